"""Up to which frequency a record tests the response of its stage, and what of another motion is above it."""

from __future__ import annotations

import math

import numpy as np

from truestroke.base.typing import FloatArray

LARGEST = 3.0  # times the motion: what a mode adds near its resonance before it has rung up
HIGHEST = 0.5  # times the sample rate: no record tests more
HALVINGS = 40  # of the range, by its logarithm
BINS = 2000  # of the spectrum at most
SEEN = 2.0  # times the residual of the record: motion above F that is further is untested
OFTEN, RAISED = 99.0, 1.4  # % of the record's time, and the factor of the frequencies that are tried
PERIODS = 4.0  # by which a motion is continued at both ends, as if it came from there and went on


def frequency(moved: FloatArray, sample_rate: float, noise: float) -> float:
    """Frequency F of the lowest mode that the residual of a record could hide, Hz; 0 where nothing moves.

    ::

        sum P(f) a(f)^2 = noise^2,      a(f) = f^2 / (F^2 - f^2) far below F, 3 near it and above

    P is the mean square of the motion at f, and a(f) what a mode at F adds to it. A lower mode adds more than the
    residual, which would show it. F is higher where the record has turns or steps of its own: as high as it has
    motion above F of `SEEN` times the noise in a hundredth of its time, and never above half of the sample rate.

    Parameters
    ----------
    moved : ndarray, shape (samples,)
        Motion of the record without noise, um.
    sample_rate : float
        Hz.
    noise : float
        Standard deviation of the residual, um.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> sine = 10.0 - 10.0 * np.cos(2 * np.pi * 2.0 * t)
    >>> round(frequency(sine, 1000.0, 0.1)), round(frequency(sine, 1000.0, 0.01))
    (17, 54)
    """
    f, power = _spectrum(moved, sample_rate)
    if noise <= 0 or not float(power.sum()) > 0:
        return 0.0
    low, high = math.log(f[0]), math.log(HIGHEST * sample_rate)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        hidden = float(power @ _added(f, math.exp(middle)) ** 2) <= noise**2
        low, high = (low, middle) if hidden else (middle, high)
    found = math.exp(high)
    while np.percentile(above(moved, sample_rate, found), OFTEN) > SEEN * noise:
        found *= RAISED
    return min(found, HIGHEST * sample_rate)


def _added(f: FloatArray, mode: float) -> FloatArray:
    """By how many times its motion at f a mode moves otherwise than a rigid stage."""
    nearer = np.maximum(mode**2 - f**2, 1e-9 * mode**2)
    return np.where(f < mode, np.minimum(f**2 / nearer, LARGEST), LARGEST)


def _spectrum(z: FloatArray, fs: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies, Hz, and the mean square at each, um^2, behind Hann's window; without the mean."""
    window = np.hanning(z.size)
    spectrum = np.abs(np.fft.rfft((z - z.mean()) * window)) ** 2
    spectrum *= 2 / (z.size * float(window @ window))
    f = np.arange(spectrum.size) * fs / z.size
    edges = np.unique(np.geomspace(1, spectrum.size, BINS).astype(int))[:-1]
    power, moment = (np.add.reduceat(values, edges) for values in (spectrum, spectrum * f))
    return np.where(power > 0, moment / np.maximum(power, 1e-300), f[edges]), power


def above(moved: FloatArray, sample_rate: float, tested: float) -> FloatArray:
    """How far a motion goes above a frequency within a period of it around each sample, um, shape (samples,).

    A high pass without phase.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> slow, fast = np.cos(2 * np.pi * 2.0 * t), 0.1 * np.cos(2 * np.pi * 50.0 * t)
    >>> above(slow + fast, 1000.0, 20.0)[[1000, 2000]].round(2)
    array([0.1, 0.1])
    """
    if not 0 < tested < 0.45 * sample_rate or moved.size < 2:
        return np.zeros_like(moved)
    from scipy.ndimage import maximum_filter1d
    from scipy.signal import butter, sosfiltfilt

    rows = min(math.ceil(PERIODS * sample_rate / tested), moved.size - 1)
    filtered = sosfiltfilt(butter(2, tested, "high", fs=sample_rate, output="sos"), moved, padlen=rows)
    return np.asarray(maximum_filter1d(np.abs(filtered), math.ceil(sample_rate / tested), mode="nearest"))
