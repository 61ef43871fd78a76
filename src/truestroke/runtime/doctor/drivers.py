"""The software that hardware, panels and clusters need."""

from collections.abc import Collection

from truestroke.runtime.doctor.finding import Finding, Level
from truestroke.runtime.drivers import registry
from truestroke.runtime.drivers.registry import Need, package

SERVER = package("softioc", "truestroke serve --epics")
CLUSTER = package("distributed", "batches on several computers, by dask")


def look(needed: Collection[Need] = ()) -> list[Finding]:
    """What all drivers need, the server and batches; those in `needed` are required.

    Examples
    --------
    >>> [finding.what for finding in look()]
    ['nidaqmx', 'libnidaqmx', 'pyvisa', 'pyvisa-py', 'pyserial', 'pipython', 'softioc', 'distributed']
    """
    needs = dict.fromkeys(need for name in registry.names() for need in of(name))  # two drivers may need the same
    return [_finding(need, need in needed) for need in (*needs, SERVER, CLUSTER)]


def of(name: str) -> tuple[Need, ...]:
    """What the driver of that name needs."""
    return tuple(getattr(registry.find(name), "needs", ()))


def _finding(need: Need, required: bool) -> Finding:
    found = need.found()
    level = Level.OK if found else Level.MISSING
    return Finding("drivers", need.what, need.why, found or "not found", level, need.command, required)
