"""`truestroke zoo`: the controller on many plants."""

from __future__ import annotations

from pathlib import Path

import click

from truestroke.cli import common
from truestroke.cli import results as shown


def _names(context: click.Context, option: click.Parameter, value: str) -> tuple[str, ...]:
    """The controllers, each one that exists, none twice."""
    names = tuple(dict.fromkeys(value.split(",")))
    for name in names:
        if name not in ("adaptive", "paper"):
            raise click.BadParameter(f"{name!r} is not one of adaptive, paper.")
    return names


@click.command()
@click.option("--plants", metavar="N", type=click.IntRange(1), default=200, help="How many are drawn.")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the zoo.")
@click.option("--controllers", metavar="NAMES", default="adaptive,paper", callback=_names, help="Of adaptive, paper.")
@click.option("--half", type=click.Choice(["all", "seen", "unseen"]), default="all", help="Even numbers are seen, for "
              "tuning; odd ones are not.")  # fmt: skip
@click.option("--workers", metavar="N", type=click.IntRange(1), default=2, help="Processes.")
@click.option("--only", metavar="NUMBER", type=click.IntRange(0), help="Play this run alone, with the first of the "
              "controllers; write its recording and page.")  # fmt: skip
@click.option("--output", metavar="NAME", default="truestroke-zoo", help="Write NAME.html; with --only also NAME.h5.")
@common.plots_option
@common.overwrite_option
@common.json_option
def zoo(
    plants: int,
    seed: int,
    controllers: tuple[str, ...],
    half: str,
    workers: int,
    only: int | None,
    output: str,
    plots: Path | None,
    as_json: bool,
) -> int:
    """Follow motions with many plants drawn at random.

    Each plant has its own hysteresis, creep, resonance, noise and drift, and half of them change suddenly. Prints
    median, 95th percentile and worst of the errors of the default controller and the paper's; writes a page.
    """
    if only is not None:
        return _one(seed, only, controllers[0], output, plots, as_json)
    (page_file,) = common.outputs(output, ".html")
    from truestroke.studies import zoo as zoos
    from truestroke.studies.zoo.table import numbers

    if not numbers(plants, half):
        raise click.UsageError(f"--plants {plants}: the {half} half of it is empty.")
    with common.stoppable(), common.progress("following") as tell:
        results = zoos.run(plants, seed, controllers, half, workers, progress=tell)
    with common.stoppable(), common.progress("drawing"):
        from truestroke.studies.zoo import page, pictures

        number = pictures.worst(results).number
        worst = zoos.record(seed, number, controllers[0])
        made = page.page(results, worst, seed, common.as_asked()["command"])
        paths = common.save_page(made, page_file, plots)
    if as_json:
        table = [line.as_dict() for line in zoos.lines(results)]
        found = {"table": table, "runs": [result.as_dict() for result in results]}
        common.print_json({**found, "page": str(page_file), "pictures": paths})
        return 0
    common.print_table(*page.table(results))
    common.print_table(*page.worst_runs(results), left="what happened")
    for name in controllers:
        common.print_text(page.verdict(results, name))
    common.print_files(page=page_file, pictures=plots)
    common.suggest((f"zoo{f' --seed {seed}' if seed else ''} --only {number}", "recording and page of the worst run"))
    return 0


def _one(seed: int, number: int, controller: str, output: str, plots: Path | None, as_json: bool) -> int:
    recording_file, page_file = common.outputs(output, ".h5", ".html")
    from truestroke.studies import zoo as zoos

    with common.stoppable(), common.progress("following"):
        recording = zoos.record(seed, number, controller)
    recording = shown.own(recording)
    recording.save(recording_file)
    if not as_json:
        click.echo(zoos.draw(seed, number).words())
    return shown.finish(recording, page_file, plots, as_json, recording_file)
