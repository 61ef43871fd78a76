"""`truestroke export c`: what it writes builds without a warning and gives the desk's bits, here and on a Cortex-M."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from truestroke import (
    ActuatorModel,
    AdaptiveController,
    Dynamics,
    Mode,
    Recording,
    RepetitiveController,
    SettingError,
    cli,
    export_c,
    plant,
    run,
    trajectories,
)
from truestroke.control.baselines import ConstantGain
from truestroke.control.repeating.repetition import derivatives
from truestroke.export import c_values
from truestroke.export.c_sizes import struct_sizes
from truestroke.identification import save_model
from truestroke.runtime.realtime.config import load as load_config
from truestroke.signals.recording import Channel

ROOT = Path(__file__).parents[1]
BENCH = {"sample_rate": 10_000.0, "stroke": 20.0, "voltage_limits": (0.0, 10.0)}
STAGE = Dynamics(
    sample_rate=10_000.0,
    modes=(Mode(frequency=900.0, damping=0.02, share=0.9), Mode(frequency=2300.0, damping=0.03, share=0.1)),
    amplifier_bandwidth=3000.0,
    dead_time=1e-4,
)
CONTROLLERS: dict[str, Callable[[], AdaptiveController]] = {
    "default": lambda: AdaptiveController(**BENCH),
    "paper": lambda: AdaptiveController.paper(**BENCH),
    "stage": lambda: AdaptiveController(**BENCH, dynamics=STAGE, hum=50.0),
    "nm and kV": lambda: AdaptiveController(sample_rate=500.0, stroke=0.03, voltage_limits=(-1500.0, 200.0)),
}
SIZES = ("--sample-rate", "10000", "--stroke", "20", "--voltage-limits", "0", "10")
CROSS = "apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"


DEBUGGED = "CFLAGS=-O0 -Werror -fPIC"
OPTIMISED = "CFLAGS=-O1 -Werror -fPIC"
KEPT, SETS = ROOT / "build/compiled", 100  # what compilers made of which texts, so many sets; of a kernel some 25


def make(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """With the objects of the kernel that an earlier test, or an earlier session, has made of the same."""
    options = [argument for argument in arguments if "=" in argument]
    objects = [path.with_suffix(".o") for path in folder.glob("kernel/*.c")]
    return made_once(folder, arguments, options, sorted(folder.glob("kernel/*.[ch]")), objects)


def made_once(
    folder: Path, arguments: Sequence[str], options: list[str], texts: Iterable[Path], made: list[Path]
) -> subprocess.CompletedProcess[str]:
    """`make`, which finds what it made of the same texts with the same options and compiler, if without a warning."""
    compiler = next((option[3:] for option in options if option.startswith("CC=")), "cc")
    of = [(path.name, re.sub(rb"(?s)/\*.*?\*/", b"", path.read_bytes())) for path in texts]
    kept = KEPT / hashlib.sha256(repr((options, version(compiler), of)).encode()).hexdigest()
    for path in made:
        if not path.exists() and (kept / path.name).exists():
            shutil.copyfile(kept / path.name, path)
    command = ["make", "-s", "-j2", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    if made and not done.stderr and not kept.exists() and all(path.exists() for path in made):
        keep(made, kept)
    return done


@cache
def version(compiler: str) -> str:
    return subprocess.run([compiler, "--version"], capture_output=True, text=True, check=True).stdout


def keep(made: list[Path], place: Path) -> None:
    KEPT.mkdir(parents=True, exist_ok=True)
    whole = Path(tempfile.mkdtemp(dir=KEPT))
    for path in made:
        shutil.copyfile(path, whole / path.name)
    try:
        whole.rename(place)
    except OSError:  # another session was sooner
        shutil.rmtree(whole)
    for old in sorted(KEPT.iterdir(), key=lambda path: path.stat().st_mtime)[:-SETS]:
        shutil.rmtree(old)


BUILT = ("default-double", "paper-single", "stage-single", "nm and kV-double")
ON_A_CORE = {"default-double": "-O2", "paper-single": "-O0", "stage-single": "-O2"}


@pytest.fixture(scope="module", params=BUILT)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    name, precision = request.param.split("-")
    return export_c(
        CONTROLLERS[name](), tmp_path_factory.mktemp("export") / precision, precision=precision, ticks=400
    ).folder


def test_it_builds_without_a_warning_and_gives_the_bits_of_the_desk(exported: Path) -> None:
    done = make(exported, "test", OPTIMISED)
    assert done.stderr == ""
    assert done.stdout == "passed: 400 of 400 commands have the same bits, largest difference 0 V\n"


def test_it_allocates_nothing_and_prints_nothing(exported: Path) -> None:
    if not (exported / "adaptive.a").exists():
        assert make(exported, "adaptive.a", OPTIMISED).returncode == 0
    listed = subprocess.run(["nm", "-u", "adaptive.a"], cwd=exported, capture_output=True, text=True, check=True).stdout
    wanted = {line.split()[-1] for line in listed.splitlines() if line.strip().startswith("U ")}
    outside = {name for name in wanted if not name.startswith(("ts_", "adaptive_"))}
    assert outside <= {"sqrt", "sqrtf", "memcmp", "memcpy", "memmove", "memset", "__stack_chk_fail",
                       "_GLOBAL_OFFSET_TABLE_"}  # fmt: skip


@pytest.fixture
def single(tmp_path: Path) -> Path:
    return export_c(AdaptiveController(**BENCH), tmp_path / "c", precision="single", ticks=200).folder


def test_before_its_start_the_voltage_is_the_safe_one_and_bad_values_keep_the_last(single: Path) -> None:
    assert make(single, "adaptive.a", DEBUGGED).returncode == 0
    whole = ["-Wl,--whole-archive", "adaptive.a", "-Wl,--no-whole-archive"]
    subprocess.run(["cc", "-shared", "-o", "a.so", *whole, "-lm"], cwd=single, check=True)
    library = ctypes.CDLL(str(single / "a.so"))
    real = ctypes.c_float
    library.adaptive_command.restype = real

    def command(z_d: float) -> float:
        return float(library.adaptive_command(real(z_d), real(0.0), real(0.0)))

    assert command(10.0) == 0.0
    assert library.adaptive_start(real(0.0), real(1000.0)) != 0  # beyond reach
    assert command(10.0) == 0.0
    assert library.adaptive_start(real(0.0), real(0.0)) == 0
    first = command(0.01)
    assert 0 < first <= 10
    for bad in (np.nan, np.inf, -np.inf):
        assert command(bad) == first
    for _ in range(3000):
        volts = command(1e6)
        assert 0 <= volts <= 10
    assert volts == 10.0


def test_the_self_test_fails_where_a_setting_differs(single: Path) -> None:
    settings = single / "settings.c"
    text = settings.read_text()
    assert ".stroke = 20.0f" in text
    settings.write_text(text.replace(".stroke = 20.0f", ".stroke = 21.0f"))
    done = make(single, "test", DEBUGGED)
    assert done.returncode != 0
    assert done.stdout.startswith("FAILED: ")


BOARD = """
#include <stdio.h>
#include "board.h"

static int tick;
bool board_wait(void) { return ++tick < 3000; }
bool board_read(ts_real *z) { *z = 0; return true; }
void board_write(ts_real volts) { printf("%.9g\\n", (double)volts); }
board_motion board_desired(void) { return (board_motion){1000, 0, 0}; }
"""


def written_volts(folder: Path, flags: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """What leaves a loop that is asked for the impossible, and ends."""
    (folder / "replay.c").write_text(BOARD)
    done = make(folder, "test", flags)
    assert done.returncode == 0, done.stderr
    return np.array(done.stdout.split(), dtype=float)


CONFIG = """
[driver]
name = "simulated"
sample_rate = 2000
[[axis]]
name = "x"
stroke = 30.0
controller = "{controller}"
voltage_limits = [-0.6, 3.6]
safe_voltage = 1.25
slew = {slew}
{more}
[axis.trajectory]
kind = "sine"
peak_to_peak = 10.0
frequency = 5.0
duration = 1.0
[recording]
file = "run.h5"
"""


@pytest.mark.parametrize(  # with objects that other tests have made
    ("controller", "slew", "flags"), [("adaptive", 400.0, DEBUGGED), ("paper", 300.0, OPTIMISED)]
)
def test_the_voltages_of_a_configuration_keep_its_limits(
    controller: str, slew: float, flags: str, tmp_path: Path
) -> None:
    config = tmp_path / "stage.toml"
    config.write_text(CONFIG.format(controller=controller, slew=slew, more=""))
    code, printed = call("--config", str(config), "--ticks", "100", "--output", str(tmp_path / "c"))
    assert code == 0, printed
    volts = written_volts(tmp_path / "c", flags)
    assert (volts[0], volts[-1]) == (1.25, 1.25)
    assert volts.max() == pytest.approx(3.6)
    assert volts.min() >= -0.6
    assert np.max(np.abs(np.diff(volts))) * 2000 == pytest.approx(slew, rel=1e-3)


def test_the_zero_of_a_configuration_is_taken_from_what_the_sensor_reads(tmp_path: Path) -> None:
    config, output = tmp_path / "stage.toml", ("--ticks", "100", "--output", str(tmp_path / "c"))
    config.write_text(CONFIG.format(controller="adaptive", slew=400.0, more="zero = 12.5"))
    code, printed = call("--config", str(config), *output)
    assert code == 0, printed
    assert "#define ADAPTIVE_ZERO 12.5f" in (tmp_path / "c/adaptive.h").read_text()
    config.write_text(CONFIG.format(controller="adaptive", slew=400.0, more='zero = "measured"'))
    code, printed = call("--config", str(config), "--overwrite", *output)
    assert code == 2
    assert "a chip measures none. Write the number of um" in printed
    others = ["export", "json", "--config", str(config), "--output", str(tmp_path / "a.json")]
    assert CliRunner().invoke(cli.main, others).exit_code == 0  # it reads no sensor


@pytest.fixture
def cortex_m() -> None:
    if not (shutil.which("arm-none-eabi-gcc") and shutil.which("qemu-system-arm")):
        assert not os.environ.get("CI"), f"CI needs the compiler and the emulator: {CROSS}"
        pytest.skip(f"no compiler or emulator of Cortex-M here; Debian: {CROSS}")


ON_M4 = ("AR=arm-none-eabi-ar", "CC=arm-none-eabi-gcc")
M4 = "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mthumb -mfloat-abi=hard"


@pytest.mark.usefixtures("cortex_m")
def test_single_precision_has_no_double_arithmetic(single: Path) -> None:
    """A Cortex-M4F calls a function of the compiler for each operation in double: none is called."""

    def called() -> set[str]:
        assert make(single, "adaptive.a", *ON_M4, f"CFLAGS=-O1 -Werror {M4}").stderr == ""
        listed = subprocess.run(["nm", "-u", "adaptive.a"], cwd=single, capture_output=True, text=True, check=True)
        return set(re.findall(r"__aeabi_(?:d\w+|\w*2d)\b", listed.stdout))

    assert called() == set()
    with (single / "adaptive.c").open("a") as text:
        text.write("\ndouble third(ts_real x);\ndouble third(ts_real x) { return (double)x / 3; }\n")
    assert called() == {"__aeabi_f2d", "__aeabi_ddiv"}


@pytest.mark.usefixtures("cortex_m")
@pytest.mark.parametrize("exported", ON_A_CORE, indirect=True)
def test_a_cortex_m_gives_the_bits_of_the_desk(exported: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """One of each core is optimised so far that products and sums would be contracted, if that were not forbidden."""
    core = "m4" if exported.name == "single" else "m7"
    level = ON_A_CORE[request.node.callspec.params["exported"]]
    folder = ROOT / "examples/cortex-m"
    texts, options = [*exported.rglob("*.[ch]"), *folder.iterdir()], ["CC=arm-none-eabi-gcc", f"OPTIMISED={level}"]
    arguments = ["-f", str(folder / "Makefile"), f"EXPORT={exported}", "OUT=.", *options, f"{core}.elf", f"{core}.run"]
    done = made_once(tmp_path, arguments, options, sorted(texts), [tmp_path / f"{core}.elf"])
    assert "passed: 400 of 400 commands have the same bits" in done.stdout, done.stdout + done.stderr


MACHINES = "apt-get install " + " ".join(
    [
        f"gcc-{machine}-linux-gnu libc6-dev-{libc}-cross"
        for machine, libc in (("aarch64", "arm64"), ("riscv64", "riscv64"))
    ]
    + ["qemu-user"]
)


@pytest.mark.parametrize(
    ("machine", "name", "precision"), [("aarch64", "default", "double"), ("riscv64", "stage", "single")]
)
def test_another_processor_gives_the_bits_of_the_desk(machine: str, name: str, precision: str, tmp_path: Path) -> None:
    tools = f"{machine}-linux-gnu-"
    if not (shutil.which(f"{tools}gcc") and shutil.which(f"qemu-{machine}")):
        assert not os.environ.get("CI"), f"CI needs the compilers and the emulator: {MACHINES}"
        pytest.skip(f"no compiler or emulator of {machine} here; Debian: {MACHINES}")
    folder = export_c(CONTROLLERS[name](), tmp_path / "c", precision=precision, ticks=200).folder  # type: ignore[arg-type]
    done = make(folder, "replay", f"CC={tools}gcc", f"AR={tools}ar", "CFLAGS=-O2 -static")
    assert done.returncode == 0, done.stderr
    printed = subprocess.run(
        [f"qemu-{machine}", "replay"], cwd=folder, capture_output=True, text=True, check=False
    ).stdout
    assert printed == "passed: 200 of 200 commands have the same bits, largest difference 0 V\n"


@pytest.fixture
def graph_of_calls() -> None:
    version = subprocess.run(["cc", "--version"], capture_output=True, text=True, check=True).stdout
    if "Free Software Foundation" not in version:
        assert not os.environ.get("CI"), "CI needs gcc"
        pytest.skip("cc is not gcc, which alone writes the graph of calls; Debian: apt-get install gcc")


@pytest.mark.usefixtures("graph_of_calls")
def test_the_stack_is_bounded_and_nothing_calls_itself(single: Path) -> None:
    done = make(single, "stack", "CFLAGS=-O1")
    assert done.stderr == ""
    depth = {line.split()[1]: int(line.split()[0]) for line in done.stdout.splitlines()[:4]}
    assert 200 < depth["adaptive_adapt"] < 4000
    assert depth["adaptive_adapt"] > depth["adaptive_end"]
    (single / "settings.c").write_text((single / "settings.c").read_text() + RECURSION)
    done = make(single, "stack", DEBUGGED, "SOURCES=settings.c")  # beside what is known of the others
    assert done.returncode != 0
    assert "calls itself" in done.stderr


RECURSION = """
int adaptive_end2(int n);
static int inner(int n) { return adaptive_end2(n - 1); }
int adaptive_end2(int n) { return n ? inner(n) : 0; }
"""


@given(st.floats(width=32, allow_nan=False))
def test_constants_are_read_back_to_the_same_bits(value: float) -> None:
    text = c_values.real(value, "single")
    if np.isfinite(value):
        assert text.endswith("f")
        assert np.float32(text[:-1]).tobytes() == np.float32(value).tobytes()
    else:
        assert text == ("INFINITY" if value > 0 else "-INFINITY")


def test_a_folder_with_files_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "main.c").write_text("mine")
    with pytest.raises(FileExistsError, match="has files"):
        export_c(AdaptiveController(**BENCH), tmp_path)
    assert (tmp_path / "main.c").read_text() == "mine"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"history": 8}, "history"),
        ({"history": 2000}, "history"),
        ({"ticks": 5}, "ticks"),
        ({"precision": "half"}, "precision"),
    ],
)
def test_what_cannot_be_exported_is_named(options: dict[str, object], named: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=named):
        export_c(AdaptiveController(**BENCH), tmp_path / "c", **options)  # type: ignore[arg-type]
    assert not (tmp_path / "c").exists()


def test_what_is_too_large_for_the_chip_is_refused(tmp_path: Path) -> None:
    controller = AdaptiveController(**BENCH)
    needed = export_c(controller, tmp_path / "a", precision="single", ticks=100).ram
    assert export_c(controller, tmp_path / "b", precision="single", ticks=100, ram=needed).ram == needed
    with pytest.raises(SettingError, match=rf"ram = {needed - 1} bytes: must be {needed} or more for the state of 26"):
        export_c(controller, tmp_path / "c", precision="single", ticks=100, ram=needed - 1)
    assert not (tmp_path / "c").exists()


# ---- What a host has learned of a motion that repeats ----------------------------------------------------------------


def repetitive(inside: object = None) -> RepetitiveController:
    stage = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=900.0, damping=0.02),))
    alone = AdaptiveController(sample_rate=10_000.0, stroke=30.0, voltage_limits=(-0.6, 3.6), dynamics=stage)
    return RepetitiveController(alone if inside is None else inside, 0.02)  # type: ignore[arg-type]


def test_the_exported_source_has_the_error_of_the_host_that_learned(tmp_path: Path) -> None:
    """Lines of another run of the same stage, mean of twenty periods, so that the noise of the sensor is small."""
    wave = trajectories.raster(
        frequency=50.0, peak_to_peak=20.0, duration=5.0, sample_rate=10_000.0, offset=12.0, turn=0.2
    )
    settings = plant.StageSettings(resonances=(900.0,), dampings=(0.02,), hysteresis_kind="preisach", dead_time=1e-4)
    host = repetitive()
    learned = run(wave, host, plant.StagePlant(settings, seed=1))
    made = export_c(host, tmp_path / "c", precision="single")
    assert made.ram == export_c(host.controller, tmp_path / "alone", precision="single").ram + 232 + 2 * 4 * 200  # type: ignore[arg-type]
    done = make(made.folder, "test", OPTIMISED)
    assert done.stderr == ""
    assert done.stdout == "passed: 2400 of 2400 commands have the same bits, largest difference 0 V\n"
    whole = ["-Wl,--whole-archive", "adaptive.a", "-Wl,--no-whole-archive"]
    subprocess.run(["cc", "-shared", "-o", "a.so", *whole, "-lm"], cwd=made.folder, check=True)
    library, real = ctypes.CDLL(str(made.folder / "a.so")), ctypes.c_float
    library.adaptive_command.restype = real
    stage = plant.StagePlant(settings, seed=2)
    stage.open()
    velocity, acceleration = derivatives(wave.position, 10_000.0)
    assert library.adaptive_start(real(0.0), real(stage.exchange(np.zeros(1))[0])) == 0
    measured = []
    for row in np.stack([wave.position, velocity, acceleration], axis=1).tolist():
        volts = library.adaptive_command(*map(real, row))
        measured.append(float(stage.exchange(np.array([volts]))[0]))
        library.adaptive_adapt(real(measured[-1]), 0)

    def error(z: np.ndarray[tuple[int], np.dtype[np.float64]], ticks: slice) -> float:
        lines = wave.flat[ticks].reshape(-1, 200)[0].astype(bool)
        return float(np.std((z - wave.position)[ticks].reshape(-1, 200).mean(axis=0)[lines]))

    first, last = slice(4_000, 8_000), slice(26_000, 30_000)
    on_chip = error(np.array(measured), last)
    assert on_chip < 0.4 * error(learned["measured"], first)
    assert on_chip < error(learned["measured"], last) + 0.003  # um; the noise of the mean is 0.003


def test_the_command_takes_the_state_that_was_saved(tmp_path: Path) -> None:
    config, state = tmp_path / "stage.toml", tmp_path / "learned.npz"
    config.write_text(CONFIG.format(controller="adaptive", slew=400.0, more="period = 0.2"))
    controller = load_config(config).axes[0].controller
    assert isinstance(controller, RepetitiveController)
    wave = trajectories.sine(frequency=5.0, peak_to_peak=10.0, duration=6.0, sample_rate=2000.0)
    run(wave, controller, plant.RealisticPlant(plant.PlantSettings(sample_rate=2000.0)))
    np.savez(state, **controller.state())
    output = ("--ticks", "100", "--output", str(tmp_path / "c"))
    code, printed = call("--config", str(config), "--repetition", str(state), *output)
    assert code == 0, printed
    assert "const ts_real wave[ADAPTIVE_PERIOD]" in (tmp_path / "c/period.c").read_text()
    assert "#define ADAPTIVE_PERIOD 400 " in (tmp_path / "c/adaptive.h").read_text()
    for refused, words in (
        (("--config", str(config)), "its axis has a period"),
        (("--config", str(config), "--repetition", str(config)), "--repetition"),
        ((*SIZES, "--repetition", str(state)), "--repetition goes with --config"),
    ):
        code, printed = call(*refused, *output)
        assert code == 2
        assert words in printed


def test_a_file_that_is_not_what_was_learned_is_refused_in_a_line(tmp_path: Path) -> None:
    config, learned = tmp_path / "stage.toml", tmp_path / "learned.npz"
    config.write_text(CONFIG.format(controller="adaptive", slew=400.0, more="period = 0.2"))
    controller = load_config(config).axes[0].controller
    assert isinstance(controller, RepetitiveController)
    np.savez(tmp_path / "fresh.npz", **controller.state())
    wave = trajectories.sine(frequency=5.0, peak_to_peak=10.0, duration=6.0, sample_rate=2000.0)
    run(wave, controller, plant.RealisticPlant(plant.PlantSettings(sample_rate=2000.0)))
    np.savez(learned, **controller.state())
    (tmp_path / "cut.npz").write_bytes(learned.read_bytes()[:1000])
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "text.npz").write_text("volts\n1.0\n")
    np.savez(tmp_path / "another.npz", volts=np.zeros(3))

    def refused(name: str) -> str:
        asked = ("--config", str(config), "--repetition", str(tmp_path / name), "--output", str(tmp_path / "c"))
        code, printed = call(*asked)
        assert (code, printed.count("\n")) == (2, 1), printed
        return printed

    for name in ("cut.npz", "empty.npz", "text.npz"):
        assert "no NPZ file, or a damaged one" in refused(name)
    assert "it is no state of the controller of this axis" in refused("another.npz")
    assert "it has learned nothing yet" in refused("fresh.npz")
    written = config.read_text()
    config.write_text(written.replace("stroke = 30.0", "stroke = 20.0"))
    assert "made with stroke 30 um: must be one made with stroke 20 um" in refused("learned.npz")
    faster = CONFIG.replace("frequency = 5.0", "frequency = 10.0")
    config.write_text(faster.format(controller="adaptive", slew=400.0, more="period = 0.1"))
    assert "its motion has a period of 0.2 s, that of " in refused("learned.npz")
    assert not (tmp_path / "c").exists()


def test_what_has_learned_nothing_or_is_around_another_controller_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=r"controller = 0 batches: must be one that has learned a correction"):
        export_c(repetitive(), tmp_path / "c")
    line = ConstantGain(10.0, voltage_limits=(-0.6, 3.6))
    around = RepetitiveController(line, 0.02, sample_rate=10_000.0, voltage_limits=(-0.6, 3.6))
    with pytest.raises(SettingError, match="a RepetitiveController around one"):
        export_c(around, tmp_path / "c")
    assert not (tmp_path / "c").exists()


SIZES_IN_C = """
#include <stdio.h>
#include "kernel/truestroke.h"
int main(void) { printf("%zu %zu %zu", sizeof(ts_controller), sizeof(ts_settings), sizeof(ts_kalman)); return 0; }
"""


@pytest.mark.parametrize("name", ["default", "paper", "stage"])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_sizes_are_those_of_the_compiler(name: str, precision: str, tmp_path: Path) -> None:
    folder = export_c(CONTROLLERS[name](), tmp_path / "c", precision=precision, ticks=100).folder  # type: ignore[arg-type]
    (folder / "sizes.c").write_text(SIZES_IN_C)
    subprocess.run(["cc", "-I.", "sizes.c", "-o", "sizes"], cwd=folder, check=True)
    printed = subprocess.run([folder / "sizes"], capture_output=True, text=True, check=True).stdout
    sizes = struct_sizes((folder / "kernel/truestroke.h").read_text(), precision, pointer=struct.calcsize("P"))
    assert printed == " ".join(str(sizes[kind]) for kind in ("ts_controller", "ts_settings", "ts_kalman"))


@pytest.mark.parametrize(("limits", "flags"), [((0.32791528710747, 2.7), ()), ((-2.7, -0.32791528710747), (DEBUGGED,))])
def test_limits_that_single_precision_rounds_are_no_reason_to_refuse(limits, flags, tmp_path: Path) -> None:
    """0.32791528 V is the nearest such number, and below the limit; those of a model are of this kind.

    The first is built as a user builds it, optimised most; its bits are those of the desk, too.
    """
    controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=limits)
    folder = export_c(controller, tmp_path / "chip", precision="single", ticks=100).folder
    done = make(folder, "test", *flags)
    assert done.stdout.startswith("passed: 100 of 100")
    assert done.stderr == ""


def test_a_dead_time_needs_a_longer_history(tmp_path: Path) -> None:
    late = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=900.0, damping=0.02),), dead_time=1e-3)
    controller = AdaptiveController(**BENCH, dynamics=late)
    with pytest.raises(SettingError, match=r"history = 16 ticks: must be \d+ or more for this law and dead time"):
        export_c(controller, tmp_path / "c", history=16)
    assert export_c(controller, tmp_path / "c", ticks=100).capacities["TS_HISTORY"] > 16


def test_the_zero_of_a_model_is_taken_from_what_the_sensor_reads(tmp_path: Path) -> None:
    model = ActuatorModel(
        stroke=20.0, voltage_range=(0.0, 10.0), velocity=1000.0, thresholds=(0.0,), rate_dependent=(), zero=3.25,
        weights=[2.0, 0.0, 0.0], covariance=np.diag([0.1, 0.1, 0.1]),
    )  # fmt: skip
    save_model(tmp_path / "model.toml", model)
    start = ("--model", str(tmp_path / "model.toml"), "--sample-rate", "10000", "--ticks", "100")
    code, printed = call(*start, "--output", str(tmp_path / "c"))
    assert code == 0, printed
    assert "#define ADAPTIVE_ZERO 3.25f" in (tmp_path / "c/adaptive.h").read_text()
    assert make(tmp_path / "c", "test", DEBUGGED).stdout.startswith("passed: 100 of 100")
    readings = re.findall(r"(?m)^    \{.*, ([-0-9.e]+)f\},$", (tmp_path / "c/replay.c").read_text())
    assert float(readings[0]) == pytest.approx(3.25, abs=0.1)
    code, printed = call(*start, "--voltage-limits", "0", "1000", "--output", str(tmp_path / "volts"))
    assert (code, "0 to 1000 V: must be 1 to 80 V apart" in " ".join(printed.split())) == (2, True), printed


def call(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(cli.main, ["export", "c", *arguments])
    return done.exit_code, done.output


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, printed = call(*SIZES, "--ticks", "100", "--output", "chip", "--json")
    assert (code, json.loads(printed)["capacities"]["TS_MAX_PLAYS"]) == (0, 26)
    assert "truestroke export c" in Path("chip/README.md").read_text()
    assert call(*SIZES, "--output", "chip")[0] == 1
    assert call(*SIZES, "--output", "chip", "--ticks", "100", "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--stroke", "20"], "--sample-rate, --voltage-limits: needed"),
        (["--axis", "x"], "--axis is one of --config"),
        (["--sample-rate", "1e4", "--stroke", "-1", "--voltage-limits", "0", "10"], "stroke = -1"),
        (["--controller", "paper", "--dynamics", __file__, *SIZES], "knows no dynamics"),
        (["--safe-voltage", "-1", *SIZES], "--safe-voltage = -1.0 V: must be from 0 to 10 V"),
        (["--config", __file__, "--safe-voltage", "1"], "--safe-voltage is in --config FILE"),
    ],
)
def test_the_command_says_what_it_needs(arguments: list[str], words: str, tmp_path: Path) -> None:
    code, printed = call(*arguments, "--output", str(tmp_path / "c"))
    assert code in (1, 2)
    assert words in printed


def test_the_command_starts_from_what_a_run_has_learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    soft = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    run(trajectories.random_wave(duration=1.0, velocity_limit=400.0), soft, plant.RealisticPlant(seed=1)).save("run.h5")
    code, printed = call("--state", "run.h5", "--precision", "double", "--ticks", "100", "--output", "chip")
    assert code == 0, printed
    weights = re.search(r"\.initial_weights = \{(.*)\},", Path("chip/settings.c").read_text())
    assert weights is not None
    np.testing.assert_array_equal(np.array(weights[1].split(","), dtype=float), Recording.load("run.h5")["weights"][-1])
    assert make(Path("chip"), "test", OPTIMISED).stdout.startswith("passed: 100 of 100")
    assert "#define ADAPTIVE_ZERO 0.0" in Path("chip/adaptive.h").read_text()
    kept = Recording.load("run.h5")
    seen = {"axis": {"name": "x"}, "axis_check": {"x": {"zero": 12.5}}}  # as `truestroke run` writes it
    Recording(kept.channels, {**kept.metadata, **seen}).save("zeroed.h5")
    code, printed = call("--state", "zeroed.h5", "--ticks", "100", "--output", "zeroed")
    assert code == 0, printed
    assert "#define ADAPTIVE_ZERO 12.5f" in Path("zeroed/adaptive.h").read_text()
    code, printed = call("--state", "run.h5", "--stroke", "30", "--output", "other")
    assert "--stroke is in --state FILE" in printed
    code, printed = call("--state", "run.h5", "--axis", "y", "--output", "other")
    assert "run.h5 has axis" in printed


def test_what_a_bad_run_has_learned_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    wave = trajectories.random_wave(duration=1.0, velocity_limit=400.0)
    made = run(wave, controller, plant.RealisticPlant(seed=1))
    lost = np.where(np.arange(2000) > 900, np.nan, made["measured"])
    Recording({**made.channels, "measured": Channel(lost, "um", "")}, made.metadata).save("run.h5")
    code, printed = call("--state", "run.h5", "--output", "chip")
    assert code == 2
    assert "run.h5: must be a good run: its weights are not to be used." in printed
    assert not Path("chip").exists()


def test_the_command_takes_an_axis_of_a_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example = CliRunner().invoke(cli.main, ["run", "--example"]).output
    Path("stage.toml").write_text(example)
    code, printed = call("--config", "stage.toml", "--ticks", "100", "--output", "chip")
    assert code == 0, printed
    assert "stage.toml" in Path("chip/adaptive.h").read_text()
    code, printed = call("--config", "stage.toml", "--stroke", "3", "--output", "other")
    assert "--stroke is in --config" in printed
