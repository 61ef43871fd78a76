"""Rivals of `identify` on foreign records: each finds what it is made for, so the comparison is no straw man."""

import numpy as np
import pytest
from benchmarks import foreign_records, foreign_rivals


def task(volts, displacement, train=0.6):
    u = (volts - volts.min()) / np.ptp(volts)
    z = (displacement - displacement.mean()) / np.ptp(displacement)
    return foreign_rivals.Task(u, z, np.ones(u.size, dtype=bool), round(train * u.size))


def wave(samples, seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    t = np.arange(samples) / samples * 12.0
    s = np.sin(2 * np.pi * np.outer(t, rng.uniform(0.3, 1.5, 5)) + rng.uniform(0, 6.28, 5)).sum(axis=1)
    return (s - s.min()) / np.ptp(s)


def held_out(known, made):
    return 100 * np.sqrt(np.mean((made - known.z)[known.train :] ** 2))


MADE_FOR = {
    "Bouc-Wen": lambda v: foreign_records.bouc_wen(v),
    "Preisach": lambda v: foreign_records.preisach(v, np.random.Generator(np.random.PCG64(5))),
    "plays, lags": lambda v: foreign_records.stop_elements(v, np.random.Generator(np.random.PCG64(5))),
}
WITHIN = {"Bouc-Wen": 0.2, "Preisach": 1.0, "plays, lags": 1.5}  # % of p-p, in what it has not seen


@pytest.mark.parametrize("rival", MADE_FOR)
def test_a_rival_predicts_the_actuator_that_it_is_made_for(rival):
    v = wave(3000, 1)
    known = task(v, MADE_FOR[rival](v))
    assert held_out(known, foreign_rivals.RIVALS[rival](known)) < WITHIN[rival]


def test_what_is_held_out_decides_nothing():
    """Another end of the record, and the model is the same before it."""
    v = wave(1500, 2)
    z = foreign_records.bouc_wen(v)
    one, other = task(v, z), task(v, z)
    other.z[other.train :] = 7.0
    for rival in ("plays, lags", "Preisach"):
        made = [foreign_rivals.RIVALS[rival](known)[: one.train // 2] for known in (one, other)]
        np.testing.assert_array_equal(*made)


def test_a_record_is_compared_in_the_rows_that_count():
    """The sensor ends at 88 %: rows in which it does are judged for nobody."""
    record = next(foreign_records.records(0, (foreign_records.clipped_sensor,)))
    found = foreign_rivals.compared(record, ("Preisach",))
    assert found.identified < found.errors["Preisach"] < 2.0
    assert found.ratio < 0.6
