"""The doctor tells what is there and what is not: told apart on computers that are made up, and on this one."""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import json
import os
import platform
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from truestroke.base import system
from truestroke.cli import main
from truestroke.runtime import doctor
from truestroke.runtime.doctor import Finding, Level, disk, drivers, examine, machine
from truestroke.runtime.realtime import RealtimeSettings, config


@pytest.fixture(autouse=True)
def _quick_and_in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor, "examine", functools.partial(examine, probe=0.05))
    monkeypatch.setattr(disk, "WRITE", 2**20)
    monkeypatch.setattr(disk, "SHARED", 2**20)


def by_name(findings: list[Finding]) -> dict[str, Finding]:
    assert len({finding.what for finding in findings}) == len(findings)
    return {finding.what: finding for finding in findings}


def call(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["doctor", *arguments])
    return done.exit_code, done.output


# ---- This computer -------------------------------------------------------------------------------------------------


def test_on_this_computer() -> None:
    code, said = call("--json")
    assert code == 0
    printed = json.loads(said)
    found = {entry["what"]: entry for entry in printed["findings"]}
    assert len(found) == len(printed["findings"]) == printed["ok"] + printed["warning"] + printed["missing"]
    assert found["nidaqmx"]["found"] == importlib.metadata.version("nidaqmx")
    assert platform.release() in found["PREEMPT_RT"]["found"]
    assert found["processors"]["found"] == f"{len(os.sched_getaffinity(0))} of {os.cpu_count()} usable"
    for name in ("shared memory", "HDF5 SWMR"):  # the tests of the runner need them
        assert (found[name]["level"], found[name]["command"]) == ("ok", "")
    assert "2000 Hz for" in found["lateness"]["found"]
    assert not list(Path().iterdir())
    code, table = call()
    assert code == 0
    for name, entry in found.items():
        assert name in table
        measured_again = name == "lateness"  # what else this computer does may differ from one call to the next
        assert f"{name}: {entry['command']}" in table or not entry["command"] or measured_again


# ---- A configuration -----------------------------------------------------------------------------------------------


def write(*changes: tuple[str, str]) -> tuple[str, str]:
    text = config.example().replace('name = "simulated"', 'name = "simulated"\nregister = "volts"')
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    Path("run.toml").write_text(text)
    return "--config", "run.toml"


def test_a_configuration_that_can_run_moves_nothing() -> None:
    np.array([0.125]).tofile("volts")
    code, said = call(*write(), "--json")
    printed = json.loads(said)
    assert (code, printed["can_run"]) == (0, True)
    required = {entry["what"]: entry["level"] for entry in printed["findings"] if entry["required"]}
    assert required == dict.fromkeys(("file", "driver", "recording", "shared memory", "HDF5 SWMR"), "ok")
    assert np.fromfile("volts").tolist() == [0.125]
    assert sorted(path.name for path in Path().iterdir()) == ["run.toml", "volts"]


NI = 'name = "nidaqmx"\noutputs = ["Dev1/ao0"]\ninputs = ["Dev1/ai0"]\num_per_volt = [10.0]'
LACKS = {
    "libnidaqmx: not found": (('name = "simulated"\nregister = "volts"', NI), ("seed = 0 ", "#")),
    "file: run.toml: driver.blok = 5": (("seed = 0", "blok = 5"),),
    "driver: SimulatedDriver: open: error -2": (("seed = 0", 'faults = [{ kind = "open" }]'),),
    "recording: there.h5: a recording is there": (('"run.h5"', '"there.h5"'),),
    "folder: ": (('"run.h5"', '"nowhere/run.h5"'),),
    "processors: cpu = 4095 is not usable": (("# cpu = 1 ", "cpu = 4095 "),),
}


@pytest.mark.parametrize("complaint", LACKS)
def test_a_configuration_that_cannot_run_is_told_why(complaint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    c_library = ctypes.CDLL(None)

    def nowhere(name: str | None) -> ctypes.CDLL:
        if name is None:
            return c_library
        raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", nowhere)  # tests of the card may have loaded the fake one
    Path("there.h5").touch()
    code, said = call(*write(*LACKS[complaint]))
    assert code == 1
    assert f"run.toml needs {complaint}" in said
    assert f"{complaint.partition(':')[0]} (required): " in said


@pytest.mark.parametrize(
    ("tables", "name", "wanted"),
    [
        (config.example("serve"), "softioc", "softioc>=4.7"),
        (config.example() + "\n[live]\n", "uvicorn", "uvicorn>=0.34"),
    ],
    ids=["epics", "live"],
)
def test_a_missing_package_is_told_with_the_command(
    tables: str, name: str, wanted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    version = importlib.metadata.version

    def without(asked: str) -> str:
        if asked == name:
            raise importlib.metadata.PackageNotFoundError
        return version(asked)

    monkeypatch.setattr(importlib.metadata, "version", without)
    assert call("--json")[0] == 0
    Path("serve.toml").write_text(tables)
    code, said = call("--config", "serve.toml")
    assert code == 1
    assert f"serve.toml needs {name}: not found" in said
    assert f'{name} (required): {sys.executable} -m pip install "{wanted}"' in said


# ---- Computers that are made up ------------------------------------------------------------------------------------

GOOD = {
    "/sys/fs/cgroup/cpu.max": "max 100000",
    "/proc/swaps": "Filename Type Size Used Priority",
    "/sys/kernel/realtime": "1",
    "/sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc",
    "/proc/self/timerslack_ns": "50000",
}
POOR = {
    "processor quota": ("/sys/fs/cgroup/cpu.max", "50000 100000", "0.5 processors"),
    "memory": ("/proc/swaps", "Filename Type\n/swap.img file", "swap in use"),
    "PREEMPT_RT": ("/sys/kernel/realtime", "0", "Linux"),
    "clock source": ("/sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet", "hpet"),
    "timer slack": ("/proc/self/timerslack_ns", "4000000", "4000 us"),
}


def look(files: dict[str, str], monkeypatch: pytest.MonkeyPatch, settings: RealtimeSettings | None = None) -> Any:
    monkeypatch.setattr(system, "read", lambda path: files.get(path, ""))
    return by_name(machine.look(settings, probe=0.01))


@pytest.mark.parametrize("name", POOR)
def test_each_setting_of_the_system(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path, text, found = POOR[name]
    good, poor = look(GOOD, monkeypatch)[name], look(GOOD | {path: text}, monkeypatch)[name]
    assert (good.level, good.command) == (Level.OK, "")
    assert poor.level is (Level.MISSING if name == "PREEMPT_RT" else Level.WARNING)
    assert found in poor.found
    assert poor.command or name == "clock source"  # there is no other one to switch to


def test_priority_is_tried_and_required_where_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(pid: int, policy: int, parameter: object) -> None:
        if policy == os.SCHED_FIFO:
            raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    finding = look(GOOD, monkeypatch)["real-time priority"]
    assert (finding.level, finding.required) == (Level.MISSING, False)
    assert "rtprio" in finding.command
    seen = look(GOOD, monkeypatch, RealtimeSettings(spin=0.0, priority=50))
    assert (seen["real-time priority"].level, seen["real-time priority"].required) == (Level.MISSING, True)
    assert "not measured: priority = 50" in seen["lateness"].found


def test_lateness_is_that_of_the_clock() -> None:
    hopeless = by_name(machine.look(period=1e-7, probe=1e-4))["lateness"]  # nobody spins ten million times a second
    assert hopeless.level is Level.WARNING
    assert hopeless.command


def broken_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "READER", "raise OSError('unable to lock file')")


def no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbid(name: str) -> int:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "memfd_create", forbid)


def full(monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil._ntuple_diskusage(10**12, 10**12, 10**5)  # type: ignore[attr-defined]
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage)


@pytest.mark.parametrize(
    ("name", "harm", "found"),
    [
        ("HDF5 SWMR", broken_reader, "unable to lock file"),
        ("shared memory", no_memory, "not permitted"),
        ("space on the disk", full, "1 MB needed"),
    ],
)
def test_each_permission(
    name: str, harm: Callable[[pytest.MonkeyPatch], None], found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert by_name(disk.look(Path(), 1e6))[name].level is Level.OK
    harm(monkeypatch)
    finding = by_name(disk.look(Path(), 1e6))[name]
    assert (finding.level, finding.required) == (Level.MISSING, True)
    assert found in finding.found
    assert finding.command


def test_a_file_that_is_no_toml_is_no_reason_to_fail_otherwise() -> None:
    Path("run.toml").write_text("[driver\n")
    findings = by_name(examine(Path("run.toml"), probe=0.01))
    assert "TOML" in findings["file"].found
    assert findings.keys() > by_name(drivers.look()).keys()


@pytest.mark.parametrize(("columns", "why"), [("60", False), ("120", True)])
def test_a_narrow_terminal_shows_what_was_found(monkeypatch: pytest.MonkeyPatch, columns: str, why: bool) -> None:
    """Of four columns beside each other the words were cut off."""
    monkeypatch.setenv("COLUMNS", columns)
    printed = CliRunner().invoke(main, ["doctor"]).output
    assert ("why it matters" in printed, "…" in printed) == (why, False)
