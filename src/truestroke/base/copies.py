"""Copies of objects with their state: controllers, laws, plants."""

from __future__ import annotations

import copy
from typing import TypeVar

T = TypeVar("T")


def deep(original: T) -> T:
    """A copy that shares nothing with the original: their `__copy__`, for a shallow one would share arrays and kernels.

    Examples
    --------
    >>> class Law:
    ...     __copy__ = deep
    ...     def __init__(self) -> None:
    ...         self.weights = [5.0]
    >>> law = Law()
    >>> copy.copy(law).weights is law.weights
    False
    """
    return copy.deepcopy(original)
