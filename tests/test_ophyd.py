"""A flyable axis in ophyd-async: real plans of bluesky, real scanspecs, the simulated stage."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from late import Late

from truestroke import SettingError
from truestroke.dropins import flights, motions
from truestroke.dropins.axes import Axes
from truestroke.model.dynamics import Dynamics, Mode

bluesky, bps, bp = Late("bluesky"), Late("bluesky.plan_stubs"), Late("bluesky.plans")
bpp, utils = Late("bluesky.preprocessors"), Late("bluesky.utils")
event_model, core, specs = Late("event_model"), Late("ophyd_async.core"), Late("scanspec.specs")
ophyd = Late("truestroke.dropins.ophyd")

CONFIGURATION = """
[driver]
name = "simulated"
sample_rate = 10000.0
{driver}

[[axis]]
name = "x"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 3000.0
resonance = 700.0
"""


@pytest.fixture(scope="module")
def engine() -> Any:
    return bluesky.RunEngine(context_managers=[])


@pytest.fixture
def axis(tmp_path: Path, engine: Any, request: pytest.FixtureRequest) -> Any:
    driver = getattr(request, "param", "stage = {noise = 0.005}")
    (tmp_path / "stage.toml").write_text(CONFIGURATION.format(driver=driver))
    with core.init_devices():
        x = ophyd.PiezoAxis(tmp_path / "stage.toml", "x")
    yield x
    x.close()


def documents(engine: Any, plan: Any) -> dict[str, list[dict[str, Any]]]:
    """What a plan emits, by kind, each checked by the schema of event-model."""
    found: dict[str, list[dict[str, Any]]] = {}

    def keep(name: str, document: dict[str, Any]) -> None:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)
        found.setdefault(name, []).append(document)

    engine(plan, keep)
    return found


def test_a_flight_carries_desired_measured_volts(engine: Any, axis: Any) -> None:
    scan = 0.005 @ specs.Line("x", 5.0, 15.0, 41)
    found = documents(engine, ophyd.fly(axis, scan, stream="flight", md={"sample": "grating"}))
    assert found["start"][0]["sample"] == "grating"
    assert found["descriptor"][0]["name"] == "flight"
    keys = found["descriptor"][0]["data_keys"]
    assert {key: entry["units"] for key, entry in keys.items()} == {
        "x-desired": "um",
        "x-measured": "um",
        "x-volts": "V",
    }
    data = found["event_page"][0]["data"]
    np.testing.assert_allclose(data["x-desired"], np.linspace(5.0, 15.0, 41), atol=1e-9)
    error = np.subtract(data["x-measured"], data["x-desired"])
    assert np.sqrt(np.mean(error**2)) < 0.02  # of 10 um; one slope is off by 1 um
    assert (np.diff(data["x-volts"]) > 0).all()
    stamps = found["event_page"][0]["timestamps"]["x-measured"]
    np.testing.assert_allclose(np.diff(stamps), 0.005, atol=1e-6)
    assert found["stop"][0]["exit_status"] == "success"
    assert found["stop"][0]["num_events"] == {"flight": 41}


def test_lines_there_and_back(engine: Any, axis: Any) -> None:
    scan = 0.002 @ (2 * ~specs.Line(axis, 8.0, 12.0, 5))
    data = documents(engine, ophyd.fly(axis, scan))["event_page"][0]["data"]
    np.testing.assert_allclose(data["x-desired"], [8, 9, 10, 11, 12, 12, 11, 10, 9, 8], atol=1e-9)


def test_moves_reads_and_steps(engine: Any, axis: Any) -> None:
    engine(bps.mv(axis, 12.0))
    read = asyncio.run(axis.read())
    assert read["x"]["value"] == pytest.approx(12.0, abs=0.2)
    assert 1.0 < read["x-volts"]["value"] < 2.5
    events = documents(engine, bp.scan([], axis, 12.0, 16.0, 5))["event"]
    assert [e["data"]["x"] for e in events] == pytest.approx([12, 13, 14, 15, 16], abs=0.1)


def test_a_flight_of_a_motor_is_one_point(engine: Any, axis: Any) -> None:
    info = core.FlyMotorInfo(start_position=5.0, end_position=10.0, time_for_move=0.05)
    data = documents(engine, ophyd.fly(axis, info))["event_page"][0]["data"]
    assert data["x-desired"] == pytest.approx([7.5])
    assert data["x-measured"] == pytest.approx([7.5], abs=0.1)


@pytest.mark.parametrize("axis", ['faults = [{kind = "nan", count = 1000000}]'], indirect=True)
def test_no_sensor_leaves_nan_and_the_place_where_it_should_be(engine: Any, axis: Any) -> None:
    data = documents(engine, ophyd.fly(axis, 0.005 @ specs.Line("x", 5.0, 10.0, 6)))["event_page"][0]["data"]
    assert np.isnan(data["x-measured"]).all()
    engine(bps.mv(axis, 7.0))
    assert asyncio.run(axis.read())["x"]["value"] == 7.0


@pytest.mark.parametrize(
    ("scan", "reason"),
    [
        (
            lambda: 0.005 @ specs.Line("x", 5.0, 40.0, 6),
            "motion of axis x = .* um: must be within 0 to 30 um, with its run-up and run-down",
        ),
        (lambda: 0.005 @ specs.Line("y", 5.0, 10.0, 6), "axis = y: must be x, the axis that flies"),
        (lambda: specs.Line("x", 5.0, 10.0, 6), "duration = None s: must be that of each point: 0.005 @ spec"),
        (
            lambda: 0.005 @ (specs.Line("y", 0.0, 1.0, 2) * ~specs.Line("x", 5.0, 10.0, 6)),
            "axis = y: must be left out: x flies alone",
        ),
        (
            lambda: 0.005 @ (specs.Static("y", 1.0, 2) * ~specs.Line("x", 0.0, 10.0, 6)),
            "motion of axis x = -.*: must be within 0",
        ),
        (lambda: 7, "prepare = a int: must be a scanspec, its Path, or a FlyMotorInfo"),
    ],
)
def test_a_scan_that_cannot_be_flown_says_why(engine: Any, axis: Any, scan: Any, reason: str) -> None:
    with pytest.raises(utils.FailedStatus) as failed:
        engine(bps.prepare(axis, scan(), wait=True))
    with pytest.raises(SettingError, match=reason):
        raise failed.value.__cause__ or failed.value
    engine(bps.mv(axis, 3.0))  # and the axis is as it was


def test_a_speed_that_changes_within_a_line_is_refused() -> None:
    with pytest.raises(SettingError, match="speed = 10 to 20 within a line um/s: must be constant"):
        flights.lines(np.array([0.0, 1.0]), np.array([1.0, 3.0]), np.full(2, 0.1), [True, False])


def test_a_configuration_that_is_missing_is_named_with_its_folder_and_a_remedy(tmp_path: Path) -> None:
    """It was `[Errno 2] No such file or directory` alone."""
    with pytest.raises(FileNotFoundError, match=r"none.toml, in .*; `truestroke run --example` prints one"):
        Axes.of(tmp_path / "none.toml")


def test_kickoff_before_prepare_and_move_before_connect(engine: Any, axis: Any) -> None:
    with pytest.raises(utils.FailedStatus) as failed:
        engine(bpp.run_wrapper(bps.kickoff(axis, wait=True)))
    assert "prepare() must be called before kickoff()" in str(failed.value.__cause__ or failed.value)
    alone = ophyd.PiezoAxis("none.toml", "x")
    with pytest.raises(RuntimeError, match="x: connect"):
        _ = alone.axes


@pytest.mark.parametrize("axis", ['faults = [{kind = "error", at = 900}]'], indirect=True)
def test_a_fault_of_the_hardware_fails_the_run(engine: Any, axis: Any) -> None:
    found: list[dict[str, Any]] = []
    with pytest.raises(utils.FailedStatus):
        engine(
            ophyd.fly(axis, 0.005 @ specs.Line("x", 5.0, 15.0, 41)),
            {"stop": lambda _, document: found.append(document)},
        )
    assert found[0]["exit_status"] == "fail"


@pytest.mark.parametrize(
    ("points", "least"), [(10, "2e-05 s, so that a line of 10 points"), (1, "0.0002 s, so that it")]
)
def test_a_line_that_takes_no_two_ticks_is_named_by_its_points(points: int, least: str) -> None:
    """4e-7 s of a point, which the scan states, and not the 4e-6 s of the line, which nobody does."""
    scan = [flights.Line(5.0, 15.0, points, 4e-7 * points)]
    with pytest.raises(SettingError, match=rf"^duration of a point = 4e-07 s: must be at least {least} takes 2 ticks$"):
        flights.flight(scan, 10_000.0, speed=500.0)


def test_a_flight_that_does_not_fit_the_memory_is_refused() -> None:
    words = (
        r"^duration of a point = 10000 s: must be so short that all lines take at most .* not 1e\+05: .* GB are free"
    )
    with pytest.raises(SettingError, match=words):
        flights.flight([flights.Line(5.0, 15.0, 10, 1e5)], 1e6, speed=500.0)


@pytest.mark.parametrize("duration", [0.0, -0.01])
def test_a_point_that_takes_no_time_is_named_with_its_duration(duration):
    with pytest.raises(SettingError, match=rf"^duration of a point = {duration:g} s: must be above 0 s: 0.005 @ spec"):
        flights.lines(np.array([0.0]), np.array([1.0]), np.array([duration]), [True])


TIMED = "hardware_timed = true\nblock = 20\nstage = {noise = 0.005}"


def stopped(axis: Any, begin: Any, success: bool = False) -> str:
    """Stop what `begin` begins, once it moves: rests when `stop` returns; the error with which it ended."""

    async def both() -> str:
        begun = begin()
        while not axis.axes.busy("x"):
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.03)
        await axis.stop(success)
        assert not axis.axes.busy("x")
        try:
            await begun
        except RuntimeError as error:
            return str(error)
        return ""

    return bluesky.run_engine.call_in_bluesky_event_loop(both(), 20.0)


@pytest.mark.parametrize("axis", [TIMED], indirect=True)
@pytest.mark.parametrize("success", [True, False])
def test_stop_ends_a_flight_at_rest(engine: Any, axis: Any, success: bool) -> None:
    """It flew on to its end; nobody who had waited for a move could move it again."""

    async def ready() -> None:
        await axis.prepare(0.05 @ specs.Line("x", 5.0, 15.0, 41))  # 2 s
        await axis.kickoff()

    bluesky.run_engine.call_in_bluesky_event_loop(ready(), 20.0)
    assert stopped(axis, axis.complete, success) == ("" if success else "Device x was stopped.")
    points = list(axis.collect())
    assert len(points) < 35
    places = [one["data"]["x-desired"] for one in points]
    assert places == pytest.approx((5.0 + 0.25 * np.arange(len(points))).tolist())
    engine(bps.mv(axis, 5.0))  # and it goes on


@pytest.mark.parametrize("axis", [TIMED], indirect=True)
def test_stop_ends_a_move_at_rest(engine: Any, axis: Any) -> None:
    """It went on, and the loop ended with it: whoever waited for it had gone."""
    axis.axes._lines["x"].speed = 20.0
    assert stopped(axis, lambda: axis.set(25.0)) == "Device x was stopped."
    assert axis.axes.at("x") < 8.0
    engine(bps.mv(axis, 0.0))


def test_stop_at_rest_or_before_connect_does_nothing(axis: Any) -> None:
    asyncio.run(ophyd.PiezoAxis("none.toml", "x").stop())
    asyncio.run(axis.stop())
    assert axis.axes.at("x") == 0.0


@pytest.mark.parametrize("stage", [None, Dynamics(sample_rate=1000.0, modes=(Mode(frequency=100.0, damping=0.02),))])
def test_a_move_that_would_take_weeks_names_the_speed(stage) -> None:
    """mm/s where um/s are due, or a typing error: the memory ended."""
    with pytest.raises(SettingError, match=r"speed = 1e-06 um/s: must be faster: 10 um take 1e\+07 s"):
        motions.move(0.0, 10.0, 1000.0, speed=1e-6, stage=stage)
