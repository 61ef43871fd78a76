"""What a sensor says at rest, and how it answers small steps: noise, polarity, gain, latency, with uncertainties."""

from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import FloatArray

SEEN = 8.0  # standard errors: an answer smaller than that is none
SETTLED = 0.5  # of a level: its last part, that is taken for the displacement
ONSET = 6.0  # standard deviations of the noise by which the answer leaves rest


@dataclass(frozen=True)
class Rest:
    """A sensor under constant voltage."""

    zero: float  # um, the mean
    noise: float  # um, standard deviation of a tick about a straight line
    drift: float  # um/s, slope of that line
    lost: float  # share of ticks without a sample
    frozen: bool  # whether it shows the same to the last bit all the time


def rest(z: FloatArray, sample_rate: float) -> Rest:
    """Zero, noise and drift of a record at rest (um, NaN where a sample was lost), `sample_rate` in Hz.

    >>> rest(np.array([1.0, 2.0, 1.0, 2.0, np.nan]), 1000.0).lost.__round__(2)
    0.2
    """
    used = np.isfinite(z)
    if used.sum() < 3:
        return Rest(np.nan, np.nan, np.nan, float(1 - used.mean()), False)
    t, kept = np.flatnonzero(used) / sample_rate, z[used]
    slope, offset = np.polyfit(t - t.mean(), kept, 1)
    noise = float(np.std(kept - offset - slope * (t - t.mean()), ddof=2))
    return Rest(float(kept.mean()), noise, float(slope), float(1 - used.mean()), bool(np.ptp(kept) == 0))


@dataclass(frozen=True)
class Gain:
    """The answer to steps of one height."""

    step: float  # V
    gain: float  # um/V
    uncertainty: float  # um/V, standard error, from how much the steps differ and from the noise

    @property
    def seen(self) -> bool:
        """Whether there is an answer, or only noise and motion of others."""
        return abs(self.gain) > SEEN * self.uncertainty


def gain(volts: FloatArray, z: FloatArray, latency: int, noise: float = 0.0) -> Gain:
    """Gain from levels of voltage that alternate, each held for some time.

    Entry i of `z` (um, NaN where a sample was lost) answers entry i - latency of `volts` (V), both of shape (ticks,);
    roughly, as the first half of each level is not used. The means of the levels are fitted by gain times voltage and a
    parabola over time, so that a drift does not count. `noise` is the standard deviation of one sample, um: few levels
    agree by chance, and the uncertainty is not smaller than the one that this noise makes.

    >>> volts = np.tile(np.repeat([0.0, 0.1], 50), 4)
    >>> found = gain(volts, 8.0 * volts + 1e-4 * np.arange(400), 0)
    >>> print(f"{found.gain:.3f} um/V, {found.seen}")
    8.000 um/V, True
    """
    levels = [level for level in _levels(volts, z, latency) if level[2]]
    if len(levels) < 7:
        return Gain(float(np.ptp(volts)), 0.0, np.inf)
    v, mean, samples = np.array(levels).T
    time = np.linspace(-1.0, 1.0, v.size)
    terms = np.stack((v, np.ones_like(time), time, time**2), axis=1)
    inverse = np.linalg.pinv(terms)
    found = inverse @ mean
    spread = np.sqrt(np.sum((mean - terms @ found) ** 2) / (v.size - terms.shape[1]))
    by_spread = float(spread * np.linalg.norm(inverse[0]))
    by_noise = float(noise * np.linalg.norm(inverse[0] / np.sqrt(samples)))
    return Gain(float(np.ptp(v)), float(found[0]), max(by_spread, by_noise, 1e-12))


def _levels(volts: FloatArray, z: FloatArray, latency: int) -> list[tuple[float, float, int]]:
    """Voltage, settled mean and number of samples of each level; ramps between them are none."""
    edges = np.flatnonzero(np.diff(volts)) + 1
    levels = []
    for start, stop in zip([0, *edges], [*edges, volts.size], strict=True):
        if stop - start < 4:
            continue
        part = z[min(start + latency + int(SETTLED * (stop - start)), z.size) : stop + latency]
        part = part[np.isfinite(part)]
        levels.append((float(volts[start]), float(part.mean()) if part.size else np.nan, part.size))
    return levels


def onset(volts: FloatArray, z: FloatArray, noise: float) -> int | None:
    """Ticks from the first step of `volts` (V) to the first sample that shows it; None where none does.

    `z` is the record of the same ticks, um, and `noise` the standard deviation of one of them, um.

    >>> volts = np.repeat([0.0, 0.1, 0.0], 40)
    >>> onset(volts, 8.0 * np.roll(volts, 5), noise=0.01)
    5
    """
    edges = np.flatnonzero(np.diff(volts)) + 1
    if not edges.size:
        return None
    before = z[: edges[0]]
    away = np.abs(z - np.nanmean(before)) > max(ONSET * noise, 1e-3 * float(np.nanmax(z) - np.nanmin(z)))
    away[: edges[0]] = False
    both = np.flatnonzero(away[:-1] & away[1:])  # one sample alone is a spike
    return int(both[0] - edges[0]) if both.size else None
