"""Axes that know how the others move, in the loop in real time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.axes import MultiAxisController
from truestroke.control.controller import AdaptiveController
from truestroke.control.settings import ControllerSettings
from truestroke.runtime.realtime.settings import Axis
from truestroke.signals.trajectories import Trajectory


def couple(
    axes: Sequence[Axis], frame: npt.ArrayLike | None = None, *, period: float | None = None
) -> tuple[Axis, ...]:
    """The same axes, each with a controller that learns what the motion of the others does to it.

    Parameters
    ----------
    axes : sequence of Axis
        Two or three, with trajectories of one length as the sensors should read them, and adaptive controllers, whose
        settings are taken.
    frame : array_like, shape (axes, axes), optional
        What the sensors read of the axes, as of `MultiAxisController`; the driver is then a `Turned` one.
    period : float, optional
        Of what repeats on one of them, s, as of `MultiAxisController`: all axes learn it.

    Returns
    -------
    tuple of Axis
        In the frame of the axes.

    Raises
    ------
    SettingError
        A motion is a set-point, a controller is not adaptive, or they do not fit together.
    """
    settings: dict[str, ControllerSettings] = {}
    motions: dict[str, Trajectory] = {}
    for axis in axes:
        if not isinstance(axis.trajectory, Trajectory):
            words = "a trajectory that is known ahead where axes are coupled: the others have to know it"
            raise SettingError(f"trajectory of axis {axis.name}", "a set-point", words)
        if not isinstance(axis.controller, AdaptiveController) or axis.controller.settings.law != "kalman":
            raise SettingError(f"controller of axis {axis.name}", "another", '"adaptive" where axes are coupled')
        if period is not None and axis.controller.settings.dynamics is None:
            words = 'given where axes learn a period: settings = {dynamics = "FILE"}, a file of truestroke bode'
            raise SettingError(f"dynamics of axis {axis.name}", None, words)
        settings[axis.name], motions[axis.name] = axis.controller.settings, axis.trajectory
    checks.distinct("name", [axis.name for axis in axes], "axis")
    together = MultiAxisController(settings, frame, period=period)
    known, width = together.prepare(motions), 3 * (len(axes) - 1)
    return tuple(
        dataclasses.replace(
            axis,
            controller=together.axes[axis.name],
            trajectory=known.axes[axis.name],
            others=known.others[:, width * i : width * (i + 1)],
            learned=together.learned.get(axis.name),
        )
        for i, axis in enumerate(axes)
    )
