"""docs/fmu.md: the FMUs are valid, have the bits of the package, save their state, and name what is wrong."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from lxml import etree

from truestroke import (
    ActuatorModel,
    AdaptiveController,
    CompilerError,
    Dynamics,
    Mode,
    SettingError,
    cli,
    export_fmu,
    save_model,
    trajectories,
)
from truestroke._plant import Plant
from truestroke.base import declared
from truestroke.model.branches import Branches
from truestroke.model.layout import Layout
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.plant.settings import PLANT_SETTINGS

SIZES: dict[str, Any] = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
QUIET = PlantSettings().without("noise")
TICK = 1 / 2000.0
STAGE = Dynamics(
    sample_rate=2000.0,
    modes=(Mode(frequency=300.0, damping=0.02, share=0.9), Mode(frequency=700.0, damping=0.03, share=0.1)),
    amplifier_bandwidth=800.0,
    dead_time=1.3e-3,
)
RANGE = (-0.6, 3.6)
CURVED = Branches(
    voltage_range=RANGE,
    curves=("convex", "concave", "sigmoid"),
    plays=2,
    levels=3,
    weights=(0.3, -0.1, 0.1, 0.2, 0.4, 0.1, 0.5, -0.2, 0.3, 0.1, 0.7, -0.3),
)


def model(**changes: Any) -> ActuatorModel:
    """Of an actuator with every term."""
    terms: dict[str, Any] = {
        "thresholds": (0.0, 0.2, 0.5, 0.9),
        "rate_dependent": (0, 2),
        "creep_times": (0.01, 0.3),
        "asymmetry": 2,
    }
    weights = Layout(**terms).vector(
        [7.1, 0.5, 0.4, 0.3], [0.11, -0.07], creep=[0.1, 0.2], lag=-1.5e-4, offset=0.33, asymmetry=[0.4, -0.2]
    )
    others = {"stroke": 30.0, "voltage_range": RANGE, "rate_scale": 0.007, "velocity": 2000.0, "zero": 1.2345}
    covariance = 1e-10 * np.eye(weights.size)  # of a lag that is proven: volts_of is faster than the record
    return ActuatorModel(**{**terms, **others, "weights": weights, "covariance": covariance, **changes})


WHOLE = model(dynamics=STAGE, delay=3.7e-3, time_constant=2e-4, branches=CURVED)


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    folder = tmp_path_factory.mktemp("fmu")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CC", "cc -O0")  # compiles soonest, and gives the same bits
        yield {
            "controller": export_fmu(AdaptiveController(**SIZES), folder / "controller.fmu", version=request.param),
            "plant": export_fmu(QUIET, folder / "stack.fmu", version=request.param),
            "actuator": export_fmu(WHOLE, folder / "actuator.fmu", sample_rate=2000.0, version=request.param),
        }


class Unit:
    """An instance by the names of its variables, and what it says of errors."""

    def __init__(self, file: Path, folder: Path, **parameters: float) -> None:
        described = fmpy.read_model_description(str(file))
        shutil.rmtree(folder, ignore_errors=True)
        fmpy.extract(str(file), str(folder))
        self.said: list[str] = []
        self.variables = {v.name: v for v in described.modelVariables}
        self.three = described.fmiVersion == "3.0"
        model = described.coSimulation.modelIdentifier
        given = {"guid": described.guid, "unzipDirectory": str(folder), "modelIdentifier": model}
        self.unit = (FMU3Slave if self.three else FMU2Slave)(instanceName="one", **given)
        (self._instantiate3 if self.three else self._instantiate2)()
        self.set(**parameters)
        self.ticks, self.tick = 0, float(described.defaultExperiment.stepSize)

    def _instantiate3(self) -> None:
        self.unit.instantiate(logMessage=lambda _, status, category, message: self.said.append(message.decode()))
        self.unit.enterInitializationMode(startTime=0.0)

    def _instantiate2(self) -> None:
        self._logger = fmi2CallbackLoggerTYPE(self._log)
        calls = fmi2CallbackFunctions()
        calls.logger = self._logger
        calls.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        calls.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self._calls = calls
        self.unit.instantiate(callbacks=calls)
        self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()

    def _log(self, _: Any, name: bytes, status: int, category: bytes, message: bytes, *rest: Any) -> None:
        self.said.append(message.decode())

    def begin(self) -> Unit:
        self.unit.exitInitializationMode()
        return self

    def set(self, **values: float) -> None:
        for name, value in values.items():
            v = self.variables[name]
            getattr(self.unit, f"set{v.type}")(
                [v.valueReference], [value if v.type in ("Real", "Float64") else int(value)]
            )

    def get(self, name: str) -> float:
        v = self.variables[name]
        return float(getattr(self.unit, f"get{v.type}")([v.valueReference])[0])

    def saved(self) -> tuple[Any, bytes]:
        """Its state, and that as bytes."""
        if self.three:
            kept = self.unit.getFMUState()
            return kept, self.unit.serializeFMUState(kept)
        kept = self.unit.getFMUState()
        return kept, self.unit.serializeFMUstate(kept)

    def restore(self, kept: Any) -> None:
        """A state, or its bytes."""
        if isinstance(kept, bytes):
            kept = (self.unit.deserializeFMUState if self.three else self.unit.deSerializeFMUstate)(kept)
        self.unit.setFMUState(kept)

    def step(self, ticks: int = 1) -> None:
        self.unit.doStep(self.ticks * self.tick, ticks * self.tick)
        self.ticks += ticks


def test_they_are_valid(exported: dict[str, Path]) -> None:
    for file in exported.values():
        assert validate_fmu(str(file)) == []
        description = fmpy.read_model_description(str(file))
        assert description.coSimulation.canGetAndSetFMUstate
        assert {u.name for u in description.unitDefinitions} >= {"um", "V"}


def test_terminals_and_build_description_follow_their_schemas(exported: dict[str, Path]) -> None:
    schemas = Path(fmpy.__file__).parent / "schema/fmi3"
    for file in exported.values():
        description = fmpy.read_model_description(str(file))
        with zipfile.ZipFile(file) as archive:
            parts = {Path(name).stem: name for name in archive.namelist() if name.endswith(".xml")}
            icon = archive.read("model.png" if description.fmiVersion == "2.0" else "terminalsAndIcons/icon.png")
            assert icon.startswith(b"\x89PNG")
            if description.fmiVersion == "2.0":
                assert list(parts) == ["modelDescription"]
                continue
            for part, schema in (("buildDescription", "BuildDescription"), ("terminalsAndIcons", "TerminalsAndIcons")):
                read = etree.fromstring(archive.read(parts[part]))
                etree.XMLSchema(etree.parse(schemas / f"fmi3{schema}.xsd")).assertValid(read)
            members = [member.get("variableName") for member in read.iter("TerminalMemberVariable")]
        assert len(members) >= 3
        assert set(members) <= {v.name for v in description.modelVariables}


def test_a_loop_of_both_has_the_bits_of_the_package(exported: dict[str, Path], tmp_path: Path) -> None:
    law = Unit(exported["controller"], tmp_path / "c", acceleration=1).begin()
    stack = Unit(exported["plant"], tmp_path / "p").begin()
    controller, plant = AdaptiveController(**SIZES), RealisticPlant(QUIET)
    plant.open()
    wave = trajectories.random_wave(duration=0.5)
    for z_d, zdot_d, zddot_d in zip(wave.position, wave.velocity, wave.acceleration, strict=True):
        law.set(z_d=z_d, zdot_d=zdot_d, zddot_d=zddot_d)
        law.step()
        stack.set(volts=law.get("volts"))
        stack.step()
        law.set(z=stack.get("measured"))
        volts = controller.command(z_d, zdot_d, zddot_d)
        z = plant.exchange(np.array([volts]))[0]
        assert (law.get("volts"), stack.get("measured")) == (volts, z)
        controller.adapt(z)
    assert abs(stack.get("truth") - z_d) < 0.1


def volts_of(ticks: int) -> Any:
    """A voltage that rests, then wanders, beyond the record, too."""
    steps = np.random.default_rng(3).normal(size=ticks)
    steps[:4] = 0.0
    return np.clip(0.7 + 0.2 * np.cumsum(steps), -0.8, 3.8)


def driven(unit: Unit, volts: Any) -> Any:
    """The displacement of an actuator's FMU in each tick, um."""
    found = []
    for value in volts:
        unit.set(volts=value)
        unit.step()
        found.append(unit.get("displacement"))
    return np.array(found)


def test_an_actuator_is_its_model(exported: dict[str, Path], tmp_path: Path) -> None:
    unit = Unit(exported["actuator"], tmp_path / "a", offset=0.25).begin()
    at_rest = WHOLE.predict([0.0], 2000.0, offset=0.25)[0]  # curved branches are summed in another order
    assert unit.get("displacement") == pytest.approx(at_rest, rel=1e-12)
    assert unit.get("late") == 0  # the dead time is longer than what the velocity looks ahead
    volts = volts_of(1200)
    found = driven(unit, volts)
    np.testing.assert_allclose(found, WHOLE.predict(volts, 2000.0, offset=0.25), rtol=0, atol=1e-12 * np.ptp(found))
    assert np.ptp(found) > 20.0
    unit.set(volts=3.7)
    unit.step()
    assert unit.get("beyond") == 1
    weights = WHOLE.weights.copy()
    weights[WHOLE.names.index("creep 0.3 s")] = 0.9
    other = Unit(exported["actuator"], tmp_path / "b", weight_creep_0_3_s=0.9).begin()
    expected = WHOLE.replace(weights=weights).predict(volts[:300], 2000.0)
    np.testing.assert_allclose(driven(other, volts[:300]), expected, rtol=0, atol=1e-12 * np.ptp(found))


def test_an_actuator_without_dead_time_is_late_by_what_its_velocity_looks_ahead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "cc -O0")
    volts = volts_of(600)
    duhem = Branches(voltage_range=RANGE, betas=(4.0, 12.0), weights=(0.3, -0.1, 0.2, 0.1))
    for name, one, largest in (("plays", model(), 0.0), ("duhem", model(branches=duhem), 1e-12)):
        file = export_fmu(one, tmp_path / f"{name}.fmu", sample_rate=20_000.0)
        unit = Unit(file, tmp_path / name).begin()
        late = int(unit.get("late"))
        assert late == 2  # of 0.1 ms
        difference = driven(unit, volts)[late:] - one.predict(volts, 20_000.0)[:-late]
        assert np.abs(difference).max() <= largest  # exp of NumPy and of C differ in the last bit


def test_an_actuator_is_beyond_a_record_that_shows_no_speed_but_that_of_a_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """2000 um/s is that of a step, most motion has 10 um/s; a ramp of some 800 um/s."""
    monkeypatch.setenv("CC", "cc -O0")
    found = []
    for name, usual in (("motion", 1500.0), ("step", 10.0)):
        file = export_fmu(model(usual_velocity=usual), tmp_path / f"{name}.fmu", sample_rate=1000.0)
        unit = Unit(file, tmp_path / name).begin()
        driven(unit, 0.1 * np.arange(10))
        found.append(unit.get("beyond"))
    assert found == [0, 1]


def test_another_importer(exported: dict[str, Path], tmp_path: Path) -> None:
    """Ecos, whose library needs that of the package tbb: both FMUs of a loop step at the same time."""
    law = Unit(exported["controller"], tmp_path / "c", late=1).begin()
    stack = Unit(exported["plant"], tmp_path / "p").begin()
    actuator = Unit(exported["actuator"], tmp_path / "a").begin()
    expected = []
    for k in range(200):
        values = {"volts": law.get("volts")}, {"z": stack.get("measured"), "z_d": 10.0 + k / 20, "zdot_d": 100.0}
        for unit, given in zip((stack, law), values, strict=True):
            unit.set(**given)
            unit.step()
        actuator.set(**values[0])
        actuator.step()
        expected.append((law.get("volts"), stack.get("measured"), actuator.get("displacement")))
    folders = [os.environ.get("LD_LIBRARY_PATH", ""), str(Path(sys.prefix) / "lib")]
    script = Path(__file__).with_name("fakes") / "in_ecos.py"
    done = subprocess.run(
        [sys.executable, str(script), *map(str, exported.values())],
        env=os.environ | {"LD_LIBRARY_PATH": os.pathsep.join(filter(None, folders))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == [list(row) for row in expected]


def numbers(seed: int, count: int) -> list[float]:
    """The generator of the FMU's noise, from the papers that c/fmi/unit_plant.c names."""
    state, found = seed, []

    def uniform() -> float:
        nonlocal state
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        x = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) % 2**64
        return (((x ^ (x >> 31)) >> 11) + 1) / 2**53

    for _ in range(count):
        size = math.sqrt(-2 * math.log(uniform()))
        found.append(size * math.cos(6.283185307179586 * uniform()))
    return found


def test_parameters_and_noise_of_the_stack(exported: dict[str, Path], tmp_path: Path) -> None:
    chosen = {"hysteresis": 0.2, "creep": 0.03, "resonance": 400.0, "noise": 0.1, "drift": 0.0, "ad_step": 0.0}
    settings = PlantSettings(**chosen)
    plant = Plant(declared.kernel_values(settings, PLANT_SETTINGS))
    volts = 1.5 + np.sin(np.arange(200.0))
    measured, truth = np.empty(200), np.empty(200)
    plant.run(volts, np.array(numbers(7, 1000)), measured, truth)
    stack = Unit(exported["plant"], tmp_path / "p", seed=7, **chosen).begin()
    for k in range(0, 200, 4):
        stack.set(volts=volts[k])
        stack.step()
        assert (stack.get("measured"), stack.get("truth")) == (measured[k], truth[k])
        for i in range(k + 1, k + 4):
            stack.set(volts=volts[i])
            stack.step()
    assert 0.03 < np.std(measured - truth) < 0.06  # 0.1 um / sqrt(5)


def test_a_long_step_is_as_many_ticks(exported: dict[str, Path], tmp_path: Path) -> None:
    one = Unit(exported["plant"], tmp_path / "p").begin()
    ends = []
    for ticks in (1, 1, 1, 3):
        one.set(volts=2.0)
        one.step(ticks)
        ends.append(one.get("measured"))
    plant = RealisticPlant(QUIET)
    plant.open()
    assert ends == plant.exchange(np.full(6, 2.0))[[0, 1, 2, 5]].tolist()


def test_a_saved_state_goes_on_with_the_same_bits(exported: dict[str, Path], tmp_path: Path) -> None:
    one = Unit(exported["controller"], tmp_path / "one").begin()
    other = Unit(exported["controller"], tmp_path / "other").begin()

    def run(unit: Unit, ticks: range) -> list[float]:
        volts = []
        for k in ticks:
            z = 11 * unit.get("volts") + 0.1 * math.sin(k)
            unit.set(z_d=10 + 5 * math.sin(k / 20), zdot_d=500 * math.cos(k / 20), z=z)
            unit.step()
            volts.append(unit.get("volts"))
        return volts

    run(one, range(300))
    other.set(z=1.0)  # inputs are part of the state
    kept, bytes_ = one.saved()
    expected = run(one, range(300, 400))
    one.restore(kept)
    one.ticks = other.ticks = 300
    assert run(one, range(300, 400)) == expected
    one.unit.freeFMUState(kept)
    other.restore(bytes_)
    one.unit.freeInstance()  # nothing of it may be needed any more
    assert run(other, range(300, 400)) == expected
    assert len(set(expected)) > 90


@pytest.mark.parametrize(
    ("kind", "parameters", "words"),
    [
        ("plant", {"damping": 1.5}, "damping = 1.5: must be from 0 to 0.99"),
        ("plant", {"noise": math.nan}, "noise = nan um: must be from 0 to 1000"),
        ("controller", {"voltage_min": 9.0}, "voltage_min = 9 V: must be below voltage_max, 3.6 V"),
        ("controller", {"late": 1024}, "late = 1024: must be from 0 to 1023"),
        ("plant", {"truth": 1.0}, "truth is an output: it cannot be set"),
    ],
)
def test_bad_parameters_are_named(
    kind: str, parameters: dict[str, float], words: str, exported: dict[str, Path], tmp_path: Path
) -> None:
    unit = Unit(exported[kind], tmp_path / "u")

    def begin() -> None:
        unit.set(**parameters)
        unit.begin()

    with pytest.raises(fmpy.fmi1.FMICallException):
        begin()
    assert unit.said == [words]


def test_bad_steps_are_named(exported: dict[str, Path], tmp_path: Path) -> None:
    unit = Unit(exported["controller"], tmp_path / "u", slew_limit=100.0)
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.step()
    unit.begin()
    for now, step in ((0.0, 0.0007), (0.0, 0.0), (0.1, TICK)):
        with pytest.raises(fmpy.fmi1.FMICallException):
            unit.unit.doStep(now, step)
    unit.set(z_d=10.0)
    unit.step()
    volts = unit.get("volts")
    assert volts == pytest.approx(100.0 * TICK, rel=1e-12)  # the slew limit
    unit.set(z_d=math.inf)
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.step()
    assert unit.get("volts") == volts
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.set(slew_limit=1.0)
    assert [said.partition(" s:")[0] for said in unit.said[1:4]] == [
        "step = 0.0007",
        "step = 0",
        "time = 0.1",
    ]
    assert "must be a multiple of the tick, 0.0005" in unit.said[1]
    assert (unit.said[0][:6], *unit.said[4:]) == (
        "a step",
        "z_d = inf um: must be finite",
        "slew_limit is set before the first step only",
    )


def test_a_first_measurement_beyond_reach_is_refused(exported: dict[str, Path], tmp_path: Path) -> None:
    """An importer that takes um for nm; the next one, of the right unit, is taken."""
    unit = Unit(exported["controller"], tmp_path / "u")
    unit.begin()
    unit.set(z_d=10.0)
    unit.step()
    unit.set(z=1e4)
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.step()
    assert unit.said[0].startswith("z = 10000 um: must be within ")
    unit.set(z=9.0)
    unit.step()
    assert unit.get("innovation") != 0.0


def test_all_functions_of_the_standard_are_there(exported: dict[str, Path]) -> None:
    """FMI 3.0 asks for those of the other kinds of FMUs, too; FMI 2.0 does not."""
    header = (Path(fmpy.__file__).parent / "c-code/fmi3Functions.h").read_text()
    standard = set(re.findall(r"FMI3_Export \w+TYPE\s+(\w+);", header))
    assert len(standard) > 70
    for file in exported.values():
        if fmpy.read_model_description(str(file)).fmiVersion == "3.0":
            with zipfile.ZipFile(file) as archive:
                binary = archive.read(next(name for name in archive.namelist() if name.endswith(".so")))
            assert not [name for name in standard if name.encode() + b"\0" not in binary]


def test_the_source_stands_alone(exported: dict[str, Path], tmp_path: Path) -> None:
    for kind, file in exported.items():
        folder = tmp_path / kind
        fmpy.extract(str(file), str(folder))
        texts = [path.read_text() for path in folder.rglob("*Description.xml")]
        named = re.findall(r'<(?:Source)?File name="(.*?)"/>', "".join(texts))
        sources = [str(folder / "sources" / name) for name in named]
        assert {Path(name).name for name in sources} == {path.name for path in (folder / "sources").glob("*.c")}
        prefixes = [f"-DFMI{version}_FUNCTION_PREFIX=truestroke_{kind}_" for version in (2, 3)]
        strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", *prefixes]
        done = subprocess.run(["cc", "-fsyntax-only", *strict, *sources], capture_output=True, text=True, check=False)
        assert done.stderr == ""


def test_what_cannot_be_exported_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingError, match="double: the variables of FMI are in double precision"):
        export_fmu(AdaptiveController(**SIZES, precision="single"), tmp_path / "c.fmu")
    with pytest.raises(SettingError, match=r"version = '1\.0': must be '2\.0' or '3\.0'"):
        export_fmu(QUIET, tmp_path / "c.fmu", version="1.0")  # type: ignore[arg-type]
    with pytest.raises(SettingError, match=r"a name that ends with \.fmu"):
        export_fmu(QUIET, tmp_path / "stack.zip")
    with pytest.raises(SettingError, match=r"sample_rate = 2000\.0 Hz: must be left out: it is in the settings"):
        export_fmu(QUIET, tmp_path / "stack.fmu", sample_rate=2000.0)
    with pytest.raises(SettingError, match="sample_rate = None Hz: must be given: the model does not say"):
        export_fmu(WHOLE, tmp_path / "a.fmu")
    with pytest.raises(SettingError, match=r"model\.delay = 200\.0 s: must be 100 s or less, 100000 ticks"):
        export_fmu(WHOLE.replace(delay=200.0), tmp_path / "a.fmu", sample_rate=1000.0)
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(CompilerError, match="no C compiler no-such-compiler on this computer"):
        export_fmu(QUIET, tmp_path / "stack.fmu")
    assert list(tmp_path.iterdir()) == []


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(cli.main, ["export", "fmu", *arguments])
        return done.exit_code, done.output

    sizes = ("--sample-rate", "2000", "--stroke", "30", "--voltage-limits", "-0.6", "3.6")
    assert call(*sizes, "--source", "--output", "c.fmu")[0] == 0
    first = Path("c.fmu").read_bytes()
    assert call(*sizes, "--source", "--output", "c.fmu")[0] == 0  # one of ours
    assert Path("c.fmu").read_bytes() == first
    assert call("--stack", "--source", "--fmi", "3.0", "--output", "p.fmu")[0] == 0
    assert fmpy.read_model_description("p.fmu").fmiVersion == "3.0"
    with zipfile.ZipFile("p.fmu") as archive:
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
    save_model("model.toml", WHOLE.replace(metrics={"record_sample_rate_hz": 4000.0}))
    assert call("--actuator", "--model", "model.toml", "--source", "--output", "a.fmu")[0] == 0
    assert fmpy.read_model_description("a.fmu").defaultExperiment.stepSize == "0.00025"
    for arguments, words in (
        (("--stack", "--stroke", "3"), "--stroke is one of a controller"),
        (("--actuator", "--model", "model.toml", "--slew", "3"), "--slew is one of a controller"),
        (("--actuator",), "--actuator needs --model FILE"),
        (("--actuator", "--stack"), "--actuator and --stack are two FMUs"),
        (("--stack", "--force"), "--force uses a --model whose verdict is bad"),
        (("--history", "20", *sizes), "--history is one of `export c`"),
        (("--ticks", "200", *sizes), "--ticks is one of `export c`"),
    ):
        code, printed = call(*arguments, "--output", "d.fmu")
        assert (code, words in printed) == (2, True), printed
    save_model("model.toml", model())
    other = call(
        "--model", "model.toml", "--sample-rate", "2000", "--voltage-limits", "-50", "150", "--output", "d.fmu"
    )
    assert (other[0], "--voltage-limits = -50 to 150 V: must be 0.42 to 33.6 V apart" in other[1]) == (2, True), other
    Path("mine.fmu").write_text("mine")
    assert call("--stack", "--source", "--output", "mine.fmu")[0] == 1
    assert Path("mine.fmu").read_text() == "mine"
