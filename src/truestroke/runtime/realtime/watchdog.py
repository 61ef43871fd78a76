"""The watchdog and its deputy: they end the process when the loop stops, and set the output to the safe voltage.

Each has a process and a session of its own. The watchdog acts at once; its deputy acts when the watchdog has ended, or
stopped, or takes too long. The loop checks the heartbeats of both.
"""

import sys
import time
from collections.abc import Callable

from truestroke.base import system
from truestroke.base.system import Peer
from truestroke.base.typing import FloatArray
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.shared import Helper, Pulse, Shared, Slot, State

PATIENCE = 5.0  # s that starting and stopping the hardware may take
SETTLING = 1.0  # s between two ticks of axis check and soft start
LOOK = 0.1  # s between two looks, or less
GRACE = 0.5  # s without a beat of the watchdog after which its deputy acts
LETTING_GO = 1.0  # s that a killed process has to let go of the hardware
RESCUE = 15.0  # s that bringing the output to safety may take
NAMES = {Slot.WATCHDOG: "watchdog", Slot.DEPUTY: "deputy of the watchdog"}
BEATS = {Slot.WATCHDOG: Slot.WATCHDOG_BEAT, Slot.DEPUTY: Slot.DEPUTY_BEAT}


def watch(
    lifeline: Lifeline, shared: Shared, pid: int, rescue: Callable[[FloatArray], None], safe: FloatArray, timeout: float
) -> None:
    """Look at the beat until the run has ended; without one for `timeout` seconds, kill `pid` and rescue.

    The end of the process suffices, for any cause.
    """
    system.protect()
    if why := _until_it_is_lost(lifeline, shared, Peer(pid), timeout, Slot.WATCHDOG):
        _bring_to_safety(shared, rescue, safe, why, Slot.WATCHDOG)


def deputise(
    lifeline: Lifeline,
    shared: Shared,
    pid: int,
    first: int,
    rescue: Callable[[FloatArray], None],
    safe: FloatArray,
    timeout: float,
) -> None:
    """`watch` a little longer, and rescue where the watchdog, of the number `first`, does not."""
    watchdog = Peer(first)
    system.protect()
    why = _until_it_is_lost(lifeline, shared, Peer(pid), timeout + GRACE, Slot.DEPUTY)
    if why and (failed := _failed(shared, watchdog)):
        _bring_to_safety(shared, rescue, safe, f"{why}, {failed}", Slot.DEPUTY)


def _until_it_is_lost(lifeline: Lifeline, shared: Shared, process: Peer, timeout: float, who: Slot) -> str:
    """Why the safe voltage has to be set now: the process is gone, or killed here; "" at the end of the run."""
    count, pulse, look, gone = shared.count, Pulse(), min(timeout / 8, LOOK), False
    count[who] = Helper.READY
    while not gone:
        count[BEATS[who]] += 1
        state = count[Slot.STATE]
        if state == State.ENDED:
            return ""
        still = pulse.still((count[Slot.BEAT], state))
        if state != State.IDLE and still > _patience(shared, state, timeout):
            break
        gone = lifeline.gone(look)
    if count[Slot.STATE] in (State.IDLE, State.ENDED):
        return ""
    if gone:
        return "the process is gone"
    process.kill(LETTING_GO)
    return f"no tick for {timeout:g} s: killed the process"


def _patience(shared: Shared, state: int, timeout: float) -> float:
    """s without a tick: what the hardware needs to start and to stop, and once it ticks before the run, `SETTLING`."""
    if state == State.LIVE:
        return timeout
    return max(timeout, SETTLING if state == State.STARTING and shared.count[Slot.BEAT] else PATIENCE)


def _failed(shared: Shared, watchdog: Peer) -> str:
    """How the watchdog failed to set the output to the safe voltage; "" if it did not fail."""
    count, pulse, began = shared.count, Pulse(), time.monotonic()
    while count[Slot.WATCHDOG] not in (Helper.RESCUED, Helper.NO_RESCUE):
        if watchdog.gone():
            if count[Slot.WATCHDOG] in (Helper.RESCUED, Helper.NO_RESCUE):
                break
            return "and so is the watchdog"
        count[Slot.DEPUTY_BEAT] += 1
        still = pulse.still((count[Slot.WATCHDOG], count[Slot.WATCHDOG_BEAT]))
        if still > (RESCUE if count[Slot.WATCHDOG] == Helper.RESCUING else GRACE):
            watchdog.kill(LETTING_GO)
            return f"the watchdog stood still for {time.monotonic() - began:.1f} s"
        time.sleep(GRACE / 50)
    return ""


def outcome(shared: Shared) -> str:
    """In words, what the two have done after the end of the process; they have a moment for it."""
    began = time.monotonic()
    while True:
        states = {slot: shared.count[slot] for slot in NAMES}
        for slot, state in states.items():
            if state in (Helper.RESCUED, Helper.NO_RESCUE):
                could = "set" if state == Helper.RESCUED else "could not set"
                return f"the {NAMES[slot]} {could} the output to the safe voltage"
        if time.monotonic() - began > (RESCUE + PATIENCE if Helper.RESCUING in states.values() else 3.0):
            return "nothing set the output to the safe voltage"
        time.sleep(LOOK / 2)


def _bring_to_safety(
    shared: Shared, rescue: Callable[[FloatArray], None], safe: FloatArray, why: str, who: Slot
) -> None:
    volts = ", ".join(f"{v:g} V" for v in safe)
    shared.count[who] = Helper.RESCUING
    try:
        rescue(safe)
    except Exception as error:
        shared.count[who] = Helper.NO_RESCUE
        tell = f"{NAMES[who]}: {why}; THE OUTPUT IS NOT SAFE, not at {volts}: {' '.join(str(error).split())}"
    else:
        shared.count[who] = Helper.RESCUED
        tell = f"{NAMES[who]}: {why}; output set to {volts}"
    sys.stderr.write(f"truestroke: {tell}\n")
    sys.stderr.flush()
