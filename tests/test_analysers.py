"""docs/misra.md: cppcheck with its MISRA addon and clang's analyser find what is listed in the kernel, and no more."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DEBIAN = "apt-get install cppcheck clang"


def test_the_kernel_has_no_finding_that_is_not_listed() -> None:
    """What `make analyse` has read since it changed is not read again."""
    if not (shutil.which("cppcheck") and shutil.which("clang")):
        assert not os.environ.get("CI"), f"CI needs the analysers: {DEBIAN}"
        pytest.skip(f"no cppcheck or clang here; Debian: {DEBIAN}")
    version = subprocess.run(["cppcheck", "--version"], capture_output=True, text=True, check=True).stdout.split()[-1]
    if f"cppcheck {version} " not in (ROOT / "docs/misra.md").read_text():
        pytest.skip(f"cppcheck {version} may find other things than that of docs/misra.md")
    command = ["make", "-s", "-C", str(ROOT / "c"), "analyse", "REALS=double"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
