"""How far loads are reduced with measured dynamics, on a family of stages: python benchmarks/loads.py

For each stage: the sensitivity |S| at 5 and 50 Hz and the time in which a step of load falls to 10 % for good, of the
linear loop by python-control; the same on `StagePlant`, with hysteresis, creep and what the law learns; and beside them
what the dead time alone allows, |S| at 50 Hz of an integrator on a stage without resonance and with the same margins.
Over all frequencies the mean of log|S| is 0 (Bode): what is gained below the bandwidth is paid for above it.

`--least` has, in place of all this, what is left of a step of load after 5 ms at least, whatever linear feedback there
is: a linear program over all of them, for a stage that is known exactly.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterable
from dataclasses import replace

import control
import numpy as np
import numpy.typing as npt
from scipy import linalg, optimize, signal

from truestroke import AdaptiveController, Dynamics, run, trajectories
from truestroke.control.feedback import BEYOND, GAINS, LOUDEST, PEAK, Feedback, design, grid
from truestroke.plant import StagePlant, StageSettings

RESONANCES = 100.0, 200.0, 400.0, 700.0, 1000.0, 2000.0  # Hz
RATES = 5_000.0, 10_000.0, 20_000.0  # Hz
DAMPINGS = 0.003, 0.02, 0.08
LOAD = 0.5  # um
TERMS = 80  # of the feedbacks that `least` goes through
GOALS = {"5 Hz (dB)": -30.0, "50 Hz (dB)": -6.0, "step (ms)": 5.0}


def sampled(stage: Dynamics) -> tuple[control.StateSpace, control.StateSpace]:
    """From a command, and from a load on the stage, that are held for a tick to the mean over it: exact."""
    T = 1 / stage.sample_rate
    found = []
    load = Dynamics(sample_rate=stage.sample_rate, modes=stage.modes)
    for system in (control.ss(stage.to_control(pade=0)), control.ss(load.to_control(pade=0))):
        n = system.nstates
        whole = np.zeros((n + 2, n + 2))  # states, integral of the displacement, command
        whole[:n, :n], whole[:n, n + 1], whole[n, :n] = system.A, system.B[:, 0], system.C[0]
        tick = linalg.expm(whole * T)
        parts = tick[:n, :n], tick[:n, n + 1 :], tick[n : n + 1, :n] / T, tick[n : n + 1, n + 1 :] / T
        found.append(control.ss(*parts, T))
    return found[0], found[1]


def closed(stage: Dynamics, bank: Feedback) -> tuple[control.StateSpace, control.StateSpace]:
    """The sensitivity, and from a load on the stage to the displacement; a dead time of whole ticks."""
    T = 1 / stage.sample_rate
    command, load = sampled(stage)
    late = 1 + bank.latency + round(stage.dead_time * stage.sample_rate)
    delay = control.ss(np.eye(late, k=-1), np.eye(late, 1), np.eye(1, late, late - 1), 0, T)
    each = [control.ss(control.tf([b0, b1, b2], [1.0, a1, a2], T)) for b0, b1, b2, a1, a2 in bank.filters]
    S = control.feedback(1, command * delay * sum(each[1:], start=each[0]))
    return S, S * load


def settled(error: npt.NDArray[np.float64], rate: float) -> float:
    """Time from which on |error| stays below a tenth, ms."""
    beyond = np.flatnonzero(np.abs(error) > 0.1)
    return 1e3 * (beyond[-1] + 1) / rate if beyond.size else 0.0


def linear(stage: Dynamics, bank: Feedback) -> dict[str, float]:
    """By python-control."""
    S, loaded = closed(stage, bank)
    rate = stage.sample_rate
    size = {f: 20 * math.log10(abs(S(np.exp(2j * math.pi * f / rate)))) for f in (5.0, 50.0)}
    step = control.step_response(loaded, T=np.arange(round(0.2 * rate)) / rate).outputs
    return {"5 Hz (dB)": size[5.0], "50 Hz (dB)": size[50.0], "step (ms)": settled(step, rate)}


def allowed(stage: Dynamics, latency: int = 0) -> float:
    """|S| at 50 Hz, dB, of the fastest integrator behind the same dead time, without resonance and with the margins."""
    rate = stage.sample_rate
    f = np.geomspace(1e-4, 0.5, 4000)
    q = np.exp(-2j * math.pi * f)
    late = 1 + latency + round(stage.dead_time * rate)
    lag = 1 + 1j * f * rate / stage.amplifier_bandwidth if stage.amplifier_bandwidth else 1.0
    loop = q**late / (1 - q) / lag
    fastest = max(w for w in np.geomspace(1e-3, 1.0, 300) if np.abs(1 / (1 + GAINS[1] * w * loop)).max() < PEAK)
    return float(20 * np.log10(np.abs(1 / (1 + fastest * loop[np.searchsorted(f, 50.0 / rate)]))))


def least(stage: Dynamics, after: float, latency: int = 0) -> float:
    """What is left of a step of load from `after` (s) on, at the least, with |S| and |K| within the bounds of `design`.

    K = Q / (1 - P Q) for any stable Q (Youla), here sums of Laguerre functions: S = 1 - P Q, and what passes it, are
    linear in them. A bound of |K| beyond the mode is one of |Q|, PEAK times as large. Each disc is replaced by a
    polygon about it, so that no K is left out.
    """
    rate, first = stage.sample_rate, stage.modes[0].frequency
    late, ticks = 1 + latency + round(stage.dead_time * rate), round(0.2 * rate)
    f = grid(stage, points=400)
    q = np.exp(-2j * math.pi * f / rate)
    command, load = sampled(stage)
    pole = math.exp(-2 * math.pi * min(3 * first, rate / 6) / rate)
    first_one, all_pass = math.sqrt(1 - pole**2) / (1 - pole * q), (q - pole) / (1 - pole * q)
    Q = first_one[:, np.newaxis] * all_pass[:, np.newaxis] ** np.arange(TERMS)
    P = np.array([complex(command(1 / each)) for each in q]) * q**late
    beyond = Q[f >= BEYOND * stage.modes[-1].frequency]
    time = np.arange(ticks)
    passed = control.step_response(load, T=time / rate).outputs
    pulse = np.concatenate([np.zeros(late), control.impulse_response(command, T=time / rate).outputs / rate])
    moved, course = [], signal.lfilter([math.sqrt(1 - pole**2)], [1.0, -pole], passed)
    for _ in range(TERMS):
        moved.append(np.convolve(pulse, course)[:ticks])
        course = signal.lfilter([-pole, 1.0], [1.0, -pole], course)
    judged = (time >= after * rate) & (time % max(1, int(rate / first / 24)) == 0)
    rows, bounds = [], []
    for turned in np.exp(-2j * math.pi * np.arange(16) / 16):
        rows += [-(P[:, np.newaxis] * Q * turned).real, (beyond * turned).real]
        bounds += [PEAK - np.full(q.size, turned.real), np.full(len(beyond), LOUDEST[1] * PEAK)]
    free = np.vstack(rows)
    left, wanted = np.array(moved).T[judged], passed[judged]
    judging = np.vstack([np.column_stack([sign * left, -np.ones(len(left))]) for sign in (-1, 1)])
    every = np.vstack([np.column_stack([free, np.zeros(len(free))]), judging])
    limits = np.concatenate([*bounds, -wanted, wanted])
    box = [(None, None)] * TERMS + [(0, None)]
    return float(optimize.linprog(np.eye(TERMS + 1)[-1], every, limits, bounds=box, method="highs-ipm").x[-1])


def typical(
    settings: StageSettings, seeds: int = 3, trusted: float | None = None, motion: float = 2.0
) -> dict[str, float]:
    """The median of `simulated` over some noises: a load of 50 Hz raises an alarm of change in some runs."""
    rows = [simulated(settings, seed, trusted=trusted, motion=motion) for seed in range(1, 1 + seeds)]
    return {name: float(np.median([row[name] for row in rows])) for name in rows[0]}


def known(settings: StageSettings, trusted: float | None) -> Dynamics:
    """The stage's dynamics, trusted up to a share of the sample rate; None: to the last mode, as without more."""
    found = settings.dynamics()
    return found if trusted is None else replace(found, trusted_to=trusted * settings.sample_rate)


def simulated(
    settings: StageSettings, seed: int = 1, duration: float = 3.0, trusted: float | None = None, motion: float = 2.0
) -> dict[str, float]:
    """On the stage with hysteresis, creep and noise, beside a slow motion, with the law at work."""
    rate, ticks = settings.sample_rate, round(duration * settings.sample_rate)
    wave = trajectories.sine(frequency=motion, peak_to_peak=15.0, offset=12.0, duration=duration, sample_rate=rate)
    time = np.arange(ticks) / rate
    late = time >= 0.5 * duration

    def moved(load: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        axis = {"sample_rate": rate, "stroke": 24.0, "voltage_limits": settings.voltage_limits}
        controller = AdaptiveController(**axis, dynamics=known(settings, trusted))
        return run(wave, controller, StagePlant(settings, seed, load=load))["true"]

    still = moved(np.zeros(ticks))
    found = {}
    for frequency in (5.0, 50.0):
        passed = moved(LOAD * np.sin(2 * math.pi * frequency * time)) - still
        part = 2 * np.mean((passed * np.exp(-2j * math.pi * frequency * time))[late])
        found[f"{frequency:g} Hz (dB)"] = float(20 * np.log10(abs(part) / LOAD))
    step = (moved(LOAD * late) - still)[late] / LOAD
    return {**found, "step (ms)": settled(step[: round(0.2 * rate)], rate)}


def family(resonances: Iterable[float], rates: Iterable[float], dampings: Iterable[float]) -> Iterable[StageSettings]:
    """The stages whose resonance is below 0.3 of the sample rate."""
    for first, rate, damping in itertools.product(resonances, rates, dampings):
        if first < 0.3 * rate:
            yield StageSettings(sample_rate=rate, resonances=(first,), dampings=(damping,), dead_time=1 / rate)


def main() -> None:
    """A line for each stage; then how many meet each goal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--resonances", nargs="+", type=float, default=RESONANCES)
    parser.add_argument("--rates", nargs="+", type=float, default=RATES)
    parser.add_argument("--dampings", nargs="+", type=float, default=DAMPINGS)
    parser.add_argument("--linear", action="store_true", help="without the simulated stages")
    parser.add_argument("--least", action="store_true", help="what any feedback leaves of a step of load after 5 ms")
    parser.add_argument("--motion", type=float, default=2.0, help="Hz: of the slow wave beside the load")
    parser.add_argument("--trusted", type=float, help="of the sample rate: up to where no further mode is possible")
    options = parser.parse_args()
    met: dict[str, list[bool]] = {}
    print(f"{'f0':>5} {'rate':>6} {'zeta':>6} {'bandwidth':>9} {'allowed':>8}   5 Hz, 50 Hz (dB), step (ms); simulated")
    for settings in family(options.resonances, options.rates, options.dampings):
        stage = known(settings, options.trusted)
        head = f"{settings.resonances[0]:5.0f} {settings.sample_rate:6.0f} {settings.dampings[0]:6.3f}"
        if options.least:
            left = " and ".join(f"{least(stage, 1e-3 * ms):.3f} after {ms} ms" for ms in (5, 8))
            print(f"{head} {left} are left", flush=True)
            continue
        bank = design(stage, stroke=24.0)
        if not bank.filters:
            print(f"{head} none: {bank.reasons[0]}")
            continue
        rows = [
            linear(stage, bank),
            *([] if options.linear else [typical(settings, trusted=options.trusted, motion=options.motion)]),
        ]
        numbers = "; ".join(" ".join(f"{value:7.1f}" for value in row.values()) for row in rows)
        print(f"{head} {bank.bandwidth_hz:9.0f} {allowed(stage):8.1f} {numbers}", flush=True)
        for name, goal in GOALS.items():
            met.setdefault(name, []).append(rows[-1][name] <= goal)
    for name, each in met.items():
        print(f"{name} at most {GOALS[name]:g}: {sum(each)} of {len(each)}")


if __name__ == "__main__":
    main()
