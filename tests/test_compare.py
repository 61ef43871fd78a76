"""The table of rivals: its figures are right, its rivals no straw men, and the documentation shows what it gives."""

import inspect
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from printed import assert_prints

from truestroke.cli import main
from truestroke.control.baselines import ConstantGain
from truestroke.control.settings import ControllerSettings
from truestroke.plant import RealisticPlant
from truestroke.signals.timing import Timing
from truestroke.signals.trajectories import random_wave, sine
from truestroke.studies.compare import Workbench, compare, prepare, run

LIMITS = (-0.6, 3.6)
ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "compare.md"


class Late:
    """10 um/V, some ticks late, 0.1 um too high."""

    def __init__(self, ticks=0):
        self.ticks = ticks

    def open(self):
        self.queue = [0.0] * self.ticks
        return Timing(sample_rate=2000.0)

    def exchange(self, volts):
        self.queue.append(float(volts[0]))
        return np.array([10.0 * self.queue.pop(0) + 0.1])


def test_the_figures_of_a_known_error():
    """Three ticks are 1.5 ms, and 360 * 8 * 0.0015 = 4.32 degrees at 8 Hz; an offset is no delay."""
    waves = [sine(frequency=8.0, peak_to_peak=20.0, duration=2.0), random_wave(peak_to_peak=20.0, duration=2.0)]
    controllers = {"gain": lambda: ConstantGain(10.0, LIMITS)}
    for ticks, lag in ((0, 0.0), (3, 4.32)):
        on_sine, on_wave = compare(lambda ticks=ticks: Late(ticks), waves, controllers)
        assert (on_sine.wave, on_wave.wave) == ("sine", "random wave")
        assert on_sine.phase_lag_deg == pytest.approx(lag, abs=1e-6)
        assert on_wave.phase_lag_deg is None
        for row in (on_sine, on_wave):
            assert row.delay_ms == pytest.approx(ticks / 2, abs=0.02)
            assert row.summary.true_rmse_um is None
        if ticks == 0:
            assert on_sine.summary.measured_rmse_um == pytest.approx(0.1)
            assert on_sine.summary.measured_rmse_percent == pytest.approx(0.5, rel=1e-3)


@pytest.fixture(scope="module")
def comparison():
    steps = []
    result = run(progress=lambda done, everything: steps.append((done, everything)))
    assert steps == [(k, len(steps)) for k in range(1, len(steps) + 1)]
    return result


def figures(comparison, wave):
    return {row.controller: row for row in comparison.rows if row.wave == wave}


def test_all_rivals_are_on_both_waves(comparison):
    names = [rival.name for rival in comparison.rivals]
    assert names[0] == "no compensation"
    assert len(names) == len(set(names)) == 8
    assert [(row.controller, row.wave) for row in comparison.rows] == list(
        itertools.product(names, ["random wave", "sine"])
    )


def test_no_rival_is_a_straw_man(comparison):
    """Identified inverses take away nine tenths of the hysteresis, as Ang and Kuhnen report; nobody has bursts."""
    random, sines = figures(comparison, "random wave"), figures(comparison, "sine")
    nothing = random["no compensation"].summary.true_rmse_um
    assert 0.02 < random["no compensation"].summary.true_rmse_percent / 100 < 0.07
    for name, row in random.items():
        if name != "no compensation":
            assert row.summary.true_rmse_um < 0.2 * nothing, name
            assert row.summary.true_maximum_um < 1.0, name
            assert abs(sines[name].phase_lag_deg) < 0.5, name
            assert row.summary.true_rmse_um < row.summary.measured_rmse_um, name
    assert 4 < sines["no compensation"].phase_lag_deg < 8  # hysteresis of some 20 % looks like that


def test_the_paper_is_the_paper(comparison):
    """rmse about 0.1 um and maximum about 0.4 um on its waves (Table 2)."""
    paper = figures(comparison, "random wave")["the paper"].summary
    assert 0.02 < paper.measured_rmse_um < 0.15
    assert paper.measured_maximum_um < 0.8


def test_the_same_seed_gives_the_same_table(comparison):
    settings = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=LIMITS)
    bench = Workbench(actuator=RealisticPlant(seed=1), settings=settings, seed=1)
    some = list(itertools.islice(prepare(bench), 4))
    assert [rival.tuning for rival in some] == [rival.tuning for rival in comparison.rivals[:4]]
    waves = [random_wave(duration=20.0, seed=0)]
    (row,) = compare(lambda: RealisticPlant(seed=0), waves, {"again": some[3].make})
    np.testing.assert_array_equal(
        row.recording["measured"], figures(comparison, "random wave")[some[3].name].recording["measured"]
    )


def test_the_table_is_plain_data(comparison):
    again = json.loads(json.dumps(comparison.as_dict()))
    assert len(again["rows"]) == 2 * len(again["rivals"]) == 16
    assert again["rows"][1]["phase_lag_deg"] == comparison.rows[1].phase_lag_deg


def test_the_documentation_shows_this_table(comparison):
    shown = {}
    for line in PAGE.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 7 and re.fullmatch(r"-?[\d.]+", cells[1]):
            shown[cells[0]] = [float(cell) for cell in cells[1:]]
    random, sines = figures(comparison, "random wave"), figures(comparison, "sine")
    assert list(shown) == list(random)
    for name, cells in shown.items():
        wave, on_sine = random[name], sines[name]
        # Kernel and libm differ a little between machines: adaptive rivals amplify that.
        assert cells[:4] == pytest.approx(
            [
                wave.summary.true_rmse_um,
                wave.summary.true_maximum_um,
                on_sine.summary.true_rmse_um,
                on_sine.summary.true_maximum_um,
            ],
            rel=0.1,
            abs=0.002,
        )
        assert cells[4:] == pytest.approx([wave.delay_ms, on_sine.phase_lag_deg], abs=0.03)


@pytest.mark.usefixtures("each_picture_once")
def test_the_readme_shows_what_the_command_prints(comparison, monkeypatch, tmp_path):
    """With its defaults, which are those of `run`; tests/test_cli.py runs the command itself."""
    command, expected = re.search(
        r"^\$ truestroke (compare.*)\n((?:.+\n)+?)```", (ROOT / "README.md").read_text(), re.M
    ).groups()
    asked = []
    monkeypatch.setattr(
        "truestroke.studies.compare.run", lambda progress, **options: asked.append(options) or comparison
    )
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, command.split(), env={"COLUMNS": "120", "NO_COLOR": "1"})
    assert done.exit_code == 0, done.output
    assert asked == [{name: inspect.signature(run).parameters[name].default for name in ("seed", "duration")}]
    assert_prints(expected, done.output, tolerance=0.05)
