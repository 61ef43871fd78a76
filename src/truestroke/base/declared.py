"""Settings that are declared once: what each means, its unit, bound and default, and who uses it.

The fields of a frozen dataclass have a type and a plain default; a table has a `Setting` for each. Checks, defaults,
the docstring, the table of the documentation and the kernel's copy follow from the two.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from truestroke.base import checks
from truestroke.base.display import quantity

TINY, HUGE = 1e-15, 1e15  # of a setting, in its unit: squares and quotients of such numbers are finite

FOLLOWS: Any = None
"""Default of a field whose value follows from the others: see `Setting.rule`."""

Check = Callable[[Any, str, Any, str], Any]
"""check(settings, name, value, unit) gives the value that is kept, or raises a `SettingError`."""

C = TypeVar("C", bound=type)


@dataclass(frozen=True)
class Times:
    """A multiple of another setting, as an end of a bound or as a default.

    >>> from types import SimpleNamespace
    >>> print(Times(50, "stroke"), Times(50, "stroke")(SimpleNamespace(stroke=3.0)))
    50 * stroke 150.0
    """

    factor: float
    name: str

    def __call__(self, settings: Any) -> float:
        """The number, with these settings."""
        return float(self.factor * getattr(settings, self.name))

    def __str__(self) -> str:
        return self.name if self.factor == 1 else f"{_text(self.factor)} * {self.name}"


@dataclass(frozen=True)
class Bound:
    """What a value may be: as a table states it, and as a check; of a closed interval also its ends."""

    text: str
    check: Check
    ends: tuple[float | Times, float | Times] | None = None


@dataclass(frozen=True)
class Setting:
    """The declaration of a setting.

    Attributes
    ----------
    meaning : str
        In one sentence.
    unit : str
        "" for a pure number, and for what is no number.
    bound : Bound
        It may use the settings that are declared before this one, and so may the rule.
    rule : callable, optional
        rule(settings) is the default of a field that `FOLLOWS`: a `Times`, or a function whose docstring states it.
    law : str
        The adaptation law that uses it; "" for all.
    changeable : bool
        Whether it may be changed while running.
    kernel : str
        Members of the kernel's settings that hold it, such as "kalman.filter"; "{name}" is its own name.
    convert : callable, optional
        convert(value, settings) gives what they hold: one value, or one for each; by default the value itself.
    """

    meaning: str
    unit: str
    bound: Bound
    rule: Callable[[Any], Any] | None = None
    law: str = ""
    changeable: bool = False
    kernel: str = "{name}"
    convert: Callable[[Any, Any], Any] = lambda value, _: value

    def members(self, name: str) -> list[str]:
        """The members of the kernel's settings."""
        return self.kernel.format(name=name).split()


Table = Mapping[str, Setting]


def checked(table: Table, name: str, value: Any, settings: Any = None) -> Any:
    """The value of a setting as it is kept."""
    setting = table[name]
    return setting.bound.check(settings, name, value, setting.unit)


def complete(settings: Any, table: Table) -> None:
    """Check each setting of a frozen dataclass, in the order of the table, and fill in what follows from the others."""
    for name, setting in table.items():
        value = getattr(settings, name)
        if value is None and setting.rule is not None:
            value = setting.rule(settings)
        object.__setattr__(settings, name, checked(table, name, value, settings))


def kernel_values(settings: Any, table: Table, law: str = "") -> dict[str, Any]:
    """All members of the kernel's settings by name; those of another law than `law` are 0."""
    values: dict[str, Any] = {}
    for name, setting in table.items():
        members, value = setting.members(name), setting.convert(getattr(settings, name), settings)
        if setting.law not in ("", law):
            value = [] if np.ndim(value) else 0
        values.update(zip(members, value if len(members) > 1 else [value], strict=False))
    return values


def rows(settings: Any, table: Table) -> list[tuple[str, str]]:
    """Name and value with its unit, of each setting, to be displayed."""
    return [(name, quantity(getattr(settings, name), setting.unit)) for name, setting in table.items()]


def described(settings: Any, table: Table) -> list[dict[str, Any]]:
    """The declaration as plain data, with the value of each setting: for tables and exports."""
    fields = {field.name: field for field in dataclasses.fields(settings)}
    return [
        {
            **{"name": name, "value": getattr(settings, name), "unit": s.unit, "bound": s.bound.text},
            **{"default": default_text(fields[name], s), "law": s.law or "all", "changeable": s.changeable},
            **{"kernel": s.members(name), "meaning": s.meaning},
        }
        for name, s in table.items()
    ]


def documented(table: Table) -> Callable[[C], C]:
    """Give the docstring of a dataclass its section Attributes, from the table, which has a row for each field."""

    def decorate(cls: C) -> C:
        fields = {f.name: f for f in dataclasses.fields(cls)}
        if fields.keys() != table.keys():
            raise TypeError(f"{cls.__name__}: fields and table differ in {sorted(fields.keys() ^ table.keys())}")
        lines = [
            f"{name} : {fields[name].type}\n        {s.meaning}{', ' + s.unit if s.unit else ''}: {s.bound.text}; "
            f"default: {default_text(fields[name], s)}."
            for name, s in table.items()
        ]
        before, raises, after = (cls.__doc__ or "").partition("    Raises\n")
        entries = "\n    ".join(["    Attributes", "----------", *lines])
        cls.__doc__ = f"{before}{entries}\n\n{raises}{after}"
        return cls

    return decorate


def default_text(field: dataclasses.Field[Any], setting: Setting) -> str:
    """The default as a table states it, code in backticks."""
    if field.default is dataclasses.MISSING:
        return "needed"
    if setting.rule is None or isinstance(setting.rule, Times):
        return f"`{setting.rule or repr(field.default)}`"
    return str(setting.rule.__doc__).rstrip(".")


# ---- Bounds ----------------------------------------------------------------------------------------------------------


def bound(text: str) -> Callable[[Check], Bound]:
    """Make a check a bound that a table states as `text`."""
    return lambda check: Bound(text, check)


def between(low: float | Times, high: float | Times) -> Bound:
    """A number in the closed interval; an end may be a multiple of another setting."""

    @bound(f"[{_text(low)}, {_text(high)}]")
    def check(settings: Any, name: str, value: Any, unit: str) -> float:
        least, most = (end(settings) if isinstance(end, Times) else end for end in (low, high))
        return checks.within(name, value, least, most, unit)

    return dataclasses.replace(check, ends=(low, high))


def sized(low: float = TINY, high: float = HUGE) -> Bound:
    """A number above 0 of a size that computes."""
    text = f"[{_text(low)}, {_text(high)}]"
    return Bound(text, lambda _, name, value, unit: checks.sized(name, value, unit, low, high))


def whole(low: int, high: int) -> Bound:
    """A whole number in the closed interval."""
    return Bound(f"[{low}, {high}]", lambda _, name, value, __: checks.count(name, value, low, high))


def word(*choices: str) -> Bound:
    """One of these words."""
    text = " or ".join(f'"{choice}"' for choice in choices)
    return Bound(text, lambda _, name, value, __: checks.one_of(name, value, choices))


def ascending(most: int) -> Bound:
    """At most so many numbers that ascend from 0."""

    @bound(f"ascending from 0, up to {most}")
    def check(_: Any, name: str, value: Sequence[float], unit: str) -> tuple[float, ...]:
        result = checks.ascending(name, value, unit)
        checks.count(f"the number of {name}", len(result), 1, most)
        checks.within(name, result[-1], 0.0, HUGE, unit)
        return result

    return check


def _text(end: float | Times) -> str:
    """A number or a multiple as a table states it: 1e6, not 1e+06."""
    return str(end) if isinstance(end, Times) else re.sub(r"e\+?(-?)0?", r"e\1", f"{end:g}")


FLAG = Bound("True or False", lambda _, name, value, __: checks.flag(name, value))
SHARE = between(0, 1)
