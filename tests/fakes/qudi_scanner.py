"""A card of two channels and two stacks in qudi, without its windows: scans, and what they saw, as JSON.

    python qudi_scanner.py FOLDER X.toml Y.toml

A process of its own: Qt allows one application in each.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
import weakref
from pathlib import Path
from typing import Any

import numpy as np

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")  # before Qt starts

import qudi.core.module
from PySide6 import QtCore, QtWidgets
from qudi.core.configoption import ConfigOption
from qudi.hardware.dummy.process_control_dummy import ProcessSetpointDummy
from qudi.hardware.interfuse.ni_scanning_probe_interfuse import NiScanningProbeInterfuse
from qudi.interface.finite_sampling_io_interface import FiniteSamplingIOConstraints, FiniteSamplingIOInterface
from qudi.interface.scanning_probe_interface import ScanSettings
from qudi.util.enums import SamplingOutputMode

from truestroke import plant
from truestroke.dropins import qudi as dropin

FS = 2000.0
LIMITS = (0.0, 3.0)
LENGTH = 20e-6  # m
AXES = {"x": "ao0", "y": "ao1"}


class Stacks:
    """What both modules of the card drive: a voltage in each channel moves a stack for so long."""

    def __init__(self) -> None:
        self.stacks = {channel: stack(i) for i, channel in enumerate(AXES.values())}

    def __deepcopy__(self, memo: Any) -> Stacks:
        return self  # qudi copies its configuration

    def output(self, channel: str, volts: np.ndarray, rate: float) -> np.ndarray:
        """True positions, um, at the end of each sample."""
        ticks = max(1, round(FS / rate))
        self.stacks[channel].exchange(np.repeat(volts, ticks))
        return self.stacks[channel].truth[ticks - 1 :: ticks].copy()


def stack(seed: int) -> plant.RealisticPlant:
    made = plant.RealisticPlant(plant.PlantSettings(noise=0.0), seed=seed)
    made.open()
    return made


class Card(FiniteSamplingIOInterface):
    """Frames at once; each input is the true position of the stack of its number, um."""

    stacks: Stacks = ConfigOption(name="stacks")
    stop_after: int = ConfigOption(name="stop_after", default=10**9)

    def on_activate(self) -> None:
        names = list(AXES.values())
        self._constraints = FiniteSamplingIOConstraints(
            supported_output_modes=frozenset(SamplingOutputMode),
            input_channel_units={"ai0": "um", "ai1": "um"},
            output_channel_units=dict.fromkeys(names, "V"),
            frame_size_limits=(1, 10**9),
            sample_rate_limits=(1, 1e6),
            output_channel_limits=dict.fromkeys(names, LIMITS),
            input_channel_limits={"ai0": (-100, 100), "ai1": (-100, 100)},
        )
        self.rate, self.frame, self.running, self.read = 1.0, {}, False, 0

    def on_deactivate(self) -> None:
        pass

    constraints = property(lambda self: self._constraints)
    sample_rate = property(lambda self: self.rate)
    is_running = property(lambda self: self.running)
    samples_in_buffer = property(lambda self: len(self.taken["ai0"]) - self.read if self.running else 0)
    active_channels = frame_size = output_mode = None

    def set_sample_rate(self, rate: float) -> None:
        self.rate = rate

    def set_active_channels(self, input_channels: Any, output_channels: Any) -> None:
        pass

    def set_output_mode(self, mode: Any) -> None:
        pass

    def set_frame_data(self, data: dict[str, np.ndarray]) -> None:
        self.frame = {channel: np.array(volts) for channel, volts in data.items()}

    def start_buffered_frame(self) -> None:
        self.running, self.read = True, 0
        sent = {channel: volts[: self.stop_after] for channel, volts in self.frame.items()}
        moved = {channel: self.stacks.output(channel, volts, self.rate) for channel, volts in sent.items()}
        self.taken = {f"ai{i}": moved[channel] for i, channel in enumerate(AXES.values())}

    def stop_buffered_frame(self) -> None:
        self.running = False

    def get_buffered_samples(self, number_of_samples: int | None = None) -> dict[str, np.ndarray]:
        if number_of_samples is not None and number_of_samples > self.samples_in_buffer:
            raise ValueError("more samples than there are")
        first, self.read = self.read, len(self.taken["ai0"])
        return {name: samples[first:] for name, samples in self.taken.items()}

    def get_frame(self, data: Any) -> Any:
        raise NotImplementedError


class Outputs(ProcessSetpointDummy):
    """The same card, one value at a time; as one of NI, it repeats its last one when it is switched on."""

    stacks: Stacks = ConfigOption(name="stacks")

    def set_activity_state(self, channel: str, active: bool) -> None:
        if active and not self._activity_states[channel]:
            self.stacks.output(channel, np.array([self._setpoints[channel]]), FS)
        self._activity_states[channel] = active

    def set_setpoint(self, channel: str, value: float) -> None:
        super().set_setpoint(channel, value)
        self.stacks.output(channel, np.full(20, value), FS)


class Main:
    """What a module of qudi asks of the application."""

    configuration: dict[str, Any] = {"default_data_dir": None, "daily_data_dirs": True}  # noqa: RUF012


def with_a_slot(kind: type) -> type:
    """The same class with a slot that does nothing, to wait for the thread of a module."""

    class Waited(kind):
        @QtCore.Slot()
        def nothing(self) -> None:
            pass

    return Waited


def scanner(kind: type, folder: Path, card: dict[str, Any], **more: Any) -> Any:
    main, stacks = Main(), Stacks()
    qudi.core.module.get_module_app_data_path = lambda *names: str(folder / "-".join(names))
    reference = weakref.ref(main)
    channels = {channel: {"unit": "V", "limits": LIMITS, "dtype": float} for channel in AXES.values()}
    io = Card(qudi_main_weakref=reference, name="card", config={"stacks": stacks, **card})
    ao = Outputs(
        qudi_main_weakref=reference,
        name="outputs",
        config={"stacks": stacks, "setpoint_channels": channels},
    )
    options = {
        "ni_channel_mapping": {**AXES, "X": "ai0", "Y": "ai1"},
        "position_ranges": {axis: [0, LENGTH] for axis in AXES},
        "frequency_ranges": {axis: [1, 5000] for axis in AXES},
        "resolution_ranges": {axis: [1, 10000] for axis in AXES},
        "input_channel_units": {"X": "um", "Y": "um"},
        "maximum_move_velocity": 2e-3,
        **more,
    }
    made = with_a_slot(kind)(qudi_main_weakref=reference, name="scanner", config=options)
    made.connect_modules({"scan_hardware": io, "analog_output": ao})
    for module in (io, ao):
        module.module_state.activate()
    thread = QtCore.QThread()  # of its own, as qudi gives it
    made.moveToThread(thread)
    thread.start()
    QtCore.QMetaObject.invokeMethod(made.module_state, "activate", QtCore.Qt.ConnectionType.BlockingQueuedConnection)
    made.kept = main, io, ao, stacks, thread  # which qudi holds weakly
    return made


def wait(application: Any, ended: Any) -> None:
    until = time.monotonic() + 60.0
    while not ended():
        application.processEvents()
        time.sleep(2e-3)
        assert time.monotonic() < until, "it takes too long"


def settled(application: Any, made: Any) -> None:
    """Wait until the module has really ended its move.

    A scan that ends unlocks the module first, and then moves the cursor back; `is_move_running` is False until the
    first step of that move, and in its last step qudi gives up whatever target it got meanwhile. A move that is asked
    for in between is lost, with no error. So let the module's thread finish what it does, and wait for its last step.
    """
    QtCore.QMetaObject.invokeMethod(made, "nothing", QtCore.Qt.ConnectionType.BlockingQueuedConnection)
    wait(application, lambda: made._abort_cursor_move and not made.is_move_running)


def move(application: Any, made: Any, **position: float) -> None:
    made.move_absolute(position)
    settled(application, made)
    assert arrived(made.get_position(), position), f"{made.get_position()} in place of {position}"


def arrived(place: dict[str, float], position: dict[str, float]) -> bool:
    return all(abs(place[axis] - there) < 1.5e-9 for axis, there in position.items())


def settings(pixels: int, lines: int) -> ScanSettings:
    span, shape = (6e-6, 18e-6), (pixels, lines)
    return ScanSettings(channels=("X", "Y"), axes=("x", "y"), range=(span, span), resolution=shape, frequency=200.0)


def scan(application: Any, made: Any, pixels: int = 40, lines: int = 10) -> tuple[Any, Any]:
    """Images of an image that is the true position itself."""
    made.configure_scan(settings(pixels, lines))
    made.start_scan()
    wait(application, lambda: not made.is_scan_running)
    settled(application, made)
    return made.get_scan_data(), made.get_back_scan_data()


def off(data: Any) -> tuple[float, float]:
    """Largest distance of x and y from where the pixels should be, um, after the best straight line."""
    found = []
    for axis, channel in enumerate(("X", "Y")):
        there = data.data[channel]
        low, high = data.settings.range[axis]
        asked = np.linspace(low, high, there.shape[axis]) * 1e6
        asked = np.broadcast_to(asked[:, None] if axis == 0 else asked, there.shape)
        line = np.polyval(np.polyfit(asked.ravel(), there.ravel(), 1), asked)
        found.append(float(np.abs(there - line).max()))
    return found[0], found[1]


class Errors(logging.Handler):
    """What modules log in place of raising it."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.seen: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        cause = record.exc_info[1] if record.exc_info else None
        self.seen.append(str(cause or record.getMessage()))


def images(application: Any, made: Any) -> list[list[float]]:
    """Of two scans: how far off x and y are on the way there, and x on the way back, um."""
    move(application, made, x=10e-6, y=10e-6)
    found = []
    for _ in range(2):
        there, back = scan(application, made)
        found.append([*off(there), off(back)[0]])
    move(application, made, x=12e-6, y=8e-6)
    stacks = made.kept[3].stacks.values()
    return [*found, [abs(float(one.truth[-1]) - z) for one, z in zip(stacks, (12.0, 8.0), strict=True)]]


def cut_short(application: Any, made: Any) -> list[float]:
    """A scan that is stopped in its 300th sample, and how far off the next one is, um."""
    card = made.kept[1]
    move(application, made, x=10e-6, y=10e-6)
    made.configure_scan(settings(40, 10))
    card.stop_after = 300
    made.start_scan()
    wait(application, lambda: made.raw_data_container.number_of_non_nan_values == 300)
    made.stop_scan()
    card.stop_after = 10**9
    wait(application, lambda: not made.is_scan_running)
    settled(application, made)
    there, back = scan(application, made)
    return [*off(there), off(back)[0]]


def main() -> None:
    folder, x, y = Path(sys.argv[1]), *sys.argv[2:4]
    application = QtWidgets.QApplication([])
    errors = Errors()
    logging.getLogger().addHandler(errors)
    dropin.monotonic = lambda: 0.0  # at rest the stacks pass no time
    models = {"x": x, "y": y}
    slope = scanner(NiScanningProbeInterfuse, folder, {})
    inverse = scanner(dropin.InversePiezoInterfuse, folder, {}, models=models)
    stopped = scanner(dropin.InversePiezoInterfuse, folder, {}, models=models)
    found: dict[str, Any] = {
        "slope": images(application, slope),
        "inverse": images(application, inverse),
        "stopped": cut_short(application, stopped),
        "errors": list(errors.seen),
    }
    errors.seen.clear()
    long = {axis: [0, 90e-6] for axis in AXES}
    kept = [
        scanner(dropin.InversePiezoInterfuse, folder, {}, models=models, position_ranges=long),
        scanner(dropin.InversePiezoInterfuse, folder, {}, models={"w": x}),
        scanner(dropin.InversePiezoInterfuse, folder, {}, models={"x": str(folder / "none.toml")}),
    ]
    mapping = {**AXES, "x": "ao7"}
    kept.append(scanner(dropin.InversePiezoInterfuse, folder, {}, models={"x": x}, ni_channel_mapping=mapping))
    found["refused"] = list(errors.seen)
    errors.setLevel(logging.WARNING)
    found["heeded"] = {}
    for level in ("bad", "doubtful"):
        errors.seen.clear()
        kept.append(scanner(dropin.InversePiezoInterfuse, folder, {}, models={"x": str(folder / f"{level}.toml")}))
        found["heeded"][level] = [kept[-1].module_state(), *errors.seen]
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()
    os._exit(len(kept) - 6)  # at once: threads of Qt end in their own way


if __name__ == "__main__":
    main()
