"""Checks of arguments: an error names the argument, its value, the bound and the unit."""

import difflib
import inspect
import itertools
import math
import os
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import FloatArray

T = TypeVar("T")
ALIKE = 0.65  # of two names, by difflib: width is no pitch
LONG = 15  # letters of a number that is shown as it is


class SettingError(TruestrokeError, ValueError):
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
        shown = str(value).partition("\n")[0]  # an object may show itself on a screen
        if isinstance(value, float) and len(shown) > LONG:  # the last digits of 3 * 0.3 are of its rounding
            shown = f"{value:.12g}"
        super().__init__(f"{argument} = {shown}{' ' + unit if unit else ''}: must be {bound}")


@contextmanager
def inside(where: str, names: Mapping[str, str] = types.MappingProxyType({})) -> Iterator[None]:
    """Name what is wrong within it by its whole path: `where` before the argument, or before what `names` call it.

    >>> with inside("axis.", {"slew_limit": "slew"}):
    ...     positive("slew_limit", -1.0, "V/s")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: axis.slew = -1.0 V/s: must be above 0 V/s
    """
    try:
        yield
    except SettingError as error:
        argument = names.get(error.argument, error.argument)
        raise SettingError(where + argument, error.value, error.bound, error.unit) from None


def known(
    given: Mapping[str, Any], names: Iterable[str], elsewhere: Mapping[str, str] = types.MappingProxyType({})
) -> None:
    """Only names that exist; for another one the error suggests the nearest, or says where `elsewhere` it belongs.

    >>> known({"forgeting": 0.9}, ("prior_return_time", "forgetting"))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: forgeting = 0.9: must be left out; did you mean forgetting? There are prior_return_time, \
forgetting
    >>> known({"width": 6.0}, ("pitch",))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: width = 6.0: must be left out; there are pitch
    >>> known({"stroke": 30.0}, ("file",), {"stroke": "in [[axis]]"})
    Traceback (most recent call last):
        ...
    truestroke.SettingError: stroke = 30.0: must be in [[axis]]
    """
    names = tuple(names)
    for name, value in given.items():
        if name in names:
            continue
        bound = elsewhere.get(name)
        if bound is None:
            close = difflib.get_close_matches(str(name), names, 1, ALIKE)
            words = f"did you mean {close[0]}? There" if close else "there"
            bound = f"left out; {words} are {', '.join(names) or 'none'}"
        raise SettingError(str(name), tabled(value), bound)


def tabled(value: Any) -> str:
    """A value of a file in an error: of tables only that they are.

    >>> tabled({"name": "x"}), tabled([{"name": "x"}]), tabled(30.0)
    ('a table', 'tables', '30.0')
    """
    if isinstance(value, list) and value and all(isinstance(one, Mapping) for one in value):
        return "tables"
    return "a table" if isinstance(value, Mapping) else repr(value)


def number(argument: str, value: object, unit: str = "") -> float:
    """A finite number as a float; a string is none, nor is a truth value."""
    try:
        if isinstance(value, (str, bytes, bool, np.bool_)):
            raise TypeError
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise SettingError(argument, described(value), "a number", unit) from None
    if not math.isfinite(result):
        raise SettingError(argument, value, "finite", unit)
    return result


def positive(argument: str, value: object, unit: str = "") -> float:
    """A finite number above zero."""
    result = number(argument, value, unit)
    if result <= 0:
        raise SettingError(argument, value, f"above 0{' ' + unit if unit else ''}", unit)
    return result


def sized(argument: str, value: object, unit: str = "", least: float = 1e-15, most: float = 1e15) -> float:
    """A number above zero of a size that computes: squares and quotients of such numbers are finite.

    >>> sized("prior_return_time", 1e300, "s")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: prior_return_time = 1e+300 s: must be from 1e-15 to 1e+15 s
    """
    return within(argument, positive(argument, value, unit), least, most, unit)


def within(argument: str, value: object, low: float, high: float, unit: str = "") -> float:
    """A finite number in the closed interval [low, high]."""
    result = number(argument, value, unit)
    if not low <= result <= high:
        raise SettingError(argument, value, f"from {low:g} to {high:g}{' ' + unit if unit else ''}", unit)
    return result


def instance(argument: str, value: Any, kind: type[T] | tuple[type[T], ...], words: str) -> T:
    """A value of this class, or of one of these; `words` describe it and how to make one.

    >>> instance("settings", {"noise": 0.0}, slice, "a slice, such as slice(3)")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: settings = {'noise': 0.0}: must be a slice, such as slice(3)
    """
    if not isinstance(value, kind):
        raise SettingError(argument, described(value), words)
    return value


def able(argument: str, value: Any, methods: Sequence[str], words: str) -> None:
    """An object that has these methods; a class is none, but can be called where that is asked.

    >>> able("actuator", [1.0], ("open", "exchange"), "an actuator")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: actuator = [1.0]: must be an actuator; it has no open(), no exchange()
    """
    missing = [name for name in methods if not callable(getattr(value, name, None))]
    if isinstance(value, type) and "__call__" not in methods:
        raise SettingError(argument, described(value), f"{words}; call the class to make one")
    if missing:
        lack = f"; it has {', '.join(f'no {name}()' for name in missing)}" if "__call__" not in methods else ""
        raise SettingError(argument, described(value), words + lack)


def takes(argument: str, method: Callable[..., Any], *examples: Any, form: str) -> None:
    """A method that can be called with such values; `form` says how it is written. One without a signature passes.

    >>> takes("controller.adapt", lambda z: None, 0.0, 0, form="adapt(z_measured, ago=0)")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: controller.adapt = adapt(z): must be callable as adapt(z_measured, ago=0)
    """
    try:
        signature = inspect.signature(method)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*examples)
    except TypeError:
        given = f"{argument.rpartition('.')[2]}({', '.join(signature.parameters)})"
        raise SettingError(argument, given, f"callable as {form}") from None


def path(argument: str, value: Any) -> Path:
    """A path of a file.

    >>> path("path", 3)
    Traceback (most recent call last):
        ...
    truestroke.SettingError: path = 3: must be the path of a file, such as "run.h5"
    """
    if not isinstance(value, (str, os.PathLike)):
        raise SettingError(argument, described(value), 'the path of a file, such as "run.h5"')
    return Path(value)


def described(value: Any) -> str:
    """A value of a wrong type: itself where that is short, else what it is."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape}"
    text = repr(value)
    short = len(text) <= 60 and " at 0x" not in text and "\n" not in text
    return text if short else f"object of class {type(value).__name__}"


def one_of(argument: str, value: object, choices: Sequence[str]) -> str:
    """One of these words."""
    if not isinstance(value, str) or value not in choices:
        raise SettingError(argument, repr(value), " or ".join(map(repr, choices)))
    return value


def distinct(argument: str, names: Sequence[str], each: str) -> None:
    """A name of its own for each of these.

    >>> distinct("name", ["x", "y", "x"], "axis")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: name = x, y, x: must be different for each axis
    """
    if len(set(names)) < len(names):
        raise SettingError(argument, ", ".join(names), f"different for each {each}")


def flag(argument: str, value: object) -> bool:
    """True or false; 1 and 0 are."""
    if not isinstance(value, (bool, np.bool_, int)) or value not in (0, 1):
        raise SettingError(argument, repr(value), "True or False")
    return bool(value)


def several(argument: str, value: Any, unit: str = "", of: str = "numbers") -> tuple[Any, ...]:
    """The entries of a sequence, of any kind."""
    try:
        return tuple(value)
    except TypeError:
        raise SettingError(argument, described(value), f"a sequence of {of}", unit) from None


def count(argument: str, value: object, low: int, high: int) -> int:
    """A whole number in the closed interval [low, high]."""
    # a float does not hold all of them beyond 2^53
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    result: Any = value if whole else number(argument, value)
    if result != int(result) or not low <= result <= high:
        raise SettingError(argument, value, f"a whole number from {low} to {high}" if low < high else str(low))
    return int(result)


def measurement(z_measured: object, ago: object) -> tuple[float, int]:
    """A displacement, um, which may be NaN or infinite, and how many commands ago; both as numbers, of any size.

    >>> measurement(1, 0)
    (1.0, 0)
    >>> measurement(1.0, "3")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: ago = '3': must be a number
    """
    if type(z_measured) is float and type(ago) is int:  # of a loop, in every tick
        return z_measured, ago
    if not isinstance(z_measured, (float, np.floating)):
        z_measured = number("z_measured", z_measured, "um")
    whole = isinstance(ago, (int, np.integer))
    if not whole and number("ago", ago) % 1:
        raise SettingError("ago", ago, "a whole number from 0 to 1023")
    return float(z_measured), int(ago)  # type: ignore[call-overload]


def interval(argument: str, value: Any, unit: str = "") -> tuple[float, float]:
    """Two finite numbers, the first below the second."""
    try:
        first, second = value
    except (TypeError, ValueError):
        raise SettingError(argument, described(value), "a pair (low, high)", unit) from None
    low, high = number(argument, first, unit), number(argument, second, unit)
    if not low < high:
        raise SettingError(argument, value, "a pair (low, high) with low below high", unit)
    return low, high


def ascending(argument: str, value: Sequence[float], unit: str = "") -> tuple[float, ...]:
    """Finite numbers that start at 0 and ascend, as thresholds do."""
    result = tuple(number(argument, entry, unit) for entry in several(argument, value, unit))
    if not result or result[0] != 0 or any(b <= a for a, b in itertools.pairwise(result)):
        raise SettingError(argument, value, "numbers that start at 0 and ascend", unit)
    return result


def beyond_reach(argument: str, z: float, volts: float, reach: float, stroke: float) -> SettingError:
    """The error of a displacement that an actuator under `volts` cannot have."""
    where = f"within {reach:g} um of 0 at {volts:g} V, with a stroke of {stroke:g} um"
    remedy = "zero the sensor, or subtract its reading at rest, and scale it to um"
    return SettingError(argument, float(f"{z:.6g}"), f"{where}: {remedy}", "um")


def wrong_others(values: object, axes: int) -> SettingError:
    """The error of a motion of the other axes that is not three finite numbers for each of them."""
    words = f"{3 * axes} finite numbers, displacement, velocity and acceleration of each of other_axes = {axes}"
    return SettingError("others", values, words, "um, um/s, um/s^2")


def signal(argument: str, value: npt.ArrayLike, unit: str = "", ndim: int | tuple[int, int] = 1) -> FloatArray:
    """A contiguous array of one axis, or as `ndim` says; a number is one of one entry.

    What is not finite is for the caller to find.
    """
    return _array(np.ascontiguousarray, argument, value, unit, ndim)


def finite_array(argument: str, value: npt.ArrayLike, unit: str = "", ndim: int | tuple[int, int] = 1) -> FloatArray:
    """An array of finite numbers with `ndim` axes, or one of two numbers of axes."""
    result = _array(np.asarray, argument, value, unit, ndim)
    bad = np.flatnonzero(~np.isfinite(result))
    if bad.size:
        raise SettingError(f"{argument}[{bad[0]}]", result.flat[bad[0]], "finite", unit)
    return result


def _array(
    make: Callable[..., FloatArray], argument: str, value: npt.ArrayLike, unit: str, ndim: int | tuple[int, int]
) -> FloatArray:
    """What `make` makes of the value, with `ndim` axes."""
    allowed = (ndim,) if isinstance(ndim, int) else ndim
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        raise SettingError(argument, described(value), "an array of real numbers: its amplitude, phase or a part", unit)
    try:
        result = make(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        rows = ", rows of one length" if max(allowed) > 1 else ""
        raise SettingError(argument, described(value), f"an array of numbers{rows}", unit) from None
    if result.ndim not in allowed:
        kinds = {0: "a number", 1: "a row of numbers", 2: "a table of numbers, of rows and columns"}
        words = " or ".join(kinds.get(one, f"an array with {one} axes") for one in allowed)
        raise SettingError(argument, f"array of shape {result.shape}", words, unit)
    return result
