"""The recording of a run: labelled arrays with units, to and from HDF5."""

import dataclasses
import functools
import json
import platform
import subprocess
import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from truestroke.base import checks, files, hdf5
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.base.hdf5 import ENDING, FORMAT
from truestroke.signals.channels import Array, Channel, Signals, index_names

__all__ = ["Channel", "Recording", "RecordingError", "versions"]

FORMAT_VERSION = 2  # from 2 on with checksums
CHUNK = 65536  # entries of a chunk of a file that is saved at once
TRIES, PAUSE = 10, 0.02  # s; to read a file that is being written


def of_axis(name: str, axis: str) -> str:
    """Name of a channel in a recording of several axes.

    >>> of_axis("measured", "x")
    'measured_x'
    """
    return f"{name}_{axis}"


class RecordingError(files.FileError):
    """A file that cannot be read as a recording; the message states the reason."""


class ChannelError(TruestrokeError, KeyError):
    """A recording has no such channel; the message names those that it has.

    Examples
    --------
    >>> Recording({})["time"]
    Traceback (most recent call last):
        ...
    truestroke.ChannelError: the recording has no channel 'time'; there are none
    """

    __str__ = Exception.__str__  # that of KeyError quotes the message


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Signals, Mapping[str, Array]):
    """Labelled arrays of one run, a mapping of names to arrays, and what it was made from.

    Attributes
    ----------
    channels : dict[str, Channel]
        By name: time, desired, volts, measured, ...; see `truestroke.run`.
    metadata : dict[str, Any]
        Trajectory, controller, actuator, versions, time of creation: numbers, text, lists and dicts of them. Tuples
        become lists, NumPy numbers plain ones and dataclasses dicts, as they are in a file.

    Raises
    ------
    SettingError
        A channel does not fit its time channel, or the metadata cannot be written as JSON.

    Examples
    --------
    >>> time = np.arange(4) / 2000.0
    >>> recording = Recording(
    ...     {"time": Channel(time, "s", "start of each tick"), "volts": Channel(2 * time, "V", "command")},
    ...     {"trajectory": {"name": "ramp"}},
    ... )
    >>> recording["volts"].max(), recording.unit("volts"), "true" in recording, list(recording)
    (np.float64(0.003), 'V', False, ['time', 'volts'])
    >>> recording
    Recording
      time   s  (4,)  start of each tick
      volts  V  (4,)  command
    """

    channels: dict[str, Channel]
    metadata: dict[str, Any] = field(default_factory=dict)

    __hash__, __eq__ = object.__hash__, object.__eq__  # arrays have no single answer to ==

    def __post_init__(self) -> None:
        checks.instance("channels", self.channels, Mapping, "a mapping of names to Channel")
        for name, channel in self.channels.items():
            checks.instance(f"channels[{name!r}]", channel, Channel, "a Channel(data, unit, description)")
        super().__post_init__()
        object.__setattr__(self, "metadata", json.loads(_json(self.metadata)))

    def _repr_html_(self) -> str:
        """In a notebook: how it tracked, and the channels."""
        from truestroke.report import notebook

        return notebook.recording(self) + super()._repr_html_()

    def labelled(self) -> Mapping[str, Channel]:
        """The same as `channels`."""
        return self.channels

    def __getitem__(self, name: str) -> Array:
        return self._channel(name).data

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes of a run of several; () of one."""
        return tuple(self.metadata.get("axes", ()))

    def axis(self, name: str) -> Self:
        """The recording of one axis of a run of several, with the names of its channels as in that of a run of one.

        Raises
        ------
        SettingError
            There is no such axis.

        Examples
        --------
        >>> both = Recording(
        ...     {"time": Channel(np.arange(2.0), "s", ""), "volts_x": Channel(np.ones(2), "V", "")}, {"axes": {"x": {}}}
        ... )
        >>> both.axes, list(both.axis("x"))
        (('x',), ['time', 'volts'])
        """
        checks.one_of("name", name, self.axes)
        own = {key.removesuffix(f"_{name}"): c for key, c in self.channels.items() if key.endswith(f"_{name}")}
        times = {c.time: self.channels[c.time] for c in own.values()}
        common = {key: value for key, value in self.metadata.items() if key != "axes"}
        return type(self)(times | own, common | {"axis": {"name": name}} | self.metadata["axes"][name])

    def unit(self, name: str) -> str:
        """Unit of a channel."""
        return self._channel(name).unit

    def _channel(self, name: str) -> Channel:
        try:
            return self.channels[name]
        except KeyError:
            there = ", ".join(self.channels) or "none"
            raise ChannelError(f"the recording has no channel {name!r}; there are {there}") from None

    def save(self, path: str | Path) -> Path:
        """Write to an HDF5 file: a dataset for each channel, unit and description as its attributes.

        The file is written under a temporary name and then renamed: an existing file is either unchanged or replaced by
        a complete one. It has checksums of all data that `load` reads.

        Raises
        ------
        FileExistsError
            A file is there that is no recording, or one that another command made; within `files.overwriting` it is
            replaced.
        FileNotFoundError
            There is no such folder.
        """
        checks.path("path", path)
        with files.writing(path, kind(self.metadata)) as draft, hdf5.written(draft, **MODE) as file:
            describe(file, self.metadata)
            for name, channel in self.channels.items():
                data = channel.data
                chunked = {"chunks": (min(len(data), CHUNK), *data.shape[1:]), "fletcher32": True} if data.size else {}
                create(file, name, channel, **chunked)
            seal(file)
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read from an HDF5 file that `save` or `truestroke run` wrote, also while it is being written.

        Raises
        ------
        FileNotFoundError
            There is no such file.
        RecordingError
            Not an HDF5 file, not a truestroke recording, damaged, or of a newer format than this version reads.
        FileTooLargeError
            It needs more memory than its size allows, or than this computer has.
        """
        path = files.existing(checks.path("path", path))
        for _ in range(TRIES):
            try:
                return cls._load(path)
            except RecordingError:
                if not files.busy(path):
                    raise
                time.sleep(PAUSE)  # its writer was at the same place
        return cls._load(path)

    @classmethod
    def _load(cls, path: Path) -> Self:
        import h5py

        with files.reading(path, lambda reason: RecordingError(f"{path}: {reason}")):
            if not h5py.is_hdf5(path):
                raise RecordingError(f"{path}: not an HDF5 file; `truestroke examine` reads other records")
            with hdf5.opened(path) as file:
                return cls._read(file, path)

    @classmethod
    def _read(cls, file: Any, path: Path) -> Self:
        if file.attrs.get("format") != FORMAT:
            raise RecordingError(f"{path}: an HDF5 file, but not a {FORMAT}")
        if (version := int(file.attrs["format_version"])) > FORMAT_VERSION:
            raise RecordingError(f"{path}: format {version}, newer than {FORMAT_VERSION}; a newer truestroke reads it")
        if not hdf5.intact(file):
            raise RecordingError(f"{path}: the file is damaged (the checksum of what describes it is wrong)")
        sets = hdf5.channels(file)
        files.check_size(path, "the recording", sum(data.nbytes for data in sets.values()))
        channels = {
            name: Channel(data[()], data.attrs["unit"], data.attrs["description"], data.attrs["time"])
            for name, data in sets.items()
        }
        metadata = json.loads(file.attrs["metadata"])
        if ENDING in file:
            metadata |= _ending(file[ENDING][()].tobytes(), version)
            channels = _even(channels)
        return cls(channels, metadata)


MODE = {"libver": "latest", "track_order": True}
"""How a file of a recording is made: of a version of HDF5 that keeps checksums of its own tables."""


def describe(file: Any, metadata: Mapping[str, Any]) -> None:
    """Write format and metadata into an HDF5 file."""
    file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION, metadata=_json(metadata))
    for key, value in metadata.items():  # readable in any HDF5 viewer; `load` reads the one above
        file.attrs[f"about {key}"] = _json(value, indent=1)


def create(file: Any, name: str, channel: Channel, **storage: Any) -> Any:
    """The dataset of a channel, with its attributes; `storage` as in `h5py.Group.create_dataset`."""
    dataset = file.create_dataset(name, data=channel.data, **storage)
    dataset.attrs.update(unit=channel.unit, description=channel.description, time=channel.time)
    return dataset


def seal(file: Any) -> None:
    """When all channels are there: their axes as HDF5's dimension scales, as xarray reads them, and the checksum."""
    sets = hdf5.channels(file)
    for axis in dict.fromkeys(data.attrs["time"] for data in sets.values()):
        sets[axis].make_scale(axis)
    for name, data in sets.items():
        if data.attrs["time"] != name:
            data.dims[0].attach_scale(sets[data.attrs["time"]])
        for dimension, index in enumerate(index_names(name, data.ndim), 1):
            scale = file.create_dataset(index, data=np.arange(data.shape[dimension]))
            scale.make_scale(index)
            data.dims[dimension].attach_scale(scale)
    file.attrs["checksum"] = hdf5.digest(file)


def sealed(ending: str, size: int) -> bytes:
    """JSON of an end as in `ENDING`: after it a zero, and its checksum; `{}` where the space does not suffice."""
    data = ending.encode()
    if len(data) > size - 10:
        data = b"{}"
    return data + b"\0%08x\0" % zlib.crc32(data)


def _ending(data: bytes, version: int) -> dict[str, Any]:
    """What `sealed` wrote; nothing if it was not yet written."""
    text, sum_, *_ = [*data.split(b"\0", 2), b""]
    if version > 1 and (text or sum_) and sum_ != b"%08x" % zlib.crc32(text):
        raise ValueError("the checksum of how the run ended is wrong")
    found: dict[str, Any] = json.loads(text or b"{}")
    return found


def kind(metadata: Mapping[str, Any]) -> files.Kind:
    """What a recording with this metadata may replace: one that the same command made, or Python."""
    maker = _maker(metadata)
    return files.Kind("a recording" + (f" of {maker}" if maker else ""), lambda path: _ours(path, maker))


def _maker(metadata: Mapping[str, Any]) -> str:
    """The command that made a recording, such as "truestroke track"; "" for Python."""
    return " ".join(str(metadata.get("command", "")).split()[:2])


def _ours(path: Path, maker: str) -> bool:
    try:
        with hdf5.opened(path) as file:
            return bool(file.attrs["format"] == FORMAT and _maker(json.loads(file.attrs["metadata"])) == maker)
    except Exception:  # not one that can be read
        return False


def ticks(path: Path) -> int:
    """Entries of a recording that may have been interrupted; 1 where it cannot be read."""
    try:
        return len(Recording.load(path)["time"])
    except (files.FileError, OSError, KeyError):
        return 1


def _even(channels: dict[str, Channel]) -> dict[str, Channel]:
    """Channels of a file that is being written, cut to what all of the same time axis have."""
    ends: dict[str, int] = {}
    for channel in channels.values():
        ends[channel.time] = min(ends.get(channel.time, len(channel.data)), len(channel.data))
    return {name: dataclasses.replace(c, data=c.data[: ends[c.time]]) for name, c in channels.items()}


def versions() -> dict[str, str]:
    """What computed it: versions of truestroke, NumPy, Python, the platform, and the git commit in a checkout.

    Examples
    --------
    >>> sorted(versions().keys() - {"commit"})
    ['numpy', 'platform', 'python', 'truestroke']
    """
    commit = _commit()
    return {
        "truestroke": _version(),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        **({"commit": commit} if commit else {}),
    }


@functools.cache
def _version() -> str:
    """Of what is installed; to read it takes a tenth of a short run."""
    from importlib.metadata import version

    return version("truestroke")


@functools.cache
def _commit() -> str | None:
    """Commit of the checkout that this file is in, with "-dirty" where files differ from it; None elsewhere."""
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip() or None
    except (OSError, subprocess.SubprocessError):
        return None


def _json(value: Any, indent: int | None = None) -> str:
    try:
        return json.dumps(value, default=_plain, allow_nan=False, indent=indent)
    except (TypeError, ValueError) as error:
        raise SettingError("metadata", repr(value), f"numbers, text, lists and dicts ({error})") from None


def _plain(value: object) -> object:
    """A NumPy value, a mapping or a dataclass as a type of JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {one.name: getattr(value, one.name) for one in dataclasses.fields(value)}  # JSON asks for what is within
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a {type(value).__name__} is none of them")
