"""Whether the zero jumped within a record: steps beside the fit that explain its residual, one or two."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.identification.held_out.steps import SHOWN, Blocks, Steps

TRIED = 4  # steps, one after the other: one or two of them are jumps, the others show what chance and errors make
CLEAR = 6.0  # deviations of the residual, and of what all steps explain behind those that are tried
ALONE = 1.9, 1.6  # times what the next steps explain: one jump, and the smaller one of two
AT_ONCE, SURE = 0.5, 6.0  # of its height, within so few blocks that they show it by so many deviations
APART = 2.0  # strokes between two jumps: the error of a model comes and goes within one


class Jump(NamedTuple):
    """By how much the residual is higher from a row on, um."""

    size: float
    row: int


@one_thread
def jump(of: Blocks, stroke: float) -> Jump | None:
    """The larger of one or two jumps of a residual, um, if there are any.

    A fit takes most of a jump, as creep or drift. So each step is taken beside the fit: what it explains is measured
    in what the coefficients cannot make up for. The error of a model comes and goes in many places, and many steps
    explain it alike; a zero jumps in one or two.

    Parameters
    ----------
    of : Blocks
        Of the fit, as `blocks` makes them.
    stroke : float
        Rows.

    Examples
    --------
    >>> from truestroke.identification.held_out.steps import blocks
    >>> noise = np.random.Generator(np.random.PCG64(0)).standard_normal(4000)
    >>> nothing = np.zeros((4000, 0)), np.zeros((0, 0)), np.cos(np.arange(4000) / 30.0)
    >>> jumped = noise + 2.0 * (np.arange(4000) > 1700)
    >>> jump(blocks(noise, *nothing), 100.0), jump(blocks(jumped, *nothing), 100.0).row
    (None, 1701)
    """
    r, each = of.residual, of.each
    steps = Steps(of, np.ones(r.size))
    found = [steps.next() for _ in range(TRIED)]
    deviation = max(float(np.std(steps.residual)), 1e-9 * float(np.abs(r).max()), 1e-300)
    explain = np.array([share for share, _, _ in found]) / deviation
    for jumps, alone in enumerate(ALONE, 1):
        least = float(explain[:jumps].min())
        clear = least > CLEAR * max(1.0, steps.usual / deviation) and least > alone * explain[jumps:].max()
        apart = jumps == 1 or abs(found[0][2] - found[1][2]) * each > APART * stroke
        if clear and apart and all(_at_once(r, deviation, height, at) for _, height, at in found[:jumps]):
            _, size, at = max(found[:jumps], key=lambda one: abs(one[1]))
            return Jump(size, at * each)
    return None


def _at_once(r: FloatArray, deviation: float, height: float, at: int) -> bool:
    """Whether a residual has most of a step at once: the error that a knock leaves, which decays, goes back slowly."""
    width = int(np.clip(np.ceil(2 * (SURE * deviation / height) ** 2), SHOWN, min(at, r.size - at)))
    change = float(r[at : at + width].mean() - r[at - width : at].mean())
    return change > AT_ONCE * height if height > 0 else change < AT_ONCE * height
