"""How far the sensor may be from a prediction: 95 % intervals that grow with the time since the record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truestroke import _kernel
from truestroke.base.typing import FloatArray
from truestroke.control.explored import places
from truestroke.model.models import Motion, asymmetry_slopes, known_terms, play_terms
from truestroke.model.sampled import central_difference, creep_states

if TYPE_CHECKING:
    from truestroke.control.actuator import ActuatorModel

COVERED = 1.96  # standard deviations: 95 %
OF_ZERO = 2.45  # the same of the zero, by Student with six degrees of freedom: a record shows few ways of it
BEYOND = 0.2  # of the stroke: the deviation of the error at a voltage that is a voltage range beyond the record
USUAL = 2.5  # standard deviations of the difference between branches and plays in the record: no more is doubted
CREEP = 0.01  # of the stroke in each decade of time: 0.01 to 0.02 in stacks (Jung and Gweon 2000)
OF_LAG = 2.0  # deviations of the lag by which motion that is faster than the record may be late
OF_RESPONSE = 0.15  # of 1 / (2 pi F): the same by a response that the record does not test
INNER = 1.33  # of the loop's height at a voltage, and of its mean height over the stroke: the deviation inside of it
WIDEST = 0.6  # of that height: the same at most
HIGHER = 1.5  # times the loop of the record: a model whose loop is higher has it at the speed of a step
INSIDE = 0.1  # of the voltage range: so far from the loop of the record motion is inside of it
SHOWN = 0.15  # of later rows are inside of loops before: then their errors count as much as the height of the loop
LOOP = 200  # samples of a stroke
TRAVEL = 0.98  # of a record's travel is no faster than the speed that it shows: one step shows no speed
POINTS = 4000  # at most, at which the part of the weights is computed; straight lines between them


@dataclass(frozen=True)
class InnerLoops:
    """What later blocks of a record show of loops inside of those before them.

    Attributes
    ----------
    inner : float
        Deviation of the error over the height of the loop there, as `Explored.inner`.
    share : float
        Mean of min(d / INSIDE, 1) over their rows, d the distance from what the blocks before show: 0 of one sine.
    """

    inner: float
    share: float


def of_weights(
    model: ActuatorModel,
    volts: FloatArray,
    sample_rate: float,
    strain: FloatArray,
    P: FloatArray,
    centred: bool = False,
) -> FloatArray:
    """Variance of the prediction by that of the weights, diag(J P J'), um^2, shape (samples,).

    J is the derivative of the prediction by the weights, P their covariance. With `centred` the part that moves all
    samples alike is not in it: the mean of each column is removed. `strain` is that of the model.
    """
    if not volts.size:
        return volts
    every = -(-volts.size // POINTS)
    J = _derivative(model, volts, sample_rate, strain, every)
    if centred:
        J = J - J.mean(axis=0)
    late = (model.delay + model.time_constant) * sample_rate
    places = np.arange(0, volts.size, every)
    return np.asarray(np.interp(np.arange(volts.size) - late, places, np.sum(J @ P * J, axis=1)))


def of_motion(
    model: ActuatorModel, volts: FloatArray, sample_rate: float, P: FloatArray | None = None, centred: bool = False
) -> FloatArray:
    """Variance of the prediction error whatever the time, um^2, shape (samples,).

    ::

        J P J' + noise^2 + (jitter v)^2 + (growth d)^2

    v is the velocity of the strain, d the distance of the motion from all that the record shows (`model.explored`); P
    the covariance of the model if none is given, and `centred` as in `of_weights`.
    """
    strain = model.strain(volts, sample_rate)
    v = central_difference(strain, sample_rate)
    weights = of_weights(model, volts, sample_rate, strain, model.covariance if P is None else P, centred)
    return np.asarray(weights + model.noise**2 + (model.jitter * v) ** 2 + _of_distance(model, volts, v))


def _of_distance(model: ActuatorModel, volts: FloatArray, v: FloatArray) -> FloatArray:
    """Variance of the error by the distance from what the record shows, um^2, shape (samples,)."""
    if model.explored is None or not volts.size:
        return np.zeros_like(volts)
    every = -(-volts.size // POINTS)
    at = places(volts, v, model.voltage_range, model.velocity, every)
    away = model.explored.growth * model.explored.distance(at)
    return np.interp(np.arange(volts.size), np.arange(0, volts.size, every), away**2)


def beyond(model: ActuatorModel, volts: FloatArray) -> FloatArray:
    """Variance of the error beyond the voltages of the record, (BEYOND stroke b)^2, um^2, shape (samples,).

    b is how far the voltage is from those of the record (`model.explored`), over their range.
    """
    if model.explored is None:
        return np.zeros_like(volts)
    low, high = model.voltage_range
    return np.asarray((BEYOND * model.stroke * model.explored.beyond(volts / (high - low))) ** 2)


def _derivative(model: ActuatorModel, x: FloatArray, fs: float, z: FloatArray, every: int) -> FloatArray:
    """J at every `every`-th sample of the strain z, before delay, lag and stage."""
    rate = model.seen(central_difference(z, fs))[::every]
    H = np.empty((-(-x.size // every), len(model.thresholds)))
    _kernel.play_history(np.ascontiguousarray(x), np.array(model.thresholds), np.zeros(H.shape[1]), every, H)
    creep = [c[::every] for c in creep_states(x, model.creep_times, fs)]
    known = known_terms(model, creep, Motion(z[::every], rate), model.stroke)
    J = np.vstack([play_terms(model, H.T, model.rate_scale * rate), known]).T
    asymmetry = model.weights[model.columns["asymmetry"]]
    slope = 1 - asymmetry @ asymmetry_slopes(z[::every], model.stroke)[: len(asymmetry)]
    return np.asarray(J / np.maximum(slope, 0.1)[:, None])


def apart(
    model: ActuatorModel, volts: FloatArray, sample_rate: float, predicted: FloatArray | None = None
) -> FloatArray:
    """Variance by which plays alone predict otherwise than branches do, um^2, shape (samples,).

    The square of their difference, beyond that in the record: noise^2 of the plays less noise^2 of the branches, times
    `USUAL`^2. Branches follow a record more closely, and may be wrong where it has not been. `predicted` is what the
    model predicts, where that is known.
    """
    if model.plain is None:
        return np.zeros_like(volts)
    predicted = model.forward(volts, sample_rate) if predicted is None else predicted
    differs = predicted - model.plain.forward(volts, sample_rate)
    usual = max(model.plain.noise**2 - model.noise**2, 0.0)
    return np.asarray(np.maximum(differs**2 - USUAL**2 * usual, 0.0))


def of_speed(model: ActuatorModel, volts: FloatArray, sample_rate: float) -> FloatArray:
    """Variance of the error of motion that is faster than the record shows, um^2, shape (samples,).

    ::

        late^2 s^2,      late^2 = lag^2 + (OF_LAG sigma)^2 + (OF_RESPONSE / (2 pi F))^2

    s is by how much the strain is faster than `model.usual_velocity`, the largest within 1 / F about each sample, for
    what is late goes on at a turn. F is the frequency up to which the record tests the response; lag the weight, sigma
    its deviation: the record knows it together with other weights, which make up for it at its own speed alone, and
    beyond the fastest of the record the prediction has `proven_lag` of it.
    """
    usual, F = model.usual_velocity or model.velocity, model.tested_frequency
    faster = np.maximum(np.abs(central_difference(model.strain(volts, sample_rate), sample_rate)) - usual, 0.0)
    if not usual or not faster.any():
        return np.zeros_like(volts)
    lag = model.columns["lag"]
    late = np.sum(model.weights[lag] ** 2 + (OF_LAG * model.deviations[lag]) ** 2)
    if F:
        from scipy.ndimage import maximum_filter1d

        late += (OF_RESPONSE / (2 * math.pi * F)) ** 2
        faster = maximum_filter1d(faster, min(math.ceil(sample_rate / F), faster.size), mode="nearest")
    return np.asarray(late * faster**2)


def inner(model: ActuatorModel, width: float = math.inf, shown: InnerLoops | None = None) -> float:
    """`Explored.inner` of the model of a record with one family of loops: `INNER` of their mean height over the stroke.

    What makes the largest loop wider than that of stacks makes inner loops less like it: friction, saturation. Where
    later blocks are inside of loops before them and are predicted better, it is the geometric mean of both (`SHOWN`).

    Parameters
    ----------
    model : ActuatorModel
        Of the record.
    width : float
        Mean height of the loop in the record, um. Where that of the model is more than `HIGHER` times as high, its pace
        is that of steps, at which what is late is further apart than the loop: the share is of the record's, or of the
        model's without what is late, if that is higher, as of strokes that decay.
    shown : InnerLoops, optional
        By later blocks of the record.
    """
    at = np.linspace(*model.voltage_range, LOOP)
    mean = seen = float(_height(model, at).mean())
    if mean > HIGHER * width:
        seen = max(width, float(_height(model.replace(delay=0.0, time_constant=0.0), at).mean()))
    usual = min(INNER * seen / model.stroke, WIDEST) * (seen / mean if mean else 1.0)
    if shown is None or shown.inner >= usual:
        return usual
    exponent = 0.5 * min(shown.share / SHOWN, 1.0) ** 3  # of one sine, with noise, the share is 0.02 to 0.05
    return float(usual ** (1 - exponent) * shown.inner**exponent)


def of_inner_loops(model: ActuatorModel, volts: FloatArray, sample_rate: float) -> FloatArray:
    """Variance of the error inside of the loop of a record that has no other, um^2, shape (samples,).

    ::

        (inner height min(d / INSIDE, 1))^2

    height is how far the branches of the model's largest loop are apart at the voltage, um, d the distance from what
    the record shows. Of actuators of another structure inner loops are somewhere within the largest one, and the record
    does not say where.
    """
    if model.explored is None or not model.explored.inner or not volts.size:
        return np.zeros_like(volts)
    v = central_difference(model.strain(volts, sample_rate), sample_rate)
    every = -(-volts.size // POINTS)
    away = model.explored.distance(places(volts, v, model.voltage_range, model.velocity, every))
    inside = model.explored.inner * inside_of(model, volts[::every], away)
    return np.interp(np.arange(volts.size), np.arange(0, volts.size, every), inside**2)


def inside_of(model: ActuatorModel, volts: FloatArray, distance: FloatArray) -> FloatArray:
    """height min(d / INSIDE, 1) at these voltages, um: what `Explored.inner` is a share of."""
    return _height(model, volts) * np.minimum(distance / INSIDE, 1.0)


def _height(model: ActuatorModel, volts: FloatArray) -> FloatArray:
    """How far the branches of the model's largest loop are apart at these voltages, um; at the pace of the record.

    What is late belongs to it: one loop does not separate it from hysteresis.
    """
    up, usual = np.linspace(*model.voltage_range, LOOP), model.usual_velocity or model.velocity
    rate = LOOP * usual / model.stroke or 1.0
    loop = model.strain(np.concatenate([up, up[::-1], up, up[::-1]]), rate)[2 * LOOP :]
    late = 2 * (model.delay + model.time_constant) * usual
    return np.asarray(np.abs(np.interp(volts, up, loop[LOOP:][::-1] - loop[:LOOP]) + late))


def shown_velocity(velocity: FloatArray) -> float:
    """The speed that all but a fiftieth of a record's travel has at most, of its velocities, both um/s.

    Examples
    --------
    >>> one_step = np.append(np.full(1000, 1.0), 20.0)
    >>> shown_velocity(one_step), shown_velocity(np.append(one_step, 20.0))
    (1.0, 20.0)
    """
    speed = np.sort(np.abs(velocity))
    travel = np.cumsum(speed)
    return float(speed[np.searchsorted(travel, TRAVEL * travel[-1])]) if speed.size else 0.0


def unshown(
    model: ActuatorModel, volts: FloatArray, sample_rate: float, predicted: FloatArray | None = None
) -> FloatArray:
    """Variance of what blocks of a record do not show, um^2, shape (samples,): `apart`, `of_speed` and `beyond`."""
    return apart(model, volts, sample_rate, predicted) + of_speed(model, volts, sample_rate) + beyond(model, volts)


def half_width(
    model: ActuatorModel,
    volts: FloatArray,
    sample_rate: float,
    zero: FloatArray,
    predicted: FloatArray | None = None,
) -> FloatArray:
    """Of the 95 % interval, um, shape (samples,), with the variance of the zero, um^2.

    The factor of the motion is that of cross-validation, whose errors have nothing that is `unshown`; `predicted` as of
    `apart`. It is no less than that of inner loops, where the record has none.
    """
    motion = model.coverage_factor**2 * of_motion(model, volts, sample_rate)
    more = unshown(model, volts, sample_rate, predicted)
    least = COVERED**2 * of_inner_loops(model, volts, sample_rate)
    return np.asarray(np.sqrt(np.maximum(motion + COVERED**2 * more + OF_ZERO**2 * zero, least)))


def of_walk(model: ActuatorModel, time: FloatArray) -> FloatArray:
    """Variance of a zero that walks, or moves steadily, um^2, at times of 0 and more, s.

    It is the larger of walk^2 t and (trend t)^2; a trend goes on for as long as the record at most, then as a walk.
    """
    steady = time * np.minimum(time, model.duration) if model.duration else time**2
    return np.asarray(np.maximum(model.walk**2 * time, model.trend**2 * steady))


def of_zero(model: ActuatorModel, time: FloatArray) -> FloatArray:
    """Variance of the zero, um^2, at times after the end of the record, s: `of_walk` + (drift t)^2 + creep^2.

    Creep that is slower than the record is not in the model. It goes on with the logarithm of the time: `CREEP` of the
    stroke in each tenfold of the record's duration, or as far as the model's own largest creep state.
    """
    t = np.maximum(time, 0.0)
    decades = np.log10(np.maximum(t / model.duration, 1.0)) if model.duration else 0.0
    low, high = model.voltage_range
    own = float(np.abs(model.weights[model.columns["creep"]]).max(initial=0.0)) * (high - low)
    creep = max(CREEP * model.stroke, own)
    return np.asarray(of_walk(model, t) + (model.drift * t) ** 2 + (creep * decades) ** 2)
