"""Plays and dead zones: against exact fractions, and by the properties that Krejci and Brokate prove of them."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truestroke import ControllerSettings, _kernel, _kernel32
from truestroke.control.settings import kernel_settings
from truestroke.model.operators import dead_zone, play_history

FORWARD = json.loads((Path(__file__).parent / "vectors" / "forward.json").read_text())
IDS = [f"{len(case['r'])} plays, {len(case['d'])} dead zones" for case in FORWARD]


def kernel_play_history(x, r, kernel=_kernel):
    """The kernel's bank: with w_h = [1, 0, ...] it is the identity, so that z_d is the voltage."""
    wide = {"sample_rate": 1.0, "stroke": 30.0, "voltage_limits": (-1e6, 1e6), "slope_limits": (1e-3, 1e9)}
    settings = ControllerSettings.paper(**wide, thresholds=tuple(r), initial_sensitivity=1.0, rate_scale=0.0)
    k = kernel.Kernel(kernel_settings(settings))
    states = np.empty((len(x), len(r)))
    for i, x_i in enumerate(x):
        k.command(x_i, 0.0)
        states[i] = k.play()
    return states


BANKS = pytest.mark.parametrize("bank", [play_history, kernel_play_history], ids=["numpy", "kernel"])
Bank = Callable[..., np.ndarray]
volts = st.floats(-4.0, 4.0)
histories = st.lists(volts, min_size=1, max_size=12)
thresholds = st.lists(st.floats(0.01, 3.0), min_size=1, max_size=6, unique=True).map(lambda r: [0.0, *sorted(r)])
ROUNDING = 1e-14  # V; the kernel reaches its x through the inverse, which rounds
quick = settings(derandomize=True, max_examples=80, deadline=None)


@pytest.mark.parametrize("case", FORWARD, ids=IDS)
def test_plays_are_the_exact_ones(case) -> None:
    exact = np.array(case["states"])
    np.testing.assert_allclose(play_history(case["x"], case["r"], case["y0"]), exact, rtol=0, atol=1e-15)
    np.testing.assert_allclose(kernel_play_history(case["x"], case["r"]), exact, rtol=0, atol=ROUNDING)
    single = kernel_play_history(case["x"], case["r"], _kernel32)
    np.testing.assert_allclose(single, exact, rtol=0, atol=2e-6)  # 24 bits on 8 V are 0.5e-6 V


def test_the_first_sample_starts_from_y0() -> None:
    """(2): 0.2 is within reach of 1 - 1.5 ... 1 + 1.5 and stays; 0 is not within 1 -+ 0.5."""
    np.testing.assert_array_equal(play_history([1.0], [0.5, 1.5], [0.0, 0.2]), [[0.5, 0.2]])


def test_dead_zones_by_hand() -> None:
    expected = [[-3.0, 0.0, 0.0], [12.0, 0.0, 0.0], [16.0, 4.0, 0.0], [30.0, 18.0, 10.0]]
    np.testing.assert_array_equal(dead_zone([-3.0, 12.0, 16.0, 30.0], [0.0, 12.0, 20.0]), expected)
    np.testing.assert_array_equal(dead_zone(16.0, [0.0, 12.0, 20.0]), expected[2])


@BANKS
@quick
@given(x=histories, r=thresholds)
def test_states_are_nested(bank: Bank, x, r) -> None:
    """y_i + r_i ascend and y_i - r_i descend: the breakpoints of the inverse are in order without sorting."""
    y = bank(x, r)
    assert (np.diff(y + r, axis=1) >= -ROUNDING).all()
    assert (np.diff(y - r, axis=1) <= ROUNDING).all()


@BANKS
@quick
@given(x=histories, r=thresholds, turn=volts, end=volts, between=st.floats(0.0, 1.0))
def test_return_point_memory(bank: Bank, x, r, turn, end, between) -> None:
    """A closed minor loop is forgotten: end, inside, end leaves the states that the first end left."""
    inside = min(max(turn + between * (end - turn), min(turn, end)), max(turn, end))
    y = bank([*x, turn, end, inside, end], r)
    np.testing.assert_allclose(y[-1], y[-3], rtol=0, atol=ROUNDING)


@BANKS
@quick
@given(first=histories, second=histories, r=thresholds, low=volts, high=volts, path=st.lists(volts, max_size=8))
def test_congruence(bank: Bank, first, second, r, low, high, path) -> None:
    """Loops between the same turning points have the same shape whatever came before."""
    loop = [low, high, *np.clip(path, min(low, high), max(low, high))]
    a, b = bank([*first, *loop], r)[-len(loop) + 1 :], bank([*second, *loop], r)[-len(loop) + 1 :]
    np.testing.assert_allclose(a - a[0], b - b[0], rtol=0, atol=ROUNDING)


@BANKS
@quick
@given(x=histories, r=thresholds, rise=histories)
def test_monotone_input_moves_every_state_one_way(bank: Bank, x, r, rise) -> None:
    top = max(x[-1], *rise)
    up = sorted(v for v in [*rise, top] if v >= x[-1])
    y = bank([*x, *up], r)[len(x) - 1 :]
    assert (np.diff(y, axis=0) >= -ROUNDING).all()
