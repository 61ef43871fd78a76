"""Where the live page is, and for whom."""

from __future__ import annotations

import importlib.util
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from truestroke.base import checks, system
from truestroke.base.checks import SettingError
from truestroke.runtime.realtime.process import Lifeline, RealtimeError
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.settings import Axis
from truestroke.runtime.realtime.shared import Shared

LEAST = 16  # characters of a token


def _token() -> str:
    return secrets.token_urlsafe(18)


@dataclass(frozen=True, kw_only=True)
class LiveSettings:
    """The live page of a run.

    Attributes
    ----------
    port : int
        Where it is served, 1024 to 65535; 0 for any that is free.
    interface : str
        Address of this computer that answers. "127.0.0.1" is known to this computer alone; with "0.0.0.0" everybody in
        the network can read the tokens on their way, for the page is not encrypted.
    window : float
        How much of the run the page shows, s.
    control, reading : str
        Tokens: who has the first can change the run, who has the second can look. By default others in each run.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """

    port: int = 8765
    interface: str = "127.0.0.1"
    window: float = 2.0
    control: str = field(default_factory=_token, repr=False)
    reading: str = field(default_factory=_token, repr=False)

    def __post_init__(self) -> None:
        if self.port != 0:
            checks.count("port", self.port, 1024, 65535)
        checks.within("window", self.window, 0.01, 4.0, "s")
        for name in ("control", "reading"):
            if len(getattr(self, name)) < LEAST:
                raise SettingError(name, "a token", f"of at least {LEAST} characters")
        if self.control == self.reading:
            raise SettingError("reading", "a token", "another one than that of control")

    def check(self, axes: Sequence[Axis]) -> None:
        """Before anything moves: RealtimeError without starlette and uvicorn, or where the page cannot be served."""
        if not system.HAS_PROCESSES:
            raise RealtimeError(
                f"{system.NAME} starts no process beside this one, so the live page cannot be served: use Linux, "
                "Windows or macOS, or truestroke report, whose page can be read into everywhere"
            )
        if any(importlib.util.find_spec(name) is None for name in ("starlette", "uvicorn")):
            raise RealtimeError(
                'the live page needs the packages starlette and uvicorn: pip install "truestroke[live]"'
            )
        self.bound().close()

    def bound(self) -> socket.socket:
        """A socket at that address; RealtimeError where it cannot be had."""
        made = socket.socket(socket.AF_INET6 if ":" in self.interface else socket.AF_INET, socket.SOCK_STREAM)
        if not system.SHARES_PORTS:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((self.interface, self.port))
        except OSError as error:
            made.close()
            raise RealtimeError(
                f"the live page cannot be served at {self.interface}, port {self.port} ({error.strerror or error}): "
                "another run may use it; choose another `port` in the table [live], or 0 for any that is free"
            ) from None
        return made

    @property
    def everywhere(self) -> bool:
        """Whether each network of the computer can reach the page."""
        return self.interface in {"0.0.0.0", "::"}

    def names(self) -> list[str]:
        """What the computer is called in the address of the page; the first one is for others."""
        others = [socket.gethostname(), f"{socket.gethostname()}.local"] if self.everywhere else [self.interface]
        return [*others, "127.0.0.1", "localhost"]

    def serve(self, lifeline: Lifeline, shared: Shared, axes: list[Panel], sample_rate: float) -> None:
        """Serve the page until the run has ended, or its process is gone."""
        from truestroke.runtime.realtime.live_page import door  # with h11

        door.serve(self, lifeline, shared, axes, sample_rate)

    def show(self, lifeline: Lifeline, shared: Shared, *what: Any) -> None:
        """The process of the pages, which the one of `serve` starts."""
        from truestroke.runtime.realtime.live_page import pages  # with starlette and uvicorn

        pages.serve(lifeline, shared, self, *what)
