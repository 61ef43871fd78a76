"""`truestroke doctor`: what this computer has of what a run needs, and the commands that help."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import click

from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.runtime.doctor import Finding

WIDE = 90  # columns of a terminal that shows the last column, too


@click.command()
@click.option("--config", type=common.FILE, metavar="FILE",
              help="Also look at what this configuration of truestroke run needs.")  # fmt: skip
@common.json_option
def doctor(config: Path | None, as_json: bool) -> int:
    """Check drivers, real-time settings and permissions, and print the remedies.

    No output moves. Takes about two seconds, one of which measures how late an empty loop is. Exit code 1 if the
    configuration needs something that is missing, else 0.
    """
    from truestroke.runtime.doctor import Level, examine

    findings = examine(config)
    lacking = [finding for finding in findings if config and finding.required and finding.level is Level.MISSING]
    if as_json:
        counts = {str(level): sum(finding.level is level for finding in findings) for level in Level}
        common.print_json({**counts, "can_run": not lacking, "findings": [dataclasses.asdict(f) for f in findings]})
    else:
        _print(findings)
        for finding in lacking:
            click.echo(f"truestroke: {config} needs {finding.what}: {finding.found}", err=True)
    return 1 if lacking else 0


def _print(findings: list[Finding]) -> None:
    """Found and why wrap, a narrow terminal has no why; the commands follow below, whole, to be copied."""
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    console = common.console()
    table = Table(box=SIMPLE_HEAD if console.is_terminal else None, pad_edge=False, padding=(0, 1, 0, 0))
    colours = {"ok": "green", "warning": "yellow", "missing": "red"}
    for name in ("", "part", "what"):
        table.add_column(name, no_wrap=True)
    table.add_column("found", ratio=3)
    why = ["why it matters"] if console.width >= WIDE else []
    for name in why:
        table.add_column(name, ratio=2, style="dim")
    for f in findings:
        table.add_row(f"[{colours[f.level]}]{f.level}[/]", f.part, f.what, escape(f.found), *why and [escape(f.why)])
    console.print(table)
    helpful = [f for f in findings if f.command]
    if helpful:
        click.echo("\nWhat helps:")
    for f in helpful:
        click.echo(f"  {f.what}{' (required)' if f.required else ''}: {f.command}")
