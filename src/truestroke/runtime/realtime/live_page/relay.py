"""Connections of those who want to look: what they and the pages say to each other passes through the door.

A side is read only when the other one has taken what it said before: who reads slowly fills no memory here, and the
pages, which then wait for him, leave out frames. All of it is TCP, which each system has.
"""

from __future__ import annotations

import math
import selectors
import socket
import time
from contextlib import suppress

CHUNK = 65536  # bytes
BUFFER = 65536  # bytes that the system keeps between the pages and us: about a second of frames
UNREAD = 10.0  # s after which a connection that takes nothing is given up, as of a laptop that was closed
SILENCE = 5.0  # s in which a visitor says all of a request
PATIENCE = 60.0  # s in which the pages answer it: they give way to the loop, on a computer that others use too
COMPLETE = b"\r\n\r\n"  # ends a request


class _Side:
    """One end: `pending` are bytes for it, `since` when it last took some."""

    other: _Side

    def __init__(self, connection: socket.socket, pending: bytes = b"") -> None:
        self.connection, self.pending, self.since = connection, pending, time.monotonic()
        self.begun, self.ended, self.spoke = self.since, False, False
        self.asked: bytes | None = None  # the end of what a visitor has said, who is the one that asks

    @property
    def wanted(self) -> int:
        """Events that it waits for."""
        reads = selectors.EVENT_READ if not (self.ended or self.other.pending) else 0
        return reads | (selectors.EVENT_WRITE if self.pending else 0)


class Relays:
    """All of them; their events go through `selector`, whose data are called with the connection."""

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._selector, self._sides = selector, dict[socket.socket, _Side]()

    def __len__(self) -> int:
        return len(self._sides) // 2

    def begin(self, visitor: socket.socket, said: bytes, port: int) -> None:
        """Connect a visitor, of whom this was read, with the pages at a port of this computer."""
        pages = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        pages.setblocking(False)
        pages.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        pages.connect_ex(("127.0.0.1", port))
        one, other = _Side(visitor), _Side(pages, said)
        one.other, other.other, one.asked = other, one, said
        for side in (one, other):
            self._sides[side.connection] = side
            self._selector.register(side.connection, selectors.EVENT_WRITE, self._pass)
            self._wait(side)

    def give_up(self) -> None:
        """Close those whose visitor takes nothing or does not say what he wants, and those that have no answer."""
        now = time.monotonic()
        for side in list(self._sides.values()):
            waits = math.inf
            if side.asked is not None and not side.other.spoke:
                waits = PATIENCE if COMPLETE in side.asked else SILENCE
            if now - side.begun > waits or (side.pending and now - side.since > UNREAD):
                self._close(side)

    def _pass(self, connection: socket.socket) -> None:
        side = self._sides.get(connection)
        if side is None:  # closed with the other side in the same glance
            return
        try:
            self._take(side)
            self._give(side)
            self._give(side.other)
        except OSError:
            self._close(side)
            return
        if any(one.ended and not one.other.pending for one in (side, side.other)):
            self._close(side)
            return
        self._wait(side)
        self._wait(side.other)

    def _take(self, side: _Side) -> None:
        """Read what a side says, if the other one has taken all before."""
        if side.ended or side.other.pending:
            return
        with suppress(BlockingIOError):
            said = side.connection.recv(CHUNK)
            side.ended, side.other.pending = not said, said
            if said:
                side.spoke, side.other.since = True, time.monotonic()
            if side.asked is not None and COMPLETE not in side.asked:
                side.asked = side.asked[1 - len(COMPLETE) :] + said

    def _give(self, side: _Side) -> None:
        """Write as much as a side takes."""
        if side.pending:
            with suppress(BlockingIOError):
                side.pending = side.pending[side.connection.send(side.pending) :]
                side.since = time.monotonic()

    def _wait(self, side: _Side) -> None:
        """For the events that it wants, of which there may be none."""
        known = side.connection in self._selector.get_map()
        if side.wanted and known:
            self._selector.modify(side.connection, side.wanted, self._pass)
        elif side.wanted:
            self._selector.register(side.connection, side.wanted, self._pass)
        elif known:
            self._selector.unregister(side.connection)

    def _close(self, side: _Side) -> None:
        for one in (side, side.other):
            if self._sides.pop(one.connection, None):
                with suppress(KeyError):
                    self._selector.unregister(one.connection)
                one.connection.close()
