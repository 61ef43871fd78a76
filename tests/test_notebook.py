"""What a notebook shows, by Jupyter's own kernel: a bar while a run goes on, pictures of what comes of it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from examples.notebooks import cell, document

RUN = """import numpy as np
import truestroke
from truestroke import plant, trajectories
wave = trajectories.random_wave(duration=2.0, velocity_limit=300.0)
controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
recording = truestroke.run(wave, controller, plant.RealisticPlant(seed=0))
recording"""
IDENTIFY = "found = truestroke.identify(recording, branches=False)\nfound"
ASKED = "_ = truestroke.run(wave, controller, plant.RealisticPlant(seed=0), progress=lambda done, of: None)"


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> list[list[dict[str, Any]]]:
    """Of each cell, in the order of the page."""
    folder = tmp_path_factory.mktemp("notebook")
    cells = [cell(str(i), "code", text) for i, text in enumerate((RUN, IDENTIFY, ASKED))]
    (folder / "a.ipynb").write_text(document(cells))
    execute = "from nbclient.cli import main; main()"
    options = ["--inplace", "--timeout=600", "--startup_timeout=300"]
    command = [sys.executable, "-c", execute, str(folder / "a.ipynb"), *options]
    done = subprocess.run(command, cwd=Path(__file__).parent.parent, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return [one["outputs"] for one in json.loads((folder / "a.ipynb").read_text())["cells"]]


def page(output: dict[str, Any]) -> str:
    return "".join(output["data"]["text/html"])


def test_a_bar_goes_when_the_run_is_done(outputs: list[list[dict[str, Any]]]) -> None:
    for shown in outputs[:2]:
        assert [output["output_type"] for output in shown] == ["display_data", "execute_result"]
        assert page(shown[0]) == ""
    assert outputs[2] == []  # who asks for another progress has that


def test_a_run_and_a_model_are_pictures_that_a_screen_reader_names(outputs: list[list[dict[str, Any]]]) -> None:
    for shown, words in zip(outputs[:2], ("desired and actual displacement", "measured and predicted"), strict=True):
        html = page(shown[-1])
        alt, light = re.search(r'<img alt="([^"]*)".*?src="data:image/png;base64,([^"]*)"', html).groups()
        assert words in alt
        assert 5_000 < len(light) < 300_000
        assert html.count("data:image/png") == 2  # light and dark
        assert not re.search(r"\bum\b", re.sub(r'base64,[^"]*', "", html))
    assert "held out" in page(outputs[1][-1])
