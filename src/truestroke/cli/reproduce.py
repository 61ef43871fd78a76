"""`truestroke reproduce`: the paper's tables and figures beside ours."""

from pathlib import Path

import click

from truestroke.cli import common
from truestroke.studies import paper


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(paper.NAMES), metavar="[NAME]...")
@click.option("--output", metavar="NAME", default="truestroke-reproduce", help="Write NAME.html.")
@common.page_options
def reproduce(names: tuple[str, ...], output: str, plots: Path | None, as_json: bool) -> None:
    """Print the paper's tables and figures beside ours."""
    (page_file,) = common.outputs(output, ".html")
    with common.stoppable(), common.progress("reproducing") as tell:
        results = paper.reproduce(names, progress=tell)
    with common.progress("plotting"):
        from truestroke.studies.paper.page import page

        pictures = common.save_page(page(results, common.to_repeat()), page_file, plots)
    if as_json:
        found = [result.as_dict() for result in results]
        common.print_json({"results": found, "page": str(page_file), "pictures": pictures})
        return
    for result in results:
        click.secho(result.title, bold=True)
        common.print_table(["quantity", "paper", "ours", "unit"], [row.cells() for row in result.rows], left="unit")
        common.print_text(result.sentence)
        click.echo()
    common.print_files(page=page_file, pictures=plots)
    common.suggest(("compare", "eight controllers on the same actuator"), ("track", "one run with all its pictures"))


reproduce.help = f"""Print the paper's tables and figures beside ours.

NAME is one of {", ".join(paper.NAMES)}; without a name all of them. Prints the paper's values beside those of its
algorithm here, and the differences with their causes; writes a page with the pictures.
"""
