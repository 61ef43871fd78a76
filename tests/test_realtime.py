"""`truestroke run`: as accurate as the simulation, each measurement with its command, a recording to read meanwhile."""

from __future__ import annotations

import itertools
import json
import os
import pty
import signal
import subprocess
import threading
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from late import Late
from running import COMMAND, rows

from truestroke import AdaptiveController, Dynamics, Mode, Recording, SettingError, Timing, run, trajectories
from truestroke.cli import main
from truestroke.identification import ActuatorModel, save_model
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.runtime.drivers import SimulatedDriver, SimulatedSettings
from truestroke.runtime.drivers.paced import EDGES_US
from truestroke.runtime.realtime import Axis, Cause, RealtimeSettings, config, run_realtime, status
from truestroke.runtime.realtime.shared import Layout, Shared, Slot, State, Text
from truestroke.signals.trajectories import Trajectory, random_wave, sine

xarray = Late("xarray")

pytestmark = pytest.mark.usefixtures("empty_folder", "forked_helpers")

LIMITS, SLEW = (-0.6, 3.6), 400.0
PATIENT = RealtimeSettings(spin=0.0, overrun_streak=0, watchdog_timeout=20.0)  # a busy machine is late by ms and more


def axis(wave: Trajectory, name: str = "axis") -> Axis:
    rate = wave.sample_rate
    controller = AdaptiveController(sample_rate=rate, stroke=30.0, voltage_limits=LIMITS, slew_limit=SLEW)
    return Axis(trajectory=wave, controller=controller, voltage_limits=LIMITS, slew=SLEW, name=name)


def document(**changes: Any) -> dict[str, Any]:
    """The example, short, on a machine that may be busy."""
    made = tomllib.loads(config.example())
    made["axis"][0]["trajectory"]["duration"] = 1.0
    made["realtime"] |= {"overrun_streak": 0, "watchdog_timeout": 20.0, "cpu": min(os.sched_getaffinity(0))}
    return made | changes


def test_the_run_of_the_example_is_the_simulation_to_the_last_bit() -> None:
    cpus = os.sched_getaffinity(0)
    job, twin = (config.job(document(), Path()) for _ in range(2))
    outcome = run_realtime(job.driver, job.axes, job.file, settings=job.settings)
    assert outcome.cause is Cause.FINISHED
    assert os.sched_getaffinity(0) == cpus
    assert (outcome.ticks, outcome.lost, outcome.limited) == (2000, 0, 0)
    live = Recording.load("run.h5")
    offline = run(twin.axes[0].trajectory, twin.axes[0].controller, RealisticPlant(PlantSettings(), seed=0))
    for name, channel in offline.channels.items():
        assert live[name].dtype == channel.data.dtype
        assert live.unit(name) == channel.unit
        np.testing.assert_array_equal(live[name], channel.data, err_msg=name)
    with xarray.open_dataset("run.h5") as file:  # by its dimension scales
        entries = {"time": 2000, "weights_time": 100, "weights_index": 41, "partial_slopes_index": 26}
        assert {name: size for name, size in file.sizes.items() if name != "ending"} == entries
        assert file["measured"].dims == ("time",)
    late = live.metadata["lateness"]
    assert sum(late["blocks"]) == 2000 == sum(outcome.histogram)
    below = np.searchsorted(EDGES_US, np.maximum(live["lateness"], 0), side="left")  # the histogram by another way
    np.testing.assert_array_equal(np.bincount(below, minlength=len(EDGES_US) + 1), late["blocks"])
    assert live.metadata["controller"] == offline.metadata["controller"]
    assert live.metadata["versions"] == offline.metadata["versions"]


class Spring:
    """A stiff one: its displacement tells which command it answers."""

    def __init__(self, gain: float) -> None:
        self.gain, self.truth = gain, np.empty(0)

    def open(self) -> Timing:
        return Timing(sample_rate=1000.0)

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        self.truth = self.gain * volts
        return self.truth


def test_the_mark_of_a_raster_and_the_dynamics_of_its_turns_come_from_the_configuration(tmp_path: Path) -> None:
    stage = Dynamics(sample_rate=2000.0, modes=(Mode(frequency=500.0, damping=0.02),))
    stage.save(tmp_path / "dynamics.toml")
    made = document()
    made["axis"][0]["trajectory"] = {"kind": "raster", "frequency": 20.0, "turn": "dynamics.toml", "duration": 1.0}
    job = config.job(made, tmp_path)
    run_realtime(job.driver, job.axes, job.file, settings=job.settings)
    live, wave = Recording.load("run.h5"), trajectories.raster(frequency=20.0, turn=stage, duration=1.0)
    assert live["flat"].dtype == np.uint8
    np.testing.assert_array_equal(live["flat"], wave.flat)
    made["axis"][0]["trajectory"]["turn"] = "none.toml"
    with pytest.raises(SettingError, match=r"trajectory.turn = 'none.toml': must be dynamics of truestroke bode"):
        config.job(made, tmp_path)


@pytest.mark.parametrize(("block", "latency", "paced"), [(1, 2, False), (7, 0, False), (20, 40, True)])
def test_each_measurement_is_paired_with_its_command_on_each_axis(block: int, latency: int, paced: bool) -> None:
    timing = {"sample_rate": 1000.0, "block": block, "latency": latency, "channels": 2, "hardware_timed": paced}
    driver = SimulatedDriver(SimulatedSettings(**timing), [Spring(10.0), Spring(9.0)])
    waves = [sine(frequency=f, peak_to_peak=12.0, duration=0.51, sample_rate=1000.0) for f in (6.0, 11.0)]
    axes = [axis(wave, name) for wave, name in zip(waves, "xy", strict=True)]
    began = time.monotonic()
    outcome = run_realtime(driver, axes, "run.h5", settings=PATIENT)
    assert time.monotonic() - began >= 0.5
    assert [path.name for path in outcome.files] == ["run-x.h5", "run-y.h5"]
    for path, wave, gain in zip(outcome.files, waves, (10.0, 9.0), strict=True):
        recording = Recording.load(path)
        answered = slice(None, -latency or None)
        np.testing.assert_array_equal(recording["measured"][answered], gain * recording["volts"][answered])
        np.testing.assert_array_equal(recording["true"], recording["measured"])
        assert np.isnan(recording["measured"][510 - latency :]).all()
        np.testing.assert_array_equal(recording["desired"], wave.position)
        error = (recording["measured"] - recording["desired"])[255:470]
        assert np.abs(error).max() < (0.05 if latency < 40 else 0.5)


# ---- As a user runs it ---------------------------------------------------------------------------------------------


def test_in_a_terminal() -> None:
    """A status line, a file that others read meanwhile, and Ctrl-C."""
    Path("run.toml").write_text(
        config.example().replace("duration = 20.0 ", "duration = 90.0 ").replace("= 0.25", "= 9")
    )
    ours, theirs = pty.openpty()
    process = subprocess.Popen([COMMAND, "run", "--config", "run.toml"], stderr=theirs, stdout=subprocess.PIPE)
    os.close(theirs)
    shown: list[bytes] = []
    reader = threading.Thread(target=lambda: shown.extend(itertools.takewhile(bool, iter(lambda: _read(ours), b""))))
    reader.start()
    lengths = []
    for _ in range(200):
        time.sleep(0.1)
        lengths.append(rows("run.h5"))
        if lengths[-1] > 3000:
            break
    assert len({n for n in lengths if n}) > 2  # it grows before our eyes
    process.send_signal(signal.SIGINT)
    stdout, _ = process.communicate(timeout=30)
    reader.join()
    os.close(ours)
    assert process.returncode == 130, b"".join(shown)
    screen = b"".join(shown).decode()
    assert "running" in screen
    assert "s left   overruns" in screen
    assert "x: rmse 0." in screen
    assert screen.rstrip().endswith("truestroke: Ctrl-C")
    printed = stdout.decode()
    assert "verdict    doubtful" in printed
    assert "90 s: Ctrl-C." in printed
    assert "recording  run.h5" in printed
    reported = CliRunner().invoke(main, ["report", "run.h5", "--json"])
    assert json.loads(reported.stdout)["measured_rmse_um"] < 0.1


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # the other end is closed
        return b""


def test_json_in_a_pipe_and_no_overwriting() -> None:
    text = config.example().replace("duration = 20.0 ", "duration = 0.6 ").replace("= 0.25", "= 9")
    Path("run.toml").write_text(text.replace("overrun_streak = 20", "overrun_streak = 0"))
    command = [COMMAND, "run", "--config", "run.toml", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert [
        line for line in done.stderr.splitlines() if "the timer of this system" not in line
    ] == []  # a busy machine's
    printed = json.loads(done.stdout)
    assert (printed["cause"], printed["exit_code"], printed["ticks"]) == ("finished", 0, 1200)
    assert printed["axes"]["x"]["true_rmse_um"] < 0.1
    code, said = call("--config", "run.toml")
    assert code == 1
    assert "run.h5: a recording is there" in said


def call(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["run", *arguments])
    return done.exit_code, done.output


def test_what_the_command_line_refuses() -> None:
    assert call("--example") == (0, config.example())
    code, said = call()
    assert code == 2
    assert "--example prints one" in said
    Path("run.toml").write_text(config.example().replace("seed = 0", 'faults = [{ kind = "open" }]'))
    assert call("--config", "run.toml") == (12, "truestroke: open: error -2: the simulated device does not answer\n")
    Path("run.toml").write_text('format = "truestroke model"\n')
    code, said = call("--config", "run.toml")
    assert code == 2
    assert "--config run.toml is a model; it must be a configuration: `truestroke run --example` prints one" in said
    with pytest.raises(SettingError, match=r"the file = truestroke model: must be a configuration, with tables"):
        config.load("run.toml")


@pytest.mark.parametrize(
    ("file", "words"),
    [
        (b"[driver\n", "run.toml: line 1 = '[driver': must be TOML ("),
        (b"x = 1\nslew = 400,0 # V/s\n", "line 2 = 'slew = 400,0 # V/s': must be TOML (Expected newline"),
        (b"slew = 400,0\n", "; a decimal has a point, as in 2.5)"),
        (b"\x89HDF", "run.toml: the file = other bytes than those of text: must be TOML, in UTF-8"),
        (b"x = " + 2000 * b"[", "run.toml: the file = text: must be TOML ("),
    ],
)
def test_a_configuration_that_is_no_toml_is_shown_its_line(file: bytes, words: str) -> None:
    Path("run.toml").write_bytes(file)
    code, said = call("--config", "run.toml")
    assert (code, said.count("\n")) == (2, 1)
    assert words in said


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_configuration_may_be_of_an_editor_of_windows(encoding: str) -> None:
    """PowerShell writes `truestroke run --example > stage.toml` in UTF-16."""
    Path("run.toml").write_text(config.example(), encoding=encoding, newline="\r\n")
    assert config.load("run.toml").axes[0].slew == 400.0


def test_a_recording_needs_no_name() -> None:
    made = document()
    del made["recording"]
    assert config.job(made, Path()).file == Path("run.h5")


# ---- The configuration ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"drivers": {}}, "drivers = .*did you mean driver.*There are driver, axis, scan, coupled, realtime"),
        ({"driver": {}}, 'driver.name = missing: must be given, such as name = "simulated"$'),
        ({"driver": {"name": "labview"}}, "driver.name = 'labview': must be one of nidaqmx, nv200, pi, simulated"),
        (
            {"driver": {"name": "simulated", "blok": 5}},
            "driver.blok = 5: must be left out; did you mean block.* There are name, sample_rate, block",
        ),
        ({"axis": []}, "at least one table"),
        ({"axis.slow": 1.0}, "axis.slow = 1.0: must be left out; did you mean slew.* There are name, stroke"),
        ({"axis.slew": None}, r"axis.slew = missing: must be given, such as slew = 400.0 \(V/s\)"),
        ({"axis": {"name": "x"}}, r"axis = a table: must be a list of tables: \[\[axis\]\], with double brackets"),
        ({"axis.trajectory": [{}]}, "axis.trajectory = tables: must be a table, with single brackets"),
        ({"axis.trajectory": None}, r"trajectory.kind = missing: .*such as kind = \"sine\", in a table \[axis.traj"),
        ({"axis.sample_rate": 1000}, r"axis.sample_rate = 1000: must be in \[driver\]"),
        ({"axis.error_time": 1.0}, r"axis.error_time = 1.0: must be in \[realtime\]"),
        ({"axis.trim_rate": 1.0}, r"axis.trim_rate = 1.0: must be in settings of \[\[axis\]\]"),
        ({"axis.slew_limit": 400.0}, r"axis.slew_limit = 400.0: must be slew, in \[\[axis\]\]"),
        ({"trajectory": {}}, r"trajectory = a table: must be \[axis.trajectory\], below its \[\[axis\]\]"),
        ({"axis.trajectory": {"kind": "sine", "zero": 1.0}}, r"trajectory.zero = 1.0: must be in \[\[axis\]\], above"),
        ({"axis.stroke": None}, r"axis.stroke = missing: must be given, such as stroke = 30.0 \(um\), the length"),
        ({"axis.safe_voltage": 5.0}, "safe_voltage = 5.0 V"),
        ({"axis.zero": "measure"}, "axis.zero = 'measure' um: must be a number or 'measured'$"),
        ({"axis.controller": "pid"}, "axis.controller = 'pid': must be one of adaptive, paper"),
        ({"axis.settings": {"slew_limit": 3.0}}, r"axis.settings.slew_limit = 3.0: must be slew, in \[\[axis\]\]$"),
        ({"axis.settings": {"stroke": 3.0}}, r"axis.settings.stroke = 3.0: must be in \[\[axis\]\], above its other"),
        ({"axis.controller": "paper", "axis.settings": {"trim_rate": 3.0}}, "there are none"),
        ({"axis.model": "m.toml"}, "left out where there is a model"),
        ({"axis.trajectory": 3}, "axis.trajectory = 3: must be a table"),
        ({"axis.trajectory": {"kind": "sine", "cutoff": 3.0}}, "axis.trajectory.cutoff = 3.0: must be left out"),
        ({"axis.trajectory": {"kind": "spiral"}}, "axis.trajectory.kind = 'spiral'"),
        ({"axis.name": "a/b"}, "name = 'a/b'"),
        ({"realtime": {"spin": 1e-4, "priority": 50}}, "spin = 0.0001 s: must be 0 under SCHED_FIFO"),
        ({"realtime": {"watchdog": 1.0}}, "realtime.watchdog = 1.0"),
        ({"realtime": {"file": "a.h5"}}, r"realtime.file = 'a.h5': must be in \[recording\]"),
        ({"recording": {"spin": 0.0}}, r"recording.spin = 0.0: must be in \[realtime\]"),
        ({"driver": {"name": "simulated", "noise": 0.1}}, "driver.noise = 0.1: must be in plant or stage$"),
        ({"driver": {"name": "simulated", "dead_time": 0.1}}, "driver.dead_time = 0.1: must be in stage$"),
        ({"recording": {"files": "x"}}, "recording.files"),
        ({"recording": {"file": ""}}, r"recording.file = .*: must be a name that ends with .*, such as run.h5$"),
        ({"recording": {"file": 5}}, "recording.file = 5: must be text in quotes"),
        ({"recording": {"file": "scan.csv"}}, "recording.file = 'scan.csv': must be a name that ends with .*scan.h5"),
        ({"axis": [3]}, r"axis = 3: must be a table"),
        ({"axis": 3}, "axis = 3: must be a list"),
        ({"axis.stroke": "30"}, "axis.stroke = '30' um: must be a number, without quotes"),
        ({"axis.stroke": True}, "axis.stroke = True um: must be a number"),
        ({"axis.resonance": "180"}, "axis.resonance = '180' Hz: must be a number"),
        ({"axis.resonance": -1.0}, "axis.resonance = -1.0 Hz: must be from 0 to 1e"),
        ({"axis.slew": "400"}, "axis.slew = '400' V/s: must be a number"),
        ({"axis.slew": -4.0}, "axis.slew = -4.0 V/s: must be above 0"),
        ({"axis.voltage_limits": 3.6}, r"axis.voltage_limits = 3.6 V: must be a list, in brackets: \[...\]"),
        ({"axis.voltage_limits": [0.0]}, r"axis.voltage_limits = \(0.0,\) V: must be a pair"),
        ({"axis.voltage_limits": ["0", 3.6]}, "axis.voltage_limits = '0' V: must be a number, without quotes"),
        ({"axis.name": 3}, "axis.name = 3: must be text"),
        ({"axis.settings": {"trim_rate": "3"}}, "axis.settings.trim_rate = '3': must be a number"),
        (
            {"axis.settings": {"hum": "50 Hz"}},
            r"hum = '50 Hz': must be a list of numbers, without quotes: hum = \[50\]$",
        ),
        ({"axis.settings": {"trim_rate": -3.0}}, "axis.settings.trim_rate = -3.0 1/s"),
        ({"axis.settings": {"trim_rat": 3.0}}, "axis.settings.trim_rat .*did you mean trim_rate"),
        ({"axis.settings": {"lag": "no"}}, "axis.settings.lag = 'no': must be true or false, without quotes"),
        ({"axis.trajectory": {"kind": "sine", "frequency": "3"}}, "axis.trajectory.frequency = '3': must be a number"),
        ({"axis.trajectory": {"kind": ["sine"]}}, "axis.trajectory.kind = "),
        ({"axis.trajectory": {"kind": "from_csv", "path": 3}}, "axis.trajectory.path = 3: must be text"),
        ({"axis.trajectory": {"kind": "from_csv", "path": "n.csv"}}, "axis.trajectory.*n.csv"),
        ({"realtime": 3}, "realtime = 3: must be a table"),
        ({"realtime": {"cpu": "1"}}, "realtime.cpu = '1': must be a whole number"),
        ({"realtime": {"spin": False}}, "realtime.spin = False: must be a number"),
        ({"realtime": {"sensor_timeout": 0.0}}, "realtime.sensor_timeout = 0.0 s"),
        ({"driver": {"name": "simulated", "seed": "1"}}, "driver.seed = '1': must be a whole number, without quotes"),
        ({"driver": {"name": "simulated", "plant": 3}}, "driver.plant = 3: must be a table"),
        ({"driver": {"name": "simulated", "plant": {"nois": 0.1}}}, "driver.plant.nois .*did you mean noise"),
        (
            {"driver": {"name": "simulated", "plant": {"noise": "0.1"}}},
            "driver.plant.noise = '0.1': must be a number, without quotes",
        ),
        ({"driver": {"name": "simulated", "plant": {"change": {"tim": 1}}}}, "driver.plant.change.tim .*mean time"),
        ({"driver": {"name": "simulated", "plant": {"change": {"gain": 1}}}}, "driver.plant.change.time = missing"),
        ({"driver": {"name": "simulated", "faults": [3]}}, "driver.faults = 3: must be a table"),
        ({"driver": {"name": "simulated", "faults": [{"kind": "nan", "a": 1}]}}, "driver.faults.a = 1"),
        ({"driver": {"name": "simulated", "hardware_timed": 1}}, "driver.hardware_timed = 1: must be true or false"),
        ({"driver": {"name": "nidaqmx", "outputs": 1, "inputs": [], "um_per_volt": 1.0}}, "driver.outputs = 1"),
        (
            {"driver": {"name": "nidaqmx"}},
            r'driver.outputs = missing: must be given, such as outputs = \["Dev1/ao0"\]$',
        ),
        (
            {"driver": {"name": "nidaqmx", "outputs": ["a/b"], "inputs": ["a/c"]}},
            "um_per_volt = missing: .* such as um_",
        ),
        ({"driver": {"name": "nv200"}}, r'driver.resource = missing: must be given, such as resource = "ASRL3::INSTR"'),
        (
            {"driver": {"name": "pi", "host": "a"}},
            r"driver.output_range = missing: .* such as output_range = \[-20.0, 120",
        ),
        (
            {"driver": {"name": "visa"}},
            r'driver.resource = missing: must be given, such as resource = "TCPIP::192\.168',
        ),
        ({"epics": {"prefix": 3}}, "epics.prefix = 3: must be text"),
    ],
)
def test_what_is_wrong_in_a_configuration_is_named(changes: dict[str, Any], words: str) -> None:
    made = document()
    for key, value in changes.items():
        *inside, name = key.split(".")
        table = made["axis"][0] if inside else made
        table.pop(name, None)
        if value is not None:
            table[name] = value
    with pytest.raises(SettingError, match=words):
        config.job(made, Path())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is no such file"),
        ("[driver]\n", "format = None: must be 'truestroke model'"),
        ("\x00", "Invalid"),
        ('format = "truestroke model"\nversion = 1\nmodel = {}\n', "weights = missing"),
    ],
)
def test_a_model_that_is_none_is_one_line(text: str | None, words: str) -> None:
    """It was 45 lines of traceback."""
    wanted = (
        config.example().replace("stroke = 30.0 ", 'model = "stage.toml" ').replace("controller =", "# controller =")
    )
    Path("run.toml").write_text(wanted)
    if text is not None:
        Path("stage.toml").write_text(text)
    code, said = call("--config", "run.toml")
    assert (code, said.count("\n")) == (2, 1), said
    assert said.startswith("truestroke: run.toml: axis.model = 'stage.toml': must be a model of truestroke identify")
    assert words in said


def test_the_file_and_the_axis_are_named_where_there_are_several() -> None:
    text = config.example() + config.example()[config.example().index("[[axis]]") :].partition("[realtime]")[0]
    head, _, second = text.rpartition("slew = 400.0")
    Path("run.toml").write_text(f'{head}slew = "fast"{second}')
    with pytest.raises(SettingError, match=r"^run.toml: \[\[axis\]\] 2: slew = 'fast' V/s: must be a number, "):
        config.load("run.toml")


def test_a_trajectory_takes_the_sample_rate_of_the_driver() -> None:
    """It had to be repeated."""
    made = document()
    made["driver"]["sample_rate"] = 1000.0
    (axis_,) = config.job(made, Path()).axes
    assert (axis_.trajectory.sample_rate, len(axis_.trajectory)) == (1000.0, 1000)
    assert axis_.controller.settings.sample_rate == 1000.0  # type: ignore[attr-defined]
    made["axis"][0]["trajectory"]["sample_rate"] = 2000.0
    job = config.job(made, Path())
    with pytest.raises(SettingError, match=r"trajectory.sample_rate = 2000.0 Hz: must be 1000.0 Hz"):
        run_realtime(job.driver, job.axes, job.file)
    Path("move.csv").write_text("t (s),z (um)\n" + "".join(f"{k / 500},{k}\n" for k in range(9)))
    made["axis"][0]["trajectory"] = {"kind": "from_csv", "path": "move.csv"}
    with pytest.raises(SettingError, match=r"axis.trajectory.sample_rate = 1000.0 Hz: must be 500 Hz, as the times of"):
        config.job(made, Path())


def test_the_law_learns_below_the_resonance() -> None:
    made = document()
    made["axis"][0]["resonance"] = 120.0
    (soft,) = config.job(made, Path()).axes
    assert (soft.controller.settings.resonance, soft.controller.settings.filter_frequency) == (120.0, 60.0)  # type: ignore[attr-defined]
    made["axis"][0]["settings"] = {"filter_frequency": 90.0}
    (told,) = config.job(made, Path()).axes
    assert told.controller.settings.filter_frequency == 90.0  # type: ignore[attr-defined]


def test_controllers_of_a_configuration(tmp_path: Path) -> None:
    made = document()
    made["axis"][0] |= {"controller": "paper"}
    (paper,) = config.job(made, Path()).axes
    assert paper.controller.settings.law == "rls"  # type: ignore[attr-defined]
    made["axis"][0] |= {"controller": "adaptive", "settings": {"trim_rate": 20.0}}
    (adaptive,) = config.job(made, Path()).axes
    assert adaptive.controller.settings.trim_rate == 20.0  # type: ignore[attr-defined]
    assert adaptive.controller.settings.slew_limit == adaptive.slew  # type: ignore[attr-defined]
    shape: dict[str, Any] = {"thresholds": (0.0, 0.3), "rate_dependent": (1,), "creep_times": (1e-3,), "asymmetry": 1}
    weights = {"weights": np.array([8.0, 1 / 3, 0.0, 0.0, 0.0, 0.0, 0.0]), "covariance": np.eye(7)}
    model = ActuatorModel(**shape, **weights, stroke=30.0, voltage_range=LIMITS, rate_scale=1 / 1500)
    save_model(tmp_path / "stage.toml", model)
    for key in ("controller", "stroke", "settings"):
        del made["axis"][0][key]
    made["axis"][0]["model"] = "stage.toml"
    (known,) = config.job(made, tmp_path).axes
    assert known.controller.settings.thresholds == (0.0, 0.3)  # type: ignore[attr-defined]


def test_axes_that_do_not_fit_together() -> None:
    two = SimulatedSettings(channels=2)
    waves = random_wave(duration=0.6), random_wave(duration=0.7)
    with pytest.raises(SettingError, match="name = x, x"):
        run_realtime(SimulatedDriver(two), [axis(waves[0], "x"), axis(waves[0], "x")], "run.h5")
    with pytest.raises(SettingError, match="of the same length"):
        run_realtime(SimulatedDriver(two), [axis(waves[0], "x"), axis(waves[1], "y")], "run.h5")
    with pytest.raises(SettingError, match=r"sample_rate = 2000\.0 Hz: must be 1000\.0 Hz, that of the actuator"):
        run_realtime(SimulatedDriver(SimulatedSettings(sample_rate=1000.0)), [axis(waves[0])], "run.h5")
    slow = SimulatedSettings(sample_rate=2000.0, block=60)
    with pytest.raises(SettingError, match=r"watchdog_timeout = 0.05 s: must be from 0.12 to 60 s"):
        run_realtime(
            SimulatedDriver(slow), [axis(waves[0])], "run.h5", settings=RealtimeSettings(watchdog_timeout=0.05)
        )


# ---- What is shared ------------------------------------------------------------------------------------------------


def test_the_status_line_says_what_the_ring_holds() -> None:
    shared = Shared(Layout(channels=2, size=1000, slow_size=1, slow_width=1))
    assert status.line(shared, ["x", "y"], 1000.0).startswith("preparing")
    shared.ring[0, 2], shared.ring[0, 3] = 1.5, 0.000324  # volts and measured; desired is 0
    shared.ring[1, 3] = np.nan
    for slot, value in ((Slot.STATE, State.LIVE), (Slot.TICKS, 5000), (Slot.WRITTEN, 2700), (Slot.OVERRUNS, 4)):
        shared.count[slot] = value
    said = status.line(shared, ["x", "y"], 1000.0)
    assert said == "running   2.3 s left   overruns 4   x: rmse 0.000324 um, +1.500 V   y: rmse ? um, +0.000 V"
    shared.write(Text.COMPLAINT, "µ" * 20000)
    assert set(shared.read(Text.COMPLAINT)) <= {"µ", "\ufffd"}
    shared.close()


# ---- A driver of another package -----------------------------------------------------------------------------------

FOREIGN = """
from dataclasses import dataclass
from truestroke.runtime.drivers import SimulatedDriver, SimulatedSettings
from truestroke.runtime.drivers.registry import package

@dataclass(frozen=True, kw_only=True)
class StageSettings:
    port: str
    sample_rate: float = 1000.0

class StageDriver(SimulatedDriver):
    Settings = StageSettings
    needs = (package("stagelib", "talks to the stage"),)

    def __init__(self, settings):
        super().__init__(SimulatedSettings(sample_rate=settings.sample_rate))
        self._port = settings.port

    def describe(self):
        return super().describe() | {"port": self._port}
"""


def test_a_driver_of_another_package_is_run_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A distribution that is installed: a module, and metadata with an entry point."""
    told = tmp_path / "site" / "stage-1.0.dist-info"
    told.mkdir(parents=True)
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: stage\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text("[truestroke.drivers]\nmystage = foreign_stage:StageDriver\n")
    (told.parent / "foreign_stage.py").write_text(FOREIGN)
    text = config.example().replace('name = "simulated"', 'name = "mystage"\nport = "COM3"').replace("seed = 0 ", "# ")
    text = text.replace("sample_rate = 2000.0", "sample_rate = 1000.0").replace("duration = 20.0", "duration = 1.0")
    Path("run.toml").write_text(text)
    found = {**os.environ, "PYTHONPATH": str(told.parent)}
    command = [COMMAND, "run", "--config", "run.toml"]
    done = subprocess.run(command, env=found, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert Recording.load("run.h5").metadata["plant"]["settings"]["port"] == "COM3"
    Path("run.toml").write_text(text.replace('port = "COM3"', "prot = 3"))
    monkeypatch.syspath_prepend(told.parent)
    said = call("--config", "run.toml")[1]
    assert "driver.prot = 3: must be left out; did you mean port? There are name, port, sample_rate" in said
    Path("run.toml").write_text(text.replace('"mystage"', '"mystag"'))
    said = call("--config", "run.toml")[1]
    assert "driver.name = 'mystag': must be one of mystage, nidaqmx, nv200, pi, simulated, visa" in said
    examined = CliRunner().invoke(main, ["doctor", "--json"])
    assert "stagelib" in {finding["what"] for finding in json.loads(examined.stdout)["findings"]}
