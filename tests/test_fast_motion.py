"""Motion up to half of the resonance: dynamics in the controller, on stages of another structure than its model."""

import dataclasses

import numpy as np
import pytest
from scipy import signal

from truestroke import AdaptiveController, ControllerSettings, Dynamics, Mode, SettingError, run
from truestroke.base.flags import BIT
from truestroke.control import feasibility, stage
from truestroke.control.reference import ReferenceController
from truestroke.plant import StagePlant, StageSettings
from truestroke.signals import trajectories
from truestroke.studies.robustness import fast
from truestroke.studies.robustness.fast.sample import stage_of

RATE = 10_000.0
LIMITS = (-0.6, 3.6)


def followed(plant: StageSettings, frequency: float, duration: float = 2.0, **settings):
    """True error of a sine of 20 um in the second half, um, and the controller."""
    wave = trajectories.sine(
        frequency=frequency, peak_to_peak=20.0, duration=duration, sample_rate=plant.sample_rate, offset=12.0
    )
    controller = AdaptiveController(sample_rate=plant.sample_rate, stroke=24.0, voltage_limits=LIMITS, **settings)
    recording = run(wave, controller, StagePlant(plant, seed=1))
    return (recording["true"] - recording["desired"])[len(wave) // 2 :], controller


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize("kind", ["plays", "preisach", "bouc-wen"])
@pytest.mark.parametrize(("resonance", "damping", "frequency"), [(700.0, 0.02, 350.0), (300.0, 0.005, 100.0)])
def test_known_dynamics_follow_half_the_resonance(kind, resonance, damping, frequency) -> None:
    """0.15 % of p-p, rms; at 100 Hz the third harmonic of the inverse hysteresis meets a resonance of 300 Hz."""
    plant = StageSettings(
        sample_rate=RATE, hysteresis_kind=kind, resonances=(resonance,), dampings=(damping,), voltage_limits=LIMITS
    )
    error, controller = followed(plant, frequency, dynamics=plant.dynamics())
    assert error.std() < 0.03
    assert np.abs(error).max() < 0.12
    assert controller.counters.slewed == controller.counters.rejected == 0


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_a_soft_stage_in_a_fast_loop() -> None:
    """The first sample without the mode is noise, 2,000 times that of the sensor: a law that began with it burst."""
    plant = StageSettings(
        sample_rate=20_000.0, resonances=(80.0,), dampings=(0.004,), voltage_limits=LIMITS, dead_time=7.5e-5,
        noise=0.1, hysteresis_kind="bouc-wen",
    )  # fmt: skip
    error, _ = followed(plant, 30.0, 0.8, dynamics=plant.dynamics())
    assert error.std() < 0.3
    assert np.abs(error).max() < 1.5


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize(("kind", "resonance", "frequency"), [("plays", 600.0, 93.0), ("preisach", 300.0, 90.0)])
def test_the_inertia_is_learned_where_nothing_is_known(kind, resonance, frequency) -> None:
    """0.8 % of p-p, rms, and 0.7 of what the law without the term leaves; the weight is that of the stage."""
    plant = StageSettings(
        sample_rate=RATE, hysteresis_kind=kind, resonances=(resonance,), dampings=(0.015,), voltage_limits=LIMITS
    )
    error, controller = followed(plant, frequency, inertia=True, sensor_delay=1e-9)  # the stage is not looked for
    without, _ = followed(plant, frequency, sensor_delay=1e-9)
    assert error.std() < min(0.16, 0.7 * without.std())
    weight = controller.weights[controller.settings.names.index("inertia")]
    assert -weight == pytest.approx(1 / (2 * np.pi * resonance) ** 2, rel=0.4)


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize("wrong", [0.97, 1.03])
def test_a_resonance_that_is_3_percent_wrong(wrong) -> None:
    plant = StageSettings(sample_rate=RATE, resonances=(700.0,), dampings=(0.01,), voltage_limits=LIMITS)
    right = plant.dynamics()
    modes = (Mode(frequency=700.0 * wrong, damping=0.01),)
    known = Dynamics(sample_rate=RATE, modes=modes, amplifier_bandwidth=right.amplifier_bandwidth)
    error, _ = followed(plant, 233.0, dynamics=known)
    assert error.std() < 0.05


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize("settings", [{"hum": 50.0}, {"hum": 50.0, "feedback": False}, {}, {"feedback": False}])
def test_hum_is_reduced_by_20_db(settings: dict[str, object]) -> None:
    """Of 0.1 um at 50 Hz, beside a slow sine, named or heard: what remains of it after 2 s."""
    plant = StageSettings(sample_rate=RATE, hum=0.1, hum_frequency=50.0, voltage_limits=LIMITS, noise=0.005)
    error, _ = followed(plant, 3.0, 4.0, dynamics=plant.dynamics(), **settings)
    turns = np.exp(-2j * np.pi * 50.0 * np.arange(error.size) / RATE)
    assert 2 * abs(np.mean(error * turns)) < 0.01


def test_a_motion_of_several_frequencies_is_followed_through_the_lag_of_the_amplifier() -> None:
    """Five tones to f0/2 on a stage of 1188 Hz, amplifier of 707 Hz: 0.22 % where the lag was behind the hysteresis."""
    recording = fast.record(1777, 99, "known")
    error = recording["true"] - recording["desired"]
    assert 100 * error[error.size // 2 :].std() / np.ptp(recording["desired"]) < 0.1


def test_the_filters_of_the_stage_are_its_response() -> None:
    """The forward model of the kernel against scipy's simulation of the same transfer function, 20 steps in a tick."""
    dynamics = Dynamics(
        sample_rate=RATE,
        modes=(Mode(frequency=700.0, damping=0.02, share=0.9), Mode(frequency=1900.0, damping=0.03, share=0.1)),
        amplifier_bandwidth=2000.0,
        sensor_bandwidth=3000.0,
        dead_time=2e-4,
    )
    fine, ticks = 100, 300
    u = np.random.Generator(np.random.PCG64(1)).normal(size=ticks)
    u[:5] = 0.0
    time = np.arange(ticks * fine + 1) / (fine * RATE)
    held = np.append(np.repeat(u, fine), u[-1])
    system = dynamics.to_control(pade=0, sensor=True)
    _, out, _ = signal.lsim((system.num[0][0], system.den[0][0]), held, time, interp=False)
    late = np.concatenate([np.zeros(2 * fine), out])[: ticks * fine + 1]
    means = (late[:-1] + late[1:]).reshape(ticks, fine).mean(axis=1) / 2
    known = stage.members(dynamics)
    model, kept = stage.Stage(known, 1), known["dynamics.amplifier"]
    strain = signal.lfilter([1 - kept], [1.0, -kept], u)  # the output of the amplifier at the end of each tick
    found = np.zeros(ticks)
    for k in range(ticks):
        model.strain[k] = strain[k]
        found[k] = model.expected()
        model.notched(found[k])
    assert np.abs(found - means).max() < 2e-3 * np.abs(means).max()


def test_the_law_compares_two_sides_of_one_equation() -> None:
    """A z = (A G)[u] for z = G[u] of two modes, in neither of which anything rings."""
    dynamics = Dynamics(
        sample_rate=RATE,
        modes=(Mode(frequency=200.0, damping=0.004, share=0.86), Mode(frequency=768.0, damping=0.004, share=0.14)),
        amplifier_bandwidth=2000.0,
    )
    ticks = 3000
    u = np.zeros(ticks)
    u[10] = 1.0
    model = stage.Stage(stage.members(dynamics), 1)
    left, right = np.zeros(ticks), np.zeros(ticks)
    for k in range(ticks):
        model.strain[k] = u[k]
        left[k] = model.notched(model.expected())
        right[k] = model.passed(u[k : k + 1])[0]
    assert np.abs(left - right).max() < 2e-3 * np.abs(left).max()
    assert np.abs(np.fft.rfft(right)).max() < 5.0


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_both_modes_jump_by_5_percent() -> None:
    """The twelfth harmonic is between the second mode as measured and as it is: 19 % rms where A leaves that in."""
    stiffer = StageSettings(
        sample_rate=RATE, resonances=(200.0, 768.0), dampings=(0.004, 0.004), shares=(0.86, 0.14),
        hysteresis_kind="plays", voltage_limits=LIMITS, resonance_change=1.05, resonance_change_time=0.8,
    )  # fmt: skip
    dynamics = dataclasses.replace(stiffer, resonance_change=1.0).dynamics()
    error, controller = followed(stiffer, 65.6, dynamics=dynamics)
    assert error.std() < 0.06
    assert controller.resonance == 200.0  # as it was measured: it is not followed
    wave = trajectories.sine(frequency=65.6, peak_to_peak=20.0, duration=0.06, sample_rate=RATE, offset=12.0, ramp=0.02)
    settings = ControllerSettings(sample_rate=RATE, stroke=24.0, voltage_limits=LIMITS, dynamics=dynamics)
    volts = [
        run(wave, make(settings), StagePlant(stiffer, seed=1))["volts"].tolist()
        for make in (AdaptiveController.from_settings, ReferenceController)
    ]
    assert volts[0] == volts[1]


def test_strain_of_a_sine_is_its_inverse() -> None:
    dynamics = Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=1.5e-4)
    time = np.arange(20_000) / RATE
    wave = np.clip(time / 0.5, 0, 1) * np.sin(2 * np.pi * 300.0 * time)
    s = 2j * np.pi * 300.0
    G = np.exp(-1.5e-4 * s) / (1 + 2 * 0.02 * s / (2 * np.pi * 700) + (s / (2 * np.pi * 700)) ** 2)
    wanted = (np.exp(s * time) / (G * np.sinc(300.0 / RATE) ** 2)).imag
    assert np.abs(stage.strain(dynamics, wave) - wanted)[8000:16_000].max() < 1e-3


def test_blocks_of_a_long_motion_join_without_a_seam() -> None:
    """By superposition: what was before a second period of rest moves nothing behind it, wherever a block ends."""
    modes = (Mode(frequency=900.0, damping=0.02, share=0.8), Mode(frequency=1400.0, damping=0.005, share=0.2))
    dynamics = Dynamics(sample_rate=5000.0, modes=modes)
    short = np.zeros(60_000)
    short[20_000:40_000] = 10 - 10 * np.cos(2 * np.pi * np.arange(20_000) / 250)
    expected = stage.strain(dynamics, short)
    for place in (0, 150_000, 216_000, 222_500, 400_000, 640_000):
        long = np.zeros(700_000)
        long[place : place + 60_000] = short
        assert np.abs(stage.strain(dynamics, long)[place : place + 60_000] - expected).max() < 1e-9 * 20


def test_dynamics_that_do_not_fit_are_refused() -> None:
    dynamics = Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),))
    known = {"stroke": 24.0, "voltage_limits": LIMITS}
    with pytest.raises(SettingError, match=r"dynamics.sample_rate = 10000 Hz: must be 5000 Hz.*by `Dynamics.at`"):
        AdaptiveController(sample_rate=5000.0, dynamics=dynamics, **known)
    with pytest.raises(SettingError, match=r"dynamics = 3: must be a Dynamics"):
        AdaptiveController(sample_rate=RATE, dynamics=3, **known)  # type: ignore[arg-type]
    with pytest.raises(SettingError, match='must be None for law = "rls"'):
        AdaptiveController(sample_rate=RATE, law="rls", dynamics=dynamics, **known)


KNOWN = Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),))
AXIS = {"sample_rate": RATE, "stroke": 24.0, "voltage_limits": LIMITS, "dynamics": KNOWN}


def test_a_new_latency_designs_the_feedback_anew_but_not_one_that_was_chosen() -> None:
    designed, off = AdaptiveController(**AXIS), AdaptiveController(**AXIS, feedback=False)
    before = designed.settings.feedback
    designed.change(latency=2), off.change(latency=2)
    assert designed.settings.feedback.latency == 2
    assert designed.settings.feedback.filters != before.filters
    assert off.settings.feedback.filters == ()
    chosen = AdaptiveController(**AXIS, feedback=before)
    chosen.change(trim_rate=1.0)
    assert chosen.settings.feedback == before


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_kernel_and_numpy_text_in_the_loop_of_run() -> None:
    """A motion that raises the slew limit, with preview, and hum that is added on the way: the same to the last bit."""
    wave = trajectories.sine(frequency=300.0, peak_to_peak=20.0, duration=0.1, sample_rate=RATE, offset=12.0, ramp=0.05)
    volts = []
    for make in (AdaptiveController.from_settings, ReferenceController):
        controller = make(ControllerSettings(**AXIS, slew_limit=None))
        plant = StagePlant(StageSettings(sample_rate=RATE, voltage_limits=LIMITS), seed=1)
        first = run(wave, controller, plant)["volts"]
        controller.change(hum=50.0)
        volts.append([*first, *run(wave, controller, plant)["volts"]])
    assert volts[0] == volts[1]


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_kernel_and_numpy_text_where_a_load_is_too_small_for_an_alarm() -> None:
    """After the error has been small for long 0.1 um are no alarm, 0.3 um are: the same to the last bit, flags, too."""
    rate, stage_of = 2500.0, {"resonances": (250.0,), "dampings": (0.02,), "voltage_limits": LIMITS}
    wave = trajectories.sine(frequency=40.0, peak_to_peak=18.0, duration=0.8, sample_rate=rate, offset=12.0, ramp=0.05)
    tick, alarms, volts = np.arange(len(wave)), [], []
    known = Dynamics(sample_rate=rate, modes=(Mode(frequency=250.0, damping=0.02),))
    settings = ControllerSettings(**AXIS | {"sample_rate": rate, "dynamics": known})
    for make in (AdaptiveController.from_settings, ReferenceController):
        plant = StagePlant(
            StageSettings(sample_rate=rate, **stage_of), seed=1, load=0.1 * (tick >= 1700) + 0.3 * (tick >= 1900)
        )
        recording = run(wave, make(settings), plant)
        alarms.append(np.flatnonzero(recording["flags"] & BIT["changed"]).tolist())
        volts.append(recording["volts"].tolist())
    assert volts[0] == volts[1]
    assert alarms[0] == alarms[1]
    assert [k // 100 for k in alarms[1]] == [19]  # with `adaptation.STEADY` = 1 it is [17, 19]


def grows_twice(make):
    """A stage that is found, and an error at 61 Hz that grows to 0.4 % of the motion and vanishes, twice."""
    rate = 1500.0
    wave = trajectories.sine(frequency=20.0, peak_to_peak=20.0, duration=3.4, sample_rate=rate, offset=12.0, ramp=0.05)
    time = np.arange(len(wave)) / rate
    load = 0.04 * np.sin(2 * np.pi * 61.0 * time) * (((time > 1.5) & (time < 2.3)) | ((time > 2.6) & (time < 3.2)))
    plant = StageSettings(sample_rate=rate, resonances=(80.0,), dampings=(0.01,), voltage_limits=LIMITS)
    controller = make(ControllerSettings(sample_rate=rate, stroke=24.0, voltage_limits=LIMITS))
    return run(wave, controller, StagePlant(plant, seed=1, load=load)), controller


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_kernel_and_numpy_text_where_an_error_grows() -> None:
    """Earlier weights are held, and learned on from behind a third pole; the second time they stay: the same bits."""
    (kernel, controller), (text, _) = (grows_twice(x) for x in (AdaptiveController.from_settings, ReferenceController))
    assert kernel["volts"].tolist() == text["volts"].tolist()
    assert kernel["flags"].tolist() == text["flags"].tolist()
    later = np.flatnonzero(np.diff((kernel["flags"][1500:] & BIT["restored"]).astype(int))) + 1501
    assert [round(k / 1500, 1) for k in later] == [2.1, 2.5, 3.1]
    assert controller.counters.restored == 3  # once at the start


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_weights_that_drift_by_a_second_mode_go_back() -> None:
    """Two of the worst runs of the study: 0.97 and 1.14 % rms before, in a sine beside a second mode."""
    for number, most in ((166, 0.35), (66, 0.25)):
        sampled = fast.sample(21, number, ["unknown"])
        controller = AdaptiveController.from_settings(sampled.controllers["unknown"])
        recording = run(sampled.motions["unknown"], controller, StagePlant(stage_of(sampled), sampled.seed))
        error = (recording["true"] - recording["desired"])[len(recording["true"]) // 2 :]
        assert 100 * np.sqrt(np.mean(error**2)) / sampled.sampled["span"]["unknown"] < most


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_kernel_and_numpy_text_where_the_inertia_is_learned() -> None:
    """A stage that rings, and whose oscillation is found: the same to the last bit."""
    wave = trajectories.sine(
        frequency=20.0, peak_to_peak=20.0, duration=0.3, sample_rate=2000.0, offset=12.0, ramp=0.05
    )
    settings = ControllerSettings(sample_rate=2000.0, stroke=24.0, voltage_limits=LIMITS, inertia=True)
    volts = []
    for make in (AdaptiveController.from_settings, ReferenceController):
        plant = StageSettings(sample_rate=2000.0, resonances=(80.0,), dampings=(0.01,), voltage_limits=LIMITS)
        volts.append(run(wave, make(settings), StagePlant(plant, seed=1))["volts"].tolist())
    assert volts[0] == volts[1]


def test_what_a_motion_needs_counts_the_dynamics() -> None:
    """At f0 / 2 the stage moves a third further: a quarter less voltage, and less slew."""
    wave = trajectories.sine(frequency=350.0, peak_to_peak=20.0, duration=0.5, sample_rate=RATE, offset=12.0)
    settings = ControllerSettings(**AXIS)
    plain = feasibility.demands(wave, ControllerSettings(**{**AXIS, "dynamics": None}))
    needs = feasibility.demands(wave, settings)
    assert needs.resonance == 700.0
    assert needs.slew == pytest.approx(0.75 * plain.slew, rel=0.05)


@pytest.mark.parametrize("frequency", [0.001, 0.02, 0.16])
def test_a_stage_that_is_found_is_one_mode_behind_a_tick(frequency) -> None:
    """The members in closed form give the response of the dynamics, whose members are fitted."""
    tick = 2e-4
    dynamics = Dynamics(sample_rate=1 / tick, modes=(Mode(frequency=frequency / tick, damping=0.02),), dead_time=tick)
    get = stage.found(frequency, tick)
    f = np.array([0.1, 0.5, 0.98, 1.5, 2.5]) * frequency / tick
    q = np.exp(-2j * np.pi * f * tick)
    ((b0, b1, a1, a2),), (direct, *none) = get["dynamics.section"], get["dynamics.direct"]
    wanted = dynamics.response(f, sensor=True) / q
    np.testing.assert_allclose(direct + (b0 + b1 * q) / (1 + a1 * q + a2 * q * q), wanted, rtol=1e-4)
    assert not any(none)
    notched = np.polyval(get["dynamics.notch"][::-1], q) * wanted
    np.testing.assert_allclose(np.polyval(get["dynamics.tap"][::-1], q), notched, rtol=1e-4)
    fitted = stage.members(dynamics)
    np.testing.assert_allclose(get["dynamics.quiet"], fitted["dynamics.quiet"], rtol=1e-6)
    np.testing.assert_allclose(get["dynamics.lead"], fitted["dynamics.lead"], rtol=2e-3)


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize(("number", "before"), [(152, 0.0238), (174, 0.0041)])
def test_noise_above_the_first_mode_is_behind_three_poles(number: int, before: float) -> None:
    """% of the motion, rms; `before`: with two poles at 1.2 f0, above which the filter of the stage lets noise grow."""
    recording = fast.record(1777, number, "measured")
    error = recording["true"] - recording["desired"]
    assert 100 * error[error.size // 2 :].std() / np.ptp(recording["desired"]) < before / 1.5


@pytest.mark.parametrize(
    ("known", "seed", "start", "after"),
    [("dynamics", 2, 21.0, 0.26), ("dynamics", 1, 3.2, 17.0), ("f0", 1, 12.0, 15.0)],
)
def test_the_noise_of_a_soft_stage_is_no_jump_where_learning_begins_or_goes_on(known, seed, start, after) -> None:
    """f0 a 300th of the sample rate: `start` and `after` a hold it was so much, % of peak to peak."""
    stage = StageSettings(
        sample_rate=20_000.0, resonances=(65.0,), dampings=(0.02,), hysteresis_kind="preisach", dead_time=1e-4
    )
    wave = trajectories.sine(
        frequency=15.0, peak_to_peak=15.0, offset=10.0, duration=0.7, ramp=0.1, sample_rate=20_000.0
    )
    given = {"dynamics": stage.dynamics()} if known == "dynamics" else {"resonance": 65.0}
    controller = AdaptiveController(
        sample_rate=20_000.0, stroke=stage.stroke, voltage_limits=stage.voltage_limits, **given
    )
    plant, error = StagePlant(stage, seed=seed), []
    plant.open()
    for k in range(wave.position.size):
        if k in (10_000, 11_000):
            (controller.hold if k == 10_000 else controller.resume)()
        volts = controller.command(wave.position[k], wave.velocity[k], wave.acceleration[k])
        controller.adapt(float(plant.exchange(np.array([volts]))[0]))
        error.append(100 / 15.0 * abs(plant.truth[0] - wave.position[k]))
    assert max(error[:4000]) < max(start / 2, 4.5)
    assert max(error[11_000:]) < max(after / 10, 0.5)


@pytest.mark.parametrize("every", [38, 60])
def test_pauses_in_each_half_wave_of_the_stage_do_not_end_all_learning(every: int) -> None:
    """77 ticks are a period of f0: where each pause began the wait anew, the weights stayed those of before."""
    stage = StageSettings(sample_rate=5000.0, resonances=(65.0,), dampings=(0.02,), hysteresis_kind="preisach")
    wave = trajectories.sine(frequency=10.0, peak_to_peak=15.0, offset=10.0, duration=0.3, ramp=0.1, sample_rate=5000.0)
    known = {"stroke": stage.stroke, "voltage_limits": stage.voltage_limits, "dynamics": stage.dynamics()}
    settings = ControllerSettings(sample_rate=5000.0, **known)
    controller, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant, moved = StagePlant(stage, seed=1), 0
    plant.open()
    for k in range(wave.position.size):
        for law in (controller, text):
            (law.hold if k % every == 0 else law.resume)()
        before, motion = controller.weights, (wave.position[k], wave.velocity[k], wave.acceleration[k])
        volts = controller.command(*motion)
        assert text.command(*motion) == volts
        z = float(plant.exchange(np.array([volts]))[0])
        controller.adapt(z)
        text.adapt(z)
        moved += bool(np.any(controller.weights != before))
    assert moved > wave.position.size / 10  # every second tick at most
