"""Studies: a run is its number, whoever simulates it; killed anywhere, they continue; what they say is so."""

import json
import os
import signal
import socket
import sqlite3
import ssl
import stat
import subprocess
import sys
import time
import tomllib
from contextlib import closing
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import psutil
import pytest
from click.testing import CliRunner

from truestroke import AdaptiveController, SettingError, run
from truestroke.cli import main
from truestroke.plant import MatchedPlant
from truestroke.studies import study
from truestroke.studies.engine import Batch, Row, StoreError, StudyError, executors
from truestroke.studies.engine import run as drive
from truestroke.studies.study.page import axes_of_map

TRUESTROKE = Path(sys.executable).with_name("truestroke")
SMALL = """
runs = 40
sample_rate = 1000.0
record = ["rmse", "largest"]
[plant]
kind = "matched"
a = { around = [8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23], spread = 0.5 }
noise = { log_uniform = [0.001, 0.1] }
[wave]
kind = "random_wave"
duration = 1.0
peak_to_peak = { choice = [10.0, 20.0] }
velocity_limit = { uniform = [200.0, 900.0] }
[controllers.paper]
kind = "paper"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
[controllers.default]
kind = "default"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
plays = { choice = [8, 16] }
[converged]
level = 0.01
within = 0.7
"""
LONG = SMALL.replace("duration = 1.0", "duration = 20.0")  # 25 runs make a batch, not 500


def source(**changed):
    return tomllib.loads(SMALL) | changed


SOME = study.parse(source())


@pytest.fixture(scope="module")
def rows():
    """Of the small study, one after the other."""
    return study.simulate(SOME, range(SOME.runs)).rows


def in_batches(numbers, size=5):
    return [tuple(numbers[i : i + size]) for i in range(0, len(numbers), size)]


def gathered(batches):
    """Rows by number; none came twice."""
    found = [row for batch in batches for row in batch.rows]
    assert len({row.number for row in found}) == len(found)
    return sorted(found, key=lambda row: row.number)


# ---- A run is its number -------------------------------------------------------------------------------------------


def test_a_run_is_what_the_loop_gives_and_converges_by_the_stated_formula():
    """Simulated with `run`; every window of 0.25 s looked at by itself."""
    seen = set()
    for number in range(8):
        sampled, row = study.sample(SOME, number), study.simulate(SOME, [number]).rows[0]
        for name, controller in sampled.controllers.items():
            plant = MatchedPlant(sampled.trajectory.velocity, sampled.plant, sampled.seed)
            recording = run(sampled.trajectory, AdaptiveController.from_settings(controller), plant)
            error = recording["true"] - recording["desired"]
            bad = [k for k in range(751) if np.sqrt(np.mean(error[k : k + 250] ** 2)) > 0.02]
            expected = 0.0 if not bad else (bad[-1] + 1) / 1000 if bad[-1] < 750 else None
            found = row.metrics[name]
            assert found["convergence_time"] == (expected if expected is None else pytest.approx(expected))
            assert found["rmse"] == pytest.approx(np.sqrt(np.mean(error[500:] ** 2)))
            assert found["largest"] == pytest.approx(np.abs(error).max())
            assert SOME.has_converged(row, name) == (expected is not None and expected <= 0.7)
            seen.add(SOME.has_converged(row, name))
    assert seen == {True, False}


def test_a_sample_depends_on_seed_and_number_alone():
    other = study.parse(source(runs=7, seed=0, title="another"))
    assert study.simulate(SOME, [5]).rows == study.simulate(other, [3, 5]).rows[1:]
    assert study.sample(SOME, 5).plant != study.sample(SOME, 6).plant
    assert study.sample(SOME, 5).plant != study.sample(study.parse(source(seed=1)), 5).plant


def test_samples_are_of_the_stated_distribution():
    runs = [study.sample(SOME, number) for number in range(300)]
    stated = {
        "a_0": (np.array([r.plant.a[0] for r in runs]) / 8.4, 0.5, 1.5),
        "a_6": (np.array([r.plant.a[6] for r in runs]) / -2.6, 0.5, 1.5),
        "noise": (np.log([r.plant.noise for r in runs]), np.log(0.001), np.log(0.1)),
        "velocity limit": (np.array([r.sampled["velocity limit"] for r in runs]), 200.0, 900.0),
    }
    for name, (values, low, high) in stated.items():
        part = (values - low) / (high - low)
        assert 0 <= part.min() <= part.max() <= 1, name
        assert np.mean(part) == pytest.approx(0.5, abs=5 / np.sqrt(12 * 300)), name
        assert np.var(part) == pytest.approx(1 / 12, rel=0.25), name
    assert abs(np.corrcoef(stated["a_0"][0], stated["a_6"][0])[0, 1]) < 0.3
    assert {r.sampled["peak to peak"] for r in runs} == {10.0, 20.0}
    assert {r.controllers["default"].plays for r in runs} == {8, 16}
    assert len({r.trajectory.settings["seed"] for r in runs}) == len({r.seed for r in runs}) == 300


def test_the_example_is_the_papers_plant_and_wave():
    asked = study.parse(tomllib.loads(study.example()))
    sampled = study.sample(asked, 3)
    assert asked.runs == 10_000
    assert np.all(np.abs(np.array(sampled.plant.a) / [8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23] - 1) <= 0.3)
    assert np.all(np.abs(np.array(sampled.plant.b) / [-0.9, 1.03, -0.244, 0.1, 0.05, -0.02, 0.01, -0.01] - 1) <= 0.3)
    assert sampled.trajectory.duration == 20.0
    assert 0.0 <= sampled.trajectory.position.min() <= sampled.trajectory.position.max() <= 30.0
    assert sampled.trajectory.peak_speed <= 300.0


def test_a_realistic_plant_that_changes():
    plant = {"kind": "realistic", "change": {"time": {"uniform": [0.4, 0.6]}, "gain": 0.9}}
    sampled = study.sample(study.parse(source(plant=plant, wave={"kind": "sine", "duration": 1.0})), 0)
    assert 0.4 < sampled.plant.change.time == sampled.sampled["change time"] < 0.6
    assert sampled.plant.change.gain == 0.9


@pytest.mark.parametrize(
    ("changed", "argument"),
    [
        ({"runz": 3}, "runz"),
        ({"runs": 0}, "runs"),
        ({"record": ["rsme"]}, "record"),
        ({"plant": {"kind": "matched", "noize": 0.1}}, "plant.noize"),
        ({"plant": {"kind": "matched", "sample_rate": 0.1}}, "plant.sample_rate"),
        ({"plant": {"kind": "steel"}}, "plant.kind"),
        ({"plant": {"kind": "matched", "noise": {"uniform": [2.0, 1.0]}}}, "plant.noise"),
        ({"plant": {"kind": "matched", "noise": {"log_uniform": [0.0, 1.0]}}}, "plant.noise[0]"),
        ({"plant": {"kind": "matched", "a": {"around": [1.0]}}}, "plant.a.spread"),
        ({"plant": {"kind": "matched", "noise": {"uniform": [0.0, 1.0], "spread": 1.0}}}, "plant.noise.spread"),
        ({"wave": {"kind": "random_wave", "seed": 3}}, "wave.seed"),
        ({"controllers": {}}, "controllers"),
        ({"controllers": {"mine": {"kind": "paper", "strok": 3.0}}}, "controllers.mine.strok"),
        ({"converged": {"level": 0.1}}, "converged.within"),
    ],
)
def test_what_is_not_known_is_an_error(changed, argument):
    with pytest.raises(SettingError) as error:
        study.parse(source(**changed))
    assert error.value.argument == argument


@pytest.mark.usefixtures("each_picture_once")
def test_impossible_samples_are_rows_with_their_error(tmp_path, monkeypatch):
    """They stop nothing, are named at the end, and are not simulated again."""
    limits = {"choice": [1.0, 400.0]}
    some = source(runs=12, wave={"kind": "random_wave", "duration": 1.0, "velocity_limit": limits})
    asked = study.parse(some)
    found = study.simulate(asked, range(12))
    wrong = {row.number: row.error for row in found.rows if row.error}
    assert 0 < len(wrong) < 12
    assert all(error.startswith("wave.ramp") for error in wrong.values())
    assert found.ticks == (12 - len(wrong)) * 2 * 1000
    with study.Store(tmp_path / "s.sqlite", asked) as store:
        drive(asked, store, executors.threads(2))
        assert {row.number: row.error for row in store.failed(12)} == wrong
        assert store.rows(12) == [row for row in found.rows if not row.error]
        assert store.missing(range(12)) == []
    text = SMALL.replace("{ uniform = [200.0, 900.0] }", "{ choice = [1.0, 400.0] }").replace("runs = 40", "runs = 12")
    (tmp_path / "s.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["study", "s.toml", "--output", "cli"])
    said = " ".join(done.stdout.split())
    assert done.exit_code == 4  # a fifth or more of the runs is missing
    assert "more runs could not be simulated, the first is run" in said
    assert "more runs could not be simulated, the first is run" in (tmp_path / "cli.html").read_text()
    found = json.loads(CliRunner().invoke(main, ["study", "s.toml", "--output", "cli", "--json"]).stdout)
    assert found["runs"] + len(found["failed"]) == 12
    (tmp_path / "none.toml").write_text(text.replace("400.0", "1.0"))
    none = CliRunner().invoke(main, ["study", "none.toml"])
    assert (none.exit_code, none.stderr.count("\n")) == (2, 1)  # all that can be sampled is impossible


# ---- Whoever simulates it ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 3])
def test_threads_give_the_same_rows(rows, workers):
    assert gathered(executors.threads(workers)(SOME, in_batches(range(40)))) == rows


def test_dask_gives_the_same_rows_when_a_worker_is_killed(rows):
    """A cluster of its own; after the first result each worker process gets SIGKILL in the middle of its batch."""
    with closing(executors.dask(2)(SOME, in_batches(range(40)))) as stream:  # a failure would wait for the cluster
        first = next(stream)
        children = psutil.Process().children(recursive=True)
        workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
        assert {key: workers[0].environ().get(key) for key in executors.TRIM} == executors.TRIM
        assert_closed_to_strangers([psutil.Process(), *workers])
        for worker in workers:
            worker.kill()
        assert gathered([first, *stream]) == rows


def assert_closed_to_strangers(processes):
    """Each port is one of 127.0.0.1; it wants a certificate of theirs, or is the empty web server of a process."""
    at = {one.laddr for process in processes for one in process.net_connections("tcp") if one.status == "LISTEN"}
    assert {address for address, _ in at} == {"127.0.0.1"}
    said = [told_a_stranger(port) for _, port in at if not is_empty_web_server(port)]
    assert all("certificate" in words.lower() for words in said), said
    assert len(said) >= 3  # scheduler, and of each worker one


def is_empty_web_server(port):
    """Whether it speaks HTTP and has no page of dask's. It is asked before: a hello of TLS it would not answer."""
    try:
        urlopen(f"http://127.0.0.1:{port}/info/main/workers.html", timeout=60.0)
    except HTTPError as error:
        return error.code == 404
    except OSError:
        return False
    raise AssertionError(f"port {port} shows a page to everybody")


def told_a_stranger(port):
    """What somebody hears who has no certificate."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with socket.create_connection(("127.0.0.1", port), 10.0) as plain:
        try:
            with context.wrap_socket(plain) as wrapped:
                return f"welcome: {wrapped.recv(1)!r}"
        except OSError as error:
            return str(error)


def test_dask_gives_the_same_rows_on_a_scheduler_of_its_own_process(rows, tmp_path):
    """As on a cluster: the scheduler here, a worker there, known by the scheduler's address alone."""
    dask, address = [sys.executable, "-m", "dask"], tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    started = [
        subprocess.Popen(
            [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", address],
            **quiet,
        )
    ]
    try:
        wait_for(address.exists)
        wait_for(lambda: address.read_text().strip().endswith("}"))
        known = json.loads(address.read_text())["address"]
        started.append(subprocess.Popen([*dask, "worker", known, "--nthreads", "2", "--no-dashboard"], **quiet))
        assert gathered(executors.dask(scheduler=known)(SOME, in_batches(range(40)))) == rows
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()


SBATCH = """#!{python}
import pathlib, subprocess, sys
if "--test-only" in sys.argv:
    sys.exit("sbatch: error: invalid partition specified" if "wrong" in sys.stdin.read() else 0)
script = pathlib.Path(sys.argv[1]).read_text()  # which is removed when this returns
quiet = {{"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}}
job = subprocess.Popen(["sh", "-c", script], start_new_session=True, **quiet)
print(f"Submitted batch job {{job.pid}}")
"""
SCANCEL = """#!{python}
import os, signal, sys
os.killpg(int(sys.argv[1]), signal.SIGTERM)
"""


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """sbatch and scancel that run the jobs on this machine; the folder of certificates and logs."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (programs / name).write_text(text.format(python=sys.executable))
        (programs / name).chmod(stat.S_IRWXU)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    return tmp_path / "study.slurm"


def workers_of(folder):
    """Processes of jobs whose certificates are in this folder."""
    alive = psutil.process_iter(["cmdline"])
    return [one for one in alive if str(folder) in " ".join(one.info["cmdline"] or [])]


def test_slurm_gives_the_same_rows_when_a_job_is_killed(cluster, rows):
    """As at its time limit: the job is submitted again, its batch is simulated again."""
    ctrl_c = signal.getsignal(signal.SIGINT)
    stream = executors.slurm(cluster, 1)(SOME, in_batches(range(40)))
    assert signal.getsignal(signal.SIGINT) is ctrl_c
    first = next(stream)
    killed = workers_of(cluster)
    for worker in killed:
        worker.kill()
    assert gathered([first, *stream]) == rows
    wait_for(lambda: not workers_of(cluster))  # the jobs end with the study
    assert killed


def test_jobs_that_slurm_refuses_are_an_error(cluster, monkeypatch):
    monkeypatch.setitem(executors.TRIM, "PARTITION", "wrong")
    with pytest.raises(StudyError, match="sbatch refuses the jobs of this study: sbatch: error: invalid partition"):
        next(executors.slurm(cluster, 1)(SOME, [(0,)]))


def test_without_slurm_there_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SettingError, match="executor = slurm: must be on a machine that has sbatch"):
        executors.slurm(tmp_path)


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


# ---- Killed anywhere -----------------------------------------------------------------------------------------------


def count(path):
    """Runs in a store that somebody else writes."""
    if not path.exists():
        return 0
    database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        return database.execute("SELECT count(*) FROM run").fetchone()[0]
    except sqlite3.OperationalError:  # not made yet
        return 0
    finally:
        database.close()


def test_a_driver_that_is_killed_continues(tmp_path):
    """SIGKILL twice, as soon as something new is there: all is there in the end, once, as if nothing had been."""
    file, store = tmp_path / "many.toml", tmp_path / "many.sqlite"
    file.write_text(LONG)
    command = [TRUESTROKE, "study", file, "--runs", "75", "--workers", "1", "--output", tmp_path / "many"]
    before = 0
    for _ in range(2):
        driver = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        wait_for(lambda: count(store) > before or driver.poll() is not None)  # noqa: B023
        driver.kill()
        assert driver.wait() == -signal.SIGKILL
        assert count(store) >= before
        before = count(store)
    assert 0 < before < 75
    done = json.loads(subprocess.run([*command, "--json"], check=True, capture_output=True).stdout)
    assert done["runs"] == count(store) == 75
    asked = study.load(file, 75)
    with study.Store(store, asked) as kept:
        found, (ticks, _) = kept.rows(75), kept.cost()
    assert ticks == 75 * 2 * 20_000  # nothing was paid twice
    assert [row.number for row in found] == list(range(75))
    assert found[::15] == study.simulate(asked, range(0, 75, 15)).rows


@pytest.mark.parametrize("executor", ["threads", "dask"])
def test_ctrl_c_keeps_what_is_there_and_says_how_to_go_on(tmp_path, executor):
    """As a terminal sends it: to the driver and to all that it started."""
    (tmp_path / "many.toml").write_text(LONG)
    command = [TRUESTROKE, "study", "many.toml", "--runs", "10000", "--workers", "1", "--executor", executor]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    driver = subprocess.Popen(command, cwd=tmp_path, **quiet)
    wait_for(lambda: count(tmp_path / "many.sqlite") > 0 or driver.poll() is not None)
    os.killpg(driver.pid, signal.SIGINT)
    said = driver.communicate(timeout=30)[1].split("\n")
    assert driver.returncode == 130
    known = ["many.sqlite keeps what is done; the same command continues.", "truestroke: interrupted"]
    assert [line for line in said if line] == known
    assert count(tmp_path / "many.sqlite") > 0


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ('noise = { log_uniform = [0.001, 0.1] }|noise = "quiet"', "plant.noise = 'quiet' um: must be a number"),
        ("spread = 0.5 }|spread = 0.5 }\nb = 3", "plant.b = 3 um/V: must be a sequence of numbers"),
        ('stroke = 30.0|stroke = "long"', "controllers.paper.stroke = 'long' um: must be a number"),
    ],
)
def test_what_cannot_be_sampled_is_one_line_and_claims_no_store(tmp_path, wrong, says):
    (tmp_path / "s.toml").write_text(SMALL.replace(*wrong.split("|")))
    done = CliRunner().invoke(main, ["study", str(tmp_path / "s.toml"), "--output", str(tmp_path / "s")])
    assert done.exit_code == 2
    assert done.output.startswith(f"truestroke: {says}")
    assert len(done.output.splitlines()) == 1
    assert not (tmp_path / "s.sqlite").exists()


def test_whole_numbers_are_exact():
    """Beyond 2^53 a float has no odd ones, so a seed that went through one would be another's."""
    assert study.parse(source(seed=2**63 - 1)).seed == 2**63 - 1
    assert [MatchedPlant(np.zeros(1), seed=seed).seed for seed in (2**53 + 1, np.int64(2**62 + 1))] == [
        2**53 + 1,
        2**62 + 1,
    ]
    with pytest.raises(SettingError, match="seed"):
        study.parse(source(seed=2**63))


def test_a_store_counts_nothing_twice_and_belongs_to_one_study(tmp_path, rows):
    batch = study.simulate(SOME, [0, 1])
    with study.Store(tmp_path / "s", SOME) as store:
        store.add(batch)
        store.add(batch)
        store.add(Batch([*batch.rows[:1], rows[7]], {"sample": 1.0}, 10))
        assert store.rows(40) == [rows[0], rows[1], rows[7]]
        assert store.missing(range(9)) == [2, 3, 4, 5, 6, 8]
        assert store.cost()[0] == 4000
        with pytest.raises(StoreError, match="versions"):
            store.add(Batch(batch.rows, {}, 0, {"truestroke": "0.0.1"}))
    study.Store(tmp_path / "s", study.parse(source(runs=80, title="more of it"))).close()
    with pytest.raises(StoreError, match="study differs in seed"):
        study.Store(tmp_path / "s", study.parse(source(seed=1)))
    (tmp_path / "no").write_text("this is not a database, and longer than its header of 100 bytes would be" * 3)
    with pytest.raises(StoreError, match="not a database"):
        study.Store(tmp_path / "no", SOME)


def test_a_damaged_store_is_found(tmp_path, rows):
    """One byte of 240 copies is another: each is found, in one line, or still tells the same."""
    good = tmp_path / "good"
    with study.Store(good, SOME) as store:
        store.add(study.simulate(SOME, range(10)))
        expected = store.rows(40), store.missing(range(40)), store.cost()
    data, random, said = bytearray(good.read_bytes()), np.random.Generator(np.random.PCG64(8)), []
    used = np.flatnonzero(np.frombuffer(data, np.uint8))  # most of a small file is room
    for i in range(240):
        at = int(random.choice(used)) if i % 4 else int(random.integers(len(data)))
        bad = bytearray(data)
        bad[at] ^= 1 << int(random.integers(8))
        (tmp_path / f"{i}").write_bytes(bad)
        try:
            with study.Store(tmp_path / f"{i}", SOME) as store:
                assert (store.rows(40), store.missing(range(40)), store.cost()) == expected, at
        except StoreError as error:
            said.append(str(error))
    assert len(said) > 120
    assert not any("\n" in words for words in said)


def test_rows_that_were_taken_out_or_put_in_are_missed(tmp_path):
    with study.Store(tmp_path / "s", SOME) as store:
        store.add(study.simulate(SOME, range(3)))
    database = sqlite3.connect(tmp_path / "s", isolation_level=None)
    database.execute("DELETE FROM run WHERE number = 1")
    with pytest.raises(StoreError, match="is damaged: it holds 2 runs, not 3; move it away"):
        study.Store(tmp_path / "s", SOME)
    database.execute("INSERT INTO run SELECT 1, sampled, metrics, error, seal FROM run WHERE number = 0")
    database.close()
    with study.Store(tmp_path / "s", SOME) as store, pytest.raises(StoreError, match="run 1 is not as it was"):
        store.rows(3)


def test_more_runs_are_added_to_those_that_are_there(tmp_path, rows):
    calls = []
    with study.Store(tmp_path / "s", SOME) as store:
        drive(study.parse(source(runs=10)), store, executors.threads(1))
        drive(SOME, store, executors.threads(2), lambda *done: calls.append(done))
        assert store.rows(40) == rows
    assert calls == [(10, 40), (40, 40)]


# ---- What it says --------------------------------------------------------------------------------------------------


def made(times, sampled):
    return [
        Row(i, {"x": x, "y": float(i % 3), "same": 1.0}, {name: {"convergence_time": t, "rmse": 0.1, "largest": 1.0}
        for name in ("paper", "default")}) for i, (t, x) in enumerate(zip(times, sampled, strict=True))
    ]  # fmt: skip


def test_shares_and_intervals():
    """Clopper and Pearson's intervals of 8 in 10 and 10 in 10, from published tables."""
    some = made([0.1, 0.2, 0.3, 0.7, 0.1, 0.1, 0.1, 0.1, 0.71, None], range(10))
    line = study.lines(SOME, some)[0]
    assert (line.runs, line.converged, line.share) == (10, 8, 0.8)
    assert (line.low, line.high) == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert line.time == pytest.approx((0.1, 0.56, 0.7), abs=0.02)
    everyone = study.lines(SOME, made([0.0] * 10, range(10)))[0]
    assert (everyone.low, everyone.high) == pytest.approx((0.6915, 1.0), abs=1e-4)
    assert study.lines(SOME, made([None] * 3, range(3)))[0].time is None


def test_what_is_informative():
    """x is above 5.5 where a run fails, but for one pair of five by five that is the other way round."""
    times = [0.1, 0.1, 0.1, 0.1, None, 0.1, None, None, None, None]
    found = study.informative(SOME, made(times, range(10)), "paper")
    assert (found[0].name, found[0].higher) == ("x", pytest.approx(24 / 25))
    assert "same" not in [one.name for one in found]
    assert axes_of_map(SOME, made(times, range(10))) == ("x", "y")
    assert study.informative(SOME, made([0.1] * 4, range(4)), "paper") == []


def test_the_command_reports(tmp_path, monkeypatch):
    def truestroke(*words):
        done = CliRunner().invoke(main, ["study", *words])
        return done.exit_code, done.stdout, done.stderr

    monkeypatch.chdir(tmp_path)

    assert truestroke("--example")[1] == study.example()
    (tmp_path / "small.toml").write_text(SMALL)
    code, out, _ = truestroke("small.toml", "--json", "--plots", "pictures", "--workers", "2")
    found = json.loads(out)
    assert (code, found["runs"]) == (0, 40)
    assert found["controllers"]["paper"]["converged"] < 40
    assert found["cost"]["ticks"] == 80_000
    assert len(found["pictures"]) == 4
    page = (tmp_path / "small.html").read_text()
    code, out, _ = truestroke("small.toml", "--report-only")
    pictures = (tmp_path / "small.html").read_text().count("<svg")
    assert pictures == page.count("<svg") == 4  # each as a phone shows it, too
    assert f"Of 40 runs converged: paper in {100 * found['controllers']['paper']['share']:.2f} %" in out
    (tmp_path / "other.toml").write_text(SMALL.replace("0.7", "0.6"))
    code, _, said = truestroke("other.toml", "--output", "small")
    assert (code, said.count("\n")) == (1, 1)
    assert "small.sqlite holds another study" in said
    assert truestroke("small.toml", "--scheduler", "tcp://here:1")[0] == 2
