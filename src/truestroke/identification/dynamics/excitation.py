"""The excitation of a measurement of the dynamics: a periodic multisine with random phases, within its limits."""

from dataclasses import dataclass

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray

CREST_TRIALS = 20  # sets of random phases, of which the one with the smallest peak is taken
SPARE = 0.9  # of the slew limit that the excitation uses at most


@dataclass(frozen=True, eq=False)
class Multisine:
    """One period of a multisine.

    Attributes
    ----------
    volts : ndarray, shape (ticks,)
        Without the bias voltage, V.
    lines : ndarray of int, shape (lines,)
        The frequencies that are excited, in steps of 1 / period.
    frequency : ndarray, shape (lines,)
        The same, Hz.
    """

    volts: FloatArray
    lines: np.ndarray
    frequency: FloatArray


def multisine(
    sample_rate: float, ticks: int, band: tuple[float, float], corner: float, peak: float, seed: int = 0
) -> Multisine:
    """A multisine of all lines in a band; its lines are equal up to a corner, then fall as 1 / f.

    Parameters
    ----------
    sample_rate : float
        Hz.
    ticks : int
        Of a period.
    band : tuple[float, float]
        Lowest and highest frequency, Hz.
    corner : float
        From which on the amplitudes fall, so that the peak of the slew stays small, Hz.
    peak : float
        Largest absolute voltage, V.
    seed : int
        Of the phases.

    Examples
    --------
    >>> made = multisine(1000.0, 1000, (5.0, 400.0), 100.0, 0.1)
    >>> made.volts.shape, round(float(abs(made.volts).max()), 6), made.frequency[[0, -1]]
    ((1000,), 0.1, array([  5., 400.]))
    """
    resolution = sample_rate / ticks
    lines = np.arange(int(np.ceil(band[0] / resolution)), int(band[1] / resolution) + 1)
    if lines.size < 20:
        raise SettingError("band", band, f"wider: it has {lines.size} lines at a spacing of {resolution:g} Hz", "Hz")
    frequency = lines * resolution
    amplitudes = 1 / np.hypot(1.0, frequency / corner)
    random, best = np.random.default_rng(seed), np.empty(0)
    for _ in range(CREST_TRIALS):
        spectrum = np.zeros(ticks // 2 + 1, dtype=np.complex128)
        spectrum[lines] = amplitudes * np.exp(2j * np.pi * random.random(lines.size))
        volts = np.fft.irfft(spectrum, ticks)
        volts *= peak / np.max(np.abs(volts))
        if not best.size or volts.std() > best.std():
            best = volts
    return Multisine(best, lines, np.asarray(frequency))


def fastest(volts: FloatArray, sample_rate: float) -> float:
    """Fastest change of a periodic voltage, V/s.

    >>> fastest(np.array([0.0, 0.1, 0.0, -0.1]), 1000.0)
    100.0
    """
    return float(np.max(np.abs(np.diff(volts, append=volts[:1]))) * sample_rate)
