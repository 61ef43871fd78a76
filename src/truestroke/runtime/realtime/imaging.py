"""The table [scan] of a configuration: two axes scan an area, and a signal of the driver is its image."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from truestroke.base import checks, frames, toml
from truestroke.base.checks import SettingError
from truestroke.control.repeating.repetition import SHORTEST
from truestroke.runtime.drivers.protocol import Driver, Signal
from truestroke.signals import scans
from truestroke.signals.scans.motions import LEAD_OUT
from truestroke.signals.scans.scan import Scan
from truestroke.signals.timing import LONGEST_AGO

LEAST = 2  # pixels of a row
SLOWER = {"raster": (3, "third"), "spiral": (2, "half"), "lissajous": (2, "half"), "cycloid": (2, "half")}
"""By how much the fast motion is slower than the first resonance: lines have harmonics, sines have none."""
SCANS = {kind: getattr(scans, kind) for kind in ("raster", "spiral", "lissajous", "cycloid")}


@dataclass(frozen=True, kw_only=True)
class ScanTable:
    """The table [scan] but for the keys of its motion: two axes take theirs from it.

    Attributes
    ----------
    kind : str
        "raster", "spiral", "lissajous" or "cycloid"; all other keys are those of that function of `truestroke.scans`.
    axes : tuple of str
        Names of the fast and the slow axis; by default the first two.
    signal : str or None
        Signal of the driver that is the image; by default its only one.
    columns : int
        Pixels of a row, at most as many as the ticks can fill (`scans.pixels_of`).
    """

    kind: Literal["raster", "spiral", "lissajous", "cycloid"] = "raster"
    axes: tuple[str, ...] = ()
    signal: str | None = None
    columns: int = 512


@dataclass(frozen=True, eq=False, kw_only=True)
class Imaging:
    """A scan that a configuration asks for.

    Attributes
    ----------
    scan : Scan
        As the sensors should read it.
    axes : tuple[str, str]
        Names of x and y.
    signal : Signal
        Of the image.
    columns : int
        Pixels of a row.
    notice : str
        A sentence where they are fewer than the configuration asks for; empty where they are not.
    frame : tuple of tuple of float, or None
        What the sensors read of the axes, where they are turned.
    """

    scan: Scan
    axes: tuple[str, str]
    signal: Signal
    columns: int
    notice: str = ""
    frame: frames.Matrix | None = None


def imaging(given: Mapping[str, Any], names: Sequence[str], driver: Driver, rate: float) -> Imaging:
    """What a table [scan] asks for, of axes of these `names`.

    Its ticks per second, Hz, are those of the driver; dynamics of `truestroke bode` are read already.

    Raises
    ------
    SettingError
        Names the key, its value, the bound and the unit.
    """
    own = tuple(field.name for field in dataclasses.fields(ScanTable))
    table = toml.decode(ScanTable, {key: entry for key, entry in given.items() if key in own})
    if len(names) < 2:
        raise SettingError("axes", list(names), "two axes, for a scan moves two: add a second table [[axis]]")
    moving = table.axes or tuple(names[:2])
    if len(moving) != 2 or len(set(moving)) < 2 or not set(moving) <= set(names):
        raise SettingError("axes", list(moving), f"two of the axes: {', '.join(names)}")
    usual = {"sample_rate": rate, "lead_out": max(_until_measured(driver) / rate, LEAD_OUT)}
    made: Scan = toml.decode(SCANS[table.kind], usual | dict(given), also=own)
    if made.sample_rate != rate:
        raise SettingError("sample_rate", made.sample_rate, f"{rate:g} Hz, that of the driver, or left out", "Hz")
    asked, paces = checks.count("columns", table.columns, LEAST, 10**5), _paces(made)
    for key, pace in paces.items():
        if pace * SHORTEST > rate * (1 + 1e-9):
            bound = f"at most {rate / SHORTEST:g} Hz, for {SHORTEST} ticks of {rate:g} Hz a period: {_slower(key)}, or "
            raise SettingError(key, pace, f"{bound}sample at {SHORTEST * pace:g} Hz or more", "Hz")
    if (columns := scans.pixels_of(made, asked)) < LEAST:
        most = f"so low that the ticks of a line at {rate:g} Hz fill {LEAST} pixels, not {columns}"
        key = next(iter(paces))
        raise SettingError(
            key, paces[key], f"{most}: scan slower, in more lines, with shorter turns, or sample faster", "Hz"
        )
    fewer = columns < asked and "columns" in given
    notice = (
        f"The image has {columns} columns, not {asked}: that is what the ticks of a line fill. "
        f"Scan slower, or at a higher sample rate than {rate:g} Hz."
    )
    return Imaging(
        scan=made,
        axes=(moving[0], moving[1]),
        signal=_signal(table.signal, driver),
        columns=columns,
        notice=notice if fewer else "",
    )


def check_stage(image: Imaging, resonances: Mapping[str, float]) -> None:
    """Refuse lines or turns that are too fast for the first resonance of an axis, Hz, by its name; 0 is not known.

    Raises
    ------
    SettingError
        Names the rate, the bound, the axis and its resonance, Hz.
    """
    times, part = SLOWER[image.scan.name]
    fast = image.axes[:1] if image.scan.name == "raster" else image.axes
    for key, pace in _paces(image.scan).items():
        for name in fast:
            first = resonances.get(name, 0.0)
            if first and pace * times > first * (1 + 1e-9):
                most = f"at most {first / times:.4g} Hz, a {part} of the first resonance of axis {name}, "
                most += f"{first:.4g} Hz: {_slower(key)}, or correct the resonance or dynamics of the axis"
                raise SettingError(key, pace, most, "Hz")


def _paces(scan: Scan) -> dict[str, float]:
    """The rates of lines or turns by their keys, Hz: of a spiral of constant linear velocity two."""
    keys = [key for key in ("rate", "rotation", "fastest") if key in scan.settings]
    return {key: float(scan.settings[key]) for key in keys}  # type: ignore[arg-type]


def _slower(key: str) -> str:
    """What makes this rate lower; the fastest turns are twice as fast as the outermost where nobody says how fast."""
    return "give `fastest`, for the turns in the middle" if key == "fastest" else "scan slower"


def _until_measured(driver: Driver) -> int:
    """Ticks until the last one of the image is measured: by the settings of the driver, or the longest there are."""
    settings = getattr(driver, "settings", None)
    latency, block = (getattr(settings, name, None) for name in ("latency", "block"))
    return latency + block if isinstance(latency, int) and isinstance(block, int) else LONGEST_AGO


def _signal(name: str | None, driver: Driver) -> Signal:
    """The signal of this name that the driver reads, or its only one."""
    there: dict[str, Signal] = {one.name: one for one in getattr(driver, "signals", ())}
    if not there:
        words = "one that the driver reads: it reads none; add a table [[driver.signals]], the input of the image"
        raise SettingError("signal", repr(name) if name else "missing", words)
    if (name is None and len(there) > 1) or (name is not None and name not in there):
        raise SettingError("signal", repr(name) if name else "missing", f"one of {', '.join(there)}")
    return there[name] if name else next(iter(there.values()))
