"""The driver for controllers of PI, through the unmodified PIPython, against the fake of tests/fakes/gcs.py."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import platform
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from click.testing import CliRunner
from forked import ForkedCommand, ran
from running import COMMAND, until
from test_docs import assert_prints

import truestroke
from truestroke import SettingError, plant, trajectories
from truestroke.cli import main
from truestroke.runtime.drivers import DriverError, connected, playback
from truestroke.runtime.drivers.pi import PiDriver, PiSettings
from truestroke.signals.timing import Timing

if TYPE_CHECKING:
    from controller import Fake

pytest_plugins = ["controller"]

ROOT = Path(__file__).parents[1]
SAFE = np.array([2.5])  # V
GAIN = plant.PlantSettings().amplifier_gain  # piezo volts over the plant's


def made(fake: Fake, **change: object) -> PiDriver:
    settings = {"host": "127.0.0.1", "port": fake.port, "output_range": (-20.0, 120.0), "timeout": 0.4}
    settings |= {"sample_rate": 10.0} | change  # 10 Hz: whatever else this machine does
    return PiDriver(PiSettings(**settings))


@pytest.fixture(autouse=True)
def _look_at_the_interpreter_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """PIPython starts `file` on it for its log at each connection: four hundred processes of this file."""
    monkeypatch.setattr(platform, "architecture", lambda *_: ("64bit", "ELF"))


@pytest.fixture
def driver(fake: Fake):
    driver = made(fake)
    yield driver
    driver.close()


def offline(volts: np.ndarray, **settings: object) -> np.ndarray:
    """The stack without noise, from rest; piezo volts."""
    quiet = plant.PlantSettings(**settings).without("noise", "ad_quantisation")
    return plant.RealisticPlant(quiet).exchange(volts / GAIN)


def wave(duration: float = 1.0, rate: float = 2000.0) -> np.ndarray:
    """From 0 V to 80 V and back, at rest on both ends; V."""
    t = np.arange(round(duration * rate)) / rate
    return 40.0 * (1 - np.cos(2 * np.pi * t / duration)) * np.sin(2 * np.pi * 3 * t) ** 2


def assert_safe(driver: PiDriver, fake: Fake) -> None:
    """Stop, twice, is what a voltmeter reads; no connection is left."""
    for _ in range(2):
        driver.stop(SAFE)
        assert fake.volts[0] == pytest.approx(SAFE[0])
    driver.close()
    assert fake.left()


# ---- A wave is played and recorded --------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "samples"), [(2000.0, 5), (2000.0, 1), (1000.0, 2), (10_000.0, 1)])
def test_each_displacement_belongs_to_its_voltage(fake: Fake, rate: float, samples: int) -> None:
    driver = made(fake, samples_per_tick=samples)
    assert driver.open() == Timing(sample_rate=10.0, block=1, latency=1)
    volts = np.repeat(np.random.default_rng(1).uniform(0.0, 100.0, 100), 20)
    recorded = driver.playback(volts[None, :], rate)
    assert (recorded.sample_rate, fake.volts[0]) == (rate, pytest.approx(volts[-1], abs=1e-6))
    assert np.abs(recorded.volts[0] - volts).max() < 1e-5
    per = round(10_000 / rate)
    fine = offline(np.repeat(volts, per), sample_rate=10_000.0, samples_per_tick=1, steps_per_tick=2)
    true = fine.reshape(-1, samples, per // samples)[:, :, 0 if per == samples else -1].mean(1)
    shifts = [np.std(recorded.displacement[0, 1:-1] - np.roll(true, k)[1:-1]) for k in (-1, 0, 1)]
    assert np.argmin(shifts) == 1
    if per == samples:
        assert shifts[1] == pytest.approx(0.030 / np.sqrt(samples), rel=0.1)  # the sensor's noise, and nothing else
    assert_safe(driver, fake)


def test_axes_do_not_mix_and_each_has_its_scale(fake: Fake) -> None:
    fake.make(axes=["A", "B"], factor=10.0)
    driver = made(fake, axes=["B", "A"], outputs=[2, 1], volts_per_unit=10.0, um_per_unit=-1.0, offset=5.0)
    assert driver.open().channels == 2
    volts = np.stack([wave(), 0.5 * wave()])
    recorded = driver.playback(volts, 2000.0)
    assert np.abs(recorded.volts - volts).max() < 1e-4
    for x, z in zip(volts, recorded.displacement, strict=True):
        assert np.sqrt(np.mean((z - (5.0 - offline(x))) ** 2)) < 0.02
    driver.stop(np.array([30.0, 10.0]))
    assert fake.volts == pytest.approx([10.0, 30.0])
    driver.start(np.array([40.0, 20.0]))
    assert fake.volts == pytest.approx([20.0, 40.0])
    driver.close()


def test_limits_may_be_parameters_of_the_controller(fake: Fake) -> None:
    parameters = (0x0C000000, 0x0C000001)
    assert made(fake, limit_parameters=parameters).open().channels == 1
    fake.make(limits=[-20.0, 119.9])
    with pytest.raises(DriverError, match=r"limits output 1 to -20 to 119\.9 V"):
        made(fake, limit_parameters=parameters).open()


@pytest.mark.parametrize(("points", "samples"), [(8 * 10_100, 5), (8 * 2100, 1)])
def test_a_small_recorder_takes_fewer_samples(fake: Fake, points: int, samples: int) -> None:
    fake.make(points=points)
    driver = made(fake)
    driver.open()
    volts = np.full((1, 2000), 20.0)
    volts[0, 0] = 19.0
    noise = np.diff(driver.playback(volts, 2000.0).displacement[0, 1000:]).std() / np.sqrt(2)
    assert noise == pytest.approx(0.030 / np.sqrt(samples), rel=0.15)
    with pytest.raises(
        DriverError, match=r"the recorder holds \d+ samples of each source, so .* and the wave has 15 s"
    ):
        driver.playback(np.zeros((1, 30_000)), 2000.0)
    assert_safe(driver, fake)


def test_ramps_lead_to_the_wave_and_back(fake: Fake) -> None:
    volts = 30.0 + wave()
    limits = {"voltage_limits": (-20.0, 120.0), "slew": 5000.0, "safe_voltage": 5.0}
    driver = made(fake)
    driver.stop(np.array([5.0]))
    recorded = playback(driver, volts, 2000.0, **limits, rest=0.1)
    assert np.abs(recorded.volts[0] - volts).max() < 1e-5
    assert fake.volts[0] == 5.0
    assert fake.left()
    assert fake.step < max(np.abs(np.diff(volts)).max(), 500.0 / 2000.0, 5.0) + 1e-5  # 5 V: the first stop
    with pytest.raises(SettingError, match=r"^volts = .*from -20 to 100 V"):
        playback(driver, volts, 2000.0, **limits | {"voltage_limits": (-20.0, 100.0)})


def test_two_axes_play_at_once_each_from_and_to_its_safe_voltage(fake: Fake) -> None:
    volts = np.stack([30.0 + wave(), 0.25 * wave()])
    limits = {"voltage_limits": (-20.0, 120.0), "slew": 5000.0, "safe_voltage": 5.0}
    driver = made(fake, axes=["1", "2"])
    driver.stop(np.array([5.0, 5.0]))
    recorded = playback(driver, volts, 2000.0, **limits, rest=0.1)
    assert np.abs(recorded.volts - volts).max() < 1e-5
    assert (fake.volts, fake.left()) == ([5.0, 5.0], True)
    assert fake.step < max(np.abs(np.diff(volts)).max(), 500.0 / 2000.0, 5.0) + 1e-5  # 5 V: the first stop
    with pytest.raises(SettingError, match=r"^channels of the driver = 2: must be as many as waveforms, 1"):
        playback(driver, volts[0], 2000.0, **limits)
    assert fake.volts == [5.0, 5.0]
    with pytest.raises(SettingError, match=r"^volts = .* must be an array of numbers, rows of one length"):
        playback(driver, [volts[0], volts[1][:-1]], 2000.0, **limits)
    with pytest.raises(SettingError, match=r"^volts = waveforms of 2 channels: must be one"):
        playback(Card(), volts, 2000.0, voltage_limits=(-20.0, 120.0), slew=5000.0)


class Card:
    """Hardware without `playback`: blocks of 20, a latency of 40."""

    def describe(self) -> dict[str, object]:
        return {"output_range": (-100.0, 200.0)}

    def open(self) -> Timing:
        self.stack, self.waiting, self.safe = plant.RealisticPlant(seed=3), np.zeros(40), []
        return Timing(sample_rate=2000.0, block=20, latency=40, hardware_timed=True)

    def start(self, volts: np.ndarray) -> None:
        self.waiting[:] = volts

    def exchange(self, volts: np.ndarray, measured: np.ndarray) -> None:
        self.waiting = np.append(self.waiting, volts / GAIN)
        measured[0] = self.stack.exchange(self.waiting[:20])
        self.waiting = self.waiting[20:]

    def stop(self, volts: np.ndarray) -> None:
        self.safe.append(volts.tolist())

    def close(self) -> None:
        self.safe.append("closed")


def test_hardware_without_playback_takes_block_by_block() -> None:
    card, volts = Card(), wave()[:1999]
    recorded = playback(card, volts, 2000.0, voltage_limits=(-20.0, 120.0), slew=5000.0)
    assert np.std(recorded.displacement[0] - offline(volts)) < 0.02
    assert card.safe == [[0.0], "closed"]
    with pytest.raises(
        SettingError, match=r"sample_rate of the waveform = 1000.0 Hz: must be that of the driver, 2000 Hz"
    ):
        playback(card, volts, 1000.0, voltage_limits=(-20.0, 120.0), slew=5000.0)
    assert card.safe == [[0.0], "closed"]


def test_one_set_point_a_tick(fake: Fake) -> None:
    driver = made(fake)
    driver.open()
    driver.start(np.zeros(1))
    volts = np.random.default_rng(2).uniform(0.0, 100.0, 200)
    measured = np.empty((1, 200))
    for k, x in enumerate(volts):
        driver.exchange(np.array([[x]]), measured[:, k : k + 1])
    fine = offline(np.repeat(volts, 5), sample_rate=10_000.0, samples_per_tick=1, steps_per_tick=2)
    assert np.std(measured[0, 1:] - fine[4::5][:-1]) == pytest.approx(0.030, rel=0.2)
    assert_safe(driver, fake)


# ---- What goes wrong ----------------------------------------------------------------------------------------------

BROKEN = [
    ("SVA:1:7", r"exchanging 127.0.0.1: GCS 7: .*limits"),
    ("SVA:1:5", r"GCS 5: .*servo"),
    ("SVA:1:drop", r"exchanging 127.0.0.1: .*(closed the connection|reset|Broken pipe)"),
    ("POS?:>25:drop", r"closed the connection"),
    ("POS?:26:late", r"GCS -7: .*no answer in time"),
    ("POS?:>25:silent", r"GCS -7"),
    ("POS?:26:garbage", r"answer cannot be read"),
    ("POS?:>25:1", r"GCS -7"),
]


def several(driver: PiDriver) -> None:
    for _ in range(10):
        driver.exchange(np.array([[20.0]]), np.empty((1, 1)))


@pytest.mark.parametrize(("fault", "message"), BROKEN, ids=[f for f, _ in BROKEN])
def test_a_fault_is_named_and_the_safe_voltage_is_reached(fake: Fake, fault: str, message: str) -> None:
    fake.make(fault=fault)
    driver = made(fake)
    driver.open()
    driver.start(np.array([10.0]))
    assert fake.volts[0] == 10.0
    with pytest.raises(DriverError, match=message):
        several(driver)
    with pytest.raises(DriverError, match="the driver is failed"):
        driver.exchange(np.array([[20.0]]), np.empty((1, 1)))
    assert_safe(driver, fake)


PLAYS_BADLY = [
    ("WAV:3:67", r"playing 127.0.0.1: GCS 67: .*longer than the controller's memory"),
    ("WAV:3:drop", r"closed the connection|reset|Broken pipe"),
    ("WTR:0:2", r"GCS 2: .*does not know the command"),
    ("WGO:0:75", r"GCS 75"),
    ("#9:0:silent", r"GCS -7"),
    ("DRL?:0:1", r"GCS -7"),
    ("DRR?:0:17", r"playing 127.0.0.1: .*(GCS 17|GCS -7)"),
    ("DRR?:0:drop", r"closed the connection"),
    ("ROWS:0:short", r"GCS -1088: .*fewer points came"),
    ("VOLTS:0:clip", r"differs from the wave by .* V rms.*volts_per_unit"),
]


def test_no_signal_interrupts_the_way_to_the_safe_voltage() -> None:
    class Impatient:
        left: tuple[str, ...] = ()

        def open(self) -> Timing:
            return Timing(sample_rate=2000.0)

        def describe(self) -> dict[str, object]:
            return {}

        def start(self, volts: np.ndarray) -> None:
            raise DriverError("no network")

        def exchange(self, volts: np.ndarray, measured: np.ndarray) -> None:
            """Never called."""

        def stop(self, volts: np.ndarray) -> None:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.raise_signal(number)
            self.left = ("stopped",)

        def close(self) -> None:
            self.left += ("closed",)

    driver = Impatient()
    with pytest.raises(DriverError, match="no network"):
        playback(driver, [0.0, 0.1], 2000.0, voltage_limits=(0.0, 10.0), slew=1000.0)
    assert driver.left == ("stopped", "closed")


def test_a_waveform_faster_than_slew_is_refused_before_anything_moves() -> None:
    with pytest.raises(SettingError, match=r"waveform of 200 V/s: must be no faster than slew, 100 V/s"):
        playback(None, [0.0, 0.1], 2000.0, voltage_limits=(0.0, 10.0), slew=100.0)  # no driver is touched


@pytest.mark.parametrize(("fault", "message"), PLAYS_BADLY, ids=[f for f, _ in PLAYS_BADLY])
def test_a_wave_that_fails_ends_at_the_safe_voltage(fake: Fake, fault: str, message: str) -> None:
    fake.make(fault=fault)
    driver = made(fake)
    with pytest.raises(DriverError, match=message):
        playback(driver, wave(), 2000.0, voltage_limits=(-20.0, 120.0), slew=5000.0, safe_voltage=SAFE[0])
    assert fake.volts[0] == SAFE[0]
    assert_safe(driver, fake)


def test_samples_without_signal_are_nan(fake: Fake) -> None:
    fake.make(fault="NAN:0:nan")
    driver = made(fake)
    driver.open()
    z = driver.playback(wave()[None, :], 2000.0).displacement[0]
    assert np.flatnonzero(np.isnan(z)).tolist() in ([79, 80, 81], [80, 81])
    assert_safe(driver, fake)


def test_a_wave_is_stopped_where_it_is(fake: Fake) -> None:
    fake.make(realtime=True, fault="#9:>2:silent")
    driver = made(fake)
    driver.open()
    with pytest.raises(DriverError, match="GCS -7"):
        driver.playback(np.linspace(20.0, 60.0, 8000)[None, :], 2000.0)  # for 4 s
    assert 20.0 < fake.volts[0] < 40.0
    before = fake.volts[0]
    time.sleep(0.1)
    assert fake.volts[0] > before  # it goes on, although nobody is there
    assert_safe(driver, fake)
    time.sleep(0.1)
    assert fake.volts[0] == SAFE[0]


@pytest.mark.parametrize(
    ("volts", "rate", "message"),
    [
        (np.full((1, 9), 120.1), 2000.0, r"^volts = 120.1 V: must be from -20 to 120 V"),
        (np.full((1, 9), np.nan), 2000.0, r"^volts\[0\] = nan V"),
        (np.zeros((2, 9)), 2000.0, r"^volts = array of shape \(2, 9\)"),
        (
            np.zeros((1, 9)),
            3000.0,
            r"^sample_rate = 3000.0 Hz: must be 10000 Hz over a whole number, such as 3333.33 Hz",
        ),
        (np.zeros((1, 9)), 30_000.0, r"^sample_rate = 30000.0 Hz: .* such as 10000 Hz"),
    ],
)
def test_a_wave_that_cannot_be_is_refused_before_it_moves(driver, fake, volts, rate, message) -> None:
    driver.open()
    with pytest.raises(SettingError, match=message):
        driver.playback(volts, rate)
    assert fake.step == 0.0
    driver.playback(np.zeros((1, 9)), 2000.0)  # the driver still works


@pytest.mark.parametrize("volts", [np.nan, 121.0])
def test_a_set_point_that_cannot_be_does_not_reach_the_controller(driver, fake, volts) -> None:
    driver.open()
    driver.start(np.zeros(1))
    with pytest.raises(DriverError, match=r"not finite|outside of output_range"):
        driver.exchange(np.array([[volts]]), np.empty((1, 1)))
    assert fake.step == 0.0
    assert_safe(driver, fake)


# ---- Open, start, stop --------------------------------------------------------------------------------------------


def test_opening_leaves_the_output_where_it_is(driver: PiDriver, fake: Fake) -> None:
    fake.make(volts=[33.0, 0.0])
    driver.open()
    assert (fake.volts[0], fake.step) == (33.0, 0.0)
    with pytest.raises(DriverError, match="the driver is open; call start first"):
        several(driver)


@pytest.mark.parametrize(
    ("controller", "settings", "message"),
    [
        ({"axes": ["1"]}, {"axes": ["1", "2"]}, r"opening 127.0.0.1: there is no axis 2; there are 1$"),
        ({"servo": [True, False]}, {}, r"the servo of axis 1 is on; switch it off \(SVO 1 0\)"),
        ({"limits": [-30.0, 130.0]}, {}, r"limits output 1 to -30 to 130 V, the settings have output_range = \(-20"),
        ({"fault": "VMI?:0:2"}, {}, r"asking VMI\? and VMA\?, else see limit_parameters: GCS -7"),
        ({"connections": 0}, {}, r"closed the connection; does it accept one more|reset"),
        ({"syntax": 3.0}, {}, r"speaks GCS 3, the driver GCS 2"),
        ({"fault": "CSV?:0:drop"}, {}, r"closed the connection"),
    ],
)
def test_what_does_not_fit_is_said_at_open(fake: Fake, controller: dict, settings: dict, message: str) -> None:
    fake.make(**controller)
    driver = made(fake, **settings)
    with pytest.raises(DriverError, match=message):
        driver.open()
    assert fake.step == 0.0
    driver.close()


def test_a_controller_that_is_not_there_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    driver = PiDriver(PiSettings(host="127.0.0.1", port=port, output_range=(0.0, 1.0), timeout=0.1))
    for call in (driver.open, lambda: driver.stop(np.zeros(1))):
        with pytest.raises(DriverError, match=r"127.0.0.1.*Connection refused"):
            call()


def test_a_connection_that_is_too_slow_for_the_rate_is_refused(fake: Fake) -> None:
    fake.make(delay=0.002)
    driver = made(fake, sample_rate=200.0)
    driver.open()
    with pytest.raises(DriverError, match=r"sample_rate = 200 Hz: .* take [0-9.]+ ms here, so at most [0-9.]+ Hz"):
        driver.start(np.array([10.0]))
    assert fake.step == 0.0
    assert_safe(driver, fake)


def test_stop_works_from_any_state_and_the_driver_starts_again(driver: PiDriver, fake: Fake) -> None:
    assert_safe(driver, fake)
    driver.open()
    assert_safe(driver, fake)
    driver.open()
    driver.start(np.array([50.0]))
    driver.stop(SAFE)
    driver.start(np.array([50.0]))
    driver.playback(wave()[None, :], 2000.0)
    assert_safe(driver, fake)
    fake.make(servo=[True, False])
    assert_safe(driver, fake)  # stop switches it off


@pytest.mark.parametrize("fault", ["#24:*:2", "SVO:*:2"])
def test_what_a_controller_does_not_know_does_not_keep_it_from_the_safe_voltage(fake: Fake, fault: str) -> None:
    fake.make(fault=fault, volts=[50.0, 0.0])
    assert_safe(made(fake), fake)


def test_stop_says_so_when_the_controller_refuses(fake: Fake) -> None:
    fake.make(fault="SVA:*:7")
    driver = made(fake, timeout=0.05)
    with pytest.raises(DriverError, match=r"holding 127.0.0.1 at \[2.5\] V: GCS 7"):
        driver.stop(SAFE)


# ---- Another process ----------------------------------------------------------------------------------------------

HANGS = """
import sys, time
import numpy as np
from truestroke.runtime.drivers import pi
from truestroke.runtime.drivers.pi import PiDriver, PiSettings
driver = PiDriver(PiSettings(host="127.0.0.1", port=int(sys.argv[1]), output_range=(-20.0, 120.0)))
driver.open()
driver.playback(np.linspace(20.0, 100.0, 60_000)[None, :], 2000.0)
"""


@pytest.mark.parametrize("connections", [8, 1])
def test_rescue_stops_the_wave_of_a_process_that_is_gone(fake: Fake, connections: int) -> None:
    fake.make(realtime=True, connections=connections, points=2**21)
    rescue = pickle.loads(pickle.dumps(made(fake).rescue()))
    child = subprocess.Popen([sys.executable, "-c", HANGS, str(fake.port)])
    try:
        until(lambda: fake.volts[0] >= 20.0, process=child)
        if connections == 1:  # a watchdog kills first
            child.send_signal(signal.SIGKILL)
            child.wait()
        assert 20.0 <= fake.volts[0] < 60.0
        rescue(SAFE)
        time.sleep(0.1)
        assert fake.volts[0] == SAFE[0]
    finally:
        child.kill()
        child.wait()


PLAYS = """
import sys
import numpy as np
from truestroke.runtime.drivers import playback
from truestroke.runtime.drivers import pi
from truestroke.runtime.drivers.pi import PiDriver, PiSettings
driver = PiDriver(PiSettings(host="127.0.0.1", port=int(sys.argv[1]), output_range=(-20.0, 120.0)))
wave = np.linspace(20.0, 60.0, 6000)
playback(driver, wave, 2000.0, voltage_limits=(-20.0, 120.0), slew=2e3, safe_voltage=2.5, rest=0.1)
"""


def test_a_wave_whose_every_process_is_killed_ends_at_the_safe_voltage_by_itself(fake: Fake) -> None:
    """Its last value is the safe voltage: the controller needs nobody to come to it."""
    fake.make(realtime=True)
    child = subprocess.Popen([sys.executable, "-c", PLAYS, str(fake.port)])
    until(lambda: fake.volts[0] >= 20.0, process=child)
    child.kill()
    child.wait()
    assert 20.0 <= fake.volts[0] <= 60.0
    until(lambda: fake.volts[0] == SAFE[0])


def test_a_computer_without_the_package_is_told_what_to_install(driver, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pipython", None)
    with pytest.raises(DriverError, match=r'pip install "truestroke\[pi\]"'):
        driver.open()


# ---- Settings and page --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"axes": "1"}, "axes"),
        ({"axes": ["1", "1"]}, "axes"),
        ({"outputs": [1, 2]}, "outputs"),
        ({"output_range": [3.0, 3.0]}, "output_range"),
        ({"um_per_unit": 0.0}, "um_per_unit"),
        ({"volts_per_unit": 0.0}, "volts_per_unit"),
        ({"offset": float("nan")}, "offset"),
        ({"sample_rate": 0.0}, "sample_rate"),
        ({"port": 0}, "port"),
        ({"timeout": 0.0}, "timeout"),
        ({"points_per_command": 0}, "points_per_command"),
    ],
)
def test_settings_are_checked(change: dict, argument: str) -> None:
    with pytest.raises(SettingError, match=f"^{argument} = "):
        PiSettings(**({"host": "x", "output_range": (0.0, 1.0)} | change))


def page_blocks(fake: Fake) -> list[tuple[str, str]]:
    """The page's python, console and toml blocks, with the text behind a python block, for the fake's address."""
    page = (ROOT / "docs/pi.md").read_text().replace("192.168.0.5", "127.0.0.1").replace("50000", str(fake.port))
    return re.findall(r"^```(python|console|toml|text)\n(.*?)^```", page, flags=re.M | re.S)


@pytest.mark.usefixtures("each_picture_once", "no_waiting")
def test_the_page_runs_on_the_fake_controller(fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each block in turn: the file, python and what it prints, the commands and what they print."""
    monkeypatch.chdir(tmp_path)
    names, printed, tables = {}, "", []
    for kind, text in page_blocks(fake):
        if kind == "toml":
            Path("stage.toml").write_text(text)
        elif kind == "text":
            assert_prints(text, printed, tolerance=0.15)
        elif kind == "python":
            output = io.StringIO()
            with contextlib.redirect_stdout(output):
                exec(text, names)
            printed = output.getvalue()
            tables += [printed] if printed.startswith("pass") else []
        else:
            for command, expected in re.findall(r"^\$ truestroke (.*)\n((?:(?!\$ ).*\n?)*)", text, flags=re.M):
                done = CliRunner().invoke(main, shlex.split(command))
                assert done.exit_code == 0, done.output
                assert_prints(expected, done.output, tolerance=0.05)
    for table in tables:
        errors = [float(line.split()[1]) for line in table.splitlines()[1:]]
        assert errors[-1] < 0.05 * errors[0]
    assert len(tables) == 2
    assert (fake.volts, fake.left()) == ([0.0, 0.0], True)


@pytest.fixture
def bench(fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's configuration, and a wave of 2 s that begins and ends at 20 V."""
    monkeypatch.chdir(tmp_path)
    config = next(text for kind, text in page_blocks(fake) if kind == "toml")
    Path("stage.toml").write_text(config.replace("safe_voltage = 0.0 ", f"safe_voltage = {SAFE[0]}"))
    rows = np.column_stack([np.arange(4000) / 2000.0, 20.0 + np.abs(wave(2.0))])
    np.savetxt("wave.csv", rows, delimiter=",", header="time (s),volts (V)", comments="")
    return tmp_path


RUN = """
[axis.trajectory]
kind = "random_wave"
sample_rate = {rate}
cutoff = {cutoff}
peak_to_peak = 10.0
duration = {duration}
[realtime]
watchdog_timeout = {timeout}
[recording]
file = "run.h5"
"""


def run_in_time(fake: Fake, ticks: int, fault: str = "") -> tuple[float, subprocess.CompletedProcess[str]]:
    """`truestroke run` at 50 Hz, or slower where the machine is so busy that the driver says that it cannot."""
    stage = Path("stage.toml").read_text()
    for rate in (50.0, 20.0, 10.0):
        Path("run.h5").unlink(missing_ok=True)
        fake.make(realtime=True, fault=fault)
        config = stage.replace("[[axis]]", f"sample_rate = {rate}\n[[axis]]\nstroke = 40.0")
        timeout = 0.4 if "silent" in fault else 9.0  # the driver itself gives up after 2 s
        Path("run.toml").write_text(
            config + RUN.format(rate=rate, cutoff=rate / 50, duration=ticks / rate, timeout=timeout)
        )
        command = [COMMAND, "run", "--config", "run.toml", "--json"]
        done = ran(command, timeout=120)
        if "so at most" not in done.stderr:
            break
    return rate, done


@pytest.mark.parametrize(
    ("fault", "code"),
    [("", 0), ("POS?:60:drop", 12), ("POS?:60:silent", -signal.SIGKILL), ("SVA:40:7", 12), ("POS?:60:nan", 0)],
)
def test_the_loop_runs_sample_by_sample(bench: Path, fake: Fake, fault: str, code: int) -> None:
    _, done = run_in_time(fake, 50, fault)
    assert (done.returncode, fake.volts[0], fake.left()) == (code, SAFE[0], True), done.stderr


class Offline:
    """The fake's stack in no time: the position at the end of the tick before."""

    def __init__(self, rate: float) -> None:
        self.rate = rate

    def open(self) -> Timing:
        cycles = plant.PlantSettings(sample_rate=10_000.0, samples_per_tick=1, steps_per_tick=2)  # servo cycles
        self.stack = plant.RealisticPlant(cycles, seed=0)
        self.stack.open()
        self.z = self.stack.exchange(np.zeros(1))[-1]
        return Timing(sample_rate=self.rate, latency=1)

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        before = self.z
        self.z = self.stack.exchange(np.full(round(10_000 / self.rate), volts[0] / GAIN))[-1]
        return np.array([before])


def test_the_loop_is_as_accurate_as_offline(bench: Path, fake: Fake) -> None:
    """0.031 um both, of 10 um; a busy machine, whose ticks are late by ms, may add as much."""
    rate, done = run_in_time(fake, 200)
    assert done.returncode == 0, done.stderr
    real = truestroke.Recording.load("run.h5")
    wave = trajectories.random_wave(sample_rate=rate, cutoff=rate / 50, peak_to_peak=10.0, duration=200 / rate)
    limits = {"voltage_limits": (-20.0, 120.0), "slew_limit": 20000.0}
    controller = truestroke.AdaptiveController(sample_rate=rate, stroke=40.0, **limits)
    offline = truestroke.run(wave, controller, Offline(rate))
    rmse = [np.sqrt(np.nanmean((run["measured"] - run["desired"])[100:-1] ** 2)) for run in (real, offline)]
    assert rmse[0] < 2 * rmse[1]
    assert rmse[1] < 0.1


# ---- The command --------------------------------------------------------------------------------------------------


def typed(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["playback", *arguments])
    return done.exit_code, done.output


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (("[[axis]]", "[axis]"), (), "stage.toml: axis = a table: must be a list of tables: [[axis]]"),
        (("slew", "slow"), (), "axis.slow = 20000.0: must be left out; did you mean slew?"),
        (('"pi"', '"pie"'), (), "driver.name = 'pie': must be one of "),
        (("port", "porter"), (), "driver.porter = "),
        (("[driver]", "[driver"), (), "stage.toml: line 1 = '[driver': must be TOML"),
        (
            ("voltage_limits = [-20.0, 120.0]", "voltage_limits = [-20.0, 30.0]"),
            (),
            "within voltage_limits, from -20 to 30 V: make it for these (`truestroke invert --voltage-limits -20 30`)",
        ),
        (("slew = 20000.0", "slew = 12.0"), (), "wave.csv: volts = waveform of "),
        (
            ("slew = 20000.0", "slew = 12.0"),
            (),
            "no faster than slew, 12 V/s: make it for that (`truestroke invert --slew 12`)",
        ),
        (("output_range = [-20.0, 120.0]", "output_range = [-30.0, 120.0]"), (), "the controller limits output 1"),
        (("", ""), ("--output", "record.h5"), "a file .csv"),
    ],
)
def test_the_command_says_what_is_wrong(bench, fake, change, arguments, message) -> None:
    Path("stage.toml").write_text(Path("stage.toml").read_text().replace(*change))
    code, output = typed("wave.csv", "--config", "stage.toml", *arguments)
    assert (code in (1, 2, 12), message in output, fake.volts[0] in (0.0, SAFE[0])) == (True, True, True), output
    assert not Path("record.csv").exists()


def test_a_waveform_that_is_none_is_refused(bench) -> None:
    for rows, message in (
        ("t,z\n0,1\n1,2\n", "which column is volts? Head it volts (V); there are"),
        ("t,volts\n0,1\n1,2\n", "which column is time? Head it time (s); there are"),
        ("time,volts\n0,1\n1,1\n5,1\n", "as even times are"),
    ):
        Path("wave.csv").write_text(rows)
        code, output = typed("wave.csv", "--config", "stage.toml")
        assert (code, message in output) == (1, True), output


@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_stops_the_wave_and_the_output_is_safe(bench, fake, stop, code) -> None:
    fake.make(realtime=True)
    command = [COMMAND, "play", "wave.csv", "--config", "stage.toml"]
    running = ForkedCommand(command, stderr=subprocess.PIPE)
    until(lambda: fake.volts[0] >= 20.0, process=running)
    running.send_signal(stop)
    _, words = running.communicate(timeout=30)
    assert (running.returncode, fake.volts[0], fake.left()) == (code, SAFE[0], True), words


@pytest.mark.usefixtures("each_picture_once", "no_waiting")
@pytest.mark.parametrize(("change", "code"), [(("", ""), 0), (("[[axis]]", "um_per_unit = -1.0\n[[axis]]"), 3)])
def test_the_first_volts(bench: Path, fake: Fake, monkeypatch: pytest.MonkeyPatch, change, code: int) -> None:
    monkeypatch.setattr(connected, "require_time", lambda *_: None)  # late ticks do not matter to it
    text = Path("stage.toml").read_text().replace("[[axis]]", "sample_rate = 200.0\n[[axis]]").replace(*change)
    Path("stage.toml").write_text(text)
    done = CliRunner().invoke(main, ["commission", "--config", "stage.toml", "--yes", "--json"])
    assert (done.exit_code, fake.volts[0], fake.left()) == (code, SAFE[0], True), done.output
    printed = json.loads(done.stdout)
    if code == 0:
        assert printed["gain_um_per_V"] == pytest.approx(0.273, rel=0.1)
        assert printed["resonance_Hz"] is None
        assert 35.0 < printed["written"]["axis.stroke"] < 50.0
    else:
        assert "turn the sign" in printed["reasons"][0]


LEARN = ["learn", "sine", "--frequency", "12", "--peak-to-peak", "10", "--offset", "12", "--bandwidth", "150"]
LEARN += ["--averaged", "0.2", "--config", "learn.toml", "--json"]


@pytest.mark.usefixtures("each_picture_once")
def test_a_motion_is_learned_from_the_wave_table(bench: Path, fake: Fake) -> None:
    """Waveform, model and page; a record that is cut short keeps what was learned before on the disk."""
    stage = Path("stage.toml").read_text()
    Path("learn.toml").write_text(stage.replace("[[axis]]", "sample_rate = 2000.0\n[[axis]]\nstroke = 40.0"))
    done = CliRunner().invoke(main, [*LEARN, "--passes", "4"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    errors = [one["rmse_um"] for one in found["passes"]]
    assert errors[-1] < 0.1 * errors[0]
    assert max(errors[1:]) < errors[0]
    assert truestroke.load_waveform(found["waveform"]).volts.size == found["samples"]
    assert truestroke.load_model(found["model"]).weights[0] > 0
    assert (fake.volts[0], fake.left()) == (SAFE[0], True)


@pytest.mark.parametrize(("fault", "words"), [("ROWS:2:short", "fewer points came"), ("WGO:4:drop", "onnection")])
def test_a_later_pass_that_fails_keeps_the_best_waveform(bench: Path, fake: Fake, fault: str, words: str) -> None:
    stage = Path("stage.toml").read_text()
    Path("learn.toml").write_text(stage.replace("[[axis]]", "sample_rate = 2000.0\n[[axis]]\nstroke = 40.0"))
    fake.make(fault=fault)
    done = CliRunner().invoke(main, [*LEARN, "--passes", "6"])
    assert (done.exit_code, done.stderr.count("\n")) == (12, 1)
    assert words in done.stderr
    assert "learned.csv has the best waveform so far, of pass" in done.stderr
    assert truestroke.load_waveform("learned.csv").volts.size > 100
    assert fake.volts[0] == SAFE[0]
