"""The costs as tables: each beside the kernel's own."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bench import rivals
from benchmarks.bench.cost import Cost

import truestroke

Table = tuple[list[str], list[list[str]]]
FIGURES = ["best, ns", "median", "99.9 %", "worst, us"]


def reference(costs: Sequence[Cost]) -> Cost | None:
    """The update of 16 parameters in C, double, in the fastest variant: what the others are divided by."""
    own = [c for c in costs if c.what == "update" and c.way == "C" and _sixteen(c) and c.precision == "double"]
    return min(own, key=lambda c: c.best_ns, default=None)


def limit(costs: Sequence[Cost]) -> Cost | None:
    """The machine's limit for the same work."""
    found = [c for c in costs if c.what == "limit" and _sixteen(c) and c.precision == "double"]
    return min(found, key=lambda c: c.best_ns, default=None)


def _sixteen(cost: Cost) -> bool:
    return cost.parameters == rivals.PARAMETERS


def updates(costs: Sequence[Cost]) -> list[Cost]:
    """Recursive least squares of 16 parameters, whoever's, from the fastest to the slowest."""
    found = [c for c in costs if c.what in ("limit", "update") and _sixteen(c)]
    return sorted(found, key=lambda c: c.best_ns)


def update_table(costs: Sequence[Cost]) -> Table:
    """Whose update costs how much, and how many times ours."""
    own = reference(costs)
    rows = []
    for c in updates(costs):
        name = "the machine's limit for it" if c.what == "limit" else c.name
        rows.append([f"{name}, {_how(c)}", *_figures(c), f"{c.best_ns / own.best_ns:.3g}" if own else ""])
    return [f"one update, {rivals.PARAMETERS} parameters", *FIGURES, "times ours"], rows


def tick_table(costs: Sequence[Cost]) -> Table:
    """What command and adapt cost together, by law, way and plays."""
    found = sorted((c for c in costs if c.what == "tick"), key=lambda c: (c.name, c.way, c.precision, c.plays))
    rows = [[f"{c.name}, {_how(c)}", str(c.plays), str(c.parameters), *_figures(c)] for c in found]
    return ["one tick: command and adapt", "plays", "weights", *FIGURES], rows


def axes_table(costs: Sequence[Cost]) -> Table:
    """What a tick of several axes costs, and a pass of learning for each of its ticks."""
    found = [c for c in costs if c.what == "axes"]
    alone = found[0].best_ns if found else 1.0
    rows = [[f"{c.name}, {_how(c)}", str(c.parameters), *_figures(c), f"{c.best_ns / alone:.3g}"] for c in found]
    return ["one tick of all axes, with dynamics", "weights or harmonics", *FIGURES, "times one axis"], rows


def _how(c: Cost) -> str:
    return ", ".join(word for word in (c.way, c.variant, "" if c.precision == "double" else c.precision) if word)


def _figures(c: Cost) -> list[str]:
    return [f"{c.best_ns:.0f}", f"{c.median_ns:.0f}", f"{c.p999_ns:.0f}", f"{c.worst_ns / 1e3:.1f}"]


def verdict(costs: Sequence[Cost]) -> str:
    """What matters, in a sentence or two."""
    own, least = reference(costs), limit(costs)
    if own is None:
        return "Without the kernel in C there is nothing to divide by."
    text = f"One update of {rivals.PARAMETERS} parameters takes {own.best_ns:.0f} ns in C"
    if least is not None:
        text += (
            f", {own.best_ns / least.best_ns:.1f} times what its loads, stores and multiply-adds need on this machine"
        )
    others = [c for c in updates(costs) if c.way != "C"]
    ratios = [f"{c.name} {c.best_ns / own.best_ns:.3g}" for c in others]
    return text + ("." if not ratios else f". Times that: {', '.join(ratios)}.")


def machine() -> str:
    """Processor, compiler's target and versions, in a line."""
    names: list[str] = []
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8", errors="replace").splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")][:1]
    processor = names[0] if names else platform.processor() or platform.machine()
    return f"{processor}, Python {platform.python_version()}, truestroke {truestroke.__version__}"
