"""From a record to a model: structure by blocked cross-validation, then the weights and how well they are known."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke import _check
from truestroke._check import SettingError
from truestroke._typing import FloatArray
from truestroke.identification import normal, uncertainty
from truestroke.identification.actuator import ActuatorModel, bend_slopes, play_sum
from truestroke.identification.regression import Data, Structure, delayed, even_thresholds, plays, rated

SAMPLES = 500_000  # of the record at most: longer ones are replaced by means over blocks
ROWS = 50_000  # of the regression at most: beyond, every so many samples; the plays see all of them
BLOCKS = 6  # of the cross-validation: each but the first two is predicted from those before it
FIRST = 2
PLAYS = (8, 16, 24)
REACHES = (0.36, 0.48)  # of the voltage range: thresholds end below this; none beyond 0.5 ever moves
PLAYS_FROM_REST = (16, 32)
REACHES_FROM_REST = (0.6, 0.9)  # the same where the first way up from rest is in the fit
AT_REST = 0.02  # of the voltage range: a record that starts nearer to 0 V may start at rest
FROM_REST = 0.5  # and is taken to, unless that makes the rmse twice as large: a controller starts at rest, too
CREEP_TIMES = (0.003, 0.03, 0.3, 3.0, 30.0)  # s
WEIGHTS = (1.0, 10.0, 100.0)  # of the prior, beyond the noise of the first fit
BETTER = 0.99  # a sample of delay must lower the rmse at least this far
ENOUGH = 1.1  # of the least rmse: the most terms that do not exceed it, as by one standard error
LONGEST_DELAY = 0.1  # s
NEAR = 0.25  # of the stroke
QUICK = 16  # plays of the first fit
STEPS = 2  # Gauss-Newton
FLOOR = 0.05  # of the straight line's slope: the smallest partial slope


@dataclass(frozen=True)
class HeldOut:
    """How well a model predicts, from voltage alone, the last part of a record that no choice has seen.

    Attributes
    ----------
    rmse_um, maximum_um : float
        Root mean square and largest magnitude of the error, um.
    rmse_percent, maximum_percent : float
        The same in % of the peak-to-peak displacement of the record.
    samples : int
        Length of that part.
    """

    rmse_um: float
    maximum_um: float
    rmse_percent: float
    maximum_percent: float
    samples: int


@dataclass(frozen=True, eq=False)
class Identified:
    """What `identify` found.

    Attributes
    ----------
    model : ActuatorModel
        Fitted to the whole record, with covariance, figures and provenance.
    held_out : HeldOut
        Of a model of the same structure that was fitted without the last part of the record.
    residual : ndarray, shape (rows,)
        What the model leaves of the rows it was fitted to, um.
    effective_samples : float
        How many independent samples the rows count for.
    tried : tuple of (str, float)
        What cross-validation compared, in its order: structure in words, rmse, um.
    """

    model: ActuatorModel
    held_out: HeldOut
    residual: FloatArray
    effective_samples: float
    tried: tuple[tuple[str, float], ...]


def identify(
    record: Any,
    *,
    rate: bool | None = None,
    creep_times: Sequence[float] | None = None,
    bends: int | None = None,
    thresholds: Sequence[float] | None = None,
    delay: float | None = None,
    held_out: float = 0.4,
) -> Identified:
    """The model of an actuator from a record of voltage and displacement.

    Least squares that are pulled to the prior of the controller, all partial slopes positive at every velocity of the
    record. What is left out of the arguments is chosen by blocked cross-validation within the first part of the
    record; the last part gives the figures of `HeldOut`.

    Parameters
    ----------
    record : Record or tuple
        An object with `volts` (V), `displacement` (um), `sample_rate` (Hz) and perhaps `segments` and `source`, or
        the first three of them. Of several segments the longest is taken; beyond 500,000 samples, means over blocks.
    rate : bool, optional
        Whether the weights know the rate.
    creep_times : sequence of float, optional
        Time constants of the creep states, s; () is no creep.
    bends : int, optional
        Terms of asymmetry, 0 to 2.
    thresholds : sequence of float, optional
        r of the plays, V, ascending from 0.
    delay : float, optional
        Between voltage and displacement, s.
    held_out : float
        Share of the record at its end that is held out, above 0, at most 0.5.

    Raises
    ------
    SettingError
        An argument is out of bounds, the record is too short, voltage or displacement does not move, or the
        displacement falls where the voltage rises.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> x = 1.5 - 1.5 * np.cos(2 * np.pi * t) * np.cos(0.8 * t)
    >>> found = identify((x, 10.0 * x, 1000.0))
    >>> round(found.held_out.rmse_percent, 2), found.model.predict([0.0, 1.0], 1000.0).round(1)
    (0.0, array([ 0., 10.]))
    """
    x, z, fs, source = _taken(record)
    share = _check.within("held_out", held_out, 0.01, 0.5)
    train = round((1 - share) * x.size)
    shift = None if delay is None else round(_check.within("delay", delay, 0.0, x.size / fs / 4, "s") * fs)
    fixed = {
        "rate": rate,
        "creep_times": creep_times,
        "bends": None if bends is None else _check.count("bends", bends, 0, 2),
        "thresholds": thresholds,
    }
    first = _data(x[:train], z[:train], fs)
    data, guess, shift = _delay(first, x[:train], shift)
    structure, weight, tried = _choose(data, guess, fixed)
    part = _fit(data, structure, weight, guess, shift / fs, certain=False)
    error = z[train:] - part.model.predict(x, fs)[train:]
    figures = _held_out(error, float(np.ptp(z)))

    whole = _data(x, z, fs, shift)
    final = _fit(whole, structure, weight, _quick(whole)[0], shift / fs)
    model = _documented(final, figures, source, x.size, fs)
    return Identified(model, figures, final.residual, uncertainty.effective_samples(final.residual), tried)


# ---- The record ----------------------------------------------------------------------------------------------------


def _taken(record: Any) -> tuple[FloatArray, FloatArray, float, str]:
    """Voltage, displacement, sample rate and source of the longest segment."""
    if isinstance(record, tuple):
        volts, displacement, sample_rate = record
        source, segments = "", ()
    else:
        volts, displacement, sample_rate = record.volts, record.displacement, record.sample_rate
        source, segments = str(getattr(record, "source", "")), getattr(record, "segments", ())
    if segments:
        longest = max(segments, key=lambda s: s.stop - s.start)
        volts, displacement = volts[longest], displacement[longest]
    x, z = _check.finite_array("volts", volts, "V"), _check.finite_array("displacement", displacement, "um")
    if z.size != x.size:
        raise SettingError("displacement", f"array of {z.size} samples", f"as long as volts, {x.size} samples", "um")
    if x.size < 200:
        raise SettingError("volts", f"array of {x.size} samples", "a record of at least 200 samples")
    for name, value, unit in (("volts", x, "V"), ("displacement", z, "um")):
        if np.ptp(value) <= 1e-12 * np.abs(value).max():
            raise SettingError(name, f"{value[0]:g} throughout", "a record that moves", unit)
    if np.cov(x, z)[0, 1] <= 0:
        raise SettingError("displacement", "falls where volts rises", "one that rises; swap its sign", "um")
    fs, block = _check.positive("sample_rate", sample_rate, "Hz"), -(-x.size // SAMPLES)
    x, z = (a[: a.size // block * block].reshape(-1, block).mean(axis=1) for a in (x, z))
    return x, z, fs / block, source


def _data(x: FloatArray, z: FloatArray, fs: float, shift: int = 0) -> Data:
    """The zero is the sensor's own where the record comes near it, else the straight line's displacement at 0 V."""
    stroke = float(np.ptp(z))
    every = -(-x.size // ROWS)
    near = z.min() - NEAR * stroke <= 0 <= z.max() + NEAR * stroke
    zero = 0.0 if near else float(np.polyfit(x, z, 1)[1])
    return Data(
        volts=delayed(x, shift),
        displacement=(z - zero)[::every],
        sample_rate=fs,
        every=every,
        voltage_range=(float(x.min()), float(x.max())),
        stroke=stroke,
        zero=zero,
    )


def _held_out(error: FloatArray, stroke: float) -> HeldOut:
    rmse, maximum = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return HeldOut(rmse, maximum, 100 * rmse / stroke, 100 * maximum / stroke, error.size)


# ---- Choices -------------------------------------------------------------------------------------------------------


def _quick(data: Data) -> tuple[FloatArray, float]:
    """A first prediction, um, at the full rate, by plays alone; and the rmse of its fit, um."""
    span = data.voltage_range[1] - data.voltage_range[0]
    s = Structure(thresholds=even_thresholds(QUICK, 0.5 * span))
    rows = np.column_stack(
        [plays(data.volts, s.thresholds, data.every), np.ones(len(data.displacement)), data.displacement]
    )
    rows = rows[data.settled() :]
    names = s.names
    believed = data.prior(s).part(np.array([*range(QUICK), names.index("offset")]))
    c = normal.solve(np.vstack([normal.reduced(rows), believed.rows((0.01 * data.stroke) ** 2)]))
    prediction = play_sum(data.volts, 0.0, c[:-1], np.zeros(QUICK), s.thresholds) + c[-1]
    return prediction, float(np.sqrt(normal.sum_of_squares(rows, c) / len(rows)))


def _delay(data: Data, x: FloatArray, shift: int | None) -> tuple[Data, FloatArray, int]:
    """The delay in samples with the smallest rmse of the first fit, found by halving steps."""

    def at(samples: int) -> tuple[Data, FloatArray, float]:
        moved = dataclasses.replace(data, volts=delayed(x, samples))
        return moved, *_quick(moved)

    longest = min(round(LONGEST_DELAY * data.sample_rate), x.size // 20)
    best, (moved, guess, rmse) = shift or 0, at(shift or 0)
    step = 1 << max(longest.bit_length() - 2, 0)
    while shift is None and step:
        for other in (best + step, best - step):
            if 0 <= other <= longest and (tried := at(other))[2] < BETTER * rmse:
                best, (moved, guess, rmse) = other, tried
                break
        step //= 2
    return moved, guess, best


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Rows of consecutive parts of the record, reduced: every structure within `full` is fitted from them."""

    full: Structure
    left_out: tuple[FloatArray, ...]
    before: tuple[FloatArray, ...]
    rows: int
    data: Data

    def rmse(self, s: Structure, weight: float) -> float:
        """Of each block as the fit to all before it predicts it, um."""
        places = s.columns_in(self.full)
        pull = self.data.prior(s).rows(weight)
        columns = np.append(places, -1)
        total = 0.0
        for left_out, before in zip(self.left_out, self.before, strict=True):
            c = normal.solve(np.vstack([before[:, columns], pull]))
            total += normal.sum_of_squares(left_out[:, columns], c)
        return float(np.sqrt(total / self.rows))


def _blocks(data: Data, s: Structure, guess: FloatArray) -> _Blocks:
    rows, skip = data.columns(s, guess), data.settled()
    start, rows = normal.reduced(rows[:skip]) if s.rested else rows[:0], rows[skip:]
    parts = tuple(normal.reduced(part) for part in np.array_split(rows, BLOCKS))
    before = tuple(normal.reduced(np.vstack([start, *parts[:k]])) for k in range(FIRST, BLOCKS))
    tested = sum(len(part) for part in np.array_split(rows, BLOCKS)[FIRST:])
    return _Blocks(s, parts[FIRST:], before, tested, data)


def _choose(
    data: Data, guess: FloatArray, fixed: dict[str, Any]
) -> tuple[Structure, float, tuple[tuple[str, float], ...]]:
    """Thresholds with all terms in the model, then the terms; the prior's weight, um^2, with both."""
    left = (data.displacement - guess[:: data.every])[data.settled() :]
    noise = float(np.var(left)) * left.size / uncertainty.effective_samples(left)  # as if it were white
    weights = [w * noise for w in WEIGHTS]
    banks = [_blocks(data, s, guess) for s in _with_all_terms(data, fixed)]
    tried = [(bank.rmse(bank.full, w), bank, bank.full, w) for bank in banks for w in weights]
    _, bank, full, _ = min(tried, key=lambda entry: entry[0] * (FROM_REST if entry[2].rested else 1.0))
    fewer = [(bank.rmse(s, w), bank, s, w) for s in _with_fewer_terms(full, fixed) for w in weights]
    tried += fewer
    least = min(score for score, *_ in fewer)
    most = max((e for e in fewer if e[0] <= ENOUGH * least), key=lambda e: len(e[2].names))[2]
    rmse, _, chosen, weight = min((e for e in fewer if e[2] == most), key=lambda e: e[0])
    words = tuple((f"{_words(s)}, prior x {w / noise:g}", score) for score, _, s, w in tried)
    return chosen, weight, (*words, (f"chosen: {_words(chosen)}, prior x {weight / noise:g}", rmse))


def _with_all_terms(data: Data, fixed: dict[str, Any]) -> Iterator[Structure]:
    span = data.voltage_range[1] - data.voltage_range[0]
    duration = data.volts.size / data.sample_rate
    times = tuple(tau for tau in CREEP_TIMES if 1 / data.sample_rate < tau < duration / 3)
    if fixed["creep_times"] is not None:
        times = tuple(_check.positive("creep_times", tau, "s") for tau in fixed["creep_times"])
    if fixed["thresholds"] is not None:
        banks = [_check.ascending("thresholds", fixed["thresholds"], "V")]
    else:
        banks = [even_thresholds(n, reach * span) for n, reach in itertools.product(PLAYS, REACHES)]
    states = [False, True] if abs(data.volts[0]) <= AT_REST * span else [False]
    if fixed["thresholds"] is None and len(states) == 2:
        banks += [
            even_thresholds(n, reach * span) for n, reach in itertools.product(PLAYS_FROM_REST, REACHES_FROM_REST)
        ]
    for r, rested in itertools.product(banks, states):
        if rested == (r[-1] < 0.5 * span) and fixed["thresholds"] is None:
            continue
        yield Structure(
            thresholds=r,
            rated=() if fixed["rate"] is False else rated(len(r)),
            creep_times=times,
            bends=2 if fixed["bends"] is None else fixed["bends"],
            rested=rested,
        )


def _with_fewer_terms(full: Structure, fixed: dict[str, Any]) -> Iterator[Structure]:
    rates = [full.rated] if fixed["rate"] is not None else [(), full.rated]
    times = full.creep_times
    creeps = [times] if fixed["creep_times"] is not None else sorted({(), times[len(times) // 2 :], times}, key=len)
    bends = [full.bends] if fixed["bends"] is not None else [0, 1, 2]
    for rate, creep, n in itertools.product(rates, creeps, bends):
        yield dataclasses.replace(full, rated=rate, creep_times=creep, bends=n)


def _words(s: Structure) -> str:
    creep = f"creep {', '.join(f'{tau:g}' for tau in s.creep_times)} s" if s.creep_times else "no creep"
    rate = f"{len(s.rated)} rate weights" if s.rated else "no rate"
    start = " from rest" if s.rested else ""
    return f"{len(s.thresholds)} plays to {s.thresholds[-1]:.3g} V{start}, {rate}, {creep}, {s.bends} bends"


# ---- The fit -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Fit:
    model: ActuatorModel
    residual: FloatArray  # um, of the rows that were fitted


def _fit(data: Data, s: Structure, weight: float, guess: FloatArray, delay: float, certain: bool = True) -> _Fit:
    """Gauss-Newton on the prediction error: velocity and bends follow the model's own displacement."""
    believed, skip, z = data.prior(s), 0 if s.rested else data.settled(), guess
    first_start = len(s.names) - len(s.starts)
    bends = slice(first_start - s.bends, first_start)
    c = np.zeros(len(s.names))
    for step in range(STEPS + 1):
        rows = data.columns(s, z)[skip:]
        C, measured = rows[:, :-1], rows[:, -1]
        velocity = float(np.abs(C[:, s.names.index("lag")]).max())
        predicted = z[:: data.every][skip:] if step else np.zeros(len(C))
        J = C / np.maximum(1 - bend_slopes(predicted, data.stroke)[:, : s.bends] @ c[bends], 0.1)[:, None]
        pull = np.vstack([normal.reduced(np.column_stack([J, measured - predicted + J @ c])), believed.rows(weight)])
        c = normal.solve(pull, data.slopes(s, velocity), FLOOR * data.q)
        model = data.model(s, c, 0.0, velocity)
        z = model.predict(data.volts, data.sample_rate) - data.zero + data.starts(s, c[first_start:])
    residual = measured - z[:: data.every][skip:]
    P = np.zeros((first_start, first_start))
    if certain:
        P = uncertainty.covariance(J, residual, believed, weight)[:first_start, :first_start]
    noise = float(np.sqrt(np.mean(residual**2)))
    return _Fit(model.replace(covariance=P, delay=delay, noise=noise), residual)


def _documented(fit: _Fit, held_out: HeldOut, source: str, samples: int, fs: float) -> ActuatorModel:
    """The model with what its file tells about it."""
    from importlib.metadata import version

    figures = {f"held_out_{name}": float(value) for name, value in dataclasses.asdict(held_out).items()}
    figures |= {"record_samples": float(samples), "record_sample_rate_hz": fs}
    return fit.model.replace(
        figures=figures, provenance={"source": source, "made_by": f"truestroke {version('truestroke')}"}
    )
