"""The structure of the model, chosen by blocked cross-validation."""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.control.actuator import play_sum
from truestroke.identification import normal, uncertainty
from truestroke.identification.regression import DRIFTS, Data, Structure, even_thresholds, plays, rate_dependent
from truestroke.model.branches import Branches

BLOCKS = 6  # of the cross-validation: each but the first three is predicted from those before it
FIRST = 3
PLAYS = (8, 16, 24)
REACHES = (0.36, 0.48)  # of the voltage range: thresholds end below this; none beyond 0.5 ever moves
PLAYS_FROM_REST = (16, 32)
REACHES_FROM_REST = (0.6, 0.9)  # the same where the first way up from rest is in the fit
AT_REST = 0.02  # of the voltage range: a record that starts nearer to 0 V may start at rest
FROM_REST = 0.75  # and is taken to, unless that makes the rmse a third larger: a controller starts at rest, too
CREEP_TIMES = (0.003, 0.03, 0.3, 3.0, 30.0)  # s
WEIGHTS = (0.1, 1.0, 10.0, 100.0)  # of the prior, beyond the noise of the first fit
FASTER = 2.0  # times what the rows to fit show: where the rest of the record is, a line in the rate would mislead
BETTER = 0.99  # a sample of delay must lower the rmse at least this far
ENOUGH = 1.1  # of the least rmse: the most terms that do not exceed it, as by one standard error
ENOUGH_PLAYS = 1.05  # the same of the thresholds
WITHIN = 0.98  # of the voltage range: where the rest of the record exceeds what is fitted, no prior is weak
DRIFTS_IF = 0.95  # times the rmse without a drift: with one it must be below
BRANCHES_IF = 0.65  # times the rmse of plays of the voltage alone: with branches it must be below
ENOUGH_BRANCHES = 1.1  # of the least rmse: the fewest branches that do not exceed it
CURVED_PLAYS = 12  # of each curve
BETAS = (1.5, 4.0, 10.0, 25.0)  # times the voltage range
CURVES = ((), ("convex", "concave"), ("convex", "concave", "sigmoid"))
WEAKER = (0.01, 0.1, 1.0, 10.0)  # times the weight of the prior without branches
LONGEST_DELAY = 0.1  # s
QUICK = 16  # plays of the first fit


@dataclass(frozen=True)
class Tried:
    """A structure that cross-validation compared.

    Attributes
    ----------
    structure : Structure
        Which terms.
    prior : float
        Weight of the prior, times the noise.
    rmse : float
        Of what was predicted, um.
    modes : int
        Resonances of the stage.
    """

    structure: Structure
    prior: float
    rmse: float
    modes: int = 0

    @property
    def parts(self) -> tuple[str, ...]:
        """The structure in words: plays, rate weights, creep, asymmetry, resonances."""
        s = self.structure
        more = "" if s.branches is None else f", {s.branches.described}"
        return (
            f"{len(s.thresholds)} plays to {s.thresholds[-1]:.3g} V{' from rest' if s.rested else ''}{more}",
            f"{len(s.rate_dependent)} rate weights" if s.rate_dependent else "no rate",
            f"creep {', '.join(f'{tau:g}' for tau in s.creep_times)} s" if s.creep_times else "no creep",
            f"{s.asymmetry} asymmetry terms{''.join(f', {name}' for name in s.drift)}",
            "no resonance" if not self.modes else "1 resonance" if self.modes == 1 else f"{self.modes} resonances",
        )


def first_prediction(data: Data) -> FloatArray:
    """A prediction before dead time and lag, um, at the full rate, by plays alone."""
    s = _first(data)
    c, _ = _first_fit(data, s, data.columns(s, np.zeros_like(data.volts)))
    return np.asarray(play_sum(data.volts, 0.0, c[:-1], np.zeros(QUICK), s.thresholds) + c[-1])


def _first(data: Data) -> Structure:
    span = data.voltage_range[1] - data.voltage_range[0]
    return Structure(thresholds=even_thresholds(QUICK, 0.5 * span), lag=False)


def _first_fit(data: Data, s: Structure, columns: FloatArray) -> tuple[FloatArray, float]:
    """Weights of the plays and the offset, and the rmse, um."""
    rows = columns[data.fitted(rested=False)]
    prior = data.prior(s).part(np.append(s.a, s.columns["offset"].start))
    R = normal.reduced(rows)
    c = normal.solve(np.vstack([R, prior.rows((0.01 * data.stroke) ** 2)]))
    return c, float(np.sqrt(normal.sum_of_squares(R, c) / len(rows)))


def coarse_delay(data: Data) -> float:
    """The delay, s, of whole samples, with the smallest rmse of the first fit."""
    longest = min(round(LONGEST_DELAY * data.sample_rate), data.volts.size // 20)
    s, kept = _first(data), np.arange(0, data.volts.size, data.every)
    columns = np.column_stack([plays(data.volts, s.thresholds), np.ones_like(data.volts)])

    def error(samples: int) -> float:
        late = columns[np.maximum(kept - samples, 0)]
        return _first_fit(data, s, np.column_stack([late, data.displacement]))[1]

    best, rmse = 0, error(0)
    step = 1 << max(longest.bit_length() - 2, 0)
    while step:
        for other in (best + step, best - step):
            if 0 <= other <= longest and (tried := error(other)) < BETTER * rmse:
                best, rmse = other, tried
                break
        step //= 2
    return best / data.sample_rate


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
    rows, late = data.columns(s, guess), data.fitted(rested=False)
    start, rows = normal.reduced(rows[data.fitted(s.rested) & ~late]), rows[late]
    parts = tuple(normal.reduced(part) for part in np.array_split(rows, BLOCKS))
    before = tuple(normal.reduced(np.vstack([start, *parts[:k]])) for k in range(FIRST, BLOCKS))
    tested = sum(len(part) for part in np.array_split(rows, BLOCKS)[FIRST:])
    return _Blocks(s, parts[FIRST:], before, tested, data)


def choose(data: Data, guess: FloatArray, fixed: Mapping[str, Any]) -> tuple[Structure, float, tuple[Tried, ...]]:
    """The structure (thresholds with all terms, then the terms), its prior's weight, um^2, and all that was tried."""
    if fixed["rate"] is None and data.fastest > FASTER * data.speed:
        fixed = {**fixed, "rate": False}
    residual = (data.displacement - data.through(guess)[:: data.every])[data.fitted(rested=False)]
    noise = uncertainty.white_variance(residual)
    beyond = np.ptp(data.volts) < WITHIN * np.ptp(data.voltage_range) or data.fastest > FASTER * data.speed
    weights = [w * noise for w in (WEIGHTS[1:] if beyond else WEIGHTS)]
    banks = [_blocks(data, s, guess) for s in _with_all_terms(data, fixed)]
    tried = [(bank.rmse(bank.full, w), bank, bank.full, w) for bank in banks for w in weights]
    scores = [score * (FROM_REST if s.rested else 1.0) for score, _, s, _ in tried]
    good = [entry for entry, score in zip(tried, scores, strict=True) if score <= ENOUGH_PLAYS * min(scores)]
    _, bank, full, _ = max(good, key=lambda entry: (len(entry[2].thresholds), -entry[0]))
    if fixed["drift"] is not False:
        bank, full = _with_drift(data, full, guess, weights, DRIFTS_IF if fixed["drift"] is None else np.inf)
    fewer = [(bank.rmse(s, w), bank, s, w) for s in _with_fewer_terms(full, fixed) for w in weights]
    tried += fewer
    least = min(score for score, *_ in fewer)
    most = max((e for e in fewer if e[0] <= ENOUGH * least), key=lambda e: len(e[2].coefficients))[2]
    best = min((e for e in fewer if e[2] == most), key=lambda e: e[0])
    _, _, chosen, weight = best
    modes = 0 if data.dynamics is None else len(data.dynamics.modes)
    return chosen, weight, tuple(Tried(s, w / noise, score, modes) for score, _, s, w in (*tried, best))


def _with_drift(
    data: Data, s: Structure, guess: FloatArray, weights: Sequence[float], better: float
) -> tuple[_Blocks, Structure]:
    """The structure with the drift of the zero that predicts later blocks `better` times as well, or with none."""
    bank = _blocks(data, dataclasses.replace(s, drift=tuple(DRIFTS)), guess)
    found = {
        drift: min(bank.rmse(dataclasses.replace(s, drift=drift), w) for w in weights)
        for drift in ((), *[(name,) for name in DRIFTS])
    }
    best = min([drift for drift in found if drift], key=lambda drift: found[drift])
    return bank, dataclasses.replace(s, drift=best if found[best] < better * found[()] else ())


def choose_branches(
    data: Data, s: Structure, weight: float, strain: FloatArray
) -> tuple[Structure, float, tuple[Tried, ...]] | None:
    """The structure with the branches that predict later blocks better, its prior's weight, um^2, and all tried.

    None where plays of the voltage alone are about as good, and where the rest of the record goes beyond the voltages
    of these rows. `strain` is the prediction of the plays before dead time and lag, um.
    """
    if np.ptp(data.volts) < WITHIN * np.ptp(data.voltage_range):
        return None
    most = Branches(voltage_range=data.voltage_range, curves=CURVES[-1], plays=CURVED_PLAYS, betas=BETAS)
    bank = _blocks(data, dataclasses.replace(s, branches=most), strain)
    noise = float(np.var((data.displacement - data.through(strain)[:: data.every])[data.fitted(rested=False)]))
    choices = [
        dataclasses.replace(s, branches=dataclasses.replace(most, curves=curves, betas=betas))
        for curves, betas in itertools.product(CURVES, ((), most.betas))
        if curves or betas
    ]
    weights = [w * weight for w in WEAKER]
    alone = min(bank.rmse(s, w) for w in weights)
    tried = [(bank.rmse(choice, w), choice, w) for choice in choices for w in weights]
    least = min(entry[0] for entry in tried)
    if least >= BRANCHES_IF * alone:
        return None
    good = [entry for entry in tried if entry[0] <= ENOUGH_BRANCHES * least]
    score, best, w = min(good, key=lambda entry: (len(entry[1].further), entry[0]))
    modes = 0 if data.dynamics is None else len(data.dynamics.modes)
    return best, w, tuple(Tried(c, w / noise, score, modes) for score, c, w in (*tried, (score, best, w)))


def _with_all_terms(data: Data, fixed: Mapping[str, Any]) -> Iterator[Structure]:
    span = data.voltage_range[1] - data.voltage_range[0]
    duration = data.volts.size / data.sample_rate
    times = tuple(tau for tau in CREEP_TIMES if 1 / data.sample_rate < tau < duration / 3)
    if fixed["creep_times"] is not None:
        times = tuple(checks.positive("creep_times", tau, "s") for tau in fixed["creep_times"])
    if fixed["thresholds"] is not None:
        banks = [checks.ascending("thresholds", fixed["thresholds"], "V")]
    else:
        banks = [even_thresholds(n, reach * span) for n, reach in itertools.product(PLAYS, REACHES)]
    states = [False, True] if abs(data.volts[0]) <= AT_REST * span else [False]
    if fixed["thresholds"] is None and len(states) == 2:
        more = itertools.product(PLAYS_FROM_REST, REACHES_FROM_REST)
        banks += [even_thresholds(n, reach * span) for n, reach in more]
    for r, rested in itertools.product(banks, states):
        if rested == (r[-1] < 0.5 * span) and fixed["thresholds"] is None:
            continue
        yield Structure(
            thresholds=r,
            rate_dependent=() if fixed["rate"] is False else rate_dependent(len(r)),
            creep_times=times,
            asymmetry=2 if fixed["asymmetry"] is None else fixed["asymmetry"],
            rested=rested,
        )


def _with_fewer_terms(full: Structure, fixed: Mapping[str, Any]) -> Iterator[Structure]:
    rates = [full.rate_dependent] if fixed["rate"] is not None else [(), full.rate_dependent]
    times = full.creep_times
    creeps = [times] if fixed["creep_times"] is not None else sorted({(), times[len(times) // 2 :], times}, key=len)
    asymmetry = [full.asymmetry] if fixed["asymmetry"] is not None else [0, 1, 2]
    for rate, creep, n in itertools.product(rates, creeps, asymmetry):
        yield dataclasses.replace(full, rate_dependent=rate, creep_times=creep, asymmetry=n)
