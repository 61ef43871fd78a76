"""A package that is imported when it is first used: each process collects all tests, and one runs these."""

from __future__ import annotations

import importlib
from typing import Any


class Late:
    """What the module of this name has."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self._name), name)
