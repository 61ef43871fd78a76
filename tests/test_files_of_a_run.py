"""What happens to the files of `truestroke run`: a disk that fails, a recording that is replaced, names that change."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from running import configuration, started, ticks

from truestroke import AdaptiveController, Recording
from truestroke.base import files
from truestroke.cli import main
from truestroke.runtime.drivers import DriverError, Fault, SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import Axis, RealtimeSettings, run_realtime
from truestroke.signals.trajectories import sine

# how late a tick is depends on what else the machine does
pytestmark = [
    pytest.mark.usefixtures("empty_folder", "forked_helpers"),
    pytest.mark.filterwarnings("ignore::truestroke.LatenessWarning"),
]

FAKES = Path(__file__).with_name("fakes")


@pytest.fixture(scope="module")
def bad_disk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library to preload."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    assert compiler, "the kernel was built with one"
    library = tmp_path_factory.mktemp("disk") / "bad_disk.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, FAKES / "bad_disk.c", "-ldl"], check=True)
    return library


def environment(library: Path) -> dict[str, str]:
    Path("disk").write_bytes(bytes(32))
    return {**os.environ, "LD_PRELOAD": str(library), "BAD_DISK": os.path.abspath("disk"), "BAD_DISK_NAME": ".h5"}


def test_what_is_said_to_be_saved_is_there_whichever_write_fails(bad_disk: Path) -> None:
    """A disk that is full at each write in turn, one that reports errors at every 31st, and short writes."""
    script = [sys.executable, FAKES / "record_on_a_bad_disk.py", "31"]
    done = subprocess.run(script, env=environment(bad_disk), capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout.split()[0]) > 100


@pytest.mark.usefixtures("each_picture_once")
@pytest.mark.parametrize("kind", [errno.ENOSPC, errno.EIO])
def test_a_run_whose_disk_fails_ends_with_13(bad_disk: Path, kind: int) -> None:
    process = started(configuration(), env=environment(bad_disk))
    state = np.memmap("disk", np.int64, "r+")
    state[0] = kind
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 13, stderr
    assert f"the recording cannot be written: {os.strerror(kind)}" in stderr or "errno" in stderr
    assert "Traceback" not in stderr
    assert np.fromfile("volts") == 0.25
    state[0] = 0
    recording = Recording.load("run.h5")
    assert len(recording["time"]) > 200
    assert np.isfinite(recording["measured"]).all()
    if kind == errno.ENOSPC:  # both leave the same file
        assert CliRunner().invoke(main, ["report", "run.h5"]).exit_code == 0


def test_a_disk_that_fails_at_the_very_end_is_told(bad_disk: Path) -> None:
    """Only the last step to the disk fails: without it nothing is sure to be there."""
    process = started(configuration(duration=2.5), there=lambda: ticks("run.h5") > 200, env=environment(bad_disk))
    with pytest.raises(subprocess.TimeoutExpired):
        process.communicate(timeout=0.3)
    np.memmap("disk", np.int64, "r+")[:2] = errno.EIO, 250
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 13, stderr


# ---- A recording that is replaced ----------------------------------------------------------------------------------


def again(*options: str) -> Result:
    return CliRunner().invoke(main, ["run", "--config", "run.toml", *options])


def test_one_that_is_being_written_is_refused_at_once() -> None:
    process = started(configuration())
    for options in (["--overwrite"], []):
        done = again(*options)
        assert done.exit_code == 1
        assert done.stderr == "truestroke: run.h5: another run is writing it; choose another name\n"
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert Recording.load("run.h5").metadata["ended"]["cause"] == "interrupted"
    assert not Path("run.new.h5").exists()


def test_who_looks_at_a_file_while_it_is_made_does_not_keep_the_run_from_beginning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """HDF5 locks what it reads, be it for a moment."""
    lock, readers = files.system.lock, []

    def looked_at(descriptor: int) -> None:
        lock(descriptor)
        readers.append(os.open("run.h5", os.O_RDONLY))
        fcntl.flock(readers[0], fcntl.LOCK_SH)

    monkeypatch.setattr(files.system, "lock", looked_at)
    assert record(sine(frequency=4.0, peak_to_peak=20.0, duration=0.5, sample_rate=2000.0)) == "run.h5"
    os.close(*readers)


def test_a_recording_is_replaced_by_a_complete_one_only() -> None:
    short = sine(frequency=4.0, peak_to_peak=20.0, duration=0.5, sample_rate=2000.0)
    record(short)
    old = Path("run.h5").read_bytes()
    with pytest.raises(FileExistsError, match="a recording is there; choose another name, or `overwrite` it"):
        record(short)
    with pytest.raises(DriverError, match="open: error -2"):
        record(short, "open", overwrite=True)
    assert (Path("run.h5").read_bytes(), Path("run.new.h5").exists()) == (old, False)
    assert record(short, "start", overwrite=True) == "run.new.h5"  # it had no tick
    assert Path("run.h5").read_bytes() == old
    assert record(short, overwrite=True) == "run.h5"
    assert Path("run.h5").read_bytes() != old
    assert not Path("run.new.h5").exists()


def record(wave: object, fault: str = "", overwrite: bool = False) -> str:
    """Run for half a second; the name of the recording."""
    law = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    axis = Axis(trajectory=wave, controller=law, voltage_limits=(-0.6, 3.6), slew=400.0)  # type: ignore[arg-type]
    faults = (Fault(kind=fault, at=0, count=10**6),) if fault else ()
    driver = SimulatedDriver(SimulatedSettings(register="volts", faults=faults))
    settings = RealtimeSettings(spin=0.0, overrun_streak=0, watchdog_timeout=20.0)
    return str(run_realtime(driver, [axis], "run.h5", settings=settings, overwrite=overwrite).files[0])


def test_kill_9_while_it_replaces_one_keeps_both_and_the_terminal_says_where() -> None:
    Path("run.h5").write_text("precious")
    process = started(configuration(), "--overwrite")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(signal.SIGSTOP)
    before = ticks("run.new.h5")
    for pid in (*children, str(process.pid)):
        os.kill(int(pid), signal.SIGKILL)
    _, stderr = process.communicate(timeout=30)
    assert "run.new.h5 until the run has ended" in stderr
    assert Path("run.h5").read_text() == "precious"
    assert ticks("run.new.h5") >= before > 200
    done = again("--overwrite")
    assert done.exit_code == 1
    assert "truestroke: run.new.h5: a run that ended early left it" in done.stderr
    assert ticks("run.new.h5") >= before


def test_the_end_is_written_to_the_file_that_is_open() -> None:
    """And not to one that has its name by now."""
    process = started(configuration())
    Path("run.h5").rename("moved.h5")
    Path("run.h5").write_text("another's")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert Path("run.h5").read_text() == "another's"
    assert Recording.load("moved.h5").metadata["ended"]["cause"] == "interrupted"


def test_ctrl_c_before_it_begins_leaves_nothing() -> None:
    process = started(configuration(), there=Path("run.h5").exists)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130
    assert not Path("run.h5").exists() or ticks("run.h5") == 0  # it may have begun


def test_a_lock_goes_with_its_process() -> None:
    place = files.grow(Path("a.h5").absolute(), False, lambda path: True)
    assert files.busy(place.path)
    with pytest.raises(FileExistsError, match="another run is writing it"):
        files.grow(place.path, True, lambda path: True)
    place.close()
    assert not files.busy(place.path)


def test_a_name_without_an_ending_gets_one() -> None:
    Path("run.toml").write_text(configuration(duration=0.5))
    assert again("--output", "first", "--json").exit_code in (0, 4, 11)  # the machine may be late
    assert [path.name for path in Path().glob("first*")] == ["first.h5"]
