"""`truestroke learn`: the voltage of a motion that repeats, learned on hardware pass by pass."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke.base import checks, display, files
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, realtime, waveforms

if TYPE_CHECKING:
    from truestroke.control.repeating.iterative import Learned
    from truestroke.runtime.drivers.protocol import Driver
    from truestroke.runtime.realtime.watched import Watched

DEMO = {"voltage_limits": (-0.6, 3.6), "slew": 20_000.0, "safe_voltage": 0.0}
DEMO_STROKE = 35.0  # um over the whole of these limits
SECONDS = 8e-6  # of a sample that is simulated
LONGEST_SIMULATION = 600.0  # s
LONGEST = 10_000_000  # samples of a repetition


@click.command()
@click.argument("motion", metavar="[sine|raster]", type=click.Choice(["sine", "raster"]), default="raster")
@click.option("--config", metavar="FILE", type=common.FILE, help="Driver and axes with their limits: TOML, as of "
              "truestroke run.  [default: a simulated stage]")  # fmt: skip
@realtime.axis_option
@click.option("--passes", metavar="N", type=click.IntRange(1, 1000), default=8, help="At most.")
@click.option("--frequency", metavar="HZ", type=float, default=50.0, help="Of the motion.")
@click.option("--peak-to-peak", metavar="UM", type=float, default=20.0)
@click.option("--offset", metavar="UM", type=float, help="Middle of the motion.  [default: that of the travel]")
@click.option("--turn", metavar="SHARE", type=click.FloatRange(0.01, 0.99), help="Of the period of a raster that "
              "its turns take.  [default: 0.2]")  # fmt: skip
@click.option("--dynamics", metavar="FILE", type=common.FILE, help="Of `truestroke bode`.  [default: measured first]")
@click.option("--model", metavar="FILE", type=common.FILE, help="Of `truestroke identify`: makes the first pass.")
@waveforms.force_option
@click.option("--bandwidth", metavar="HZ", type=float, help="Highest harmonic that is learned.  [default: 2.4 "
              "times the first resonance]")  # fmt: skip
@click.option("--averaged", metavar="S", type=click.FloatRange(0.0, 3600.0), default=0.5,
              help="Duration of the periods of a pass that count.")  # fmt: skip
@click.option("--settle", metavar="S", type=click.FloatRange(0.0, 3600.0), help="Duration of those before them.  "
              "[default: until the start has decayed, 0.3 to 5]")  # fmt: skip
@click.option("--output", metavar="NAME", default="learned", help="Write NAME.csv, NAME.toml and "
              "NAME.html.")  # fmt: skip
@realtime.live_option
@common.page_options
def learn(
    motion: str, config: Path | None, output: str, live: bool, plots: Path | None, as_json: bool, **options: Any
) -> int:  # fmt: skip
    """Learn the voltage of a motion that repeats, pass by pass.

    Plays the motion, measures it, corrects the voltage at each harmonic through the measured response, and again until
    the error is that of the noise. Writes one repetition of the best voltage after each pass, and at the end a model of
    the actuator that the passes show. The output is at the safe voltage before and after each pass.
    """
    from truestroke.report import learning
    from truestroke.runtime.realtime.watched import StoppedError

    realtime.check_axis(config, options["axis"])
    if live and config is None:
        raise click.UsageError("--live shows hardware or a simulated driver in real time: it needs --config.")
    (page_file,) = common.outputs(output.removesuffix(".csv"), ".html")
    target = common.to_write("--output", page_file.with_suffix(".csv"), files.WAVEFORM)
    model_file = common.to_write("--output", page_file.with_suffix(".toml"), files.MODEL)
    driver, limits, rate, given = _driven(config, options)
    if options["offset"] is None:
        options["offset"] = _middle(limits, options["peak_to_peak"])
    with _naming_options():
        duration = _long(rate, options)
        expected = _expected(rate, config, options)
    wave = _wave(motion, rate, duration, options)
    given |= {key: options[key] for key in ("passes", "bandwidth", "settle", "averaged")}
    if options["dynamics"] is not None:
        given["dynamics"] = waveforms.dynamics_of(options["dynamics"], rate)
    if options["model"] is not None:
        given["model"] = truestroke.usable_model(options["model"], force=options["force"])
    shown = _watched(driver, config, limits, rate) if live and config else nullcontext(driver)
    try:
        with shown as driver:
            found = _learned(driver, wave, limits | given, target, expected, as_json)
    except StoppedError as error:
        return common.complain(str(error), ExitCode.STOPPED)
    except truestroke.DriverError as error:
        return common.complain(str(error), ExitCode.DRIVER)
    try:
        model, why = _model(found, given.get("model"), model_file)
        made = learning.page(found, common.to_repeat())
        pictures = common.save_page(made, page_file, plots)
    except (KeyboardInterrupt, OSError):
        common.complain(f"all passes are done; {_kept(found, target)}")
        raise
    if as_json:
        written: dict[str, Any] = {"waveform": str(target), "model": model and str(model), "no_model": why}
        written |= {"page": str(page_file), "pictures": pictures}
        common.print_json({**found.verdict.as_dict(), **learning.as_dict(found), **written})
        return ExitCode.of(found.verdict)
    common.print_verdict(found.verdict)
    for note in learning.notes(found):
        common.print_text(f"note: {note}")
    if why:
        common.print_text(f"no model: {why}")
    common.print_files(waveform=target, model=model, page=page_file, pictures=plots)
    common.print_simulated(config)
    return ExitCode.of(found.verdict)


def _middle(limits: dict[str, Any], peak_to_peak: float) -> float:
    """Of the travel, um, where limits hold neither end of a motion; of one from 0 um on where no stroke is known."""
    low, high = limits["voltage_limits"]
    if limits["stroke"] is None:
        return 0.5 * peak_to_peak
    return float(0.5 * (low + high) * limits["stroke"] / (high - low))


def _wave(motion: str, rate: float, duration: float, options: dict[str, Any]) -> truestroke.Trajectory:
    """The motion that repeats, at the sample rate of what is driven, Hz."""
    given = {key: options[key] for key in ("frequency", "peak_to_peak", "offset", "turn") if options[key] is not None}
    if motion == "sine" and "turn" in given:
        raise click.UsageError("--turn means nothing to a sine: leave it out.")
    made: truestroke.Trajectory = getattr(truestroke.trajectories, motion)(sample_rate=rate, duration=duration, **given)
    return made


def _expected(rate: float, config: Path | None, options: dict[str, Any]) -> tuple[str, float]:
    """How long all passes take: words, and s; a UsageError for a simulation of more than minutes."""
    from truestroke.control.repeating.iterative import repetition
    from truestroke.runtime.learning import lasting_of

    passes, given = options["passes"], {key: options[key] for key in ("passes", "settle", "averaged")}
    seconds, each = lasting_of(*repetition(rate, options["frequency"]), rate, **given)
    what = f"{passes} passes of {display.duration(each)} take at most"
    if config is None:
        simulated = SECONDS * rate * seconds
        if simulated > LONGEST_SIMULATION:
            frequency, times = options["frequency"], simulated / LONGEST_SIMULATION
            # of 1, 2, 5 and their tenfolds: a period that is a whole number of samples is repeated as it is
            decade = 10.0 ** math.floor(math.log10(times * frequency))
            enough = next(one * decade for one in (1, 2, 5, 10) if one * decade >= times * frequency)
            least = f"at least {enough:g} Hz in the simulation with {passes} passes"
            takes = f"{display.duration(seconds)} of motion take about {display.duration(simulated)}"
            fewer = "; or fewer --passes, or a stage of yours by --config FILE"
            raise click.UsageError(f"--frequency {frequency:g} Hz: must be {least}, as {takes}{fewer}.")
        seconds, what = simulated, f"{passes} simulated passes of {display.duration(each)} take about"
    return what, seconds


def _learned(
    driver: Any,
    wave: truestroke.Trajectory,
    given: dict[str, Any],
    target: Path,
    expected: tuple[str, float],
    as_json: bool,
) -> Learned:
    """What was learned; where a later pass fails or is interrupted, a line says what is on the disk."""
    from truestroke.runtime.realtime.watched import StoppedError

    best: list[Learned] = []
    waits = [expected]
    write, show = _reporter(target, as_json), common.activity(as_json)

    def report(found: Learned) -> None:
        write(found)
        best.append(found)
        if hasattr(driver, "expect"):  # shown on the live page
            _expect(driver, found, given)

    def doing(what: str) -> None:
        if waits:  # for what is refused before anything moves says nothing else
            common.foretell(*waits.pop(), as_json)
        show(what)

    def begins() -> None:
        if not as_json:
            place = wave.position[len(wave) // 2 :]  # behind the way from 0 um
            click.echo(f"motion     {place.min():.4g} to {place.max():.4g} um, with 0 um at 0 V")

    try:
        with _naming_options():
            return truestroke.learn(driver, wave, **given, report=report, doing=doing, begins=begins)
    except truestroke.TruestrokeError as error:
        if not best:
            raise
        words = f"{error}; {_kept(best[-1], target)}"
        kinds = StoppedError, truestroke.DriverError
        raise next((kind for kind in kinds if isinstance(error, kind)), click.ClickException)(words) from error
    except KeyboardInterrupt:
        if best:
            common.complain(_kept(best[-1], target))
        raise


def _naming_options() -> AbstractContextManager[None]:
    """Errors name the options that set the motion; its place is of both size and offset."""
    from truestroke.control.repeating.iterative import FREQUENCY_OF, SIZE

    return checks.inside("", {SIZE: "peak_to_peak", FREQUENCY_OF: "frequency"})


def _kept(found: Learned, target: Path) -> str:
    """What is on the disk when no further pass comes."""
    return f"{target} has the best waveform so far, of pass {found.best.number}, rmse {found.best.rmse:.4g} um"


def _expect(driver: Watched, found: Learned, given: dict[str, Any]) -> None:
    """The motion of the next pass, as the sensor reads it, and when it begins."""
    from truestroke.runtime.drivers.guard import Limits
    from truestroke.runtime.drivers.playback import lead

    limits = Limits(**{key: given[key] for key in ("voltage_limits", "slew", "safe_voltage")})
    next_pass = found.learning
    driver.expect(next_pass.desired + found.zero, lead(limits, float(next_pass.volts[0]), next_pass.sample_rate).size)


def _watched(driver: Driver, config: Path, limits: dict[str, Any], rate: float) -> AbstractContextManager[Watched]:
    """The driver, shown on the live page."""
    from truestroke.runtime.realtime import config as configuration
    from truestroke.runtime.realtime.server import Panel
    from truestroke.runtime.realtime.watched import watched

    settings = configuration.live(config)
    settings.check([])
    reach = 0.0, float(limits["stroke"] or 0.0)
    panel = Panel(name="axis", voltage_limits=limits["voltage_limits"], reach=reach, moved=False, weights=0)
    return watched(driver, settings, panel, rate)


def _model(found: Learned, before: truestroke.ActuatorModel | None, file: Path) -> tuple[Path | None, str]:
    """The file of the model that the passes show; or why there is none."""
    from truestroke.runtime.learning import model_of

    try:
        truestroke.save_model(file, model_of(found, before))
    except truestroke.TruestrokeError as error:
        return None, str(error)
    return file, ""


def _driven(config: Path | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any], float, dict[str, Any]]:
    """What is driven, its limits and stroke, its sample rate, Hz, and what its configuration knows of it.

    What an option names is not read from the configuration.
    """
    from truestroke.runtime.realtime import config as configuration

    if config is None:
        from truestroke.plant import StagePlant

        stage = StagePlant()
        return stage, DEMO | {"stroke": DEMO_STROKE}, stage.settings.sample_rate, {}
    driver, table, rate = configuration.one_axis_at(config, options["axis"])
    if options["dynamics"] is not None:
        table = dataclasses.replace(table, settings={})
    if options["model"] is not None:
        table = dataclasses.replace(table, model=None)
    known = configuration.known(config, table, rate, force=options["force"])
    if options["model"] is None and "model" not in known:
        with checks.inside(f"{config}: [[axis]] {table.name}: "):
            table.needed_stroke()
    limits = table.limits | {"stroke": table.stroke, "resonance": table.resonance, "zero": table.zero}
    return driver, limits, rate, known


def _long(rate: float, options: dict[str, Any]) -> float:
    """Seconds that hold a repetition of whole samples after the ramp."""
    from truestroke.control.repeating.iterative import repetition

    samples, _ = repetition(rate, options["frequency"])
    if samples > LONGEST:
        least = f"must be at least {rate / LONGEST:g} Hz at {rate:g} Hz"
        raise click.UsageError(f"--frequency {options['frequency']:g} Hz: {least}, so that a period fits the memory.")
    return 1.0 + 2 * samples / rate


def _reporter(target: Path, as_json: bool) -> Callable[[Learned], None]:
    """Writes the best waveform after each pass, so that no fault loses it, and prints the pass."""
    from truestroke.report import learning

    former = [] if files.replacing() else [target.with_suffix(ending) for ending in (".csv", ".toml", ".html")]
    heads = [f"{'pass':>4}  {'rmse':>10}  {'of p-p':>8}  {'maximum':>10}  {'noise':>9}"]

    def report(found: Learned) -> None:
        if former:
            _set_aside(former)
        truestroke.save_waveform(target, waveforms.learned(found))
        if not as_json:
            if heads:
                click.echo(heads.pop())
            number, rmse, share, maximum, noise, remark = (cell.replace("µ", "u") for cell in learning.rows(found)[-1])
            line = f"{number:>4}  {rmse:>10}  {share:>8}  {maximum:>10}  {noise:>9}  {remark.replace('best', '')}"
            click.echo(line.rstrip())
            sys.stdout.flush()

    return report


def _set_aside(former: list[Path]) -> None:
    """What an earlier `learn` has written gets another name before the first pass replaces it; a line says so."""
    kept = files.set_aside(former)
    former.clear()
    if kept:
        names = ", ".join(map(str, kept))
        common.complain(f"of an earlier learn, now called {names}; with --overwrite they would have been replaced")
