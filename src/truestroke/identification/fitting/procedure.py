"""From the first samples of a record to a model: dead time, structure, stage, branches, weights."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import coverage, modes, zeros
from truestroke.identification.fitting.absorbed import absorbed
from truestroke.identification.fitting.modes import ModeSearch
from truestroke.identification.fitting.regression import ROWS, Data, Structure
from truestroke.identification.fitting.response import Response, find_response
from truestroke.identification.fitting.select import (
    BRANCHES_GAIN,
    BranchChoice,
    Tried,
    choose,
    choose_branches,
    coarse_delay,
    first_prediction,
    with_this,
)
from truestroke.identification.fitting.structure import Fit, fit_structure
from truestroke.identification.records.series import Series
from truestroke.model.dynamics import Dynamics
from truestroke.model.sampled import central_difference

CHOICE_ROWS = 15_000  # at most where structures are compared, as `ROWS`
SEARCH_ROWS = 8_000  # at most where modes are looked for
LATE_ROWS = 5000  # at most where the final model is fitted with and without dead time and lag
NEAR = 0.25  # of the stroke
FEWEST = 20  # samples in each part
RESONATES = 0.9  # of the rmse of cross-validation: modes of the stage must lower it so far
NEITHER_IF = 0.9  # of the rmse of cross-validation with a dead time or lag: without it must be below
LAGS = 0.5  # samples: a lag behind modes that is longer may be dead time which they lack
OTHERS = 0.9  # of the rmse of cross-validation with the modes of the first search: those of another must be below
SEARCHES = 12  # for modes at most, each behind a model that was fitted with those of the one before


def fit_samples(
    s: Series,
    samples: int,
    delay: float | None,
    fixed: Mapping[str, Any],
    certain: bool = True,
    before: Fit | None = None,
) -> tuple[Fit, tuple[Tried, ...], Response]:
    """Dead time, lag, structure and weights from the first samples, and what was compared.

    The search for modes begins with those of the fit `before` to a part of the samples, whose branches stay where they
    are nearly as much better. Intervals are made where `certain`.
    """
    s, zero = zeros.at_one_zero(s, samples)
    coarse = data_of(s, samples, CHOICE_ROWS)
    _refuse_still(coarse)
    found = time_constants(s, coarse, delay, certain)
    behind = None
    if found.undecided:
        few = data_of(s, samples, LATE_ROWS)
        found, decided = _decided(few, found, fixed)
        behind = decided if few.every == coarse.every else None  # of the same rows
    coarse, chosen = behind or _behind_response(coarse, found, fixed)
    structure, weight, guess, tried = chosen
    fine = dataclasses.replace(data_of(s, samples, ROWS), delay=found.delay, time_constant=found.time_constant)
    resonant = fixed["modes"] and _resonances(s, coarse, fixed, chosen, before)
    if resonant:
        dynamics, structure, weight, guess, tried = resonant
        fine = _behind_modes(fine, dynamics)
    weight *= fine.displacement.size / coarse.displacement.size  # as sure of the prior as what was compared
    plain = fit_structure(fine, structure, weight, guess)
    compared = _behind(coarse, fine)
    stay = before is not None and before.model.branches is not None
    fit, more = _branched(plain, fine, compared, fixed, stay) if fixed["branches"] else (plain, ())
    rate = float(np.diff(fit.drift(samples)[-2:])[0]) * s.sample_rate
    zero_moves = (more or tried)[-1].zero
    model = fit.model.replace(walk=zero_moves.walk, trend=zero_moves.trend, drift=rate)
    rows = compared.displacement.size / fine.displacement.size
    model, shown = coverage.calibrated(model, compared, fit.structure, fit.weight * rows, fit.strain)
    drift = fit.drift
    fit = dataclasses.replace(fit, model=model, drift=lambda size: drift(size) + zero[:size], inner_loops=shown)
    if not certain:  # nobody asks for its columns, which are many
        fit = dataclasses.replace(fit, columns=np.zeros((0, 0)), pull=np.zeros((0, 0)))
    return fit, (*tried, *more), found


def _refuse_still(data: Data) -> None:
    """Where nothing moves behind the first sweep of its range, as between pieces at two voltages."""
    if not data.fitted(rested=False).any():
        sweep = f"no motion behind the first sweep of its {np.ptp(data.volts):.4g} V"
        raise SettingError("record", sweep, "one that moves over its range more than once")


@one_thread
def time_constants(s: Series, coarse: Data | None = None, delay: float | None = None, certain: bool = True) -> Response:
    """Dead time and lag of all samples, or of those of `coarse`; of `identify`, without a model."""
    coarse = data_of(s, s.volts.size, CHOICE_ROWS) if coarse is None else coarse
    first = 0.0 if delay is not None else coarse_delay(coarse)
    samples = coarse.volts.size
    return find_response(data_of(s, samples, samples), first, delay, certain)


_Chosen = tuple[Structure, float, FloatArray, tuple[Tried, ...]]


def _behind_response(coarse: Data, found: Response, fixed: Mapping[str, Any]) -> tuple[Data, _Chosen]:
    """The rows behind a dead time and lag, and what is chosen for them."""
    data = dataclasses.replace(coarse, delay=found.delay, time_constant=found.time_constant)
    guess = first_prediction(data)
    structure, weight, tried = choose(data, guess, fixed)
    return data, (structure, weight, guess, tried)


def _decided(data: Data, found: Response, fixed: Mapping[str, Any]) -> tuple[Response, tuple[Data, _Chosen]]:
    """The dead time and lag of which the quick model of `find_response` is not sure, or neither; and what is behind."""
    both = [_behind_response(data, response, fixed) for response in (found.neither, found)]
    late = _is_late(both, fixed)
    return found if late else found.neither, both[late]


def _is_late(both: Sequence[tuple[Data, _Chosen]], fixed: Mapping[str, Any]) -> bool:
    """Whether the final model, without a dead time and lag and with them, keeps them.

    It does unless it predicts later blocks better without: branches may explain what looks like a lag to plays. Both
    are compared with branches where either would take them: what these must lower is another rmse for each.
    """
    without, late = (chosen[-1][-1].rmse for _, chosen in both)
    if without >= late or not fixed["branches"]:
        return without >= NEITHER_IF * late
    branched = [_with_any_branches(*each, fixed) for each in both]
    if any(each.taken for each in branched):
        without, late = (each.least for each in branched)
    return without >= NEITHER_IF * late


def _with_any_branches(data: Data, chosen: _Chosen, fixed: Mapping[str, Any], near: Fit | None = None) -> BranchChoice:
    structure, weight, guess, _ = chosen
    return choose_branches(data, structure, weight, _strain(data, structure, weight, near or guess), fixed)


def _behind(coarse: Data, fine: Data) -> Data:
    """The first with the stage, dead time and lag of the second, and with its columns where these are its own."""
    if fine.dynamics is None:
        return coarse
    return dataclasses.replace(coarse, delay=fine.delay, time_constant=fine.time_constant, dynamics=fine.dynamics)


def _branched(
    plain: Fit, fine: Data, compared: Data, fixed: Mapping[str, Any], stay: bool
) -> tuple[Fit, tuple[Tried, ...]]:
    """The model with branches, if cross-validation asks for them, and what was compared; else the plain one.

    What drifts beside the branches drifts beside the plays of its plain model, too.
    """
    rows, s, of_plain = fine.displacement.size / compared.displacement.size, plain.structure, plain.weight
    taken = choose_branches(compared, s, of_plain / rows, plain.strain, fixed, stay=stay).taken
    if taken is None:
        return plain, ()
    structure, weight, tried = taken
    without = dataclasses.replace(structure, branches=None)
    beside = plain if without == s else fit_structure(fine, without, of_plain, plain.strain)
    fit = fit_structure(fine, structure, weight * rows, plain.strain)
    if fit.model.noise > BRANCHES_GAIN * beside.model.noise:  # what was compared need not have an inverse
        return plain, ()
    return dataclasses.replace(fit, model=fit.model.replace(plain=beside.model)), tried


def _resonances(
    s: Series, static: Data, fixed: Mapping[str, Any], chosen: _Chosen, before: Fit | None
) -> tuple[Dynamics, Structure, float, FloatArray, tuple[Tried, ...]] | None:
    """Modes of the stage with their dead time in place of the delay, and what was chosen behind them.

    None where cross-validation does not ask for them.

    A mode is found between what a static model predicts and the displacement, the next ones from models that were
    fitted behind those before.
    """
    structure, weight, guess, tried = chosen
    searched = _excerpt(s, min(static.volts.size, modes.ROWS), static)
    if np.count_nonzero(searched.fitted(structure.rested)) < FEWEST:
        return None
    pull = weight * searched.displacement.size / static.displacement.size
    searches = _Searches(s, searched, structure, pull, guess)
    found = _searched(searches, None if before is None else before.model.dynamics)
    each = [(dynamics, *_compared(static, dynamics, chosen, searches.last)) for dynamics in found]
    if not each:
        return None
    dynamics, rmse, data, guess = each[-1] if each[-1][1] < OTHERS * each[0][1] else each[0]
    if rmse > tried[-1].rmse:
        return None
    thresholds = {"thresholds": structure.thresholds}
    structure, weight, more = choose(data, guess, {**fixed, **thresholds})
    behind = structure, weight, guess, more
    if more[-1].rmse > RESONATES * tried[-1].rmse:
        return None
    if fixed["branches"] and _is_branches(static, chosen, data, behind, searches.last, fixed):
        return None
    return dynamics, structure, weight, guess, (*tried, *more)


def _compared(static: Data, dynamics: Dynamics, chosen: _Chosen, near: Fit) -> tuple[float, Data, FloatArray]:
    """The rmse of cross-validation behind these modes, um, with the samples and the strain behind them.

    `near` is the last fit of the search that found them.
    """
    structure, weight, *_ = chosen
    data = _behind_modes(static, dynamics)
    strain = _strain(data, structure, weight, near)
    return with_this(data, structure, strain, weight), data, strain


def _is_branches(
    static: Data, chosen: _Chosen, resonant: Data, behind: _Chosen, near: Fit, fixed: Mapping[str, Any]
) -> bool:
    """Whether what looks like a mode behind plays is hysteresis of another kind: branches explain it as well."""
    without = _with_any_branches(static, chosen, fixed, near)
    return without.taken is not None and _with_any_branches(resonant, behind, fixed).least > RESONATES * without.least


class _Searches:
    """Searches for modes, each behind a model that was fitted with those of the one before."""

    def __init__(self, s: Series, static: Data, structure: Structure, weight: float, guess: FloatArray) -> None:
        n = static.volts.size
        first = 0 if structure.rested else static.settled * static.every
        self.static, self.structure, self.weight, self.guess = static, structure, weight, guess[:n]
        self.known, self.z = s.known[:n] & (np.arange(n) >= first), s.displacement[:n] - static.zero
        self.rate, self._fits = s.sample_rate, list[tuple[Dynamics | None, Fit]]()
        self._last: Fit | None = None

    def behind(self, found: Dynamics | None, narrow: bool = True, flat: bool = True, lags: bool = False) -> ModeSearch:
        """A search behind these modes; with `lags` the lag of the model is kept, else it is for the dead time."""
        fit = next((fit for those, fit in self._fits if those is found), None)
        if fit is None:
            fit = self._fit(_behind_modes(self.static, found))
            self._fits.append((found, fit))
        strain, late = (fit.strain, 0.0) if lags else _without_lag(fit, self.static, found)
        return ModeSearch(strain, self.z, self.known, self.rate, narrow, flat, late)

    @property
    def last(self) -> Fit:
        """The latest fit, from which others go on: its strain is about theirs, whatever the modes are."""
        return self._last or self._fit(self.static)

    def _fit(self, data: Data) -> Fit:
        guess = self.guess if self._last is None else self._last
        self._last = fit_structure(data, self.structure, self.weight, guess, certain=False)
        return self._last

    def strain(self, data: Data) -> FloatArray:
        """What a fitted model gives before the stage, um above `Data.zero`."""
        return self._fit(data).strain

    def in_turn(self, found: Dynamics | None, flat: bool = True, lags: bool = False) -> Dynamics | None:
        """Modes behind a strain and strain behind modes until they stay; where one may be hum, without narrow ones."""
        for narrow in (True, False):
            made, more = found, True
            for _ in range(SEARCHES):
                made, more = self.behind(made, narrow, flat, lags).run(made)
                if not more:
                    break
            if made is None or not narrow or not self.behind(made, narrow, lags=True).hums(made):
                break
        return made


def _searched(searches: _Searches, found: Dynamics | None) -> list[Dynamics]:
    """The modes that samples show beyond those that were found; where they may be wrong, those of another search, too.

    They may be where there are none, where one does not ring, or where the model behind them has a lag, which should be
    dead time: the other search has the lag as dead time, and modes that ring alone. Each is found behind a model with
    those before. Where none is, the model without may have followed one.
    """
    made = searches.in_turn(found, lags=True) or _absorbed(searches)
    if made is not None and not modes.flat(made) and abs(searches.behind(made).late) < LAGS:
        return [made]
    others = searches.in_turn(None, flat=False)
    if others is None and made is not None and (ringing := modes.resonant(made)) is not None:
        others = searches.in_turn(ringing, flat=False)
    return [each for each in (made, others) if each is not None]


def _absorbed(searches: _Searches) -> Dynamics | None:
    """The modes beginning with one that the model without has followed, if there is one."""
    static = searches.static
    begun = absorbed(searches.behind(None, lags=True), _behind_modes(static, None), searches.structure, searches.weight)
    if begun is None:
        return None
    without = (searches.z - static.through(searches.strain(static)))[searches.known]
    if searches.behind(begun, lags=True).rms(begun) >= modes.FIRST_LOWER * np.std(without):
        return None
    made = searches.in_turn(begun, lags=True)
    return made if made is not None and searches.behind(made, lags=True).inside(made) else None


def _without_lag(fit: Fit, data: Data, behind: Dynamics | None) -> tuple[FloatArray, float]:
    """The strain of a fit without its lag, um above `Data.zero`, and that lag, samples: the search makes it dead time.

    A lag would keep what the dead time lacks, and each mode would be looked for with a wrong phase. It is taken as far
    as the dead time does not become negative.
    """
    at = fit.model.columns["lag"]
    lag = -float(fit.model.weights[at].sum())
    late = max(lag, 0.0 if behind is None else -behind.dead_time)
    weights = fit.model.weights.copy()
    weights[at] += late
    if not weights[at].size or not late:
        return fit.strain, 0.0
    return fit.model.replace(weights=weights).strain(data.volts, data.sample_rate), late * data.sample_rate


def _behind_modes(data: Data, dynamics: Dynamics | None) -> Data:
    """The same behind modes, whose dead time is in place of a delay, or behind nothing."""
    return dataclasses.replace(data, dynamics=dynamics, delay=0.0, time_constant=0.0)


def _excerpt(s: Series, samples: int, of: Data) -> Data:
    """The first samples of other data, with more rows of them."""
    every = -(-samples // SEARCH_ROWS)
    z, known = (s.displacement - of.zero)[:samples:every], s.known[:samples:every]
    return dataclasses.replace(of, volts=of.volts[:samples], displacement=z, known=known, every=every)


def _strain(data: Data, structure: Structure, weight: float, guess: FloatArray | Fit) -> FloatArray:
    """What a fitted model gives before the stage, um above `Data.zero`."""
    return fit_structure(data, structure, weight, guess, certain=False).strain


def data_of(s: Series, samples: int, rows: int) -> Data:
    """The first samples for the fit; of the others, the range of the voltage and its rate.

    The zero is the first that the record comes near: the sensor's own, the straight line's displacement at 0 V, or its
    least displacement: asymmetry is estimated from travel between 0 and the stroke.
    """
    x, z = s.volts[:samples], s.displacement[:samples]
    stroke = float(np.ptp(z) * np.ptp(s.volts) / np.ptp(x))
    every = -(-x.size // rows)
    middle, span = float(x.mean()), float(np.ptp(x))
    u = (x - middle) / span  # of a voltage far from 0 beside its span, too
    zeros = 0.0, float(z.mean() - middle / span * (u @ z) / (u @ u)), float(z.min())
    zero = next(a for a in zeros if z.min() - NEAR * stroke <= a <= z.max() + NEAR * stroke)
    return Data(
        volts=x,
        displacement=(z - zero)[::every],
        known=s.known[:samples:every],
        sample_rate=s.sample_rate,
        every=every,
        voltage_range=(float(s.volts.min()), float(s.volts.max())),
        stroke=stroke,
        zero=zero,
        fastest=float(np.abs(central_difference(s.volts, s.sample_rate)).max()) * stroke / float(np.ptp(s.volts)),
        duration=s.volts.size / s.sample_rate,
    )
