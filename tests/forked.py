"""Processes of a run as forks of the process of the test: they begin at once, for nothing is imported anew."""

from __future__ import annotations

import faulthandler
import gc
import importlib
import itertools
import os
import signal
import subprocess
import sys
import time
import traceback
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from truestroke.__main__ import main
from truestroke.runtime.drivers import paced, simulated
from truestroke.runtime.realtime import process


class Forked(subprocess.Popen):  # type: ignore[type-arg]
    """What `process.start` starts: a fork does what a fresh process would do, told by the same pipe."""

    def _execute_child(self, *given: Any) -> None:
        words, keep, folder, env, pipes = given[0], *given[4:7], given[10:16]  # the first of the pipes is its stdin
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of other threads: the fork needs none of their locks
            self.pid = os.fork()
        if not self.pid:
            try:
                os.chdir(folder or ".")
                os.environ.update(env or {})
                self.begin(pipes, keep)
                self.do(words)
                sys.stderr.flush()
                os._exit(0)
            except SystemExit as end:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(end.code if isinstance(end.code, int) else int(bool(end.code)))
            except BaseException:
                traceback.print_exc()
                os._exit(1)
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]

    def begin(self, pipes: tuple[int, ...], keep: tuple[int, ...]) -> None:
        os.setsid()
        become_fresh(pipes[0], os.open(os.devnull, os.O_WRONLY), 2, keep)

    def do(self, words: Any) -> None:
        Path("/proc/self/comm").write_text(words[-1])  # the name for those who list processes
        process.main()


class ForkedCommand(Forked):
    """`truestroke` with words, whose standard output and error are pipes, or stay what they are.

    Its own processes are forks, too. It has the signals, warnings and clock of a fresh process. What its environment is
    to change before Python begins needs a fresh one.
    """

    def begin(self, pipes: tuple[int, ...], keep: tuple[int, ...]) -> None:
        faulthandler.disable()  # pytest's: it would write to a file that is another one here
        importlib.reload(warnings)
        warnings.resetwarnings()
        for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", kind)
        out, err = (there if there >= 0 else number for there, number in ((pipes[3], 1), (pipes[5], 2)))
        become_fresh(os.open(os.devnull, os.O_RDONLY), out, err, keep)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    def do(self, words: Any) -> None:
        process.subprocess = SimpleNamespace(**{**vars(subprocess), "Popen": Forked})  # type: ignore[assignment]
        paced.time = simulated.time = time  # type: ignore[attr-defined]
        paced.perf_counter_ns = time.perf_counter_ns
        sys.argv = [str(word) for word in words]
        main()


def ran(command: list[Any], timeout: float, **options: Any) -> subprocess.CompletedProcess[str]:
    """As `subprocess.run` gives it, with what it printed."""
    both: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with ForkedCommand(command, **both, **options) as process:
        try:
            said = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, *said)


def become_fresh(stdin: int, stdout: int, stderr: int, keep: tuple[int, ...]) -> None:
    """These descriptors, the usual streams, and no signal handler of the test."""
    gc.freeze()
    os.dup2(stdin, 0)
    os.dup2(stdout, 1)
    os.dup2(stderr, 2)
    ends = [2, *sorted(keep), os.sysconf("SC_OPEN_MAX")]
    for before, after in itertools.pairwise(ends):
        os.closerange(before + 1, after)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        stream = open(number, mode, closefd=False)  # noqa: SIM115 (as long as the process)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
