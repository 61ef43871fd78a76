"""Parts of a record that are apart by long gaps: each has a zero of its own, which is no error of the model."""

import numpy as np
import pytest
from benchmarks import foreign_records as foreign

from truestroke.identification import Record, identify
from truestroke.identification.fitting.zeros import at_one_zero, zeros
from truestroke.identification.records.series import series

FS, SECONDS, GAP = 100.0, 12.0, 600.0
ABOVE = np.array([0.0, 1.2, -0.7])  # um, of the parts


def record(heights: np.ndarray, drifts: np.ndarray) -> tuple[Record, np.ndarray]:
    """Three parts of stop elements, 30 um, ten minutes apart; what their zeros add, um."""
    rng = np.random.Generator(np.random.PCG64(6))
    t = foreign.clock(3 * SECONDS, FS)
    v, part = foreign.wave(t, rng, 2.0), (t // SECONDS).astype(int)
    added = heights[part] + drifts[part] * (t - SECONDS * part)
    z = 30 * foreign.stop_elements(v, rng) + added + rng.normal(0, 0.01, t.size)
    return Record.from_arrays(100 * v, z, time=t + GAP * part, source="three parts"), added


@pytest.mark.parametrize("drifts", [np.zeros(3), np.array([0.2, -0.15, 0.1])])
def test_zeros_and_drifts_of_the_parts_are_found(drifts: np.ndarray) -> None:
    made, added = record(ABOVE, drifts)
    s = series(made)
    assert len(s.breaks) == 2
    found = np.interp(made.time, s.time, zeros(s, s.volts.size))
    assert found - found[-1] == pytest.approx(added - added[-1], abs=0.15)
    first = at_one_zero(s, s.breaks[0])
    assert first[0] is s  # one part


def test_a_model_is_judged_without_the_zero_of_another_part() -> None:
    made, _ = record(ABOVE, np.zeros(3))
    found = identify(made, delay=0.0, branches=False)
    assert found.held_out.rmse_percent < 0.5  # 5 with these zeros
    assert found.held_out.zero_um == pytest.approx(ABOVE[2] - ABOVE[1], abs=0.1)
    assert any("um below that before; the errors are without it" in text for text in found.verdict.reasons)
    assert np.mean(found.residual**2) < 0.1**2
    plain = identify(record(np.zeros(3), np.zeros(3))[0], delay=0.0, branches=False)
    assert found.model.weights[0] == pytest.approx(plain.model.weights[0], rel=0.05)
