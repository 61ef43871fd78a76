"""The server of the live page: its files, a stream of frames, and what a person may ask of the run.

A request that changes something needs the token of control and, from a browser, the page's own origin. Whatever is
refused is counted and said on the page.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import math
import os
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib import resources
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from truestroke.base import system
from truestroke.base.flags import BIT
from truestroke.runtime.realtime.live_page import frames
from truestroke.runtime.realtime.live_page.settings import LiveSettings
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import Helper, Shared, Slot, State, Text

REFRESH = 0.05  # s between two frames
LAST_WORDS = 0.5  # s for the page to show the end
READERS = 32  # pages at once
LONGEST = 1024  # bytes of a request
SILENCE = 5.0  # s for which a request may be incomplete
FILES = {
    "/": ("runtime/realtime/live_page/page.html", "text/html"),
    "/live.js": ("runtime/realtime/live_page/live.js", "text/javascript"),
    "/live.css": ("runtime/realtime/live_page/live.css", "text/css"),
    "/uplot.js": ("report/uplot/uPlot.iife.min.js", "text/javascript"),
    "/uplot.css": ("report/uplot/uPlot.min.css", "text/css"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

Handler = Callable[[Request], Awaitable[Response]]


class RefusedError(Exception):
    """A request that is not answered; the status of HTTP and a sentence."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


class LivePage:
    """What the routes answer, of one run."""

    def __init__(
        self, settings: LiveSettings, shared: Shared, axes: list[Panel], sample_rate: float, origins: set[str]
    ) -> None:
        self._settings, self._shared, self._axes, self._rate = settings, shared, axes, sample_rate
        self._origins, self._hosts = origins, {origin.partition("://")[2] for origin in origins}
        self._line, self._number, self._settled, self._readers = b"", 0, 0, 0
        self._fresh = asyncio.Event()
        self._files = {path: (_read(file), kind) for path, (file, kind) in FILES.items()}
        routes = [Route(path, self._guarded(self._file)) for path in FILES]
        routes += [
            Route("/stream", self._guarded(self._stream)),
            Route("/do", self._guarded(self._do), methods=["POST"]),
        ]
        self.app = Starlette(routes=routes)

    # ---- Frames ------------------------------------------------------------------------------------------------------

    def look(self) -> None:
        """Make the frame of now; what the loop had written at the look before has settled."""
        made = frames.frame(self._shared, self._axes, self._rate, self._settings.window, self._settled)
        self._line, self._number = frames.encoded(made), self._number + 1
        self._settled = self._shared.count[Slot.WRITTEN]
        self._fresh.set()
        self._fresh = asyncio.Event()

    async def _frames(self, control: bool) -> AsyncIterator[bytes]:
        """One line at once, then one a frame; a reader that is slow misses frames."""
        self._readers += 1
        try:
            yield frames.encoded(frames.about(self._axes, list(BIT)) | {"control": control})
            while True:
                yield self._line
                await self._fresh.wait()
        finally:
            self._readers -= 1

    # ---- Routes ------------------------------------------------------------------------------------------------------

    def _guarded(self, handler: Handler) -> Handler:
        """The same route; what it refuses is counted."""

        async def guarded(request: Request) -> Response:
            try:
                if request.headers.get("host") not in self._hosts:
                    raise RefusedError(421, "this page has another address")
                response = await handler(request)
            except RefusedError as refused:
                self._shared.count[Slot.REFUSED] += 1
                response = JSONResponse({"error": str(refused)}, refused.status)
            except ClientDisconnect:
                response = Response(status_code=400)
            response.headers.update(HEADERS)
            return response

        return guarded

    async def _file(self, request: Request) -> Response:
        content, kind = self._files[request.url.path]
        return Response(content, media_type=kind)

    async def _stream(self, request: Request) -> Response:
        control = self._has(request, self._settings.control)
        if not control and not self._has(request, self._settings.reading):
            raise RefusedError(401, "the address of the page has no token, or that of an earlier run")
        if self._readers >= READERS:
            raise RefusedError(503, f"{READERS} pages are open already")
        return StreamingResponse(self._frames(control), media_type="application/x-ndjson")

    async def _do(self, request: Request) -> Response:
        if request.headers.get("origin", next(iter(self._origins))) not in self._origins:
            raise RefusedError(403, "the request comes from another page")
        if not self._has(request, self._settings.control):
            raise RefusedError(403, "this address may look, not change anything")
        self._act(_checked(await _body(request)))
        return JSONResponse({"done": True})

    def _has(self, request: Request, token: str) -> bool:
        given = request.headers.get("authorization", "").removeprefix("Bearer ")
        return hmac.compare_digest(given.encode(), token.encode())

    def _act(self, asked: dict[str, Any]) -> None:
        """STOP, hold, resume, or the set-point or speed of an axis."""
        count, targets = self._shared.count, self._shared.targets
        match asked:
            case {"do": "stop"}:
                count[Slot.STOP] = 1
            case {"do": "hold" | "resume" as do}:
                count[Slot.HOLD] = int(do == "hold")
            case {"do": "setpoint", "axis": int(channel), "um": float(um) | int(um)}:
                panel = self._moved(channel)
                _within("the set-point", um, *panel.reach, "um")
                targets[channel] = um
            case {"do": "speed", "axis": int(channel), "um_per_s": float(speed) | int(speed)}:
                panel = self._moved(channel)
                _within("the speed", speed, panel.speed * 1e-4, panel.speed, "um/s")
                targets[len(self._axes) + channel] = speed
            case _:
                raise RefusedError(400, "that cannot be done; there are stop, hold, resume, setpoint, speed")

    def _moved(self, channel: int) -> Panel:
        if not 0 <= channel < len(self._axes) or not self._axes[channel].moved:
            raise RefusedError(400, f"axis {channel} has no set-point: its motion is in the configuration")
        return self._axes[channel]


def _within(what: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:  # nor a whole number that no float can hold
        raise RefusedError(400, f"{what} = {value} {unit}: must be {low:g} to {high:g} {unit}")


async def _body(request: Request) -> bytes:
    """What was sent, while it is short and comes soon."""
    content = b""
    try:
        async with asyncio.timeout(SILENCE):
            async for part in request.stream():
                content += part
                if len(content) > LONGEST:
                    raise RefusedError(413, f"a request has at most {LONGEST} bytes")
    except TimeoutError:
        raise RefusedError(408, f"the request was not complete after {SILENCE:g} s") from None
    return content


def _checked(content: bytes) -> dict[str, Any]:
    try:
        asked = json.loads(content)
    except (ValueError, RecursionError):
        raise RefusedError(400, "that is no JSON") from None
    if not isinstance(asked, dict):
        raise RefusedError(400, "that is no object of JSON")
    return asked


def _read(path: str) -> bytes:
    return resources.files("truestroke").joinpath(path).read_bytes()


# ---- The process ---------------------------------------------------------------------------------------------------


def serve(settings: LiveSettings, lifeline: Lifeline, shared: Shared, axes: list[Panel], sample_rate: float) -> None:
    """Serve until the run has ended, or its process is gone."""
    system.allow_many_files()
    try:
        bound = settings.bound()
        port = bound.getsockname()[1]
        names = {settings.interface, "127.0.0.1", "localhost"}
        origins = {f"http://{f'[{name}]' if ':' in name else name}:{port}" for name in names}
        asyncio.run(_run(settings, lifeline, shared, axes, sample_rate, bound, origins))
    except BaseException as error:
        shared.write(Text.SERVER, f"{type(error).__name__}: {error}")
        shared.count[Slot.SERVER] = Helper.FAILED
        os._exit(1)
    os._exit(0)


async def _run(
    settings: LiveSettings,
    lifeline: Lifeline,
    shared: Shared,
    axes: list[Panel],
    sample_rate: float,
    bound: Any,
    origins: set[str],
) -> None:
    page = LivePage(settings, shared, axes, sample_rate, origins)
    quiet: dict[str, Any] = {"log_config": None, "access_log": False, "server_header": False, "lifespan": "off"}
    server = uvicorn.Server(uvicorn.Config(page.app, http="h11", ws="none", timeout_keep_alive=5, **quiet))
    serving = asyncio.create_task(server.serve(sockets=[bound]))
    while not server.started and not serving.done():
        await asyncio.sleep(0.01)
    _print_addresses(settings, bound.getsockname()[1])
    shared.count[Slot.SERVER] = Helper.READY
    ended = math.inf
    while time.monotonic() < ended:
        page.look()
        if ended == math.inf and (shared.count[Slot.STATE] == State.ENDED or lifeline.gone(0.0)):
            ended = time.monotonic() + LAST_WORDS
        await asyncio.sleep(REFRESH)


def _print_addresses(settings: LiveSettings, port: int) -> None:
    host = "127.0.0.1" if settings.interface in {"0.0.0.0", "::"} else settings.interface
    place = f"http://{f'[{host}]' if ':' in host else host}:{port}"
    sys.stderr.write(f"live page  {place}/#{settings.control}\nto look at {place}/#{settings.reading}\n")
    sys.stderr.flush()
