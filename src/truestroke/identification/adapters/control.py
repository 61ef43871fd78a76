"""Actuators as input/output systems of python-control: voltage in, displacement out (extra `control`)."""

from typing import Any

import control
import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import actuator
from truestroke.control.actuator import ActuatorModel
from truestroke.model.operators import play
from truestroke.model.sampled import lag_coefficients
from truestroke.signals.timing import Timing


def model_system(model: ActuatorModel, sample_rate: float, name: str = "model") -> control.NonlinearIOSystem:
    """An identified model as a discrete-time system, for `control.input_output_response` and `control.interconnect`.

    Its states are the plays, V, the creep states, V, the voltages within the delay, V, and the displacement of the
    sample before, without its rate-dependent part, um. From states of zero the actuator comes from rest at 0 V. The
    velocity is that since the sample before, where `ActuatorModel.predict` takes the one around each sample.

    Parameters
    ----------
    model : ActuatorModel
        Of `identify` or `load_model`.
    sample_rate : float
        Samples per second, Hz; `dt` of the system is its inverse.
    name : str
        Of the system; its input is `volts`, its output `z`.

    Examples
    --------
    >>> model = ActuatorModel(
    ...     thresholds=(0.0, 0.5), weights=[8.0, 2.0, 0.0, 0.0], covariance=np.eye(4), stroke=20.0,
    ...     voltage_range=(0.0, 2.0),
    ... )
    >>> time = np.arange(5) / 1000.0
    >>> found = control.input_output_response(model_system(model, 1000.0), time, [0.0, 1.0, 2.0, 1.0, 0.0])
    >>> np.asarray(found.outputs)
    array([ 0.,  9., 19., 11.,  1.])
    """
    checks.instance("model", model, ActuatorModel, actuator.EXPECTED)
    if model.branches is not None:
        raise SettingError("model", "one with branches", "one of plays alone: model.plain")
    if model.dynamics is not None:
        words = "None: model.replace(dynamics=None), in series with model.dynamics.to_control()"
        raise SettingError("model.dynamics", f"{len(model.dynamics.modes)} modes", words)
    fs = checks.positive("sample_rate", sample_rate, "Hz")
    step = _Step(model, fs)
    named = {"inputs": ["volts"], "outputs": ["z"], "states": step.states, "name": name}
    return control.NonlinearIOSystem(
        lambda t, x, u, params: step(x, u[0])[0], lambda t, x, u, params: step(x, u[0])[1], dt=1 / fs, **named
    )


class _Step:
    """One sample of a model: (states, voltage) -> (next states, displacement)."""

    def __init__(self, model: ActuatorModel, sample_rate: float) -> None:
        self.model, self.fs = model, sample_rate
        self.plays, self.creeps = len(model.thresholds), len(model.creep_times)
        self.late, self.part = divmod(round(model.delay * sample_rate, 9), 1.0)
        self.late = int(self.late)
        self.shares = -np.expm1(-1 / (np.array(model.creep_times) * sample_rate))
        self.thresholds = np.array(model.thresholds)
        self.w = model.weights
        self.a, self.b = model.of_all_plays(self.w)
        self.states = [
            *(f"play[{i}]" for i in range(self.plays)),
            *(f"creep[{i}]" for i in range(self.creeps)),
            *(f"volts[-{i}]" for i in range(self.late, 0, -1)),
            "z[-1]",
            "before lag[-1]",
            "behind lag[-1]",
        ]
        self.lag = lag_coefficients(model.time_constant * sample_rate)
        self.rest = self._displacement(np.zeros(self.plays), np.zeros(self.creeps), 0.0)

    def __call__(self, states: FloatArray, volts: float) -> tuple[FloatArray, float]:
        p, c, held, before = np.split(states, np.cumsum([self.plays, self.creeps, self.late]))
        previous, was, behind = before
        line = np.append(held, volts)
        x = line[0]
        p = play(x, self.thresholds, p)
        still = self._displacement(p, c, 0.0)
        moved = self._displacement(p, c, (still - previous) * self.fs) - self.rest
        last, first, kept = self.lag
        lagged = last * moved + first * was + kept * behind
        z = self.model.zero + self.rest + (1 - self.part) * lagged + self.part * behind
        return np.concatenate([p, c + self.shares * (x - c), line[1:], [still, moved, lagged]]), z

    def _displacement(self, p: FloatArray, c: FloatArray, velocity: float) -> float:
        plays = p @ (self.a + self.model.rate_scale * velocity * self.b)
        made = actuator.displacement(self.model, self.w, np.array([plays]), c[:, None], np.array([velocity]))
        return float(made[0])


def actuator_system(driven: Any, name: str = "actuator") -> control.NonlinearIOSystem:
    """An actuator of the loop, such as a simulated plant, as a discrete-time system.

    Its state and output is the displacement that came in at the end of the sample before, um: a measurement is there
    when its tick is over. A simulation opens the actuator at t = 0 and goes from tick to tick.

    Parameters
    ----------
    driven : Actuator
        With `open()` and `exchange(volts)`, such as `plant.RealisticPlant`, in blocks of one tick without latency.
    name : str
        Of the system; its input is `volts`, its output `z`.

    Examples
    --------
    >>> from truestroke.plant import RealisticPlant
    >>> plant = actuator_system(RealisticPlant())
    >>> found = control.input_output_response(plant, np.arange(2000) / 2000.0, np.full(2000, 1.0))
    >>> print(f"{found.outputs[1]:.2f} um after the first tick, {found.outputs[-1]:.1f} um after a second")
    4.02 um after the first tick, 12.2 um after a second
    """
    checks.able("driven", driven, ("open", "exchange"), "an actuator, such as a plant.RealisticPlant")
    timing = checks.instance("driven.open()", driven.open(), Timing, "a Timing(sample_rate=...)")
    checks.count("block of the actuator", timing.block, 1, 1)
    checks.count("latency of the actuator", timing.latency, 0, 0)
    next_tick = 0

    def update(t: float, x: FloatArray, u: FloatArray, params: object) -> FloatArray:
        nonlocal next_tick
        tick = round(t * timing.sample_rate)
        if tick == 0:
            driven.open()
        elif tick != next_tick:
            bound = f"{next_tick / timing.sample_rate:g} s: an actuator continues from tick to tick"
            raise SettingError("t", t, bound, "s")
        next_tick = tick + 1
        return np.asarray(driven.exchange(np.array([u[0]])))

    named = {"inputs": ["volts"], "outputs": ["z"], "states": ["z"], "name": name}
    return control.NonlinearIOSystem(update, lambda t, x, u, params: x, dt=1 / timing.sample_rate, **named)
