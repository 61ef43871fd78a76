"""The interfuse in qudi: its own module classes and interfaces, a simulated card, two simulated stacks, no sensor."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truestroke import ActuatorModel, SettingError, identify, plant, save_model
from truestroke.base.verdict import Verdict
from truestroke.dropins.memory import Memory

FS = 2000.0
SCANNER = Path(__file__).with_name("fakes") / "qudi_scanner.py"


def stack(seed: int) -> plant.RealisticPlant:
    made = plant.RealisticPlant(plant.PlantSettings(noise=0.0), seed=seed)
    made.open()
    return made


@pytest.fixture(scope="module")
def model() -> ActuatorModel:
    """Of the first stack, from a record with a sensor, which was taken away then."""
    time = np.arange(6000) / FS
    volts = 1.5 - 1.5 * np.cos(2 * np.pi * 1.5 * time) * np.cos(0.55 * time)
    record = (volts, stack(0).exchange(volts), FS)
    return identify(record, rate=False, creep_times=(0.03, 0.3, 3.0), asymmetry=2, delay=0.0).model


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory, model: ActuatorModel) -> dict[str, Any]:
    """What the scans in qudi gave: the second stack is of the same kind."""
    folder = tmp_path_factory.mktemp("qudi")
    save_model(folder / "x.toml", model.replace(provenance={}))
    for level in ("bad", "doubtful"):
        found = Verdict(level, ("The sensor was noisy.", "It crept.")).entries
        save_model(folder / f"{level}.toml", model.replace(provenance=found))
    command = [sys.executable, SCANNER, folder, folder / "x.toml", folder / "x.toml"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def test_images_without_a_sensor(found: dict[str, Any]) -> None:
    slope, inverse = (np.array(found[name][:2]) for name in ("slope", "inverse"))
    assert found["errors"] == []
    assert slope.min() > 0.6  # um of 12 um, after the best straight line
    assert inverse.max() < 0.4
    assert (inverse < 0.35 * slope).all()


def test_the_cursor_arrives_where_it_should(found: dict[str, Any]) -> None:
    assert max(found["inverse"][2]) < 0.6


def test_a_scan_that_is_cut_short_is_remembered(found: dict[str, Any]) -> None:
    assert max(found["stopped"]) < 0.4


def test_what_cannot_be_is_an_error_of_the_activation(found: dict[str, Any]) -> None:
    too_long, unknown, missing, channel = found["refused"]
    assert too_long.startswith("position_ranges of x: 90 um from end to end, but its model reaches 4")
    assert unknown == "models: no axis w; position_ranges has x, y"
    assert "none.toml" in missing
    assert channel == "ni_channel_mapping of x = 'ao7': must be an output of the card: ao0, ao1"


def test_a_bad_model_is_refused_and_a_doubtful_one_said(found: dict[str, Any]) -> None:
    state, *said = found["heeded"]["bad"]
    assert state == "deactivated"
    assert any("bad.toml is bad: The sensor was noisy. Record again" in one for one in said)
    state, *said = found["heeded"]["doubtful"]
    assert state == "idle"
    assert any("doubtful.toml is doubtful: The sensor was noisy. It crept." in one for one in said)


def test_the_folder_for_the_configuration_holds_what_qudi_imports() -> None:
    line = subprocess.run(
        [sys.executable, "-m", "truestroke.dropins.qudi_modules"], capture_output=True, text=True, check=True
    ).stdout
    folder = Path(line.split("'")[1])
    assert line.startswith("extension_paths: ['")
    assert (folder / "qudi/hardware/interfuse/truestroke_interfuse.py").is_file()


# ---- The memory itself ----------------------------------------------------------------------------------------------


def test_a_voltage_depends_on_the_way(model: ActuatorModel) -> None:
    axis, stage = Memory(model, (0.0, 3.0)), stack(0)
    zero, off = axis.position, []
    for end in (10.0, 4.0, 18.0, 8.0, 12.0):
        start = axis.position - zero
        wanted = np.linspace(start, end, 200)
        volts = axis.voltages(wanted + zero, 500.0)
        axis.output(volts, 500.0)
        stage.exchange(np.repeat(volts, 4))
        off.append(np.abs(stage.truth[3::4] - wanted).max())
        assert axis.position - zero == pytest.approx(end, abs=0.02)  # led by the lag
    assert max(off) < 0.15  # of a loop that is 2 um wide


def test_output_in_parts_is_output_at_once(model: ActuatorModel) -> None:
    rng = np.random.Generator(np.random.PCG64(0))
    volts = rng.uniform(0.0, 2.9, 300)
    whole, parts = Memory(model, (0.0, 3.0)), Memory(model, (0.0, 3.0))
    whole.output(volts, 100.0)
    for part in np.split(volts, [1, 2, 50, 51, 200]):
        parts.output(part, 100.0)
    assert parts.position == pytest.approx(whole.position, abs=1e-9)
    assert parts.volts == whole.volts
    predicted = model.predict(np.concatenate([[0.0], volts]), 100.0)[-1]
    assert whole.position == pytest.approx(predicted - model.zero, abs=0.2)  # the rate is not in it


def test_limits_hold_and_are_those_of_record_and_output(model: ActuatorModel) -> None:
    axis = Memory(model, (0.2, 2.0))
    assert axis.limits == (0.2, 2.0)
    assert axis.voltages([-50.0, 90.0], 10.0).tolist() == [0.2, 2.0]
    assert Memory(model, (-5.0, 50.0)).limits == model.voltage_range
    with pytest.raises(
        SettingError, match=r"voltage_limits = \(5.0, 6.0\) V: must be limits that have voltages of the"
    ):
        Memory(model, (5.0, 6.0))
    with pytest.raises(SettingError, match=r"^seconds = '1 s' s: must be a number"):
        axis.hold("1 s")  # type: ignore[arg-type]
    assert axis.voltages([], sample_rate=500.0).size == 0
