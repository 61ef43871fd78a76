"""A model on another day: its zero is estimated, and said; a model that does not hold is told apart from that."""

import numpy as np
import pytest
from benchmarks import foreign_records

from truestroke.base.checks import SettingError
from truestroke.identification import identify, score, waveform

FS = 500.0


def day(seed, zero=0.0, gain=1.0):
    """Volts and displacement, um, of a Preisach actuator of 30 um on a wave of its own."""
    rng = np.random.Generator(np.random.PCG64(seed))
    v = foreign_records.wave(foreign_records.clock(10.0, FS), rng, 3.0)
    z = 30 * gain * foreign_records.preisach(v, np.random.Generator(np.random.PCG64(7)))
    return 100 * v, z + zero + rng.normal(0, 0.01, v.size), FS


@pytest.fixture(scope="module")
def model():
    return identify(day(1)).model


def test_the_zero_of_another_day_is_estimated_and_said(model):
    found = score(model, day(2, zero=1.1))
    assert found.offset_um - score(model, day(2)).offset_um == pytest.approx(1.1, abs=1e-6)
    assert found.rmse_percent < 0.6 < 3.0 < 100 * found.rmse_without_offset_um / 30
    assert 0.9 <= found.coverage <= 1.0
    assert found.half_width_um < 1.0
    assert found.verdict.level == "doubtful"
    assert "above that of the record" in found.verdict.reasons[0]


def test_an_offset_that_is_given_is_taken(model):
    given = score(model, day(2, zero=1.1), offset=0.0)
    assert not given.estimated
    assert given.rmse_um == given.rmse_without_offset_um


def test_an_actuator_that_has_changed_is_no_matter_of_its_zero(model):
    found = score(model, day(3, gain=1.3))
    assert found.verdict.is_bad
    assert "anew" in found.verdict.reasons[0]


def test_predict_invert_and_waveform_take_the_zero(model):
    volts, _, _ = day(4)
    moved = model.predict(volts, FS, offset=1.1)
    np.testing.assert_allclose(moved - model.predict(volts, FS), 1.1)
    np.testing.assert_allclose(model.invert(moved, FS, offset=1.1), model.invert(moved - 1.1, FS), atol=1e-9)
    made = waveform(model, moved, FS, offset=1.1)
    assert made.rmse < 0.05
    assert made.rmse < 0.1 * np.sqrt(np.mean((waveform(model, moved, FS).volts - made.volts) ** 2))
    with pytest.raises(SettingError, match="offset"):
        model.predict(volts, FS, offset=float("nan"))
