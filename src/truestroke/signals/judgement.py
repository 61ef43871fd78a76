"""Whether a run is good: from its recording, the same for every command; docs/exit-codes.md has the thresholds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures, taken_for_um
from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.signals import metrics
from truestroke.signals.clipping import at_an_end
from truestroke.signals.metrics import WINDOW, TrackingSummary
from truestroke.signals.recording import Recording

NOT_FOLLOWED = 5  # times what is tolerable: 10 % of the motion, and the run is bad
LIMITED, STUCK = 0.01, 0.2  # of the ticks of the second half, at a limit and far off: doubtful, bad
UNSEEN, BLIND = 0.05, 0.25  # of the measurements, missing or rejected: doubtful, bad
ALARMS = 2.0  # changes of the actuator that were found, per second: more are none of the actuator
STANDS = 0.5  # of the desired motion: an actuator that moves less did not follow, however small the error is in um
SURE = 4.0  # standard deviations
FOREIGN = 20.0  # times the gain of the settings, or as many times less: no actuator is so far from them
ALIKE = 0.7  # correlation of voltage and displacement: the sensor shows the motion of the voltage
TINY = 1e-12  # V
REPEATS = 20  # periods of a motion at least, for the answer of the actuator to its voltage at that frequency
HIDDEN = 0.2  # of the peak-to-peak: with more noise, and few samples, a motion is not seen
GREW, MATTERS = 3.0, 0.25  # times the error that was; of what is tolerable: an error that grew by so much, to so much
UNEVEN = 0.02  # of a tick: a period that is further from a whole number of them has other samples each time
AS_FAST = 1.2  # times the speed that was, at most: a motion that becomes faster has a larger error anyway
AS_MANY = 0.8  # of the ticks that count at the end, at least: what was before they counted is not known
BEYOND = (1.5, 4.0)  # times the resonance that was found: where a second mode is
RISES, SHOWS = 1.5, 0.025  # times an error there that was; of what is tolerable: one that rises by so much, to so much
PERIODS, LONGEST = 100, 2**18  # of that resonance at least, ticks at most, in which the error there is taken
COLOURED = 100  # samples of an error that count as one
BEGINS, JUMPED = 10, 0.02  # ticks of a run, and an error in them as a share of the stroke: it began elsewhere
ELSEWHERE = 0.01  # of the resonance that was given: one that differs by so much has taken its place
ASSUMED = 0.15  # of the resonance that was given: within it the first fast motion does not burst
WITHIN, STEPS = 8.0, 1.5  # standard deviations, steps of a sensor: what it may show of one value
GOES_ON = (0.02, 4.0)  # of the stroke; times that band: a voltage that moves so much further has no answer
BURST, FEWEST = 0.005, 10  # s, and ticks at least, over which a short error is taken
MOVES, JUMPS = 0.2, 5.0  # of the highest speed: such a window has motion; times the rms step of a tick: a jump
BY_A_PERSON = ("interrupted", "terminated", "hangup")


# ---- Data of the run in a recording --------------------------------------------------------------------------------


def settings(recording: Recording, section: str) -> Mapping[str, Any]:
    """Settings in a section of the metadata ("controller", "plant", ...); empty where there are none."""
    value = recording.metadata.get(section)
    found = value.get("settings") if isinstance(value, Mapping) else None
    return found if isinstance(found, Mapping) else {}


def change_time(recording: Recording) -> float | None:
    """When the simulated actuator changes suddenly, s; None if it does not."""
    change = settings(recording, "plant").get("change")
    return _positive(change.get("time")) if isinstance(change, Mapping) else None


def summary(recording: Recording) -> TrackingSummary:
    """The metrics of a recording, which knows its stroke, and when its actuator changed."""
    stroke = _positive(settings(recording, "controller").get("stroke"))
    return metrics.summary(recording, change=change_time(recording), stroke=stroke)


def repetition(recording: Recording) -> tuple[float, list[float]]:
    """What was learned of motion that repeats: its period, s, and the rms of each batch, um; 0 and none if nothing."""
    learned = _of_axis(recording, "repetition") or {}
    return learned.get("period_s", 0.0), learned.get("rmse_um", [])


def _positive(value: object) -> float | None:
    """A number of the metadata, if it is one: files come from anywhere."""
    return float(value) if isinstance(value, int | float) and np.isfinite(value) and value > 0 else None


# ---- The verdict ---------------------------------------------------------------------------------------------------

Finding = tuple[Level, str]
Check = Callable[["_Run"], Finding | None]


def judge(recording: Recording) -> Verdict:
    """Whether the run of a recording is good, and why not.

    Errors are those of the second half that are not the sensor's noise; measurements that the controller rejected count
    as missing. Where the recording has the truth, its error counts, too.

    Parameters
    ----------
    recording : Recording
        Whole or interrupted, with time, desired and measured; flags, true displacement and metadata as there are. Of
        several axes the worst of them.

    Returns
    -------
    Verdict
        With a sentence for each finding, lengths in um.

    Examples
    --------
    >>> from truestroke.signals.recording import Channel
    >>> time = np.arange(4000) / 2000.0
    >>> wave = 10 - 10 * np.cos(50 * time)
    >>> def made(measured):
    ...     arrays = {"time": (time, "s"), "desired": (wave, "um"), "measured": (measured, "um")}
    ...     return Recording({name: Channel(data, unit, name) for name, (data, unit) in arrays.items()})
    >>> judge(made(1.001 * wave))
    Verdict(level='good', reasons=())
    >>> for reason in judge(made(0 * wave)).reasons:
    ...     print(reason)
    The error is 12.3 um rmse, 61.4 % of the motion's peak-to-peak.
    What was measured moved 0.00 times as far as desired: the actuator did not follow, or this is not its sensor.
    """
    checks.instance("recording", recording, Recording, "a Recording, such as of truestroke.run or Recording.load(path)")
    if recording.axes:
        return worst({f"axis {name}": judge(recording.axis(name)) for name in recording.axes})
    ticks = recording["time"].size
    if not ticks:
        return Verdict("bad", (f"Nothing was recorded{_because(recording)}.",))
    try:
        measured = summary(recording)
    except SettingError:
        return Verdict("bad", (f"No measurement came in the second half of the run{_because(recording)}.",))
    run = _Run(recording, measured)
    checks_of_it: Sequence[Check] = (_ending, _other_unit, _missed) if run.found(_other_unit) else CHECKS
    if run.found(_at_an_end):
        checks_of_it = [check for check in checks_of_it if check not in OTHER_CAUSES]
    return Verdict.of(found for check in checks_of_it if (found := run.found(check)))


def _because(recording: Recording) -> str:
    why = recording.metadata.get("interrupted")
    return f": {str(why).rstrip('.')}" if why else ""


def worst(verdicts: Mapping[str, Verdict]) -> Verdict:
    """One verdict of several runs, by name: the worst level, and all reasons, each with the name before it.

    Examples
    --------
    >>> worst({"x": Verdict("good"), "y": Verdict("doubtful", ("It was late.",))})
    Verdict(level='doubtful', reasons=('y: It was late.',))
    """
    levels = [verdict.level for verdict in verdicts.values()]
    level: Level = "bad" if "bad" in levels else "doubtful" if "doubtful" in levels else "good"
    one = len(verdicts) == 1
    reasons = (r if one else f"{name}: {r}" for name, verdict in verdicts.items() for r in verdict.reasons)
    return Verdict(level, tuple(reasons))


@dataclass(frozen=True, eq=False)
class _Run:
    """A recording, its metrics, and what the checks share."""

    recording: Recording
    metrics: TrackingSummary
    findings: dict[Check, Finding | None] = field(default_factory=dict)

    def found(self, check: Check) -> Finding | None:
        """What a check finds, computed once: others depend on it."""
        if check not in self.findings:
            self.findings[check] = check(self)
        return self.findings[check]

    @cached_property
    def half(self) -> slice:
        return slice(self.metrics.ticks // 2, self.metrics.ticks)

    @cached_property
    def rejected(self) -> npt.NDArray[np.bool_]:
        """Ticks whose measurement the controller rejected."""
        if "flags" not in self.recording:
            return np.zeros(self.metrics.ticks, bool)
        return np.asarray(self.recording["flags"] & BIT["rejected"] > 0, bool)

    @cached_property
    def usable(self) -> npt.NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.recording["measured"]) & ~self.rejected, bool)

    @cached_property
    def error(self) -> FloatArray:
        """Measured minus desired, um; NaN where there is nothing usable, or where errors do not count."""
        counted = self.usable & metrics.judged(self.recording)
        return np.where(counted, self.recording["measured"] - self.recording["desired"], np.nan)

    @cached_property
    def noise(self) -> float:
        return min(metrics.noise(self.error), metrics.NOISE_LIMIT * self.metrics.stroke_um)

    @cached_property
    def tolerable(self) -> float:
        return metrics.tolerable(self.metrics.peak_to_peak_um, self.metrics.stroke_um, self.noise)

    @cached_property
    def rmse(self) -> float:
        """Of the second half, without the sensor's noise, um; that of the truth, if it is larger."""
        measured = float(np.sqrt(max(0.0, _rms(self.error[self.half]) ** 2 - self.noise**2)))
        return max(measured, self.metrics.true_rmse_um or 0.0)

    @cached_property
    def jumps(self) -> npt.NDArray[np.int64]:
        """Ticks before which the desired position jumps as no actuator can."""
        steps = np.abs(np.diff(self.recording["desired"]))
        return np.flatnonzero(steps > max(2 * self.tolerable, JUMPS * _rms(steps))) + 1

    def ticks_in(self, seconds: float) -> int:
        return min(max(round(seconds / self.metrics.duration_s * self.metrics.ticks), 1), self.metrics.ticks)

    def windows(self, length: int | None = None) -> FloatArray:
        """Rms of the usable errors in each window of 0.25 s or of so many ticks, up to the end, um."""
        return np.sqrt(np.maximum(0.0, self._rms_of_windows(self.error, length) ** 2 - self.noise**2))

    def counted(self) -> FloatArray:
        """Share of the ticks in the same windows whose errors count: none in the lead-in of a scan."""
        return self._rms_of_windows(np.isfinite(self.error).astype(float)) ** 2

    def smooth(self) -> npt.NDArray[np.bool_]:
        """Which of the same windows have no jump of the desired position."""
        jumped = np.zeros(self.metrics.ticks)
        jumped[self.jumps] = 1.0
        return np.asarray(self._rms_of_windows(jumped) == 0.0)

    def speeds(self) -> FloatArray:
        """Rms of the desired velocity in the same windows, um/s."""
        return self._rms_of_windows(np.gradient(self.recording["desired"], self.recording["time"]))

    def _rms_of_windows(self, values: FloatArray, length: int | None = None) -> FloatArray:
        length = length or self.ticks_in(WINDOW)
        blocks = values[values.size % length :].reshape(-1, length)
        known = np.isfinite(blocks)
        squares = np.where(known, blocks, 0.0) ** 2
        return np.asarray(np.sqrt(squares.sum(axis=1) / np.maximum(known.sum(axis=1), 1)))


def _ending(run: _Run) -> Finding | None:
    """How it ended, if not by itself; an operator who ends a set-point is no fault."""
    about = run.recording.metadata
    why, ended = about.get("interrupted"), about.get("ended")
    cause = ended.get("cause") if isinstance(ended, Mapping) else None
    if not why or cause == "stopped":
        return None
    asked = about.get("trajectory")
    ticks, rate = (_positive(asked.get(n)) if isinstance(asked, Mapping) else None for n in ("ticks", "sample_rate"))
    of = f" of {ticks / rate:.4g}" if ticks and rate else ""
    person = cause in BY_A_PERSON or str(why).startswith("KeyboardInterrupt")
    unended = cause is None and "not ended" in str(why)
    words = "Ctrl-C" if str(why).startswith("KeyboardInterrupt") else str(why).rstrip(".")
    text = f"The run ended before its time, after {run.metrics.duration_s:.4g}{of} s: {words}."
    return "doubtful" if person or unended else "bad", text


def _saturated(run: _Run) -> Finding | None:
    return _limited(run, "saturated", "was at a voltage limit")


def _slewed(run: _Run) -> Finding | None:
    if run.found(_saturated):
        return None  # a command that comes back from there is fast, too
    if found := _limited(run, "slewed", "met the slew limit"):
        return "doubtful", found[1]
    up = run.recording["flags"] & BIT["slewed"] > 0 if "flags" in run.recording else np.zeros(run.metrics.ticks, bool)
    if np.mean(up[run.half]) <= LIMITED:
        return None  # such as at the beginning, or after a change; the flags are counted in any case
    limit = _positive(settings(run.recording, "controller").get("slew_limit"))
    of = f", {figures(limit, 4)} V/s," if limit else ""
    return "doubtful", (
        f"The command met the slew limit{of} in {np.count_nonzero(up)} ticks, {_percent(float(np.mean(up)))}: raise "
        "it, or make the motion slower."
    )


def _limited(run: _Run, flag: str, words: str) -> Finding | None:
    far = metrics.at_limit(run.recording, run.tolerable, run.noise, flag)
    share = float(np.mean(far[run.half]))
    if share <= LIMITED:
        return None
    all_of_them = float(np.mean(run.recording["flags"] & BIT[flag] > 0))
    off = np.nanmax(np.where(far, np.abs(run.recording["measured"] - run.recording["desired"]), 0.0))
    text = f"The command {words} in {_percent(all_of_them)} of the ticks, with an error of up to {off:.3g} um there."
    return "bad" if share > STUCK else "doubtful", text


def _at_an_end(run: _Run) -> Finding | None:
    """A sensor that shows one value while the voltage goes on: nothing is known of the motion there."""
    known = np.isfinite(run.recording["measured"])
    if "volts" not in run.recording or not known.any():
        return None
    measured, volts, desired = (run.recording[name][known] for name in ("measured", "volts", "desired"))
    steps = np.diff(np.unique(measured))
    step = float(np.min(steps[steps > TINY * np.ptp(measured)], initial=np.inf))
    band = max(WITHIN * run.noise, STEPS * step if np.isfinite(step) else 0.0)
    rows, begins = at_an_end(measured, volts, desired, band, max(GOES_ON[0] * run.metrics.stroke_um, GOES_ON[1] * band))
    if not rows.any():
        return None
    share, end = float(np.mean(rows)), float(np.median(measured[rows]))
    end = 0.0 if abs(end) < band else end  # the noise about the zero
    why = "The motion there is not known"
    if begins:
        why = "It began there, so its zero is not that of the stage, and the motion is off by an unknown distance"
    return "bad" if begins or share > BLIND else "doubtful", (
        f"The sensor shows one value, {end:.3g} um, in {_percent(share)} of the ticks, while the voltage goes on: "
        f"there its range ends. {why}. Shift the range of the sensor or the motion."
    )


def _too_fast(run: _Run) -> Finding | None:
    """A motion that a volt moves less than half as far as it does slowly: the cause of what else is found then."""
    if run.rmse <= NOT_FOLLOWED * run.tolerable or "volts" not in run.recording or not run.usable.any():
        return None
    ticks = run.metrics.ticks
    desired, volts, measured = (run.recording[name] for name in ("desired", "volts", "measured"))
    second = desired[run.half] - np.mean(desired[run.half])
    periods = int(np.argmax(np.abs(np.fft.rfft(second))))
    length = second.size // max(periods, 1)
    if periods < REPEATS or length < 2:
        return None
    at = np.exp(-2j * np.pi * periods * np.arange(ticks) / second.size) * run.usable
    fast = abs(np.nansum((at * measured)[run.half])) / max(abs(np.sum((at * volts)[run.half])), TINY)
    slowly = [_means(np.where(run.usable, values, np.nan), length) for values in (volts, measured)]
    known = np.isfinite(slowly[0]) & np.isfinite(slowly[1])
    u, z = (values[known] - np.mean(values[known]) for values in slowly)
    if not np.any(u) or np.dot(u, z) < STANDS * np.sqrt(np.dot(u, u) * np.dot(z, z)):
        return None  # it never moved slowly, or not with its voltage
    share = fast / (np.dot(u, z) / np.dot(u, u))
    if share > STANDS:
        return None
    frequency = periods * ticks / second.size / run.metrics.duration_s
    return "bad", (
        f"The motion, of {frequency:.4g} Hz, is faster than the stage or its sensor: there a volt moves it "
        f"{_percent(float(share))} as far as it does slowly. Move at fewer periods, or rows, a second."
    )


def _other_unit(run: _Run) -> Finding | None:
    """A sensor that does not report in um, or has another scale: the cause of all else that is found then."""
    about = settings(run.recording, "controller")
    stroke, limits = _positive(about.get("stroke")), about.get("voltage_limits")
    known = np.isfinite(run.recording["measured"])
    if run.rmse <= run.tolerable or "volts" not in run.recording or not stroke or known.sum() < 2:
        return None
    volts, measured = (run.recording[name][known] for name in ("volts", "measured"))
    if not isinstance(limits, Sequence) or len(limits) != 2 or not np.ptp(volts) or not np.ptp(measured):
        return None
    steep, expected = float(np.std(measured) / np.std(volts)), stroke / (limits[1] - limits[0])
    if 1 / FOREIGN < steep / expected < FOREIGN or abs(np.corrcoef(volts, measured)[0, 1]) < ALIKE:
        return None
    words = f"The sensor shows {figures(steep)} um/V, where stroke and voltage limits make {figures(expected)}"
    why = taken_for_um(steep / expected, "this is not its scale")
    return "bad", f"{words}: {why}. Scale what it reports, or correct stroke and voltage limits."


def _means(values: FloatArray, length: int) -> FloatArray:
    """Of each block of so many ticks."""
    return np.asarray(values[: values.size // length * length].reshape(-1, length).mean(axis=1))


def _missed(run: _Run) -> Finding | None:
    """The error of the second half."""
    if run.rmse <= run.tolerable:
        return None
    span, stroke = run.metrics.peak_to_peak_um, run.metrics.stroke_um
    level: Level = "bad" if run.rmse > NOT_FOLLOWED * run.tolerable else "doubtful"
    of = f", {_percent(run.rmse / (span or stroke))} of the " if span or stroke else ", at rest"  # of no stroke: a PID
    whole = "motion's peak-to-peak" if span else "stroke, at rest" if stroke else ""
    return level, f"The error is {run.rmse:.3g} um rmse{of}{whole}."


def _gain(run: _Run) -> Finding | None:
    """Whether what was measured is the motion at all, also where that is small."""
    known = run.usable[run.half]
    desired, measured = (run.recording[name][run.half][known] for name in ("desired", "measured"))
    spread = float(np.std(desired)) if known.any() else 0.0
    if not spread:
        return None
    gain = float(np.mean((desired - desired.mean()) * measured)) / spread**2
    residual = measured - measured.mean() - gain * (desired - desired.mean())
    deviation = float(np.std(residual)) / spread / np.sqrt(max(1.0, known.sum() / COLOURED))
    if abs(gain - 1) < STANDS or abs(gain - 1) < SURE * deviation:
        return _hidden(run) if SURE * deviation > STANDS else None
    if run.found(_too_fast):
        return None  # above its resonance a stage goes against its voltage
    what = "the actuator did not follow, or this is not its sensor"
    if gain < -0.1 or _answers_backwards(run):
        what = "the sign of sensor or actuator is wrong"
    elif gain > 1:
        what = "the unit or the gain of sensor or actuator is wrong"
    gain = 0.0 if abs(gain) < 0.005 else gain  # no -0.00
    return "bad", f"What was measured moved {gain:.2f} times as far as desired: {what}."


def _hidden(run: _Run) -> Finding | None:
    """A motion that the sensor does not show: an actuator that stands still would do as well."""
    span = run.metrics.peak_to_peak_um
    if run.noise < HIDDEN * span:
        return None
    return "doubtful", (
        f"The motion, {span:.3g} um, is hidden by the noise of the sensor, {run.noise:.3g} um rms: the measurements do "
        "not show whether it was followed. Move further, measure for longer, or average more in the sensor."
    )


def _answers_backwards(run: _Run) -> bool:
    """Whether the displacement goes down where the voltage goes up."""
    if "volts" not in run.recording:
        return False
    volts, measured = (run.recording[name][run.usable] for name in ("volts", "measured"))
    if not np.ptp(volts) or not np.ptp(measured):
        return False
    return bool(np.corrcoef(volts, measured)[0, 1] < -STANDS)


def _unmeasured(run: _Run) -> Finding | None:
    return _unusable(~np.isfinite(run.recording["measured"]), "No measurement came in")


def _rejected(run: _Run) -> Finding | None:
    finite = np.isfinite(run.recording["measured"])
    found = _unusable(run.rejected & finite, "The controller rejected the measurement in")
    if found:
        return found
    kept = _rms(run.error[run.half])
    if run.metrics.measured_rmse_um > run.tolerable >= kept:  # the metrics hold what was rejected
        return "doubtful", f"Rejected measurements are in the measured error: without them it is {kept:.3g} um rmse."
    return None


def _unusable(ticks: npt.NDArray[np.bool_], words: str) -> Finding | None:
    share = float(np.mean(ticks))
    if share <= UNSEEN:
        return None
    return "bad" if share > BLIND else "doubtful", f"{words} {_percent(share)} of the ticks."


def _heard(run: _Run, what: str, least: float) -> tuple[float, float] | None:
    """Frequency, Hz, and amplitude, um, of a tone that the controller heard, where it exceeds so many um.

    None in a run that was not followed at all: it has lines that nothing else makes.
    """
    if any(found and found[0] == "bad" for found in map(run.found, (_saturated, _gain))):
        return None
    heard = _of_axis(run.recording, what)
    frequency, amplitude = (
        _positive(heard.get(name)) if isinstance(heard, Mapping) else None for name in ("frequency_hz", "amplitude_um")
    )
    return (frequency, amplitude) if frequency and amplitude and amplitude > least else None


def _shaken(run: _Run) -> Finding | None:
    """Whether a load of one frequency, which the controller heard, may be why the error is large, or learning fails."""
    heard = _heard(run, "load", run.tolerable)
    disturbed = run.rmse > run.tolerable or run.metrics.restored_ticks or _many_changes(run)
    if not heard or not disturbed:
        return None
    line = f"{heard[0]:.3g}"
    return "doubtful", (
        f"A load of {line} Hz and {heard[1]:.2g} um shakes the stage: a pump, a fan, the mains. Stop what makes it, "
        f"or name it, so that it is taken away from the beginning: `hum = [{line}]` (Hz) of the controller."
    )


def _not_in_dynamics(run: _Run) -> Finding | None:
    """Whether a tone beyond the resonance, which the controller heard, shows that the given dynamics lack a mode."""
    heard = _heard(run, "beyond_resonance", MATTERS * run.tolerable)
    if not heard:
        return None
    return "doubtful", (
        f"The stage rang at {heard[0]:.4g} Hz with {heard[1]:.2g} um, beyond its first resonance, and the dynamics "
        "that were given do not have that: a further mode. Law and feedback worked without it from then on. Measure "
        "the dynamics again, with the load in place: `truestroke bode`."
    )


def _oscillated(run: _Run) -> Finding | None:
    """Whether the kernel detected an oscillation that the law excites."""
    count = run.metrics.oscillating_ticks
    if not count:
        return None
    share, frequency = _percent(count / run.metrics.ticks), _resonance(run.recording)
    at, setting = (f" at about {frequency} Hz", f" = {frequency}") if frequency else ("", "")
    return "doubtful", (
        f"The controller excited an oscillation of the stage{at}, and was stopped in {share} of the ticks. Set "
        f"its resonance before the run: `resonance{setting}` (Hz) of the axis or controller; `truestroke commission` "
        "measures it."
    )


def _elsewhere(run: _Run) -> Finding | None:
    """A controller that goes on from an earlier run, of an actuator that began elsewhere: all of it is a change."""
    about, stroke = run.recording.metadata.get("controller"), run.metrics.stroke_um
    before = _positive(about.get("ticks_before")) if isinstance(about, Mapping) else None
    if not before or not (run.metrics.restored_ticks or _many_changes(run)):
        return None
    first = np.abs(run.recording["measured"] - run.recording["desired"])[:BEGINS]
    off = float(np.max(first[np.isfinite(first)], initial=0.0))
    if off < max(JUMPED * stroke, NOT_FOLLOWED * run.tolerable):
        return None
    return "doubtful", (
        f"The controller goes on from {before:.0f} ticks of earlier runs, but the actuator began {off:.3g} um from "
        "where they left it, and the controller took that for a change. Run a new controller, or `reset()` this one, "
        "which forgets what it learned."
    )


def _assumed(run: _Run) -> Finding | None:
    """Whether a resonance that was given may be that of another stage, where the motion is not followed or burst.

    A wrong one makes it late or lets it ring; a sensor that shows something else takes the command to a limit.
    """
    given, known = _positive(settings(run.recording, "controller").get("resonance")), _known_resonance(run.recording)
    if not given or not known:
        return None
    burst = abs(known / given - 1) > ASSUMED and (run.metrics.restored_ticks or _many_changes(run))
    if run.rmse <= run.tolerable and not burst:
        return None
    if any(run.found(check) for check in (_saturated, _unmeasured, _rejected)):
        return None
    shown = f"the measurements showed {known:.4g} Hz" if abs(known / given - 1) > ELSEWHERE else "nothing has shown it"
    return "doubtful", (
        f"The settings say resonance = {given:.4g} Hz, and {shown}. With another f0 than that of the stage, under its "
        "load, a fast motion bursts or is not followed: give that of `truestroke commission`, or leave it out."
    )


def _restored(run: _Run) -> Finding | None:
    """Whether the controller gave up what it had learned."""
    count = run.metrics.restored_ticks
    if not count or run.found(_elsewhere) or run.found(_shaken):
        return None
    return "doubtful", (
        f"Learning made the error larger: in {_percent(count / run.metrics.ticks)} of the ticks the controller held "
        "earlier weights. The stage moves faster than its model, or its sensor was wrong for a while. If it was not, "
        "measure the dynamics of the stage before the run, `truestroke bode`, or again if they are given."
    )


def _another_stage(run: _Run) -> Finding | None:
    """Whether the dynamics that were given are not those of the stage."""
    given, known = settings(run.recording, "controller").get("dynamics"), _known_resonance(run.recording)
    modes = given.get("modes") if isinstance(given, Mapping) else None
    first = modes[0] if isinstance(modes, list) and modes else None
    f0 = _positive(first.get("frequency")) if isinstance(first, Mapping) else None
    if not f0 or not known or abs(known / f0 - 1) < ELSEWHERE:
        return None
    return "doubtful", (
        f"The dynamics are of a stage with a first resonance of {f0:.4g} Hz; the measurements showed one of "
        f"{known:.4g} Hz, which took their place. Measure them again: `truestroke bode`."
    )


def _resonance(recording: Recording) -> str:
    """First resonance in the controller at the end, Hz, in two digits; empty without one."""
    found = _known_resonance(recording)
    return f"{float(f'{found:.2g}'):g}" if found else ""


def _known_resonance(recording: Recording) -> float | None:
    """First resonance in the controller at the end, Hz; None without one."""
    return _positive(_of_axis(recording, "resonance"))


def _of_axis(recording: Recording, name: str) -> Any:
    """What the metadata say at the end: of the axis, or, of a run in real time, of each one by its name."""
    known, axis = (recording.metadata.get(entry) for entry in (name, "axis"))
    of = axis.get("name") if isinstance(axis, Mapping) else None
    return known[of] if isinstance(known, Mapping) and of in known else known


def _many_changes(run: _Run) -> bool:
    return (run.metrics.changed_ticks or 0) > max(3.0, ALARMS * run.metrics.duration_s)


def _alarmed(run: _Run) -> Finding | None:
    count = run.metrics.changed_ticks or 0
    if not _many_changes(run) or run.found(_elsewhere) or run.found(_shaken):
        return None
    return "doubtful", (
        f"The controller detected {count} sudden changes of the actuator in {run.metrics.duration_s:.4g} s: the stage "
        "oscillates, or the sensor jumps."
    )


def _unsettled(run: _Run) -> Finding | None:
    """Temporary errors, which the rmse of the whole half does not show."""
    if run.metrics.duration_s < 4 * WINDOW or run.rmse > NOT_FOLLOWED * run.tolerable:
        return None
    windows = run.windows()
    half = windows.size // 2
    worst = half + int(np.argmax(windows[half:]))
    if windows[-1] > 2 * run.tolerable:
        level: Level = "bad" if windows[-1] > 2 * NOT_FOLLOWED * run.tolerable else "doubtful"
        return level, f"At the end the error was {windows[-1]:.3g} um rms over {WINDOW:g} s: it has not converged."
    if windows[worst] > 2 * run.tolerable:
        at = run.metrics.duration_s - WINDOW * (windows.size - worst)
        return "doubtful", f"From {at:.4g} s on the error was {windows[worst]:.3g} um rms over {WINDOW:g} s."
    return None


def _burst(run: _Run) -> Finding | None:
    """An error of some milliseconds, after the motion was followed: a window of 0.25 s does not show it."""
    if run.metrics.duration_s < 4 * WINDOW or run.rmse > run.tolerable or run.found(_unsettled):
        return None
    length = max(run.ticks_in(BURST), min(FEWEST, run.ticks_in(WINDOW)))
    errors, end = run.windows(length), run.metrics.ticks
    begins = np.arange(end - errors.size * length, end, length)
    errors[~_comparable(run)[begins]] = 0.0
    worst = int(np.argmax(errors))
    if errors[worst] <= 2 * run.tolerable:
        return None
    tick = run.metrics.duration_s / end
    return "doubtful", (
        f"From {tick * begins[worst]:.4g} s on the error was {errors[worst]:.3g} um rms over "
        f"{1000 * tick * length:.2g} ms, although the motion had been followed before."
    )


def _comparable(run: _Run) -> npt.NDArray[np.bool_]:
    """Ticks after a window of the motion that was followed, and not just after a jump that no actuator can follow."""
    ticks, window = run.metrics.ticks, run.ticks_in(WINDOW)
    speeds = run.speeds()
    followed = np.flatnonzero((run.windows() <= run.tolerable) & (speeds >= MOVES * speeds.max()))
    counted = np.arange(ticks) >= (ticks % window + window * (followed[0] + 1) if followed.size else ticks)
    change = change_time(run.recording)
    known = [] if change is None else [min(round(change / run.metrics.duration_s * ticks), ticks)]
    jumps = np.append(run.jumps, known).astype(np.int64)
    near = np.zeros(ticks + 1, dtype=np.int64)  # how many jumps begin, less those that end
    np.add.at(near, np.maximum(jumps - window, 0), 1)
    np.add.at(near, np.minimum(jumps + window, ticks), -1)
    return np.asarray(counted & (np.cumsum(near[:-1]) == 0))


def _beyond_resonance(run: _Run) -> Finding | None:
    """An error that rises up to the last quarter of the run, a third of it faster than the resonance that was found."""
    known, rate = _known_resonance(run.recording), run.metrics.ticks / run.metrics.duration_s
    ticks = min(run.error.size // 4, LONGEST)
    if not known or settings(run.recording, "controller").get("dynamics") or ticks * known < PERIODS * rate:
        return None
    error, desired = (_quarters(x, ticks) for x in (np.nan_to_num(run.error), run.recording["desired"]))
    frequencies, window = np.fft.rfftfreq(ticks, 1 / rate), np.hanning(ticks)
    power = 2 / (ticks * np.sum(window**2)) * np.abs(np.fft.rfft(error * window)) ** 2
    above = (frequencies > BEYOND[0] * known) & (frequencies < BEYOND[1] * known)
    if not above.any():
        return None
    parts, speeds = np.sqrt(power[:, above].sum(axis=1)), np.std(np.diff(desired), axis=1)
    counted = _quarters(np.isfinite(run.error), ticks).mean(axis=1)
    same = (speeds[:3] * AS_FAST >= speeds[3]) & (counted[:3] >= AS_MANY * counted[3])
    before = float(parts[:3][same].min()) if same.any() else float(parts[3])
    much = 3 * power[3, above].sum() > power[3].sum()
    if not much or parts[3] <= max(RISES * before, SHOWS * run.tolerable):
        return None
    highest = frequencies[above][np.argmax(power[3, above])]
    return "doubtful", (
        f"The error at {highest:.0f} Hz and about it grew from {before:.2g} to {parts[3]:.2g} um rms, above the "
        f"resonance that was found at {known:.0f} Hz: a second mode spoils the learning. Measure it, `truestroke "
        "bode`, or hold the adaptation while the error is small."
    )


def _between_periods(run: _Run) -> Finding | None:
    """An error that is another one in each period of a motion whose period is no whole number of ticks."""
    period, errors = repetition(run.recording)
    time, windows = run.recording["time"], run.windows()
    if not errors or windows.size < 4:
        return None
    rate = float((time.size - 1) / (time[-1] - time[0]))
    ticks = period * rate
    if abs(ticks - round(ticks)) < UNEVEN:
        return None
    last = float(np.median(windows[-(windows.size // 4) :]))
    if last <= max(GREW * errors[-1], MATTERS * run.tolerable):
        return None
    below, above = int(ticks), int(ticks) + 1
    return "doubtful", (
        f"The error is {last:.3g} um rms, and what of it repeats from period to period, which is learned, is "
        f"{errors[-1]:.3g} um: the period of {ticks:.4g} ticks is no whole number, so that each one has its turns "
        f"between other ticks. Take {below} or {above} ticks, {rate / below:.6g} or {rate / above:.6g} Hz, or turns "
        "that last longer."
    )


def _quarters(values: npt.NDArray[Any], ticks: int) -> npt.NDArray[Any]:
    """The end of each quarter, so many ticks long."""
    quarter = values.size // 4
    return values[values.size - 4 * quarter :].reshape(4, quarter)[:, quarter - ticks :]


def _grew(run: _Run) -> Finding | None:
    """An error that grows while the motion stays as it is: the median of the last quarter of the run, beside others."""
    if beyond := _beyond_resonance(run):
        return beyond  # which says more
    if run.found(_between_periods):
        return None
    windows = run.windows()
    quarter = windows.size // 4
    if quarter < 2:
        return None
    errors, fast, shares, smooth = (
        x[-4 * quarter :].reshape(4, quarter) for x in (windows, run.speeds(), run.counted(), run.smooth())
    )
    if not smooth.any(axis=1).all():  # as of a square wave, which jumps in each window
        smooth = np.ones_like(smooth)
    parts, speeds = (np.array([np.median(x[kept]) for x, kept in zip(y, smooth, strict=True)]) for y in (errors, fast))
    counted = np.min(shares, axis=1)
    same = (speeds[:3] * AS_FAST >= speeds[3]) & (counted[:3] >= AS_MANY * counted[3])
    before = float(parts[:3][same].min()) if same.any() else float(parts[3])
    if parts[3] <= max(GREW * before, MATTERS * run.tolerable):
        return None
    return "doubtful", (
        f"The error grew from {before:.3g} to {parts[3]:.3g} um rms while the motion became no faster: the actuator "
        "has changed, or the stage has what its model has not, such as a second mode. Measure it: `truestroke bode`."
    )


CHECKS: Sequence[Check] = (
    _ending,
    _at_an_end,
    _too_fast,
    _saturated,
    _missed,
    _gain,
    _unmeasured,
    _rejected,
    _shaken,
    _not_in_dynamics,
    _oscillated,
    _another_stage,
    _assumed,
    _elsewhere,
    _restored,
    _unsettled,
    _burst,
    _between_periods,
    _grew,
    _slewed,
    _alarmed,
)

OTHER_CAUSES = (
    _too_fast, _shaken, _not_in_dynamics, _oscillated, _another_stage, _assumed, _elsewhere, _restored, _grew, _alarmed,
)  # fmt: skip
"""What a sensor at an end of its range brings about, and what they would put it down to."""


def _rms(error: FloatArray) -> float:
    """Of what is no NaN; 0 where there is nothing."""
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def _percent(part: float) -> str:
    return f"{100 * part:.3g} %" if part < 10 else f"{100 * part:.0f} %"
