"""Build what runs in a browser: `python web/build.py FOLDER` writes the module and its JavaScript there.

It needs the package `ziglang` (the extra `web`), which compiles C to WebAssembly on every system.
"""

from __future__ import annotations

import argparse
import base64
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import truestroke
from truestroke import AdaptiveController, trajectories
from truestroke.export import json_settings
from truestroke.export.json_settings import controller_members, plain, plant_members
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.plant.noise import Noise

HERE = Path(__file__).parent
ROOT = HERE.parent
STRUCTS = {"ts_settings": "c/include/truestroke.h", "ts_plant_settings": "c/plant/plant.h"}
SOURCES = ("web/module.c", "web/math.zig", "c/plant/plant.c")
C_FLAGS = ("-std=c11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")

NOTICE = """/*! truestroke, BSD-3-Clause, in LICENSE beside this file. The module has mathematical functions of
 * Zig's standard library, (c) Zig contributors, MIT, in LICENSE-zig. */
"""
STACK: dict[str, Any] = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}  # of the README


def _slider(
    label: str, unit: str, low: float, high: float, step: float, value: float, to: float | None
) -> dict[str, Any]:
    return {"label": label, "unit": unit, "low": low, "high": high, "step": step, "value": value, "to": to}


# By the members of ts_plant_settings that they set; `to`: of the slider's unit to the member's; None: no member.
SLIDERS = {
    "speed": _slider("Speed of the motion", "Hz", 0.5, 60, 0.5, 5, None),
    "hysteresis": _slider("Hysteresis", "%", 0, 60, 1, 33, 0.01),
    "amplifier_bandwidth": _slider("Rate: amplifier of", "Hz", 100, 900, 10, 500, 1),
    "creep": _slider("Creep in a decade of time", "%", 0, 5, 0.1, 1.5, 0.01),
    "resonance": _slider("Resonance", "Hz", 200, 950, 10, 900, 1),
    "noise": _slider("Noise of a sample", "nm", 0, 200, 5, 30, 0.001),
}


def compiler() -> Path:
    """The folder of the compiler."""
    found = importlib.util.find_spec("ziglang")
    if found is None or found.origin is None:
        sys.exit("web/build.py needs the compiler that the package ziglang brings: pip install ziglang")
    return Path(found.origin).parent


def module() -> bytes:
    """The kernel and the simulated stack as WebAssembly, without imports."""
    # The C library's headers, for declarations only: nothing of the library is linked.
    headers = (compiler() / "lib/libc/include" / name for name in ("wasm-wasi-musl", "generic-musl"))
    includes = [item for folder in headers for item in ("-isystem", str(folder))]
    sources = [str(ROOT / name) for name in SOURCES] + sorted(map(str, (ROOT / "c/src").glob("*.c")))
    parts = ROOT / "build/module"  # always the same: the compiler keeps what it has made of the same sources
    parts.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for struct, header in STRUCTS.items():
            script, written = ROOT / "src/bindings/members.py", Path(folder, f"{struct}.inc")
            subprocess.run([sys.executable, script, ROOT / header, struct, written], check=True)
            shutil.move(written, parts / written.name)
        made = Path(folder, "truestroke.wasm")
        command = [sys.executable, "-m", "ziglang", "build-exe", "-target", "wasm32-wasi", "-fno-entry", "-fstrip"]
        command += ["-O", "ReleaseFast", "--name", "truestroke", f"-femit-bin={made}", *includes, f"-I{parts}"]
        command += ["--cache-dir", str(parts)]
        command += [f"-I{ROOT / 'c/include'}", f"-I{ROOT / 'c/plant'}", "-cflags", *C_FLAGS, "--", *sources]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
        if done.returncode:
            sys.exit(done.stderr)
        return made.read_bytes()


def minimal(text: str) -> str:
    """A module of JavaScript as a part of one script: without its imports, exports and long comments."""
    text = re.sub(r"(?m)^import [^;]*;\n", "", text)
    return re.sub(r"(?m)^export ", "", re.sub(r"(?s)/\*\*.*?\*/\n", "", text))


def base64_of(numbers: Any) -> str:
    """Numbers as doubles of 8 bytes, the lowest first."""
    return base64.b64encode(np.asarray(numbers, dtype="<f8").tobytes()).decode()


def looped(controller: AdaptiveController, settings: PlantSettings, ticks: int, seed: int = 0) -> dict[str, Any]:
    """A run of the package: settings, motion, commands and measurements, noise; what `web/replay.js` runs again."""
    duration = ticks / settings.sample_rate
    wave = trajectories.random_wave(duration=duration, sample_rate=settings.sample_rate, ramp=min(0.25, duration / 4))
    recording = truestroke.run(wave, controller, RealisticPlant(settings, seed=seed))
    motion = [wave.position, wave.velocity, wave.acceleration, recording["volts"], recording["measured"]]
    return {
        "members": controller_members(controller.settings),
        "plant": plant_members(settings),
        "motion": base64_of(np.stack(motion, axis=1)),
        "noise": base64_of(Noise(seed).take(ticks * settings.samples_per_tick)),
    }


def playground_data() -> dict[str, Any]:
    """What the page needs of the package: settings of its controllers and of its stack, a recorded run."""
    adaptive, paper = AdaptiveController(**STACK), AdaptiveController.paper(**STACK)
    settings = PlantSettings()
    fields = ("sample_rate", "flags", "members")
    exports = {"truestroke": adaptive, "paper": paper}
    described = {name: json_settings.described(c.settings, None, 100, name, "") for name, c in exports.items()}
    return {
        "controllers": {name: {field: entry[field] for field in fields} for name, entry in described.items()},
        "plant": plant_members(settings),
        "sensitivity": settings.input_sensitivity,
        "thresholds": plain(adaptive.settings.thresholds),
        "sliders": SLIDERS,
        "run": looped(AdaptiveController(**STACK), settings, 800),
    }


def page(wasm: bytes) -> str:
    """The playground in one file."""
    folder = HERE / "playground"
    parts = [HERE / "truestroke.js", HERE / "replay.js"]
    parts += [folder / f"{name}.js" for name in ("motion", "simulation", "charts", "playground")]
    first = NOTICE + f'const TRUESTROKE_WASM = "{base64.b64encode(wasm).decode()}";\n'
    first += f"const PLAYGROUND_DATA = {json.dumps(playground_data(), separators=(',', ':'), allow_nan=False)};\n"
    script = first + "\n".join(minimal(part.read_text(encoding="utf-8")) for part in parts)
    text = (folder / "page.html").read_text(encoding="utf-8")
    return text.replace("{{ style }}", (folder / "style.css").read_text(encoding="utf-8")).replace(
        "{{ script }}", script
    )


def script(wasm: bytes) -> str:
    """`truestroke.js` with the module within it, so that it loads from a file without a server."""
    text = (HERE / "truestroke.js").read_text(encoding="utf-8")
    return f'{NOTICE}const TRUESTROKE_WASM = "{base64.b64encode(wasm).decode()}";\n{text}'


def write(folder: Path) -> None:
    """All files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    wasm = module()
    (folder / "truestroke.wasm").write_bytes(wasm)
    (folder / "truestroke.js").write_text(script(wasm), encoding="utf-8")
    (folder / "playground.html").write_text(page(wasm), encoding="utf-8")
    shutil.copy(HERE / "package.json", folder)
    shutil.copy(ROOT / "LICENSE", folder)
    shutil.copy(compiler() / "LICENSE", folder / "LICENSE-zig")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    write(parser.parse_args().folder)
