"""The NI-DAQmx driver, through the unmodified `nidaqmx` package, on the fake card of tests/fakes/nidaqmx.c."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from click.testing import CliRunner
from running import COMMAND, until
from test_docs import assert_prints

import truestroke
from truestroke import SettingError, plant, trajectories
from truestroke.cli import main
from truestroke.runtime import doctor
from truestroke.runtime.drivers import DriverError
from truestroke.runtime.drivers.nidaqmx import NidaqmxDriver, NidaqmxSettings
from truestroke.runtime.drivers.turned import Turned
from truestroke.signals.timing import Timing

if TYPE_CHECKING:
    from card import Card

pytest_plugins = ["card"]

ROOT = Path(__file__).parents[1]
SAFE = np.array([0.25])  # V; not 0, where a reset would leave it
STACK = {"outputs": ("Dev1/ao0",), "inputs": ("Dev1/ai0",), "um_per_volt": 10.0}


@pytest.fixture
def driver(card: Card):
    driver = NidaqmxDriver(NidaqmxSettings(**STACK))
    yield driver
    driver.close()


def fail(monkeypatch: pytest.MonkeyPatch, function: str, call: int | str, what: int | str) -> None:
    monkeypatch.setenv("FAKE_NIDAQMX_FAULT", f"{function}:{call}:{what}")


def move(driver: NidaqmxDriver, volts: np.ndarray) -> np.ndarray:
    """Volts of shape (channels, ticks), whole blocks, and what came back."""
    measured = np.full(volts.shape, np.inf)
    block = driver.settings.block
    for k in range(0, volts.shape[1], block):
        part = np.empty((len(volts), block))
        driver.exchange(np.ascontiguousarray(volts[:, k : k + block]), part)
        measured[:, k : k + block] = part
    return measured


def begun(driver: NidaqmxDriver) -> NidaqmxDriver:
    driver.open()
    driver.start(np.full(len(driver.settings.outputs), 1.0))
    return driver


def assert_safe(driver: NidaqmxDriver, card: Card) -> None:
    """Stop, twice, is what the terminals show; nothing is left behind."""
    for _ in range(2):
        driver.stop(SAFE)
        assert card.volts[0] == SAFE[0]
        assert (card.tasks, card.owner) == (0, 0)


# ---- Measurements belong to their commands ------------------------------------------------------------------------


def offline(volts: np.ndarray) -> np.ndarray:
    stack = plant.RealisticPlant(plant.PlantSettings().without("noise", "ad_quantisation"))
    return stack.exchange(volts)


@pytest.mark.parametrize(("block", "ahead"), [(20, 2), (1, 1), (31, 1), (7, 8)])
def test_each_measurement_answers_the_command_that_the_latency_says(card: Card, block: int, ahead: int) -> None:
    driver = NidaqmxDriver(NidaqmxSettings(**STACK, block=block, ahead=ahead))
    timing = driver.open()
    assert timing == Timing(sample_rate=2000.0, block=block, latency=ahead * block, channels=1, hardware_timed=True)
    driver.start(np.zeros(1))
    volts = np.repeat(np.random.default_rng(1).uniform(0.0, 3.0, 28), 5 * block)[None, :]
    measured = move(driver, volts)[0]
    driver.stop(SAFE)
    assert np.abs(measured[: timing.latency]).max() < 0.1  # at rest: nothing was commanded
    wrong = measured[timing.latency :] - offline(volts[0])[: -timing.latency]
    assert wrong.std() == pytest.approx(0.030 / np.sqrt(5), rel=0.25)  # the sensor's noise, and nothing else


TWO_AXES = NidaqmxSettings(
    outputs=["Dev1/ao2", "Dev1/ao0"], inputs=["Dev1/ai2", "Dev1/ai0"], um_per_volt=[10.0, -20.0], offset=[0.0, 5.0]
)


def test_axes_do_not_mix_and_each_has_its_sensor(card: Card) -> None:
    driver = NidaqmxDriver(TWO_AXES)
    assert driver.open().channels == 2
    driver.start(np.array([0.0, 0.0]))
    volts = np.outer([1.0, 2.0], np.ones(200))
    first, second = move(driver, volts)[:, -1]
    assert card.volts == [2.0, 0.0, 1.0, 0.0]
    driver.stop(np.array([0.5, 0.75]))
    assert card.volts == [0.75, 0.0, 0.5, 0.0]
    truth = offline(np.ones(160)), offline(np.full(160, 2.0))
    assert first == pytest.approx(truth[0][-1], abs=0.1)
    assert second == pytest.approx(5.0 - 2.0 * truth[1][-1], abs=0.2)


def test_a_frame_turns_what_the_sensors_of_the_card_read(card: Card) -> None:
    driver = Turned(NidaqmxDriver(TWO_AXES), [[0.0, 2.0], [1.0, 0.0]])  # sensor 0 reads twice axis 1
    driver.open()
    driver.start(np.array([0.0, 0.0]))
    measured = np.empty((2, 20))
    for _ in range(10):
        driver.exchange(np.outer([1.0, 2.0], np.ones(20)), measured)
    driver.stop(np.zeros(2))
    driver.close()
    first, second = offline(np.ones(160))[-1], 5.0 - 2.0 * offline(np.full(160, 2.0))[-1]
    assert measured[:, -1] == pytest.approx([second, first / 2.0], abs=0.2)


class Axis:
    """An actuator of loop.run."""

    def __init__(self, driver: NidaqmxDriver) -> None:
        self.driver = driver

    def open(self) -> Timing:
        timing = self.driver.open()
        self.driver.start(np.zeros(1))
        return timing

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        block, measured = np.full((1, 20), volts[-1]), np.empty((1, 20))
        block[0, : volts.size] = volts
        self.driver.exchange(block, measured)
        return measured[0, : volts.size]


class Late:
    """The simulated stack behind the same block and latency: the offline simulation."""

    def open(self) -> Timing:
        self.stack, self.waiting = plant.RealisticPlant(seed=3), np.zeros(40)
        return Timing(sample_rate=2000.0, block=20, latency=40)

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        waiting = np.append(self.waiting, volts)
        now, self.waiting = waiting[: volts.size], waiting[volts.size :]
        return self.stack.exchange(now)


def test_a_wave_is_tracked_as_well_as_offline(driver: NidaqmxDriver, card: Card) -> None:
    wave = trajectories.random_wave(duration=4.0, seed=0)
    rmse = []
    for actuator in (Axis(driver), Late()):
        controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
        run = truestroke.run(wave, controller, actuator)
        assert np.isnan(run["measured"]).sum() == 40  # what was still under way at the end
        error = (run["measured"] - run["desired"])[4000:-40]
        rmse.append(np.sqrt(np.mean(error**2)))
    assert rmse[0] == pytest.approx(rmse[1], rel=0.08)
    assert rmse[0] < 0.016
    assert_safe(driver, card)


# ---- What goes wrong while it runs --------------------------------------------------------------------------------

READ, WRITE = "DAQmxReadAnalogF64", "DAQmxWriteAnalogF64"
BROKEN = [
    (WRITE, -200290, r"writing to Dev1/ao0: NI-DAQmx -200290: The generation has stopped.*larger block"),
    (WRITE, -200621, r"NI-DAQmx -200621: .*larger block"),
    (READ, -200279, r"reading from Dev1/ai0: NI-DAQmx -200279: .*not able to keep up.*larger block"),
    (READ, -200284, r"NI-DAQmx -200284: .*sample clock"),
    (READ, -200324, r"NI-DAQmx -200324: .*plugged in"),
    (WRITE, -50405, r"writing to Dev1/ao0: NI-DAQmx -50405: Something went wrong"),
    (READ, "short", "read_many_sample: the card moved 50 samples of 100"),
    (WRITE, "short", "write_many_sample: the card moved 50 samples of 100"),
    (READ, "slip", "the input has lost edges of its clock"),
    ("DAQmxGetReadAttribute", -200077, "NI-DAQmx -200077"),
]


@pytest.mark.parametrize(("function", "what", "message"), BROKEN, ids=[f"{f}:{w}" for f, w, _ in BROKEN])
def test_a_fault_is_named_and_the_safe_voltage_is_reached(driver, card, monkeypatch, function, what, message) -> None:
    fail(monkeypatch, function, 5, what)
    begun(driver)
    with pytest.raises(DriverError, match=message):
        move(driver, np.full((1, 200), 2.0))
    assert_safe(driver, card)
    assert card.resets == 0


def test_a_burst_without_signal_is_nan_and_the_run_goes_on(driver, card, monkeypatch) -> None:
    fail(monkeypatch, READ, 2, "nan")
    measured = move(begun(driver), np.full((1, 100), 1.0))[0]
    assert np.flatnonzero(np.isnan(measured)).tolist() == [22, 23]
    assert_safe(driver, card)


def test_a_late_computer_stops_the_output_and_is_told_so(card, monkeypatch) -> None:
    monkeypatch.setenv("FAKE_NIDAQMX_REALTIME", "1")  # slowly: a busy machine that runs this test may be 0.2 s late
    driver = begun(NidaqmxDriver(NidaqmxSettings(**STACK, sample_rate=200.0, converter_rate=1000.0)))
    assert (card.volts[0], card.edges) == (1.0, 0)
    time.sleep(0.5)  # more than waits in the buffer
    begin = time.perf_counter()
    move(driver, np.full((1, 60), 2.0))
    assert time.perf_counter() - begin > 0.29  # s: three blocks of 0.1 s, paced by the card; a slower loop is late
    time.sleep(0.5)
    with pytest.raises(DriverError, match="this computer was late; take a larger block, or more blocks ahead"):
        move(driver, np.full((1, 20), 2.0))
    assert card.volts[0] == 2.0  # the output holds what it had
    assert_safe(driver, card)


@pytest.mark.parametrize(("volts", "why"), [(10.5, "NI-DAQmx -200561"), (np.nan, "not finite"), (np.inf, "not finite")])
def test_a_voltage_that_the_card_cannot_give_does_not_reach_it(driver, card, volts, why) -> None:
    begun(driver)
    with pytest.raises(DriverError, match=f"writing to Dev1/ao0: .*{why}"):
        move(driver, np.full((1, 20), volts))
    assert_safe(driver, card)


def test_a_ramp_to_safety_comes_to_its_end_before_the_stop(card, monkeypatch) -> None:
    monkeypatch.setenv("FAKE_NIDAQMX_REALTIME", "1")
    driver = NidaqmxDriver(NidaqmxSettings(**STACK, sample_rate=200.0, converter_rate=1000.0))
    driver.open()
    driver.start(np.zeros(1))
    up = np.linspace(0.0, 2.0, 20)
    move(driver, np.concatenate([up, up[::-1]])[None, :])  # the way down is still in the buffer
    driver.stop(np.zeros(1))
    assert card.edges >= 5 * 80
    assert card.step < 0.11
    driver.close()


# ---- Open, start, stop --------------------------------------------------------------------------------------------


BEFORE_THE_CLOCK = (
    "CreateTask CreateAOVoltageChan CreateAIVoltageChan CfgSampClkTiming SetBufferAttribute SetWriteAttribute "
    "GetTimingAttribute GetWriteAttribute GetReadAttribute TaskControl WriteAnalogF64 StartTask ReadAnalogF64"
)


@pytest.mark.parametrize("call", [0, 1])
@pytest.mark.parametrize("function", BEFORE_THE_CLOCK.split())
def test_whatever_fails_before_the_clock_runs_leaves_nothing_behind(driver, card, monkeypatch, function, call) -> None:
    fail(monkeypatch, f"DAQmx{function}", call, -200324)
    with contextlib.suppress(DriverError):  # some are called once
        move(begun(driver), np.full((1, 20), 2.0))
        assert call == 1
    assert_safe(driver, card)


def test_opening_leaves_the_output_where_it_is(driver, card) -> None:
    driver.stop(np.array([2.5]))
    driver.open()
    assert card.volts[0] == 2.5
    assert card.edges == 0


@pytest.mark.parametrize("function", ["DAQmxGetReadAttribute", "DAQmxGetWriteAttribute"])
def test_a_card_with_another_number_of_channels_is_refused(driver, card, monkeypatch, function) -> None:
    fail(monkeypatch, function, 0, "double")
    with pytest.raises(DriverError, match=r"(in|out)put channels: the card says 2, the settings 1"):
        driver.open()
    assert_safe(driver, card)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"outputs": ["Dev2/ao0"]}, r"opening Dev2/ao0, Dev1/ai0: NI-DAQmx -200220: .*the card's name"),
        ({"inputs": ["Dev1/ai9"]}, r"NI-DAQmx -200170: .*have this channel"),
        ({"outputs": ["Dev1/ao0:1"]}, "output channels: the card says 2, the settings 1"),
        ({"converter_rate": 14_000.0}, r"converter_rate in Hz: the card says 13999\.7"),
    ],
)
def test_what_the_card_cannot_do_is_said_at_open(card, change, message) -> None:
    driver = NidaqmxDriver(NidaqmxSettings(**(STACK | change)))
    with pytest.raises(DriverError, match=message):
        driver.open()
    assert (card.tasks, card.owner) == (0, 0)


def test_stop_works_from_any_state_and_the_card_starts_again(driver, card) -> None:
    assert_safe(driver, card)
    driver.open()
    assert_safe(driver, card)
    begun(driver)
    driver.open()  # once more
    with pytest.raises(DriverError, match="the driver is open; call start first"):
        move(driver, np.zeros((1, 20)))
    assert_safe(driver, card)
    driver.start(np.zeros(1))  # without a second open
    move(driver, np.full((1, 20), 2.0))
    driver.close()
    driver.close()
    assert_safe(driver, card)
    with pytest.raises(DriverError, match="the driver is closed; call start first"):
        move(driver, np.zeros((1, 20)))


def test_a_task_that_cannot_be_ended_does_not_keep_the_voltage_from_being_safe(driver, card, monkeypatch) -> None:
    begun(driver)
    fail(monkeypatch, "DAQmxClearTask", "*", -50405)
    with pytest.raises(DriverError, match="-50405"):
        driver.stop(SAFE)
    assert card.volts[0] == SAFE[0]


def test_stop_resets_a_card_that_refuses(driver, card, monkeypatch) -> None:
    begun(driver)
    fail(monkeypatch, WRITE, 2, -50103)  # after the two of start
    driver.stop(SAFE)
    assert (card.volts[0], card.resets) == (SAFE[0], 1)


# ---- Another process ----------------------------------------------------------------------------------------------

HANGS = """
import numpy as np
from truestroke.runtime.drivers.nidaqmx import NidaqmxDriver, NidaqmxSettings
driver = NidaqmxDriver(NidaqmxSettings(outputs=["Dev1/ao0"], inputs=["Dev1/ai0"], um_per_volt=10.0))
driver.open()
driver.start(np.zeros(1))
while True:
    driver.exchange(np.full((1, 20), 2.0), np.empty((1, 20)))
"""


@pytest.mark.parametrize("killed", [True, False])
def test_rescue_reaches_the_safe_voltage_when_our_process_hangs(driver, card, killed) -> None:
    """The child finds the library by LD_LIBRARY_PATH and never comes back from its ninth read."""
    rescue = pickle.loads(pickle.dumps(driver.rescue()))
    environment = os.environ | card.environment() | {"FAKE_NIDAQMX_FAULT": f"{READ}:9:hang"}
    child = subprocess.Popen([sys.executable, "-c", HANGS], env=environment)
    try:
        until(lambda: card.file.exists() and card.edges >= 801, process=child)
        assert (card.volts[0], card.owner) == (2.0, child.pid)
        if killed:
            child.send_signal(signal.SIGKILL)
            child.wait()
        else:
            with pytest.raises(DriverError, match=r"NI-DAQmx -50103: .*another program"):
                driver.open()
        rescue(SAFE)
        assert card.volts[0] == SAFE[0]
        assert card.resets == (0 if killed else 1)  # a reset passes 0 V, so it is the last resort
    finally:
        child.kill()
        child.wait()


# ---- The card's own watchdog --------------------------------------------------------------------------------------

WATCHED = STACK | {"card_watchdog": 0.3}


def test_with_every_process_killed_a_card_with_a_watchdog_brings_its_output_to_safety(card, monkeypatch) -> None:
    """Nobody rescues. Without card_watchdog the output stays where it was."""
    monkeypatch.setenv("FAKE_NIDAQMX_WATCHDOG", "1")
    for extra, left in (("", 2.0), (", card_watchdog=2.0", SAFE[0])):
        code = HANGS.replace("um_per_volt=10.0", f"um_per_volt=10.0{extra}").replace("np.zeros(1)", "np.full(1, 0.25)")
        before = card.edges if card.file.exists() else 0
        child = subprocess.Popen([sys.executable, "-c", code], env=os.environ | card.environment())
        try:
            until(lambda before=before: card.file.exists() and card.edges >= before + 2000, process=child)
            assert card.volts[0] == 2.0  # it is kept from expiring
        finally:
            child.kill()
            child.wait()
        time.sleep(2.1 if extra else 0.0)
        assert card.volts[0] == left
    driver = NidaqmxDriver(NidaqmxSettings(**STACK | {"card_watchdog": 2.0}))
    begun(driver)  # the next run clears what has expired
    move(driver, np.full((1, 100), 2.0))
    assert card.volts[0] == 2.0
    driver.stop(SAFE)
    driver.close()
    assert (card.volts[0], card.deadline) == (SAFE[0], 0.0)


def test_a_watchdog_that_expires_ends_the_run_at_the_safe_voltage(card, monkeypatch) -> None:
    monkeypatch.setenv("FAKE_NIDAQMX_WATCHDOG", "1")
    driver = begun(NidaqmxDriver(NidaqmxSettings(**WATCHED)))
    time.sleep(0.4)
    assert card.volts[0] == 1.0  # that of start
    with pytest.raises(DriverError, match=r"-200678: .* \(the card's own watchdog has expired"):
        move(driver, np.full((1, 20), 2.0))
    assert_safe(driver, card)


def test_a_card_tells_what_it_does_unattended(card, monkeypatch) -> None:
    driver = NidaqmxDriver(NidaqmxSettings(**WATCHED))
    with pytest.raises(DriverError, match=r"card_watchdog = 0.3 s: the watchdog of Dev1: NI-DAQmx -200452"):
        driver.open()
    assert (card.tasks, card.owner) == (0, 0)
    plain = NidaqmxDriver(NidaqmxSettings(**STACK))
    plain.open()
    assert plain.unattended() == (False, "the card holds its last voltage; where it has a watchdog, set card_watchdog")
    monkeypatch.setenv("FAKE_NIDAQMX_WATCHDOG", "1")
    assert "and gets 0 V at power-up" in plain.unattended()[1]
    plain.close()
    driver.open()
    assert driver.unattended()[0]
    assert "the safe voltage after 0.3 s" in driver.unattended()[1]
    driver.close()
    with pytest.raises(SettingError, match=r"card_watchdog = 0.01 s: must be from 0.04"):
        NidaqmxSettings(**STACK | {"card_watchdog": 0.01})


def test_a_computer_without_the_library_of_ni_is_told_so() -> None:
    code = HANGS.replace("while", "driver.close()\nwhile")
    environment = {k: v for k, v in os.environ.items() if k != "LD_LIBRARY_PATH"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert "DriverError: opening Dev1/ao0, Dev1/ai0: Could not find an installation of NI-DAQmx" in done.stderr


def test_a_computer_without_the_package_is_told_what_to_install(driver, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "nidaqmx.errors", None)
    with pytest.raises(DriverError, match=r'pip install "truestroke\[nidaqmx\]"'):
        driver.open()


# ---- Settings and page --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"outputs": "Dev1/ao0"}, "outputs"),
        ({"outputs": []}, "outputs"),
        ({"inputs": ["Dev1/ai0", "Dev1/ai1"]}, "inputs"),
        ({"um_per_volt": 0.0}, "um_per_volt"),
        ({"um_per_volt": [10.0, 10.0]}, "um_per_volt"),
        ({"offset": float("nan")}, "offset"),
        ({"converter_rate": 9000.0}, "converter_rate"),
        ({"block": 512, "ahead": 2}, r"block - 1 \+ ahead \* block"),
        ({"output_range": [3.0, 3.0]}, "output_range"),
        ({"terminals": "balanced"}, "terminals"),
        ({"timeout": 0.0}, "timeout"),
    ],
)
def test_settings_are_checked(change: dict, argument: str) -> None:
    with pytest.raises(SettingError, match=f"^{argument} = "):
        NidaqmxSettings(**(STACK | change))


def toml() -> str:
    """The configuration that the page shows."""
    return re.search(r"^```toml\n(.*?)^```", (ROOT / "docs/nidaqmx.md").read_text(), flags=re.M | re.S)[1]


def test_the_page_runs_on_the_fake_card(card, tmp_path, monkeypatch) -> None:
    """Each python block, and what the text block behind it says; its configuration makes the driver."""
    page = (ROOT / "docs/nidaqmx.md").read_text()
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    blocks = re.findall(r"^```python\n(.*?)^```\n\nIt prints[^\n]*\n\n```text\n(.*?)^```", page, flags=re.M | re.S)
    assert len(blocks) == page.count("```python") == 1
    for code, printed in blocks:
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            exec(code, names)
        assert_prints(printed, output.getvalue(), tolerance=0.2)
    config = tomllib.loads(toml())
    assert config["driver"].pop("name") == "nidaqmx"
    driver = NidaqmxDriver(NidaqmxSettings(**config["driver"]))
    assert driver.open().channels == len(config["axis"])
    driver.close()


def commission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: tuple[str, str] = ("", "")) -> tuple[int, str]:
    monkeypatch.chdir(tmp_path)
    Path("stage.toml").write_text(toml().replace(*change))
    done = CliRunner().invoke(main, ["commission", "--config", "stage.toml", "--yes"])
    return done.exit_code, done.output


@pytest.mark.usefixtures("each_picture_once")
def test_the_first_volts_of_the_page(card, tmp_path, monkeypatch) -> None:
    expected = re.search(
        r"^\$ truestroke commission[^\n]*\n(.*?)^```", (ROOT / "docs/nidaqmx.md").read_text(), re.M | re.S
    )[1]
    code, printed = commission(tmp_path, monkeypatch)
    assert code == 0, printed
    assert_prints(expected, printed, tolerance=0.2)
    assert card.volts[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("um_per_volt = 10.0", "um_per_volt = -10.0"), "more voltage makes the displacement smaller"),
        (("um_per_volt = 10.0", "um_per_volt = 100.0"), "which allows 1.43 to 28.6: look at um_per_volt"),
        (("Dev1/ai0", "Dev1/ai1"), "no answer to steps"),
    ],
)
def test_wrong_wiring_is_found_by_the_first_volts(card, tmp_path, monkeypatch, change, words) -> None:
    code, printed = commission(tmp_path, monkeypatch, change)
    assert (code, card.volts[0]) == (3, pytest.approx(0.0, abs=1e-9)), printed
    assert words in " ".join(printed.split())


@pytest.mark.usefixtures("forked_helpers")
@pytest.mark.parametrize(
    ("fault", "code", "words"),
    [
        ("", 0, ""),
        (f"{READ}:150:nan", 0, ""),
        (f"{READ}:150:-200324", 12, "NI-DAQmx -200324"),
        (f"{READ}:150:-200284", 12, "NI-DAQmx -200284"),
        (f"{READ}:150:short", 12, "the card moved"),
        (f"{READ}:150:slip", 12, "lost edges"),
        (f"{WRITE}:150:-200290", 12, "this computer was late"),
        (f"{READ}:150:hang", -signal.SIGKILL, "killed"),
    ],
    ids=lambda value: str(value).replace(" ", "-") or "none",
)
def test_the_command_runs_the_configuration_of_the_page(card, tmp_path, monkeypatch, fault, code, words) -> None:
    text = toml().replace("safe_voltage = 0.0", f"safe_voltage = {SAFE[0]}") + "[realtime]\nwatchdog_timeout = 3.0\n"
    (tmp_path / "stage.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FAKE_NIDAQMX_FAULT", fault)
    if code in (0, 12) and fault:
        done = CliRunner().invoke(main, ["run", "--config", "stage.toml", "--json"])
        printed, returned = done.output, done.exit_code
    else:  # as a user runs it, and where its process is killed
        command = [COMMAND, "run", "--config", "stage.toml", "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        printed = process.communicate(timeout=60)[0].decode()  # the watchdog, too, has ended
        returned = process.returncode
    assert returned == code, printed
    assert words in printed
    assert (card.volts[0], card.resets) == (SAFE[0], 0)
    run = truestroke.Recording.load(tmp_path / "first.h5")
    error = run["measured"] - run["desired"]
    assert np.sqrt(np.nanmean(error[error.size // 2 :] ** 2)) < (0.1 if fault else 0.016)


def test_the_doctor_says_what_the_card_does_unattended(card, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(doctor, "examine", functools.partial(doctor.examine, probe=0.01))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FAKE_NIDAQMX_WATCHDOG", "1")
    for extra, level, words in (("", "warning", "holds its last"), ("card_watchdog = 1.0\n", "ok", "the card's own")):
        Path("stage.toml").write_text(toml().replace("terminals =", f"{extra}terminals ="))
        done = CliRunner().invoke(main, ["doctor", "--config", "stage.toml", "--json"])
        (found,) = [one for one in json.loads(done.stdout)["findings"] if one["what"] == "unattended"]
        assert (found["level"], words in found["found"]) == (level, True)
        assert (done.exit_code, card.volts[0]) == (0, 0.0)


def test_limits_beyond_the_range_of_the_card_are_refused_before_anything_moves(card, tmp_path) -> None:
    (tmp_path / "stage.toml").write_text(toml().replace("[-0.6, 3.6]", "[-0.6, 12.0]"))
    command = [COMMAND, "run", "--config", "stage.toml"]
    environment = os.environ | card.environment()
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "voltage_limits of axis x = 12.0 V: must be from -10 to 10 V" in done.stderr
    assert (card.volts[0], card.edges) == (0.0, 0)


@pytest.mark.usefixtures("each_picture_once")
@pytest.mark.parametrize("fault", ["", f"{READ}:450:-200279"])
def test_a_motion_is_learned_from_the_buffer(card, tmp_path, monkeypatch, fault) -> None:
    """Waveform, model and page; where a later pass fails, what was learned before it is on the disk."""
    monkeypatch.chdir(tmp_path)
    config = """
[driver]
name = "nidaqmx"
outputs = ["Dev1/ao0"]
inputs = ["Dev1/ai0"]
um_per_volt = 10.0
[[axis]]
stroke = 35.0
voltage_limits = [-0.6, 3.6]
slew = 2000.0
safe_voltage = 0.25
"""
    Path("learn.toml").write_text(config)
    if fault:
        monkeypatch.setenv("FAKE_NIDAQMX_FAULT", fault)
    words = "learn sine --frequency 20 --peak-to-peak 10 --offset 12 --bandwidth 150 --averaged 0.2 --passes 3"
    done = CliRunner().invoke(main, [*words.split(), "--config", "learn.toml", "--json"])
    assert card.volts[0] == SAFE[0]
    if fault:
        assert done.exit_code == 12
        assert "learned.csv has the best waveform so far" in done.stderr
        assert truestroke.load_waveform("learned.csv").volts.size == 100
        return
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    errors = [one["rmse_um"] for one in found["passes"]]
    assert errors[-1] < 0.1 * errors[0]
    assert truestroke.load_model(found["model"]).weights[0] > 0
