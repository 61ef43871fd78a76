"""Records that are possible but rare make a model doubtful, each with its evidence; correct ones do not."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks import foreign_records
from scipy.signal import butter, lfilter

from truestroke import plant, trajectories
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.identification import Findings, Record, examine, read_record
from truestroke.identification.examination.rare import nonlinear
from truestroke.identification.fitting.modes import ModeSearch
from truestroke.identification.fitting.regression import plays

RATE = 1000.0
T = np.arange(3000) / RATE


@pytest.fixture(scope="module")
def good() -> tuple[FloatArray, FloatArray]:
    """Two tones, 0 to 100 V, through plays: 15 um with 2 nm of noise, late by 1 ms."""
    x = 50 - 30 * np.cos(2 * np.pi * 3 * T) - 20 * np.cos(2 * np.pi * 7 * T)
    bent = np.insert(np.asarray(plays(x, (0.0, 5.0, 10.0, 20.0)) @ (0.09, 0.02, 0.02, 0.02))[:-1], 0, 0.0)
    return x, bent + 0.002 * noise(1)


def noise(seed: int) -> FloatArray:
    return np.random.default_rng(seed).standard_normal(T.size)


def written(
    folder: Path, x: FloatArray, z: FloatArray, heading: str = "t (s),volts (V),z (um)", rate: float = RATE
) -> Path:
    table = np.column_stack([np.arange(x.size) / rate, x, z])
    np.savetxt(folder / "a.csv", table, delimiter=",", header=heading, comments="", fmt="%.9g")
    return folder / "a.csv"


def asked(file: Path, **options: object) -> tuple[str, ...]:
    found: Findings = examine(read_record(file, **options))  # type: ignore[arg-type]
    assert not found.mistakes
    return found.implausible


def test_a_correct_record_raises_none_at_any_rate_and_stroke(
    good: tuple[FloatArray, FloatArray], tmp_path: Path
) -> None:
    x, z = good
    assert asked(written(tmp_path, x, z)) == ()
    assert asked(written(tmp_path, 10 * x - 500, z)) == ()
    assert asked(written(tmp_path, x / 10, 30 * z)) == ()
    assert asked(written(tmp_path, x, 5 * z + 0.5 * noise(3), "t (s),volts (V),z (nm)")) == ()
    assert asked(written(tmp_path, x, z, rate=50.0)) == ()


@pytest.mark.parametrize(("bits", "digits"), [(16, 5), (12, 4)])
def test_the_steps_of_a_converter_are_those_of_volts(
    good: tuple[FloatArray, FloatArray], tmp_path: Path, bits: int, digits: int
) -> None:
    """A sensor of 5 um/V that is labelled um; a step of 0.001 um is one of a file."""
    x, z = good
    step = 20.0 / 2**bits
    volts = np.round(step * np.round((z + 0.02 * noise(2)) / 5 / step), digits)
    (text,) = asked(written(tmp_path, x, volts))
    assert f"in steps of {step:.6g} um" in text
    assert asked(tmp_path / "a.csv", displacement_unit="um") == ()
    assert asked(written(tmp_path, x, np.round(z / 5 + 0.002 * noise(2), 3))) == ()


def test_without_hysteresis_it_is_a_command_or_a_closed_loop(good: tuple[FloatArray, FloatArray]) -> None:
    x, z = good
    late = 0.15 * np.concatenate([[x[0]] * 2, 0.5 * (x[1:-1] + x[:-2])])
    for moved in (0.15 * x + 0.002 * noise(2), np.round(0.15 * x / 0.004) * 0.004, late + 1e-4 * noise(3)):
        (text,) = examine(Record.from_arrays(x, moved, sample_rate=RATE)).implausible
        assert "there is hardly any hysteresis" in text
    of_loop = Record.from_arrays(z + 0.003 * noise(4), z, sample_rate=RATE)
    assert "set-point of a closed loop" in examine(of_loop).implausible[0]
    record = Record.from_arrays(x, z, sample_rate=RATE)
    left = nonlinear(record, examine(record))
    assert left is not None
    assert left > 1.0


def test_strokes_that_are_alike_have_hysteresis_that_a_filter_explains() -> None:
    """One sine and a rest, twelve times: a filter leaves 0.5 % of Bouc and Wen's loop, and 0.06 % of a lag."""
    t = np.linspace(0.0, 12.0, 4000, endpoint=False) % 1.0
    v = np.where(t < 0.5, 0.5 - 0.5 * np.cos(4 * np.pi * t), 0.0)
    rough = 0.01 * np.random.default_rng(1).standard_normal(v.size)
    stack, command = foreign_records.bouc_wen(v, 0.2), foreign_records.lagged(v, RATE, 0.01)
    of_stack, of_command = (Record.from_arrays(100 * v, 20 * z + rough, sample_rate=RATE) for z in (stack, command))
    assert examine(of_stack).implausible == ()
    (text,) = examine(of_command).implausible
    assert "there is hardly any hysteresis" in text


def test_a_record_with_many_gaps_has_hysteresis_between_them() -> None:
    """A stack at 2 kHz, 7 % of whose rows were lost, in parts of few strokes."""
    wave = trajectories.random_wave(duration=5.0, cutoff=10.0, seed=3)
    stack = plant.RealisticPlant(seed=3)
    stack.open()
    volts = wave.position / 12.0
    z = stack.exchange(volts)
    kept = np.random.Generator(np.random.PCG64(0)).random(z.size) > 0.07
    found = examine(Record.from_arrays(volts[kept], z[kept], time=wave.time[kept]))
    assert len(found.gaps) > 20
    assert found.implausible == ()


def test_a_signal_that_is_cut_off_beneath_its_noise(good: tuple[FloatArray, FloatArray]) -> None:
    x, z = good
    sensor = np.minimum(z, 11.0) + 0.002 * noise(5)
    monitor = np.minimum(x, 75.0) + 0.01 * noise(6)
    assert "the displacement stays at an end" in examine(Record.from_arrays(x, sensor, sample_rate=RATE)).implausible[0]
    found = examine(Record.from_arrays(monitor, z, sample_rate=RATE))
    assert any("the voltage stays at an end" in text for text in found.implausible)


def test_units_that_people_rather_write_otherwise(good: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    x, z = good
    assert "nm or counts" in asked(written(tmp_path, x, 1e3 * z, rate=100.0))[0]
    assert asked(tmp_path / "a.csv", displacement_unit="um") == ()
    assert "nm or mm" in asked(written(tmp_path, x, 1e-3 * z))[0]
    nanometres = "t (s),volts (V),z (nm)"
    few = 0.17 * z + 0.05 * noise(3)
    assert asked(written(tmp_path, 0.1 * x, few, nanometres)) == ()
    assert "less than a single plate" in asked(written(tmp_path, x, few, nanometres))[0]
    assert "is the voltage in V" in asked(written(tmp_path, x, z, "t (s),volts (mV),z (um)"))[0]
    assert "is its unit right" in asked(written(tmp_path, x / 50, 30 * z))[0]
    assert "is the voltage in V" in asked(written(tmp_path, 2 * x, z, "t (s),volts (mV),z (um)"))[0]
    assert asked(tmp_path / "a.csv", volts_unit="mV") == ()
    assert "is the voltage in V" in asked(written(tmp_path, x, 0.1 * z, "t (s),volts (mV),z (um)"))[0]


def test_a_clock_in_another_unit(good: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    """The record turns a row late: a row of 1 s is no row of an actuator."""
    x, z = good
    assert "in ms? If so, write ms in the heading of the file" in asked(written(tmp_path, x, z, rate=1.0))[0]
    assert "in a smaller unit" in asked(written(tmp_path, x, z, "t (ms),volts (V),z (um)", rate=1e-3))[0]
    np.savetxt(tmp_path / "b.csv", np.column_stack([x, z]), delimiter=",", header="volts (V),z (um)", comments="")
    assert "is the given sample rate of 1 Hz in kHz?" in asked(tmp_path / "b.csv", sample_rate=1.0)[0]


def test_a_voltage_behind_a_slow_filter_is_asked_about() -> None:
    """Beneath noise of 0.6 % a lead of 8 rows passed as `good`, and the model was 1.5 % off behind the true voltage."""
    t, rng = np.arange(20_000) / RATE, np.random.default_rng(0)
    x = 50 - 25 * np.cos(2 * np.pi * 2.1 * t) - 15 * np.cos(2 * np.pi * 1.3 * t) - 10 * np.cos(2 * np.pi * 0.37 * t)
    z = plays(x, (0.0, 10.0)) @ (0.22, 0.08) + 0.15 * rng.standard_normal(t.size)
    filtered = lfilter([1 - np.exp(-1 / 8)], [1, -np.exp(-1 / 8)], x)
    right, wrong = (examine(Record.from_arrays(volts, z, sample_rate=RATE)) for volts in (x, filtered))
    assert not right.mistakes
    assert right.implausible == ()
    assert not wrong.mistakes
    assert "ms before the voltage, its cause: is the voltage filtered" in " ".join(wrong.implausible)


def test_a_quick_way_to_the_start_of_a_slow_motion_is_no_joint() -> None:
    """In three rows, at 20 Hz: it was said that "both signals jump within one row, the voltage by 0 V"."""
    rng = np.random.default_rng(0)
    t = np.arange(4000) / 20.0
    x = 50 + 35 * np.cos(2 * np.pi * 0.1 * t + 0.8) + 15 * np.cos(2 * np.pi * 0.037 * t + 0.8)
    x = np.concatenate([x[0] * np.array([0.0, 0.26, 0.74, 1.0]), x])
    z = plays(x, (0.0, 10.0)) @ (0.22, 0.08) + 0.1 * rng.standard_normal(x.size)
    assert "jump" not in " ".join(examine(Record.from_arrays(x, z, sample_rate=20.0)).implausible)


def test_several_mm_of_an_amplified_stage_are_not_asked_about(
    good: tuple[FloatArray, FloatArray], tmp_path: Path
) -> None:
    """3 mm for 150 V, as the heading says, at the speed of such a stage; nm of a stack are faster, or of more um/V."""
    x, z = good
    x, z = 150 * (x - x.min()) / np.ptp(x), 3000 * (z - z.min()) / np.ptp(z)
    assert asked(written(tmp_path, x, z, rate=20.0)) == ()
    heading = "t (s),volts (V),z (um)"
    for volts, rate, head in ((x / 3, 20.0, heading), (x, RATE, heading), (x, 20.0, "t (s),volts (V),z")):
        assert "nm or counts" in " ".join(asked(written(tmp_path, volts, z, head, rate)))


def test_stamps_without_a_unit_of_one_row_a_second_are_seconds_until_they_make_hours(tmp_path: Path) -> None:
    """They were refused, whatever the record: 1 Hz is a rate of many loggers."""
    t = np.arange(1200.0)
    x = 50 - 30 * np.cos(0.1 * t) - 20 * np.cos(0.0313 * t)
    play = [0.0]
    for volts in x.tolist():
        play.append(max(volts - 10.0, min(volts + 10.0, play[-1])))
    z = 0.2 * x + 0.1 * np.array(play[1:]) + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    heading = "time,volts (V),z (um)"
    for rate, row in ((1.0, "1 s"), (0.2, "5 s")):
        words = f"in s one row is {row}: are they in ms, or do they count the rows? State the unit"
        assert words in " ".join(asked(written(tmp_path, x, z, heading, rate)))
        assert "the time stamps" not in " ".join(asked(tmp_path / "a.csv", time_unit="s"))
    hours = examine(read_record(written(tmp_path, x, z, heading, rate=0.1)))
    assert "one row would be 10 s, the record 3.33 h: are they in ms (`time_unit`), or do" in hours.mistakes[0]


def test_rows_that_are_written_twice(good: tuple[FloatArray, FloatArray]) -> None:
    x, z = (np.repeat(signal, 2) for signal in good)
    (text,) = examine(Record.from_arrays(x, z, sample_rate=2 * RATE)).implausible
    assert "in every 2. row only" in text


def test_a_staircase_of_a_quiet_sensor_is_not_written_several_times() -> None:
    """Levels that are held for 20 rows, and a sensor of coarse steps without noise: each value is there 20 times."""
    rng = np.random.Generator(np.random.PCG64(5))
    levels = np.round(rng.uniform(0.0, 100.0, 150), 1)
    x = np.repeat(levels, 20)
    z = np.round(plays(x, (0.0, 10.0, 20.0, 30.0)) @ np.array([0.1, 0.02, 0.02, 0.02]), 2)
    found = examine(Record.from_arrays(x, z, sample_rate=100.0))
    assert not any("new value in every" in text for text in found.implausible)


def test_some_rows_are_written_twice(good: tuple[FloatArray, FloatArray]) -> None:
    rows = np.sort(np.concatenate([np.arange(T.size), np.arange(20, T.size, 150)]))
    (text,) = examine(Record.from_arrays(*(signal[rows] for signal in good), sample_rate=RATE)).implausible
    assert text.startswith("20 rows, each by itself, repeat both values")


def test_rows_of_triangles_are_written_twice(good: tuple[FloatArray, FloatArray]) -> None:
    """Each row of a triangle moves as far as the others: none is slow."""
    x = np.interp(T, np.arange(13) / 4, np.tile([0.0, 100.0, 20.0, 90.0], 4)[:13])
    z = plays(x, (0.0, 5.0, 20.0)) @ (0.09, 0.02, 0.02) + 0.002 * noise(3)
    rows = np.sort(np.concatenate([np.arange(T.size), np.arange(20, T.size, 60)]))
    (text,) = examine(Record.from_arrays(x[rows], z[rows], sample_rate=RATE)).implausible
    assert text.startswith("50 rows, each by itself, repeat both values")


def test_converters_of_12_bits_that_repeat_both_values_where_the_voltage_turns_wrote_no_row_twice() -> None:
    t = np.arange(12000) / RATE
    x = 50 - 30 * np.cos(2 * np.pi * 3 * t) - 20 * np.sin(2 * np.pi * 7.3 * t)
    z = plays(x, (0.0, 5.0, 20.0)) @ (0.09, 0.02, 0.02) + 2e-4 * np.random.default_rng(1).standard_normal(t.size)
    x, z = (np.ptp(signal) / 4096 * np.round(signal / np.ptp(signal) * 4096) for signal in (x, z))
    assert np.count_nonzero((np.diff(x) == 0) & (np.diff(z) == 0)) > 12
    assert examine(Record.from_arrays(x, z, sample_rate=RATE)).implausible == ()


def test_what_changes_within_a_record(good: tuple[FloatArray, FloatArray]) -> None:
    """One channel loses rows; another actuator; warmth; a sensor that is AC-coupled, at a tenth of the lowest tone."""

    x, z = good

    def says(moved: FloatArray) -> str:
        found = examine(Record.from_arrays(x[: moved.size], moved, sample_rate=RATE))
        return " ".join(found.implausible or found.mistakes)

    half = T.size // 2
    lost = np.concatenate([z[:half], z[half + 25 :]])
    assert "from about 1.484 s on the displacement is earlier by about 24 rows, 24 ms" in says(lost)
    softer = np.concatenate([z[:half], z[half] + 0.8 * (z[half:] - z[half])])
    assert "s on strokes have 79 % of the gain" in says(softer)
    for share in (0.85, 1.2):
        warm = says(z * np.linspace(1.0, share, T.size))
        assert "of the gain of the beginning, and it changes steadily" in warm
        assert float(warm.split("strokes have ")[1].split(" %")[0]) == pytest.approx(100 * share, abs=2)
    assert "of the gain" not in says(z * np.linspace(1.0, 1.04, T.size))
    coupled = lfilter(*butter(1, 0.3, "high", fs=RATE), z - z[0])
    assert "by itself, with a time constant of about 0.532 s" in says(np.asarray(coupled))


def test_columns_that_are_not_what_they_are_taken_for(good: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    x, z = good
    (text,) = asked(written(tmp_path, x / 10, z, "t (s),HV_mon (V),z (um)"))
    assert "a monitor mostly shows a tenth" in text
    assert asked(tmp_path / "a.csv", volts_scale=10.0) == ()
    np.testing.assert_allclose(read_record(tmp_path / "a.csv", volts_scale=10.0).volts, x, atol=1e-6)
    with pytest.raises(SettingError, match=r"volts_scale = 10\.0 V: must be left out where a unit is given"):
        read_record(tmp_path / "a.csv", volts_scale=10.0, volts_unit="V")
    (text,) = asked(written(tmp_path, x, 0.5 * z, "t (s),volts (V),z"))
    assert "stays within +-10 as the volts of a sensor do" in text
    assert asked(tmp_path / "a.csv", displacement_unit="um") == ()


def test_a_voltage_over_its_span(good: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    x, z = good
    over = (x - x.min()) / np.ptp(x)
    (text,) = asked(written(tmp_path, over, 0.1 * z))
    assert "exactly from 0 to 1: is it normalised?" in text
    assert asked(tmp_path / "a.csv", volts_scale=1.0) == ()
    assert asked(written(tmp_path, 1.001 * over, 0.1 * z)) == asked(written(tmp_path, 100 * over, z)) == ()


@pytest.mark.parametrize("digits", ["%.9g", "%.3f"])
def test_means_that_were_taken_off_both_signals(
    good: tuple[FloatArray, FloatArray], tmp_path: Path, digits: str
) -> None:
    """Off the voltage alone nothing is seen, as many waves have a mean of 0; off the displacement nothing is lost."""
    x, z = good
    for volts, moved, seen in (
        (x - x.mean(), z - z.mean(), True),
        (x - x.mean(), z, False),
        (x, z - z.mean(), False),
        (x - x.mean(), z - z.mean() + 1e-4, False),
    ):
        table = np.column_stack([T, volts, moved])
        np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t (s),volts (V),z (um)", comments="", fmt=digits)
        assert [text.startswith("the means of") for text in asked(tmp_path / "a.csv")] == [True] * seen


def test_stamps_that_count_rows_or_make_hours(good: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    x, z = good[0][:-1], good[1][1:]  # turns with the voltage
    assert "one apart each: do they count the rows?" in asked(written(tmp_path, x, z, rate=1.0))[0]
    assert asked(tmp_path / "a.csv", sample_rate=1000.0) == asked(tmp_path / "a.csv", time_unit="s") == ()
    (text,) = asked(written(tmp_path, x, z, rate=0.25))
    assert "strokes in 3.33 h, one row each 4 s: are they in ms?" in text
    assert asked(tmp_path / "a.csv", time_unit="s") == ()


def test_a_record_of_a_day_has_no_modes_that_are_too_slow_for_one() -> None:
    """A sample in 20 minutes."""
    strain = np.cos(np.arange(400) / 9.0)
    assert ModeSearch(strain, strain + 0.1 * np.roll(strain, 1), np.ones(400, dtype=bool), 8e-4).run() == (None, False)
    assert math.isfinite(ModeSearch(strain, strain, np.ones(400, dtype=bool), 0.1).lowest)


@pytest.mark.parametrize(("lag", "recorded"), [(0.0, True), (0.0, False), (0.02, False), (0.01, True)])
def test_a_voltage_that_was_recorded_in_steps_is_told_from_one_that_goes_in_steps(lag: float, recorded: bool) -> None:
    """By 2 % of its span, at 1 kHz: where the actuator is moved in steps it goes on behind each, within 20 ms."""
    t = np.arange(20_000) / 1000.0
    smooth = 50 - 50 * np.cos(2 * np.pi * 0.07 * t) * (0.7 + 0.3 * np.cos(2 * np.pi * 0.023 * t))
    stepped = 2.0 * np.round(smooth / 2.0)
    x = smooth if recorded else stepped
    z = x + 0.1 * x * (1 - x / 100)
    if lag:
        z = z[0] + lfilter([1 - np.exp(-0.001 / lag)], [1, -np.exp(-0.001 / lag)], z - z[0])
    z += np.random.Generator(np.random.PCG64(1)).normal(0, 0.05, t.size)
    said = examine(Record.from_arrays(stepped, z, sample_rate=1000.0)).implausible
    assert any("goes by steps of 2 V, 2.2 % of its span" in words for words in said) == recorded


@pytest.mark.parametrize(
    ("heading", "um", "noise", "asked"),
    [
        ("z (nm)", 30.0, 0.1, "is it in um? Say `displacement_scale` 1 if so, `displacement_unit` nm if not"),
        ("z (nm)", 3.0, 0.01, "quieter than most sensors"),
        ("z (nm)", 30e3, 100.0, ""),
        ("z (nm)", 40.0, 0.5, ""),  # of a single plate
        ("z (nm)", 300.0, 1.0, ""),  # of a tube
        ("z (nm)", 30.0, 0.0, ""),  # simulated
        ("z (um)", 0.03, 1e-4, "is it in nm or mm? State its unit (`displacement_unit` um if it is right"),
    ],
)
def test_um_under_a_heading_of_nm(tmp_path, heading, um, noise, asked):
    """30 um of a stack, and what is really in nm: the numbers of the file, over 100 V."""
    t = np.arange(5000) / 1e3
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 1.3 * t) + np.cos(2 * np.pi * 3.1 * t))
    z = um * foreign_records.bouc_wen(v)
    z = z * (um / np.ptp(z)) + noise * np.random.default_rng(0).standard_normal(t.size)
    np.savez(tmp_path / "sweep.npz", **{"time (s)": t, "volts (V)": 100 * v, heading: z})
    said = examine(read_record(tmp_path / "sweep.npz")).implausible
    assert [asked in text for text in said] == [True] * bool(asked)
    stated = heading[3:5]
    assert not examine(read_record(tmp_path / "sweep.npz", displacement_unit=stated)).implausible


def test_a_stroke_of_mm_is_confirmed_by_its_unit(tmp_path):
    """5 mm for +-10 V, as the heading says: the question names the argument that answers it."""
    t = np.arange(5000) / 1e3
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 1.3 * t) + np.cos(2 * np.pi * 3.1 * t))
    z = 7.0 * foreign_records.bouc_wen(v) + 2e-3 * np.random.default_rng(0).standard_normal(t.size)
    np.savez(tmp_path / "stage.npz", **{"time (s)": t, "volts (V)": 20 * v - 10, "z (mm)": z})
    (said,) = examine(read_record(tmp_path / "stage.npz")).implausible
    assert "`displacement_unit` mm if it is right, else `displacement_scale`" in said
    assert not examine(read_record(tmp_path / "stage.npz", displacement_unit="mm")).implausible


def test_a_joint_beneath_the_noise_of_the_displacement() -> None:
    """A block of both signals is missing, with 1 % of noise; without the joint nothing is asked."""
    t = np.arange(5000) / 1e3
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 1.3 * t) + np.cos(2 * np.pi * 3.1 * t))
    z = 20 * foreign_records.bouc_wen(v)
    z += 0.01 * np.ptp(z) * np.random.default_rng(0).standard_normal(t.size)
    kept = np.r_[:2380, 2450:5000]
    for rows, asked_of in ((kept, 1), (slice(None), 0)):
        found = examine(Record.from_arrays(100 * v[rows], z[rows], sample_rate=1e3))
        assert sum("two records joined" in text for text in found.implausible) == asked_of


def test_rows_that_are_missing_here_and_there_are_asked_about(
    good: tuple[FloatArray, FloatArray], tmp_path: Path
) -> None:
    """A tenth of the rows without stamps of their own, at random or each tenth: both signals go twice as far there."""
    x, z = good
    some = np.random.default_rng(5).random(T.size) > 0.1
    for kept in (some, np.arange(T.size) % 10 != 4):
        (reason,) = asked(written(tmp_path, x[kept], z[kept]))
        assert re.match(r"at \d+ places both signals go 2(\.1)? times as far", reason)
    table = np.column_stack([T, x, z])[some]
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t (s),volts (V),z (um)", comments="", fmt="%.9g")
    assert asked(tmp_path / "a.csv") == ()  # the stamps know it


@pytest.mark.parametrize("rows", [0, 10, 200])
def test_an_end_that_was_not_recorded_is_asked_about(
    good: tuple[FloatArray, FloatArray], tmp_path: Path, rows: int
) -> None:
    """A buffer with 0 in both columns where nothing was written; the stamps are those of all rows."""
    x, z = (signal.copy() for signal in good)
    x[x.size - rows :] = z[z.size - rows :] = 0.0
    reasons = asked(written(tmp_path, x, z))
    assert [f"in the last {rows} rows: were they not recorded? Leave out" in each for each in reasons] == [True] * (
        rows == 200
    )


def test_a_start_that_was_not_recorded_is_asked_about(good: tuple[FloatArray, FloatArray]) -> None:
    """Both signals are 0 and then at once elsewhere; a sensor that was set to 0 at rest has its noise there."""
    x, z = (np.concatenate([np.zeros(200), signal[1500:]]) for signal in good)
    at_rest = z + np.where(np.arange(z.size) < 200, 0.002 * np.resize(noise(4), z.size), 0.0)
    said = ["in the first 200 rows: were they not" in text for text in _implausible(x, z)]
    assert any(said)
    assert not any("were they not recorded" in text for text in _implausible(x, at_rest))


@pytest.mark.parametrize("at", [slice(1500, 1540), slice(700, 2400), slice(2800, None), slice(0, 900)])
def test_a_voltage_that_was_not_recorded_is_asked_about(good: tuple[FloatArray, FloatArray], at: slice) -> None:
    """It keeps 0 V, within or at an end, while the displacement moves on; where it was 0 V, the latter follows."""
    x, z = good
    lost = x.copy()
    lost[at] = 0.0
    assert any("was it not recorded there?" in text for text in _implausible(lost, z))
    followed = plays(lost, (0.0, 5.0, 20.0)) @ (0.09, 0.02, 0.02) + 0.002 * noise(3)
    followed = lfilter([0.2], [1.0, -0.8], followed)
    assert not any("was it not recorded there?" in text for text in _implausible(lost, followed))


def _implausible(x: FloatArray, z: FloatArray) -> tuple[str, ...]:
    return examine(Record.from_arrays(x, z, sample_rate=RATE)).implausible


def test_a_second_column_in_volts_is_said(good: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    x, z = good
    table = np.column_stack([T, x / 10, x, z])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t (s),Vin (V),Vout (V),z (um)", comments="")
    says = "the voltage is the column 'Vin', and 'Vout' not in use: name the one"
    for named, said in ((None, True), ("Vout", False)):
        warnings = examine(read_record(tmp_path / "a.csv", volts=named)).warnings
        assert any(warning.startswith(says) for warning in warnings) == said


def test_a_voltage_that_was_not_recorded_is_no_slew_limit() -> None:
    """Where 0 V stand the displacement goes on: as fast as an amplifier at its limit, which was asked about, too."""
    (record,) = foreign_records.records(makers=(foreign_records.short,))
    x = record.volts * (np.arange(record.time.size) < 0.9 * record.time.size)
    said = examine(Record.from_arrays(x, record.displacement, time=record.time)).implausible
    assert any("while the displacement moves as if it went on: was it not recorded there?" in one for one in said)
    assert not any("slew rate" in one for one in said)


@pytest.mark.parametrize("seed", [0, 4])
def test_the_first_stroke_of_reversal_curves_shows_no_other_gain(seed: int) -> None:
    """It comes from rest, all others from the upper end; until the last ones none is as long."""
    r = np.random.default_rng(seed)
    turns = np.concatenate([[0.0, 100.0], np.stack([np.linspace(95, 0, 12), np.full(12, 100.0)], axis=1).ravel()])
    x = np.interp(np.linspace(0, 1, 6000), np.linspace(0, 1, turns.size), turns)
    z = np.asarray(plays(x, (0.0, 10.0, 30.0, 60.0)) @ (0.1, *r.uniform(0.02, 0.1, 3)))
    z += 0.01 * r.standard_normal(x.size)
    assert "of the gain" not in " ".join(_implausible(x, z))
