"""What is at the outputs when the host of a drop-in dies, stands still, or ends: read by another process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from running import until

from truestroke.dropins.axes import Axes
from truestroke.runtime.drivers import DriverError

CONFIGURATION = """
[driver]
name = "simulated"
sample_rate = 1000.0
block = 10
hardware_timed = true
register = "{register}"

[[axis]]
name = "z"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
safe_voltage = 0.25
slew = 3000.0
"""
HOST = """
import sys, time
from truestroke.dropins.axes import Axes
axes = Axes.of("stage.toml")
axes.open()
axes.move(z=12.0)["z"].result()
print("there", flush=True)
axes._thread.join()
print("ended", flush=True)
time.sleep(600)
"""


def output(folder: Path) -> float:
    """What a voltmeter shows, V."""
    return float(np.fromfile(folder / "volts")[0])


@pytest.fixture
def host(tmp_path):
    """A process whose axis rests at 12 um."""
    (tmp_path / "stage.toml").write_text(CONFIGURATION.format(register=tmp_path / "volts"))
    made = subprocess.Popen([sys.executable, "-c", HOST], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert made.stdout.readline() == b"there\n"
    assert output(tmp_path) > 0.5
    yield made
    if made.poll() is None:
        made.send_signal(signal.SIGCONT)
        made.kill()
    made.communicate()


def test_a_host_that_is_killed(host, tmp_path):
    host.kill()
    until(lambda: output(tmp_path) == 0.25, 60.0)
    assert b"attendant: the host is gone; output set to 0.25 V" in host.stderr.read()


def test_a_host_that_stands_still_is_not_killed_and_may_not_go_on(host, tmp_path):
    host.send_signal(signal.SIGSTOP)
    until(lambda: output(tmp_path) == 0.25, 60.0)
    host.send_signal(signal.SIGCONT)
    assert host.stdout.readline() == b"ended\n"
    assert host.poll() is None
    assert output(tmp_path) == 0.25


def test_an_axis_that_is_closed_leaves_nothing_behind(tmp_path):
    (tmp_path / "stage.toml").write_text(CONFIGURATION.format(register=tmp_path / "volts"))
    with Axes.of(tmp_path / "stage.toml") as axes:
        attendant = axes._attendant._process
        assert attendant.poll() is None
    assert attendant.poll() == 0
    assert output(tmp_path) == 0.25
    assert axes._attendant is None


def test_an_attendant_that_dies_ends_the_motion(tmp_path):
    (tmp_path / "stage.toml").write_text(CONFIGURATION.format(register=tmp_path / "volts"))
    axes = Axes.of(tmp_path / "stage.toml")
    axes.open()
    os.kill(axes._attendant._process.pid, signal.SIGKILL)
    axes._attendant._process.wait()
    until(lambda: axes._error is not None, 60.0)
    with pytest.raises(DriverError, match="the process that watches over the host has died"):
        axes.move(z=5.0)
    axes.close()
    assert output(tmp_path) == 0.25
