"""How well this computer keeps time."""

import math
import os

import numpy as np

from truestroke import _kernel
from truestroke.base import system
from truestroke.runtime.doctor.finding import Finding, Level
from truestroke.runtime.drivers.paced import Clock, coarse
from truestroke.runtime.realtime import RealtimeError, RealtimeSettings
from truestroke.runtime.realtime.process import undisturbed

PART = "real time"
PROBE = 1.0  # s
PERIOD = 0.5e-3  # s: 2 kHz
LATE = 50.0  # us that 99 % of the ticks should not be later than
SLACK = 50_000  # ns, Linux's default
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")
LIMITS = "/etc/security/limits.d/realtime.conf"


def look(settings: RealtimeSettings | None = None, period: float = PERIOD, probe: float = PROBE) -> list[Finding]:
    """Processors, governor, priority, memory, kernels, clock, and what they add up to: lateness of `probe` seconds."""
    asked = RealtimeSettings() if settings is None else settings
    if not system.HAS_PROCESSES:
        return [_none(), _kernel_variant()]
    lateness = _lateness(asked, period, probe)
    if not system.BOUNDS_LATENESS:
        return [_processors(asked.cpu), _unbounded(), _timer(asked.spin, period), _kernel_variant(), lateness]
    return [
        _processors(asked.cpu),
        _quota(),
        _governor(),
        _priority(asked.priority > 0),
        _memory(),
        _preemption(),
        _clock_source(),
        _timer_slack(asked.spin),
        _kernel_variant(),
        lateness,
    ]


def _none() -> Finding:
    why = "run and serve need its watchdog; all other commands work here"
    command = "run on Linux, or export the controller: truestroke export c"
    return Finding(PART, "real time", why, f"none on {system.NAME}", Level.MISSING, command, required=True)


def _unbounded() -> Finding:
    """Windows and macOS."""
    why = "Linux alone bounds lateness (SCHED_FIFO, PREEMPT_RT); a run counts the late ticks"
    command = "run on Linux, or export the controller: truestroke export c"
    return Finding(PART, "real time", why, f"none on {system.NAME}: a tick may be late by ms", Level.WARNING, command)


def _timer(spin: float, period: float) -> Finding:
    """Linux has finer ones, and `_timer_slack`."""
    step = system.timer_step()
    why = f"a sleeper wakes so much later at most; the loop wakes {1e6 * spin:g} us early"
    late = coarse(step, period, spin)
    found = f"steps of {1e3 * step:.2g} ms" + (f": {late}" if late else "")
    return Finding(PART, "timer", why, found, Level.WARNING if late else Level.OK)


def _processors(cpu: int | None) -> Finding:
    mine, there = system.processors(), os.cpu_count() or 1
    usable = f"{len(mine)} of {there} usable"
    if cpu is not None and cpu not in mine:
        level, found, command = Level.MISSING, f"cpu = {cpu} is not usable, only {mine}", f"taskset -c {cpu} truestroke"
    else:
        level, found = (Level.OK if len(mine) > 1 else Level.WARNING), usable
        command = "" if len(mine) == there or len(mine) > 1 else f"taskset -pc 0-{there - 1} $$"
    why = "the loop spins on one; recorder and watchdog need another"
    return Finding(PART, "processors", why, found=found, level=level, command=command, required=cpu is not None)


def _quota() -> Finding:
    """A container may be given a share of the processors, and is stopped when it is used up."""
    quota = system.quota()
    level, found = Level.OK, "none"
    if math.isfinite(quota):
        level, found = Level.WARNING, f"{quota:g} processors"
    why = "who has used up its share of a period is stopped for the rest of it, up to 100 ms"
    return Finding(PART, "processor quota", why, found, level, "start the container without --cpus")


def _governor() -> Finding:
    found, why = ", ".join(system.governors()), "a processor that has slowed down takes longer over a tick"
    level = Level.OK if found in ("", "performance") else Level.WARNING
    command = "sudo cpupower frequency-set -g performance"
    return Finding(PART, "frequency governor", why, found or "not in this system's hands", level, command)


def _priority(required: bool) -> Finding:
    try:
        with system.prioritised(1):
            level, answer = Level.OK, "permitted"
    except OSError:
        level, answer = Level.MISSING, "refused"
    allowed = _limit(system.limit("RTPRIO"))
    why, found = "priority in [realtime], of use with PREEMPT_RT", f"SCHED_FIFO {answer}, ulimit -r {allowed}"
    command = f"echo '{os.environ.get('USER', '*')} - rtprio 99' | sudo tee -a {LIMITS}"
    return Finding(PART, "real-time priority", why, found, level, command, required)


def _limit(value: float, unit: int = 1) -> str:
    return "unlimited" if math.isinf(value) else f"{value / unit:g}"


def _memory() -> Finding:
    limit = system.limit("MEMLOCK")
    level, swap = (Level.WARNING, "swap in use") if system.swaps() else (Level.OK, "no swap")
    found = f"{swap}, memlock {_limit(limit, 2**20)} MiB".replace("ed MiB", "ed")
    why = "a page that has been swapped out stops a tick for milliseconds"
    return Finding(PART, "memory", why, found, level, "sudo swapoff -a")


def _preemption() -> Finding:
    release, found = system.kernel()
    level = Level.OK if found == "PREEMPT_RT" else Level.MISSING
    why = "bounds lateness; without it the rare tick is late by ms"
    command = "Debian: sudo apt install linux-image-rt-amd64; Ubuntu: sudo pro enable realtime-kernel"
    return Finding(PART, "PREEMPT_RT", why, f"{found or 'not preemptible'}, Linux {release}", level, command)


def _clock_source() -> Finding:
    source, available = system.clock_source()
    level, why = Level.OK, "the loop reads it while it spins; a slow one takes microseconds"
    if source in SLOW_CLOCKS:
        level = Level.WARNING
    command = f"echo tsc | sudo tee {system.CLOCKS}current_clocksource" if "tsc" in available else ""
    return Finding(PART, "clock source", why, source or "unknown", level, command)


def _timer_slack(spin: float) -> Finding:
    found = system.timer_slack()
    slack = SLACK if found is None else found
    why = f"a sleeper may wake so much later; the loop wakes {1e6 * spin:g} us early"
    level = Level.OK if slack <= max(SLACK, 0.5e9 * spin) else Level.WARNING
    command = f"echo {SLACK} | sudo tee {system.TIMER_SLACK.format('$PPID')}"
    return Finding(PART, "timer slack", why, f"{slack / 1000:g} us", level, command)


def _kernel_variant() -> Finding:
    """Our own kernel: which of its texts for this processor is in use."""
    variant = getattr(_kernel, "variant", lambda: "portable")()
    there = getattr(_kernel, "variants", lambda: [variant])()
    why = "the instructions that command and adapt are made of"
    return Finding(PART, "truestroke's kernel", why, f"{variant} of {', '.join(there)}")


def _lateness(settings: RealtimeSettings, period: float, probe: float) -> Finding:
    """The runner's own clock, under the settings of the run, with nothing to do."""
    usable = settings.cpu is None or settings.cpu in system.processors()
    asked = settings if usable else RealtimeSettings(spin=settings.spin)
    clock, late = Clock(period, asked.spin), np.empty(max(2, round(probe / period)))
    try:
        with undisturbed(asked):
            clock.start()
            for i in range(late.size):
                late[i] = clock.wait() * 1e-3
    except RealtimeError as error:
        return Finding(PART, "lateness", "", f"not measured: {error}", Level.WARNING)
    middle, high = np.percentile(late, [50, 99])
    bad = clock.overruns > 0 or high > (LATE if asked.spin else LATE + 200.0)
    found = (
        f"{1 / period:g} Hz for {probe:g} s: median {middle:.1f} us, p99 {high:.1f} us, worst "
        f"{clock.worst * 1e-3:.0f} us, {clock.overruns} overruns"
    )
    level, why = Level.WARNING if bad else Level.OK, "what the rest adds up to, of an empty loop"
    return Finding(PART, "lateness", why, found, level, "end other programs; pin the loop: cpu = 1 in [realtime]")
