"""Up to which frequency a record tests the response of its stage, and where another motion is above it."""

import numpy as np
import pytest
from benchmarks.foreign_records import clock, resonance, up_and_down, wave

from truestroke.control import tested
from truestroke.identification import identify, score, waveform

FS, NOISE, FIRST = 500.0, 0.01, 60.0  # Hz, um, Hz
T = clock(8.0, FS)


def stage(v, rng=None):
    """A linear one, 30 um for 100 V, with a mode that a slow motion does not shake."""
    z = 30 * resonance(v, FS, FIRST, 0.02)
    return (100 * v, z if rng is None else z + rng.normal(0, NOISE, v.size), FS)


def slow(seed=1):
    return wave(T, np.random.default_rng(seed), 1.5)


@pytest.fixture(scope="module")
def found():
    rng = np.random.default_rng(0)
    volts, z, fs = stage(slow(), rng)
    v = volts / 100  # of a loop, so that it has hysteresis
    return identify((volts, z + 0.3 * np.maximum.accumulate(v), fs), modes=False, branches=False, delay=0.0)


def test_a_mode_that_the_record_hides_is_above_what_it_tests_and_one_that_it_shows_is_not():
    """Rms of what a mode adds to the motion, by a fine simulation of the stage itself, over the noise."""
    t = clock(8.0, 20 * FS)
    v = wave(t, np.random.default_rng(1), 1.5)
    frequency = tested.frequency(30 * v, 20 * FS, NOISE)
    later = slice(t.size // 2, None)  # once the start has decayed
    added = [np.std(30 * (resonance(v, 20 * FS, k * frequency, 0.02) - v)[later]) for k in (0.5, 2.0)]
    assert added[0] > NOISE > added[1]


def test_noise_and_unit_change_what_is_tested_and_the_clock_scales_it():
    moved = 30 * slow()
    frequency = tested.frequency(moved, FS, NOISE)
    assert tested.frequency(1e3 * moved, FS, 1e3 * NOISE) == pytest.approx(frequency, rel=1e-6)
    assert tested.frequency(moved, 1e3 * FS, NOISE) == pytest.approx(1e3 * frequency, rel=1e-6)
    assert tested.frequency(moved, FS, 16 * NOISE) < 0.5 * frequency
    assert tested.frequency(moved, FS, 0.0) == tested.frequency(0 * moved, FS, NOISE) == 0.0


def test_a_record_of_steps_tests_its_own_steps():
    steps = 30 * np.random.default_rng(2).uniform(0, 1, 17)[(2 * T).astype(int)]
    frequency = tested.frequency(steps, FS, NOISE)
    assert frequency == pytest.approx(0.5 * FS)
    assert frequency > 5 * tested.frequency(30 * slow(), FS, NOISE)
    assert np.percentile(tested.above(steps, FS, frequency), 99) <= 2 * NOISE


@pytest.mark.parametrize("noise", [1e-6, 1e-12])
def test_no_record_tests_more_than_half_of_its_sample_rate(noise):
    """Without noise a mode of ten times the sample rate would show in a slow motion, but nothing of its frequency."""
    steps = 30 * np.random.default_rng(2).uniform(0, 1, 17)[(2 * T).astype(int)]
    for moved in (30 * slow(), steps):
        assert tested.frequency(moved, FS, noise) == pytest.approx(0.5 * FS)
        assert not tested.above(moved, FS, 0.5 * FS).any()


def test_sharp_turns_behind_a_mode_that_the_record_could_not_show_are_said(found):
    """The raster is no faster than the record, and the model misses it by more than twice what it states."""
    model = found.model
    assert 5.0 < model.tested_frequency < FIRST
    raster = 0.2 + 0.5 * up_and_down(T, 1.0)
    turning = score(model, stage(raster, np.random.default_rng(3)))
    assert turning.rmse_um > 2 * found.held_out.rmse_um
    assert turning.beyond.velocity == ()
    assert any("where the record tests no response" in reason for reason in turning.verdict.reasons)
    smooth = score(model, stage(slow(2), np.random.default_rng(3)))
    assert smooth.beyond.frequency == ()
    assert smooth.rmse_um < 2 * found.held_out.rmse_um
    made = waveform(model, 5.0 + 10.0 * up_and_down(T, 1.0), FS)
    assert any("where the record tests no response" in warning for warning in made.warnings)
