"""Faults of a sensor are named with their evidence; records of correct sensors, however odd, have none."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks import foreign_records, unseen_records

from truestroke.identification import examine
from truestroke.identification.examination.faults import faults, repeated
from truestroke.identification.examination.mistakes import refuse
from truestroke.identification.records.record import Record, read_record
from truestroke.signals.tables import RecordError

FS = 1000.0


def clean(scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Volts and displacement of plays for 4 s, with noise of 0.05 % of the stroke."""
    rng = np.random.Generator(np.random.PCG64(2))
    u = foreign_records.wave(foreign_records.clock(4.0, FS), rng, 5.0)
    z = foreign_records.stop_elements(u, np.random.Generator(np.random.PCG64(3)))
    return 100 * u, scale * (20 * z + 0.01 * rng.standard_normal(u.size))


def faulty(kind: str, z: np.ndarray) -> np.ndarray:
    z, k = z.copy(), 2500
    span = np.ptp(z)
    if kind == "stops":
        z[k:] = z[k]
    elif kind == "jumps":
        z[k:] += 0.16 * span
    elif kind == "runs over":
        z = (z - z.min()) % (0.6 * span)
    else:
        z[97::97] = z.max() + 2.5 * span
    return z


SAID = {
    "stops": r"stays at .* in 1500 rows from 2\.5 s on.*the sensor had stopped",
    "jumps": r"jumps by .* once, first at 2\.5 s: the zero of the sensor moved",
    "runs over": r"jumps by .* \d+ times.*its counter ran over",
    "spikes": r"far from the rows beside it in 41 rows, first at 0\.097 s",
}


@pytest.mark.parametrize("scale", [1.0, 1e-3])
@pytest.mark.parametrize("kind", SAID)
def test_a_fault_is_named_and_refused(kind: str, scale: float) -> None:
    volts, z = clean(scale)
    found = examine(Record.from_arrays(volts, faulty(kind, z), sample_rate=FS))
    assert any(np.char.find(found.mistakes, "row") >= 0)
    with pytest.raises(RecordError, match=SAID[kind]):
        refuse(found)


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("resonance", [20.0, 60.0, 200.0])
def test_a_coarse_sensor_at_rest_between_steps_has_not_stopped(resonance: float, bits: int) -> None:
    """The stage answers some rows after the step, of which a converter shows one value."""
    steps = np.repeat(np.random.Generator(np.random.PCG64(1)).random(20), 400)
    z = 20 * foreign_records.resonance(steps, 2000.0, resonance, 0.2)
    z = np.round(z * 2**bits / 30) * 30 / 2**bits
    assert not [text for text in faults(Record.from_arrays(100 * steps, z, sample_rate=2000.0)) if "stopped" in text]
    assert not [
        text for text in examine(Record.from_arrays(100 * steps, z, sample_rate=2000.0)).implausible if "line" in text
    ]
    z[3000:] = z[3000]
    assert any("stopped" in text for text in faults(Record.from_arrays(100 * steps, z, sample_rate=2000.0)))


@pytest.mark.parametrize(("damping", "bits", "sigma"), [(0.005, 10, 0.0002), (0.005, 8, 0.0), (0.1, 12, 0.002)])
def test_a_ringing_that_dies_away_between_steps_is_no_line(damping: float, bits: int, sigma: float) -> None:
    random = np.random.Generator(np.random.PCG64(1))
    steps = np.repeat(random.random(40), 200)
    z = 20 * foreign_records.resonance(steps, 2000.0, 200.0, damping) + sigma * random.standard_normal(steps.size)
    z = np.round(z * 2**bits / 30) * 30 / 2**bits
    found = examine(Record.from_arrays(100 * steps, z, sample_rate=2000.0))
    assert not [text for text in found.implausible if "line" in text]


@pytest.mark.parametrize("fringe", [0.3164, 0.0])
def test_fringes_that_an_interferometer_loses_are_found_in_a_small_part_of_the_stroke(fringe: float) -> None:
    rng = np.random.Generator(np.random.PCG64(2))
    u = foreign_records.wave(foreign_records.clock(4.0, FS), rng, 1.0)
    z = 20 * foreign_records.stop_elements(u, rng) + 0.002 * rng.standard_normal(u.size)
    z[1700:] -= fringe  # um, 1.6 % of the stroke
    texts = [text for text in faults(Record.from_arrays(100 * u, z, sample_rate=FS)) if "fringes" in text]
    assert len(texts) == (fringe > 0)
    assert all("once, first at 1.7 s" in text for text in texts)


@pytest.mark.parametrize("seed", range(6))
def test_noise_hides_no_jump_of_the_zero_and_is_none(seed: int) -> None:
    """1 % of the stroke, and a jump of 16; 2 % of it, with which a row or two are 10 % from those beside them."""
    volts, z = clean()
    noise = float(np.ptp(z)) * np.random.Generator(np.random.PCG64(seed)).standard_normal(z.size)
    (said,) = faults(Record.from_arrays(volts, faulty("jumps", z) + 0.01 * noise, sample_rate=FS))
    assert "once, first at 2.5 s" in said
    assert not [*faults(Record.from_arrays(volts, z + 0.02 * noise, sample_rate=FS))]


def test_wrong_rows_are_named_one_by_one_and_the_remedy_works(tmp_path: Path) -> None:
    """Only the first was named, and nobody knew which others to leave out."""
    volts, z = clean()
    wrong = z.copy()
    wrong[[500, 1234, 2000]] += 40.0
    (said,) = faults(Record.from_arrays(volts, wrong, sample_rate=FS))
    assert "in 3 rows, first at 0.5 s: " in said
    assert (
        ", then at 1.234, 2 s; leave these rows out: delete them, or write NaN in them and give `drop_bad_rows`" in said
    )
    wrong[[500, 1234, 2000]] = np.nan
    time = np.arange(z.size) / FS
    np.savetxt(tmp_path / "a.csv", np.column_stack([time, volts, wrong]), delimiter=",", header="t (s),V,z (um)")
    assert not [*faults(read_record(tmp_path / "a.csv", drop_bad_rows=True))]
    many = z.copy()
    many[300:2100:100] += 40.0
    assert any(" 1.1 s and so on; leave" in text for text in faults(Record.from_arrays(volts, many, sample_rate=FS)))


def test_a_wrong_row_of_the_voltage_is_named_and_a_pulse_of_it_is_none() -> None:
    volts, z = clean()
    volts[1234] = 300.0
    (said,) = faults(Record.from_arrays(volts, z, sample_rate=FS))
    assert said.startswith("the voltage is far from the rows beside it in 1 row, first at 1.234 s: 300 between")
    z[1235] += 40.0  # an effect of the pulse
    (said,) = faults(Record.from_arrays(volts, z, sample_rate=FS))
    assert said.startswith("the voltage")


def test_records_of_correct_sensors_have_no_fault() -> None:
    """Steps, resonances, clipping, coarse converters, holes, few rows, heavy tails."""
    of = foreign_records
    makers = (of.staircase, of.software_timed, of.short, of.ringing, of.clipped_sensor)
    others = (unseen_records.outliers, unseen_records.coarse)
    for record in (*of.records(0, makers), *unseen_records.records(0, others)):
        assert not [*faults(record)], record.source
        assert repeated(record.displacement) == 1, record.source


def test_a_sensor_slower_than_the_record_is_said_and_its_noise_is_that_of_its_values() -> None:
    volts, z = clean()
    found = examine(Record.from_arrays(volts, np.repeat(z[::5], 5), sample_rate=FS))
    assert not found.mistakes
    assert any("a new value in every 5th row only" in said for said in found.warnings)
    assert found.noise_um == pytest.approx(0.01, rel=0.5)


def test_a_sensor_that_is_much_slower_than_the_record_is_not_shifted() -> None:
    """A value of 80 rows is late by 40 of them, a third of a stroke: which rows are to be left out is the remedy."""
    volts, z = clean()
    (refused,) = examine(Record.from_arrays(volts, np.repeat(z[::80], 80), sample_rate=FS)).mistakes
    assert refused.endswith("each of its values stays for 80 rows. Leave out all but the first of these")


def test_a_sensor_with_a_clock_of_its_own_keeps_its_values_and_is_on_no_lines() -> None:
    """A new value in each tenth or eleventh row: in no certain one."""
    volts, z = clean()
    rows = np.floor(np.floor(np.arange(z.size) / 10.4) * 10.4).astype(int)
    (asked,) = examine(Record.from_arrays(volts, z[rows], sample_rate=FS)).implausible
    assert "keeps each of its values for 10.4 rows on average" in asked


def test_the_noise_is_that_of_rows_that_are_not_clipped() -> None:
    volts, z = clean()
    low, high = np.quantile(z, [0.3, 0.7])
    found = examine(Record.from_arrays(volts, np.clip(z, low, high), sample_rate=FS))
    assert found.clipped_displacement > 0.4 * z.size
    assert found.noise_um == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize(
    "heading",
    [
        "Zeit (ms);Spannung (mV);Weg (nm)",
        "Tempo [ms];Tensione [mV];Spostamento [nm]",
        "время, мс;напряжение, мВ;смещение, нм",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_headings_in_other_languages_and_their_units(tmp_path: Path, heading: str, encoding: str) -> None:
    volts, z = clean()
    rows = (f"{k};{1e3 * x:.2f};{1e3 * y:.3f}".replace(".", ",") for k, (x, y) in enumerate(zip(volts, z, strict=True)))
    (tmp_path / "record.csv").write_bytes("\n".join([heading, *rows]).encode(encoding))
    record = read_record(tmp_path / "record.csv")
    assert all(column.stated for column in record.columns.values())
    np.testing.assert_allclose(record.volts, volts, atol=1e-4)
    np.testing.assert_allclose(record.displacement, z, atol=1e-4)
    assert record.sample_rate == pytest.approx(FS)
