"""Scans: motions that are what they say, tables that mark them, images whose pixels are where they should be."""

import json
import os
import re
import shutil
import subprocess
import sys

import gwyfile
import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image as Pillow
from scipy import ndimage

from truestroke import Dynamics, Mode, SettingError, scans
from truestroke.base import system
from truestroke.signals.scans import rates
from truestroke.signals.scans.images import at_pixels

FS = 10_000.0
STAGE = Dynamics(sample_rate=FS, modes=(Mode(frequency=900.0, damping=0.02),))


def made(name, **others):
    usual = {"raster": {"lines": 8, "rate": 40.0}, "spiral": {"turns": 12, "rotation": 40.0}}
    usual |= {"lissajous": {"rate": 40.0, "lobes": 12}, "cycloid": {"rate": 40.0, "pitch": 2.0}}
    return getattr(scans, name)(**usual[name] | others)


SMALL = scans.raster(width=20.0, lines=4, rate=40.0, sample_rate=5000.0)
EVERY = {
    "raster": made("raster"),
    "raster with dynamics": made("raster", turn=STAGE, settle=STAGE, over_scan=0.05),
    "raster with a ramp": made("raster", slow="ramp"),
    "spiral": made("spiral"),
    "spiral of constant linear velocity": made("spiral", velocity="linear"),
    "lissajous": made("lissajous"),
    "cycloid": made("cycloid"),
}
every = pytest.mark.parametrize("scan", EVERY.values(), ids=EVERY.keys())


# ---- Motions -------------------------------------------------------------------------------------------------------


@every
def test_a_scan_starts_at_zero_at_rest(scan):
    for axis in scan.axes:
        assert axis.position[0] == pytest.approx(0.0, abs=1e-9)
        assert axis.velocity[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["raster", "spiral", "lissajous", "cycloid"])
@pytest.mark.parametrize("other", [{}, {"slow": "ramp"}, {"velocity": "linear"}])
def test_velocity_and_acceleration_are_the_derivatives(name, other):
    """Against central differences; a spiral starts to turn at once, which is a corner of a few um/s."""
    if other and set(other) != {{"raster": "slow", "spiral": "velocity"}.get(name)}:
        return
    scan, rate = made(name, **other, sample_rate=100_000.0), 100_000.0
    for axis in scan.axes:
        v = np.gradient(axis.position, 1 / rate)[2:-2] - axis.velocity[2:-2]
        a = np.gradient(axis.velocity, 1 / rate)[2:-2] - axis.acceleration[2:-2]
        corners = 2 if scan.name == "spiral" else 0
        for off, scale in ((v, axis.peak_speed), (a, axis.peak_acceleration)):
            assert np.sort(np.abs(off))[-1 - 4 * corners] < 0.02 * scale  # the jerk of a step jumps


@every
def test_lines_follow_one_another_and_reach_over_the_image(scan):
    lines = scan.lines
    assert np.all(lines["end"] > lines["start"])
    assert np.all(lines["start"][1:] >= lines["end"][:-1] - 1e-9)
    assert lines["end"][-1] <= scan.x.duration + 1e-9
    assert scan.inside.sum() == np.sum(lines["last"] - lines["first"] + 1)
    inside = scan.inside
    for axis, low, size in zip(scan.axes, scan.origin, scan.size, strict=True):
        part = axis.position[inside]
        assert part.min() < low + 0.1 * size
        assert part.max() > low + 0.9 * size
    assert scan.line_of_tick.max() == len(lines) - 1


@pytest.mark.parametrize("name", ["raster", "raster with dynamics"])
def test_the_lines_of_a_raster_are_straight_even_and_on_their_row(name):
    scan = EVERY[name]
    x, y = (at_pixels(scan, axis.position, 64) for axis in scan.axes)
    centres = scan.origin[0] + (np.arange(64) + 0.5) * scan.size[0] / 64
    rows = scan.origin[1] + (scan.lines["row"] + 0.5) * scan.size[1] / 8
    assert np.abs(x - centres).max() < 1e-5  # um, trace and retrace alike
    assert np.abs(y - rows[:, None]).max() < 1e-3 * scan.size[1] / 8


def test_the_ramp_of_a_raster_passes_each_row_at_its_middle():
    scan = EVERY["raster with a ramp"]
    middle = np.mean([scan.lines["start"][::2], scan.lines["end"][1::2]], axis=0)
    y = np.interp(middle, scan.time, scan.y.position)
    assert np.allclose(np.diff(y), scan.size[1] / 8, atol=1e-6)
    assert y[0] == pytest.approx(scan.origin[1] + scan.size[1] / 16, abs=scan.size[1] / 16)


def test_the_turns_and_steps_of_a_raster_leave_the_stage_at_rest():
    """The mode itself, simulated, on the lines: a triangle and sudden steps would leave it ringing."""
    from scipy.signal import lsim

    scan = EVERY["raster with dynamics"]
    w, zeta = 2 * np.pi * 900.0, 0.02
    time = np.arange(4 * len(scan.x)) / (4 * FS)
    for axis in scan.axes:
        command = np.interp(time, scan.time, axis.position)
        _, z, _ = lsim(([w**2], [1, 2 * zeta * w, w**2]), command, time)
        error = (z[::4] - axis.position + 2 * zeta / w * axis.velocity)[scan.inside]
        assert np.abs(error).max() < 2e-4 * axis.peak_to_peak + 2e-4


@pytest.mark.parametrize("name", ["spiral", "spiral of constant linear velocity"])
def test_a_spiral_keeps_its_pitch_and_what_is_constant(name):
    scan = EVERY[name]
    x, y = (axis.position[scan.inside] - 10.0 for axis in scan.axes)
    radius, angle = np.hypot(x, y), np.unwrap(np.arctan2(y, x))
    turned = radius > 0.5
    assert np.allclose(np.diff(radius[turned]) / np.diff(angle[turned]), 10 / 12 / (2 * np.pi), rtol=1e-3)
    if name == "spiral":
        assert np.allclose(np.diff(angle[turned]) * FS / (2 * np.pi), 40.0, rtol=1e-3)
    else:
        speed = np.hypot(*(axis.velocity[scan.inside] for axis in scan.axes))
        assert np.ptp(speed[radius > 6]) < 1e-6 * speed.max()
        assert np.diff(angle[turned]).max() * FS / (2 * np.pi) < 2 * 40.0 * 1.02


def test_a_lissajous_curve_repeats_after_its_frame():
    scan = scans.lissajous(rate=40.0, lobes=10, frames=2, ramp=0.0, sample_rate=FS)
    ticks = round(scan.settings["frame_time"] * FS)
    for axis in scan.axes:
        assert np.allclose(axis.position[ticks : 2 * ticks], axis.position[:ticks], atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(
    rate=st.floats(1.0, 100.0),
    over=st.floats(0.0, 0.5),
    lines=st.integers(1, 20),
    turn=st.floats(0.05, 0.9),
    width=st.floats(0.1, 100.0),
)
def test_a_line_of_any_raster_passes_the_whole_width(rate, over, lines, turn, width):
    scan = scans.raster(rate=rate, over_scan=over, lines=lines, turn=turn, width=width, sample_rate=5000.0)
    one = scan.lines[-1]
    ends = np.interp([one["start"], one["end"]], scan.time, scan.x.position)
    tick = float(scan.x.settings["speed"]) / 5000.0
    assert np.abs(ends - np.add(scan.origin[0], [width, 0.0])).max() < tick + 1e-6


# ---- Tables --------------------------------------------------------------------------------------------------------


def test_triggers_mark_start_pixels_and_end_of_each_line():
    scan = EVERY["raster"]
    table = scan.triggers(16)
    assert np.all(np.diff(table["time"]) > -1e-12)
    for number, line in enumerate(scan.lines):
        one = table[table["line"] == number]
        assert one["kind"].tolist() == ["line start", *["pixel"] * 16, "line end"]
        assert one["tick"][0] == line["first"]
        assert one["tick"][-1] == line["last"] + 1
        order = range(16) if line["direction"] > 0 else range(15, -1, -1)
        assert one["pixel"][1:-1].tolist() == list(order)


def test_pixels_that_are_shorter_than_a_tick_have_no_triggers_of_their_own():
    scan = EVERY["raster"]
    most = int((scan.lines["last"] - scan.lines["first"] + 1).min())
    each = scan.triggers(most)
    for number in range(scan.lines.size):
        ticks = each["tick"][(each["line"] == number) & (each["kind"] == "pixel")]
        assert np.all(np.diff(ticks) > 0)
    with pytest.raises(SettingError, match=rf"columns = {10**6}: must be at most \d+, or a higher sample rate"):
        scan.triggers(10**6)


def test_the_gate_has_an_edge_for_each_line():
    scan = EVERY["raster"]
    for direction, lines in ((1, 8), (-1, 8), (0, 16)):
        gate = scan.gate(direction).astype(int)
        assert np.count_nonzero(np.diff(gate) == 1) == lines
        assert np.count_nonzero(np.diff(gate) == -1) == lines
    with pytest.raises(SettingError, match="direction = 2: must be 1"):
        scan.gate(2)


def test_a_motion_and_its_lines_come_back_from_their_files(tmp_path):
    from truestroke import read_lines, trajectories

    scan = EVERY["raster"]
    path = scan.save_motion(tmp_path / "scan.csv")
    for name, axis in zip("xy", scan.axes, strict=True):
        about = {"position": name, "time": "time", "velocity": f"{name} velocity"}
        back = trajectories.from_csv(path, **about, ramp=0.0)
        assert np.allclose(back.position, axis.position, atol=1e-7)
        assert np.allclose(back.velocity, axis.velocity, atol=1e-5)
    lines = read_lines(scan.save_lines(tmp_path / "lines.csv"))
    for column in ("row", "direction", "start", "end"):
        assert np.allclose(lines[column], scan.lines[column], atol=1e-8)
    scan.save_motion(path)  # its own kind
    with pytest.raises(FileExistsError, match="not a table of lines"):
        scan.save_lines(path)


# ---- Errors --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: made("raster", turn=STAGE, width=-1.0), "width = -1.0 um: must be above 0"),
        (lambda: scans.raster(rate=400.0, turn=STAGE), "rate = 400.0 Hz: must be at most"),
        (
            lambda: made("raster", lead_in=0),
            "lead_in = 0 rows: must be at least 10 at 40 rows a second, for the 0.25 s of the ramp",
        ),
        (lambda: made("raster", slow="jumps"), "slow = 'jumps': must be 'steps' or 'ramp'"),
        (lambda: made("raster", turn=0.02, settle=STAGE), "steps take at most 0.25 ms"),
        (lambda: made("spiral", pitch=0.1), "turns = 12: must be left out"),
        (lambda: made("spiral", fastest=80.0), "fastest = 80.0 Hz: must be left out at constant angular"),
        (
            lambda: made("raster", rate=1e-4, lines=2048),
            "duration = 20490000.0 s: must be at most .* at 10000 Hz, as a scan of 2.05e.11 ticks and its "
            "images take 1.54e.05 GB of memory",
        ),
        (lambda: made("spiral", rotation=5000.0), "rotation = 5000.0 Hz: must be below half of the sample rate, 5000"),
        (lambda: scans.lissajous(lobes=1), "lobes = 1: must be a whole number from 2"),
        (lambda: scans.cycloid(rate=5000.0), "rate = 5000.0 Hz: must be below a quarter"),
        (lambda: made("raster", offset=(1.0,)), "two numbers, x and y"),
    ],
)
def test_a_wrong_setting_is_named(call, message):
    with pytest.raises(SettingError, match=message):
        call()


def test_a_signal_that_is_dead_is_said():
    scan = scans.raster(width=10.0, lines=16, rate=40.0, lead_in=20, sample_rate=10_000.0)
    found = scans.recorded(scan, scan.x.position, scan.y.position, np.full(len(scan.x), 3.0), columns=64)
    assert found.verdict.level == "doubtful"
    assert "the same in all pixels" in found.verdict.reasons[0]


def test_what_is_no_array_or_image_is_named():
    scan = scans.raster(width=10.0, lines=4, rate=40.0, lead_in=20, sample_rate=10_000.0)
    x, y = scan.x.position, scan.y.position
    for call, message in (
        (lambda: scans.recorded(scan, x, y, "high"), "signal = 'high'.*: must be an array of numbers"),
        (lambda: scans.recorded(scan, x, y, x + 1j), "signal = .*: must be an array of real numbers"),  # of a lock-in
        (lambda: scans.recorded(scan, [x, y], y, x), r"x = array of shape \(2, .* um: must be a row of numbers"),
        (lambda: scans.images(scan, [[1.0], "a"]), "signal = .*: must be an array of numbers"),
        (lambda: scans.distortion(scan, x, "low", 64), "y = .*: must be an array of numbers"),
        (lambda: scans.shift(np.zeros((9, 9)), np.zeros((9, 9))), "reference = .* must be an Image"),
    ):
        with pytest.raises(SettingError, match=message):
            call()


def test_a_scan_that_memory_cannot_hold_is_refused_before_it_is_made(monkeypatch):
    monkeypatch.setattr(system, "free_memory", lambda: 4e9)
    words = r"must be at most 107 s at 50000 Hz, as a scan of 2.56e\+07 ticks .* 19.2 GB of memory, and 4 GB are free"
    with pytest.raises(SettingError, match=words):
        scans.raster(sample_rate=50_000.0, rate=1.0, lines=512)
    monkeypatch.undo()
    assert 1e8 < system.free_memory() <= system.memory()


# ---- Images --------------------------------------------------------------------------------------------------------

TEXTURE = scans.Texture(seed=3, grain=0.3)


def test_samples_of_the_true_place_give_the_sample_itself():
    scan = scans.raster(width=10.0, lines=32, rate=20.0, lead_in=15, sample_rate=FS)
    places = [at_pixels(scan, axis.position, 48) for axis in scan.axes]
    shown = scans.images(scan, TEXTURE(*places), name="height", unit="nm")
    x, y = np.meshgrid((np.arange(48) + 0.5) * 10 / 48 + scan.origin[0], (np.arange(32) + 0.5) * 10 / 32)
    for one in shown.values():
        assert np.allclose(one.data, TEXTURE(x, y), atol=1e-4)
    by_ticks = scans.images(scan, TEXTURE(scan.x.position, scan.y.position), 48)
    assert np.std(by_ticks["trace"].data - shown["trace"].data) < 0.05 * np.std(shown["trace"].data)


def test_a_spiral_and_a_curve_show_the_same_sample_on_a_grid():
    for scan in (scans.spiral(diameter=10.0, turns=60, rotation=20.0), scans.lissajous(width=10.0, lobes=120)):
        one = scan.inside
        x, y = scan.x.position[one], scan.y.position[one]
        shown = scans.gridded(x, y, TEXTURE(x, y), origin=scan.origin, size=scan.size, shape=(50, 50))
        centre = (np.arange(50) + 0.5) / 5
        true = TEXTURE(*np.meshgrid(centre, centre))
        known = np.isfinite(shown.data)
        assert np.mean(known) > 0.75
        assert np.corrcoef(shown.data[known], true[known])[0, 1] > 0.93


@pytest.mark.parametrize(("right", "up"), [(0.0, 0.04), (0.3, -0.27), (5.61, 2.0), (-12.4, 0.5)])
def test_the_shift_between_two_images_is_found_to_a_fiftieth_of_a_pixel(right, up):
    """Images of a texture that is displaced, not rolled: what leaves at one edge does not come back at the other."""
    x, y = np.meshgrid(np.arange(160) * 0.05, np.arange(200) * 0.05)
    still = scans.Image(data=TEXTURE(x, y), size=(8.0, 10.0))
    moved = scans.Image(data=TEXTURE(x - right * 0.05, y - up * 0.05), size=(8.0, 10.0))
    assert scans.shift(still, moved) == pytest.approx((right, up), abs=0.02)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("noise", "rows"), [(0.5, 0.0), (0.0, 0.3), (0.3, 3.0)])
def test_noise_and_rows_of_other_offsets_hide_no_shift(seed, noise, rows):
    """Of two images with a noise of half of their rms it was up to 0.7 pixels off.

    Where each row has an offset of its own, as of a microscope, it was up to 5 pixels off along the rows' numbers.
    """
    right, up, coarse = 2.3, -1.6, scans.Texture(seed=seed, grain=0.5)
    x, y = np.meshgrid(np.arange(256) * 0.05, np.arange(128) * 0.05)
    random = np.random.default_rng(seed)

    def seen(data):
        added = noise * random.standard_normal(data.shape) + rows * random.standard_normal((data.shape[0], 1))
        return scans.Image(data=data + added * np.std(data), size=(12.8, 6.4))

    still, moved = seen(coarse(x, y)), seen(coarse(x - right * 0.05, y - up * 0.05))
    assert scans.shift(still, moved) == pytest.approx((right, up), abs=0.2)


def test_a_sample_of_rows_alone_has_a_shift():
    """What is the same in each row is all that such a sample shows: nothing of it is taken off."""
    x, y = np.meshgrid(np.arange(128) * 0.1, np.arange(160) * 0.1)
    still, moved = (scans.Image(data=np.tanh(np.sin(y - up)) + 1e-3 * np.sin(x), size=(12.8, 16.0)) for up in (0, 0.12))
    assert scans.shift(still, moved) == pytest.approx((0.0, 1.2), abs=0.05)


def test_distortion_is_what_was_done_to_the_positions():
    scan = EVERY["raster"]
    assert scans.distortion(scan, scan.x.position, scan.y.position, 100).largest < 1e-9
    pixel = 20.0 / 100
    late = scans.distortion(scan, np.interp(scan.time - 1e-3, scan.time, scan.x.position), scan.y.position, 100)
    speed = float(scan.x.settings["speed"])
    assert late.trace_retrace == pytest.approx(2e-3 * speed / pixel, rel=0.02)
    assert scans.distortion(scan, scan.x.position + 1.0, scan.y.position, 100).largest < 1e-9  # a shift is none
    sheared = scans.distortion(scan, scan.x.position, scan.y.position + 0.01 * scan.x.position, 100)
    assert np.ptp(sheared.dy) == pytest.approx(0.01 * 20.0 * 0.99 / (20.0 / 8), rel=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda scan: scans.images(scan, np.zeros(7)), "the signal has 7 samples, the scan 9500 ticks"),
        (lambda scan: scans.images(scan, np.zeros((15, 9))), r"shape \(15, 9\): must be one sample a tick, 9500"),
        (lambda scan: scans.images(scan, cut(scan, 5)), "line 5 of 16 has no sample: its trigger is missing"),
        (lambda scan: scans.distortion(scan, np.zeros(3), np.zeros(3)), "the position has 3 samples"),
        (lambda _: scans.gridded([0.0], [0.0], [1.0, 2.0], origin=(0, 0), size=(1, 1)), "have 1, 1, 2 samples"),
        (lambda _: scans.gridded([9.0], [9.0], [1.0], origin=(0, 0), size=(1, 1)), "no sample is within the image"),
        (lambda _: scans.shift(flat((4, 4)), flat((4, 5))), "must be as many"),
        (lambda _: scans.shift(flat((4, 4)), flat((4, 4))), "is the same everywhere"),
    ],
)
def test_what_does_not_fit_is_named(call, message):
    with pytest.raises(scans.ImageError, match=message):
        call(EVERY["raster"])


def flat(shape):
    return scans.Image(data=np.zeros(shape), size=(1.0, 1.0))


def cut(scan, line):
    """A recording of ticks in which a line was not triggered."""
    signal = np.arange(len(scan.x), dtype=float)
    signal[scan.lines["first"][line] - 5 : scan.lines["last"][line] + 6] = np.nan
    return signal


def test_a_spiral_has_no_rows():
    with pytest.raises(SettingError, match="a spiral: must be a raster"):
        scans.images(EVERY["spiral"], np.zeros(len(EVERY["spiral"].x)))


# ---- Files ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair():
    data = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=(24, 32)), 1.0)
    return [
        scans.Image(data=sign * data, size=(8.0, 5.0), origin=(1.0, 2.5), name=name, unit="nm")
        for sign, name in ((1.0, "trace"), (2.0, "retrace"))
    ]


@pytest.mark.parametrize("ending", ["gsf", "gwy", "tif", "nxs"])
def test_a_file_gives_its_images_back(ending, pair, tmp_path):
    given = pair[:1] if ending == "gsf" else pair
    back = scans.read_images(scans.save_images(tmp_path / f"a.{ending}", given))
    assert len(back) == len(given)
    for one, other in zip(given, back, strict=True):
        assert np.allclose(one.data, other.data, atol=1e-6)
        assert (one.size, one.origin, one.name, one.unit) == (other.size, other.origin, other.name, other.unit)


@pytest.mark.parametrize("ending", ["gsf", "gwy"])
def test_gwyddion_reads_the_same_heights_and_places(ending, pair, tmp_path):
    """It writes what it has read to a file of its own; rows of that begin at the highest y, heights are in m."""
    if not shutil.which("gwyddion"):
        assert not os.environ.get("CI"), "CI needs Gwyddion: apt-get install gwyddion"
        pytest.skip("no Gwyddion here; Debian: apt-get install gwyddion")
    given = pair[:1] if ending == "gsf" else pair
    path, read = scans.save_images(tmp_path / f"a.{ending}", given), tmp_path / "read.gwy"
    subprocess.run(["gwyddion", f"--convert-to-gwy={read}", path], check=True)
    fields = gwyfile.util.get_datafields(gwyfile.load(str(read)))
    assert list(fields) == [one.name for one in given]
    for one, field in zip(given, fields.values(), strict=True):
        assert np.allclose(field.data, 1e-9 * one.data[::-1], rtol=1e-6, atol=1e-16)
        area = (field.xoff, field.yoff, field.xreal, field.yreal)
        assert area == pytest.approx([1e-6 * length for length in (*one.origin, *one.size)])
        assert (field.si_unit_xy.unitstr, field.si_unit_z.unitstr) == ("m", "m")


def test_a_gsf_is_what_its_specification_says(pair, tmp_path):
    """By the text of the format: a magic line, fields, NUL up to a multiple of four, rows of float32 from the top."""
    raw = scans.save_images(tmp_path / "a.gsf", pair[0]).read_bytes()
    end = raw.index(b"\0")
    lines = raw[:end].decode().splitlines()
    assert lines[0] == "Gwyddion Simple Field 1.0"
    fields = dict(line.split(" = ") for line in lines[1:])
    assert (int(fields["XRes"]), int(fields["YRes"]), fields["ZUnits"]) == (32, 24, "m")
    assert (float(fields["XReal"]), float(fields["YReal"])) == pytest.approx((8e-6, 5e-6))
    begin = end + 4 - end % 4
    data = np.frombuffer(raw[begin:], "<f4").reshape(24, 32)
    assert np.allclose(data[0], 1e-9 * pair[0].data[-1])


def test_a_gwy_has_the_serialised_container_of_its_specification(pair, tmp_path):
    """Read by its bytes: magic, the name of the container, its size, and a data field for each image."""
    raw = scans.save_images(tmp_path / "a.gwy", pair).read_bytes()
    assert raw[:4] == b"GWYP"
    assert raw[4:17] == b"GwyContainer\0"
    assert int.from_bytes(raw[17:21], "little") == len(raw) - 21
    assert raw.count(b"GwyDataField\0") == 2
    assert b"/1/data/title\0sretrace\0" in raw


def test_a_tiff_has_its_resolution_for_any_reader(pair, tmp_path):
    path = scans.save_images(tmp_path / "a.tif", pair)
    with Pillow.open(path) as shown:
        assert shown.n_frames == 2
        assert shown.size == (32, 24)
        assert shown.tag_v2[296] == 3  # per centimetre
        assert float(shown.tag_v2[282]) == pytest.approx(1e4 / 0.25)
        assert float(shown.tag_v2[283]) == pytest.approx(1e4 / (5 / 24), rel=1e-6)
        assert np.allclose(np.asarray(shown)[0], pair[0].data[-1])


def test_a_nexus_file_leads_to_its_image_and_axes(pair, tmp_path):
    """By the attributes that a reader of NeXus follows: default, signal, axes; region and calibration of the scan."""
    scan = scans.raster(width=8.0, height=5.0, lines=24, rate=40.0)
    with h5py.File(scans.save_images(tmp_path / "a.nxs", pair, scan=scan)) as file:
        entry = file[file.attrs["default"]]
        assert entry["definition"].asstr()[()] == "NXspm"
        data = entry[entry.attrs["default"]]
        assert data.attrs["NX_class"] == "NXdata"
        signal = data[data.attrs["signal"]]
        y, x = (data[name] for name in data.attrs["axes"])
        assert signal.shape == (y.size, x.size) == (24, 32)
        assert x.attrs["units"] == "um"
        assert (x[0], y[-1]) == pytest.approx((1.125, 2.5 + 5 / 48))
        control = entry["experiment_instrument/scan_environment/scan_control"]
        assert control["scan_region/scan_range_x"][()] == 8.0
        assert control["scan_type"].asstr()[()] == "mesh"
        found = entry["experiment_instrument/piezo_sensor/piezo_configuration/calibration/range_x"]
        assert found[()] == pytest.approx(scan.x.peak_to_peak)


def test_a_tiff_of_others_is_read_by_its_resolution(tmp_path):
    tifffile.imwrite(tmp_path / "b.tif", np.eye(4, dtype=np.uint8), resolution=(20_000, 10_000), resolutionunit=3)
    (one,) = scans.read_images(tmp_path / "b.tif")
    assert one.size == pytest.approx((2.0, 4.0))
    assert one.data[0].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_tiff_whose_least_is_white_is_inverted(dtype, tmp_path):
    """Cameras and scanners write such ones: they were read as they stand, the pits as hills."""
    tifffile.imwrite(tmp_path / "w.tif", np.arange(6, dtype=dtype).reshape(2, 3), photometric="miniswhite")
    (one,) = scans.read_images(tmp_path / "w.tif")
    white = 0 if dtype is np.float32 else np.iinfo(dtype).max
    assert one.data[::-1].ravel().tolist() == [white - k for k in range(6)]


def test_the_numbers_of_a_palette_are_its_greys(tmp_path):
    data, grey = np.array([[0, 1], [2, 1]], dtype=np.uint8), np.zeros((3, 256), dtype=np.uint16)
    grey[:, :3] = [500, 100, 300]
    tifffile.imwrite(tmp_path / "p.tif", data, photometric="palette", colormap=grey)
    assert scans.read_images(tmp_path / "p.tif")[0].data[::-1].tolist() == [[500, 100], [300, 100]]
    grey[0, 2] = 7
    tifffile.imwrite(tmp_path / "p.tif", data, photometric="palette", colormap=grey)
    with pytest.raises(scans.ImageError, match="a picture in colour"):
        scans.read_images(tmp_path / "p.tif")


@pytest.mark.parametrize(("colours", "dtype"), [(3, np.uint8), (4, np.uint16)])
def test_a_grey_picture_in_colours_is_what_was_measured(colours, dtype, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    grey = np.arange(30, dtype=dtype).reshape(5, 6)
    data = np.stack([grey] * colours, axis=-1)
    extra = {"extrasamples": ("unassalpha",)} if colours == 4 else {}
    if extra:
        data[..., 3] = 255  # opacity
    tifffile.imwrite(tmp_path / "c.tif", data, photometric="rgb", **extra)
    assert scans.read_images(tmp_path / "c.tif")[0].data[::-1].tolist() == grey.tolist()
    data[0, 0, 1] = 7
    tifffile.imwrite(tmp_path / "c.tif", data, photometric="rgb", **extra)
    with pytest.raises(scans.ImageError, match=f"a picture in colour, {colours} numbers a pixel: export the signal"):
        scans.read_images(tmp_path / "c.tif")


SIGNAL = np.arange(12.0).reshape(3, 4)  # the highest y first; pixels of 0.5 x 1 um


def in_imagej(path, unit, um):
    about = {"unit": unit.replace("\u00b5", "\\u00B5"), "axes": "CYX", "Labels": ["Height", "Phase"]}
    data = np.stack([SIGNAL, 2 * SIGNAL]).astype(np.float32)
    tifffile.imwrite(path, data, imagej=True, resolution=(2.0 * um, 1.0 * um), metadata=about)


def in_ome(path, unit, um):
    about = {
        "axes": "CYX",
        "PhysicalSizeX": 0.5 / um,
        "PhysicalSizeXUnit": unit,
        "Channel": {"Name": ["Height", "Phase"]},
    }
    about |= {"PhysicalSizeY": 1000.0, "PhysicalSizeYUnit": "nm"}
    data = np.stack([SIGNAL, 2 * SIGNAL]).astype(np.uint16)
    tifffile.imwrite(path, data, ome=True, photometric="minisblack", metadata=about)


def in_gwyddion(path, unit, um):
    made = gwyfile.objects.GwyContainer()
    for i, name in enumerate(["Height", "Phase"]):
        of = {
            "si_unit_xy": gwyfile.objects.GwySIUnit(unitstr=unit),
            "si_unit_z": gwyfile.objects.GwySIUnit(unitstr="V"),
        }
        made[f"/{i}/data"] = gwyfile.objects.GwyDataField((i + 1) * SIGNAL, xreal=2.0 / um, yreal=3.0 / um, **of)
        made[f"/{i}/data/title"] = name
    made.tofile(str(path))


def in_nexus(path, unit, um):
    """Both axes downwards, so that the first pixel has the highest places."""
    with h5py.File(path, "w") as file:
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = "NXentry"
        data = entry.create_group("data")
        data.attrs.update(
            {"NX_class": "NXdata", "signal": "Height", "auxiliary_signals": ["Phase"], "axes": ["y", "x"]}
        )
        data["Height"], data["Phase"] = SIGNAL[:, ::-1], 2 * SIGNAL[:, ::-1]
        for axis, places in {"x": [1.75, 1.25, 0.75, 0.25], "y": [2.5, 1.5, 0.5]}.items():
            data[axis] = np.array(places) / um
            data[axis].attrs["units"] = unit


@pytest.mark.parametrize(("unit", "um"), [("nm", 1e-3), ("um", 1.0), ("\u00b5m", 1.0), ("mm", 1e3), ("m", 1e6)])
@pytest.mark.parametrize("writes", [in_imagej, in_ome, in_gwyddion, in_nexus])
def test_files_of_others_have_their_places_in_any_unit_and_their_names(writes, unit, um, tmp_path):
    """What ImageJ, OME, Gwyddion and NeXus write of two channels whose pixels are no squares."""
    path = tmp_path / {"in_gwyddion": "a.gwy", "in_nexus": "a.nxs"}.get(writes.__name__, "a.tif")
    writes(path, unit, um)
    height, phase = scans.read_images(path)
    assert ("Height" in height.name, "Phase" in phase.name) == (True, True)
    for image, times in ((height, 1), (phase, 2)):
        assert image.size == pytest.approx((2.0, 3.0), rel=1e-6)
        assert np.array_equal(image.data, times * SIGNAL[::-1])


@pytest.mark.parametrize("ending", [".gwy", ".nxs", ".tif"])
@pytest.mark.parametrize("shape", [(1, 4), (4, 1)])
def test_a_row_or_column_alone_keeps_its_size_and_images_their_names_and_order(ending, shape, tmp_path):
    """A .nxs took a row for 1 um high, and had the tenth image behind the first; a .gwy kept one of a name alone."""
    about = {"size": (3.3, 0.7), "origin": (-1.5, 2.5)}
    made = [scans.Image(data=np.full(shape, float(i)), name="same" if i < 2 else "z", **about) for i in range(11)]
    for i, image in enumerate(scans.read_images(scans.save_images(tmp_path / f"a{ending}", made))):
        assert (image.name, image.data[0, 0]) == (made[i].name, i)
        assert image.size == pytest.approx(about["size"])
        assert image.origin == pytest.approx(about["origin"])
    assert i == 10


def test_a_gsf_has_any_name_and_small_letters(tmp_path):
    image = scans.Image(data=np.eye(2), size=(1.0, 1.0), name="bias = 3 V\nfwd", unit="pm")
    (back,) = scans.read_images(scans.save_images(tmp_path / "a.gsf", image))
    assert back.name == "bias : 3 V fwd"
    assert back.data.max() == pytest.approx(1e-3), "nm"
    with pytest.raises(SettingError, match="in small letters"):
        scans.save_images(tmp_path / "a.GSF", image)


def test_a_nexus_of_others_has_bytes_and_edges_and_even_axes(tmp_path):
    def written(**axes):
        in_nexus(tmp_path / "a.nxs", "um", 1.0)
        with h5py.File(tmp_path / "a.nxs", "r+") as file:
            data = file["entry/data"]
            for place, kind in ((file["entry"], b"NXentry"), (data, b"NXdata")):
                place.attrs["NX_class"] = np.bytes_(kind)
            data.attrs["signal"], data.attrs["axes"] = np.bytes_(b"Height"), np.array([b"y", b"x"])
            for axis, places in axes.items():
                del data[axis]
                data[axis] = places
        return scans.read_images(tmp_path / "a.nxs")[0]

    assert written(x=[2.0, 1.5, 1.0, 0.5, 0.0]).size == pytest.approx((2.0, 3.0))
    for places, words in (([0.0, 1.0, 3.0, 7.0], "are not even"), ([0.0, 1.0], "2 places for 4 pixels")):
        with pytest.raises(scans.ImageError, match=words):
            written(x=places)


def test_a_tiff_without_a_resolution_or_of_complex_numbers_is_said(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.ones((2, 3), np.uint16), resolution=(0, 0), resolutionunit="CENTIMETER")
    assert scans.read_images(tmp_path / "a.tif")[0].size == (3.0, 2.0)
    tifffile.imwrite(tmp_path / "a.tif", np.ones((2, 3), np.complex64))
    with pytest.raises(scans.ImageError, match="complex numbers"):
        scans.read_images(tmp_path / "a.tif")


def test_a_place_in_no_length_is_named(tmp_path):
    in_gwyddion(tmp_path / "a.gwy", "1/m", 1.0)
    with pytest.raises(scans.ImageError, match="places in '1/m', which must be one of pm, nm, um"):
        scans.read_images(tmp_path / "a.gwy")


def test_files_that_are_none_are_named(pair, tmp_path):
    with pytest.raises(SettingError, match=r"a\.bmp: must be a file that ends with \.gsf"):
        scans.save_images(tmp_path / "a.bmp", pair)
    with pytest.raises(SettingError, match=r"2 images: must be one"):
        scans.save_images(tmp_path / "a.gsf", pair)
    for ending in ("gsf", "gwy", "tif", "nxs"):
        (tmp_path / f"bad.{ending}").write_bytes(b"no image at all")
        with pytest.raises(scans.ImageError, match=r"damaged, or no image \(.+\): copy it again, or export it"):
            scans.read_images(tmp_path / f"bad.{ending}")
        with pytest.raises(FileExistsError, match="not an image that truestroke wrote"):
            scans.save_images(tmp_path / f"bad.{ending}", pair[:1])
    with pytest.raises(FileNotFoundError):
        scans.read_images(tmp_path / "none.gsf")


def test_a_package_that_is_missing_is_named(pair, tmp_path, monkeypatch):
    for module in ("skimage.registration", "tifffile"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(scans.ImageError, match=r'needs the package scikit-image: pip install "truestroke\[scan\]"'):
        scans.shift(*pair)
    with pytest.raises(scans.ImageError, match="need the package tifffile: pip install"):
        scans.save_images(tmp_path / "a.tif", pair)
    assert not (tmp_path / "a.tif").exists()


def test_scans_need_numpy_alone_until_an_image_is_made():
    code = (
        "import truestroke, sys, json; truestroke.scans.raster(lines=4, rate=40.0); print(json.dumps([*sys.modules]))"
    )
    loaded = json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
    assert {"scipy", "h5py", "matplotlib", "skimage", "tifffile"}.isdisjoint(loaded)


# ---- Rates between the resonances ----------------------------------------------------------------------------------


@given(
    rate=st.floats(2.0, 50.0),
    resonances=st.lists(st.floats(100.0, 2000.0), min_size=1, max_size=3),
    sample_rate=st.sampled_from([1000.0, 5000.0, 50_000.0]),
)
def test_no_rate_within_reach_keeps_its_harmonics_further_from_the_resonances(rate, resonances, sample_rate):
    found = scans.quiet_rate(rate, resonances, sample_rate)
    assert abs(sample_rate / found - round(sample_rate / found)) < 1e-9
    assert abs(found / rate - 1) <= 0.0601

    def nearest(one):
        harmonics = one * np.arange(1, 3000 / one)
        return min(np.abs(harmonics - f).min() for f in resonances) / one

    ticks = sample_rate / rate
    others = [sample_rate / n for n in range(1, int(1.1 * ticks) + 2) if abs(ticks / n - 1) < 0.0599]
    assert all(nearest(found) >= nearest(one) - 1e-9 for one in others)


def test_the_verdict_names_a_rate_where_a_harmonic_meets_a_resonance():
    scan = scans.raster(width=10.0, lines=16, rate=40.0, sample_rate=5000.0)
    off = scan.x.position + 2.0 * np.sin(2 * np.pi * 600.0 * scan.time)
    known = {"x": 600.0, "y": 500.0}
    cut = scans.recorded(scan, *(one[:5000] for one in (scan.x.position, scan.y.position, off)), resonances=known)
    assert [one[:14] for one in cut.verdict.reasons] == ["The scan ended"]
    for x, resonances, named in (
        (off, known, True),
        (off, {"x": 620.0, "y": 500.0}, False),  # between two harmonics
        (off, None, False),
        (scan.x.position, known, False),  # good
        (scan.x.position + 2.0, known, False),  # off, but by no harmonic
        (off + 4.0, known, False),  # and by one that is the smaller part
        (np.where(np.arange(off.size) % 50, off, np.nan), known, True),  # samples that were lost
    ):
        found = scans.recorded(scan, x, scan.y.position, x, columns=32, resonances=resonances)
        said = " ".join(found.verdict.reasons)
        assert (
            "At 40 rows a second harmonic 15 meets the resonance of x, 600 Hz, which may be why: at 39.3" in said
        ) == named


def test_turns_and_sweeps_have_harmonics_and_constant_linear_velocity_has_none():
    for scan, said in (
        (
            scans.spiral(turns=8, rotation=100.0),
            "At 100 turns a second harmonic 9 meets the resonance of x, 900 Hz, and h",
        ),
        (
            scans.lissajous(lobes=64, rate=100.0),
            "At 100 lines a second harmonic 9 meets the resonance of x, 900 Hz, and h",
        ),
        (scans.spiral(turns=8, rotation=100.0, velocity="linear"), ""),
        (scans.spiral(turns=8, rotation=20.0), ""),  # harmonic 45 has no power
    ):
        found = rates.advice(scan, {"x": 900.0, "y": 700.0})
        assert found.startswith(said)
        assert bool(found) == bool(said)
    assert rates.advice(scan, {}) == ""


def test_the_other_rate_keeps_away_from_what_its_own_harmonics_reach():
    """1210 Hz is beyond harmonic 30 of 40 Hz, but what is said of the other rate has to be true of it, too."""
    scan = scans.raster(lines=4, rate=40.0, sample_rate=5000.0)
    said = rates.advice(scan, {"x": 600.0, "y": 1180.0})
    other, away = (float(re.search(words, said)[1]) for words in (r"at ([\d.]+) rows", r"within ([\d.]+) Hz"))
    harmonics = other * np.arange(1, 31)
    assert min(np.abs(harmonics - one).min() for one in (600.0, 1180.0)) >= away
    alone = rates.advice(scan, {"x": 600.0, "y": 1210.0})
    assert alone == "" or "harmonic up to 30" in alone


@pytest.mark.parametrize(
    ("resonances", "words"),
    [
        ({"x": -600.0}, r"resonances\['x'\] = -600.0 Hz"),
        ({"x": "fast"}, r"resonances\['x'\] = 'fast'"),
        ([600.0], r"resonances = .* must be frequencies by the names of axes"),
    ],
)
def test_resonances_that_are_none_are_named(resonances, words):
    scan = scans.raster(lines=4, rate=40.0, sample_rate=5000.0)
    with pytest.raises(SettingError, match=words):
        scans.recorded(scan, scan.x.position, scan.y.position, scan.x.position, columns=32, resonances=resonances)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: scans.spiral(diameter=1.0, pitch=20.0, rotation=100.0),
            "pitch = 20.0 um: must be at most half of the",
        ),
        (lambda: scans.images(SMALL, np.zeros(len(SMALL.x)), unit=5), "unit = 5: must be a text"),
        (lambda: scans.distortion(SMALL, SMALL.x.position, SMALL.y.position, "64"), "columns = '64': must be a number"),
        (lambda: scans.Image(data=np.zeros(4), size=(1.0, 1.0)), r"shape \(4,\): must be a table of numbers"),
    ],
)
def test_what_is_no_unit_pitch_table_or_number_of_columns_is_named(call, words):
    with pytest.raises(SettingError, match=words):
        call()


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"rate": 0.0}, "rate = 0.0 Hz"),
        ({"resonances": [0.0]}, "resonances = 0.0 Hz"),
        ({"rate": 900.0}, "rate = 900.0 Hz: must be within 0.06 of one whose period is a whole number of ticks"),
        ({"reach": 1.0}, "reach = 1.0"),
        ({"resonances": []}, r"resonances = \(\) Hz: must be at least one number"),
        ({"resonances": 900.0}, "resonances = .* must be a sequence of numbers"),
        ({"resonances": {"x": 900.0}}, "resonances = .* must be a sequence of numbers, without names"),
    ],
)
def test_a_rate_that_cannot_be_is_named(given_, words):
    with pytest.raises(SettingError, match=words):
        scans.quiet_rate(**{"rate": 40.0, "resonances": [600.0], "sample_rate": 2000.0, **given_})


def test_a_resonance_beyond_the_harmonics_of_another_rate_is_no_error():
    """150 Hz is the 30th harmonic of 5 rows a second, and beyond the 30th of 4.9."""
    from truestroke.signals.scans import rates

    scan = scans.raster(lines=4, rate=5.0, sample_rate=2000.0)
    words = rates.advice(scan, {"x": 150.0})
    assert words.startswith("At 5 rows a second harmonic 30 meets the resonance of x, 150 Hz")


def test_an_error_of_fast_lines_is_not_taken_for_noise():
    """20 ticks a row: 0.8 um that repeat in each row were within the noise, whose rms is 13 nm."""
    scan = scans.raster(width=6.0, lines=64, rate=100.0, sample_rate=2000.0)
    phase = 2 * np.pi * 100.0 * scan.time
    off = 0.8 * np.sin(phase) + 0.4 * np.sin(3 * phase + 1.0) + 0.2 * np.sin(8 * phase)
    x, y = (axis.position + np.random.default_rng(k).normal(0.0, 0.013, off.size) for k, axis in enumerate(scan.axes))
    found = scans.recorded(scan, x + off, y, np.sin(x), columns=7)
    assert found.noise == pytest.approx((0.013, 0.013), rel=0.15)
    assert found.rms_um()[0] == pytest.approx(np.sqrt(np.mean(off[scan.inside] ** 2)), rel=0.01)
    assert found.rms_um()[1] < 0.004
    x[::2] = np.nan
    assert scans.recorded(scan, x + off, y, np.sin(y), columns=7).rms_um()[0] > 0.5


@pytest.mark.parametrize("sample", [scans.Texture(), scans.Grating()], ids=["texture", "grating"])
@pytest.mark.parametrize(("x", "y"), [(np.zeros(2), np.zeros(3)), ("here", 1.0)])
def test_places_of_a_sample_that_do_not_fit_are_named(sample, x, y):
    with pytest.raises(SettingError, match=r"^x and y = (array of shape \(2,\) and .*\(3,\)|'here' and 1.0)"):
        sample(x, y)


def test_a_sample_takes_lists_and_one_place_beside_many():
    texture, grating = scans.Texture(), scans.Grating()
    for sample in (texture, grating):
        np.testing.assert_array_equal(sample([0.2, 3.1], 1.0), sample(np.array([0.2, 3.1]), np.array([1.0, 1.0])))
