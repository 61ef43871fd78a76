"""The processes beside the loop: recorder, watchdog with its deputy, status line, server."""

import os
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Literal

import numpy as np

from truestroke.runtime.drivers.protocol import Driver
from truestroke.runtime.realtime import process, recorder, status, watchdog
from truestroke.runtime.realtime.ending import Cause
from truestroke.runtime.realtime.process import RealtimeError
from truestroke.runtime.realtime.server import Server, panels
from truestroke.runtime.realtime.server import start as start_server
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings
from truestroke.runtime.realtime.shared import Helper, Pulse, Shared, Slot, State, Text

START = 60.0  # s for them to start
PATIENCE = 60.0  # s for a watchdog to end
LAST_WORDS = 15.0  # s for the recorder to write the rest
BEAT = 2.0  # s without a beat after which a watchdog counts as stopped


class Helpers:
    """Recorder, watchdog, status line and server, each in its process."""

    def __init__(
        self,
        shared: Shared,
        plans: list[recorder.Plan],
        driver: Driver,
        axes: Sequence[Axis],
        settings: RealtimeSettings,
        show: Literal["live", "lines"] | None,
        server: Server | None,
    ) -> None:
        safe, rescue = np.array([axis.safe_voltage for axis in axes]), driver.rescue()
        self._shared, self._plans, us, timeout = shared, plans, os.getpid(), settings.watchdog_timeout
        self.recorder = process.start(shared, recorder.record, plans, keep=[plan.place.descriptor for plan in plans])
        self.watchdog = process.start(shared, watchdog.watch, us, rescue, safe, timeout)
        self.deputy = process.start(shared, watchdog.deputise, us, self.watchdog.pid, rescue, safe, timeout)
        self._watchdogs = {Slot.WATCHDOG: self.watchdog, Slot.DEPUTY: self.deputy}
        self._all = [self.recorder, self.watchdog, self.deputy]
        self._pulses = {slot: Pulse() for slot in self._watchdogs}
        if show is not None:
            names = [axis.name for axis in axes]
            shown = (names, plans[0].sample_rate, show == "live")
            self._all.append(process.start(shared, status.show, *shown, terminal=True))

        self.server: subprocess.Popen[bytes] | None = None
        if server is not None:
            self.server = process.start(shared, start_server, server, panels(axes, plans), plans[0].sample_rate)
            self._all.append(self.server)

    def wait_until_ready(self) -> None:
        """RealtimeError if they do not come up."""
        count, until = self._shared.count, time.monotonic() + START
        needed = [Slot.RECORDER, Slot.WATCHDOG, Slot.DEPUTY] + ([Slot.SERVER] if self.server else [])
        while any(count[slot] != Helper.READY for slot in needed):
            if count[Slot.RECORDER] == Helper.FAILED:
                raise RealtimeError(f"the recording cannot be written: {self._shared.read(Text.COMPLAINT)}")
            if count[Slot.SERVER] == Helper.FAILED:
                raise RealtimeError(f"the server did not start: {self._shared.read(Text.SERVER) or 'it died'}")
            if self.trouble() or time.monotonic() > until:
                raise RealtimeError("recorder and watchdog did not start")
            time.sleep(0.01)
        self._pulses = {slot: Pulse() for slot in self._watchdogs}

    def trouble(self) -> tuple[Cause, str] | None:
        """Which of them no longer works so that the run must end, and why; the server's death is only noted."""
        if self.server and self.server.poll() is not None:
            self._shared.count[Slot.SERVER] = Helper.FAILED
        if self._shared.count[Slot.RECORDER] == Helper.FAILED:
            return Cause.RECORDER, f"the recording cannot be written: {self._shared.read(Text.COMPLAINT)}"
        if self.recorder.poll() is not None:
            return Cause.RECORDER, "the recorder died"
        for slot, name in watchdog.NAMES.items():
            if self._watchdogs[slot].poll() is not None:
                return Cause.WATCHDOG, f"the {name} died"
            if self._stands_still(slot):
                return Cause.WATCHDOG, f"the {name} stands still"
        return None

    def _stands_still(self, slot: Slot) -> bool:
        """Whether a watchdog that was ready takes no looks any more: stopped, not dead."""
        if self._shared.count[slot] != Helper.READY:
            return False
        return self._pulses[slot].still(self._shared.count[watchdog.BEATS[slot]]) > BEAT

    def finish(self, ending: str) -> str:
        """Let the recording be completed; in words, its state if it was not."""
        self._shared.write(Text.ENDING, ending)
        self._shared.count[Slot.STATE] = State.ENDED
        try:
            if self.recorder.wait(LAST_WORDS) == 0:
                return ""
        except subprocess.TimeoutExpired:
            self.recorder.kill()
            self.recorder.wait()
        return f"the recording is not complete: {self._shared.read(Text.COMPLAINT) or 'the recorder died'}"

    def note(self, ending: str) -> None:
        """Write how the run ended, where the recorder no longer can."""
        for axis, plan in enumerate(self._plans):
            if offset := self._shared.count[Slot.ENDINGS + axis]:
                with suppress(OSError):  # the disk takes nothing: the recording says that it was not ended
                    recorder.write_ending(plan.place, offset, ending)

    def close(self) -> None:
        """End them all; a watchdog that rescues is not disturbed, one that has stopped is killed."""
        for slot, one in self._watchdogs.items():
            if self._stands_still(slot):
                one.kill()
        patience = {self.recorder: LAST_WORDS, self.watchdog: PATIENCE, self.deputy: PATIENCE}
        for helper in self._all:
            if helper.stdin:
                helper.stdin.close()
            try:  # a terminal that nobody reads holds up the status line
                helper.wait(patience.get(helper, 2.0))
            except subprocess.TimeoutExpired:
                helper.kill()
                helper.wait()
