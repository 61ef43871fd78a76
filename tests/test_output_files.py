"""What commands write: complete or not at all, and never over what truestroke did not write."""

from __future__ import annotations

import json
import os
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from truestroke import Recording
from truestroke.base import files
from truestroke.cli import identify, main
from truestroke.cli.common import in_words_of, print_table
from truestroke.signals.recording import Channel
from truestroke.studies.study.config import example

pytestmark = pytest.mark.usefixtures("empty_folder")


def record(rows: int = 1200) -> None:
    """A record that can be identified, rec.csv."""
    t = np.arange(rows) / 2000.0
    x = 1.5 - 1.5 * np.cos(2 * np.pi * 5 * t) * np.linspace(0.2, 1, rows)
    z = 10 * x + 0.3 * np.sin(2 * np.pi * 5 * t)
    np.savetxt("rec.csv", np.column_stack([t, x, z]), delimiter=",", header="t,V,z", comments="")


COMMANDS: dict[str, tuple[list[str], str]] = {
    "track": (["track", "--duration", "0.5", "--output", "out"], "out.h5"),
    "track, page": (["track", "--duration", "0.5", "--output", "out"], "out.html"),
    "compare": (["compare", "--duration", "1", "--output", "out"], "out.html"),
    "reproduce": (["reproduce", "table1", "--output", "out"], "out.html"),
    "identify": (["identify", "rec.csv", "--output", "stage.toml"], "stage.toml"),
    "identify, page": (["identify", "rec.csv", "--report", "out.html"], "out.html"),
    "score": (["score", "rec.csv", "rec.csv"], "score.html"),
    "characterise": (["characterise", "--output", "stage"], "stage.toml"),
    "characterise, recording": (["characterise", "--output", "stage"], "stage.h5"),
    "bode": (["bode", "--output", "stage"], "stage.toml"),
    "bode, page": (["bode", "--output", "out"], "out.html"),
    "study": (["study", "study.toml", "--output", "out"], "out.html"),
    "robustness": (["robustness", "--plants", "1", "--output", "out"], "out.html"),
    "report": (["report", "run.h5", "--output", "out"], "out.html"),
    "invert": (["invert", "sine", "--model", "rec.csv", "--output", "wave.csv"], "wave.csv"),
    "refine": (["refine", "rec.csv", "--model", "rec.csv", "--output", "stage.toml"], "stage.toml"),
    "play": (["play", "rec.csv", "--config", "rec.csv", "--output", "record.csv"], "record.csv"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_what_truestroke_did_not_write_stays(name: str) -> None:
    """Refused before anything is computed; the message names the option."""
    words, target = COMMANDS[name]
    record()
    Path("study.toml").write_text(example())
    recording(3).save("run.h5")
    Path(target).write_text("precious")
    done = CliRunner().invoke(main, words)
    assert (done.exit_code, Path(target).read_text()) == (1, "precious"), done.output
    assert done.stderr.startswith(f"truestroke: {target}: is there ")
    assert done.stderr.endswith("; choose another name, or --overwrite it\n")


@pytest.mark.usefixtures("each_picture_once")
def test_an_output_may_end_as_its_recording_does() -> None:
    """It became out.hdf5.h5."""
    for ending in (".h5", ".hdf5"):
        invoked = CliRunner().invoke(main, ["track", "--duration", "0.5", "--output", f"out{ending}"])
        assert invoked.exit_code == 0
        assert {path.name for path in Path().iterdir()} == {f"out{ending}", "out.html"}
        Path(f"out{ending}").unlink()


@pytest.mark.usefixtures("each_picture_once")
def test_overwrite_says_that_it_may_go_and_what_is_ours_may_always() -> None:
    Path("out.html").write_text("<p>precious</p>")
    words = ["track", "--duration", "0.5", "--output", "out"]
    assert CliRunner().invoke(main, words).exit_code == 1
    assert CliRunner().invoke(main, [*words, "--overwrite"]).exit_code in (0, 4)
    assert files.PAGE.ours(Path("out.html"))
    assert CliRunner().invoke(main, words).exit_code in (0, 4)
    assert sorted(os.listdir()) == ["out.h5", "out.html"]


def test_a_page_of_another_command_stays() -> None:
    """`identify --output run.toml` writes no run.html over the page of the run; `report` may make that again."""
    head = '<meta name="generator" content="truestroke" />'
    Path("run.html").write_text(f'{head}<meta name="truestroke-command" content="run" />')
    with pytest.raises(FileExistsError, match="is not a page of truestroke identify that truestroke wrote"):
        files.check("run.html", files.page("identify"))
    files.check("run.html", files.page("report"))
    Path("old.html").write_text(head)
    files.check("old.html", files.page("identify"))


@pytest.mark.parametrize(
    ("option", "name", "right"),
    [
        ("output", "model.h5", "a model is no .h5 file; call it model.toml"),
        ("output", "a b.json", "a model is no .json file; call it a b.toml"),
        ("report", "page.PDF", "a page of truestroke identify is no .PDF file; call it page.html"),
    ],
)
def test_no_file_has_the_name_of_another_format(option: str, name: str, right: str) -> None:
    """`identify --output model.h5` wrote TOML."""
    record()
    done = CliRunner().invoke(main, ["identify", "rec.csv", f"--{option}", name])
    stated = f"truestroke: --{option} {name}: {right}. See: truestroke identify --help\n"
    assert (done.exit_code, done.stderr) == (2, stated)
    assert os.listdir() == ["rec.csv"]


def test_models_of_any_other_name_have_pages_of_their_own() -> None:
    """The page of stage.2 would have replaced that of stage.1; what is no format is a name."""
    for name, page in (("stage.1", "stage.1.html"), ("stage.toml", "stage.html"), ("my stäge", "my stäge.html")):
        assert identify._files(name, None) == (Path(name), Path(page))


def recording(ticks: int, **metadata: object) -> Recording:
    time = np.arange(ticks) / 2000.0
    names = {"time": "s", "desired": "um", "volts": "V", "measured": "um"}
    return Recording({name: Channel(time * 1.0, unit, name) for name, unit in names.items()}, metadata)


def test_a_recording_of_another_command_stays() -> None:
    """A measurement by `run` is no draft of `track`."""
    recording(9, command="truestroke run --config run.toml").save("out.h5")
    with pytest.raises(FileExistsError, match="is not a recording of truestroke track that truestroke wrote"):
        recording(9, command="truestroke track").save("out.h5")
    with files.overwriting():
        recording(9, command="truestroke track").save("out.h5")
    recording(8, command="truestroke track --seed 2").save("out.h5")
    assert len(Recording.load("out.h5")["time"]) == 8


@pytest.mark.parametrize("ticks", [2, 19])
def test_report_of_a_short_recording_is_a_line(ticks: int) -> None:
    recording(ticks).save("short.h5")
    done = CliRunner().invoke(main, ["report", "short.h5"])
    assert done.exit_code == 1
    assert done.stderr == f"truestroke: short.h5: {ticks} ticks, a page needs at least 20\n"


@pytest.mark.parametrize(("ticks", "why"), [(0, "Nothing was recorded."), (1, "No measurement came in")])
def test_report_of_nothing_is_a_bad_verdict(ticks: int, why: str) -> None:
    recording(ticks).save("empty.h5")
    done = CliRunner().invoke(main, ["report", "empty.h5"])
    assert done.exit_code == 4
    assert why in done.stdout
    assert not Path("empty.html").exists()


def test_a_writer_that_fails_leaves_what_was_there() -> None:
    files.write("page.html", '<meta name="generator" content="truestroke" /> old', files.PAGE)

    def fails() -> None:
        with files.writing("page.html", files.PAGE) as draft:
            draft.write_text("half")
            raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        fails()
    assert Path("page.html").read_text().endswith("old")
    assert os.listdir() == ["page.html"]


def test_a_link_stays_a_link_and_a_device_a_device() -> None:
    Path("real.html").touch()
    Path("page.html").symlink_to("real.html")
    files.write("page.html", "new", files.PAGE)
    assert (Path("page.html").is_symlink(), Path("real.html").read_text()) == (True, "new")
    files.write("/dev/null", "new", files.PAGE)
    assert Path("/dev/null").is_char_device()


def test_pictures_are_known_by_what_made_them() -> None:
    from truestroke.report import style

    for ending in ("png", "svg", "pdf"):
        with style.use(style.LIGHT):
            figure, _ = style.panels(2.0)
        path = style.save(figure, f"a.{ending}")
        assert files.PICTURE.ours(path)
    Path("a.png").write_bytes(b"\x89PNG another's")
    with pytest.raises(FileExistsError):
        style.save(figure, "a.png")


# ---- In the words of the reader ------------------------------------------------------------------------------------


@click.command()
@click.option("--drop-bad-rows", is_flag=True)
@click.option("--slew")
def command() -> None:
    """With two options."""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a.csv: bad; `drop_bad_rows` leaves it out", "a.csv: bad; --drop-bad-rows leaves it out"),
        ("slew_limit = 0 V/s: must be above 0", "--slew = 0 V/s: must be above 0"),
        ("`rate_dependent` = 0: must be", "rate_dependent = 0: must be"),
        ("rate_dependent = 0: must be", "rate_dependent = 0: must be"),
    ],
)
def test_the_name_of_an_argument_becomes_the_option(text: str, told: str) -> None:
    assert in_words_of(command, text) == told


def test_a_bad_row_names_the_option() -> None:
    record()
    rows = Path("rec.csv").read_text().splitlines()
    Path("rec.csv").write_text("\n".join([*rows[:9], "0.004,oops,1", *rows[10:]]))
    done = CliRunner().invoke(main, ["examine", "rec.csv"])
    assert done.stderr.endswith("line 10: volts is missing or no number in '0.004,oops,1'; --drop-bad-rows leaves such "
                                "rows out\n")  # fmt: skip


NARROW = (("controller", "distortion", "rms"), [("open loop", "60.30 px", "32.76 px"), ("paper", "1204 px", "271 px")])


@pytest.mark.parametrize(
    ("columns", "lines"),
    [
        ("32", ["controller  distortion       rms", "open loop     60.30 px  32.76 px"]),  # the words are whole
        ("28", ["controller  open loop    paper", "distortion   60.30 px  1204 px"]),  # rows and columns exchanged
        ("10", ["controller  open loop    paper", "distortion   60.30 px  1204 px"]),  # too wide, but whole
    ],
)
def test_a_narrow_terminal_cuts_no_cell_off(monkeypatch: pytest.MonkeyPatch, columns: str, lines: list[str]) -> None:
    """Of the images of a scan at 60 columns the names of the controllers were gone."""
    monkeypatch.setenv("COLUMNS", columns)
    printed = CliRunner().invoke(click.command()(lambda: print_table(*NARROW))).output
    assert [line.rstrip() for line in printed.splitlines()][:2] == lines


def test_a_cell_is_no_markup() -> None:
    """A column that is called [red] is a name."""
    record()
    Path("[red].csv").write_text(Path("rec.csv").read_text())
    done = CliRunner().invoke(main, ["examine", "[red].csv"])
    assert (done.exit_code, done.exception) == (0, None)
    assert "[red].csv" in done.stdout


def test_a_record_may_be_a_recording_with_ticks_without_a_measurement() -> None:
    """`examine` and `identify` read it: lost samples, and the last ticks of a driver with latency, are NaN."""
    record()
    t, x, z = np.loadtxt("rec.csv", delimiter=",", skiprows=1).T
    z[[5, 700, -1, -2]] = np.nan
    channels = {"time": Channel(t, "s", "t"), "volts": Channel(x, "V", "x"), "measured": Channel(z, "um", "z")}
    Recording(channels, {}).save("run.h5")
    done = CliRunner().invoke(main, ["examine", "run.h5", "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["dropped"] == 4


def test_a_pipe_is_written_into() -> None:
    """And not replaced: `--output /dev/stdout` has no other name."""
    out, into = os.pipe()
    files.write(f"/proc/self/fd/{into}", "a model", files.MODEL)
    assert os.read(out, 100) == b"a model"
    os.close(out)
    os.close(into)


def test_a_folder_that_cannot_be_written_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a recording that grows as of any other file; root may write everywhere, so the system's answer is set."""
    monkeypatch.setattr("os.access", lambda place, mode: False)
    with pytest.raises(PermissionError, match="cannot be written: no permission; choose another folder"):
        files.check_growing(tmp_path / "run.h5", False, lambda _: True)
    with pytest.raises(PermissionError, match="choose another folder"):
        files.check(tmp_path / "run.html", files.MEASUREMENT)
