"""`truestroke scan`: on hardware, or a simulated XY stage that images two samples under three controllers."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.base import files, system, toml
from truestroke.base.checks import SettingError
from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import common, realtime

if TYPE_CHECKING:
    import truestroke
    from truestroke.model.dynamics import Mode
    from truestroke.runtime.realtime.config import Job
    from truestroke.runtime.realtime.imaging import Imaging
    from truestroke.signals.scans import Image, Recorded

HYSTERESES = click.Choice(["plays", "preisach", "bouc-wen"])
SIMULATED = ("rate", "resonances", "kinds", "noise", "seed")  # options without --config


@click.command()
@click.option("--config", type=common.FILE, metavar="FILE", help="Scan on hardware: driver, axes, limits and [scan], "
              "TOML.")  # fmt: skip
@click.option("--rate", metavar="HZ", type=float, default=40.0, help="Rows per second of the simulation.")
@click.option("--resonances", metavar="X Y", type=float, nargs=2, default=(900.0, 700.0), help="Of both axes, Hz.")
@click.option("--hysteresis", "kinds", metavar="X Y", type=HYSTERESES, nargs=2, default=("plays", "preisach"),
              help="Of both axes: plays, preisach or bouc-wen.")  # fmt: skip
@click.option("--noise", metavar="UM", type=float, default=0.001, help="Of a sample of the sensors.")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of noise and texture.")
@click.option("--output", metavar="NAME", help="Write NAME.html, with --images NAME.gwy; with --config also the "
              "recordings NAME-x.h5, NAME-y.h5.  [default: truestroke-scan, or as the configuration says]")  # fmt: skip
@click.option("--images", "endings", metavar="ENDING", type=click.Choice(["gwy", "gsf", "tif", "nxs"]), multiple=True,
              help="Also write all images, again and again: gwy (Gwyddion), gsf (a file for each), tif, nxs (NeXus).  "
              "[with --config: gsf]")  # fmt: skip
@realtime.live_option
@common.page_options
def scan(
    config: Path | None, rate: float, resonances: tuple[float, float], kinds: tuple[str, str], noise: float, seed: int,
    output: str | None, endings: tuple[str, ...], live: bool, plots: Path | None, as_json: bool,
) -> int:  # fmt: skip
    """Scan an area with two axes, on hardware (--config), or simulated.

    Without arguments a simulated XY stage images a grating and a texture, open loop, with the paper's law, and with
    truestroke, side by side: 512 x 512 pixels, trace and retrace, at 40 rows a second on a stage of 900 Hz whose axes
    disturb each other.
    """
    if config is not None:
        return _on_hardware(config, output, endings or ("gsf",), live, plots, as_json)
    if live:
        raise click.UsageError("--live shows a run in real time: it needs --config.")
    from concurrent.futures import ThreadPoolExecutor
    from importlib import import_module

    from truestroke.studies.scanning.imaging import NAMES, PIXELS, expected, image, planned, seconds_for

    (page_file,) = common.outputs(output or "truestroke-scan", ".html")
    names = {key: ", ".join(key) for key in product(NAMES, ("grating", "texture"), ("trace", "retrace"))}
    _check_images(page_file, endings, names.values(), PIXELS**2)
    stage, motion = planned(rate, resonances, kinds, noise, seed)  # before anything is said of it
    if seconds_for(rate) > common.LONG:
        system.return_memory()  # a tenth of the time of fast rows
    common.foretell(f"{PIXELS} rows at {rate:g} a second take about", seconds_for(rate), as_json)
    _say(expected(rate, resonances), as_json)
    with common.progress("scanning") as tell, ThreadPoolExecutor(1) as beside:
        loading = beside.submit(import_module, "truestroke.studies.scanning.page")  # with matplotlib
        found = image(stage, motion, seed, tell)  # in the thread that Ctrl-C interrupts
        report = loading.result()
        made = report.page(found, common.to_repeat())
        pictures = common.save_page(made, page_file, plots)
    every = [
        dataclasses.replace(found.imaged[name].images[sample][way], name=words)
        for (name, sample, way), words in names.items()
    ]
    written = _save_images(page_file, endings, every, found.scan)
    if as_json:
        files = {"page": str(page_file), "images": [str(one) for one in written], "pictures": pictures}
        common.print_json({**found.verdict.as_dict(), **found.as_dict(), **files})
        return ExitCode.of(found.verdict)
    rows = [[cell.replace("µ", "u") for cell in row] for row in report.rows(found)]
    common.print_table(report.HEADS, rows)
    common.print_text(f"spiral     100 turns a second: {found.spiral:.2g} % of its diameter off, rms")
    common.print_verdict(found.verdict)
    _print_files(page_file, written, plots)
    return ExitCode.of(found.verdict)


def _say(words: str, as_json: bool) -> None:
    """What is to be expected, before the scan; on stderr."""
    if words and not as_json:
        common.print_text(words, err=True)


# ---- Files of images -----------------------------------------------------------------------------------------------


def _check_images(
    page_file: Path, endings: tuple[str, ...], names: Collection[str], pixels: int, option: str = "--output"
) -> None:
    """An error now rather than after the scan, where images of these names, with so many pixels, cannot be written."""
    from truestroke.signals.scans import image_files

    needed = common.SPACE + 8 * pixels * len(names) * len(endings)
    for ending in endings:
        image_files.require_library(Path(f"image.{ending}"))
        each = [_gsf(page_file, name) for name in names]
        for file in each if ending == "gsf" else [page_file.with_suffix(f".{ending}")]:
            common.to_write(option, file, image_files.IMAGE, needed)


def _gsf(page_file: Path, name: str) -> Path:
    """The file of one image: its name is behind that of the page."""
    return page_file.with_name(f"{page_file.stem}-{name.replace(', ', '-').replace(' ', '-')}.gsf")


def _save_images(
    page_file: Path, endings: tuple[str, ...], images: list[Image], scan: truestroke.scans.Scan
) -> list[Path]:
    """All images in each format; a .gsf holds one."""
    from truestroke import scans

    written = []
    for ending in endings:
        if ending != "gsf":
            written.append(scans.save_images(page_file.with_suffix(f".{ending}"), images, scan=scan))
            continue
        written += [scans.save_images(_gsf(page_file, one.name), one) for one in images]
    return written


def _print_files(page_file: Path, written: list[Path], plots: Path | None) -> None:
    for one in written:
        common.print_files(images=one)
    common.print_files(page=page_file, pictures=plots)


# ---- On hardware ---------------------------------------------------------------------------------------------------


def _on_hardware(
    config: Path, output: str | None, endings: tuple[str, ...], live: bool, plots: Path | None, as_json: bool
) -> int:
    """Run the axes along the scan, record the signal, and make its images; the exit code."""
    from truestroke import ImageError
    from truestroke.signals import judgement
    from truestroke.signals.scans import rates

    job, imaging = _to_scan(config)
    _say(imaging.notice, as_json)
    if imaging.scan.name == "raster":
        _say(rates.ringing(float(imaging.scan.settings["rate"]), _modes(job, imaging)), as_json)  # type: ignore[arg-type]
    ending = ".h5" if output else job.file.suffix or ".h5"
    option = "--output" if output else f"{config}: recording.file"
    recording, page_file = common.outputs(output or str(job.file.with_suffix("")), ending, ".html", option=option)
    names, most = [imaging.signal.name], imaging.columns * max(imaging.columns, imaging.scan.lines.size)
    if imaging.scan.name == "raster":
        names = [f"{names[0]}, {way}" for way in ("trace", "retrace")]
    _check_images(page_file, endings, names, most, option)
    command, server = ("scan --live", job.live) if live else ("scan", None)
    done = realtime.follow(command, config, job, recording, files.replacing(), as_json, server)
    if done.outcome.reason:
        common.complain(done.outcome.reason)
    try:
        found = _recorded(imaging, done.recordings, _resonances(job, imaging))
    except ImageError as error:
        return _without_image(done, str(error), as_json)
    verdict = judgement.worst({**{f"axis {name}": one for name, one in done.verdicts.items()}, "image": found.verdict})
    code = realtime.code_of(done.outcome, verdict)
    written = _save_images(page_file, endings, list(found.images.values()), found.scan)
    with common.progress("plotting"):
        from truestroke.report import scan as report

        pictures = common.save_page(report.page(found, verdict, common.to_repeat(), done.recordings), page_file, plots)
    if as_json:
        paths = {"page": str(page_file), "images": [str(one) for one in written], "pictures": pictures}
        run = realtime.as_dict(done, code)
        common.print_json({**run, **verdict.as_dict(), **found.as_dict(), **paths})
        return code
    realtime.print_run(done)
    click.echo()
    for words, value in report.rows(found, done.recordings):
        click.echo(f"{words:40} {value.replace('µ', 'u')}")
    common.print_verdict(verdict)
    _print_files(page_file, written, plots)
    return code


def _to_scan(config: Path) -> tuple[Job, Imaging]:
    """What the configuration asks for; an error if it has no scan, or an option is of the simulation."""
    from truestroke.runtime.realtime import config as configuration

    context = click.get_current_context()
    for name in SIMULATED:
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            option = next(one.opts[0] for one in context.command.params if one.name == name)
            raise click.UsageError(f"{option} is of the simulation: with --config the table [scan] has the motion.")
    missing = click.UsageError(f"{config} has no table [scan]: add one, or follow its motion by truestroke run.")
    try:
        job = configuration.load(config)
    except SettingError as error:
        if "trajectory" in error.argument and "scan" not in toml.read(config):  # axes that [scan] would move
            raise missing from error
        raise
    if job.imaging is None:
        raise missing
    return job, job.imaging


def _without_image(done: realtime.Closed, why: str, as_json: bool) -> int:
    """Of a run whose recordings make no image: where they are; the exit code."""
    code = realtime.code_of(done.outcome, Verdict("bad"))
    if as_json:
        common.print_json({**realtime.as_dict(done, code), "images": []})
    if not done.outcome.ticks and done.outcome.reason:  # which says why there is nothing
        return code
    kept = ", ".join(map(str, done.outcome.files)) if done.outcome.ticks else "no file"
    return common.complain(f"no image: {why}; what was recorded is in {kept}", code)


def _resonances(job: Job, imaging: Imaging) -> dict[str, float]:
    """First resonance of each axis of the scan whose controller knows it, Hz."""
    known = {name: getattr(settings, "resonance", 0.0) for name, settings in _settings(job, imaging).items()}
    known |= {name: mode.frequency for name, mode in _modes(job, imaging).items()}
    return {name: frequency for name, frequency in known.items() if frequency}


def _modes(job: Job, imaging: Imaging) -> dict[str, Mode]:
    """First mode of each axis of the scan whose controller knows its dynamics."""
    known = {name: getattr(settings, "dynamics", None) for name, settings in _settings(job, imaging).items()}
    return {name: dynamics.modes[0] for name, dynamics in known.items() if dynamics and dynamics.modes}


def _settings(job: Job, imaging: Imaging) -> dict[str, Any]:
    """Of the controllers of the axes of the scan, where they have some."""
    return {one.name: getattr(one.controller, "settings", None) for one in job.axes if one.name in imaging.axes}


def _recorded(
    imaging: Imaging, recordings: Mapping[str, truestroke.Recording], resonances: dict[str, float]
) -> Recorded:
    """Images of the signal, which stands in the recording of the first axis; places as the sensors read them."""
    import numpy as np

    from truestroke import scans
    from truestroke.base import frames

    every = list(recordings.values())
    measured = np.stack([one["measured"] for one in every])
    if imaging.frame is not None:
        measured = frames.turn(np.array(imaging.frame), measured)
    x, y = (measured[list(recordings).index(name)] for name in imaging.axes)
    signal = imaging.signal
    about = {"columns": imaging.columns, "name": signal.name, "unit": signal.unit, "resonances": resonances}
    about["axes"] = imaging.axes
    return scans.recorded(imaging.scan, x, y, every[0][signal.name], **about)  # type: ignore[arg-type]
