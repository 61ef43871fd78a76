"""One base class of errors, all of them public, and what a wrong type is told."""

from __future__ import annotations

import copy
import importlib
import pickle
import pkgutil
from pathlib import Path

import numpy as np
import pytest

import truestroke
from truestroke import plant, trajectories
from truestroke.runtime.batch import Simulation

BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
INTERNAL = {"Stop", "NotHere", "RefusedError"}  # caught where they are raised


def exceptions():
    """Every class of an error or a warning that a module of the package defines."""
    found = {}
    for module in pkgutil.walk_packages(truestroke.__path__, "truestroke."):
        if module.name.rpartition(".")[2].startswith("_"):
            continue
        held = vars(importlib.import_module(module.name))
        found |= {
            name: item
            for name, item in held.items()
            if isinstance(item, type) and issubclass(item, BaseException) and item.__module__.startswith("truestroke")
        }
    return {name: item for name, item in found.items() if not name.startswith("_") and name not in INTERNAL}


def test_every_error_is_public_and_shown_so():
    found = exceptions()
    assert {"SettingError", "RecordError", "RunInterrupted", "DriverError", "TruestrokeError"} <= set(found)
    for name, kind in found.items():
        assert kind.__module__ == "truestroke", name
        assert issubclass(kind, (truestroke.TruestrokeError, Warning)), name
        assert getattr(truestroke, name) is kind, name
        assert kind.__doc__, name


def test_the_kinds_of_python_remain():
    assert issubclass(truestroke.SettingError, ValueError)
    assert issubclass(truestroke.FileError, ValueError)
    assert issubclass(truestroke.RunInterrupted, RuntimeError)


@pytest.mark.parametrize("again", [copy.copy, lambda error: pickle.loads(pickle.dumps(error))], ids=["copy", "pickle"])
@pytest.mark.parametrize(
    "error",
    [
        truestroke.SettingError("stroke", -1.0, "above 0 um", "um"),
        truestroke.SimulationError(3, ValueError("of this")),
        truestroke.RecordError("sweep.csv", "no rows", 7),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_goes_to_another_process_as_it_is(error, again):
    same = again(error)
    assert type(same) is type(error)
    assert str(same) == str(error)
    assert vars(same) == vars(error)


# ---- Wrong types ---------------------------------------------------------------------------------------------------

WAVE = trajectories.sine(frequency=8.0, peak_to_peak=20.0, duration=1.0)
MODEL = truestroke.ActuatorModel(
    thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.eye(3), stroke=20.0, voltage_range=(0.0, 2.0)
)
VOLTS = 1 - np.cos(np.arange(400) / 20)
RECORD = truestroke.Record.from_arrays(VOLTS, 10 * VOLTS, sample_rate=1000.0)
SETTINGS = truestroke.ControllerSettings(**BENCH)


def controller(**settings):
    return truestroke.AdaptiveController(**(BENCH | settings))


class NoExchange:
    def open(self):
        return truestroke.Timing(sample_rate=2000.0)


class NoTiming(NoExchange):
    def open(self):
        return None

    def exchange(self, volts):
        return 10.0 * volts


def simulation(**members):
    return Simulation(**({"trajectory": WAVE, "controller": SETTINGS, "plant": plant.PlantSettings()} | members))


# What was done, and what the error says of it.
MISTAKES = {
    "a desired position as text": (lambda: controller().command("30", 0.0), "z_d = '30' um: must be a number"),
    "no desired velocity": (lambda: controller().command(30.0, None), "zdot_d = None um/s: must be a number"),
    "arrays to command": (
        lambda: controller().command(VOLTS, VOLTS),
        r"z_d = array of shape \(400,\) um: must",
    ),
    "an infinite desired velocity": (lambda: controller().command(1.0, np.inf), "zdot_d = inf um/s: must be finite"),
    "a measurement as text": (lambda: controller().adapt("3"), "z_measured = '3' um: must be a number"),
    "half an age": (lambda: controller().adapt(3.0, 0.5), "ago = 0.5: must be a whole number from 0 to 1023"),
    "an age beyond all numbers": (
        lambda: controller().adapt(3.0, 10**30),
        "ago = 10+: must be a whole number from 0 to",
    ),
    "half an age of a block": (
        lambda: controller().process([1.0], [0.0], [1.0], ago=0.5),
        "ago = 0.5: must be a whole",
    ),
    "an age as text": (lambda: controller().adapt(3.0, "1"), "ago = '1': must be a number"),
    "words as measurements": (
        lambda: controller().process([1.0], [0.0], ["x"]),
        r"z_measured = \['x'\] um: must",
    ),
    "a state without entries": (lambda: controller().restore({}), "state = 0 entries: must be what `state` gave"),
    "no state": (lambda: controller().restore(None), "state = None: must be what `state` gave"),
    "text to a plant": (lambda: plant.RealisticPlant().exchange("x"), "volts = 'x' V: must be an array of numbers"),
    "a table to a plant": (
        lambda: plant.RealisticPlant().exchange(np.eye(2)),
        r"volts = array of shape \(2, 2\)",
    ),
    "a number as progress": (
        lambda: truestroke.run(WAVE, controller(), plant.RealisticPlant(), 3),
        "progress = 3: must be a function of ticks done",
    ),
    "a number as reduce": (lambda: truestroke.simulate_many([], reduce=3), "reduce = 3: must be a function of index"),
    "a wave to summarise": (
        lambda: truestroke.metrics.summary(MODEL),
        "recording = object of class Act",
    ),
    "arrays as a recording": (
        lambda: truestroke.Recording({"volts": VOLTS}),
        r"channels\['volts'\] = array",
    ),
    "a list as a recording": (lambda: truestroke.Recording([VOLTS]), "channels = .*a mapping of names to Channel"),
    "one threshold": (lambda: MODEL.replace(thresholds=0.0), "thresholds = 0.0 V: must be a sequence of numbers"),
    "yes as rate": (lambda: truestroke.identify(RECORD, rate="yes"), "rate = 'yes': must be True or False"),
    "a controller to compare": (
        lambda: truestroke.compare(plant.RealisticPlant, [WAVE], {"ours": controller()}),
        r"controllers\['ours'\] = object of class AdaptiveController: must be a function that gives a controller",
    ),
    "an array as the trajectory": (
        lambda: truestroke.run(np.zeros(100), controller(), plant.RealisticPlant()),
        r"trajectory = array of shape \(100,\): must be a Trajectory, such as of truestroke.trajectories",
    ),
    "swapped arguments of run": (
        lambda: truestroke.run(controller(), WAVE, plant.RealisticPlant()),
        "trajectory = object of class AdaptiveController: must be a Trajectory.*the order is trajectory, contr",
    ),
    "swapped controller and actuator": (
        lambda: truestroke.run(WAVE, plant.RealisticPlant(), controller()),
        r"controller = object of class RealisticPlant: must be a controller.*no command\(\), no adapt\(\)",
    ),
    "the settings as the controller": (
        lambda: truestroke.run(WAVE, SETTINGS, plant.RealisticPlant()),
        "controller = object of class ControllerSettings: must be a controller",
    ),
    "a class as the actuator": (
        lambda: truestroke.run(WAVE, controller(), plant.RealisticPlant),
        "actuator = the class RealisticPlant: .* call the class",
    ),
    "no actuator": (lambda: truestroke.run(WAVE, controller(), None), "actuator = None: must be an actuator"),
    "an actuator that cannot exchange": (
        lambda: truestroke.run(WAVE, controller(), NoExchange()),
        r"must be an actuator.*it has no exchange\(\)",
    ),
    "an actuator that gives no timing": (
        lambda: truestroke.run(WAVE, controller(), NoTiming()),
        r"actuator.open\(\) = None: must be a Timing",
    ),
    "a stroke as text": (lambda: controller(stroke="30"), "stroke = '30' um: must be a number"),
    "a stroke as a list": (lambda: controller(stroke=[30.0]), r"stroke = \[30.0\] um: must be a number"),
    "no stroke": (lambda: controller(stroke=None), "stroke = None um: must be a number"),
    "one voltage limit": (
        lambda: controller(voltage_limits=3.6),
        r"voltage_limits = 3.6 V: must be a pair \(low, high\)",
    ),
    "a name of a setting with a slip": (lambda: controller(forgeting=0.9), "forgeting.*did you mean forgetting"),
    "a dict as settings": (
        lambda: truestroke.AdaptiveController.from_settings(BENCH),
        "settings = .*ControllerSettings",
    ),
    "a number as a model": (
        lambda: truestroke.AdaptiveController.from_model(3, sample_rate=2000.0),
        "model = 3: must be an ActuatorModel, or the file of one",
    ),
    "a dict as a plant's settings": (
        lambda: plant.RealisticPlant({"noise": 0.0}),
        "settings = .* must be a PlantSettings",
    ),
    "an empty dict as a plant's settings": (lambda: plant.RealisticPlant({}), "settings = {}: must be a PlantSettings"),
    "a trajectory as the matched plant's velocity": (lambda: plant.MatchedPlant(WAVE), "velocity = .*array of numbers"),
    "a fractional seed": (lambda: plant.RealisticPlant(seed=0.5), "seed = 0.5: must be a whole number"),
    "a single simulation": (lambda: truestroke.simulate_many(simulation()), "simulations = .*a sequence of Simulation"),
    "plants in place of simulations": (
        lambda: truestroke.simulate_many([plant.RealisticPlant()]),
        r"simulations\[0\] = object of class RealisticPlant: must be a Simulation",
    ),
    "a controller in a simulation": (
        lambda: simulation(controller=controller()),
        "controller = .*a ControllerSettings",
    ),
    "a plant in a simulation": (lambda: simulation(plant=plant.RealisticPlant()), "plant = .*PlantSettings"),
    "an array in a simulation": (lambda: simulation(trajectory=np.zeros(9)), "trajectory = array.*a Trajectory, or a"),
    "a path to identify": (lambda: truestroke.identify("sweep.csv"), "record = .*must be a Record, as of read_record"),
    "an array to identify": (lambda: truestroke.identify(VOLTS), "record = .*must be a Record"),
    "a path to examine": (lambda: truestroke.examine("sweep.csv"), "record = 'sweep.csv': must be a Record"),
    "an array to read": (lambda: truestroke.read_record(VOLTS), r"path = array of shape \(400,\): must be the path"),
    "swapped arguments of refine": (
        lambda: truestroke.refine(RECORD, MODEL),
        "model = object of class Record: must be an ActuatorModel",
    ),
    "a path to refine": (lambda: truestroke.refine(MODEL, "run.h5"), "record = 'run.h5': must be a Record"),
    "an array as a waveform to refine by": (
        lambda: truestroke.refine(MODEL, RECORD, waveform=VOLTS),
        "waveform = array.*a waveform",
    ),
    "the path of a model to waveform": (
        lambda: truestroke.waveform("stage.toml", VOLTS, 1000.0),
        "model = 'stage.toml': must be an ActuatorModel, such as of truestroke.load_model",
    ),
    "a sample rate as text": (
        lambda: truestroke.waveform(MODEL, VOLTS, "1 kHz"),
        "sample_rate = '1 kHz' Hz: must be a number",
    ),
    "swapped arguments of save_model": (
        lambda: truestroke.save_model(MODEL, "stage.toml"),
        "model = 'stage.toml': must be an ActuatorModel.*the order is path, model",
    ),
    "no path of a model": (lambda: truestroke.load_model(None), "path = None: must be the path of a file"),
    "an array to save as a waveform": (lambda: truestroke.save_waveform("w.csv", VOLTS), "must be a PredictedWaveform"),
    "a number as the path of a waveform": (lambda: truestroke.load_waveform(7), "path = 7: must be the path of a file"),
    "a number as the path of a recording": (
        lambda: truestroke.Recording.load(7),
        "path = 7: must be the path of a file",
    ),
    "a path to judge": (lambda: truestroke.judge("run.h5"), "recording = 'run.h5': must be a Recording"),
    "swapped arguments of save_page": (
        lambda: truestroke.save_page("run.html", truestroke.Recording({})),
        "recording = 'run.html': must be a Recording.*the order is recording, path",
    ),
    "a plant to play back on": (
        lambda: truestroke.playback(plant.RealisticPlant(), VOLTS, 2000.0, voltage_limits=(-0.6, 3.6), slew=400.0),
        r"driver = object of class RealisticPlant: must be a driver.*no start\(\), no stop\(\), no close\(\)",
    ),
    "a wave to characterise": (
        lambda: truestroke.characterise(WAVE, stroke=30.0, voltage_limits=(-0.6, 3.6)),
        "actuator = object of class Trajectory: must be an actuator",
    ),
    "a number as the path of a motion": (lambda: trajectories.from_csv(3), "path = 3: must be the path of a file"),
    "a peak-to-peak as text": (
        lambda: trajectories.sine(peak_to_peak="20"),
        "peak_to_peak = '20' um: must be a number",
    ),
    "an actuator to compare": (
        lambda: truestroke.compare(plant.RealisticPlant(), [WAVE], {"ours": controller}),
        "make_actuator = object of class RealisticPlant: must be a function that gives an actuator",
    ),
    "one wave to compare": (
        lambda: truestroke.compare(plant.RealisticPlant, 3.0, {"ours": controller}),
        "trajectories = 3.0: must be a sequence of Trajectory",
    ),
    "controllers without names": (
        lambda: truestroke.compare(plant.RealisticPlant, [WAVE], [controller]),
        "controllers = .*must be a mapping",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_wrong_type_is_told_in_one_line(mistake, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, expected = MISTAKES[mistake]
    with pytest.raises(truestroke.SettingError, match=expected) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250 or "did you mean" in str(caught.value)
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("value", "shown"), [(3 * 0.3, "0.9"), (0.1 + 0.2, "0.3"), (3000.0, "3000.0"), (1 / 3, "0.333333333333"), (7, "7")]
)
def test_a_value_is_shown_without_its_rounding(value: float, shown: str) -> None:
    """A target of 3 * 0.3 was one of 0.8999999999999999 um."""
    assert str(truestroke.SettingError("target", value, "less", "um")) == f"target = {shown} um: must be less"
