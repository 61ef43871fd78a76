"""Frames of several axes: what sensors that are turned against the axes of a stage read of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray

LEAST = 0.05  # of the largest singular value: sensors that are less independent do not measure all axes

Matrix = tuple[tuple[float, ...], ...]


def sensor_frame(rotation: float, skew: float = 0.0) -> Matrix:
    """The frame of two sensors that are turned against the axes of the stage.

    ::

        s_x = cos(r) x - sin(r) y,    s_y = sin(r + k) x + cos(r + k) y

    Parameters
    ----------
    rotation : float
        r, degrees: from the axis x to the sensor of x, against the direction from x to y.
    skew : float
        k, degrees: by how much the angle between the sensors is above 90.

    Returns
    -------
    tuple of tuple of float, shape (2, 2)
        Row i: what sensor i reads of a um of each axis, 1.

    Examples
    --------
    >>> np.round(sensor_frame(30.0), 3).tolist()
    [[0.866, -0.5], [0.5, 0.866]]
    """
    r = math.radians(checks.within("rotation", rotation, -360.0, 360.0, "degrees"))
    of_y = r + math.radians(checks.within("skew", skew, -80.0, 80.0, "degrees"))
    return (math.cos(r), -math.sin(r)), (math.sin(of_y), math.cos(of_y))


def described(frame: Matrix) -> str:
    """How two sensors stand, in degrees and mrad: an angle that was meant in the other unit is seen. "" for three.

    Examples
    --------
    >>> print(described(sensor_frame(0.17)))
    The sensors are turned by 0.17 degrees (2.97 mrad).
    >>> print(described(sensor_frame(90.0, -0.5)))
    The sensors are turned by 90 degrees (1570 mrad), and 89.5 degrees apart.
    """
    if len(frame) != 2:
        return ""
    rotation, of_y = math.atan2(-frame[0][1], frame[0][0]), math.atan2(frame[1][0], frame[1][1])
    apart = 90.0 + math.degrees(math.remainder(of_y - rotation, math.tau))
    turned = f"The sensors are turned by {math.degrees(rotation):.3g} degrees ({figures(1e3 * rotation)} mrad)"
    return f"{turned}." if math.isclose(apart, 90.0, abs_tol=1e-9) else f"{turned}, and {apart:.4g} degrees apart."


def matrix(argument: str, value: npt.ArrayLike, axes: int, unit: str = "") -> FloatArray:
    """A matrix of finite numbers with a row and a column for each axis."""
    found = checks.finite_array(argument, value, unit, 2)
    if found.shape != (axes, axes):
        raise SettingError(argument, f"array of shape {found.shape}", f"of shape ({axes}, {axes})", unit)
    return found


def turn(by: FloatArray, values: FloatArray) -> FloatArray:
    """by @ values, summed in the order of the axes, as the loops in C and Python do it: the same bits.

    Examples
    --------
    >>> turn(np.array([[0.0, 2.0], [1.0, 0.0]]), np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])).tolist()
    [[8.0, 10.0, 12.0], [1.0, 2.0, 3.0]]
    """
    total = np.zeros(values.shape)
    for column, row in zip(by.T, values, strict=True):
        total += column[:, np.newaxis] * row
    return total


def rows(found: FloatArray) -> Matrix:
    """As tuples of plain numbers."""
    return tuple(tuple(row) for row in found.tolist())


def frame(argument: str, value: Any, axes: int) -> Matrix:
    """What the sensors read of the axes, which must follow from it; None is a sensor along each axis.

    Examples
    --------
    >>> frame("frame", [[1.0, 1.0], [1.0, 1.01]], 2)
    Traceback (most recent call last):
        ...
    truestroke.SettingError: frame = [[1.0, 1.0], [1.0, 1.01]]: must be a matrix whose smallest singular value is at \
least 0.05 of the largest, not 0.0025: the sensors read almost the same
    """
    found = np.eye(axes) if value is None else matrix(argument, value, axes)
    values = np.linalg.svd(found, compute_uv=False)
    if not values[-1] >= LEAST * values[0] or not 1e-6 <= values[0] <= 1e6:
        ratio = float(values[-1] / values[0]) if values[0] else 0.0
        words = f"a matrix whose smallest singular value is at least {LEAST:g} of the largest, not {ratio:.2g}"
        raise SettingError(argument, found.tolist(), f"{words}: the sensors read almost the same")
    return rows(found)
