"""The command line: what it prints, writes, refuses, and how it ends."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

from truestroke import AdaptiveController, cli
from truestroke.cli import main
from truestroke.cli.common import RENAMED, plots_option, program
from truestroke.control.baselines import ConstantGain
from truestroke.plant import RealisticPlant
from truestroke.signals.recording import Recording
from truestroke.signals.trajectories import random_wave
from truestroke.studies.compare import Rival

pytestmark = pytest.mark.usefixtures("empty_folder")

COMMAND = Path(sys.executable).with_name("truestroke")
SHORT = ["track", "--duration", "2"]


def call(*arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments))


@pytest.fixture
def _without_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes a second, which most tests can spare."""
    monkeypatch.setattr("truestroke.cli.common.save_page", lambda *_: [])


def errors(path: Path) -> dict[str, float]:
    """Figures of the second half, by their definition."""
    recording = Recording.load(path)
    half = slice(recording["time"].size // 2, None)
    found = {}
    for kind in ("measured", "true"):
        error = recording[kind][half] - recording["desired"][half]
        found |= {f"{kind}_rmse_um": np.sqrt(np.mean(error**2)), f"{kind}_maximum_um": np.abs(error).max()}
    return found


def test_the_command_as_a_user_runs_it() -> None:
    done = subprocess.run([COMMAND, *SHORT, "--json"], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == ""  # no progress in a pipe
    printed = json.loads(done.stdout)
    assert done.stdout.count("\n") == 1
    for name, value in errors(Path("truestroke-track.h5")).items():
        assert printed[name] == pytest.approx(value, rel=1e-9), name
    page = Path(printed["page"]).read_text()
    assert f"{printed['true_rmse_um']:.4f}" in page
    assert "truestroke track --duration 2<" in page  # the command that repeats it


def test_help_comes_at_once_and_loads_nothing_heavy() -> None:
    code = (
        "import sys, truestroke.cli as c\n"
        "try: c.main(['--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted(set(sys.modules) & {'matplotlib', 'scipy', 'h5py', 'jinja2', 'rich', 'truestroke.runtime.loop'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "track" in done.stdout


@pytest.mark.usefixtures("_without_page")
def test_track_prints_the_table_and_where_the_page_is() -> None:
    done = call(*SHORT, "--output", "run")
    assert done.exit_code == 0, done.output
    for name, value in errors(Path("run.h5")).items():
        assert f"{value:.4f} um" in done.stdout, name
    assert "\x1b" not in done.stdout
    assert "converged  " in done.stdout
    files, suggestions = done.stdout.split("\n\n")[-2:]
    assert "run.html" in files
    suggested = re.findall(r"^  (?:python -m )?truestroke (.*?)  ", suggestions, flags=re.MULTILINE)
    assert {words.split()[0] for words in suggested} == {"track", "compare", "reproduce"}
    for words in suggested:  # what is suggested exists
        name, *options = words.split()
        main.commands[name].make_context(name, options)
    recording = Recording.load("run.h5")
    loop = np.abs(recording["uncompensated"] - recording["desired"]).max()
    assert loop > 5 * errors(Path("run.h5"))["true_maximum_um"]  # before is worse than after


@pytest.mark.usefixtures("_without_page")
def test_the_same_seed_gives_the_same_bits() -> None:
    for name, seed in (("one", "3"), ("two", "3"), ("other", "4")):
        assert call(*SHORT, "--output", name, "--seed", seed).exit_code == 0
    one, two, other = (Recording.load(f"{name}.h5") for name in ("one", "two", "other"))
    np.testing.assert_array_equal(one["measured"], two["measured"])
    assert not np.array_equal(one["desired"], other["desired"])
    assert not np.array_equal(one["measured"] - one["true"], other["measured"] - other["true"])


def named(_: object, path: Path) -> Path:
    """Stands for a picture: tests/test_report.py saves some."""
    path.touch()
    return path


def test_report_makes_the_same_page_again(monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(*SHORT).exit_code == 0
    first = Path("truestroke-track.html").read_text()
    monkeypatch.setattr("truestroke.report.style.save", named)
    done = call("report", "truestroke-track.h5", "--output", "again", "--plots", "pictures")
    assert done.exit_code == 0, done.output
    assert Path("again.html").read_text() == first
    assert not Path("again.h5").exists()
    names = {path.name for path in Path("pictures").iterdir()}
    assert {"tracking-light.png", "tracking-dark.png", "loop-light.png", "weights-dark.png"} <= names


@pytest.mark.usefixtures("_without_page")
def test_what_comes_next_is_suggested_of_the_simulated_stack_alone() -> None:
    assert "What next" in call(*SHORT).output
    simulated = Recording.load("truestroke-track.h5")
    Recording(simulated.channels, simulated.metadata | {"realtime": {}}).save("run.h5")
    done = call("report", "run.h5")
    assert (done.exit_code, "What next" in done.output) == (0, False)


@pytest.mark.usefixtures("_without_page")
@pytest.mark.parametrize(
    ("options", "check"),
    [
        (["--trajectory", "sine", "--frequency", "8"], lambda z: np.ptp(z[2000:]) == pytest.approx(22.8, abs=0.01)),
        (["--trajectory", "triangle"], lambda z: np.ptp(z) == pytest.approx(22.8, abs=0.1)),
        (["--trajectory", "staircase", "--peak-to-peak", "10"], lambda z: z.max() == pytest.approx(10, abs=0.01)),
        (["--trajectory", "raster", "--turn", "0.5"], lambda z: np.ptp(z) == pytest.approx(22.8, abs=0.1)),
        (["--trajectory", "step"], lambda z: set(np.unique(z[z.size // 2 :: 200].round(6))) == {0.0, 5.0}),
        (["--sample-rate", "1000"], lambda z: z.size == 2000),
        (["--velocity-limit", "300"], lambda z: 250 < np.abs(np.diff(z)).max() * 2000 < 310),
        (["--controller", "paper", "--plant", "matched"], lambda z: z.size == 4000),
    ],
)
def test_options_reach_the_run(options: list[str], check: Any) -> None:
    done = call(*SHORT, *options)
    assert done.exit_code == 0, done.output
    recording = Recording.load("truestroke-track.h5")
    assert check(recording["desired"])
    assert sorted(recording.metadata["command"].split()) == sorted(["truestroke", *SHORT, *options])


@pytest.mark.usefixtures("_without_page")
@pytest.mark.parametrize("plant", ["realistic", "matched"])
def test_a_sudden_change_shows_from_its_tick_on(plant: str) -> None:
    for name, options in (("as_it_was", []), ("changed", ["--change-at", "1.2"])):
        assert call(*SHORT, "--plant", plant, "--output", name, *options).exit_code == 0
    before, after = (Recording.load(f"{name}.h5")["true"] for name in ("as_it_was", "changed"))
    assert np.flatnonzero(before != after)[0] == 2400


@pytest.mark.usefixtures("_without_page")
def test_a_motion_from_a_file() -> None:
    time = np.arange(2000) / 1000
    motion = 10 * (1 - np.cos(2 * np.pi * 3 * time))
    Path("move.csv").write_text("t,z\n" + "\n".join(f"{t},{z}" for t, z in zip(time, motion, strict=True)))
    done = call("track", "--trajectory", "move.csv")
    assert done.exit_code == 0, done.output
    recording = Recording.load("truestroke-track.h5")
    np.testing.assert_allclose(recording["desired"][500:], motion[500:], atol=1e-9)
    assert recording.metadata["command"] == "truestroke track --trajectory move.csv"


@pytest.mark.parametrize(
    ("headings", "remedy"),
    [
        ("time (ms);drive (V);sensor (nm)", "which column is position? Head it z (um); there are column 1 'time'"),
        ("z (nm)", "which column is time? Head it t (s) or give the --sample-rate; there is column 1 'z'"),
        ("t (s);z (um);desired (um)", "(column 2 'z' (um), column 3 'desired' (um)); keep one of them in the file"),
    ],
)
def test_a_motion_whose_columns_are_not_known_is_refused_with_what_can_be_done(headings: str, remedy: str) -> None:
    """Python and a configuration name the column; no option of a command does."""
    row = [f"{k};{k / 10};{k / 20}".split(";")[: headings.count(";") + 1] for k in range(100)]
    Path("move.csv").write_text("\n".join([headings, *map(";".join, row)]) + "\n")
    done = call("track", "--trajectory", "move.csv")
    assert (done.exit_code, done.stdout) == (1, "")
    assert remedy in done.stderr


@pytest.mark.usefixtures("each_picture_once")
def test_rest_is_a_motion_like_any_other() -> None:
    Path("rest.csv").write_text("\n".join(["0.0"] * 1000))
    done = call("track", "--trajectory", "rest.csv", "--sample-rate", "1000", "--json")
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout, parse_constant=pytest.fail)  # no NaN or Infinity
    assert printed["true_maximum_um"] < 0.1
    assert printed["true_maximum_percent"] is None


@pytest.mark.parametrize(
    ("arguments", "said", "code"),
    [
        (["learn", "--averaged", "4000"], "'--averaged': 4000 s must be from 0 to 3600 s. See", 2),
        (["learn", "--averaged", "nan"], "--averaged = nan s: must be finite", 2),
        (["learn", "--passes", "0"], "'--passes': 0 must be from 1 to 1000. See", 2),
        (["track", "--duration", "-1"], "'--duration': -1 s must be 0.5 s or more", 2),
        (["track", "--peak-to-peak", "-3"], "--peak-to-peak = -3.0 um: must be above 0 um", 2),
        (["track", "--duration", "soon"], "'--duration': 'soon' is no number, in s and without the unit.", 2),
        (["track", "--frequency", "5kHz"], "'5kHz' is no number, in Hz and without the unit.", 2),
        (["track", "--seed", "1.5"], "'1.5' is no whole number.", 2),
        (["commission"], "Missing option '--config': `truestroke run --example` prints one. See: ", 2),
        (["export", "c"], "Missing option '--output': c: a new or empty folder; json, fmu: a file. See: ", 2),
        (["score"], "Missing argument 'MODEL': `truestroke identify` writes it. See: ", 2),
        (["playback"], "Missing argument 'WAVEFORM': `truestroke invert` writes it. See: ", 2),
        (
            ["report"],
            "Missing argument 'RECORDING': `truestroke run` or `truestroke track` writes it. See: ",
            2,
        ),
        (["track", "--strok", "3"], "No such option '--strok'. See: truestroke track --help", 2),
        (["track", "--overwrit"], "No such option '--overwrit'. Did you mean '--overwrite'? See: ", 2),
        (["track", "--voltage-limits", "0", "150"], "moves 30 um from -0.6 to 3.6 V, before its amplifier", 2),
        (["track", "--frequency", "1e9"], "--frequency = 1000000000.0 Hz: must be", 2),
        (["track", "--trajectory", "zigzag"], "zigzag", 2),
        (["track", "--trajectory", "none.csv"], "none.csv", 2),
        (["track", "--trajectory", "staircase", "--frequency", "3"], "--frequency means nothing", 2),
        (["track", "--trajectory", "sine", "--turn", "0.3"], "--turn means nothing to sine", 2),
        (["track", "--change-at", "99"], "--change-at = 99.0 s: must be between 0 and", 2),
        (["track", "--controller", "magic"], "magic", 2),
        (["track", "--output", "no/such/run"], "mkdir -p no/such", 1),
        (["track", "--output", "no such/run"], "mkdir -p 'no such'", 1),
        (["track", "--frequency"], "requires an argument. See: truestroke track --help", 2),
        (["track", "on"], "unexpected extra argument (on). See: truestroke track --help", 2),
        (["track", "--output", "."], "is a folder", 2),
        (["track", "--trajectory", "sine", "--velocity-limit", "3"], "--velocity-limit means nothing", 2),
        (["track", "--velocity-limit", "0"], "--velocity-limit = 0.0 um/s: must be above 0 um/s", 2),
        (["compare", "--duration", "0.5"], "'--duration': 0.5 s must be 1 s or more", 2),
        (["compare", "--output", "no/such/run"], "mkdir -p no/such", 1),
        (["reproduce", "fig5"], "'fig5' is not one of 'fig4', 'fig6'", 2),
        (["report", "none.h5"], "there is no file none.h5 in ", 2),
        (["bode", "--config", "no/stage.toml"], "there is no folder ", 2),
        (["track", "--model", "mine.toml"], "; `truestroke identify` writes it. See: ", 2),
        (["report", __file__], "not an HDF5 file; `truestroke examine` reads other records", 1),
        (["study", __file__], ": must be TOML (", 2),
        (["fly"], "No such command 'fly'", 2),
    ],
)
def test_errors_are_one_line_that_names_the_argument(arguments: list[str], said: str, code: int) -> None:
    done = call(*arguments)
    assert done.exit_code == code, done.output
    assert said in done.stderr
    assert done.stderr.startswith("truestroke: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    assert not list(Path().iterdir())


SWAPPED = {
    "score rec.csv model.toml": "MODEL rec.csv is a table of numbers, RECORD model.toml is a model: exchange them.",
    "unwarp rec.csv a.gsf --record rec.csv --model model.toml": "IMAGE rec.csv is a table of numbers; it must be an im",
    "unwarp a.gsf --record model.toml --model rec.csv": "--record model.toml is a model, --model rec.csv is a table",
    "score model.toml a.gsf": "RECORD a.gsf is an image; it must be a table of numbers or a recording.",
    "invert model.toml --model rec.csv": "TRAJECTORY model.toml is a model: exchange them.",
    "playback rec.csv --config model.toml": "it must be a configuration: `truestroke run --example` prints one.",
    "learn --dynamics model.toml --model dyn.toml": "--model dyn.toml is a file of dynamics: exchange them.",
    "report rec.csv": "it must be a recording: `truestroke run` or `truestroke track` writes it.",
}


@pytest.mark.parametrize("command", SWAPPED)
def test_a_file_in_the_place_of_another_is_known_by_what_is_in_it(command: str) -> None:
    """`score RECORD MODEL` was "must be TOML"."""
    shutil.copy(Path(__file__).with_name("vectors") / "scanner.toml", "model.toml")
    Path("dyn.toml").write_text('format = "truestroke dynamics"\n')
    Path("rec.csv").write_text("time (s),volts (V),z (um)\n0,0,0\n0.1,1,9.5\n0.2,2,19\n")
    Path("a.gsf").write_bytes(b"Gwyddion Simple Field 1.0\n")
    done = call(*command.split())
    assert (done.exit_code, done.stdout) == (2, "")
    assert SWAPPED[command] in done.stderr


def test_a_file_of_almost_the_same_name_is_proposed() -> None:
    Path("dynamics.toml").touch()
    done = call("track", "--dynamics", "dynamcs.toml")
    assert "there is no file dynamcs.toml in " in done.stderr
    assert "; did you mean dynamics.toml? See: " in done.stderr
    Path("sweep.csv").touch()
    assert "; did you mean sweep.csv? See: " in call("identify", "sweep.cvs").stderr
    Path("score.html").touch()
    assert "did you mean" not in call("run", "--config", "stage.toml").stderr


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("run stage.toml", "--config stage.toml"),
        ("bode stage.toml", "--config stage.toml"),
        ("track sine", "--trajectory sine"),
        ("track stage.toml", ""),
        ("compare nothing", ""),
    ],
)
def test_an_option_without_its_name_is_proposed(words: str, meant: str) -> None:
    Path("stage.toml").write_text('[driver]\nname = "simulated"\n[[axis]]\n')
    done = call(*words.split())
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert f"extra argument ({words.split()[1]}){f'; did you mean {meant}?' if meant else '.'} See: " in done.stderr


def test_of_files_that_differ_in_their_ending_the_one_that_fits_is_proposed() -> None:
    Path("two.toml").write_text('[driver]\nname = "simulated"\n[[axis]]\n')
    Path("two.h5").write_bytes(b"\x89HDF\r\n\x1a\n")  # as HDF5 begins
    for command, ending in (("report", "h5"), ("run --config", "toml")):
        done = call(*command.split(), "two")
        assert f"there is no file two in {Path.cwd()}; did you mean two.{ending}?" in done.stderr


def test_what_cannot_be_written_is_said_before_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("run.html").mkdir()
    monkeypatch.setattr("truestroke.cli.track._run", lambda *_: pytest.fail("it ran"))
    done = call("track", "--output", "run")
    assert done.exit_code == 1
    assert "run.html cannot be written; choose another --output" in done.stderr


@pytest.mark.parametrize("option", ["--output", "--plots"])
def test_a_full_disk_is_said_before_the_run(monkeypatch: pytest.MonkeyPatch, option: str) -> None:
    """A learned motion was output once, and then `No space left on device`."""
    monkeypatch.setattr("truestroke.cli.track._run", lambda *_: pytest.fail("it ran"))
    full = shutil._ntuple_diskusage(total=10**9, used=10**9 - 1000, free=1000)  # type: ignore[attr-defined]
    monkeypatch.setattr(shutil, "disk_usage", lambda _: full)
    done = call("track", option, "run")
    assert done.exit_code == 1
    assert f"{option} run: 0.0 MB are free on its disk, 5 MB are needed" in done.stderr.replace("run.h5", "run")


@pytest.fixture
def _two_rivals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tuning takes seconds, which most tests can spare."""
    line = Rival("line", "a ruler", "by eye", lambda: ConstantGain(12.2, (-0.6, 3.6), 3.0))
    known = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
    paper = Rival("paper", "Tan <et al.>", "as printed", lambda: AdaptiveController.paper(**known))
    monkeypatch.setattr("truestroke.studies.compare.prepare", lambda bench: iter([line, paper]))


@pytest.mark.usefixtures("each_picture_once")
@pytest.mark.usefixtures("_two_rivals")
def test_compare_prints_a_table_and_writes_a_page_with_the_tuning() -> None:
    done = call("compare", "--duration", "2", "--seed", "5", "--output", "rivals", "--plots", "pictures")
    assert done.exit_code == 0, done.output
    random, sine, files, _ = done.stdout.split("\n\n")
    assert re.split(r"  +", random.splitlines()[0].strip())[:3] == ["random wave, 1 to 2 s", "rmse", "of p-p"]
    assert sine.splitlines()[0].split()[-2:] == ["phase", "lag"]
    found = {line.split()[0]: float(line.split()[1]) for line in random.splitlines()[1:]}
    assert 0.3 < found["line"] < 1.5  # um: the hysteresis loop
    assert 0.01 < found["paper"] < 0.2
    # The same wave and noise as `track`, so the same error.
    assert call("track", "--duration", "2", "--seed", "5", "--controller", "paper").exit_code == 0
    assert found["paper"] == pytest.approx(errors(Path("truestroke-track.h5"))["true_rmse_um"], abs=1e-4)
    assert "rivals.html" in files
    page = Path("rivals.html").read_text()
    ET.fromstring(page.split("\n", 1)[1])  # well-formed
    for text in (
        f"{found['paper']:.4f} µm",
        "a ruler",
        "by eye",
        "Tan &lt;et al.&gt;",
        "compare --seed 5 --duration 2 --output rivals<",
    ):
        assert text in page
    assert page.count("<svg") == 4  # both as a phone shows them, too
    assert {path.name for path in Path("pictures").iterdir()} == {
        f"{name}-{theme}.png" for name in ("errors", "traces") for theme in ("light", "dark")
    }


@pytest.mark.usefixtures("_two_rivals")
def test_compare_as_json() -> None:
    done = call("compare", "--duration", "2", "--json")
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout, parse_constant=pytest.fail)
    assert [row["controller"] for row in printed["rows"]] == ["line", "line", "paper", "paper"]
    assert [row["wave"] for row in printed["rows"]] == ["random wave", "sine"] * 2
    assert printed["rivals"][0] == {"controller": "line", "source": "a ruler", "tuning": "by eye"}
    assert Path(printed["page"]).is_file()


@pytest.mark.usefixtures("each_picture_once")
def test_reproduce_puts_the_paper_beside_ours() -> None:
    done = call("reproduce", "fig10", "fig6", "--plots", "pictures")
    assert done.exit_code == 0, done.output
    ten, six = done.stdout.index("Fig. 10"), done.stdout.index("Fig. 6")
    assert ten < six  # in the order asked for
    row = re.search(r"^rmse, 10 to 20 s +0\.0584 +(0\.\d+)  um", done.stdout[:six], flags=re.MULTILINE)  # Table 1
    assert row
    assert 0.02 < float(row[1]) < 0.08
    page = Path("truestroke-reproduce.html").read_text()
    ET.fromstring(page.split("\n", 1)[1])
    assert page.count("<svg") == 4  # both as a phone shows them, too
    assert row[1] in page
    assert "truestroke reproduce fig10 fig6<" in page
    assert len(list(Path("pictures").iterdir())) == 4


def test_reproduce_as_json() -> None:
    done = call("reproduce", "fig10", "--json")
    assert done.exit_code == 0, done.output
    (fig10,) = json.loads(done.stdout, parse_constant=pytest.fail)["results"]
    assert fig10["name"] == "fig10"
    assert 0.0584 in [row["paper"] for row in fig10["rows"]]


def test_who_interrupts_the_pictures_is_told_of_the_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("truestroke.report.run_page", interrupted)
    done = call(*SHORT, "--output", "one")
    assert done.exit_code == 130
    told = "truestroke: the recording is in one.h5; its page: truestroke report one.h5"
    assert [line for line in done.stderr.splitlines() if line] == [told, "truestroke: interrupted"]
    assert len(Recording.load("one.h5")["time"]) > 0


@pytest.mark.usefixtures("_without_page")
def test_recovery_is_told_apart_from_convergence() -> None:
    for change, converged, recovered in (
        ("1.5", r"after \d\.\d\d s|from the start", "not known: there is less than 1 s after the change at 1.5 s"),
        ("0.4", "not known: the change comes within 1 s", "not known: there is less than 1 s before the change"),
    ):
        done = call(*SHORT, "--change-at", change)
        assert done.exit_code == 0, done.output
        assert re.search(rf"^converged  ({converged})$", done.stdout, flags=re.MULTILINE), done.stdout
        assert f"recovered  {recovered}" in done.stdout


@pytest.mark.usefixtures("each_picture_once")
@pytest.mark.parametrize(
    ("end", "code", "said"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated"), (signal.SIGHUP, 129, "terminated")],
)
def test_what_was_recorded_is_kept(monkeypatch: pytest.MonkeyPatch, end: signal.Signals, code: int, said: str) -> None:
    calls = iter(range(10**6))
    exchange = RealisticPlant.exchange

    def interrupted(plant: RealisticPlant, volts: Any) -> Any:
        if next(calls) == 1500:
            signal.raise_signal(end)
        return exchange(plant, volts)

    usual = signal.default_int_handler if end is signal.SIGINT else signal.SIG_DFL
    before = signal.signal(end, usual)  # under nohup it is ignored, and would stay so
    try:
        with monkeypatch.context() as patch:
            patch.setattr(RealisticPlant, "exchange", interrupted)
            done = call(*SHORT)
        assert signal.getsignal(end) == usual
    finally:
        signal.signal(end, before)
    assert done.exit_code == code
    assert done.stderr == f"truestroke: the 1500 ticks so far are in truestroke-track.h5\ntruestroke: {said}\n"
    rest = Recording.load("truestroke-track.h5")
    assert rest["time"].size == 1500
    assert call("report", "truestroke-track.h5").exit_code == 0


class _Interrupted:
    """Its finaliser is where Ctrl-C comes."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_ctrl_c_is_not_lost_in_a_finaliser(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python printed "Exception ignored in", and the run went on to its end."""
    instances, exchange = [_Interrupted()], RealisticPlant.exchange

    def interrupted(plant: RealisticPlant, volts: Any) -> Any:
        instances.clear()
        time.sleep(0.001)
        return exchange(plant, volts)

    monkeypatch.setattr(RealisticPlant, "exchange", interrupted)
    done = call("track", "--duration", "5")
    assert (done.exit_code, done.stderr.splitlines()[-1]) == (130, "truestroke: interrupted")


def test_ctrl_c_while_the_commands_are_loaded_is_a_line() -> None:
    code = (
        "import sys, truestroke.__main__ as start\n"
        "class Slow:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'truestroke.cli': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Slow())\n"
        "start.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "truestroke: interrupted\n")


def test_python_starts_it_too() -> None:
    command = [sys.executable, "-m", "truestroke", "trak"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (
        2, "truestroke: No such command 'trak'. Did you mean 'track'? See: truestroke --help\n"
    )  # fmt: skip


@pytest.mark.usefixtures("_two_rivals")
def test_a_comparison_that_is_interrupted_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RealisticPlant, "exchange", lambda *_: signal.raise_signal(signal.SIGTERM))
    done = call("compare", "--duration", "2")
    assert (done.exit_code, done.stderr) == (143, "truestroke: terminated\n")
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("called", "on_the_path", "shown"),
    [
        ("/usr/bin/truestroke", "/usr/bin/truestroke", "truestroke"),
        (".venv/bin/truestroke", None, ".venv/bin/truestroke"),
        ("/usr/bin/truestroke", None, "/usr/bin/truestroke"),
        ("/lib/truestroke/__main__.py", "/usr/bin/truestroke", "python -m truestroke"),
        ("-c", None, "truestroke"),
    ],
)
def test_suggestions_can_be_typed(
    monkeypatch: pytest.MonkeyPatch, called: str, on_the_path: str | None, shown: str
) -> None:
    monkeypatch.setattr("sys.argv", [called])
    monkeypatch.setattr("shutil.which", lambda name: on_the_path)
    assert program() == shown


def test_version() -> None:
    from truestroke import __version__

    assert call("--version").stdout == f"truestroke {__version__}\n"


@pytest.mark.usefixtures("each_picture_once")
def test_identify_writes_a_model_that_a_controller_starts_from(tmp_path) -> None:
    plant = RealisticPlant(seed=2)
    plant.open()
    volts = random_wave(duration=5.0, peak_to_peak=28.0, seed=4).position / 12.0
    time = np.arange(volts.size) / 2000.0
    table = np.column_stack([time, volts, plant.exchange(volts)])
    record, model = tmp_path / "record.csv", tmp_path / "stage.toml"
    np.savetxt(record, table, delimiter=",", header="t (s),x (V),z (um)", comments="", fmt="%.7f")
    done = CliRunner().invoke(main, ["identify", str(record), "--output", str(model), "--json"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.output)
    assert figures["rmse_percent"] < 0.5
    assert figures["model"] == str(model)
    controller = AdaptiveController.from_model(model, sample_rate=2000.0, voltage_limits=(-0.6, 3.6))
    assert controller.command(0.0, 0.0) == pytest.approx(0.0, abs=0.1)
    lost = CliRunner().invoke(main, ["identify", str(record), "--output", str(tmp_path / "none" / "m.toml")])
    assert lost.exit_code == 1
    assert f"; make it: mkdir -p {tmp_path / 'none'}" in lost.output.replace("\n", " ")


def test_no_command_imports_another_and_old_names_are_hidden() -> None:
    folder = Path(cli.__file__).parent
    for name in main.commands:
        imports = re.findall(r"from truestroke\.cli(?:\.(\w+))? import ([\w, ]+)", (folder / f"{name}.py").read_text())
        named = {word for package, words in imports for word in (package or words).split(", ")}
        assert named.isdisjoint(main.commands), f"{name} imports {named}"
    for old, new in RENAMED.items():
        assert CliRunner().invoke(main, [old, "--help"]).output == CliRunner().invoke(main, [new, "--help"]).output
        assert f"\n  {old} " not in CliRunner().invoke(main, ["--help"]).output


def test_the_list_of_commands_has_whole_sentences() -> None:
    listed = CliRunner().invoke(main, ["--help"], terminal_width=60).output.partition("Commands:")[2]
    sentences = re.split(r"\n  (?=\w)", listed.strip("\n"))
    assert len(sentences) == len(main.commands)
    assert all(re.search(r"(?<!\.)\.$", sentence) for sentence in sentences), listed


def test_a_folder_of_plots_that_cannot_be_made_is_refused_before_the_run(tmp_path) -> None:
    """Some seconds, or a scan on hardware, came before "No such file or directory"."""
    (tmp_path / "notes").write_text("")
    done = CliRunner().invoke(main, ["scan", "--plots", str(tmp_path / "notes" / "plots"), "--rate", "nan"])
    assert done.exit_code == 1
    assert f"{tmp_path / 'notes'} is a file; choose another folder." in done.output


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="a folder in which nobody can make a file, not even root")
def test_a_folder_that_only_seems_to_take_files_is_refused_before_the_run() -> None:
    """Permissions of root forbid nothing: "No such file or directory" came when all was computed."""
    for options in (["--plots", "/proc/plots"], ["--output", "/proc/scan"]):
        done = CliRunner().invoke(main, ["scan", "--rate", "nan", *options])
        assert done.exit_code == 1
        assert f"{' '.join(options).replace('scan', 'scan.html')}: " in done.output
        assert "choose another" in done.output


def test_the_old_name_of_plots_still_works_and_is_hidden() -> None:
    @click.command()
    @plots_option
    def command(plots: Path | None) -> None:
        click.echo(f"plots: {plots}")

    for words, folder in (((), None), (("--plots", "new"), "new"), (("--figures", "old"), "old")):
        assert CliRunner().invoke(command, words).stdout == f"plots: {folder}\n"
    assert "--figures" not in CliRunner().invoke(command, ["--help"]).stdout
