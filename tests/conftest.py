"""What every test finds: Ctrl-C ends a process, also where a shell that runs in the background has it ignored.

The longest tests begin first, so that none of them is what all the others wait for.
"""

from __future__ import annotations

import signal

import pytest

LONG = ("test_soak.py", "test_compare.py", "test_bench.py", "test_docs.py", "test_study.py")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))
