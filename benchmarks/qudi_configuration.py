"""qudi itself, without its windows, with a configuration of its user: python -m benchmarks.qudi_configuration

Needs the extra `qudi` in an environment of its own (docs/qudi.md), 2 GB. It writes qudi.cfg with the three lines of the
page, and a simulated card with two stacks as modules of an extension; the application reads the file, activates the
scanner with what it is connected to, and scans 40 x 10 pixels. Prints how far pixels are off, um.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from truestroke import dropins, identify, plant, save_model

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")  # before Qt starts
FS = 2000.0
FAKES = Path(__file__).parents[1] / "tests" / "fakes"
CARD = """
import sys
sys.path.insert(0, {fakes!r})
import qudi_scanner as simulated
from qudi.core.configoption import ConfigOption

shared = simulated.Stacks()


class Card(simulated.Card):
    stacks = ConfigOption(name="stacks", default=None, constructor=lambda _: shared)


class Outputs(simulated.Outputs):
    stacks = ConfigOption(name="stacks", default=None, constructor=lambda _: shared)
"""
CONFIGURATION = """
global:
    startup_modules: []
    extension_paths: ['{modules}', '{card}']
gui: {{}}
logic: {{}}
hardware:
    card:
        module.Class: 'simulated_card.Card'
    outputs:
        module.Class: 'simulated_card.Outputs'
        options:
            setpoint_channels:
                ao0: {{unit: 'V', limits: [0, 3], dtype: float}}
                ao1: {{unit: 'V', limits: [0, 3], dtype: float}}
    ni_scanning_probe:
        module.Class: 'interfuse.truestroke_interfuse.InversePiezoInterfuse'
        connect:
            scan_hardware: card
            analog_output: outputs
        options:
            models: {{x: '{model}', y: '{model}'}}
            ni_channel_mapping: {{x: 'ao0', y: 'ao1', X: 'ai0', Y: 'ai1'}}
            position_ranges: {{x: [0, 20.0e-6], y: [0, 20.0e-6]}}
            frequency_ranges: {{x: [1, 5000], y: [1, 5000]}}
            resolution_ranges: {{x: [1, 10000], y: [1, 10000]}}
            input_channel_units: {{X: 'um', Y: 'um'}}
            maximum_move_velocity: 2.0e-3
"""


def written(folder: Path) -> Path:
    """The files of the user, in a folder."""
    time = np.arange(6000) / FS
    volts = 1.5 - 1.5 * np.cos(2 * np.pi * 1.5 * time) * np.cos(0.55 * time)
    stack = plant.RealisticPlant(plant.PlantSettings(noise=0.0))
    stack.open()
    record = (volts, stack.exchange(volts), FS)
    model = identify(record, rate=False, creep_times=(0.03, 0.3, 3.0), asymmetry=2, delay=0.0).model
    save_model(folder / "x.toml", model)
    (folder / "qudi" / "hardware").mkdir(parents=True)
    (folder / "qudi" / "hardware" / "simulated_card.py").write_text(CARD.format(fakes=str(FAKES)))
    modules = Path(dropins.__file__).with_name("qudi_modules")
    text = CONFIGURATION.format(modules=modules, card=folder, model=folder / "x.toml")
    (folder / "qudi.cfg").write_text(text)
    return folder / "qudi.cfg"


def main() -> None:
    folder = Path(tempfile.mkdtemp())
    os.environ["HOME"] = str(folder)  # qudi writes its log and its state there
    file = written(folder)
    sys.path.insert(0, str(FAKES))
    import qudi_scanner as simulated  # with Qt
    from PySide6 import QtCore, QtWidgets
    from qudi.core.application import Qudi

    events = QtWidgets.QApplication(sys.argv)  # qudi takes it; a timer needs it before
    application = Qudi(no_gui=True, log_dir=str(folder), config_file=str(file))

    def scan() -> None:
        failed = 1
        try:
            application.module_manager.activate_module("ni_scanning_probe")
            scanner = application.module_manager["ni_scanning_probe"].instance
            scanner.move_absolute({"x": 10e-6, "y": 10e-6})
            simulated.wait(events, lambda: simulated.arrived(scanner.get_position(), {"x": 10e-6, "y": 10e-6}))
            scanner.configure_scan(simulated.settings(40, 10))
            scanner.start_scan()
            simulated.wait(events, lambda: not scanner.is_scan_running)
            x, y = simulated.off(scanner.get_scan_data())
            print(
                f"{type(scanner).__name__}: pixels are off by at most {x:.2f} um in x and {y:.2f} um in y", flush=True
            )
            failed = int(max(x, y) > 0.4)
        finally:
            os._exit(failed)  # at once: threads of Qt end in their own way

    QtCore.QTimer.singleShot(100, scan)
    application.run()


if __name__ == "__main__":
    main()
