"""The structure of the model, chosen by blocked cross-validation."""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import normal, uncertainty
from truestroke.identification.fitting.regression import DRIFTS, Data, Structure, even_thresholds, plays, rate_dependent
from truestroke.identification.fitting.rest import begins_with_step, over_motion
from truestroke.identification.records.turning import reversals
from truestroke.model.branches import Branches
from truestroke.model.layout import MAX_CREEPS
from truestroke.model.sampled import play_sum
from truestroke.signals.noise import noise_with_tails

BLOCKS = 6  # of the cross-validation: each but the first three is predicted from those before it
FIRST = 3
QUARTERS = 4  # of a block, whose means show how the zero walks
PLAYS = (8, 16, 24)
REACHES = (0.36, 0.48)  # of the voltage range: thresholds end below this; none beyond 0.5 ever moves
PLAYS_FROM_REST = (16, 32)
REACHES_FROM_REST = (0.6, 0.9)  # the same where the first way up from rest is in the fit
FROM_REST = 0.7  # least factor of the rmse from rest, where the first motion shows it: a controller starts at rest, too
CREEP_TIMES = (0.003, 0.03, 0.3, 3.0, 30.0)  # s
WEIGHTS = (0.1, 1.0, 10.0, 100.0)  # of the prior, beyond the noise of the first fit
FASTER = 2.0  # times what the rows to fit show: where the rest of the record is, a line in the rate would mislead
BETTER = 0.99  # a sample of delay must lower the rmse at least this far
ENOUGH = 1.1  # of the least rmse: the most terms that do not exceed it, as by one standard error
ENOUGH_PLAYS = 1.05  # the same of the thresholds
WITHIN = 0.98  # of the voltage range: where the rest of the record exceeds what is fitted, no prior is weak
DRIFTS_IF = 0.95  # times the rmse without a drift: with one it must be below
BRANCHES_WITHIN = 0.7  # of the voltage range: where the rest of the record goes further, branches would mislead
BRANCHES_IF = 0.65  # times the rmse of plays of the voltage alone: with branches it must be below
BRANCHES_IF_NOISY = 0.6  # or times it, both without the noise of the sensor
BRANCHES_STAY = 1.15  # times both: where the first part of the record has taken them
BRANCHES_GAIN = 0.9  # in any case, and times the residual of the fit
ENOUGH_BRANCHES = 1.1  # of the least rmse: the fewest branches that do not exceed it
CURVED_PLAYS = 12  # of each curve
BETAS = (1.5, 4.0, 10.0, 25.0)  # times the voltage range
STIFF = (*BETAS, 60.0, 150.0)  # of friction, which turns within a few hundredths of the range
CURVES = ((), ("convex", "concave"), ("convex", "concave", "sigmoid"))
Kind = tuple[tuple[str, ...], int, tuple[float, ...]]  # of branches: curves, levels and betas
LEVELS, FINER = 10, 14  # of the cells of Preisach's plane
KINDS: tuple[Kind, ...] = tuple(
    kind for kind in (*itertools.product(CURVES, (0,), ((), BETAS)), ((), 0, STIFF), ((), LEVELS, ())) if any(kind)
)  # that are compared
FINER_KINDS: tuple[Kind, ...] = (((), FINER, ()), (CURVES[-1], FINER, ()), ((), FINER, BETAS))
FINER_IF = 1.25  # times the shares of `BRANCHES_IF` that the others must be below: these are compared, too
FINER_TURNS = 4  # of the places, as wide as a cell, in which the voltage turns: with fewer, cells are not known
WEAKER = (0.01, 0.1, 1.0, 10.0)  # times the weight of the prior without branches
CREEPS_IF = 1.25  # times the rmse with a drift: from rest, slower creep that does not exceed it is taken instead
SLOWEST = 10.0  # of the record: the slowest of that creep
LONGEST_DELAY = 0.1  # s
QUICK = 16  # plays of the first fit


class Zero(NamedTuple):
    """How the zero moves after a fit, by the mean errors of later blocks: see `_Blocks.zero`."""

    walk: float = 0.0  # um/sqrt(s), of a random walk
    trend: float = 0.0  # um/s, of a zero that moves steadily


STILL = Zero()


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
    zero : Zero
        How the zero of what was chosen moves on; 0 of the others.
    """

    structure: Structure
    prior: float
    rmse: float
    modes: int = 0
    zero: Zero = STILL

    @property
    def parts(self) -> tuple[str, ...]:
        """The structure in words: plays, rate weights, creep, asymmetry, resonances."""
        s = self.structure
        more = "" if s.branches is None else f", {s.branches.described}"
        return (
            f"{len(s.thresholds)} plays to {s.thresholds[-1]:.3g} V{' from rest' if s.rested else ''}{more}",
            f"{len(s.rate_dependent)} rate weights" if s.rate_dependent else "no rate",
            f"creep {', '.join(f'{tau:g}' for tau in s.creep_times)} s" if s.creep_times else "no creep",
            f"{s.asymmetry} asymmetry term{'' if s.asymmetry == 1 else 's'}{''.join(f', {name}' for name in s.drift)}",
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
    means: FloatArray  # of the rows of each quarter of each part of `left_out`
    rows: int
    data: Data
    _within: dict[Structure, tuple[tuple[FloatArray, FloatArray], ...]] = field(default_factory=dict, init=False)
    _rmse: dict[tuple[Structure, float], float] = field(default_factory=dict, init=False)

    def within(self, s: Structure) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Each of `before`, and of `left_out`, of the columns of a structure: once for all weights of the prior."""
        if s not in self._within:
            columns = np.append(s.columns_in(self.full), -1)
            pairs = zip(self.before, self.left_out, strict=True)
            self._within[s] = tuple((normal.reduced(before[:, columns]), out[:, columns]) for before, out in pairs)
        return self._within[s]

    def pull(self, s: Structure, weight: float) -> FloatArray:
        """Rows that pull the coefficients to the prior."""
        return self.data.prior(s).rows(weight)

    def rmse(self, s: Structure, weight: float) -> float:
        """Of each block as the fit to all before it predicts it, um."""
        if (s, weight) not in self._rmse:
            self._rmse[s, weight] = self._rmse_of(s, weight)
        return self._rmse[s, weight]

    def _rmse_of(self, s: Structure, weight: float) -> float:
        pull = self.pull(s, weight)
        each = ((normal.solve(pull, above=before), out) for before, out in self.within(s))
        return float(np.sqrt(sum(normal.sum_of_squares(out, c) for c, out in each) / self.rows))

    def zero(self, s: Structure, weight: float) -> Zero:
        """Random walk of the zero, and its trend, by the mean errors of later blocks.

        Their squares are walk^2 times the seconds since the fit, and so are their sums. And of means over the time L
        beside each other the squared difference is (2 walk^2 L + 3 c / L) / 3, where c / L is of errors that return,
        for a quarter and for half of a block. Few blocks show either; where the second is larger, the geometric mean.

        The trend is the rms of the slopes, one for each fit, of lines through 0 at its end: a zero that goes to and fro
        slowly, as with the temperature, is a walk at first, and further off than one later.
        """
        pull, columns = self.pull(s, weight), np.append(s.columns_in(self.full), -1)
        quarter = self.rows / len(self.means) * self.data.every / self.data.sample_rate
        squares = seconds = 0.0
        slopes: list[float] = []
        steps: dict[int, list[float]] = {1: [], 2: []}
        for k, (before, _) in enumerate(self.within(s)):
            c = normal.solve(pull, above=before)
            errors = self.means[QUARTERS * k :, columns] @ np.append(c, -1.0)
            since = quarter * (np.arange(errors.size) + 0.5)
            slopes.append(float(since @ errors / (since @ since)))
            blocks = errors.reshape(-1, QUARTERS).mean(axis=1)
            squares += float(blocks @ blocks)
            seconds += QUARTERS * quarter * float(np.sum(np.arange(blocks.size) + 0.5))
            for width, found in steps.items():
                found += list(np.diff(errors.reshape(-1, width).mean(axis=1)) ** 2)
        short, long = (1.5 * float(np.mean(found)) / (width * quarter) for width, found in steps.items())
        grown, stepped = squares / seconds, (4 * long - short) / 3
        return Zero(math.sqrt(math.sqrt(grown * max(grown, stepped))), math.sqrt(float(np.mean(np.square(slopes)))))


def _blocks(data: Data, s: Structure, guess: FloatArray) -> _Blocks:
    rows, late = data.columns(s, guess), data.fitted(rested=False)
    start, rows = normal.reduced(rows[data.fitted(s.rested) & ~late]), rows[late]
    blocks = np.array_split(rows, BLOCKS)
    parts = tuple(normal.reduced(part) for part in blocks)
    before = [normal.reduced(np.vstack([start, *parts[:FIRST]]))]
    for part in parts[FIRST:-1]:
        before.append(normal.reduced(part, before[-1]))
    quarters = [
        np.array_split(part, QUARTERS) if len(part) >= QUARTERS else [part] * QUARTERS for part in blocks[FIRST:]
    ]
    means = np.array([part.mean(axis=0) for part in itertools.chain(*quarters)])
    return _Blocks(s, parts[FIRST:], tuple(before), means, sum(len(part) for part in blocks[FIRST:]), data)


def with_this(data: Data, s: Structure, guess: FloatArray, weight: float) -> float:
    """The rmse of cross-validation, um, of one structure alone."""
    return _blocks(data, s, guess).rmse(s, weight)


def choose(data: Data, guess: FloatArray, fixed: Mapping[str, Any]) -> tuple[Structure, float, tuple[Tried, ...]]:
    """The structure (thresholds with all terms, then the terms), its prior's weight, um^2, and all that was tried."""
    if fixed["rate"] is None and data.fastest > FASTER * data.speed:
        fixed = {**fixed, "rate": False}
    residual = (data.displacement - data.through(guess)[:: data.every])[data.fitted(rested=False)]
    noise = uncertainty.white_variance(residual)
    beyond = np.ptp(data.volts) < WITHIN * np.ptp(data.voltage_range) or data.fastest > FASTER * data.speed
    weights = [w * noise for w in (WEIGHTS[1:] if beyond else WEIGHTS)]
    of_rest = over_motion(data, guess, noise)
    states = [False, True] if of_rest < 1 else [False]
    drifts = tuple(DRIFTS) if fixed["drift"] is not False else ()
    banks = [
        (_blocks(data, dataclasses.replace(s, drift=drifts), guess), s) for s in _with_all_terms(data, fixed, states)
    ]
    tried = [(bank.rmse(s, w), bank, s, w) for bank, s in banks for w in weights]
    scores = [score * (max(of_rest, FROM_REST) if s.rested else 1.0) for score, _, s, _ in tried]
    good = [entry for entry, score in zip(tried, scores, strict=True) if score <= ENOUGH_PLAYS * min(scores)]
    _, bank, full, _ = max(good, key=lambda entry: (len(entry[2].thresholds), -entry[0]))
    if drifts:
        creeps = _with_slower_creep(data, full, fixed)
        if creeps != full:
            bank = _blocks(data, dataclasses.replace(creeps, drift=drifts), guess)
        full = _with_drift(bank, full, creeps, weights, DRIFTS_IF if fixed["drift"] is None else np.inf)
    fewer = [(bank.rmse(s, w), bank, s, w) for s in _with_fewer_terms(full, fixed) for w in weights]
    tried += fewer
    least = min(score for score, *_ in fewer)
    most = max((e for e in fewer if e[0] <= ENOUGH * least), key=lambda e: len(e[2].coefficients))[2]
    best = min((e for e in fewer if e[2] == most), key=lambda e: e[0])
    rmse, bank, chosen, weight = best
    modes = 0 if data.dynamics is None else len(data.dynamics.modes)
    found = [Tried(s, w / noise, score, modes) for score, _, s, w in tried]
    return chosen, weight, (*found, Tried(chosen, weight / noise, rmse, modes, bank.zero(chosen, weight)))


def _with_drift(bank: _Blocks, s: Structure, creeps: Structure, weights: Sequence[float], better: float) -> Structure:
    """The structure with the drift of the zero that predicts later blocks `better` times as well, or with none.

    `creeps` is the structure with creep that is slower than the record, or the same: after a rest that looks like a
    drift, but comes again after the next one, and belongs to the model.
    """

    def rmse(tried: Structure) -> float:
        return min(bank.rmse(tried, w) for w in weights)

    still = rmse(s)
    found = {name: rmse(dataclasses.replace(s, drift=(name,))) for name in DRIFTS}
    best = min(found, key=lambda name: found[name])
    if found[best] >= better * still:
        return s
    if creeps != s and rmse(creeps) <= CREEPS_IF * found[best]:
        return creeps
    return dataclasses.replace(s, drift=(best,))


def _with_slower_creep(data: Data, s: Structure, fixed: Mapping[str, Any]) -> Structure:
    """The structure with creep that is slower than the record, which may look like a drift; or the same."""
    free = fixed["creep_times"] is None and fixed["drift"] is None
    slow = free and s.rested and not begins_with_step(data.volts)  # whose rest is not in the record
    return dataclasses.replace(s, creep_times=_slower(data, s.creep_times)) if slow else s


def _without_drift(data: Data, s: Structure, fixed: Mapping[str, Any]) -> tuple[Structure, Structure]:
    """The structure without a drift, or creep that is slower than the record and may be one; and with that creep.

    A drift that plays alone have shown is not exchanged for creep: the second is the first.
    """
    free = fixed["creep_times"] is None and fixed["drift"] is None
    still = dataclasses.replace(s, drift=(), creep_times=_within(data, s.creep_times) if free else s.creep_times)
    return still, still if s.drift else _with_slower_creep(data, still, fixed)


def _drift_beside(bank: _Blocks, s: Structure, weights: Sequence[float], fixed: Mapping[str, Any]) -> Structure:
    """A structure with branches, with the drift of the zero, or the slower creep, that is found beside these.

    Where plays of the voltage alone miss the hysteresis by more than it, a drift is not seen, and creep that seems as
    good beside them is not. From rest with given time constants no slower creep may be compared, and all stays.
    """
    if fixed["drift"] is False or (s.rested and fixed["creep_times"] is not None):
        return s
    still, creeps = _without_drift(bank.data, s, fixed)
    found = _with_drift(bank, still, creeps, weights, DRIFTS_IF if fixed["drift"] is None else np.inf)
    return s if found == still and not s.drift else found


class BranchChoice(NamedTuple):
    """What branches do for a structure.

    Attributes
    ----------
    least : float
        The least rmse of cross-validation with any of `KINDS`, um; inf where none were compared.
    taken : tuple or None
        The structure with those that are taken, its prior's weight, um^2, and all that was tried.
    """

    least: float
    taken: tuple[Structure, float, tuple[Tried, ...]] | None


def choose_branches(
    data: Data, s: Structure, weight: float, strain: FloatArray, fixed: Mapping[str, Any], *, stay: bool = False
) -> BranchChoice:
    """The branches that predict later blocks better than the structure without.

    None where plays of the voltage alone are about as good, and where the rest of the record goes far beyond the
    voltages of these rows. `strain` is the prediction of the plays before dead time and lag, um. Where they may `stay`
    a part of these rows has taken branches. The drift of the zero is found anew beside the best of them.
    """
    if np.ptp(data.volts) < BRANCHES_WITHIN * np.ptp(data.voltage_range):
        return BranchChoice(np.inf, None)
    residual = (data.displacement - data.through(strain)[:: data.every])[data.fitted(rested=False)]
    noise, weights = float(np.var(residual)), [w * weight for w in WEAKER]
    bank, tried = _with_branches(data, s, strain, KINDS, weights, fixed)
    of_sensor = noise_with_tails(residual)
    plain = min(bank.rmse(s, w) for w in weights)
    best = min(tried, key=lambda entry: entry[0])[1]
    moved = dataclasses.replace(_drift_beside(bank, best, weights, fixed), branches=None)
    if moved != s:
        s, choices = moved, [(dataclasses.replace(moved, branches=c.branches), w) for _, c, w, _ in tried]
        tried = [(bank.rmse(choice, w), choice, w, bank) for choice, w in choices]
        plain = min(plain, *(bank.rmse(s, w) for w in weights))
    enough, near = (_enough(plain, of_sensor, times) for times in (BRANCHES_STAY if stay else 1.0, FINER_IF))
    of_kinds = min(entry[0] for entry in tried)
    if of_kinds < near and _places_of_turns(data) >= FINER_TURNS:
        tried += _with_branches(data, s, strain, FINER_KINDS, weights, fixed)[1]
    least = min(entry[0] for entry in tried)
    if least >= enough:
        return BranchChoice(of_kinds, None)
    good = [entry for entry in tried if entry[0] <= ENOUGH_BRANCHES * least]
    score, best, w, bank = min(good, key=lambda entry: (len(entry[1].further), entry[0]))
    modes = 0 if data.dynamics is None else len(data.dynamics.modes)
    compared = [Tried(c, w / noise, score, modes) for score, c, w, _ in tried]
    return BranchChoice(of_kinds, (best, w, (*compared, Tried(best, w / noise, score, modes, bank.zero(best, w)))))


def _enough(plain: float, noise: float, times: float) -> float:
    """What branches must be below, um, where the rmse without them is `plain` and has so much noise of the sensor.

    With `times` above 1, what they must be below to be so near.
    """
    model = max(plain**2 - noise**2, 0.0)
    beside = math.sqrt(plain**2 - (1 - (times * BRANCHES_IF_NOISY) ** 2) * model)
    return min(max(times * BRANCHES_IF * plain, beside), BRANCHES_GAIN * plain)


def _with_branches(
    data: Data,
    s: Structure,
    strain: FloatArray,
    kinds: Sequence[Kind],
    weights: Sequence[float],
    fixed: Mapping[str, Any],
) -> tuple[_Blocks, list[tuple[float, Structure, float, _Blocks]]]:
    """Rows for all these kinds of branches and any drift; and of each with each weight the rmse of cross-validation."""
    most = Branches(
        voltage_range=data.voltage_range,
        curves=max((curves for curves, _, _ in kinds), key=len),
        plays=CURVED_PLAYS,
        levels=max(levels for _, levels, _ in kinds),
        betas=max((betas for _, _, betas in kinds), key=len),
    )
    creeps = _without_drift(data, s, fixed)[1].creep_times
    times = s.creep_times if set(creeps) <= set(s.creep_times) else creeps
    drifts = s.drift if fixed["drift"] is False else tuple(DRIFTS)
    bank = _blocks(data, dataclasses.replace(s, creep_times=times, drift=drifts, branches=most), strain)
    choices = [
        dataclasses.replace(s, branches=dataclasses.replace(most, curves=curves, levels=levels, betas=betas))
        for curves, levels, betas in kinds
    ]
    return bank, [(bank.rmse(choice, w), choice, w, bank) for choice in choices for w in weights]


def _places_of_turns(data: Data) -> int:
    """In how many of the voltage's parts, as wide as a cell, it turns and goes back by as much."""
    x, (low, high) = data.volts[:: data.every], data.voltage_range
    width = (high - low) / FINER
    turns = reversals(x, width)[1:-1]
    return len(set(np.clip((x[turns] - low) // width, 0, FINER - 1).tolist()))


def _within(data: Data, times: tuple[float, ...]) -> tuple[float, ...]:
    """The time constants, s, that a third of the record has."""
    return tuple(tau for tau in times if tau < data.volts.size / data.sample_rate / 3)


def _slower(data: Data, times: tuple[float, ...]) -> tuple[float, ...]:
    """The time constants, s, and slower ones, two a decade."""
    duration, slow = data.volts.size / data.sample_rate, times
    while 0 < len(slow) < MAX_CREEPS and math.sqrt(10) * slow[-1] <= SLOWEST * duration:
        slow = (*slow, float(f"{math.sqrt(10) * slow[-1]:.2g}"))
    return slow


def _with_all_terms(data: Data, fixed: Mapping[str, Any], states: Sequence[bool]) -> Iterator[Structure]:
    span = data.voltage_range[1] - data.voltage_range[0]
    times = tuple(tau for tau in _within(data, CREEP_TIMES) if 1 / data.sample_rate < tau)
    if fixed["creep_times"] is not None:
        times = tuple(checks.positive("creep_times", tau, "s") for tau in fixed["creep_times"])
    if fixed["thresholds"] is not None:
        banks = [checks.ascending("thresholds", fixed["thresholds"], "V")]
    else:
        banks = [even_thresholds(n, reach * span) for n, reach in itertools.product(PLAYS, REACHES)]
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
