"""A package that is imported when it is first used: each process collects all tests, and one runs these."""

from __future__ import annotations

import importlib
from typing import Any


class Late:
    """What the module of this name has."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # pytest asks all that a file of tests has for some, and would import it
            raise AttributeError(name)
        return getattr(importlib.import_module(self._name), name)
