"""The noise of a measured voltage, which the actuator does not see, is not fitted; what it sees stays."""

import numpy as np
import pytest
from benchmarks import foreign_records

from truestroke import Record, examine
from truestroke.identification import identify
from truestroke.signals.quiet import noise_not_followed, without_noise, without_reversals

T = np.arange(8000) / 1000.0


def normal(seed: int, size: int = T.size) -> np.ndarray:
    return np.random.Generator(np.random.PCG64(seed)).standard_normal(size)


def test_noise_of_the_voltage_neither_hides_duhem_nor_looks_like_a_lag() -> None:
    """0.1 % of the span: its travel is a third of that of the motion, with which a state of Duhem decays."""
    v = foreign_records.wave(T, np.random.Generator(np.random.PCG64(6)), 2.0)
    z = 20 * foreign_records.duhem(v) + 4e-3 * normal(1)
    clean, noisy = (identify((100 * (v + share * normal(2)), z, 1000.0)) for share in (0.0, 1e-3))
    assert noisy.held_out.rmse_percent < 2 * clean.held_out.rmse_percent  # 11 times with the noise
    assert noisy.response.time_constant < 2e-3


def test_predict_takes_off_the_noise_that_the_record_had_too_and_says_so() -> None:
    """Another motion, with noise of its own: with it in the voltage the error is four times as large."""
    waves = (foreign_records.wave(T, np.random.Generator(np.random.PCG64(seed)), 2.0) for seed in (6, 7))
    first, second = (100 * v + 0.2 * normal(2 + k) for k, v in enumerate(waves))
    v = foreign_records.wave(T, np.random.Generator(np.random.PCG64(7)), 2.0)
    z = 20 * foreign_records.duhem(foreign_records.wave(T, np.random.Generator(np.random.PCG64(6)), 2.0))
    record = Record.from_arrays(first, z + 4e-3 * normal(1), sample_rate=1000.0)
    model, truth = identify(record).model, 20 * foreign_records.duhem(v)

    def error(**measured: bool) -> float:
        off = (truth - model.predict(second, 1000.0, **measured))[2000:]
        return float(np.std(off))

    assert error() == error(measured=True) < 0.3 * error(measured=False)
    assert model.voltage_noise == pytest.approx(0.2, rel=0.1)
    assert any("the voltage has noise of 0.2 V" in words for words in examine(record).warnings)
    clean = 100 * v
    assert np.array_equal(model.predict(clean, 1000.0), model.predict(clean, 1000.0, measured=False))
    assert np.array_equal(model.forward(second, 1000.0), model.predict(second, 1000.0, measured=False))
    assert np.median(model.interval(second, 1000.0)) < np.median(model.interval(second, 1000.0, measured=False))


@pytest.mark.parametrize("share", [5e-4, 5e-3])
def test_a_triangle_keeps_its_corners(share: float) -> None:
    true = foreign_records.up_and_down(T, 1.0)
    measured = true + share * normal(3)
    left = without_noise(measured, noise_not_followed(measured, 10 * true + 1e-3 * normal(4))) - true
    assert float(np.std(left)) < 0.5 * share
    corners = np.concatenate([left[k - 2 : k + 3] for k in range(500, 7999, 500)])
    assert float(np.abs(corners.mean())) < share


def test_what_is_no_noise_stays() -> None:
    """A staircase; a smooth voltage; and fast random motion, which the displacement follows."""
    stairs = np.repeat(np.arange(40) % 7, 200) / 7.0
    smooth = foreign_records.wave(T, np.random.Generator(np.random.PCG64(4)), 2.0)
    shaken = smooth + 0.003 * normal(5)
    for x in (stairs, smooth, shaken):
        assert without_noise(x, noise_not_followed(x, 10 * x + 1e-3 * normal(6))) is x


@pytest.mark.parametrize(("frequency", "damping"), [(40.0, 0.03), (60.0, 0.05), (40.0, 1.0)])
def test_what_shakes_a_slow_stage_stays_and_noise_of_the_measurement_does_not(frequency: float, damping: float) -> None:
    """Random motion up to 300 Hz, of 0.8 % of the span: a stage of 40 Hz, or a lag, hardly follows the fastest part."""
    smooth = foreign_records.wave(T, np.random.Generator(np.random.PCG64(4)), 2.0)
    dither = 0.01 * foreign_records.low_pass(normal(5), 1000.0, 300.0)
    for put_out, beside in ((smooth + dither, 0.0), (smooth, 0.003 * normal(7))):
        z = foreign_records.resonance(foreign_records.bouc_wen(put_out), 1000.0, frequency, damping)
        assert (noise_not_followed(put_out + beside, z + 3e-4 * normal(6)) > 0) == (put_out is smooth)


def test_only_reversals_that_are_large_enough_stay() -> None:
    """Turns of a motion are where they were; between them it goes one way, about in the middle of the noise."""
    v = 50 - 50 * np.cos(T)
    measured = v + 0.5 * normal(4)
    quiet = without_reversals(measured, 5.0)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(quiet)[np.diff(quiet) != 0])))
    assert turns.size == 2
    assert np.abs(np.diff(quiet)).sum() < 1.05 * np.abs(np.diff(v)).sum()
    assert np.abs(np.diff(measured)).sum() > 10 * np.abs(np.diff(v)).sum()
    assert np.abs(quiet - v).max() < 2.5
    assert np.array_equal(without_reversals(v, 5.0), v)
    assert np.array_equal(without_reversals(-v, 5.0), -v)
    assert without_reversals(np.full(3, 2.0), 5.0).tolist() == [2.0] * 3
