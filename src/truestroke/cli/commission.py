"""`truestroke commission`: guided commissioning of an axis."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import common, realtime

if TYPE_CHECKING:
    from truestroke.runtime.commissioning import Findings
    from truestroke.runtime.drivers import OneAxis
    from truestroke.runtime.realtime.config import AxisTable


@click.command()
@click.option("--config", type=common.FILE, metavar="FILE", required=True,
              help="Driver and axes with their limits: TOML, as of truestroke run.")  # fmt: skip
@realtime.axis_option
@click.option("--output", metavar="FILE", default="commission.html", help="Page, HTML.")
@click.option(
    "--yes", is_flag=True, help="Ask nothing: move through the whole range, take the stroke that is proposed."
)
@click.option("--loop-back", is_flag=True, help="The output is wired to the input, and no actuator is connected: "
              "measure delay and lag of the electronics alone.")  # fmt: skip
@common.overwrite_option
@common.json_option
def commission(config: Path, axis: str | None, output: str, yes: bool, loop_back: bool, as_json: bool) -> int:
    """Commission an axis: measure its data in small steps, and write them into the configuration.

    Steps from the safe voltage that begin tiny: noise, polarity, gain, latency, first resonance. Then, if you agree,
    the whole range of voltage_limits. The output ends at the safe voltage in every case. FILE as it was stays beside
    it as FILE.bak.

    With --loop-back: delay and lag of the electronics, as settings of the controller. Nothing is written.
    """
    from truestroke.runtime.drivers import OneAxis
    from truestroke.runtime.realtime import config as configuration

    (page,) = common.outputs(output, ".html")
    driver, table = configuration.one_axis(config, axis)
    if not (yes or sys.stdin.isatty()):
        raise click.UsageError("there is no terminal to agree before the axis moves: use --yes in scripts.")
    driven = OneAxis(driver, **table.limits)
    try:
        if loop_back:
            return _looped(driven, yes, as_json)
        found = _measured(driven, table, yes, as_json)
    except truestroke.AnswerError as error:
        return _failed(str(error), as_json)
    return _told(found, config, axis, page, as_json)


def _measured(axis: OneAxis, table: AxisTable, yes: bool, as_json: bool) -> Findings:
    """All steps, with a question before each that a person must decide."""
    from truestroke.runtime.commissioning import Findings, small_steps, whole_range
    from truestroke.runtime.commissioning.findings import small_rows
    from truestroke.runtime.commissioning.procedure import STEPS

    report = common.activity(as_json)
    low, high = axis.voltage_limits
    first = STEPS[-1] * (high - low)
    _agree(
        f"Steps from {axis.safe_voltage:g} V by {1e3 * STEPS[0] * (high - low):.3g} mV to at most {first:.3g} V?", yes
    )
    small = small_steps(axis, table.stroke, report)
    if not as_json:
        _print_rows(small_rows(small, table.stroke, table.limits))
    travel = small.gain.gain * (high - low)
    _agree(f"The whole range, {low:g} to {high:g} V, roughly {travel:.3g} um?", yes)
    whole = whole_range(axis, small, report)
    about: dict[str, Any] = {"name": table.name, "small": small, "whole": whole, "limits": table.limits}
    about |= {"zero": table.zero, "resonance": table.resonance or None}
    found = Findings(**about, asked=table.stroke)
    return Findings(**about, asked=table.stroke, stroke=_stroke(found, table, yes))


def _looped(axis: OneAxis, yes: bool, as_json: bool) -> int:
    """Delay and lag of the electronics, and the settings that say so."""
    from truestroke.runtime import commissioning
    from truestroke.runtime.commissioning.loop_back import STEP

    low, high = axis.voltage_limits
    _agree(f"Is the output wired to the input, and no actuator connected? Steps of {STEP * (high - low):.2g} V", yes)
    found = commissioning.loop_back(axis, common.activity(as_json))
    if as_json:
        common.print_json({**Verdict("good", ()).as_dict(), **found.as_dict()})
        return ExitCode.OK
    _print_rows(found.rows())
    click.echo(f"{'settings':10} settings = {{ {', '.join(f'{k} = {v!r}' for k, v in found.settings.items())} }}")
    return ExitCode.OK


def _stroke(found: Findings, table: AxisTable, yes: bool) -> float | None:
    """As it is, or the answer of the user where there is none or it is beyond reach."""
    if table.model or (found.asked is not None and not found.beyond):
        return found.asked
    if yes:
        return found.proposed
    why = "No stroke is given" if found.asked is None else f"The stroke of {found.asked:g} um is beyond reach"
    question = f"{why}; the axis reaches {found.whole.high:.4g} um from rest. Stroke in um"
    kind = click.FloatRange(0.0, found.whole.reach, min_open=True)
    return float(click.prompt(question, type=kind, default=found.proposed, err=True))


def _agree(question: str, yes: bool) -> None:
    if not yes:
        click.confirm(question, abort=True, err=True)


def _print_rows(rows: list[list[str]]) -> None:
    if sys.stderr.isatty():
        click.echo("\r\x1b[K", nl=False, err=True)
    for name, found, beside in rows:
        click.echo(f"{name:10} {found:26} {beside}")


def _failed(reason: str, as_json: bool) -> int:
    verdict = Verdict("bad", (reason,))
    if as_json:
        common.print_json({**verdict.as_dict(), "exit_code": int(ExitCode.CHECK)})
    else:
        _print_rows([])
        common.print_verdict(verdict)
    return ExitCode.CHECK


def _told(found: Findings, config: Path, axis: str | None, page: Path, as_json: bool) -> int:
    """Configuration, page and the rest of the lines."""
    from truestroke.runtime.commissioning.findings import write
    from truestroke.runtime.commissioning.page import page as page_of

    changes, verdict = found.changes(), found.verdict()
    backup = write(config, changes, axis) if changes else None
    named = {"axis": axis or "axis"}
    lines = [f"{named.get(table, table)}.{key} = {value:g}" for (table, key), (value, _) in changes.items()]
    page_of(found, lines, common.to_repeat()).save(page)
    if as_json:
        written = {f"{table}.{key}": value for (table, key), (value, _) in changes.items()}
        files = {"config": str(config), "backup": backup and str(backup), "page": str(page)}
        common.print_json({**verdict.as_dict(), **found.as_dict(), "written": written, **files})
        return ExitCode.OK
    _print_rows(found.rows()[-2:])
    common.print_verdict(verdict)
    click.echo(f"{'written':10} {f'{config}: ' + ', '.join(lines) if changes else 'nothing'}")
    common.print_files(before=backup, page=page)
    return ExitCode.OK
