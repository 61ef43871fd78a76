"""A sample rate that is given, against the time stamps of the file."""

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.signals.columns import Column
from truestroke.signals.tables import UNITS

AGREE = 0.02  # relative: how far a nominal sample rate may be from that of the stamps
EVEN = 0.05, 0.01  # of the median interval: deviation of stamps that are even; they show a rate as exactly as this
SAME = 1e-3  # the same, that is not worth a word
DAY = 86_400.0  # s
ACROSS = 10.0  # median intervals at most between the last row of a day and the first of the next


def against(stamps: FloatArray, column: Column, sample_rate: float) -> tuple[str, str]:
    """What the stamps say against the sample rate, Hz; and, where it is nothing, that they are not used.

    Both the mean and the median interval may agree with it: stamps may be rounded coarsely, or have gaps; of even ones
    a hundredth is a contradiction, too. Stamps
    without a unit may be in any; those that count the rows or do not ascend are no clock.

    Examples
    --------
    >>> against(np.arange(9) / 200.0, Column("time", "s", True), 1000.0)[0]
    "the sample rate is given as 1000 Hz, but the time stamps of the file ('time' in s) have 200 Hz"
    """
    known = stamps[np.isfinite(stamps)]
    steps = np.diff(known)
    called = f"{column.heading!r} in {column.unit}"
    if steps.size < 2 or np.median(steps) <= 0 or known[-1] <= known[0]:
        return "", f"the time stamps of the file ({called}) do not ascend and are not used"
    counted = bool(np.all(steps == 1))
    rates = [1 / float(np.median(steps)), steps.size / float(known[-1] - known[0])]
    scales = [1.0] if column.stated else [1 / seconds for seconds in UNITS["time"].values()]
    off = min((rate * scale / sample_rate - 1 for rate in rates for scale in scales), key=abs)
    even = float(np.std(steps)) < EVEN[0] * float(np.median(steps))
    if abs(off) <= (EVEN[1] if even else AGREE) or counted:
        which = "" if abs(off) <= SAME or counted else f", although they have {sample_rate * (1 + off):.6g} Hz"
        return "", f"the time stamps of the file ({called}) are not used{which}"
    rate = f"{rates[0]:.6g} Hz"
    return f"the sample rate is given as {sample_rate:g} Hz, but the time stamps of the file ({called}) have {rate}", ""


def over_midnight(stamps: FloatArray) -> FloatArray:
    """Stamps that ascend where they are of the time of day, s, and the record goes on into the next day.

    A day ends where the time falls by 24 h but for an interval between rows. Runs that begin again at the same stamp
    are no days.

    Examples
    --------
    >>> over_midnight(np.array([86398.0, 86399.0, 0.0, 1.0, 2.0])) - 86400.0
    array([-2., -1.,  0.,  1.,  2.])
    """
    steps = np.diff(stamps)
    ends = np.flatnonzero(steps < -DAY / 2)
    if not ends.size or not (stamps[ends] < DAY).all() or not (stamps[ends + 1] >= 0).all():
        return stamps
    across = steps[ends] + DAY
    if not (across > 0).all() or (across > ACROSS * np.nanmedian(steps)).any() or stamps[0] == stamps[ends[0] + 1]:
        return stamps
    days = np.zeros(stamps.size)
    days[ends + 1] = DAY
    return stamps + np.cumsum(days)
