"""How many held-out samples the 95 % intervals of `identify` hold, on records of actuators that are not the model.

python -m benchmarks.coverage                                  all foreign records; minutes
python -m benchmarks.coverage --records Preisach --seed 1      those whose description has the word
python -m benchmarks.coverage --unseen                         of other actuators
python -m benchmarks.coverage --further                        of fifteen more, of which no rule was made
python -m benchmarks.coverage --other                          of sixteen more
python -m benchmarks.coverage measured.dat --columns 1 5 --sample-rate 200
"""

import argparse

import numpy as np
from benchmarks import foreign_records, further_records, other_records, unseen_records

from truestroke import read_record
from truestroke.identification import identify


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*", help="measured records in place of the foreign ones")
    parser.add_argument("--columns", nargs=2, type=int, default=(1, 2), help="of voltage and displacement, from 1")
    parser.add_argument("--sample-rate", type=float)
    parser.add_argument("--records", default="")
    parser.add_argument("--unseen", action="store_true", help="the records of unseen_records.py in their place")
    parser.add_argument("--further", action="store_true", help="those of further_records.py")
    parser.add_argument("--other", action="store_true", help="those of other_records.py")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    sets = (asked.further, further_records), (asked.other, other_records), (asked.unseen, unseen_records)
    of = next((chosen for wanted, chosen in sets if wanted), foreign_records)
    volts, moved = asked.columns
    chosen = [
        read_record(file, volts=volts, displacement=moved, sample_rate=asked.sample_rate) for file in asked.files
    ] or [r for r in of.records(asked.seed) if asked.records.lower() in r.source.lower()]
    print("| record | held-out rmse, % | half width, % | held, % |\n|---|---|---|---|")
    shares = []
    for record in chosen:
        found = identify(record)
        shares.append(found.held_out.coverage)
        width = 100 * np.median(found.trace.half_width[found.trace.held_out]) / np.ptp(found.trace.displacement)
        print(
            f"| {record.source} | {found.held_out.rmse_percent:.2f} | {width:.2f} | {100 * shares[-1]:.0f} |",
            flush=True,
        )
    low, middle, high = np.percentile(shares, [10, 50, 90])
    right = sum(0.895 <= share < 0.975 for share in shares)
    print(f"90 to 97 % of the samples on {right}, fewer on {sum(share < 0.895 for share in shares)}")
    print(f"10, 50, 90 % of {len(shares)} records: {100 * low:.0f}, {100 * middle:.0f}, {100 * high:.0f} %")


if __name__ == "__main__":
    main()
