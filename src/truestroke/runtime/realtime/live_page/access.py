"""Who may look at a run, who may change it, and what is said to all others."""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from enum import IntEnum
from ipaddress import ip_address

from truestroke.runtime.realtime.live_page.settings import LiveSettings

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Connection": "close",  # each request comes through the door
}


class Refusal(IntEnum):
    """Why a request is refused; each kind has a counter of its own."""

    TOKEN, ORIGIN, HOST, PLACE, MALFORMED, VALUE, LONG, SLOW, MANY = range(9)


STATUS = (403, 403, 421, 404, 400, 400, 413, 408, 503)
"""Of HTTP, by kind."""

WORDS = (
    *("without a token that allows it", "from another page", "for another address", "for what is not here"),
    *("malformed", "of what cannot be done", "too long", "incomplete", "too many"),
)
"""Requests that were refused, by kind."""


class RefusedError(Exception):
    """A request that is not followed: its kind, and a sentence for who asked."""

    def __init__(self, kind: Refusal, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind


class Access:
    """What a request needs, of the page of one run at this port."""

    def __init__(self, settings: LiveSettings, port: int) -> None:
        self._settings, self._port = settings, port
        self._names = settings.names()

    def address(self, name: str) -> str:
        """Of the page, where the computer has that name."""
        return f"http://{f'[{name}]' if ':' in name else name}:{self._port}"

    def check_host(self, headers: Mapping[str, str]) -> None:
        """A name that a stranger's server has given to this computer is none of the page's."""
        name, _, port = headers.get("host", "").rpartition(":")
        name = name.strip("[]")
        if port != str(self._port) or not (name in self._names or (self._settings.everywhere and _is_number(name))):
            raise RefusedError(Refusal.HOST, "this page has another address")

    def check_change(self, headers: Mapping[str, str]) -> None:
        """Of a request that changes something: from the page itself, or from a program, and with the token."""
        here = f"http://{headers.get('host')}"
        if headers.get("origin", here) != here:
            raise RefusedError(Refusal.ORIGIN, "the request comes from another page")
        if not _has(headers, self._settings.control):
            raise RefusedError(Refusal.TOKEN, "this address may look, not change anything")

    def controls(self, headers: Mapping[str, str]) -> bool:
        """Of a request to look: whether it might also change something."""
        control = _has(headers, self._settings.control)
        if not control and not _has(headers, self._settings.reading):
            raise RefusedError(Refusal.TOKEN, "the address of the page has no token, or that of an earlier run")
        return control


def _has(headers: Mapping[str, str], token: str) -> bool:
    given = headers.get("authorization", "").removeprefix("Bearer ")
    return hmac.compare_digest(given.encode(), token.encode())


def _is_number(name: str) -> bool:
    """Whether it is an address in numbers, which no stranger's server can give."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
