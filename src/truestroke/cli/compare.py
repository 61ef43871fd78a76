"""`truestroke compare`: eight controllers on the same waves."""

from pathlib import Path

import click

from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common


@click.command()
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--duration", metavar="S", type=click.FloatRange(min=1.0), default=20.0, help="Of the random wave; the "
              "sine takes an eighth of it, at least 2 s.")  # fmt: skip
@click.option("--output", metavar="NAME", default="truestroke-compare", help="Write NAME.html.")
@common.page_options
def compare(seed: int, duration: float, output: str, plots: Path | None, as_json: bool) -> int:
    """Follow the same waves with eight controllers.

    No compensation, a PID, fixed and adaptive inverses, LMS, the paper: each identified and tuned by code on the same
    simulated stack. Prints true rmse, maximum, delay and phase lag over the second half of a random wave and a sine;
    writes a page of pictures with the source and the tuning of each.
    """
    (page_file,) = common.outputs(output, ".html")
    with common.stoppable(), common.progress("tuning and comparing") as tell:
        from truestroke.studies import compare as comparing

        found = comparing.run(seed=seed, duration=duration, progress=tell)
    verdict = comparing.judge(found.rows)
    code = ExitCode.of(verdict)
    with common.progress("plotting"):
        from truestroke.studies.compare import page

        made = page.page(found.rows, found.rivals, common.to_repeat())
        pictures = common.save_page(made, page_file, plots)
    if as_json:
        common.print_json({**found.as_dict(), "page": str(page_file), "pictures": pictures})
        return code
    for columns, rows in page.tables(found.rows):
        common.print_table(columns, rows, dim="of p-p")
    common.print_verdict(verdict)
    common.print_files(page=page_file, pictures=plots)
    common.suggest(
        ("compare --seed 1", "another wave, other noise"),
        ("track --change-at 10", "the actuator changes suddenly"),
        ("reproduce", "the paper's figures beside ours"),
    )
    return code
