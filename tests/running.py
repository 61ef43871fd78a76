"""`truestroke run` in a process of its own, and what another process sees of its recording."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from forked import ForkedCommand

from truestroke import FileError, Recording
from truestroke.base import hdf5

COMMAND = Path(sys.executable).with_name("truestroke")
CONFIG = """
[driver]
name = "simulated"
register = "volts"
FAULTS
[[axis]]
stroke = 30.0
voltage_limits = [-0.6, 3.6]
safe_voltage = 0.25
slew = 400.0
[axis.trajectory]
kind = "sine"
frequency = 4.0
duration = DURATION
[realtime]
overrun_streak = 0
spin = 0.0
watchdog_timeout = TIMEOUT
axis_check = false
[recording]
file = "run.h5"
"""


def configuration(faults: str = "", *, duration: float = 60.0, watchdog_timeout: float = 9.0) -> str:
    """A simulated stack on a sine for so many seconds; the file `volts` holds what its output holds."""
    text = CONFIG.replace("FAULTS", f"faults = {faults}" if faults else "")
    return text.replace("DURATION", str(duration)).replace("TIMEOUT", str(watchdog_timeout))


STALLED = ("no tick for", "stands still")  # a run's own words, where nobody stopped one of its processes


def started(
    config: str, *options: str, there: Callable[[], bool] | None = None, env: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """The process, with this text as its configuration, when `there`: by default when 500 ticks are in its file.

    It is a fork of this one, but a fresh process in an environment of its own. It begins again, twice at most, where
    the machine stood still for longer than the configuration allows.
    """
    Path("run.toml").write_text(config)
    command = [COMMAND, "run", "--config", "run.toml", "--json", *options]  # no status line, which is a process
    file = "run.new.h5" if "--overwrite" in options else "run.h5"
    for left in (2, 1, 0):
        start = subprocess.Popen if env else ForkedCommand
        process = start(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=env)
        try:
            until(there or (lambda: rows(file) > 500), process=process)
            break
        except EndedError as ended:
            if not left or not any(words in str(ended) for words in STALLED):
                raise
            Path(file).unlink(missing_ok=True)
    return process


class EndedError(AssertionError):
    """A process ended before that for which somebody waited; its code, and what it said."""


def until(true: Callable[[], bool], seconds: float = 60.0, process: subprocess.Popen[Any] | None = None) -> None:
    """Wait; fail where it takes longer, and at once where the process that is to bring it about has ended."""
    end = time.monotonic() + seconds
    while True:
        ended = process is not None and process.poll() is not None
        if true():
            return
        if process is not None and ended:
            said = [part for part in process.communicate(timeout=seconds) if part]
            raise EndedError(f"the process ended with {process.returncode}: {said}")
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.02)


def rows(file: str | Path) -> int:
    """How far the file has grown: a twentieth of the work of `ticks`, for those that wait."""
    with contextlib.suppress(OSError, KeyError, ValueError), hdf5.opened(Path(file)) as found:  # it may be half written
        return int(found["time"].shape[0])
    return 0


def ticks(file: str | Path) -> int:
    """What another process sees in the file now."""
    try:
        return len(Recording.load(file)["time"])
    except (FileNotFoundError, FileError):
        return 0  # not yet
