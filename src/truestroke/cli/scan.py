"""`truestroke scan`: a simulated XY stage images a grating and a texture under three controllers, on one page."""

from __future__ import annotations

from pathlib import Path

import click

from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common

HYSTERESES = click.Choice(["plays", "preisach", "bouc-wen"])


@click.command()
@click.option("--rate", metavar="HZ", type=float, default=40.0, help="Rows per second.")
@click.option("--resonances", metavar="X Y", type=float, nargs=2, default=(900.0, 700.0), help="Of both axes, Hz.")
@click.option("--hysteresis", "kinds", metavar="X Y", type=HYSTERESES, nargs=2, default=("plays", "preisach"),
              help="Of both axes: plays, preisach or bouc-wen.")  # fmt: skip
@click.option("--noise", metavar="UM", type=float, default=0.001, help="Of a sample of the sensors.")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of noise and texture.")
@click.option(
    "--output", metavar="NAME", default="truestroke-scan", help="Write NAME.html, and NAME.gwy with --images."
)
@click.option("--images", "ending", metavar="ENDING", type=click.Choice(["gwy", "tif", "nxs"]), help="Also write all "
              "images: gwy (Gwyddion), tif or nxs (NeXus).")  # fmt: skip
@common.page_options
def scan(
    rate: float, resonances: tuple[float, float], kinds: tuple[str, str], noise: float, seed: int, output: str,
    ending: str | None, plots: Path | None, as_json: bool,
) -> int:  # fmt: skip
    """Image a grating and a texture with a simulated XY stage.

    Open loop, with the paper's law, and with truestroke, side by side: 512 x 512 pixels, trace and retrace, at 40 rows
    a second on a stage of 900 Hz whose axes disturb each other. No hardware, no arguments.
    """
    from concurrent.futures import ThreadPoolExecutor

    from truestroke import scans
    from truestroke.signals.scans.image_files import IMAGE
    from truestroke.studies.scanning.imaging import image_stage

    (page_file,) = common.outputs(output, ".html")
    target = common.to_write("--output", page_file.with_suffix(f".{ending}"), IMAGE) if ending else None
    about = {"rate": rate, "resonances": resonances, "kinds": kinds, "noise": noise, "seed": seed}
    with common.progress("scanning"), ThreadPoolExecutor(1) as beside:
        running = beside.submit(image_stage, **about)  # type: ignore[arg-type]
        from truestroke.studies.scanning import page as report  # matplotlib loads while the stage moves

        found = running.result()
        made = report.page(found, common.as_asked()["command"])
        pictures = common.save_page(made, page_file, plots)
    if target:
        every = [
            scans.Image(data=one.data, size=one.size, origin=one.origin, name=f"{name}, {one.name}", unit=one.unit)
            for name, imaged in found.imaged.items()
            for pair in imaged.images.values()
            for one in pair.values()
        ]
        scans.save_images(target, every, scan=found.scan)
    if as_json:
        written = {"page": str(page_file), "images": target and str(target), "pictures": pictures}
        common.print_json({**found.verdict.as_dict(), **found.as_dict(), **written})
        return ExitCode.of(found.verdict)
    rows = [[cell.replace("µ", "u") for cell in row] for row in report.rows(found)]
    common.print_table(report.HEADS, rows)
    common.print_text(f"spiral     100 turns a second: {found.spiral:.2g} % of its diameter off, rms")
    common.print_verdict(found.verdict)
    common.print_files(page=page_file, images=target, pictures=plots)
    return ExitCode.of(found.verdict)
