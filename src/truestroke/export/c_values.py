"""Values of Python as C99 constants: numbers in the kernel's number type, designated initialisers of its settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

REALS: dict[str, type[np.floating[Any]]] = {"double": np.float64, "single": np.float32}

UNSIGNED = 2**31  # from here on an int of C is too small


def real(value: float, precision: str) -> str:
    """A number as a constant of ts_real: the shortest text that is read back to the same bits.

    >>> real(0.1, "double"), real(0.1, "single"), real(3, "single"), real(float("inf"), "double")
    ('0.1', '0.1f', '3.0f', 'INFINITY')
    """
    rounded: np.floating[Any] = REALS[precision](value)
    if not np.isfinite(rounded):
        return "NAN" if math.isnan(rounded) else "INFINITY" if rounded > 0 else "-INFINITY"
    text = str(rounded)
    return text + ("f" if precision == "single" else "")


def constant(value: Any, precision: str) -> str:
    """A value of a setting: a number, a truth value, or nested sequences of them."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value)) + ("u" if value >= UNSIGNED else "")
    if isinstance(value, (float, np.floating)):
        return real(float(value), precision)
    return "{" + ", ".join(constant(entry, precision) for entry in value) + "}"


def members(settings: Mapping[str, Any], precision: str) -> Iterator[str]:
    """A designated initialiser for each setting that is not zero: what is not named is 0 in C.

    >>> list(members({"kalman.filter": 0.25, "plays": 3, "trim": 0.0, "creep": []}, "double"))
    ['.kalman.filter = 0.25', '.plays = 3']
    """
    for name, value in settings.items():
        if np.size(value) and np.any(np.asarray(value, dtype=object)):
            yield f".{name} = {constant(value, precision)}"
