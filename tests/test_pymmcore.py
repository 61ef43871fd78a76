"""Stages in pymmcore-plus: with its own core, its own acquisition engine, and the simulated stage."""

from __future__ import annotations

import re
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import useq
from pymmcore_plus.experimental.unicore import SimpleCameraDevice, UniMMCore

from truestroke import PlaceWarning, SettingError
from truestroke.dropins.axes import Axes
from truestroke.dropins.pymmcore import PiezoXY, PiezoZ, opened
from truestroke.runtime.drivers import DriverError, SimulatedDriver
from truestroke.runtime.drivers.simulated import Fault, SimulatedSettings
from truestroke.runtime.realtime import config
from truestroke.signals import trajectories

AXIS = """
[[axis]]
name = "{name}"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 3000.0
resonance = 700.0
"""


def configuration(folder: Path, *axes: str, driver: str = "stage = {noise = 0.01}", more: str = "") -> Path:
    head = f'[driver]\nname = "simulated"\nsample_rate = 10000.0\nchannels = {len(axes)}\n{driver}\n'
    (folder / "stage.toml").write_text(head + "".join(AXIS.format(name=name) + more for name in axes))
    return folder / "stage.toml"


@pytest.fixture
def core() -> UniMMCore:
    made = UniMMCore()
    yield made
    made.unloadAllDevices()


def load(core: UniMMCore, folder: Path, lines: str) -> None:
    (folder / "scope.cfg").write_text(lines)
    core.loadSystemConfiguration(str(folder / "scope.cfg"))


class Depth(SimpleCameraDevice):
    """A camera whose one pixel is the true position of the stage, nm."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path

    def get_exposure(self) -> float:
        return 1.0

    def set_exposure(self, exposure: float) -> None:
        pass

    def sensor_shape(self) -> tuple[int, int]:
        return (1, 1)

    def dtype(self) -> type:
        return np.uint16

    def snap(self, buffer: np.ndarray) -> dict[str, object]:
        buffer[:] = round(1000 * opened(self.path).trace("z").true[-1])
        return {}


def test_a_z_stack_of_the_acquisition_engine(core: UniMMCore, tmp_path: Path) -> None:
    file = configuration(tmp_path, "z")
    load(
        core,
        tmp_path,
        f"#py pyDevice,Z,truestroke.dropins.pymmcore,PiezoZ\n#py Property,Z,Configuration,{file}\n"
        "Property,Core,Initialize,1\n#py Property,Core,Focus,Z\n",
    )
    core.loadPyDevice("Camera", Depth(file))
    core.initializeDevice("Camera")
    core.setCameraDevice("Camera")
    core.setAutoShutter(False)
    seen: list[tuple[float, float]] = []
    core.mda.events.frameReady.connect(lambda image, event: seen.append((event.z_pos, image[0, 0] / 1000)))
    stack = useq.MDASequence(z_plan={"bottom": 4.0, "top": 12.0, "step": 1.0}, metadata={})
    for _ in range(2):  # in the first one the controller learns the stage
        core.mda.run(stack)
    asked, true = np.array(seen[9:]).T
    assert asked.tolist() == np.arange(4.0, 12.5).tolist()
    assert np.abs(true - asked)[1:].max() < 0.12  # one slope: 1 um and more
    assert core.getPosition() == pytest.approx(12.0, abs=0.1)
    assert float(core.getProperty("Z", "Axis volts")) == opened(file).volts("z") > 1.0


def test_xy_and_z_share_a_driver_and_close_it_together(core: UniMMCore, tmp_path: Path) -> None:
    file = str(configuration(tmp_path, "x", "y", "z", driver="stage = {noise = 0.0}"))
    core.loadPyDevice("XY", PiezoXY(file))
    core.loadPyDevice("Z", PiezoZ(file))
    core.initializeAllDevices()
    core.setXYStageDevice("XY")
    core.setFocusDevice("Z")
    core.setXYPosition(5.0, 8.0)
    core.setPosition(3.0)
    core.waitForDevice("XY")
    core.waitForDevice("Z")
    assert core.getXYPosition() == pytest.approx((5.0, 8.0), abs=0.3)
    assert core.getZPosition() == pytest.approx(3.0, abs=0.3)
    output = opened(file)._driver.output  # type: ignore[attr-defined]
    assert (output > 0.2).all()
    core.unloadDevice("Z")
    core.setRelativeXYPosition(1.0, 1.0)
    core.waitForDevice("XY")
    core.unloadDevice("XY")
    assert output.tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(LookupError, match="no stage that is initialized"):
        opened(file)


def test_origin_home_and_adapter_origin(core: UniMMCore, tmp_path: Path) -> None:
    core.loadPyDevice("Z", PiezoZ(str(configuration(tmp_path, "z", driver="stage = {noise = 0.0}"))))
    core.initializeDevice("Z")
    core.setFocusDevice("Z")
    core.setPosition(10.0)
    core.waitForDevice("Z")
    core.setOrigin()
    assert core.getPosition() == pytest.approx(0.0, abs=0.3)
    core.setPosition(2.0)
    core.waitForDevice("Z")
    core.setAdapterOrigin(50.0)
    assert core.getPosition() == pytest.approx(50.0, abs=0.3)
    with pytest.raises(ValueError, match=r"target of axis z = 'up' um: must be a number"):
        core.setPosition("up")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"target of axis z = -1\.0 um: must be from 0 to 30 um"):
        core.setPosition(37.0)


def test_a_missing_file_or_axis_is_an_error_in_the_words_of_the_host(core: UniMMCore, tmp_path: Path) -> None:
    core.loadPyDevice("Z", PiezoZ(str(tmp_path / "none.toml")))
    core.initializeDevice("Z")  # which logs the error and keeps it
    assert isinstance(core._pydevices["Z"]._initialized_, FileNotFoundError)
    core.setFocusDevice("Z")
    with pytest.raises(RuntimeError, match=r"^Device 'Z' is not initialized: .*No such file.*none.toml"):
        core.setPosition(1.0)
    core.loadPyDevice("W", PiezoZ(str(configuration(tmp_path, "z")), axis="w"))
    core.initializeDevice("W")
    assert "must be one of z" in str(core._pydevices["W"]._initialized_)


# ---- The axes themselves --------------------------------------------------------------------------------------------


def test_time_passes_at_rest_where_the_hardware_has_a_clock(tmp_path: Path) -> None:
    file = configuration(tmp_path, "z", driver="hardware_timed = true\nblock = 20\nstage = {noise = 0.01}")
    with Axes.of(file) as axes:
        done = axes.move(z=5.0)["z"]
        assert axes.busy("z")
        assert done.result(timeout=60.0).desired[-1] == 5.0
        time.sleep(0.1)
        assert axes.reading("z") == pytest.approx(5.0, abs=0.1)  # learned at rest
        assert not axes.busy("z")


def test_latency_and_blocks_leave_each_measurement_at_its_tick(tmp_path: Path) -> None:
    late = configuration(tmp_path, "z", driver="block = 4\nlatency = 7\nplant = {noise = 0.0}")
    with Axes.of(late) as axes:
        made = axes.move(z=5.0)["z"].result()
    assert np.isfinite(made.measured).all()
    assert np.abs(made.measured - made.true).max() < 0.01
    assert abs(made.measured[0]) < 0.01  # at rest; the first of them came 7 ticks later


def test_a_motion_that_is_stopped_rests_on_its_way(tmp_path: Path) -> None:
    """Nothing could stop it: a large move on a slow amplifier takes seconds."""
    with Axes.of(configuration(tmp_path, "z", driver="block = 4\nlatency = 7\nplant = {noise = 0.0}")) as axes:
        assert axes.stop("z") is None
        axes._lines["z"].speed = 20.0
        going = axes.move(z=20.0)["z"]
        while axes.at("z") < 1.0:
            time.sleep(0.001)
        assert axes.stop("z") is going
        assert axes.stop("z") in (going, None)  # again; None: it rests by now
        made = going.result(timeout=60.0)
        assert made.stopped is not None
        assert 1.0 <= made.desired[made.stopped] <= made.desired[-1] < 15.0
        steps = np.diff(made.desired)
        assert steps.min() > -1e-12
        assert np.abs(np.diff(steps)).max() < 0.1 * steps.max()
        assert np.isfinite(made.measured).all()
        assert axes.at("z") == made.desired[-1]
        axes._lines["z"].speed = 500.0
        assert axes.move(z=0.0)["z"].result().desired[-1] == 0.0


def test_the_host_stops_a_move(core: UniMMCore, tmp_path: Path) -> None:
    file = configuration(tmp_path, "z", driver="hardware_timed = true")
    core.loadPyDevice("Z", PiezoZ(str(file)))
    core.initializeDevice("Z")
    opened(file)._lines["z"].speed = 5.0
    core.setPosition("Z", 20.0)
    core.stop("Z")
    core.waitForDevice("Z")
    assert core.getPosition("Z") < 5.0


def test_no_sensor_leaves_the_model(tmp_path: Path) -> None:
    file = configuration(tmp_path, "z", driver='faults = [{kind = "nan", count = 1000000}]\nstage = {noise = 0.0}')
    with Axes.of(file) as axes:
        made = axes.move(z=5.0)["z"].result()
        assert np.isnan(made.measured).all()
        assert axes.reading("z") == 5.0


@pytest.mark.parametrize(
    ("more", "what"), [("period = 0.02\n", "axis.period = 0.02 s"), ("[coupled]\n", "coupled = a table")]
)
def test_what_needs_a_motion_that_is_known_ahead_is_refused(tmp_path: Path, more: str, what: str) -> None:
    """It was passed over without a word."""
    with pytest.raises(SettingError, match=f"{what}: must be left out: another program moves the axes"):
        config.movable(configuration(tmp_path, "z", more=more))


def test_a_fault_of_the_hardware_ends_at_the_safe_voltage(tmp_path: Path) -> None:
    _, given = config.movable(configuration(tmp_path, "z"))
    faulty = SimulatedDriver(SimulatedSettings(sample_rate=10000.0, faults=(Fault(kind="error", at=10),)))
    axes = Axes(faulty, given)
    axes.open()
    with pytest.raises(DriverError, match="the axes are at the safe voltage: exchange: error -1"):
        axes.move(z=5.0)["z"].result(timeout=60.0)
    assert faulty.output.tolist() == [0.0]
    with pytest.raises(DriverError, match="the simulated connection is lost"):
        axes.move(z=1.0)
    axes.close()


def test_an_axis_that_has_lost_its_way_ends(tmp_path: Path) -> None:
    file = configuration(tmp_path, "z", driver='faults = [{kind = "wild", at = 100, count = 1000000}]')
    with Axes.of(file) as axes:
        motion = trajectories.sine(frequency=1.0, peak_to_peak=5.0, duration=2.0, sample_rate=10000.0)
        with pytest.raises(DriverError, match="axis z: tracking is lost"):
            axes.follow("z", motion).result(timeout=120.0)


def test_an_axis_that_is_further_off_than_its_stroke_ends_at_once(tmp_path: Path) -> None:
    """A stroke that is a hundred times too small; it moved for 1.6 s. One that is ten times too small is learned."""

    def moved(stroke: float) -> float:
        file = configuration(tmp_path, "z", driver='stage = {noise = 0.01, hysteresis_kind = "preisach"}')
        file.write_text(file.read_text().replace("stroke = 30.0", f"stroke = {stroke}"))
        seconds = 0.0
        with Axes.of(file) as axes:
            for k in range(400):
                made = axes.move(z=stroke * (0.1 + 0.08 * (7 * k % 10)))["z"].result(timeout=60.0)
                seconds += made.time.size / axes.timing.sample_rate
                if seconds > 0.4:
                    return seconds
        return seconds

    assert moved(3.0) > 0.4
    with pytest.raises(DriverError, match=r"further off than its stroke, 0\.3 um; .*: correct stroke"):
        moved(0.3)


@pytest.mark.parametrize(
    ("about", "stated", "said"),
    [
        ("resonances = [150.0]", 0.0, True),
        ('resonances = [150.0], hysteresis_kind = "bouc-wen"', 0.0, True),
        ("resonances = [150.0]", 150.0, False),
        ("resonances = [700.0]", 0.0, False),
        ('resonances = [1500.0], hysteresis_kind = "preisach"', 0.0, False),
    ],
)
def test_planes_beside_their_place_are_said_where_no_resonance_is_stated(tmp_path, about, stated, said) -> None:
    """A stage of 150 Hz whose resonance nobody has stated had planes up to 18 % of a step off, and nothing said so."""
    file = configuration(tmp_path, "z", driver=f"stage = {{noise = 0.01, {about}}}")
    file.write_text(file.read_text().replace("resonance = 700.0\n", f"resonance = {stated}\n" if stated else ""))
    with warnings.catch_warnings(record=True) as given, Axes.of(file) as axes:
        warnings.simplefilter("always")
        for z in [*np.linspace(5.0, 20.0, 16), *np.linspace(5.0, 20.0, 16)]:
            axes.move(z=float(z))["z"].result(timeout=60.0)
    words = [str(one.message) for one in given if issubclass(one.category, PlaceWarning)]
    assert len(words) == said
    assert not said or re.match(
        r"axis z: 3 of the last \d moves ended beside their place, .* Give `resonance`", words[0]
    )


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"z": 31.0}, "target of axis z = 31.0 um: must be from 0 to 30 um"),
        ({"z": float("nan")}, "target of axis z = nan um"),
        ({"w": 1.0}, "axis = 'w': must be one of z"),
    ],
)
def test_what_cannot_be_reached_is_refused(tmp_path: Path, asked: dict[str, float], message: str) -> None:
    with Axes.of(configuration(tmp_path, "z")) as axes, pytest.raises(SettingError, match=message):
        axes.move(**asked)


def test_a_stage_between_voltages_of_both_signs_moves_to_both_sides(tmp_path: Path) -> None:
    file = configuration(tmp_path, "z", driver="stage = {noise = 0.01, stroke = 15.0, voltage_limits = [-10.0, 10.0]}")
    file.write_text(file.read_text().replace("voltage_limits = [-0.6, 3.6]", "voltage_limits = [-10.0, 10.0]"))
    with Axes.of(file) as axes:
        for target in (10.0, -10.0, -9.0, -10.0):
            made = axes.move(z=target)["z"].result()
        assert made.true[-1] == pytest.approx(-10.0, abs=0.2)
        with pytest.raises(SettingError, match="must be from -15 to 15 um"):
            axes.move(z=-15.1)


def test_a_motion_from_elsewhere_is_refused(tmp_path: Path) -> None:
    with Axes.of(configuration(tmp_path, "z")) as axes:
        axes.move(z=5.0)["z"].result()
        wave = trajectories.sine(frequency=10.0, peak_to_peak=5.0, duration=1.0, sample_rate=10000.0)
        with pytest.raises(SettingError, match="must be from 5 um, where z is"):
            axes.follow("z", wave)
        other = trajectories.sine(frequency=10.0, peak_to_peak=5.0, duration=1.0, sample_rate=2000.0)
        with pytest.raises(SettingError, match=r"must be 10000\.0 Hz, that of the driver"):
            axes.follow("z", other)
