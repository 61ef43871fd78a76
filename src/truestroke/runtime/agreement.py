"""Before the first tick: trajectory, controller and actuator agree on sample rate, latency and arguments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.controller import Controller
from truestroke.control.repeating.repetition import check_repeats
from truestroke.control.repeating.repetitive import RepetitiveController
from truestroke.signals.timing import LONGEST_AGO, Timing
from truestroke.signals.trajectories import Trajectory

LATEST = 20  # ticks of latency that the design of a feedback may have


class Motion(Protocol):
    """A desired motion for check and metadata; a `Trajectory` is one."""

    @property
    def name(self) -> str:
        """What it is."""

    @property
    def sample_rate(self) -> float:
        """Ticks per second, Hz."""

    @property
    def settings(self) -> Mapping[str, object]:
        """What it was made from."""

    def __len__(self) -> int:
        """Ticks."""


def check_agreement(trajectory: Motion, controller: Controller, timing: Timing) -> None:
    """One sample rate, a period that the motion has, and measurements that can be placed; SettingError otherwise."""
    settings = getattr(controller, "settings", None)
    for whose, rate in (("actuator", timing.sample_rate), ("controller", getattr(settings, "sample_rate", None))):
        if rate is not None and rate != trajectory.sample_rate:
            raise SettingError(
                "trajectory.sample_rate", trajectory.sample_rate, f"{rate} Hz, that of the {whose}", "Hz"
            )
    _check_late("block - 1 + latency", timing.block - 1 + timing.latency, LONGEST_AGO)
    if isinstance(controller, RepetitiveController) and isinstance(trajectory, Trajectory):
        check_repeats(trajectory, controller.period)


def count_latency(controller: Any, timing: Timing) -> None:
    """The latency of the actuator in the design of the controller's feedback, if it has one; refused if too late."""
    settings: Any = getattr(controller, "settings", None)
    late = timing.latency + timing.block - 1
    if sensor := math.floor(getattr(settings, "sensor_delay", 0.0) * timing.sample_rate + 1e-9):
        _check_late("block - 1 + latency, and the ticks of sensor_delay", late + sensor, LONGEST_AGO)
    if getattr(settings, "dynamics", None) is not None and settings.latency != late and hasattr(controller, "change"):
        controller.change(latency=_check_late("block - 1 + latency", late, LATEST, " with dynamics"))


def _check_late(what: str, ticks: int, most: int, where: str = "") -> int:
    """How late a measurement is, ticks; SettingError where that is too late."""
    if ticks > most:
        bound = f"at most {most} ticks{where}, so that a measurement is of use: take a smaller block of the driver"
        raise SettingError(what, ticks, bound, "ticks")
    return ticks


def wanted(trajectory: Trajectory, controller: Any) -> list[FloatArray]:
    """The arguments of `command`, an array each: acceleration and strain, too, of a controller that uses them."""
    motion = [trajectory.position, trajectory.velocity]
    strain = controller.strain(trajectory.position) if hasattr(controller, "strain") else None
    if strain is not None:
        return [*motion, trajectory.acceleration, strain]
    settings = getattr(controller, "settings", None)
    used = getattr(settings, "inertia", False) is True or getattr(settings, "resonance", 0.0) > 0
    return [*motion, trajectory.acceleration] if used else motion
