"""The pages of a run: its files, and a stream of frames. A process of its own, which can change nothing.

The door connects those who want to look with it.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib import resources

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from truestroke.base import system
from truestroke.base.flags import BIT
from truestroke.runtime.realtime.live_page import frames
from truestroke.runtime.realtime.live_page.access import HEADERS, STATUS, Access, Refusal, RefusedError
from truestroke.runtime.realtime.live_page.relay import BUFFER
from truestroke.runtime.realtime.live_page.settings import LiveSettings
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import Shared, Slot, Text

REFRESH = 0.05  # s between two frames
READERS = 32  # pages at once
FEWER = 10  # steps of priority below the loop, which looks at a computer that others use too
FILES = {
    "/": ("runtime/realtime/live_page/page.html", "text/html"),
    "/live.js": ("runtime/realtime/live_page/live.js", "text/javascript"),
    "/live.css": ("runtime/realtime/live_page/live.css", "text/css"),
    "/uplot.js": ("report/uplot/uPlot.iife.min.js", "text/javascript"),
    "/uplot.css": ("report/uplot/uPlot.min.css", "text/css"),
}

Handler = Callable[[Request], Awaitable[Response]]
Refused = Callable[[Refusal], None]


class LivePage:
    """What the routes answer, of one run."""

    def __init__(
        self,
        settings: LiveSettings,
        access: Access,
        shared: Shared,
        axes: list[Panel],
        sample_rate: float,
        refused: Refused,
    ) -> None:
        self._settings, self._access, self._shared, self._axes = settings, access, shared, axes
        self._rate, self._refused = sample_rate, refused
        self._line, self._settled, self._readers = b"", 0, 0
        self._fresh = asyncio.Event()
        self._files = {path: (_read(file), kind) for path, (file, kind) in FILES.items()}
        routes = [Route(path, self._guarded(self._file)) for path in FILES]
        routes.append(Route("/stream", self._guarded(self._stream)))
        self.app = Starlette(routes=routes, exception_handlers={HTTPException: self._elsewhere})

    # ---- Frames ------------------------------------------------------------------------------------------------------

    def look(self) -> None:
        """Make the frame of now, if anybody looks; what the loop had written at the look before has settled."""
        if self._readers:
            made = frames.frame(self._shared, self._axes, self._rate, self._settings.window, self._settled)
            self._line = frames.encoded(made)
            self._fresh.set()
            self._fresh = asyncio.Event()
        self._settled = self._shared.count[Slot.WRITTEN]

    async def _frames(self, control: bool) -> AsyncIterator[bytes]:
        """One line at once, then one a frame; a reader that is slow misses frames."""
        self._readers += 1
        try:
            yield frames.encoded(frames.about(self._axes, list(BIT)) | {"control": control})
            while True:
                await self._fresh.wait()
                yield self._line
        finally:
            self._readers -= 1

    # ---- Routes ------------------------------------------------------------------------------------------------------

    def _guarded(self, handler: Handler) -> Handler:
        """The same route; what it refuses is counted."""

        async def guarded(request: Request) -> Response:
            try:
                self._access.check_host(request.headers)
                response = await handler(request)
            except RefusedError as error:
                response = self._refusal(error)
            response.headers.update(HEADERS)
            return response

        return guarded

    def _refusal(self, error: RefusedError) -> Response:
        self._refused(error.kind)
        return JSONResponse({"error": str(error)}, STATUS[error.kind], headers=HEADERS)

    async def _elsewhere(self, request: Request, error: Exception) -> Response:
        return self._refusal(RefusedError(Refusal.PLACE, "there is no such page"))

    async def _file(self, request: Request) -> Response:
        content, kind = self._files[request.url.path]
        return Response(content, media_type=kind)

    async def _stream(self, request: Request) -> Response:
        control = self._access.controls(request.headers)
        if self._readers >= READERS:
            raise RefusedError(Refusal.MANY, f"{READERS} pages are open already")
        return StreamingResponse(self._frames(control), media_type="application/x-ndjson")


def _read(path: str) -> bytes:
    return resources.files("truestroke").joinpath(path).read_bytes()


# ---- The process ---------------------------------------------------------------------------------------------------


def serve(
    lifeline: Lifeline, shared: Shared, settings: LiveSettings, access: Access, axes: list[Panel], sample_rate: float
) -> None:
    """Answer the connections that come from the door, until it has ended."""
    system.yield_to_others(FEWER)
    system.allow_many_files()

    def refused(kind: Refusal) -> None:
        shared.count[Slot.REFUSED_THERE + kind] += 1

    try:
        page = LivePage(settings, access, shared, axes, sample_rate, refused)
        with socket.create_server(("127.0.0.1", 0)) as bound:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
            asyncio.run(_run(lifeline, shared, bound, page, refused))
    except BaseException as error:
        shared.write(Text.SERVER, f"{type(error).__name__}: {error}")
        os._exit(1)
    os._exit(0)


async def _run(lifeline: Lifeline, shared: Shared, bound: socket.socket, page: LivePage, refused: Refused) -> None:
    config = Config(page.app, http="h11", ws="none", lifespan="off", log_config=None, access_log=False)
    config.load()
    state, loop = ServerState(), asyncio.get_running_loop()
    await loop.create_server(lambda: _Spoken(config, state, refused), sock=bound)
    shared.count[Slot.PAGES] = bound.getsockname()[1]
    while not lifeline.gone(0.0):
        page.look()
        await asyncio.sleep(REFRESH)


class _Spoken(H11Protocol):
    """A connection; what is no request of HTTP is counted."""

    def __init__(self, config: Config, state: ServerState, refused: Refused) -> None:
        super().__init__(config, state, {})
        self._refused = refused

    def send_400_response(self, msg: str) -> None:
        self._refused(Refusal.MALFORMED)
        super().send_400_response(msg)
