"""Helping processes of a run as forks of the process of the test: they begin at once, for nothing is imported anew."""

from __future__ import annotations

import gc
import itertools
import os
import signal
import subprocess
import sys
import traceback
import warnings
from typing import Any

from truestroke.runtime.realtime import process


class Forked(subprocess.Popen):  # type: ignore[type-arg]
    """What `process.start` starts: a fork does what a fresh process would do, told by the same pipe."""

    def _execute_child(self, *given: Any) -> None:
        keep, pipes = given[4], given[10:16]  # the first of the pipes is its stdin
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of other threads: the fork needs none of their locks
            self.pid = os.fork()
        if not self.pid:
            try:
                become_fresh(pipes[0], keep)
                process.main()
                sys.stderr.flush()
                os._exit(0)
            except BaseException:
                traceback.print_exc()
                os._exit(1)
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]


def become_fresh(stdin: int, keep: tuple[int, ...]) -> None:
    """A session of its own, these descriptors, the usual streams, and no signal handler of the test."""
    gc.freeze()
    os.setsid()
    os.dup2(stdin, 0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    ends = [2, *sorted(keep), os.sysconf("SC_OPEN_MAX")]
    for before, after in itertools.pairwise(ends):
        os.closerange(before + 1, after)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        stream = open(number, mode, closefd=False)  # noqa: SIM115 (as long as the process)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
