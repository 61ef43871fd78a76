"""The first move of a controller that knows nothing, on soft stages of another structure."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from benchmarks.changing_motion import rise
from benchmarks.first_move import largest_error
from benchmarks.foreign_stages import sampled, travel

from truestroke import AdaptiveController
from truestroke.control.guard import FirstGain
from truestroke.control.reference import ReferenceController


@pytest.mark.parametrize(
    ("number", "wide", "most"),
    [(5200, 1.0, 40.0), (5204, 1.0, 15.0), (5209, 1.0, 25.0), (5204, 5.0, 70.0), (5209, 5.0, 70.0)],
    ids=[
        "220 % before",
        "360 % before",
        "325 % before",
        "limits too wide: 197 % before",
        "limits too wide: 168 % before",
    ],
)
def test_a_stage_that_rings_in_the_first_move_is_calmed_while_its_gain_is_learned(number, wide, most) -> None:
    """121 to 189 Hz, half of the travel within 0.1 s: largest error, % of the move."""
    assert largest_error(number, 0.1, False, wide) < most


@pytest.mark.parametrize("number", [5218, 5222, 5223])
def test_a_first_move_with_f0_given_does_not_wait_with_the_gain(number: int) -> None:
    """Limits five times too wide, half of the travel within 30 ms: 325 to 349 % while learning waited a period."""
    assert largest_error(number, 0.03, True, 5.0) < 60


def test_kernel_and_text_in_a_first_move_with_limits_that_are_too_wide() -> None:
    """The gain is learned in the pause, and what follows from it: to the last bit; the sensor is not zeroed."""
    (bottom, top), (stage, _) = travel(sampled(5209)[0]), sampled(5209)
    low, high = stage.limits
    kernel = AdaptiveController(
        sample_rate=stage.rate,
        stroke=stage.stroke,
        voltage_limits=(5 * low, 5 * high),
        slew_limit=100 * (high - low),
    )
    text, moving, zero = ReferenceController(kernel.settings), round(0.1 * stage.rate), 0.2 * stage.stroke
    positions, velocities = (bottom + top) / 2 * rise(moving, stage.rate)[:2]
    stage.open()
    for z_d, zdot_d in zip(zero + positions, velocities, strict=True):
        volts = kernel.command(z_d, zdot_d)
        assert text.command(z_d, zdot_d) == volts
        z = zero + float(stage.exchange(np.array([volts]))[0])
        kernel.adapt(z), text.adapt(z)
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert kernel.counters.oscillating == text.counters["oscillating"] == 1
    assert list(dataclasses.asdict(kernel.counters).values()) == list(text.counters.values())


def test_the_first_gain_is_that_of_the_measurements_beside_an_oscillation() -> None:
    gain, time = FirstGain(0.01, 0.01), np.arange(400) / 5000.0
    expected = 20.0 * time
    for x, ringing in zip(expected, np.sin(2 * np.pi * 120.0 * time), strict=True):
        gain.update(x + 1.0, 5.0 * x + 2.0 + ringing)
    assert gain.ratio == pytest.approx(5.0, rel=0.05)
    assert gain.offset == pytest.approx(2.0 - 5.0 * 1.0, rel=0.05)


def test_a_gain_of_the_wrong_sign_is_not_shown() -> None:
    gain = FirstGain(0.01, 0.01)
    for k in range(400):
        gain.update(0.01 * k, -0.01 * k)
    assert not gain.shown
