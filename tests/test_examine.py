"""What `examine` finds, on signals whose properties are known, and what it says of bad ones."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks import foreign_records
from click.testing import CliRunner

from truestroke import plant, trajectories
from truestroke.cli import main
from truestroke.identification import Findings, Record, examine, read_record
from truestroke.identification.records import turning
from truestroke.identification.records.turning import reversals
from truestroke.model.operators import play_history

SHARED = Path(os.environ.get("TRUESTROKE_SHARED", Path(__file__).parents[2] / "shared"))
MEASURED = SHARED / "data/p885_91/Model_Vi_Do.dat"
RATE = 1000.0
Signal = Callable[[np.ndarray], np.ndarray]


def sine(t: np.ndarray, frequency: float = 2.0) -> np.ndarray:
    return 1.8 - 1.8 * np.cos(2 * np.pi * frequency * t)


def several(t: np.ndarray) -> np.ndarray:
    """From 1 to 9 Hz with strokes of many lengths."""
    return sine(t + 0.3 * t**2, 1.0) * (0.6 + 0.4 * np.sin(1.3 * t))


def triangle(t: np.ndarray) -> np.ndarray:
    return 3.6 * np.abs((2.0 * t + 1.0) % 2.0 - 1.0)


@functools.cache
def _exact(wave: Signal, delay: float, seconds: float) -> tuple[np.ndarray, ...]:
    fine = np.arange(int(seconds * RATE) * 10) / (10 * RATE)
    thresholds = np.linspace(0.0, 1.6, 9)
    z = play_history(wave(np.maximum(fine - delay, 0.0)), thresholds) @ np.r_[8.0, np.full(8, 0.6)]
    return fine[::10], wave(fine[::10]), z[::10]


def actuator(wave: Signal, delay: float = 0.0, noise: float = 0.0, seconds: float = 6.0) -> tuple[np.ndarray, ...]:
    """Time, volts and displacement of plays without rate, read `delay` s later; 10 times finer than it is sampled."""
    t, x, z = _exact(wave, delay, seconds)
    return t, x, z + np.random.Generator(np.random.PCG64(1)).normal(0.0, noise, t.size)


def found(t: np.ndarray, x: np.ndarray, z: np.ndarray) -> Findings:
    return examine(Record.from_arrays(x, z, time=t))


def says(findings: Findings, words: str) -> bool:
    return any(words in warning for warning in findings.warnings)


# ---- Figures ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wave", [sine, several, triangle])
@pytest.mark.parametrize("delay", [0.0, 0.0017, 0.006])
def test_delay_is_told_from_hysteresis(wave: Signal, delay: float) -> None:
    """To a quarter of a sample, where the cross-correlation of the rates errs by samples."""
    result = found(*actuator(wave, delay, noise=0.02))
    assert result.delay_ms == pytest.approx(1e3 * delay, abs=0.25)
    if wave is sine:
        assert result.lag_ms is not None
        assert result.lag_ms > 1e3 * delay + 2


def test_delay_leaves_the_hysteresis_as_it_is() -> None:
    direct, late = (found(*actuator(sine, delay)) for delay in (0.0, 0.008))
    assert late.loop_width_percent > direct.loop_width_percent + 5
    assert late.hysteresis_percent == pytest.approx(direct.loop_width_percent, abs=0.3)


def test_loop_width_of_a_parallelogram() -> None:
    """A play of 0.9 V in 3.6 V: a band 1.8 V wide, over whose share of the travel the area of the loop extends."""
    t = np.arange(8000) / RATE
    x = triangle(t)
    z = 10.0 * play_history(x, [0.9])[:, 0]
    result = found(t[500:], x[500:], z[500:])  # settled: from 9 to 27 um
    assert result.stroke_um == pytest.approx(18.0)
    assert result.loop_width_percent == pytest.approx(100 * 2 * (18 * 1.8) / 7.2 / 18, rel=0.03)


@pytest.mark.parametrize("wave", [sine, several, triangle])
@pytest.mark.parametrize("noise", [0.003, 0.05, 0.5])
def test_noise_level(wave: Signal, noise: float) -> None:
    assert found(*actuator(wave, noise=noise)).noise_um == pytest.approx(noise, rel=0.06)


def test_noise_does_not_see_outliers_and_sees_a_coarse_converter() -> None:
    t, x, z = actuator(sine, noise=0.05)
    z[::100] += 20.0
    assert found(t, x, z).noise_um == pytest.approx(0.05, rel=0.15)
    t, x, z = actuator(sine)
    assert found(t, x, 2.0 * np.round(z / 2.0)).noise_um == pytest.approx(2.0 / np.sqrt(12), rel=0.01)


def test_strokes_speeds_and_range() -> None:
    """A triangle of 36 um linear at 1 Hz: 2 strokes a second, each 72 um/s."""
    t = np.arange(6000) / RATE
    result = found(t, triangle(t), 10 * triangle(t) - 100.0)
    assert result.strokes == 12
    assert result.stroke_durations_s == pytest.approx((0.5, 0.5), rel=1e-2)
    assert result.seldom_way_percent == pytest.approx(50.0, abs=1.0)
    assert result.stroke_speeds_um_s == pytest.approx((72.0, 72.0), rel=1e-3)
    assert result.rates_um_s == pytest.approx((72.0, 72.0, 72.0), rel=1e-2)
    assert (result.gain_um_per_v, result.offset_um) == pytest.approx((10.0, -100.0))
    assert result.displacement_um == pytest.approx((-100.0, -64.0), abs=0.1)
    assert result.states_known_s == pytest.approx(0.5, abs=0.02)


def test_jitter_is_that_of_the_intervals() -> None:
    t, x, z = actuator(sine, noise=0.01)
    late = t + np.random.Generator(np.random.PCG64(2)).uniform(-4e-4, 4e-4, t.size)
    result = found(late, x, z)
    assert result.jitter_us == pytest.approx(400 / np.sqrt(3) * np.sqrt(2), rel=0.05)
    assert says(result, "jitter of the time stamps")
    assert examine(Record.from_arrays(x, z, sample_rate=RATE)).jitter_us is None


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_reversals_are_the_extremes_whatever_the_noise(noise: float) -> None:
    t = np.arange(4000) / RATE
    x = sine(t) + np.random.Generator(np.random.PCG64(3)).normal(0.0, noise, t.size)
    turns = reversals(x, 0.5)
    assert (turns[0], turns[-1]) == (0, t.size - 1)
    np.testing.assert_allclose(turns[1:-1][np.abs(turns[1:-1] - 10) > 20], 250 * np.arange(1, 16), atol=1 + 600 * noise)


def test_the_reversals_of_a_noisy_voltage_are_those_of_each_of_its_extremes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ripple is left out before they are walked along; also coarse ripple of equal steps, and beyond the threshold."""
    rng = np.random.Generator(np.random.PCG64(4))
    noise = rng.standard_normal((2, 6000))
    wave = np.sin(np.arange(6000) / 200.0)
    signals = [wave + 0.1 * noise[0], np.cumsum(noise[1]), np.round(8 * wave + noise[0]), np.round(2 * noise[1])]
    cases = [(x, share * float(np.ptp(x))) for x in signals for share in (0.01, 0.05, 0.3)]
    quick = [reversals(x, threshold) for x, threshold in cases]
    monkeypatch.setattr(turning, "FEW_EXTREMES", 10**9)
    assert all(np.array_equal(rows, reversals(*case)) for rows, case in zip(quick, cases, strict=True))


def test_gaps_are_counted_and_no_stroke_is_read_into_them() -> None:
    t, x, z = actuator(several)
    keep = np.r_[0:3000, 3400:6000]
    result = found(t[keep], x[keep], z[keep])
    assert result.gaps == ((2999, pytest.approx(0.401)),)
    assert says(result, "1 gap, the longest 0.401 s")


def test_a_gap_of_a_day_is_no_stroke_of_a_day() -> None:
    """What nine tenths of the time are spent in is what was measured: lengths and speeds are not those of the gap."""
    t, x, z = actuator(several)
    later = np.where(t < 3.2, t, t + 86_400.0)
    as_one, of_two_days = found(t, x, z), found(later, x, z)
    assert of_two_days.stroke_lengths_percent == as_one.stroke_lengths_percent
    assert not says(of_two_days, "all strokes")


# ---- Bad records -----------------------------------------------------------------------------------------------------


def test_swapped_columns() -> None:
    t, x, z = actuator(several, noise=0.01)
    assert not says(found(t, x, z), "swapped")
    assert says(found(t, z, x), "are the columns swapped?")


@pytest.mark.parametrize(("x_factor", "z_factor"), [(1.0, 1e-3), (1e3, 1.0), (1.0, 1e3)])
def test_units_that_cannot_be(x_factor: float, z_factor: float) -> None:
    t, x, z = actuator(several)
    assert says(found(t, x_factor * x, z_factor * z), "is its unit right?")
    assert not says(found(t, x, z), "unit")


def test_clipping_is_told_from_holding() -> None:
    t, x, z = actuator(sine, noise=0.0)
    top = z.max() - 0.15 * np.ptp(z)
    clipped = found(t, x, np.minimum(z, top))
    assert clipped.clipped_displacement == np.count_nonzero(z >= top)
    assert says(clipped, "the displacement is clipped")
    assert says(found(t, np.minimum(x, 3.0), z), "the voltage seems clipped")
    held = np.clip(1.5 * sine(t) - 0.9, 0.0, 3.6)  # a trapezium, which the actuator follows
    result = found(t, held, play_history(held, [0.0, 0.4]) @ [8.0, 2.0])
    assert (result.clipped_displacement, result.clipped_volts) == (0, 0)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("share", [0.95, 1.0])
def test_a_voltage_that_is_clipped_in_few_rows_is_said(share: float, noise: float) -> None:
    """Relays of Preisach on a random wave: 1 % of the rows are at the limit; with no limit nothing is said."""
    t, rng = foreign_records.clock(10.0, 1e3), np.random.Generator(np.random.PCG64(4))
    x = foreign_records.wave(t, rng, 8.0)
    z = 20 * foreign_records.preisach(x, np.random.Generator(np.random.PCG64(7))) + rng.normal(0.0, 0.004, x.size)
    recorded = 10 * (np.minimum(x, x.min() + share * np.ptp(x)) + rng.normal(0.0, noise, x.size))
    result = examine(Record.from_arrays(recorded, z, sample_rate=1e3))
    assert any("voltage stays at an end" in text for text in result.implausible) == (share < 1)
    assert (result.clipped_volts > 0) == (share < 1)
    assert result.clipped_volts < 0.03 * t.size


@pytest.mark.parametrize("damping", [0.02, 0.3])
def test_a_stage_that_rings_in_a_hold_is_no_clipped_voltage(damping: float) -> None:
    """A trapezium of 8 Hz on a resonance of 30 Hz, 10 ms late."""
    t = foreign_records.clock(4.0, 2e3)
    x = np.clip(1.6 * np.sin(16 * np.pi * t), -1.0, 1.0) + 1.0
    z = np.roll(20 * foreign_records.resonance(play_history(x, [0.0, 0.2]) @ [0.8, 0.2], 2e3, 30.0, damping), 20)
    result = examine(Record.from_arrays(50 * x, z, sample_rate=2e3))
    assert result.clipped_volts == 0
    assert not any("voltage stays at an end" in text for text in result.implausible)


def test_what_it_cannot_identify_is_said() -> None:
    one = found(*actuator(sine))
    assert says(one, "not informative about rate dependence")
    assert says(one, "inner loops are not tested")
    assert says(one, "6 s are too short for creep slower than about 2 s")
    many = found(*actuator(several, noise=0.01))
    assert not says(many, "rate dependence")
    assert not says(many, "inner loops are not tested")
    assert says(many, "inner loops elsewhere")  # all strokes are from one end, but the last, which the record cuts


def test_further_suspicions() -> None:
    t, x, z = actuator(several)
    falls = "the displacement falls as the voltage rises: "
    assert falls + "turn its sign before fitting (`flip_displacement`)" in found(t, x, -z).warnings
    turned = dataclasses.replace(Record.from_arrays(x, -z, time=t), flipped=True)
    assert falls + "leave out `flip_displacement`" in examine(turned).warnings
    assert says(found(t, x, np.random.Generator(np.random.PCG64(4)).normal(0.0, 5.0, t.size)), "wrong column?")
    assert says(found(t, x, 10 * x), "hardly a loop")
    assert says(found(t[::60], x[::60], z[::60]), "samples on average")
    assert says(found(t[:60], x[:60], z[:60]), "a loop needs three")
    for rate in (RATE, RATE / 1000):  # Hz, and kHz that are taken for them
        regular = examine(Record.from_arrays(x, z, sample_rate=rate))
        stroke = x.size / rate / regular.strokes
        assert says(regular, f"the given sample rate is used; by it a stroke takes {stroke:.3g} s")


def test_any_usable_record_is_examined(tmp_path: Path) -> None:
    """Steps, noise, a ramp, one jump: findings that JSON can hold, and no failure."""
    noise = np.random.Generator(np.random.PCG64(5)).normal(size=(2, 400))
    steps = np.repeat([0.0, 1.0, 0.0, 2.0], 100)
    for x, z in (noise, (steps, steps), (np.arange(400.0), np.arange(400.0) ** 2), (np.arange(400) > 200, noise[0])):
        result = examine(Record.from_arrays(x, z, sample_rate=100.0))
        assert json.loads(json.dumps(result.as_dict()))["rows"] == 400
        assert all(text for _, text in result.table())


def test_a_record_is_examined_however_far_from_zero_it_is() -> None:
    """The variance of 20 um about 1e9 um was lost in that of 1e9 um, and divided by."""
    t = np.arange(4000) / RATE
    x, z = several(t), 10 * several(t - 0.002) + np.random.Generator(np.random.PCG64(0)).normal(0, 0.01, t.size)
    near, far, biased = (
        examine(Record.from_arrays(x + volts, z + um, sample_rate=RATE)) for volts, um in ((0, 0), (0, 1e9), (1e7, 0))
    )
    for found in (far, biased):
        assert found.gain_um_per_v == pytest.approx(near.gain_um_per_v, rel=1e-4)
        assert not found.mistakes


def test_pieces_between_gaps_that_are_shorter_than_the_delay_are_no_part_of_the_loop() -> None:
    """One of 4 rows with a displacement that is 6 rows late ended with an error of NumPy."""
    t = np.arange(4000) / RATE
    kept = np.ones(t.size, dtype=bool)
    kept[[*range(2000, 2010), *range(2014, 2024)]] = False
    x, z = several(t), 10 * several(t - 0.006)
    whole, holed = (examine(Record.from_arrays(x[rows], z[rows], time=t[rows])) for rows in (np.ones_like(kept), kept))
    assert len(holed.gaps) == 2
    assert holed.loop_width_percent == pytest.approx(whole.loop_width_percent, rel=0.05)
    assert holed.hysteresis_percent == pytest.approx(0.0, abs=0.2)


# ---- From outside ----------------------------------------------------------------------------------------------------


def test_the_simulated_stack() -> None:
    """Noise 0.013 um a tick; the mean over the tick alone makes half a tick of delay."""
    wave = trajectories.random_wave(duration=5.0, seed=3)
    stack, x = plant.RealisticPlant(seed=0), wave.position / 10.0
    stack.open()
    result = examine(
        Record.from_arrays(x, [stack.exchange(x[k : k + 1])[0] for k in range(x.size)], sample_rate=2000.0)
    )
    assert result.delay_ms == pytest.approx(0.3, abs=0.1)
    assert result.noise_um == pytest.approx(0.013, rel=0.3)
    assert not says(result, "rate dependence")


def test_the_measured_record() -> None:
    """Sensor noise of 0.07 um, as who measured it says; loop as wide as that paper's."""
    if not MEASURED.is_file():
        pytest.skip(f"the measured record is not at {MEASURED}; TRUESTROKE_SHARED names the folder")
    result = examine(read_record(MEASURED, volts=1, displacement=5, sample_rate=200.0))
    assert result.noise_um == pytest.approx(0.07, rel=0.05)
    assert result.strokes == 81
    assert result.delay_ms == pytest.approx(20.4, abs=1.0)
    assert result.clipped_displacement == 0
    assert says(result, "not informative about rate dependence")
    swapped = examine(read_record(MEASURED, volts=5, displacement=1, sample_rate=200.0))
    assert says(swapped, "are the columns swapped?")


def test_memory_grows_by_the_record_alone(tmp_path: Path) -> None:
    """A stand-in for 10 million rows: reading and examining 300,000 more rows costs less than 48 bytes for each."""
    code = (
        "import re, sys\n"
        "from pathlib import Path\n"
        "from truestroke.identification import examine, read_record\n"
        "examine(read_record(sys.argv[1]))\n"
        "print(re.search(r'VmHWM:\\s+(\\d+)', Path('/proc/self/status').read_text())[1])"
    )
    mapped = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}  # arrays go back at once
    peaks = []
    for rows in (100_000, 400_000):
        t = np.arange(rows) / 1e4
        path = tmp_path / f"{rows}.csv"
        lines = (f"{a:.4f},{b:.4f},{c:.3f}\n" for a, b, c in zip(t, sine(t), 10 * sine(t - 0.01), strict=True))
        path.write_text("t,V,z\n" + "".join(lines))
        done = subprocess.run(
            [sys.executable, "-c", code, path], env=mapped, capture_output=True, text=True, timeout=60, check=True
        )
        peaks.append(1024 * int(done.stdout))
    assert peaks[1] - peaks[0] < 48 * 300_000


def test_the_command(tmp_path: Path) -> None:
    t, x, z = actuator(sine, 0.002)
    np.savetxt(tmp_path / "r.csv", np.column_stack([t, x, z]), header="t,V,z (um)", delimiter=",", comments="")
    plain = CliRunner().invoke(main, ["examine", str(tmp_path / "r.csv")])
    assert plain.exit_code == 0, plain.output
    assert "- all strokes have about the same speed" in plain.output
    told = json.loads(CliRunner().invoke(main, ["examine", str(tmp_path / "r.csv"), "--json"]).output)
    assert told["delay_ms"] == pytest.approx(2.0, abs=0.2)
    refused = CliRunner().invoke(main, ["examine", str(tmp_path / "r.csv"), "--volts", "none"])
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert refused.stderr.startswith(f"truestroke: {tmp_path / 'r.csv'}: volts: no column 'none'")
