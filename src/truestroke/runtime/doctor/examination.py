"""All checks of the doctor, of this computer alone or for one configuration."""

from contextlib import closing
from pathlib import Path

from truestroke.base import toml
from truestroke.base.checks import SettingError
from truestroke.runtime.doctor import disk, drivers, machine
from truestroke.runtime.doctor.finding import Finding, Level
from truestroke.runtime.drivers.protocol import DriverError
from truestroke.runtime.drivers.registry import Need
from truestroke.runtime.realtime import config as configuration
from truestroke.runtime.realtime.runner import recordings
from truestroke.signals.timing import Timing

PART = "configuration"


def examine(config: Path | None = None, probe: float = machine.PROBE) -> list[Finding]:
    """Check drivers, real-time settings and permissions; with a configuration, its requirements.

    No output moves: of the hardware that a configuration names the driver is opened and closed.

    Parameters
    ----------
    config : Path, optional
        TOML of `truestroke run`. What it cannot do without is `required`.
    probe : float
        How long lateness is measured, s.

    Returns
    -------
    list[Finding]
        In the order of the table.

    Examples
    --------
    >>> findings = examine(probe=0.01)
    >>> sorted({finding.part for finding in findings})
    ['drivers', 'permissions', 'real time']
    """
    if config is None:
        return [*drivers.look(), *machine.look(probe=probe), *disk.look(Path())]
    needs = drivers.look(_needed(config))
    try:
        job = configuration.load(config)
    except (SettingError, OSError) as error:
        found = _finding("file", str(error), "nothing can be run without it", "truestroke run --example")
        return [found, *needs, *machine.look(probe=probe), *disk.look(Path())]
    opened, timing = _driver(job)
    period = timing.block / timing.sample_rate if timing else machine.PERIOD
    ticks = sum(len(axis.trajectory) for axis in job.axes)
    return [
        _finding("file", f"{config}: {len(job.axes)} axis, {ticks} ticks", "says what is to be run"),
        *opened,
        _recording(job),
        *needs,
        *machine.look(job.settings, period, probe),
        *disk.look(job.file.absolute().parent, disk.BYTES * ticks),
    ]


def _finding(what: str, found: str, why: str, command: str = "") -> Finding:
    """Missing if there is a command to give."""
    level = Level.MISSING if command else Level.OK
    return Finding(PART, what, why, found=found, level=level, command=command, required=True)


def _needed(config: Path) -> tuple[Need, ...]:
    """The packages behind what the file names, also where it is otherwise not in order."""
    try:
        tables = toml.read(config)
        needs = drivers.of(tables["driver"]["name"])
    except (OSError, SettingError, KeyError, TypeError):
        return ()
    return (*needs, *(need for name, server in drivers.SERVERS.items() if name in tables for need in server))


def _driver(job: configuration.Job) -> tuple[list[Finding], Timing | None]:
    """Opened, which moves nothing, and closed; what the hardware does when this computer stands still."""
    name, why = type(job.driver).__name__, "connects and configures; no output moves"
    try:
        with closing(job.driver) as driver:
            timing = driver.open()
            tell = getattr(driver, "unattended", None)
            unattended = [] if tell is None else [_unattended(*tell())]
    except (DriverError, SettingError, OSError, ImportError) as error:
        return [_finding("driver", f"{name}: {error}", why, "see the page of the driver in docs/")], None
    found = f"{name} opens: {timing.channels} axis at {timing.sample_rate:g} Hz, blocks of {timing.block}"
    return [_finding("driver", found, why), *unattended], timing


def _unattended(safe: bool, found: str) -> Finding:
    why = "when the computer itself stands still, no watchdog in software acts"
    return Finding(PART, "unattended", why, found=found, level=Level.OK if safe else Level.WARNING)


def _recording(job: configuration.Job) -> Finding:
    why = "no recording is replaced unless asked for"
    try:
        files = recordings(job.file, job.axes, overwrite=False)
    except OSError as error:
        return _finding("recording", f"{error.filename}: {error.strerror}", why, "another name in [recording]")
    return _finding("recording", ", ".join(map(str, files)), why)
