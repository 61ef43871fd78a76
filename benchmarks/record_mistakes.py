"""Mistakes planted in correct records: which of them `examine` finds, and that it refuses no correct record.

python -m benchmarks.record_mistakes              the table of docs/identify.md; some minutes
python -m benchmarks.record_mistakes --averaged   moving averages of both columns: verdict and error of the model
python -m benchmarks.record_mistakes --jumps      a zero that jumps beneath 1 % of noise: verdicts; half an hour
python -m benchmarks.record_mistakes --changes    a gain that changes, rows that are lost, so as well; half an hour
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from benchmarks import foreign_records, further_records, other_records, unseen_records
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, lfilter

from truestroke import plant, trajectories
from truestroke.identification import Record, RecordError, examine, identify, read_record
from truestroke.identification.records import turning

SHARED = Path(os.environ.get("TRUESTROKE_SHARED", Path(__file__).resolve().parents[2] / "shared"))
MEASURED = SHARED / "data" / "p885_91" / "Model_Vi_Do.dat"

Columns = Mapping[str, np.ndarray]
Planted = tuple[Columns, Mapping[str, object]]  # columns with their headings, and arguments of `read_record`

# ---- Correct records -------------------------------------------------------------------------------------------------


def correct() -> Iterator[Record]:
    """The measured record, those of foreign_records.py, two simulated ones."""
    if MEASURED.is_file():
        yield read_record(MEASURED, volts=1, displacement=5, sample_rate=200.0)
    yield from foreign_records.records()
    yield from (simulated(seed) for seed in (3, 5))


def simulated(seed: int, duration: float = 10.0) -> Record:
    wave = trajectories.random_wave(duration=duration, seed=seed)
    stack, volts = plant.RealisticPlant(seed=seed), wave.position / 10.0
    stack.open()
    return Record.from_arrays(volts, stack.exchange(volts), time=wave.time, source=f"simulated stack, seed {seed}")


# ---- Mistakes --------------------------------------------------------------------------------------------------------


def nothing(r: Record) -> Planted:
    """None"""
    return named(r.time, r.volts, r.displacement), {}


def sample_rate(r: Record) -> Planted:
    """A sample rate five times that of the time stamps"""
    return named(r.time, r.volts, r.displacement), {"sample_rate": 5 * r.sample_rate}


def slightly(r: Record) -> Planted:
    """A sample rate 2 % above that of the time stamps"""
    return named(r.time, r.volts, r.displacement), {"sample_rate": 1.02 * r.sample_rate}


def milliseconds(r: Record) -> Planted:
    """Seconds labelled ms"""
    return {"time (ms)": r.time, "volts (V)": r.volts, "z (um)": r.displacement}, {}


def seconds(r: Record) -> Planted:
    """ms labelled s"""
    return named(1e3 * r.time, r.volts, r.displacement), {}


def millivolts(r: Record) -> Planted:
    """mV labelled V"""
    return named(r.time, 1e3 * r.volts, r.displacement), {}


def fraction(r: Record) -> Planted:
    """The voltage at 0.15 of its size, labelled V"""
    return named(r.time, 0.15 * r.volts, r.displacement), {}


def sensor_volts(r: Record) -> Planted:
    """A sensor's V, 10 um/V, read as um although the heading says V"""
    return {"time": r.time, "volts": r.volts, "z (V)": r.displacement / 10}, {"displacement_unit": "um"}


def sensor_volts_labelled(r: Record) -> Planted:
    """The same, labelled um"""
    return named(r.time, r.volts, r.displacement / 10), {}


def nanometres(r: Record) -> Planted:
    """um labelled nm"""
    return {"time (s)": r.time, "volts (V)": r.volts, "z (nm)": r.displacement}, {}


def millimetres(r: Record) -> Planted:
    """mm labelled um"""
    return named(r.time, r.volts, r.displacement / 1e3), {}


def swapped(r: Record) -> Planted:
    """Voltage and displacement swapped"""
    return named(r.time, r.displacement, r.volts), {}


def command(r: Record) -> Planted:
    """The command, voltage times gain, in place of the displacement"""
    gain = np.ptp(r.displacement) / np.ptp(r.volts)
    return named(r.time, r.volts, r.displacement[0] + gain * (r.volts - r.volts[0])), {}


def late_command(r: Record) -> Planted:
    """The same a row later and rounded to 1 in 100,000, as a file has it"""
    gain, digit = np.ptp(r.displacement) / np.ptp(r.volts), 1e-5 * np.ptp(r.displacement)
    return named(r.time[1:], r.volts[1:], digit * np.round(gain * r.volts[:-1] / digit)), {}


def set_point(r: Record) -> Planted:
    """A fifth of the displacement's command in place of the voltage, as of a closed loop"""
    return named(r.time, 0.2 * gaussian_filter1d(r.displacement, 1.0), r.displacement), {}


def early(r: Record) -> Planted:
    """The displacement a tenth of a stroke too early"""
    n = shift(r, 0.1)
    return named(r.time[:-n], r.volts[:-n], r.displacement[n:]), {}


def late(r: Record) -> Planted:
    """The displacement a third of a stroke too late"""
    n = shift(r, 0.33)
    return named(r.time[n:], r.volts[n:], r.displacement[:-n]), {}


def very_late(r: Record) -> Planted:
    """The displacement a whole stroke too late"""
    n = shift(r, 1.0)
    return named(r.time[n:], r.volts[n:], r.displacement[:-n]), {}


def stopped(r: Record) -> Planted:
    """The sensor stops after three fifths of the record"""
    kept = np.arange(r.time.size) < round(0.6 * r.time.size)
    return named(r.time, r.volts, np.where(kept, r.displacement, r.displacement[kept][-1])), {}


def moved(r: Record) -> Planted:
    """The zero of the sensor jumps by 15 % of the stroke after three fifths of the record"""
    after = np.arange(r.time.size) >= round(0.6 * r.time.size)
    return named(r.time, r.volts, r.displacement + 0.15 * np.ptp(r.displacement) * after), {}


def overflown(r: Record) -> Planted:
    """The counter of the sensor runs over at three fifths of the stroke"""
    return named(r.time, r.volts, (r.displacement - r.displacement.min()) % (0.6 * np.ptp(r.displacement))), {}


def spiked(r: Record) -> Planted:
    """Every 97th row reads twice the stroke"""
    wrong = np.arange(r.time.size) % 97 == 50
    return named(r.time, r.volts, np.where(wrong, 2 * r.displacement.max(), r.displacement)), {}


def coupled(r: Record) -> Planted:
    """An AC-coupled displacement: a corner at a tenth of the frequency of the strokes"""
    corner = min(0.1 / (2 * shift(r, 1.0)), 0.2)  # of the sample rate
    return named(r.time, r.volts, lfilter(*butter(1, 2 * corner, "high"), r.displacement - r.displacement[0])), {}


def lost(r: Record) -> Planted:
    """From the middle on the displacement has lost a quarter of a stroke of rows"""
    n, half = shift(r, 0.25), r.time.size // 2
    return named(r.time[:-n], r.volts[:-n], np.concatenate([r.displacement[:half], r.displacement[half + n :]])), {}


def another(r: Record) -> Planted:
    """From the middle on another actuator, with three quarters of the gain"""
    z, half = r.displacement, r.time.size // 2
    return named(r.time, r.volts, np.concatenate([z[:half], z[half] + 0.75 * (z[half:] - z[half])])), {}


def warming(r: Record) -> Planted:
    """The gain grows by 20 % in the course of the record"""
    return named(r.time, r.volts, r.displacement * np.linspace(1.0, 1.2, r.time.size)), {}


def copied(r: Record) -> Planted:
    """One row in fifty written twice, without time stamps"""
    rows = np.sort(np.concatenate([np.arange(r.time.size), np.arange(25, r.time.size, 50)]))
    return {"volts (V)": r.volts[rows], "z (um)": r.displacement[rows]}, {"sample_rate": r.sample_rate}


def counted(r: Record) -> Planted:
    """Numbers of the rows labelled s"""
    return named(np.arange(float(r.time.size)), r.volts, r.displacement), {}


def aliased(r: Record) -> Planted:
    """Sampled 1.4 times in a stroke"""
    every = max(2, shift(r, 1 / 1.4))
    return named(r.time[::every], r.volts[::every], r.displacement[::every]), {}


def monitor(r: Record) -> Planted:
    """A monitor of 1:100 taken for the voltage, called V_mon"""
    return {"time (s)": r.time, "V_mon (V)": r.volts / 100, "z (um)": r.displacement}, {}


def unstated(r: Record) -> Planted:
    """A sensor's V, 10 um/V, in a column without a unit"""
    return {"time (s)": r.time, "volts (V)": r.volts, "z": (r.displacement - r.displacement.mean()) / 10}, {}


def joined(r: Record) -> Planted:
    """A third of a stroke of rows lost by both channels in the middle, without time stamps"""
    half, n = r.time.size // 2, shift(r, 0.33)
    kept = np.r_[:half, half + n : r.time.size]
    return {"volts (V)": r.volts[kept], "z (um)": r.displacement[kept]}, {"sample_rate": r.sample_rate}


def thinned(r: Record) -> Planted:
    """A tenth of the rows lost, each by itself, without time stamps"""
    kept = np.random.default_rng(5).random(r.time.size) > 0.1
    return {"volts (V)": r.volts[kept], "z (um)": r.displacement[kept]}, {"sample_rate": r.sample_rate}


def doubled(r: Record) -> Planted:
    """A tenth of the rows, a block, written twice, without time stamps"""
    a, b = (round(share * r.time.size) for share in (0.3, 0.4))
    rows = np.r_[:b, a : r.time.size]
    return {"volts (V)": r.volts[rows], "z (um)": r.displacement[rows]}, {"sample_rate": r.sample_rate}


def filled(r: Record) -> Planted:
    """Nine holes of a tenth of a stroke in the displacement, filled by lines"""
    z, n = r.displacement.copy(), max(10, shift(r, 0.1))
    for a in np.linspace(0.08, 0.88, 9) * r.time.size:
        k = int(a)
        z[k : k + n] = np.linspace(z[k - 1], z[k + n], n + 2)[1:-1]
    return named(r.time, r.volts, z), {}


def multiplied(r: Record) -> Planted:
    """Four rows of each by lines, for a higher sample rate"""
    k = np.arange(4 * (r.time.size - 1)) / 4
    return named(*(np.interp(k, np.arange(r.time.size), values) for values in (r.time, r.volts, r.displacement))), {}


def sorted_rows(r: Record) -> Planted:
    """Rows sorted by the voltage, without time stamps"""
    rows = np.argsort(r.volts, kind="stable")
    return {"volts (V)": r.volts[rows], "z (um)": r.displacement[rows]}, {"sample_rate": r.sample_rate}


def two_clocks(r: Record) -> Planted:
    """The displacement by a clock that is 3 in 1000 slower"""
    k = np.arange(r.time.size)
    return named(r.time, r.volts, np.interp(0.997 * k, k, r.displacement)), {}


def counts(r: Record) -> Planted:
    """Counts of an encoder, a thousand for the stroke, labelled um"""
    z = r.displacement
    return named(r.time, r.volts, np.round(1000 * (z - z.min()) / np.ptp(z))), {}


def normalised(r: Record) -> Planted:
    """Displacement over its span, labelled um"""
    return named(r.time, r.volts, (r.displacement - r.displacement.min()) / np.ptp(r.displacement)), {}


def centred(r: Record) -> Planted:
    """The means of both signals taken off"""
    return named(r.time, r.volts - r.volts.mean(), r.displacement - r.displacement.mean()), {}


def one_way(r: Record) -> Planted:
    """Only rows in which the voltage rises, without time stamps"""
    rises = np.flatnonzero(np.gradient(r.volts) > 0)
    return {"volts (V)": r.volts[rises], "z (um)": r.displacement[rises]}, {"sample_rate": r.sample_rate}


def share_of_volts(r: Record) -> Planted:
    """Voltage over its span, labelled V"""
    return named(r.time, (r.volts - r.volts.min()) / np.ptp(r.volts), r.displacement), {}


def percent(r: Record) -> Planted:
    """Both in % of their spans, and the headings say so"""
    x, z = (100 * (a - a.min()) / np.ptp(a) for a in (r.volts, r.displacement))
    return {"time (s)": r.time, "volts (%)": x, "z (%)": z}, {}


def voltage_lost(r: Record) -> Planted:
    """The voltage is written as 0 V in the last tenth of the rows"""
    recorded = np.arange(r.time.size) < 0.9 * r.time.size
    return named(r.time, r.volts * recorded, r.displacement), {}


def named(time: np.ndarray, volts: np.ndarray, displacement: np.ndarray) -> Columns:
    return {"time (s)": time, "volts (V)": volts, "z (um)": displacement}


def shift(r: Record, share: float) -> int:
    """Rows of a share of the median stroke, at least three."""
    turns = turning.reversals(r.volts, turning.STROKE * float(np.ptp(r.volts)))
    return max(3, round(share * float(np.median(np.diff(turns)))))


MISTAKES: tuple[Callable[[Record], Planted], ...] = (
    nothing,
    sample_rate,
    slightly,
    milliseconds,
    seconds,
    millivolts,
    fraction,
    sensor_volts,
    sensor_volts_labelled,
    nanometres,
    millimetres,
    swapped,
    command,
    late_command,
    set_point,
    early,
    late,
    very_late,
    stopped,
    moved,
    overflown,
    spiked,
    coupled,
    lost,
    another,
    warming,
    copied,
    counted,
    aliased,
    monitor,
    unstated,
    joined,
    thinned,
    doubled,
    filled,
    multiplied,
    sorted_rows,
    two_clocks,
    counts,
    normalised,
    centred,
    one_way,
    share_of_volts,
    percent,
    voltage_lost,
)


def found(record: Record, mistake: Callable[[Record], Planted]) -> tuple[str, str]:
    """What `identify` refuses the record with, planted as a file, and what makes it doubtful; or empty."""
    columns, arguments = mistake(record)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "record.npz")
        np.savez(file, **columns)  # type: ignore[arg-type]
        try:
            findings = examine(read_record(file, **arguments))  # type: ignore[arg-type]
        except RecordError as error:
            return str(error), ""
    falls = "the displacement falls as the voltage rises" if findings.correlation < 0 else ""
    return "; ".join(findings.mistakes) or falls, "; ".join(findings.implausible)


def table(records: Iterable[Record]) -> dict[str, tuple[int, int, int, list[str]]]:
    """For each mistake: in how many records it is found, in how many doubted, of how many; those with neither."""
    kept = [record for record in records if record.volts.size >= 400]
    rows = {}
    for mistake in MISTAKES:
        texts = [found(record, mistake) for record in kept]
        missed = [record.source for record, seen in zip(kept, texts, strict=True) if not any(seen)]
        refused, doubted = (sum(map(bool, column)) for column in zip(*texts, strict=True))
        rows[str(mistake.__doc__)] = (refused, doubted, len(kept), missed)
    return rows


def averaged(share: float) -> Iterator[str]:
    """Of four records whose columns are means over a share of a stroke: what `identify` says, and true errors."""
    for r in (simulated(3), *(r for k, r in enumerate(foreign_records.records()) if k in (5, 8, 9))):
        rows = max(1, round(share * shift(r, 1.0)))
        x, z = (np.convolve(a, np.full(rows, 1 / rows), "valid") for a in (r.volts, r.displacement))
        found = identify(Record.from_arrays(x, z, time=r.time[rows - 1 :], source=r.source))
        later = slice(r.time.size // 5, None)
        error = (r.displacement - found.model.predict(r.volts, r.sample_rate))[later]
        true = 100 * float(np.std(error)) / float(np.ptp(r.displacement))
        yield f"| {r.source} | {share:.2g} | {found.held_out.rmse_percent:.2f} | {true:.2f} | {found.verdict.level} |"


def jumps(seed: int = 1) -> None:
    """Which records of all four sets, with 1 % of noise, are `good`, and say that the zero jumped, by 2 % or not."""
    sets = foreign_records, further_records, other_records, unseen_records
    records, random, verdicts = [r for one in sets for r in one.records(seed)], np.random.default_rng(seed), []
    for number, r in enumerate(records):
        z, stroke = r.displacement, float(np.ptp(r.displacement))
        noisy = z + 0.01 * stroke * random.standard_normal(z.size)
        after = 0.02 * stroke * (np.arange(z.size) >= random.integers(z.size))
        each = [seen(Record.from_arrays(r.volts, z, time=r.time, source=r.source)) for z in (r.displacement, noisy)]
        if each[1][0] == "good":
            each.append(seen(Record.from_arrays(r.volts, noisy + after, time=r.time, source=r.source)))
        verdicts.append(each)
        print(f"{number:3} {each} {r.source}", flush=True)
    of_jump = [each[2] for each in verdicts if len(each) == 3]
    print(
        f"{sum(jump for each in verdicts for _, jump in each[:2])} of {2 * len(verdicts)} correct records have a jump"
    )
    print(
        f"{len(of_jump)} are good with noise; with a jump of 2 % {sum(level == 'good' for level, _ in of_jump)} are, "
        f"and {sum(jump for _, jump in of_jump)} say it"
    )


def changes(seed: int = 5) -> None:
    """Of the same records with 0.3 to 2.5 % of noise: which are `good`, and still are with a change at some row."""
    sets = foreign_records, further_records, other_records, unseen_records
    records, random = [r for one in sets for r in one.records(seed)], np.random.default_rng(seed + 1000)
    of_right, planted = list[tuple[str, bool]](), {"gain": list[tuple[str, bool]](), "rows": list[tuple[str, bool]]()}
    for number, r in enumerate(records):
        stroke, rows = float(np.ptp(r.displacement)), r.time.size
        z = r.displacement + 0.01 * 10 ** random.uniform(-0.5, 0.4) * stroke * random.standard_normal(rows)
        at, sign = int(random.integers(0.15 * rows, 0.9 * rows)), int(random.choice([-1, 1]))
        made = {"": Record.from_arrays(r.volts, z, time=r.time, source=r.source)}
        after = 0.05 * sign * (z - random.uniform(0, 1) * stroke - z.min()) * (np.arange(rows) >= at)
        made["gain"] = Record.from_arrays(r.volts, z + after, time=r.time, source=r.source)
        short = np.delete(z, range(at, at + 3))
        made["rows"] = Record.from_arrays(r.volts[:-3], short, time=r.time[:-3], source=r.source)
        of_right.append(seen(made[""], CHANGED))
        line = [of_right[-1]]
        for name in planted if of_right[-1][0] == "good" else ():
            planted[name].append(seen(made[name], CHANGED))
            line.append(planted[name][-1])
        print(f"{number:3} {line} {r.source}", flush=True)
    said, good = (sum(counted) for counted in zip(*((says, level == "good") for level, says in of_right), strict=True))
    print(f"{said} of {len(of_right)} correct records have a change; {good} are good")
    for name, words in (("gain", "5 % of gain more or less"), ("rows", "three rows lost")):
        still, says = sum(level == "good" for level, _ in planted[name]), sum(says for _, says in planted[name])
        print(f"with {words} {still} of these still are, and {says} say it")


JUMPED = ("did the zero of the sensor jump",)
CHANGED = "did the gain or the range", "did one channel lose rows"


def seen(record: Record, questions: tuple[str, ...] = JUMPED) -> tuple[str, bool]:
    """The level of the verdict, and whether it asks one of these; "refused" where `identify` refuses it."""
    try:
        verdict = identify(record).verdict
    except RecordError:
        return "refused", False
    return verdict.level, any(question in reason for question in questions for reason in verdict.reasons)


def main() -> None:
    if "--jumps" in sys.argv:
        jumps()
        return
    if "--changes" in sys.argv:
        changes()
        return
    if "--averaged" in sys.argv:
        print(
            "| record | mean over, strokes | held out, % | of the record itself, % | verdict |\n|---|---|---|---|---|"
        )
        for share in (0.0, 1 / 15, 0.1, 0.3, 0.6, 1.0):
            for row in averaged(share):
                print(row, flush=True)
        return
    print("| mistake | refused | doubtful | neither |")
    print("|---|---|---|---|")
    for name, (hits, doubted, of, missed) in table(correct()).items():
        names = "; ".join(Path(source).name.split(":")[0] for source in missed) if hits and missed else ""
        print(f"| {name} | {hits} of {of} | {doubted or ''} | {names} |", flush=True)


if __name__ == "__main__":
    main()
