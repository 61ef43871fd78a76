"""`truestroke study`: many random runs of a file, continued where they stopped."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.studies.engine.executors import Work
    from truestroke.studies.study import Store, Study


def _example(context: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked:
        from truestroke.studies.study import example

        click.echo(example(), nl=False)
        context.exit()


@click.command()
@click.argument("file", metavar="FILE.toml", type=common.FILE)
@click.option("--example", is_flag=True, is_eager=True, expose_value=False, callback=_example, help="Print a study to "
              "begin with, that of Sec. 4.3, and leave.")  # fmt: skip
@click.option("--runs", metavar="N", type=click.IntRange(1), help="In place of the number in the file.")
@click.option("--executor", type=click.Choice(["threads", "dask", "slurm"]), default="threads", help="Where it runs.")
@click.option("--workers", metavar="N", type=click.IntRange(1), help="Threads, processes or jobs of one core; by "
              "default one for each core here, 16 jobs.")  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Of a dask cluster that is there, as tls://host:8786.")
@click.option("--report-only", is_flag=True, help="Run nothing; report what is there.")
@click.option("--output", metavar="NAME", help="Keep results in NAME.sqlite, write NAME.html; by default FILE's name.")
@common.page_options
def study(
    file: Path, output: str | None, plots: Path | None, as_json: bool, runs: int | None, report_only: bool, **where: Any
) -> int:
    """Sample many runs from the distributions in FILE.toml, simulate them, and report how many converge.

    Results go to one file as they come. Call it again after Ctrl-C, a crash, or with more --runs: it continues.
    """
    if where["scheduler"] and where["executor"] != "dask":
        raise click.UsageError("--scheduler: belongs to --executor dask.")
    from truestroke.studies import study as studies

    asked = studies.load(file, runs)
    store_file, page_file = common.outputs(output or file.stem, ".sqlite", ".html")
    studies.first(asked, range(asked.runs))  # a setting out of its bounds is reported before the file belongs to it
    try:
        with studies.Store(store_file, asked) as store:
            if not report_only:
                with common.progress("simulating") as tell:
                    studies.run(asked, store, _work(store_file, **where), tell)
            return _report(store, asked, page_file, plots, as_json)
    except KeyboardInterrupt:
        click.echo(f"{store_file} keeps what is done; the same command continues.", err=True)
        raise


def _work(store_file: Path, executor: str, workers: int | None, scheduler: str | None) -> Work:
    from truestroke.studies.engine import executors

    if executor == "slurm":
        return executors.slurm(store_file.with_suffix(".slurm"), workers or 16)
    return executors.dask(workers, scheduler) if executor == "dask" else executors.threads(workers)


def _report(store: Store, asked: Study, page_file: Path, plots: Path | None, as_json: bool) -> int:
    from truestroke.studies import study as studies
    from truestroke.studies.study import page

    rows, failed, cost = store.rows(asked.runs), store.failed(asked.runs), store.cost()
    if not rows:
        raise click.ClickException(page.failures(failed) or f"{store.path} holds no run yet.")
    verdict = studies.judge(asked, rows, failed)
    with common.progress("plotting"):
        made = page.page(asked, rows, cost, common.to_repeat(), failed)
        paths = common.save_page(made, page_file, plots)
    if as_json:
        lines = {line.controller: vars(line) for line in studies.lines(asked, rows)}
        numbers = {name: [vars(one) for one in studies.informative(asked, rows, name)] for name in asked.controllers}
        spent = {"ticks": cost[0], "seconds": cost[1]}
        files = {"store": str(store.path), "page": str(page_file), "pictures": paths}
        runs = {"runs": len(rows), "failed": {row.number: row.error for row in failed}}
        found = {**verdict.as_dict(), **runs, "controllers": lines, "informative": numbers, "cost": spent}
        common.print_json({**found, **files})
        return ExitCode.of(verdict)
    for table, _ in page.tables(asked, rows, cost):
        common.print_table(*table)
    common.print_text(" ".join(filter(None, [page.result(asked, rows), page.failures(failed), page.meaning(asked)])))
    common.print_verdict(verdict)
    common.print_files(store=store.path, page=page_file, pictures=plots)
    return ExitCode.of(verdict)
