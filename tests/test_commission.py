"""The guided first volts: stages whose truth is known, wrong wiring, and what becomes of the configuration."""

from __future__ import annotations

import json
import signal
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from forked import ForkedCommand
from running import COMMAND, until

from truestroke.cli import main
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.runtime import gains
from truestroke.runtime.commissioning import AnswerError, Findings, answer, small_steps, whole_range
from truestroke.runtime.commissioning.findings import write
from truestroke.runtime.commissioning.resonance import _Record, resonance
from truestroke.runtime.drivers import OneAxis, SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import config
from truestroke.signals.timing import Timing

pytestmark = pytest.mark.usefixtures("each_picture_once", "empty_folder", "no_waiting")
LIMITS = (-0.6, 3.6)


# ---- The first resonance -------------------------------------------------------------------------------------------


def steps(rate: float = 2000.0, height: float = 0.04) -> np.ndarray:
    """Up and down four times, held for 0.25 s and a bit."""
    holds = np.round(rate * np.array([0.2, 0.26, 0.31, 0.29, 0.34, 0.27, 0.3, 0.25, 0.33])).astype(int)
    return np.repeat(height * np.array([0, 1, 0, 1, 0, 1, 0, 1, 0]), holds)


@pytest.mark.parametrize("damping", [0.003, 0.08])
@pytest.mark.parametrize("frequency", [20.0, 50.0, 120.0, 400.0, 650.0])
def test_the_resonance_of_a_stage_is_found(frequency: float, damping: float) -> None:
    stage = RealisticPlant(PlantSettings(resonance=frequency, damping=damping), seed=3)
    volts = steps()
    found = resonance(volts, stage.exchange(volts), 2000.0, onset=1, noise=0.0134)
    assert found.reason == ""
    assert found.frequency == pytest.approx(frequency, rel=0.01)
    assert abs(found.frequency - frequency) < 3 * found.uncertainty
    assert found.damping == pytest.approx(damping, rel=0.1)


def test_a_frequency_that_cannot_be_the_best_is_not_fitted_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four are tried, with 50 evaluations each at most: the right one takes 6, the others went on to 50."""
    solved, solve = [], _Record.solve
    monkeypatch.setattr(_Record, "solve", lambda *given: (solved.append(given[1]), solve(*given))[1])
    volts = steps()
    stage = RealisticPlant(PlantSettings(resonance=120.0, damping=0.003), seed=3)
    found = resonance(volts, stage.exchange(volts), 2000.0, onset=1, noise=0.0134)
    assert found.frequency == pytest.approx(120.0, rel=1e-4)
    assert len(solved) < 450  # 827 to the end, 296 now


@pytest.mark.parametrize("damping", [0.003, 0.03, 0.08])
@pytest.mark.parametrize("frequency", [900.0, 1100.0, 1500.0, 0.0])
def test_near_and_above_half_the_sample_rate_it_is_right_or_not_known(frequency: float, damping: float) -> None:
    stage = RealisticPlant(PlantSettings(resonance=frequency, damping=damping), seed=3)
    volts = steps()
    found = resonance(volts, stage.exchange(volts), 2000.0, onset=0, noise=0.0134)
    if found.frequency is None:
        assert any(words in found.reason for words in ("half the sample rate", "seen in small steps", "distinguish"))
        assert not found.doubtful
    else:
        assert found.frequency == pytest.approx(frequency, rel=0.05)
    assert frequency == 900.0 or found.frequency is None


# ---- The first steps -----------------------------------------------------------------------------------------------


class Stage:
    """A realistic stack of 120 Hz behind a sensor that may be wrong; remembers the voltages that it got."""

    def __init__(self, sensor: str = "right", offset: float = 0.0, delay: int = 0, **plant: Any) -> None:
        self.sensor, self.offset = sensor, offset
        self.plant = RealisticPlant(PlantSettings(**{"resonance": 120.0, "ad_limits": None, **plant}))
        self.late, self.ticks, self.volts = [0.0] * delay, 0, [0.0]
        self.random = np.random.default_rng(5)

    def open(self) -> Timing:
        return self.plant.open()

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        self.volts += volts.tolist()
        z = self.plant.exchange(volts)
        t = (self.ticks + np.arange(volts.size)) / 2000.0
        self.ticks += volts.size
        z = {
            "right": z,
            "sign": -z,
            "gain": 10 * z,
            "weak": 0.05 * z,
            "dead": np.full(z.size, 0.25),
            "noise": 0.013 * self.random.standard_normal(z.size),
            "another axis": 0.4 * np.sin(2 * np.pi * 3.3 * t) + 0.013 * self.random.standard_normal(z.size),
            "lost": np.where(self.random.random(z.size) < 0.3, np.nan, z),
            "ends": np.minimum(z, 21.0),
        }[self.sensor]
        self.late += (z + self.offset).tolist()
        z, self.late = np.array(self.late[: z.size]), self.late[z.size :]
        self.truth = z
        return z


class Instant(SimulatedDriver):
    """The same driver, but nobody waits for it."""

    def _pass_time(self, period: float, slips: bool) -> None:
        pass


def axis(stage: Stage, **settings: Any) -> OneAxis:
    timing = {"hardware_timed": True, "block": 20, "latency": 40, **settings}
    driver = Instant(SimulatedSettings(**timing), [stage])
    return OneAxis(driver, voltage_limits=LIMITS, slew=400.0)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        ("sign", "makes the displacement smaller, by [89]"),
        ("gain", r"the gain is [89]\d.* um/V; .* 7.14 um/V .* allows 1.43 to 28.6"),
        ("weak", r"the gain is 0.4.* um/V; .* allows 1.43"),
        ("dead", "no answer to steps of 0.21 V, 5 % of voltage_limits: the sensor shows 0.25 um to the last bit"),
        ("noise", "no answer to steps of 0.21 V.*its noise alone"),
        ("another axis", "not with the voltage: is it that of another axis"),
        ("lost", r"[23]\d % of the samples are lost"),
    ],
)
def test_an_axis_that_does_not_answer_as_told_has_hardly_moved(sensor: str, words: str) -> None:
    stage = Stage(sensor)
    with pytest.raises(AnswerError, match=words):
        small_steps(axis(stage), stroke=30.0)
    assert max(np.abs(stage.volts)) <= 0.05 * 4.2 + 1e-12
    assert stage.volts[-1] == 0.0


def test_noise_is_no_answer() -> None:
    """Nine levels of noise agree by chance once in a hundred times, if their differences alone are asked."""
    volts, random = np.repeat([0.0, 0.1] * 4 + [0.0], 40), np.random.default_rng(0)
    assert not any(answer.gain(volts, random.standard_normal(volts.size), 0, noise=1.0).seen for _ in range(1000))


@pytest.mark.parametrize(("block", "latency"), [(5, 0), (20, 40)])
def test_what_is_found_of_a_stage_is_true(block: int, latency: int) -> None:
    stage = Stage(offset=200.0)
    bench = axis(stage, block=block, latency=latency)
    small = small_steps(bench, stroke=30.0)
    assert small.rest.noise == pytest.approx(0.030 / np.sqrt(5), rel=0.1)
    assert small.rest.zero == pytest.approx(200.0, abs=0.01)
    assert small.latency == pytest.approx(latency, abs=0.5)
    assert small.resonance.frequency == pytest.approx(120.0, rel=0.01)
    quiet = RealisticPlant(PlantSettings().without("noise", "resonance", "drift"))
    ways = quiet.exchange(np.repeat([0.0, 0.042, 0.0, 0.042, 0.0], 120)).reshape(5, 120)[:, 60:].mean(axis=1)
    assert small.gain.gain == pytest.approx((ways[1] + ways[3] - 2 * ways[2]) / 2 / 0.042, rel=0.05)
    assert np.abs(np.diff(stage.volts)).max() <= 0.2 * (1 + 1e-9)  # slew
    whole = whole_range(bench, small)
    assert (min(stage.volts), max(stage.volts), stage.volts[-1]) == (*LIMITS, 0.0)
    assert 45.0 < whole.high < 55.0
    assert -6.0 < whole.low < -3.0
    found = Findings(name="x", small=small, whole=whole, limits={"voltage_limits": LIMITS}, asked=30.0, stroke=30.0)
    assert found.verdict().level == "good"
    assert found.changes()["axis", "zero"][0] == pytest.approx(200.0, abs=0.01)
    assert found.changes()["axis", "resonance"][0] == pytest.approx(120.0, rel=0.01)
    assert 0.8 * whole.high < found.proposed < whole.high


def test_a_delay_that_the_driver_does_not_tell_is_told() -> None:
    small = small_steps(axis(Stage(delay=7), latency=2), stroke=30.0)
    assert small.latency == pytest.approx(9.0, abs=0.5)
    whole = whole_range(axis(Stage()), small)
    found = Findings(name="x", small=small, whole=whole, limits={"voltage_limits": LIMITS}, asked=30.0, stroke=30.0)
    verdict = found.verdict()
    assert verdict.level == "doubtful"
    assert "ticks after its command, the driver states 2" in verdict.reasons[0]


def test_a_sensor_that_ends_before_the_voltage_does() -> None:
    bench = axis(Stage("ends"))
    whole = whole_range(bench, small_steps(bench, stroke=30.0))
    assert whole.high == pytest.approx(21.0, abs=0.01)
    assert "no more than 21 um" in whole.ends


# ---- The configuration ---------------------------------------------------------------------------------------------


def test_comments_stay_and_no_backup_is_overwritten() -> None:
    text = config.example()
    Path("run.toml").write_text(text)
    Path("run.toml").chmod(0o640)
    backup = write(Path("run.toml"), {("axis", "resonance"): (123.0, "Hz"), ("axis", "stroke"): (25.0, "um")})
    assert (backup.name, backup.read_text()) == ("run.toml.bak", text)
    second = Path("run.toml").read_text()
    assert write(Path("run.toml"), {("driver", "latency"): (2, "ticks")}).name == "run.toml.bak1"
    assert (backup.read_text(), Path("run.toml.bak1").read_text()) == (text, second)
    made, was = tomllib.loads(Path("run.toml").read_text()), tomllib.loads(text)
    was["axis"][0] |= {"resonance": 123.0, "stroke": 25.0}
    was["driver"]["latency"] = 2
    assert made == was
    kept = [line.partition("#")[2] for line in text.splitlines() if "#" in line and "stroke = " not in line]
    assert all(words in Path("run.toml").read_text() for words in kept)
    assert Path("run.toml").stat().st_mode & 0o777 == 0o640
    assert sorted(path.name for path in Path().iterdir()) == ["run.toml", "run.toml.bak", "run.toml.bak1"]


def test_the_values_of_one_axis_of_two_are_written_into_its_table() -> None:
    Path("two.toml").write_text("[[axis]]\nname = 'x'\nslew = 1.0\n[[axis]] # slow\nname = 'y'\nslew = 2.0\n")
    write(Path("two.toml"), {("axis", "resonance"): (640.0, "Hz")}, "y")
    x, y = tomllib.loads(Path("two.toml").read_text())["axis"]
    assert (x, y) == ({"name": "x", "slew": 1.0}, {"name": "y", "slew": 2.0, "resonance": 640.0})


def test_a_configuration_in_utf_16_is_changed_and_its_backup_is_as_it_was() -> None:
    Path("run.toml").write_text(config.example(), encoding="utf-16")
    before = Path("run.toml").read_bytes()
    assert write(Path("run.toml"), {("axis", "stroke"): (25.0, "um")}).read_bytes() == before
    assert tomllib.loads(Path("run.toml").read_text(encoding="utf-8"))["axis"][0]["stroke"] == 25.0


# ---- The command ---------------------------------------------------------------------------------------------------


def configuration(driver: str = "plant = { resonance = 120.0 }", **changes: str) -> None:
    """The example on a soft stage, that nobody waits for, patient with a busy machine."""
    text = config.example().replace("seed = 0 ", f'{driver}\nregister = "volts"\nhardware_timed = true\n#')
    text = text.replace("duration = 20.0", "duration = 1.0").replace("timeout = 0.25", "timeout = 9.0")
    for old, new in {"overrun_streak = 20": "overrun_streak = 0", **changes}.items():
        assert old in text
        text = text.replace(old, new)
    Path("run.toml").write_text(text)


def call(*arguments: str, typed: str | None = None) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["commission", "--config", "run.toml", *arguments], input=typed)
    return done.exit_code, done.output


@pytest.fixture
def instant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedDriver, "_pass_time", Instant._pass_time)


@pytest.mark.usefixtures("instant")
def test_what_it_writes_makes_a_soft_stage_run() -> None:
    configuration()
    code, said = call("--yes", "--json")
    assert code == 0, said
    printed = json.loads(said)
    assert (printed["verdict"], printed["reasons"]) == ("good", [])
    assert printed["resonance_Hz"] == pytest.approx(120.0, rel=0.01)
    assert printed["backup"] == str(Path("run.toml.bak").resolve())
    assert "Axis x, commissioned" in Path("commission.html").read_text()
    assert np.fromfile("volts").tolist() == [0.0]
    done = subprocess.run(
        [COMMAND, "run", "--config", "run.toml", "--json"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["axes"]["x"]["true_rmse_um"] < 0.2  # without the resonance it shakes: 50 um


@pytest.mark.usefixtures("instant")
def test_a_stroke_beyond_reach_becomes_one_that_is_reached() -> None:
    configuration(**{"stroke = 30.0": "stroke = 90.0"})
    code, said = call("--yes")
    assert code == 0, said
    assert "doubtful" in said
    assert "The stroke of 90 um is beyond reach" in said
    assert tomllib.loads(Path("run.toml").read_text())["axis"][0]["stroke"] == 45.0
    assert len(said.splitlines()) < 16


@pytest.mark.usefixtures("instant")
def test_wrong_wiring_is_exit_code_3_and_changes_nothing() -> None:
    configuration("faults = [{ kind = 'frozen', at = 1001, count = 1000000 }]")
    before = Path("run.toml").read_text()
    code, said = call("--yes", "--json")
    assert code == 3
    assert json.loads(said)["verdict"] == "bad"
    assert "no answer to steps" in json.loads(said)["reasons"][0]
    code, said = call("--yes")
    assert code == 3
    assert "BAD" in said
    assert (Path("run.toml").read_text(), np.fromfile("volts").tolist()) == (before, [0.0])
    assert not Path("commission.html").exists()


def test_nobody_is_there_to_agree() -> None:
    configuration()
    code, said = call()
    assert code == 2
    assert "use --yes in scripts" in said
    assert not Path("volts").exists()


@pytest.mark.usefixtures("instant")
def test_a_driver_that_fails_in_between() -> None:
    configuration("faults = [{ kind = 'error', at = 1500 }]")
    code, said = call("--yes")
    assert (code, np.fromfile("volts").tolist()) == (12, [0.0])
    assert "connection is lost" in said


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_leaves_the_safe_voltage(number: int, code: int) -> None:
    configuration()
    process = ForkedCommand([COMMAND, "commission", "--config", "run.toml", "--yes"], stderr=subprocess.PIPE)
    until(lambda: Path("volts").exists() and np.fromfile("volts").tolist() not in ([], [0.0]), process=process)
    process.send_signal(number)
    process.communicate(timeout=30)
    assert process.returncode == code
    assert np.fromfile("volts").tolist() == [0.0]
    assert not Path("run.toml.bak").exists()


def test_an_axis_that_is_commissioned_passes_the_check_of_every_run() -> None:
    assert gains.RUN[0] < gains.COMMISSIONING[0] < 1.0 < gains.COMMISSIONING[1] < gains.RUN[1]
