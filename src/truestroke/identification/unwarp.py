"""An image that was scanned without sensor and compensation, corrected by a model and the voltage that was recorded.

The model gives the place of each pixel, from the voltage alone: `ActuatorModel.predict` at the times of the pixels.
Along each line, then across the lines, the signal is interpolated at even places, the same for trace and retrace.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control.actuator import ActuatorModel
from truestroke.control.reach import inherited
from truestroke.identification import unwarp_evidence as evidence
from truestroke.identification.unwarp_evidence import FAR, filled
from truestroke.identification.unwarp_voltage import quieted, without_hum
from truestroke.signals.columns import Wanted, even_rate, read_columns, refuse_bad_rows
from truestroke.signals.scans.images import Image, ImageError, shift
from truestroke.signals.scans.scan import LINE, Scan, table
from truestroke.signals.tables import UNITS, RecordError, open_table

Area = tuple[tuple[float, float], tuple[float, float]]  # um: lowest and highest x, and y
DIRECTIONS = {"trace": 1, "retrace": -1}
FORWARD = {"trace", "forward", "fwd"}  # in the names of images: of microscopes, too
BACKWARD = {"retrace", "backward", "bwd", "reverse"}
OPPOSITE = {"start": "end", "end": "start"}
APART = 0.3  # pixels between trace and retrace after it: beyond, and beyond `FAR`, they are doubtful, bad
OTHER_SIZE = 3.0  # times: an image that is so much larger or smaller than the voltage says is of another scan
BACK = 1.0  # pixels: a line that goes back further is none
ODD = 0.05  # of a line: one that lasts so much longer or shorter than the others has lost its trigger
LOOSE = 0.1  # of half a sample: by which noise may move an edge further
OTHER_UNIT = 10.0  # times the length of the recording: lines that last longer have another unit
SURE, HALF = 0.95, 0.5  # of the places; pixels by which noise of the voltage may leave them open
LEAST_HUM = 1e-4  # of the range of a voltage, rms: less moves no pixel by half of one
SKIPPED = 1.5  # periods from one line to the next: beyond, one between them is missing
HEADINGS = {"x": ("volts x", "volts_x", "x", "volts", "u"), "y": ("volts y", "volts_y", "y")}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ScanRecord(Displayed):
    """The voltages of a scan, and when its lines were.

    Attributes
    ----------
    x, y : ndarray, shape (samples,)
        Voltage of each axis, V, from rest; y is empty where it is not known.
    sample_rate : float
        Hz.
    lines : ndarray of `scans.LINE`
        As of `Scan.lines`, or from a trigger.
    jitter : float
        By how much their times may be wrong, s: half a sample of a trigger, 0 of a table.

    Raises
    ------
    SettingError
        The arrays differ in length, or there is no line.
    """

    x: FloatArray
    sample_rate: float
    lines: npt.NDArray[np.void]
    y: FloatArray = dataclasses.field(default_factory=lambda: np.empty(0))
    jitter: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, checks.finite_array(name, getattr(self, name), "V"))
        checks.positive("sample_rate", self.sample_rate, "Hz")
        if self.y.size and self.y.size != self.x.size:
            raise SettingError("y", f"{self.y.size} samples", f"{self.x.size}, as many as of x")
        if not self.lines.size:
            raise SettingError("lines", "none", "at least one line: a trigger that is 1 within the lines")

    @classmethod
    def of(cls, scan: Scan, x: npt.ArrayLike, y: npt.ArrayLike = ()) -> ScanRecord:
        """The voltages that a scan was made with: its lines are known exactly."""
        made = cls(x=np.asarray(x, float), y=np.asarray(y, float), sample_rate=scan.sample_rate, lines=scan.lines)
        if made.x.size != len(scan.x):
            raise ImageError(f"the voltage has {made.x.size} samples, the scan {len(scan.x)} ticks: must be as many")
        return made

    @property
    def time(self) -> FloatArray:
        """Of the samples, s."""
        return np.arange(self.x.size) / self.sample_rate

    @property
    def inside(self) -> npt.NDArray[np.bool_]:
        """Whether each sample is within the lines, of the first to the last one."""
        begin, end = self.lines["start"].min(), self.lines["end"].max()
        return np.asarray((self.time >= begin) & (self.time <= end))

    def _display(self) -> tuple[str, Rows]:
        rows = [("sample_rate", quantity(self.sample_rate, "Hz")), ("lines", quantity(self.lines.size))]
        return f"Voltages of a scan, {self.x.size / self.sample_rate:g} s", rows


def triggered(trigger: npt.ArrayLike, sample_rate: float, direction: int = 1) -> npt.NDArray[np.void]:
    """Lines by a trigger signal that is high within them; lines of even period are placed to a part of a sample.

    A trigger is high from the first sample at or behind the start of a line to the last one before its end: each edge
    is half a sample late in the mean. Where the edges are even, a straight line through all of them is what counts.

    Raises
    ------
    ImageError
        The trigger never changes, or has no whole line.

    Examples
    --------
    >>> gate = np.tile([0, 0, 1, 1, 1, 0], 4)
    >>> lines = triggered(gate, 10.0)
    >>> len(lines), lines["first"][:2].tolist(), lines["start"][:2].round(3).tolist()
    (4, [2, 8], [0.15, 0.75])
    """
    level = checks.finite_array("trigger", trigger)
    if np.ptp(level) == 0:
        raise ImageError("the trigger never changes: it is missing, or is the column of another signal")
    high = level > (level.min() + level.max()) / 2
    change = np.diff(high.astype(np.int8))
    starts, ends = np.flatnonzero(change == 1) + 1, np.flatnonzero(change == -1) + 1
    ends = ends[ends > starts[0]] if starts.size else ends
    count = min(starts.size, ends.size)
    if not count:
        raise ImageError("the trigger has no whole line: no rising and falling edge")
    made = [_even(edges[:count]) / sample_rate for edges in (starts, ends)]
    lines = table(made[0], made[1], np.arange(count), np.full(count, direction), sample_rate)
    lines["first"], lines["last"] = starts[:count], ends[:count] - 1
    return lines


def _even(edges: npt.NDArray[np.intp]) -> FloatArray:
    """Times of edges, in samples; on a straight line where all but a few are within a sample of it."""
    times = np.asarray(edges - 0.5, dtype=np.float64)
    odd = np.abs(evidence.uneven(times)) > 1.0
    if edges.size <= 2 or np.mean(odd) > evidence.FEW:
        return times
    number = np.arange(edges.size)
    straight = np.polyval(np.polyfit(number[~odd], times[~odd], 1), number)
    odd = np.abs(straight - times) > 1.0
    return np.where(odd, times, straight) if np.mean(odd) <= evidence.FEW else times


def mirrored(
    trace: npt.NDArray[np.void], retrace: npt.NDArray[np.void], volts: FloatArray, sample_rate: float
) -> tuple[npt.NDArray[np.void], npt.NDArray[np.void]]:
    """Lines of triggers, each retrace with the voltages of its trace on its way back.

    A trigger leaves half a sample open at each edge. Where the voltage of a scan goes and comes back by the same way,
    each edge is moved by half of what its two voltages differ, in the mean of all rows: then trace and retrace are
    wrong by the same. Nothing moves where half a sample is not enough: the voltage of such a scan comes back by another
    way.

    Examples
    --------
    The trigger of the retrace is a sample late at its start:

    >>> volts, tick = 5.0 - np.abs(np.arange(101) % 20 - 10.0), np.arange(101) % 20
    >>> trace, retrace = triggered((tick > 1) & (tick < 8), 10.0), triggered((tick > 13) & (tick < 19), 10.0, -1)
    >>> trace, retrace = mirrored(trace, retrace, volts, 10.0)
    >>> (10.0 * retrace["start"][:2]).round(3).tolist(), (10.0 * trace["end"][:2]).round(3).tolist()
    ([13.0, 33.0], [7.0, 27.0])
    """
    trace, retrace = trace.copy(), retrace.copy()
    if trace.size != retrace.size or not trace.size:
        return trace, retrace
    time, half = np.arange(volts.size) / sample_rate, 0.5 / sample_rate
    of_trace, of_retrace = (
        {edge: np.interp(lines[edge], time, volts) for edge in OPPOSITE} for lines in (trace, retrace)
    )
    speed = float(np.mean((of_trace["end"] - of_trace["start"]) / (trace["end"] - trace["start"])))
    apart = {edge: float(np.mean(of_trace[edge] - of_retrace[OPPOSITE[edge]])) for edge in OPPOSITE}
    if not speed or max(map(abs, apart.values())) > (1 + LOOSE) * 2 * half * abs(speed):
        return trace, retrace
    for edge, difference in apart.items():
        trace[edge] -= difference / (2 * speed)
        retrace[OPPOSITE[edge]] -= difference / (2 * speed)
    return trace, retrace


def read_scan_record(
    path: str | Path,
    *,
    x: str | int | None = None,
    y: str | int | None = None,
    trigger: str | int | None = None,
    retrace_trigger: str | int | None = None,
    time: str | int | None = None,
    sample_rate: float | None = None,
    lines: npt.NDArray[np.void] | None = None,
) -> ScanRecord:
    """The voltages of a scan and its trigger, from a file with columns.

    Parameters
    ----------
    path : str or Path
        Text, NPZ, MATLAB, Parquet, HDF5, as `read_record` reads them.
    x, y : str or int, optional
        Columns of the voltages, by name or counted from 1; by default "volts x" and "volts y", or "x" and "y". y may be
        missing.
    trigger, retrace_trigger : str or int, optional
        Columns that are high within the lines of the trace and of the retrace; by default "trigger" and "retrace". The
        second may be missing.
    time : str or int, optional
        Column of the times, s.
    sample_rate : float, optional
        Hz, where there is none.
    lines : ndarray of `scans.LINE`, optional
        In place of a trigger, as of `read_lines`.

    Raises
    ------
    RecordError
        A column is missing, or has entries that are no numbers.
    ImageError
        The trigger has no line.
    """
    path = checks.path("path", path)
    found = open_table(path)
    volts, none = UNITS["volts"], {"": 1.0, **UNITS["volts"]}
    wanted = [Wanted("x", volts, HEADINGS["x"], x)]
    wanted.append(Wanted("y", volts, HEADINGS["y"], y, needed=y is not None, certain=True))
    wanted.append(Wanted("trigger", none, ("trigger", "gate", "line"), trigger, needed=False, certain=True))
    wanted.append(
        Wanted("retrace", none, ("retrace",), retrace_trigger, needed=retrace_trigger is not None, certain=True)
    )
    wanted.append(
        Wanted("time", UNITS["time"], ("t", "time"), time, needed=sample_rate is None, instead="the `sample_rate`")
    )
    signals, _ = read_columns(path, found, wanted, ())
    refuse_bad_rows(str(path), signals, found)
    rate = even_rate(path, found, signals.get("time"), sample_rate)
    volts_of_y = signals.get("y", np.empty(0))
    if lines is not None:
        return ScanRecord(x=signals["x"], y=volts_of_y, sample_rate=rate, lines=lines)
    if "trigger" not in signals:
        names = ", ".join(found.names) or f"{found.width} columns without names"
        which = "no trigger of the trace beside that of the retrace" if "retrace" in signals else "no trigger"
        reason = f"there is {which}: name the column that is high within the lines (`trigger`), or give a table of \
them (`lines`); there are {names}"
        raise RecordError(str(path), reason)
    trace = triggered(signals["trigger"], rate)
    retrace = triggered(signals["retrace"], rate, -1) if "retrace" in signals else trace[:0]
    trace, retrace = mirrored(trace, retrace, signals["x"], rate)
    together = np.zeros(trace.size + retrace.size, LINE)
    together[: trace.size], together[trace.size :] = trace, retrace
    together = together[np.argsort(together["start"])]
    return ScanRecord(x=signals["x"], y=volts_of_y, sample_rate=rate, lines=together, jitter=0.5 / rate)


def read_lines(path: str | Path) -> npt.NDArray[np.void]:
    """A table of lines from a text that `save_lines` has written, or one with its columns: start, end, direction, s.

    Raises
    ------
    RecordError
        A column is missing, or a line ends before it begins.
    """
    path = checks.path("path", path)
    found = open_table(path)
    wanted = [Wanted(name, UNITS["time"], (name,), heading=f"{name} (s)") for name in ("start", "end")]
    wanted.append(Wanted("direction", {"": 1.0}, ("direction",), heading="direction"))
    signals, _ = read_columns(path, found, wanted, ())
    refuse_bad_rows(str(path), signals, found)
    back = np.flatnonzero(signals["end"] <= signals["start"])
    if back.size:
        start, end = (float(signals[name][back[0]]) for name in ("start", "end"))
        reason = f"the line ends at {end:.6g} s, and begins at {start:.6g} s: are the columns start and end swapped?"
        raise RecordError(str(path), reason, found.locate(int(back[0]))[0], found.where)
    made = np.zeros(signals["start"].size, LINE)
    made["start"], made["end"] = signals["start"], signals["end"]
    made["direction"] = np.where(signals["direction"] < 0, -1, 1)
    for direction in (1, -1):
        of = made["direction"] == direction
        made["row"][of] = np.arange(np.count_nonzero(of))
    return made


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Unwarped(Displayed):
    """What `unwarp` made.

    Attributes
    ----------
    images : Mapping[str, Image]
        "trace", "retrace", or the one that was given; pixels that no line has reached are NaN.
    before, after : tuple[float, float] or None
        Shift of the retrace against the trace in x and y, pixels, by `scans.shift`; None of a single image.
    moved : float
        Largest distance that a pixel was moved along x, pixels.
    timing : float
        By how much a pixel may be wrong along x because the trigger is known to half a sample only, pixels.
    verdict : Verdict
        Doubtful where trace and retrace are more than 0.3 pixels apart, there is no retrace, or the trigger does not
        say where they are; bad beyond 3.
    even_rows : bool
        Whether the rows were taken as even, as there was no model of y: what y does is not corrected.
    hum : str
        What was taken off the voltages, and why; empty where nothing was.
    """

    images: Mapping[str, Image]
    before: tuple[float, float] | None
    after: tuple[float, float] | None
    moved: float
    timing: float
    verdict: Verdict
    even_rows: bool = False
    hum: str = ""

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, quantity(getattr(self, name), "pixels")) for name in ("before", "after", "moved", "timing")]
        return f"Unwarped: {', '.join(self.images)}, {self.verdict.level}", rows


def unwarp(
    images: Image | Mapping[str, Image],
    record: ScanRecord,
    x: ActuatorModel,
    y: ActuatorModel | None = None,
    *,
    align: bool = False,
) -> Unwarped:
    """Correct an image by the places that a model predicts from the voltage alone.

    Parameters
    ----------
    images : Image or mapping of str to Image
        A trace, or "trace" and "retrace", as they were shown: each row with pixels of equal time, from the left to the
        right.
    record : ScanRecord
        Voltages, from rest, and lines.
    x : ActuatorModel
        Of the fast axis, such as of `truestroke.identify`, of the day before.
    y : ActuatorModel, optional
        Of the slow axis, where its voltage is in the record; by default the rows are even.
    align : bool
        Whether what still separates trace and retrace, seen in the images, is shared between both, in eight blocks of
        columns: the place of neither is better known then.

    Returns
    -------
    Unwarped

    Raises
    ------
    ImageError
        The record has not a line for each row, a line goes back, or there is nothing to align.
    SettingError
        An argument is not of its kind.
    """
    checks.instance("record", record, ScanRecord, "a ScanRecord, such as of read_scan_record(path)")
    checks.instance("x", x, ActuatorModel, "an ActuatorModel, such as of truestroke.identify(record).model")
    given = {"trace": images} if isinstance(images, Image) else dict(images)
    for name in given:
        checks.one_of("images", name, tuple(DIRECTIONS))
    if not given:
        raise SettingError("images", "none", "a trace, or a trace and a retrace")
    for name, image in given.items():
        _check_fit(image, name, record)
    if y is not None and not record.y.size:
        raise ImageError("the record has no voltage of y: name its column, or leave the model of y out")
    axes = [("x", record.x, x), *([] if y is None else [("y", record.y, y)])]
    hints = [evidence.beyond(name, volts, model.voltage_range) for name, volts, model in axes]
    try:
        places, calmed, hum = _chosen(given, record, x, y)
        unlike, times = evidence.sizes(places.seen, places.size)
        hints.append(unlike)
        made = _aligned(given, places) if align else places.corrected(given)
        before, after = (_apart(pair) for pair in (given, made))
    except ImageError as error:
        raise ImageError(". ".join(words for words in (str(error), *hints) if words)) from None
    speed = places.seen.data.shape[1] / float(record.lines["end"][0] - record.lines["start"][0])
    timing = record.jitter * speed
    findings: list[tuple[Level, str]] = [
        one for model in (x, y) if model and model.verdict.is_bad for one in inherited(model)
    ]
    begun = [evidence.begins(name, volts) for name, volts, _ in axes]
    findings += [("doubtful", words) for words in ("" if calmed else hum, *places.noisy, *begun) if words]
    for name in given:
        lines = record.lines[record.lines["direction"] == DIRECTIONS[name]]
        if words := evidence.late(lines, name, speed, record.jitter, APART):
            findings.append(("doubtful", words))
    findings += [("bad" if times > OTHER_SIZE else "doubtful", words) for words in hints if words]
    far = after is not None and float(np.hypot(*after)) > APART
    why = evidence.why_apart(given, made, places.corrected, after, speed, APART) if after and far else ""
    verdict = Verdict.of([*findings, *_findings(before, after, timing, made, why, speed)])
    return Unwarped(
        images=made,
        before=before,
        after=after,
        moved=places.moved,
        timing=timing,
        verdict=verdict,
        even_rows=y is None,
        hum=hum if calmed else "",
    )


def _chosen(
    given: Mapping[str, Image], record: ScanRecord, x: ActuatorModel, y: ActuatorModel | None
) -> tuple[_Places, bool, str]:
    """Places of the pixels, whether hum of the voltages was taken off, and a sentence of it.

    It is taken off where trace and retrace then agree better.
    """
    places = _Places.of(given, record, x, y)
    inside, first = record.inside, record.lines["direction"] == DIRECTIONS[next(iter(given))]
    hums = {}
    for name, left in zip("x" if y is None else "xy", places.open, strict=False):
        hums[name] = left.quiet - without_hum(left.quiet, record.sample_rate, record.lines["start"][first])
    if max(float(np.std(hum[inside]) / np.ptp(getattr(record, name))) for name, hum in hums.items()) < LEAST_HUM:
        return places, False, ""
    calm: dict[str, Any] = {name: getattr(record, name) - hum for name, hum in hums.items()}
    other = _Places.of(given, dataclasses.replace(record, **calm), x, y)
    pixels = places.apart(other)
    worst = max(pixels, key=lambda name: pixels[name])
    if pixels[worst] <= HALF:
        return places, False, ""
    agree = [_agreement(given, one) for one in (places, other)]
    taken, words = evidence.hum(worst, hums[worst][inside], record.sample_rate, pixels[worst], *agree)
    return (other if taken else places), taken, words


def _agreement(given: Mapping[str, Image], places: _Places) -> float:
    """Of trace and retrace at these places: 1 where they are the same, or there is one; -1 where lines go back."""
    try:
        return evidence.agreement(places.corrected(given)) if len(given) == 2 else 1.0
    except ImageError:
        return -1.0


@dataclass(frozen=True)
class _Open:
    """Deviation of the noise of a voltage, V, how far 95 % of places may be off for it, um; what is quiet, V."""

    volts: float
    um: float
    quiet: FloatArray


@dataclass(frozen=True, eq=False)
class _Places:
    """Where the pixels of each image are by the voltage, um, and the area that all lines have.

    Attributes
    ----------
    seen : Image
        The first of them.
    across, along : Mapping[str, ndarray], shape (rows, columns)
        x and y of each pixel, um; y is empty where its rows are even.
    area : tuple
        Lowest and highest x, and y, um.
    open : tuple of _Open
        Uncertainty by noise of the voltages of x and y.
    """

    seen: Image
    across: Mapping[str, FloatArray]
    along: Mapping[str, FloatArray]
    area: Area
    open: tuple[_Open, _Open]

    @classmethod
    def of(cls, given: Mapping[str, Image], record: ScanRecord, x: ActuatorModel, y: ActuatorModel | None) -> _Places:
        across, open_x = _places(given, record, x, record.x)
        along, open_y = ({}, _Open(0.0, 0.0, record.y)) if y is None else _places(given, record, y, record.y)
        seen = next(iter(given.values()))
        return cls(seen, across, along, (_common(across), _rows_area(seen, along)), (open_x, open_y))

    @property
    def noisy(self) -> list[str]:
        """A sentence for each axis whose places noise of the voltage makes uncertain by more than half a pixel."""
        pixels = zip("xy", self.open, self.size, reversed(self.seen.data.shape), strict=True)
        return [
            f"The voltage of {name} has {1000 * left.volts:.2g} mV of noise, which leaves places open by "
            f"{left.um * count / size:.2g} pixels: take the command, or a monitor with less noise or finer steps."
            for name, left, size, count in pixels
            if left.um * count / size > HALF
        ]

    def apart(self, other: _Places) -> dict[str, float]:
        """By how many pixels in x and y places of another voltage are elsewhere: 95 % of them by no more."""
        made = {}
        pairs = (self.across, other.across), (self.along, other.along)
        for axis, (mine, its), size, count in zip("xy", pairs, self.size, reversed(self.seen.data.shape), strict=True):
            off = np.concatenate([(its[name] - one).ravel() for name, one in mine.items()]) if mine else np.zeros(1)
            made[axis] = float(np.quantile(np.abs(off - np.median(off)), SURE)) * count / size
        return made

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, um."""
        (left, right), (low, high) = self.area
        return right - left, high - low

    @property
    def moved(self) -> float:
        """Largest distance of a pixel from where it is shown, pixels."""
        columns = self.seen.data.shape[1]
        pixel: float = self.size[0] / columns
        even = self.area[0][0] + (np.arange(columns) + 0.5) * pixel
        return max(float(np.abs(one - even).max()) for one in self.across.values()) / pixel

    def corrected(self, images: Mapping[str, Image]) -> dict[str, Image]:
        """At even places."""
        return {
            name: _resampled(image, self.across[name], self.along.get(name), self.area)
            for name, image in images.items()
        }


def _common(across: Mapping[str, FloatArray]) -> tuple[float, float]:
    """Lowest and highest x, um, of the part that all lines have."""
    if why := evidence.no_lines(across):
        raise ImageError(why)
    low = max(float(one.min(axis=1).max()) for one in across.values())
    high = min(float(one.max(axis=1).min()) for one in across.values())
    if not low < high:
        raise ImageError(
            f"the lines have no part in common: by its voltage x begins one at {low:.4g} um, and ends another at "
            f"{high:.4g} um: they are the lines of another scan, or their times are not those of the recording's "
            "sample rate"
        )
    return low, high


def _check_fit(image: Image, name: str, record: ScanRecord) -> None:
    """The record has a line for each row, and goes on to the end of the last one."""
    lines = record.lines[record.lines["direction"] == DIRECTIONS[name]]
    if lines.size != (rows := image.data.shape[0]):
        why = evidence.other_count(lines, image.data.shape, SKIPPED)
        raise ImageError(f"the {name} has {rows} rows, the recording {lines.size} lines of it: {why}")
    end, last = record.x.size / record.sample_rate, float(lines["end"].max())
    if last > end + 1 / record.sample_rate:
        unit = ", or the times of the lines are in another unit" if last > OTHER_UNIT * end else ""
        raise ImageError(f"the recording ends at {end:.4g} s, the last line at {last:.4g} s: it was cut short{unit}")

    lasts = lines["end"] - lines["start"]
    usual = float(np.median(lasts))
    odd = np.flatnonzero(np.abs(lasts - usual) > max(ODD * usual, 4 * record.jitter))
    if odd.size:
        number, period = int(odd[0]), float(lasts[odd[0]])
        raise ImageError(
            f"line {number} of the {name} lasts {period:.4g} s, the others {usual:.4g} s: its trigger is damaged"
        )


def _places(
    images: Mapping[str, Image], record: ScanRecord, model: ActuatorModel, volts: FloatArray
) -> tuple[dict[str, FloatArray], _Open]:
    """Predicted place of each pixel of each image, um, shape (rows, columns); and their uncertainty by its noise.

    That is seen where the voltage has noise once more.
    """
    low, high = model.voltage_range
    first = record.lines[record.lines["direction"] == DIRECTIONS[next(iter(images))]]
    about = record.sample_rate, high - low, first["start"]
    volts, deviation = quieted(volts, *about)
    places = _predicted(images, record, model, volts)
    if not deviation:
        return places, _Open(0.0, 0.0, volts)
    again = volts + deviation * np.random.default_rng(0).standard_normal(volts.size)
    others = _predicted(images, record, model, quieted(again, *about)[0])
    apart = np.concatenate([(others[name] - one).ravel() for name, one in places.items()])
    return places, _Open(deviation, float(np.quantile(np.abs(apart - np.median(apart)), SURE)), volts)


def _predicted(
    images: Mapping[str, Image], record: ScanRecord, model: ActuatorModel, volts: FloatArray
) -> dict[str, FloatArray]:
    """Place of each pixel by this voltage, um."""
    from scipy.interpolate import CubicSpline

    predicted, made = CubicSpline(record.time, model.predict(volts, record.sample_rate, measured=False)), {}
    for name, image in images.items():
        lines = record.lines[record.lines["direction"] == DIRECTIONS[name]]
        columns = image.data.shape[1]
        part = (np.arange(columns) + 0.5) / columns
        part = part if DIRECTIONS[name] > 0 else 1 - part
        made[name] = np.asarray(predicted(lines["start"][:, None] + part * (lines["end"] - lines["start"])[:, None]))
    return made


def _rows_area(image: Image, along: Mapping[str, FloatArray]) -> tuple[float, float]:
    """Lowest and highest y of the image: edges of its first and last row."""
    if not along:
        return image.origin[1], image.origin[1] + image.size[1]
    middle = np.mean([one.mean(axis=1) for one in along.values()], axis=0)
    half = (middle[-1] - middle[0]) / (middle.size - 1) / 2 if middle.size > 1 else image.size[1] / 2
    if not half > 0:
        raise ImageError("y does not rise from row to row: the slow axis did not move, or downwards; flip the image")
    return float(middle[0] - half), float(middle[-1] + half)


def _resampled(image: Image, x: FloatArray, y: FloatArray | None, area: Area) -> Image:
    """The signal at even places: along each line, then across the lines."""
    (left, right), (low, high) = area
    rows, columns = image.data.shape
    pixel = (right - left) / columns
    even = left + (np.arange(columns) + 0.5) * pixel
    data, height = np.empty_like(image.data), np.empty_like(image.data)
    for i in range(rows):
        if (back := float(np.max(x[i, :-1] - x[i, 1:]))) > BACK * pixel:
            raise ImageError(
                f"row {i} goes back by {back:.3g} um: its line is not where the trigger says, the direction is wrong, "
                "or the voltage is noisy: take the command in place of a monitor"
            )
        order = np.maximum.accumulate(x[i])
        data[i] = _between(even, order, image.data[i])
        height[i] = np.interp(even, order, y[i]) if y is not None else 0.0
    if y is not None and rows > 1:  # a single line is where it is
        level = low + (np.arange(rows) + 0.5) * (high - low) / rows
        for j in range(columns):
            data[:, j] = _between(level, np.maximum.accumulate(height[:, j]), data[:, j])
    size = (right - left, high - low)
    return Image(data=data, size=size, origin=(left, low), name=image.name, unit=image.unit)


def _between(places: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Cubic interpolation without overshoot; beyond the ends, by up to a pixel, the last value, then NaN."""
    from scipy.interpolate import PchipInterpolator

    _, kept = np.unique(known, return_index=True)
    kept = kept[np.isfinite(values[kept])]
    if kept.size < 2:
        return np.full(places.size, np.nan)
    known, values = known[kept], values[kept]
    step = places[1] - places[0] if places.size > 1 else np.inf
    inside = np.clip(places, known[0], known[-1])
    made = np.asarray(PchipInterpolator(known, values)(inside))
    return np.where(np.abs(inside - places) <= step, made, np.nan)


def _aligned(given: Mapping[str, Image], places: _Places) -> dict[str, Image]:
    """With half of what separates trace and retrace in each block of columns added to the places of both."""
    made = places.corrected(given)
    if len(made) < 2:
        raise ImageError("there is only one image: `align` needs trace and retrace")
    centres, apart = evidence.in_blocks(made["trace"], made["retrace"])
    left, pixel = places.area[0][0], places.size[0] / places.seen.data.shape[1]
    across = {}
    for name, x in places.across.items():
        by = 0.5 * DIRECTIONS[name] * pixel * np.interp((x - left) / pixel, centres, apart)
        across[name] = x + by
    return dataclasses.replace(places, across=across).corrected(given)


def _apart(images: Mapping[str, Image]) -> tuple[float, float] | None:
    """Of trace and retrace, pixels; None where one of them is missing or shows nothing."""
    if len(images) < 2 or _same_everywhere(images):
        return None
    return shift(*(filled(images[name]) for name in DIRECTIONS))


def _same_everywhere(images: Mapping[str, Image]) -> list[str]:
    """Names of the images in which nothing is seen."""
    return [name for name, image in images.items() if not np.ptp(filled(image).data) > 0]


def _findings(
    before: tuple[float, float] | None,
    after: tuple[float, float] | None,
    timing: float,
    images: Mapping[str, Image],
    why: str,
    speed: float,
) -> list[tuple[Level, str]]:
    findings: list[tuple[Level, str]] = []
    if len(images) > 1 and (same := _same_everywhere(images)):
        words = f"The {' and the '.join(same)} {'are' if len(same) > 1 else 'is'} the same everywhere, so nothing shows"
        findings.append(("doubtful", f"{words} whether the correction is right: look at the signal and its `channel`."))
    elif before is None or after is None:
        findings.append(("doubtful", "There is no retrace, so nothing shows whether the correction is right: give it."))
    elif (apart := float(np.hypot(*after))) > APART:
        level: Level = "bad" if apart > FAR else "doubtful"
        findings.append((level, _still(apart, after[0], abs(after[0]) > abs(before[0]), timing, why, speed)))
    if timing > APART:
        text = (
            f"The trigger places a line to half a sample, {timing:.2g} pixels: record faster, or give a table of lines."
        )
        findings.append(("doubtful", text))
    lost = max(float(np.mean(~np.isfinite(image.data))) for image in images.values())
    if lost > 0.01:
        findings.append(("doubtful", f"{100 * lost:.0f} % of the pixels were not reached by the scan."))
    return findings


def _still(apart: float, across: float, farther: bool, timing: float, why: str, speed: float) -> str:
    """Why trace and retrace are still so many pixels apart, so many `across`; `farther`: than before."""
    by_trigger = apart < 2 * timing  # half a sample of both
    if why and not by_trigger:
        return f"Trace and retrace are {apart:.2g} pixels apart: {why}."
    if farther and apart > FAR:
        return (
            f"Trace and retrace are {apart:.2g} pixels apart, further than before: an image is mirrored or turned, "
            "the two are exchanged, or the model is that of another axis."
        )
    late = f", or the voltage was recorded {evidence.delay(across, speed)}" if abs(across) > 0.9 * apart else ""
    why = f"the model is not that of this motion{late}. Identify it from a record of the scan's own lines"
    if by_trigger:
        why = "the trigger leaves as much open. Give a table of lines"
    return f"Trace and retrace are still {apart:.2g} pixels apart: {why}, or share the rest by `align`."


def by_direction(*files: Sequence[Image], channel: str | None = None) -> dict[str, Image]:
    """Images of files as trace and retrace: one of each of two files in this order, else by their names, or in order.

    Parameters
    ----------
    files : sequences of Image
        Of one signal, or of several.
    channel : str, optional
        Part of the name of the signal, where there are several; case does not count.

    Raises
    ------
    ImageError
        There are not one or two images of the channel; the message names them all.
    """
    part = (channel or "").casefold()
    parts = [[image for image in images if part in image.name.casefold()] for images in files]
    if [len(images) for images in parts] == [1, 1]:
        return dict(zip(DIRECTIONS, (image for (image,) in parts), strict=True))
    chosen = [image for images in parts for image in images]
    directions = [_direction(image.name) for image in chosen]
    if not 1 <= len(chosen) <= 2 or directions in (["trace"] * 2, ["retrace"] * 2):
        names = ", ".join(repr(image.name) for images in files for image in images)
        with_part = "" if channel is None else f" whose name contains {channel!r}"
        found = f"{len(chosen)} images{with_part} are not" if chosen else f"there is no image{with_part}; there must be"
        raise ImageError(
            f"{found} a trace, or a trace and a retrace: by `channel` take those whose names "
            f"have a part in common, of {names}"
        )
    known = {"trace", "retrace"}.issuperset(directions)
    return dict(zip(directions if known else DIRECTIONS, chosen, strict=False))


def _direction(name: str) -> str:
    """Of the line of an image, by the words that microscopes use; empty where there is none, or both."""
    words = re.findall("[a-z]+", name.casefold())
    forward, backward = not FORWARD.isdisjoint(words), not BACKWARD.isdisjoint(words)
    return "" if forward is backward else "trace" if forward else "retrace"
