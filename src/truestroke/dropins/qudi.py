"""A scanning probe of qudi whose voltages come from the inverse of the hysteresis, without a sensor (extra `qudi`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from time import monotonic
from typing import Any

import numpy as np

from truestroke.base.verdict import Verdict
from truestroke.dropins import needed
from truestroke.dropins.memory import Memory
from truestroke.identification import load_model

with needed("qudi-core and qudi-iqo-modules", "qudi"):
    from PySide6 import QtCore
    from qudi.core.configoption import ConfigOption
    from qudi.hardware.interfuse.ni_scanning_probe_interfuse import NiScanningProbeInterfuse
    from qudi.util.mutex import RecursiveMutex

UM = 1e6  # um in a metre
SAME = 1e-9  # V: what a voltage may differ by and be the one that was output
PATIENCE = (
    0.02  # of the length of an axis: how far a range may exceed the reach of slow motion, for hysteresis and creep
)


class _Axis:
    """An axis with a model: what its output has done, and which position that is for qudi, m."""

    def __init__(self, path: str, limits: tuple[float, float], low: float) -> None:
        model = load_model(path)
        self.memory, self.verdict, self._low = Memory(model, limits), model.verdict, low
        self._rests = self.memory.position
        self.position = low
        self._since = monotonic()

    def reach(self) -> float:
        """Length of the longest range, m."""
        return (self.memory.reach()[1] - self._rests) / UM

    def voltages(self, positions: Any, rate: float) -> Any:
        """For these positions, m, after what has been output."""
        self._age()
        return self.memory.voltages((np.atleast_1d(positions) - self._low) * UM + self._rests, rate)

    def step(self, position: float) -> float:
        """The voltage for a position of rest, m, which is output now."""
        volts = float(self.voltages(position, 1.0)[0])
        self.output([volts], 1e6, position)
        return volts

    def output(self, volts: Any, rate: float, position: float = math.nan) -> None:
        """These voltages, V, were output; they lead to this position, m, or where the model says."""
        self.memory.output(volts, rate)
        self._since = monotonic()
        reached = (self.memory.position - self._rests) / UM + self._low
        self.position = reached if math.isnan(position) else position

    def place(self, volts: float) -> float:
        """Position at the output of this voltage, m; another one than the last was output by somebody else."""
        if abs(volts - self.memory.volts) > SAME:
            self._age()
            self.output([volts], 1e6)
        return round(self.position, 10)

    def _age(self) -> None:
        now = monotonic()
        self.memory.hold(now - self._since)
        self._since = now


class InversePiezoInterfuse(NiScanningProbeInterfuse):  # type: ignore[misc]
    """`NiScanningProbeInterfuse` with the inverse of an identified model in place of one slope per axis.

    All options are those of that class. `models` names the axes with a model, and the file of each; the other axes keep
    their slope. It needs no sensor: it knows every voltage that was output, and so where the hysteresis is.

    Example config for copy-paste::

        ni_scanning_probe:
            module.Class: 'interfuse.truestroke_interfuse.InversePiezoInterfuse'
            options:
                models: {x: '/home/me/x.toml', y: '/home/me/y.toml'}
                # and everything of NiScanningProbeInterfuse

    Raises
    ------
    ValueError
        When it is activated: a model cannot be read or is bad, an axis is unknown or has no output of the card, or its
        range is longer than the
        model's reach.
    """

    _models: dict[str, str] = ConfigOption(name="models", missing="error")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._inverses: dict[str, _Axis] = {}
        self._inverse_lock = RecursiveMutex()
        self._frame: dict[str, Any] = {}
        self._running = False

    def on_activate(self) -> None:
        """Read the models, then as the class it replaces."""
        if unknown := sorted(set(self._models) - set(self._position_ranges)):
            known = ", ".join(self._position_ranges)
            raise ValueError(f"models: no axis {', '.join(unknown)}; position_ranges has {known}")
        limits = self._ni_finite_sampling_io().constraints.output_channel_limits
        for name, path in self._models.items():
            low, high = self._position_ranges[name]
            axis = _Axis(path, limits[self._output(name, limits)], low)
            self._heed(name, path, axis.verdict)
            if high - low > axis.reach() * (1 + PATIENCE):
                bounds = " to ".join(f"{volts:.3g}" for volts in axis.memory.limits)
                raise ValueError(
                    f"position_ranges of {name}: {UM * (high - low):.4g} um from end to end, but its model reaches "
                    f"{UM * axis.reach():.4g} um with {bounds} V"
                )
            self._inverses[name] = axis
        super().on_activate()

    def _output(self, name: str, limits: Mapping[str, object]) -> str:
        """The output of the card that moves an axis; an error where the card has no such one."""
        channel = self._ni_channel_mapping.get(name)
        if channel not in limits:
            given = "missing" if channel is None else repr(channel)
            raise ValueError(
                f"ni_channel_mapping of {name} = {given}: must be an output of the card: {', '.join(limits)}"
            )
        return str(channel)

    def _heed(self, name: str, path: str, verdict: Verdict) -> None:
        """An error for a bad model, a warning in the log for a doubtful one."""
        if verdict.is_bad:
            why = " ".join(verdict.reasons[:1])
            raise ValueError(f"models: {name}: {path} is bad: {why} Record again, and identify a better one")
        if verdict.reasons:
            self.log.warning(f"models: {name}: {path} is doubtful: {' '.join(verdict.reasons)}")

    def _position_to_voltage(self, axis: str, positions: Any) -> Any:
        inverse = self._inverses.get(axis)
        if inverse is None:
            return super()._position_to_voltage(axis, positions)
        with self._inverse_lock:
            if np.ndim(positions) == 0:
                return inverse.step(float(positions))  # of the cursor, output at once
            return inverse.voltages(positions, self._ni_finite_sampling_io().sample_rate)

    def _voltage_dict_to_position_dict(self, voltages: dict[str, float]) -> dict[str, Any]:
        found: dict[str, Any] = super()._voltage_dict_to_position_dict(voltages)
        with self._inverse_lock:
            for name, inverse in self._inverses.items():
                channel = self._ni_channel_mapping[name]
                if channel in voltages:
                    found[name] = inverse.place(voltages[channel])
        return found

    def _start_hw_timed_scan(self) -> None:
        """The frame is made now, from where the cursor has arrived."""
        self._frame = self._init_ni_scan_arrays(self.scan_settings, self.back_scan_settings)
        self._ni_finite_sampling_io().set_frame_data(self._frame)
        self._running = True
        super()._start_hw_timed_scan()

    @QtCore.Slot()
    def _start_scan(self) -> None:
        super()._start_scan()

    @QtCore.Slot()
    def _stop_scan(self) -> None:
        """What of the frame was output is remembered, before the cursor moves again."""
        if self._running:
            self._running = False
            card = self._ni_finite_sampling_io()
            done = int(self.raw_data_container.number_of_non_nan_values) + int(card.samples_in_buffer)
            with self._inverse_lock:
                for name, inverse in self._inverses.items():
                    inverse.output(self._frame[self._ni_channel_mapping[name]][:done], card.sample_rate)
        super()._stop_scan()
