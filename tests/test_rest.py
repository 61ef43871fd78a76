"""A record with a rest in it, and one that only seems to begin at rest."""

import numpy as np
import pytest
from benchmarks import foreign_records as foreign

from truestroke.identification import Record, examine, identify, score
from truestroke.identification.fitting import select, uncertainty
from truestroke.identification.fitting.procedure import data_of
from truestroke.identification.fitting.rest import from_step, over_motion
from truestroke.identification.records.resting import fitted, moving
from truestroke.identification.records.series import first_known, series

FS = 200.0
BEFORE = foreign.up_and_down(foreign.clock(2.0, FS), 1.0)  # two strokes over the whole range


def stack(share, before=BEFORE, unit=1.0, hysteresis=foreign.stop_elements):
    """Volts, um, Hz of an actuator that moved before the record, or did not: before is ()."""
    rng = np.random.Generator(np.random.PCG64(5))
    way = np.linspace(before[-1], share[0], 50) if len(before) else ()
    y = hysteresis(np.concatenate([before, way, share]), rng)[-share.size :]
    return 3.6 * share, unit * (20 * y + 0.005 * rng.standard_normal(share.size)), FS


def bouc_wen(v, _):
    return foreign.bouc_wen(v)


def wave(seconds=10.0, seed=3):
    return foreign.wave(foreign.clock(seconds, FS), np.random.Generator(np.random.PCG64(seed)), 2.0)


def rest(volts, seconds):
    return np.full(round(seconds * FS), volts)


# ---- From when on a record is fitted ---------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_a_rest_costs_nothing_however_long(noise):
    x = wave()
    still = np.concatenate([rest(x[0], 30.0), x])
    still += noise * np.random.Generator(np.random.PCG64(1)).standard_normal(still.size)
    first = first_known(still, float(np.ptp(x)))
    assert first == pytest.approx(6000 + first_known(x, float(np.ptp(x))), abs=20)
    assert np.ptp(still[:first]) > 0.8 * np.ptp(x)


def test_what_is_left_is_most_of_the_motion():
    t = foreign.clock(20.0, FS)
    grows = 0.5 + 0.5 * t / 20 * np.sin(2 * np.pi * t)  # it covers its range at its end only
    once = np.linspace(0.0, 1.0, 1000)
    assert first_known(grows, 1.0) < 0.5 * grows.size
    assert first_known(once, 1.0) < 100
    assert first_known(np.ones(100), 1.0) == 0


@pytest.mark.parametrize(("unit", "seconds"), [(1.0, 4.0), (1e-3, 10.0)])
def test_rest_before_the_motion_does_not_spoil_the_fit(unit, seconds):
    moved = wave(12.0)
    found = identify(stack(np.concatenate([rest(moved[0], seconds), moved]), unit=unit), delay=0.0, drift=False)
    assert found.held_out.rmse_percent < 0.5  # fitted from a tenth of the record on: 1.5 %


# ---- Long rests ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(
    ("pieces", "share"),
    [
        ([3.0, -7.0], 0.7),
        ([4.0, -2.5, 1.0, -2.5], 0.5),  # each a quarter of the record
        ([4.0, -5.0, 1.0], 0.5),
        ([4.0, -1.2, 4.0], 0.0),
    ],
    ids=["behind", "twice", "middle", "short"],
)
def test_a_long_rest_is_found_wherever_it_is(pieces, share, noise):
    x = np.concatenate([wave(2 * p, seed=k) if p > 0 else rest(0.3, -2 * p) for k, p in enumerate(pieces)])
    x += noise * np.random.Generator(np.random.PCG64(1)).standard_normal(x.size)
    still = ~moving(x)
    assert still.mean() == pytest.approx(share, abs=0.02)
    rests = min(share, 0.1 * (1 - share) * (pieces.count(-2.5) or 1))
    assert fitted(x).mean() == pytest.approx(1 - share + rests, abs=0.02)


def test_holds_of_a_staircase_are_no_rests():
    assert moving(np.repeat(wave(10.0)[:: round(FS)], 200)).all()


def test_a_voltage_that_mostly_rests_is_not_at_few_levels():
    x = np.concatenate([wave(10.0), rest(0.0, 190.0)])
    assert examine(Record.from_arrays(x, 10 * x, sample_rate=FS)).volts_visited_percent > 90


def test_a_rest_behind_the_motion_neither_hides_its_error_nor_spoils_the_fit():
    moved = wave(6.0, seed=4)
    volts, z, _ = stack(np.concatenate([moved, rest(moved[-1], 14.0), wave(8.0, seed=44)]), hysteresis=bouc_wen)
    known = slice(0, round(20.0 * FS))
    found = identify((volts[known], z[known], FS))
    after = (z - found.model.forward(volts, FS))[known.stop :]
    assert found.held_out.samples == pytest.approx(0.4 * moved.size, abs=20)  # all of them at rest: 0.03 %
    assert found.held_out.rmse_percent > 0.1
    assert np.std(after) < 0.007 * np.ptp(z)  # with all of the rest in the fit: 1.8 %


def test_a_rest_does_not_make_a_score_better():
    moved = wave(10.0)
    volts, z, _ = stack(moved)
    model = identify((volts, z, FS), modes=False, branches=False, drift=False).model
    errors = [
        score(model, (volts, 1.02 * z, FS), offset=0.0).rmse_um
        for volts, z in ((volts, z), (np.append(volts, rest(volts[-1], 90.0)), np.append(z, rest(z[-1], 90.0))))
    ]
    assert errors[1] == pytest.approx(errors[0], rel=0.02)


# ---- Rest at the start -----------------------------------------------------------------------------------------------

RAMPED = wave() * np.minimum(1.0, foreign.clock(10.0, FS) / 0.3)
TRIANGLES = foreign.up_and_down(foreign.clock(10.0, FS), 1.0) * (1 - foreign.clock(10.0, FS) / 20)


def taken_for_rest(record):
    s = series(record)
    data = data_of(s, s.volts.size, 15_000)
    guess = select.first_prediction(data)
    return over_motion(data, guess, uncertainty.white_variance(data.displacement - guess)) < 1


@pytest.mark.parametrize("hysteresis", [foreign.stop_elements, bouc_wen])
@pytest.mark.parametrize("share", [RAMPED, TRIANGLES, np.concatenate([rest(0.0, 1.0), TRIANGLES])])
def test_an_actuator_that_has_not_moved_is_at_rest(hysteresis, share):
    assert taken_for_rest(stack(share, (), hysteresis=hysteresis))


@pytest.mark.parametrize("unit", [1.0, 1e3])
@pytest.mark.parametrize("hysteresis", [foreign.stop_elements, bouc_wen])
def test_0_volts_after_motion_is_no_rest(hysteresis, unit):
    assert not taken_for_rest(stack(TRIANGLES, hysteresis=hysteresis, unit=unit))
    assert not taken_for_rest(stack(np.concatenate([rest(0.0, 1.0), TRIANGLES]), hysteresis=hysteresis, unit=unit))
    x = 1.3 * wave(13.0) - 0.3
    for sign in (-1, 1):
        k = int(np.argmax((np.abs(x) < 0.01) & (np.gradient(x) * sign > 0) & (np.arange(x.size) > 1.5 * FS)))
        assert not taken_for_rest(stack(x[k:], x[:k], hysteresis=hysteresis, unit=unit))


def test_a_bias_is_no_rest():
    assert not taken_for_rest(stack(0.5 + 0.5 * TRIANGLES, ()))


# ---- A record that begins with the answer to a step ------------------------------------------------------------------


def switched_on(tau, since=0):
    """A sine of 1 Hz that a rested stack answers 1.3 rows and a lag of tau, s, later; so many rows since it began."""
    share = np.concatenate([[0.0], 0.5 + 0.5 * np.sin(2 * np.pi * foreign.clock(16.0, FS))])
    rng = np.random.Generator(np.random.PCG64(8))
    strain = foreign.late(np.arange(share.size), foreign.stop_elements(share, rng), 1.3)
    y = 20 * foreign.lagged(strain, FS, tau)[1 + since :]
    return 3.6 * share[1 + since :], y + 0.005 * rng.standard_normal(y.size), FS


def test_the_step_at_the_start_is_in_the_model():
    """With the record as it is dead time, lag and creep would have been at rest at 1.8 V; 3.7 um are missed."""
    found = identify(switched_on(0.015))
    again = score(found.model, switched_on(0.015))
    assert found.trace.volts[0] == 0.0
    assert again.start_rmse_um < 0.2
    assert found.held_out.rmse_percent < 0.2
    assert found.response.time_constant == pytest.approx(0.015, abs=0.002)  # its strokes are alike, but for the step


@pytest.mark.parametrize("record", [switched_on(1e-5), switched_on(0.015, 20)], ids=["fast", "later"])
def test_no_step_is_seen_where_none_was_answered_in_the_record(record):
    taken = series(record)
    assert from_step(taken) is taken
