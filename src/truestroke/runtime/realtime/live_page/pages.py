"""The pages of a run: its files, and a stream of frames. A process of its own, which can change nothing.

The door sends it the connections of those who want to look. It reports what it refuses to the door, which counts.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from functools import partial
from importlib import resources
from typing import Any

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
from truestroke.runtime.realtime.live_page.settings import LiveSettings
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import Shared, Slot, Text

REFRESH = 0.05  # s between two frames
READERS = 32  # pages at once
FEWER = 10  # steps of priority below the loop, which looks at a computer that others use too
READY = b"\xff"  # to the door; other bytes are a Refusal
MOST = 65536  # bytes that the door has read already
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
    lifeline: Lifeline,
    shared: Shared,
    settings: LiveSettings,
    access: Access,
    axes: list[Panel],
    sample_rate: float,
    channel: int,
) -> None:
    """Answer the connections that come through `channel`, a descriptor, until the door has closed."""
    system.yield_to_others(FEWER)
    system.allow_many_files()
    try:
        with socket.socket(fileno=channel) as door:
            door.setblocking(False)
            asyncio.run(_run(lifeline, door, lambda say: LivePage(settings, access, shared, axes, sample_rate, say)))
    except BaseException as error:
        shared.write(Text.SERVER, f"{type(error).__name__}: {error}")
        os._exit(1)
    os._exit(0)


async def _run(lifeline: Lifeline, door: socket.socket, page_of: Callable[[Refused], LivePage]) -> None:
    def say(kind: Refusal) -> None:
        with suppress(BlockingIOError):  # a door with so much to do has counted enough
            door.send(bytes([kind]))

    page = page_of(say)
    config = Config(page.app, http="h11", ws="none", lifespan="off", log_config=None, access_log=False)
    config.load()
    state, loop, tasks = ServerState(), asyncio.get_running_loop(), set[asyncio.Task[Any]]()

    def come_in() -> None:
        """The connections that wait, with what they have said so far."""
        with suppress(BlockingIOError):
            while True:
                said, descriptors, _, _ = socket.recv_fds(door, MOST, 1)
                if not descriptors:
                    loop.remove_reader(door)  # the door has closed
                    return
                connection = socket.socket(fileno=descriptors[0])
                connection.setblocking(False)
                made = loop.connect_accepted_socket(partial(_Handed, config, state, said, say), connection)
                tasks.add(task := loop.create_task(made))
                task.add_done_callback(tasks.discard)

    loop.add_reader(door, come_in)
    door.send(READY)
    while not lifeline.gone(0.0):
        page.look()
        await asyncio.sleep(REFRESH)


class _Handed(H11Protocol):
    """A connection of which the door has read the beginning."""

    def __init__(self, config: Config, state: ServerState, said: bytes, refused: Refused) -> None:
        super().__init__(config, state, {})
        self._said, self._refused = said, refused

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.data_received(self._said)

    def send_400_response(self, msg: str) -> None:
        self._refused(Refusal.MALFORMED)
        super().send_400_response(msg)
