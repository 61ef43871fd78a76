"""What every test finds: Ctrl-C ends a process, also where a shell that runs in the background has it ignored.

The longest tests begin first, so that none of them is what all the others wait for. The tests of a file are run by one
process, for they share packages, computations and servers; those that are long and share nothing by any of them. Every
page that a test writes says µm and never um.
"""

from __future__ import annotations

import gc
import hashlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

from truestroke.base import files

LONG = ("test_soak.py", "test_compare.py", "test_bench.py", "test_files_of_a_run.py", "test_docs.py", "test_study.py")
ALONE = (
    "test_docs.py", "test_examples.py", "test_files_of_a_run.py", "test_realtime.py", "test_realtime_faults.py",
    "test_reference.py", "test_robustness.py", "test_study.py", "test_supervision.py",
)  # fmt: skip
# Pages and docstrings with the file whose tests load the same large packages, so that one process imports them.
WITH = {
    "[docs/conventions.md]": "test_recording.py", "[docs/other-packages.md]": "test_adapters.py",
    "[docs/ophyd.md]": "test_ophyd.py", "[truestroke.dropins.ophyd]": "test_ophyd.py",
    "[docs/qudi.md]": "test_qudi.py", "[truestroke.dropins.qudi]": "test_qudi.py",
    "[truestroke.identification.adapters.sklearn]": "test_adapters.py",
}  # fmt: skip

# Where Python writes no bytecode, each of some thousand processes would compile the package again, and each of xdist's
# every test: a quarter of what a test of `truestroke run` computes.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# How fast hypothesis makes its input depends on what else the machine does: no test may fail by it.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # under nohup
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        """Last come short tests that any process takes: none waits at the end for another's file."""
        name = item.path.name
        return LONG.index(name) if name in LONG else len(LONG) + (name in ALONE)

    items.sort(key=place)


gc.disable()  # until all tests are there: a tenth of what it takes to collect them


def pytest_collection_finish() -> None:
    """What 5,800 tests are is garbage at no time: each run in real time would look through it again, for 0.2 s.

    What collecting left is frozen with them: to look for it takes each process a twelfth of what it takes to collect.
    Pictures make many small objects and free them: to look for garbage after each 700 was a sixteenth of all time, and
    is a hundredth more after each 20,000 than after each 100,000, which take 13 MB.
    """
    gc.freeze()
    gc.enable()
    gc.set_threshold(100_000)
    from truestroke.runtime.realtime import process

    # To count what is frozen, 600,000 objects, takes longer than to look for garbage among the others.
    process.gc = SimpleNamespace(**{**vars(gc), "get_freeze_count": lambda: 1})  # type: ignore[assignment]


@pytest.fixture(scope="module", autouse=True)
def _what_other_files_left_is_frozen() -> None:
    """Each run in real time looks for garbage first, among all that the files before have imported and cached.

    It was 0.1 s of each, a third of what a test of the doctor or of a fault took after some hundred others.
    """
    gc.collect()
    gc.freeze()


class ByComputation(LoadScopeScheduling):
    """File by file, the tests of `ALONE` one by one; xdist's own groups do not work with pytest 9.2."""

    def _split_scope(self, nodeid: str) -> str:
        file, _, test = nodeid.partition("::")
        beside = WITH.get(test[test.find("[") :]) if "[" in test else None
        if beside:
            return file.rpartition("/")[0] + f"/{beside}"
        return nodeid if file.endswith(ALONE) else file

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Without the units that are done, whose tests xdist counts anew behind each test of the process."""
        work = self.assigned_work[node]
        for unit in [unit for unit, tests in work.items() if all(tests.values())]:
            del work[unit]
        super()._assign_work_unit(node)


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByComputation:
    return ByComputation(config, log)


@pytest.fixture(autouse=True)
def _pages_say_one_micrometre(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a page: µm alone, never um, and not within a word; commands and quotations keep what they say."""
    write = files.write

    def checked(path: str | Path, text: str, kind: Any) -> Path:
        if kind is files.PAGE:
            shown = re.sub(r"<[^>]*>", " ", re.sub(r"(?s)<(style|pre|code)\b.*?</\1>", " ", text))
            assert not re.findall(r".{0,30}(?:\bum\b|\w[µ\u03bc]m\b|\u03bcm).{0,20}", shown)
        return write(path, text, kind)

    monkeypatch.setattr(files, "write", checked)


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current one, for a test whose command writes files."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def each_picture_once(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """For tests that read the words of pages: what a process has drawn for one of them is made, but not drawn again.

    A picture for light and for dark is one, and so is one with that for a phone. Half of the time of a page is the
    drawing. Each kind of page has tests of its own, which draw all of it.
    """
    from truestroke.report import page, style

    svgs, save, folder = page._svgs, style.save, tmp_path_factory.getbasetemp()
    drawn_before = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "drawn"  # by any process
    drawn_before.mkdir(exist_ok=True)

    def first(thing: object) -> bool:
        try:
            (drawn_before / hashlib.sha256(repr(thing).encode()).hexdigest()).touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    def drawn(figure: Any, name: str, description: str) -> str:
        if first((name, description)):
            return svgs(figure, name, description)
        names = (name, f"{name}-phone") if figure.get_figwidth() > style.PHONE else (name,)
        return "".join(f'<svg role="img" id="{one}"/>' for one in names)

    def saved(figure: Any, path: str | Path, **options: Any) -> Path:
        if first(re.sub("-(light|dark)$", "", Path(path).stem)):
            return save(figure, path, **options)
        Path(path).touch()
        return Path(path)

    monkeypatch.setattr(page, "_svgs", drawn)
    monkeypatch.setattr(style, "save", saved)


@pytest.fixture
def forked_helpers(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of what happens in a run: its recorder, watchdogs and server are forks of this process.

    Fresh ones import NumPy and truestroke anew, for longer than the run takes. Those that `truestroke run` has in the
    tests of the command are fresh; where signals or the end of its process are what is tested, `forked.ForkedCommand`
    is the command.
    """
    from forked import Forked

    from truestroke.runtime.realtime import process

    monkeypatch.setattr(process, "subprocess", SimpleNamespace(**{**vars(subprocess), "Popen": Forked}))


class Passing:
    """A clock that is moved on by those who sleep, and a little by those who look."""

    LOOK = 20_000  # ns

    def __init__(self) -> None:
        self.now = 0  # ns

    def sleep(self, seconds: float) -> None:
        self.now += round(1e9 * seconds)

    def perf_counter_ns(self) -> int:
        self.now += self.LOOK
        return self.now

    def perf_counter(self) -> float:
        return 1e-9 * self.perf_counter_ns()


@pytest.fixture
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of what is done with simulated hardware, not of when: nothing in this process waits for its ticks."""
    from truestroke.runtime.drivers import paced, simulated

    clock = Passing()
    monkeypatch.setattr(paced, "time", clock)
    monkeypatch.setattr(simulated, "time", clock)
    monkeypatch.setattr(paced, "perf_counter_ns", clock.perf_counter_ns)
