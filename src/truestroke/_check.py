"""Checks of arguments: an error names the argument, its value, the bound and the unit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke._typing import FloatArray


class SettingError(ValueError):
    """An argument outside its bounds.

    Attributes
    ----------
    argument : str
        Name of the argument.
    value : object
        What was given.
    bound : str
        What is allowed, in words.
    unit : str
        Unit of value and bound; empty for a pure number.
    """

    def __init__(self, argument: str, value: object, bound: str, unit: str = "") -> None:
        self.argument, self.value, self.bound, self.unit = argument, value, bound, unit
        super().__init__(f"{argument} = {value}{' ' + unit if unit else ''}: must be {bound}")


def number(argument: str, value: object, unit: str = "") -> float:
    """A finite number as a float."""
    try:
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise SettingError(argument, repr(value), "a number", unit) from None
    if not math.isfinite(result):
        raise SettingError(argument, value, "finite", unit)
    return result


def positive(argument: str, value: object, unit: str = "") -> float:
    """A finite number above zero."""
    result = number(argument, value, unit)
    if result <= 0:
        raise SettingError(argument, value, f"above 0{' ' + unit if unit else ''}", unit)
    return result


def within(argument: str, value: object, low: float, high: float, unit: str = "") -> float:
    """A finite number in the closed interval [low, high]."""
    result = number(argument, value, unit)
    if not low <= result <= high:
        raise SettingError(argument, value, f"from {low:g} to {high:g}{' ' + unit if unit else ''}", unit)
    return result


def count(argument: str, value: object, low: int, high: int) -> int:
    """A whole number in the closed interval [low, high]."""
    whole = isinstance(value, (int, np.integer))  # a float does not hold all of them beyond 2^53
    result: Any = value if whole else number(argument, value)
    if result != int(result) or not low <= result <= high:
        raise SettingError(argument, value, f"a whole number from {low} to {high}")
    return int(result)


def interval(argument: str, value: Any, unit: str = "") -> tuple[float, float]:
    """Two finite numbers, the first below the second."""
    try:
        first, second = value
    except (TypeError, ValueError):
        raise SettingError(argument, repr(value), "a pair (low, high)", unit) from None
    low, high = number(argument, first, unit), number(argument, second, unit)
    if not low < high:
        raise SettingError(argument, value, "a pair (low, high) with low below high", unit)
    return low, high


def ascending(argument: str, value: Sequence[float], unit: str = "") -> tuple[float, ...]:
    """Finite numbers that start at 0 and ascend, as thresholds do."""
    result = tuple(number(argument, entry, unit) for entry in value)
    if not result or result[0] != 0 or any(b <= a for a, b in itertools.pairwise(result)):
        raise SettingError(argument, value, "numbers that start at 0 and ascend", unit)
    return result


def finite_array(argument: str, value: npt.ArrayLike, unit: str = "", ndim: int = 1) -> FloatArray:
    """An array of finite numbers with `ndim` axes."""
    try:
        result = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise SettingError(argument, repr(value), "an array of numbers", unit) from None
    if result.ndim != ndim:
        raise SettingError(argument, f"array of shape {result.shape}", f"an array with {ndim} axis", unit)
    bad = np.flatnonzero(~np.isfinite(result))
    if bad.size:
        raise SettingError(f"{argument}[{bad[0]}]", result.flat[bad[0]], "finite", unit)
    return result
