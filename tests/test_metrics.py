"""Metrics against signals whose figures are known beforehand."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from truestroke import SettingError, metrics
from truestroke.report import words

RATE = 2000.0


def random_motion(ticks, delay_ticks, seed):
    """A band-limited periodic motion and the same later, both exact: a sum of random sines."""
    rng = np.random.Generator(np.random.PCG64(seed))
    f, phase, size = rng.uniform(1, 30, 40), rng.uniform(0, 6.3, 40), rng.normal(size=40)
    t = np.arange(ticks) / RATE
    return [(size * np.sin(2 * np.pi * f * (t[:, None] - d / RATE) + phase)).sum(axis=1) for d in (0.0, delay_ticks)]


@given(lag=st.floats(-170, 170), gain=st.floats(0.1, 5), frequency=st.floats(2, 200), offset=st.floats(-20, 20))
@settings(max_examples=50, deadline=None)
def test_phase_lag_finds_the_angle(lag, gain, frequency, offset):
    phase = 2 * np.pi * frequency * np.arange(3333) / RATE  # no whole number of periods
    measured = offset + gain * np.sin(phase - np.radians(lag))
    assert metrics.phase_lag(10 + np.sin(phase), measured, RATE, frequency) == pytest.approx(lag, abs=1e-6)


@pytest.mark.parametrize("ticks", [-3.0, 0.0, 0.5, 1.25, 17.4, 80.0])
@pytest.mark.parametrize("seed", range(3))
def test_delay_finds_parts_of_a_tick(ticks, seed):
    desired, measured = random_motion(8000, ticks, seed)
    noise = np.random.Generator(np.random.PCG64(seed)).normal(0, 0.01, 8000)
    assert metrics.delay(desired, 5 + 0.7 * measured + noise, RATE) == pytest.approx(ticks / RATE * 1000, abs=0.005)


def test_delay_of_a_first_order_lag_is_its_time_constant():
    # slow against the lag, so that the group delay is the time constant, 2 ms
    desired, _ = random_motion(20000, 0.0, 4)
    slow = signal.sosfiltfilt(signal.butter(4, 5.0, fs=RATE, output="sos"), desired)
    b, a = signal.cont2discrete(([1.0], [0.002, 1.0]), 1 / RATE, method="foh")[:2]
    assert metrics.delay(slow, signal.lfilter(b[0], a, slow), RATE) == pytest.approx(2.0, rel=0.02)


def test_delay_beyond_its_range_is_refused():
    desired, measured = random_motion(8000, 80.0, 0)
    with pytest.raises(SettingError, match=r"longest = 2.0 ms: must be longer"):
        metrics.delay(desired, measured, RATE, longest=2.0)


def test_loop_width_of_one_play_operator():
    # a play of threshold r driven through +-a: the branches are 2 r apart, the output runs through +-(a - r)
    a, r = 3.0, 0.6
    x = np.roll(a * np.cos(np.linspace(0, 2 * np.pi, 4001)[:-1]), 777)
    z, y = np.empty_like(x), 0.0
    for _ in range(2):
        for i, v in enumerate(x):
            z[i] = y = max(v - r, min(v + r, y))
    assert metrics.loop_width(x, 7 + 10 * z) == pytest.approx(100 * 2 * r / (2 * (a - r)), rel=1e-3)
    assert metrics.loop_width(x, 2 * x) == pytest.approx(0.0, abs=1e-9)


def test_convergence_time():
    t = np.arange(int(10 * RATE)) / RATE
    hum = np.sin(2 * np.pi * 40 * t)  # rms 1 / sqrt 2 over each window
    assert metrics.convergence_time(t, hum) == 0.0
    # decay: window rms twice the final one where exp(-2 s)-envelope integrates to 4 times: solved by hand below
    decaying = hum * np.hypot(1.0, 30.0 * np.exp(-2 * t))
    window = (900 * (1 - np.exp(-4 * 0.25)) / (4 * 0.25)) * np.exp(-4 * t)  # excess mean square, in units of 1 / 2
    assert metrics.convergence_time(t, decaying) == pytest.approx(t[np.argmax(window < 3.0)], abs=0.02)
    burst_at_the_end = np.where(t > 9.9, 100.0, 1.0) * hum
    assert metrics.convergence_time(t, burst_at_the_end) is None
    assert metrics.convergence_time(t + 5.0, np.where(t < 2.0, 9.0, 1.0) * hum) == pytest.approx(2.0, abs=0.03)


def recording(**extra):
    t = np.arange(8000) / RATE
    z_d = 10 + 10 * np.sin(2 * np.pi * 8 * t)
    return {"time": t, "desired": z_d, "measured": z_d + np.where(t < 1, 1.0, 0.1) * np.cos(60 * t)} | extra


def test_summary_counts_the_later_part():
    rec = recording()
    s = metrics.summary(rec)
    assert (s.duration_s, s.counted_from_s, s.ticks, s.missing_ticks) == (4.0, 2.0, 8000, 0)
    assert s.measured_rmse_um == pytest.approx(0.1 / np.sqrt(2), rel=0.01)
    assert s.measured_maximum_percent == pytest.approx(0.5, rel=1e-3)
    assert s.convergence_time_s == pytest.approx(0.95, abs=0.06)
    assert (s.true_rmse_um, s.saturated_ticks, s.held_ticks) == (None, None, None)
    assert metrics.summary(rec, start=0.0).measured_maximum_um == 1.0
    assert json.loads(json.dumps(s.as_dict()))["measured_rmse_um"] == s.measured_rmse_um


@pytest.mark.parametrize(("begins", "said"), [(3.2, "not known: errors are judged for less than 1 s"), (2.5, "after ")])
def test_convergence_of_errors_that_are_judged_for_less_than_a_second_is_not_known(begins, said):
    """Of a scan with few rows behind its lead-in a good verdict had "not before the end"."""
    t = recording()["time"]
    rec = recording(flat=(t >= begins).astype(np.uint8))
    rec["measured"] += 0.5 * (t < 2.8)
    s = metrics.summary(rec)
    assert s.judged_s == pytest.approx(4.0 - begins)
    assert words.course(s)[0][1].startswith(said)


def test_summary_with_truth_flags_and_gaps():
    rec = recording()
    rec["true"] = rec["desired"] - 0.02
    rec["measured"][5000:5010] = np.nan
    rec["true"][-3:] = rec["measured"][-3:] = np.nan
    rec["flags"] = np.zeros(8000, np.uint8)
    rec["flags"][:7] = 1 | 2
    rec["flags"][5000:5010] = 4
    s = metrics.summary(rec)
    assert (s.true_rmse_um, s.true_maximum_um) == (pytest.approx(0.02), pytest.approx(0.02))
    assert (s.missing_ticks, s.saturated_ticks, s.projected_ticks, s.rejected_ticks, s.held_ticks) == (13, 7, 7, 10, 0)
    assert np.isfinite(s.measured_rmse_um)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.rmse([1.0, np.nan], [1.0, 2.0]), r"desired\[1\]"),
        (lambda: metrics.rmse([1.0], [1.0, 2.0]), r"of shape \(1,\)"),
        (lambda: metrics.phase_lag(np.zeros(10), np.zeros(10), RATE, 8.0), "at least a period, 250 ticks"),
        (lambda: metrics.convergence_time(np.arange(100) / RATE, np.zeros(100)), "time = 0.05 s: must be at least 1 s"),
        (lambda: metrics.loop_width(np.zeros(9), np.zeros(9)), "a motion"),
        (lambda: metrics.delay(np.zeros(9000), np.zeros(9000), RATE), "a motion"),
        (lambda: metrics.summary(recording(), start=1.0), "start = 1.0"),
        (lambda: metrics.summary(recording(measured=np.full(8000, np.nan))), "measurements"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(SettingError, match=message):
        call()


def test_recovery_is_counted_from_the_change_and_measured_by_what_was_before():
    t = np.arange(int(10 * RATE)) / RATE
    hum = np.sin(2 * np.pi * 100 * t)
    size = np.select([t < 0.8, t < 6, t < 7.5], [9.0, 1.0, 5.0], 1.5)  # recovers to 1.5 times what it was, after 1.5 s
    record = {"time": t, "desired": 20 * np.sin(t), "measured": 20 * np.sin(t) + size * hum}
    s = metrics.summary(record, change=6.0)
    assert (s.convergence_time_s, s.change_s) == (pytest.approx(0.8, abs=0.03), 6.0)
    assert s.recovery_time_s == pytest.approx(1.5, abs=0.06)
    record["measured"] = 20 * np.sin(t) + np.where(t < 7.5, size, 3.0) * hum  # stays three times as bad
    assert metrics.summary(record, change=6.0).recovery_time_s is None
    for change in (0.5, 9.5):
        assert metrics.summary(record, change=change).recovery_time_s is None
    assert metrics.summary(record).change_s is None
