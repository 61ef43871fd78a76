"""A voltage that was clipped where it was recorded: the displacement goes on, and comes back."""

from collections.abc import Sequence

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.signals.clipping import runs

LEVEL = 12.0  # times the noise of the voltage: so wide is the end of its range
FEWEST = 6  # rows of an arc
LEAST = 0.01  # of the stroke: height of an arc, at least,
WIDER = 1.5  # and of the width of the end, as a share of the span, besides,
TO_AND_FRO = 6.0  # and of deviations of the displacement's noise
ROUND = 0.8  # of the variance within an arc that a parabola explains, at least
INSIDE = 0.6  # of half of an arc: its vertex is that near to the middle
GOES_ON = 0.3, 1.1  # its speed in the first and last third over that just before and behind: a hold that rings stops
JUMP = 0.1  # of the span: a step, after which a displacement rings
MOST = 0.5  # of the rows at that end are in arcs: a stage that rings makes few
BINS = 6  # of the mean arc, and of the rows before and behind it
FEWEST_TOGETHER = 30  # rows of arcs
TOGETHER = 5.0  # deviations of the noise: by so much the mean arc is curved
WAYS = 3.0  # the same, and so far it comes and leaves within two bins
SLOWER = 0.04  # of the speed beside it: a motion that turns slowly goes on as slowly in the mean arc,
HIGH, MIDDLE = 0.02, 0.3  # which is then of that share of the stroke, and has its vertex that near to the middle
PLACES, REST = 4, 12  # holds at one end, and their rows, of which the second half is looked at
STEADY = 0.5  # of that deviation: by less it goes on within a hold
APART = 0.03, 6.0  # of the stroke, and deviations of the noise: so far they are from one level beside a drift


Runs = Sequence[tuple[int, int]]  # first row and end of each


def clipped_volts(volts: FloatArray, moved: FloatArray, quiet: float, rough: float) -> tuple[int, float]:
    """Rows at the ends of the voltage in which the displacement goes on and comes back in an arc, and the highest, um.

    A displacement knows nothing of a limit of the recording: it goes on as fast as before, and leaves as fast as it
    comes back. In a hold it creeps, arrives late, or rings. `quiet` and `rough` are the noises of the two.

    Examples
    --------
    >>> x = np.sin(np.linspace(0.0, 12.0, 2000))
    >>> y = np.minimum(x, 0.9)
    >>> clipped_volts(y, x, 0.0, 0.0)[0], clipped_volts(y, y, 0.0, 0.0)[0]
    (300, 0)
    """
    span, stroke = float(np.ptp(volts)), float(np.ptp(moved))
    width = LEVEL * quiet
    least = max((LEAST + WIDER * width / span) * stroke, TO_AND_FRO * rough)
    rows, most = 0, 0.0
    top, bottom = volts >= volts.max() - width, volts <= volts.min() + width
    for sign, near, far in ((1, top, bottom), (-1, bottom, top)):
        ends = [(int(start), int(stop)) for start, stop in runs(near) if stop - start >= FEWEST]
        heights = [_height(volts, moved, sign, rows_of, JUMP * span) for rows_of in ends]
        sizes, high = np.array([stop - start for start, stop in ends]), np.array(heights) > least
        if high.any() and sizes[high].sum() > MOST * sizes.sum():
            rows, most = rows + int(sizes[high].sum()), max(most, *heights)
        elif ends:
            share = max(LEAST + WIDER * width / span, 1e-9)
            height = _height_of_mean(volts, moved, sign, ends, JUMP * span, rough, share * stroke, HIGH * stroke)
            known = int(np.argmax(far))
            later = [rows_of for rows_of in ends if rows_of[0] > known]  # the other end takes the memory of the start
            height = max(height, _spread(moved, later, rough, APART[0] * stroke))
            rows, most = rows + (int(sizes.sum()) if height else 0), max(most, height)
    return rows, most


def _height(volts: FloatArray, moved: FloatArray, sign: int, rows: tuple[int, int], jump: float) -> float:
    """Of the arc of the displacement in these rows, to the side of `sign`, um; 0 where it is none."""
    start, stop = rows
    third = max((stop - start) // 3, 2)
    if not _is_entered_evenly(volts, rows, jump):
        return 0.0
    part, z = sign * moved[start:stop], sign * moved[start - third : stop + third]
    arc = _arc(np.linspace(-1.0, 1.0, part.size), part)
    if arc is None:
        return 0.0
    before, behind = z[third] - z[0], z[-third - 1] - z[-1]
    up, down = part[third - 1] - part[0], part[-third] - part[-1]
    slowest, fastest = GOES_ON
    goes_on = all(slowest * by < way < fastest * by for way, by in ((up, before), (down, behind)))
    return arc[0] if goes_on else 0.0


def _arc(u: FloatArray, part: FloatArray, noise2: float = 0.0) -> tuple[float, float, float] | None:
    """Height and curvature of the parabola through `part` at u, -1 to 1, and its vertex; None where it is no arc.

    noise2: variance that the parabola need not explain.
    """
    bend, slope, level = np.polyfit(u, part, 2)
    if bend >= 0 or abs(vertex := -slope / (2 * bend)) > INSIDE:
        return None
    if np.var(part - ((bend * u + slope) * u + level)) > (1 - ROUND) * np.var(part) + noise2:
        return None
    return float(-bend * (1 - abs(vertex)) ** 2), float(-bend), float(vertex)


def _is_entered_evenly(volts: FloatArray, rows: tuple[int, int], jump: float) -> bool:
    """Whether the voltage comes to these rows and leaves them without a jump, and a third of them is on either side."""
    start, stop = rows
    third = max((stop - start) // 3, 2)
    if start < third or stop + third > volts.size:
        return False
    return bool(max(abs(volts[start] - volts[start - 1]), abs(volts[stop - 1] - volts[stop])) <= jump)


def _height_of_mean(
    volts: FloatArray, moved: FloatArray, sign: int, ends: Runs, jump: float, rough: float, least: float, high: float
) -> float:
    """Of the mean arc at an end of the voltage, um, beneath noise that hides each; 0 where it is none.

    Each arc is less its own mean, which a zero that walks moves, and counts by its rows.
    """
    total, square, rows = np.zeros(3 * BINS), np.zeros(3 * BINS), 0
    for start, stop in ends:
        if not _is_entered_evenly(volts, (start, stop), jump):
            continue
        n, third = stop - start, max((stop - start) // 3, 2)
        z = sign * moved[start - third : stop + third]
        parts = np.linspace(0, third, BINS + 1), np.linspace(0, n, BINS + 1)[1:], np.linspace(0, third, BINS + 1)[1:]
        edges = np.concatenate([parts[0], third + parts[1], third + n + parts[2]])
        sums = np.interp(edges, np.arange(z.size + 1), np.concatenate([[0.0], np.cumsum(z - z.mean())]))
        total += n * np.diff(sums) / np.diff(edges)
        square += n**2 * rough**2 / np.maximum(np.diff(edges), 1.0)
        rows += n
    if rows < FEWEST_TOGETHER:
        return 0.0
    mean, unsure = total / rows, float(np.sqrt(square[BINS : 2 * BINS].mean())) / rows
    return _height_of_bins(mean, unsure, least, high)


def _height_of_bins(mean: FloatArray, unsure: float, least: float, high: float) -> float:
    """Of a mean arc in bins with those before and behind it, um, of the deviation `unsure`; 0 where it is none."""
    part, u = mean[BINS : 2 * BINS], (2 * np.arange(BINS) + 1.0) / BINS - 1.0
    arc = _arc(u, part, 2 * unsure**2)
    if arc is None:
        return 0.0
    height, bend, vertex = arc
    square = np.linalg.inv(np.vander(u, 3).T @ np.vander(u, 3))[0, 0]
    if height < least or bend < TOGETHER * unsure * np.sqrt(square):
        return 0.0
    near, over = BINS // 3, 4 * unsure * 3 / BINS
    before, behind = ((mean[a] - mean[b]) / (BINS - 1) for a, b in ((BINS - 1, 0), (2 * BINS, 3 * BINS - 1)))
    up, down = (part[near] - part[0]) / (3 * near), (part[-1 - near] - part[-1]) / (3 * near)
    if min(part[near] - part[0], part[-1 - near] - part[-1]) < WAYS * unsure:
        return 0.0
    slowest, fastest = SLOWER if height > high and abs(vertex) < MIDDLE else GOES_ON[0], GOES_ON[1]
    goes_on = all(slowest * by - over < way < fastest * by + over for way, by in ((up, before), (down, behind)))
    return height if goes_on else 0.0


def _spread(moved: FloatArray, ends: Runs, rough: float, least: float) -> float:
    """From the lowest to the highest level of the displacement in holds at an end of the voltage; 0 where it is one.

    There the memory of all other turns is gone: the actuator comes to one place, but for creep and drift.
    """
    holds = [((start + stop) // 2, stop) for start, stop in ends if stop - start >= REST]
    if len(holds) < PLACES:
        return 0.0
    quarters = np.array([[moved[a : (a + b) // 2].mean(), moved[(a + b) // 2 : b].mean()] for a, b in holds])
    levels = quarters.mean(axis=1)
    drift = np.column_stack([np.ones(levels.size), [start for start, _ in holds]])
    apart = levels - drift @ np.linalg.lstsq(drift, levels, rcond=None)[0]
    deviation = float(np.sqrt(apart @ apart / (levels.size - 2)))
    unsure = rough / np.sqrt(min(stop - start for start, stop in holds))
    within = float(np.median(np.abs(np.diff(quarters, axis=1))))  # of a lag or a resonance that has not ended
    return float(np.ptp(apart)) if deviation > max(least, APART[1] * unsure, within / STEADY) else 0.0
