"""Arrays over time, each with name, unit and description: what every signal of truestroke is kept in."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows
from truestroke.base.flags import IN_SHORT
from truestroke.base.typing import FloatArray

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

Array = npt.NDArray[Any]

QUANTITIES = {
    "time": ("s", "start of each tick"),
    "position": ("um", "desired displacement"),
    "velocity": ("um/s", "desired velocity"),
    "acceleration": ("um/s^2", "desired acceleration"),
    "flat": ("", "whether the motion is in its flat part, where errors count"),
    "desired": ("um", "desired displacement"),
    "desired_velocity": ("um/s", "desired velocity"),
    "volts": ("V", "command at the D/A converter"),
    "measured": ("um", "measured displacement, mean over the tick"),
    "displacement": ("um", "measured displacement"),
    "predicted": ("um", "displacement that the model predicts from the voltage"),
    "true": ("um", "displacement without sensor noise, mean over the tick"),
    "residual": ("um", "measured minus predicted displacement"),
    "error": ("um", "measured minus desired displacement"),
    "innovation": ("um", "measurement beyond the model, (15)"),
    "flags": ("", IN_SHORT),
    "lateness": ("us", "how late the block began that the tick is in"),
    "known": ("", "whether the sample may be fitted"),
    "held_out": ("", "whether the sample was held out of the fit"),
    "weights_time": ("s", "start of the tick before the weights"),
    "weights": ("um/V", "w = [a0, b0, a1, b1, ...], (21)"),
    "partial_slopes": ("um/V", "slopes of the hysteresis branches as the inverse used them"),
    "trace_P": ("1/V^2", "trace of the covariance"),
}
"""Unit and description of every signal, by its name."""


@dataclass(frozen=True, eq=False)
class Channel:
    """One labelled array.

    Attributes
    ----------
    data : ndarray
        Its first axis runs over the entries of the channel `time`.
    unit : str
        "um", "V", ...; empty for a pure number.
    description : str
        Its meaning, in a few words.
    time : str
        Name of the channel that holds the times of its entries.
    """

    data: Array
    unit: str
    description: str
    time: str = "time"


def channel(name: str, data: Array, time: str = "time") -> Channel:
    """A signal of `QUANTITIES` with its unit and description."""
    return Channel(data, *QUANTITIES[name], time)


def dtype(name: str) -> npt.DTypeLike:
    """Of the entries of a signal that is recorded: flags are bits, flat is 0 or 1, all else are numbers."""
    return np.uint8 if name in ("flags", "flat") else np.float64


class Signals(Displayed):
    """Arrays over common times: what a recording, a trajectory, a record, a waveform can all do.

    A subclass is a dataclass with `time`, s; its attributes that `QUANTITIES` names are the signals.
    """

    def labelled(self) -> Mapping[str, Channel]:
        """The arrays by name, each with unit and description."""
        names = [f.name for f in dataclasses.fields(self) if f.name in QUANTITIES]  # type: ignore[arg-type]
        found = {name: getattr(self, name) for name in dict.fromkeys(("time", *names))}
        return {name: channel(name, data) for name, data in found.items() if data is not None}

    def __post_init__(self) -> None:
        """SettingError where an array is not as long as its times."""
        channels = self.labelled()
        for name, one in channels.items():
            if one.time not in channels:
                raise SettingError(f"time of channel {name}", repr(one.time), f"one of {', '.join(channels)}")
            if one.data.shape[:1] != (length := channels[one.time].data.shape[:1]):
                raise SettingError(f"channel {name}", f"array of shape {one.data.shape}", f"{length[0]} entries long")

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, c.unit or "-", str(c.data.shape), c.description) for name, c in self.labelled().items()]
        return type(self).__name__, rows

    def to_dataframe(self, time: str = "time") -> pandas.DataFrame:
        """The channels over one time axis as columns of a pandas data frame (extra `pandas`), with that time as index.

        A channel of several columns, such as weights, becomes columns "weights[0]", "weights[1]", ...

        Raises
        ------
        SettingError
            No channel has this time axis.
        """
        import pandas

        held = {name: c for name, c in self.labelled().items() if c.time == time}
        if time not in held:
            axes = dict.fromkeys(c.time for c in self.labelled().values())
            raise SettingError("time", repr(time), " or ".join(map(repr, axes)))
        return pandas.DataFrame(split(held)).set_index(time)

    def to_xarray(self) -> xarray.Dataset:
        """All channels as an `xarray.Dataset` (extra `xarray`), each along its time, with units and descriptions.

        The same as `xarray.open_dataset` shows of the file of a recording. The columns of weights and the like have a
        dimension of their own, such as `weights_index`.
        """
        import xarray

        channels = self.labelled()
        held = {
            name: ((c.time, *index_names(name, c.data.ndim)), c.data, {"units": c.unit, "long_name": c.description})
            for name, c in channels.items()
        }
        return xarray.Dataset(held).set_coords(sorted({c.time for c in channels.values()}))

    def plot(self, *names: str) -> Figure:
        """These channels over their time, or all of them: a panel for each unit (`report.signals`).

        Raises
        ------
        SettingError
            There is no such channel.
        """
        from truestroke.report.signals import signals

        return signals(self, names)


def split(channels: Mapping[str, Channel]) -> dict[str, Array]:
    """The columns of channels, each with one axis: of weights, "weights[0]", "weights[1]", ..."""
    return {
        name + "".join(f"[{i}]" for i in index): channel.data[:, *index]
        for name, channel in channels.items()
        for index in np.ndindex(channel.data.shape[1:])
    }


def index_names(name: str, ndim: int) -> list[str]:
    """Names of the axes of a channel after that of time.

    >>> index_names("weights", 2)
    ['weights_index']
    """
    return [f"{name}_index{axis if axis > 1 else ''}" for axis in range(1, ndim)]


class Sampled(Signals):
    """Signals that are evenly sampled from time 0; a subclass has `sample_rate`, Hz."""

    sample_rate: float

    def __len__(self) -> int:
        return next(
            int(getattr(self, f.name).shape[0])
            for f in dataclasses.fields(self)  # type: ignore[arg-type]
            if f.name in QUANTITIES
        )

    @property
    def time(self) -> FloatArray:
        """Start of each sample, s, shape (samples,)."""
        return np.arange(len(self)) / self.sample_rate

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self) / self.sample_rate
