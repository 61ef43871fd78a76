"""From a desired displacement to a voltage waveform, and where it falls short."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, files
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.control import actuator, reach
from truestroke.control.actuator import ActuatorModel
from truestroke.control.settings import UNLIMITED
from truestroke.control.spans import Beyond, Span
from truestroke.model.sampled import REST
from truestroke.signals import metrics
from truestroke.signals.channels import Sampled

GOOD = Verdict("good")
SAID = "# "  # begins a line behind the rows of a waveform: no number, and nothing to who knows comments
TAIL = 1 << 16  # bytes at the end of a file that hold all reasons

Passes = tuple[tuple[FloatArray, FloatArray], ...]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Waveform(Sampled):
    """A waveform as its file has it.

    Attributes
    ----------
    sample_rate : float
        Hz.
    volts : ndarray, shape (samples,)
        V.
    desired : ndarray, shape (samples,)
        Displacement as the sensor reads it, um.
    passes : tuple of (ndarray, ndarray), each of shape (samples,)
        Voltage, V, and measurement, um, of the passes of this motion before it; `refine` learns from them.
    verdict : Verdict
        Whether it makes the motion, as far as its model or its passes show; docs/exit-codes.md has the thresholds. Good
        is also one whose file says nothing against it.
    """

    sample_rate: float
    volts: FloatArray
    desired: FloatArray
    passes: Passes = ()
    verdict: Verdict = GOOD


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PredictedWaveform(Waveform):
    """A voltage for playback, and its prediction by the model.

    Attributes
    ----------
    predicted : ndarray, shape (samples,)
        Displacement as the sensor reads it, um.
    out_of_reach : tuple[Span, ...]
        Where a voltage limit bounds it; `worst` is the largest error there, um.
    too_fast : tuple[Span, ...]
        The same of the slew limit.
    beyond : Beyond
        Spans in which the prediction is beyond the record of the model.
    """

    predicted: FloatArray
    out_of_reach: tuple[Span, ...]
    too_fast: tuple[Span, ...]
    beyond: Beyond

    @property
    def rmse(self) -> float:
        """Of the predicted displacement against the desired one, um."""
        return metrics.rmse(self.desired, self.predicted)

    @property
    def maximum(self) -> float:
        """Largest magnitude of the same error, um."""
        return metrics.maximum_error(self.desired, self.predicted)

    @property
    def warnings(self) -> tuple[str, ...]:
        """In words, where it cannot follow or extrapolates."""
        return *reach.Held(self.out_of_reach, self.too_fast).warnings, *self.beyond.warnings


def waveform(
    model: ActuatorModel,
    displacement: npt.ArrayLike,
    sample_rate: float,
    *,
    velocity: npt.ArrayLike | None = None,
    voltage_limits: tuple[float, float] | None = None,
    slew_limit: float = UNLIMITED,
    offset: float = 0.0,
    rest: float = REST,
) -> PredictedWaveform:
    """The voltage that makes a displacement, and where it does not.

    Parameters
    ----------
    model : ActuatorModel
        Of the actuator.
    displacement, sample_rate, velocity, voltage_limits, slew_limit
        As in `ActuatorModel.invert`.
    offset : float
        By how much the sensor's zero is above that of the record of the model, um: `score` estimates it from a
        recording of this day.
    rest : float
        Time under the first voltage before the waveform, s, from rest at 0 V: creep that is slower goes on. By default
        that of `playback`; infinity is a rest in which creep has ended.

    Raises
    ------
    SettingError
        An argument is out of bounds, or the arrays differ in length.

    Examples
    --------
    >>> model = ActuatorModel(
    ...     thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.eye(3), stroke=20.0,
    ...     voltage_range=(0.0, 2.0), velocity=50.0,
    ... )
    >>> made = waveform(model, [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 24.0], sample_rate=10.0)
    >>> made.volts[-3:], round(made.rmse, 3)
    (array([2., 2., 2.]), 2.0)
    >>> made.warnings
    ('out of reach: a voltage limit bounds it, once, 0.600 to 0.800 s, off by at most 4 um',)
    >>> made.verdict.level
    'bad'
    """
    checks.instance("model", model, ActuatorModel, actuator.EXPECTED)
    desired = checks.finite_array("displacement", displacement, "um")
    if desired.size < 2:
        raise SettingError("displacement", f"array of {desired.size} samples", "at least two samples", "um")
    limits = model.voltage_range if voltage_limits is None else voltage_limits
    asked: dict[str, Any] = {"voltage_limits": limits, "slew_limit": slew_limit, "offset": offset, "rest": rest}
    volts = model.invert(desired, sample_rate, velocity=velocity, warn=False, **asked)
    predicted = model.forward(volts, sample_rate, offset=offset, rest=rest)
    return described(model, volts, desired, predicted, float(sample_rate), limits, slew_limit)


def described(
    model: ActuatorModel,
    volts: FloatArray,
    desired: FloatArray,
    predicted: FloatArray,
    sample_rate: float,
    limits: tuple[float, float],
    slew_limit: float,
    passes: Passes = (),
) -> PredictedWaveform:
    """A voltage with its prediction, and where it falls short; arguments as of `waveform` and its result."""
    made = reach.Made(
        volts=volts,
        desired=desired,
        predicted=predicted,
        sample_rate=sample_rate,
        voltage_limits=(float(limits[0]), float(limits[1])),
        slew_limit=slew_limit,
    )
    held, beyond = made.held_back(model), model.beyond(volts, sample_rate, measured=False)
    return PredictedWaveform(
        sample_rate=sample_rate,
        volts=volts,
        desired=desired,
        predicted=predicted,
        passes=passes,
        out_of_reach=held.out_of_reach,
        too_fast=held.too_fast,
        beyond=beyond,
        verdict=reach.judged(model, made, held, beyond, measured=bool(passes)),
    )


def save_waveform(path: str | os.PathLike[str], made: PredictedWaveform) -> None:
    """Write time, voltage, desired displacement and the passes before to a CSV file, or to NPZ where the name ends so.

    A verdict that is not good is written, too: in comments behind the last row, or as arrays.

    Raises
    ------
    SettingError
        The name ends in neither.
    FileExistsError
        A file is there that is no waveform; within `files.overwriting` it is replaced.
    """
    words = "a PredictedWaveform, as truestroke.waveform gives; the order is path, waveform"
    checks.instance("made", made, PredictedWaveform, words)
    kind = checks.path("path", path).suffix
    said = {} if made.verdict.level == "good" else made.verdict.entries
    if kind == ".npz":
        with files.writing(path, files.WAVEFORM) as draft:
            signals: dict[str, Any] = {"volts": made.volts, "desired": made.desired, "predicted": made.predicted}
            for k, one in enumerate(made.passes, 1):
                signals |= {name.split(" (")[0]: x for name, x in zip(_names(k), one, strict=True)}
            np.savez(draft, time=made.time, **signals | said)
    elif kind == ".csv":
        rows = np.column_stack([made.time, made.volts, made.desired, *(x for one in made.passes for x in one)])
        header = ",".join([files.WAVEFORM_HEADER, *(name for k in range(len(made.passes)) for name in _names(k + 1))])
        footer = "\n".join(f"{SAID}{name} = {' '.join(words.split())}" for name, words in said.items())
        text: dict[str, Any] = {"delimiter": ",", "header": header, "footer": footer, "comments": ""}
        with files.writing(path, files.WAVEFORM) as draft:
            np.savetxt(draft, rows, fmt="%.12g", encoding="utf-8", **text)
    else:
        raise SettingError("path", os.fspath(path), "a name that ends in .csv or .npz")


def load_waveform(path: str | os.PathLike[str]) -> Waveform:
    """Read a waveform that `save_waveform` wrote.

    Raises
    ------
    RecordError
        It has no columns `volts` and `desired`, or a row that cannot be used.
    """
    from truestroke.identification.records.record import read_record

    file = checks.path("path", path)
    read = read_record(file, volts="volts", displacement="desired", time="time")
    return Waveform(
        sample_rate=read.sample_rate,
        volts=read.volts,
        desired=read.displacement,
        passes=_passes(file, read.volts.size),
        verdict=verdict_of(file),
    )


def verdict_of(path: Path) -> Verdict:
    """That of the file of a waveform; good where it says nothing against it, as one of another program."""
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return Verdict.named({name: str(arrays[name]) for name in arrays.files if arrays[name].dtype.kind == "U"})
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - TAIL))
        lines = file.read().decode("utf-8", "replace").splitlines()
    comments = (line.removeprefix(SAID).partition(" = ") for line in lines if line.startswith(SAID))
    return Verdict.named({name: words.rstrip(",;\t ") for name, _, words in comments})  # of cells that are empty


def _names(number: int) -> tuple[str, str]:
    """Headings of a pass."""
    return files.PASS_VOLTS.format(number), files.PASS_MEASURED.format(number)


def _passes(path: Path, samples: int) -> Passes:
    """Those in the file of a waveform."""
    from truestroke.signals import tables

    table = tables.open_table(path)
    places = {name.lower(): i for i, name in enumerate(table.names)}
    found: list[tuple[FloatArray, FloatArray]] = []
    while all(name.split(" (")[0] in places for name in _names(len(found) + 1)):
        x, z = table.read([places[name.split(" (")[0]] for name in _names(len(found) + 1)], True)
        if x.size != samples or not (np.isfinite(x).all() and np.isfinite(z).all()):
            raise tables.RecordError(str(path), f"pass {len(found) + 1} has a row without a finite number")
        found.append((x, z))
    return tuple(found)
