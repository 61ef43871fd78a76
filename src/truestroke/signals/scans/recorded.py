"""A scan that hardware has made: images of its signal, and what is distorted in them as far as the sensors see it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.signals import metrics
from truestroke.signals.noise import noise
from truestroke.signals.scans import rates
from truestroke.signals.scans.images import (
    Distortion,
    Image,
    ImageError,
    at_pixels,
    both_show,
    distortion,
    gridded,
    images,
    levelled,
    shift,
)
from truestroke.signals.scans.scan import Scan

SEEN, CLEAR = 0.5, 2.0  # pixels: what a good image may be off, and a doubtful one
FEWEST = 8  # rows and columns of images whose shift means something
ALIKE = 0.5  # correlation of two images of the same thing


@dataclass(frozen=True, eq=False, kw_only=True)
class Recorded:
    """Images of a scan, and how far the sensors say that its pixels are from their places.

    Attributes
    ----------
    scan : Scan
        The part of it that was recorded, of whole rows.
    rows : tuple[int, int]
        Rows, or turns, that were recorded, and that were asked for.
    images : Mapping[str, Image]
        "trace" and "retrace" of a raster, "image" of any other scan.
    error : ndarray, shape (ticks, 2)
        Measured minus desired position within the lines, um, NaN outside.
    noise : tuple[float, float]
        Of a sample of the sensors of x and y, um rms.
    distortion : Distortion or None
        Of a raster, by the measured positions.
    shift : tuple[float, float] or None
        Of the retrace against the trace, in x and y, pixels, by the images alone, less the half row by which y moves on
        between them with ``slow="ramp"``; None where they do not show it.
    verdict : Verdict
        Of the image.
    axes : tuple[str, str]
        Names of the fast and the slow axis.
    """

    scan: Scan
    rows: tuple[int, int]
    images: Mapping[str, Image] = field(repr=False)
    error: FloatArray = field(repr=False)
    noise: tuple[float, float]
    distortion: Distortion | None
    shift: tuple[float, float] | None
    verdict: Verdict
    axes: tuple[str, str] = ("x", "y")

    def rms_um(self) -> tuple[float, float]:
        """Root mean square of the errors of x and y, um, without the noise of the sensors."""
        return _rms(self.error, self.noise)

    @property
    def noise_apart(self) -> float:
        """Distance of trace and retrace, pixels, that the noise of the sensors alone may make."""
        return _noise_apart(self.distortion, self.noise)

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        x, y = self.rms_um()
        made: dict[str, object] = {"rows": self.rows[0], "all_rows": self.rows[1], "x_rms_um": x, "y_rms_um": y}
        if self.distortion is not None:
            made |= {"distortion_rms_pixels": self.distortion.rms, "shift_pixels": self.shift}
            made |= {"trace_retrace_pixels": self.distortion.trace_retrace, "noise_apart_pixels": self.noise_apart}
        return made


def recorded(
    scan: Scan,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    signal: npt.ArrayLike,
    *,
    columns: int = 512,
    name: str = "signal",
    unit: str = "",
    resonances: Mapping[str, float] | None = None,
    axes: tuple[str, str] = ("x", "y"),
) -> Recorded:
    """Images of a scan from what was recorded in each of its ticks, from the first one on.

    Parameters
    ----------
    scan : Scan
        What was asked for.
    x, y : array_like, shape (ticks,)
        Measured positions, um, NaN where there is none; fewer than the scan has where it was cut short.
    signal : array_like, shape (ticks,)
        What becomes the image.
    columns : int
        Pixels of a row; those of a scan that is no raster are square.
    name, unit : str
        Of the signal.
    resonances : Mapping[str, float], optional
        First resonance of axes, Hz, by their names: where a harmonic of the lines meets one, and what the sensors show
        there is why an image is not good, the verdict names a rate of which none does.
    axes : tuple[str, str]
        What the page calls the fast and the slow axis.

    Returns
    -------
    Recorded
        A raster by its times, any other scan by its measured positions.

    Raises
    ------
    ImageError
        The arrays differ in length, are longer than the scan, end before its first row, or a line has no sample.

    Examples
    --------
    >>> from truestroke import scans
    >>> scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
    >>> height = np.sin(scan.x.position)
    >>> found = recorded(scan, scan.x.position, scan.y.position, height, columns=64)
    >>> found.rows, found.images["trace"].data.shape, found.verdict.level
    ((4, 4), (4, 64), 'good')
    >>> recorded(scan, scan.x.position[:5600], scan.y.position[:5600], height[:5600], columns=64).verdict.reasons
    ('The scan ended after row 2 of 4.',)
    """
    given = {"x": (x, "um"), "y": (y, "um"), "signal": (signal, unit)}
    arrays = [checks.signal(argument, one, of) for argument, (one, of) in given.items()]
    part, rows = _as_far(scan, arrays)
    values, places = arrays[2], np.stack(arrays[:2], axis=1)
    made, apart = _images(part, places, values, columns, name, unit)
    found = _Measured.of(part, places, columns)
    remedy = _remedy(part, places, columns, found, next(iter(made.values())).pixel, resonances or {})
    return Recorded(
        scan=part,
        rows=rows,
        images=made,
        error=found.error,
        noise=found.noise,
        distortion=found.distortion,
        shift=apart,
        verdict=_judged(made, rows, found, apart, remedy),
        axes=axes,
    )


def _images(
    scan: Scan, places: FloatArray, values: FloatArray, columns: int, name: str, unit: str
) -> tuple[dict[str, Image], tuple[float, float] | None]:
    """Trace and retrace of a raster, with their shift, or the image of any other scan."""
    if scan.name == "raster":
        made = images(scan, values, columns, name=name, unit=unit)
        apart = _shift(made)
        return made, apart and (apart[0], apart[1] + _moved_on(scan, columns))
    inside = scan.inside
    down = max(1, round(columns * scan.size[1] / scan.size[0]))
    where = {"origin": scan.origin, "size": scan.size, "shape": (down, columns)}
    samples = (*places[inside].T, values[inside])
    return {"image": gridded(*samples, name=name, unit=unit, **where)}, None  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Measured:
    """What the sensors say of the places: measured minus desired within the lines, um, and that in pixels.

    And the noise of a tick of them, um rms: of all ticks, as a line may have few.
    """

    error: FloatArray
    noise: tuple[float, float]
    distortion: Distortion | None

    @classmethod
    def of(cls, scan: Scan, places: FloatArray, columns: int) -> _Measured:
        error = places - _desired(scan)
        of_x, of_y = (_noise(one, rates.ticks_of_lines(scan)) for one in error.T)
        error[~scan.inside] = np.nan
        if scan.name != "raster":
            return cls(error, (of_x, of_y), None)
        x, y = (_without_gaps(one) for one in places.T)
        return cls(error, (of_x, of_y), distortion(scan, x, y, columns))

    def off(self, pixel: tuple[float, float]) -> float:
        """Distance of a pixel from its place, pixels, rms, without noise."""
        return float(
            np.linalg.norm([one / size for one, size in zip(_rms(self.error, self.noise), pixel, strict=True)])
        )

    @property
    def apart(self) -> float:
        """Distance of trace and retrace, pixels."""
        return 0.0 if self.distortion is None else self.distortion.trace_retrace

    @property
    def noise_apart(self) -> float:
        """What the noise of the sensors alone may make of it, pixels."""
        return _noise_apart(self.distortion, self.noise)


def _desired(scan: Scan) -> FloatArray:
    return np.stack([axis.position for axis in scan.axes], axis=1)


def _remedy(
    scan: Scan,
    places: FloatArray,
    columns: int,
    found: _Measured,
    pixel: tuple[float, float],
    resonances: Mapping[str, float],
) -> str:
    """Another rate, where what harmonics do at a resonance is why the image is not good."""
    words = rates.advice(scan, resonances)
    seen, allowed = (found.off(pixel), found.apart), (SEEN, SEEN + found.noise_apart)
    if not words or all(one <= goal for one, goal in zip(seen, allowed, strict=True)):
        return ""
    whole = np.stack([_without_gaps(one) for one in places.T], axis=1)
    less = _Measured.of(scan, places - rates.at_resonances(scan, whole - _desired(scan), resonances), columns)
    left = less.off(pixel), less.apart
    return words if any(map(rates.is_why, seen, left, allowed)) else ""


def _as_far(scan: Scan, arrays: list[FloatArray]) -> tuple[Scan, tuple[int, int]]:
    """The part of a scan that was recorded, and its rows of all; the arrays are as long as it."""
    sizes = {one.size for one in arrays}
    ticks, whole = min(sizes), len(scan.x)
    if len(sizes) > 1 or ticks > whole or any(one.ndim != 1 for one in arrays):
        raise ImageError(
            f"the recording has {', '.join(str(one.size) for one in arrays)} ticks of x, y and the signal, the scan "
            f"{whole} at {scan.sample_rate:g} Hz: it is of another scan"
        )
    every = int(scan.lines["row"].max()) + 1
    if ticks == whole:
        return scan, (every, every)
    first = int(scan.lines["last"][scan.lines["row"] == 0].max()) + 1
    if ticks < first:
        raise ImageError(f"the recording ends after {ticks} ticks, before the first row is complete, at tick {first}")
    part = scan.until(ticks)
    return part, (int(part.lines["row"].max()) + 1, every)


def _without_gaps(place: FloatArray) -> FloatArray:
    """Samples that were lost, between those that came."""
    known = np.isfinite(place)
    if not known.any():
        raise ImageError("no position was measured")
    return place if known.all() else np.interp(np.arange(place.size), np.flatnonzero(known), place[known])


def _noise(error: FloatArray, period: int) -> float:
    """Of a sample of a sensor, um rms, by neighbouring samples, or by those of neighbouring lines, if it is less then.

    What the motion makes of neighbouring samples in fast lines is the same in the next one. `period` is that of the
    lines, ticks; 0 is none.
    """
    found = [_of_neighbours(error)]
    if 0 < period < error.size // 2:
        found.append(_of_neighbours(error[period:] - error[:-period]) / math.sqrt(2))
    return min(found)


def _of_neighbours(error: FloatArray) -> float:
    """By the pieces without gaps; where all are short, by what came."""
    if not np.isfinite(error).any():
        return 0.0
    pieces = np.ma.clump_unmasked(np.ma.masked_invalid(error))  # type: ignore[no-untyped-call]
    return noise(_without_gaps(error), pieces) or metrics.noise(error)


def _shift(made: Mapping[str, Image]) -> tuple[float, float] | None:
    """By the images alone, where they are large enough and show the same thing: noise has a shift, too."""
    trace, retrace = made["trace"], made["retrace"]
    if min(trace.data.shape) < FEWEST:
        return None
    try:
        apart = shift(trace, retrace)
    except ImageError:
        return None
    right, up = (round(one) for one in apart)
    first, second = levelled(*both_show(trace.data, retrace.data, (-up, -right)))
    if min(first.shape) < FEWEST or np.ptp(first) == 0 or np.ptp(second) == 0:
        return None
    return apart if np.corrcoef(first.ravel(), second.ravel())[0, 1] > ALIKE else None


def _moved_on(scan: Scan, columns: int) -> float:
    """Rows by which y moves on between trace and retrace, as it should, in the mean."""
    y, direction = at_pixels(scan, scan.y.position, columns), scan.lines["direction"]
    row = scan.size[1] / (int(scan.lines["row"].max()) + 1)
    return float(np.mean(y[direction < 0]) - np.mean(y[direction > 0])) / row


def _rms(error: FloatArray, noise: tuple[float, float]) -> tuple[float, float]:
    squares = [np.nanmean(one**2) - of_sensor**2 for one, of_sensor in zip(error.T, noise, strict=True)]
    return float(np.sqrt(max(squares[0], 0.0))), float(np.sqrt(max(squares[1], 0.0)))


def _noise_apart(moved: Distortion | None, noise: tuple[float, float]) -> float:
    return 0.0 if moved is None else moved.apart_by_noise(noise)


def _judged(
    made: Mapping[str, Image],
    rows: tuple[int, int],
    found: _Measured,
    apart: tuple[float, float] | None,
    remedy: str,
) -> Verdict:
    """Errors in pixels of the image, with a remedy; what the noise of the sensors makes of them counts for nothing."""
    pixel = next(iter(made.values())).pixel
    off = found.off(pixel)
    findings: list[tuple[Level, str]] = []
    if rows[0] < rows[1]:
        findings.append(("doubtful", f"The scan ended after row {rows[0]} of {rows[1]}."))
    if all(np.ptp(one.data[np.isfinite(one.data)]) == 0 for one in made.values()):
        findings.append(("doubtful", "The signal is the same in all pixels: is it the input of this image?"))
    measured = [("By the sensors, a pixel is {:.2g} pixels from its place, rms.", off, 0.0)]
    if found.distortion is not None:
        words = "By the sensors, trace and retrace are up to {:.2g} pixels apart."
        measured.append((words, found.apart, found.noise_apart))
    if apart is not None:
        measured.append(("In the images, trace and retrace are {:.2g} pixels apart.", float(np.hypot(*apart)), 0.0))
    far = [one for one in measured if one[1] > SEEN + one[2]]
    for words, pixels, allowed in far:
        findings.append(("bad" if pixels > CLEAR + allowed else "doubtful", words.format(pixels)))
    if not far and any(noise > size for noise, size in zip(found.noise, pixel, strict=True)):
        small, loud = (" x ".join(figures(1000 * one) for one in both) for both in (pixel, found.noise))
        words = (
            f"A pixel of {small} nm is smaller than the noise of the sensors, {loud} nm rms: they do not show whether "
        )
        words += "it is in its place. Scan a larger area or fewer pixels, or average in the sensor."
        findings.append(("doubtful", words))
    findings += [("doubtful", remedy)] * bool(remedy)
    return Verdict.of(findings)
