"""TOML into what declares it: a dataclass or a function. One decoder, whose errors name the key by its whole path.

`text` writes a value.
"""

import codecs
import dataclasses
import inspect
import json
import math
import os
import re
import tomllib
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError

Made = TypeVar("Made")

_KINDS: dict[Any, tuple[Any, str]] = {
    float: ((int, float), "a number"),
    int: ((int, float), "a whole number"),
    bool: (bool, "true or false"),
    str: (str, "text in quotes"),
    type(None): (type(None), "left out"),
    tuple: ((list, tuple), "a list"),
    Mapping: (Mapping, "a table"),
}
"""Of the type of an annotation the types of values that it takes, and how they are called."""


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises
    ------
    SettingError
        It is no TOML; names the line, and not the file, which its caller knows.
    OSError
        It cannot be read.
    """
    text = source(path)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise _no_toml(text, str(error)) from None


def source(path: str | os.PathLike[str]) -> str:
    """The text of a TOML file, also with the marks of editors of Windows; PowerShell writes `command > FILE` in UTF-16.

    Raises
    ------
    SettingError
        It is no text, or a folder.
    OSError
        It cannot be read.
    """
    if Path(path).is_dir():
        raise SettingError("the file", "a folder", "a file of TOML")
    data = Path(path).read_bytes()
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        raise SettingError("the file", "other bytes than those of text", "TOML, in UTF-8") from None


def _no_toml(text: str, reason: str) -> SettingError:
    """The error that shows the line, where the decoder names one."""
    if not (place := re.search(r" \(at line (\d+), column \d+\)$", reason)):
        return SettingError("the file", "text", f"TOML ({reason})")
    line = text.split("\n")[int(place[1]) - 1].strip()
    point = "; a decimal has a point, as in 2.5" if re.search(r"= *-?\d+,\d", line) else ""
    return SettingError(f"line {place[1]}", repr(line), f"TOML ({reason[: place.start()]}{point})")


def needed(given: Mapping[str, Any], name: str, example: str = "") -> Any:
    """The value of a key that must be there; `example` is what the error shows.

    >>> needed({}, "file", 'file = "run.h5"')
    Traceback (most recent call last):
        ...
    truestroke.SettingError: file = missing: must be given, such as file = "run.h5"
    """
    if name not in given:
        raise SettingError(name, "missing", f"given, such as {example}" if example else "given")
    return given[name]


def decode(
    make: Callable[..., Made],
    given: Mapping[str, Any],
    also: tuple[str, ...] = (),
    elsewhere: Mapping[str, str] = types.MappingProxyType({}),
    **fixed: Any,
) -> Made:
    """What a table describes: ``make(**given, **fixed)``.

    Parameters
    ----------
    make : callable
        A dataclass, or a function with annotations: its parameters are the keys.
    given : mapping
        The table. Lists become tuples, inner tables the dataclasses of their annotations.
    also : tuple of str
        Keys that are allowed, but not passed to `make`.
    elsewhere : mapping of str to str
        Of keys that are not, here or in an inner table, where they belong, for the error. So do the keys that a field
        has by its metadata "keys", a function without arguments.
    **fixed
        Arguments that are no keys.

    Raises
    ------
    SettingError
        A key is unknown or missing, a value has the wrong type, or `make` refuses it.

    Examples
    --------
    >>> @dataclasses.dataclass
    ... class Stage:
    ...     stroke: float
    ...     name: str = "x"
    >>> decode(Stage, {"stroke": 30.0})
    Stage(stroke=30.0, name='x')
    >>> decode(Stage, {"strok": 30.0})
    Traceback (most recent call last):
        ...
    truestroke.SettingError: strok = 30.0: must be left out; did you mean stroke? There are stroke, name
    """
    parameters = inspect.signature(make).parameters
    fields = dataclasses.fields(make) if dataclasses.is_dataclass(make) else ()
    examples = {one.name: one.metadata.get("example", "") for one in fields}
    names = (*also, *(name for name in parameters if name not in fixed))
    inner = _inner(fields) if any(name not in names for name in given) else {}
    checks.known(given, names, {**inner, **elsewhere})
    for name, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and name not in fixed:
            needed(given, name, examples.get(name, ""))
    return make(**arguments(make, {name: given[name] for name in given if name not in also}, elsewhere), **fixed)


def _inner(fields: Sequence[dataclasses.Field[Any]]) -> dict[str, str]:
    """Of the keys that fields have which are declared as mappings, where they belong."""
    places: dict[str, list[str]] = {}
    for one in fields:
        for key in one.metadata.get("keys", tuple)():
            places.setdefault(key, []).append(one.name)
    return {key: f"in {' or '.join(names)}" for key, names in places.items()}


def arguments(
    make: Callable[..., object], given: Mapping[str, Any], elsewhere: Mapping[str, str] = types.MappingProxyType({})
) -> dict[str, Any]:
    """The values of some parameters of `make`, of the types of their annotations; `elsewhere` as in `decode`."""
    hints, fields = get_type_hints(make), dataclasses.fields(make) if dataclasses.is_dataclass(make) else ()
    units = {field.name: str(field.metadata.get("unit", "")) for field in fields}
    return {name: value(name, entry, hints[name], units.get(name, ""), elsewhere) for name, entry in given.items()}


def value(
    name: str, given: Any, hint: Any, unit: str = "", elsewhere: Mapping[str, str] = types.MappingProxyType({})
) -> Any:
    """A value of the type of an annotation: a string is no number, and neither is a truth value.

    >>> value("stroke", "30", float, "um")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: stroke = '30' um: must be a number, without quotes
    """
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType) and (fitting := [one for one in inner if _fits(given, one)]):
        return value(name, given, fitting[0], unit, elsewhere)
    if not _fits(given, hint):
        raise SettingError(name, checks.tabled(given), _called(hint) + _remedy(name, given, hint, inner), unit)
    if _outer(hint) is tuple:
        return tuple(value(name, entry, inner[0], unit) for entry in given)
    if dataclasses.is_dataclass(hint) and isinstance(given, Mapping):
        with checks.inside(f"{name}."):
            return decode(hint, given, elsewhere=elsewhere)  # type: ignore[arg-type]
    return given


def _remedy(name: str, given: Any, hint: Any, inner: tuple[Any, ...]) -> str:
    """What to change where a value has another type, if that is known."""
    needed = [one for one in inner if one is not type(None)]
    if get_origin(hint) in (Union, types.UnionType) and len(needed) == 1:
        return _remedy(name, given, needed[0], get_args(needed[0]))
    if isinstance(given, str) and get_origin(hint) is tuple and float in inner:
        number = re.search(r"[-+]?\d+(\.\d+)?", given)
        return f" of numbers, without quotes: {name} = [{number[0] if number else '...'}]"
    if isinstance(given, str) and {int, float, bool} & {hint, *inner}:
        return "" if any(get_origin(one) is Literal for one in inner) else ", without quotes"
    if isinstance(given, Mapping) and _outer(hint) is tuple and _outer(inner[0]) is Mapping:
        return f" of tables: [[{name}]], with double brackets"
    if _outer(hint) is tuple and not isinstance(given, Mapping) and _outer(inner[0]) is not Mapping:
        return ", in brackets: [...]"
    return ", with single brackets" if checks.tabled(given) == "tables" else ""


def _outer(hint: Any) -> Any:
    """An annotation without its brackets; a dataclass is a table."""
    outer = get_origin(hint) or hint
    return Mapping if dataclasses.is_dataclass(outer) else outer


def _kind(hint: Any) -> tuple[Any, str]:
    """The entry of `_KINDS` for an annotation; values of other types have checks of their own."""
    outer = _outer(hint)
    return _KINDS.get(outer, (outer if isinstance(outer, type) and outer is not Any else object, ""))


def _called(hint: Any) -> str:
    """The type of an annotation, in words."""
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(filter(None, (_called(one) for one in get_args(hint) if one is not type(None))))
    if get_origin(hint) is Literal:
        choices = get_args(hint)
        return f"one of {', '.join(choices)}" if len(choices) > 1 else repr(choices[0])
    return _kind(hint)[1]


def _fits(given: Any, hint: Any) -> bool:
    """Whether the outermost type does."""
    if get_origin(hint) is Literal:
        return given in get_args(hint)
    if get_origin(hint) in (Union, types.UnionType):
        return False
    if isinstance(hint, type) and dataclasses.is_dataclass(hint) and isinstance(given, hint):
        return True
    kinds = _kind(hint)[0]
    return isinstance(given, kinds) and (kinds is object or isinstance(given, bool) <= (hint is bool))


def text(value: Any) -> str:
    r"""A string, truth value, number or flat list as TOML; floats so that they come back to the last bit.

    Raises
    ------
    ValueError
        A number is not finite: no reader expects one.

    Examples
    --------
    >>> print(text('a "b"'), text(0.1 + 0.2), text(np.float64(2)), text((1, 2.5)), text(True))
    "a \"b\"" 0.30000000000000004 2.0 [1, 2.5] true
    """
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        if not math.isfinite(value):
            raise ValueError(f"{value}: only finite numbers are written")
        return repr(float(value))
    return f"[{', '.join(text(entry) for entry in value)}]"
