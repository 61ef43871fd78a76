"""Mistakes in a record: found by their evidence, and no correct record is refused."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks import foreign_records, record_mistakes
from click.testing import CliRunner

import truestroke
from truestroke.cli import main
from truestroke.identification import Record, RecordError, examine, identify, read_record
from truestroke.identification.records.series import series
from truestroke.model.operators import play_history
from truestroke.plant import RealisticPlant

MAKERS = (foreign_records.sines_of_a_stack, foreign_records.staircase)


@pytest.fixture(scope="module")
def run() -> truestroke.Recording:
    wave = truestroke.trajectories.random_wave(duration=2.0, seed=1)
    controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=45.0, voltage_limits=(-0.6, 3.6))
    return truestroke.run(wave, controller, RealisticPlant())


def test_each_mistake_is_found_in_records_of_other_models_and_none_in_the_records_themselves() -> None:
    records = [*foreign_records.records(makers=MAKERS), record_mistakes.simulated(3, duration=2.0)]
    rows = record_mistakes.table(records)
    assert {name: len(missed) for name, (*_, missed) in rows.items() if missed} == {
        "None": 3,
        "The voltage at 0.15 of its size, labelled V": 3,  # another actuator could have this gain
        "The same, labelled um": 3,  # another actuator could have this stroke
        "The zero of the sensor jumps by 15 % of the stroke after three fifths of the record": 1,  # with steps
        "An AC-coupled displacement: a corner at a tenth of the frequency of the strokes": 1,  # of ten strokes
        "From the middle on another actuator, with three quarters of the gain": 1,  # the same
        "The gain grows by 20 % in the course of the record": 1,  # the same
        "One row in fifty written twice, without time stamps": 1,  # held for 2 s each
        "A third of a stroke of rows lost by both channels in the middle, without time stamps": 2,  # small jumps
        "A tenth of the rows lost, each by itself, without time stamps": 1,  # steps, which have none beside them
        "The displacement by a clock that is 3 in 1000 slower": 1,  # of ten strokes
        "Only rows in which the voltage rises, without time stamps": 1,  # steps, which one row has
        "The voltage is written as 0 V in the last tenth of the rows": 1,  # steps, one of which is 0 V
    }


def _slewed(volts: np.ndarray, most: float) -> np.ndarray:
    """The output of an amplifier that changes by `most` in a row at most, V."""
    behind = volts.copy()
    for k in range(1, volts.size):
        behind[k] = behind[k - 1] + np.clip(volts[k] - behind[k - 1], -most, most)
    return behind


def _noisy(noise: float, n: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Voltage and displacement of plays in two sines, V and um, with noise of so much of the stroke."""
    t = np.arange(n) / 1e3
    x = 50 - 25 * (np.cos(2 * np.pi * 2.1 * t) + np.cos(2 * np.pi * 5.3 * t))
    z = 0.1 * x + 0.05 * play_history(x, (10.0, 30.0)).sum(axis=1)
    return x, z + noise * float(np.ptp(z)) * np.random.Generator(np.random.PCG64(7)).standard_normal(n)


def test_a_sensor_that_ends_beneath_much_noise_is_asked_about() -> None:
    x, z = _noisy(0.01)
    end = float(z.min()) + 0.85 * float(np.ptp(z))
    right, ended = (examine(Record.from_arrays(x, moved, sample_rate=1e3)) for moved in (z, np.minimum(z, end)))
    assert right.implausible == ()
    assert [text[:55] for text in ended.implausible] == ["the displacement stays at an end of its range, exactly,"]


@pytest.mark.parametrize(("rows", "asked"), [(80, True), (6, False)])
def test_one_hole_that_was_filled_by_a_line_is_asked_about_if_it_is_long(rows: int, asked: bool) -> None:
    x, z = _noisy(0.005)
    z[1300 : 1300 + rows] = np.linspace(z[1300], z[1300 + rows], rows)
    found = examine(Record.from_arrays(x, z, sample_rate=1e3))
    assert ["at one place, first at 1.3 s: were holes filled" in text for text in found.implausible] == [True] * asked


@pytest.mark.parametrize(("share", "asked"), [(0.6, True), (2.0, False)])
def test_an_amplifier_at_its_slew_rate(share: float, asked: bool) -> None:
    """Two sines of a Bouc-Wen actuator at 0.6 of their largest speed; and by an amplifier that is fast enough."""
    t = np.arange(5000) / 1e3
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 1.3 * t) + np.cos(2 * np.pi * 3.1 * t))
    moved = foreign_records.bouc_wen(_slewed(v, share * float(np.abs(np.diff(v)).max())))
    z = 20 * moved + np.random.Generator(np.random.PCG64(0)).normal(0.0, 0.01, t.size)
    said = examine(Record.from_arrays(100 * v, z, sample_rate=1e3)).implausible
    assert any("at the limit of its current or slew rate" in text for text in said) == asked


@pytest.mark.parametrize("path", ["slew rate", "lag", "resonance"])
def test_a_slew_rate_beneath_noise_is_named_with_its_value_and_no_lag_or_resonance_is(path: str) -> None:
    """1 % of noise; a rate that a tenth of the motion exceeds, a lag or a resonance of the same effect."""
    t = foreign_records.clock(8.0, 500.0)
    v = foreign_records.wave(t, np.random.Generator(np.random.PCG64(8)), 4.0)
    most = float(np.percentile(np.abs(np.diff(v)), 90))
    paths = {
        "slew rate": lambda: _slewed(v, most),
        "lag": lambda: foreign_records.lagged(v, 500.0, 0.01),
        "resonance": lambda: foreign_records.resonance(v, 500.0, 30.0, 0.1),
    }
    z = 20 * foreign_records.bouc_wen(paths[path]())
    z = z + 0.2 * np.random.Generator(np.random.PCG64(9)).standard_normal(t.size)
    said = [text for text in examine(Record.from_arrays(100 * v, z, time=t)).implausible if "slew rate" in text]
    assert len(said) == (path == "slew rate")
    for text in said:
        rate = float(text.removeprefix("behind a voltage of at most ").split(" V/s")[0])
        assert rate == pytest.approx(100 * most * 500.0, rel=0.2)


def test_steps_that_an_amplifier_answers_late_do_not_lead() -> None:
    """Rates of steps and of late answers have no common rows: by their sign one was turned round."""
    rng = np.random.Generator(np.random.PCG64(0))
    volts = np.repeat(rng.uniform(0.0, 1.0, 60), 500)
    z = foreign_records.resonance(foreign_records.duhem(_slewed(volts, 0.008)), 1e4, 1100.0, 0.03)
    found = examine(Record.from_arrays(100 * volts, 12 * z + 2e-3 * rng.standard_normal(z.size), sample_rate=1e4))
    assert found.lag_ms is not None
    assert 0 < found.lag_ms < 10
    assert found.mistakes == ()


def test_a_stage_that_rings_behind_random_bits_is_not_shifted() -> None:
    """The rates of bits and of ringing agree best a period later."""
    rng = np.random.Generator(np.random.PCG64(5))
    bits = foreign_records.lagged(np.repeat(rng.integers(0, 2, 400), 50).astype(float), 5e3, 2e-4)
    y = foreign_records.duhem(0.2 + 0.6 * bits)
    z = foreign_records.resonance(y, 5e3, 130.0, 0.02) + 1e-3 * rng.standard_normal(y.size)
    assert examine(Record.from_arrays(20 + 60 * bits, 10 * z, sample_rate=5e3)).mistakes == ()


@pytest.mark.parametrize("end", [0.6, 0.8])
def test_a_displacement_that_is_cut_off_exactly_is_asked_about_as_one_with_noise(end: float) -> None:
    """Its rows are not fitted, but a model of the others was `good`, and missed these by five times what it stated."""
    rng = np.random.Generator(np.random.PCG64(2))
    v = foreign_records.wave(np.arange(6000) / 500.0, rng, 3.0)
    z = 30 * foreign_records.bouc_wen(v) + 0.1 * rng.standard_normal(v.size)
    cut = np.minimum(z, end * z.max())
    found = examine(Record.from_arrays(100 * v, cut, sample_rate=500.0))
    assert any("the displacement stays at an end of its range" in text for text in found.implausible)
    assert found.clipped_displacement > 0.95 * np.count_nonzero(cut == cut.max())
    assert examine(Record.from_arrays(100 * v, z, sample_rate=500.0)).implausible == ()


@pytest.mark.parametrize("seed", [4, 5])
def test_a_displacement_of_which_most_strokes_are_cut_off_is_examined(seed: int) -> None:
    """The gain of most strokes is 0, by which a change of it was divided."""
    rng = np.random.Generator(np.random.PCG64(seed))
    v = foreign_records.lagged(foreign_records.lagged(rng.standard_normal(5000), 500.0, 0.04), 500.0, 0.04)
    v -= np.linspace(v[0], v[-1], v.size)
    z = 30 * (v - v.min()) / np.ptp(v) + 0.03 * rng.standard_normal(v.size)
    found = examine(Record.from_arrays(10 * v / np.ptp(v), np.minimum(z, 12.0), sample_rate=500.0))
    assert found.clipped_displacement > 0.5 * v.size


@pytest.mark.parametrize("harmonic", [2.9, 3.0, 3.05])
def test_a_stage_that_the_third_harmonic_of_triangles_shakes_is_no_wrong_column(harmonic: float) -> None:
    """The ringing was looked for above three times the strokes, and half of it was refused as the wrong column."""
    rng = np.random.Generator(np.random.PCG64(1))
    t = np.arange(2400) / 400.0
    v = (1 - np.abs((14.0 * t) % 2.0 - 1.0)) * rng.uniform(0.2, 1.0, 50)[(7.0 * t).astype(int)]
    z = 20 * foreign_records.resonance(v, 400.0, 7.0 * harmonic, 0.005) + 0.05 * rng.standard_normal(t.size)
    found = examine(Record.from_arrays(20 * v, z, sample_rate=400.0))
    assert abs(found.correlation) < 0.7
    assert found.mistakes == ()
    assert any("is the stage" in text or "resonance" in text for text in found.implausible)


def test_a_stage_that_rings_at_every_turn_does_not_lead() -> None:
    """A slow wave and one small step ring at 180 Hz to the end of the record: turns show the ringing, no delay."""
    rng = np.random.Generator(np.random.PCG64(0))
    t = np.arange(15000) / 5e3
    v = 0.3 + 0.25 * foreign_records.wave(t, rng, 5.0) + 0.05 * (t > 1.0)
    z = foreign_records.resonance(foreign_records.duhem(v), 5e3, 180.0, 0.0015)
    found = examine(Record.from_arrays(10 * v, 11 * z + 3e-3 * rng.standard_normal(z.size), sample_rate=5e3))
    assert found.mistakes == ()
    assert found.delay_ms is None


@pytest.mark.parametrize(("milliseconds", "shifted"), [(0.29, False), (2.9, True)])
def test_a_fast_stage_with_its_dead_time_is_not_shifted(milliseconds: float, shifted: bool) -> None:
    """Strokes of 0.8 ms, or of 8 ms, and the same share of them."""
    rate = 1e5 / (milliseconds / 0.29)
    v = foreign_records.wave(np.arange(20000) / 1e5, np.random.Generator(np.random.PCG64(3)), 700.0)
    y = foreign_records.duhem(v) + 1e-3 * np.random.Generator(np.random.PCG64(4)).standard_normal(v.size)
    found = examine(Record.from_arrays(100 * v[29:], 20 * y[:-29], sample_rate=rate))
    assert [text.endswith("is it shifted?") for text in found.mistakes] == [True] * shifted


@pytest.mark.parametrize(("rows", "resonance"), [(25, 30.0), (67, 44.0), (25, 100.0)])
def test_square_steps_of_a_resonant_stage_are_no_turned_sensor_and_a_turned_one_is(rows: int, resonance: float) -> None:
    """Driven above its resonance a stage goes down as its voltage goes up; a turned sensor is known by its gain."""
    steps = np.tile(np.repeat([0.0, 1.0], rows), 2000 // rows)
    z = 20 * foreign_records.resonance(steps, 2000.0, resonance, 0.02)
    z += 0.05 * np.random.Generator(np.random.PCG64(1)).standard_normal(z.size)
    found = examine(Record.from_arrays(100 * steps, z, sample_rate=2000.0))
    assert found.mistakes == ()
    assert not any("swapped" in text or "flip" in text for text in found.warnings)
    assert series((100 * steps, z, 2000.0)).volts.size == z.size
    with pytest.raises(truestroke.SettingError, match="one that falls as the voltage rises"):
        series((100 * steps, -z, 2000.0))


@pytest.mark.parametrize("wrong", [False, True])
def test_a_stage_that_rings_more_than_it_moves_is_no_wrong_column(wrong: bool) -> None:
    """Twelve samples a period, a ringing that goes on through seven steps; or the displacement of other steps."""
    rng = np.random.Generator(np.random.PCG64(1))
    steps, others = (np.repeat(rng.uniform(0.0, 1.0, 36), 127) for _ in range(2))
    z = foreign_records.resonance(foreign_records.duhem(others if wrong else steps), 732.0, 61.0, 0.002)
    found = examine(Record.from_arrays(100 * steps, 20 * z + 0.01 * rng.standard_normal(z.size), sample_rate=732.0))
    assert abs(found.correlation) < 0.7
    assert any("do not move together" in text for text in found.mistakes) == wrong
    assert any("rings at 61" in text and "round the steps to 33 ms" in text for text in found.implausible) != wrong
    assert not any("hardly move together" in text for text in found.warnings)


@pytest.mark.parametrize("seed", range(2))
def test_reversal_curves_that_go_further_and_further_are_no_other_gain(seed: int) -> None:
    """Of two actuators whose gain grows with the length of a stroke: that is what changes from some stroke on."""
    rng = np.random.Generator(np.random.PCG64(seed))
    turns = np.concatenate([[0.0, 1.0], np.ravel([[low, 1.0] for low in np.linspace(0.95, 0.0, 20)])])
    way = np.concatenate([[0.0], np.abs(np.diff(turns)).cumsum()])
    v = np.interp(np.arange(0.0, way[-1], 0.005), way, turns)
    weights, thresholds = rng.exponential(0.03, 30), np.sort(0.24 * rng.uniform(0.0, 1.0, 30) ** 2)
    for z in (0.5 * v + play_history(v, tuple(thresholds)) @ weights, foreign_records.generalised_plays(v)):
        record = Record.from_arrays(10 * v, 15 * z + 0.003 * rng.standard_normal(v.size), sample_rate=50.0)
        assert not any("of the gain" in text for text in examine(record).implausible)


def test_a_gain_that_changes_with_the_length_of_the_strokes_is_no_other_gain_and_a_step_is() -> None:
    """24 curves from one end: Bouc and Wen; plays with three quarters of the gain from the middle on."""
    turns = np.concatenate([[0.0, 1.0], np.ravel([[low, 1.0] for low in np.linspace(0.95, 0.0, 24)])])
    way = np.concatenate([[0.0], np.abs(np.diff(turns)).cumsum()])
    v = np.interp(np.arange(0.0, way[-1], 0.005), way, turns)
    noise, half = 0.003 * np.random.Generator(np.random.PCG64(0)).standard_normal(v.size), v.size // 2
    z = 15 * foreign_records.generalised_plays(v)
    other = np.concatenate([z[:half], z[half] + 0.75 * (z[half:] - z[half])])
    for moved, asked in ((18 * foreign_records.bouc_wen(v), False), (z, False), (other, True)):
        texts = examine(Record.from_arrays(10 * v, moved + noise, sample_rate=50.0)).implausible
        assert any("of the gain of before" in text for text in texts) == asked


@pytest.mark.parametrize("seed", [34, 132])
def test_twenty_strokes_of_an_actuator_that_creeps_show_no_other_gain(seed: int) -> None:
    """Twelve numbers are fitted to them, and a second gain at one of twenty places."""
    rng = np.random.Generator(np.random.PCG64(seed))
    turns = np.zeros(21)
    turns[1::2], turns[2::2] = rng.uniform(0.25, 1.0, 10), rng.uniform(0.0, 0.2, 10)
    v = np.interp(np.arange(2000) / 100.0, np.arange(21), turns)
    z = foreign_records.creep(foreign_records.bouc_wen(v), 10.0, 0.02)
    record = Record.from_arrays(100 * v, 100 * z + 0.02 * rng.standard_normal(v.size), sample_rate=10.0)
    assert not any("of the gain" in text for text in examine(record).implausible)


def test_few_strokes_of_a_stage_that_rings_show_no_other_gain() -> None:
    rng = np.random.Generator(np.random.PCG64(4))
    rng.uniform(size=180)
    steps = np.repeat(rng.uniform(0.05, 0.95, 27), 300)
    z = foreign_records.resonance(foreign_records.duhem(steps), 1e3, 83.0, 0.002)
    assert not any("of the gain" in x for x in examine(Record.from_arrays(steps, z, sample_rate=1e3)).implausible)


def test_a_lag_is_neither_a_slew_rate_nor_another_actuator() -> None:
    """Triangles of three rates in turn behind 3 ms and a lag of 8 ms: the fast ones are smaller, and turn late."""
    fs, t = 2000.0, np.arange(36000) / 2000.0
    phase = np.cumsum(np.select([t < 6, t < 12], [0.5, 2.0], 8.0)) / fs
    v = foreign_records.up_and_down(phase, 1.0) * np.choose(phase.astype(int) % 3, [1.0, 0.6, 0.85])
    moved = foreign_records.late(t, foreign_records.lagged(foreign_records.bouc_wen(v), fs, 8e-3), 3e-3)
    z = 9 * moved + np.random.Generator(np.random.PCG64(0)).normal(0.0, 0.004, t.size)
    assert not examine(Record.from_arrays(100 * v, z, sample_rate=fs)).implausible


def test_a_stage_that_rings_while_its_voltage_rests_at_an_end_is_not_cut_off() -> None:
    t = np.arange(8000) / 2000.0
    levels = np.random.Generator(np.random.PCG64(1)).uniform(5.0, 70.0, 16)
    x = foreign_records.lagged(levels[(t / 0.25).astype(int)], 2000.0, 3e-3)
    x = np.round(x, 2)
    z = 0.15 * foreign_records.resonance(foreign_records.bouc_wen(x / 75) * 75, 2000.0, 70.0, 0.01)
    z += np.random.Generator(np.random.PCG64(2)).normal(0.0, 0.01, t.size)
    found = examine(Record.from_arrays(x, z, sample_rate=2000.0))
    assert found.clipped_volts == 0
    assert not any("stays at an end" in text for text in found.implausible)


@pytest.mark.parametrize(("steps", "seed"), [((150, 250), 5), ((100, 20), 9)])
def test_converters_that_are_coarse_on_both_sides_show_no_lead(steps: tuple[int, int], seed: int) -> None:
    """Steps of the voltage and of the displacement in the record, many rows each: 13 and 21 rows before."""
    rng, t = np.random.Generator(np.random.PCG64(seed)), foreign_records.clock(8.0, 5e3)
    x = 75.0 + 75.0 * foreign_records.wave(t, rng, 5.0)
    z = play_history(x, np.arange(8) * 7.0) @ np.linspace(1.5, 0.5, 8) / 60
    x, z = (np.round((a - a.min()) / np.ptp(a) * n) * np.ptp(a) / n for a, n in zip((x, z), steps, strict=True))
    assert not examine(Record.from_arrays(x, z, sample_rate=5e3)).mistakes


@pytest.mark.parametrize(("rows", "asked"), [(16, True), (3, False)])
def test_a_dead_time_of_many_rows_is_asked_for(rows: int, asked: bool) -> None:
    """16 ms at 1 kHz, which a buffer makes; told as `delay` it is taken."""
    record = record_mistakes.simulated(3, duration=4.0)
    x, z = record.volts[::2], record.displacement[::2]
    late = x[rows:], z[:-rows]
    said = identify((*late, 1000.0)).verdict.reasons
    assert any("one channel buffered" in text for text in said) == asked
    if asked:
        told = identify((*late, 1000.0), delay=0.016).verdict.reasons
        assert not any("one channel buffered" in text for text in told)


@pytest.mark.parametrize("step", [0.02, 0.001])
def test_noise_of_a_coarse_sensor_makes_lines_and_equal_blocks_by_chance(step: float) -> None:
    """A periodic motion, noise of 0.01 um, rounded to two and to a tenth of it: neither is asked for."""
    x = 50 - 50 * np.cos(np.arange(20_000) * 2 * np.pi / 500)
    z = 0.2 * play_history(x, np.linspace(0.0, 40.0, 8)).sum(axis=1) / 8
    z += np.random.Generator(np.random.PCG64(0)).normal(0.0, 0.01, x.size)
    assert not examine(Record.from_arrays(x, step * np.round(z / step), sample_rate=1e3)).implausible


def test_stamps_whose_unit_is_rarely_right_make_a_model_doubtful(tmp_path: Path) -> None:
    """A record that turns with the voltage: 100 Hz is possible, 100 kHz hardly; told as a sample rate it is taken."""
    (record,) = foreign_records.records(makers=(foreign_records.normalised,))
    t, x, z = record.time, record.volts, record.displacement
    np.savez(file := tmp_path / "ms.npz", **{"time (ms)": t, "volts (V)": x, "z (um)": z})
    found = identify(read_record(file))
    assert any("the voltage, before most amplifiers do: are the time stamps" in text for text in found.verdict.reasons)
    assert found.verdict.level == "doubtful"
    assert not examine(read_record(file, sample_rate=1e5)).implausible
    half = {"volts (V)": x[1:], "z (um)": 0.5 * (z[1:] + z[:-1])}  # a row late
    np.savez(file := tmp_path / "s.npz", **{"time (s)": 1e3 * t[1:], **half})
    assert "s later than the voltage, as hardly any does" in examine(read_record(file)).implausible[0]
    np.savez(file, **{"time (s)": t[1:], **half})
    assert not examine(read_record(file)).implausible


def test_the_desired_motion_is_no_measurement(run: truestroke.Recording, tmp_path: Path) -> None:
    """By the name of its column, and without it by its noise, which a sensor has."""
    run.save(file := tmp_path / "run.h5")
    named = examine(read_record(file, displacement="desired"))
    assert "'desired': a command" in named.mistakes[0]
    bare = Record.from_arrays(run["volts"], run["desired"], sample_rate=2000.0)
    assert any("no noise" in text for text in examine(bare).mistakes)
    assert not examine(read_record(file)).mistakes


def test_a_recording_is_a_record(run: truestroke.Recording) -> None:
    found = examine(run)
    assert (found.rows, found.source) == (run["time"].size, "recording")
    assert identify(run).held_out.rmse_percent < 1.0


@pytest.mark.parametrize("rows", [40, 30_000])
def test_rows_at_the_ends_without_a_measurement_are_left_out(tmp_path: Path, rows: int) -> None:
    """As the latency of a driver leaves them; the second are more than one chunk of text."""
    t = np.arange(40_000) / 2000.0
    x = 1.5 - 1.5 * np.cos(3 * t)
    z = 10 * x
    z[:3], z[-rows:] = np.nan, np.nan
    np.savetxt(
        tmp_path / "late.csv", np.column_stack([t, x, z]), delimiter=",", header="t (s),u (V),z (um)", fmt="%.9e"
    )
    record = read_record(tmp_path / "late.csv")
    assert (record.volts.size, record.dropped) == (t.size - rows - 3, rows + 3)
    z[100] = np.nan
    np.savetxt(
        tmp_path / "late.csv", np.column_stack([t, x, z]), delimiter=",", header="t (s),u (V),z (um)", fmt="%.9e"
    )
    with pytest.raises(RecordError, match="line 102: displacement is missing"):
        read_record(tmp_path / "late.csv")


def test_identify_refuses_with_the_evidence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (record,) = foreign_records.records(makers=(foreign_records.short,))
    table = np.column_stack([record.time, record.volts, record.displacement])
    np.savetxt("ms.csv", table, delimiter=",", header="time (ms),volts (V),z (um)", comments="")
    refused = CliRunner().invoke(main, ["identify", "ms.csv"])
    assert (refused.exit_code, Path("model.toml").exists()) == (1, False)
    assert "'time' in ms) make" in refused.stderr
    assert "--force uses it all the same" in refused.stderr


def test_stamps_without_a_unit_may_be_in_any_and_counters_are_none(tmp_path: Path) -> None:
    t = np.arange(400) / 1000.0
    x = 1.5 - 1.5 * np.cos(60 * t)
    for stamps, wrong in ((1e3 * t, False), (np.arange(400.0), False), (t, False), (2 * t, True)):
        np.savez(tmp_path / "a.npz", time=stamps, volts=x, z=10 * x)
        record = read_record(tmp_path / "a.npz", sample_rate=1000.0)
        assert (bool(record.contradictions), "are not used" in record.unused) == (wrong, not wrong)


@pytest.mark.parametrize(("even", "share", "wrong"), [(True, 1.02, True), (True, 1.005, False), (False, 1.015, False)])
def test_even_stamps_show_a_rate_that_is_off_by_two_per_cent(
    tmp_path: Path, even: bool, share: float, wrong: bool
) -> None:
    """Those of a computer, which wander, show it to 2 %; those of a card to a hundredth."""
    t = np.arange(2000) / 1000.0
    x = 1.5 - 1.5 * np.cos(60 * t)
    stamps = t if even else t + 2e-4 * np.random.default_rng(0).uniform(size=t.size)
    np.savez(tmp_path / "a.npz", **{"time (s)": stamps, "volts (V)": x, "z (um)": 10 * x})
    record = read_record(tmp_path / "a.npz", sample_rate=1000.0 * share)
    assert bool(record.contradictions) == wrong
    if wrong:
        assert "the sample rate is given as 1020 Hz, but the time stamps of the file" in record.contradictions[0]


@pytest.mark.parametrize("written", ["%.4f", "%.5e"])
@pytest.mark.parametrize("shape", ["sine", "triangle"])
def test_the_rounding_of_a_text_is_no_noise(tmp_path: Path, shape: str, written: str) -> None:
    """A simulation without noise in mV and nm: Dahl's model, which no mistake makes."""
    t = np.arange(3000) / 200.0
    x = 1 - np.cos(2.7 * t) if shape == "sine" else 2 * np.abs((0.8 * t) % 2 - 1)
    z = np.zeros_like(x)
    for k in range(1, x.size):
        step = x[k] - x[k - 1]
        z[k] = z[k - 1] + 0.3 * step - 0.7 * abs(step) * z[k - 1]
    columns = np.column_stack([1e3 * t, 1e3 * x, 1e4 * (x - z)])
    header = "time (ms),u (mV),z (nm)"
    np.savetxt(file := tmp_path / "a.csv", columns, delimiter=",", header=header, comments="", fmt=written)
    assert examine(read_record(file)).mistakes == ()


def test_two_percent_of_noise_is_no_jump_of_the_sensor() -> None:
    """Rows about a step of three deviations are alike by chance; of ten such records nine were refused."""
    rng, t = np.random.Generator(np.random.PCG64(2)), np.arange(20_000) / 1000.0
    for _ in range(5):
        v = foreign_records.wave(t, rng, 5.0)
        z = 20 * play_history(v, (0.1,))[:, 0]
        assert examine(Record.from_arrays(100 * v, z + rng.normal(0, 0.4, t.size), sample_rate=1000.0)).mistakes == ()


@pytest.mark.parametrize("early", [0, 150])
def test_a_lag_behind_a_staircase_is_no_lead(early: int) -> None:
    """A level is held for 83 rows: the rates agree nearly as well ten steps earlier."""
    k, rng = np.arange(20_000) // 83, np.random.Generator(np.random.PCG64(2))
    v = np.minimum(k % 24, 24 - k % 24) / 12 * (0.6 + 0.4 * np.cos(2e-4 * np.arange(k.size)))
    z = foreign_records.lagged(play_history(v, (0.12,))[:, 0] + 0.5 * v, 2e4, 2.5e-3)
    z = 7 * z + rng.normal(0, 0.07, v.size)
    record = Record.from_arrays(44 * v[: v.size - early], z[early:], sample_rate=2e4)
    assert any("leads" in words for words in examine(record).mistakes) == (early > 0)


def test_noise_at_the_end_of_a_staircase_does_not_go_to_and_fro() -> None:
    k, rng = np.arange(20_000) // 5, np.random.Generator(np.random.PCG64(2))
    v = np.minimum(k % 24, 24 - k % 24) / 12 * (0.6 + 0.4 * np.cos(4.7e-4 * np.arange(k.size)))
    z = 85 * play_history(v, (0.12,))[:, 0] + rng.normal(0, 1.7, v.size)
    assert examine(Record.from_arrays(350 * v, z, sample_rate=100.0)).implausible == ()


def test_the_remedy_for_a_unit_of_the_file_that_is_wrong_is_one_that_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nanometres below um: the unit of the caller would be refused against that of the file, a scale is not."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(4000) / 1000.0
    x = 1.5 - 1.5 * np.cos(2 * np.pi * t) * np.cos(0.8 * t)
    for name, heading in (("stated", "z (um)"), ("bare", "z")):
        table = np.column_stack([t, x, 1e4 * x])
        np.savetxt(f"{name}.csv", table, delimiter=",", header=f"t (s),volts (V),{heading}", comments="")
    remedies = {"stated.csv": "--displacement-scale 0.001", "bare.csv": "--displacement-unit nm"}
    for file, remedy in remedies.items():
        refused = CliRunner().invoke(main, ["examine", file])
        assert f"If it is nm, say {remedy}" in " ".join(refused.output.split())
        assert "If it is" not in CliRunner().invoke(main, ["examine", file, *remedy.split()]).output
    against = CliRunner().invoke(main, ["identify", "stated.csv", "--displacement-unit", "nm"])
    assert "if the file is wrong, give --displacement-scale 0.001 in its place" in against.stderr


def test_hours_under_a_heading_of_s_are_refused() -> None:
    """The stamps begin at 0, as most do: they are no dates of a spreadsheet."""
    t = np.arange(4000) / 1e4
    x = 50 - 50 * np.cos(2 * np.pi * 5 * t)
    found = examine(Record.from_arrays(x, 0.3 * x**1.1, time=t / 3600))
    assert "are they in min, h or days" in found.mistakes[0]


def _in_bursts(stamped: bool) -> Record:
    """Ten rows in 0.5 ms, each 10 ms: stamped so when a buffer was read, or measured so."""
    k, even = np.arange(4000), 1e-3 * np.arange(4000)
    stamps = 1e-2 * (k // 10) + 5e-5 * (k % 10)
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 1.3 * even) + np.cos(2 * np.pi * 3.1 * even))
    z = 20 * foreign_records.bouc_wen(v)
    if not stamped:
        v, z = (np.interp(stamps, even, signal) for signal in (v, z))
    return Record.from_arrays(100 * v, z + 0.05 * np.random.default_rng(0).standard_normal(k.size), time=stamps)


def test_stamps_of_the_instants_at_which_a_buffer_was_read() -> None:
    """The voltage moves no further in a gap than from row to row. The fit of it ended with a division by zero."""
    record = _in_bursts(True)
    (said,) = examine(record).mistakes
    assert "399 gaps, 191 times as long" in said
    assert "by them about 1000 Hz" in said
    assert identify(record).verdict.level == "bad"
    even = Record.from_arrays(record.volts, record.displacement, sample_rate=1000.0)
    assert not examine(even).mistakes
    assert not examine(even).implausible


def test_bursts_that_were_measured_are_asked_about() -> None:
    record = _in_bursts(False)
    assert not examine(record).mistakes
    (said,) = examine(record).implausible
    assert "400 bursts of 10 on average, between which 95 % of the time" in said
    assert identify(record).verdict.level != "good"


def test_gaps_are_shortened_only_so_far_that_they_are_as_long_as_the_record_together() -> None:
    """Forty gaps of 3 rows, and one of 5000 in 1000 rows: the short ones stay."""
    steps = np.ones(999)
    steps[10:810:20], steps[900] = 4.0, 5000.0
    t = 1e-3 * np.concatenate([[0.0], np.cumsum(steps)])
    x = np.sin(8 * t)
    rows = series(Record.from_arrays(x, x, time=t))
    assert rows.volts.size == 1000 - 41 + 1000
    assert np.interp(0.9, rows.time, rows.volts) == pytest.approx(np.sin(8 * 0.9), abs=1e-3)
