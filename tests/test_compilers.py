"""The kernel on every compiler: C99 and nothing beyond it, for computers that nobody here has (docs/platforms.md)."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

C = Path(__file__).parents[1] / "c"
STRICT = ["-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Wshadow", "-Wstrict-prototypes", "-Werror"]
FOLDERS = [f"-I{C / folder}" for folder in ("include", "dispatch", "loops", "plant")]
SOURCES = [
    "dispatch/variant.c",
    "dispatch/dispatch.c",
    "loops/loops.c",
    "plant/plant.c",
    "plant/stage.c",
    "plant/axes.c",
]
TARGETS = ["x86_64-windows-gnu", "aarch64-macos", "aarch64-linux-musl"]  # `make zig` has x86_64-macos, too
FORMATS = {"windows": b"\x64\x86", "macos": b"\xcf\xfa\xed\xfe", "linux": b"\x7fELF"}
MINGW = "apt-get install gcc-mingw-w64-x86-64 wine64"


def program(*names: str) -> str:
    """A program of Debian; without it the test skips, and fails in CI."""
    for name in names:
        if found := shutil.which(name) or shutil.which(name, path="/usr/lib/wine"):
            return found
    assert not os.environ.get("CI"), f"CI needs {names[0]}: {MINGW}"
    pytest.skip(f"{names[0]} is not installed: {MINGW}")


def run(*command: str | Path, **more: str) -> str:
    environment = {**os.environ, **more}
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("target", TARGETS)
def test_it_builds_for(target: str, tmp_path: Path) -> None:
    """By clang, as zig from PyPI contains it with the headers of each system."""
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", target, *STRICT, "-DTS_REAL=double", *FOLDERS]
    for source in SOURCES:
        made = tmp_path / Path(source).with_suffix(".o").name
        run(*zig, "-DTS_VARIANT=vector", "-c", C / source, "-o", made)
        assert made.read_bytes().startswith(FORMATS[target.split("-")[1]])


def test_it_builds_without_what_only_gcc_has(tmp_path: Path) -> None:
    """As for a compiler that does not say that it is like gcc, such as that of Microsoft."""
    headers = "".join(f"#include <{name}.h>\n" for name in ("math", "stdbool", "stddef", "stdint", "string"))
    for source in ("dispatch/variant.c", "dispatch/dispatch.c"):
        (tmp_path / "one.c").write_text(f'{headers}#undef __GNUC__\n#include "{C / source}"\n')
        defined = ["-DTS_REAL=float", "-DTS_VARIANT=vector", "-DTS_X86"]
        run(program("gcc"), *STRICT, *defined, *FOLDERS, "-c", tmp_path / "one.c", "-o", tmp_path / "one.o")


def test_the_tests_of_the_kernel_pass_on_windows(tmp_path: Path) -> None:
    """Cross-compiled by mingw-w64, run under wine: its vectors are of high precision. `make zig` shares its folders."""
    gcc, wine = program("x86_64-w64-mingw32-gcc"), program("wine64", "wine64-stable", "wine")
    quiet = {"WINEPREFIX": str(C / "build/wine"), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml=d"}
    (C / "build").mkdir(exist_ok=True)
    try:
        made, sources = tmp_path / "kernel.exe", [C / "tests/test_kernel.c", *sorted((C / "src").glob("*.c"))]
        options = [*STRICT, "-O1", "-ffp-contract=off", "-DTS_REAL=double", *FOLDERS]
        run(gcc, *options, *sources, "-lm", "-static", "-o", made)
        said = run(wine, made, **quiet)
        assert "kernel (double): " in said
        assert ", 0 failed" in said
    finally:
        server = Path(wine).with_name("wineserver64")
        if server.exists():
            subprocess.run([server, "-k"], env={**os.environ, **quiet}, check=False)
