"""What a motion needs, against stroke and limits, before anything moves."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import signal

import truestroke
from truestroke import ControllerSettings, Dynamics, Mode, Recording, SettingError, metrics
from truestroke.cli import main
from truestroke.control import feasibility
from truestroke.control.baselines import ConstantGain
from truestroke.plant import PlantSettings, RealisticPlant, StagePlant, StageSettings
from truestroke.runtime.realtime import Axis, runner
from truestroke.signals.judgement import judge
from truestroke.signals.trajectories import Trajectory, random_wave, raster, sine, staircase, triangle

BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
SETTINGS = ControllerSettings(**BENCH)


def test_the_demands_of_a_sine_are_those_of_the_book() -> None:
    needs = feasibility.demands(sine(frequency=100.0, peak_to_peak=20.0, duration=1.0), SETTINGS)
    w = 2 * np.pi * 100.0
    assert needs.reach == pytest.approx((0.0, 20.0), abs=0.02)
    assert needs.speed == pytest.approx(10.0 * w, rel=1e-3)
    assert needs.acceleration == pytest.approx(10.0 * w * w, rel=0.02)
    weights = dict(zip(SETTINGS.names, SETTINGS.initial_weights, strict=True))
    plays = [value for name, value in weights.items() if name[0] == "a"]
    assert needs.slew == pytest.approx(needs.speed / weights["a0"])
    assert needs.volts == pytest.approx((0.0, needs.reach[1] / sum(plays)))


@pytest.mark.parametrize(
    "wave",
    [
        sine(frequency=8.0, peak_to_peak=28.6, duration=1.0),
        triangle(frequency=4.0, peak_to_peak=30.0, duration=1.0),
        staircase(peak_to_peak=20.0, velocity_limit=1000.0, duration=1.0),
        random_wave(duration=2.0),
    ],
    ids=lambda wave: wave.name,
)
@pytest.mark.parametrize("settings", [SETTINGS, ControllerSettings.paper(**BENCH)], ids=["default", "paper"])
def test_nothing_is_told_of_what_the_stack_can_do(wave: Trajectory, settings: ControllerSettings) -> None:
    needs = feasibility.demands(wave, settings)
    feasibility.check(needs, settings, slew=400.0)
    assert feasibility.notices(needs, settings, slew=400.0) == ()


def refused(wave: Trajectory, settings: ControllerSettings = SETTINGS, **options: object) -> str:
    with pytest.raises(SettingError) as error:
        feasibility.check(feasibility.demands(wave, settings), settings, **options)  # type: ignore[arg-type]
    return str(error.value)


def test_a_motion_longer_than_the_stroke_is_refused_with_what_it_needs() -> None:
    said = refused(random_wave(duration=2.0, peak_to_peak=200.0), names={**feasibility.NAMES, "stroke": "axis.stroke"})
    assert said.startswith("trajectory = ")
    assert "must be within the stroke, 30 um" in said
    assert "V/s); make it smaller, or change axis.stroke" in said


@pytest.mark.parametrize("offset", [-40.0, 55.0])
def test_a_motion_that_is_short_enough_but_elsewhere_is_to_be_shifted(offset: float) -> None:
    """It was to be made smaller, as often for a scan whose offset is that of another stage."""
    said = refused(sine(frequency=5.0, peak_to_peak=10.0, offset=offset, duration=2.0))
    assert "; shift it, as by its offset: behind its start it is from" in said
    assert "make it smaller" not in said


def test_units_that_do_not_fit_are_refused() -> None:
    """The weights of a model in mV; a motion that goes far below 0 um."""
    mv = ControllerSettings(**BENCH, initial_sensitivity=8.2e-3)
    assert "voltage_limits are -0.6 to 3.6 V" in refused(sine(frequency=8.0, peak_to_peak=20.0, duration=1.0), mv)
    wave = sine(frequency=8.0, peak_to_peak=20.0, duration=1.0)
    below = Trajectory("below", wave.sample_rate, -wave.position, -wave.velocity)
    assert "about -1.7 to 0 V are needed" in refused(below)


def test_a_motion_too_fast_for_the_slew_is_refused_or_told() -> None:
    wave = sine(frequency=100.0, peak_to_peak=20.0, duration=1.0)
    assert refused(wave, slew=300.0).startswith("slew_limit = 300 V/s: must be about 765 V/s for a motion")
    needs = feasibility.demands(wave, SETTINGS)
    feasibility.check(needs, SETTINGS)
    (told,) = feasibility.notices(needs, SETTINGS)
    assert told.startswith("slew_limit = 504 V/s will hold the motion back: it needs about 765 V/s")
    tight = ControllerSettings(**BENCH | {"voltage_limits": (0.0, 2.0)}, initial_sensitivity=8.2)
    (told,) = feasibility.notices(feasibility.demands(sine(peak_to_peak=30.0, duration=1.0), tight), tight)
    assert told.startswith("voltage_limits = 0 to 2 V will hold the motion back: it needs about 0 to 2.")


class Spring:
    """10 um/V."""

    def __init__(self, sample_rate: float = 2000.0) -> None:
        self.sample_rate = sample_rate

    def open(self) -> truestroke.Timing:
        return truestroke.Timing(sample_rate=self.sample_rate)

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        return 10.0 * volts


def test_a_run_tells_before_it_begins_which_limit_holds_its_motion_back() -> None:
    wave = sine(frequency=100.0, peak_to_peak=20.0, duration=0.6)
    with pytest.warns(
        truestroke.LimitWarning, match=r"slew_limit = 600 V/s .* needs about 765 V/s .*; change it"
    ) as told:
        held = truestroke.run(wave, truestroke.AdaptiveController(**BENCH, slew_limit=600.0), Spring())
    assert told[0].filename == __file__
    assert len(told) == 1
    assert held.metadata["notices"] == [str(told[0].message)]
    assert "met the slew limit, 600 V/s, in" in " ".join(judge(held).reasons)
    truestroke.run(wave, truestroke.AdaptiveController(**BENCH, slew_limit=900.0), Spring())  # no word
    truestroke.run(wave, ConstantGain(10.0, (-0.6, 3.6)), Spring())


def test_the_default_slew_limit_is_raised_for_a_known_motion_that_needs_more_and_a_chosen_one_stays() -> None:
    wave = sine(frequency=93.0, peak_to_peak=20.0, duration=0.6, sample_rate=10_000.0)
    bench = BENCH | {"sample_rate": 10_000.0}
    controller = truestroke.AdaptiveController(**bench)
    with pytest.warns(truestroke.LimitWarning, match=r"slew_limit is 1423 V/s in place of its default, 504 V/s"):
        recording = truestroke.run(wave, controller, Spring(10_000.0))
    assert recording.metadata["controller"]["settings"]["slew_limit"] == pytest.approx(1423, abs=1)
    assert metrics.summary(recording).slewed_ticks == 0
    assert judge(recording).level == "good"
    assert recording.metadata["notices"][0].endswith("; set slew_limit to keep it lower")
    axis = {"voltage_limits": (-0.6, 3.6), "slew": 1000.0, "safe_voltage": 0.0}
    on = Axis(name="x", trajectory=wave, controller=truestroke.AdaptiveController(**bench), **axis)
    assert runner._check_motions([on])[0].endswith("; set slew of axis x to keep it lower")
    assert feasibility.needed_slew(wave, ControllerSettings(**bench, slew_limit=505.0)) is None
    assert feasibility.needed_slew(wave, ControllerSettings(**bench), most=1000.0) == 1000.0  # that of the axis stays


@pytest.mark.parametrize(
    ("needs", "raised"), [(0.4, None), (0.49, None), (0.6, 1.2), (0.95, 1.9), (1.05, 2.1), (1.2, 2.4)]
)
def test_a_stage_half_as_sensitive_as_expected_is_not_held_back_by_the_default(needs: float, raised: float) -> None:
    """Of the default slew limit; it is raised to twice the need, also where the need is below it."""
    default, fast = SETTINGS.slew_limit, sine(frequency=100.0, peak_to_peak=20.0, duration=1.0)
    frequency = 100.0 * needs * default / feasibility.demands(fast, SETTINGS).slew
    limit = feasibility.needed_slew(sine(frequency=frequency, peak_to_peak=20.0, duration=1.0), SETTINGS)
    assert limit is None if raised is None else limit == pytest.approx(raised * default, rel=1e-2)


def test_the_default_slew_limit_follows_a_resonance_that_is_given() -> None:
    """A sine over all of the travel at a third of it needs less than half of the limit, and a chosen limit stays."""
    settings = ControllerSettings(**BENCH | {"sample_rate": 10_000.0}, resonance=600.0)
    whole = sine(frequency=200.0, peak_to_peak=30.0, duration=1.0, sample_rate=10_000.0)
    assert 0.3 < feasibility.demands(whole, settings).slew / settings.slew_limit < 0.5
    assert ControllerSettings(**BENCH, resonance=50.0).slew_limit == SETTINGS.slew_limit
    assert ControllerSettings(**BENCH, resonance=600.0, slew_limit=300.0).slew_limit == 300.0


def test_a_simulation_raises_the_slew_limit_as_a_run_does() -> None:
    wave = sine(frequency=100.0, peak_to_peak=20.0, duration=0.6)
    one = truestroke.Simulation(trajectory=wave, controller=SETTINGS, plant=PlantSettings(), seed=3)
    with pytest.warns(truestroke.LimitWarning):
        run = truestroke.run(wave, truestroke.AdaptiveController(**BENCH), RealisticPlant(PlantSettings(), seed=3))
    np.testing.assert_array_equal(truestroke.simulate_many([one])["measured"][0], run["measured"])


def test_voltages_are_those_that_also_move_the_inertia_where_the_resonance_is_known() -> None:
    wave = sine(frequency=100.0, peak_to_peak=20.0, offset=10.0, duration=2.0, sample_rate=10_000.0)
    bench = BENCH | {"sample_rate": 10_000.0}
    rigid, known = (feasibility.demands(wave, ControllerSettings(**bench, resonance=f)) for f in (0.0, 250.0))
    factor = 1 - (100.0 / 250.0) ** 2  # of the inverse of an undamped mode at 100 Hz
    assert known.volts[1] / rigid.volts[1] == pytest.approx((10 + 10 * factor) / 20, rel=0.01)
    assert known.slew / rigid.slew == pytest.approx(factor, rel=0.02)
    assert known.ringing == 0.0


def test_a_triangle_too_sharp_for_a_known_stage_is_told_with_figures_and_a_raster_is_not() -> None:
    mode = Mode(frequency=700.0, damping=0.02)
    stage = Dynamics(sample_rate=10_000.0, modes=(mode,))
    usual = {"frequency": 83.0, "peak_to_peak": 20.0, "duration": 2.0, "sample_rate": 10_000.0}
    settings = ControllerSettings(**BENCH | {"sample_rate": 10_000.0}, slew_limit=5000.0)
    waves = triangle(**usual), raster(turn=stage, **usual)
    sharp, smooth = (feasibility.demands(wave, settings, mode) for wave in waves)
    assert feasibility.notices(smooth, settings) == ()
    (notice,) = feasibility.notices(sharp, settings)
    assert "trajectory is too sharp for the stage: its corners (6.64e+07 um/s^2) leave it ringing at 700 Hz" in notice
    # what it states, by scipy: the inverse of the mode on samples of the lines, held for a tick, through the mode
    wave, w = triangle(**usual), 2 * np.pi * 700.0
    command = np.repeat(wave.position + 0.04 / w * wave.velocity, 10)
    (b,), poles, _ = signal.cont2discrete(([w**2], [1, 0.04 * w, w**2]), 1e-5)
    z = signal.lfilter(b, poles, command)
    error = (z[5::10] - wave.position)[5000:]  # in the middle of ticks, as a held command is half a tick late
    assert sharp.ringing == pytest.approx(np.std(error), rel=0.1)
    assert f"by {sharp.ringing:.2g} um rms" in notice


@pytest.mark.usefixtures("each_picture_once")
def test_a_command_tells_it_in_a_line_in_its_own_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    fast = ["track", "--trajectory", "sine", "--duration", "0.6", "--json"]
    done = CliRunner().invoke(main, [*fast, "--frequency", "100", "--peak-to-peak", "20"])
    (line,) = done.stderr.splitlines()
    assert line.startswith(
        "truestroke: slew_limit is 1530 V/s in place of its default, 504 V/s: the motion needs about"
    )
    assert line.endswith("; a slower motion keeps the default")  # the command has no option for a limit
    assert Recording.load("truestroke-track.h5").metadata["notices"] == [line.removeprefix("truestroke: ")]
    done = CliRunner().invoke(main, [*fast, "--frequency", "4", "--voltage-limits", "-0.6", "1.9"])
    assert done.stderr == ""  # the prior follows from the limits


def on_a_stage(kind: str, offset: float) -> tuple[bool, int, float]:
    """Whether something is told of a raster of 20 um at 0 to 10 V; then ticks at the limit, and largest error, um."""
    limits, late = (0.0, 10.0), slice(6000, None)
    wave = raster(frequency=20.0, peak_to_peak=20.0, offset=offset, duration=2.0, sample_rate=5000.0)
    controller = truestroke.AdaptiveController(sample_rate=5000.0, stroke=30.0, voltage_limits=limits)
    plant = StagePlant(StageSettings(sample_rate=5000.0, voltage_limits=limits, hysteresis_kind=kind))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        recording = truestroke.run(wave, controller, plant)
    error = np.abs(recording["true"] - recording["desired"])[late]
    return bool(told), int(np.sum(recording["volts"][late] <= 0.0)), float(error.max())


@pytest.mark.parametrize("kind", ["plays", "preisach", "bouc-wen"])
def test_a_motion_that_hysteresis_keeps_above_its_lowest_voltage_is_told_of(kind: str) -> None:
    told, held, error = on_a_stage(kind, 10.0)
    assert held > 100
    assert error > 0.3
    assert told
    told, held, in_the_middle = on_a_stage(kind, 15.0)
    assert (told, held) == (False, 0)
    assert in_the_middle < 0.1 * error


def test_what_is_told_of_a_lowest_voltage_names_how_far_up() -> None:
    settings = ControllerSettings(sample_rate=5000.0, stroke=30.0, voltage_limits=(0.0, 10.0))
    wave = raster(frequency=20.0, peak_to_peak=20.0, duration=2.0, sample_rate=5000.0)
    (notice,) = feasibility.notices(feasibility.demands(wave, settings), settings)
    assert "voltage_limits = 0 to 10 V may hold the motion back where it comes back to its lowest position" in notice
    up = float(notice.rsplit("move it up by ", 1)[1].removesuffix(" um"))
    higher = raster(frequency=20.0, peak_to_peak=20.0, offset=10.0 + up, duration=2.0, sample_rate=5000.0)
    assert feasibility.notices(feasibility.demands(higher, settings), settings) == ()


def in_an_own_loop(controller: truestroke.AdaptiveController, position, velocity) -> list[str]:
    """What is said while a linear actuator of 8 um/V follows."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for z_d, zdot_d in zip(position.tolist(), velocity.tolist(), strict=True):
            controller.adapt(8.0 * controller.command(z_d, zdot_d))
    return [str(one.message) for one in said if issubclass(one.category, truestroke.LimitWarning)]


def test_a_loop_of_ones_own_is_said_once_that_the_default_slew_limit_holds_it_back() -> None:
    bench = BENCH | {"sample_rate": 10_000.0}
    fast, slow = (sine(frequency=f, peak_to_peak=20.0, duration=0.5, sample_rate=10_000.0) for f in (200.0, 50.0))
    controller = truestroke.AdaptiveController(**bench)
    said = in_an_own_loop(controller, fast.position, fast.velocity)
    assert len(said) == 1
    assert "slew_limit = 504 V/s, the default, holds the motion back" in said[0]
    assert "twice the highest velocity over 8.21 um/V" in said[0]
    enough = 2 * np.abs(fast.velocity).max() / 8.21
    for given in ({"slew_limit": 504.5}, {"slew_limit": enough}, {"resonance": 700.0}):
        assert in_an_own_loop(truestroke.AdaptiveController(**bench, **given), fast.position, fast.velocity) == []
    assert in_an_own_loop(truestroke.AdaptiveController(**bench), slow.position, slow.velocity) == []
    controller.change(trim_rate=1.0)
    assert in_an_own_loop(controller, fast.position, fast.velocity) == []  # it was said
    changed = truestroke.AdaptiveController(**bench)
    changed.change(resonance=700.0)  # as it says; a limit that was chosen stays
    assert changed.settings.slew_limit == ControllerSettings(**bench, resonance=700.0).slew_limit > 504.0
    chosen = truestroke.AdaptiveController(**bench, slew_limit=300.0)
    chosen.change(resonance=700.0)
    assert chosen.settings.slew_limit == 300.0
    controller.change(slew_limit=enough)
    held = controller.counters.slewed
    assert in_an_own_loop(controller, fast.position, fast.velocity) == []
    assert controller.counters.slewed < held + 100


def test_jumps_short_moves_and_noise_are_no_motion_that_needs_another_slew_limit() -> None:
    rng = np.random.Generator(np.random.PCG64(4))
    noise = 15 + 5 * rng.standard_normal(5000)
    moves = np.tile(np.concatenate([np.linspace(5, 15, 20), np.full(480, 15.0), np.full(500, 5.0)]), 4)
    for position in (noise, np.repeat(noise[:500], 10), moves):
        controller = truestroke.AdaptiveController(**BENCH)
        assert in_an_own_loop(controller, position, 2000.0 * np.diff(position, prepend=position[0])) == []
        assert controller.counters.slewed > 10


def test_a_resonance_in_khz_is_named_where_the_motion_is_out_of_reach() -> None:
    wave = random_wave(duration=2.0, peak_to_peak=28.6)
    settings = ControllerSettings(**BENCH, resonance=3.0)
    with pytest.raises(SettingError, match=r"or correct the limits or the model \(um, V\), or its resonance of 3 Hz$"):
        feasibility.check(feasibility.demands(wave, settings), settings)
