"""What every test finds: Ctrl-C ends a process, also where a shell that runs in the background has it ignored.

The longest tests begin first, so that none of them is what all the others wait for. The tests of a file whose tests
share a long computation are played by one process.
"""

from __future__ import annotations

import signal

import pytest
from xdist.scheduler import LoadScopeScheduling

LONG = ("test_soak.py", "test_compare.py", "test_bench.py", "test_docs.py", "test_study.py")
SHARED = ("test_compare.py", "test_bench.py")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # under nohup
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


class ByComputation(LoadScopeScheduling):
    """Each test by itself, those of `SHARED` by file; xdist's own groups do not work with pytest 9.2."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return file if file.endswith(SHARED) else nodeid


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByComputation:
    return ByComputation(config, log)
