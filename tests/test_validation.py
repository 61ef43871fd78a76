"""The verdict of an identified model: from errors that are known, of traces that are made of them."""

import dataclasses
import itertools
from functools import cache

import numpy as np
import pytest
from benchmarks import foreign_records

from truestroke import trajectories
from truestroke.identification import Findings, Record, examine, identify, load_model, save_model
from truestroke.identification.fitting.uncertainty import autocorrelation
from truestroke.identification.held_out.changed import change
from truestroke.identification.held_out.jump import jump
from truestroke.identification.held_out.steps import blocks
from truestroke.identification.held_out.trace import HeldOut, Trace
from truestroke.identification.held_out.validation import Evidence, evidence, verdict
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.model.operators import play_history
from truestroke.plant import StagePlant, StageSettings

RATE = 1000.0
X = trajectories.random_wave(duration=20.0, sample_rate=RATE, cutoff=3.0, peak_to_peak=4.0, seed=2).position
T = np.arange(X.size) / RATE
VELOCITY = np.gradient(X)
PREDICTED = 7 * X + 5 * play_history(X, (0.3,))[:, 0]
NOISE = np.random.Generator(np.random.PCG64(1)).normal(0.0, 0.01, X.size)  # um, of a stroke of 40


@cache
def of_noise() -> Findings:
    """Of a record of the prediction and the sensor's noise; several tests begin with it."""
    return examine(Record.from_arrays(X, PREDICTED + NOISE, sample_rate=RATE))


def judged(error: np.ndarray, volts: np.ndarray = X) -> tuple[Evidence, tuple[str, ...], str]:
    """Of a model, where the truth differs from its prediction by `error`, um, and the sensor's noise; made once."""
    return _judged(error.tobytes(), volts.tobytes())


@cache
def _judged(of_error: bytes, of_volts: bytes) -> tuple[Evidence, tuple[str, ...], str]:
    error, volts = np.frombuffer(of_error), np.frombuffer(of_volts)
    z = PREDICTED + error + NOISE
    held = T >= 12.0
    taken = {"time": T, "volts": volts, "displacement": z, "known": np.ones(T.size, dtype=bool), "sample_rate": RATE}
    trace = Trace(**taken, source="", breaks=(), predicted=PREDICTED, half_width=np.full(T.size, 0.1), held_out=held)
    findings = examine(Record.from_arrays(X, z, sample_rate=RATE))
    jumped = jump(blocks(error + NOISE, np.zeros((T.size, 0)), np.zeros((0, 0)), X), T.size / findings.strokes)
    found = evidence(trace, (T, error + NOISE), autocorrelation(error + NOISE), findings, jumped=jumped)
    rms = float(np.sqrt(np.mean((error + NOISE)[held] ** 2)))
    whole = verdict(found, HeldOut(rms, 3 * rms, 100 * rms / np.ptp(z), 0.0, int(held.sum()), 0.95), findings)
    return found, whole.reasons, whole.level


def test_noise_alone_is_good() -> None:
    found, reasons, level = judged(np.zeros(T.size))
    assert (level, reasons) == ("good", ())
    assert found.over_noise == pytest.approx(1.0, abs=0.05)
    assert abs(found.autocorrelation) < 0.05
    assert max(found.voltage, found.velocity, found.history, found.time) < 0.02


def test_what_is_rare_in_a_record_comes_before_what_the_residual_shows() -> None:
    """A question about the unit of the time was the last of several reasons: if it is wrong, so are they."""
    error = 0.1 * np.sin(2 * np.pi * 0.5 * T)
    found = judged(error)[0]
    findings = examine(Record.from_arrays(X, PREDICTED + error + NOISE, sample_rate=RATE))
    asked = dataclasses.replace(findings, implausible=("are the stamps in ms? State the unit", "is it in nm?"))
    said = verdict(found, HeldOut(0.07, 0.2, 0.2, 0.0, 1000, 0.95), asked).reasons
    assert said[:2] == ("Are the stamps in ms? State the unit.", "Is it in nm?")
    assert len(said) > 2


def test_a_jump_of_the_zero_beneath_the_noise_is_dated() -> None:
    """Two deviations of the noise. An error that comes back is none, and one above the noise may be the model's."""
    found, reasons, level = judged(0.02 * (T > 7.0) - 0.01)
    assert level == "doubtful"
    assert found.jump_um == pytest.approx(0.02, abs=0.003)
    assert found.jump_s == pytest.approx(7.0, abs=0.05)
    assert "did the zero of the sensor jump" in reasons[0]
    for seconds in (0.1, 0.5):  # of an error that is gone within a stroke, or within some
        assert judged(0.03 * (T > 7.0) * np.exp(-(T - 7.0) / seconds))[0].jump_um == 0.0
    assert judged(0.01 * np.sin(2 * np.pi * 0.1 * T))[0].jump_um == 0.0
    assert not any("jump" in reason for reason in judged(0.1 * (T > 7.0) - 0.05)[1])


@pytest.mark.parametrize(("seed", "until"), [(0, None), (1, 2.2)], ids=["stays", "goes back"])
def test_a_jump_that_creep_of_the_fit_takes_is_found(seed: int, until: float | None) -> None:
    """Of 5 % beneath 2 % of noise: the residual keeps a tenth of it; one that goes back is in no mean behind it."""
    x = trajectories.random_wave(duration=4.0, sample_rate=RATE, cutoff=4.0, peak_to_peak=4.0, seed=seed).position
    t, z = np.arange(x.size) / RATE, 7 * x + 5 * play_history(x, (0.3, 1.0)).sum(axis=1)
    stroke = float(np.ptp(z))
    z += 0.02 * stroke * np.random.Generator(np.random.PCG64(seed + 5)).standard_normal(x.size)
    jumped = 0.05 * stroke * ((t >= 1.8) & (t < (until or np.inf)))
    right, wrong = (identify((x, displacement, RATE), modes=False) for displacement in (z, z + jumped))
    assert (right.verdict.level, right.evidence.jump_um) == ("good", 0.0)
    assert wrong.verdict.level == "doubtful"
    assert any("did the zero of the sensor jump" in reason for reason in wrong.verdict.reasons)
    assert wrong.evidence.jump_s == pytest.approx(until or 1.8, abs=0.02)
    assert abs(wrong.evidence.jump_um) == pytest.approx(0.05 * stroke, rel=0.25)


def changing(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Voltage and displacement of a stage with creep, beneath noise, a share of the stroke."""
    x = trajectories.random_wave(duration=6.0, sample_rate=RATE, cutoff=4.0, peak_to_peak=4.0, seed=seed).position
    z = 7 * x + 5 * play_history(x, (0.3, 1.0)).sum(axis=1)
    z += 0.02 * np.convolve(z, 0.001 * np.exp(-np.arange(4000) / 800.0))[: z.size]
    return x, z + noise * np.ptp(z) * np.random.Generator(np.random.PCG64(seed + 5)).standard_normal(z.size)


@pytest.mark.parametrize(("seed", "at"), [(0, 3.5), (1, 3.5)])
def test_a_gain_that_changes_by_a_twentieth_beneath_the_noise_is_dated(seed: int, at: float) -> None:
    """It was a good model, or one whose zero had jumped."""
    x, z = changing(seed, noise=0.012)
    after = np.arange(x.size) >= at * RATE
    more = after * (z - z.mean())
    known = {"modes": False, "rate": False, "asymmetry": 0, "delay": 0.0}
    right, wrong = (identify((x, z + share * more, RATE), **known) for share in (0.0, 0.05))
    assert (right.verdict.level, right.evidence.gain_changed, right.evidence.later_s) == ("good", 0.0, 0.0)
    assert wrong.evidence.over_noise < 2.0
    assert wrong.verdict.level == "doubtful"
    assert wrong.evidence.gain_changed == pytest.approx(0.05, abs=0.015)
    assert wrong.evidence.changed_s == pytest.approx(at, abs=0.15)
    assert any("further for the same voltage than before: did the gain" in reason for reason in wrong.verdict.reasons)


@pytest.mark.parametrize("rows", [3, -3], ids=["displacement", "voltage"])
def test_a_few_rows_that_one_channel_has_lost_are_counted(rows: int) -> None:
    """Fewer than the four that are seen without a model: it was a good one."""
    x, z = changing(seed=0, noise=0.012)
    first, kept = (z, x) if rows > 0 else (x, z)
    lost, kept = np.delete(first, np.arange(3500, 3500 + abs(rows))), kept[: -abs(rows)]
    wrong = identify((kept, lost, RATE) if rows > 0 else (lost, kept, RATE), modes=False)
    assert wrong.verdict.level == "doubtful"
    assert wrong.evidence.later_s == pytest.approx(-rows / RATE, rel=0.15)
    assert wrong.evidence.changed_s == pytest.approx(3.5, abs=0.05)
    way = "earlier" if rows > 0 else "later"
    assert any(f"is {way} by about 3 rows" in reason and "lose rows" in reason for reason in wrong.verdict.reasons)


def test_an_error_that_is_in_some_parts_of_the_record_is_no_change_of_the_gain() -> None:
    """As of a model: a step of the gain explains it, but it is as large nowhere else."""
    z = 20.0 * np.sin(np.arange(4000) / 30.0)
    noise, rate = np.random.Generator(np.random.PCG64(0)).standard_normal(4000), np.gradient(z)
    gain, later = np.zeros((2, 4000))
    gain[1700:], later[1700:] = 0.04, 1.0
    places = np.arange(4000) // 200 % 4 == 1
    nothing = np.zeros((4000, 0)), np.zeros((0, 0)), z
    errors = gain * z, 4 * gain * z * places, -later * rate
    found = [change(blocks(noise + error, *nothing), z, rate) for error in errors]
    assert found[0] == ("gain", pytest.approx(0.04, abs=0.01), pytest.approx(1700, abs=80))
    assert found[1] is None
    assert found[2] == ("delay", pytest.approx(1.0, abs=0.2), pytest.approx(1700, abs=80))


def test_a_step_of_the_voltage_and_a_new_end_of_its_range_are_no_jump_of_the_zero() -> None:
    """There the error of a model changes at once."""
    rest = np.random.Generator(np.random.PCG64(0)).standard_normal(4000) + 2.0 * (np.arange(4000) >= 1700)
    wave = np.cos(np.arange(4000) / 30.0)
    steps, further = wave + 5.0 * (np.arange(4000) >= 1700), wave * np.where(np.arange(4000) >= 1690, 2.0, 1.0)
    found = [
        jump(blocks(rest, np.zeros((4000, 0)), np.zeros((0, 0)), volts), 100.0) for volts in (wave, steps, further)
    ]
    assert [one is not None for one in found] == [True, False, False]


def test_hum_is_named_by_its_frequency() -> None:
    found, reasons, level = judged(0.1 * np.sin(2 * np.pi * 50.02 * T + 1.0))
    assert level == "doubtful"
    assert found.line > 0.9
    assert found.line_hz == pytest.approx(50.0, abs=0.1)
    assert any("one line at 50 Hz" in reason and "average over 20 ms" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("hz", "of_voltage", "level"), [(50.0, 0.0, "doubtful"), (50.0, 0.01, "bad"), (1.0, 0.0, "bad")]
)
def test_hum_does_not_make_the_motion_bad(hz: float, of_voltage: float, level: str) -> None:
    """7 % of the stroke in one line that the voltage does not have; a stage may ring by what the voltage has."""
    line = np.sin(2 * np.pi * hz * T)
    found, reasons, said = judged(4.0 * line, X + of_voltage * line)
    assert said == level
    assert (found.hum > 0.9) == (level == "doubtful")
    if level == "doubtful":
        assert found.over_line < 0.5
        assert any("one line at 50 Hz" in reason for reason in reasons)


def test_a_stage_that_rings_throughout_is_not_said_to_be_hum_alone() -> None:
    """80 Hz with a damping of 0.002: the voltage makes the line, and no mode is so narrow in 4 s."""
    settings = StageSettings(sample_rate=RATE, resonances=(80.0,), dampings=(0.002,), hysteresis_kind="preisach")
    stage, t = StagePlant(settings, seed=2), np.arange(4000) / RATE
    stage.open()
    volts = 1.5 - 1.2 * np.cos(2 * np.pi * 1.5 * t) * (0.6 + 0.4 * np.sin(2 * np.pi * 0.3 * t))
    volts += 0.1 * (t > 1.3) - 0.15 * (t > 2.6)
    found = identify(Record.from_arrays(volts, stage.exchange(volts), sample_rate=RATE)).verdict
    assert any("one line at 80 Hz" in reason and "a stage that rings" in reason for reason in found.reasons)


def test_an_error_in_step_with_the_motion_is_no_hum() -> None:
    reasons = judged(0.3 * np.cos(2 * np.pi * 1.3 * T))[1]
    assert not any("one line" in reason for reason in reasons)


def test_strokes_that_grow_beyond_the_fitted_ones_are_the_reason() -> None:
    """Reversal curves from the top that go further and further down, each as fast: not something that changed."""
    lows = np.linspace(0.9, 0.0, 30)
    turns = np.concatenate([[0.0, 1.0], np.ravel([[low, 1.0] for low in lows])])
    x = 10 * np.interp(
        np.arange(0.0, np.abs(np.diff(turns)).sum(), 0.004), np.r_[0, np.abs(np.diff(turns)).cumsum()], turns
    )
    known = np.ones(x.size, dtype=bool)
    held_out = np.arange(x.size) >= 0.6 * x.size
    error = np.where(held_out, 0.1, 0.01) * np.sin(np.arange(x.size) / 30)
    trace = Trace(np.arange(x.size) / RATE, x, x + error, known, RATE, "", (), x, 0 * x + 1, held_out)
    findings = examine(Record.from_arrays(x, x + error, sample_rate=RATE))
    found = evidence(trace, (trace.time, error), np.array([1.0, 0.1]), findings)
    assert found.strokes_beyond > 0.3
    assert found.range_beyond < 1e-9
    reasons = verdict(found, HeldOut(0.1, 0.1, 1.0, 1.0, 100, 0.95), findings).reasons
    assert any("its strokes are up to" in reason and "Record strokes of all lengths" in reason for reason in reasons)


@pytest.mark.parametrize(("fades", "tested"), [(True, 0.1), (False, 1.0)])
def test_motion_that_fades_does_not_test_long_strokes(fades: bool, tested: float) -> None:
    x = X * np.exp(-T / 5.0) if fades else X
    trace = Trace(T, x, x + NOISE, T >= 0.0, RATE, "", (), x, 0 * x + 1, T >= 12.0)
    findings = examine(Record.from_arrays(x, x + NOISE, sample_rate=RATE))
    found = evidence(trace, (T, NOISE), np.array([1.0, 0.1]), findings)
    assert found.strokes_tested == pytest.approx(tested, abs=0.25)
    reasons = verdict(found, HeldOut(0.01, 0.03, 0.03, 0.1, 8000, 0.95), findings).reasons
    assert any("the error of long ones is untested" in reason for reason in reasons) == fades


@pytest.mark.parametrize(("beyond", "left", "level"), [(0.6, 0.2, "doubtful"), (0.6, 3.0, "bad"), (0.0, 0.2, "bad")])
def test_an_error_beyond_the_fitted_range_is_no_verdict_on_a_model_that_fits_all(
    beyond: float, left: float, level: str
) -> None:
    """Sines whose height grows in steps: the held-out part is beyond the fitted one, but not beyond the record."""
    found, findings = judged(CAUSES["time"])[0], of_noise()
    large = {"over_noise": 200.0, "over_fitted": 40.0, "time": 0.0}
    found = dataclasses.replace(found, **large, range_beyond=beyond, residual_percent=left)
    said = verdict(found, HeldOut(2.8, 5.0, 7.0, 12.0, 8000, 0.6), findings)
    assert said.level == level
    assert any("score the model" in reason for reason in said.reasons) == (level == "doubtful")


@pytest.mark.parametrize(("fitted_from", "grows", "says"), [(2.0, 16.0, True), (0.0, 16.0, False), (2.0, 18.5, False)])
def test_an_error_from_the_first_voltage_on_that_was_not_fitted(fitted_from: float, grows: float, says: bool) -> None:
    """The rows of the first 2 s are of unknown states: those fitted behind them have not been at low voltages.

    What such voltages have switched stays, so that the error looks slow. Where it grows later it has another reason.
    """
    low, high = np.quantile(X, [0.3, 0.9])
    x = np.where((T < 2.0) | (T > 16.0), np.minimum(X, high), np.clip(X, low, high))
    error = np.where(grows < T, 0.5, 0.0) + np.where(T < 2.0, 0.3, 0.0) + NOISE
    trace = Trace(T, x, x + error, T >= 0.0, RATE, "", (), x, 0 * x + 1, T >= 12.0)
    findings = examine(Record.from_arrays(x, x + NOISE, sample_rate=RATE))
    rows = np.flatnonzero((fitted_from <= T) & (T < 12.0))
    found = dataclasses.replace(evidence(trace, (T, NOISE), np.array([1.0, 0.1]), findings, rows=rows), over_fitted=5.0)
    assert (found.until_left < 0.5) == says
    reasons = verdict(found, HeldOut(0.35, 0.5, 3.5, 5.0, 8000, 0.95), findings).reasons
    assert any("until it goes beyond the voltages of the fitted rows at 16." in reason for reason in reasons) == says
    assert any("is slow" in reason for reason in reasons) != says


@pytest.mark.parametrize(("slow", "level"), [(0.99, "doubtful"), (0.5, "bad")])
def test_a_zero_that_drifts_does_not_make_the_motion_bad(slow: float, level: str) -> None:
    """6 % of error of which next to all is slow: without it 0.6 %."""
    found, findings = judged(CAUSES["time"])[0], of_noise()
    found = dataclasses.replace(found, over_noise=200.0, over_line=2.0, time=slow)
    said = verdict(found, HeldOut(2.4, 5.0, 6.0, 12.0, 8000, 0.6), findings)
    assert said.level == level
    assert any("of the error is slow" in reason for reason in said.reasons) == (level == "doubtful")
    lost = verdict(found, HeldOut(4.8, 10.0, 12.0, 24.0, 8000, 0.6), findings)  # a zero that jumps as far is no drift
    assert lost.level == "bad"


def test_a_figure_of_a_model_with_branches_is_not_that_of_one_without() -> None:
    findings = of_noise()
    found, good = judged(np.zeros(T.size))[0], HeldOut(0.01, 0.03, 0.025, 0.1, 8000, 0.95)
    assert verdict(found, good, findings).level == "good"
    said = verdict(found, good, findings, part_branches=True)
    assert said.level == "doubtful"
    assert "with branches" in said.reasons[0]


def family(x: np.ndarray, loop: float) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Verdict on a record of this voltage with a loop of plays, its reasons, and the warnings of `examine`."""
    z = 7 * x + loop * play_history(x, (0.3,))[:, 0] + NOISE[: x.size]
    findings = examine(Record.from_arrays(x, z, sample_rate=RATE))
    found, *_ = judged(np.zeros(T.size))
    said = verdict(found, HeldOut(0.01, 0.03, 0.025, 0.1, 8000, 0.95), findings)
    return said.level, said.reasons, findings.warnings


SINE = 2 * np.sin(2 * np.pi * T)
AM = SINE * (0.55 + 0.45 * np.sin(2 * np.pi * T / 7))
SLOW_AM = (0.5 + np.sin(2 * np.pi * T) * (0.275 + 0.225 * np.cos(2 * np.pi * T / 13))) * 4  # begins within a stroke
RISES = np.random.Generator(np.random.PCG64(3)).uniform(0.2, 1.0, 21)[T.astype(int)] * (1 - np.cos(2 * np.pi * T))


@pytest.mark.parametrize(
    ("x", "good"), [(X, True), (AM, False), (SLOW_AM, False), (SINE * T / 20, False), (2 * RISES, False)]
)
def test_inner_loops_of_one_family_say_nothing_about_others(x: np.ndarray, good: bool) -> None:
    """A random wave, and motions whose strokes of one length are all at one voltage."""
    level, _, warnings = family(x, 5.0)
    assert (level == "good") == good
    assert any("inner loops elsewhere" in words for words in warnings) != good


def test_a_random_wave_about_a_voltage_that_a_ramp_leads_to_has_loops_everywhere() -> None:
    """The ramp and its range of voltages have no inner loops, and hide none of the wave."""
    level, _, warnings = family((0.6 * (X - X.min()) / np.ptp(X) + 0.4) * np.minimum(4 * T, 1.0), 5.0)
    assert level == "good"
    assert not any("inner loops elsewhere" in words for words in warnings)


def test_a_stroke_that_the_record_cuts_is_none_of_another_length() -> None:
    """Six strokes, and 0.6 of one."""
    _, reasons, warnings = family(4 * foreign_records.up_and_down(T, 0.165), 5.0)
    assert any(reason.startswith("All strokes are about as long") for reason in reasons)
    assert any("all strokes are about as long" in words for words in warnings)


ENDS = np.random.Generator(np.random.PCG64(4)).uniform(0.2, 2.0, 81) * (-1) ** np.arange(81)
WAY = 0.5 - 0.5 * np.cos(np.pi * np.arange(250) / 250)  # of 0.25 s, whatever its length
EVEN = np.concatenate([a + (b - a) * WAY for a, b in itertools.pairwise(ENDS)])


@pytest.mark.parametrize(("x", "loop", "same"), [(X, 5.0, False), (EVEN, 5.0, True), (EVEN, 0.05, False)])
def test_strokes_that_take_as_long_do_not_show_the_speed(x: np.ndarray, loop: float, same: bool) -> None:
    """Ways between random voltages: the longer, the faster. A loop within the noise may be of any width."""
    _, reasons, warnings = family(x, loop)
    assert any("take about as long" in words for words in warnings) == (x is EVEN)
    assert any(reason.startswith("All strokes take about as long (250 ms)") for reason in reasons) == same


@pytest.mark.parametrize(("hysteresis", "matters"), [(-0.5, True), (0.5, True), (1.0, True), (2.0, False), (4.0, True)])
def test_a_delay_that_takes_the_loop_may_be_hysteresis(hysteresis: float, matters: bool) -> None:
    """Of a loop of 6 %, beside noise of 0.5 %."""
    z = 7 * EVEN + 3 * play_history(EVEN, (0.3,))[:, 0] + 20 * NOISE[: EVEN.size]
    findings = examine(Record.from_arrays(EVEN, z, sample_rate=RATE))
    findings = dataclasses.replace(findings, loop_width_percent=6.0, hysteresis_percent=hysteresis)
    found, good = judged(np.zeros(T.size))[0], HeldOut(0.01, 0.03, 0.025, 0.1, 8000, 0.95)
    reasons = verdict(found, good, findings).reasons
    assert any(reason.startswith("All strokes take about as long") for reason in reasons) == matters


def test_a_way_that_hardly_has_rows_is_asked_about() -> None:
    """A raster with and without the rows of the ways back."""
    x = (T % 0.5) / 0.5
    x = 4 * np.where(x < 0.8, x / 0.8, (1 - x) / 0.2)
    kept = np.gradient(x) > 0
    for volts, seen in ((x, False), (x[kept], True)):
        _, reasons, warnings = family(volts, 5.0)
        for said in (reasons, warnings):
            assert any("were the ways back left out?" in words for words in said) == seen


def test_a_voltage_that_never_turns_shows_no_hysteresis() -> None:
    level, reasons, _ = family(4 * np.minimum(np.maximum(T - 1.0, 0.0), 1.0), 5.0)
    assert level == "bad"
    assert reasons[0].startswith("The voltage never turns")
    assert family(4 * np.abs(np.minimum(T / 10 - 1.0, 1.0)), 5.0)[0] == "doubtful"  # down and up


def test_branches_beyond_the_loops_of_a_record_are_not_bounded() -> None:
    """A loop that is three times as wide as twice the noise, and a third of it, by which plays err, is not."""
    z = 7 * AM + 3 * play_history(AM, (0.3,))[:, 0] + 20 * NOISE
    found, findings = judged(np.zeros(T.size))[0], examine(Record.from_arrays(AM, z, sample_rate=RATE))
    good = HeldOut(0.01, 0.03, 0.025, 0.1, 8000, 0.95)
    said = [verdict(found, good, findings, branches=branches).level for branches in (False, True)]
    assert said == ["good", "doubtful"]


@pytest.mark.parametrize("levels", [4, 15])
def test_few_levels_do_not_show_the_curve_between_them(levels: int) -> None:
    """Steps between so many voltages, a new one every 0.1 s."""
    steps = np.random.Generator(np.random.PCG64(5)).integers(0, levels, 200)[(T / 0.1).astype(int)] / (levels - 1)
    _, reasons, warnings = family(4 * steps, 5.0)
    for said in (reasons, warnings):
        assert any("at few levels" in words for words in said) == (levels == 4)


def test_motion_about_a_voltage_far_from_the_first_is_at_no_levels() -> None:
    """A random wave between 2.4 and 3.2 V, after a way from 0 V: words and remedy are others."""
    noise = np.random.Generator(np.random.PCG64(5)).normal(size=T.size)
    wave = np.convolve(noise, np.hanning(round(0.3 * RATE)), "same")
    wave = np.minimum(T / 0.5, 1.0) * (2.4 + 0.8 * (wave - wave.min()) / np.ptp(wave))
    _, reasons, warnings = family(wave, 5.0)
    for said in (reasons, warnings):
        assert not any("few levels" in words for words in said)
        assert any("ost of the motion is at 2." in words and "% of the voltage's span" in words for words in said)


@pytest.mark.parametrize(("loop", "matters"), [(0.05, False), (0.2, True)])
def test_a_loop_within_the_noise_needs_no_other_inner_loops(loop: float, matters: bool) -> None:
    """Width of the loop over twice the noise: 0.8, and 4.1, of which an error of 0.27 was seen."""
    assert any("inner loops elsewhere" in reason for reason in family(AM, loop)[1]) == matters


@pytest.mark.parametrize(("damping", "level"), [(0.0015, "doubtful"), (0.02, "good")])
def test_few_decays_of_a_mode_decide_its_damping(damping: float, level: str) -> None:
    """Of 20 s: 180 Hz with a damping of 0.0015 decays 34 times, within 11 lines of the spectrum; in 6 s within 3."""
    found, *_ = judged(np.zeros(T.size))
    findings = examine(Record.from_arrays(X[:6000], (PREDICTED + NOISE)[:6000], sample_rate=RATE))
    dynamics = Dynamics(sample_rate=RATE, modes=(Mode(frequency=180.0, damping=damping),))
    said = verdict(found, HeldOut(0.01, 0.03, 0.025, 0.1, 2400, 0.95), findings, dynamics=dynamics)
    assert said.level == level
    assert [reason.startswith("Few decays of the mode of 180 Hz") for reason in said.reasons] == (
        [True] if level == "doubtful" else []
    )
    assert all("Record 18.5 s and more" in reason for reason in said.reasons)


def test_a_range_that_is_reached_late_is_the_reason() -> None:
    findings = of_noise()
    found = dataclasses.replace(judged(0.02 * (T - 6.0))[0], over_fitted=3.0, range_beyond=0.0, speed_beyond=0.0)
    error = HeldOut(0.1, 0.3, 0.25, 0.0, 8000, 0.95)
    late = dataclasses.replace(findings, states_known_s=9.0)
    assert any("only after 9 s" in reason for reason in verdict(found, error, late).reasons)
    soon = dataclasses.replace(findings, states_known_s=2.0)
    assert any("by a slow error" in reason for reason in verdict(found, error, soon).reasons)


WIDTH = play_history(X, (0.4,))[:, 0] - play_history(X, (0.2,))[:, 0]
CAUSES = {  # an error of 1 % of the stroke that each function finds, and the others do not
    "voltage": 0.3 * np.cos(4 * X),
    "velocity": -0.3 * VELOCITY / VELOCITY.std(),
    "history": 2.0 * (WIDTH - np.polyval(np.polyfit(X, WIDTH, 7), X)),
    "time": 0.02 * (T - 6.0),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_what_the_error_depends_on_is_found(cause: str) -> None:
    found, reasons, level = judged(CAUSES[cause])
    shares = {name: getattr(found, name) for name in CAUSES}
    assert max(shares, key=shares.__getitem__) == cause
    assert shares[cause] > 0.4
    assert level == "doubtful"
    words = {"history": "reversals", "time": "slow"}.get(cause, cause)
    assert any(words in reason for reason in reasons)


def test_a_model_that_a_black_box_beats_by_two_is_not_good() -> None:
    """Not even where the sensor is taken to be so noisy: an error that plays and a sine of the voltage make."""
    error = 0.1 * np.sin(3 * X) + CAUSES["history"] / 10
    found, reasons, _ = judged(error)
    assert found.black_box > 0.6
    assert any("can be predicted: a model of another structure has 0." in reason for reason in reasons)
    loud = dataclasses.replace(examine(Record.from_arrays(X, PREDICTED, sample_rate=RATE)), noise_um=1.0)
    small = HeldOut(0.1, 0.3, 0.25, 0.0, 8000, 0.95)
    quiet = dataclasses.replace(found, black_box=0.8, over_noise=0.1, autocorrelation=0.1, least_autocorrelation=-0.1)
    assert verdict(quiet, small, loud).level == "doubtful"
    assert verdict(dataclasses.replace(quiet, black_box=0.7), small, loud).level == "good"
    assert abs(judged(np.zeros(T.size))[0].black_box) < 0.02


def test_the_black_box_knows_an_actuator_of_another_structure() -> None:
    """Dahl's, which rises on for a moment after its voltage has turned: other models had a third of the error."""
    (record,) = foreign_records.records(0, (foreign_records.short,))
    found = identify(record)
    assert found.evidence.black_box > 0.75
    assert found.verdict.level == "doubtful"


def test_a_residual_that_alternates_is_not_called_white() -> None:
    """1.24 um on 10 nm of noise, autocorrelation -0.81 at lag 1: it has no low frequencies."""
    error, rng = np.zeros(T.size), np.random.Generator(np.random.PCG64(3))
    shocks = rng.normal(0.0, 1.0, T.size)
    for k in range(1, T.size):
        error[k] = -0.81 * error[k - 1] + shocks[k]
    found, reasons, level = judged(1.24 * error / error.std())
    assert found.least_autocorrelation == pytest.approx(-0.81, abs=0.03)
    assert found.least_autocorrelation_s == pytest.approx(1e-3)
    assert level == "doubtful"
    assert any("The residual oscillates: autocorrelation -0.8" in reason for reason in reasons)


def test_the_steps_of_a_slow_sensor_are_no_resonance() -> None:
    """They are in the residual, which goes to and fro with them."""
    found, reasons, _ = judged(0.1 * np.cos(2 * np.pi * 250.0 * T))
    assert any("A resonance, or hum" in reason or "hum, a floor" in reason for reason in reasons)
    slow = dataclasses.replace(examine(Record.from_arrays(X, PREDICTED, sample_rate=RATE)), rows_per_value=4)
    said = verdict(found, HeldOut(0.1, 0.3, 0.25, 0.0, 8000, 0.95), slow).reasons
    assert any("has a new value in every 4. row only, and the residual has its steps" in reason for reason in said)
    assert not any("hum" in reason for reason in said)


def test_the_held_out_part_beyond_the_fitted_one() -> None:
    error = np.where(T >= 12.0, 0.5, 0.05) * np.sin(40 * T)
    _, reasons, _ = judged(error)
    assert any("predicted 9" in reason or "predicted 10" in reason for reason in reasons)


def test_a_record_of_one_stroke_length_and_a_contradiction(tmp_path) -> None:
    (record,) = foreign_records.records(makers=(foreign_records.short,))
    assert any("All strokes are about as long" in reason for reason in identify(record).verdict.reasons)
    found = identify(dataclasses.replace(record, contradictions=("the file says otherwise", "is it shifted?")))
    assert found.verdict.is_bad
    save_model(tmp_path / "model.toml", found.model)
    kept = load_model(tmp_path / "model.toml").provenance
    assert (kept["verdict"], kept["reason_1"]) == ("bad", "The record contradicts itself: the file says otherwise.")
    assert kept["reason_2"] == "The record contradicts itself: is it shifted?"


@pytest.mark.parametrize(("share", "said"), [(0.05, False), (0.33, True)])
def test_a_zero_that_drifts_far_is_a_reason(share: float, said: bool) -> None:
    """A third of the stroke in 20 s was good: the drift is fitted, but no prediction has it."""
    drift = share * np.ptp(X) * np.linspace(0.0, 1.0, X.size)
    measured = X + drift + NOISE
    trace = Trace(T, X, measured, T >= 0.0, RATE, "", (), X + drift, 0 * X + 1, T >= 12.0)
    findings = examine(Record.from_arrays(X, measured, sample_rate=RATE))
    found = evidence(trace, (T, NOISE), np.array([1.0, 0.1]), findings, drift)
    reasons = verdict(found, HeldOut(0.01, 0.03, 0.03, 0.1, 8000, 0.95), findings).reasons
    assert any("The zero drifts by" in reason for reason in reasons) == said


def test_motion_beside_a_zero_that_moves_is_compared_with_a_straight_line_by_itself() -> None:
    """As of a thermal cycle beyond which a drift was extended: it was bad, worse than a straight line."""
    moves = 5.0 * np.clip((T - 12.0) / (T[-1] - 12.0), 0.0, 1.0)
    found, reasons, level = judged(moves + 0.7 * np.sin(40.0 * T))
    assert level == "doubtful"
    assert found.over_line < 0.5
    assert any("is slow: drift, creep, or a zero that moved" in reason for reason in reasons)


def test_an_error_that_grows_all_the_time_does_not_begin_at_the_first_voltage_that_was_not_fitted() -> None:
    """Of a zero that moves on while the voltage leaves the fitted range by chance."""
    held, volts = T >= 12.0, np.where(T >= 14.0, 1.5, 1.0) * X
    reached = float(T[np.flatnonzero(volts > 1.03 * X.max())[0]])
    z = PREDICTED + NOISE
    taken = {"time": T, "volts": volts, "displacement": z, "known": np.ones(T.size, dtype=bool), "sample_rate": RATE}
    growing, sudden = 0.5 * np.maximum(T - 12.0, 0.0), np.where(reached <= T, 2.0, 0.1)
    left = []
    for error in (growing, sudden):
        trace = Trace(**taken, source="", breaks=(), predicted=z - error, half_width=np.ones(T.size), held_out=held)
        findings = examine(Record.from_arrays(X, z, sample_rate=RATE))
        left.append(evidence(trace, (T, NOISE), autocorrelation(NOISE), findings).left_s)
    assert left == [0.0, pytest.approx(reached, abs=0.05)]
