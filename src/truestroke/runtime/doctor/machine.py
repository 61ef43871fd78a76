"""How well this computer keeps time."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import numpy as np

from truestroke import _kernel
from truestroke.runtime.doctor.finding import Finding, Level, read
from truestroke.runtime.drivers.clock import Clock
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
        _lateness(asked, period, probe),
    ]


def _processors(cpu: int | None) -> Finding:
    mine, there = sorted(os.sched_getaffinity(0)), os.cpu_count() or 1
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
    quota, _, period = read("/sys/fs/cgroup/cpu.max").partition(" ")
    limited = quota.isdigit()
    return Finding(
        PART,
        "processor quota",
        "who has used up its share of a period is stopped for the rest of it, up to 100 ms",
        found=f"{int(quota) / int(period):g} processors" if limited else "none",
        level=Level.WARNING if limited else Level.OK,
        command="start the container without --cpus",
    )


def _governor() -> Finding:
    files = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    governors = sorted({read(str(file)) for file in files})
    slow = [name for name in governors if name != "performance"]
    return Finding(
        PART,
        "frequency governor",
        "a processor that has slowed down takes longer over a tick",
        found=", ".join(governors) or "not in this system's hands",
        level=Level.WARNING if slow else Level.OK,
        command="sudo cpupower frequency-set -g performance",
    )


def _priority(required: bool) -> Finding:
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, policy, parameter)
        permitted = True
    except OSError:
        permitted = False
    return Finding(
        PART,
        "real-time priority",
        "priority in [realtime], of use with PREEMPT_RT",
        found=f"SCHED_FIFO {'permitted' if permitted else 'refused'}, ulimit -r {_limit(limit)}",
        level=Level.OK if permitted else Level.MISSING,
        command=f"echo '{os.environ.get('USER', '*')} - rtprio 99' | sudo tee -a {LIMITS}",
        required=required,
    )


def _limit(value: int, unit: int = 1) -> str:
    return "unlimited" if value == resource.RLIM_INFINITY else f"{value / unit:g}"


def _memory() -> Finding:
    swaps = read("/proc/swaps").splitlines()[1:]
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    return Finding(
        PART,
        "memory",
        "a page that has been swapped out stops a tick for milliseconds",
        found=f"{'swap in use' if swaps else 'no swap'}, memlock {_limit(limit, 2**20)} MiB".replace("ed MiB", "ed"),
        level=Level.WARNING if swaps else Level.OK,
        command="sudo swapoff -a",
    )


def _preemption() -> Finding:
    release, version = os.uname().release, os.uname().version
    fully = read("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in version
    found = "PREEMPT_RT" if fully else next((word for word in version.split() if "PREEMPT" in word), "not preemptible")
    return Finding(
        PART,
        "PREEMPT_RT",
        "bounds lateness; without it the rare tick is late by ms",
        found=f"{found}, Linux {release}",
        level=Level.OK if fully else Level.MISSING,
        command="Debian: sudo apt install linux-image-rt-amd64; Ubuntu: sudo pro enable realtime-kernel",
    )


def _clock_source() -> Finding:
    folder = "/sys/devices/system/clocksource/clocksource0/"
    source, available = (read(f"{folder}{name}_clocksource") for name in ("current", "available"))
    slow = source in SLOW_CLOCKS
    switch = slow and "tsc" in available.split()
    return Finding(
        PART,
        "clock source",
        "the loop reads it while it spins; a slow one takes microseconds",
        found=source or "unknown",
        level=Level.WARNING if slow else Level.OK,
        command=f"echo tsc | sudo tee {folder}current_clocksource" if switch else "",
    )


def _timer_slack(spin: float) -> Finding:
    text = read("/proc/self/timerslack_ns")
    slack = int(text) if text.isdigit() else SLACK
    return Finding(
        PART,
        "timer slack",
        f"a sleeper may wake so much later; the loop wakes {1e6 * spin:g} us early",
        found=f"{slack / 1000:g} us",
        level=Level.OK if slack <= max(SLACK, 0.5e9 * spin) else Level.WARNING,
        command="" if slack <= SLACK else f"echo {SLACK} | sudo tee /proc/$PPID/timerslack_ns",
    )


def _kernel_variant() -> Finding:
    """Our own kernel: which of its texts for this processor is in use."""
    variant = getattr(_kernel, "variant", lambda: "portable")()
    there = getattr(_kernel, "variants", lambda: [variant])()
    return Finding(
        PART,
        "truestroke's kernel",
        "the instructions that command and adapt are made of",
        found=f"{variant} of {', '.join(there)}",
        level=Level.OK,
    )


def _lateness(settings: RealtimeSettings, period: float, probe: float) -> Finding:
    """The runner's own clock, under the settings of the run, with nothing to do."""
    usable = settings.cpu is None or settings.cpu in os.sched_getaffinity(0)
    asked = settings if usable else RealtimeSettings(spin=settings.spin)
    clock, late = Clock(period, asked.spin), np.empty(max(2, round(probe / period)))
    try:
        with undisturbed(asked):
            clock.start()
            for i in range(late.size):
                late[i] = clock.wait() * 1e-3
    except RealtimeError as error:
        return _unmeasured(str(error))
    middle, high = np.percentile(late, [50, 99])
    bad = clock.overruns > 0 or high > (LATE if asked.spin else LATE + 200.0)
    return Finding(
        PART,
        "lateness",
        "what the rest adds up to, of an empty loop",
        found=f"{1 / period:g} Hz for {probe:g} s: median {middle:.1f} us, p99 {high:.1f} us, worst "
        f"{clock.worst * 1e-3:.0f} us, {clock.overruns} overruns",
        level=Level.WARNING if bad else Level.OK,
        command="end other programs; pin the loop: cpu = 1 in [realtime]",
    )


def _unmeasured(reason: str) -> Finding:
    return Finding(PART, "lateness", "", found=f"not measured: {reason}", level=Level.WARNING)
