"""The software that hardware, panels and clusters need."""

import itertools
from collections.abc import Collection

from truestroke.runtime.doctor.finding import Finding, Level
from truestroke.runtime.drivers import registry
from truestroke.runtime.drivers.registry import Need, package

SERVERS = {
    "epics": (package("softioc", "truestroke serve --epics"),),
    "live": tuple(package(name, "the live page, --live") for name in ("starlette", "uvicorn")),
}
"""What the server of a table of the configuration needs."""
CLUSTER = package("distributed", "batches on several computers, by dask")


def look(needed: Collection[Need] = ()) -> list[Finding]:
    """What all drivers need, the servers and batches; those in `needed` are required.

    Examples
    --------
    >>> [finding.what for finding in look()]
    ['nidaqmx', 'libnidaqmx', 'pyvisa', 'pyvisa-py', 'pyserial', 'pipython', 'softioc', 'starlette', \
'uvicorn', 'distributed']
    """
    needs = dict.fromkeys(need for name in registry.names() for need in of(name))  # two drivers may need the same
    return [_finding(need, need in needed) for need in (*needs, *itertools.chain(*SERVERS.values()), CLUSTER)]


def of(name: str) -> tuple[Need, ...]:
    """What the driver of that name needs."""
    return tuple(getattr(registry.find(name), "needs", ()))


def _finding(need: Need, required: bool) -> Finding:
    found = need.found()
    level = Level.OK if found else Level.MISSING
    return Finding("drivers", need.what, need.why, found or "not found", level, need.command, required)
