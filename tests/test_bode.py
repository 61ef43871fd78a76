"""Measuring the dynamics of a stage: the truth is that of simulated stages, the limits are looked at from outside."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import dynamics as benchmark
from benchmarks import foreign_stages
from benchmarks.foreign_stages import Duhem, Stage
from click.testing import CliRunner
from scipy.signal import lfilter

from truestroke import AdaptiveController, Dynamics, DynamicsError, SettingError, Timing, measure_bode, measure_dynamics
from truestroke.cli import main
from truestroke.identification.dynamics import bode
from truestroke.identification.dynamics.fit import Fit, Problem, Spectra, pair_transfer, pulse_transfer
from truestroke.model.dynamics import Mode
from truestroke.plant import PlantSettings, RealisticPlant, StagePlant, StageSettings
from truestroke.report import dynamics as dynamics_page

pytestmark = pytest.mark.usefixtures("no_waiting")

LIMITS = {"voltage_limits": (-0.6, 3.6)}


class Spied:
    """A stage behind blocks and latency, that keeps the voltages."""

    def __init__(self, stage: StagePlant, block: int = 1, latency: int = 0) -> None:
        self.stage, self.block, self.latency = stage, block, latency
        self.volts: list[float] = []

    def open(self) -> Timing:
        self.late = np.zeros(self.latency)
        return Timing(sample_rate=self.stage.open().sample_rate, block=self.block, latency=self.latency)

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        assert len(volts) <= self.block
        self.volts += volts.tolist()
        z = np.concatenate([self.late, self.stage.exchange(volts)])
        self.late = z[len(volts) :]
        return z[: len(volts)]


# ---- What is found -------------------------------------------------------------------------------------------------

STAGES = {
    "plays": StageSettings(resonances=(700.0,), dampings=(0.02,), sample_rate=5000.0),
    "Preisach, slow, hardly damped": StageSettings(
        resonances=(90.0,), dampings=(0.003,), sample_rate=2000.0, hysteresis_kind="preisach", amplifier_bandwidth=300.0
    ),
    "Bouc-Wen, two modes, dead time": StageSettings(
        resonances=(600.0, 1650.0),
        dampings=(0.03, 0.01),
        shares=(1.06, -0.06),
        dead_time=1.3e-4,
        hysteresis_kind="bouc-wen",
        noise=0.01,
    ),
}


@pytest.mark.parametrize("name", STAGES)
def test_the_dynamics_of_a_stage_are_found(name: str) -> None:
    truth = STAGES[name].dynamics()
    found = measure_bode(StagePlant(STAGES[name], seed=2), **LIMITS)
    assert found.verdict.level == "good"
    assert len(found.dynamics.modes) == len(truth.modes)
    first, mode = truth.modes[0], found.dynamics.modes[0]
    assert mode.frequency == pytest.approx(first.frequency, rel=0.003)
    assert mode.damping == pytest.approx(first.damping, rel=0.12)
    below = np.linspace(1.0, 0.6 * first.frequency, 50)
    around = np.linspace(0.9, 1.1, 50) * first.frequency
    assert np.abs(found.dynamics.response(below) / truth.response(below) - 1).max() < 0.02
    assert np.abs(found.dynamics.response(around) / truth.response(around) - 1).max() < 0.05
    assert found.dynamics.dead_time * truth.sample_rate == pytest.approx(truth.dead_time * truth.sample_rate, abs=0.08)
    assert abs(mode.frequency - first.frequency) < 4 * found.dynamics.uncertainty["frequency[0]"]
    assert found.dynamics.trusted_to > first.frequency


@pytest.mark.parametrize("number", [211, 213])
def test_a_lag_that_is_too_short_to_be_seen_is_within_the_deviation_of_the_dead_time(number: int) -> None:
    """Amplifiers of 1230 and 2943 Hz at 2 kHz; the dead time's own deviation is 17 and 59 times too small there."""
    settings = benchmark.stage(number)
    found = measure_dynamics(StagePlant(settings, seed=number), **LIMITS, seed=number)
    assert found.amplifier_bandwidth == 0.0
    error, stated = abs(found.dead_time - settings.dead_time), found.uncertainty["dead_time"]
    assert 0.1 * stated < error < 2.6 * stated


def test_blocks_and_latency_are_no_dead_time_and_the_sensor_is_not_the_stage() -> None:
    settings = StageSettings(sample_rate=2000.0, resonances=(180.0,), sensor_delay=4e-4, sensor_bandwidth=400.0)
    driven = Spied(StagePlant(settings), block=7, latency=3)
    options = {**LIMITS, "duration": 1.0, "safe_voltage": 0.2, "bias": 1.0}
    found = measure_dynamics(driven, sensor_delay=4e-4, sensor_bandwidth=400.0, **options)
    assert found.modes[0].frequency == pytest.approx(180.0, rel=0.003)
    f = np.linspace(1.0, 110.0, 50)
    assert np.abs(found.response(f) / settings.dynamics().response(f) - 1).max() < 0.02
    assert driven.volts[-1] == pytest.approx(0.2)
    assert max(np.abs(np.diff(driven.volts))) * 2000.0 <= 504.0


@pytest.mark.parametrize(("damping", "delay"), [(0.02, 0.0), (0.003, 2.7), (0.4, -0.4)])
def test_partial_fractions_and_aliases_give_the_same_response(damping: float, delay: float) -> None:
    """The fit has closed forms of poles; `Dynamics.response` sums over aliases."""
    stage = Dynamics(sample_rate=1e4, modes=(Mode(frequency=900.0, damping=damping),), dead_time=delay / 1e4)
    f = np.array([3.0, 450.0, 900.0, 4500.0])
    w = 2 * np.pi * 900.0 / 1e4
    pole, z = w * complex(-damping, np.sqrt(1 - damping**2)), np.exp(2j * np.pi * f / 1e4)
    both = [pulse_transfer(p, delay, z) * w**2 / (2j * p.imag) for p in (pole, pole.conjugate())]
    assert sum(both) == pytest.approx(stage.response(f), rel=1e-4, abs=1e-5)
    assert pair_transfer(pole, w**2 / (2j * pole.imag), delay, z) == pytest.approx(sum(both), rel=1e-11)


def test_derivatives_are_those_of_the_residual_whose_linear_numbers_follow() -> None:
    f, random = np.linspace(5.0, 900.0, 180), np.random.default_rng(1)
    U = np.exp(2j * np.pi * random.uniform(size=f.size))
    stage = Dynamics(sample_rate=2000.0, modes=(Mode(frequency=300.0, damping=0.02),), dead_time=4e-4)
    noise = 0.01 * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    problem = Problem(Spectra(2000.0, 400, f, U, U * stage.response(f) + noise, np.full(f.size, 1e-4)), 1, lag=True)
    x = np.array([np.log(305.0), np.log(0.03), 0.7, 0.02, np.log(20.0), 0.01, np.log(0.3)])
    high = np.append(x[:-1] + 1, x[-1])  # the last one is at its bound
    made = problem.jacobian(x, high)
    for k in range(x.size):
        step = 1e-5 * np.eye(x.size)[k]
        slope = (problem.solve(x + step).residual - problem.solve(x - step).residual) / 2e-5
        np.testing.assert_allclose(made[:, k], slope, atol=1e-4 * np.abs(slope).max())


def test_a_sensor_that_is_sampled_at_the_end_of_its_tick_is_half_a_tick_early() -> None:
    """What a loop of single conversions does; the response is that of the matrix exponential."""
    stage = Stage([(900.0, 0.02, 1.0)], 10000.0, hysteresis=Duhem(0.0))
    f = np.array([3.0, 450.0, 900.0, 3000.0, 4500.0])
    q = np.exp(2j * np.pi * f / stage.rate)
    exact = np.array([one * np.linalg.solve(one * np.eye(2) - stage.A, stage.b)[0] for one in q])
    early = Dynamics(sample_rate=stage.rate, modes=(Mode(frequency=900.0, damping=0.02),), dead_time=-0.5 / stage.rate)
    assert early.response(f) == pytest.approx(exact, rel=5e-5)


@pytest.mark.parametrize("relative", [0.02, 0.1, 0.3, 0.44])
@pytest.mark.parametrize("ticks", [-0.5, -0.3, -0.1])
def test_a_controller_takes_a_measurement_that_is_early(relative: float, ticks: float) -> None:
    """Without the lag of an amplifier it was refused: a mean that is early knew the next command."""
    mode = Mode(frequency=relative * 1e4, damping=0.01)
    early = Dynamics(sample_rate=1e4, modes=(mode,), dead_time=ticks / 1e4)
    AdaptiveController(sample_rate=1e4, stroke=10.0, voltage_limits=(0.0, 10.0), dynamics=early)


@pytest.mark.parametrize(
    ("rate", "modes", "dead"),
    [
        (5000.0, [(600.0, 0.02, 1.0)], 0),
        (5000.0, [(127.6, 0.0272, 0.785), (334.3, 0.0272, 0.215)], 3),
        (20000.0, [(94.3, 0.0617, 1.0)], 2),
        (20000.0, [(68.1, 0.0035, 1.0)], 0),
        (5000.0, [(176.3, 0.0319, 0.7), (326.7, 0.0319, 0.15), (514.1, 0.0319, 0.15)], 0),
        (10000.0, [(668.0, 0.385, 1.0)], 0),
    ],
    ids=["one mode", "a second mode as high as the first", "soft", "soft, hardly damped", "three", "damped"],
)
def test_hysteresis_far_below_the_resonance_does_not_spoil_the_stage(
    rate: float, modes: list[tuple[float, float, float]], dead: int
) -> None:
    """Small loops of two fifths of the gain relax within the excitation: up to some 40 Hz the response is theirs."""
    stage = Stage(modes, rate, hysteresis=Duhem(0.22), dead=dead)
    found = measure_bode(stage, voltage_limits=stage.limits)
    assert not found.verdict.is_bad
    for mode, (frequency, damping, share) in zip(found.dynamics.modes, modes, strict=True):
        assert mode.frequency == pytest.approx(frequency, rel=2e-3)
        assert mode.damping == pytest.approx(damping, rel=0.1)
        assert mode.share == pytest.approx(share, rel=0.05)
    assert found.dynamics.dead_time * modes[0][0] == pytest.approx((dead - 0.5) / rate * modes[0][0], abs=0.02)


def test_what_is_too_early_by_its_last_digit_alone_is_not_refused() -> None:
    """-2.5000000000000005e-05 s for half a tick at 20 kHz: a delay plus what it is too early was such a sum."""
    used = SimpleNamespace(frequency=np.array([8.0, 9000.0]))
    for early in np.linspace(0.5, 0.9, 400):
        fit = Fit(
            frequency=np.array([68.0]), damping=np.array([0.01]), share=np.ones(1), lag=1e-3, delay=-early / 20_000.0,
            hysteresis=(0.0, 1.0, 0.0), gain=1.0, deviations=dict.fromkeys(("frequency[0]", "damping[0]"), 1e-4),
            response=np.ones(1, complex), measured=np.ones(1, complex), cost=1.0, numbers=1, x=np.zeros(1),
        )  # fmt: skip
        found = bode._dynamics(fit, SimpleNamespace(sample_rate=20_000.0), used, 0.0, 0.0)
        assert found.dead_time == -0.5 / 20_000.0


def test_the_gain_is_seen_where_bias_and_safe_voltage_are_one() -> None:
    """It bounds the travel; a way of 2 % of the range, as it was, shows what is left of the last loop."""
    stage = Stage([(600.0, 0.01, 1.0)], 5000.0, hysteresis=Duhem(0.22))
    for volts in (np.linspace(0, 10, 500), np.linspace(10, 5, 500)):
        stage.exchange(volts)
    found = measure_bode(stage, voltage_limits=stage.limits, safe_voltage=5.0)
    assert found.record.gain == pytest.approx(found.gain, rel=0.1)


# ---- Limits and refusals -------------------------------------------------------------------------------------------


def test_a_stage_that_goes_too_far_is_stopped_at_the_safe_voltage() -> None:
    soft = Spied(StagePlant(StageSettings(sample_rate=2000.0, resonances=(60.0,), dampings=(0.003,))))
    with pytest.raises(DynamicsError, match=r"further than `travel` allows, .* um, mostly at (59|60|61)[.\d]* Hz"):
        measure_bode(soft, **LIMITS, travel=0.3, duration=1.0)
    assert soft.volts[-1] == pytest.approx(0.0, abs=1e-9)
    assert max(np.abs(np.diff(soft.volts))) * 2000.0 <= 504.0


def test_a_band_below_the_resonance_is_what_is_widened() -> None:
    """The sample rate is asked for where the band goes as far as it shows."""
    words = r"no resonance from 5\d to 60 Hz, .* above, excite it by a higher `band` \(10000 Hz sees up to 4500 Hz\);"
    with pytest.raises(DynamicsError, match=words):
        measure_bode(StagePlant(), **LIMITS, band=(50.0, 60.0))


def test_a_resonance_in_the_gap_of_what_is_seen_is_found() -> None:
    """At lines of 0.5 Hz the peak at 15 Hz is not seen; the fit began at 20 Hz and stopped at 16, its bound."""
    settings = StageSettings(sample_rate=2000.0, resonances=(15.0,), dampings=(0.0185,), hysteresis_kind="bouc-wen")
    found = measure_bode(StagePlant(settings, seed=26), **LIMITS, seed=26)
    assert found.verdict.level == "good"
    assert found.dynamics.modes[0].frequency == pytest.approx(15.0, rel=0.005)
    assert found.dynamics.modes[0].damping == pytest.approx(0.0185, rel=0.15)


def test_a_peak_behind_a_slow_amplifier_is_found_below_lines_that_seem_high_by_chance() -> None:
    """It was refused for no resonance up to 8000 Hz: two noisy lines there were the peak."""
    settings = StageSettings(
        sample_rate=20_000.0, resonances=(92.5,), dampings=(0.02508,), amplifier_bandwidth=9.25, noise=0.0402,
        hysteresis_kind="preisach",
    )  # fmt: skip
    found = measure_bode(StagePlant(settings, seed=43), **LIMITS, seed=43)
    assert found.dynamics.modes[0].frequency == pytest.approx(92.5, rel=0.005)


def test_a_bandwidth_of_the_amplifier_that_is_not_known_is_not_good_and_that_of_the_data_sheet_mends_it() -> None:
    """The lag had 48 in place of 29 Hz, 85 at one standard deviation, and the response 64 % too much: `good`."""
    settings = StageSettings(
        sample_rate=2000.0, resonances=(288.9,), dampings=(0.0035,), amplifier_bandwidth=28.9, noise=0.0066
    )
    found, truth = measure_bode(StagePlant(settings, seed=100), **LIMITS, seed=100), settings.dynamics()
    below = np.linspace(1.0, 0.6 * 288.9, 50)
    assert np.abs(found.dynamics.response(below) / truth.response(below) - 1).max() > 0.05
    assert found.verdict.is_bad
    assert "State that of its data sheet (`amplifier_bandwidth`)" in " ".join(found.verdict.reasons)
    stated = measure_bode(StagePlant(settings, seed=100), **LIMITS, seed=100, amplifier_bandwidth=28.9)
    assert stated.verdict.level == "good"
    mended = stated.dynamics
    assert mended.amplifier_bandwidth == 28.9
    assert np.abs(mended.response(below) / truth.response(below) - 1).max() < 0.03


@pytest.mark.parametrize(("rate", "resonance"), [(5000.0, 3000.0), (2000.0, 1500.0)])
def test_a_resonance_above_half_of_the_sample_rate_is_named_first(rate: float, resonance: float) -> None:
    """More amplitude was asked for, or, as the measurement seemed early, another latency of the driver."""
    stage = StagePlant(StageSettings(sample_rate=rate, resonances=(resonance,), dampings=(0.02,)))
    words = f"A resonance above half of the sample rate, {rate / 2:g} Hz, appears below it"
    assert measure_bode(stage, **LIMITS).verdict.reasons[0].startswith(words)


def test_a_measurement_that_is_early_names_a_resonance_beyond_the_sample_rate() -> None:
    """The latency of the driver, and a filter, were all that it named."""
    stage = StagePlant(StageSettings(sample_rate=5000.0, resonances=(8000.0,), dampings=(0.01,)), seed=1)
    words = r"comes -0\.\d+ ticks .* possible: a stage that resonates above 2250 Hz, beyond what 5000 Hz sees, looks"
    with pytest.raises(DynamicsError, match=words):
        measure_bode(stage, **LIMITS, slew_limit=504.0, duration=1.0)


def test_what_is_assumed_of_the_sensor_is_said() -> None:
    """Its pole, 500 Hz, counts as the amplifier's: the response to 0.6 f0 is 65 % off, which no record shows."""
    settings = StageSettings(sample_rate=10_000.0, sensor_bandwidth=500.0)
    limits, rows, remarks = ((-0.6, 3.6), 504.0), [], []
    for known in ({}, {"sensor_bandwidth": 500.0}, {"sensor_bandwidth": 500.0, "sensor_delay": 1e-5}):
        found = measure_bode(StagePlant(settings, seed=1), **LIMITS, slew_limit=504.0, **known)
        assert found.verdict.level == "good"
        made = dynamics_page.page(found, *limits)
        rows += [row[1:] for row in dynamics_page.rows(found, *limits) if row[0] == "sensor"]
        remarks.append("assumed to have no lag or delay" in made.remark)
    assert remarks == [True, False, False]
    assert rows == [
        ["assumed ideal", "lag and delay of it count as the stage's: see its data sheet"],
        ["500 Hz", "as stated; its delay counts as the stage's"],
        ["500 Hz, 10 us", "as stated"],
    ]


def test_by_default_a_resonance_is_looked_for_as_far_as_the_sample_rate_shows_it() -> None:
    """The band ended at 8 kHz."""
    stage = StagePlant(StageSettings(sample_rate=50_000.0, resonances=(12_000.0,), dampings=(0.02,), noise=0.002))
    found = measure_bode(stage, **LIMITS, slew_limit=5e4, amplitude=0.3, duration=0.5)
    assert found.verdict.level == "good"
    assert found.dynamics.modes[0].frequency == pytest.approx(12_000.0, rel=0.001)


def test_where_the_response_is_lost_below_the_band_a_longer_excitation_is_asked_for_and_helps() -> None:
    """A higher sample rate was asked for, where 45 of 450 Hz were seen."""
    settings = StageSettings(
        sample_rate=1000.0, resonances=(15.0,), dampings=(0.001,), dead_time=5.2e-3, amplifier_bandwidth=852.0,
        noise=0.0363, hysteresis_kind="bouc-wen",
    )  # fmt: skip
    with pytest.raises(
        DynamicsError, match=r"no resonance from 4 to \d+ Hz, .*: if .*, raise `amplitude` or `duration`;"
    ):
        measure_bode(StagePlant(settings, seed=131), **LIMITS, seed=131)
    helped = measure_bode(StagePlant(settings, seed=131), **LIMITS, seed=131, duration=10.0)
    assert helped.verdict.level == "good"
    assert helped.dynamics.modes[0].frequency == pytest.approx(15.0, rel=0.001)


def test_noise_below_the_resonance_asks_for_the_amplitude_that_helps_not_for_a_duration_that_does_not() -> None:
    settings = StageSettings(
        sample_rate=5000.0, resonances=(689.0,), dampings=(0.011,), amplifier_bandwidth=200.0, noise=0.18
    )
    for options, level in (({}, "bad"), ({"duration": 6.0}, "bad"), ({"amplitude": 0.4, "slew_limit": 1e4}, "good")):
        found = measure_bode(StagePlant(settings, seed=150), **LIMITS, **options)
        assert found.verdict.level == level
        words = "" if found.verdict.reasons == () else found.verdict.reasons[0]
        assert words.endswith("raise `amplitude`.") == found.verdict.is_bad


def test_a_travel_that_was_given_is_named_where_more_of_it_helps() -> None:
    """A smaller amplitude keeps within it, and is lost in noise then; each remedy asked for the other."""
    known = {"duration": 0.5, "travel": 0.3}
    with pytest.raises(DynamicsError, match=r"or, where the stage may go so far, a larger `travel`$"):
        measure_bode(StagePlant(), **LIMITS, **known)
    with pytest.raises(DynamicsError, match=r"raise `amplitude` and, with it, `travel` \(0\.3 um\), or look"):
        measure_bode(StagePlant(), **LIMITS, **known, amplitude=0.0005)
    with pytest.raises(DynamicsError, match="raise `amplitude`, or look"):
        measure_bode(StagePlant(), **LIMITS, duration=0.5, amplitude=0.0005)


@pytest.mark.parametrize("noise", [0.01, 0.1], ids=["bad", "refused"])
def test_a_slew_limit_that_makes_the_excitation_small_is_named_with_what_helps(noise: float) -> None:
    stage = StagePlant(StageSettings(sample_rate=5000.0, resonances=(900.0,), noise=noise))
    try:
        reasons = " ".join(measure_bode(stage, **LIMITS, slew_limit=10.0, duration=1.0).verdict.reasons)
    except DynamicsError as error:
        reasons = str(error)
    found = re.search(r"raise the slew limit, 10 V/s, which makes the excitation small: up to ([\d.]+) V/s", reasons)
    assert found, reasons
    assert "`amplitude`" not in reasons  # which the slew limit does not allow
    helped = measure_bode(stage, **LIMITS, slew_limit=float(found[1]), duration=1.0)
    assert not helped.verdict.is_bad


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"resonance": 0.0}, "no resonance from 8 to "),
        ({"resonance": 990.0}, "if there is one above, raise the sample rate"),
        ({"sensitivity": 1e-5}, "look at amplifier, cables and channels"),
        ({"noise": 20.0, "sensitivity": 3.0}, "coherence .* from 8 Hz on; raise `amplitude`"),
    ],
)
def test_what_is_no_stage_is_refused(settings: dict[str, float], words: str) -> None:
    with pytest.raises(DynamicsError, match=words):
        measure_dynamics(RealisticPlant(PlantSettings(**settings)), **LIMITS, duration=1.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"amplitude": 3.0}, "amplitude = 3.0 V: must be up to 2.1 V, from the bias of 1.5 V"),
        ({"amplitude": 0.1, "slew_limit": 2.0}, "V/s are needed, the slew limit is 2 V/s"),
        ({"band": (5.0, 950.0)}, r"band = \(5.0, 950.0\) Hz: must be within 1 Hz, .* and 900 Hz, 0.45 of the rate"),
        ({"bias": 4.0}, "bias = 4.0 V: must be from -0.6 to 3.6 V"),
        ({"modes": 4}, "modes = 4: must be a whole number from 1 to 3"),
    ],
)
def test_an_excitation_beyond_its_limits_is_refused(options: dict[str, object], words: str) -> None:
    stage = Spied(StagePlant(StageSettings(sample_rate=2000.0, resonances=(200.0,))))
    with pytest.raises(SettingError, match=words):
        measure_bode(stage, **{**LIMITS, **options})
    assert stage.volts[-1:] in ([], [pytest.approx(0.0, abs=1e-9)])


# ---- The command ---------------------------------------------------------------------------------------------------

CONFIG = """
[driver]
name = "simulated"
sample_rate = 2000.0
plant = { resonance = RESONANCE, damping = 0.02 }
hardware_timed = true

[[axis]]
voltage_limits = [-0.6, 3.6]
slew = 400.0
"""


def run(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["bode", *words])
    return done.exit_code, done.output


def test_the_command_writes_dynamics_and_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("axis.toml").write_text(CONFIG.replace("RESONANCE", "300.0"))
    code, printed = run("--config", "axis.toml", "--duration", "1", "--json")
    said = json.loads(printed)
    assert (code, said["verdict"]) == (0, "good")
    found = Dynamics.load("dynamics.toml")
    assert found == Dynamics.from_dict(said["dynamics"])
    assert found.modes[0].frequency == pytest.approx(300.0, rel=0.003)
    page = Path("dynamics.html").read_text()
    assert all(words in page for words in ("mode 1", "trusted to", "slew of 400 V/s", "bode-title"))


TWO = """
[driver]
name = "simulated"
sample_rate = 2000.0
channels = 2
axes = {stages = [{resonances = [300.0]}, {resonances = [210.0]}], coupling = [[0.0, 0.03], [0.03, 0.0]]}

[[axis]]
name = "x"
voltage_limits = [-0.6, 3.6]
slew = 400.0

[[axis]]
name = "y"
voltage_limits = [-0.6, 3.6]
slew = 400.0
"""


@pytest.mark.usefixtures("each_picture_once")
def test_the_command_measures_one_axis_of_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("xy.toml").write_text(TWO)
    assert run("--config", "xy.toml", "--axis", "y", "--duration", "1", "--output", "y")[0] == 0
    assert Dynamics.load("y.toml").modes[0].frequency == pytest.approx(210.0, rel=0.003)
    for words, said in (
        (("--config", "xy.toml"), "xy.toml: --axis = missing: must be one of x, y"),
        (("--config", "xy.toml", "--axis", "z"), "xy.toml: --axis = 'z': must be one of x, y"),
        (("--axis", "x"), "--axis x: names an axis of a configuration; it needs --config"),
    ):
        code, printed = run(*words)
        assert (code, said in printed) == (2, True), printed
    Path("slow.toml").write_text(TWO.replace("slew = 400.0", "slew = 0.1"))  # which has no slew_limit
    code, printed = run("--config", "slow.toml", "--axis", "x", "--output", "s")
    assert (code, "slow.toml: slew of the axis = 0.1 V/s: must be at least 0.4" in printed) == (2, True), printed


DRIVER, X, Y = TWO.replace("[[axis]]", "#[[axis]]").split("#")
UNSAFE = Y.replace("[-0.6, 3.6]", "[0.0, 1000.0]\nsafe_voltage = 500.0")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DRIVER + X + Y.replace('"y"', '"x"'), "xy.toml: name = x, x: must be different for each axis"),
        (
            DRIVER + X + Y.replace("slew", "slw"),
            "xy.toml: [[axis]] 2: slw = 400.0: must be left out; did you mean slew",
        ),
        (f"axis = []\n{DRIVER}", "xy.toml: axis = []: must be at least one table [[axis]]"),
        (f"axis = 3\n{DRIVER}", "xy.toml: axis = 3: must be a list"),
        (DRIVER, "xy.toml: axis = missing: must be given, such as a table [[axis]]"),
        (DRIVER + X + Y + Y.replace('"y"', '"z"'), "the number of axes = 3: must be 2, one for each channel"),
        (DRIVER + X, "channels of the driver = 2: must be 1"),
        (DRIVER + X + UNSAFE, "safe_voltage of axis y = 500.0 V: must be from"),
    ],
)
def test_the_command_says_which_axes_are_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("xy.toml").write_text(text)
    code, printed = run("--config", "xy.toml", "--axis", "x")
    assert (code, words in printed) == (2, True), printed


def test_a_bad_measurement_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("axis.toml").write_text(CONFIG.replace("RESONANCE", "0.0"))
    code, printed = run("--config", "axis.toml", "--duration", "1")
    assert code == 3
    assert "BAD" in printed
    assert "no resonance from 8 to" in printed
    assert not Path("dynamics.toml").exists()
    assert printed.endswith("written    no dynamics, as the verdict is bad\n")
    Dynamics(sample_rate=5000.0, modes=(Mode(frequency=400.0, damping=0.01),)).save("dynamics.toml")
    older = "written no dynamics, as the verdict is bad; dynamics.toml is of an older measurement"
    assert older in " ".join(run("--config", "axis.toml", "--duration", "1")[1].split())
    Path("dynamics.toml").write_text("mine")
    assert run("--config", "axis.toml")[0] == 1
    assert Path("dynamics.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"amplitude": 3.0}, "amplitude"),
        ({"bias": 3.59}, "bias"),
        ({"travel": -1.0}, "travel"),
        ({"slew_limit": 0.01}, "slew_limit"),
        ({"sensor_delay": 1.0}, "sensor_delay"),
        ({"sensor_bandwidth": -1.0}, "sensor_bandwidth"),
    ],
)
def test_what_can_be_refused_before_the_stage_moves_is(
    options: dict[str, float], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = StagePlant(StageSettings(sample_rate=5000.0))
    monkeypatch.setattr(stage, "exchange", lambda volts: pytest.fail("it moved"))
    with pytest.raises(SettingError, match=named):
        measure_bode(stage, **{**LIMITS, **options})


def test_foreign_stages_are_followed_within_a_third_of_a_per_cent() -> None:
    """`python -m benchmarks.foreign_stages` has 24 of them; one with a second mode, measured first, for 1 s."""
    motion, rms, largest = foreign_stages.follow(3, given=True, duration=1.0)
    assert motion == "sine   0.15 f0 good"
    assert rms < 0.1
    assert largest < 1.0


@pytest.mark.parametrize("reading", [0.0, 7.3])
def test_a_sensor_that_reads_a_constant_is_named(reading):
    """Without any noise, as of a channel that is not connected."""

    class Constant(StagePlant):
        def exchange(self, volts):
            return np.full(np.shape(volts), reading)

    with pytest.raises(DynamicsError, match=r"move the stage by .* um, its noise is 0 um: look at amplifier, cables"):
        measure_bode(Constant(), voltage_limits=(-0.6, 3.6))


class Filtered(Stage):
    """Behind a digital filter of first order, which begins at rest."""

    memory = np.zeros(1)

    def exchange(self, volts):
        z, self.memory = lfilter([0.7], [1.0, -0.3], super().exchange(volts), zi=self.memory)
        return z


@pytest.mark.parametrize(("rate", "lag"), [(2000.0, 0.0), (4000.0, 8000.0)])
def test_a_measurement_that_seems_early_may_be_behind_a_digital_filter(rate, lag):
    modes = [(0.25 * rate, 0.006, 1.0)]
    stage = Filtered(modes, rate, hysteresis=Duhem(0.15), lag=lag)
    with pytest.raises(
        DynamicsError, match=r"-0\.[67]\d ticks .*latency of the driver; a digital filter in the sensor"
    ):
        measure_dynamics(stage, voltage_limits=(0.0, 10.0))
