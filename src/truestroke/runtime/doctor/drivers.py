"""The software that hardware, panels and clusters need."""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import sys
from contextlib import suppress

from truestroke.runtime.doctor.finding import Finding, Level

PACKAGES = (
    ("nidaqmx", "drives cards of National Instruments"),
    ("pipython", "drives controllers of Physik Instrumente"),
    ("softioc", "truestroke serve --epics"),
    ("distributed", "batches on several computers, by dask"),
)
NI_LIBRARY = "libnidaqmx"


def look(needed: frozenset[str] = frozenset()) -> list[Finding]:
    """The optional packages, and the library of NI; those in `needed` are required.

    Examples
    --------
    >>> [finding.what for finding in look()]
    ['nidaqmx', 'libnidaqmx', 'pipython', 'softioc', 'distributed']
    """
    findings = [_package(name, why, name in needed) for name, why in PACKAGES]
    findings.insert(1, _ni_library(NI_LIBRARY in needed))
    return findings


def _package(name: str, why: str, required: bool) -> Finding:
    try:
        level, found, command = Level.OK, importlib.metadata.version(name), ""
    except importlib.metadata.PackageNotFoundError:
        level, found, command = Level.MISSING, "not installed", f"{sys.executable} -m pip install '{_asked_for(name)}'"
    return Finding(level=level, part="drivers", what=name, found=found, why=why, command=command, required=required)


def _asked_for(name: str) -> str:
    """The package with the versions that our extras name."""
    lines = importlib.metadata.requires("truestroke") or []
    asked = (line.partition(";")[0].strip() for line in lines)
    return next((line for line in asked if line.startswith(name)), name)


def _ni_library(required: bool) -> Finding:
    """Found as the package nidaqmx finds it; the loader's path is looked at, too."""
    found = ctypes.util.find_library("nidaqmx")
    if found is None:
        with suppress(OSError):
            found = ctypes.CDLL(f"{NI_LIBRARY}.so.1")._name
    return Finding(
        level=Level.MISSING if found is None else Level.OK,
        part="drivers",
        what=NI_LIBRARY,
        found="not found" if found is None else str(found),
        why="the driver of National Instruments, below the package nidaqmx",
        command="" if found else f"{sys.executable} -m nidaqmx installdriver",
        required=required,
    )
