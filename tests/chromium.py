"""Debian's Chromium, as tests of pages use it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

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


class Browser:
    """A page that stays open, told what to do over Chromium's pipe of its DevTools."""

    def __init__(self, address: str) -> None:
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        ours, theirs = os.pipe(), os.pipe()  # what it reads at 3, what it writes at 4
        script = f'exec "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        options = [*QUIET.split(), f"--user-data-dir={self._profile.name}", "--remote-debugging-pipe"]
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", script, "bash", found(), *options],
            pass_fds=(ours[0], theirs[1]),
            start_new_session=True,
            **quiet,
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._to, self._from, self._number, self._session = ours[1], os.fdopen(theirs[0], "rb"), 0, ""
        target = self._ask("Target.createTarget", url=address)["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        asked = {"id": self._number, "method": method, "params": parameters}
        os.write(self._to, json.dumps(asked | ({"sessionId": self._session} if self._session else {})).encode() + b"\0")
        while True:
            text = b""
            while (letter := self._from.read(1)) != b"\0":
                assert letter, "Chromium has ended"
                text += letter
            if (answer := json.loads(text)).get("id") == self._number:
                return dict(answer.get("result", {}))  # none where the page is about to change

    def evaluate(self, script: str) -> Any:
        """The value of an expression in the page."""
        return self._ask("Runtime.evaluate", expression=script, returnByValue=True).get("result", {}).get("value")

    def wait_for(self, script: str) -> None:
        """Until an expression in the page is true."""
        until = time.monotonic() + 300.0
        while not self.evaluate(script):
            assert time.monotonic() < until, script
            time.sleep(0.05)

    def close(self) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)  # all of its processes
        self._process.wait()
        os.close(self._to)
        self._from.close()
        self._profile.cleanup()
