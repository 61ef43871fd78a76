"""The stage for fast motion: each part against closed forms, scipy and `Dynamics`; the kernel against the text."""

import copy
import itertools
import pickle

import numpy as np
import pytest
from scipy.integrate import dblquad, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import TransferFunction, find_peaks, step

from truestroke import AdaptiveController, ControllerSettings, SettingError
from truestroke.plant import StagePlant, StageSettings, stage_reference
from truestroke.plant.noise import Noise
from truestroke.runtime.batch import Simulation, simulate_many
from truestroke.runtime.loop import run
from truestroke.signals import trajectories

KINDS = ("plays", "preisach", "bouc-wen")
STILL = {"creep": 0.0, "noise": 0.0}
LINEAR = {**STILL, "loop_width": 0.0, "stroke": 1.0, "voltage_limits": (-1.0, 1.0)}  # um = V
AT_ONCE = {"samples_per_tick": 1, "steps_per_tick": 2}  # a measurement is the displacement in the middle of its tick
STIFF = {**AT_ONCE, "amplifier_bandwidth": 0.0, "resonances": (50e3,), "dampings": (0.7,), "sample_rate": 2000.0}


def response(volts, pushes=(), **settings):
    """Measured and true displacement; `pushes` are the load tick by tick."""
    stage = StagePlant(StageSettings(**settings), load=pushes)
    return stage.exchange(np.asarray(volts, dtype=float)), stage.truth


def polynomials(resonance, damping, share):
    w = 2 * np.pi * resonance
    return share * np.array([w**2]), np.array([1.0, 2 * damping * w, w**2])


# ---- What is linear


@pytest.mark.parametrize("late", [0.0, 0.37, 3.0, 18.8])
def test_a_step_through_dead_time_amplifier_and_modes_is_that_of_scipy(late):
    _, z = response(np.ones(80), **LINEAR, **AT_ONCE, resonances=(700.0, 2300.0), dampings=(0.02, 0.05),
                    shares=(1.1, -0.1), amplifier_bandwidth=3000.0, dead_time=late * 1e-4)  # fmt: skip
    (n1, d1), (n2, d2) = polynomials(700.0, 0.02, 1.1), polynomials(2300.0, 0.05, -0.1)
    lag = np.array([1 / (2 * np.pi * 3000.0), 1.0])
    system = TransferFunction(np.polyadd(np.polymul(n1, d2), np.polymul(n2, d1)), np.polymul(lag, np.polymul(d1, d2)))
    after = (np.arange(80) + 0.5 - late) * 1e-4
    grid = np.linspace(0, 8e-3, 8001)
    expected = np.where(after > 0, CubicSpline(grid, step(system, T=grid)[1])(after), 0.0)
    assert z == pytest.approx(expected, abs=1e-6)


def test_a_fast_sine_has_the_gain_and_phase_of_its_dynamics():
    settings = {**LINEAR, "resonances": (700.0, 2300.0), "dampings": (0.05, 0.05), "shares": (0.9, 0.1),
                "dead_time": 1.3e-4, "sensor_delay": 0.7e-4, "sensor_bandwidth": 900.0}  # fmt: skip
    known = StageSettings(**settings).dynamics()
    turn = np.exp(2j * np.pi * 410.0 * np.arange(4000) / 1e4)
    measured, true = response(turn.imag, **settings)
    whole = slice(2000, 4000)  # 82 periods
    for z, sensor in ((true, False), (measured, True)):
        seen = 2j * np.mean((z * turn.conj())[whole])
        assert seen == pytest.approx(complex(known.response(410.0, sensor=sensor)), rel=3e-3)  # a mean of 5 samples


def test_the_sensor_lags_and_delays_what_is_measured_alone():
    t = (np.arange(200) + 0.5) * 1e-4
    settings = {**LINEAR, **AT_ONCE, "steps_per_tick": 20}
    _, true = response(np.ones(200), **settings)
    measured, same = response(np.ones(200), **settings, sensor_bandwidth=300.0, sensor_delay=2.45e-4)
    assert np.array_equal(true, same)
    fine = np.arange(20_001) * 1e-6
    stage = np.polymul([1 / (2 * np.pi * 3000.0), 1.0], polynomials(700.0, 0.02, 1.0)[1])
    system = TransferFunction(polynomials(700.0, 0.02, 1.0)[0], np.polymul(stage, [1 / (2 * np.pi * 300.0), 1.0]))
    expected = np.interp(t - 2.45e-4, fine, step(system, T=fine)[1], left=0.0)
    assert measured == pytest.approx(expected, abs=2e-4)


def test_creep_is_a_straight_line_over_log_time():
    _, z = response(np.ones(20_000), **{**LINEAR, **STIFF, "creep": 0.015})
    t = np.arange(20_000) / 2000.0
    crept = z[[200, 2000, 19_999]] - z[0]
    assert np.diff(crept) / np.diff(np.log10(t[[200, 2000, 19_999]])) == pytest.approx([0.015, 0.015], rel=0.05)


# ---- Hysteresis


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limits", [(-0.6, 3.6), (-10.0, 10.0)])
def test_the_loop_is_as_high_and_as_wide_as_told(kind, limits):
    up = np.linspace(0, limits[1], 500)
    volts = np.concatenate([up, up[::-1]] * 5)
    _, z = response(volts, **STILL, **STIFF, voltage_limits=limits, hysteresis_kind=kind, loop_width=0.11, stroke=40.0)
    rise, fall = z[-1000:-500], z[:-501:-1]
    assert rise[-1] - fall[0] == pytest.approx(40.0, rel=2e-4)
    assert np.max(fall - rise) == pytest.approx(0.11 * 40.0, rel=2e-3)
    assert np.all(np.diff(rise) > 0)


def test_one_play_with_two_envelopes_by_hand():
    """r = R / 2 = 0.2, a = 0.1: up along x - 0.1 x^2 - 0.2, down along x + 0.1 x^2 + 0.2.

    P goes from 0.2 at 0 to 0.7 at 1. Its branches are farthest apart where the fall begins: at x + 0.1 x^2 = 0.5.
    """
    settings = {"plays": 1, "threshold_max": 0.4, "envelope": 0.1, "loop_width": 0.1, "stroke": 1.0}
    x = np.array([1, 0, 1, 0.5, 0, 0.5, 1])
    _, z = response(x, **STILL, **STIFF, voltage_limits=(0.0, 1.0), **settings)
    falls = np.sqrt(25 + 5) - 5
    weight = 0.1 / (0.7 - (falls - 0.1 * falls**2 - 0.2))
    expected = x + weight * (np.array([0.7, 0.2, 0.7, 0.7, 0.2, 0.275, 0.7]) - 0.5 * x)
    assert z == pytest.approx(expected, abs=1e-4)


def test_everett_function_is_the_integral_of_its_density():
    s = StageSettings(preisach_scale=0.4, preisach_tilt=-0.5, preisach_curvature=2.0)

    def density(b, a):
        middle = (a + b) / 2 - 0.5
        return np.exp(-(a - b) / 0.4) * (1 - 0.5 * middle + 2 * middle**2)

    for high, low in ((0.9, 0.1), (0.3, -0.2), (0.62, 0.6)):
        expected = dblquad(density, low, high, low, lambda a: a)[0]
        assert stage_reference.everett(s, high, low) == pytest.approx(expected, rel=1e-9)


def minor_loops(kind, turns=((0.2, 0.35), (0.8, 0.95))):
    """Each twice around on the rising branch, after the major loop: the true displacement, a row a loop."""
    rows = []
    for low, high in turns:
        path = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise((0, 1, 0, high, low, high, low))])
        rows.append(response(path, **STILL, **STIFF, voltage_limits=(0.0, 1.0), hysteresis_kind=kind, stroke=1.0)[1])
    return np.array(rows)


def test_minor_loops_of_preisach_close_and_are_not_congruent():
    z = minor_loops("preisach")
    assert z[:, 799] == pytest.approx(z[:, 1199], abs=1e-9)  # high -> low -> high ends on the loop
    assert z[:, 999] != pytest.approx(z[:, 799], abs=1e-3)
    heights = z[:, 599] - z[:, 799]
    assert abs(heights[1] / heights[0] - 1) > 0.01
    plays = minor_loops("plays")
    assert plays[:, 799] == pytest.approx(plays[:, 1199], abs=1e-9)


def test_bouc_wen_follows_its_equation_and_its_minor_loops_do_not_close():
    z = minor_loops("bouc-wen")
    assert np.min(np.abs(z[:, 799] - z[:, 1199])) > 1e-4
    beta, gamma, n = 4.0, 1.0, 1.6
    t = np.linspace(0, 1, 1001)
    x = 0.5 - 0.5 * np.cos(6 * np.pi * t) * np.linspace(1, 0.5, t.size)

    def slope(time, q):
        rate = np.interp(time, t[:-1] + 0.5 * t[1], np.diff(x) / t[1])
        return rate - beta * abs(rate) * q * abs(q) ** (n - 1) - gamma * rate * abs(q) ** n

    q = solve_ivp(slope, (0, 1), [0.0], t_eval=t, max_step=1e-3, rtol=1e-6, atol=1e-9).y[0]
    z = response(x, **STILL, **STIFF, voltage_limits=(0.0, 1.0), hysteresis_kind="bouc-wen", bouc_wen_beta=beta,
                 bouc_wen_gamma=gamma, bouc_wen_exponent=n, stroke=1.0)[1]  # fmt: skip
    fit = np.linalg.lstsq(np.stack([x, q], axis=1), z, rcond=None)
    assert np.max(np.abs(np.stack([x, q], axis=1) @ fit[0] - z)) < 3e-4
    assert fit[0][1] < -0.1  # q leads: the strain lags


# ---- Changes and disturbances


def test_all_resonances_jump_by_a_factor_and_drift():
    settings = {**LINEAR, **AT_ONCE, "dampings": (1e-4,), "resonance_change": 1.05, "resonance_change_time": 0.5}
    _, z = response(np.ones(10_000), **settings, resonance_drift=0.01)
    t = (np.arange(10_000) + 0.5) * 1e-4
    for part, factor in ((t < 0.5, 1.0), (t > 0.5, 1.05)):
        signal, time = z[part] - 1, t[part]
        spectrum = np.abs(np.fft.rfft(signal * np.hanning(signal.size), 1 << 20))
        found = np.argmax(spectrum) * 1e4 / (1 << 20)
        assert found == pytest.approx(700.0 * factor * (1 + 0.01 * np.mean(time) / 60), abs=0.03)


def test_a_load_on_the_stage_rings_and_one_behind_it_does_not():
    settings = {**LINEAR, **AT_ONCE, "sample_rate": 50e3, "load": 0.5, "load_time": 0.01}
    _, z = response(np.zeros(2000), **settings)
    root = np.sqrt(1 - 0.02**2)
    assert np.all(z[:500] == 0)
    assert z[find_peaks(z)[0][0]] == pytest.approx(0.5 * (1 + np.exp(-np.pi * 0.02 / root)), rel=1e-3)
    _, behind = response(np.zeros(2000), **settings, load_on_stage=False)
    assert np.array_equal(behind, np.repeat([0.0, 0.5], [500, 1500]))
    _, same = response(np.zeros(2000), np.repeat([0.0, 0.5], [500, 1500]), **settings | {"load": 0.0})
    assert same == pytest.approx(z, abs=1e-12)


def test_a_sine_of_load_is_answered_by_the_modes_and_hum_is_not():
    t = (np.arange(8000) + 0.5) * 1e-4
    settings = {**LINEAR, **AT_ONCE, "load": 0.2, "load_frequency": 350.0, "dampings": (0.05,)}
    _, z = response(np.zeros(8000), **settings | {"steps_per_tick": 10}, amplifier_bandwidth=0.0)
    gain = 1 / (1 - 0.25 + 0.05j)
    assert z[4000:] == pytest.approx(0.2 * np.imag(gain * np.exp(2j * np.pi * 350.0 * t[4000:])), abs=1e-3)
    _, z = response(np.zeros(8000), **LINEAR, **AT_ONCE, hum=0.1, hum_frequency=50.0)
    assert z == pytest.approx(0.1 * np.sin(2 * np.pi * 50.0 * t), abs=1e-12)


# ---- The whole chain


@pytest.mark.parametrize(("kind", "bandwidth"), [("plays", 3000.0), ("preisach", 0.0), ("bouc-wen", 3000.0)])
def test_kernel_is_the_readable_text(kind, bandwidth):
    s = StageSettings(
        hysteresis_kind=kind, bouc_wen_exponent=1.5, amplifier_bandwidth=bandwidth, load_on_stage=bandwidth > 0,
        resonances=(700.0, 2300.0), dampings=(0.02, 0.02), shares=(0.9, 0.1), resonance_drift=0.1 * (bandwidth == 0),
        resonance_change=1.05, resonance_change_time=2e-3, dead_time=1.73e-4, sensor_delay=1.3e-4,
        sensor_bandwidth=2000.0, load=0.5, load_frequency=50.0, load_time=1e-3, hum=0.1, samples_per_tick=2,
        steps_per_tick=4,
    )  # fmt: skip
    random = np.random.default_rng(0)
    volts = np.concatenate([1.5 + 1.5 * np.sin(np.arange(30)) * np.linspace(0, 1, 30), random.uniform(-2, 5, 30)])
    load = 0.1 * random.normal(size=60)
    measured, truth = stage_reference.simulate(s, volts, Noise(3).take(120).reshape(60, 2), load)
    stage = StagePlant(s, seed=3, load=load)
    assert stage.exchange(volts) == pytest.approx(measured, abs=1e-11)
    assert stage.truth == pytest.approx(truth, abs=1e-11)


def test_blocks_copies_and_reopening_give_the_same_bits():
    random = np.random.default_rng(1)
    volts, load = random.uniform(-0.6, 3.6, 900), random.normal(size=500)
    stage = StagePlant(StageSettings(hysteresis_kind="preisach", dead_time=2.3e-4), seed=5, load=load)
    whole = stage.exchange(volts)
    stage.open()
    parts = [stage.exchange(volts[:1]), stage.exchange(volts[1:400])]
    copies = [copy.deepcopy(stage), pickle.loads(pickle.dumps(stage)), stage]
    for other in copies:
        assert np.array_equal(np.concatenate([*parts, other.exchange(volts[400:])]), whole)


def test_a_batch_has_the_bits_of_run():
    wave = trajectories.sine(frequency=40.0, peak_to_peak=10.0, duration=0.1, ramp=0.02, sample_rate=10e3)
    control = ControllerSettings(sample_rate=10e3, stroke=30.0, voltage_limits=(-0.6, 3.6))
    plant = StageSettings(hysteresis_kind="bouc-wen", resonances=(1200.0,))
    simulation = Simulation(trajectory=wave, controller=control, plant=plant, seed=3, dropouts=((300, 310),))
    batch = simulate_many([simulation], record=["measured", "true"])
    one = run(wave, AdaptiveController.from_settings(control), StagePlant(plant, 3, ((300, 310),)))
    assert np.array_equal(batch["measured"][0], one["measured"], equal_nan=True)
    assert np.array_equal(batch["true"][0], one["true"])


def test_what_a_stage_cannot_be_is_said():
    for bad, name in (
        ({"shares": (0.9,)}, "shares"),
        ({"resonances": (700.0, 600.0)}, "resonances"),
        ({"dampings": (0.1, 0.1)}, "dampings"),
        ({"dead_time": 0.0021}, "dead_time"),
        ({"steps_per_tick": 15}, "steps_per_tick"),
        ({"hysteresis_kind": "duhem"}, "hysteresis_kind"),
        ({"voltage_limits": (1.0, 2.0)}, "voltage_limits"),
        ({"bouc_wen_gamma": -4.1}, "bouc_wen_gamma"),
    ):
        with pytest.raises(SettingError, match=name):
            StageSettings(**bad)
    with pytest.raises(SettingError, match=r"loop_width = 0\.5: must be smaller for bouc-wen"):
        StagePlant(StageSettings(hysteresis_kind="bouc-wen", loop_width=0.5))
    with pytest.raises(SettingError, match="no play would move"):
        StagePlant(StageSettings(plays=1, threshold_max=1.0, envelope=0.0))
