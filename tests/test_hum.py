"""Lines of the mains that are named: the law learns without them, and the command or the feedback takes them away."""

import math
import re

import numpy as np
import pytest
from benchmarks import foreign_stages

from truestroke import AdaptiveController, ControllerSettings, SettingError, judge, run, trajectories
from truestroke.base.typing import FloatArray
from truestroke.control.reference import ReferenceController
from truestroke.plant import StagePlant, StageSettings
from truestroke.signals.trajectories import Trajectory

AXIS = {"sample_rate": 10_000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
LINE = 71.0

pytestmark = pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")


def stage(f0: float, load: float, **of: object) -> StageSettings:
    """Shaken by so much, um, at the line."""
    given = {"sample_rate": 10_000.0, "resonances": (f0,), "dampings": (0.02,), "noise": 0.01, "hum": load}
    return StageSettings(**given | {"hum_frequency": LINE} | of)


def followed(plant: StageSettings, *, motion: float = 3.0, **known: object) -> tuple[FloatArray, AdaptiveController]:
    """True error of the last 2 of 4 s, um."""
    rate, stroke = plant.sample_rate, plant.stroke
    wave = trajectories.sine(
        frequency=motion, peak_to_peak=0.4 * stroke, offset=0.33 * stroke, duration=4.0, sample_rate=rate
    )
    controller = AdaptiveController(**AXIS | {"sample_rate": rate, "stroke": stroke}, **known)
    recording = run(wave, controller, StagePlant(plant, seed=1))
    return (recording["true"] - recording["desired"])[wave.position.size // 2 :], controller


def with_the_same_bits(
    settings: ControllerSettings, shaken: StageSettings, wave: Trajectory, *, ticks: int, missing: int
) -> AdaptiveController:
    """Each tick as that of the NumPy text, on a stage that is shaken; one measurement in `missing` is lost."""
    controller, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant = StagePlant(shaken, seed=1)
    plant.open()
    for k, z_d in enumerate(wave.position[:ticks].tolist()):
        motion = z_d, float(wave.velocity[k]), float(wave.acceleration[k])
        volts = controller.command(*motion)
        assert text.command(*motion) == volts, k
        z = float(plant.exchange(np.array([volts]))[0])
        if k % missing != 5:
            controller.adapt(z)
            text.adapt(z)
    return controller


@pytest.mark.parametrize(("f0", "load"), [(250.0, 0.1), (600.0, 0.5), (1200.0, 0.1)])
def test_a_load_does_not_change_the_slopes_that_the_law_learns(f0: float, load: float) -> None:
    """Feedback answers the load, and without `hum` the law takes that for a property of the plays."""
    plant = stage(f0, load)
    error, controller = followed(plant, dynamics=plant.dynamics(), hum=LINE)
    slopes = np.array(controller.diagnostics.partial_slopes)
    assert slopes.min() > 3.0
    assert error.std() < 0.07 * load / math.sqrt(2)


EVERYTHING = ("nothing", "f0", "dynamics without feedback")


@pytest.mark.parametrize(
    ("f0", "motion", "of", "known"),
    [
        (f0, motion, of, known)
        for f0, motion, of, each in (
            (600.0, 3.0, {}, EVERYTHING),
            (600.0, 0.3, {"hysteresis_kind": "bouc-wen"}, EVERYTHING[:2]),
            (1200.0, 60.0, {"hysteresis_kind": "preisach"}, EVERYTHING[:2]),
            (250.0, 3.0, {"hysteresis_kind": "preisach"}, EVERYTHING[::2]),
            (
                900.0,
                20.0,
                {"sample_rate": 20_000.0, "stroke": 0.6, "hum": 0.006, "noise": 0.0003, "hum_frequency": 50.0},
                EVERYTHING[:1],
            ),
            (
                2000.0,
                20.0,
                {"sample_rate": 20_000.0, "stroke": 600.0, "hum": 6.0, "noise": 0.3, "hum_frequency": 120.0},
                EVERYTHING[:1],
            ),
            (300.0, 2.0, {"dead_time": 1e-3, "hum_frequency": 50.0}, EVERYTHING[::2]),
        )
        for known in each
    ],
)
def test_hum_is_reduced_by_14_db_whatever_is_known(known: str, f0: float, motion: float, of: dict[str, object]) -> None:
    plant = stage(f0, 0.3, **of)
    give = {"nothing": {}, "f0": {"resonance": f0}}.get(known, {"dynamics": plant.dynamics(), "feedback": False})
    error, _ = followed(plant, motion=motion, hum=plant.hum_frequency, **give)
    assert error.std() < 0.2 * plant.hum / math.sqrt(2)


def test_the_law_of_the_paper_and_a_bank_without_resonators_refuse_hum() -> None:
    with pytest.raises(SettingError, match=r"hum = .* Hz: must be \(\) with the law of the paper"):
        AdaptiveController(law="rls", hum=50.0, **AXIS)
    dynamics = stage(700.0, 0.0).dynamics()
    bank = AdaptiveController(dynamics=dynamics, **AXIS).settings.feedback
    with pytest.raises(SettingError, match="the feedback has no resonator for them"):
        AdaptiveController(dynamics=dynamics, feedback=bank, hum=50.0, **AXIS)


@pytest.mark.parametrize(
    ("f0", "known"),
    [(110.0, {"resonance": 110.0}), (75.0, {"resonance": 75.0}), (50.0, {"resonance": 50.0})],
)
def test_a_line_near_the_resonance_is_left_alone(f0: float, known: dict[str, float]) -> None:
    """There a command against it would drive the stage: it is not much larger than the load."""
    plant = stage(f0, 0.1)
    assert followed(plant, hum=LINE, **known)[0].std() < 1.25 * max(
        0.1 / math.sqrt(2), followed(plant, **known)[0].std()
    )


def test_a_line_that_a_late_loop_drives_is_left_alone() -> None:
    """Measurements that come 40 ticks late, which nobody has named: a quarter of a period at 60 Hz."""
    plant = stage(900.0, 0.0)
    controller = AdaptiveController(hum=60.0, **AXIS)
    actuator, late, errors = StagePlant(plant, seed=3), [0.0] * 40, []
    actuator.open()
    for _ in range(30_000):
        late.append(float(actuator.exchange(np.array([controller.command(10.0, 0.0)]))[0]))
        controller.adapt(late[-41])
        errors.append(late[-1] - 10.0)
    assert np.abs(errors[-5000:]).max() < 0.04 * 30.0  # the bound of a line is 0.02 of the stroke


@pytest.mark.parametrize("motion", [4.0, 5.73, 7.0])
@pytest.mark.parametrize("kind", ["preisach", "bouc-wen"])
def test_a_line_of_which_nothing_is_there_costs_nothing(motion: float, kind: str) -> None:
    """The law follows any amplitude that is taken from its measurement alone: 0.27 um remained of none."""
    plant = stage(213.0, 0.0, hysteresis_kind=kind, dampings=(0.03,))
    assert followed(plant, motion=motion, hum=12.9)[0].std() < 0.02


def test_a_load_of_which_nobody_knows_is_no_burst_of_the_law() -> None:
    """0.056 um at 27 Hz beside a motion of 0.2 Hz, with nothing given: 28 um."""
    plant = stage(474.0, 0.056, hysteresis_kind="preisach", dampings=(0.0082,), hum_frequency=26.85)
    error, _ = followed(plant, motion=0.2)
    assert np.abs(error).max() < 0.5


@pytest.mark.parametrize("load", [25.3, 25.6])
@pytest.mark.parametrize("known", ["f0", "dynamics"])
def test_a_load_that_the_law_follows_is_heard_beside_what_is_given(load: float, known: str) -> None:
    """0.3 um beside a motion of 1 Hz: the error has a tenth of it, and peaks that are a matter of the noise."""
    plant = stage(600.0, 0.3, hysteresis_kind="preisach", hum_frequency=load)
    given = {"dynamics": plant.dynamics()} if known == "dynamics" else {"resonance": 600.0}
    error, controller = followed(plant, motion=1.0, **given)
    assert controller.load[0] == pytest.approx(load, abs=0.3)
    assert error.std() < 0.2 * 0.3
    assert np.abs(error).max() < 0.3


@pytest.mark.parametrize("f0", [0.98, 1.0])
def test_a_line_that_the_command_drives_is_dropped(f0: float) -> None:
    """328 Hz, f0 a fifth of it, a load of 0.16 um that the law follows: it rang with 10 um to the end."""
    plant = stage(
        68.7251, 0.16251, sample_rate=328.115, hysteresis_kind="plays", hum_frequency=8.0902, dampings=(0.0091,)
    )
    wave = trajectories.sine(frequency=0.2, peak_to_peak=12.0, offset=10.0, duration=8.0, sample_rate=328.115)
    controller = AdaptiveController(**AXIS | {"sample_rate": 328.115}, resonance=68.7251 * f0)
    recording = run(wave, controller, StagePlant(plant, seed=12))
    assert (recording["true"] - recording["desired"])[-656:].std() < 2 * 0.16251


def test_a_mode_below_the_one_that_was_found_is_no_load() -> None:
    """With nothing given the second mode is found first. The ringing of the first was heard: 32 % of the motion."""
    _, rms, _ = foreign_stages.follow(2014, given=False, duration=4.0, first=foreign_stages.First(arranged="front"))
    assert rms < 2.2


def test_what_is_below_the_noise_is_not_stated() -> None:
    """A harmonic of the motion that its neighbours shift is heard: 0.8 nm at 25.4 Hz, where no load is."""
    plant = stage(900.0, 0.0, hysteresis_kind="bouc-wen")
    _, controller = followed(plant, motion=5.0, dynamics=plant.dynamics())
    assert np.isnan(controller.load).all()


def test_at_a_low_sample_rate_a_load_is_no_burst() -> None:
    """0.13 um at 15 Hz, 500 Hz and f0 0.3 of it: 60 um while more was taken for loads than the error shows."""
    plant = stage(145.58, 0.13318, sample_rate=500.0, hysteresis_kind="plays", hum_frequency=14.68)
    error, _ = followed(plant, motion=0.45116, resonance=145.58)
    assert np.abs(error).max() < 0.5


def test_two_loads_are_heard() -> None:
    """0.2 um at 71 Hz, and as much at 31 Hz."""
    rate = AXIS["sample_rate"]
    second = 0.2 * np.sin(2 * np.pi * 31.0 * np.arange(40_000) / rate)
    wave = trajectories.sine(frequency=3.0, peak_to_peak=12.0, offset=10.0, duration=4.0, sample_rate=rate)
    recording = run(
        wave, AdaptiveController(resonance=600.0, **AXIS), StagePlant(stage(600.0, 0.2), seed=1, load=second)
    )
    assert (recording["true"] - recording["desired"])[30_000:].std() < 0.25 * 0.2


def test_a_sensor_that_repeats_a_number_is_still_noticed() -> None:
    controller = AdaptiveController(hum=50.0, dynamics=stage(900.0, 0.0).dynamics(), **AXIS)
    plant = StagePlant(stage(900.0, 0.2, hum_frequency=50.0), seed=1)
    plant.open()
    wave = trajectories.sine(frequency=8.0, peak_to_peak=12.0, offset=10.0, duration=1.0, sample_rate=10_000.0)
    for k, (z, v) in enumerate(zip(wave.position.tolist(), wave.velocity.tolist(), strict=True)):
        measured = plant.exchange(np.array([controller.command(z, v)]))[0]
        controller.adapt(measured if k < 6000 else 9.0)
    assert controller.counters.rejected > 1000


SLOW = {"sample_rate": 2500.0}  # what the law hears takes as many seconds at each rate, and here a quarter of the ticks


@pytest.mark.parametrize(
    ("f0", "given"),
    [
        (300.0, {"hum": LINE} | SLOW),
        (120.0, {"hum": 50.0} | SLOW),
        (300.0, {"hum": 50.0, "resonance": 300.0} | SLOW),
        (300.0, {"hum": (LINE, 142.0), "dynamics": stage(300.0, 0.0, **SLOW).dynamics()} | SLOW),
        (300.0, {"hum": LINE, "dynamics": stage(300.0, 0.0, **SLOW).dynamics(), "feedback": False} | SLOW),
    ],
)
def test_the_kernel_has_the_bits_of_the_numpy_text(f0: float, given: dict[str, object]) -> None:
    """Past the first 0.25 s, where the command begins to subtract it; measurements are missing."""
    settings = ControllerSettings(**AXIS | given)
    rate = settings.sample_rate
    wave = trajectories.sine(frequency=8.0, peak_to_peak=12.0, offset=10.0, duration=0.6, sample_rate=rate)
    with_the_same_bits(settings, stage(f0, 0.3, sample_rate=rate), wave, ticks=round(0.42 * rate), missing=97)


def test_lines_that_are_added_while_a_load_is_heard_have_the_bits_of_the_numpy_text() -> None:
    settings = ControllerSettings(resonance=300.0, **AXIS | SLOW)
    controller, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant = StagePlant(stage(300.0, 0.3, **SLOW), seed=1)
    plant.open()
    wave = trajectories.sine(frequency=3.0, peak_to_peak=12.0, offset=10.0, duration=1.2, **SLOW)
    for k, z_d in enumerate(wave.position[:2625].tolist()):
        if k == 2375:
            assert controller.load[1] > 0
            controller.change(hum=50.0)
            text.change(hum=50.0)
        volts = controller.command(z_d, float(wave.velocity[k]))
        assert text.command(z_d, float(wave.velocity[k])) == volts, k
        z = float(plant.exchange(np.array([volts]))[0])
        controller.adapt(z)
        text.adapt(z)


def test_without_measurements_a_line_is_no_longer_subtracted() -> None:
    """For 2 s, as beside a motion that repeats: 71.3 Hz in place of 71 Hz would be half a period off by then."""
    plant, stopped = StagePlant(stage(600.0, 0.3), seed=1), []
    controller = AdaptiveController(resonance=600.0, hum=(71.3,), **AXIS)
    plant.open()
    for k in range(40_000):
        measured = float(plant.exchange(np.array([controller.command(10.0, 0.0)]))[0])
        controller.adapt(measured if k < 20_000 else math.nan)
        stopped.append(measured - 10.0)
    assert np.std(stopped[15_000:20_000]) < 0.3 * 0.3 / math.sqrt(2)
    assert np.std(stopped[-5000:]) < 1.1 * 0.3 / math.sqrt(2)


def test_hum_that_is_added_and_removed_on_the_way_makes_no_step() -> None:
    plant = StagePlant(stage(600.0, 0.3), seed=1)
    controller, volts = AdaptiveController(**AXIS), []
    plant.open()
    for k in range(30_000):
        if k in (10_000, 20_000):
            controller.change(hum=LINE if k == 10_000 else 0.0)
        volts.append(controller.command(10.0, 0.0))
        controller.adapt(plant.exchange(np.array([volts[-1]]))[0])
    steps = np.abs(np.diff(volts))
    assert steps[10_000:].max() < 3 * steps[5000:10_000].max() + 0.06  # 0.06 V is the hum in volts


@pytest.mark.parametrize(
    ("known", "f0", "motion"),
    [
        ("f0", 600.0, 0.3),
        ("f0", 1200.0, 3.0),
        ("dynamics", 250.0, 3.0),
        ("dynamics", 600.0, 0.3),
        ("nothing", 1000.0, 3.0),
        ("nothing", 1200.0, 3.0),
    ],
)
def test_a_load_that_nobody_names_is_heard_and_taken_away(known: str, motion: float, f0: float) -> None:
    """0.3 um at 71 Hz, in the last 2 of 4 s."""
    plant = stage(f0, 0.3)
    given = {"f0": {"resonance": f0}, "dynamics": {"dynamics": plant.dynamics()}}.get(known, {})
    error, controller = followed(plant, motion=motion, **given)
    frequency, amplitude = controller.load
    assert frequency == pytest.approx(LINE, abs=1.0)
    assert 0.05 < amplitude < 0.45
    assert "um at 7" in str(controller)
    assert error.std() < 0.35 * 0.3 / math.sqrt(2)


def test_the_verdict_of_a_short_run_names_the_load_and_no_other_cause() -> None:
    plant = stage(600.0, 0.5)
    wave = trajectories.sine(frequency=3.0, peak_to_peak=12.0, offset=10.0, duration=1.5, sample_rate=10_000.0)
    recording = run(wave, AdaptiveController(resonance=600.0, **AXIS), StagePlant(plant, seed=1))
    verdict = judge(recording)
    assert verdict.level == "doubtful"
    (reason,) = verdict.reasons
    words = re.match(r"A load of (.*) Hz and (.*) um shakes the stage: .*`hum = \[(.*)\]` \(Hz\)", reason)
    assert words is not None
    assert [float(number) for number in words.groups()] == [
        pytest.approx(LINE, abs=1.0),
        pytest.approx(0.5, abs=0.1),
        float(words[1]),
    ]


@pytest.mark.parametrize("by_name", [False, True])
def test_the_verdict_of_one_axis_of_several_names_its_load(by_name: bool) -> None:
    """`run` has it of the axis, a run in real time of each one by its name."""
    plant = stage(600.0, 0.5)
    wave = trajectories.sine(frequency=3.0, peak_to_peak=12.0, offset=10.0, duration=1.5, sample_rate=10_000.0)
    recording = run(wave, AdaptiveController(resonance=600.0, **AXIS), StagePlant(plant, seed=1))
    load = recording.metadata["load"]
    recording.metadata.update(axis={"name": "x"}, load={"x": load} if by_name else load)
    assert judge(recording).reasons[0].startswith(f"A load of {load['frequency_hz']:.3g} Hz")


@pytest.mark.parametrize(
    ("f0", "given"),
    [
        (1200.0, {}),
        (300.0, {"resonance": 300.0} | SLOW),
        (300.0, {"dynamics": stage(300.0, 0.0, **SLOW).dynamics()} | SLOW),
    ],
)
def test_the_kernel_hears_with_the_bits_of_the_numpy_text(f0: float, given: dict[str, object]) -> None:
    settings = ControllerSettings(**AXIS | given)
    rate = settings.sample_rate
    wave = trajectories.sine(frequency=3.0, peak_to_peak=12.0, offset=10.0, duration=1.2, sample_rate=rate)
    shaken = stage(f0, 0.3, sample_rate=rate)
    controller = with_the_same_bits(settings, shaken, wave, ticks=round(0.95 * rate), missing=1397)
    assert controller.load[0] == pytest.approx(LINE, abs=1.0)


@pytest.mark.parametrize("known", ["f0", "dynamics"])
@pytest.mark.parametrize("kind", ["sine", "raster", "random"])
def test_no_load_is_heard_where_there_is_none(kind: str, known: str) -> None:
    """What a fast motion leaves repeats with it, and a random one leaves no tone."""
    plant = stage(600.0, 0.0, hysteresis_kind="bouc-wen")
    of = {"duration": 4.0, "sample_rate": 10_000.0}
    moved = {"frequency": 60.0, "peak_to_peak": 12.0, "offset": 10.0, **of}
    wave = {
        "sine": lambda: trajectories.sine(**moved),
        "raster": lambda: trajectories.raster(**moved | {"frequency": 25.0}),
        "random": lambda: trajectories.random_wave(cutoff=40.0, seed=2, **of),
    }[kind]()
    given = {"resonance": 600.0} if known == "f0" else {"dynamics": plant.dynamics()}
    controller = AdaptiveController(**AXIS, **given)
    run(wave, controller, StagePlant(plant, seed=1))
    assert not controller.load[1] > 0.01  # um
