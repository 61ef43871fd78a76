"""The state of an object that has others in it, as named arrays: what `numpy.savez` takes; nothing is executed.

Numbers and the structure are one text of JSON, arrays stand beside it. Only classes that are named are made again.
What the object was made with is an entry of its own, `MADE_WITH`: a state goes to an object that was made alike.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, display
from truestroke.base.checks import SettingError

Arrays = dict[str, npt.NDArray[Any]]
TEXT = "structure"
MADE_WITH = "made_with"
PLAIN = (bool, int, float, str)
SAME = 1e-6  # of a number: settings that follow from others are computed by libraries that round in their own way
NAMED = 3  # what differs, in an error


def taken(parts: Mapping[str, Any], kinds: tuple[type, ...]) -> Arrays:
    """Named arrays of values: numbers, texts, arrays, lists, tuples, deques, and objects of these classes.

    An object that stands in two places is one again.

    Raises
    ------
    TypeError
        A value is of another class.
    """
    arrays: Arrays = {}
    seen: dict[int, int] = {}
    names = {kind: kind.__name__ for kind in kinds}

    def written(value: Any) -> Any:
        if value is None or type(value) in PLAIN:
            return value
        if isinstance(value, np.generic):
            return written(value.item())
        if isinstance(value, np.ndarray):
            if id(value) not in seen:
                seen[id(value)] = len(seen)
                arrays[f"array {seen[id(value)]}"] = value.copy()
            return {"array": seen[id(value)]}
        if isinstance(value, (list, tuple, deque)):
            kept = {"longest": value.maxlen} if isinstance(value, deque) else {}
            return {type(value).__name__: [written(one) for one in value], **kept}
        if type(value) not in names:
            raise TypeError(f"a {type(value).__name__} has no place in a state")
        if id(value) in seen:
            return {"again": seen[id(value)]}
        seen[id(value)] = number = len(seen)
        return {names[type(value)]: {name: written(one) for name, one in vars(value).items()}, "is": number}

    structure = {name: written(value) for name, value in parts.items()}
    return {TEXT: np.array(json.dumps(structure)), **arrays}


def rebuilt(state: Mapping[str, npt.NDArray[Any]], kinds: tuple[type, ...]) -> dict[str, Any]:
    """The values of `taken`.

    Raises
    ------
    ValueError, KeyError, TypeError
        It is not what `taken` gave.
    """
    named = {kind.__name__: kind for kind in kinds}
    objects: dict[int, Any] = {}

    def read(value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        kind, held = next(iter(value.items()))
        if kind == "again":
            return objects[held]
        if kind == "array":
            if held not in objects:
                objects[held] = np.array(state[f"array {held}"])
            return objects[held]
        if kind in ("list", "tuple", "deque"):
            whole = [read(one) for one in held]
            return deque(whole, value["longest"]) if kind == "deque" else whole if kind == "list" else tuple(whole)
        made: Any = object.__new__(named[kind])
        objects[value["is"]] = made
        made.__dict__.update({name: read(one) for name, one in held.items()})
        return made

    structure = json.loads(str(state[TEXT]))
    return {name: read(value) for name, value in structure.items()}


def named(state: Mapping[str, npt.NDArray[Any]], begin: str) -> Arrays:
    """The entries of a state whose names begin so, without it.

    >>> sorted(named({"inside weights": np.zeros(2), "structure": np.zeros(1)}, "inside "))
    ['weights']
    """
    return {name.removeprefix(begin): array for name, array in state.items() if name.startswith(begin)}


# ---- What it was made with -------------------------------------------------------------------------------------------


def made_with(values: Mapping[str, Any]) -> Arrays:
    """The entry of a state that says what its object was made with: numbers, texts, sequences and mappings of them."""
    return {MADE_WITH: np.frombuffer(json.dumps(values).encode(), np.uint8)}


def check_made_with(
    state: Mapping[str, npt.NDArray[Any]],
    here: Mapping[str, Any],
    units: Mapping[str, str],
    remedy: str,
    follow: Collection[str] = (),
) -> None:
    """Refuse a state whose object was made with other values than `here`, by their names.

    Those that `follow` from others are named only where no other differs.

    >>> saved = made_with({"stroke": 30.0, "law": "kalman", "modes": [{"frequency": 700.0}]})
    >>> check_made_with(saved, {"stroke": 30.0, "law": "kalman", "modes": [{"frequency": 700.0}]}, {}, "")
    >>> other = {"stroke": 20.0, "law": "kalman", "modes": [{"frequency": 650.0}]}
    >>> check_made_with(saved, other, {"stroke": "um"}, "make it with these")
    Traceback (most recent call last):
        ...
    truestroke.SettingError: state = one made with stroke 30 um, modes[0].frequency 700: must be one made with \
stroke 20 um, modes[0].frequency 650, as here: make it with these
    """
    there = _of_bytes(state)
    names = {**here, **there}
    first = {n: next(_differing(n, there.get(n), here.get(n), units.get(n, "")), None) for n in names}
    found = [pair for name, pair in first.items() if pair and name not in follow] or [*filter(None, first.values())]
    if found:
        rest = f" and {len(found) - NAMED} more" if len(found) > NAMED else ""
        saved, own = (", ".join(pair[i] for pair in found[:NAMED]) for i in (0, 1))
        raise SettingError("state", f"one made with {saved}{rest}", f"one made with {own}, as here: {remedy}")


def _of_bytes(state: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    checks.able("state", state, ("items",), "what `state` gave, or numpy.load of its file")
    try:
        found = json.loads(np.asarray(state[MADE_WITH]).tobytes())
    except (KeyError, ValueError) as error:
        why = f"it has no entry {MADE_WITH}" if isinstance(error, KeyError) else f"its entry {MADE_WITH} is damaged"
        raise SettingError("state", f"{len(state)} entries", f"what `state` gave in this version: {why}") from None
    return dict(checks.instance("state", found, dict, "what `state` gave"))


def _differing(name: str, there: Any, here: Any, unit: str) -> Iterator[tuple[str, str]]:
    """Name and value, there and here, of each part in which two values differ."""
    there, here = (list(value) if isinstance(value, tuple) else value for value in (there, here))
    if isinstance(there, dict) and isinstance(here, dict):
        for key in {**here, **there}:
            yield from _differing(f"{name}.{key}", there.get(key), here.get(key), unit)
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        pairs = enumerate(zip(there, here, strict=True))
        parts = [part for i, pair in pairs for part in _differing(f"{name}[{i}]", *pair, unit)]
        flat = len(here) <= display.FEW and not any(isinstance(one, (list, tuple, dict)) for one in here)
        yield from [_both(name, there, here, unit)] if parts and flat else parts
    elif not _same(there, here):
        yield _both(name, there, here, unit)


def _same(there: Any, here: Any) -> bool:
    numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in (there, here))
    return math.isclose(there, here, rel_tol=SAME) if numbers else bool(there == here)


def _both(name: str, there: Any, here: Any, unit: str) -> tuple[str, str]:
    texts = ["given" if isinstance(value, dict) else display.quantity(value, unit) for value in (there, here)]
    if texts[0] == texts[1]:
        texts = [repr(value) for value in (there, here)]
    return f"{name} {texts[0]}", f"{name} {texts[1]}"
