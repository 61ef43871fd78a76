"""Stages of pymmcore-plus: planes and fields where they should be, for `UniMMCore` (extra `pymmcore`)."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any, ClassVar

from truestroke.base import checks
from truestroke.dropins import needed
from truestroke.dropins.axes import Axes

with needed("pymmcore-plus", "pymmcore"):
    from pymmcore_plus.experimental.unicore import StageDevice, XYStageDevice

CONFIG = "Configuration"
POLL = 0.01  # s that `busy` waits for the end of a move: shorter than the host waits before it asks again


class _Opened:
    """The axes of each configuration: its devices share them, and the last one that leaves closes them."""

    _lock = threading.Lock()
    axes: ClassVar[dict[Path, tuple[Axes, int]]] = {}

    @classmethod
    def enter(cls, path: Path) -> Axes:
        with cls._lock:
            axes, users = cls.axes.get(path, (None, 0))
            if axes is None:
                axes = Axes.of(path)
                axes.open()
            cls.axes[path] = axes, users + 1
            return axes

    @classmethod
    def leave(cls, path: Path) -> None:
        with cls._lock:
            axes, users = cls.axes.pop(path)
            if users > 1:
                cls.axes[path] = axes, users - 1
            else:
                axes.close()


def opened(path: str | os.PathLike[str]) -> Axes:
    """The axes of a configuration that a stage has opened, for what a host does not ask for: voltages, last motions.

    Raises
    ------
    LookupError
        No stage has opened it.
    """
    axes, _ = _Opened.axes.get(_place(path), (None, 0))
    if axes is None:
        raise LookupError(f"{os.fspath(path)}: no stage that is initialized has this configuration")
    return axes


def _place(path: str | os.PathLike[str]) -> Path:
    return Path(path).expanduser().resolve()


class _Piezo:
    """What both kinds of stages have: the axes of a configuration, an origin for each, the end of a move."""

    get_label: Any
    register_property: Any
    get_property_value: Any

    def _register(self, path: str, names: dict[str, str]) -> None:
        self._path: Path | None = None
        self._failed = "not initialized, or could not be: see the log above"
        self._begun: list[Any] = []
        self._origin = dict.fromkeys(names, 0.0)
        self.register_property(CONFIG, default_value=path, is_pre_init=True)
        for role, name in names.items():
            self.register_property(role, default_value=name, is_pre_init=True)

    def initialize(self) -> None:
        """Open the axes: the outputs go from the safe voltage to 0 um."""
        self._names = {role: self.get_property_value(role) for role in self._origin}
        path = _place(self.get_property_value(CONFIG))
        try:
            self._axes, self._path = _Opened.enter(path), path
            for name in self._names.values():
                self._axes.at(name)  # an error now, if there is no such axis
        except Exception as error:
            self._failed = f"not initialized: {error}"  # for who finds no device later: the host logs it and goes on
            raise
        for role, name in self._names.items():
            show = {"is_read_only": True, "property_type": float}
            self.register_property(f"{role} volts", getter=lambda _, n=name: self._axes.volts(n), **show)

    def shutdown(self) -> None:
        """Let go of the axes: the last stage of a configuration leaves the outputs at the safe voltages."""
        path, self._path = self._path, None
        if path is not None:
            _Opened.leave(path)

    def busy(self) -> bool:
        """Whether it moves; waits for the end of a move up to 10 ms, for most moves end within."""
        return any(not _ended(one) for one in self._begun)

    def _where(self, role: str) -> float:
        return self._opened().reading(self._names[role]) - self._origin[role]

    def _go(self, **targets: float) -> None:
        """Begin to move, after the end of the move before."""
        axes = self._opened()
        for one in self._begun:
            one.exception()
        wanted = {role: checks.number(f"target of axis {self._names[role]}", to, "um") for role, to in targets.items()}
        places = {self._names[role]: target + self._origin[role] for role, target in wanted.items()}
        self._begun = list(axes.move(**places).values())

    def _set_origin(self, role: str, reads: float = 0.0) -> None:
        self._origin[role] = self._opened().at(self._names[role]) - reads

    def _opened(self) -> Axes:
        if self._path is None:
            raise RuntimeError(f"Device {self.get_label()!r} is {self._failed}")
        return self._axes

    def stop(self) -> None:
        """Bring the axes to rest on their way, without ringing; `busy` until then."""
        axes = self._opened()
        for name in self._names.values():
            axes.stop(name)


def _ended(future: Any) -> bool:
    """Whether a move has ended; its error, if it ended by one."""
    try:
        future.result(timeout=POLL)
    except TimeoutError:
        return False
    return True


class PiezoZ(_Piezo, StageDevice):  # type: ignore[misc]
    """One piezo axis as a focus drive: each plane is reached without ringing, and held.

    Its properties "Configuration" (a file as of `truestroke run`, of which driver and axes are used) and "Axis" (a
    name in it) are set before it is initialised. Positions are um, from 0 to the stroke of the axis, or on
    both sides of 0 where its voltages are.

    Parameters
    ----------
    path, axis : str
        Defaults of the two.

    Examples
    --------
    >>> stage = PiezoZ("stage.toml")
    >>> stage.get_property_value("Axis")
    'z'
    """

    def __init__(self, path: str = "stage.toml", axis: str = "z") -> None:
        super().__init__()
        self._register(path, {"Axis": axis})

    def set_position_um(self, val: float) -> None:
        """Move, um; returns when the move has begun."""
        self._go(Axis=val)
        self.core.events.stagePositionChanged.emit(self.get_label(), val)

    def get_position_um(self) -> float:
        """What the sensor reads, um; without a sensor, where the axis should be."""
        return self._where("Axis")

    def set_origin(self) -> None:
        """Call the present position 0 um."""
        self._set_origin("Axis")

    def set_adapter_origin_um(self, newZUm: float) -> None:
        """Call the present position `newZUm`, um."""
        self._set_origin("Axis", newZUm)

    def home(self) -> None:
        """Move to 0 um."""
        self._go(Axis=-self._origin["Axis"])


class PiezoXY(_Piezo, XYStageDevice):  # type: ignore[misc]
    """Two piezo axes as an XY stage; properties "Configuration", "Axis X" and "Axis Y", as of `PiezoZ`.

    Parameters
    ----------
    path, x, y : str
        Defaults of the three.

    Examples
    --------
    >>> stage = PiezoXY("stage.toml")
    >>> stage.get_property_value("Axis Y")
    'y'
    """

    def __init__(self, path: str = "stage.toml", x: str = "x", y: str = "y") -> None:
        super().__init__()
        self._register(path, {"Axis X": x, "Axis Y": y})

    def set_position_um(self, x: float, y: float) -> None:
        """Move both axes, um; returns when the moves have begun."""
        self._go(**{"Axis X": x, "Axis Y": y})
        self.core.events.XYStagePositionChanged.emit(self.get_label(), x, y)

    def get_position_um(self) -> tuple[float, float]:
        """What the sensors read, um; without them, where the axes should be."""
        return self._where("Axis X"), self._where("Axis Y")

    def set_origin_x(self) -> None:
        """Call the present x 0 um."""
        self._set_origin("Axis X")

    def set_origin_y(self) -> None:
        """Call the present y 0 um."""
        self._set_origin("Axis Y")

    def set_adapter_origin_um(self, x: float, y: float) -> None:
        """Call the present position x, y, um."""
        self._set_origin("Axis X", x)
        self._set_origin("Axis Y", y)

    def home(self) -> None:
        """Move both to 0 um."""
        self._go(**{role: -origin for role, origin in self._origin.items()})
