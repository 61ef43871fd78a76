"""Mistakes that noise of 2 % of the stroke hid: a clipped voltage, rows that both channels lost, AC coupling."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from truestroke.base.typing import FloatArray
from truestroke.identification import Record, examine, read_record
from truestroke.identification.fitting.regression import plays

RATE = 1000.0
T = np.arange(6000) / RATE
CLIPPED, JOINED, COUPLED = "the voltage stays at an end", "both signals jump within one row", "AC-coupled"


def moved(x: FloatArray) -> FloatArray:
    """Through plays, 20 um for 100 V."""
    return np.asarray(plays(x, (0.0, 4.0, 10.0, 20.0)) @ (0.12, 0.03, 0.03, 0.03))


def asked(x: FloatArray, z: FloatArray, seed: int = 0) -> str:
    noisy = z + 0.02 * np.ptp(z) * np.random.default_rng(seed).standard_normal(z.size)
    found = examine(Record.from_arrays(x, noisy, sample_rate=RATE))
    assert not found.mistakes
    return "; ".join(found.implausible)


def tones() -> FloatArray:
    return 50 - 30 * np.cos(2 * np.pi * 3 * T) - 20 * np.cos(2 * np.pi * 5.3 * T)


def triangles() -> FloatArray:
    heights = np.random.default_rng(3).uniform(60, 100, 20)
    return np.interp(T, np.linspace(0, 6, 40), np.stack([0 * heights, heights], axis=1).ravel())


def steps() -> FloatArray:
    levels = np.random.default_rng(1).uniform(0, 100, 60)
    levels[::7] = 0.0
    return np.repeat(levels, 100)


@pytest.mark.parametrize("motion", [tones, triangles, steps])
def test_a_voltage_that_is_clipped_at_either_end_is_asked_about(motion: Callable[[], FloatArray]) -> None:
    x = motion()
    z = moved(x)
    assert asked(x, z) == ""
    for cut in (np.maximum(x, 15.0), np.minimum(x, np.max(x) - 15.0)):
        assert CLIPPED in asked(cut, z)


def test_a_voltage_that_is_at_its_limits_is_not_clipped() -> None:
    """Trapeziums that the actuator follows, with a lag; and a first rest, from which it leaves on another curve."""
    x = np.clip(1.5 * tones() - 25.0, 0.0, 100.0)
    x[:400] = 0.0
    assert CLIPPED not in asked(x, moved(x))
    assert CLIPPED not in asked(x, lfilter([0.1], [1, -0.9], moved(x)))


@pytest.mark.parametrize("motion", [tones, triangles])
def test_rows_that_both_channels_lost_are_asked_about(motion: Callable[[], FloatArray]) -> None:
    x = motion()
    kept = np.r_[:2500, 2760 : T.size]
    assert JOINED in asked(x[kept], moved(x)[kept])
    stepped = np.where(T < 2.5, x, np.roll(x, -290))[:5700]  # the voltage jumps, and a slow actuator follows
    assert JOINED not in asked(stepped, lfilter([0.05], [1, -0.95], moved(stepped)))


def test_an_ac_coupled_sensor_is_asked_about() -> None:
    x = tones()
    assert COUPLED in asked(x, lfilter(*butter(1, 0.5 / RATE, "high"), moved(x)))


def test_noise_makes_no_turn_late(tmp_path: Path) -> None:
    """At 5 Hz the turns of slow sines seemed to be 0.24 s late: are the stamps in ms?"""
    x = 50 - 50 * np.cos(2 * np.pi * T * 4) ** 3
    z = moved(x)
    z += 0.02 * np.ptp(z) * np.random.default_rng(1).standard_normal(z.size)

    def late(rows: int) -> bool:
        table = np.column_stack([200 * T[rows:], x[rows:], z[: z.size - rows]])
        np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t (s),volts (V),z (um)", comments="")
        return "later than the voltage" in "; ".join(examine(read_record(tmp_path / "a.csv")).implausible)

    assert (late(0), late(20)) == (False, True)


@pytest.mark.parametrize("seed", [4, 20, 23])
def test_noise_makes_no_displacement_early(seed: int) -> None:
    """The rates of slow triangles are those of the noise: of reversal curves 27 to 142 rows of lead were refused."""
    turns = np.concatenate([[0.0, 100.0], np.stack([np.linspace(90, 0, 8), np.full(8, 100.0)], axis=1).ravel()])
    x, r = np.interp(np.linspace(0, 1, T.size), np.linspace(0, 1, turns.size), turns), np.random.default_rng(seed)
    z = moved(x) + 0.6 * r.standard_normal(x.size)
    noisy = x + 0.2 * r.standard_normal(x.size)
    assert not examine(Record.from_arrays(noisy, z, sample_rate=RATE)).mistakes
    early = examine(Record.from_arrays(noisy[:-100], z[100:], sample_rate=RATE)).mistakes
    assert "leads the voltage" in early[0] or "clockwise" in early[0]
