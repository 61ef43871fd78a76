"""`truestroke robustness`: the controller on many plants."""

from pathlib import Path

import click

from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, results

SLOW, FAST = ("adaptive", "paper"), ("measured", "known", "unknown")  # controllers of the two halves of the study


def _names(context: click.Context, option: click.Parameter, value: str | None) -> tuple[str, ...]:
    """The controllers, each one that exists, none twice."""
    fast = context.params["fast"]
    some = FAST if fast else SLOW
    if value is None:
        return ("measured", "unknown") if fast else SLOW
    names = tuple(dict.fromkeys(value.split(",")))
    for name in names:
        if name not in some:
            raise click.BadParameter(f"{name!r} is not one of {', '.join(some)}.")
    if {"measured", "known"} <= set(names):
        raise click.BadParameter("measured and known are for two runs of the study.")
    return names


@click.command()
@click.option("--plants", metavar="N", type=click.IntRange(1), default=200, help="How many are sampled.")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of all that is sampled.")
@click.option("--fast", is_flag=True, is_eager=True, help="Stages of 50 to 2000 Hz, and motions up to half of that.")
@click.option("--controllers", metavar="NAMES", callback=_names, help="Of adaptive, paper; with --fast "
              "of measured or known, unknown: the dynamics.")  # fmt: skip
@click.option("--half", type=click.Choice(["all", "seen", "unseen"]), default="all", help="Even numbers are seen, for "
              "tuning; odd ones are not.")  # fmt: skip
@click.option("--workers", metavar="N", type=click.IntRange(1), default=2, help="Threads.")
@click.option("--only", metavar="NUMBER", type=click.IntRange(0), help="Simulate this run alone, with the first of the "
              "controllers; write its recording and page.")  # fmt: skip
@click.option("--output", metavar="NAME", default="truestroke-robustness", help="Write NAME.html; with --fast also "
              "NAME.sqlite, with --only NAME.h5.")  # fmt: skip
@common.page_options
def robustness(
    plants: int, seed: int, fast: bool, controllers: tuple[str, ...], half: str, workers: int, only: int | None,
    output: str, plots: Path | None, as_json: bool,
) -> int:  # fmt: skip
    """Follow motions with many plants sampled at random.

    Each plant has its own hysteresis, creep, resonance, noise and drift, and half of them change suddenly. Prints
    median, 95th percentile and worst of the errors of the default controller and the paper's; writes a page.

    With --fast: stages with modes, lag, dead time and hystereses of three structures, in motions up to half of the
    first resonance; the dynamics are measured before, or unknown. Results go to NAME.sqlite as they come: call it again
    after Ctrl-C, or with more --plants, and it continues.
    """
    if only is not None:
        return _one(seed, only, controllers[0], fast, output, plots, as_json)
    from truestroke.studies import robustness as studies

    if fast:
        return _fast(seed, studies.numbers(plants, half), controllers, workers, output, plots, as_json)
    (page_file,) = common.outputs(output, ".html")
    asked = studies.Robustness(seed=seed, numbers=studies.numbers(plants, half), controllers=controllers)
    if not asked.numbers:
        raise click.UsageError(f"--plants {plants}: the {half} half of it is empty.")
    with common.progress("simulating") as tell:
        rows = studies.run(asked, workers, tell)
    verdict = studies.judge(rows)
    with common.stoppable(), common.progress("plotting"):
        from truestroke.studies.robustness import page

        number = page.worst_first(rows)[0].number
        worst = studies.record(seed, number, controllers[0])
        paths = common.save_page(page.page(rows, worst, common.to_repeat()), page_file, plots)
    if as_json:
        runs = [{"number": row.number, "what": row.sampled["what"], **row.metrics} for row in rows]
        found = {"table": [vars(line) for line in studies.lines(rows)], "runs": runs}
        common.print_json({**verdict.as_dict(), **found, "page": str(page_file), "pictures": paths})
        return ExitCode.of(verdict)
    common.print_table(*page.table(rows))
    common.print_table(*page.worst_runs(rows), left="what happened")
    for name in controllers:
        common.print_text(studies.sentence(rows, name))
    common.print_verdict(verdict)
    common.print_files(page=page_file, pictures=plots)
    again = f"robustness{f' --seed {seed}' if seed else ''} --only {number}"
    common.suggest((again, "recording and page of the worst run"))
    return ExitCode.of(verdict)


def _fast(
    seed: int, numbers: range, controllers: tuple[str, ...], workers: int, output: str, plots: Path | None,
    as_json: bool,
) -> int:  # fmt: skip
    store_file, page_file = common.outputs(output, ".sqlite", ".html")
    from truestroke.studies import robustness as studies
    from truestroke.studies.robustness import fast

    if not numbers:
        raise click.UsageError("--plants: that half of it is empty.")
    study = fast.FastRobustness(seed=seed, numbers=numbers, controllers=controllers)
    try:
        with common.progress("simulating") as tell:
            rows = studies.run(study, workers, tell, file=store_file, with_refused=True)
    except KeyboardInterrupt:
        click.echo(f"{store_file} keeps what is done; the same command continues.", err=True)
        raise
    verdict = fast.judge(rows)
    with common.stoppable(), common.progress("plotting"):
        from truestroke.studies.robustness.fast import page

        row, controller = page.worst_first(rows)[0]
        recording = fast.record(seed, row.number, controller)
        made = page.page(rows, (row, controller), recording, common.to_repeat())
        paths = common.save_page(made, page_file, plots)
    if as_json:
        runs = [{"number": row.number, **row.sampled, **row.metrics, "error": row.error} for row in rows]
        found = {"table": [vars(line) for line in fast.results(rows)], "runs": runs}
        common.print_json(
            {**verdict.as_dict(), **found, "store": str(store_file), "page": str(page_file), "pictures": paths}
        )
        return ExitCode.of(verdict)
    common.print_table(*page.table(rows))
    common.print_table(*page.compared(rows))
    common.print_table(*page.worst_runs(rows))
    common.print_verdict(verdict)
    common.print_files(store=store_file, page=page_file, pictures=plots)
    again = f"robustness --fast{f' --seed {seed}' if seed else ''} --controllers {controller} --only {row.number}"
    common.suggest((again, "recording and page of the worst run"))
    return ExitCode.of(verdict)


def _one(seed: int, number: int, controller: str, fast: bool, output: str, plots: Path | None, as_json: bool) -> int:
    recording_file, page_file = common.outputs(output, ".h5", ".html")
    from truestroke.studies import robustness as studies
    from truestroke.studies.robustness import fast as fast_studies

    record = fast_studies.record if fast else studies.record
    with common.stoppable(), common.progress("simulating"):
        recording = record(seed, number, controller)
    recording = results.own(recording)
    recording.save(recording_file)
    if not as_json:
        click.echo(recording.metadata["robustness"]["what"])
    return results.finish(recording, page_file, plots, as_json, recording_file)
