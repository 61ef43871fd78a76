"""Where a limit of the voltage or of its slew keeps a waveform from the motion, and whether it is to be used."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control.interval import BEYOND
from truestroke.control.spans import Beyond, Span, in_words, spans
from truestroke.signals import metrics
from truestroke.signals.judgement import HIDDEN, LIMITED, NOT_FOLLOWED, STUCK

if TYPE_CHECKING:
    from truestroke.control.actuator import ActuatorModel

LAGS = 3.0  # time constants after which a lag has forgotten a limit
NOTICED = 1e-4  # of the stroke: an error at a limit that is smaller is not reported
FASTER = 10.0  # times the record: of such a speed it shows nothing, however small its error is
SLEWED = 1 - 1e-9  # of the slew limit: a voltage that is as fast is held back by it
OF_A_LIMIT = "out of reach: a voltage limit bounds it", "too fast: the slew limit bounds it"

Finding = tuple[Level, str]


@dataclass(frozen=True)
class Held:
    """Spans in which a limit holds the voltage back, each with the largest error there, um.

    Attributes
    ----------
    out_of_reach, too_fast : tuple[Span, ...]
        By a voltage limit, and by the slew limit.
    """

    out_of_reach: tuple[Span, ...]
    too_fast: tuple[Span, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """In words, where there are any."""
        both = zip(OF_A_LIMIT, (self.out_of_reach, self.too_fast), strict=True)
        return tuple(words for what, found in both if (words := in_words(what, found, "off by at most", "um")))

    @property
    def worst(self) -> float:
        """The largest error of all, um."""
        return max((span.worst for span in (*self.out_of_reach, *self.too_fast)), default=0.0)


@dataclass(frozen=True, eq=False)
class Made:
    """A voltage, and the motion that it is for.

    Attributes
    ----------
    volts, desired, predicted : ndarray, shape (samples,)
        V; what the sensor should read, and what the model predicts that it reads, um.
    sample_rate : float
        Hz.
    voltage_limits : tuple[float, float]
        V.
    slew_limit : float
        V/s.
    """

    volts: FloatArray
    desired: FloatArray
    predicted: FloatArray
    sample_rate: float
    voltage_limits: tuple[float, float]
    slew_limit: float

    def held_back(self, model: "ActuatorModel") -> Held:
        """Where the voltage is at a limit, or was within dead time and lag, and the motion is not as desired."""
        off = np.abs(self.predicted - self.desired)
        short = off - NOTICED * model.stroke
        fs, (low, high) = self.sample_rate, self.voltage_limits
        late = math.ceil((model.delay + LAGS * model.time_constant) * fs)
        at_limit = _lasting(self.volts <= low, late) & (self.predicted > self.desired)
        at_limit |= _lasting(self.volts >= high, late) & (self.predicted < self.desired)
        rate = np.abs(np.diff(self.volts, prepend=self.volts[:1])) * fs
        slewed = _lasting(rate >= self.slew_limit * SLEWED, late)
        return Held(spans(np.where(at_limit, short, 0.0), fs, off), spans(np.where(slewed, short, 0.0), fs, off))


def at_a_limit(volts: FloatArray, sample_rate: float, limits: tuple[float, float], slew_limit: float) -> bool:
    """Whether a voltage, V, is at one of its limits, or as fast as the slew limit, V/s, in any sample."""
    if not volts.size:
        return False
    low, high = limits
    fastest = float(np.abs(np.diff(volts)).max(initial=0.0)) * sample_rate
    return bool(volts.min() <= low or volts.max() >= high or fastest >= slew_limit * SLEWED)


def _lasting(held: npt.NDArray[np.bool_], late: int) -> npt.NDArray[np.bool_]:
    """Where a voltage that is held back may still be seen: in its sample, and in so many after it.

    >>> _lasting(np.array([False, True, False, False]), 1).tolist()
    [False, True, True, False]
    """
    return np.asarray(np.convolve(held, np.ones(late + 1))[: held.size] > 0.5)


# ---- The verdict ---------------------------------------------------------------------------------------------------


def tolerable(model: "ActuatorModel", desired: FloatArray) -> float:
    """Error that a good waveform may have, um: that of a run, of a motion that is no longer than the stroke."""
    return metrics.tolerable(min(float(np.ptp(desired)), model.stroke), model.stroke, model.noise)


def judged(model: "ActuatorModel", made: Made, held: Held, beyond: Beyond, *, measured: bool) -> Verdict:
    """Whether a waveform makes its motion.

    Good is one that no limit holds back, of a good model, on a motion as that of its record. Where a pass of the motion
    was `measured` before, only limits and the prediction are judged.
    """
    least = tolerable(model, made.desired)
    found = [*_of_limits(model, made, held, least)] or [*_of_error(made, least)]
    if not measured:
        found += [*_of_extrapolation(model, made, beyond, least), *_of_model(model, made, least)]
    return Verdict.of(found)


def _level(error: float, least: float) -> Level:
    return "bad" if error > NOT_FOLLOWED * least else "doubtful"


def _share(error: float, made: Made) -> str:
    span = float(np.ptp(made.desired))
    return f"{figures(error)} um" + (
        f", {figures(100 * error / span, 2)} % of the motion's peak-to-peak" if span else ""
    )


def _of_limits(model: "ActuatorModel", made: Made, held: Held, least: float) -> Iterator[Finding]:
    low, high = made.voltage_limits
    worst = max((span.worst for span in held.out_of_reach), default=0.0)
    if worst > least:
        whose = ", those of the model's record" if (low, high) == model.voltage_range else ""
        yield (
            _level(worst, least),
            f"The motion is out of reach of {low:.4g} to {high:.4g} V{whose}: off by up to {_share(worst, made)}. "
            f"{_asked(made, held, least)} Move it, make it smaller, or give other `voltage_limits`, which actuator and "
            "amplifier have to stand.",
        )
    worst = max((span.worst for span in held.too_fast), default=0.0)
    share = sum(span.stop - span.start for span in held.too_fast) * made.sample_rate / made.volts.size
    if worst > least and share > LIMITED:
        yield (
            "bad" if share > STUCK else "doubtful",
            f"The slew limit holds the motion back in {figures(100 * share, 2)} % of the time, by up to "
            f"{_share(worst, made)}: make it slower, or raise the limit.",
        )


def _asked(made: Made, held: Held, least: float) -> str:
    """What it asks for, and what is predicted: as ranges, or where it is worst if the range is reached elsewhere."""
    asked, reached = made.desired, made.predicted
    if max(reached.min() - asked.min(), asked.max() - reached.max()) > least / 2:
        ranges = (f"{z.min():.4g} to {z.max():.4g} um" for z in (asked, reached))
        return "It asks for {}, and {} are predicted.".format(*ranges)
    worst = max(held.out_of_reach, key=lambda span: span.worst)
    first, end = (round(t * made.sample_rate) for t in (worst.start, worst.stop))
    k = first + int(np.argmax(np.abs(reached - asked)[first:end]))
    return f"At {k / made.sample_rate:.4g} s it asks for {asked[k]:.4g} um, and {reached[k]:.4g} um are predicted."


def _of_error(made: Made, least: float) -> Iterator[Finding]:
    rmse = metrics.rmse(made.desired, made.predicted)
    if rmse > least:
        yield _level(rmse, least), f"The predicted error is {_share(rmse, made)}, rms."


def _of_extrapolation(model: "ActuatorModel", made: Made, beyond: Beyond, least: float) -> Iterator[Finding]:
    """An error by voltage as the interval has it; one that grows with the speed may hide in the error of the model."""
    low, high = model.voltage_range
    outside = max((span.worst for span in beyond.voltage), default=0.0) / (high - low)
    if (error := BEYOND * model.stroke * outside) > least:
        yield (
            _level(error, least),
            f"The voltage is beyond that of the model's record, {low:.4g} to {high:.4g} V, by up to "
            f"{figures(100 * outside, 2)} % of its range: no record shows what the actuator does there. Record that "
            "range, and identify anew.",
        )
    faster = max((span.worst for span in beyond.velocity), default=0.0)
    times = 1 + faster / model.fastest if model.fastest and faster else 0.0
    hidden = max(times * (error_of(model) or model.noise), _late(model, made))
    if times and (hidden > least or times > FASTER):
        yield (
            _level(hidden, least),
            f"The motion is {figures(times, 2)} times as fast as the model's record: an error that grows with the "
            f"speed, such as that of a lag, may be {_share(hidden, made)}, and the record would not show it. Record "
            "motion that is as fast, and identify anew.",
        )
    above = max((span.worst for span in beyond.frequency), default=0.0)
    if above > least:
        yield (
            "doubtful",
            f"Turns or steps have motion of up to {_share(above, made)}, above {figures(beyond.tested_frequency)} Hz, "
            "where the record tests no response: a stage may ring there. Record such a motion, or make its turns "
            "longer.",
        )


def _late(model: "ActuatorModel", made: Made) -> float:
    """Rms error of a lag that the record leaves open, um: other weights make up for it at its own speed alone."""
    speed = np.gradient(made.predicted) * made.sample_rate
    return float(np.max(model.deviations[model.columns["lag"]]) * np.sqrt(np.mean(speed**2)))


def error_of(model: "ActuatorModel") -> float | None:
    """Rmse of the model where it last met the actuator, um: held out by `identify`, or of the last pass."""
    return model.metrics.get("held_out_rmse_um", model.metrics.get("prediction_rmse_um"))


def inherited(model: "ActuatorModel") -> Iterator[Finding]:
    """What speaks against the model speaks against all that is made with it."""
    if (verdict := model.verdict).level != "good":
        yield (
            verdict.level,
            f"The verdict of the model is {verdict.level}: {' '.join(verdict.reasons[:1])}".rstrip(": "),
        )


def _of_model(model: "ActuatorModel", made: Made, least: float) -> Iterator[Finding]:
    yield from inherited(model)
    error = error_of(model) or model.noise
    if error > least:
        yield (
            _level(error, least),
            f"The error of the model itself is {_share(error, made)}, rms: correct the waveform pass by pass, with "
            "`truestroke refine`, or identify a better model.",
        )
    elif 0.0 < (span := float(np.ptp(made.desired))) < error / HIDDEN:
        yield (
            "doubtful",
            f"The motion, {span:.3g} um, is hidden by the error of the model itself, {figures(error)} um rms: it "
            "may be all wrong. Is the motion in um? Else move further.",
        )
