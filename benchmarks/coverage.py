"""How many held-out samples the 95 % intervals of `identify` hold, on records of actuators that are not the model.

python -m benchmarks.coverage                                  all foreign records; minutes
python -m benchmarks.coverage --records Preisach --seed 1      those whose description has the word
python -m benchmarks.coverage --unseen                         of other actuators
python -m benchmarks.coverage --further                        of fifteen more, of which no rule was made
python -m benchmarks.coverage --other                          of sixteen more
python -m benchmarks.coverage --all                            of all of these
python -m benchmarks.coverage measured.dat --columns 1 5 --sample-rate 200

The last lines have what an interval would hold that knew the spectrum of the errors of each record, and no more: it
holds 95 % on average, but errors that are slow, or few cycles of them, make a single share more or less.
"""

import argparse

import numpy as np
from benchmarks import foreign_records, further_records, other_records, unseen_records

from truestroke import read_record
from truestroke.identification import identify

BAND = 0.895, 0.975
DRAWS, ROWS = 200, 20_000  # of errors with the spectrum of those of a record, and of these at most


def perfect(errors: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shares that an interval of 1.96 times the true deviation holds of normal errors with the spectrum of these."""
    u = errors[:: -(-errors.size // ROWS)]
    size = np.abs(np.fft.rfft(u))
    drawn = (rng.standard_normal((DRAWS, size.size)) + 1j * rng.standard_normal((DRAWS, size.size))) / np.sqrt(2)
    alone = [0, -1] if u.size % 2 == 0 else [0]  # of the mean and of the highest frequency, which are real
    drawn[:, alone] = rng.standard_normal((DRAWS, len(alone)))
    made = np.fft.irfft(drawn * size, u.size, axis=1)
    return np.asarray(np.mean(np.abs(made) <= 1.96 * np.sqrt(np.mean(u**2)), axis=1))


def summary(shares: np.ndarray, drawn: np.ndarray) -> None:
    """Records within the band, below and above it, and the mean share: as they are, and of perfect intervals."""
    print("\n| intervals | 90 to 97 % | below | above | mean, % | median, % |\n|---|---|---|---|---|---|")
    for name, each in (("these", shares[:, None]), ("perfect", drawn)):
        below, above = each < BAND[0], each >= BAND[1]
        counts = [np.sum(kept, axis=0) for kept in (~(below | above), below, above)]
        cells = [f"{count.mean():.3g}{f' +- {count.std():.2g}' if count.size > 1 else ''}" for count in counts]
        mean = 100 * each.mean(axis=0)
        cells.append(f"{mean.mean():.1f}{f' +- {mean.std():.1f}' if mean.size > 1 else ''}")
        print(f"| {name} | {' | '.join(cells)} | {100 * np.median(each):.1f} |")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*", help="measured records in place of the foreign ones")
    parser.add_argument("--columns", nargs=2, type=int, default=(1, 2), help="of voltage and displacement, from 1")
    parser.add_argument("--sample-rate", type=float)
    parser.add_argument("--records", default="")
    parser.add_argument("--unseen", action="store_true", help="the records of unseen_records.py in their place")
    parser.add_argument("--further", action="store_true", help="those of further_records.py")
    parser.add_argument("--other", action="store_true", help="those of other_records.py")
    parser.add_argument("--all", action="store_true", help="all four sets")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    sets = (asked.further, further_records), (asked.other, other_records), (asked.unseen, unseen_records)
    of = [chosen for wanted, chosen in sets if wanted or asked.all] or [foreign_records]
    of = [foreign_records, *of] if asked.all else of
    volts, moved = asked.columns
    chosen = [
        read_record(file, volts=volts, displacement=moved, sample_rate=asked.sample_rate) for file in asked.files
    ] or [r for each in of for r in each.records(asked.seed) if asked.records.lower() in r.source.lower()]
    print("| record | held-out rmse, % | half width, % | held, % |\n|---|---|---|---|")
    shares, drawn, rng = [], [], np.random.Generator(np.random.PCG64(asked.seed))
    for record in chosen:
        found = identify(record)
        trace = found.trace
        judged = trace.held_out & trace.known
        shares.append(found.held_out.coverage)
        drawn.append(perfect((trace.residual / trace.half_width)[judged], rng))
        width = 100 * np.median(trace.half_width[trace.held_out]) / np.ptp(trace.displacement)
        print(
            f"| {record.source} | {found.held_out.rmse_percent:.2f} | {width:.2f} | {100 * shares[-1]:.0f} |",
            flush=True,
        )
    summary(np.array(shares), np.array(drawn))


if __name__ == "__main__":
    main()
