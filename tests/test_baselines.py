"""The rivals behave as their textbooks say, on plants that the tests make themselves."""

import functools
import math

import numpy as np
import pytest
from scipy import signal

from truestroke import SettingError
from truestroke.control.baselines import ConstantGain, Pid, PidGains, ProjectedGradient, tune_pid

RATE = 2000.0
LIMITS = (-0.6, 3.6)


def resonant(gain=12.0, resonance=350.0, damping=0.05):
    """Numerator and denominator in z of a resonant stage behind a zero-order hold, um/V."""
    w = 2 * math.pi * resonance
    b, a, _ = signal.cont2discrete(([gain * w**2], [1, 2 * damping * w, w**2]), 1 / RATE, "zoh")
    return np.ravel(b), np.ravel(a)


def closed_loop(controller, z_d, gain=1.0):
    """Displacement of the resonant stage, its gain multiplied, under the controller."""
    b, a = resonant()
    x, z = [0.0, 0.0], [0.0, 0.0]
    for target in z_d:
        # z[k] comes of commands up to k: one tick earlier than cont2discrete has it, like a mean over the tick
        x.append(controller.command(target, 0.0))
        z.append(gain * (b[1] * x[-1] + b[2] * x[-2]) - a[1] * z[-1] - a[2] * z[-2])
        controller.adapt(z[-1])
    return np.array(z[2:])


@functools.cache
def tuned(**changes):
    f = np.arange(1, 1001) * 1.0
    b, a = resonant()
    _, G = signal.freqz(np.append(b[1:], 0.0), a, worN=f, fs=RATE)
    spectrum = 1 / (1 + (f / 20.0) ** 8)
    return tune_pid(f, G, sample_rate=RATE, spectrum=spectrum, **changes)


def test_the_tuned_pid_has_the_margin_that_it_states():
    """M_s <= 2 leaves a gain margin of 2 at least (Astrom, Hagglund), here on top of 1.5 times the gain."""
    step = np.full(4000, 1.0)
    for gain in (0.5, 1.0, 1.5, 2.9):
        z = closed_loop(Pid(tuned(), sample_rate=RATE, voltage_limits=LIMITS), step, gain)
        np.testing.assert_allclose(z[-200:], 1.0, atol=0.01)
    # and is not timid: it settles within 1 % in 50 ms, does not ring, and some gain is too much for it
    z = closed_loop(Pid(tuned(), sample_rate=RATE, voltage_limits=LIMITS), step)
    assert np.abs(z[100:] - 1).max() < 0.01
    assert z.max() < 1.3
    z = closed_loop(Pid(tuned(), sample_rate=RATE, voltage_limits=LIMITS), step, 12.0)
    assert np.abs(z[-200:] - 1).max() > 0.1


def test_a_smaller_margin_tracks_better():
    wave = np.cumsum(np.random.Generator(np.random.PCG64(1)).standard_normal(4000))
    wave = 10 + 5 * signal.sosfilt(signal.butter(4, 20, fs=RATE, output="sos"), wave / np.abs(wave).max())
    errors = []
    for peak in (1.3, 1.6, 2.5):
        pid = Pid(tuned(sensitivity_peak=peak), sample_rate=RATE, voltage_limits=LIMITS)
        errors.append(np.std((closed_loop(pid, wave) - wave)[1000:]))
    assert errors[0] > errors[1] > errors[2]


def test_the_response_is_that_of_the_controller():
    gains = PidGains(k_p=0.03, k_i=0.0, k_d=2e-5, T_f=1e-3)
    impulse = np.zeros(256)
    impulse[0] = 1.0
    pid = Pid(gains, sample_rate=RATE, voltage_limits=(-9, 9))
    out = np.array([pid.command(z_d, 0.0) for z_d in impulse])
    f = np.fft.rfftfreq(256, 1 / RATE)[1:]
    np.testing.assert_allclose(gains.response(f, RATE), np.fft.rfft(out)[1:], atol=1e-12)

    integral = PidGains(k_p=0.0, k_i=40.0, k_d=0.0, T_f=0.0)
    pid = Pid(integral, sample_rate=RATE, voltage_limits=(-9, 9))
    out = np.array([pid.command(z_d, 0.0) for z_d in impulse])
    np.testing.assert_allclose(out, 40.0 / RATE)  # an impulse of one tick is held for ever
    np.testing.assert_allclose((1 - np.exp(-2j * np.pi * f / RATE)) * integral.response(f, RATE), 40.0 / RATE)


def test_the_integral_does_not_wind_up():
    """Ten seconds out of reach cost no more than a moment."""
    recovery = []
    for ticks in (200, 20_000):
        pid = Pid(PidGains(k_p=0.0, k_i=20.0, k_d=0.0, T_f=0.0), sample_rate=RATE, voltage_limits=LIMITS)
        for _ in range(ticks):
            volts = pid.command(90.0, 0.0)
            pid.adapt(10.0 * volts)
        assert volts == pytest.approx(3.6)
        back = 0
        while abs(10.0 * volts - 20.0) > 0.1:
            volts = pid.command(20.0, 0.0)
            pid.adapt(10.0 * volts)
            back += 1
        recovery.append(back)
    assert recovery[0] == recovery[1] < 100


def test_a_lost_measurement_leaves_the_last_one_in_place():
    one, other = (Pid(tuned(), sample_rate=RATE, voltage_limits=LIMITS) for _ in range(2))
    for pid in (one, other):
        pid.command(1.0, 0.0)
        pid.adapt(0.4)
    one.adapt(math.nan)
    assert one.command(2.0, 0.0) == other.command(2.0, 0.0)
    assert math.isfinite(one.command(2.0, 0.0))


def test_bad_arguments_are_named():
    with pytest.raises(SettingError, match=r"sensitivity = -1.0 um/V: must be above 0 um/V"):
        ConstantGain(-1.0, LIMITS)
    with pytest.raises(SettingError, match=r"z_d = nan um: must be finite"):
        ConstantGain(12.0, LIMITS).command(math.nan, 0.0)
    with pytest.raises(SettingError, match=r"k_i = -1.0 V/\(um s\)"):
        PidGains(k_p=0.0, k_i=-1.0, k_d=0.0, T_f=0.0)
    with pytest.raises(SettingError, match=r"sensitivity_peak = 1.0: must be larger for this actuator"):
        tuned(sensitivity_peak=1.0)


def test_a_constant_gain_stays_within_the_limits():
    controller = ConstantGain(12.5, LIMITS)
    controller.adapt(99.0)
    assert [controller.command(z, 0.0) for z in (-50.0, 0.0, 25.0, 90.0)] == [-0.6, 0.0, 2.0, 3.6]
    assert ConstantGain(10.0, LIMITS, offset=5.0).command(25.0, 0.0) == 2.0


def projected(weights, **changes):
    return ProjectedGradient(weights, **{"forgetting": 0.995, "slope_min": 0.5, **changes})


def learn(law, volts, truth, thresholds):
    """Feed the law what an actuator with the true weights answers to the voltages."""
    state = [0.0] * len(thresholds)
    for x in volts:
        state = [max(x - r, min(x + r, s)) for r, s in zip(thresholds, state, strict=True)]
        u = np.column_stack([state, np.zeros(len(state))]).ravel()
        law.update(u, float(np.dot(truth, state) - law.weights @ u))


def test_the_projected_gradient_finds_the_weights_and_follows_a_change():
    t = np.arange(10_000) / RATE
    volts = 1.3 + 1.2 * np.sin(2 * np.pi * 5 * t) * np.cos(2 * np.pi * 0.7 * t)
    law = projected([5.0, 0, 0, 0, 0, 0])
    for truth in ([9.0, 3.0, 1.0], [7.0, 4.0, -1.0]):
        learn(law, volts, truth, [0.0, 0.3, 0.6])
        np.testing.assert_allclose(law.weights[0::2], truth, atol=0.02)
    assert not law.weights[1::2].any()


def test_the_projected_gradient_keeps_partial_sums_positive_and_rests_at_rest():
    t = np.arange(6000) / RATE
    law = projected([5.0, 0, 0, 0])
    learn(law, 1 - np.cos(2 * np.pi * 5 * t), [2.0, -3.0], [0.0, 0.4])  # a falling branch: no inverse exists
    assert np.cumsum(law.weights[0::2]).min() >= 0.5 - 1e-12
    rest(law)
    before = law.weights.copy()
    rest(law)
    np.testing.assert_array_equal(law.weights, before)


def rest(law):
    for _ in range(5000):
        law.update(np.zeros(4), 0.3)
