"""docs/house.md is true: its packages are those of the code, in the order of imports, and its lists of files exist."""

from __future__ import annotations

import dataclasses
import functools
import re
import tomllib
from pathlib import Path

import pytest

from truestroke import cli
from truestroke.base.flags import FLAGS
from truestroke.control.settings import ControllerSettings
from truestroke.model.layout import TERMS
from truestroke.plant import EFFECTS

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src/truestroke"
PAGE = (ROOT / "docs/house.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
DRIVERS = {  # name: class, of the hardware; the simulated stack is part of many tests and examples
    name: place.partition(":")[2]
    for name, place in PROJECT["project"]["entry-points"]["truestroke.drivers"].items()
    if name != "simulated"
}
NAMES = {  # of what exists already, by row
    "driver": list(DRIVERS),
    "command": list(cli.COMMANDS),
    "drop-in for a host": ["ophyd", "pymmcore", "qudi"],
    "figure or table of the paper": [],
}


def rows(heading: str) -> list[list[str]]:
    """The cells of each row of the table whose first heading this is."""
    table = re.search(rf"^\| {re.escape(heading)} \|.*\n\|[-|]+\n((?:\|.*\n)+)", PAGE, flags=re.MULTILINE)
    assert table, f"docs/house.md has no table of {heading}"
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table[1].splitlines()]


PLACES = {row[0]: re.findall(r"`([^`]+)`", row[1]) for row in rows("a new ...")}


def files(row: str, name: str = "NAME") -> list[Path]:
    """The files that a row lists, for something of this name; Python files stand without src/truestroke."""
    paths = [path.replace("NAME", name) for path in PLACES[row]]
    return [next((p for p in (SOURCE / path, ROOT / path) if p.exists()), ROOT / path) for path in paths]


@functools.cache
def texts(folder: str) -> dict[Path, str]:
    """What the source files in this folder hold."""
    kinds = {".py", ".pyi", ".c", ".h", ".cpp"}
    every = [p for p in (ROOT / folder).rglob("*") if p.suffix in kinds and "build" not in p.parts]
    return {p: p.read_text() for p in every}


def naming(word: str, *folders: str) -> set[Path]:
    """The files in these folders that contain the word."""
    whole = re.compile(rf"\b{re.escape(word)}\b")
    return {p for folder in folders for p, text in texts(folder).items() if word in text and whole.search(text)}


def test_packages_are_in_the_order_of_imports() -> None:
    layers = PROJECT["tool"]["importlinter"]["contracts"][0]["layers"]
    assert [row[0].strip("`/") for row in rows("package")] == layers[::-1]


@pytest.mark.parametrize("row", rows("package"), ids=lambda row: row[0].strip("`/"))
def test_every_module_is_named(row: list[str]) -> None:
    folder = SOURCE / row[0].strip("`/")
    modules = {p.stem for p in folder.glob("[!_]*.py")}
    packages = {f"{p.parent.name}/" for p in folder.glob("*/__init__.py")}
    assert set(re.findall(r"`([^`]+)`", row[2])) == modules | packages


@pytest.mark.parametrize("row", rows("folder"), ids=lambda row: row[0])
def test_every_folder_exists(row: list[str]) -> None:
    assert all((ROOT / folder).is_dir() for folder in re.findall(r"`([^`]+)`", row[0]))


@pytest.mark.parametrize("row", PLACES)
def test_every_file_of_a_row_exists(row: str) -> None:
    for name in NAMES.get(row, ["NAME"]):
        assert [str(path) for path in files(row, name) if not path.exists()] == []


@pytest.mark.parametrize(("name", "driver"), DRIVERS.items())
def test_a_driver_is_named_in_its_files_alone(name: str, driver: str) -> None:
    listed = files("driver", name)
    assert naming(driver, "src", "c") == {path for path in listed if SOURCE in path.parents}
    assert all(name in path.read_text() for path in listed if path.suffix in {".toml", ".md"})


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_a_command_is_named_in_its_files_alone(name: str) -> None:
    module, table, readme = files("command", name)
    assert f'"{name}"' in table.read_text()
    assert re.search(rf"^\| .*`(?:truestroke )?{name}\b", readme.read_text(), flags=re.MULTILINE) or name == "report"
    assert naming(f"truestroke.cli.{name}", "src") | naming(f"cli import {name}", "src") <= {module, table}


@pytest.mark.parametrize("name", TERMS)
def test_a_term_is_named_in_its_files(name: str) -> None:
    listed = files("term of the model")
    of_kernel = {path for path in listed if path.suffix in {".c", ".h"}}
    assert [str(path) for path in set(listed) - of_kernel if not re.search(name, path.read_text(), re.IGNORECASE)] == []
    family = name.partition("_")[0]  # of which the kernel makes all terms in one line
    assert of_kernel <= naming(f"TS_{family.upper()}", "c/src", "c/include")
    if name == "asymmetry":  # which no other part of the law has to know
        assert naming("TS_ASYMMETRY", "c/src", "c/include") == of_kernel


@pytest.mark.parametrize("flag", [flag.name for flag in FLAGS])
def test_a_flag_is_named_in_its_files(flag: str) -> None:
    listed = files("flag of a tick")
    at_all = [path for path in listed if path.name != "controller.py" or flag == FLAGS[-1].name]
    assert [str(path) for path in at_all if path.is_file() and flag not in path.read_text()] == []
    sets = naming(f"flags.{flag}", "c/src")
    assert sets, "no part of the kernel sets it"
    if flag == "oscillating":  # whose name is no other word
        named = naming(flag, "src", "c/src", "c/include", "c/loops")
        in_folders = {p for p in named if p.parent in listed}
        assert named - in_folders == {p for p in listed if p.is_file() and p.suffix != ".md"}


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(ControllerSettings)])
def test_a_setting_is_named_in_its_files(name: str) -> None:
    listed = {path.name: path.read_text() for path in [*files("setting of the controller"), SOURCE / "model/layout.py"]}
    assert name in listed["settings.py"] or name in listed["layout.py"]
    assert name in listed["options.py"] or name in {"sample_rate", "stroke", "voltage_limits"}
    assert f"`{name}`" in listed["settings.md"]


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_is_named_in_its_files(effect: str) -> None:
    settings, *_, page, _ = files("effect of the simulated plant")
    assert f'"{effect}"' in settings.read_text()
    assert f"`{effect}`" in page.read_text()


def test_pages_have_one_template() -> None:
    assert [p.name for p in SOURCE.rglob("*.html.j2")] == ["page.html.j2"]
    assert {p for p in SOURCE.rglob("*.py") if "import jinja2" in p.read_text()} == {
        SOURCE / "report/page.py",
        SOURCE / "export/texts.py",  # no pages: C and XML
    }


OF_ONE_SYSTEM = re.compile(  # portable are SIGINT, SIG_IGN and SIG_DFL
    r"/proc/|/sys/|sys\.platform|os\.name\b|os\.uname|platform\.(?:system|machine|release)\b"
    r"|os\.(?:sched_|getuid|geteuid|nice|fork)|signal\.SIG(?!INT\b|_IGN|_DFL)|SO_(?:BINDTODEVICE|EXCLUSIVEADDRUSE)"
    r"|import (?:fcntl|resource|msvcrt|winreg|termios)\b|hasattr\((?:os|signal|socket|mmap|time), "
)


def test_what_differs_between_systems_is_in_one_module() -> None:
    found = [
        f"{path.relative_to(SOURCE)}: {line.strip()}"
        for path in sorted(SOURCE.rglob("*.py"))
        if path != SOURCE / "base/system.py"
        for line in path.read_text().splitlines()
        if OF_ONE_SYSTEM.search(line)
    ]
    assert found == []
    assert len(OF_ONE_SYSTEM.findall((SOURCE / "base/system.py").read_text())) > 20
