"""Iterative learning: on stages of three structures the error falls to the noise, whatever is known wrongly."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import truestroke
from truestroke import Dynamics, IterativeLearning, Mode, SettingError, trajectories
from truestroke.cli import main
from truestroke.control.repeating import periodic_hysteresis
from truestroke.control.repeating.iterative import Learned, repetition
from truestroke.control.repeating.mean import MeanAnswer
from truestroke.control.repeating.response_prior import FewNumbers, beside
from truestroke.control.repeating.steps import finished
from truestroke.model import prior
from truestroke.model.operators import play_history
from truestroke.plant import StagePlant, StageSettings
from truestroke.report.learning import notes
from truestroke.report.learning import page as learning_page
from truestroke.report.learning import rows as learning_rows
from truestroke.runtime import learning as learning_module
from truestroke.runtime.drivers import SimulatedDriver
from truestroke.runtime.drivers.playback import Recorded

FS, LIMITS = 10_000.0, (-0.6, 3.6)
GAIN = 30.0 / 3.6  # um/V of the simulated stage
KNOWN = {"gain": GAIN, "voltage_limits": LIMITS}


def dynamics(f0, damping=0.01, rate=FS):
    return Dynamics(sample_rate=rate, modes=(Mode(frequency=f0, damping=damping),), amplifier_bandwidth=3000.0)


class Stage:
    """A stage that plays periods: settles for 0.15 s, and measures 0.25 s of them."""

    def __init__(self, f0, kind="preisach", damping=0.01, **others):
        two = {"resonances": (f0, 2.9 * f0), "dampings": (damping, 0.01), "shares": (0.95, 0.05)}
        self.plant = StagePlant(StageSettings(hysteresis_kind=kind, **two, **others), seed=3)
        self.plant.open()

    def play(self, volts):
        """What was measured, and the true displacement, um, shape (periods, samples)."""
        settle, count = (max(2, int(np.ceil(s * FS / volts.size))) for s in (0.15, 0.25))
        wave = np.tile(volts, settle + count)
        part = slice(settle * volts.size, None)
        measured = self.plant.exchange(wave)[part].reshape(count, -1)
        return measured, self.plant.truth[part].reshape(count, -1)


def raster(frequency, duration=1.0, peak_to_peak=20.0):
    return trajectories.raster(
        frequency=frequency, peak_to_peak=peak_to_peak, duration=duration, sample_rate=FS, offset=12.0
    )


def true_errors(stage, learned, wave, passes):
    """Rms of each pass where it counts, against the motion itself, % of peak-to-peak."""
    samples = learned.samples
    start = int(np.ceil(0.25 * FS / samples)) * samples
    desired, counts = (one[start : start + samples] for one in (wave.position, wave.flat))
    found = []
    for _ in range(passes):
        measured, true = stage.play(learned.volts)
        learned.learn(measured)
        found.append(100 * np.std((true.mean(axis=0) - desired)[counts]) / wave.settings["peak_to_peak"])
    return np.array(found)


# ---- Stages --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frequency", "f0", "known", "kind"),
    [(20.0, 900.0, 1.03, "preisach"), (50.0, 900.0, 0.97, "bouc-wen"), (50.0, 400.0, 1.03, "plays")],
)
def test_five_passes_leave_a_twentieth_of_a_percent_with_a_wrong_resonance(frequency, f0, known, kind):
    wave = raster(frequency)
    stage = Stage(f0, kind, damping=0.02, dead_time=1e-4)  # a tick that the dynamics do not have
    learned = IterativeLearning(wave, dynamics=dynamics(known * f0, 0.02), **KNOWN)
    errors = true_errors(stage, learned, wave, 7)
    assert errors[0] > 3.0
    assert errors[5:].max() < 0.05
    assert np.all(errors <= errors[0])


@pytest.mark.parametrize("gain", [0.3, 3.0])
def test_a_gain_that_is_three_times_wrong_costs_one_pass(gain):
    wave = raster(50.0)
    stage = Stage(900.0)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0), **{**KNOWN, "gain": gain * GAIN})
    assert true_errors(stage, learned, wave, 8)[-1] < 0.05


def test_a_change_of_gain_is_learned_again_in_five_passes():
    wave = raster(50.0)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0), **KNOWN)
    assert true_errors(Stage(900.0), learned, wave, 7)[-1] < 0.05
    errors = true_errors(Stage(900.0, stroke=31.5), learned, wave, 6)
    assert errors[0] > 1.0
    assert errors[-1] < 0.05


def test_a_motion_near_the_resonance_is_learned_too():
    wave = trajectories.sine(frequency=400.0, peak_to_peak=10.0, offset=12.0, duration=1.0, sample_rate=FS)
    stage = Stage(900.0)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0 * 1.03), **KNOWN)
    for _ in range(8):
        made = learned.learn(stage.play(learned.volts)[0])
    assert made.rmse < 0.001 * 10.0 + made.noise


@pytest.mark.parametrize(
    ("frequency", "kind", "known", "late", "damping"),
    [
        (200.0, "plays", 1.022, 0.0, 0.019),
        (200.0, "bouc-wen", 1.029, 0.0, 0.027),
        (100.0, "bouc-wen", 0.993, 1e-4, 0.017),
    ],
)
def test_hysteresis_that_moves_much_to_other_harmonics_needs_five_passes(frequency, kind, known, late, damping):
    """Stages that kept 0.06 to 0.18 % while what hysteresis moves was noise."""
    wave, stage = raster(frequency), Stage(900.0, kind, damping=damping, dead_time=late)
    learned = IterativeLearning(wave, dynamics=dynamics(known * 900.0, damping), **KNOWN)
    assert true_errors(stage, learned, wave, 6)[5] < 0.05


# ---- The hysteresis of the first pass --------------------------------------------------------------------------------


def test_plays_of_a_period_are_those_of_many():
    """Those of the definition, after so many periods that the start is forgotten; also of a play that never moves."""
    x, r = np.random.Generator(np.random.PCG64(1)).normal(size=150).cumsum(), np.array([0.0, 0.3, 2.0, 5.0])
    r = np.append(r[r < np.ptp(x) / 2], np.ptp(x))
    found = finished(periodic_hysteresis.plays(x, r))
    assert np.array_equal(found[:-1], play_history(np.tile(x, 3), r[:-1])[-150:].T)
    assert np.ptp(found[-1]) < 1e-12


def shown(weights, f0=900.0, known=930.0, samples=100):
    """What a pass shows of a stage behind these plays: its voltage, their strain, and the model."""
    t = np.arange(samples) / samples
    volts = 1.5 - np.cos(2 * np.pi * t) - 0.05 * np.cos(6 * np.pi * t)
    f = np.fft.rfftfreq(samples, 1 / FS)
    G, stage = (
        dynamics(known).response(f),
        dynamics(f0).response(f) * np.exp(-2j * np.pi * f / FS),
    )  # a tick that nobody knows
    few = FewNumbers(dynamics(known), f, FS, beside(f, known, 2000.0))
    r = np.array(prior.thresholds(periodic_hysteresis.PLAYS, float(np.ptp(volts))))
    strain = weights @ finished(periodic_hysteresis.plays(volts, r[: weights.size]))
    about = {"few": few, "learned": f <= 2000.0, "periods": 1}
    model = finished(
        periodic_hysteresis.identified(volts, stage * np.fft.rfft(strain), G, np.full(f.size, 1e-6), **about)
    )
    return volts, strain, model


def bouc_wen(volts):
    """Strain of a period that has repeated, V: z' = x' (1 - |z| (0.5 sign(x' z) + 0.5)), in small steps of its own."""
    fine = np.interp(np.arange(40 * volts.size) / 40.0, np.arange(volts.size + 1), np.append(volts, volts[0]))
    z, states = 0.0, []
    for _ in range(3):
        states = []
        for change in np.diff(fine, append=fine[0]).tolist():
            states.append(z)
            z += 4.0 * change * (1.0 - abs(z) * (0.5 * np.sign(change * z) + 0.5))
    return volts - 0.15 * np.array(states[::40])


def test_a_change_of_the_voltage_shows_how_hysteresis_of_another_structure_answers_the_next_one():
    """Bouc-Wen, which is no sum of plays: one loop alone does not show what a small change does."""
    n, f = 100, np.fft.rfftfreq(100, 1e-4)
    at = 2 * np.pi * np.arange(n) / n
    base = 1.5 - 1.2 * np.cos(at)
    first, second = base + 0.03 * np.cos(7 * at + 0.5), base + 0.02 * np.cos(5 * at)
    few = FewNumbers(None, f, 10_000.0, np.full(f.size, 1e-4))
    about = {"few": few, "learned": f <= 1500.0, "periods": 1}
    answers = {x.tobytes(): np.fft.rfft(bouc_wen(x)) for x in (base, first, second)}
    G, noise2 = np.ones(f.size, dtype=complex), np.full(f.size, 1e-8)

    def wrong(others):
        """Error of what the model says the second change does, over it, at the harmonics that are learned."""
        model = finished(
            periodic_hysteresis.identified(base, answers[base.tobytes()], G, noise2, **about, others=others)
        )
        said = np.fft.rfft(finished(model.strain(second)) - finished(model.strain(base)))[1:16]
        is_ = (answers[second.tobytes()] - answers[base.tobytes()])[1:16]
        return np.linalg.norm(said - is_) / np.linalg.norm(is_)

    alone, together = wrong([]), wrong([(first, answers[first.tobytes()], noise2)])
    assert together < 0.7 * alone


@pytest.mark.parametrize("width", [0.0, 0.1, 0.3])
def test_the_first_pass_shows_the_width_of_the_loop(width):
    """A tick of dead time looks like a loop at the frequency of the motion alone; of a fast motion it is as wide."""
    r = prior.thresholds(periodic_hysteresis.PLAYS, 2.0)
    weights = np.append(1 - width, np.full(len(r) - 1, width / (len(r) - 1)))
    volts, strain, model = shown(weights)
    missed = finished(model.strain(volts)) - strain
    assert np.std(missed) < 0.03 * np.std(strain)


def test_the_inverse_makes_the_strain_and_moves_no_other_harmonic():
    volts, _, model = shown(np.array([0.7, 0.1, 0.1, 0.1]))
    moved = np.arange(volts.size // 2 + 1) < 20
    wanted = np.fft.rfft(finished(model.strain(volts))) + np.where(moved, 1.0, 0.0) * (np.arange(moved.size) == 7)
    found = finished(model.volts(np.fft.irfft(wanted, volts.size), volts, moved))
    left = np.fft.rfft(finished(model.strain(found))) - wanted
    assert np.abs(left[moved]).max() < 1e-6
    assert np.abs(np.fft.rfft(found - volts)[~moved]).max() < 1e-9
    assert np.abs(found - volts).max() > 0.01


# ---- The law -------------------------------------------------------------------------------------------------------


def frequencies(learned):
    """Of the harmonics of a repetition, Hz."""
    return np.fft.rfftfreq(learned.samples, 1 / learned.sample_rate)


def linear(learned, G):
    """The measurement of a linear stage with these responses at the harmonics, um/V."""
    return np.fft.irfft(G * np.fft.rfft(learned.volts), learned.samples)


@settings(max_examples=6, deadline=None)
@given(
    gain=st.floats(0.3, 3.0),
    late=st.floats(0.0, 1.0),
    f0=st.floats(0.93, 1.07),
    damping=st.floats(0.005, 0.1),
    frequency=st.sampled_from([10.0, 25.0, 50.0, 100.0]),
)
def test_no_linear_stage_makes_it_diverge(gain, late, f0, damping, frequency):
    """Gain, dead time, resonance and damping of another stage: the error falls to a hundredth, and never rises much."""
    wave = trajectories.raster(frequency=frequency, peak_to_peak=10.0, duration=1.0, sample_rate=FS)
    learned = IterativeLearning(wave, dynamics=dynamics(800.0, 0.02), gain=5.0, voltage_limits=(-10.0, 15.0))
    f = frequencies(learned)
    G = gain * 5.0 * dynamics(800.0 * f0, damping).response(f) * np.exp(-2j * np.pi * f * late / FS)
    errors = [learned.learn(np.tile(linear(learned, G), (2, 1))).rmse for _ in range(14)]
    assert min(errors) < 0.01 * errors[0] + 1e-9
    assert max(errors[1:]) < 1.5 * errors[0]
    assert learned.best == pytest.approx(min(errors), abs=1e-4)


def test_what_hysteresis_makes_at_the_resonance_is_no_response():
    """The ninth harmonic meets the resonance. Its R was taken for a tenth of what it is, and the error grew tenfold."""
    wave = raster(100.0)
    stage = Stage(900.0, "bouc-wen", damping=0.02243, dead_time=1e-4)
    known = Dynamics(sample_rate=FS, modes=(Mode(frequency=0.9834 * 900.0, damping=0.02243),))
    errors = true_errors(stage, IterativeLearning(wave, dynamics=known, **KNOWN), wave, 8)
    assert errors.argmax() == 0
    assert errors[-1] < 0.05


def test_what_was_learned_of_the_response_is_forgotten_where_only_it_has_changed(monkeypatch):
    """The best pass comes again, and is as good as it was: the stage is the same, R was wrong."""
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    law, G = learned._law, GAIN * dynamics(930.0).response(frequencies(learned))

    def play():
        return learned.learn(np.tile(linear(learned, G), (2, 1)))

    def wrong(before, after):
        law._shown = np.full(law.ratio.size, 0.02e6 + 0j), np.full(law.ratio.size, 1e6)  # R = 0.02, surely
        yield
        law.know()
        return False

    first = play()
    with monkeypatch.context() as here:
        here.setattr(law, "_estimate", wrong)
        second = play()
    best = min(first, second, key=lambda one: one.rmse)
    worse, again, *others = (play() for _ in range(8))
    assert worse.undone
    assert worse.rmse > first.rmse
    volts, its = again.volts - again.volts.mean(), best.volts - best.volts.mean()
    assert volts == pytest.approx(its, abs=1e-5), "but for the mean"
    assert not again.undone
    assert min(one.rmse for one in others) < 0.1 * best.rmse
    assert max(one.rmse for one in others) < 2 * second.rmse  # 1.4 to 1.65 times: rounding decides, of another CPU


def test_a_mode_beyond_the_bandwidth_that_hysteresis_excites_is_learned():
    """The 13th harmonic meets the second mode, at 2610 Hz, which nobody has given; a bandwidth that is given holds."""
    wave, left = raster(200.0), []
    for bandwidth in (None, 2160.0):
        stage = Stage(900.0, "bouc-wen", damping=0.025)
        learned = IterativeLearning(wave, dynamics=dynamics(900.0, 0.025), bandwidth=bandwidth, **KNOWN)
        true_errors(stage, learned, wave, 12)
        spectrum = np.abs(np.fft.rfft(stage.play(learned.best_volts)[1].mean(axis=0))) * 2 / learned.samples
        left.append(spectrum[13])
        beyond = np.abs(np.fft.rfft(learned.best_volts))[12:]
        assert (beyond.max() > 1e-9) == (bandwidth is None)
    assert left[0] < 0.2 * left[1]
    assert left[1] > 0.005, "um, else the test shows nothing"


@pytest.mark.parametrize(
    ("cycles", "words"),
    [
        (5, "at 100 Hz, which is no harmonic of the motion"),
        (150, "at 3000 Hz, beyond the bandwidth of 2160 Hz: choose a frequency"),
    ],
)
def test_where_the_error_is_that_is_not_learned(cycles, words):
    """60 Hz at 10 kHz repeats after 500 samples, three periods: multiples of 20 Hz are measured, of 60 Hz learned.

    Where no bandwidth was given passes learn beyond it, as far as they can: to raise it is no remedy.
    """
    learning = IterativeLearning(raster(60.0), dynamics=dynamics(900.0), **KNOWN)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (6, 500))
    error = 0.2 * np.sin(2 * np.pi * cycles * np.arange(500) / 500)
    made = learning.learn(learning.desired + error + noise)
    (reason,) = Learned(passes=(made,), learning=learning).verdict.reasons
    assert words in reason
    assert (cycles == 150) == ("such as 59.88024 Hz" not in reason)
    assert repetition(FS, 59.88024) == (167, 1), "it is taken as it is written"


def test_a_mean_that_creeps_is_not_said_to_be_beyond_the_bandwidth():
    """At 100 kHz the noise of all harmonics that are not learned is more than the error of those that are."""
    rate, random = 100_000.0, np.random.default_rng(5)
    wave = trajectories.raster(frequency=50.0, peak_to_peak=10.0, offset=12.0, duration=1.0, sample_rate=rate)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0, rate=rate), **KNOWN)
    measured = np.tile(learned.desired, (10, 1)) + 0.13 + 0.01 * random.standard_normal((10, learned.samples))
    made = Learned(passes=(learned.learn(measured + 1.0), learned.learn(measured)), learning=learned)
    assert "Most of it" not in " ".join(made.verdict.reasons)
    assert "times the noise" in made.verdict.reasons[0]


def test_an_error_that_falls_no_longer_is_not_promised_to_fall():
    """Whatever is put out the stage does the same, as one does within a step of its converter."""
    learning = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (6, 200))
    passes = ()
    for error in (2.0, *5 * (0.2,)):
        wave = error * np.sin(2 * np.pi * 3 * np.arange(200) / 200)
        passes += (learning.learn(learning.desired + wave + noise),)
    reason = Learned(passes=passes[:3], learning=learning).verdict.reasons[0]
    assert "more passes will lower it" in reason
    reason = Learned(passes=passes, learning=learning).verdict.reasons[0]
    assert "more will not lower it. Look for steps of the converter" in reason


def test_a_resonance_that_is_far_off_is_learned_from_the_way_back_to_the_best_pass():
    """The fifth harmonic is at f0, which is given 15 % too high with a third of its damping: 6.3 % stayed."""
    wave = raster(FS / 251)
    learned = IterativeLearning(wave, dynamics=dynamics(230.0, 0.0084), **KNOWN)
    errors = true_errors(Stage(200.0, "plays", damping=0.028, dead_time=1e-4), learned, wave, 7)
    assert errors[0] > 5.0
    assert errors[-1] < 0.1


@pytest.mark.parametrize(
    ("share", "level"), [(0.2, "doubtful"), (0.02, "doubtful"), (0.005, "doubtful"), (0.001, "good")]
)
def test_a_motion_that_is_hidden_by_the_noise_is_not_good(share, level):
    """An error within the noise shows nothing where the motion is hardly larger."""
    learning = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    span = np.ptp(learning.desired)
    noise = np.random.default_rng(1).normal(0.0, share * np.sqrt(6) * span, (6, learning.samples))
    made = learning.learn(learning.desired + noise)
    verdict = Learned(passes=(made,), learning=learning).verdict
    assert verdict.level == level
    assert ("no pass shows whether it was learned" in " ".join(verdict.reasons)) == (level == "doubtful")


def test_a_pass_that_is_worse_is_undone_and_its_voltage_left():
    wave = raster(50.0)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0), **KNOWN)
    stage = Stage(900.0)
    for _ in range(4):
        learned.learn(stage.play(learned.volts)[0])
    best, volts = learned.best, learned.best_volts
    made = learned.learn(stage.play(learned.volts)[0] + 0.5 * np.sin(np.arange(200) * 2 * np.pi / 200))
    assert "undone" in made.undone
    assert made.verdict.level == "doubtful"
    assert learned.best == best
    assert np.array_equal(learned.best_volts, volts)
    learned.learn(stage.play(learned.volts)[0])  # and it goes on from there; the mean was still of the disturbance
    assert learned.learn(stage.play(learned.volts)[0]).rmse < 2 * best


@pytest.mark.parametrize(("sense", "most"), [(1, 0.06), (-1, 0.12)])
def test_the_creep_of_the_mean_is_foreseen(sense, most):
    """0.1 um from each pass to the next, um: what is not foreseen remains. Where it has no lasting sense none is."""
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    G, zero = GAIN * dynamics(900.0).response(frequencies(learned)), 0.0
    noise = np.random.Generator(np.random.PCG64(2))
    for number in range(10):
        zero += 0.1 * sense**number
        made = learned.learn(linear(learned, G) + zero + noise.normal(scale=0.01, size=(2, learned.samples)))
        assert not made.undone
        assert number < 4 or abs(made.error.mean()) < most


class FromRest:
    """A driver whose stage begins each pass at rest, by its own clock, as one that waited."""

    def __init__(self, stage):
        self.stage = stage

    def open(self):
        return self.stage.open()

    def playback(self, volts, rate):
        self.stage.open()
        return Recorded(volts, self.stage.exchange(volts[0])[None, :], rate)

    def start(self, volts=None): ...

    exchange = stop = close = rescue = start

    def describe(self):
        return {}


@pytest.mark.parametrize("kind", ["plays", "preisach", "bouc-wen"])
@pytest.mark.parametrize("width", [0.08, 0.18])
def test_the_mean_is_learned_as_fast_as_the_motion(kind, width):
    """It answers up to 1.7 times what the motion does: with the gain of the motion a pass left a quarter to a half."""
    stage = StagePlant(StageSettings(resonances=(900.0,), hysteresis_kind=kind, loop_width=width), seed=1)
    about = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1, "settle": 0.2}
    found = truestroke.learn(FromRest(stage), raster(50.0), dynamics=dynamics(900.0, 0.02), passes=5, **about)
    mean = [abs(one.error.mean()) for one in found.passes]
    assert mean[2] < 0.03 * mean[0]
    assert mean[-1] < 0.0005 * 20.0
    assert found.passes[-1].rmse < 0.0005 * 20.0


@pytest.mark.parametrize(("ratio", "side"), [(1.0, 1.0), (1.3, 1.0), (1.8, 1.0), (1.4, -1.0), (1.0, 0.0)])
def test_the_mean_hangs_on_the_turn_that_is_further_from_rest(ratio, side):
    """A loop that becomes higher moves its mean away from rest."""
    answer = MeanAnswer(20.0)
    answer.begin(side * 12.0, 10.0, ratio * (side * 12.0 + side * 10.0) - side * 10.0)
    assert answer.side == side
    error, height = -3.0 * side - 1.0, 1.0
    for _ in range(4):
        mean = answer.change(error, height)
        made = ratio * (mean + side * height) - side * height
        answer.see(mean, height, made)
        error, height = error - made, 0.1 * height
    assert abs(error) < 0.01
    assert answer.ratio == pytest.approx(ratio, abs=0.06) or side == 0


def test_a_zero_that_jumps_is_no_answer_of_the_mean():
    answer = MeanAnswer(20.0)
    answer.begin(12.0, 10.0, 12.0)
    answer.see(-0.5, 0.0, -0.5)
    before = answer.ratio
    answer.see(0.01, 0.0, 2.0)
    assert answer.ratio == pytest.approx(before, abs=0.05)
    assert answer.foreseen < 0.1


def test_a_missed_pass_changes_nothing():
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    stage = Stage(900.0)
    learned.learn(stage.play(learned.volts)[0])
    volts = learned.volts
    lost = np.full((3, 200), np.nan)
    for measured in (None, lost):
        assert "missed" in learned.learn(measured).undone
        assert np.array_equal(learned.volts, volts)


def test_lost_samples_are_taken_from_the_other_periods():
    wave, true = raster(50.0), dynamics(900.0)
    a, b = (IterativeLearning(wave, dynamics=true, **KNOWN) for _ in range(2))
    z = np.tile(linear(a, GAIN * true.response(frequencies(a))), (4, 1))
    holes = z.copy()
    holes[1, 20:60] = holes[3, 150:] = np.nan
    assert np.allclose(a.learn(z).measured, b.learn(holes).measured)
    assert np.allclose(a.volts, b.volts)


def test_spikes_do_not_spoil_a_pass():
    """1 % of the samples, 5 um off: 0.5 % of the motion was the noise that no pass took away."""
    stage, wave, random = Stage(900.0), raster(50.0), np.random.default_rng(4)
    learned, made = IterativeLearning(wave, dynamics=dynamics(900.0), **KNOWN), []
    for _ in range(6):
        measured, _ = stage.play(learned.volts)
        measured[random.random(measured.shape) < 0.01] += 5.0
        made.append(learned.learn(measured))
    assert made[-1].rmse < 0.0005 * 20.0
    assert 0.005 < made[-1].spikes < 0.015


def test_periods_that_are_others_are_no_spikes():
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    measured, _ = Stage(900.0).play(learned.volts)
    late = measured.copy()
    late[-3:] = np.roll(measured[-3:], 5, axis=1)  # a trigger that was late from there on
    assert learned.learn(late).spikes == 0


@pytest.mark.parametrize(("limits", "words"), [((0.0, 9.0), "The lowest voltage, 0 V,"), ((-9.0, 1.9), "highest")])
def test_the_limit_that_holds_is_named_with_its_remedy(limits, words):
    """A motion from 0 um needs voltages below 0 V, where the hysteresis is on its way back."""
    learned = IterativeLearning(raster(50.0), gain=10.0, voltage_limits=limits, dynamics=dynamics(900.0))
    stage = Stage(900.0)
    for _ in range(3):
        made = learned.learn(stage.play(learned.volts)[0])
    reason = made.verdict.reasons[-1]  # behind that of a pass that was undone
    assert words in reason
    assert "(`offset`), or make it smaller" in reason


def test_voltage_and_slew_stay_within_their_limits():
    wave = raster(100.0)
    tight = {"gain": 10.0, "voltage_limits": (0.0, 2.2), "slew_limit": 800.0}
    learned = IterativeLearning(wave, dynamics=dynamics(900.0), **tight)
    stage = Stage(900.0)
    passes = []
    for _ in range(5):
        made = learned.learn(stage.play(learned.volts)[0])
        passes.append(made)
        steps = np.diff(made.volts, append=made.volts[:1])
        assert made.volts.min() >= 0.0
        assert made.volts.max() <= 2.2
        assert np.abs(steps).max() * FS <= 800.0 * (1 + 1e-9)
    assert made.limited > 0.05
    assert "The highest voltage, 2.2 V, holds" in " ".join(made.verdict.reasons)
    assert "more passes" not in " ".join(Learned(passes=tuple(passes), learning=learned).verdict.reasons)


@pytest.mark.parametrize(("highest", "level"), [(1.3, "bad"), (2.2, "doubtful")])
def test_a_motion_of_which_a_limit_cuts_off_much_is_bad(highest, level):
    """It was doubtful, with exit code 0."""
    learned = IterativeLearning(raster(20.0), dynamics=dynamics(900.0), gain=10.0, voltage_limits=(0.0, highest))
    stage = Stage(900.0)
    made = Learned(passes=tuple(learned.learn(stage.play(learned.volts)[0]) for _ in range(3)), learning=learned)
    assert made.verdict.level == level, made.best.rmse / np.ptp(learned.desired)
    assert any("The highest voltage" in reason for reason in made.verdict.reasons)


def test_errors_in_the_turns_do_not_count():
    """The learned motion follows the lines of a fast raster three times better than the harmonics alone would."""
    wave = raster(200.0)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0), **KNOWN)
    _, harmonics = learned.harmonics
    period = wave.position[2500:2550]
    kept = np.fft.rfft(period)
    kept[1:][~harmonics[1:]] = 0.0
    off = [np.std((x - period)[learned.counts]) for x in (learned.desired, np.fft.irfft(kept, 50))]
    assert off[0] < off[1] / 3


# ---- What is refused -----------------------------------------------------------------------------------------------


def test_what_does_not_repeat_is_refused():
    wave = trajectories.random_wave(duration=2.0, sample_rate=FS)
    with pytest.raises(SettingError, match="a random wave: must be a motion that repeats"):
        IterativeLearning(wave, dynamics=dynamics(900.0), **KNOWN)
    with pytest.raises(SettingError, match="a motion that rests"):
        IterativeLearning(np.ones(100), FS, dynamics=dynamics(900.0), **KNOWN)
    with pytest.raises(SettingError, match="sample_rate = None Hz: must be that of the array"):
        IterativeLearning(np.arange(100.0), dynamics=dynamics(900.0), **KNOWN)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slew_limit": 100.0}, r"slew_limit = 100.0 V/s: must be at least \d+"),
        ({"dynamics": None}, "bandwidth"),
        ({"dynamics": dynamics(40.0)}, "frequency of the motion = 100.0 Hz: must be at most 96 Hz"),
        ({"dynamics": dynamics(900.0, rate=5000.0)}, "5000"),
        ({"bandwidth": 10.0}, "bandwidth = 10.0"),
        ({"gain": 0.0}, "gain = 0"),
    ],
)
def test_bad_arguments_name_what_is_needed(change, message):
    with pytest.raises(SettingError, match=message):
        IterativeLearning(raster(100.0), **{"dynamics": dynamics(900.0), **KNOWN, **change})


def test_a_pass_that_was_cut_short_is_refused_and_nothing_is_lost():
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    volts = learned.volts
    with pytest.raises(SettingError, match="301 samples: must be a whole number of periods of 200"):
        learned.learn(np.zeros(301))
    with pytest.raises(SettingError, match=r"measured = 'x.csv'.* um: must be an array of numbers"):
        learned.learn("x.csv")
    assert learned.volts is volts


@pytest.mark.parametrize("sign", [-1.0, 0.01])
def test_a_sensor_that_goes_the_other_way_or_hardly_at_all_is_refused(sign):
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    z = sign * linear(learned, GAIN * dynamics(900.0).response(frequencies(learned)))
    with pytest.raises(SettingError, match="within ten times of it, and of its sign"):
        learned.learn(np.tile(z, (2, 1)))


def test_a_sensor_that_turns_its_sign_while_it_is_learned_is_refused_and_the_best_voltage_stays():
    """The law took it for another stage, whose plays had no weight: after some passes each voltage was NaN."""
    stage, learned = Stage(900.0), IterativeLearning(raster(50.0), dynamics=dynamics(870.0), **KNOWN)
    for _ in range(4):
        learned.learn(stage.play(learned.volts)[0])
    one = learned.learn(24.0 - stage.play(learned.volts)[0])
    assert one.undone
    again = learned.volts
    with pytest.raises(SettingError, match="measured = against the voltage, two passes in a row: must be of a sensor"):
        learned.learn(24.0 - stage.play(learned.volts)[0])
    assert learned.volts is again
    assert learned.learn(stage.play(learned.volts)[0]).rmse < 0.05


@pytest.mark.parametrize(("spoilt", "why"), [
    (lambda z: np.roll(z, 33), "33 samples, 0.0033 s, too late"),
    (lambda z: np.roll(z, -15), "15 samples, 0.0015 s, too early"),
    (lambda z: 24.0 - z, "against the voltage"),
])  # fmt: skip
@pytest.mark.parametrize("number", [1, 3])
def test_a_pass_whose_record_is_not_that_of_its_voltage_counts_for_nothing(spoilt, why, number):
    """The law took it for what the stage does, and stayed at a hundredth of the motion."""
    stage, learned = Stage(900.0), IterativeLearning(raster(50.0), dynamics=dynamics(870.0), **KNOWN)
    for _ in range(number):
        learned.learn(stage.play(learned.volts)[0])
    volts = learned.volts
    missed = learned.learn(spoilt(stage.play(volts)[0]))
    assert missed.missed == f"it was {why}"
    assert not missed.measured.size
    assert learned.volts is volts
    for _ in range(6 - number):
        made = learned.learn(stage.play(learned.volts)[0])
    assert made.rmse < 0.01


@pytest.mark.parametrize(("by", "why"), [
    (10, "9.9 samples, 0.00099 s, too late for its voltage"),
    (33, "too late for its voltage"),
    (-15, "too early for its voltage"),
])  # fmt: skip
@pytest.mark.parametrize(("frequency", "kind"), [(20.0, "plays"), (50.0, "preisach"), (100.0, "bouc-wen")])
def test_a_first_record_that_is_late_for_its_voltage_costs_one_pass(by, why, frequency, kind):
    """It cost three and more; some were refused for their gain, and one stage was never learned again."""
    by = by if frequency > 20.0 else 3 * by  # less than 2 % of the period is what hysteresis may do
    stage, learned = Stage(900.0, kind), IterativeLearning(raster(frequency), dynamics=dynamics(918.0), **KNOWN)
    volts = learned.volts
    missed = learned.learn(np.roll(stage.play(volts)[0], by, axis=1))
    assert "for its voltage" in missed.missed
    assert why.split(", ")[-1] in missed.missed
    assert learned.volts is volts
    made = [learned.learn(stage.play(learned.volts)[0]) for _ in range(5)]
    assert not any(one.missed for one in made)
    assert made[-1].rmse < 0.02


def test_a_first_record_that_is_late_twice_shows_a_dead_time():
    stage, learned = Stage(900.0, dead_time=1.2e-3), IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    passes = [learned.learn(stage.play(learned.volts)[0]) for _ in range(9)]
    assert [bool(one.missed) for one in passes] == [True] + 8 * [False]
    assert learned.dead_time == pytest.approx(1.2e-3, abs=2e-4)
    assert passes[-1].rmse < 0.02
    found = Learned(passes=tuple(passes), learning=learned)
    assert not any("missed" in reason for reason in found.verdict.reasons)
    assert "turn 1.1 ms later than voltage and dynamics say" in notes(found)[0]


def test_the_page_of_passes_whose_first_one_was_missed_begins_with_the_next():
    """It was a ValueError: cannot convert float NaN to integer."""
    stage, learned = Stage(900.0), IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    z = stage.play(learned.volts)[0]
    passes = [learned.learn(np.roll(z, 30, axis=1)), learned.learn(z)]
    found = Learned(passes=tuple(passes), learning=learned)
    assert "first pass" in learning_page(found).html()
    assert learning_rows(found)[0][-1] == "missed"


def test_first_records_that_begin_elsewhere_each_time_are_refused():
    stage, learned = Stage(900.0), IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    z = stage.play(learned.volts)[0]
    learned.learn(np.roll(z, 30, axis=1))
    with pytest.raises(SettingError, match=r"= 1[56] samples, .* too early, after (29|30) samples, .* too late: must"):
        learned.learn(np.roll(z, -15, axis=1))


def test_a_trigger_that_has_another_place_from_now_on_is_refused_and_the_best_voltage_stays():
    stage, learned = Stage(900.0), IterativeLearning(raster(50.0), dynamics=dynamics(870.0), **KNOWN)
    for _ in range(3):
        learned.learn(stage.play(learned.volts)[0])
    best = learned.best_volts
    learned.learn(np.roll(stage.play(learned.volts)[0], 12))
    with pytest.raises(SettingError, match=r"^measured = 12 samples, 0\.0012 s, too late, two passes in a row: must"):
        learned.learn(np.roll(stage.play(learned.volts)[0], 12))
    assert learned.best_volts is best
    with pytest.raises(SettingError, match=r"^measured = 7 samples, .* too early, after 12 .* too late, two passes in"):
        learned.learn(np.roll(stage.play(learned.volts)[0], -7))
    assert learned.learn(stage.play(learned.volts)[0]).rmse < 0.05


def test_a_sine_shows_no_time_and_is_learned_again_where_the_stage_has_changed():
    stage = Stage(900.0)
    wave = trajectories.sine(frequency=50.0, peak_to_peak=20.0, offset=12.0, duration=1.0, sample_rate=FS)
    learned = IterativeLearning(wave, dynamics=dynamics(900.0), **KNOWN)
    for _ in range(4):
        learned.learn(stage.play(learned.volts)[0])
    assert not learned.learn(np.roll(stage.play(learned.volts)[0], 3)).missed


def test_plays_that_all_go_against_the_voltage_leave_one_without_a_loop():
    """Their sum is what the others are divided by: each voltage of the model was NaN."""
    assert periodic_hysteresis._rising(np.array([-0.5, -0.2, 0.0, 0.1, 0.3])).tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (lambda z: np.minimum(z, 19.0), r"% of the samples at 19 um, while the voltage goes on: must be of a sensor"),
        (
            lambda z: np.minimum(z, 19.0) + np.random.default_rng(1).normal(0.0, 0.01, z.shape),
            "% of the samples at 19 um",
        ),
        (lambda z: 0 * z + 12.0, "0 um rms, with a noise of 0: must be a motion of about 20 um: look at the sensor"),
        (lambda z: np.random.default_rng(1).normal(12.0, 0.01, z.shape), "must be a motion of about 20 um: look at"),
        (lambda z: 1000 * z, "of its sign: the sensor seems to report in nm, not in um, or the stroke to be in mm"),
    ],
)
def test_what_is_wrong_with_the_sensor_is_named(sensor, words):
    """A sensor at the end of its range was a voltage limit, one that is not connected another gain."""
    learned = IterativeLearning(raster(50.0), dynamics=dynamics(900.0), **KNOWN)
    z = linear(learned, GAIN * dynamics(900.0).response(frequencies(learned)))
    with pytest.raises(SettingError, match=words):
        learned.learn(sensor(np.tile(z, (3, 1))))


def test_a_motion_below_the_noise_is_named_and_not_another_unit():
    """What noise shows beside so little motion is any gain: the sensor seemed to report in nm."""
    learned = IterativeLearning(raster(50.0, peak_to_peak=1e-6), dynamics=dynamics(900.0), **KNOWN)
    noise = np.random.default_rng(0).normal(12.0, 0.01, (3, learned.samples))
    with pytest.raises(SettingError, match=r"motion = .*e-06 um: must be above the noise of a pass, 0.0.* um: move"):
        learned.learn(noise)


def test_a_period_of_no_whole_samples_is_repeated_until_it_is_one():
    assert repetition(FS, 97.0) == (10_000, 97)
    assert repetition(2000.0, 12.5) == (160, 1)
    with pytest.raises(SettingError, match=r"such as 111\.1111"):
        repetition(FS, 111.37123)


# ---- The procedure -------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("each_picture_once")
def test_the_command_learns_writes_and_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["learn", "--frequency", "100", "--averaged", "0.2", "--passes", "6", "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["verdict"] == "good"
    errors = [one["rmse_um"] for one in found["passes"]]
    assert errors[-1] < 0.02 < 1.0 < errors[0]
    made = truestroke.load_waveform(tmp_path / "learned.csv")
    assert made.volts.size == found["samples"] == 100
    assert "<svg" in (tmp_path / "learned.html").read_text()
    model = truestroke.load_model(tmp_path / "learned.toml")
    assert "passes of truestroke learn" in model.provenance["source"]
    true = StagePlant()  # that of the command: the model foretells the best waveform, but for the zero
    true.open()
    z = true.exchange(np.tile(made.volts, 60))[-1000:]
    off = z - model.predict(np.tile(made.volts, 60), FS)[-1000:]
    assert np.std(off) < 0.02 * 20.0


@pytest.mark.parametrize(
    ("stage", "most"),
    [
        ({"resonances": (3000.0,)}, 0.0005),
        ({"resonances": (901.0,)}, 0.0005),  # just beyond what the sample rate sees
        ({"resonances": (1200.0,)}, 0.0005),  # its alias is at 800 Hz
        ({"resonances": (300.0,), "dampings": (0.6,)}, 0.001),
    ],
)
def test_a_stage_whose_resonance_is_not_seen_is_taken_for_a_spring(stage, most):
    """Its motion at 20 Hz, at a card's 2 kHz: no dynamics can be measured, and none are needed."""
    plant = StagePlant(StageSettings(sample_rate=2000.0, **stage))
    wave = trajectories.raster(frequency=20.0, peak_to_peak=20.0, duration=1.0, sample_rate=2000.0)
    limits = {"voltage_limits": (-0.6, 3.6), "slew": 4000.0}
    found = truestroke.learn(plant, wave, stroke=35.0, **limits, passes=5)
    assert found.best.rmse < most * np.ptp(found.learning.desired)
    assert 100.0 < found.learning.bandwidth <= 900.0
    assert found.spring.startswith("the stage is taken for a spring, up to ")
    assert found.spring in learning_page(found).lead


def test_the_start_of_a_stage_that_rings_has_decayed_before_the_periods_count():
    """200 Hz, damping 0.005: a time constant of 0.16 s. After 0.3 s its ringing was a noise of 0.2 %."""
    known = Dynamics(sample_rate=FS, modes=(Mode(frequency=200.0, damping=0.005),))
    stage = StagePlant(StageSettings(resonances=(200.0,), dampings=(0.005,), hysteresis_kind="plays", noise=0.0))
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1}
    found = truestroke.learn(stage, raster(40.0), dynamics=known, passes=1, **limits)
    assert found.passes[0].noise < 2e-4 * 20.0


def test_what_begins_is_reported():
    """The measurement takes seconds, in which nothing else is shown."""
    wave, begun = trajectories.raster(frequency=50.0, peak_to_peak=20.0, duration=1.0, sample_rate=10_000.0), []
    limits = {"voltage_limits": (-0.6, 3.6), "slew": 20_000.0}
    reported = {"doing": begun.append, "begins": lambda: begun.append("the motion")}
    found = truestroke.learn(StagePlant(), wave, stroke=35.0, **limits, passes=2, averaged=0.1, **reported)
    measuring = [f"dynamics: {part}" for part in ("bias", "excitation", "fitting")]
    assert begun == [*measuring, "the motion", *[f"pass {one.number}" for one in found.passes]]


def test_a_motion_beyond_the_spring_is_refused():
    plant = StagePlant(StageSettings(sample_rate=2000.0, resonances=(3000.0,), amplifier_bandwidth=20.0))
    wave = trajectories.raster(frequency=50.0, peak_to_peak=20.0, duration=1.0, sample_rate=2000.0)
    with pytest.raises(truestroke.DynamicsError, match="the motion is too fast where the stage is taken for a spring"):
        truestroke.learn(plant, wave, stroke=35.0, voltage_limits=(-0.6, 3.6), slew=4000.0, passes=2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--frequency", "3000"), "--frequency = 3000.0 Hz: must be at most 2160 Hz, 2.4 times the first"),
        (("--frequency", "4600"), "--frequency = 4600.0 Hz: must be at most 4500 Hz, 0.45 of the sample"),
        (("--frequency", "9999"), "--frequency = 9999.0 Hz: must be at most 4500 Hz"),
        (("--frequency", "4499"), "must be one whose period is a whole number of samples, such as 3333.3333 Hz"),
        (
            ("--peak-to-peak", "31"),
            "--peak-to-peak = 31 um from end to end: must be at most the stroke, 30 um over voltage_lim",
        ),
    ],
)
def test_a_motion_that_cannot_be_learned_is_refused_before_anything_moves(options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = CliRunner().invoke(main, ["run", "--example"]).stdout
    fast = example.replace("sample_rate = 2000.0", "sample_rate = 10000.0").replace(
        "# resonance = 180.0", "resonance = 900.0"
    )
    Path("stage.toml").write_text(fast)
    monkeypatch.setattr(SimulatedDriver, "open", lambda _: pytest.fail("it was opened"))
    result = CliRunner().invoke(main, ["learn", "--config", "stage.toml", *options])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert words in result.stderr
    Path("stage.toml").write_text(fast.replace("stroke = 30.0", ""))
    without = CliRunner().invoke(main, ["learn", "--config", "stage.toml"]).stderr
    assert "stage.toml: [[axis]] x: stroke = missing: must be given, such as stroke = 30.0 (um)" in without


def test_a_driver_of_another_rate_is_refused_before_it_is_measured(monkeypatch):
    wave = trajectories.raster(frequency=20.0, peak_to_peak=20.0, duration=1.0, sample_rate=4000.0)
    limits = {"voltage_limits": (-0.6, 3.6), "slew": 4000.0}
    monkeypatch.setattr("truestroke.runtime.learning.measure_bode", lambda *_, **__: pytest.fail("it was measured"))
    for driver in (SimulatedDriver(), StagePlant(StageSettings(sample_rate=2000.0))):
        with pytest.raises(SettingError, match=r"sample_rate = 4000\.0 Hz: must be that of the actuator, 2000 Hz"):
            truestroke.learn(driver, wave, stroke=35.0, **limits)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyboardInterrupt(), 130, ""),
        (truestroke.DriverError("playing: the trigger did not come"), 12, "the trigger did not come; "),
    ],
    ids=["Ctrl-C", "hardware that fails"],
)
def test_what_ends_learning_leaves_the_best_waveform_and_says_where(error, code, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exchange = StagePlant.exchange

    def until_there_is_one(self, volts):
        if Path("learned.csv").exists():
            raise error
        return exchange(self, volts)

    monkeypatch.setattr(StagePlant, "exchange", until_there_is_one)
    result = CliRunner().invoke(main, ["learn", "--frequency", "100", "--averaged", "0.1"])
    assert result.exit_code == code
    assert f"{words}learned.csv has the best waveform so far, of pass 0" in result.stderr
    assert truestroke.load_waveform(tmp_path / "learned.csv").volts.size == 100


@pytest.mark.parametrize("at", ["truestroke.runtime.learning.model_of", "truestroke.report.learning.page"])
def test_what_ends_learning_behind_its_last_pass_leaves_the_best_waveform_and_says_where(at, tmp_path, monkeypatch):
    """Ctrl-C and SIGTERM while model or page are made: no line said that the waveform is there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(at, lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    result = CliRunner().invoke(main, ["learn", "--frequency", "100", "--averaged", "0.1", "--passes", "1"])
    assert result.exit_code == 130
    assert "all passes are done; learned.csv has the best waveform so far, of pass 0, rmse" in result.stderr
    assert truestroke.load_waveform(tmp_path / "learned.csv").volts.size == 100


@pytest.mark.filterwarnings("error")
def test_a_model_of_another_axis_that_holds_the_motion_at_one_voltage_is_refused():
    """Of 50 nm for a motion of 20 um: the first pass did not move, and its gain was nan, behind a warning of NumPy."""
    other = truestroke.ActuatorModel(
        thresholds=(0.0,), weights=[0.01, 0.0, 0.0], covariance=np.zeros((3, 3)), stroke=0.05, voltage_range=(0.0, 5.0)
    )
    wave = trajectories.raster(frequency=50.0, peak_to_peak=20.0, offset=12.0, duration=1.0, sample_rate=10_000.0)
    known = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=900.0, damping=0.02),))
    words = r"model = one of 0\.05 um for 0 to 5 V: must be one of this axis: by it a motion of 20 um is at one voltage"
    with pytest.raises(SettingError, match=words):
        truestroke.IterativeLearning(wave, gain=9.0, dynamics=known, voltage_limits=(-0.6, 3.6), model=other)


def test_a_trigger_that_never_comes_has_the_exit_code_of_hardware(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(StagePlant, "exchange", lambda self, volts: np.full(volts.size, np.nan))
    known = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=900.0, damping=0.02),))
    known.save("known.toml")
    result = CliRunner().invoke(
        main, ["learn", "--frequency", "100", "--averaged", "0.1", "--passes", "2", "--dynamics", "known.toml"]
    )
    assert result.exit_code == 12
    assert "a trigger is late or missing" in result.stderr


@pytest.mark.usefixtures("each_picture_once")
def test_passes_without_a_model_say_why(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refuse(*_, **__):
        raise SettingError("record", "2 samples", "at least 200 samples")

    monkeypatch.setattr("truestroke.runtime.learning.identify", refuse)
    done = CliRunner().invoke(main, ["learn", "--frequency", "100", "--averaged", "0.05", "--passes", "1"])
    assert "no model: record = 2 samples" in done.output
    assert not Path("learned.toml").exists()


def test_the_model_that_was_there_is_refined():
    from truestroke.runtime.learning import model_of

    wave = trajectories.sine(frequency=50.0, peak_to_peak=10.0, duration=1.0, sample_rate=FS)
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1}
    found = truestroke.learn(StagePlant(), wave, dynamics=dynamics(700.0, 0.02), passes=4, **limits)
    assert len(found.records) == 3
    model = model_of(found)
    soft = model.replace(weights=0.8 * model.weights)
    volts, measured = found.records[-1]
    before, after = (np.std(measured - one.predict(volts, FS)) for one in (soft, model_of(found, soft)))
    assert after < 0.2 * before


def test_passes_above_the_resonance_make_no_model_and_say_why():
    """The displacement falls as the voltage rises; the sign is right."""
    from truestroke.runtime.learning import model_of

    wave = trajectories.sine(frequency=500.0, peak_to_peak=1.0, duration=1.0, sample_rate=FS)
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1}
    plant = StagePlant(StageSettings(sample_rate=FS, resonances=(300.0,), dampings=(0.02,)))
    found = truestroke.learn(plant, wave, dynamics=dynamics(300.0, 0.02), passes=2, **limits)
    with pytest.raises(truestroke.RecordError, match=r"so fast a motion .* learn a motion below the resonance"):
        model_of(found)


def test_a_driver_takes_the_same_passes_and_ends_at_the_safe_voltage():
    from truestroke.runtime.drivers import SimulatedDriver, SimulatedSettings

    stage = {"resonances": [300.0], "dampings": [0.03]}
    driver = SimulatedDriver(SimulatedSettings(sample_rate=2000.0, block=20, stage=stage))
    wave = trajectories.sine(frequency=20.0, peak_to_peak=10.0, duration=1.0, sample_rate=2000.0)
    limits = {"voltage_limits": LIMITS, "slew": 2000.0, "stroke": 35.0, "settle": 0.0, "averaged": 0.1}
    seen = []
    found = truestroke.learn(
        driver, wave, dynamics=dynamics(300.0, 0.03, 2000.0), passes=2, **limits, report=seen.append
    )
    assert [len(one.passes) for one in seen] == [1, 2]
    assert found.passes[1].rmse < 0.5 * found.passes[0].rmse


def test_a_sensor_that_was_not_zeroed_is_subtracted():
    class Offset(StagePlant):
        def exchange(self, volts):
            return super().exchange(volts) + 200.0

    wave = trajectories.sine(frequency=50.0, peak_to_peak=10.0, duration=1.0, sample_rate=FS)
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1}
    found = truestroke.learn(Offset(), wave, dynamics=dynamics(700.0, 0.02), passes=4, **limits)
    assert found.zero == pytest.approx(200.0, abs=0.1)
    assert found.best.rmse < 0.02
    given = truestroke.learn(Offset(), wave, dynamics=dynamics(700.0, 0.02), passes=1, zero=190, **limits)
    assert given.zero == 190.0
    with pytest.raises(SettingError, match=r"^zero = 'first' um: must be \"measured\", or a number"):
        truestroke.learn(Offset(), wave, dynamics=dynamics(700.0, 0.02), zero="first", **limits)
    assert given.passes[0].error.mean() - found.passes[0].error.mean() == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize("limits", [(-0.6, 3.6), (0.0, 10.0), (-2.0, 12.0)], ids=str)
def test_the_mean_of_the_first_pass_is_no_zero_of_the_sensor(limits):
    """Hysteresis has the stage an eighth of its stroke above where a straight line has it: the motion is not there."""
    middle = 15.0 * sum(limits) / (limits[1] - limits[0])
    stage = StagePlant(StageSettings(voltage_limits=limits, hysteresis_kind="bouc-wen"))
    wave = trajectories.sine(frequency=50.0, peak_to_peak=10.0, offset=middle, duration=1.0, sample_rate=FS)
    about = {"voltage_limits": limits, "slew": 50_000.0, "stroke": 30.0, "averaged": 0.1}
    found = truestroke.learn(stage, wave, dynamics=dynamics(700.0, 0.02), passes=6, **about)
    assert found.passes[0].error.mean() > 0.09 * 30.0
    stage.open()
    stage.exchange(np.tile(found.best.volts, 40))
    assert stage.truth[-found.learning.samples :].mean() == pytest.approx(middle, abs=0.2)  # creep of six passes
    assert found.zero == 0.0


def test_a_wrong_sign_stops_after_the_first_pass():
    class Reversed(StagePlant):
        def exchange(self, volts):
            return -super().exchange(volts)

    wave = trajectories.sine(frequency=50.0, peak_to_peak=10.0, duration=1.0, sample_rate=FS)
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1}
    with pytest.raises(SettingError, match="of its sign"):
        truestroke.learn(Reversed(), wave, dynamics=dynamics(700.0, 0.02), **limits)


def test_a_first_pass_that_is_lost_is_reported_and_repeated():
    """And a sensor that never shows a place of the period ends in an error, not in a result."""

    class Lost(StagePlant):
        missing = 1

        def exchange(self, volts):
            z = super().exchange(volts)
            if volts.size > 2500 and self.missing:  # a pass, no ramp
                self.missing -= 1
                z[::200] = np.inf
            return z

    wave = trajectories.sine(frequency=50.0, peak_to_peak=10.0, duration=1.0, sample_rate=FS)
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "averaged": 0.1}
    stage, known = Lost(), dynamics(700.0, 0.02)
    seen = []
    found = truestroke.learn(stage, wave, dynamics=known, passes=5, **limits, report=seen.append)
    assert [one.number for one in found.passes] == [0, 1, 2, 3, 4]
    assert len(seen) == 4
    assert "missed" in found.passes[0].undone
    assert learning_rows(found)[0] == ["0", "-", "-", "-", "-", "missed"]
    assert found.best.rmse < 0.1 * found.passes[1].rmse
    assert any("1 of 5 passes was missed: samples were lost" in reason for reason in found.verdict.reasons)
    stage.missing = 9
    with pytest.raises(truestroke.DriverError, match="no pass of 2 was measured"):
        truestroke.learn(stage, wave, dynamics=known, passes=2, **limits)


def test_an_offset_of_zero_and_a_frequency_of_zero_are_what_was_asked_for():
    done = CliRunner().invoke(main, ["learn", "--frequency", "0"])
    assert done.exit_code == 2
    with pytest.MonkeyPatch.context() as patch:
        asked = {}

        def raster(**arguments):
            asked.update(arguments)
            raise SettingError("offset", 0.0, "seen")

        patch.setattr(trajectories, "raster", raster)
        CliRunner().invoke(main, ["learn", "--offset", "0"])
    assert asked["offset"] == 0.0


@pytest.mark.parametrize("motion", [np.full(200, 100.0), -50.0 + np.sin(np.arange(200) * np.pi / 100)])
def test_a_motion_out_of_reach_is_refused_before_anything_moves(
    motion: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = StagePlant()
    monkeypatch.setattr(stage, "exchange", lambda volts: pytest.fail("it moved"))
    with pytest.raises(SettingError, match=r"motion = .* um: must be within -5 to 30 um, which voltage_limits"):
        truestroke.learn(stage, motion, sample_rate=10_000.0, voltage_limits=(-0.6, 3.6), slew=2e4, stroke=35.0)


def test_a_motion_whose_voltage_is_all_at_a_limit_is_refused_by_its_place(monkeypatch):
    """It was an error of the gain, 2e13 um/V. A motion may seem out of reach by a stroke that may be twice as much."""
    stage = StagePlant()
    monkeypatch.setattr(stage, "exchange", lambda volts: pytest.fail("it moved"))
    wave = trajectories.raster(frequency=50.0, peak_to_peak=15.0, offset=-20.0, duration=1.0, sample_rate=FS)
    about = {"voltage_limits": LIMITS, "slew": 2e4, "stroke": 35.0, "dynamics": dynamics(700.0, 0.02)}
    with pytest.raises(
        SettingError, match=r"^place of the motion = -27.5 to -12.5 um: must be within -5 to 30 um"
    ) as e:
        truestroke.learn(stage, wave, **about)
    assert "(`offset`)" in str(e.value)


def test_a_slew_that_is_too_low_by_far_is_refused_before_the_dynamics_are_measured(monkeypatch):
    """The stage moved for some seconds before it was said."""
    stage, wave = StagePlant(), raster(50.0)
    monkeypatch.setattr(stage, "exchange", lambda volts: pytest.fail("it moved"))
    limits = {"voltage_limits": (-0.6, 3.6), "stroke": 35.0}
    with pytest.raises(
        SettingError, match=r"^slew = 100.0 V/s: must be at least 256 V/s, which the motion needs below"
    ):
        truestroke.learn(stage, wave, slew=100.0, **limits)
    with pytest.raises(SettingError, match="must be at least 256 V/s"):
        truestroke.learn(stage, wave, slew=120.0, resonance=900.0, **limits)
    with pytest.raises(pytest.fail.Exception):  # near the resonance less may do
        truestroke.learn(stage, wave, slew=100.0, resonance=60.0, **limits)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'settings = {dynamics = "no.toml"}',
            "[[axis]] x: settings.dynamics = 'no.toml': must be dynamics of truestro",
        ),
        ('settings = {dynamics = "stage.toml"}', "[[axis]] x: settings.dynamics = 'stage.toml': must be dynamics of"),
        ('settings = {dynamics = "slow.toml"}', "[[axis]] x: settings.dynamics: sample_rate = 2000 Hz: must be 10000"),
        ('model = "no.toml"', "[[axis]] x: model = 'no.toml': must be a model of truestroke identify"),
    ],
)
def test_a_file_of_the_configuration_that_cannot_be_used_is_named_by_its_key(tmp_path, monkeypatch, text, words):
    """It was "no.toml: there is no such file", with exit code 1; the rate was that of --dynamics."""
    monkeypatch.chdir(tmp_path)
    Dynamics(sample_rate=2000.0, modes=(Mode(frequency=300.0, damping=0.02),)).save("slow.toml")
    Path("stage.toml").write_text(
        '[driver]\nname = "simulated"\nsample_rate = 10000.0\nstage = {}\n'
        f'[[axis]]\nname = "x"\nstroke = 30.0\nvoltage_limits = [-0.6, 3.6]\nslew = 20000.0\n{text}\n'
    )
    done = CliRunner().invoke(main, ["learn", "--config", "stage.toml"])
    assert done.exit_code == 2
    assert f"stage.toml: {words}" in done.stderr


@pytest.mark.parametrize(("volts", "middle"), [((0.0, 10.0), 15.0), ((-5.0, 5.0), 0.0), ((-2.0, 8.0), 9.0)], ids=str)
def test_a_motion_without_an_offset_is_in_the_middle_of_the_travel(tmp_path, monkeypatch, volts, middle):
    monkeypatch.chdir(tmp_path)
    Path("stage.toml").write_text(
        '[driver]\nname = "simulated"\nsample_rate = 10000.0\nstage = {}\n'
        f"[[axis]]\nstroke = 30.0\nvoltage_limits = {list(volts)}\nslew = 20000.0\n"
    )
    seen = []

    def learned(driver, wave, **given):
        seen.append(wave)
        given["begins"]()
        raise truestroke.DriverError("no hardware")

    monkeypatch.setattr(truestroke, "learn", learned)
    done = CliRunner().invoke(main, ["learn", "--config", "stage.toml"])
    assert f"motion     {middle - 10.0:.4g} to {middle + 10.0:.4g} um" in done.output
    period = seen[0].position[-200:]
    assert (period.min(), period.max()) == pytest.approx((middle - 10.0, middle + 10.0), abs=1e-6)


@pytest.mark.parametrize("kind", ["preisach", "bouc-wen"])
def test_what_is_learned_in_the_middle_of_the_travel_meets_no_limit(kind):
    """At 0 um a stage of 0 to 10 V has hysteresis below 0 V: there a tenth of the waveform is cut off."""
    limits = {"voltage_limits": (0.0, 10.0), "slew": 50_000.0, "stroke": 30.0, "passes": 5, "averaged": 0.2}
    known = Dynamics(sample_rate=FS, modes=(Mode(frequency=900.0, damping=0.02),))
    verdicts = []
    for middle in (15.0, 10.0):
        stage = StagePlant(StageSettings(voltage_limits=(0.0, 10.0), hysteresis_kind=kind, resonances=(900.0,)))
        wave = trajectories.raster(frequency=50.0, peak_to_peak=20.0, offset=middle, duration=1.04, sample_rate=FS)
        verdicts.append(truestroke.learn(stage, wave, dynamics=known, **limits).verdict)
    assert [verdict.level for verdict in verdicts] == ["good", "doubtful"]
    assert any("lowest voltage" in reason for reason in verdicts[1].reasons)


@pytest.mark.parametrize(
    ("errors", "ends"),
    [
        ((780.0, 250.0, 12.7, 22.9, 15.7), False),  # 700 Hz, 12.5 um: the next pass has 4.5 nm
        ((780.0, 250.0, 12.7, 22.9, 15.7, 14.0, 12.5), True),
        ((780.0, 250.0, 5.0, 5.4, 5.2), True),
        ((780.0, 250.0, 5.0, 5.4, 4.3), False),
    ],
)
def test_far_from_the_noise_two_passes_that_are_no_improvement_do_not_end_it(errors, ends):
    passes = tuple(SimpleNamespace(measured=np.ones(1), rmse=rmse, noise=4.2) for rmse in errors)
    assert learning_module._idle(passes) == ends


@pytest.mark.parametrize(
    "command", ["learn", "export json --sample-rate 10000 --stroke 24 --voltage-limits -0.6 3.6 --output a.json"]
)
def test_dynamics_of_another_sample_rate_are_refused_by_their_file(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    dynamics(700.0, rate=20_000.0).save("fast.toml")
    monkeypatch.setattr(truestroke, "learn", lambda *_, **__: pytest.fail("it moved"))
    done = CliRunner().invoke(main, [*command.split(), "--dynamics", "fast.toml"])
    assert done.exit_code == 2
    assert "--dynamics fast.toml: sample_rate = 20000 Hz: must be 10000 Hz" in done.stderr


@pytest.mark.parametrize(("frequency", "unit"), [(2.0, "ms"), (1.0, "s")])
def test_the_page_shows_a_long_repetition_in_seconds(frequency, unit):
    """10 s had labels of 10,000 ms, too long for a phone."""
    from truestroke.report import learning as report

    learned = IterativeLearning(raster(frequency, 3.0), gain=8.3, voltage_limits=LIMITS, slew_limit=2e4, bandwidth=90.0)
    made = learned.learn(np.tile(8.0 * learned.volts, 3))
    found = Learned(passes=(made,), learning=learned)
    assert report.chart(found).label == f"time ({unit})"
    assert report.plots(found)["period"].axes[-1].get_xlabel() == f"time ({unit})"


# ---- Files ----------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("each_picture_once")
def test_what_was_learned_before_is_kept_under_another_name_unless_it_may_be_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dynamics(900.0, 0.02).save("known.toml")
    options = ["--averaged", "0.05", "--settle", "0.05", "--passes", "1", "--dynamics", "known.toml"]
    monkeypatch.setattr(learning_module, "identify", lambda *_, **__: pytest.fail("it takes seconds"))
    monkeypatch.setattr("truestroke.cli.learn._model", lambda *_: (None, ""))
    texts = []
    for frequency in ("100", "50", "200"):
        done = CliRunner().invoke(main, ["learn", "--frequency", frequency, *options])
        texts.append(Path("learned.csv").read_text())
        Path("learned.toml").write_text('format = "truestroke model"')
    assert "now called learned-2.csv, learned-2.toml, learned-2.html; with --overwrite" in done.stderr
    assert [Path(f"learned-{k}.csv").read_text() for k in (1, 2)] == texts[:2]
    CliRunner().invoke(main, ["learn", "--frequency", "100", *options, "--overwrite"])
    assert not Path("learned-3.csv").exists()
    assert Path("learned.csv").read_text().count("\n") == texts[0].count("\n")


# ---- How long it takes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ["--frequency", "0.001"],
            (
                "--frequency 0.001 Hz: must be at least 0.01 Hz in the simulation with 8",
                "11 hours of motion",
                "--passes",
            ),
        ),
        (["--frequency", "0.002", "--passes", "1000"], ("duration of the motion = ", "at most a day in 1000 passes")),
    ],
)
def test_a_motion_that_takes_hours_is_refused_with_what_is_needed(options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(StagePlant, "exchange", lambda *_: pytest.fail("it was driven"))
    monkeypatch.setattr("truestroke.signals.trajectories.by_parts", lambda *_: pytest.fail("it was made"))
    monkeypatch.setattr("truestroke.base.system.free_memory", lambda: 1e12)
    result = CliRunner().invoke(main, ["learn", *options])
    assert result.exit_code == 2
    assert all(one in result.stderr for one in words), result.stderr


@pytest.mark.parametrize(
    ("frequency", "words"),
    [("0.01", "take about 5.3 minutes."), ("0.1", "8 simulated passes of 50 s take about 32 s.")],
    ids=["the lowest one that a refusal names", "faster"],
)
def test_what_takes_long_says_so_before_the_first_pass(frequency, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(StagePlant, "exchange", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    result = CliRunner().invoke(main, ["learn", "--frequency", frequency])
    assert result.exit_code == 130
    assert words in result.stderr


def test_a_pass_that_does_not_fit_the_memory_is_refused(monkeypatch):
    from truestroke.runtime.learning import lasting

    wave = np.sin(2 * np.pi * np.arange(10**6) / 10**6)
    assert lasting(wave, FS, passes=3) == (3 * 500.0, 500.0)
    monkeypatch.setattr("truestroke.base.system.free_memory", lambda: 1e9)
    with pytest.raises(SettingError, match=r"duration of a pass = 8\.3 minutes: must be less, as a pass of 5e\+06 sam"):
        truestroke.learn(StagePlant(), wave, sample_rate=FS, voltage_limits=LIMITS, slew=2e4, stroke=35.0)


def test_a_pass_shows_how_far_it_is(monkeypatch):
    monkeypatch.setattr("truestroke.runtime.learning.PART", 1000)
    wave, begun = raster(50.0), []
    limits = {"voltage_limits": LIMITS, "slew": 20_000.0, "stroke": 35.0, "dynamics": dynamics(900.0, 0.02)}
    found = truestroke.learn(StagePlant(), wave, **limits, passes=1, averaged=0.1, doing=begun.append)
    assert begun == ["pass 0", *(f"{part} % of a pass" for part in (25, 50, 75))]
    whole = truestroke.learn(StagePlant(), wave, **limits, passes=1, averaged=0.1)
    assert found.passes[0].rmse == whole.passes[0].rmse
