"""Charts that a reader can zoom into: the samples of a run inside its page, for the script of the page.

The pictures of a page need no script; a chart is beside them where there is one. uPlot plots it (MIT licence, in the
folder uplot).
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base.typing import FloatArray

PAGE = 1_700_000  # characters of the pictures and charts of a page: the page stays below 2 MB
BUDGET = 1_200_000  # of its charts
LEAST = 200_000  # of its charts where the pictures take much
LEVELS = 65534  # of a value between the lowest and the highest of its line
GAP = np.uint16(65535)  # a value that is not known


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a panel: its name, the role of its colour in `style.ROLES`, its values of shape (samples,)."""

    name: str
    role: str
    values: FloatArray
    points: bool = False  # in place of a line


@dataclass(frozen=True)
class Panel:
    """Lines that share a vertical axis; `label` says what it shows, with the unit."""

    label: str
    lines: Sequence[Line]
    logarithmic: bool = False  # the vertical axis; values of 0 and less are left out


@dataclass(frozen=True)
class Chart:
    """Panels, one above the other, that share their horizontal axis.

    Attributes
    ----------
    panels : sequence of Panel
        Their lines have equally many samples.
    start, step : float
        Place of the first sample and distance of two, in the unit of `label`.
    label : str
        Of the horizontal axis, with its unit.
    places : ndarray, shape (samples,), or None
        Of samples that are not evenly spaced, above 0: in place of `start` and `step`, on a logarithmic axis. They are
        few, and never thinned.
    """

    panels: Sequence[Panel]
    start: float = 0.0
    step: float = 1.0
    label: str = "time (s)"
    places: FloatArray | None = None

    @property
    def lines(self) -> list[Line]:
        """Of all panels."""
        return [line for panel in self.panels for line in panel.lines]

    def encoded(self, budget: int = BUDGET) -> dict[str, Any]:
        """What the script takes: each line as integers of 16 bits in base64.

        A run that is longer than `budget` characters allow is thinned to the lowest and the highest value of groups of
        ticks, in their order, so that no peak is lost.

        Examples
        --------
        >>> spike = np.zeros(100_000)
        >>> spike[5431] = 1.0
        >>> made = Chart([Panel("error (µm)", [Line("true", "true", spike)])], 0.0, 0.001).encoded(10_000)
        >>> made["samples"], made["step"], made["panels"][0]["lines"][0]["high"]
        (3704, 0.027, 1.0)
        """
        most = max(2, int(budget / (4 / 3 * 2 * max(1, len(self.lines)))))  # samples of a line
        longest = max((line.values.size for line in self.lines), default=0)
        group = thinning(longest, most) if self.places is None else 1
        step = self.step if group == 1 else self.step * group / 2
        panels = [
            {
                "label": panel.label,
                "logarithmic": panel.logarithmic,
                "lines": [_encoded(line, extremes(line.values, group), panel.logarithmic) for line in panel.lines],
            }
            for panel in self.panels
        ]
        samples = max((extremes(line.values, group).size for line in self.lines), default=0)
        made = {"start": self.start, "step": step, "label": self.label, "samples": samples, "panels": panels}
        return made | ({} if self.places is None else {"places": [float(f"{at:.6g}") for at in self.places]})


def thinning(samples: int, most: int) -> int:
    """How many samples become two, so that at most `most` remain; 1 where all of them are kept.

    Examples
    --------
    >>> thinning(1000, 1000), thinning(1001, 1000), thinning(100_000, 1000)
    (1, 3, 200)
    """
    return 1 if samples <= most else max(3, -(-samples // (most // 2)))


def extremes(values: FloatArray, group: int) -> FloatArray:
    """The lowest and the highest value of each `group` of samples, in the order in which they come.

    Examples
    --------
    >>> extremes(np.array([0.0, 5.0, 1.0, 3.0, 2.0, -1.0]), 3)
    array([ 0.,  5.,  3., -1.])
    """
    if group == 1:
        return np.asarray(values, dtype=np.float64)
    padded = np.full(-(-values.size // group) * group, np.nan)
    padded[: values.size] = values
    blocks = padded.reshape(-1, group)
    known = np.isfinite(blocks)
    first, second = np.where(known, blocks, np.inf).argmin(axis=1), np.where(known, blocks, -np.inf).argmax(axis=1)
    order = np.sort(np.stack([first, second], axis=1), axis=1)
    return np.take_along_axis(blocks, order, axis=1).ravel()


def _encoded(line: Line, values: FloatArray, logarithmic: bool) -> dict[str, Any]:
    """The levels; of a logarithmic panel those of the decimal logarithms."""
    if logarithmic:
        values = np.log10(values, where=values > 0.0, out=np.full(values.size, np.nan))
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    levels = np.full(values.size, GAP, dtype="<u2")
    levels[known] = np.round((values[known] - low) * (LEVELS / ((high - low) or 1.0)))
    data = base64.b64encode(levels.tobytes()).decode("ascii")
    made = {"name": line.name, "role": line.role, "low": low, "high": high, "data": data}
    return made | ({"points": True} if line.points else {})
