"""The simulated XY stage that images two samples: what the page states, and that it can be bad."""

import dataclasses
import json
import math

import numpy as np
import pytest
from benchmarks.scanning import stage as sampled_stage
from click.testing import CliRunner

import truestroke
from truestroke import Mode, SettingError, scans
from truestroke.cli import main
from truestroke.plant import MultiAxisStage
from truestroke.studies.scanning import imaging, lines


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The command, once: its folder and what it printed."""
    folder = tmp_path_factory.mktemp("scan")
    found = CliRunner().invoke(main, ["scan", "--json", "--images", "nxs", "--output", str(folder / "one")])
    assert found.exit_code == 0, found.output
    return folder, json.loads(found.output)


def test_no_pixel_is_a_tenth_of_a_pixel_from_its_place(done):
    found = done[1]
    assert found["verdict"] == "good"
    one = {row["controller"]: row for row in found["controllers"]}
    assert one["truestroke"]["distortion_largest_pixels"] < 0.1
    assert one["truestroke"]["trace_retrace_pixels"] < 0.1
    assert np.hypot(*one["truestroke"]["shift_pixels"]) < 0.1
    assert one["open loop"]["trace_retrace_pixels"] > 30  # of 512: hysteresis of 13 %
    assert found["spiral_percent_of_diameter"] < 0.1


def test_the_images_show_it_too(done):
    """By the files alone, with nothing that the command knows of positions."""
    every = {image.name: image for image in scans.read_images(done[0] / "one.nxs")}
    assert len(every) == 12
    apart = {}
    for name in imaging.NAMES:
        pair = [every[f"{name}, texture, {direction}"] for direction in ("trace", "retrace")]
        assert pair[0].data.shape == (512, 512)
        apart[name] = np.hypot(*scans.shift(*pair))
    assert apart["truestroke"] < 0.05
    assert apart["open loop"] > 30
    x, y = np.meshgrid(*(low + (np.arange(512) + 0.5) * 20 / 512 for low in every["truestroke, grating, trace"].origin))
    straight = scans.Grating()(x, y)
    shown = {name: every[f"{name}, grating, trace"].data for name in imaging.NAMES}
    assert np.mean(np.abs(shown["truestroke"] - straight)) < 0.5  # nm of 100
    assert np.mean(np.abs(shown["open loop"] - straight)) > 15


def test_the_page_has_its_pictures(done):
    page = (done[0] / "one.html").read_text()
    assert page.count("<svg") == 8  # four, and as a phone shows them
    assert "A calibration grating" in page
    assert "laid over one another" in page
    assert "has had 4 s of lines before the image" in page
    assert "hysteresis of plays and Preisach, sensor noise of 1 nm" in page


def test_ctrl_c_ends_the_runs_that_nobody_waits_for(monkeypatch):
    """In the midst of the others, before any image is made of them."""
    images = []

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(imaging, "_imaged", lambda name, *_: images.append(name))
    monkeypatch.setattr(lines, "open_loop", interrupted)
    with pytest.raises(KeyboardInterrupt):
        imaging.image_stage()
    assert "truestroke" not in images  # the longest one; that of the paper may have ended before


# ---- The parts -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small():
    """A stage, and a scan of 16 rows."""
    stage = imaging.stage_of((900.0, 900.0), ("plays", "preisach"), 0.001)
    x, y = (one.dynamics() for one in stage.axes)
    usual = {"width": 20.0, "lines": 16, "height": 0.5, "rate": 40.0, "offset": (14.5, 4.0), "sample_rate": 5000.0}
    return stage, scans.raster(**usual, turn=x, settle=y, over_scan=0.01, lead_in=120, lead_rows=60)


def test_what_repeats_is_taken_away(small):
    """The same stage and controllers, with and without a period that they know."""
    stage, scan = small

    def largest(period):
        true = lines.together(scan, MultiAxisStage(stage), imaging.controllers_of(stage, period))
        return np.abs(scans.distortion(scan, *true.T).dx).max()

    assert largest(lines.period_of(scan)) < 0.1 < 0.35 * largest(None)


@pytest.mark.parametrize("repeats", [True, False])
def test_axes_together_are_as_in_a_run(small, repeats):
    """To the last bit, without a recording."""
    stage, scan = small
    period = lines.period_of(scan) if repeats else None
    true = lines.together(scan, MultiAxisStage(stage), imaging.controllers_of(stage, period))
    recording = truestroke.run(
        dict(zip("xy", scan.axes, strict=True)), imaging.controllers_of(stage, period), MultiAxisStage(stage)
    )
    for i, name in enumerate("xy"):
        np.testing.assert_array_equal(true[:, i], recording[f"true_{name}"])


def test_another_rate_is_named_for_what_is_at_a_resonance_only(small):
    """Not for noise of the sensors, of which the same image is as far off."""
    _, scan = small
    desired = np.stack([axis.position for axis in scan.axes], axis=1)
    random = np.random.default_rng(0)
    for off, named in (
        (0.01 * np.sin(2 * np.pi * 600.0 * scan.time), True),
        (0.004 * random.standard_normal(len(scan.x)), False),
        (0.01 * scan.x.position / 20.0, False),
    ):
        true = desired + off[:, None]
        moved = scans.distortion(scan, *true.T, 512)
        assert moved.largest > 0.1
        known = {name: Mode(frequency=f, damping=0.03) for name, f in (("x", 600.0), ("y", 500.0))}
        assert bool(imaging._remedy(scan, true, moved, known)) == named
        slow = known | {"y": Mode(frequency=500.0, damping=0.004)}  # 3.2 rows of 40 a second
        said = imaging._remedy(scan, true, moved, slow)
        assert ("What rings in y" in said) != named, "it is why where no harmonic is"


def test_the_last_line_is_as_the_others_and_the_first_begins_as_late_at_any_rate():
    """Of a stage whose axes disturb each other: behind the last line y steps on, as behind the others."""
    stage = imaging.stage_of((900.0, 900.0), ("plays", "preisach"), 0.001)
    for rate, lead in ((40.0, 160), (100.0, 400), (10.0, 40), (1.0, 8)):
        assert imaging.scan_of(stage, rate).settings["lead_in"] == lead
    scan = imaging.scan_of(stage, 40.0)
    period = round(5000.0 / 40.0)
    last, ahead = scan.lines["last"][-1], scan.y.position[period:] - scan.y.position[:-period]
    assert scan.x.position.size > last + 100
    assert ahead[last - period :] == pytest.approx(20.0 / 512)


def test_the_paper_alone_on_each_axis_is_its_calls(small):
    """The native loop of two axes, against each controller tick by tick."""
    stage, scan = small
    usual = {"sample_rate": 5000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
    both = [[truestroke.AdaptiveController.paper(**usual) for _ in "xy"] for _ in range(2)]
    true = lines.alone(scan, MultiAxisStage(stage), both[0])
    plant = MultiAxisStage(stage)
    plant.open()
    for k in range(2000):
        parts = [(axis.position[k], axis.velocity[k], axis.acceleration[k]) for axis in scan.axes]
        volts = np.array([[one.command(*part) for one, part in zip(both[1], parts, strict=True)]])
        measured = plant.exchange(volts)[0]
        for one, z in zip(both[1], measured, strict=True):
            one.adapt(z)
        assert np.array_equal(true[k], plant.truth[0]), k


@pytest.mark.parametrize(
    ("rate", "resonances", "most"),
    [(200.0, (900.0, 700.0), "108.2"), (78.125, (399.0, 280.0), "42.3"), (0.5, (900.0, 700.0), "108.2")],
)
def test_rows_whose_turns_are_longer_than_the_stroke_are_refused(rate, resonances, most) -> None:
    """399 and 280 Hz at 78 rows a second were to move over 70 um of 30, and were 473 pixels off."""
    kinds = ("plays", "preisach")
    with pytest.raises(SettingError, match=rf"from 1 to {most} Hz, as stages of .* within a stroke of 30 um"):
        imaging.planned(rate, resonances, kinds, 0.001, 0)
    slower = 5000.0 / math.ceil(5000.0 / float(most))
    _, scan = imaging.planned(slower, resonances, kinds, 0.001, 0)
    assert 28.0 < np.ptp(scan.x.position) <= 30.0


def test_a_motion_that_does_not_repeat_is_named():
    with pytest.raises(SettingError, match="a spiral: must be one of lines or turns of equal time"):
        lines.period_of(scans.spiral(turns=4, velocity="linear"))
    with pytest.raises(SettingError, match=r"rotation = 30.0 Hz: must be one whose period is a whole number of ticks"):
        lines.period_of(scans.spiral(turns=4, rotation=30.0))
    with pytest.raises(
        SettingError, match=r"rate = 41.0 Hz: must be one whose period is a whole number of ticks from 16 to 8192, not"
    ):
        imaging.image_stage(rate=41.0)
    bad = CliRunner().invoke(main, ["scan", "--rate", "41"])
    assert bad.exit_code == 2
    assert "--rate = 41.0 Hz" in bad.output


@pytest.mark.parametrize(
    ("option", "values"),
    [("rate", ["nan"]), ("rate", ["1e9"]), ("rate", ["1.234567"]), ("resonances", ["0.9", "0.7"]), ("noise", ["1000"])],
)
def test_a_scan_that_is_refused_gives_no_advice_before(option, values):
    """It said "nan rows of nan a second", and that the sensor has to be zeroed where the noise was too large."""
    refused = CliRunner().invoke(main, ["scan", f"--{option}", *values])
    assert refused.exit_code == 2
    assert refused.output.startswith(f"truestroke: --{option} = ")
    assert refused.output.count("\n") == 1


@pytest.mark.parametrize("rate", [0.0, -1.0, 0.5, 5000.0, float("nan")])
def test_a_rate_whose_lines_are_all_turn_is_refused_with_its_bound(rate):
    with pytest.raises(SettingError, match=r"rate = .* Hz: must be"):
        imaging.image_stage(rate=rate)


def test_a_bad_image_is_judged_as_bad(small):
    stage, scan = small
    true = lines.open_loop(scan, MultiAxisStage(stage), [30.0 / 3.6] * 2)
    distortion = scans.distortion(scan, *true.T)
    imaged = imaging.Imaged("open loop", true[:, 0], distortion, {}, (0.0, 0.0), "Scan slower.")
    found = imaging.judged(imaged, 0.2)
    assert found.level == "bad"
    assert imaging.judged(imaged, 0.0).reasons[-1] == "Scan slower."
    held = dataclasses.replace(imaged, remedy="", limited={"x": 61.0})
    assert "voltage of x in 61 % of the time" in imaging.judged(held, 0.0).reasons[-1]
    exact = scans.distortion(scan, scan.x.position, scan.y.position)
    said = "Turn slower. In Python, scans.spiral takes this rotation."
    assert imaging.judged(imaged, 0.2, for_spiral="Turn slower.").reasons[-1] == said
    assert imaging.judged(imaged, 0.09, for_spiral="Turn slower.").reasons[-1] != said
    assert imaging.judged(dataclasses.replace(imaged, distortion=exact), 0.0).reasons == ()
    assert "A pixel is up to" in found.reasons[0]
    assert "spiral" in found.reasons[-1]


def test_what_x_does_in_each_line_is_no_load_of_either_axis() -> None:
    """Lines were 0.2 pixels off where x heard a load of 16.8 Hz, and y the lines of x, in what first weights leave."""
    made = sampled_stage(
        resonances=(253.0, 240.0), damping=0.0254, kinds=("plays", "plays"), rate=5000.0, share=5 / 3, noise=0.00025
    )
    scan = imaging.scan_of(made, 25.0, 5.0)
    controllers = imaging.controllers_of(made, lines.period_of(scan))
    true = lines.together(scan, MultiAxisStage(made, 34), controllers)
    assert scans.distortion(scan, *true.T, imaging.PIXELS).largest < 0.1
    assert all(math.isnan(axis.load[0]) for axis in controllers.axes.values())
