"""`truestroke bench`: what a step costs on this machine."""

from __future__ import annotations

from pathlib import Path

import click

from truestroke.cli import common


@click.command()
@click.option("--steps", metavar="N", type=click.IntRange(10_000), default=1_000_000, help="Of the kernel in C; a "
              "tenth of them through Python, a hundredth of a rival.")  # fmt: skip
@click.option("--output", metavar="NAME", default="truestroke-bench", help="Write NAME.html.")
@common.pictures_option
@common.overwrite_option
@common.json_option
def bench(steps: int, output: str, figures: Path | None, as_json: bool) -> None:
    """Measure what a step costs here, beside its rivals.

    Recursive least squares of 16 parameters in C, in padasip, dlib, filterpy, river and NumPy, beside the machine's
    limit for it; ticks of the paper's and the default controller in C and through Python. Writes a page.
    """
    (page_file,) = common.outputs(output, ".html")
    from truestroke.studies import bench as benches
    from truestroke.studies.bench import page, table

    with common.progress("timing") as tell:
        costs, missing = benches.run(steps, progress=tell)
    page.save_page(costs, missing, page_file, common.as_asked()["command"])
    paths = page.save_pictures(costs, figures) if figures else []
    if as_json:
        found = {"machine": table.machine(), "costs": [cost.as_dict() for cost in costs], "missing": missing}
        common.print_json({**found, "page": str(page_file), "pictures": [str(path) for path in paths]})
        return
    common.print_table(*table.update_table(costs))
    common.print_table(*table.tick_table(costs))
    common.print_text(table.verdict(costs))
    for reason in missing:
        common.print_text(f"- not measured: {reason}")
    common.print_files(page=page_file, pictures=figures)
