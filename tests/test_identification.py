"""Weights are recovered from records that independent code made, and from a measured one."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from truestroke import ControllerSettings, SettingError
from truestroke.identification import fit
from truestroke.identification.fitting.regression import Data, Structure
from truestroke.identification.held_out.jump import jump
from truestroke.identification.held_out.steps import blocks
from truestroke.model.branches import Branches

THRESHOLDS = tuple(i / 8 * 1.5 for i in range(8))
A = np.array([8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23])  # P-885.90, Sec. 4.3
B = np.array([-1.89, 2.163, -0.5124, 0.21, 0.105, -0.042, 0.021, -0.021]) / 300.0  # c_b b_p


def actuator(volts, velocity, a, b, thresholds, d, w_s):
    """(8), one operator and one tick at a time in plain Python; returns displacement."""
    state = [0.0] * len(thresholds)
    out = []
    for x, v in zip(volts, velocity, strict=True):
        y = 0.0
        for i, r in enumerate(thresholds):
            state[i] = max(x - r, min(x + r, state[i]))
            y += (a[i] + b[i] * v) * state[i]
        out.append(sum(w * (max(y - t, 0.0) if t > 0 else y) for w, t in zip(w_s, d, strict=True)))
    return np.array(out)


def wave(ticks, seed, top=2.6, rate=2000.0):
    """A random wave of voltage from 0 V and its derivative, by a sum of sines below 20 Hz."""
    rng = np.random.Generator(np.random.PCG64(seed))
    t = np.arange(ticks) / rate
    f, phase = rng.uniform(0.5, 20.0, 12), rng.uniform(0, 2 * np.pi, 12)
    s = np.sin(2 * np.pi * f * t[:, None] + phase).sum(axis=1)
    s = (s - s.min()) / np.ptp(s) * top * np.minimum(1.0, t / 0.1)
    return s, np.gradient(s, 1 / rate)


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 1e-9), (0.02, 0.06)])
def test_play_and_dead_zone_weights_are_recovered(noise, tolerance):
    volts, _ = wave(8000, 1)
    d, w_s = (0.0, 10.0, 18.0), (1.0, 0.06, -0.04)
    z = actuator(volts, 0 * volts, A, 0 * B, THRESHOLDS, d, w_s)
    z += noise * np.random.Generator(np.random.PCG64(2)).standard_normal(z.size)
    # by hand: the inverse of slopes 1, 1.06, 1.02 has slopes 1, 1/1.06, 1/1.02, and d' = 10 and 10 + 8 * 1.06 um
    inverse = np.array([1.0, 1 / 1.06 - 1.0, 1 / 1.02 - 1 / 1.06])
    found = fit(volts, z, thresholds=THRESHOLDS, dead_zone_thresholds=(0.0, 10.0, 18.48))
    np.testing.assert_allclose(found.play_weights, A, atol=tolerance)
    np.testing.assert_allclose(found.dead_zone_weights, inverse, atol=0.01 * tolerance)
    assert found.rmse == pytest.approx(noise, rel=0.05, abs=1e-9)
    assert found.offset == 0
    assert not found.rate_weights.any()


def test_rate_weights_and_offset_are_recovered():
    volts, slope = wave(12000, 3)
    velocity = 12.0 * slope
    z = actuator(volts, velocity, A, B, THRESHOLDS, (0.0,), (1.0,)) - 87.0
    z += 0.02 * np.random.Generator(np.random.PCG64(4)).standard_normal(z.size)
    found = fit(volts, z, thresholds=THRESHOLDS, velocity=velocity, offset=True)
    # As a fast hysteresis branch shows them: partial sums at +-300 um/s.
    for v in (-300.0, 0.0, 300.0):
        np.testing.assert_allclose(
            np.cumsum(found.play_weights + v * found.rate_weights), np.cumsum(A + v * B), atol=0.15
        )
    assert found.offset == pytest.approx(-87.0, abs=0.01)
    assert found.rmse == pytest.approx(0.02, rel=0.05)


def test_partial_sums_stay_positive_at_every_velocity_where_the_truth_is_not():
    """A plant with a falling branch has no inverse: the fit gives the nearest that has one."""
    volts, slope = wave(4000, 5)
    velocity = 12.0 * slope
    a, b = np.array([3.0, -4.0, 9.0]), np.array([-5.0, 0.0, 0.0]) / 300.0
    z = actuator(volts, velocity, a, b, (0.0, 0.4, 0.8), (0.0,), (1.0,))
    found = fit(volts, z, thresholds=(0.0, 0.4, 0.8), velocity=velocity, slope_min=0.25)
    for v in np.linspace(-1, 1, 5) * np.abs(velocity).max():
        assert np.cumsum(found.play_weights + v * found.rate_weights).min() >= 0.25 - 1e-9


def test_dead_zone_weights_of_another_record_are_kept():
    """Sec. 2.2: w_s from a sine of 8 Hz, then w_h from the waves."""
    d, w_s = (0.0, 10.0), (1.0, 0.1)
    sine = 1.3 - 1.3 * np.cos(2 * np.pi * 8 * np.arange(2000) / 2000.0)
    first = fit(
        sine,
        actuator(sine, 0 * sine, A, 0 * B, THRESHOLDS, d, w_s),
        thresholds=THRESHOLDS,
        dead_zone_thresholds=(0.0, 10.0),
    )
    volts, _ = wave(4000, 6)
    z = actuator(volts, 0 * volts, A, 0 * B, THRESHOLDS, d, w_s)
    found = fit(
        volts, z, thresholds=THRESHOLDS, dead_zone_thresholds=(0.0, 10.0), dead_zone_weights=first.dead_zone_weights
    )
    np.testing.assert_allclose(found.dead_zone_weights, [1.0, 1 / 1.1 - 1], atol=1e-9)
    np.testing.assert_allclose(found.play_weights, A, atol=1e-7)


def test_the_fit_starts_a_controller_that_inverts_the_plant():
    volts, slope = wave(6000, 7)
    velocity = 5.0 * slope  # the published weights have no inverse above 1333 um/s
    assert 300 < np.abs(velocity).max() < 1333
    z = actuator(volts, velocity, A, B, THRESHOLDS, (0.0,), (1.0,))
    found = fit(volts, z, thresholds=THRESHOLDS, velocity=velocity)
    settings = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6), **found.settings(0.007))
    a, b = np.reshape(settings.initial_weights, (-1, 2)).T
    np.testing.assert_allclose(a, A, atol=1e-6)
    np.testing.assert_allclose(0.007 * b, B, atol=1e-8)
    still = found.settings(rate_scale=0.0)
    assert not any(still["initial_weights"][1::2])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"displacement": np.zeros(99)}, "displacement = array of 99 ticks um: must be an array of 100 ticks"),
        ({"thresholds": (0.0, 2.5)}, r"thresholds = 2.5 V: must be below what the record reaches"),
        ({"dead_zone_thresholds": (0.0, 50.0)}, r"dead_zone_thresholds = 50.0 um: must be below"),
        ({"dead_zone_weights": (0.5,)}, "dead_zone_weights = .*the first 1"),
        ({"skip": 98}, "volts = array with 2 ticks to fit: must be longer than 2 ticks"),
        ({"slope_min": 0.0}, "slope_min = 0.0: must be above 0"),
        ({"velocity": np.zeros(100)}, r"the largest \|velocity\| = 0.0 um/s: must be above 0 um/s"),
        ({"volts": np.full(100, np.nan)}, r"volts\[0\] = nan V: must be finite"),
    ],
)
def test_a_bad_record_is_named(change, message):
    record = {"volts": np.linspace(0, 2, 100), "displacement": np.linspace(0, 20, 100), "thresholds": (0.0, 1.0)}
    with pytest.raises(SettingError, match=message):
        fit(**{**record, **change})


def measured_record():
    """The P-885.91 record: beside the repository, or where TRUESTROKE_SHARED says."""
    shared = Path(os.environ.get("TRUESTROKE_SHARED", Path(__file__).parents[2] / "shared"))
    path = shared / "data" / "p885_91" / "Model_Vi_Do.dat"
    if not path.exists():
        pytest.skip(f"the measured record is not at {path}; set TRUESTROKE_SHARED to its folder 'shared'")
    return np.loadtxt(path, usecols=(0, 4)).T


def test_a_measured_stack_is_predicted():
    """P-885.91: trained on the first 60 %, the rest is predicted within 1.2 % of peak-to-peak (a line: 6.8 %)."""
    volts, z = measured_record()
    thresholds = tuple(i / 10 * 1.8 for i in range(10))
    start, split = 60, int(0.6 * volts.size)
    found = fit(volts[:split], z[:split], thresholds=thresholds, offset=True, skip=start)
    predicted = found.offset + actuator(volts, 0 * volts, found.play_weights, 0 * volts, thresholds, (0.0,), (1.0,))
    error = (predicted - z)[split:]
    line = np.polyval(np.polyfit(volts[:split], z[:split], 1), volts) - z
    stroke = np.ptp(z)
    assert np.sqrt(np.mean(line[split:] ** 2)) / stroke == pytest.approx(0.068, abs=0.002)
    assert np.sqrt(np.mean(error**2)) / stroke < 0.012


def test_columns_that_are_kept_are_those_of_a_record_that_was_not_used_before():
    """Of other thresholds, terms, branches and predictions in turn, with and without a lag."""
    x, _ = wave(3000, seed=4)
    z = 10.0 * x + np.sin(x)
    for lag in (0.0, 2e-3):
        data = Data(
            volts=x, displacement=z[::2], known=np.ones(1500, dtype=bool), sample_rate=2000.0, every=2,
            voltage_range=(0.0, 2.6), stroke=26.0, zero=0.0, fastest=900.0, time_constant=lag, duration=2.0,
        )  # fmt: skip
        plain = Structure(thresholds=(0.0, 0.5), rate_dependent=(1,), creep_times=(0.1,), asymmetry=2)
        made = [
            plain,
            replace(plain, thresholds=(0.0, 0.2, 0.9)),
            replace(plain, creep_times=(0.1, 0.4), drift=("linear drift",)),
            replace(plain, rested=True, asymmetry=1),
            replace(plain, branches=Branches(voltage_range=(0.0, 2.6), levels=3)),
            replace(plain, branches=Branches(voltage_range=(0.0, 2.6), curves=("convex",), plays=2, betas=(4.0,))),
        ]
        for structure in [*made, *made[::-1]]:
            for predicted in (z, 0.9 * z):
                fresh = replace(data).columns(structure, predicted)
                np.testing.assert_array_equal(data.columns(structure, predicted), fresh)
                assert fresh.shape == (1500, len(structure.coefficients) + 1)


def test_a_jump_of_a_residual_without_noise_is_found() -> None:
    step, nothing = (
        np.repeat([0.0, 0.3], [2000, 1500]),
        (np.zeros((3500, 0)), np.zeros((0, 0)), np.sin(np.arange(3500) / 25.0)),
    )
    assert jump(blocks(step, *nothing), 80.0) == (pytest.approx(0.3), 2000)
    assert jump(blocks(np.zeros(3500), *nothing), 80.0) is None
