"""Names of a package that are loaded when they are first used; the package's `__init__.pyi` states them."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def attach(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and the public names of a package; its stub has lines `from place import name as name`.

    Parameters
    ----------
    package : str
        Its `__name__`.
    """
    space = vars(sys.modules[package])
    stub = ast.parse(Path(space["__file__"]).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = (node for node in stub.body if isinstance(node, ast.ImportFrom))
    places = {entry.name: str(node.module) for node in imports for entry in node.names}

    def load(name: str) -> Any:
        """A public name; the next time it is found in the package itself."""
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        place = vars(importlib.import_module(places[name]))
        value = place[name] if name in place else importlib.import_module(f"{places[name]}.{name}")
        space[name] = value
        return value

    return load, lambda: sorted({*space, *places}), sorted(places)
