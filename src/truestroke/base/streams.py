"""Standard streams that may be closed, full or without a reader: they do not change what a command does."""

import io
import os
import sys
from typing import Any


class _Forgiving(io.FileIO):
    """A descriptor whose first error is kept; later output is dropped."""

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        """As much as arrives; all of it once nothing does."""
        if self.error is None:
            try:
                return super().write(data) or 0
            except OSError as error:
                self.error = error
        return memoryview(data).nbytes


def secure() -> None:
    """Make the standard streams of this process forgiving; a second time, and under a test's capture, do nothing.

    A stream that was closed when the process began leads to nowhere from now on: else the next file that is opened
    would take its number, and get what is meant for a terminal.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            nowhere = os.open(os.devnull, os.O_RDWR)  # the lowest free number: this one
            os.set_inheritable(nowhere, True)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (as long as the process)
        elif stream is getattr(sys, f"__{name}__"):
            setattr(sys, name, _forgiving(stream))


def _forgiving(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    stream.flush()
    raw = _Forgiving(stream.fileno(), "w", closefd=False)
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, stream.encoding, stream.errors, line_buffering=stream.line_buffering, write_through=False
    )


def error(name: str) -> OSError | None:
    """Why what went to "stdout" or "stderr" did not arrive, if it did not."""
    stream = getattr(sys, name)
    if stream is None:
        return None
    stream.flush()
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    return raw.error if isinstance(raw, _Forgiving) else None
