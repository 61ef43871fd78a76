"""`truestroke unwarp`: an image that was scanned open loop, corrected by a model and the recorded voltage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, waveforms


@click.command()
@click.argument("image", type=common.FILE)
@click.argument("retrace", type=common.FILE, required=False)
@click.option("--channel", metavar="NAME", help="Part of the name of the signal, where an image file has several.")
@click.option("--record", metavar="FILE", type=common.FILE, required=True, help="Voltages of the scan, from rest.")
@click.option("--model", metavar="FILE", type=common.FILE, required=True, help="Of the fast axis, of truestroke "
              "identify.")  # fmt: skip
@click.option("--model-y", metavar="FILE", type=common.FILE, help="Of the slow axis.  [default: its rows are even]")
@click.option("--volts", "x", metavar="COLUMN", help="Column of the voltage of x: its name, or its number from 1.")
@click.option("--volts-y", "y", metavar="COLUMN", help="Column of the voltage of y.")
@click.option("--trigger", metavar="COLUMN", help="Column that is high within the lines of the trace.")
@click.option("--retrace-trigger", metavar="COLUMN", help="Column that is high within those of the retrace.")
@click.option("--lines", metavar="FILE", type=common.FILE, help="Table of the lines: row, direction, start, end.  "
              "[default: by the trigger]")  # fmt: skip
@click.option("--time", metavar="COLUMN", help="Column of the time stamps.")
@click.option("--sample-rate", metavar="HZ", type=float, help="Where there is no column of time stamps.")
@click.option("--align", is_flag=True, help="Share between trace and retrace what still separates them.")
@click.option("--output", metavar="FILE", help="Image to write: .gsf, .gwy, .tif or .nxs.  [default: unwarped.gwy]",
              default="unwarped.gwy", show_default=False)  # fmt: skip
@waveforms.force_option
@common.page_options
def unwarp(
    image: Path, retrace: Path | None, record: Path, model: Path, model_y: Path | None, lines: Path | None,
    channel: str | None, align: bool, output: str, force: bool, plots: Path | None, as_json: bool, **columns: Any,
) -> int:  # fmt: skip
    """Correct an image that was scanned open loop.

    Needs a model of the axis and the voltage that was recorded during the scan, and no sensor: the model predicts where
    each pixel was taken. IMAGE has the trace, or trace and retrace; a second file has the retrace. Where there are
    other signals, too, --channel names the one to correct.
    """
    from truestroke import scans
    from truestroke.identification import unwarp as unwarping
    from truestroke.report import images as report
    from truestroke.signals.scans.image_files import IMAGE, require_library

    require_library(Path(output), "output")
    target = common.to_write("--output", output, IMAGE)
    (page_file,) = common.outputs(str(target.with_suffix("")), ".html")
    fast, slow = _models(model, model_y, force)
    given = [scans.read_images(file) for file in (image, retrace) if file]
    before = unwarping.by_direction(*given, channel=channel)
    scanned = _recorded(record, lines, columns)
    found = truestroke.unwarp(before, scanned, fast, slow, align=align)
    kept = list(found.images.values())
    scans.save_images(target, kept[0] if target.suffix == ".gsf" else kept)
    made = report.page(found, before, common.to_repeat())
    pictures = common.save_page(made, page_file, plots)
    if as_json:
        written = {"image": str(target), "page": str(page_file), "pictures": pictures}
        common.print_json({**found.verdict.as_dict(), **report.as_dict(found), **written})
        return ExitCode.of(found.verdict)
    for name, text in report.rows(found):
        common.print_text(f"{name:32} {text}")
    common.print_verdict(found.verdict)
    if target.suffix == ".gsf" and len(kept) > 1:
        common.print_text(
            f"note: a .gsf holds one image, here {kept[0].name}; .gwy, .tif and .nxs have the retrace, too"
        )
    common.print_files(image=target, page=page_file, pictures=plots)
    return ExitCode.of(found.verdict)


def _models(x: Path, y: Path | None, force: bool) -> tuple[truestroke.ActuatorModel, truestroke.ActuatorModel | None]:
    """Those of both axes; what speaks against one that is that of both is said once."""
    fast = truestroke.usable_model(x, force=force)
    if y is None:
        return fast, None
    if y.resolve() == x.resolve():
        return fast, fast
    return fast, truestroke.usable_model(y, force=force)


def _recorded(record: Path, lines: Path | None, columns: dict[str, Any]) -> truestroke.ScanRecord:
    """The voltages, with the lines of a table in place of those of a trigger."""
    if lines is None:
        return truestroke.read_scan_record(record, **columns)
    if columns["trigger"] or columns["retrace_trigger"]:
        raise click.UsageError("--lines says where the lines are: leave --trigger and --retrace-trigger out.")
    return truestroke.read_scan_record(record, **columns, lines=truestroke.read_lines(lines))
