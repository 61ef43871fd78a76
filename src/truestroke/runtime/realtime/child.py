"""Processes beside the loop: started fresh, notified when the loop's process has ended."""

from __future__ import annotations

import pickle
import select
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

from truestroke.base import interrupts, streams
from truestroke.runtime.realtime.shared import Shared

_CODE = "from truestroke.runtime.realtime.child import main; main()"


class Lifeline:
    """A pipe without a writer: it ends with the process that started us."""

    def gone(self, seconds: float) -> bool:
        """Sleep, unless the process that started us has ended, or ends meanwhile: then True at once."""
        return bool(select.select([sys.stdin.fileno()], [], [], seconds)[0])


def start(
    shared: Shared, job: Callable[..., None], *arguments: Any, keep: Sequence[int] = ()
) -> subprocess.Popen[bytes]:
    """Run job(lifeline, shared, *arguments) in a process of its own session, which has the descriptors `keep`, too.

    It is no fork: it has no share in the state of vendors' libraries, and does not run the caller's script again.
    Ctrl-C in the terminal does not reach it.
    """
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", _CODE],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        pass_fds=(shared.fd, *keep),
        start_new_session=True,
    )
    assert process.stdin
    for part in (sys.path, (job, (shared, *arguments))):
        pickle.dump(part, process.stdin)
    process.stdin.flush()
    return process


def main() -> None:
    """What the new process does."""
    streams.secure()
    interrupts.ignore()
    sys.path[:] = pickle.load(sys.stdin.buffer)
    job, arguments = pickle.load(sys.stdin.buffer)
    job(Lifeline(), *arguments)
