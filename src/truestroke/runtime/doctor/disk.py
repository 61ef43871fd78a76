"""Shared memory, and the folder that the recording goes to."""

import mmap
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from truestroke.base import system
from truestroke.base.system import Memory
from truestroke.runtime.doctor.finding import Finding, Level

PART = "permissions"
SHARED = 64 * 2**20  # bytes: more than a run of several axes takes
WRITE = 32 * 2**20  # bytes that are written to measure the disk
BYTES = 80  # of a tick of an axis in the recording
RATE = BYTES * 2000.0  # bytes/s of an axis at 2 kHz
ROOM = 2**30  # bytes below which a full disk is near
READER = "import h5py, sys; f = h5py.File(sys.argv[1], libver='latest', swmr=True); assert len(f['a']) == 3"


def look(folder: Path, needed: float = 0.0) -> list[Finding]:
    """Shared memory; space for `needed` bytes, speed, and HDF5 with a writer and a reader in `folder`."""
    return [_shared_memory(), *_disk(folder, needed)]


def _shared_memory() -> Finding:
    level, found = Level.OK, f"{SHARED // 2**20} MiB"
    try:
        memory = Memory(SHARED)
        memory.buffer[:: mmap.PAGESIZE] = bytes(-(-SHARED // mmap.PAGESIZE))
        memory.close()
    except (OSError, ValueError) as error:
        level, found = Level.MISSING, str(error)
    why = "how loop, recorder and watchdog know of each other"
    command = "a container needs a profile that allows memfd_create"
    return Finding(PART, "shared memory", why, found, level, command, required=True)


def _disk(folder: Path, needed: float) -> list[Finding]:
    try:
        with tempfile.TemporaryDirectory(prefix=".truestroke-", dir=folder) as scratch:
            return [_room(folder, needed), _speed(Path(scratch)), _swmr(Path(scratch))]
    except OSError as error:
        found = f"{folder}: {error.strerror or error}"
        command = (
            system.command_line(*system.MAKE_FOLDER, folder)
            if not folder.exists()
            else "choose another folder in [recording]"
        )
        why = "the recording grows while the run goes on"
        return [Finding(PART, "folder", why, found=found, level=Level.MISSING, command=command, required=True)]


def _room(folder: Path, needed: float) -> Finding:
    free = shutil.disk_usage(folder).free
    level = Level.MISSING if free < needed else Level.WARNING if free < ROOM else Level.OK
    hours = free / RATE / 3600
    asked = f", {needed / 1e6:.0f} MB needed" if needed else f": {hours:.0f} h of an axis at 2 kHz"
    found, why = f"{free / 1e9:.1f} GB{asked}", "a disk that is full ends the run"
    command = "choose another disk in [recording], or delete something"
    return Finding(PART, "space on the disk", why, found, level, command, required=level is Level.MISSING)


def _speed(scratch: Path) -> Finding:
    began, block = time.monotonic(), os.urandom(2**20)
    with (scratch / "speed").open("wb") as file:
        for _ in range(WRITE // len(block)):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
    speed = WRITE / (time.monotonic() - began)
    level = Level.WARNING if speed < 10 * RATE else Level.OK
    why = f"an axis at 2 kHz writes {RATE / 1e6:g} MB/s; a recorder 8 s behind ends the run"
    return Finding(PART, "speed of the disk", why, f"{speed / 1e6:.0f} MB/s", level, "record to a local disk")


def _swmr(scratch: Path) -> Finding:
    """A file that one process writes and another reads."""
    import h5py

    level, found, path = Level.OK, "read while it was written", scratch / "swmr.h5"
    try:
        with h5py.File(path, "w", libver="latest") as file:
            data = file.create_dataset("a", (0,), "f8", maxshape=(None,), chunks=(64,))
            file.swmr_mode = True
            data.resize((3,))
            file.flush()
            reader = [sys.executable, "-c", READER, str(path)]
            done = subprocess.run(reader, capture_output=True, text=True, timeout=30, check=False)
            if done.returncode:
                level, found = Level.MISSING, (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    except (OSError, subprocess.TimeoutExpired) as error:
        level, found = Level.MISSING, " ".join(str(error).split())
    why = "others read the recording while it grows; network disks often cannot"
    command = "record to a local disk, or: export HDF5_USE_FILE_LOCKING=FALSE"
    return Finding(PART, "HDF5 SWMR", why, found, level, command, required=True)
