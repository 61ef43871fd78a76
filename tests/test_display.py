"""How controllers, plants and models show themselves: a screen with units; in a notebook a table that says µm."""

import re

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings
from truestroke.control.actuator import ActuatorModel
from truestroke.control.baselines import ConstantGain, Pid, PidGains
from truestroke.control.reference import ReferenceController
from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant

BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}


def model() -> ActuatorModel:
    covariance = np.diag([0.04, 0.01, 1e-6, 0.25])
    more = {"metrics": {"held_out_rmse_um": 0.021}, "provenance": {"source": "a record & <its> notes, " + 20 * "long "}}
    return ActuatorModel(
        thresholds=(0.0, 0.5), weights=[8.0, 2.0, 0.0, 0.5], covariance=covariance, stroke=20.0,
        voltage_range=(0.0, 2.0), delay=2e-4, **more,
    )  # fmt: skip


OBJECTS = {
    "controller": lambda: AdaptiveController(**BENCH),
    "paper": lambda: AdaptiveController.paper(**BENCH),
    "NumPy": lambda: ReferenceController(ControllerSettings(**BENCH, plays=3)),
    "settings": lambda: ControllerSettings(**BENCH),
    "constant gain": lambda: ConstantGain(12.5, voltage_limits=(-0.6, 3.6)),
    "PID": lambda: Pid(PidGains(k_p=0.0, k_i=20.0, k_d=0.0, T_f=0.0), sample_rate=2e3, voltage_limits=(-0.6, 3.6)),
    "realistic": lambda: RealisticPlant(PlantSettings(change=Change(time=1.0, gain=0.8)), seed=4),
    "matched": lambda: MatchedPlant(np.zeros(9), MatchedSettings(noise=0.0)),
    "model": model,
}

# A line of each, word by word.
LINES = {
    "controller": "AdaptiveController: kalman, 26 plays, 41 weights, double precision",
    "paper": "slew_limit 1e+09 V/s",
    "NumPy": "ReferenceController: BoundedKalman, kalman, 3 plays, 15 weights, double precision",
    "settings": "initial_weights 41: 8.21429, 0, ... 0 um/V",
    "constant gain": "sensitivity 12.5 um/V",
    "PID": "k_i 20 V/(um s)",
    "realistic": "change Change(time=1.0, gain=0.8, hysteresis=1.0)",
    "matched": "a 8: 8.4, 1.3, ... 2.23 um/V",
    "model": "weight a0 8 +- 0.2 um/V",
}


@pytest.mark.parametrize("name", OBJECTS)
def test_a_repr_is_a_screen_of_names_values_and_units(name) -> None:
    lines = repr(OBJECTS[name]()).splitlines()
    assert LINES[name] in [" ".join(line.split()) for line in lines]
    assert len(lines) <= 50
    assert max(map(len, lines)) <= 120


@pytest.mark.parametrize("name", OBJECTS)
def test_a_notebook_shows_the_same_as_a_table(name) -> None:
    shown = OBJECTS[name]()
    page = shown._repr_html_()
    assert page.count("<tr>") == len(repr(shown).splitlines()) - 1
    assert not re.search(r"\bum\b", page)
    assert "<its>" not in page


def test_a_controller_shows_what_has_happened() -> None:
    controller = AdaptiveController(**BENCH, resonance=200.0)
    for z in (1.0, 2.0, np.nan):
        controller.command(1.0, 0.0)
        controller.adapt(z)
    rows = dict(line.strip().split(maxsplit=1) for line in repr(controller).splitlines()[1:])
    assert (rows["commands"], rows["adaptations"], rows["rejected"]) == ("3 ticks", "2 ticks", "1 ticks")
    assert rows["resonance"] == "200 Hz"
    assert rows["innovation"].endswith(" um")
