"""What happens when something goes wrong: one test for each row of the table in docs/run.md.

Each ends with the output at the safe voltage, a recording that says why, and its own exit code.
"""

from __future__ import annotations

import itertools
import math
import os
import re
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_supervision
from running import configuration, started, ticks

from truestroke import AdaptiveController, Recording, SettingError
from truestroke.runtime.drivers import DriverError, Fault, SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import (
    Axis,
    Outcome,
    RealtimeError,
    RealtimeSettings,
    helpers,
    run_realtime,
    runner,
)
from truestroke.runtime.realtime import process as processes
from truestroke.signals.trajectories import sine

LIMITS, SLEW, SAFE, RATE = (-0.6, 3.6), 100.0, 0.25, 2000.0
FOREVER = 10**6
# A busy machine is late by ms and more; the wait before a tick is for the tests of the clock.
PATIENT = {"overrun_streak": 0, "watchdog_timeout": 20.0, "spin": 0.0, "axis_check": False}
pytestmark = [
    pytest.mark.filterwarnings("ignore::truestroke.LatenessWarning"),
    pytest.mark.usefixtures("forked_helpers"),
]


class Bench(SimulatedDriver):
    """Notes what leaves, and does something at some exchanges."""

    def __init__(self, settings: SimulatedSettings, do: dict[int, Callable[[], object]]) -> None:
        super().__init__(settings)
        self.left: list[float] = []
        self._do, self._calls = do, 0

    def start(self, volts: np.ndarray) -> None:
        super().start(volts)
        self.left += volts.tolist()

    def exchange(self, volts: np.ndarray, measured: np.ndarray) -> None:
        self._calls += 1
        self._do.get(self._calls, lambda: None)()
        super().exchange(volts, measured)
        self.left += volts[0].tolist()

    def stop(self, volts: np.ndarray) -> None:
        super().stop(volts)
        self.left += volts.tolist()


class Odd(AdaptiveController):
    """A controller that goes wrong at tick 400."""

    def __init__(self, wrong: Callable[[float], float]) -> None:
        super().__init__(sample_rate=RATE, stroke=30.0, voltage_limits=LIMITS, slew_limit=SLEW)
        self._wrong, self._tick = wrong, 0

    def command(self, z_d: float, zdot_d: float) -> float:
        self._tick += 1
        volts = super().command(z_d, zdot_d)
        return self._wrong(volts) if self._tick >= 400 else volts


def too_much(ticks: int) -> Callable[[float], float]:
    """50 V for so many ticks, then what is right."""
    left = itertools.chain(itertools.repeat(50.0, ticks), itertools.repeat(None))
    return lambda volts: volts if (much := next(left)) is None else much


def fail(volts: float) -> float:
    raise ArithmeticError("no such voltage")


@dataclass
class Row:
    """How the row is brought about, and what is to come of it."""

    code: int
    words: str = ""
    do: Callable[[], object] | None = None
    at: tuple[int, ...] = (500,)  # exchanges
    faults: tuple[Fault, ...] = ()
    wrong: Callable[[float], float] | None = None
    soft: bool = True
    settings: dict[str, Any] = field(default_factory=dict)
    driver: dict[str, Any] = field(default_factory=dict)
    also: Callable[[Outcome, Recording], bool] | None = None


def send(number: int) -> Callable[[], None]:
    return lambda: os.kill(os.getpid(), number)


def fault(kind: str, at: int = 500, count: int = FOREVER) -> tuple[Fault, ...]:
    return (Fault(kind=kind, at=at, count=count),)


HELPERS: dict[str, subprocess.Popen[bytes]] = {}  # of the run that goes on


def to(name: str, number: int) -> Callable[[], None]:
    return lambda: HELPERS[name].send_signal(number)


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def fill_the_disk() -> None:
    resource.prlimit(HELPERS["record"].pid, resource.RLIMIT_FSIZE, (0, 0))


def lost(outcome: Outcome, recording: Recording) -> bool:
    return outcome.lost == np.isnan(recording["measured"]).sum() > 0


ROWS = {
    "Ctrl-C": Row(130, "Ctrl-C", do=send(signal.SIGINT)),
    "Ctrl-C twice": Row(130, "Ctrl-C; no soft stop: Ctrl-C", do=send(signal.SIGINT), at=(500, 503), soft=False),
    "Ctrl-C in the axis check": Row(
        130, "Ctrl-C", do=send(signal.SIGINT), settings={"axis_check": True}, also=lambda o, r: o.ticks == 0
    ),
    "Ctrl-C in the soft start": Row(130, "Ctrl-C", do=send(signal.SIGINT), at=(3,), also=lambda o, r: o.ticks == 0),
    "SIGTERM": Row(143, "SIGTERM", do=send(signal.SIGTERM)),
    "the terminal is closed": Row(129, "terminal", do=send(signal.SIGHUP)),
    "the controller raises": Row(1, "ArithmeticError: no such voltage", wrong=fail),
    "the controller asks for NaN": Row(1, "no number", wrong=lambda volts: math.nan, driver={"block": 4}),
    "the controller asks for too much": Row(0, wrong=too_much(40), also=lambda o, r: 0 < o.limited < 200),
    "the axis is lost": Row(4, "tracking is lost", wrong=too_much(FOREVER), also=lambda o, r: o.limited > 0),
    "a few samples are lost": Row(0, faults=fault("nan", count=50), also=lost),
    "part of a block is lost": Row(0, faults=fault("short", 100, 20), driver={"block": 4}, also=lost),
    "the sensor delivers nothing": Row(10, "no usable measurement for 200 ticks", faults=fault("nan")),
    "the sensor delivers unusable values": Row(10, "no usable measurement for 200 ticks", faults=fault("wild")),
    "the sensor is not zeroed": Row(10, "zero the sensor", faults=fault("wild", at=0)),
    "the sensor is frozen": Row(10, "while the voltage moves", faults=fault("frozen")),
    "the driver raises": Row(12, "exchange: error -1", faults=fault("error"), soft=False),
    "the driver raises at the start": Row(12, "start: error -2", faults=fault("start"), soft=False),
    "the driver raises at the stop": Row(12, "stop: error -2", faults=fault("stop")),
    "a block is late": Row(0, faults=fault("slip", count=1), also=lambda o, r: o.overruns > 0),
    "all blocks are late": Row(11, "raise `overrun_streak`", faults=fault("slip"), settings={"overrun_streak": 100}),
    "the disk is full": Row(13, "recording cannot be written", do=fill_the_disk),
    "the recorder dies": Row(13, "recorder died", do=to("record", signal.SIGKILL)),
    "the recorder hangs": Row(13, "s behind", do=to("record", signal.SIGSTOP)),
    "the watchdog dies": Row(14, "the watchdog died", do=to("watch", signal.SIGKILL)),
    "the watchdog is stopped (SIGSTOP)": Row(14, "the watchdog stands still", do=to("watch", signal.SIGSTOP)),
    "the deputy of the watchdog dies": Row(14, "the deputy of the watchdog died", do=to("deputise", signal.SIGKILL)),
    "the deputy is stopped (SIGSTOP)": Row(14, "the deputy of the watchdog stands", do=to("deputise", signal.SIGSTOP)),
}


@pytest.fixture(autouse=True)
def _short_patience(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = processes.start

    def start(shared: Any, job: Any, *arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        HELPERS[job.__name__] = real(shared, job, *arguments, **options)
        return HELPERS[job.__name__]

    monkeypatch.setattr(processes, "start", start)
    monkeypatch.chdir(tmp_path)


def axis(wrong: Callable[[float], float] = lambda volts: volts) -> Axis:
    wave = sine(frequency=4.0, peak_to_peak=20.0, duration=0.8, sample_rate=RATE)
    return Axis(trajectory=wave, controller=Odd(wrong), voltage_limits=LIMITS, slew=SLEW, safe_voltage=SAFE)


@pytest.mark.parametrize("name", ROWS)
def test_row(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = ROWS[name]
    if name == "the recorder hangs":
        monkeypatch.setattr(runner, "BUFFER", 0.4)
        monkeypatch.setattr(helpers, "LAST_WORDS", 0.5)
    if "(SIGSTOP)" in name:
        monkeypatch.setattr(helpers, "BEAT", 0.25)
    settings = SimulatedSettings(register=str(tmp_path / "volts"), faults=row.faults, **row.driver)
    bench = Bench(settings, dict.fromkeys(row.at, row.do) if row.do else {})
    outcome = run_realtime(
        bench, [axis(row.wrong or (lambda v: v))], "run.h5", settings=RealtimeSettings(**{**PATIENT, **row.settings})
    )
    assert outcome.cause.value == row.code, outcome
    assert row.words in outcome.reason
    assert np.fromfile("volts") == SAFE
    steps = np.abs(np.diff(bench.left)) * RATE
    assert min(bench.left) >= LIMITS[0]
    assert max(bench.left) <= LIMITS[1]
    assert (steps.max(initial=0.0) <= SLEW * (1 + 1e-6)) or not row.soft
    assert_recorded(outcome, row)


def test_a_terminal_that_closes_does_not_end_a_run_under_nohup(tmp_path: Path) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        bench = Bench(SimulatedSettings(register=str(tmp_path / "volts")), {500: send(signal.SIGHUP)})
        outcome = run_realtime(bench, [axis()], "run.h5", settings=RealtimeSettings(**PATIENT))
    finally:
        signal.signal(signal.SIGHUP, before)
    assert outcome.cause.value == 0
    assert np.fromfile("volts") == SAFE


def exits() -> None:
    raise SystemExit("the library has had enough")


@pytest.mark.parametrize(
    ("do", "soft"), [(send(signal.SIGINT), True), (exits, False)], ids=["first Ctrl-C", "the driver exits"]
)
def test_in_the_soft_stop(do: Callable[[], object], soft: bool, tmp_path: Path) -> None:
    """A first Ctrl-C does not turn it into a step; a driver that exits does not leave the output where it is."""
    waiting: list[Callable[[], object]] = []

    def wrong(volts: float) -> float:
        waiting.append(do)
        return fail(volts)

    def once() -> None:
        if waiting:
            waiting.pop()()

    bench = Bench(SimulatedSettings(register=str(tmp_path / "volts")), dict.fromkeys(range(1, 9999), once))
    outcome = run_realtime(bench, [axis(wrong)], "run.h5", settings=RealtimeSettings(**PATIENT))
    assert not waiting  # it came about
    assert outcome.cause.value == 1
    assert ("no soft stop" in outcome.reason) is not soft
    assert np.fromfile("volts") == SAFE
    assert np.abs(np.diff(bench.left)).max() * RATE <= SLEW * (1 + 1e-6) or not soft


def assert_recorded(outcome: Outcome, row: Row) -> None:
    recording = Recording.load("run.h5")
    assert recording.metadata["interrupted"] == (outcome.reason or None)
    assert recording.metadata["ended"]["exit_code"] == row.code
    missing = outcome.ticks - recording["time"].size
    assert 0 <= missing <= (0.5 * RATE if row.code == 13 else 0)
    assert outcome.ticks == outcome.all_ticks or row.code
    assert row.also is None or row.also(outcome, recording)


# ---- The process itself dies ---------------------------------------------------------------------------------------


@dataclass
class Death:
    """How the process dies, its exit code as a shell says it, and who brings the output to safety."""

    code: int
    do: Callable[[subprocess.Popen[str]], object] = lambda process: None
    faults: str = ""
    by: str = "watchdog"
    timeout: float = 9.0  # s without a tick: shorter where the test waits for it, longer than machines stall


def watchdog_of(process: subprocess.Popen[str]) -> int:
    return next(child for child in children(process.pid) if Path(f"/proc/{child}/comm").read_text() == "watch\n")


def with_the_watchdog(number: int, last: int = signal.SIGKILL) -> Callable[[subprocess.Popen[str]], None]:
    """This signal to the watchdog, and at once `last` to the process of the run."""

    def kill(process: subprocess.Popen[str]) -> None:
        process.send_signal(signal.SIGSTOP)  # else it may see the watchdog gone, and end by itself
        os.waitpid(process.pid, os.WUNTRACED)
        os.kill(watchdog_of(process), number)
        process.send_signal(last)

    return kill


DEPUTY = "deputy of the watchdog"


DEATHS = {
    "Python hangs": Death(137, faults='[{ kind = "hang", at = 1000 }]', timeout=3.0),
    "the process is stopped (SIGSTOP)": Death(137, do=lambda process: process.send_signal(signal.SIGSTOP), timeout=3.0),
    "the process is killed (kill -9)": Death(137, do=lambda process: process.kill()),
    "the vendor's library crashes": Death(134, faults='[{ kind = "abort", at = 1000 }]'),
    "process and watchdog are killed together": Death(137, do=with_the_watchdog(signal.SIGKILL), by=DEPUTY),
    "the watchdog is stopped, the process killed": Death(137, do=with_the_watchdog(signal.SIGSTOP), by=DEPUTY),
    "process and watchdog are stopped together": Death(
        137, do=with_the_watchdog(signal.SIGSTOP, signal.SIGSTOP), by=DEPUTY, timeout=3.0
    ),
}


@pytest.mark.parametrize("name", DEATHS)
def test_death(name: str) -> None:
    death = DEATHS[name]
    for _ in range(3):
        process = started(configuration(death.faults, watchdog_timeout=death.timeout))
        before = ticks("run.h5")
        death.do(process)
        _, stderr = process.communicate(timeout=60)  # to the end of the helping processes, which share stderr
        if death.by == DEPUTY or "the watchdog stood still" not in stderr:
            break
        Path("run.h5").unlink()  # the machine stalled the watchdog for so long that its deputy had to act
    assert process.returncode == 128 - death.code
    assert f"truestroke: {death.by}: " in stderr
    assert "output set to 0.25 V" in stderr
    assert np.fromfile("volts") == 0.25
    recording = Recording.load("run.h5")
    assert recording.metadata["ended"]["cause"] == "killed"
    assert f"the {death.by} set the output to the safe voltage" in recording.metadata["interrupted"]
    assert len(recording["time"]) >= (990 if death.faults else before)


EVERY = "every process of the run is killed"


def test_a_run_whose_every_process_is_killed_leaves_all_but_the_last_half_second() -> None:
    process = started(configuration())
    all_of_them = children(process.pid)
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)  # all that the ring holds is written within that; the watchdog would bite after 9 s
    before = ticks("run.h5")
    for pid in all_of_them:
        os.kill(pid, signal.SIGKILL)
    process.kill()
    process.communicate(timeout=30)
    assert process.returncode == 128 - 137
    assert np.fromfile("volts") != SAFE  # as the page says
    recording = Recording.load("run.h5")
    assert len(recording["time"]) >= before
    assert "killed" in recording.metadata["interrupted"]
    assert np.isfinite(recording["measured"]).all()


# ---- It does not begin ---------------------------------------------------------------------------------------------


def test_what_cannot_begin_does_not_touch_the_output(monkeypatch: pytest.MonkeyPatch) -> None:
    def begin(faults: tuple[Fault, ...] = (), channels: int = 1, file: str = "run.h5", **options: Any) -> None:
        np.array([0.125] * channels).tofile("volts")
        settings = SimulatedSettings(register="volts", faults=faults, channels=channels)
        run_realtime(SimulatedDriver(settings), [axis()], file, **options)

    def forbid(pid: int, policy: int, parameter: object) -> None:
        if policy == os.SCHED_FIFO:
            raise PermissionError

    with pytest.raises(DriverError, match="open: error -2"):
        begin(fault("open"))
    with pytest.raises(SettingError, match="the number of axes = 1: must be 2, one for each channel"):
        begin(channels=2)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        begin(file="nowhere/run.h5")
    full = shutil._ntuple_diskusage(10, 10, 1000)  # type: ignore[attr-defined]
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda path: full)
        with pytest.raises(RealtimeError, match="the run writes 0 MB"):
            begin()
    with monkeypatch.context() as patch:
        patch.setattr(os, "sched_setscheduler", forbid)
        with pytest.raises(RealtimeError, match="priority = 50: not permitted"):
            begin(settings=RealtimeSettings(spin=0.0, priority=50))
    with pytest.raises(SettingError, match=r"cpu = 4095: must be one of .* that this process may use"):
        begin(file="cpu.h5", settings=RealtimeSettings(cpu=4095))
    Path("run.h5").write_text("precious")
    with pytest.raises(FileExistsError, match="a recording is there"):
        begin()
    assert Path("run.h5").read_text() == "precious"
    assert set(np.fromfile("volts")) == {0.125}


def test_the_table_of_the_page_has_these_rows_and_codes() -> None:
    page = (Path(__file__).parents[1] / "docs/run.md").read_text()
    rows = re.findall(r"^\| ([^|`]+?) \| [^|]+ \| [^|]+ \| (\d+) \|$", page, flags=re.MULTILINE)
    ours = {name: row.code for name, row in (ROWS | DEATHS).items()} | {EVERY: 137}
    assert {name: int(code) for name, code in rows} == ours | test_supervision.ROWS
