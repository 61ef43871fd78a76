"""Owners' mistakes under `truestroke run`: found before or soon after anything moves, told in a sentence.

The voltage is read outside of the process: in the register of the simulated driver, at the terminals of the fake card.
"""

from __future__ import annotations

import os
import re
import timeit
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from truestroke import AdaptiveController, Recording, SettingError, Timing
from truestroke.cli import main
from truestroke.identification import ActuatorModel, save_model
from truestroke.plant import Change, PlantSettings, RealisticPlant
from truestroke.report.recording import run_page
from truestroke.runtime.drivers import SimulatedDriver, SimulatedSettings
from truestroke.runtime.drivers.guard import Guard
from truestroke.runtime.drivers.paced import padded
from truestroke.runtime.realtime import Axis, Outcome, RealtimeSettings, SetPoint, config, run_realtime
from truestroke.runtime.realtime.axis_check import Found, examine
from truestroke.runtime.realtime.axis_loop import Supervision, error_limit
from truestroke.runtime.realtime.ending import Cause, Stop
from truestroke.signals.trajectories import Trajectory, sine, staircase

if TYPE_CHECKING:
    from card import Card

pytest_plugins = ["card"]

ROOT = Path(__file__).parents[1]
LIMITS, SLEW, SAFE, STROKE, RATE = (-0.6, 3.6), 400.0, 0.25, 30.0, 2000.0
PATIENT = {"overrun_streak": 0, "watchdog_timeout": 20.0, "spin": 0.0}  # a busy machine is late by ms and more
Sensor = Callable[[np.ndarray, int], np.ndarray]
pytestmark = [
    pytest.mark.filterwarnings("ignore::truestroke.LatenessWarning"),
    pytest.mark.usefixtures("empty_folder", "forked_helpers"),
]


class Wired:
    """The realistic stack with a sensor of another mind: `sensor(z, k)` is what it shows of z (um) from tick k on."""

    def __init__(self, sensor: Sensor, seed: int = 0, **plant: Any) -> None:
        self._plant, self._sensor = RealisticPlant(PlantSettings(**plant), seed), sensor
        self.settings = self._plant.settings
        self.truth, self.left, self.furthest = np.empty(0), [], 0.0

    def open(self) -> Timing:
        self._tick = 0
        return self._plant.open()

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        self.left += volts.tolist()
        z = self._plant.exchange(volts)
        self.truth, k = self._plant.truth, self._tick
        self.furthest = max(self.furthest, float(np.abs(self.truth).max()))
        self._tick += volts.size
        return np.array(self._sensor(z, k), dtype=np.float64)


def axis(wave: Trajectory | SetPoint | None = None, paper: bool = False, **changes: Any) -> Axis:
    told = {"stroke": STROKE, "voltage_limits": LIMITS} | {k: changes.pop(k) for k in ("stroke",) if k in changes}
    bench = {"voltage_limits": LIMITS, "slew": SLEW, "safe_voltage": SAFE} | changes
    told["voltage_limits"] = bench["voltage_limits"]
    wave = wave or sine(frequency=4.0, peak_to_peak=20.0, duration=1.2, sample_rate=RATE)
    make = AdaptiveController.paper if paper else AdaptiveController
    return Axis(trajectory=wave, controller=make(sample_rate=wave.sample_rate, **told), **bench)


def went(sensor: Sensor, on: Axis | None = None, **settings: Any) -> tuple[Outcome, Wired]:
    """A run with the sensor, and what has been moved; its last voltage is the safe one."""
    plant = Wired(sensor)
    driver = SimulatedDriver(SimulatedSettings(register=os.path.abspath("volts")), [plant])
    on = on or axis()
    outcome = run_realtime(driver, [on], "run.h5", settings=RealtimeSettings(**PATIENT | settings))
    assert np.fromfile("volts") == on.safe_voltage
    assert np.abs(np.diff([on.safe_voltage, *plant.left])).max() * RATE <= SLEW * (1 + 1e-6)  # soft, all of it
    recording = Recording.load("run.h5")
    assert recording.metadata["interrupted"] == (outcome.reason or None)
    assert recording.metadata["ended"]["exit_code"] == outcome.cause.value
    assert recording["time"].size == outcome.ticks
    return outcome, plant


def noise(z: np.ndarray, k: int) -> np.ndarray:
    return np.random.default_rng(k).normal(0.0, 0.03, z.size)


# ---- The axis check ------------------------------------------------------------------------------------------------


@dataclass
class Mistake:
    """A sensor that is not the one of the settings, and what is said of it."""

    code: int
    words: tuple[str, ...]
    sensor: Sensor
    axis: dict[str, Any] = field(default_factory=dict)


BEFORE = {
    "the sign of the sensor is wrong": Mistake(
        3, ("should answer about +0.12 um", "it answers -0.0", "the sign is wrong. Change the sign"), lambda z, k: -z
    ),
    "the sensor is that of something else": Mistake(3, ("no answer to a probe of +0.0891 V",), noise),
    "the gain is not one of stroke and voltage limits": Mistake(
        3, (" um/V, where", "allow 0.893 to 53 um/V", "Correct um_per_volt"), lambda z, k: 10.0 * z
    ),
    "the gain does not reach the motion": Mistake(3, ("do not reach 0 to 20 um",), lambda z, k: 0.1 * z),
    "the axis does not come to rest": Mistake(
        3, ("does not come to rest within 5 s",), lambda z, k: np.random.default_rng(k).normal(0.0, 3.0, z.size)
    ),
    "the sensor delivers nothing at the start": Mistake(10, ("80 of 80 measurements",), lambda z, k: np.nan * z),
}


def examined(
    axes: list[Axis], plants: list[Wired], block: int = 1, latency: int = 0, order: slice = slice(None)
) -> list[Found]:
    """What the check finds of simulated axes, as fast as it goes; inputs in another `order` than outputs."""
    rate, channels = axes[0].trajectory.sample_rate, len(axes)
    settings = SimulatedSettings(sample_rate=rate, block=block, latency=latency, channels=channels)
    driver = SimulatedDriver(settings, plants)
    timing, safe = driver.open(), [on.safe_voltage for on in axes]
    driver.start(np.array(safe))
    guard = Guard(rate, [on.voltage_limits for on in axes], [on.slew for on in axes], safe)
    measured = np.empty((channels, block))

    def play(volts: np.ndarray) -> np.ndarray:
        came, ticks = [], volts.shape[1]
        volts = padded(volts, ticks + latency)
        for start in range(0, volts.shape[1], block):
            part = padded(volts[:, start : start + block], block)
            guard(part)
            driver.exchange(part, measured)
            came.append(measured[order].copy())
        return np.concatenate(came, axis=1)[:, latency : latency + ticks]

    found = examine(axes, timing, play, True)
    assert guard.limited == 0
    return found


@pytest.mark.parametrize("name", BEFORE)
def test_the_check_finds(name: str) -> None:
    mistake, plant = BEFORE[name], Wired(BEFORE[name].sensor, drift=0.0)
    with pytest.raises(Stop) as stop:
        examined([axis(safe_voltage=0.0)], [plant])
    assert stop.value.cause.value == mistake.code
    for words in ("axis axis: ", *mistake.words):
        assert words in stop.value.reason
    assert plant.furthest <= 0.05 * STROKE
    assert plant.left[-1] == 0.0


def test_the_check_ends_a_run_softly_before_its_first_tick() -> None:
    outcome, plant = went(lambda z, k: -z)
    assert (outcome.cause, outcome.ticks) == (Cause.CHECK, 0)
    assert "the sign is wrong" in outcome.reason
    assert max(plant.left) < SAFE + 0.02  # V


@pytest.mark.parametrize(
    "plant",
    [{}, {"resonance": 80.0, "damping": 0.01}, {"noise": 0.6}, {"hysteresis": 0.5}],
    ids=["default", "soft", "noisy", "hysteresis"],
)
def test_even_ten_times_the_gain_moves_less_than_a_twentieth_of_the_stroke(plant: dict[str, Any]) -> None:
    wired = Wired(lambda z, k: z, drift=0.0, sensitivity=3.771, **plant)
    with pytest.raises(Stop, match="stroke and voltage_limits allow"):
        examined([axis(safe_voltage=0.0)], [wired])
    assert wired.furthest <= 0.05 * STROKE


def drawn(seed: int) -> tuple[Axis, Wired, dict[str, int]]:
    """A good axis: strokes of 0.3 um to 1 mm, told right or three times wrong, soft, noisy, at any voltage."""
    rng = np.random.default_rng(seed)
    scale = 10 ** rng.uniform(-2.0, 1.5)
    plant = {
        "sensitivity": 0.3771 * scale * rng.uniform(0.6, 1.3),
        "hysteresis": rng.uniform(0.0, 0.5),
        "resonance": float(rng.choice([50.0, 80.0, 200.0, 900.0])),
        "damping": rng.uniform(0.01, 0.1),
        "noise": 0.03 * scale * 10 ** rng.uniform(-1.0, 0.7),
        "drift": 3.0 * scale * rng.uniform(-1.0, 1.0),
        "drift_time": 10 ** rng.uniform(0.0, 2.0),
        "creep": rng.uniform(0.0, 0.02),
        "asymmetry": rng.uniform(-0.15, 0.15),
        "asymmetry_stroke": 30.0 * scale,
        "ad_step": 3e-4 * scale * rng.uniform(0.1, 30.0),
        "ad_limits": None,
    }
    limits = [(-0.6, 3.6), (0.0, 3.6), (-0.6, 3.0)][rng.integers(3)]
    rate, stroke = float(rng.choice([500.0, 1000.0, 2000.0])), 30.0 * scale * float(rng.choice([1 / 3, 1.0, 3.0]))
    wave = sine(frequency=5.0, peak_to_peak=min(20.0 * scale, stroke), duration=1.0, sample_rate=rate)
    safe, slew = float(rng.choice([0.0, *limits, 1.0, 0.25])), float(rng.choice([4000.0, 400.0, 50.0]))
    on = axis(wave, stroke=stroke, voltage_limits=limits, safe_voltage=safe, slew=slew)
    timing = {"block": int(rng.choice([1, 5, 20])), "latency": int(rng.choice([0, 2, 40]))}
    return on, Wired(lambda z, k: z, seed, sample_rate=rate, **plant), timing


@pytest.mark.parametrize("seed", range(24))
def test_the_check_lets_a_good_axis_pass(seed: int) -> None:
    on, plant, timing = drawn(seed)
    (found,) = examined([on], [plant], **timing)
    assert found.zero == 0.0
    assert found.gain == pytest.approx(plant.settings.sensitivity * 100 / 3, rel=0.75)


def test_the_check_can_be_left_out_and_then_nothing_moves_before_the_run() -> None:
    outcome, plant = went(lambda z, k: z, axis_check=False)
    assert outcome.cause is Cause.FINISHED
    assert np.isnan(outcome.found["axis"].gain)
    assert outcome.found["axis"].probe == 0.0
    assert len(plant.left) < outcome.ticks + 100  # and the way back to the safe voltage


def test_swapped_inputs_are_told_from_a_dead_one() -> None:
    axes, plants = [axis(name=name, safe_voltage=0.0) for name in "xy"], [Wired(lambda z, k: z, s) for s in (0, 1)]
    assert [found.zero for found in examined(axes, plants)] == [0.0, 0.0]
    with pytest.raises(Stop, match=r"axis x: no answer to .*; the sensor of axis y answers instead: inputs or outputs"):
        examined(axes, plants, order=slice(None, None, -1))


@pytest.mark.parametrize("degrees", [90, -90])
def test_sensors_at_a_right_angle_are_said_with_the_rotation_that_it_is(degrees: int) -> None:
    """The sensor of y reads the motion of x where they are turned by 90 degrees, and its negative by -90."""
    axes = [axis(name=name, safe_voltage=0.0) for name in "xy"]
    plants = [Wired(lambda z, k: z if degrees > 0 else -z, 0), Wired(lambda z, k: z, 1)]
    with pytest.raises(
        Stop, match=rf"or the sensors stand at {degrees} degrees: rotation = {degrees}.0 in \[coupled\]"
    ):
        examined(axes, plants, order=slice(None, None, -1))


def test_cross_talk_is_no_answer_where_another_sensor_has_it() -> None:
    """3 % of the other axis was taken for the answer of this one: um_per_volt was to be corrected."""
    axes = [axis(name=name, safe_voltage=0.0) for name in "xy"]
    moved: list[np.ndarray] = []

    def of_x(z: np.ndarray, _: int) -> np.ndarray:
        moved.append(z)
        return z

    plants = [Wired(of_x, 0), Wired(lambda z, k: z + 0.03 * moved[-1], 1)]
    with pytest.raises(Stop, match=r"axis x: no answer .*; the sensor of axis y answers instead: inputs or outputs"):
        examined(axes, plants, order=slice(None, None, -1))


def test_a_motion_on_the_wrong_side_of_zero_is_shifted_not_made_smaller() -> None:
    """As of y where the sensors are turned by 90 degrees and the scan is where x and y are above 0."""
    down = sine(frequency=4.0, peak_to_peak=10.0, offset=-20.0, duration=1.0)
    with pytest.raises(
        Stop, match=r"do not reach -25 to 0 um. Shift the motion, as by its offset \(where sensors are tur"
    ):
        examined([axis(down, safe_voltage=0.0)], [Wired(lambda z, k: z, 0)])


# ---- The zero ------------------------------------------------------------------------------------------------------


def rmse(file: str = "run.h5") -> float:
    run = Recording.load(file)
    half = run["time"].size // 2
    return float(np.sqrt(np.nanmean((run["measured"] - run["desired"])[half:] ** 2)))


@pytest.mark.parametrize("safe", [0.0, 1.5])
def test_a_sensor_that_was_not_zeroed_is_zeroed(safe: float) -> None:
    outcome, _ = went(lambda z, k: z + 200.0, axis(safe_voltage=safe))
    assert outcome.cause is Cause.FINISHED, outcome.reason
    zero = outcome.found["axis"].zero
    assert zero == pytest.approx(200.0, abs=0.05 if safe == 0.0 else 6.0)  # at 1.5 V the hysteresis is not known
    assert Recording.load("run.h5").metadata["axis_check"]["axis"]["zero"] == zero
    assert rmse() < 0.03


def test_a_sensor_near_zero_is_believed_unless_told_otherwise() -> None:
    def shifted(z: np.ndarray, k: int) -> np.ndarray:
        return z + 1.0

    for zero, expected in ((None, 0.0), ("measured", 1.0), (0.5, 0.5)):
        on = axis(safe_voltage=0.0, zero=zero)
        (found,) = examined([on], [Wired(shifted)])
        assert found.zero == pytest.approx(expected, abs=0.01)
    with pytest.raises(SettingError, match="zero = 'none' um: must be \"measured\", or a number"):
        axis(zero="none")


# ---- Tracking is lost ----------------------------------------------------------------------------------------------

LOST: dict[str, tuple[Sensor, str]] = {
    "the cable of the sensor is pulled": (noise, "tracking is lost: more than 6 um (error_limit) off"),
    "the sign of the sensor changes": (lambda z, k: -z, "tracking is lost"),
    "the sensor shows another axis": (lambda z, k: 12.0 + noise(z, k), "tracking is lost"),
}


@pytest.mark.parametrize("name", LOST)
def test_a_run_that_is_lost_stops(name: str) -> None:
    sensor, words = LOST[name]
    outcome, _ = went(lambda z, k: z if k < 800 else sensor(z, k), axis_check=False)
    assert outcome.cause is Cause.NOT_TRACKING, outcome
    assert words in outcome.reason
    assert "Look at sensor, cable, sign and amplifier" in outcome.reason
    assert 800 < outcome.ticks < 2200  # 0.7 s later at the latest


@pytest.mark.parametrize(("limit", "said"), [(0.005, True), (0.06, False)])
def test_an_error_limit_below_the_noise_of_the_sensor_is_named(limit: float, said: bool) -> None:
    """Of 10 nm: such a run ends while the motion is followed. Beside it a sensor that jumps, with as much noise."""
    outcome, _ = went(
        lambda z, k: z if said or k < 800 else z + 20.0, axis(error_limit=limit), axis_check=False, error_time=0.1
    )
    assert outcome.cause is Cause.NOT_TRACKING, outcome
    named = re.search(
        r"That limit is below the noise of the sensor, 0\.01\d um rms: set error_limit to 0\.0\d+ um", outcome.reason
    )
    assert bool(named) is said, outcome.reason
    assert ("Look at sensor" in outcome.reason) is not said


def test_an_operators_run_that_is_lost_stops_too() -> None:
    point = SetPoint(reach=(0.0, 20.0), speed=100.0, duration=2.0)
    outcome, _ = went(lambda z, k: z if k < 800 else z + 50.0, axis(point, safe_voltage=0.0), axis_check=False)
    assert outcome.cause is Cause.NOT_TRACKING
    assert "the output stands at a voltage limit, -0.6 V" in outcome.reason


def test_a_motion_beyond_the_limits_stops_with_the_remedy_or_goes_on_where_that_is_asked_for() -> None:
    stack = {"sensitivity": 0.09}  # a quarter of what the settings believe
    wave = sine(frequency=1.0, peak_to_peak=28.0, duration=1.2, sample_rate=RATE)
    for limit_time, cause in ((0.2, Cause.NOT_TRACKING), (0.0, Cause.FINISHED)):
        driver = SimulatedDriver(SimulatedSettings(register=os.path.abspath("volts"), plant=stack))
        settings = RealtimeSettings(**PATIENT, axis_check=False, limit_time=limit_time)
        outcome = run_realtime(driver, [axis(wave)], f"{cause.name}.h5", settings=settings)
        assert outcome.cause is cause
        assert ("make it smaller" in outcome.reason) is (limit_time > 0)
        assert np.fromfile("volts") == SAFE


GOOD: dict[str, dict[str, Any]] = {
    "cold start": {},
    "sudden change": {"change": Change(time=0.6, gain=0.7, hysteresis=1.4)},
    "half the gain": {"sensitivity": 0.25},
}


@pytest.mark.parametrize("limits", [LIMITS, (0.0, 3.6)], ids=["bipolar", "unipolar"])
@pytest.mark.parametrize("paper", [False, True], ids=["default", "paper"])
@pytest.mark.parametrize("name", GOOD)
def test_no_good_run_is_lost(name: str, paper: bool, limits: tuple[float, float]) -> None:
    """Steps to and from 0 um: without negative voltages the stack cannot come back all of the way."""
    wave = staircase(duration=1.6, peak_to_peak=28.6, velocity_limit=1000.0, hold=0.3)
    on = axis(wave, paper, voltage_limits=limits, safe_voltage=0.0)
    watch, plant = Supervision(on, RealtimeSettings(), RATE), RealisticPlant(PlantSettings(**GOOD[name]))
    for k in range(len(wave)):
        z_d = wave.position[k]
        volts = on.controller.command(z_d, wave.velocity[k])
        z = plant.exchange(np.array([volts]))[0]
        on.controller.adapt(z, 0)
        if abs(z - z_d) > watch.limit:
            assert not watch.astray(volts)
        else:
            watch.on_track()


def test_how_far_is_lost() -> None:
    assert error_limit(axis()) == pytest.approx(0.3 * 20.0, rel=0.01)
    assert error_limit(axis(sine(peak_to_peak=1.0, duration=1.0))) == 0.05 * STROKE
    assert error_limit(axis(SetPoint(reach=(-5.0, 20.0), speed=10.0))) == 0.3 * 25.0
    assert error_limit(axis(error_limit=0.5)) == 0.5


def test_supervision_is_a_small_part_of_a_tick() -> None:
    """Against command and adapt of the kernel, which themselves are a hundredth of the loop's work in Python."""
    on = axis()
    watch, command, adapt = Supervision(on, RealtimeSettings(), RATE), on.controller.command, on.controller.adapt
    z, desired, limit = 5.1, 5.0, watch.limit
    back = [np.random.default_rng(k).normal(size=watch.window) for k in range(3)]

    def each_tick() -> None:
        if abs(z - desired) > limit:
            watch.astray(1.0)
        elif not watch.idle:
            watch.on_track()

    def nothing() -> None:
        pass

    def kernel() -> None:
        command(5.0, 0.0)
        adapt(z, 0)

    def cost(call: Callable[[], object], number: int) -> float:
        return min(timeit.repeat(call, number=number, repeat=9)) / number

    added = cost(each_tick, 2000) - cost(nothing, 2000) + cost(lambda: watch.look_back(*back), 20) / (watch.window / 4)
    assert added < cost(kernel, 2000)


# ---- Refused before anything moves ---------------------------------------------------------------------------------


def run(text: str) -> Result:
    Path("stage.toml").write_text(text)
    return CliRunner().invoke(main, ["run", "--config", "stage.toml"])


def example(*changes: tuple[str, str]) -> str:
    text = config.example().replace('name = "simulated" ', 'name = "simulated"\nregister = "volts"')
    text = text.replace("duration = 20.0 ", "duration = 1.0 ").replace("overrun_streak = 20", "overrun_streak = 0")
    for old, new in (("= 0.25 ", "= 9.0 "), *changes):
        assert old in text
        text = text.replace(old, new)
    return text


REFUSED = {
    "the motion is longer than the stroke": (
        (("peak_to_peak = 28.6", "peak_to_peak = 200.0"),),
        ("trajectory of axis x = ", "must be within the stroke, 30 um", "change stroke of axis x"),
    ),
    "the motion is too fast for slew": (
        (("slew = 400.0", "slew = 20.0"),),
        ("slew of axis x = 20 V/s: must be about 1", "make trajectory of axis x slower"),
    ),
    "voltage_limits in mV": (
        (("[-0.6, 3.6]", "[-600.0, 3600.0]"),),
        ("voltage_limits of axis x = -600.0 V: must be from -10 to 10 V", "V, not mV"),
    ),
    "a model in mV": (
        (('controller = "adaptive"', 'model = "mv.toml"'), ("stroke = 30.0", "# no stroke")),
        ("axis.voltage_limits = -0.6 to 3.6 V: must be 420 to 3.36e+04 V apart", "volts at the D/A converter"),
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_and_nothing_moves(name: str) -> None:
    shape: dict[str, Any] = {"thresholds": (0.0, 300.0), "rate_dependent": (1,), "creep_times": (1e-3,), "asymmetry": 1}
    weights = {"weights": np.array([8e-3, 1 / 3e3, 0.0, 0.0, 0.0, 0.0, 0.0]), "covariance": 1e-6 * np.eye(7)}
    limits = {"stroke": 30.0, "voltage_range": (-600.0, 3600.0), "rate_scale": 1 / 1500}
    save_model(Path("mv.toml"), ActuatorModel(**shape, **weights, **limits))
    np.array([0.125]).tofile("volts")
    changes, words = REFUSED[name]
    done = run(example(*changes))
    assert done.exit_code == 2, done.stderr
    for word in words:
        assert word in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert np.fromfile("volts") == 0.125
    assert not Path("run.h5").exists()


def test_a_limit_that_holds_back_is_told_before_the_run() -> None:
    done = run(example(("slew = 400.0", "slew = 100.0")))
    assert done.exit_code == 0, done.stderr
    assert re.search(
        r"^truestroke: slew of axis x = 100 V/s will hold the motion back: it needs about \d+ V/s", done.stderr, re.M
    )
    assert Recording.load("run.h5").metadata["notices"][0] in done.stderr


ROWS = {  # of the table of faults in docs/run.md; tests/test_realtime_faults.py compares
    **{name: mistake.code for name, mistake in BEFORE.items()},
    **dict.fromkeys(LOST, 4),
    **dict.fromkeys(REFUSED, 2),
    "the sensor was not zeroed": 0,
    "the motion needs more than the limits give": 4,
}


# ---- As an owner of a card meets it --------------------------------------------------------------------------------

CARD = {
    "sign": (("um_per_volt = 10.0", "um_per_volt = -10.0"), 3, "the sign is wrong. Change the sign of um_per_volt"),
    "channel": (('"Dev1/ai0"', '"Dev1/ai1"'), 3, "no answer to a probe of +0.0"),
    "gain": (("um_per_volt = 10.0", "um_per_volt = 100.0"), 3, "stroke and voltage_limits allow 0.893 to 53 um/V"),
    "motion": (("peak_to_peak = ", "peak_to_peak = 10"), 2, "must be within the stroke, 30 um"),
    "zero": (("um_per_volt = 10.0", "um_per_volt = 10.0\noffset = 200.0"), 0, ""),
}


@pytest.mark.parametrize("name", CARD)
def test_on_a_card(name: str, card: Card) -> None:
    (old, new), code, words = CARD[name]
    text = re.search(r"^```toml\n(.*?)^```", (ROOT / "docs/nidaqmx.md").read_text(), flags=re.M | re.S)[1]
    assert old in text
    text = re.sub(r"duration = [\d.]+", "duration = 1.5", text.replace(old, new))
    text = text.replace("safe_voltage = 0.0", f"safe_voltage = {SAFE}")
    done = run(f"{text}[realtime]\nwatchdog_timeout = 9.0\n")
    assert done.exit_code == code, done.stderr
    assert words in done.stderr
    assert card.resets == 0
    if code == 2:
        assert (card.volts[0], card.edges) == (0.0, 0)
    else:
        assert card.volts[0] == SAFE
    if code == 3:
        assert card.step <= SAFE
        assert not Path("first.h5").exists()  # nothing is in the way of the next run
    if code == 0:
        assert rmse("first.h5") < 0.03
        zero = Recording.load("first.h5").metadata["axis_check"]["x"]["zero"]
        assert f"zero       {zero:.4g} um of the sensor are subtracted (zero = 0.0 keeps its own)" in done.stdout
        page = run_page(Recording.load("first.h5"))
        assert f"A zero of the sensor of {zero:.4g} um is subtracted" in page.lead
