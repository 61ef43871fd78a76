"""Whether gain or delay of a record change within it: steps of both beside the fit that explain its residual."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.identification.held_out.steps import Steps, blocks

TRIED = 4  # steps, one after the other: one is a change, the others show what chance and errors of the model make
CLEAR = 7.0  # deviations of the residual, and of what all steps explain behind those that are tried
ALONE = 1.9  # times what the next steps explain
WALKS = 2  # cosines of a gain that changes slowly


class Change(NamedTuple):
    """A gain that is larger by a share, or a displacement that is later by so many s, from a row on."""

    of: Literal["gain", "delay"]
    size: float
    row: int


@one_thread
def change(
    residual: FloatArray, columns: FloatArray, pull: FloatArray, volts: FloatArray, moved: FloatArray, rate: FloatArray
) -> Change | None:
    """One change of gain or delay, if there is one.

    Parameters
    ----------
    residual, columns, pull, volts
        As `jump` has them.
    moved, rate : ndarray, shape (rows,)
        Displacement that the model predicts, um, and its rate, um/s.
    """
    of = blocks(residual, columns, pull, volts)
    if of is None:
        return None
    gain = of.means(moved)
    kinds: tuple[tuple[Literal["gain", "delay"], Steps], ...] = (
        ("gain", Steps(of, gain - gain.mean(), np.ones(gain.size), WALKS)),
        ("delay", Steps(of, -of.means(rate))),
    )
    each = [(_share(steps), kind) for kind, steps in kinds]
    (share, size, at), kind = max(each)
    return Change(kind, size, at * of.each) if share > 1.0 else None


def _share(steps: Steps) -> tuple[float, float, int]:
    """What the best step explains, over what it has to, at least; its size, and its block."""
    found = [steps.next() for _ in range(TRIED)]
    deviation = max(float(np.std(steps.residual)), 1e-300)
    explains, size, at = found[0]
    least = max(CLEAR * deviation, CLEAR * steps.usual, ALONE * max(share for share, _, _ in found[1:]))
    return explains / least, size, at
