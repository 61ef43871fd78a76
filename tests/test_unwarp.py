"""Images of an open-loop scan, corrected by a model of the day before and the recorded voltage, without a sensor."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import truestroke
from truestroke import ImageError, RecordError, ScanRecord, SettingError, Verdict, scans
from truestroke.cli import main
from truestroke.identification import unwarp as unwarp_module
from truestroke.identification.unwarp import by_direction, mirrored, read_lines, read_scan_record, triggered
from truestroke.model.branches import Branches
from truestroke.plant import StagePlant, StageSettings
from truestroke.report.images import page as images_page

FS, GAIN, ROWS = 2000.0, 30.0 / 3.6, 64
TEXTURE = scans.Texture(seed=2, grain=0.3)
DAY_BEFORE = Path(__file__).with_name("vectors") / "scanner.toml"
"""Identified from rasters of 25, 21, 17 and 12 um at 4 Hz on the stage of `stage(seed=1)`; here the seed is another."""


def stage(seed):
    about = {"resonances": (900.0,), "noise": 0.003, "hysteresis_kind": "preisach"}
    return StagePlant(StageSettings(sample_rate=FS, **about), seed=seed)


def moved(volts, seed=2):
    plant = stage(seed)
    plant.open()
    plant.exchange(volts)
    return plant.truth


@pytest.fixture(scope="module")
def scan():
    return scans.raster(width=18.0, lines=ROWS, rate=4.0, sample_rate=FS, offset=(13.0, 13.0))


@pytest.fixture(scope="module")
def volts(scan):
    return tuple(axis.position / GAIN for axis in scan.axes)


@pytest.fixture(scope="module")
def places(scan, volts):
    return [scans.at_pixels(scan, moved(one), 128) for one in volts]


@pytest.fixture(scope="module")
def shown(scan, places):
    return scans.images(scan, TEXTURE(*places), name="height", unit="nm")


@pytest.fixture(scope="module")
def model():
    return truestroke.load_model(DAY_BEFORE)


@pytest.fixture(scope="module")
def both(shown, scan, volts, model):
    return truestroke.unwarp(shown, ScanRecord.of(scan, *volts), model, model)


def test_trace_and_retrace_agree_without_a_sensor(both):
    """The goal is 0.3 of 512 pixels, so 0.075 of these 128."""
    assert abs(both.before[0]) > 10
    assert np.hypot(*both.after) < 0.075
    assert both.verdict.level == "good"
    assert both.timing == 0


def test_the_corrected_image_is_the_sample(both):
    """But for one shift, that of zero and creep: across and along, each pixel is where it says."""
    one = both.images["trace"]
    columns, rows = (
        low + (np.arange(n) + 0.5) * size for low, n, size in zip(one.origin, (128, ROWS), one.pixel, strict=True)
    )
    sample = scans.Image(data=TEXTURE(*np.meshgrid(columns, rows)), size=one.size)
    known = dataclasses.replace(one, data=np.nan_to_num(one.data))
    quarter = [slice(4, 36), slice(28, 60)], [slice(8, 64), slice(64, 120)]
    shifts = np.array([
        scans.shift(*(dataclasses.replace(i, data=i.data[r, c]) for i in (sample, known)))
        for r in quarter[0]
        for c in quarter[1]
    ])  # fmt: skip
    assert np.ptp(shifts[:, 0]) < 0.8  # pixels of 128; it was 6.8
    assert np.ptp(shifts[:, 1]) < 0.6


@pytest.mark.parametrize("monitor", ["noise", "mains"])
def test_what_the_monitor_of_a_slow_axis_adds_to_its_voltage_moves_no_row(scan, volts, shown, model, monitor):
    """States of Duhem follow the voltage with its travel: noise of 0.3 mV goes three times as far as the motion."""
    duhem = Branches(voltage_range=(0.0, 3.6), betas=(4.0,), weights=(2.0, 0.0))
    slow, ticks = model.replace(branches=duhem), np.arange(volts[1].size)
    noise = np.random.Generator(np.random.PCG64(3)).normal(size=ticks.size)
    added = 3e-4 * noise if monitor == "noise" else 3e-3 * np.sin(2 * np.pi * 50.0 * ticks / FS)
    known, found = (
        truestroke.unwarp(shown, ScanRecord.of(scan, volts[0], y), model, slow).images["trace"]
        for y in (volts[1], volts[1] + added)
    )
    assert abs(found.origin[1] - known.origin[1]) < 0.1 * known.pixel[1]
    assert abs(found.size[1] - known.size[1]) < 0.15 * known.pixel[1]


def off(record, scan, volts, shown, model):
    """By how much noise of the voltage moves the places of the pixels, pixels of 512, 99 % of them."""
    made, known = (unwarp_module._places(shown, one, model, one.x)[0] for one in (record, ScanRecord.of(scan, *volts)))
    apart = np.concatenate([(made[name] - known[name]).ravel() for name in made]) / (18.0 / 512)
    return float(np.quantile(np.abs(apart - np.median(apart)), 0.99))


@pytest.mark.parametrize(
    ("noise", "step", "most"), [(0.003, 0.0, 0.15), (0.01, 0.0, 0.5), (0.0017, 0.005, 0.15), (0.0, 0.01, 0.6)]
)
def test_the_mean_of_lines_that_are_alike_has_little_of_the_noise(noise, step, most, scan, volts, shown, model):
    """0.52, 1.8, 0.46 and 1.5 pixels: the noise of each line was only smoothed."""
    random = np.random.Generator(np.random.PCG64(5))
    read = [one + noise * random.normal(size=one.size) for one in volts]
    read = [np.round(one / step) * step if step else one for one in read]
    assert off(ScanRecord.of(scan, *read), scan, volts, shown, model) < most


def test_spikes_and_gaps_of_the_voltage_are_not_those_of_the_scan(scan, volts, shown, model, both):
    """The file was refused, or rows were displaced by four."""
    random, read = np.random.Generator(np.random.PCG64(5)), [one.copy() for one in volts]
    for one in read:
        one[random.integers(2, one.size - 2, 20)] += 0.5
        for k in random.integers(scan.lines["first"][0], one.size - 3, 10):
            one[k : k + 3] = 0.0
    found = truestroke.unwarp(shown, ScanRecord.of(scan, *read), model, model)
    assert np.nanmax(np.abs(found.images["trace"].data - both.images["trace"].data)[1:-1]) < 0.5
    assert found.verdict.level == "good"


def test_noise_that_leaves_places_open_is_said(scan, volts, shown, model):
    """10 mV moved pixels by up to 6 of 512, and the verdict was good."""
    random = np.random.Generator(np.random.PCG64(5))
    read = [one + 0.1 * random.normal(size=one.size) * (one is volts[0]) for one in volts]
    few = dataclasses.replace(ScanRecord.of(scan, *read), lines=scan.lines[:12])
    image = {name: dataclasses.replace(one, data=one.data[:6]) for name, one in shown.items()}
    try:
        words = " ".join(truestroke.unwarp(image, few, model).verdict.reasons)
    except ImageError as error:
        words = str(error)
    assert re.search(r"voltage of x has .* mV of noise, which leaves places open by|voltage is noisy", words)


def humming(volts, amplitude, phase=1.0):
    return volts + amplitude * np.sin(2 * np.pi * 51.3 * np.arange(volts.size) / FS + phase)  # V


def test_hum_of_the_monitor_is_taken_off_where_trace_and_retrace_show_it(scan, volts, shown, model, both):
    """Pixels were off by 4 of 128, and trace and retrace said bad or, at 50 Hz, good."""
    read = [humming(one, 0.05) for one in volts]
    found = truestroke.unwarp(shown, ScanRecord.of(scan, *read), model, model)
    assert np.hypot(*found.after) < 0.075
    assert found.verdict.level == "good"
    assert re.fullmatch(r"5\d mV at 51.3 Hz of x, .* pixels: trace and retrace agree better without it", found.hum)
    assert both.hum == ""


def test_hum_that_the_stage_follows_stays(scan, volts, model):
    read = [humming(one, 0.03) for one in volts]
    shown = scans.images(scan, TEXTURE(*(scans.at_pixels(scan, moved(one), 128) for one in read)), name="height")
    found = truestroke.unwarp(shown, ScanRecord.of(scan, *read), model, model)
    assert found.hum == ""
    assert np.hypot(*found.after) < 0.075
    assert found.verdict.level == "good"


def test_hum_that_no_image_explains_is_doubtful(scan, volts, shown, model):
    found = truestroke.unwarp(shown["trace"], ScanRecord.of(scan, humming(volts[0], 0.05), volts[1]), model)
    assert "The voltage of x has hum, 5" in found.verdict.reasons[0]
    assert found.hum == ""


def test_a_voltage_that_is_late_is_said_to_be_so(scan, volts, shown, model):
    late = np.interp(scan.time - 5e-4, scan.time, volts[0])
    reasons = truestroke.unwarp(shown, ScanRecord.of(scan, late), model).verdict.reasons
    assert re.search(r"recorded 0.[45]\d? ms too late", reasons[0])


def test_a_record_that_begins_in_motion_is_doubtful(scan, volts, shown, model):
    first = int(scan.lines["first"][0]) - 50
    lines = scan.lines.copy()
    for edge in ("start", "end"):
        lines[edge] -= first / FS
    record = ScanRecord(x=volts[0][first:], sample_rate=FS, lines=lines)
    reasons = " ".join(truestroke.unwarp(shown, record, model).verdict.reasons)
    assert "The recording of x begins at 0.48 V while it moves" in reasons


def test_lines_by_a_trigger_are_those_of_the_table(scan, volts, shown, model, both):
    lines = np.concatenate([triggered(scan.gate(1), FS), triggered(scan.gate(-1), FS, -1)])
    lines = lines[np.argsort(lines["start"])]
    assert np.abs(lines["start"] - scan.lines["start"]).max() < 0.51 / FS
    assert lines["direction"].tolist() == scan.lines["direction"].tolist()
    record = ScanRecord(x=volts[0], sample_rate=FS, lines=lines, jitter=0.5 / FS)
    found = truestroke.unwarp(shown, record, model)
    assert np.hypot(*found.after) < 2.5 * found.timing
    assert "The trigger places a line to half a sample" in found.verdict.reasons[-1]
    assert found.moved == pytest.approx(both.moved, abs=2 * found.timing)


def test_the_voltage_places_the_retrace_of_a_trigger_beside_its_trace(folder, scan, shown, model):
    """Half a sample of both edges was 0.7 of 128 pixels at 4 rows a second and 2 kHz."""
    record = read_scan_record(folder / "volts.csv")
    apart = np.hypot(*truestroke.unwarp(shown, record, model).after)
    assert apart < 0.05
    assert apart < 0.3 * truestroke.unwarp(shown, record, model).timing
    trace, retrace = triggered(scan.gate(1), FS), triggered(scan.gate(-1), FS, -1)
    other = record.x + 0.3 * (np.gradient(record.x) < 0)  # V: it comes back by another way, as with a model before it
    assert all(map(np.array_equal, mirrored(trace, retrace, other, FS), (trace, retrace)))
    assert mirrored(trace, retrace[1:], record.x, FS)[0] is not None  # a line is missing: nothing moves


def test_a_period_of_broken_samples_is_placed_better_than_half_a_sample():
    """Edges of even lines: the mean of their rounding is known."""
    starts = 0.5 + np.arange(200) / 39.7
    tick = np.arange(round(6 * FS)) / FS
    gate = np.zeros(tick.size)
    for start in starts:
        gate[(tick >= start) & (tick < start + 0.01)] = 5.0  # V
    found = triggered(gate, FS)
    assert np.abs(found["start"] - starts).max() < 0.1 / FS
    assert np.abs(found["end"] - starts - 0.01).max() < 0.1 / FS


def test_a_model_that_is_bad_makes_no_good_image(scan, volts, shown, model):
    noisy = model.replace(provenance=Verdict("bad", ("The sensor was noisy.",)).entries)
    found = truestroke.unwarp(shown, ScanRecord.of(scan, *volts), model, noisy)
    assert found.verdict == Verdict("bad", ("The verdict of the model is bad: The sensor was noisy.",))


def test_what_still_separates_them_is_shared(scan, volts, shown, model):
    late = dataclasses.replace(ScanRecord.of(scan, *volts), x=np.roll(volts[0], 1))
    apart = truestroke.unwarp(shown, late, model)
    assert apart.verdict.level == "doubtful"
    assert "are still" in apart.verdict.reasons[0]
    shared = truestroke.unwarp(shown, late, model, align=True)
    assert np.hypot(*shared.after) < 0.1 * np.hypot(*apart.after)


def test_one_image_has_no_shift(scan, volts, shown, model):
    found = truestroke.unwarp(shown["trace"], ScanRecord.of(scan, *volts), model)
    assert (found.before, found.after) == (None, None)
    assert list(found.images) == ["trace"]
    assert found.verdict.level == "doubtful"
    assert "no retrace, so nothing shows whether the correction is right" in found.verdict.reasons[0]


@pytest.mark.parametrize(
    ("flat", "words"),
    [(("trace", "retrace"), "The trace and the retrace are the same"), (("retrace",), "The retrace is")],
)
def test_an_image_that_shows_nothing_is_corrected_and_doubtful(flat, words, folder, scan, volts, shown, model):
    """Such as the signal of a channel that was not connected: it was refused, with all others of the file."""
    made = {
        name: dataclasses.replace(one, data=np.full_like(one.data, 3.0)) if name in flat else one
        for name, one in shown.items()
    }
    found = truestroke.unwarp(made, ScanRecord.of(scan, *volts), model)
    assert found.after is None
    assert np.nanmax(np.abs(found.images["retrace"].data - 3.0)) < 1e-9
    assert found.verdict.level == "doubtful"
    (reason,) = found.verdict.reasons
    assert reason.startswith(words)
    assert reason.endswith("nothing shows whether the correction is right: look at the signal and its `channel`.")
    assert "<svg" in images_page(found, made, "").html()
    with pytest.raises(ImageError, match="the same everywhere"):
        truestroke.unwarp(made, ScanRecord.of(scan, *volts), model, align=True)


def mirrored_image(one):
    return dataclasses.replace(one, data=one.data[:, ::-1])


def upside_down(one):
    return dataclasses.replace(one, data=one.data[::-1])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda t, r: (t, mirrored_image(r)), "with the retrace mirrored"),
        (lambda t, r: (mirrored_image(t), mirrored_image(r)), "exchanged, or both mirrored"),
        (lambda t, r: (t, upside_down(r)), "with the retrace upside down"),
        (lambda t, r: (r, t), "with both images exchanged"),
        (lambda t, r: (t, t), "they are the same image"),
    ],
)
@pytest.mark.parametrize("late", [0, 1])
def test_images_that_are_not_as_they_were_shown_are_named_by_what_makes_them_agree(
    spoil, words, late, scan, volts, shown, model
):
    """It said that an image is mirrored or turned, or that the model is not that of the motion, whichever it was.

    Where the voltage is a sample late, so that more than 0.3 pixels remain, it still did.
    """
    pair = dict(zip(shown, spoil(shown["trace"], shown["retrace"]), strict=True))
    record = ScanRecord.of(scan, *volts)
    found = truestroke.unwarp(pair, dataclasses.replace(record, x=np.roll(volts[0], late)), model)
    assert found.verdict.level != "good"
    assert words in found.verdict.reasons[0]


@pytest.mark.parametrize(("exchange", "words"), [(False, None), (True, "both images exchanged")])
def test_offsets_of_rows_hide_neither_what_agrees_nor_what_is_exchanged(exchange, words, scan, volts, shown, model):
    """Each row of a microscope has its own: a right image was "not the model of this motion", and nothing was named."""
    random = np.random.default_rng(4)
    pair = {
        name: dataclasses.replace(one, data=one.data + 2 * np.std(one.data) * random.standard_normal((ROWS, 1)))
        for name, one in shown.items()
    }
    given = dict(zip(pair, reversed(pair.values()), strict=True)) if exchange else pair
    found = truestroke.unwarp(given, ScanRecord.of(scan, *volts), model, model)
    if words is None:
        assert found.verdict.level == "good"
        assert np.hypot(*found.after) < 0.1
    else:
        assert words in found.verdict.reasons[0]


def test_an_image_that_no_change_makes_agree_is_still_named(scan, volts, shown, model):
    turned = {name: dataclasses.replace(one, data=one.data[:, :ROWS].T) for name, one in shown.items()}
    found = truestroke.unwarp(turned, ScanRecord.of(scan, *volts), model)
    assert found.verdict.level == "bad"
    assert "further than before: an image is mirrored or turned" in found.verdict.reasons[0]


def test_rows_that_do_not_begin_together_and_a_late_voltage_are_named(scan, volts, shown, model):
    """Both were "not the model of this motion"."""
    record = ScanRecord.of(scan, *volts)
    rolled = dataclasses.replace(shown["retrace"], data=np.roll(shown["retrace"].data, 2, 0))
    found = truestroke.unwarp({**shown, "retrace": rolled}, record, model)
    assert "rows of the retrace are 2 off" in found.verdict.reasons[0]
    for samples, words in ((2, "1 ms too late"), (-2, "1 ms too early")):
        moved = dataclasses.replace(record, x=np.roll(volts[0], samples))
        assert words in truestroke.unwarp(shown, moved, model).verdict.reasons[0]


def test_a_recording_of_another_area_is_named(scan, volts, shown, model):
    """Half as high, its image was good."""
    halved = dataclasses.replace(ScanRecord.of(scan, *volts), y=0.5 * volts[1])
    found = truestroke.unwarp(shown, halved, model, model)
    assert found.verdict.level == "doubtful"
    assert "The image has 18 x 18 um by its file, and 1" in found.verdict.reasons[0]
    unknown = {name: dataclasses.replace(one, size=one.data.shape[::-1]) for name, one in shown.items()}
    assert truestroke.unwarp(unknown, halved, model, model).verdict.level == "good"  # a file without a size


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda x, y: (y, x),
            "x moves by .* um along a line, and by .* um from line to line: it is the voltage of the",
        ),
        (lambda x, y: (0 * x, y), "x moves by 0 um along a line"),
        (lambda x, y: (-x, y), "x goes back by .* um along the trace: the lines or triggers"),
        (
            lambda x, y: (1e3 * x, -y),
            "downwards; flip the image. The voltage of x goes from 0 to .* V, that of the model",
        ),
        (lambda x, y: (x, 0 * y + 1), "y does not rise"),
    ],
)
def test_a_voltage_that_is_not_that_of_the_axis_is_named(change, message, scan, volts, shown, model):
    """They were "no part in common", or "its line is not where the trigger says"."""
    with pytest.raises(ImageError, match=message):
        truestroke.unwarp(shown, ScanRecord.of(scan, *change(*volts)), model, model)


def test_exchanged_and_turned_images_are_named(scan, volts, shown, model):
    record = ScanRecord.of(scan, *volts)
    found = truestroke.unwarp({"trace": shown["retrace"], "retrace": shown["trace"]}, record, model)
    assert "exchanged" in found.verdict.reasons[0]
    turned = dataclasses.replace(shown["trace"], data=shown["trace"].data.T)
    with pytest.raises(ImageError, match="the trace has 128 rows, the recording 64 lines of it: it is turned by 90"):
        truestroke.unwarp(turned, record, model)


def test_a_square_scan_that_was_stopped_has_lost_rows(scan, volts, shown, model):
    """It was said to be turned by 90 degrees, and nothing else."""
    part = dataclasses.replace(shown["trace"], data=shown["trace"].data[:40, ::2])
    with pytest.raises(ImageError, match="40 rows, the recording 64 lines of it: it has lost its last rows"):
        truestroke.unwarp(part, ScanRecord.of(scan, *volts), model)


# ---- What does not fit ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: dataclasses.replace(r, lines=r.lines[2:]), "has 64 rows, the recording 63 lines of it"),
        (lambda r: dataclasses.replace(r, x=r.x[:-2000]), "the last line at .* s: it was cut short"),
        (lambda r: dataclasses.replace(r, lines=swapped(r.lines)), "goes back by .* along the trace"),
        (lambda r: dataclasses.replace(r, lines=in_ms(r.lines)), "or the times of the lines are in another unit"),
    ],
)
def test_a_record_that_does_not_fit_is_named(change, message, scan, volts, shown, model):
    with pytest.raises(ImageError, match=message):
        truestroke.unwarp(shown, change(ScanRecord.of(scan, volts[0])), model)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda x, gate: (x[:-20_000], gate[:-20_000]),
            "the recording 24 lines of it: it was cut short, so that lines before .* or behind 6.* s are missing",
        ),
        (lambda x, gate: (x, without(gate, 20, 2)), "triggers are missing, 2 of them, the first ones between"),
        (
            lambda x, gate: (x, without(gate, 0, 3)),
            "the recording 61 lines of it: it was cut short, so that lines before 1.* s",
        ),
    ],
)
def test_a_trigger_that_does_not_fit_says_what_is_missing(spoil, message, scan, volts, shown, model):
    x, gate = spoil(volts[0], scan.gate(1))
    record = ScanRecord(x=x, sample_rate=FS, lines=triggered(gate, FS), jitter=0.5 / FS)
    with pytest.raises(ImageError, match=message):
        truestroke.unwarp(shown["trace"], record, model)


@pytest.mark.parametrize("column", [True, False])
def test_a_trigger_that_came_late_is_named(column, scan, volts, shown, model):
    """3 samples of 200 were within what is allowed, and made all other lines uneven, too."""
    if column:
        gate = scan.gate(1)
        gate[scan.lines["first"][20] :][:3] = 0
        trace = triggered(gate, FS)
        others = np.delete(np.arange(trace.size), 10)
        assert np.abs(trace["start"] - triggered(scan.gate(1), FS)["start"])[others].max() < 1e-9
    else:
        trace = scan.lines[::2].copy()
        trace["start"][10] += 3 / FS
    retrace = scan.lines[1::2]
    record = ScanRecord(
        x=volts[0],
        sample_rate=FS,
        lines=np.sort(np.concatenate([trace, retrace]), order="start"),
        jitter=0.5 / FS if column else 0.0,
    )
    found = truestroke.unwarp(shown, record, model)
    assert found.verdict.level == "doubtful"
    words = " ".join(found.verdict.reasons)
    assert re.search(r"Line 10 of the trace begins or ends 1\.[3-7] ms later than the others say: where its", words)
    assert "of the retrace begins" not in words


def test_a_line_whose_trigger_ends_too_soon_is_named(scan, volts, shown, model):
    gate = scan.gate(1)
    gate[scan.lines["first"][4] + 100 : scan.lines["last"][4] + 1] = 0
    record = ScanRecord(x=volts[0], sample_rate=FS, lines=triggered(gate, FS), jitter=0.5 / FS)
    with pytest.raises(ImageError, match=r"line 2 of the trace lasts 0.05 s, the others 0.1 s: its trigger is damaged"):
        truestroke.unwarp(shown["trace"], record, model)


def test_a_voltage_beyond_that_of_the_model_is_named(scan, volts, shown, model):
    """As of a monitor of 1:10 that nobody has scaled."""
    found = truestroke.unwarp(shown, ScanRecord.of(scan, 0.1 * volts[0]), model).verdict
    assert "The image has 18 x 18 um by its file, and 1" in found.reasons[0]
    assert "The voltage" not in " ".join(found.reasons)  # a smaller scan is none
    found = truestroke.unwarp(shown, ScanRecord.of(scan, 10.0 * volts[0]), model).verdict
    assert "The voltage of x goes from 0 to 2" in " ".join(found.reasons)


def without(gate, first, count):
    """A gate that misses some of its lines."""
    line = np.cumsum(np.diff(gate, prepend=0) > 0) - 1
    return np.where((line >= first) & (line < first + count), 0, gate)


def in_ms(lines):
    made = lines.copy()
    made["start"], made["end"] = 1e3 * lines["start"], 1e3 * lines["end"]
    return made


def swapped(lines):
    """Trace and retrace mistaken for one another."""
    made = lines.copy()
    made["direction"] *= -1
    return made


def test_what_is_missing_is_named(scan, volts, shown, model):
    record = ScanRecord.of(scan, volts[0])
    with pytest.raises(ImageError, match="no voltage of y"):
        truestroke.unwarp(shown, record, model, model)
    with pytest.raises(ImageError, match="only one image"):
        truestroke.unwarp(shown["trace"], record, model, align=True)
    with pytest.raises(ImageError, match="the voltage has 3 samples"):
        ScanRecord.of(scan, np.zeros(3))
    with pytest.raises(ImageError, match="never changes: it is missing"):
        triggered(np.ones(10), FS)
    with pytest.raises(ImageError, match="no whole line"):
        triggered([0, 0, 1, 1], FS)
    with pytest.raises(SettingError, match="x = array of shape"):
        truestroke.unwarp(shown, record, np.zeros(3))


@pytest.mark.parametrize(
    ("names", "channel", "trace"),
    [
        (["ZSensor Retrace", "ZSensor Trace"], None, 1),
        (["Phase [Bwd]", "Phase [Fwd]", "Topography [Bwd]", "Topography [Fwd]"], "topography", 3),
        (["Deflection", "Height_backward", "Height_forward"], "HEIGHT", 2),
        (["first", "second"], None, 0),
    ],
)
def test_images_of_a_microscope_are_trace_and_retrace_by_their_names(names, channel, trace):
    images = [scans.Image(data=np.eye(2), size=(1.0, 1.0), name=name, unit="nm") for name in names]
    made = by_direction(images, channel=channel)
    assert set(made) == {"trace", "retrace"}
    assert made["trace"] is images[trace]


def test_the_second_of_two_files_is_the_retrace_whatever_its_name():
    """Programs that write one file for each direction may name both images alike."""
    first, second = (scans.Image(data=np.eye(2), size=(1.0, 1.0), name="Height trace", unit="nm") for _ in range(2))
    phase = dataclasses.replace(first, name="phase")
    made = by_direction([phase, first], [second], channel="height")
    assert (made["trace"] is first, made["retrace"] is second) == (True, True)


def test_a_signal_that_is_not_one_of_the_file_is_named():
    images = [scans.Image(data=np.eye(2), size=(1.0, 1.0), name=name, unit="nm") for name in ("a", "b", "c")]
    with pytest.raises(ImageError, match=r"3 images are not a trace, .* by `channel` take .* of 'a', 'b', 'c'"):
        by_direction(images)
    with pytest.raises(ImageError, match="2 images are not a trace"):
        by_direction([dataclasses.replace(image, name=f"{image.name} forward") for image in images[:2]])
    with pytest.raises(ImageError, match="there is no image whose name contains 'height'; there must be a trace,"):
        by_direction(images, channel="height")


# ---- The command ---------------------------------------------------------------------------------------------------


def run(*arguments):
    done = CliRunner().invoke(main, ["unwarp", *map(str, arguments)])
    return done.exit_code, done.stdout or done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scan, volts, shown):
    place = tmp_path_factory.mktemp("unwarp")
    scans.save_images(place / "scan.gwy", shown)
    columns = np.column_stack([scan.time, *volts, scan.gate(1), scan.gate(-1)])
    np.savetxt(place / "volts.csv", columns, "%.7g", ",", header="time (s),x (V),y (V),trigger,retrace", comments="")
    np.savetxt(place / "plain.csv", columns[:, :3], "%.7g", ",", header="time (s),x (V),y (V)", comments="")
    scan.save_lines(place / "lines.csv")
    return place


def test_the_command_writes_image_and_page(folder, tmp_path):
    common = [folder / "scan.gwy", "--model", DAY_BEFORE, "--model-y", DAY_BEFORE, "--output", tmp_path / "new.nxs"]
    code, text = run(*common, "--record", folder / "plain.csv", "--lines", folder / "lines.csv", "--json")
    found = json.loads(text)
    assert (code, found["verdict"]) == (0, "good")
    assert np.hypot(*found["after_pixels"]) < 0.1
    trace, retrace = scans.read_images(tmp_path / "new.nxs")
    assert (trace.name, retrace.name) == ("height, trace", "height, retrace")
    assert "trace and retrace apart, after" in (tmp_path / "new.html").read_text()


def test_a_sample_rate_that_is_no_number_is_refused_beside_time_stamps(folder):
    """It ended in warnings of NumPy with lines of the source, before the sentence."""
    with pytest.raises(SettingError, match="sample_rate = nan Hz: must be finite"):
        read_scan_record(folder / "volts.csv", sample_rate=float("nan"))


@pytest.mark.usefixtures("each_picture_once")
def test_a_gsf_is_said_to_hold_the_trace_alone(folder, tmp_path):
    files = ["--record", folder / "plain.csv", "--lines", folder / "lines.csv", "--output", tmp_path / "new.gsf"]
    code, text = run(folder / "scan.gwy", "--model", DAY_BEFORE, *files)
    assert code == 0
    assert "a .gsf holds one image, here height, trace" in " ".join(text.split())


@pytest.mark.usefixtures("each_picture_once")
def test_without_a_model_of_the_slow_axis_it_is_said_not_to_be_corrected(folder, tmp_path):
    files = ["--record", folder / "plain.csv", "--lines", folder / "lines.csv", "--output", tmp_path / "new.gwy"]
    given = [folder / "scan.gwy", "--model", DAY_BEFORE, *files]
    code, text = run(*given)
    assert code == 0
    assert "slow axis                        not corrected: without a model of y (--model-y)" in text
    assert "not corrected" in (tmp_path / "new.html").read_text()
    assert "slow axis" not in run(*given, "--model-y", DAY_BEFORE, "--force")[1]


@pytest.mark.usefixtures("each_picture_once")
def test_a_model_of_both_axes_is_warned_of_once(folder, tmp_path):
    model = tmp_path / "model.toml"
    about = Verdict("doubtful", ("It was hot.",)).entries
    truestroke.save_model(model, truestroke.load_model(DAY_BEFORE).replace(provenance=about))
    files = ["--record", folder / "plain.csv", "--lines", folder / "lines.csv", "--output", tmp_path / "new.gwy"]
    given = ["unwarp", folder / "scan.gwy", "--model", model, "--model-y", model, *files]
    assert CliRunner().invoke(main, list(map(str, given))).stderr.count("It was hot") == 1


def test_an_output_of_another_kind_is_refused_before_anything_is_read(tmp_path):
    image, record = tmp_path / "scan.gwy", tmp_path / "volts.csv"
    image.write_bytes(b"no image at all"), record.write_text("nothing")
    code, text = run(image, "--model", DAY_BEFORE, "--record", record, "--output", "new.png")
    assert (code, "--output = new.png: must be a file that ends with .gsf, .gwy" in text) == (2, True)


@pytest.mark.parametrize("name", ["scan.png", "scan.npy", "scan.sxm"])
def test_a_file_of_another_kind_is_refused_with_what_to_do(folder, tmp_path, name):
    (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n")
    code, text = run(tmp_path / name, "--model", DAY_BEFORE, "--record", folder / "volts.csv")
    assert code == 2
    assert (
        "ends with .gsf, .gwy, .tif, .tiff, .nxs: save it as one of these where it was recorded, or in Gwyddion" in text
    )


@pytest.mark.usefixtures("each_picture_once")
def test_the_command_takes_one_of_several_signals(folder, shown, tmp_path):
    several = [*shown.values(), dataclasses.replace(shown["trace"], name="phase, trace")]
    scans.save_images(tmp_path / "several.gwy", several)
    files = ["--record", folder / "plain.csv", "--lines", folder / "lines.csv", "--output", tmp_path / "new.gwy"]
    common = [tmp_path / "several.gwy", "--model", DAY_BEFORE, *files]
    code, text = run(*common)
    assert code == 1
    assert "'phase, trace'" in text
    assert run(*common, "--channel", "Height")[0] == 0
    assert [image.name for image in scans.read_images(tmp_path / "new.gwy")] == ["height, trace", "height, retrace"]


@pytest.mark.usefixtures("each_picture_once")
def test_the_command_reads_a_trigger_and_names_one_that_is_missing(folder, tmp_path):
    common = [folder / "scan.gwy", "--model", DAY_BEFORE, "--output", tmp_path / "new.gwy"]
    code, text = run(*common, "--record", folder / "volts.csv")
    assert code == 0
    assert "The trigger places a line to half a sample" in " ".join(text.split())
    code, text = run(*common, "--record", folder / "plain.csv")
    assert code == 1
    assert "there is no trigger: name the column" in text
    code, text = run(*common, "--record", folder / "volts.csv", "--retrace-trigger", "trigger")
    assert code == 1
    assert "there is no trigger of the trace beside that of the retrace" in text
    code, text = run(*common, "--record", folder / "plain.csv", "--lines", folder / "lines.csv", "--trigger", "x")
    assert code == 2


def test_a_line_that_ends_before_it_begins_is_named(tmp_path):
    """All of them lasted -90 s, which were as the others; the first that was not was a damaged trigger."""
    path = tmp_path / "lines.csv"
    path.write_text("row,direction,start (s),end (s)\n0,1,0.1,0.2\n1,1,0.4,0.3\n")
    with pytest.raises(RecordError, match=r"line 3: the line ends at 0.3 s, and begins at 0.4 s: are the columns"):
        read_lines(path)


def test_a_single_line_is_corrected_with_the_model_of_y_too(model):
    """One row does not rise: it was refused as if the slow axis did not move."""
    scan = scans.raster(width=18.0, lines=1, rate=4.0, sample_rate=FS, offset=(13.0, 13.0))
    volts = [axis.position / GAIN for axis in scan.axes]
    shown = scans.images(scan, TEXTURE(*[scans.at_pixels(scan, moved(one), 64) for one in volts]))
    made = truestroke.unwarp(shown, ScanRecord.of(scan, *volts), model, model)
    alone = truestroke.unwarp(shown, ScanRecord.of(scan, *volts), model)
    np.testing.assert_array_equal(made.images["trace"].data, alone.images["trace"].data)
    assert made.images["trace"].size[1] == pytest.approx(18.0)
    assert abs(made.after[0]) < 0.1


def test_a_trigger_that_is_missing_is_named_with_its_remedy(shown, scan, volts, model):
    record = ScanRecord.of(scan, *volts)
    trace = dataclasses.replace(record, lines=record.lines[record.lines["direction"] > 0])
    with pytest.raises(ImageError, match=r"0 lines of it: .*`retrace_trigger` of the retrace, and a table of `lines`"):
        truestroke.unwarp(shown, trace, model)


@pytest.mark.filterwarnings("error")
def test_images_that_share_one_pixel_have_a_shift_of_whole_pixels():
    """scikit-image warned that it could not determine an error, with the path of its caller."""
    first = scans.Image(data=np.array([[1.0, 0.0], [0.0, 0.0]]), size=(1.0, 1.0))
    second = scans.Image(data=np.array([[0.0, 0.0], [0.0, 1.0]]), size=(1.0, 1.0))
    assert all(float(n).is_integer() for n in scans.shift(first, second))
