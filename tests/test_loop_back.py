"""Loop-back: a wire whose delay and lag are known, in fine steps of time; actuators and open wires are refused."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from truestroke.cli import main
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.runtime.commissioning import AnswerError, loop_back
from truestroke.runtime.commissioning.loop_back import _check_ratio
from truestroke.runtime.drivers import OneAxis, SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import config
from truestroke.signals.timing import Timing

FINE = 200  # steps of time in a tick


class Wire:
    """Dead time and a first-order lag between output and input; a measurement is the mean over its tick."""

    def __init__(self, rate=2000.0, delay=0.0, corner=0.0, gain=5.0, noise=0.01):
        self.rate, self.corner, self.gain, self.noise = rate, corner, gain, noise
        self.late = round(delay * rate * FINE)

    def open(self):
        self.past, self.state, self.random = np.zeros(self.late), np.zeros(1), np.random.default_rng(1)
        return Timing(sample_rate=self.rate)

    def exchange(self, volts):
        fine = np.concatenate([self.past, np.repeat(volts, FINE)])
        now, self.past = np.split(fine, [volts.size * FINE])
        if self.corner:  # the bilinear transform: no delay of its own
            c = math.pi * self.corner / self.rate / FINE
            now, self.state = lfilter([c / (1 + c)] * 2, [1, (c - 1) / (c + 1)], now, zi=self.state)
        self.truth = self.gain * now.reshape(-1, FINE).mean(axis=1)
        return self.truth + self.noise * self.random.standard_normal(volts.size)


class Instant(SimulatedDriver):
    """Nobody waits for it."""

    def _pass_time(self, period, slips):
        pass


def axis(of, safe=0.0, **timing):
    settings = SimulatedSettings(**{"hardware_timed": True, "block": 20, "latency": 40, **timing})
    return OneAxis(Instant(settings, [of]), voltage_limits=(-0.6, 3.6), slew=400.0, safe_voltage=safe)


@pytest.mark.parametrize(
    "wire",
    [
        {},
        {"delay": 2.6e-4},
        {"corner": 300.0},
        {"delay": 1.3e-3, "corner": 150.0},
        {"delay": 1e-4, "corner": 800.0, "noise": 0.03},
        {"delay": 8e-3, "gain": -0.5, "noise": 0.0005},
    ],
)
def test_delay_and_lag_of_a_wire_are_found_within_their_uncertainty(wire):
    found = loop_back(axis(Wire(**wire)))
    assert abs(found.delay - wire.get("delay", 0.0)) < 4 * found.delay_uncertainty + 1e-7
    assert found.delay_uncertainty < 0.01 / 2000.0
    assert found.gain == pytest.approx(wire.get("gain", 5.0), rel=0.01)
    assert bool(found.bandwidth) == ("corner" in wire)
    if "corner" in wire:
        assert abs(found.bandwidth - wire["corner"]) < 4 * found.bandwidth_uncertainty
        assert found.bandwidth_uncertainty < 0.03 * wire["corner"]
    assert found.settings["sensor_delay"] == pytest.approx(max(found.delay, 0.0), rel=1e-3)


def test_the_excitation_is_small_and_ends_at_the_safe_voltage():
    of = axis(Wire(), safe=3.6)  # no way up
    with pytest.raises(AnswerError):
        loop_back(axis(Wire(gain=0.0)))
    assert loop_back(of).gain == pytest.approx(5.0, rel=0.01)
    assert of.driver.output[0] == 3.6


@pytest.mark.parametrize(
    ("of", "words"),
    [
        (Wire(gain=0.0), "the input does not show the output"),
        (RealisticPlant(), "no loop-back: .* of hysteresis or creep"),
        (RealisticPlant(PlantSettings(resonance=120.0, hysteresis=0.01, creep=0.0)), "explained by no delay and lag"),
        (RealisticPlant(PlantSettings(resonance=500.0, hysteresis=0.01, creep=0.0)), "explained by no delay and lag"),
    ],
)
def test_what_is_no_wire_is_refused(of, words):
    with pytest.raises(AnswerError, match=words):
        loop_back(axis(of))


def test_voltages_far_apart_are_refused_where_the_driver_knows_them():
    _check_ratio(5.0, (10.0,))
    _check_ratio(5.0, None)
    for gain in (0.1, 80.0):
        with pytest.raises(AnswerError, match="V for a volt at the output"):
            _check_ratio(gain, 10.0)


def test_the_command_prints_settings_and_refuses_an_actuator(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("stage.toml").write_text(config.example().replace("seed = 0 ", "hardware_timed = true\n#"))
    call = ("commission", "--config", "stage.toml", "--loop-back", "--yes")
    monkeypatch.setattr(SimulatedDriver, "_pass_time", Instant._pass_time)
    before = Path("stage.toml").read_text()
    done = CliRunner().invoke(main, [*call])
    assert done.exit_code == 3
    assert "no loop-back" in done.output
    monkeypatch.setattr(SimulatedSettings, "plants", lambda self: [Wire(delay=2.6e-4)])
    done = CliRunner().invoke(main, [*call])
    assert done.exit_code == 0, done.output
    assert "settings = { sensor_delay = 0.00026" in done.output
    found = json.loads(CliRunner().invoke(main, [*call, "--json"]).stdout)
    assert found["settings"]["sensor_delay"] == pytest.approx(2.6e-4, rel=0.01)
    assert Path("stage.toml").read_text() == before
