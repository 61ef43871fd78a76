"""Debian's Chromium, as tests of pages use it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

QUIET = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-sync"
)


def found() -> str:
    """Its path; the test is skipped where there is none, but not in CI."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        assert not os.environ.get("CI"), "CI needs Chromium: apt-get install chromium"
        pytest.skip("no Chromium here; Debian: apt-get install chromium")
    return path


def dom(page: Path, hash: str = "") -> str:
    """The document after its scripts have run, as HTML."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [found(), *QUIET.split(), f"--user-data-dir={profile}", "--virtual-time-budget=4000", "--dump-dom"]
        done = subprocess.run(
            [*command, f"{page.as_uri()}{hash}"], capture_output=True, text=True, timeout=600, check=True
        )
    return done.stdout
