"""The run over EPICS: what clients of another process read, write and stop; and the set-point by itself."""

from __future__ import annotations

import ctypes
import importlib.util
import itertools
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import example, given, settings
from hypothesis import strategies as st

import truestroke
from truestroke import AdaptiveController, Recording, SettingError
from truestroke.cli import main
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.runtime.drivers import SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import (
    Axis,
    Cause,
    EpicsSettings,
    RealtimeError,
    RealtimeSettings,
    SetPoint,
    config,
    helpers,
    process,
    run_realtime,
    server,
)
from truestroke.signals.trajectories import sine

pytestmark = pytest.mark.usefixtures("empty_folder", "forked_helpers")

COMMAND = Path(sys.executable).with_name("truestroke")
LIMITS = (-0.6, 3.6)
WAVE = sine(frequency=8.0, peak_to_peak=20.0, duration=1.0)
EPICS = """
[epics]
prefix = "TEST:STAGE"
window = 0.5
rmse_warning = 1e-4
rmse_alarm = 25.0
"""
SINE = """
[[axis]]
name = "y"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 400.0
trajectory = { kind = "sine", frequency = 4.0, peak_to_peak = 10.0, duration = 60.0 }
"""


@pytest.fixture(autouse=True)
def _on_ports_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of this computer alone, so that no EPICS in the neighbourhood answers."""
    with socket.socket() as first, socket.socket() as second, socket.socket() as third:
        for variable, one in (("CA_SERVER", first), ("CA_REPEATER", second), ("PVA_SERVER", third)):
            one.bind(("127.0.0.1", 0))
            monkeypatch.setenv(f"EPICS_{variable}_PORT", str(one.getsockname()[1]))
        one = third.getsockname()[1]
    monkeypatch.setenv("EPICS_PVA_BROADCAST_PORT", str(one))
    page = (Path(__file__).parents[1] / "docs/epics.md").read_text()
    exports = re.findall(r"^export (EPICS_\w+)=(\S+)", page, flags=re.MULTILINE)  # as a reader types them
    assert len(exports) == 4
    for variable, value in exports:
        monkeypatch.setenv(variable, value)


# ---- With a client --------------------------------------------------------------------------------------------------


def configure(window: float = 0.5) -> None:
    """An axis that is moved, and one that follows a sine."""
    text = config.example("serve").replace("= 3600.0", "= 60.0").partition("\n[epics]")[0] + "\n"
    text = text.replace('name = "simulated"', 'name = "simulated"\nregister = "volts"\nchannels = 2')
    text += SINE + EPICS.replace("window = 0.5", f"window = {window}") + '[recording]\nfile = "run.h5"\n'
    text += "[realtime]\nspin = 0.0\noverrun_streak = 0\nwatchdog_timeout = 20.0\n"
    Path("serve.toml").write_text(text)


@contextmanager
def served(window: float = 0.5) -> Iterator[subprocess.Popen[str]]:
    configure(window)
    command = [COMMAND, "serve", "--epics", "--config", "serve.toml", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def client(*arguments: str) -> dict[str, Any]:
    """What a client of another process saw."""
    file = Path(__file__).with_name("epics_client.py")
    done = subprocess.run([sys.executable, file, *arguments], capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 0, done.stderr
    seen: dict[str, Any] = json.loads(done.stdout)
    return seen


def is_part(wave: list[float], channel: np.ndarray) -> bool:
    """Whether these numbers follow each other in the recording."""
    windows = np.lib.stride_tricks.sliding_window_view(channel, len(wave))
    return bool((windows == wave).all(axis=1).any())


def test_an_operator_moves_reads_and_stops() -> None:
    with served() as process:
        seen = client("move")
        stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 15, stderr
    assert json.loads(stdout)["cause"] == "stopped"
    assert np.fromfile("volts").tolist() == [0.0, 0.0]

    limits = [seen["first"][f"{side}_{what}_limit"] for what in ("ctrl", "disp") for side in ("lower", "upper")]
    assert (seen["first"]["value"], seen["first"]["units"], limits) == (0.0, "um", [0.0, 28.0, 0.0, 28.0])
    assert seen["there"] == 12.0
    assert seen["beyond"] == 28.0
    assert not seen["y is moved"]
    assert seen["written"] == []
    assert seen["written by PV Access"] == ["X:SETPOINT"]
    units = {name: seen[name]["units"] for name in ("X:VOLTS", "X:READBACK", "X:RMSE", "X:WEIGHTS", "TIME_LEFT")}
    assert units == {"X:VOLTS": "V", "X:READBACK": "um", "X:RMSE": "um", "X:WEIGHTS": "um/V", "TIME_LEFT": "s"}
    assert (seen["X:VOLTS"]["lower_disp_limit"], seen["X:VOLTS"]["upper_disp_limit"]) == LIMITS
    assert 0 < seen["X:VOLTS"]["value"] < 3.6
    assert (seen["X:RMSE"]["severity"], seen["X:READBACK"]["severity"]) == (1, 0)  # warned of beyond 0.1 nm
    assert seen["SAMPLE_RATE"]["value"] == 2000.0
    assert 0 < seen["TIME_LEFT"]["value"] < 60.0

    x, y = Recording.load("run-x.h5"), Recording.load("run-y.h5")
    assert "operator" in x.metadata["interrupted"]
    assert (x.metadata["trajectory"]["name"], x.metadata["trajectory"]["settings"]["speed"]) == ("set-point", 100.0)
    assert np.abs(np.diff(x["desired"])).max() * 2000.0 == pytest.approx(100.0)
    assert x["desired"].max() == 28.0
    assert len(seen["MEASURED"]["value"]) == 1000
    assert is_part(seen["DESIRED"]["value"], y["desired"])
    assert is_part(seen["MEASURED"]["value"], y["measured"])
    assert is_part(seen["ERROR"]["value"], y["measured"] - y["desired"])
    assert (x["weights"] == seen["X:WEIGHTS"]["value"]).all(axis=1).any()


def test_bluesky_flies_the_axis() -> None:
    with served(window=2.0):
        file = Path(__file__).with_name("fakes") / "ophyd_flight.py"
        done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=90, check=False)
        assert done.returncode == 0, done.stderr
        seen = json.loads(done.stdout.splitlines()[-1])
    assert set(seen["keys"]) == {"x-desired", "x-measured", "x-volts"}
    for page, places in zip(seen["pages"], ([8, 9, 10, 11, 12], [12, 11, 10, 9, 8]), strict=True):
        assert page["x-desired"] == pytest.approx(places, abs=0.1)  # at most half a tick beside the middle
        assert page["x-measured"] == pytest.approx(page["x-desired"], abs=0.1)
        assert np.ptp(page["x-volts"]) > 0.2
    assert "speed = 1000" in seen["refused"]
    words, place, fast_again = seen["stopped"]  # it flew on to the end
    assert words == "Device x was stopped."
    assert 8.0 < place < 11.5
    assert fast_again


def test_when_the_loop_is_gone_clients_hear_of_it() -> None:
    with served() as process:
        seen = client("lose", str(process.pid))
    assert seen["states"][-1] == [5, 2]  # lost, MAJOR
    assert seen["places"][0] == 0
    assert seen["places"][-1] == 3  # INVALID
    assert np.fromfile("volts").tolist() == [0.0, 0.0]  # by the watchdog


# ---- The server, seen from the loop --------------------------------------------------------------------------------


class Bench(SimulatedDriver):
    """Does something at some exchanges."""

    def __init__(self, do: dict[int, Callable[[], object]]) -> None:
        super().__init__(SimulatedSettings(register="volts"))
        self._calls, self._do = itertools.count(), do

    def exchange(self, volts: np.ndarray, measured: np.ndarray) -> None:
        self._do.get(next(self._calls), lambda: None)()
        super().exchange(volts, measured)


def controller() -> AdaptiveController:
    return AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=LIMITS, slew_limit=400.0)


def run(do: dict[int, Callable[[], object]] | None = None, **changes: Any) -> Any:
    axis = Axis(trajectory=WAVE, controller=controller(), voltage_limits=LIMITS, slew=400.0)
    keep = RealtimeSettings(spin=0.0, overrun_streak=0, watchdog_timeout=20.0)
    options = {"settings": keep, "server": EpicsSettings(prefix="TEST:STAGE"), **changes}
    return run_realtime(Bench(do or {}), [axis], "run.h5", **options)


def outside(pid: int) -> list[tuple[str, bytes]]:
    """Addresses of the UDP sockets of a process that are not at 127.0.0.1, and the device that each keeps to."""
    libc, process, found = ctypes.CDLL(None, use_errno=True), os.pidfd_open(pid), []
    for fd in map(int, os.listdir(f"/proc/{pid}/fd")):
        if not os.readlink(f"/proc/{pid}/fd/{fd}").startswith("socket:"):
            continue
        copy = libc.syscall(438, process, fd, 0)  # pidfd_getfd
        assert copy >= 0, os.strerror(ctypes.get_errno())
        with socket.socket(fileno=copy) as one:
            if one.type == socket.SOCK_DGRAM and one.getsockname()[0] != "127.0.0.1":
                device = one.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)
                found.append((one.getsockname()[0], device.rstrip(b"\0")))
    os.close(process)
    return found


def test_a_server_of_this_computer_hears_nothing_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    servers = noted_servers(monkeypatch)
    seen: list[tuple[str, bytes]] = []
    run({200: lambda: seen.extend(outside(servers[0].pid))})
    assert "0.0.0.0" in [address for address, _ in seen]  # searches of PV Access
    assert {device for _, device in seen} == {b"lo"}


def noted_servers(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    servers: list[subprocess.Popen[bytes]] = []

    def start(shared: Any, job: Callable[..., None], *arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        started = original(shared, job, *arguments, **options)
        servers.extend([started] if job is server.start else [])
        return started

    original = process.start
    monkeypatch.setattr(helpers.process, "start", start)
    return servers


def test_the_loop_does_not_notice_what_becomes_of_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    servers = noted_servers(monkeypatch)
    outcome = run({300: lambda: servers[0].send_signal(signal.SIGSTOP), 1200: lambda: servers[0].kill()})
    assert (outcome.cause, outcome.ticks, outcome.lost) == (Cause.FINISHED, 2000, 0)
    assert servers[0].poll() == -signal.SIGKILL
    simulated = truestroke.run(WAVE, controller(), RealisticPlant(PlantSettings(), seed=0))
    np.testing.assert_array_equal(Recording.load("run.h5")["volts"], simulated["volts"])


def test_what_cannot_be_served_does_not_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    np.array([0.125]).tofile("volts")
    with monkeypatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda name: None)
        with pytest.raises(RealtimeError, match='pip install "truestroke'):
            run()
    Path("softioc.py").write_text("raise ImportError('no such library')")
    monkeypatch.syspath_prepend(str(Path.cwd()))
    with pytest.raises(RealtimeError, match="the server did not start: ImportError: no such library"):
        run()
    assert np.fromfile("volts").tolist() == [0.125]
    with pytest.raises(SettingError, match=r"prefix = 'A\.VAL': must be"):
        EpicsSettings(prefix="A.VAL")
    with pytest.raises(SettingError, match="window"):
        EpicsSettings(prefix="A", window=9.0)


def call(*arguments: str) -> str:
    done = CliRunner().invoke(main, list(arguments))
    assert done.exit_code == 2
    return " ".join(done.output.split())


def test_what_the_command_line_refuses() -> None:
    configure()
    assert "truestroke serve --epics" in call("run", "--config", "serve.toml")
    assert "--epics or --live is needed" in call("serve", "--config", "serve.toml")
    assert "--example prints one" in call("serve", "--epics")
    Path("run.toml").write_text(config.example())
    assert "a table [epics] is needed" in call("serve", "--epics", "--config", "run.toml")
    Path("serve.toml").write_text(Path("serve.toml").read_text().replace("reach = [0.0", "reach = [5.0"))
    assert "0 um = 0.0 um: must be from 5 to 28 um" in call("serve", "--epics", "--config", "serve.toml")


# ---- The set-point by itself ---------------------------------------------------------------------------------------

RATE, SPEED, RAMP, REACH = 1000.0, 200.0, 0.03, (-5.0, 20.0)
TARGETS = st.one_of(st.floats(-5.0, 20.0), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -7.0]))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(TARGETS, st.integers(0, 200)), min_size=1, max_size=8))
@example([(1.0, 0), (math.nan, 0)])
@example([(1.0, 1), (math.nan, 0)])
def test_a_set_point_keeps_its_bounds_and_arrives(moves: list[tuple[float, int]]) -> None:
    target = memoryview(bytearray(8)).cast("d")
    motion = SetPoint(reach=REACH, speed=SPEED, ramp=RAMP, sample_rate=RATE).motion(target)
    ticks, path, goal = itertools.count(), [], 0.0
    for i, (asked, wait) in enumerate(moves):
        target[0] = asked
        looked = len(path) + wait > 1 or i == len(moves) - 1  # the first tick is at rest, whatever is asked
        seen = looked and (wait or i == len(moves) - 1) and not math.isnan(asked)  # else no tick sees it
        goal = min(max(asked, REACH[0]), REACH[1]) if seen else goal
        path += [motion(next(ticks)) for _ in range(wait)]
    path += [motion(next(ticks)) for _ in range(math.ceil(1000 * (25.0 / SPEED + RAMP)) + 3)]
    z, speed = np.array(path).T
    assert z[0] == speed[0] == speed[-1] == 0
    assert z[-1] == pytest.approx(goal, abs=2.0**-33)  # a ten-thousandth of a nm
    assert REACH[0] <= z.min() <= z.max() <= REACH[1]
    assert np.abs(speed).max() <= SPEED * (1 + 1e-9)
    assert np.abs(np.diff(speed)).max() * RATE <= 4 * SPEED / RAMP * (1 + 1e-9)
    trapezoids = np.cumsum(0.5 * (speed[1:] + speed[:-1])) / RATE
    np.testing.assert_allclose(z[1:], trapezoids, atol=2 * SPEED / RAMP / RATE**2)


def test_a_set_point_that_never_moves_stays_exact_for_a_hundred_thousand_ticks() -> None:
    target = memoryview(bytearray(8)).cast("d")
    motion = SetPoint(reach=(0.0, 30.0), speed=100.0).motion(target)
    target[0] = 7.1
    assert motion(100_000) == (pytest.approx(7.1, abs=2.0**-33), 0.0)
