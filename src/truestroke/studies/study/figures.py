"""What can be kept of a run: its time of convergence, and figures by name, each with its formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.signals import metrics

Channels = Mapping[str, Any]


@dataclass(frozen=True)
class Figure:
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


FIGURES = {
    "rmse": Figure("rmse, second half", "um", lambda c: float(np.sqrt(np.mean(_half(error(c)) ** 2)))),
    "maximum": Figure("maximum, second half", "um", lambda c: float(np.max(np.abs(_half(error(c)))))),
    "largest": Figure("largest error anywhere", "um", lambda c: float(np.max(np.abs(error(c))))),
    "saturated": Figure("ticks at a voltage limit", "%", _flagged("saturated")),
    "projected": Figure("ticks with a projection", "%", _flagged("projected")),
    "rejected": Figure("measurements rejected", "%", _flagged("rejected")),
    "changed": Figure("ticks with a change found", "%", _flagged("changed")),
    "slewed": Figure("ticks at the slew limit", "%", _flagged("slewed")),
}
"""Of the true error and the flags of a run, by name."""


def convergence_time(channels: Channels, level: float) -> float | None:
    """`truestroke.signals.metrics.convergence_time` of the true error to `level` (um); s."""
    return metrics.convergence_time(channels["time"], error(channels), level)
