"""Images of a scan: from samples to pixels, what is distorted in them, and how trace and retrace differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.signals.scans.scan import Scan

ALONG = {"raster"}  # scans whose lines are rows of an image
UPSAMPLED = 200  # parts of a pixel: resolution of the shift between two images
LEFT, SHARED = 1e-3, 0.2  # of the variance of an image, and of what is within its rows: more is no noise
AGAIN = 3  # times at most that what both images show is cut out of them
RING = 32  # frequencies in which their coherence is seen, at least
CHANCE = 2.8  # over the root of their number: coherence of noise that only 3 % of the rings exceed
UNEVEN = 2.0  # times their mean distance: that of lines where they are furthest apart
MEAN = 16  # rows over which the distance of trace and retrace is averaged
RARE = 0.05  # share of scans in which noise alone makes it larger than is said
PART = 2**14  # ticks that are interpolated at a time: some hundred bytes each
BESIDE = 48  # further ones at each end, of which the last moves a value by 1e-27 of its own
MARGIN = 2  # samples beside a line that its interpolation may use


class Sample(Protocol):
    """What is scanned: a signal at each place."""

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """The signal at these places, um."""


class ImageError(TruestrokeError, ValueError):
    """An image that cannot be made of a recording: it does not fit the scan, or has no samples."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Image(Displayed):
    """Pixels over an area.

    Attributes
    ----------
    data : ndarray, shape (rows, columns)
        The signal in the middle of each pixel; row 0 has the lowest y, column 0 the lowest x. NaN is a pixel without a
        sample.
    origin : tuple[float, float]
        Corner with the lowest x and y, um.
    size : tuple[float, float]
        Width and height, um.
    name : str
        Such as "trace".
    unit : str
        Of the signal, such as "nm" or "V".

    Raises
    ------
    SettingError
        `data` is no matrix of numbers, or the area is none.

    Examples
    --------
    >>> Image(data=np.zeros((2, 4)), size=(10.0, 5.0), name="trace", unit="nm")
    Image: trace, 4 x 2 pixels
      size    (10, 5) um
      pixel   (2.5, 2.5) um
      signal  0 to 0 nm
    """

    data: FloatArray
    size: tuple[float, float]
    origin: tuple[float, float] = (0.0, 0.0)
    name: str = "image"
    unit: str = ""

    def __post_init__(self) -> None:
        data = checks.signal("data", self.data, self.unit, 2)
        if not data.size:
            raise SettingError("data", f"array of shape {data.shape}", "at least one row and column")
        object.__setattr__(self, "data", data)
        for name, value in zip(("width", "height"), self.size, strict=True):
            checks.positive(name, value, "um")
        for name in ("name", "unit"):
            checks.instance(name, getattr(self, name), str, "a text, in quotes")

    @property
    def pixel(self) -> tuple[float, float]:
        """Width and height of a pixel, um."""
        return self.size[0] / self.data.shape[1], self.size[1] / self.data.shape[0]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top, um, as `imshow` takes it with `origin="lower"`."""
        (x, y), (width, height) = self.origin, self.size
        return x, x + width, y, y + height

    def _display(self) -> tuple[str, Rows]:
        rows, columns = self.data.shape
        known = self.data[np.isfinite(self.data)]
        span = f"{known.min():.4g} to {known.max():.4g} {self.unit}".rstrip() if known.size else "-"
        pixel = tuple(float(f"{one:.4g}") for one in self.pixel)
        lines = [("size", quantity(self.size, "um")), ("pixel", quantity(pixel, "um")), ("signal", span)]
        return f"Image: {self.name}, {columns} x {rows} pixels", lines


# ---- From ticks to pixels ------------------------------------------------------------------------------------------


def at_pixels(scan: Scan, signal: npt.ArrayLike, columns: int) -> FloatArray:
    """A signal of each tick in the middle of each pixel of each line, by cubic interpolation, shape (lines, columns).

    Raises
    ------
    ImageError
        The signal has not one entry a tick, or no number in one.
    """
    from scipy import ndimage  # scipy.interpolate takes longer to import than all lines to interpolate

    values = checks.signal("signal", signal)
    _check_fit(scan, "signal", values)
    _check_whole(scan, "signal", values)
    places = scan.pixels(columns) * scan.sample_rate + BESIDE
    made = np.empty(places.shape)
    for lines in np.array_split(np.arange(len(places)), max(1, min(len(places), values.size // PART))):
        first, last = int(scan.lines["first"][lines].min()), int(scan.lines["last"][lines].max())
        near = _beside(values, first - BESIDE, last + 1 + BESIDE)
        ndimage.map_coordinates(near, [places[lines] - first], made[lines[0] : lines[-1] + 1], order=3, mode="mirror")
    return made


def _beside(values: FloatArray, start: int, stop: int) -> FloatArray:
    """A part of a signal, which goes on beyond its ends as if it were turned about them."""
    beyond = max(-start, 0), max(stop - values.size, 0)
    part = values[max(start, 0) : stop]
    return np.pad(part, beyond, "reflect", reflect_type="odd") if any(beyond) else part


def pixels_of(scan: Scan, columns: int) -> int:
    """Pixels of a row that the samples of a scan can fill, at most `columns`.

    Of a raster the samples of its shortest line: more pixels would be interpolated. Of any other scan as many as leave
    no gaps, square: two for the distance of neighbouring samples or of neighbouring lines, whichever is larger.

    Examples
    --------
    >>> from truestroke import scans
    >>> pixels_of(scans.raster(lines=4, rate=40.0, sample_rate=10_000.0), 512)
    100
    >>> pixels_of(scans.spiral(diameter=6.0, turns=40, rotation=20.0, sample_rate=2000.0), 512)
    62
    """
    if scan.name in ALONG:
        return int(min(columns, np.min(scan.lines["last"] - scan.lines["first"] + 1)))
    shown = scan.inside.copy()  # a cycloid passes beyond its image
    for axis, low, size in zip(scan.axes, scan.origin, scan.size, strict=True):
        shown &= (axis.position >= low) & (axis.position <= low + size)
    steps = np.hypot(*(np.diff(axis.position) for axis in scan.axes))[shown[1:]]
    between = UNEVEN * scan.size[0] * scan.size[1] / steps.sum()  # lines: area over length
    return int(np.clip(2 * scan.size[0] / max(between, np.percentile(steps, 95.0)), 1, columns))


def images(
    scan: Scan, signal: npt.ArrayLike, columns: int = 512, *, name: str = "signal", unit: str = ""
) -> dict[str, Image]:
    """Trace and retrace of a raster, each pixel where its time says that it is.

    Parameters
    ----------
    scan : Scan
        A raster.
    signal : array_like, shape (ticks,) or (lines, columns)
        One sample a tick, as of a recording; or the samples of the pixels, as of an acquisition that `scan.triggers`
        has triggered, each line from the left to the right.
    columns : int
        Pixels of a row, of a signal of ticks.
    name, unit : str
        Of the signal.

    Returns
    -------
    dict of str to Image
        "trace" and "retrace".

    Raises
    ------
    ImageError
        The signal does not fit the scan, or has no number in a line.
    SettingError
        The scan is no raster: use `gridded`.
    """
    if scan.name not in ALONG:
        raise SettingError("scan", f"a {scan.name}", "a raster, whose lines are rows; make an image by `gridded`")
    values = checks.signal("signal", signal, unit, (1, 2))
    if values.ndim == 1:
        _check_fit(scan, "signal", values)
        values = _interpolated(scan, values, columns)
    if values.ndim != 2 or values.shape[0] != scan.lines.size:
        raise ImageError(
            f"the signal has the shape {values.shape}: must be one sample a tick, {len(scan.x)}, or one row for "
            f"each of {scan.lines.size} lines, trace and retrace"
        )
    if missing := np.flatnonzero(~np.isfinite(values).any(axis=1)).tolist():
        raise ImageError(
            f"line {missing[0]} of {scan.lines.size} has no sample: its trigger is missing, or the recording ended "
            "before it; scan it again, or leave these rows out"
        )
    made = {}
    for direction, word in ((1, "trace"), (-1, "retrace")):
        lines = scan.lines["direction"] == direction
        data = np.full((int(scan.lines["row"].max()) + 1, values.shape[1]), np.nan)
        data[scan.lines["row"][lines]] = values[lines]
        about = f"{name}, {word}" if name else word
        made[word] = Image(data=data, size=scan.size, origin=scan.origin, name=about, unit=unit)
    return made


def _interpolated(scan: Scan, values: FloatArray, columns: int) -> FloatArray:
    """Linear between the samples that are numbers; NaN in a line that has fewer than two."""
    times, made = scan.pixels(columns), np.full((scan.lines.size, columns), np.nan)
    time = scan.time
    for i, line in enumerate(scan.lines):
        part = slice(max(int(line["first"]) - MARGIN, 0), int(line["last"]) + 1 + MARGIN)
        known = np.isfinite(values[part])
        if np.count_nonzero(known) > 1:
            made[i] = np.interp(times[i], time[part][known], values[part][known])
    return made


def gridded(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    signal: npt.ArrayLike,
    *,
    origin: tuple[float, float],
    size: tuple[float, float],
    shape: tuple[int, int] = (512, 512),
    name: str = "signal",
    unit: str = "",
) -> Image:
    """Samples at any places as an image: of a spiral, a Lissajous curve, or any scan by its measured positions.

    Each sample counts in the four pixels around it, by its nearness to their centres. A pixel that no sample reaches
    takes the value of the nearest that one reaches, within two pixels; beyond it is NaN.

    Parameters
    ----------
    x, y, signal : array_like, shape (samples,)
        Places, um, and signal; samples that are not numbers do not count.
    origin, size : tuple[float, float]
        Corner with the lowest x and y, and width and height, um.
    shape : tuple[int, int]
        Rows and columns.
    name, unit : str
        Of the signal.

    Raises
    ------
    ImageError
        The arrays differ in length, or no sample is in the image.

    Examples
    --------
    >>> x, y = np.meshgrid(np.linspace(0.0, 1.0, 50), np.linspace(0.0, 1.0, 50))
    >>> made = gridded(x.ravel(), y.ravel(), 3 * x.ravel(), origin=(0.0, 0.0), size=(1.0, 1.0), shape=(4, 5))
    >>> made.data[2].round(1).tolist()
    [0.3, 0.9, 1.5, 2.1, 2.7]
    """
    given = {"x": (x, "um"), "y": (y, "um"), "signal": (signal, unit)}
    places = [checks.signal(argument, one, of, (1, 2)).ravel() for argument, (one, of) in given.items()]
    if len({one.size for one in places}) > 1:
        raise ImageError(f"x, y and signal have {', '.join(str(one.size) for one in places)} samples: must be as many")
    rows, columns = (checks.count("shape", one, 1, 10**5) for one in shape)
    known = np.all(np.isfinite(places), axis=0)
    u, v, values = (one[known] for one in places)
    u = (u - origin[0]) / size[0] * columns - 0.5
    v = (v - origin[1]) / size[1] * rows - 0.5
    weight, total = np.zeros(rows * columns), np.zeros(rows * columns)
    left, below = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    for i in (0, 1):
        for j in (0, 1):
            near = np.abs(1 - i - (u - left)) * np.abs(1 - j - (v - below))
            column, row = left + i, below + j
            within = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            index = row[within] * columns + column[within]
            weight += np.bincount(index, near[within], weight.size)
            total += np.bincount(index, (near * values)[within], weight.size)
    if not weight.any():
        raise ImageError("no sample is within the image: its origin, size or unit differ from those of x and y, um")
    reached = weight > 1e-6
    data = np.where(reached, total / np.where(reached, weight, 1.0), np.nan).reshape(rows, columns)
    return Image(data=_filled(data), size=size, origin=origin, name=name, unit=unit)


def _filled(data: FloatArray, reach: float = 2.0) -> FloatArray:
    """NaN replaced by the nearest number within `reach` pixels."""
    gaps = ~np.isfinite(data)
    if not gaps.any():
        return data
    from scipy.ndimage import distance_transform_edt

    distance, nearest = distance_transform_edt(gaps, return_indices=True)
    return np.where(gaps & (distance <= reach), data[tuple(nearest)], data)


def _check_fit(scan: Scan, name: str, values: FloatArray) -> None:
    if values.ndim == 1 and values.size != len(scan.x):
        raise ImageError(
            f"the {name} has {values.size} samples, the scan {len(scan.x)} ticks at {scan.sample_rate:g} Hz: the "
            "recording is of another scan, or was cut short"
        )


def _check_whole(scan: Scan, name: str, values: FloatArray) -> None:
    if (missing := np.flatnonzero(~np.isfinite(values))).size:
        raise ImageError(
            f"the {name} has no number in {missing.size} of {values.size} ticks, the first at "
            f"{missing[0] / scan.sample_rate:.6g} s: put in what lies between its neighbours, such as by numpy.interp"
        )


# ---- What is distorted ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Distortion(Displayed):
    """Where the pixels of a raster were taken, beside where they are shown.

    Attributes
    ----------
    dx, dy : ndarray, shape (lines, columns)
        True minus desired place of each pixel, in pixels, less the mean of all: a shift of the whole image is none.
    shift : tuple[float, float]
        That mean, in pixels.
    directions : ndarray, shape (lines,)
        +1 of a trace, -1 of a retrace.
    size : tuple[float, float]
        Of a pixel, um.
    """

    dx: FloatArray
    dy: FloatArray
    shift: tuple[float, float]
    directions: npt.NDArray[np.int32]
    size: tuple[float, float] = field(default=(1.0, 1.0))

    @property
    def largest(self) -> float:
        """Largest distance of a pixel from its place, pixels."""
        return float(np.max(np.hypot(self.dx, self.dy)))

    @property
    def rms(self) -> float:
        """The same, root mean square."""
        return float(np.sqrt(np.mean(self.dx**2 + self.dy**2)))

    @property
    def trace_retrace(self) -> float:
        """Largest distance between the places of the same pixel in trace and retrace of a row, mean over 16 rows.

        The mean is that of the eye, and of a correlation: noise of single rows is no shift.
        """
        apart = [one[self.directions > 0] - one[self.directions < 0] for one in (self.dx, self.dy)]
        rows, means = self._means()
        return float(np.max(np.hypot(*(one[: rows * means].reshape(means, rows, -1).mean(axis=1) for one in apart))))

    def apart_by_noise(self, noise: Sequence[float]) -> float:
        """What noise of the sensors, um rms of a sample of x and of y, makes of `trace_retrace`, pixels; 5 % are above.

        It is less the more rows are in a mean, and more the more means there are.
        """
        rows, means = self._means()
        loudest = math.sqrt(2 * math.log(means * self.dx.shape[1] / RARE))
        return loudest * math.sqrt(2 / rows) * max(one / pixel for one, pixel in zip(noise, self.size, strict=True))

    def _means(self) -> tuple[int, int]:
        """Rows in a mean, and how many means there are."""
        every = int(np.count_nonzero(self.directions > 0))
        rows = max(1, min(MEAN, every))
        return rows, every // rows

    def rms_um(self) -> tuple[float, float]:
        """Root mean square of the errors of x and y, um."""
        return tuple(float(np.std(one) * pixel) for one, pixel in zip((self.dx, self.dy), self.size, strict=True))  # type: ignore[return-value]

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, quantity(getattr(self, name), "pixels")) for name in ("largest", "rms", "trace_retrace")]
        return "Distortion", rows


def distortion(scan: Scan, x: npt.ArrayLike, y: npt.ArrayLike, columns: int = 512) -> Distortion:
    """The distortion of a raster from the true or measured positions of its ticks, um.

    Examples
    --------
    >>> from truestroke import scans
    >>> scan = scans.raster(width=10.0, lines=8, rate=40.0, sample_rate=10_000.0)
    >>> stretched = distortion(scan, 1.01 * scan.x.position, scan.y.position, 100)
    >>> round(stretched.largest, 2), round(stretched.trace_retrace, 2)
    (0.49, 0.0)
    """
    if scan.name not in ALONG:
        raise SettingError("scan", f"a {scan.name}", "a raster, whose lines are rows")
    columns = checks.count("columns", columns, 1, 10**6)
    pixel = scan.size[0] / columns, scan.size[1] / (int(scan.lines["row"].max()) + 1)
    errors = []
    for name, axis, true, one in zip("xy", scan.axes, (x, y), pixel, strict=True):
        place = checks.signal(name, true, "um")
        _check_fit(scan, "position", place)
        _check_whole(scan, f"position of {name}", place)
        errors.append(at_pixels(scan, place - axis.position, columns) / one)
    shift = float(errors[0].mean()), float(errors[1].mean())
    dx, dy = (error - mean for error, mean in zip(errors, shift, strict=True))
    return Distortion(dx=dx, dy=dy, shift=shift, directions=scan.lines["direction"], size=pixel)


def shift(reference: Image, moved: Image) -> tuple[float, float]:
    """How far the second image is displaced against the first, in x and y, pixels, by their phases (scikit-image).

    ::

        c = F^-1[w^2 conj(A) B],  w = |sum conj(A) B| / sqrt(sum |A|^2 sum |B|^2),  in rings of frequencies

    A and B are the Fourier transforms of both images under a Hann window. The peak of c is found to 1/200 of a pixel by
    `skimage.registration.phase_cross_correlation` [@guizar2008]. Amplitudes are kept: where each frequency counts
    alike, rounding at those that the sample hardly has shifts the peak by 0.1 pixel. The coherence w [@knapp1976],
    less what chance makes of it, takes out the frequencies that are noise in both images. The offset of each row, which
    a microscope adds, and a tilt along the rows do not count, unless the rows have nothing else. A sample that repeats,
    as a grating does, shows its shift within half of its period only.

    Raises
    ------
    ImageError
        The images differ in shape, have gaps, or show nothing; or scikit-image is missing.
    SettingError
        An argument is no `Image`.

    Examples
    --------
    >>> texture = np.random.default_rng(0).normal(size=(64, 64))
    >>> a = Image(data=texture, size=(1.0, 1.0))
    >>> b = Image(data=np.roll(texture, (2, -3), (0, 1)), size=(1.0, 1.0))
    >>> [round(one, 1) for one in shift(a, b)]
    [-3.0, 2.0]
    """
    try:
        from skimage.registration import phase_cross_correlation
    except ModuleNotFoundError as error:
        text = 'the shift of two images needs the package scikit-image: pip install "truestroke[scan]"'
        raise ImageError(text) from error
    for argument, given in (("reference", reference), ("moved", moved)):
        checks.instance(argument, given, Image, "an Image, such as of scans.images")
    if reference.data.shape != moved.data.shape:
        raise ImageError(f"the images have {reference.data.shape} and {moved.data.shape} pixels: must be as many")
    for image in (reference, moved):
        if not np.all(np.isfinite(image.data)):
            raise ImageError(f"{image.name} has pixels without a number: fill them, or leave these rows out")
        if np.ptp(image.data) == 0:
            raise ImageError(f"{image.name} is the same everywhere: there is nothing whose shift could be seen")
    one, other = (_windowed(data) for data in levelled(reference.data, moved.data))
    whole = np.asarray(phase_cross_correlation(one, other, normalization=None)[0])
    for _ in range(AGAIN):
        both = levelled(*both_show(reference.data, moved.data, whole.astype(int).tolist()))
        if min(np.ptp(part) for part in both) == 0:
            break
        pair = _coherent(*(np.fft.fft2(_windowed(part)) for part in both))
        step = phase_cross_correlation(*pair, space="fourier", upsample_factor=UPSAMPLED, normalization=None)[0]
        if np.abs(step).max() <= 1.0:
            whole = whole + step
            break
        whole = whole + np.rint(step)
    down, right = whole.tolist()
    return 0.0 - right, 0.0 - down


def levelled(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two images without the offsets of their rows and their tilt, where both of them show more than these and noise.

    >>> x, y = np.meshgrid(np.arange(64.0), np.arange(48.0))
    >>> bool(np.allclose(*levelled(np.sin(x / 5) + y, np.sin(x / 5) + x)))
    True
    """
    within = _within_rows(first), _within_rows(second)
    shows = (_shows(rest, one) for rest, one in zip(within, (first, second), strict=True))
    return within if all(shows) else (first, second)


def _within_rows(data: FloatArray) -> FloatArray:
    """What an image has under the window of `shift`, without the offset of each row and the tilt along all of them."""
    weights = _window(data.shape[1])
    along = np.arange(data.shape[1]) - np.average(np.arange(data.shape[1]), weights=weights)
    level = data - np.average(data, axis=1, weights=weights)[:, None]
    squares = float(np.sum(weights * along**2))
    slope = float(np.sum(weights * along * level.mean(axis=0))) / squares if squares else 0.0
    return np.asarray(level - slope * along)


def _shows(rest: FloatArray, data: FloatArray) -> bool:
    """Whether what is within the rows of an image is more than noise, which pixels that are two apart do not share."""
    power, alike = float(np.mean(rest**2)), float(np.mean(rest[:, 2:] * rest[:, :-2])) if rest.shape[1] > 2 else 0.0
    return power > LEFT * float(np.var(data)) and alike > SHARED * power


def _window(size: int) -> FloatArray:
    return np.asarray(np.hanning(size + 2)[1:-1])


def _windowed(data: FloatArray) -> FloatArray:
    return np.asarray(np.outer(*map(_window, data.shape)) * (data - data.mean()))


def both_show(first: FloatArray, second: FloatArray, by: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """The parts of two images that agree where the second is moved by so many rows and columns."""
    cut = [(slice(max(-n, 0), min(-n, 0) or None), slice(max(n, 0), min(n, 0) or None)) for n in by]
    return first[cut[0][1], cut[1][1]], second[cut[0][0], cut[1][0]]


def _coherent(one: ComplexArray, other: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Two spectra, each frequency by how much of both is the same in its ring."""
    fy, fx = (np.fft.fftfreq(size) for size in one.shape)
    ring = np.rint(np.hypot(fy[:, None], fx) * min(one.shape) / 2).astype(int)
    ends = np.cumsum(np.bincount(ring.ravel()))
    ring = (np.concatenate([[0], ends[:-1]]) // RING)[ring]  # of some frequencies at least
    crossed = np.conj(one) * other
    parts = crossed.real, crossed.imag, np.abs(one) ** 2, np.abs(other) ** 2
    real, imag, mine, its = (np.bincount(ring.ravel(), part.ravel()) for part in parts)
    many = np.maximum(np.bincount(ring.ravel()), 1)
    alike, chance = np.hypot(real, imag) / np.maximum(np.sqrt(mine * its), 1e-300), CHANCE / np.sqrt(many)
    counts = np.clip((alike - chance) / np.maximum(1 - chance, 1e-300), 0.0, 1.0)[ring]
    return (counts * one, counts * other) if counts.any() else (one, other)
