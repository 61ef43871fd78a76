"""`truestroke scan --config FILE`: two axes, an image from a further input, on a fake card and on simulated stages."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import truestroke
from truestroke import SettingError, scans
from truestroke.cli import main
from truestroke.cli.scan import _modes, _resonances
from truestroke.report import scan as scan_page
from truestroke.report.scan import rows as scan_rows
from truestroke.runtime.drivers.nidaqmx import AnalogSignal, NidaqmxDriver, NidaqmxSettings
from truestroke.runtime.drivers.simulated import SampleSettings, SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import config

if TYPE_CHECKING:
    from card import Card

pytest_plugins = ["card"]

AXES = """
[[axis]]
name = "x"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 4000.0

[[axis]]
name = "y"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 4000.0

[coupled]

[realtime]
overrun_streak = 0
watchdog_timeout = 9.0

[recording]
file = "scan.h5"
"""
NI = """
[driver]
name = "nidaqmx"
outputs = ["Dev1/ao0", "Dev1/ao1"]
inputs = ["Dev1/ai0", "Dev1/ai1"]
um_per_volt = 10.0
signals = [{name = "height", input = "Dev1/ai4", per_volt = 50.0, offset = 3.0, unit = "nm"}]

[scan]
width = 6.0
height = 3.0
lines = 12
rate = 10.0
turn = 0.4
over_scan = 0.05
offset = [8.0, 6.0]
columns = 48
"""
SIMULATED = """
[driver]
name = "simulated"
channels = 2
axes = {stages = [{resonances = [900.0]}, {resonances = [600.0]}], coupling = [[0.0, 0.03], [0.03, 0.0]]}
signals = [{name = "height", sample = "grating"}]

[scan]
width = 6.0
lines = 8
rate = 20.0
turn = 0.3
offset = [8.0, 8.0]
lead_in = 6
ramp = 0.2
"""


def sample(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """SAMPLE of the fake card, V."""
    return np.sin(2 * np.pi * x / 3) * np.cos(2 * np.pi * y / 4) + 0.1 * x


# ---- The whole command ---------------------------------------------------------------------------------------------


def test_the_card_images_its_sample(card: Card, tmp_path: Path) -> None:
    """Each pixel shows what is at its place, in trace and retrace; the terminals are safe at the end."""
    (tmp_path / "scan.toml").write_text(NI + AXES + "[live]\nport = 0\n")
    options = ["--json", "--images", "nxs", "--images", "gsf", "--live"]
    command = [Path(sys.executable).with_name("truestroke"), "scan", "--config", "scan.toml", *options]
    environment = os.environ | card.environment()
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "live page  http://127.0.0.1:" in done.stderr
    found = json.loads(done.stdout)
    assert (found["verdict"], found["rows"], found["all_rows"]) == ("good", 12, 12)
    assert card.volts[:2] == [0.0, 0.0]
    assert card.tasks == 0
    every = {image.name: image for image in scans.read_images(tmp_path / "scan.nxs")}
    x, y = (low + (np.arange(n) + 0.5) * size / n for low, n, size in ((5.0, 48, 6.0), (4.5, 12, 3.0)))
    there = 50.0 * sample(*np.meshgrid(x, y)) + 3.0  # nm
    for name in ("height, trace", "height, retrace"):
        shown = every[name]
        assert (shown.size, shown.origin, shown.unit) == ((6.0, 3.0), (5.0, 4.5), "nm")
        assert np.abs(shown.data - there).max() < 10.0  # of 200: 0.1 um beside its place, where it is steepest
        assert np.sqrt(np.mean((shown.data - there) ** 2)) < 3.0
    assert np.allclose(scans.read_images(tmp_path / "scan-height-trace.gsf")[0].data, every["height, trace"].data)
    with h5py.File(tmp_path / "scan-x.h5") as file:
        assert (file["height"].attrs["unit"], "Dev1/ai4" in file["height"].attrs["description"]) == ("nm", True)
    run = truestroke.Recording.load(tmp_path / "scan-x.h5")
    assert run["height"].size == run["measured"].size
    assert np.isfinite(run["height"]).sum() == np.isfinite(run["measured"]).sum()
    assert (tmp_path / "scan.html").read_text().count("<svg") == 8  # four, and as a phone shows them


@pytest.mark.usefixtures("each_picture_once", "forked_helpers")
def test_a_scan_that_is_cut_short_keeps_its_rows(tmp_path, monkeypatch) -> None:
    """The rows that are complete are an image, the recording is there, and the exit code is that of the fault."""
    monkeypatch.chdir(tmp_path)
    fault = "axes = {", 'faults = [{kind = "error", at = 1010}]\naxes = {'
    check = "overrun_streak = 0", "overrun_streak = 0\naxis_check = false"
    ending = "scan.h5", "scan.hdf5"
    Path("scan.toml").write_text((SIMULATED + AXES).replace(*fault).replace(*check).replace(*ending))
    done = CliRunner().invoke(main, ["scan", "--config", "scan.toml", "--json"])
    assert done.exit_code == 12, done.output
    found = json.loads(done.stdout)
    assert (found["rows"], found["all_rows"], found["verdict"]) == (4, 8, "bad")
    assert "The scan ended after row 4 of 8" in " ".join(found["reasons"])
    (image,) = scans.read_images("scan-height-retrace.gsf")
    assert image.data.shape[0] == 4
    assert image.size == (6.0, 3.0)
    assert truestroke.Recording.load("scan-y.hdf5")["measured"].size == 1010
    again = CliRunner().invoke(main, ["scan", "--config", "scan.toml"])
    assert (again.exit_code, "a recording is there" in again.output) == (1, True)


def test_an_axis_that_the_scan_does_not_move_rests(tmp_path: Path) -> None:
    stages = "{resonances = [600.0]}], coupling = [[0.0, 0.03], [0.03, 0.0]]", "{resonances = [600.0]}, {}]"
    three = SIMULATED.replace("channels = 2", "channels = 3").replace(*stages)
    third = '[[axis]]\nname = "z"\nstroke = 30.0\nvoltage_limits = [-0.6, 3.6]\nslew = 4000.0\n'
    third += "resonance = 400.0\n"
    (tmp_path / "scan.toml").write_text(three + AXES + third)
    job = config.load(tmp_path / "scan.toml")
    x, _, z = job.axes
    assert (z.name, len(z.trajectory)) == ("z", len(x.trajectory))
    assert "z" not in _resonances(job, job.imaging)  # no other rate of lines is named because of it
    assert _modes(job, job.imaging) == {}  # a resonance alone has no damping
    assert not np.any([z.trajectory.position, z.trajectory.velocity, z.trajectory.acceleration])


# ---- Signals of drivers --------------------------------------------------------------------------------------------


def test_a_signal_of_the_card_is_that_of_the_tick_of_its_command(card: Card) -> None:
    """The first axis moves over the sample: signal and sensor see it in the same tick, and in no other."""
    height = AnalogSignal(name="height", input="Dev1/ai4", per_volt=2.0, offset=-1.0)
    axes = {"outputs": ("Dev1/ao0", "Dev1/ao1"), "inputs": ("Dev1/ai0", "Dev1/ai1"), "um_per_volt": 10.0}
    driver = NidaqmxDriver(NidaqmxSettings(**axes, signals=(height,)))
    driver.open()
    driver.start(np.zeros(2))
    volts = np.zeros((2, 600))
    volts[0] = 0.05 + 0.03 * np.repeat(np.random.default_rng(3).uniform(-1.0, 1.0, 120), 5)
    measured, seen, part = [], [], np.empty((2, 20))
    for k in range(0, 600, 20):
        driver.exchange(np.ascontiguousarray(volts[:, k : k + 20]), part)
        measured.append(part.copy())
        seen.append(driver.readings.copy())
    driver.stop(np.zeros(2))
    (x, y), (signal,) = np.concatenate(measured, axis=1), np.concatenate(seen, axis=1)
    assert [(one.name, one.unit) for one in driver.signals] == [("height", "V")]
    expected = 2.0 * sample(x, y) - 1.0
    assert np.abs(signal - expected)[60:].max() < 0.5  # V; noise of the sensors
    steps = [np.diff(one[60:]) for one in (expected, signal)]
    alike = {lag: float(np.corrcoef(steps[0][5:-5], np.roll(steps[1], lag)[5:-5])[0, 1]) for lag in range(-3, 4)}
    assert max(alike, key=alike.__getitem__) == 0
    assert alike[0] > 0.9


def test_a_simulated_sample_is_read_where_it_truly_is() -> None:
    settings = SimulatedSettings(
        sample_rate=5000.0, block=4, latency=4, channels=2, axes={}, signals=(SampleSettings(sample="grating"),)
    )
    driver = SimulatedDriver(settings)
    driver.open()
    driver.start(np.zeros(2))
    measured, grating = np.empty((2, 4)), scans.Grating()
    seen = []
    for k in range(200):
        driver.exchange(np.full((2, 4), 0.015 * k), measured)
        assert np.array_equal(driver.readings[0], grating(*driver.truth), equal_nan=True)
        seen.append(driver.readings[0])
    assert np.isnan(seen[0]).all()  # of no command
    assert np.ptp(np.concatenate(seen[1:])) == pytest.approx(100.0, abs=1.0)
    driver.close()


@pytest.mark.parametrize(("stroke", "width"), [(0.5, 0.1), (1000.0, 400.0)])
def test_a_simulated_sample_is_as_large_as_the_stage(stroke: float, width: float) -> None:
    """A texture that repeated after 40 um showed the lines of a stage of 1 mm 7 pixels apart: the scan was bad."""
    stage = {"stroke": stroke, "noise": 1e-5}
    settings = SimulatedSettings(
        channels=2,
        axes={"stages": [stage, stage]},
        signals=(SampleSettings(), SampleSettings(sample="grating", name="g")),
    )
    texture, grating = SimulatedDriver(settings)._samples
    x, y = (one.ravel() for one in np.meshgrid(np.linspace(0.0, width, 35), np.linspace(0.0, width, 64)))
    seen = texture(x, y).reshape(64, 35)
    assert max(np.corrcoef(seen[:, k:].ravel(), seen[:, :-k].ravel())[0, 1] for k in range(5, 28)) < 0.5
    assert np.count_nonzero(np.diff(grating(np.linspace(0.0, width, 999), np.zeros(999)) > 50.0)) in range(2, 10)


# ---- What does not fit ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('sample = "grating"', 'sample = "gratin"'), "sample = 'gratin': must be 'texture' or 'grating'"),
        (('signals = [{name = "height", sample = "grating"}]', ""), "signal = missing: must be one that the driver re"),
        (("rate = 20.0", 'rate = 20.0\nsignal = "topography"'), "scan.signal = 'topography': must be one of height"),
        (("rate = 20.0", "rate = 20.0\nsample_rate = 4000.0"), "scan.sample_rate = 4000.0 Hz: must be 2000 Hz, that"),
        (("rate = 20.0", 'rate = 20.0\naxes = ["x", "z"]'), "scan.axes = ['x', 'z']: must be two of the axes: x, y"),
        (("offset = [8.0, 8.0]", "offset = 8"), "scan.offset = 8: must be a list, in brackets: [...]"),
        (("rate = 20.0", "raet = 20.0"), "scan.raet = 20.0: must be left out; did you mean rate"),
        (("rate = 20.0", "rate = 20.0\ncolums = 64"), "scan.colums = 64: must be left out; did you mean columns"),
        (("lines = 8", 'kind = "zigzag"'), "scan.kind = 'zigzag': must be one of raster, spiral, lissajous, cycloid"),
        (('name = "y"', 'name = "y"\ntrajectory = {kind = "sine"}'), "must be left out: [scan] moves this axis"),
        (('name = "y"', 'name = "y"\nsample_rate = 5000.0'), "2: sample_rate = 5000.0: must be in [driver]: all axes"),
        (
            ('name = "height"', 'name = "measured"'),
            "name = 'measured': must be letters, digits, - and _, and no ",
        ),
        (
            ("rate = 20.0", "rate = 20.0\nsettle = 0.2"),
            "settle = 0.2: must be dynamics of the slow axis, a file of tru",
        ),
        (
            ("turn = 0.3", "turn = 0.98"),
            "scan.rate = 20.0 Hz: must be so low that the ticks of a line at 2000 Hz fill 2",
        ),
    ],
    ids=lambda value: value[1][:24] if isinstance(value, tuple) else "",
)
def test_a_configuration_that_does_not_fit_is_named(tmp_path, change, words) -> None:
    text = SIMULATED + AXES
    assert change[0] in text
    (tmp_path / "scan.toml").write_text(text.replace(*change))
    with pytest.raises(SettingError) as refused:
        config.load(tmp_path / "scan.toml")
    assert words in str(refused.value)
    assert not list(tmp_path.glob("*.h5"))


FAST = """
[driver]
name = "simulated"
sample_rate = 10000.0
channels = 2
signals = [{name = "height", sample = "texture"}]

[scan]
width = 10.0
lines = 8
rate = 200.0
"""


@pytest.mark.parametrize(
    ("kind", "rate", "bound"),
    [
        ("raster", 200.0, ""),
        ("raster", 300.0, ""),
        ("raster", 301.0, "scan.rate = 301.0 Hz: must be at most 300 Hz, a third of the first resonance of axis x"),
        ("raster", 900.0, "scan.rate = 900.0 Hz: must be at most 625 Hz, for 16 ticks of 10000 Hz a period"),
        ("lissajous", 340.0, ""),
        ("lissajous", 360.0, "scan.rate = 360.0 Hz: must be at most 350 Hz, a half of the first resonance of axis y"),
        ("spiral", 350.0, ""),
        ("spiral", 360.0, "scan.rotation = 360.0 Hz: must be at most 350 Hz, a half of the first resonance of axis y,"),
        ("linear", 170.0, ""),
        ("linear", 180.0, "scan.fastest = 360.0 Hz: must be at most 350 Hz, a half of the first resonance of axis y,"),
        ("cycloid", 360.0, "scan.rate = 360.0 Hz: must be at most 350 Hz, a half of the first resonance of axis y,"),
    ],
)
def test_lines_that_ticks_or_stage_cannot_follow_are_refused(tmp_path, kind, rate, bound) -> None:
    """900 rows a second at 5 kHz were 174 um beside a stroke of 30 um, and only the verdict said so."""
    text = FAST + AXES
    for resonance in (900.0, 700.0):  # axis x, then y
        text = text.replace("slew = 4000.0", f"slew = 4e4\nresonance = {resonance}", 1)
    turned = {"spiral": "", "linear": 'velocity = "linear"'}
    words = f'kind = "{"spiral" if kind in turned else kind}"\n'
    words += f"rotation = {rate}\n{turned[kind]}" if kind in turned else f"rate = {rate}"
    text = text.replace("rate = 200.0", words)
    if kind != "raster":
        text = text.replace("lines = 8", "").replace("width = 10.0", "diameter = 10.0" if kind in turned else "")
    (tmp_path / "scan.toml").write_text(text)
    if not bound:
        assert config.load(tmp_path / "scan.toml").imaging is not None
        return
    with pytest.raises(SettingError) as refused:
        config.load(tmp_path / "scan.toml")
    assert bound in str(refused.value)


def test_the_turns_in_the_middle_of_a_spiral_have_ticks_enough(tmp_path) -> None:
    """At constant linear velocity they are the fastest: 2000 a second had five ticks each, and nothing said so."""
    linear = 'kind = "spiral"\nrotation = 100.0\nvelocity = "linear"\nfastest = 2000.0'
    text = FAST.replace("rate = 200.0", linear).replace("lines = 8\n", "").replace("width = 10.0", "") + AXES
    (tmp_path / "scan.toml").write_text(text.replace("slew = 4000.0", "slew = 4e5"))
    with pytest.raises(SettingError) as refused:
        config.load(tmp_path / "scan.toml")
    assert "scan.fastest = 2000.0 Hz: must be at most 625 Hz, for 16 ticks of 10000 Hz" in str(refused.value)
    assert "give `fastest`, for the turns in the middle" in str(refused.value)


def test_a_resonance_counts_beside_a_law_that_has_none(tmp_path) -> None:
    """Of axes that the paper's law moves it was not looked at: 400 rows a second on 900 Hz began."""
    axes = AXES.replace("slew = 4000.0", 'slew = 4e4\nresonance = 900.0\ncontroller = "paper"')
    text = FAST.replace("rate = 200.0", "rate = 400.0") + axes.replace("[coupled]", "")
    (tmp_path / "scan.toml").write_text(text)
    with pytest.raises(SettingError, match="at most 300 Hz, a third of the first resonance of axis x, 900 Hz"):
        config.load(tmp_path / "scan.toml")


def test_a_single_axis_is_asked_for_a_second(tmp_path) -> None:
    """It was `must be two of the axes: x`."""
    (tmp_path / "scan.toml").write_text(SIMULATED + "[[axis]]".join(AXES.split("[[axis]]")[:2]))
    with pytest.raises(SettingError, match=r"scan.axes = \['x'\]: must be two axes, .* add a second table"):
        config.load(tmp_path / "scan.toml")


def test_a_motion_that_is_refused_is_not_recorded_to_a_file_beside(tmp_path, monkeypatch) -> None:
    """A line said where the recording goes, and how long it takes, before the motion was refused."""
    monkeypatch.chdir(tmp_path)
    Path("scan.toml").write_text((SIMULATED + AXES).replace("width = 6.0", "width = 40.0"))
    Path("scan-x.h5").write_bytes(b"")
    done = CliRunner().invoke(main, ["scan", "--config", "scan.toml", "--overwrite"])
    assert done.exit_code == 2
    assert "must be within the stroke, 30 um" in done.stderr
    assert "recording to" not in done.stderr


@pytest.mark.parametrize(("asked", "said"), [("\ncolumns = 333", True), ("\ncolumns = 20", False), ("", False)])
def test_columns_that_the_ticks_do_not_fill_are_named(tmp_path, asked, said) -> None:
    (tmp_path / "scan.toml").write_text((SIMULATED + AXES).replace("lines = 8", f"lines = 8{asked}"))
    found = config.load(tmp_path / "scan.toml").imaging
    words = f"The image has {found.columns} columns, not 333: that is what the ticks of a line fill."
    assert found.notice.startswith(words) if said else not found.notice
    assert found.columns == 20 or 30 <= found.columns <= 40


def test_a_folder_of_the_recording_that_is_missing_is_named_by_its_key(tmp_path) -> None:
    """It was the option --output, which nobody had given."""
    (tmp_path / "scan.toml").write_text((SIMULATED + AXES).replace("scan.h5", "none/scan.h5"))
    done = CliRunner().invoke(main, ["scan", "--config", str(tmp_path / "scan.toml")])
    assert done.exit_code == 1
    assert "scan.toml: recording.file none/scan.h5: there is no folder none; make it" in done.stderr
    assert "--output" not in done.stderr


def test_an_image_of_another_program_is_named_before_the_scan(tmp_path, monkeypatch) -> None:
    """It was after it: the axes had moved, and there was no page."""
    monkeypatch.chdir(tmp_path)
    Path("scan.toml").write_text(SIMULATED + AXES)
    Path("scan-height-retrace.gsf").write_text("not ours")
    monkeypatch.setattr("truestroke.cli.realtime.follow", lambda *_: pytest.fail("it moved"))
    done = CliRunner().invoke(main, ["scan", "--config", "scan.toml"])
    assert done.exit_code == 1
    assert "scan-height-retrace.gsf: is there and is not an image that truestroke wrote" in done.stderr


def test_two_signals_of_one_name_are_refused() -> None:
    twice = tuple(AnalogSignal(name="height", input=f"Dev1/ai{i}") for i in (2, 3))
    with pytest.raises(SettingError, match="signals: name = height, height: must be different"):
        NidaqmxSettings(outputs=("Dev1/ao0",), inputs=("Dev1/ai0",), um_per_volt=1.0, signals=twice)
    with pytest.raises(SettingError, match=r"per_volt = 0\.0 nm/V: must be not 0"):
        AnalogSignal(name="height", input="Dev1/ai2", per_volt=0.0, unit="nm")


def test_options_of_the_simulation_do_not_go_with_a_configuration(tmp_path) -> None:
    tables = tomllib.loads(SIMULATED + AXES)
    assert "scan" in tables
    (tmp_path / "scan.toml").write_text(SIMULATED + AXES)
    done = CliRunner().invoke(main, ["scan", "--config", str(tmp_path / "scan.toml"), "--noise", "0.1"])
    assert (done.exit_code, "--noise is of the simulation" in done.output) == (2, True)
    (tmp_path / "run.toml").write_text(config.example())
    done = CliRunner().invoke(main, ["scan", "--config", str(tmp_path / "run.toml")])
    assert (done.exit_code, "has no table [scan]" in done.output) == (2, True)
    (tmp_path / "stage.toml").write_text(SIMULATED.partition("[scan]")[0] + AXES)  # as of bode and learn
    done = CliRunner().invoke(main, ["scan", "--config", str(tmp_path / "stage.toml")])
    assert (done.exit_code, "has no table [scan]" in done.output, "trajectory" in done.output) == (2, True, False)


# ---- Images of what was recorded -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def raster() -> scans.Scan:
    return scans.raster(width=10.0, lines=16, rate=40.0, lead_in=20, sample_rate=10_000.0, lead_out=0.01)


def test_a_late_stage_is_judged_by_sensors_and_by_the_image(raster) -> None:
    """0.4 ms late: 3.5 % of a line, which a microscopist would see at once."""
    texture, time = scans.Texture(seed=2), raster.time
    late = np.interp(time - 4e-4, time, raster.x.position)
    found = scans.recorded(raster, late, raster.y.position, texture(late, raster.y.position), columns=96, unit="nm")
    assert found.verdict.level == "bad"
    apart = 2 * 4e-4 * 1000.0 * 96 / 10.0  # um/s of a line of 10 um in 10 ms
    assert found.distortion.trace_retrace == pytest.approx(apart, rel=0.05)
    assert abs(found.shift[0]) == pytest.approx(apart, rel=0.1)
    assert found.rms_um()[0] == pytest.approx(0.4, rel=0.02)
    assert dict(scan_rows(found))["trace and retrace apart, by the sensors"].endswith(
        f"{found.distortion.trace_retrace:.2f} pixels"
    )


def test_the_page_says_what_each_axis_learned(raster) -> None:
    x, y = (axis.position for axis in raster.axes)
    found = scans.recorded(raster, x, y, scans.Texture(seed=2)(x, y), columns=96, unit="nm")
    learned = {"x": [0.032, 0.0106], "y": []}
    known = {name: {"period_s": 0.025, "rmse_um": errors} for name, errors in learned.items()}
    recordings = {name: truestroke.Recording({}, {"axis": {"name": name}, "repetition": known}) for name in "xy"}
    rows = dict(scan_rows(found, recordings))
    assert rows["x repeats"].endswith("period of 25 ms: 32 nm rms in the first batch, 10.6 nm in the last of 2")
    assert rows["y repeats"] == "nothing learned of the period of 25 ms: no batch of it was complete"
    page = scan_page.page(found, found.verdict, recordings=recordings)
    assert ["x repeats", rows["x repeats"]] in page.sections[0].tables[0].rows


@pytest.mark.parametrize(("height", "stacked", "shown"), [(10.0, False, 1.0), (3.0, True, 0.3), (0.2, True, 0.1)])
def test_a_flat_image_fills_its_picture_and_axes_have_their_names(height, stacked, shown) -> None:
    """Trace above retrace; a strip of 10 x 0.2 um is five times as high as it is long."""
    scan = scans.raster(width=10.0, height=height, lines=16, rate=40.0, sample_rate=5000.0)
    texture = scans.Texture(seed=2)(scan.x.position, scan.y.position)
    found = scans.recorded(scan, scan.x.position, scan.y.position, texture, columns=64, axes=("tip", "z"))
    assert ["rms error of tip, z", "within the noise, within the noise"] in scan_rows(found)
    figure = scan_page.plots(found)["image"]
    figure.draw_without_rendering()
    first, second, _ = (one.get_position() for one in figure.axes)
    assert (first.y0 > second.y1, first.x1 < second.x0) == (stacked, not stacked)
    width, size = figure.get_size_inches()
    assert first.height * size / (first.width * width) == pytest.approx(shown, rel=0.01)
    assert first.height * size > 0.25 * (size / 2 if stacked else size)
    assert (figure.axes[1].get_xlabel(), figure.axes[0].get_ylabel()) == ("tip (µm)", "z (µm)")


def test_a_single_image_has_no_margins_and_is_shown_whole_on_a_phone() -> None:
    """Of 7 in a square image of 4.2 took the middle: a phone showed two thirds of it."""
    scan = scans.raster(width=10.0, lines=16, rate=40.0, sample_rate=5000.0)
    texture = scans.Texture(seed=2)(scan.x.position, scan.y.position)
    found = scans.recorded(scan, scan.x.position, scan.y.position, texture, columns=64)
    figure = scan_page.plots(found)["over"]
    figure.draw_without_rendering()
    assert figure.axes[0].get_position().width > 0.8
    text = scan_page.page(found, found.verdict).html()
    over, image = (re.search(rf"<svg[^>]*{name}-title", text)[0] for name in ("over", "image"))  # type: ignore[index]
    assert 'class="narrow" style="max-width: 71%"' in over
    assert "narrow" not in image


def test_a_ramp_of_the_slow_axis_is_no_shift_of_the_retrace() -> None:
    """Half a row by which y moves on between trace and retrace, as it should: 0.54 pixels were stated, and doubted."""
    usual = {"width": 10.0, "lines": 32, "rate": 40.0, "sample_rate": 10_000.0, "offset": (14.0, 14.0)}
    for slow, late in (("ramp", 0.0), ("steps", 0.0), ("ramp", 1.0)):
        scan = scans.raster(**usual, slow=slow)
        y = scan.y.position + late * 10.0 / 32 * (np.gradient(scan.x.position) < 0)  # a retrace that is a row too high
        height = scans.Texture(seed=1)(scan.x.position + 3.0, y + 5.0)
        found = scans.recorded(scan, scan.x.position, scan.y.position, height, columns=100)
        assert found.shift == pytest.approx((0.0, -late), abs=0.08)
        assert found.verdict.level == ("doubtful" if late else "good")


def test_a_signal_that_is_noise_has_no_shift(raster) -> None:
    """An input that nobody has connected: trace and retrace have nothing in common, and none is stated."""
    noise = np.random.default_rng(5).normal(size=len(raster.x))
    found = scans.recorded(raster, *(axis.position for axis in raster.axes), noise, columns=100)
    assert (found.shift, found.verdict.level) == (None, "good")


def test_noise_of_the_sensors_is_no_distortion(raster) -> None:
    """A tenth of a pixel to one and a half, a tick: what is stated is without it; above one it may hide any error."""
    noise = np.random.default_rng(1)
    for sigma in (0.01, 0.08, 0.15):  # um; a pixel of 0.1 um
        x, y = (axis.position + noise.normal(0.0, sigma, len(raster.x)) for axis in raster.axes)
        found = scans.recorded(raster, x, y, np.sin(raster.x.position), columns=100)
        assert found.verdict.level == ("doubtful" if sigma > 0.1 else "good"), (sigma, found.verdict)
        assert (sigma > 0.1) == any(reason.startswith("A pixel of 100 x 625 nm") for reason in found.verdict.reasons)
        assert max(found.rms_um()) < 0.35 * sigma
        apart = dict(scan_rows(found))["trace and retrace apart, by the sensors"]
        assert apart.endswith(" pixels, within the noise"), (sigma, apart)


@pytest.mark.parametrize(("rows", "columns"), [(1, 50), (4, 300), (40, 100)])
def test_noise_of_few_rows_and_of_many_pixels_is_no_distortion_either(rows, columns) -> None:
    """Of a hundred scans a few are above what is said to be noise, and none is far below it."""
    scan = scans.raster(width=10.0, height=0.2 * rows, lines=rows, rate=20.0, sample_rate=20.0 * 700)
    noise, found = np.random.default_rng(2), []
    for _ in range(100):
        x = scan.x.position + noise.normal(0.0, 0.01, len(scan.x))
        found.append(scans.distortion(scan, x, scan.y.position, columns))
    said = found[0].apart_by_noise((0.01, 0.0))
    apart = np.array([one.trace_retrace for one in found])
    assert np.mean(apart > said) <= 0.08
    assert np.median(apart) > 0.6 * said


def test_lost_samples_and_recordings_of_another_scan(raster) -> None:
    x, y = (axis.position.copy() for axis in raster.axes)
    signal = np.sin(x)
    signal[5010:5050] = x[5010:5050] = np.nan
    found = scans.recorded(raster, x, y, signal, columns=50)
    assert np.isfinite(found.images["trace"].data).all()
    lost = np.count_nonzero(raster.inside[5010:5050])
    caption = scan_page.page(found, found.verdict).sections[-2].caption
    assert f"histogram leaves these samples out. {lost} of" in caption  # turns are not missing
    line = raster.lines[3]
    gone = signal.copy()
    gone[line["first"] - 2 : line["last"] + 3] = np.nan
    with pytest.raises(truestroke.ImageError, match="line 3 of 32 has no sample: its trigger is missing"):
        scans.recorded(raster, raster.x.position, y, gone)
    with pytest.raises(truestroke.ImageError, match="it is of another scan"):
        scans.recorded(raster, np.append(x, 0.0), np.append(y, 0.0), np.append(signal, 0.0))
    with pytest.raises(truestroke.ImageError, match="before the first row is complete"):
        scans.recorded(raster, x[:5100], y[:5100], signal[:5100])


def test_a_spiral_is_an_image_by_its_measured_places() -> None:
    scan = scans.spiral(diameter=6.0, turns=30, rotation=40.0, sample_rate=5000.0, lead_out=0.02)
    assert len(scan.x) == len(scans.spiral(diameter=6.0, turns=30, rotation=40.0, sample_rate=5000.0).x) + 100
    x, y = (1.01 * axis.position for axis in scan.axes)  # not where it should be; the image is right all the same
    found = scans.recorded(scan, x, y, x - 2 * y, columns=30)
    image = found.images["image"]
    u, v = (low + (np.arange(30) + 0.5) * 0.2 for low in image.origin)
    inside = np.hypot(*np.meshgrid(u - 3.0, v - 3.0)) < 2.7
    assert np.abs(image.data - (u - 2 * v[:, None]))[inside].max() < 0.15
    assert found.rms_um()[0] > 0.02
    assert scans.recorded(scan, *(one[:4000] for one in (x, y, x)), columns=30).rows == (12, 30)
    assert "places" in scan_page.plots(found)  # whose caption says that it is not row by row


def test_pixels_of_a_scan_that_is_no_raster_are_square() -> None:
    for width, height in ((10.0, 4.0), (2.0, 5.0)):
        scan = scans.cycloid(width=width, height=height, pitch=0.2, rate=40.0, sample_rate=20_000.0)
        columns = scans.pixels_of(scan, 512)
        found = scans.recorded(scan, scan.x.position, scan.y.position, scan.x.position, columns=columns)
        assert found.images["image"].data.shape == (round(columns * height / width), columns)
        assert found.images["image"].pixel[0] == pytest.approx(0.1, rel=0.4)  # two of them between two lines


@pytest.mark.parametrize("kind", ["raster", "spiral", "lissajous", "cycloid"])
def test_what_comes_behind_the_image_does_not_change_it(kind) -> None:
    usual = {"raster": {"lines": 8}, "spiral": {"turns": 8}, "lissajous": {"lobes": 32}, "cycloid": {"pitch": 5.0}}
    make = getattr(scans, kind)
    short, long = (make(**usual[kind], sample_rate=5000.0, lead_out=after) for after in (0.0, 0.1))
    assert len(long.x) - len(short.x) == 500
    assert np.array_equal(short.lines, long.lines)
    end = int(short.lines["last"][-1]) + 1
    assert np.array_equal(short.y.position[:end], long.y.position[:end])


@pytest.mark.parametrize("kind", ["spiral", "lissajous", "cycloid"])
def test_an_image_has_as_many_pixels_as_its_samples_fill(kind) -> None:
    """All that is within the curve has a value, at slow and at fast rates; many more pixels would have gaps."""
    usual = {"spiral": {"turns": 40, "rotation": 20.0}, "lissajous": {"lobes": 40}, "cycloid": {"pitch": 1.0}}
    for rate in (2000.0, 20_000.0):
        scan = getattr(scans, kind)(**usual[kind], sample_rate=rate)
        x, y = (axis.position[scan.inside] for axis in scan.axes)
        columns = scans.pixels_of(scan, 4096)
        assert columns >= 20
        image = scans.gridded(x, y, x, origin=scan.origin, size=scan.size, shape=(columns, columns))
        u = (np.arange(columns) + 0.5) / columns - 0.5
        inside = np.hypot(*np.meshgrid(u, u)) < 0.47 if kind == "spiral" else np.abs(u) < 0.47
        kept = image.data[inside] if kind == "spiral" else image.data[np.ix_(inside, inside)]
        assert np.mean(np.isfinite(kept)) > 0.99
        finer = scans.gridded(x, y, x, origin=scan.origin, size=scan.size, shape=(6 * columns, 6 * columns))
        assert np.mean(np.isfinite(finer.data)) < 0.95
