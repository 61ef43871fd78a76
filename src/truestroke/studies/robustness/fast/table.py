"""Fast robustness as a study: its metrics, the two baselines of each run, the table of what came out, the verdict."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control.controller import AdaptiveController
from truestroke.control.feasibility import LimitWarning
from truestroke.plant import StagePlant
from truestroke.runtime import loop
from truestroke.signals.recording import Recording
from truestroke.signals.trajectories import Trajectory
from truestroke.studies.engine import Channels, Number, Row, Run, quantiles
from truestroke.studies.robustness.fast.sample import (
    CONTROLLERS,
    DURATION,
    TRAVEL,
    FastRun,
    Motion,
    Tones,
    blended,
    sample,
    stage_of,
)

START = 0.5  # s that the largest error leaves out
SETTLED = 1.0  # s after a jump of f0 that nothing counts
LEARNING = 1.0  # s of a slow wave, before the controller is held
SLOW = 1 / 40, 10.0  # of f0, and Hz at most: that wave
FITS = 4  # rounds in which the straight line is fitted
HELD = 1.2  # times the error of the held controller: a run with more has failed
MANY = 0.2  # of the runs that failed: bad


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes
    ----------
    name : str
        In words.
    controller : str
        Whose metrics.
    belongs : callable
        Whether a run, by its `sampled`, is in it.
    goal : tuple of (float, float, float) or None
        Median, 95th percentile and worst rms that are wanted, % of peak to peak.
    """

    name: str
    controller: str
    belongs: Callable[[Mapping[str, Any]], bool]
    goal: tuple[float, float, float] | None = None


def lines_of(dynamics: str) -> list[Line]:
    """The lines where `dynamics`, "measured" or "known", are given."""

    def jumps(sampled: Mapping[str, Any]) -> bool:
        return sampled["jump"] is not None

    def bouc_wen(sampled: Mapping[str, Any]) -> bool:
        return bool(sampled["kind"] == "bouc-wen")

    def others(sampled: Mapping[str, Any]) -> bool:
        return not jumps(sampled) and not bouc_wen(sampled)

    return [
        Line(f"dynamics {dynamics}, to f0/2", dynamics, others, (0.06, 0.15, 0.3)),
        Line("dynamics unknown, to f0/3", "unknown", others, (0.15, 0.5, 1.0)),
        Line(f"after f0 jumps, dynamics {dynamics}", dynamics, jumps, (0.1, 0.3, 0.5)),
        Line(f"Bouc-Wen, dynamics {dynamics}", dynamics, bouc_wen, (0.4, 0.8, 1.2)),
        Line("after f0 jumps, dynamics unknown", "unknown", jumps),
        Line("Bouc-Wen, dynamics unknown", "unknown", bouc_wen),
    ]


# ---- A run ---------------------------------------------------------------------------------------------------------


def counts(run: Run, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where rms and maximum count, and where the largest error does: bool, shape (ticks,).

    The second half, without the second after a jump; and from 0.5 s on, without that second.
    """
    jump = run.sampled["jump"]
    settled = np.full(time.size, True) if jump is None else (time < jump) | (time >= jump + SETTLED)
    judged = time >= (DURATION / 2 if jump is None else max(DURATION / 2, jump + SETTLED))
    return judged & settled, (time >= START) & settled


def metrics(run: FastRun, controller: str, channels: Channels) -> dict[str, Number]:
    """How well one controller followed, beside its baselines; errors are true minus desired, % of peak to peak.

    Parameters
    ----------
    run : FastRun
        Of `sample`.
    controller : str
        Which of its controllers.
    channels : mapping
        time, desired, true and flags of the run, or its recording.

    Returns
    -------
    dict
        rms and maximum: of the second half, and not of the second after a jump. largest, %, and largest_at, s:
        anywhere but in the first 0.5 s and in that second. straight: rms of a straight line through the same stage with
        the best gain and offset. held: rms of the same controller that learned on a slow wave and does not adapt.
        changes: ticks in which the controller found a sudden change.
    """
    desired, true, time = channels["desired"], channels["true"], np.asarray(channels["time"])
    judged, later = counts(run, time)
    percent = 100 / float(run.sampled["span"][controller])
    error = percent * np.abs(true - desired)
    worst = int(np.argmax(np.where(later, error, 0.0)))

    def rms(truth: FloatArray) -> float:
        return percent * float(np.sqrt(np.mean((truth - desired)[judged] ** 2)))

    return {
        "rms": rms(true),
        "maximum": float(error[judged].max()),
        "largest": float(error[worst]),
        "largest_at": float(time[worst]),
        "straight": rms(straight_line(run, desired, judged)),
        "held": rms(held(run, controller)),
        "changes": int(np.count_nonzero(channels["flags"] & BIT["changed"])),
    }


def straight_line(run: Run, desired: FloatArray, judged: FloatArray) -> FloatArray:
    """True displacement, um, where the voltage is (z_d - o) / g with the g and o that are best where it is judged.

    A voltage a times as large moves the stage a times as far, nearly: a and b of z_d = a z + b, by least squares, give
    the next g and o.
    """
    stage = stage_of(run)
    gain, offset = stage.input_sensitivity, 0.0
    for _ in range(FITS):
        plant = StagePlant(stage, run.seed)
        plant.exchange((desired - offset) / gain)
        a, b = np.polyfit(plant.truth[judged], desired[judged], 1)
        gain, offset = gain / a, offset - b / a
    return plant.truth


def held(run: FastRun, controller: str) -> FloatArray:
    """True displacement, um, of the motion under the same controller, which learned on a slow wave and is held.

    The motion, and what happens to f0, come `LEARNING` later.
    """
    stage, rate = stage_of(run), stage_of(run).sample_rate
    learning = round(LEARNING * rate)
    late = dataclasses.replace(stage, resonance_change_time=stage.resonance_change_time + learning / rate)
    whole = _after_a_slow_wave(run, controller, learning)
    adaptive = AdaptiveController.from_settings(run.controllers[controller])
    plant = StagePlant(late, run.seed)
    strain = adaptive.strain(whole.position)
    motion = zip(whole.position.tolist(), whole.velocity.tolist(), whole.acceleration.tolist(), strict=True)
    volts = np.empty(len(whole))
    for k, (z_d, zdot_d, zddot_d) in enumerate(motion):
        volts[k] = adaptive.command(z_d, zdot_d, zddot_d, None if strain is None else float(strain[k]))
        if k < learning:
            adaptive.adapt(float(plant.exchange(volts[k : k + 1])[0]))
        elif k == learning:
            adaptive.hold()
    plant.exchange(volts[learning:])
    return plant.truth


def _after_a_slow_wave(run: FastRun, controller: str, learning: int) -> Trajectory:
    """A slow wave, and the motion behind it."""
    stage, rate = stage_of(run), stage_of(run).sample_rate
    tones = run.tones[controller]
    time = np.arange(learning + len(run.motions[controller])) / rate
    frequency = min(SLOW[0] * stage.resonances[0], SLOW[1])
    half = stage.stroke * (TRAVEL[1] - TRAVEL[0]) / 2
    wave = Tones(tones.middle, np.array([frequency]), np.array([half]), np.zeros(1)).at(time)
    still = (np.zeros_like(time),) * 3
    slow: Motion = blended(still, wave, time)
    both = blended(slow, tones.at(time - learning / rate), time - learning / rate)
    return Trajectory("slow, then fast", rate, *both[:2], {}, both[2])


@dataclass(frozen=True, kw_only=True)
class FastRobustness:
    """The study: stages of a stated distribution and fast motions, with the dynamics given, and unknown.

    Attributes
    ----------
    seed : int
        Of all that is sampled.
    numbers : sequence of int
        Of the runs.
    controllers : tuple of str
        "measured" or "known", and "unknown".
    settings : mapping
        Of all controllers, for trying others.
    """

    seed: int = 0
    numbers: Sequence[int] = range(200)
    controllers: tuple[str, ...] = CONTROLLERS
    settings: Mapping[str, Any] = field(default_factory=dict)

    def identity(self) -> dict[str, Any]:
        """Everything but how many there are."""
        return {"kind": "fast", "seed": self.seed, "controllers": self.controllers, "settings": self.settings}

    def sample(self, number: int) -> FastRun:
        """The run of this number."""
        return sample(self.seed, number, self.controllers, **self.settings)

    def metrics(self, run: Run, controller: str, channels: Channels) -> dict[str, Number]:
        """How well it was followed."""
        return metrics(cast(FastRun, run), controller, channels)


def record(seed: int, number: int, controller: str, **settings: Any) -> Recording:
    """Simulate one run with one of its controllers; `settings` are of `AdaptiveController`, for trying others."""
    one = sample(seed, number, [controller], **settings)
    adaptive = AdaptiveController.from_settings(one.controllers[controller])
    with warnings.catch_warnings():  # the prior, which is all that it goes by, is not the stage
        warnings.simplefilter("ignore", LimitWarning)
        recording = loop.run(one.motions[controller], adaptive, StagePlant(stage_of(one), one.seed))
    about = {"seed": seed, "number": number, "what": one.sampled["what"], "controller": controller}
    return Recording(recording.channels, recording.metadata | {"robustness": about})


# ---- The table -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Result:
    """A line of the table with its numbers, % of peak to peak.

    Attributes
    ----------
    name : str
        In words.
    runs : int
        How many.
    rms, maximum, largest, straight, held : tuple of (float, float, float)
        Median, 95th percentile and worst of the metrics of `metrics`.
    failed : tuple of int
        Numbers of the runs whose rms is larger than that of the straight line, or `HELD` times that of the held one.
    goal : tuple of (float, float, float) or None
        Wanted of rms.
    """

    name: str
    runs: int
    rms: tuple[float, float, float]
    maximum: tuple[float, float, float]
    largest: tuple[float, float, float]
    straight: tuple[float, float, float]
    held: tuple[float, float, float]
    failed: tuple[int, ...]
    goal: tuple[float, float, float] | None

    @property
    def missed(self) -> tuple[str, ...]:
        """Which of the goals are not met."""
        names = ("median", "95 %", "worst")
        return tuple(n for n, rms, most in zip(names, self.rms, self.goal or (), strict=False) if rms > most)


def of_line(line: Line, rows: Sequence[Row]) -> list[tuple[int, dict[str, float]]]:
    """Numbers and metrics of the runs that belong to a line."""
    chosen = [row for row in rows if line.controller in row.metrics and line.belongs(row.sampled)]
    return [(row.number, cast(dict[str, float], row.metrics[line.controller])) for row in chosen]


def failed(found: Mapping[str, float]) -> bool:
    """Whether a run is worse than the straight line, or than the held controller."""
    return found["rms"] > min(found["straight"], HELD * found["held"])


def given_to(rows: Sequence[Row]) -> str:
    """Which dynamics the controllers of a study were given."""
    return "known" if any("known" in row.metrics for row in rows) else "measured"


def results(rows: Sequence[Row]) -> list[Result]:
    """The table: the lines that have a run."""
    table = []
    for line in lines_of(given_to(rows)):
        if having := of_line(line, rows):
            names = ("rms", "maximum", "largest", "straight", "held")
            numbers = {name: quantiles([found[name] for _, found in having]) for name in names}
            worse = tuple(number for number, found in having if failed(found))
            table.append(Result(name=line.name, runs=len(having), failed=worse, goal=line.goal, **numbers))
    return table


def refused_of(rows: Sequence[Row]) -> list[Row]:
    """Those whose stage was refused: its dynamics could not be measured."""
    return [row for row in rows if row.error]


def sentences(rows: Sequence[Row]) -> list[str]:
    """What was refused or failed, and which goals are missed, in words."""
    text, refused = [], refused_of(rows)
    if refused:
        text.append(
            f"{len(refused)} of {len(rows)} stages were refused, the first is run {refused[0].number}: "
            f"{refused[0].error}."
        )
    for one in results(rows):
        if one.failed:
            some = ", ".join(map(str, one.failed[:8])) + ", ..." * (len(one.failed) > 8)
            worse = f"worse than a straight line, or than {HELD:g} times the held controller: {some}."
            text.append(f"{one.name}: {len(one.failed)} of {one.runs} runs are {worse}")
        if one.goal and one.missed:
            goal = " / ".join(f"{most:g}" for most in one.goal)
            text.append(f"{one.name}: the goal of {goal} % is missed: {', '.join(one.missed)}.")
    return text


def judge(rows: Sequence[Row]) -> Verdict:
    """Bad where `MANY` of the runs failed or were refused, doubtful where one was, or a goal is missed."""
    refused = len(refused_of(rows))
    ran = sum(one.runs for one in results(rows)) + refused
    wrong = sum(len(one.failed) for one in results(rows)) + refused
    level: Level = "bad" if wrong >= MANY * ran else "doubtful"
    return Verdict.of([(level, text) for text in sentences(rows)])
