"""Why an image and the recording of its voltages do not fit, by what both of them show, each in words."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.signals.scans.images import Image, levelled, shift

FAR = 3.0  # pixels between trace and retrace: beyond, they are further apart than a wrong model makes them
OUTSIDE = 0.1  # of the range of the voltage of a model's record: a scan that goes further is named
BEGINS = 0.02  # of the range of a voltage: one that begins further from 0 V and moves does not begin at rest
EARLY, MOVING = 8, 0.2  # first steps, each of which is at least that share of the steps of a line
UNLIKE = 1.5  # times: how large an image is by its file, and by the voltage
ALIKE = 0.8  # correlation of two images of the same thing
UNIFORM = 0.25  # of a shift: one that varies less along a line is the same everywhere
BLOCKS = 8  # of columns, in which trace and retrace are compared
WAY = 0.5  # of what a line covers: one that ends so far behind its start goes back
FEW = 0.1  # of the lines: so many may be uneven where the others are even
ACROSS = 0.1  # of the way from line to line: an axis that moves less along a line is the slow one
CLEARLY = 0.8  # times: what trace and retrace disagree by without a hum, where it is surely not in the motion
MISTAKES: tuple[tuple[str, Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]], ...] = (
    ("the retrace mirrored, as it is where it is stored in the order of time", lambda t, r: (t, r[:, ::-1])),
    ("the trace mirrored", lambda t, r: (t[:, ::-1], r)),
    ("both images exchanged, or both mirrored", lambda t, r: (r, t)),  # of a loop that is symmetric the same
    ("the retrace upside down", lambda t, r: (t, r[::-1])),
    ("both images turned by 90 degrees", lambda t, r: (t.T, r.T)),
)


# ---- Voltages and lines ----------------------------------------------------------------------------------------------


def beyond(axis: str, volts: FloatArray, known: tuple[float, float]) -> str:
    """A voltage that the record of the model does not have; empty where there is none."""
    (low, high), (least, most) = known, (float(volts.min()), float(volts.max()))
    if max(low - least, most - high) <= OUTSIDE * (high - low):
        return ""
    return (
        f"The voltage of {axis} goes from {least:.3g} to {most:.3g} V, that of the model's record from {low:.3g} to "
        f"{high:.3g} V: is its unit right, and the gain of a monitor?"
    )


def begins(axis: str, volts: FloatArray) -> str:
    """A recording that begins while the axis moves, far from 0 V; empty where it begins at rest."""
    steps, first = np.abs(np.diff(volts)), float(volts[0])
    moves = steps[:EARLY].min(initial=np.inf) > MOVING * float(np.quantile(steps, 0.9, method="lower"))
    if not moves or abs(first) <= BEGINS * float(np.ptp(volts)):
        return ""
    return (
        f"The recording of {axis} begins at {first:.3g} V while it moves: what hysteresis was before is not known, and "
        "the first rows may be off. Record from rest on."
    )


def hum(
    axis: str, volts: FloatArray, sample_rate: float, pixels: float, as_it_is: float, without: float
) -> tuple[bool, str]:
    """Whether hum of a voltage is only its monitor's, and what to say of it; nothing where the stage follows it.

    `as_it_is` and `without` are how much trace and retrace agree, as of `agreement`; `pixels` as far as it moves them.
    """
    power = np.abs(np.fft.rfft(volts - volts.mean())) ** 2
    at = sample_rate / volts.size * int(np.argmax(power))
    size = f"{figures(1000 * math.sqrt(2) * float(np.std(volts)), 2)} mV at {at:.3g} Hz"
    if 1 - without < CLEARLY * (1 - as_it_is):
        return True, f"{size} of {axis}, {pixels:.2g} pixels: trace and retrace agree better without it"
    if 1 - as_it_is < CLEARLY * (1 - without):
        return False, ""
    return False, (
        f"The voltage of {axis} has hum, {size}, which moves pixels by up to {pixels:.2g}: if its monitor alone has "
        "it, and not the actuator, they are as far off. Take the command."
    )


def agreement(made: Mapping[str, Image]) -> float:
    """Correlation of trace and retrace; what a microscope adds to each row alike does not count."""
    one, other = levelled(*(filled(image).data for image in made.values()))
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def other_count(lines: npt.NDArray[np.void], shape: tuple[int, int], skipped: float) -> str:
    """Why a recording has not as many lines as the image has rows, as far as their times show it."""
    rows, columns = shape
    if lines.size == columns:
        lost = "it has lost its last rows, as of a scan that was stopped, or "
        return (lost if rows < columns else "") + "it is turned by 90 degrees"
    if not lines.size:
        return (
            "its trigger is missing, or is that of the other direction: `trigger` is of the trace, `retrace_trigger` "
            "of the retrace, and a table of `lines` is of both"
        )
    if lines.size > rows:
        return "the image is of another scan or has lost rows, or the trigger is another signal"
    apart = np.diff(lines["start"])
    period = float(np.median(apart)) if apart.size else 0.0
    gaps = np.flatnonzero(apart > skipped * period)
    if gaps.size:
        begin, again = lines["start"][gaps[0] : gaps[0] + 2]
        missing = round(float(np.sum(apart[gaps] / period - 1)))
        return f"triggers are missing, {missing} of them, the first ones between {begin:.4g} and {again:.4g} s"
    first, last = lines["start"][0], lines["end"][-1]
    return (
        f"it was cut short, so that lines before {first:.4g} s or behind {last:.4g} s are missing, or the image is of "
        "another scan"
    )


def uneven(times: FloatArray) -> FloatArray:
    """How much later each of even times is than the others say; a few that are not even change it little.

    >>> uneven(np.array([0.0, 1.0, 2.0, 3.3, 4.0, 5.0])).round(2).tolist()
    [0.0, 0.0, 0.0, 0.3, 0.0, 0.0]
    """
    if times.size < 3:
        return np.zeros(times.size)
    later = times - period_of(times) * np.arange(times.size)
    return np.asarray(later - np.median(later))


def period_of(times: FloatArray) -> float:
    """From one of even times to the next, of two at least; a few that are not even change it little."""
    half = times.size // 2
    return float(np.median(times[-half:] - times[:half])) / (times.size - half)


def late(lines: npt.NDArray[np.void], name: str, speed: float, jitter: float, near: float) -> str:
    """Lines that begin or end later or earlier than the others say; empty where there are none, or all are uneven.

    `speed` is that of a line, pixels per second, `near` the pixels that do not matter, `jitter` as of the record, s.
    """
    off = np.array([uneven(lines[edge]) for edge in ("start", "end")])
    worst = off[np.abs(off).argmax(axis=0), np.arange(lines.size)] if lines.size else off[0]
    odd = np.flatnonzero(np.abs(worst) > max(near / speed, 2.5 * jitter))
    if not odd.size or odd.size > FEW * lines.size:
        return ""
    first = int(odd[0])
    more = f", as {odd.size - 1} others begin or end beside theirs" if odd.size > 1 else ""
    by, side = 1000.0 * abs(float(worst[first])), "later" if worst[first] > 0 else "earlier"
    return (
        f"Line {first} of the {name} begins or ends {by:.3g} ms {side} than the others say{more}: where its trigger "
        f"alone came {side}, and not its pixels, they are off by {abs(worst[first]) * speed:.2g} pixels."
    )


def no_lines(places: Mapping[str, FloatArray]) -> str:
    """Why these places, um, shape (rows, columns), from the left to the right, are no lines; empty where they are."""
    for name, x in places.items():
        along = float(np.median(x[:, -1] - x[:, 0]))
        moved, rows = float(np.median(np.ptp(x, axis=1))), float(np.ptp(x.mean(axis=1)))
        if moved <= ACROSS * rows or moved == 0.0:
            return (
                f"by its voltage x moves by {moved:.3g} um along a line, and by {rows:.3g} um from line to line: it is "
                "the voltage of the slow axis, or of no scan"
            )
        if along < -WAY * moved:
            return (
                f"by its voltage x goes back by {-along:.3g} um along the {name}: the lines or triggers of trace and "
                "retrace are exchanged, or the voltage has the wrong sign"
            )
    return ""


def sizes(image: Image, predicted: tuple[float, float]) -> tuple[str, float]:
    """An image that is much larger or smaller than the voltage says, and how many times; empty where it is not."""
    if image.pixel == (1.0, 1.0):
        return "", 1.0  # as of a file without a size
    times = max(max(one / other, other / one) for one, other in zip(image.size, predicted, strict=True))
    if times <= UNLIKE:
        return "", times
    shown, found = (" x ".join(f"{one:.3g}" for one in size) for size in (image.size, predicted))
    return (
        f"The image has {shown} um by its file, and {found} um by the voltage and the model: is the voltage that of "
        "this scan and axis, its unit right, and the gain of a monitor?"
    ), times


# ---- Trace and retrace -----------------------------------------------------------------------------------------------


def in_blocks(trace: Image, retrace: Image) -> tuple[list[int], list[float]]:
    """Middle columns of blocks, and by how many pixels the retrace is displaced across in each."""
    columns = trace.data.shape[1]
    half = max(columns // BLOCKS, 8)
    centres = list(range(half, max(columns - half, half) + 1, half))
    parts = [slice(centre - half, centre + half) for centre in centres]
    both = filled(trace), filled(retrace)
    apart = [shift(*(dataclasses.replace(one, data=one.data[:, part]) for one in both))[0] for part in parts]
    return centres, apart


def filled(image: Image) -> Image:
    """Without gaps: their rows and columns are those of an edge."""
    data = image.data
    known = np.isfinite(data)
    return image if known.all() else dataclasses.replace(image, data=np.where(known, data, 0.0))


def why_apart(
    given: Mapping[str, Image],
    made: Mapping[str, Image],
    again: Callable[[Mapping[str, Image]], Mapping[str, Image]],
    apart: tuple[float, float],
    speed: float,
    near: float,
) -> str:
    """Why trace and retrace are so many pixels apart, as far as the images show it.

    Parameters
    ----------
    given, made : Mapping[str, Image]
        "trace" and "retrace", before and after the correction.
    again : callable
        Corrects others by the same places.
    apart : tuple[float, float]
        Pixels in x and y.
    speed : float
        Of a line, pixels per second.
    near : float
        Pixels by which two images that agree may be apart.
    """
    if np.array_equal(given["trace"].data, given["retrace"].data):
        return "they are the same image. Give that of the other direction"
    if not _are_alike(made["trace"], made["retrace"]) and (words := _mistake(given, again, near)):
        return words
    if (rows := round(apart[1])) and _are_alike(made["trace"], _raised(made["retrace"], -rows)):
        return f"rows of the retrace are {abs(rows)} off, as where one of the two has lost a row"
    return _late(made, apart[0], speed)


def _raised(image: Image, rows: int) -> Image:
    return dataclasses.replace(image, data=np.roll(image.data, rows, axis=0))


def _are_alike(one: Image, other: Image) -> bool:
    """Whether they show the same at the same places."""
    return agreement({"one": one, "other": other}) > ALIKE


def _mistake(
    given: Mapping[str, Image], again: Callable[[Mapping[str, Image]], Mapping[str, Image]], near: float
) -> str:
    trace, retrace = given["trace"], given["retrace"]
    found = []
    for words, changed in MISTAKES:
        data = changed(trace.data, retrace.data)
        if {one.shape for one in data} != {trace.data.shape}:
            continue
        first, second = (dataclasses.replace(trace, data=one) for one in data)
        made = list(again({"trace": first, "retrace": second}).values())
        apart = float(np.hypot(*shift(*map(filled, made))))
        if apart <= max(near, FAR) and _are_alike(*made):
            found.append((apart, words))
    return f"they are {min(found)[0]:.1g} pixels apart with {min(found)[1]}. Change the file" if found else ""


def _late(made: Mapping[str, Image], across: float, speed: float) -> str:
    """A shift that is the same along the whole line is one of time."""
    _, apart = in_blocks(made["trace"], made["retrace"])
    if np.ptp(apart) > UNIFORM * abs(across):
        return ""
    return (
        f"by the same along the whole line, as if the voltage was recorded {delay(across, speed)}, or the model is not "
        "that of this motion. Move the lines by as much, or identify it from a record of the scan's own lines, or "
        "share the shift by `align`"
    )


def delay(across: float, speed: float) -> str:
    """Of a voltage that alone moves trace and retrace so many pixels apart, at a speed in pixels per second.

    >>> delay(1.0, 5000.0)
    '0.1 ms too late'
    """
    by = 500.0 * across / speed
    return f"{figures(abs(by), 2)} ms too {'late' if by > 0 else 'early'}"
