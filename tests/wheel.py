"""Builds the wheel and uses it as a stranger would, on every supported Python that this machine has.

Run by `make test`. With numpy alone beside it: `import truestroke` and a short loop. On the Python that runs this
script also with all dependencies: the command itself.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent


def run(*command: str | Path, **options) -> None:
    subprocess.run([str(c) for c in command], check=True, stdin=subprocess.DEVNULL, **options)


def pythons() -> dict[str, str]:
    """Version -> executable: this one, and others on the PATH or of pyenv that start."""
    found = {f"{sys.version_info.major}.{sys.version_info.minor}": sys.executable}
    for version in ("3.11", "3.12", "3.13"):
        candidates = [shutil.which(f"python{version}")]
        candidates += [str(p) for p in (Path.home() / ".pyenv/versions").glob(f"{version}.*/bin/python")]
        for candidate in filter(None, candidates):
            works = subprocess.run([candidate, "-c", "import venv, ensurepip"], capture_output=True).returncode == 0
            if works and version not in found:
                found[version] = candidate
    return found


def pip(python: str | Path, *words: str | Path) -> None:
    """This environment's pip for another one: to install it in each takes longer than what it does there."""
    run(sys.executable, "-m", "pip", "--python", python, *words)


def build(python: str | Path, into: Path, *options: str) -> Path:
    """The wheel that pip builds from a clean copy of what git would give."""
    pip(python, "wheel", "--quiet", "--no-deps", *options, "--wheel-dir", into, ROOT)
    return next(into.glob("*.whl"))


def install(python: Path, *what: str | Path) -> None:
    pip(python, "install", "--quiet", "--no-compile", *what)


def audit(wheel: Path) -> None:
    """One that says abi3 uses nothing of Python beyond it, and any one links the C library alone."""
    if "abi3" in wheel.name:
        run(sys.executable, "-m", "abi3audit", "--strict", "--summary", wheel)
    shown = subprocess.run([sys.executable, "-m", "auditwheel", "show", str(wheel)], capture_output=True, check=True)
    assert b"manylinux" in shown.stdout, shown.stdout.decode()


def main() -> None:
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # pip starts itself several times
    with tempfile.TemporaryDirectory() as folder:
        wheels: dict[str, Path] = {}
        for version, python in sorted(pythons().items()):
            tag = "cp311" if version == "3.11" else "abi3"
            venv = Path(folder) / version
            run(python, "-m", "venv", "--without-pip", venv)
            binary = venv / ("Scripts" if os.name == "nt" else "bin")
            if tag not in wheels:
                if python == sys.executable:  # `make setup` has compiled all of it
                    wheels[tag] = build(python, Path(folder) / tag, "--no-build-isolation")
                else:
                    wheels[tag] = build(binary / "python", Path(folder) / tag)
                if sys.platform == "linux":
                    audit(wheels[tag])
            install(binary / "python", "--no-deps", "numpy", wheels[tag])
            run(binary / "python", "-W", "error", ROOT / "tests/smoke.py", cwd=folder)
            if python == sys.executable:
                install(binary / "python", wheels[tag])
                run(binary / "truestroke", "track", "--duration", "2", "--output", Path(folder) / "run", cwd=folder)


if __name__ == "__main__":
    main()
