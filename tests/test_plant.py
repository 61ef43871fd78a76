"""The simulated actuators: each effect by its own physics, the chain against the readable text, blocks, schedule."""

import dataclasses
import json
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, find_peaks, sosfilt

from truestroke import AdaptiveController, ControllerSettings, SettingError
from truestroke.plant import EFFECTS, Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant, reference
from truestroke.plant.noise import Noise


def only(*effects, **changes):
    """The default plant with these effects alone."""
    return dataclasses.replace(PlantSettings(), **changes).without(*(set(EFFECTS) - set(effects)))


def response(plant_settings, volts, seed=0):
    plant = RealisticPlant(plant_settings, seed=seed)
    return plant.exchange(np.asarray(volts, dtype=float)), plant.truth


def cycles(frequency, amplitude, number, sample_rate=2000.0):
    t = np.arange(int(number * sample_rate / frequency)) / sample_rate
    return amplitude * (1 - np.cos(2 * np.pi * frequency * t))


def smooth_wave(ticks, seed=5):
    random = np.random.default_rng(seed)
    wave = sosfilt(butter(4, 20, fs=2000, output="sos"), random.uniform(-1, 1, ticks))
    return 1.2 + 1.2 * wave / np.max(np.abs(wave))


# ---- Each effect alone


def test_without_all_effects_it_is_a_straight_line():
    volts = np.linspace(-50, 50, 101)
    measured, truth = response(PlantSettings().without(*EFFECTS), volts)
    assert np.array_equal(measured, truth)
    assert truth == pytest.approx(12.57 * volts, rel=1e-14)


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_matters_and_switches_off_by_itself(effect):
    everything = dataclasses.replace(
        PlantSettings(),
        change=Change(time=0.01, gain=0.9),
        ageing_gain=-0.5,
        ad_limits=(-2.0, 30.0),
        da_limits=(-0.5, 9),
    )
    volts = np.concatenate([smooth_wave(400), [4.0] * 20, [-0.7] * 20])
    whole, without = response(everything, volts)[0], response(everything.without(effect), volts)[0]
    assert np.max(np.abs(whole - without)) > 1e-6


def test_da_converter_rounds_to_16_bits_and_stops_at_its_limits():
    s = only("da_quantisation", "da_limits")
    _, truth = response(s, np.linspace(0, 0.01, 1001))
    steps = np.diff(np.unique(truth))
    assert steps == pytest.approx(12.57 * 20 / 65536, rel=1e-9)
    assert response(s, [25.0, -25.0])[1] == pytest.approx([125.7, -125.7], rel=1e-12)


def test_stack_voltage_stays_between_minus_20_and_120():
    assert response(only("stack_limits"), [9.0, -9.0])[1] == pytest.approx([12.57 * 3.6, -12.57 * 0.6], rel=1e-12)


def test_lag_is_first_order():
    _, truth = response(only("lag", sample_rate=20e3), np.ones(40))
    t = np.arange(1, 41) / 20e3
    assert truth == pytest.approx(12.57 * (1 - np.exp(-2 * np.pi * 500 * t)), rel=1e-12)


def test_hysteresis_has_the_published_slopes_and_the_loop_width_of_piezo_stacks():
    s = only("hysteresis")
    _, z = response(s, [0.0, 1e-3, 3.6, 3.599, 0.0])
    assert z[1] / 1e-3 == pytest.approx(8.4, rel=1e-2)  # at first contact and after turning: a_p0
    assert (z[2] - z[3]) / 1e-3 == pytest.approx(8.4, rel=1e-2)
    assert (z[2] - z[4]) / 3.6 == pytest.approx(12.57, rel=1e-12)  # chord of the major loop: sum of a_p


@pytest.mark.parametrize(("frequency", "low", "high"), [(1.0, 0.10, 0.14), (20.0, 0.15, 0.20)])
def test_loop_is_10_to_20_percent_wide_and_wider_when_faster(frequency, low, high):
    volts = cycles(frequency, 1.2, 4)
    _, z = response(PlantSettings(), volts)
    n = int(2000 / frequency)
    x, z = volts[-n:], z[-n:]
    up, down = np.interp(1.2, x[: n // 2], z[: n // 2]), np.interp(1.2, x[: n // 2 - 1 : -1], z[: n // 2 - 1 : -1])
    assert low < (down - up) / np.ptp(z) < high
    assert np.sum(0.5 * (x + np.roll(x, 1)) * (z - np.roll(z, 1))) > 0  # a cycle takes energy, it gives none


voltages = st.floats(-0.6, 3.6)


@settings(max_examples=60, deadline=None)
@given(st.lists(voltages, min_size=1, max_size=8), voltages, st.floats(0.01, 0.99), st.floats(0.01, 0.99))
def test_hysteresis_forgets_closed_loops(history, low, rise, dip):
    """Wiping out: high, low, x, y, x with low < y < x ends where x was before; and what came earlier is forgotten."""
    high = 3.9
    x = low + rise * (high - low)
    y = low + dip * (x - low)
    s = only("hysteresis")
    _, z = response(s, [*history, -0.7, high, low, x, y, x, high])
    assert z[-2] == pytest.approx(z[-4], abs=1e-12)
    assert z[-1] == pytest.approx(z[-6], abs=1e-12)
    assert response(s, [-0.7, high, low, x, y])[1][1:] == pytest.approx(z[-6:-2], abs=1e-12)


def test_asymmetry_bends_and_keeps_its_stroke():
    _, z = response(only("asymmetry"), np.array([0.0, 22.5, 45.0]) / 12.57)
    assert z == pytest.approx([0.0, 22.5 * 1.028, 45.0], rel=1e-12)


def test_creep_is_a_straight_line_over_log_time():
    """1 to 2 % of the motion per decade of time: Physik Instrumente, "Fundamentals of Piezomechanics"."""
    _, z = response(only("creep", sample_rate=200.0, steps_per_tick=5), np.ones(200 * 101))
    t = np.geomspace(0.03, 100, 60)
    crept = np.interp(np.log(t), np.log(np.arange(1, len(z) + 1) / 200), z) / 12.57 - 1
    slope, start = np.polyfit(np.log10(t), crept, 1)
    assert slope == pytest.approx(0.015, rel=0.02)
    assert np.max(np.abs(crept - start - slope * np.log10(t))) < 0.0005


def test_resonance_rings_at_its_frequency_with_its_damping():
    s = only("resonance", sample_rate=200e3, steps_per_tick=5)
    _, z = response(s, np.ones(4000))
    peaks, _ = find_peaks(z)
    over = z[peaks] - 12.57
    root = np.sqrt(1 - 0.03**2)
    assert 200e3 / np.mean(np.diff(peaks)) == pytest.approx(900 * root, rel=2e-3)
    assert over[1:] / over[:-1] == pytest.approx(np.exp(-2 * np.pi * 0.03 / root), rel=2e-3)
    assert over[0] / 12.57 == pytest.approx(np.exp(-np.pi * 0.03 / root), rel=1e-3)


def test_lag_and_resonance_together_follow_the_transfer_function():
    """Amplitude and phase of a sine behind both, against 1 / (1 + i f/f_a) 1 / (1 - (f/f_r)^2 + 2 i zeta f/f_r)."""
    f, rate = 300.0, 60e3
    volts = np.sin(2 * np.pi * f * np.arange(24000) / rate)
    _, z = response(only("lag", "resonance", sample_rate=rate, steps_per_tick=5), volts)
    t = (np.arange(24000) + 0.5) / rate  # the hold delays by half a tick; samples are at the end of a tick
    seen = 2 * np.mean((z * np.exp(-2j * np.pi * f * (t + 0.5 / rate)))[12000:]) * 1j * np.exp(1j * np.pi * f / rate)
    u = f / 900
    expected = 12.57 / (1 + 1j * f / 500) / (1 - u**2 + 2j * 0.03 * u)
    assert seen == pytest.approx(expected, rel=1e-3)


def test_drift_is_a_bounded_warm_up():
    measured, truth = response(only("drift", sample_rate=1.0), np.zeros(3000))
    t = np.arange(3000) + 0.5
    assert truth == pytest.approx(0.2 * (1 - np.exp(-t / 600)), abs=1e-12)
    assert np.array_equal(measured, truth)


def test_noise_is_white_and_averaging_divides_it():
    volts = np.zeros(40000)
    one, five = response(only("noise"), volts)[0], response(only("noise", "averaging"), volts)[0]
    assert np.std(one) == pytest.approx(0.030, rel=0.02)
    assert np.std(five) == pytest.approx(0.030 / np.sqrt(5), rel=0.02)
    assert abs(np.corrcoef(five[1:], five[:-1])[0, 1]) < 0.02


def test_measurement_is_the_mean_of_five_samples():
    s = PlantSettings().without("noise", "ad_quantisation", "drift")
    slow = response(s, smooth_wave(300))[0]
    ten_kilohertz = dataclasses.replace(s, sample_rate=10e3, samples_per_tick=1, steps_per_tick=2)
    fast = response(ten_kilohertz, np.repeat(smooth_wave(300), 5))[0]
    assert slow == pytest.approx(fast.reshape(-1, 5).mean(axis=1), abs=1e-12)


def test_ad_converter_rounds_to_16_bits_and_stops_at_its_limits():
    s = only("ad_quantisation", "ad_limits")
    measured, truth = response(s, np.linspace(0, 3, 500))
    codes = measured / (100 / 65536)
    assert codes == pytest.approx(np.round(codes), abs=1e-8)
    assert np.max(np.abs(measured - truth)) <= 0.5 * 100 / 65536 * (1 + 1e-9)
    assert response(s, [9.0, -9.0])[0].tolist() == [75.0, -25.0]


# ---- Schedule


def test_sudden_change_falls_on_its_tick_inside_a_block():
    change = Change(time=0.0125, gain=0.8, hysteresis=1.5)
    s, volts = only("hysteresis", "change", change=change), smooth_wave(60)
    before, after = response(s.without("change"), volts)[1], response(s, volts)[1]
    assert np.array_equal(after[:25], before[:25])
    linear = response(s.without("change", "hysteresis"), volts)[1]
    bent = 0.8 * (linear + 1.5 * (before - linear))  # the hysteretic part is what differs from the straight line
    assert after[25:] == pytest.approx(bent[25:], rel=1e-12)
    assert [Change(time=t).tick(2000.0) for t in (0.0, 0.0123, 2.5, 2.50001)] == [0, 25, 5000, 5001]


def test_ageing_is_linear_in_hours():
    s = only("ageing", sample_rate=1.0, ageing_gain=-0.02)
    _, z = response(s, np.ones(7201))
    assert z[[0, 3600, 7200]] == pytest.approx([12.57, 12.57 * 0.98, 12.57 * 0.96], rel=1e-12)


# ---- The whole chain


@pytest.mark.parametrize("off", [(), ("lag",), ("resonance",), ("lag", "resonance", "averaging"), ("hysteresis",)])
def test_kernel_is_the_readable_text(off):
    change = Change(time=0.05, gain=0.7, hysteresis=1.4)
    s = PlantSettings(change=change, ageing_gain=-0.9, ageing_hysteresis=0.9, plays=57).without(*off)
    volts = np.concatenate([smooth_wave(150), np.linspace(5, -2, 10), np.random.default_rng(0).uniform(-1, 4, 40)])
    noise = Noise(3).take(200 * s.samples_per_tick).reshape(200, -1)
    plant = RealisticPlant(s, seed=3)
    measured, truth = reference.simulate(s, volts, noise)
    assert plant.exchange(volts) == pytest.approx(measured, abs=1e-12)
    assert plant.truth == pytest.approx(truth, abs=1e-12)


def test_ten_times_finer_steps_change_nothing_that_matters():
    s = PlantSettings().without("noise", "ad_quantisation")
    volts = smooth_wave(2000) * np.clip(np.arange(2000) / 500, 0, 1)
    coarse = response(s, volts)[1]
    fine = response(dataclasses.replace(s, steps_per_tick=10 * s.steps_per_tick), volts)[1]
    assert np.max(np.abs(coarse - fine)) < 1e-3  # um
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 2e-4


@pytest.mark.parametrize(
    "make",
    [
        lambda: RealisticPlant(PlantSettings(change=Change(time=0.3, gain=0.9)), seed=11),
        lambda: MatchedPlant(
            np.linspace(0, 300, 5000), MatchedSettings(change=Change(time=0.3), weight_spread=0.3), seed=11
        ),
    ],
    ids=["realistic", "matched"],
)
def test_blocks_ticks_and_reopening_give_the_same_bits(make):
    plant, volts = make(), smooth_wave(5000)
    plant.open()
    block = plant.exchange(volts)
    truth = plant.truth
    plant.open()
    parts, truths = [], []
    for part in np.split(volts, [1, 2, 3, 700, 701, 4000]):
        parts.append(plant.exchange(part))
        truths.append(plant.truth)
    assert np.array_equal(np.concatenate(parts), block)
    assert np.array_equal(np.concatenate(truths), truth)
    plant.open()
    assert np.array_equal([plant.exchange(volts[k : k + 1])[0] for k in range(5000)], block)


def test_seed_decides_the_noise_alone():
    one, other = RealisticPlant(seed=1), RealisticPlant(seed=2)
    assert not np.array_equal(one.exchange(np.ones(5)), other.exchange(np.ones(5)))
    assert np.array_equal(one.truth, other.truth)


@pytest.mark.parametrize("make", [RealisticPlant, lambda: MatchedPlant(np.zeros(30))])
def test_a_bad_voltage_moves_nothing(make):
    undisturbed, disturbed = make(), make()
    first, second = undisturbed.exchange(np.ones(10)), undisturbed.exchange(np.full(20, 2.0))
    assert np.array_equal(disturbed.exchange(np.ones(10)), first)
    with pytest.raises(SettingError, match=r"volts\[1\] = nan V"):
        disturbed.exchange(np.array([3.0, np.nan]))
    assert np.array_equal(disturbed.exchange(np.full(20, 2.0)), second)


def test_descriptions_are_plain_data_and_settings_are_checked():
    for plant in (RealisticPlant(PlantSettings(change=Change(time=1.0, gain=0.8))), MatchedPlant(np.zeros(3))):
        assert json.loads(json.dumps(plant.describe()))["seed"] == 0
    for bad in ({"noise": -1}, {"creep_span": (0, 1)}, {"plays": 0}, {"steps_per_tick": 7}, {"ad_limits": (1, 1)},
                {"hysteresis": 0.9, "change": Change(time=0.0, hysteresis=2.0)}):  # fmt: skip
        with pytest.raises(SettingError):
            PlantSettings(**bad)
    for bad in ({"a": (1.0,)}, {"thresholds": (0.1, 0.2)}, {"weight_spread": 0.3}, {"dead_zone_weights": (1.0, 2.0)}):
        with pytest.raises(SettingError):
            MatchedSettings(**bad)
    with pytest.raises(SettingError, match="'loudness'"):
        PlantSettings().without("loudness")
    with pytest.raises(SettingError, match=r"change = one at 2\.5 s of nothing: must be one of gain or hysteresis"):
        PlantSettings(change=Change(time=2.5))


# ---- The matched plant


def test_matched_plant_is_equation_13_in_exact_fractions():
    s = MatchedSettings(dead_zone_thresholds=(0.0, 12.0, 20.0), dead_zone_weights=(1.0, 0.06, -0.04), noise=0.0)
    volts, velocity = [0.5, 2.25, 1.125, 1.0, 3.0, -0.5], [0.0, 300.0, -200.0, 50.0, 100.0, -300.0]
    y, expected = [Fraction(0)] * 8, []
    for x, v in zip(map(Fraction, volts), map(Fraction, velocity), strict=True):
        y = [max(x - r, min(x + r, old)) for r, old in zip(map(Fraction, s.thresholds), y, strict=True)]
        w = [Fraction(a) + Fraction(0.007) * v * Fraction(b) for a, b in zip(s.a, s.b, strict=True)]
        strain = sum(p * q for p, q in zip(w, y, strict=True))
        expected.append(strain + Fraction(0.06) * max(strain - 12, 0) - Fraction(0.04) * max(strain - 20, 0))
    plant = MatchedPlant(velocity, s)
    assert plant.exchange(np.array(volts)) == pytest.approx([float(z) for z in expected], rel=1e-14)
    assert max(expected) > 20  # both dead zones were open


def test_matched_plant_is_inverted_exactly_by_a_controller_that_knows_it():
    t = np.arange(4000) / 2000
    z_d, velocity = 12 - 12 * np.cos(2 * np.pi * 3 * t), 12 * 2 * np.pi * 3 * np.sin(2 * np.pi * 3 * t)
    s = MatchedSettings(noise=0.0)
    weights = tuple(np.ravel(list(zip(s.a, s.b, strict=True))))
    settings = ControllerSettings.paper(
        sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6), thresholds=s.thresholds, initial_weights=weights
    )
    controller = AdaptiveController.from_settings(settings)
    volts = controller.process(z_d, velocity)
    assert MatchedPlant(velocity, s).exchange(volts) == pytest.approx(z_d, abs=1e-12)
    assert np.max(np.abs(MatchedPlant(0 * velocity, s).exchange(volts) - z_d)) > 0.3  # the rate matters


def test_matched_change_redraws_the_weights_within_their_spread():
    velocity, volts = np.full(200, 100.0), smooth_wave(200)
    s = MatchedSettings(change=Change(time=0.05, gain=0.9), weight_spread=0.3)
    changed = [MatchedPlant(velocity, s, seed=seed) for seed in range(200)]
    ratios = np.array([p.changed_a for p in changed]) / s.a / 0.9
    assert np.all((ratios >= 0.7) & (ratios <= 1.3))
    assert ratios.min() < 0.71
    assert ratios.max() > 1.29
    still, moved = MatchedPlant(velocity), changed[0]
    still.exchange(volts), moved.exchange(volts)
    assert np.array_equal(still.truth[:100], moved.truth[:100])
    fresh = dataclasses.replace(s, change=None, weight_spread=0.0, a=moved.changed_a, b=moved.changed_b)
    redrawn = MatchedPlant(velocity, fresh)
    redrawn.exchange(volts)
    assert np.array_equal(moved.truth[100:], redrawn.truth[100:])
    assert np.all(still.truth[100:] != moved.truth[100:])
    with pytest.raises(SettingError, match="at most 200"):
        moved.exchange(volts)
