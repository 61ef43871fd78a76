"""The sensor where the stage is not known: its delay and lag between the displacement and the measurement.

The measurement of tick k is the mean over the tick of the displacement, behind a delay of d ticks and a first-order lag
with the time constant lambda = f_s / (2 pi sensor_bandwidth), in ticks. The model's displacement u_k is constant
in a tick. The whole ticks of d only shift the measurement; with the rest delta of d the lag at the end of tick k is

    Y_k = p Y_(k-1) + (1 - p_2) u_k + (p_2 - p) u_(k-1),   p = exp(-1 / lambda), p_2 = exp(-(1 - delta) / lambda)

and, since lambda Y' = u - Y, the measurement shows

    (1 - delta) u_k + delta u_(k-1) - lambda (Y_k - Y_(k-1))

Both are exact. The law compares that with the measurement, so that it learns the displacement itself.
"""

from __future__ import annotations

import math
from typing import Any

from truestroke.base.typing import FloatArray

ROUNDING = 1e-9  # ticks
NAMES = ("ticks", "share", "lag", "pole", "now", "before", "slow")
IN_DYNAMICS: dict[str, Any] = {f"sensor.{name}": [] if name == "slow" else 0 for name in NAMES}
"""The members where the `dynamics` have the sensor in them."""


def members(sample_rate: float, sensor_delay: float, sensor_bandwidth: float | None) -> dict[str, Any]:
    """The members of ts_settings.sensor in c/include/truestroke.h, of a delay, s, and a bandwidth, Hz.

    >>> found = members(10000.0, 1.25e-4, 2000.0)
    >>> found["sensor.ticks"], round(found["sensor.share"], 6), round(found["sensor.lag"], 3)
    (1, 0.25, 0.796)
    """
    delay = sensor_delay * sample_rate
    ticks = math.floor(delay + ROUNDING)
    share = max(delay - ticks, 0.0)
    lag = sample_rate / (2 * math.pi * sensor_bandwidth) if sensor_bandwidth else 0.0
    pole, late = (math.exp(-1 / lag), math.exp(-(1 - share) / lag)) if lag else (0.0, 0.0)
    rest, constant = share / sample_rate, lag / sample_rate  # s
    slow = [-(rest + constant), rest**2 / 2 + rest * constant + constant**2]
    values = (ticks, share, lag, pole, 1 - late, late - pole, slow)
    return {f"sensor.{name}": value for name, value in zip(NAMES, values, strict=True)}


class Sensor:
    """The sensor in the loop, tick by tick: what the kernel does in `sensed`.

    Parameters
    ----------
    known : mapping
        What `members` gave.
    """

    def __init__(self, known: dict[str, Any]) -> None:
        get = {name.removeprefix("sensor."): value for name, value in known.items()}
        self.ticks: int = get["ticks"]
        self.slow: list[float] = get["slow"] or [0.0, 0.0]
        self._share, self._lag = get["share"], get["lag"]
        self.late: bool = self.ticks > 0 or self._share > 0 or self._lag > 0
        self._pole, self._now, self._before = get["pole"], get["now"], get["before"]
        self._u: FloatArray | None = None  # of the tick before
        self._end: FloatArray | None = None  # the lag at the end of the tick before

    def sensed(self, u: FloatArray) -> FloatArray:
        """The regressor of the next measured tick as the sensor shows it; at rest before the first tick."""
        if not self._share > 0 and not self._lag > 0:
            return u
        before, start = (u, u) if self._u is None or self._end is None else (self._u, self._end)
        end = 0.0 + self._pole * start + self._now * u + self._before * before
        shown: FloatArray = 0.0 + (1 - self._share) * u + self._share * before - self._lag * (end - start)
        self._u, self._end = u, end
        return shown
