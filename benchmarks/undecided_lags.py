"""Where the quick model of `identify` hardly prefers a lag, and the final one decides: decision 200 on and off.

    python -m benchmarks.undecided_lags                    192 records, some minutes on two idle cores
    python -m benchmarks.undecided_lags --kinds coercive   those of kinds with this word
    python -m benchmarks.undecided_lags --seed 10          other records

Eight kinds of hysteresis, three motions, no lag, lags of 3 and 10 ms and 4 ms of dead time, 400 Hz, seeds S and S + 1.
Each record that is undecided is identified as it is, and with the lag kept, whatever the final model says. A row for
each kind: how many lose their lag, and the errors of those, % of peak-to-peak, on the last part of the record and on
another motion of the same actuator, from the least to the largest.
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from unittest import mock

import numpy as np
from benchmarks import foreign_records as made
from benchmarks.other_records import polarisation

from truestroke.identification import Identified, Record, identify, score
from truestroke.identification.fitting import procedure

RATE, SECONDS = 400.0, 20.0
NOISE = 0.002  # um rms, of a motion of some 10 um
LATE = {"none": (0.0, 0.0), "3 ms": (0.003, 0.0), "10 ms": (0.01, 0.0), "dead 4 ms": (0.0, 0.004)}  # s: lag, dead time

Actuator = Callable[[np.ndarray, np.random.Generator], np.ndarray]
KINDS: Mapping[str, Actuator] = {
    "coercive field of 0.25": lambda v, rng: polarisation(2 * v - 1, rng, 0.25),
    "coercive field of 0.45": lambda v, rng: polarisation(2 * v - 1, rng, 0.45),
    "Jiles-Atherton": lambda v, _: made.jiles_atherton(2 * v - 1),
    "Duhem": lambda v, _: made.duhem(v),
    "Preisach": made.preisach,
    "Bouc-Wen": lambda v, _: made.bouc_wen(v),
    "Dahl": lambda v, _: made.dahl(v),
    "curved plays": lambda v, _: made.generalised_plays(v),
}
MOTIONS: Mapping[str, Actuator] = {
    "sines": lambda t, rng: 0.5 + (made.sine(t, 1.0) - 0.5) * rng.uniform(0.3, 1.0, 99)[t.astype(int)],
    "triangles": lambda t, rng: made.up_and_down(t, 1.5) * rng.uniform(0.3, 1.0, 99)[(1.5 * t).astype(int)],
    "wave": lambda t, rng: made.wave(t, rng, 6.0),
}


@dataclass(frozen=True)
class Case:
    """A record, and one of another motion of the same actuator."""

    kind: str
    record: Record
    other: Record


def cases(seed: int, word: str) -> Iterator[Case]:
    """All of both seeds whose kind has the word."""
    each = itertools.product(enumerate(KINDS), enumerate(MOTIONS), LATE, (seed, seed + 1))
    for (i, kind), (j, motion), lag, one in each:
        if word.lower() in kind.lower():
            faster = next(name for name in reversed(MOTIONS) if name != motion)
            yield Case(kind, *(_record(kind, moved, lag, (one, i, j)) for moved in (motion, faster)))


def _record(kind: str, motion: str, late: str, seed: tuple[int, int, int]) -> Record:
    t, (lag, dead) = made.clock(SECONDS, RATE), LATE[late]
    rng = np.random.default_rng([*seed, list(MOTIONS).index(motion)])
    v = MOTIONS[motion](t, rng)
    y = KINDS[kind](v, np.random.default_rng(seed[0]))  # the same actuator in both motions
    y = made.lagged(y, RATE, lag) if lag else y
    y = made.late(t, y, dead) if dead else y
    return Record.from_arrays(
        100 * v, 10 * y + rng.normal(0, NOISE, t.size), time=t, source=f"{kind}: {motion}, {late}"
    )


@dataclass(frozen=True)
class Decided:
    """Errors without and with decision 200, % of peak-to-peak: of the last part, of another motion."""

    before: tuple[float, float]
    now: tuple[float, float]


def decided(case: Case) -> Decided | None:
    """None where the quick model is sure, or the final one keeps the lag that it prefers."""
    with mock.patch.object(procedure, "_is_late", wraps=procedure._is_late) as asked:
        now = identify(case.record)
    if not asked.called:
        return None
    with mock.patch.object(procedure, "_is_late", return_value=True):
        before = identify(case.record)
    if (before.response.delay, before.response.time_constant) == (now.response.delay, now.response.time_constant):
        return Decided(_errors(now, case.other), _errors(now, case.other))
    return Decided(_errors(before, case.other), _errors(now, case.other))


def _errors(found: Identified, other: Record) -> tuple[float, float]:
    return found.held_out.rmse_percent, score(found.model, other).rmse_percent


def _span(errors: list[float]) -> str:
    return f"{min(errors):.2g} to {max(errors):.2g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="", help="only those with this word")
    parser.add_argument("--seed", type=int, default=0, help="the first of two")
    asked = parser.parse_args()
    print("| kind | undecided | lose their lag | held out, before | now | other motion, before | now |")
    print("|---" * 7 + "|")
    ratios: list[tuple[float, float]] = []
    for kind, group in itertools.groupby(cases(asked.seed, asked.kinds), key=lambda case: case.kind):
        found = [one for one in map(decided, group) if one is not None]
        lost = [one for one in found if one.before != one.now]
        ratios += [(one.now[0] / one.before[0], one.now[1] / one.before[1]) for one in lost]
        columns = [
            [of[part] for of in ends]
            for part in (0, 1)
            for ends in zip(*((o.before, o.now) for o in lost), strict=True)
        ]
        shown = " | ".join(map(_span, columns)) if lost else " | ".join("-" * 4)
        print(f"| {kind} | {len(found)} | {len(lost)} | {shown} |", flush=True)
    if ratios:
        means = np.exp(np.log(ratios).mean(axis=0))
        print(f"geometric means of now over before: {means[0]:.2f} held out, {means[1]:.2f} on another motion")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
