"""The state of an object that has others in it, as named arrays: what `numpy.savez` takes; nothing is executed.

Numbers and the structure are one text of JSON, arrays stand beside it. Only classes that are named are made again.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[Any]]
TEXT = "structure"
PLAIN = (bool, int, float, str)


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
