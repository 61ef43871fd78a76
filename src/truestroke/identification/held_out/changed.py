"""Whether gain or delay of a record change within it: steps of both beside the fit that explain its residual."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.identification.held_out.steps import Blocks, Steps

TRIED = 4  # steps, one after the other: one is a change, the others show what chance and errors of the model make
CLEAR = 6.0  # deviations of the residual, and of what all steps explain behind those that are tried
ALIKE = 7.0  # deviations by how far parts of the record differ: a change is the same in all, an error of the model not
PARTS = 12, 20
ALONE = 1.5  # times what the next steps explain
SHOWN = 25.0  # blocks that show as much of it as all do beside the fit, at least: errors of the model show less


class Change(NamedTuple):
    """A gain that is larger by a share, or a displacement that is later by so many s, from a row on."""

    of: Literal["gain", "delay"]
    size: float
    row: int


@one_thread
def change(of: Blocks, moved: FloatArray, rate: FloatArray) -> Change | None:
    """One change of gain or delay, if there is one.

    Parameters
    ----------
    of : Blocks
        Of the fit, as `blocks` makes them.
    moved, rate : ndarray, shape (rows,)
        Displacement that the model predicts, um, and its rate, um/s.
    """
    gain = of.means(moved)
    kinds: tuple[tuple[Literal["gain", "delay"], Steps], ...] = (
        ("gain", Steps(of, gain - gain.mean(), np.ones(gain.size))),
        ("delay", Steps(of, -of.means(rate))),
    )
    (share, size, at), kind = max((_share(steps), kind) for kind, steps in kinds)
    return Change(kind, size, at * of.each) if share > 1.0 else None


def _share(steps: Steps) -> tuple[float, float, int]:
    """What the best step explains, over what it has to, at least; its size, and its block."""
    explains, size, at = steps.next()
    if explains == 0.0 or explains**2 < SHOWN * size**2 * steps.square:
        return 0.0, 0.0, 0
    scatter = max(steps.scatter(parts) for parts in PARTS)
    others = max(steps.next()[0] for _ in range(TRIED - 1))
    if others == 0.0:  # there is nowhere else to compare it with
        return 0.0, 0.0, 0
    deviation = max(float(np.std(steps.residual)), steps.usual)
    return explains / max(CLEAR * deviation, ALIKE * scatter, ALONE * others), size, at
