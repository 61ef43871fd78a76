"""A motion of two axes that passes over an area: two trajectories, and the tables of its lines, pixels and triggers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, files
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import FloatArray
from truestroke.signals.trajectories import Trajectory

LINE = np.dtype([("row", "i4"), ("direction", "i4"), ("start", "f8"), ("end", "f8"), ("first", "i8"), ("last", "i8")])
"""A line: its row, +1 (trace) or -1 (retrace), where it begins and ends, s, and the first and last tick within it."""
TRIGGER = np.dtype([("time", "f8"), ("tick", "i8"), ("kind", "U10"), ("line", "i4"), ("pixel", "i4")])
"""A trigger: its time, s, and tick; "line start", "pixel" or "line end"; the number of the line and of the pixel."""


@dataclass(frozen=True, eq=False, repr=False)
class Scan(Displayed):
    """A motion of two axes over an area.

    Attributes
    ----------
    name : str
        "raster", "spiral", "lissajous" or "cycloid".
    x, y : Trajectory
        Of the two axes, with one sample rate and length.
    origin : tuple[float, float]
        Corner of the image with the lowest x and y, um.
    size : tuple[float, float]
        Width and height of the image, um.
    lines : ndarray of `LINE`, shape (lines,)
        Start and end of each line in the order of time: trace and retrace of a raster, turns of a spiral, sweeps of the
        fast axis of a Lissajous curve or a cycloid.
    settings : Mapping[str, object]
        What it was made from. `period` is that of the fast motion, s, of a raster, Lissajous curve or cycloid.

    Raises
    ------
    SettingError
        The axes differ in rate or length, the image has no area, or there is no line.

    Examples
    --------
    >>> from truestroke import scans
    >>> scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
    >>> scan
    Scan: raster of 10 x 10 um, 0.6 s
      sample_rate  10000 Hz
      lines        8
      rate         40 Hz
      turn_time    0.0025 s
    >>> [(int(one["row"]), int(one["direction"]), round(float(one["start"]), 4)) for one in scan.lines[:3]]
    [(0, 1, 0.5), (0, -1, 0.5125), (1, 1, 0.525)]
    """

    name: str
    x: Trajectory
    y: Trajectory
    origin: tuple[float, float]
    size: tuple[float, float]
    lines: npt.NDArray[np.void]
    settings: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            checks.instance(name, getattr(self, name), Trajectory, "a Trajectory, such as of truestroke.trajectories")
        if self.x.sample_rate != self.y.sample_rate:
            raise SettingError("y.sample_rate", self.y.sample_rate, f"{self.x.sample_rate:g} Hz, that of x", "Hz")
        if len(self.x) != len(self.y):
            raise SettingError("y", f"{len(self.y)} ticks", f"{len(self.x)} ticks, as many as of x")
        for name, value in zip(("width", "height"), self.size, strict=True):
            checks.positive(name, value, "um")
        if not self.lines.size:
            raise SettingError("lines", "none", "at least one line")

    def _display(self) -> tuple[str, Rows]:
        title = f"Scan: {self.name} of {self.size[0]:g} x {self.size[1]:g} um, {self.x.duration:g} s"
        rows = [("sample_rate", quantity(self.sample_rate, "Hz")), ("lines", quantity(self.lines.size))]
        units = {"rate": "Hz", "rotation": "Hz", "frequency": "Hz", "turn_time": "s", "pitch": "um"}
        rows += [(name, quantity(self.settings[name], unit)) for name, unit in units.items() if name in self.settings]
        return title, rows

    @property
    def sample_rate(self) -> float:
        """Ticks per second, Hz."""
        return self.x.sample_rate

    @property
    def axes(self) -> tuple[Trajectory, Trajectory]:
        """The motions of x and y."""
        return self.x, self.y

    @property
    def time(self) -> FloatArray:
        """Start of each tick, s."""
        return self.x.time

    @property
    def inside(self) -> npt.NDArray[np.bool_]:
        """Whether each tick is in a line, where errors count, shape (ticks,)."""
        return self.line_of_tick >= 0

    @property
    def line_of_tick(self) -> npt.NDArray[np.int32]:
        """Number of the line that each tick is in, shape (ticks,); -1 outside of lines."""
        return _lines_of(self.lines, len(self.x))

    def until(self, ticks: int) -> Scan:
        """Its first ticks, with the rows of which all lines have ended by then: what a scan that was cut short shows.

        Raises
        ------
        SettingError
            No row is complete.

        Examples
        --------
        >>> from truestroke import scans
        >>> scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
        >>> part = scan.until(5600)
        >>> len(part.lines), part.size, len(part.x)
        (4, (10.0, 5.0), 5600)
        """
        ticks = checks.count("ticks", ticks, 1, len(self.x))
        open_rows = self.lines["row"][self.lines["last"] >= ticks]
        rows = int(open_rows.min()) if open_rows.size else int(self.lines["row"].max()) + 1
        if not rows:
            raise SettingError("ticks", ticks, "as many as end the first row of the scan")
        x, y = (
            dataclasses.replace(
                axis,
                **{name: getattr(axis, name)[:ticks] for name in ("position", "velocity", "acceleration")},
                flat=None,
            )
            for axis in self.axes
        )
        part = rows / (int(self.lines["row"].max()) + 1) if self.name == "raster" else 1.0
        size = self.size[0], self.size[1] * part
        kept = self.lines[self.lines["row"] < rows]
        return Scan(self.name, x, y, self.origin, size, kept, {**self.settings, "rows": rows})

    def pixels(self, columns: int) -> FloatArray:
        """Time of the centre of each pixel of a line, s, shape (lines, columns), in the order of the columns.

        A line is divided into equal times: on a line of constant speed into equal lengths. Of a retrace the times fall
        from column to column, so that a column is the same place in both directions.

        Examples
        --------
        >>> from truestroke import scans
        >>> scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
        >>> scan.pixels(4)[:2].round(5).tolist()
        [[0.50125, 0.50375, 0.50625, 0.50875], [0.52125, 0.51875, 0.51625, 0.51375]]
        """
        columns = checks.count("columns", columns, 1, 10**6)
        part = (np.arange(columns) + 0.5) / columns
        part = np.where(self.lines["direction"][:, None] > 0, part, 1 - part)
        return np.asarray(self.lines["start"][:, None] + part * (self.lines["end"] - self.lines["start"])[:, None])

    def triggers(self, columns: int = 0) -> npt.NDArray[np.void]:
        """All triggers in the order of time: start of each line, its pixels (where `columns` are given), its end.

        Parameters
        ----------
        columns : int
            Pixels of a line, at most as many as the shortest line has ticks; a pixel has its trigger where it begins.
            0 is none.

        Returns
        -------
        ndarray of `TRIGGER`

        Raises
        ------
        SettingError
            Pixels are shorter than a tick, so that one tick would have several triggers; `pixels` has times of any.

        Examples
        --------
        >>> from truestroke import scans
        >>> scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
        >>> [(str(one["kind"]), int(one["tick"]), int(one["pixel"])) for one in scan.triggers(2)[:5]]
        [('line start', 5000, -1), ('pixel', 5000, 0), ('pixel', 5050, 1), ('line end', 5100, -1), \
('line start', 5125, -1)]
        """
        columns = checks.count("columns", columns, 0, 10**6)
        most = int((float((self.lines["end"] - self.lines["start"]).min()) * self.sample_rate) + 1e-6)
        if columns > most:
            bound = (
                f"at most {most}, or a higher sample rate: the shortest line has {most} ticks of {self.sample_rate:g} "
            )
            raise SettingError("columns", columns, f"{bound}Hz, and a pixel has one at least")
        part = np.concatenate([[0.0], np.arange(columns) / max(columns, 1), [1.0]])
        start, end = self.lines["start"][:, None], self.lines["end"][:, None]
        made = np.zeros((self.lines.size, part.size), TRIGGER)
        made["time"] = start + part * (end - start)
        made["tick"] = np.ceil(made["time"] * self.sample_rate - 1e-6)
        made["kind"] = ["line start", *["pixel"] * columns, "line end"]
        made["line"] = np.arange(self.lines.size)[:, None]
        made["pixel"] = [-1, *range(columns), -1]
        backwards = (self.lines["direction"] < 0)[:, None] & (made["pixel"] >= 0)
        made["pixel"] = np.where(backwards, columns - 1 - made["pixel"], made["pixel"])
        return made.ravel()

    def gate(self, direction: int = 1) -> npt.NDArray[np.uint8]:
        """A digital signal, one entry a tick: 1 within lines of this direction (+1 trace, -1 retrace, 0 both), else 0.

        Its rising edges start a line, its falling edges end it, as image acquisition expects it.

        Examples
        --------
        >>> from truestroke import scans
        >>> scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
        >>> int(np.count_nonzero(np.diff(scan.gate().astype(int)) == 1))
        4
        """
        if direction not in (-1, 0, 1):
            raise SettingError("direction", direction, "1 (trace), -1 (retrace) or 0 (both)")
        kept = self.lines if direction == 0 else self.lines[self.lines["direction"] == direction]
        return (_lines_of(kept, len(self.x)) >= 0).astype(np.uint8)

    def save_motion(self, path: str | Path) -> Path:
        """Write the motion as text, a row a tick: time, x, y, their velocities, and the gate of trace and retrace.

        `trajectories.from_csv` reads an axis of it, and so does ``[axis.trajectory]`` of a configuration, with the
        column as ``position``.

        Raises
        ------
        FileExistsError
            A file is there that is no such motion.
        """
        x, y = self.axes
        rows = np.column_stack([self.time, x.position, y.position, x.velocity, y.velocity, self.gate(0)])
        path = checks.path("path", path)
        with files.writing(path, files.SCAN) as draft:
            np.savetxt(draft, rows, "%.10g", ",", header=files.SCAN_HEADER, comments="")
        return path

    def save_lines(self, path: str | Path) -> Path:
        """Write the table of lines as text: row, direction, start and end, s; `read_lines` of `unwarp` reads it.

        Raises
        ------
        FileExistsError
            A file is there that is no such table.
        """
        rows = (f"{line['row']},{line['direction']},{line['start']:.9f},{line['end']:.9f}" for line in self.lines)
        return files.write(checks.path("path", path), "\n".join([files.LINES_HEADER, *rows, ""]), files.LINES)


def _lines_of(lines: npt.NDArray[np.void], ticks: int) -> npt.NDArray[np.int32]:
    """Number of the line that each tick is in, of lines in the order of time; -1 outside of lines."""
    made = np.full(ticks, -1, np.int32)
    for number, (first, last) in enumerate(zip(lines["first"].tolist(), lines["last"].tolist(), strict=True)):
        made[first : last + 1] = number
    return made


def table(
    start: FloatArray, end: FloatArray, row: npt.ArrayLike, direction: npt.ArrayLike, rate: float
) -> npt.NDArray[np.void]:
    """Lines from the times, s, at which they start and end."""
    made = np.zeros(start.size, LINE)
    made["start"], made["end"], made["row"], made["direction"] = start, end, row, direction
    made["first"] = np.ceil(start * rate - 1e-6)
    made["last"] = np.ceil(end * rate - 1e-6) - 1
    return made
