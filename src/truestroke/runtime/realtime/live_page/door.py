"""The door of the live page: what changes the run is done here at once; who wants to look is sent on to the pages.

The pages have a process of their own. However many look, and however slowly they read, STOP does not wait for them.
"""

from __future__ import annotations

import http
import json
import math
import os
import selectors
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

import h11

from truestroke.base import system
from truestroke.runtime.realtime import process
from truestroke.runtime.realtime.live_page.access import HEADERS, STATUS, WORDS, Access, Refusal, RefusedError
from truestroke.runtime.realtime.live_page.orders import Orders
from truestroke.runtime.realtime.live_page.relay import PATIENCE, Relays
from truestroke.runtime.realtime.live_page.settings import LiveSettings
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import Helper, Shared, Slot, State, Text

GLANCE = 0.05  # s between two looks at the run
LAST_WORDS = 0.5  # s for the page to show the end
LONGEST = 1024  # bytes of what is asked
SILENCE = 5.0  # s for which a request may be incomplete
MOST = min(2000, system.SELECTED // 2)  # connections that have not said what they want, or wait for the pages
LOOKING = min(1000, system.SELECTED // 8)  # connections to the pages
BACKLOG = 4096  # connections that the system keeps for us
AGAIN = 1.0  # s after which pages that have died are started again
PAUSE = 0.25  # s before a refusal is answered: who asks again and again waits, and what is allowed does not
LINGER = 1.0  # s for which the rest of a request that was refused is read, so that the answer arrives
CHUNK = 65536  # bytes
SENT_ON = 20  # connections in a glance: who asks without end takes no more of the computer than that
CHANGE = b"POST "  # what a request that changes something begins with


class Visitor:
    """A connection, until it is sent on or closed."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection, self.until = connection, time.monotonic() + SILENCE
        self.said, self.body, self.answered = b"", b"", False
        self.http: h11.Connection | None = None  # of one that wants to change something
        self.refused: RefusedError | None = None  # it is answered after a pause

    def answer(self, status: int, content: dict[str, object]) -> None:
        """The one answer; the connection closes when the other side has, or a little later."""
        body = json.dumps(content).encode()
        headers = {**HEADERS, "Content-Type": "application/json", "Content-Length": str(len(body))}
        lines = [f"HTTP/1.1 {status} {http.HTTPStatus(status).phrase}", *(f"{k}: {v}" for k, v in headers.items())]
        self.answered, self.until = True, time.monotonic() + LINGER
        with suppress(OSError):
            self.connection.send("\r\n".join([*lines, "", ""]).encode() + body)
            self.connection.shutdown(socket.SHUT_WR)


class Door:
    """Takes the connections of the socket `bound`; `start` starts the process of the pages."""

    def __init__(
        self,
        access: Access,
        orders: Orders,
        shared: Shared,
        bound: socket.socket,
        start: Callable[[], subprocess.Popen[bytes]],
    ) -> None:
        self._access, self._orders, self._shared, self._count = access, orders, shared, shared.count
        self._visitors: dict[socket.socket, Visitor] = {}
        self._waiting: deque[Visitor] = deque()
        self._selector = selectors.DefaultSelector()
        self._relays = Relays(self._selector)
        self._start, self._pages, self._started = start, None, -math.inf
        self._sent_on, self._since = 0, -math.inf
        bound.listen(BACKLOG)
        bound.setblocking(False)
        self._selector.register(bound, selectors.EVENT_READ, self._let_in)

    _pages: subprocess.Popen[bytes] | None

    def look(self) -> None:
        """Serve for a glance."""
        self._tend_pages()
        for key, _ in self._selector.select(GLANCE):
            key.data(key.fileobj)
        self._send_on()
        self._relays.give_up()
        now = time.monotonic()
        for visitor in [one for one in self._visitors.values() if one.until < now]:
            self._time_is_up(visitor)

    # ---- The pages ---------------------------------------------------------------------------------------------------

    def _tend_pages(self) -> None:
        """Start them, and again where they have ended; the page is ready when they say their port."""
        if self._pages and self._pages.poll() is not None:
            self._pages = None
            if self._count[Slot.SERVER] != Helper.READY:
                raise RuntimeError(self._shared.read(Text.SERVER) or "its pages did not start")
        if self._pages is None and time.monotonic() - self._started > AGAIN:
            self._count[Slot.PAGES] = 0
            self._pages, self._started = self._start(), time.monotonic()
        if self._count[Slot.PAGES]:
            self._count[Slot.SERVER] = Helper.READY

    def _send_on(self) -> None:
        if (now := time.monotonic()) - self._since > GLANCE:
            self._sent_on, self._since = 0, now
        port = self._count[Slot.PAGES] if self._pages else 0
        while self._waiting and port and self._sent_on < SENT_ON and len(self._relays) < LOOKING:
            visitor = self._waiting.popleft()
            del self._visitors[visitor.connection]
            self._sent_on += 1
            try:
                self._relays.begin(visitor.connection, visitor.said, port)
            except OSError:  # no more descriptors
                visitor.connection.close()

    # ---- Connections -------------------------------------------------------------------------------------------------

    def _let_in(self, bound: socket.socket) -> None:
        for _ in range(BACKLOG):
            try:
                connection, _ = bound.accept()
            except BlockingIOError:
                return
            except OSError:  # no more descriptors
                if not self._visitors:
                    return
                self._close(next(iter(self._visitors.values())))
                continue
            if len(self._visitors) >= MOST:
                self._close(next(iter(self._visitors.values())))
            connection.setblocking(False)
            self._visitors[connection] = Visitor(connection)
            self._selector.register(connection, selectors.EVENT_READ, self._listen)

    def _close(self, visitor: Visitor) -> None:
        if self._visitors.pop(visitor.connection, None):
            with suppress(KeyError):
                self._selector.unregister(visitor.connection)
            with suppress(ValueError):
                self._waiting.remove(visitor)
            visitor.connection.close()

    def _time_is_up(self, visitor: Visitor) -> None:
        if visitor.answered or not visitor.said or visitor in self._waiting:
            self._close(visitor)
        elif error := visitor.refused:
            visitor.answer(STATUS[error.kind], {"error": str(error)})
        else:
            self._refuse(visitor, RefusedError(Refusal.SLOW, f"the request was not complete after {SILENCE:g} s"))

    def _refuse(self, visitor: Visitor, error: RefusedError) -> None:
        self._count[Slot.REFUSED + error.kind] += 1
        visitor.refused, visitor.until = error, time.monotonic() + PAUSE

    def _listen(self, connection: socket.socket) -> None:
        """To what a connection says next."""
        visitor = self._visitors.get(connection)
        if visitor is None:  # closed for another that came in the same glance
            return
        try:
            said = connection.recv(CHUNK)
        except BlockingIOError:
            return
        except OSError:
            said = b""
        if not said and visitor.refused and not visitor.answered:
            self._selector.unregister(connection)  # it has said all, and waits for the answer
        elif not said:
            self._close(visitor)
        elif not (visitor.answered or visitor.refused):
            self._understand(visitor, said)

    def _understand(self, visitor: Visitor, said: bytes) -> None:
        if visitor.http is None:
            visitor.said += said
            if visitor.said.startswith(CHANGE):
                visitor.http, said = h11.Connection(h11.SERVER), visitor.said
            elif not CHANGE.startswith(visitor.said):
                self._selector.unregister(visitor.connection)
                visitor.until = time.monotonic() + PATIENCE
                self._waiting.append(visitor)
                return
            else:
                return
        try:
            if self._read(visitor, visitor.http, said):
                self._orders.follow(visitor.body)
                visitor.answer(200, {"done": True})
        except h11.RemoteProtocolError:
            self._refuse(visitor, RefusedError(Refusal.MALFORMED, "that is no request of HTTP"))
        except RefusedError as error:
            self._refuse(visitor, error)

    def _read(self, visitor: Visitor, speaker: h11.Connection, said: bytes) -> bool:
        """Whether the request is complete; an error as soon as it is one that will not be followed."""
        speaker.receive_data(said)
        while True:
            event = speaker.next_event()
            if isinstance(event, h11.Request):
                self._check(event)
            elif isinstance(event, h11.Data):
                visitor.body += event.data
                _check_length(len(visitor.body))
            else:
                return isinstance(event, h11.EndOfMessage)

    def _check(self, request: h11.Request) -> None:
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in request.headers}
        self._access.check_host(headers)
        if request.target != b"/do":
            raise RefusedError(Refusal.PLACE, "there is nothing that can be changed")
        self._access.check_change(headers)
        _check_length(int(headers.get("content-length", 0)))


def _check_length(length: int) -> None:
    if length > LONGEST:
        raise RefusedError(Refusal.LONG, f"a request has at most {LONGEST} bytes")


# ---- The process ---------------------------------------------------------------------------------------------------


def serve(settings: LiveSettings, lifeline: Lifeline, shared: Shared, axes: list[Panel], sample_rate: float) -> None:
    """Serve until the run has ended, or its process is gone."""
    system.allow_many_files()
    started: list[subprocess.Popen[bytes]] = []
    try:
        bound = settings.bound()
        access = Access(settings, bound.getsockname()[1])

        def pages() -> subprocess.Popen[bytes]:
            started.append(process.start(shared, settings.show, access, axes, sample_rate))
            return started[-1]

        _run(Door(access, Orders(shared, axes, sample_rate), shared, bound, pages), lifeline, shared, settings, access)
    except BaseException as error:
        shared.write(Text.SERVER, f"{type(error).__name__}: {error}")
        shared.count[Slot.SERVER] = Helper.FAILED
        _end(started, 1)
    _end(started, 0)


def _end(started: list[subprocess.Popen[bytes]], code: int) -> NoReturn:
    """Nothing stays, not even pages that stand still."""
    for one in started:
        one.kill()
    os._exit(code)


def _run(door: Door, lifeline: Lifeline, shared: Shared, settings: LiveSettings, access: Access) -> None:
    while shared.count[Slot.SERVER] != Helper.READY:
        door.look()
    others = settings.names()[0]
    here = "127.0.0.1" if settings.everywhere else others
    _say(f"live page  {access.address(here)}/#{settings.control}")
    _say(f"to look at {access.address(others)}/#{settings.reading}")
    ended = math.inf
    while time.monotonic() < ended:
        door.look()
        if ended == math.inf and (shared.count[Slot.STATE] == State.ENDED or lifeline.gone(0.0)):
            ended = time.monotonic() + LAST_WORDS
    refused = shared.refused(len(WORDS))
    if total := sum(refused):
        parts = ", ".join(f"{number} {words}" for number, words in zip(refused, WORDS, strict=True) if number)
        _say(f"live page  refused {total} requests: {parts}")


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
