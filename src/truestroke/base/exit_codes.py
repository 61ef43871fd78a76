"""How every command ends: one table of exit codes, the same for all of them."""

from __future__ import annotations

from enum import IntEnum

from truestroke.base.verdict import Verdict


class ExitCode(IntEnum):
    """Exit code of a command; `meaning` is its line in docs/exit-codes.md."""

    meaning: str

    def __new__(cls, value: int, meaning: str) -> ExitCode:
        """The number, and what it means in a sentence."""
        code = int.__new__(cls, value)
        code._value_ = value
        code.meaning = meaning
        return code

    @classmethod
    def of(cls, verdict: Verdict) -> ExitCode:
        """Of a command that did what was asked, whose result has this verdict."""
        return cls.NOT_TRACKING if verdict.is_bad else cls.OK

    OK = 0, "It did what was asked, and the verdict is not bad."
    FAILED = 1, "An error that none of the others names; nothing was overwritten."
    USAGE = 2, "A wrong argument or configuration: refused before anything moved."
    CHECK = 3, "The axis failed its check before the run: polarity, gain, channel or noise."
    NOT_TRACKING = 4, "Tracking was lost in mid-run, or the result has a bad verdict."
    SENSOR = 10, "The sensor delivered nothing usable for `sensor_timeout`."
    OVERRUN = 11, "The loop was late for `overrun_streak` blocks in a row."
    DRIVER = 12, "The driver or its hardware reported an error."
    RECORDER = 13, "The recording could not be written."
    WATCHDOG = 14, "The watchdog does not work."
    STOPPED = 15, "An operator asked for the end."
    HANGUP = 129, "The terminal was closed."
    INTERRUPTED = 130, "Ctrl-C."
    ABORTED = 134, "The vendor's library crashed; the watchdog set the output to the safe voltage."
    KILLED = 137, "The process was killed or hung; the watchdog set the output to the safe voltage."
    TERMINATED = 143, "SIGTERM."
