"""A voltage that was clipped where it was recorded: the displacement goes on, and comes back."""

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
    for sign, near in ((1, volts >= volts.max() - width), (-1, volts <= volts.min() + width)):
        ends = [run for run in runs(near) if run[1] - run[0] >= FEWEST]
        heights = [_height(volts, moved, sign, (int(start), int(stop)), JUMP * span) for start, stop in ends]
        sizes, high = np.array([stop - start for start, stop in ends]), np.array(heights) > least
        if high.any() and sizes[high].sum() > MOST * sizes.sum():
            rows, most = rows + int(sizes[high].sum()), max(most, *heights)
    return rows, most


def _height(volts: FloatArray, moved: FloatArray, sign: int, rows: tuple[int, int], jump: float) -> float:
    """Of the arc of the displacement in these rows, to the side of `sign`, um; 0 where it is none."""
    start, stop = rows
    third = max((stop - start) // 3, 2)
    if start < third or stop + third > volts.size:
        return 0.0
    if max(abs(volts[start] - volts[start - 1]), abs(volts[stop - 1] - volts[stop])) > jump:
        return 0.0
    part, z = sign * moved[start:stop], sign * moved[start - third : stop + third]
    u = np.linspace(-1.0, 1.0, part.size)
    bend, slope, level = np.polyfit(u, part, 2)
    if bend >= 0 or abs(vertex := -slope / (2 * bend)) > INSIDE:
        return 0.0
    if np.var(part - ((bend * u + slope) * u + level)) > (1 - ROUND) * np.var(part):
        return 0.0
    before, behind = z[third] - z[0], z[-third - 1] - z[-1]
    up, down = part[third - 1] - part[0], part[-third] - part[-1]
    slowest, fastest = GOES_ON
    goes_on = all(slowest * by < way < fastest * by for way, by in ((up, before), (down, behind)))
    return float(-bend * (1 - abs(vertex)) ** 2) if goes_on else 0.0
