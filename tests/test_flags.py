"""The flags stand in one place; the table for readers, the kernel and a recording say the same."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from truestroke import AdaptiveController, Flags, Timing, metrics, run, trajectories
from truestroke.base.flags import BIT, BY_ADAPT, FLAGS
from truestroke.report import words
from truestroke.signals.channels import QUANTITIES

DOCS = Path(__file__).parents[1] / "docs"


def test_the_table_for_readers_is_the_one_of_the_code():
    rows = re.findall(r"^\| (\d) \| (\d+) \| `(\w+)` \| (.+) \|$", (DOCS / "conventions.md").read_text(), re.MULTILINE)
    assert rows == [(str(i), str(flag.bit), flag.name, flag.meaning) for i, flag in enumerate(FLAGS)]
    assert sum(flag.bit for flag in FLAGS) < 256  # a byte a tick
    assert all(f"{flag.bit} {flag.name}" in QUANTITIES["flags"][1] for flag in FLAGS)


def test_every_bit_is_a_member_and_is_counted_and_said():
    for flag in FLAGS:
        assert getattr(Flags.from_bits(flag.bit), flag.name)
        assert Flags.from_bits(255 - flag.bit) == Flags(**{f.name: f is not flag for f in FLAGS})
        t = np.arange(4000) / 2000.0
        record = {"time": t, "desired": np.sin(t), "measured": np.sin(t), "flags": np.zeros(4000, np.uint8)}
        record["flags"][:7] = flag.bit
        (said,) = words.flags(metrics.summary(record))
        assert said.startswith(f"{flag.words} in 7 ticks")


class Spring:
    """10 um/V, whose sensor sees nothing above 12 um."""

    def open(self):
        return Timing(sample_rate=2000.0)

    def exchange(self, volts):
        return np.where(volts > 1.2, np.nan, 10.0 * volts)


def test_the_bits_of_the_kernel_are_these():
    controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 1.5), slew_limit=25.0)
    recording = run(trajectories.sine(frequency=4.0, peak_to_peak=28.0, duration=1.0), controller, Spring())
    for name in ("saturated", "slewed", "rejected", "projected"):
        assert np.count_nonzero(recording["flags"] & BIT[name]) == getattr(controller.counters, name), name
    seen = {name: np.flatnonzero(recording["flags"] & BIT[name]) for name in ("saturated", "slewed", "rejected")}
    assert set(recording["volts"][seen["saturated"]]) == {1.5}
    assert np.array_equal(seen["rejected"], np.flatnonzero(np.isnan(recording["measured"])))
    steps = np.abs(np.diff(recording["volts"], prepend=0.0))
    alone = np.setdiff1d(seen["slewed"], seen["saturated"])  # a limit may make the step smaller
    assert steps[alone] == pytest.approx(25.0 / 2000)
    assert all(index.size > 20 for index in seen.values())
    controller.hold()
    assert controller.flags.held
    assert controller.flag_bits & BIT["held"]
    assert BIT["rejected"] & BY_ADAPT
    assert not BIT["saturated"] & BY_ADAPT
