"""What can be kept of a run beside its time of convergence: metrics by name, each with its formula."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.studies.engine import Channels


@dataclass(frozen=True)
class Metric:
    """A number of a run: words and unit for a table, and the function of its channels."""

    words: str
    unit: str
    of: Callable[[Channels], float]


def error(channels: Channels) -> FloatArray:
    """True minus desired displacement, um, shape (ticks,)."""
    return np.asarray(channels["true"] - channels["desired"])


def _half(values: FloatArray) -> FloatArray:
    return values[values.size // 2 :]


def _flagged(name: str) -> Callable[[Channels], float]:
    return lambda channels: 100 * float(np.mean((channels["flags"] & BIT[name]) > 0))


METRICS = {
    "rmse": Metric("rmse, second half", "um", lambda c: float(np.sqrt(np.mean(_half(error(c)) ** 2)))),
    "maximum": Metric("maximum, second half", "um", lambda c: float(np.max(np.abs(_half(error(c)))))),
    "largest": Metric("largest error anywhere", "um", lambda c: float(np.max(np.abs(error(c))))),
    "saturated": Metric("ticks at a voltage limit", "%", _flagged("saturated")),
    "projected": Metric("ticks with a projection", "%", _flagged("projected")),
    "rejected": Metric("measurements rejected", "%", _flagged("rejected")),
    "changed": Metric("ticks with a change found", "%", _flagged("changed")),
    "slewed": Metric("ticks at the slew limit", "%", _flagged("slewed")),
}
"""Of the true error and the flags of a run, by name."""
