"""Guard, clock, the simulated driver and one axis of hardware in the loop."""

from __future__ import annotations

import gc
import math
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truestroke import AdaptiveController, RunInterrupted, SettingError, Timing, run
from truestroke.base import toml
from truestroke.plant import RealisticPlant, StagePlant, StageSettings
from truestroke.runtime.drivers import (
    DriverError,
    Fault,
    OneAxis,
    SimulatedDriver,
    SimulatedSettings,
    SingleChannel,
    playback,
)
from truestroke.runtime.drivers.guard import Guard
from truestroke.runtime.drivers.paced import Clock
from truestroke.runtime.drivers.playback import Recorded
from truestroke.signals.trajectories import random_wave

LIMITS, SLEW = (-0.6, 3.6), 400.0
AXIS = {"voltage_limits": LIMITS, "slew": SLEW}


def controller() -> AdaptiveController:
    return AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=LIMITS, slew_limit=SLEW)


anything = st.one_of(st.floats(-10, 10), st.floats(allow_nan=True, allow_infinity=True))


@given(
    asked=st.lists(st.lists(anything, min_size=3, max_size=3), min_size=1, max_size=30),
    slew=st.floats(1.0, 1e5),
    safe=st.floats(-0.6, 3.6),
)
def test_whatever_is_asked_for_limits_and_slew_hold_to_the_end_of_a_soft_stop(
    asked: list[list[float]], slew: float, safe: float
) -> None:
    guard = Guard(2000.0, [LIMITS], [slew], [safe])
    left = [safe]
    for block in asked:
        volts = np.array([block])
        assert guard(volts) == (not np.isnan(block).any())
        left += volts[0].tolist()
    ramp = guard.ramp([safe])
    assert guard(ramp.copy())
    left += [*ramp[0].tolist(), safe]
    assert min(left) >= -0.6
    assert max(left) <= 3.6
    assert np.abs(np.diff(left)).max() <= slew / 2000.0 * (1 + 1e-6) + 1e-12


def test_a_soft_stop_takes_no_longer_than_slew_asks_for() -> None:
    guard = Guard(1000.0, [(-10.0, 10.0), (-10.0, 10.0)], [100.0, 100.0], [1.0, -0.5])
    assert guard.ramp([0.0, 0.0]).shape == (2, 9)  # 1 V at 0.1 V a tick: 9 ticks, and the tenth is the target


def test_the_clock_is_never_early_and_counts_what_is_late() -> None:
    clock = Clock(0.005)
    began = time.monotonic()  # before it starts: the test may wait for the processor in between
    clock.start()
    for k in range(20):
        clock.wait()
        assert time.monotonic() - began >= 0.005 * k - 1e-6
    time.sleep(0.023)
    before = clock.overruns
    late = clock.wait()
    assert late > 15e6
    assert clock.overruns == before + 1
    assert clock.missed >= 3
    again = time.monotonic()
    clock.wait()  # what was lost is not hurried after
    assert time.monotonic() - again >= 0.004
    assert sum(clock.histogram) == 22


def test_another_thread_that_never_rests_does_not_keep_the_clock_from_its_time() -> None:
    import sys
    import threading

    running = True

    def burn() -> None:
        while running:
            math.sqrt(2.0)

    thread = threading.Thread(target=burn)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(20e-6)  # as in a run
    thread.start()
    try:
        clock = Clock(0.002, spin=300e-6)
        clock.start()
        late = sorted(clock.wait() for _ in range(200))
    finally:
        running = False
        thread.join()
        sys.setswitchinterval(interval)
    assert late[20] < 1e6  # ns; with the usual interval of 5 ms, 4.8 ms


def test_the_loop_on_one_axis_is_the_simulation_to_the_last_bit(tmp_path: Path) -> None:
    wave = random_wave(duration=0.6)
    register = tmp_path / "volts"
    with OneAxis(SimulatedDriver(SimulatedSettings(register=str(register))), **AXIS) as axis:
        recording = run(wave, controller(), axis)
        assert np.fromfile(register) == recording["volts"][-1]
    offline = run(wave, controller(), RealisticPlant())
    for name in ("volts", "measured", "true", "innovation", "flags", "weights"):
        np.testing.assert_array_equal(recording[name], offline[name])
    assert np.fromfile(register) == 0.0
    assert recording.metadata["plant"]["settings"]["axis"]["slew"] == SLEW


def test_limits_beyond_the_range_of_the_driver_are_refused() -> None:
    driver = SimulatedDriver()
    axis = OneAxis(driver, voltage_limits=(-600.0, 3600.0), slew=SLEW)
    with pytest.raises(SettingError, match=r"voltage_limits = -600\.0 V: must be from -10 to 10 V.*V, not mV"):
        axis.open()
    with OneAxis(driver, **AXIS) as axis:
        axis.open()


class Spring:
    """10 um/V."""

    truth = np.empty(0)

    def open(self) -> Timing:
        return Timing(sample_rate=2000.0)

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        self.truth = 10.0 * volts
        return self.truth


@pytest.mark.parametrize(("block", "latency"), [(1, 0), (1, 3), (5, 0), (8, 13)])
def test_block_and_latency_of_the_simulated_driver(block: int, latency: int) -> None:
    settings = SimulatedSettings(block=block, latency=latency)
    with OneAxis(SimulatedDriver(settings, [Spring()]), **AXIS) as axis:
        recording = run(random_wave(duration=0.6), controller(), axis)
    answered = slice(None, -latency or None)
    np.testing.assert_array_equal(recording["measured"][answered], 10.0 * recording["volts"][answered])
    np.testing.assert_array_equal(recording["true"][answered], 10.0 * recording["volts"][answered])


def test_an_interrupted_run_leaves_one_axis_at_the_safe_voltage(tmp_path: Path) -> None:
    register = tmp_path / "volts"
    settings = SimulatedSettings(register=str(register), faults=(Fault(kind="error", at=100, count=10**6),))
    with (
        pytest.raises(RunInterrupted, match="error -1"),
        OneAxis(SimulatedDriver(settings), safe_voltage=0.25, **AXIS) as axis,
    ):
        run(random_wave(duration=0.6), controller(), axis)
    assert np.fromfile(register) == 0.25


def test_what_one_axis_refuses_does_not_count_as_put_out() -> None:
    driver = SimulatedDriver(SimulatedSettings(block=4))
    with OneAxis(driver, safe_voltage=0.25, **AXIS) as actuator:
        rate = actuator.open().sample_rate
        with pytest.raises(SettingError, match="volts"):
            actuator.exchange(np.array([3.0, 3.0, math.nan, 3.0]))
        actuator.exchange(np.array([3.0, 3.0, 3.0, 3.0]))
        assert driver.output[0] - 0.25 <= 4 * AXIS["slew"] / rate * (1 + 1e-6)


def test_the_output_of_a_driver_can_be_rescued_by_what_was_pickled(tmp_path: Path) -> None:
    register = tmp_path / "volts"
    driver = SimulatedDriver(SimulatedSettings(register=str(register), channels=2))
    driver.open()
    driver.start(np.array([1.0, 2.0]))
    pickle.loads(pickle.dumps(driver.rescue()))(np.array([0.5, 0.0]))
    assert driver.output.tolist() == [0.5, 0.0]
    driver.close()
    driver.close()
    assert np.fromfile(register).tolist() == [0.5, 0.0]


def test_no_temporary_register_stays_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not of a driver that nobody has closed, nor of one that another process rescues, in time or too late."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    driver = SimulatedDriver()
    driver.open()
    driver.start(np.array([1.0]))
    rescue = driver.rescue()
    rescue(np.array([0.5]))
    assert driver.output.tolist() == [0.5]
    del driver
    gc.collect()
    assert not list(tmp_path.iterdir())
    rescue(np.array([0.0]))
    assert not list(tmp_path.iterdir())
    driver = SimulatedDriver()
    driver.open()
    driver.start(np.array([1.0]))
    code = "import pickle, sys, numpy as np; pickle.loads(bytes.fromhex(sys.argv[1]))(np.array([0.25]))"
    subprocess.run([sys.executable, "-c", code, pickle.dumps(driver.rescue()).hex()], check=True)
    assert driver.output.tolist() == [0.25]
    assert not list(tmp_path.iterdir())
    driver.close()


@pytest.mark.parametrize("kind", ["open", "start", "stop"])
def test_calls_that_fail_say_which(kind: str) -> None:
    driver = SimulatedDriver(SimulatedSettings(faults=(Fault(kind=kind),)))

    def use() -> None:
        driver.open()
        driver.start(np.zeros(1))
        driver.stop(np.zeros(1))

    with pytest.raises(DriverError, match=f"^{kind}: error -2"):
        use()
    driver.close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"plant": {"noize": 0.0}}, "plant.noize"),
        ({"faults": [{"kind": "error", "when": 3}]}, "faults.when"),
        ({"faults": [{"kind": "explosion"}]}, "kind"),
        ({"channels": 0}, "channels"),
        ({"block": 1024}, "block"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, object], words: str) -> None:
    with pytest.raises(SettingError, match=words):
        SimulatedDriver(toml.decode(SimulatedSettings, settings))


def test_one_axis_refuses_two() -> None:
    axis = OneAxis(SimulatedDriver(SimulatedSettings(channels=2)), **AXIS)
    with pytest.raises(
        SettingError, match=r"channels of the driver = 2: must be 1.*SingleChannel.*\[\[axis\]\] for each.*--axis"
    ):
        axis.open()


class Three(SimulatedDriver):
    """Three channels, and every voltage of each."""

    def __init__(self, **given: object) -> None:
        super().__init__(toml.decode(SimulatedSettings, {"channels": 3, "block": 4, **given}))
        self.went: list[np.ndarray] = []

    def start(self, volts: np.ndarray) -> None:
        self.went.append(volts[:, np.newaxis].copy())
        super().start(volts)

    def exchange(self, volts: np.ndarray, measured: np.ndarray) -> None:
        self.went.append(volts.copy())
        super().exchange(volts, measured)

    def stop(self, volts: np.ndarray) -> None:
        self.went.append(volts[:, np.newaxis].copy())
        super().stop(volts)


def test_outputs_of_several_channels_stay_where_they_are_where_one_is_expected(tmp_path: Path) -> None:
    class Plays(SimulatedDriver):
        def playback(self, volts: np.ndarray, sample_rate: float) -> Recorded:
            raise NotImplementedError

    register = tmp_path / "outputs"
    np.array([1.0, 2.0]).tofile(register)
    for kind in (SimulatedDriver, Plays):
        driver = kind(SimulatedSettings(channels=2, register=str(register)))
        with pytest.raises(SettingError, match="channels of the driver = 2"):
            playback(driver, np.linspace(0.0, 1.0, 50), 2000.0, **AXIS)
        assert np.fromfile(register).tolist() == [1.0, 2.0]


def test_one_axis_of_three_moves_as_one_alone_while_the_others_are_at_their_safe_voltages() -> None:
    volts, driver = 1.0 - np.cos(np.arange(400) / 60.0), Three()
    with OneAxis(SingleChannel(driver, "y", {"x": 0.5, "y": 0.0, "z": -0.25}), **AXIS) as axis:
        assert axis.open().channels == 1
        measured, true = axis.apply(volts), axis.truth.copy()
    went = np.hstack(driver.went)
    assert np.all(went[0] == 0.5)
    assert np.all(went[2] == -0.25)
    assert went[1].max() == volts.max()
    assert went[1, -1] == 0.0
    plants = toml.decode(SimulatedSettings, {"channels": 3, "block": 4})
    whole, rows = SimulatedDriver(plants), np.empty((3, 4))
    timing = whole.open()
    whole.start(np.array([0.5, 0.0, -0.25]))
    seen = []
    for start in range(0, 400, timing.block):
        given = np.repeat([[0.5], [0.0], [-0.25]], 4, axis=1)
        given[1] = volts[start : start + 4]
        whole.exchange(given, rows)
        seen.append(rows[1].copy())
    whole.close()
    np.testing.assert_array_equal(measured, np.concatenate(seen))
    np.testing.assert_array_equal(true, whole.truth[1])


def test_one_axis_of_several_is_rescued_and_described_with_its_channel() -> None:
    class Rescued(Three):
        def rescue(self) -> Callable[[np.ndarray], None]:
            return np.ndarray.tolist

    single = SingleChannel(Rescued(), "z", {"x": 0.5, "y": 0.25, "z": 9.0})
    assert single.describe()["channel"] == 2
    rescue = pickle.loads(pickle.dumps(single.rescue()))  # in the process of the watchdog
    assert rescue(np.array([0.1])) == [0.5, 0.25, 0.1]


def test_one_axis_of_several_is_one_of_them_and_all_voltages_are_numbers() -> None:
    for axis, safe, words in (
        ("u", {"x": 0.0, "y": 0.0}, "axis = 'u': must be one that has a safe voltage: x, y"),
        (-1, {"x": 0.0, "y": 0.0}, "axis = -1: must be one that has a safe voltage: x, y"),
        ("x", {}, "axis = 'x': must be one that has a safe voltage: no axis"),
        ("x", "ab", "safe_voltages = 'ab': must be a mapping of each axis to its voltage"),
        ("x", {"x": 0.0, "y": "a"}, "safe_voltage of axis y = 'a' V: must be a number"),
        ("x", {"x": 0.0, "y": math.nan}, "safe_voltage of axis y = nan V: must be finite"),
    ):
        with pytest.raises(SettingError, match=words):
            SingleChannel(Three(), axis, safe)  # type: ignore[arg-type]  # what must not be


def test_limits_of_axes_that_are_held_are_checked_as_those_of_the_one_that_moves() -> None:
    safe, usual = {"x": 0.0, "y": 0.5}, {"x": (-0.6, 3.6), "y": (0.0, 1.0)}
    for limits, words in (
        ({"x": (-0.6, 3.6)}, "voltage_limits = limits of x: must be one for each of the axes x, y"),
        ({**usual, "y": (1.0, 0.0)}, "voltage_limits of axis y"),
        ({**usual, "y": (1.0, 2.0)}, "safe_voltage of axis y = 0.5 V: must be from 1 to 2"),
        ((-0.6, 3.6), "voltage_limits = .*: must be a mapping of each axis to its limits"),
    ):
        with pytest.raises(SettingError, match=words):
            SingleChannel(Three(), "x", safe, voltage_limits=limits)  # type: ignore[arg-type]  # what must not be
    driver = Three(channels=2, plant={"da_limits": (-0.6, 3.6)})
    for reach in ((0.0, 150.0), (-1.0, 3.6)):
        single = SingleChannel(driver, "x", safe, voltage_limits={**usual, "y": reach})
        with pytest.raises(SettingError, match=r"voltage_limits of axis y = (150|-1).0 V: must be .* the output_range"):
            single.open()
    with OneAxis(SingleChannel(driver, "x", safe, voltage_limits=usual), **AXIS) as axis:
        assert axis.open().channels == 1


class Plays(Three):
    """Its hardware plays a waveform by itself."""

    def playback(self, volts: np.ndarray, sample_rate: float) -> Recorded:
        self.went.append(volts.copy())
        return Recorded(volts, 10.0 * volts, sample_rate)


@pytest.mark.parametrize("kind", [Three, Plays])
@pytest.mark.parametrize(
    ("safe", "words"),
    [
        (
            {"x": 0.0, "y": 500.0, "z": 0.0},
            "safe_voltage of axis y = 500.0 V: must be from -0.6 to 3.6 V, the output_range",
        ),
        ({"x": 0.0, "y": 0.0}, r"the number of axes = 2: must be 3, one for each channel.*a table \[\[axis\]\] each"),
    ],
)
def test_nothing_is_put_out_where_other_axes_cannot_be_held(
    kind: type[Three], safe: dict[str, float], words: str
) -> None:
    driver = kind(plant={"da_limits": (-0.6, 3.6)})
    closed: list[bool] = []
    driver.close = lambda: closed.append(True)  # type: ignore[method-assign]
    with pytest.raises(SettingError, match=words):
        playback(SingleChannel(driver, "x", safe), np.linspace(0.0, 1.0, 50), 2000.0, **AXIS)
    assert (driver.went, any(closed)) == ([], True)


def test_one_axis_of_several_is_stopped_only_while_it_is_open() -> None:
    driver = Three()
    single = SingleChannel(driver, "x", {"x": 0.0, "y": 0.5, "z": 0.25})
    single.stop(np.zeros(1))
    assert driver.went == []
    single.open()
    single.start(np.ones(1))
    single.stop(np.zeros(1))
    single.close()
    single.stop(np.ones(1))
    assert [went[:, 0].tolist() for went in driver.went] == [[1.0, 0.5, 0.25], [0.0, 0.5, 0.25]]


def test_hardware_that_plays_by_itself_plays_one_axis_with_the_others_at_rest() -> None:
    driver, volts = Plays(), np.linspace(0.0, 1.0, 50)
    made = playback(SingleChannel(driver, "x", {"x": 0.0, "y": 0.75, "z": -0.5}), volts, 2000.0, **AXIS)
    assert np.array_equal(made.displacement, [10.0 * volts])
    assert np.array_equal(made.volts, [volts])
    for waves in driver.went:
        assert np.all(waves[1:] == [[0.75], [-0.5]])


def test_a_driver_that_paces_itself_takes_its_time() -> None:
    driver = SimulatedDriver(SimulatedSettings(block=20, hardware_timed=True))
    driver.open()
    driver.start(np.zeros(1))
    began = time.monotonic()
    for _ in range(10):
        driver.exchange(np.zeros((1, 20)), np.empty((1, 20)))
    assert time.monotonic() - began >= 0.099
    driver.close()


def test_a_playback_that_is_interrupted_ramps_to_the_safe_voltage_within_slew() -> None:
    class Interrupted(SimulatedDriver):
        """The output of each tick, and Ctrl-C in the middle."""

        def __init__(self) -> None:
            super().__init__()
            self.went: list[float] = []

        def exchange(self, volts: np.ndarray, measured: np.ndarray) -> None:
            super().exchange(volts, measured)
            self.went.append(float(volts[0, -1]))
            if len(self.went) == 2200:
                raise KeyboardInterrupt

    driver = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        playback(driver, np.linspace(0.0, 3.0, 2000), 2000.0, **AXIS, rest=0.5)
    assert driver.went[2199] > 1.0
    assert driver.output[0] == 0.0
    assert len(driver.went) > 2205
    assert np.abs(np.diff(driver.went)).max() <= SLEW / 2000.0 * (1 + 1e-6)


def test_a_playback_is_paced_and_answers_its_own_voltages() -> None:
    began, volts = time.monotonic(), np.linspace(0.0, 1.0, 500)
    settings = SimulatedSettings(block=20, latency=40, plant={"noise": 0.0, "drift": 0.0})
    slow = playback(SimulatedDriver(settings), volts, 2000.0, **AXIS, rest=0.1)
    assert time.monotonic() - began > (500 + 200) / 2000.0
    at_once = playback(SimulatedDriver(SimulatedSettings(plant=settings.plant)), volts, 2000.0, **AXIS, rest=0.1)
    assert np.array_equal(slow.displacement, at_once.displacement)
    with pytest.raises(SettingError, match=r"voltage_limits = -20.0 V: must be from -10 to 10 V"):
        playback(SimulatedDriver(), volts, 2000.0, voltage_limits=(-20.0, 20.0), slew=SLEW)


def test_each_channel_has_the_range_of_its_own_amplifier() -> None:
    """A lens drive of 12 V beside a scanner of 3.6 V."""
    stages = [{"stroke": 30.0}, {"stroke": 100.0, "voltage_limits": [-2.0, 12.0]}]
    asked = {"sample_rate": 10_000.0, "channels": 2, "axes": {"stages": stages}}
    driver = SimulatedDriver(toml.decode(SimulatedSettings, asked))
    assert driver.describe()["output_range"] == [(-0.6, 3.6), (-2.0, 12.0)]
    for name, reach, words in (("z", (-2.0, 12.0), ""), ("z", (-2.0, 13.0), "13.0"), ("x", (-2.0, 3.6), "-2.0")):
        usual = {"x": (-0.6, 3.6), "z": (0.0, 10.0), name: reach}
        single = SingleChannel(driver, "z", {"x": 0.0, "z": 0.0}, voltage_limits=usual)
        if words:
            with pytest.raises(SettingError, match=rf"voltage_limits of axis {name} = {words} V: must be"):
                single.open()
            continue
        single.open()
        assert single.describe()["output_range"] == (-2.0, 12.0)
        single.close()


def test_a_channel_of_the_simulated_driver_may_be_a_stage() -> None:
    """From a configuration: the stage itself, tick by tick, and its range."""
    stage = {"resonances": [500.0, 1500.0], "dampings": [0.02, 0.02], "shares": [0.9, 0.1], "voltage_limits": [-1, 5]}
    driver = SimulatedDriver(toml.decode(SimulatedSettings, {"sample_rate": 10_000.0, "seed": 4, "stage": stage}))
    driver.open()
    driver.start(np.zeros(1))
    volts, measured = np.full((1, 1), 2.0), np.empty((1, 1))
    driver.exchange(volts, measured)
    plain = {name: tuple(v) if isinstance(v, list) else v for name, v in stage.items()}
    assert measured[0] == StagePlant(StageSettings(sample_rate=10_000.0, **plain), 4).exchange(np.array([2.0]))  # type: ignore[arg-type]
    assert driver.describe()["output_range"] == (-1.0, 5.0)
    driver.close()
    with pytest.raises(SettingError, match="stage"):
        SimulatedSettings(plant={"noise": 0.0}, stage=stage)
