"""Damaged files of every kind that truestroke reads: each is read, or refused in one line that names it.

python benchmarks/fuzz_readers.py --minutes 60         as many as there is time for
python benchmarks/fuzz_readers.py --cases 500 --seed 3

Good files are changed by bits, bytes, pieces and words; texts and numbers in them become absurd. Every reader runs in a
process of its own, so that a crash or a hang of a library behind it is found, too, and with little memory, so that a
file that asks for much is. A recording whose bits are changed is refused, or reads exactly as before.
tests/test_damaged_files.py has a small copy; `make fuzz-readers` runs a minute.
"""

from __future__ import annotations

import argparse
import collections
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import savemat

from truestroke import Recording, SettingError, trajectories
from truestroke.base import hdf5
from truestroke.base.files import FileError
from truestroke.identification import ActuatorModel, load_model, load_waveform, read_record, save_model
from truestroke.runtime.realtime import config
from truestroke.signals.recording import MODE, Channel
from truestroke.studies.study import config as study

MEMORY = 3 << 30  # bytes that a reader may have, of which the libraries take one
SECONDS = 20  # that a file may take
BATCH = 100  # files of a process
ABSURD = ("", "-1", "0", "nan", "inf", "-inf", "1e400", "1e308", "5e-324", "9" * 25, "[]", "{}", '""', '"x"', "true",
          "[[1]]", "[1, [2]]", "0x7f", "1_000", "2024-01-01", "[/red]", "\x00", "µ", "\ud7ff", "1;2", "--")  # fmt: skip


def recording() -> Recording:
    n = 300
    time = np.arange(n) / 2000.0
    wave = np.sin(np.arange(n) / 9)
    channels = {
        "time": Channel(time, "s", "start of each tick"),
        "volts": Channel(1 + wave, "V", "command"),
        "measured": Channel(10 * wave, "um", "measured displacement"),
        "flags": Channel(np.zeros(n, np.uint8), "", "bits"),
        "weights_time": Channel(np.arange(6) / 100, "s", "every 10 ms", "weights_time"),
        "weights": Channel(np.arange(24.0).reshape(6, 4), "um/V", "w", "weights_time"),
    }
    return Recording(channels, {"command": "truestroke track", "trajectory": {"name": "sine"}, "text": "x" * 500})


def fingerprint(path: Path) -> Any:
    held = Recording.load(path)
    return held.metadata, {n: (c.unit, c.description, c.time, c.data.tobytes()) for n, c in held.channels.items()}


def unfinished(path: Path) -> None:
    """As a writer that was killed leaves it."""
    data = bytearray(path.read_bytes())
    data[hdf5.FLAGS] = 5
    data[44:48] = hdf5.checksum(data[:44])
    path.write_bytes(data)


def corpus(folder: Path) -> dict[str, tuple[Path, Callable[[Path], object]]]:
    """Good files, and what reads each."""
    n = 600
    t = np.arange(n) / 1000.0
    x = 1.5 - 1.5 * np.cos(30 * t)
    z = 10 * x
    rows = np.column_stack([t, x, z])

    def at(name: str) -> Path:
        return folder / name

    recording().save(at("run.h5"))
    recording().save(at("killed.h5"))
    unfinished(at("killed.h5"))
    with h5py.File(at("foreign.hdf5"), "w", **{**MODE, "libver": "earliest"}) as file:
        group = file.create_group("run")
        for name, column, unit in (("t", t, "s"), ("u", x, "V"), ("z", z, "um")):
            group.create_dataset(name, data=column, compression="gzip").attrs["unit"] = unit
    np.savetxt(at("comma.csv"), rows, delimiter=",", header="time (s),drive (V),z (um)", comments="")
    at("german.txt").write_text("t;u;z\n" + "\n".join(";".join(f"{v:.5f}".replace(".", ",") for v in r) for r in rows))
    at("dates.csv").write_text(
        "time,V,um\n" + "\n".join(f"2024-01-01T10:00:{k / 10:09.6f},{k % 7},{k % 7}" for k in range(n))
    )
    np.savez(at("record.npz"), time=t, volts=x, displacement=z)
    np.savez_compressed(at("squeezed.npz"), time=t, volts=x, displacement=z)
    savemat(at("record.mat"), {"t": t, "u": x, "z": z, "run": {"a": [1, 2], "b": {"c": "text"}}}, do_compression=True)
    np.savetxt(at("wave.csv"), rows, delimiter=",", header="time (s),volts (V),desired (um)", comments="")
    np.savetxt(at("motion.csv"), np.column_stack([t, z]), delimiter=",", header="t (s),z (um)", comments="")
    np.savez(at("motion.npz"), t=t, z=z)
    save_model(at("model.toml"), model())
    at("study.toml").write_text(study.example())
    at("run.toml").write_text(config.example())
    at("serve.toml").write_text(config.example("serve"))
    readers: dict[str, Callable[[Path], object]] = {
        "run.h5": fingerprint, "killed.h5": fingerprint, "wave.csv": load_waveform, "motion.csv": trajectories.from_csv,
        "motion.npz": trajectories.from_csv, "model.toml": load_model, "study.toml": study.load,
        "run.toml": config.load, "serve.toml": config.load,
    }  # fmt: skip
    return {path.name: (path, readers.get(path.name, read_record)) for path in sorted(folder.iterdir())}


def model() -> ActuatorModel:
    made = {"source": "a.csv"}, {"rmse_um": 0.1}
    return ActuatorModel(
        thresholds=(0.0, 0.5), weights=np.array([8.0, 1.0, 0.0, 0.0]), covariance=np.diag(np.full(4, 0.01)),
        stroke=30.0, voltage_range=(-0.6, 3.6), rate_scale=1e-3, provenance=made[0], metrics=made[1],
    )  # fmt: skip


# ---- Damage --------------------------------------------------------------------------------------------------------


def damaged(good: bytes, text: bool, random: random.Random) -> bytes:
    """One to four changes of a file."""
    data = bytearray(good)
    kinds = TEXT if text else BINARY
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        if data:
            random.choice(kinds)(data, random)
    return bytes(data)


def flip(data: bytearray, random: random.Random) -> None:
    bit = random.randrange(8 * len(data))
    data[bit // 8] ^= 1 << (bit % 8)


def overwrite(data: bytearray, random: random.Random) -> None:
    start = random.randrange(len(data))
    size = random.choice((1, 4, 8, 64))
    filler = random.choice((b"\xff", b"\0", b"\x7f", random.randbytes(1)))
    data[start : start + size] = (filler * size)[: len(data) - start]


def cut(data: bytearray, random: random.Random) -> None:
    del data[random.randrange(len(data)) :]


def drop(data: bytearray, random: random.Random) -> None:
    start = random.randrange(len(data))
    del data[start : start + random.choice((1, 8, 100))]


def repeat(data: bytearray, random: random.Random) -> None:
    start, at = random.randrange(len(data)), random.randrange(len(data))
    data[at:at] = data[start : start + random.choice((1, 20, 500))]


def absurd(data: bytearray, random: random.Random) -> None:
    """A word or a value becomes another."""
    words = list(re.finditer(rb"(?<== )[^\n]+|[-+.\w\"]+", data))
    if words:
        word = random.choice(words)
        data[word.start() : word.end()] = random.choice(ABSURD).encode(errors="surrogatepass")


TEXT = (absurd, absurd, absurd, flip, cut, drop, repeat, overwrite)
BINARY = (flip, flip, overwrite, overwrite, cut, drop, repeat)


# ---- What must hold ------------------------------------------------------------------------------------------------


def wrong(path: Path, read: Callable[[Path], object], good: object) -> str:
    """What a reader did with a file that it must not do; empty if all is well."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = read(path)
    except (FileError, SettingError) as error:
        message = str(error)
    except OSError as error:
        message = f"{error.filename}: {error.strerror}"
    except BaseException as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:150]}"
    else:
        return "reads as another recording" if good is not None and found != good else ""
    if "\n" in message or len(message) > 2000:
        return f"no line: {message[:150]!r}"
    return ""


def batch(seed: int, files: Corpus, only: str, folder: Path) -> int:
    """Try a batch of files in a process of its own, and print what is wrong; how many were wrong."""
    note = folder / "last"
    sys.stdout.flush()
    pid = os.fork()
    if not pid:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        os._exit(min(100, _tried(seed, files, only, folder, note)))
    _, status = os.waitpid(pid, 0)
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        sys.stdout.write(f"{note.read_text()}: {signal.Signals(-code).name}\n")
        return 1
    return code


def _tried(seed: int, files: Corpus, only: str, folder: Path, note: Path) -> int:
    found = 0
    seen: collections.Counter[str] = collections.Counter()
    draw = random.Random(seed)
    names = [name for name in files if only in name]
    goods = {name: fingerprint(files[name][0]) for name in names if files[name][1] is fingerprint}
    for case in range(BATCH):
        name = draw.choice(names)
        path, read = files[name]
        bad = folder / f"bad{path.suffix}"
        bad.write_bytes(damaged(path.read_bytes(), path.suffix in (".csv", ".txt", ".toml"), draw))
        note.write_text(f"{name}, seed {seed}, case {case}")
        signal.alarm(SECONDS)
        told = wrong(bad, read, goods.get(name))
        signal.alarm(0)
        if told:
            found += 1
            seen[told] += 1
            if seen[told] == 1:
                sys.stdout.write(f"{note.read_text()}: {told}\n")
    sys.stdout.flush()
    return found


Corpus = dict[str, tuple[Path, Callable[[Path], object]]]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--minutes", type=float, help="in place of --cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="files whose name holds this")
    asked = parser.parse_args()
    end = time.monotonic() + 60 * (asked.minutes or 0)
    found = tried = 0
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        (good := Path(name, "good")).mkdir()
        files = corpus(good)
        for path, read in files.values():
            read(path)  # all of them are good
        while time.monotonic() < end if asked.minutes else tried < asked.cases:
            found += batch(1000 * asked.seed + tried // BATCH, files, asked.only, Path(name))
            tried += BATCH
        os.chdir("/")
    sys.stdout.write(f"{tried} damaged files, {found} neither read nor refused in one line\n")
    return found > 0


if __name__ == "__main__":
    sys.exit(main())
