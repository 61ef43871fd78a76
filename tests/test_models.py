"""Models forward and inverse, NumPy and kernel: against exact fractions, and forward(inverse(y)) = y."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truestroke import ControllerSettings, SettingError, _kernel, _kernel32
from truestroke.control.settings import kernel_settings
from truestroke.model.layout import Layout
from truestroke.model.models import (
    ModifiedPrandtlIshlinskii,
    Motion,
    PrandtlIshlinskii,
    RateDependentModel,
    asymmetry_terms,
    creep_step,
    inverse_dead_zones,
    inverse_parameters,
    known_terms,
    limit_slopes,
    play_inverse,
    play_inverse_literal,
    play_terms,
)
from truestroke.model.operators import dead_zone, play, play_history
from truestroke.model.sampled import creep_states

VECTORS = Path(__file__).parent / "vectors"
FORWARD = json.loads((VECTORS / "forward.json").read_text())
INVERSE = json.loads((VECTORS / "inverse.json").read_text())
quick = settings(derandomize=True, max_examples=100, deadline=None)


def rate_dependent(case) -> RateDependentModel:
    return RateDependentModel(**{k: case[k] for k in ("r", "a", "b", "d", "w_s")}, rate_scale=case["c_b"])


def kernel_of(case, kernel=_kernel):
    wide = {"sample_rate": 1.0, "stroke": 30.0, "voltage_limits": (-1e6, 1e6), "slope_limits": (1e-3, 1e9)}
    settings = ControllerSettings.paper(
        **wide,
        thresholds=tuple(case["r"]),
        dead_zone_thresholds=tuple(case["inverse_d"]),
        dead_zone_weights=tuple(case["inverse_w_s"]),
        initial_weights=tuple(w for pair in zip(case["a"], case["b"], strict=True) for w in pair),
        rate_scale=case["c_b"],
    )
    k = kernel.Kernel(kernel_settings(settings))
    k.hold(True)
    return k


# ---- Exact fractions -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", FORWARD, ids=lambda case: f"{len(case['r'])}-{len(case['d'])}")
def test_forward_models_are_the_exact_ones(case) -> None:
    r, d, x, zdot_d = case["r"], case["d"], case["x"], case["zdot_d"]
    close = {"rtol": 1e-13, "atol": 1e-13}
    plain = PrandtlIshlinskii(r=r, w_h=case["a"])
    modified = ModifiedPrandtlIshlinskii(r=r, w_h=case["a"], d=d, w_s=case["w_s"])
    model = rate_dependent(case)
    np.testing.assert_allclose(plain.predict(x), case["y_3"], **close)
    np.testing.assert_allclose(modified.predict(x), case["z_5"], **close)
    np.testing.assert_allclose(model.predict(x, zdot_d), case["z_8"], **close)
    y = np.zeros(len(r))
    for k in range(len(x)):
        steps = plain.step(x[k], y)[0], modified.step(x[k], y)[0], model.step(x[k], zdot_d[k], y)[0]
        np.testing.assert_allclose(steps, [case["y_3"][k], case["z_5"][k], case["z_8"][k]], **close)
        y = plain.step(x[k], y)[1]


@pytest.mark.parametrize("case", INVERSE, ids=lambda case: f"{len(case['r'])}-{len(case['d'])}")
def test_the_inverse_is_the_exact_one_with_weights_that_change_at_every_tick(case) -> None:
    exact = np.array(case["x"])
    model = rate_dependent(case)
    w_s, d = inverse_dead_zones(case["w_s"], case["d"])
    np.testing.assert_allclose(w_s, case["inverse_w_s"], rtol=1e-13)
    np.testing.assert_allclose(d, case["inverse_d"], rtol=1e-13)
    np.testing.assert_allclose(dead_zone(case["z_d"], d) @ w_s, case["y_d"], rtol=1e-13)  # (11)
    np.testing.assert_allclose(model.invert(case["z_d"], case["zdot_d"]), exact, rtol=0, atol=1e-12)

    states = np.vstack([np.zeros(len(case["r"])), play_history(exact, case["r"])])
    weights = model.weights(case["zdot_d"])
    for y, w_h, y_d, x, expected in zip(states, weights, case["y_d"], exact, case["inverse_parameters"], strict=False):
        for ours, theirs in zip(inverse_parameters(w_h, case["r"], y), expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-12)  # (10)
        assert play_inverse(y_d, np.cumsum(w_h), case["r"], y) == pytest.approx(x, abs=1e-12)


@pytest.mark.parametrize(("kernel", "bound"), [(_kernel, 1e-12), (_kernel32, 2e-5)], ids=["double", "float"])
@pytest.mark.parametrize("case", INVERSE, ids=lambda case: f"{len(case['r'])}-{len(case['d'])}")
def test_the_kernel_s_command_is_the_exact_one(case, kernel, bound) -> None:
    """In volts; single precision: 24 bits on 30 um and slopes down to 0.5 um/V."""
    k = kernel_of(case, kernel)
    volts = [k.command(z_d, zdot_d) for z_d, zdot_d in zip(case["z_d"], case["zdot_d"], strict=True)]
    np.testing.assert_allclose(volts, case["x"], rtol=0, atol=bound)


# ---- Properties ------------------------------------------------------------------------------------------------------


@st.composite
def banks(draw, ticks=12):
    """Thresholds, and for every tick admissible weights (every partial sum 0.2 to 20 um/V) and a target."""
    n = draw(st.integers(1, 8))
    steps = draw(st.lists(st.floats(0.01, 0.5), min_size=n, max_size=n))
    slope_rows = st.lists(st.floats(0.2, 20.0), min_size=n, max_size=n)
    slopes = np.array(draw(st.lists(slope_rows, min_size=ticks, max_size=ticks)))
    targets = draw(st.lists(st.floats(-30.0, 30.0), min_size=ticks, max_size=ticks))
    return np.cumsum([0.0, *steps[1:]]), slopes, targets


@quick
@given(bank=banks())
def test_forward_undoes_inverse_and_the_walk_is_the_print(bank) -> None:
    r, slope_rows, targets = bank
    y = np.zeros(r.size)
    for slopes, y_d in zip(slope_rows, targets, strict=True):
        w_h = np.diff(slopes, prepend=0.0)
        x = play_inverse(y_d, slopes, r, y)
        assert play_inverse_literal(y_d, w_h, r, y) == pytest.approx(x, rel=1e-9, abs=1e-9)
        y = play(x, r, y)
        assert w_h @ y == pytest.approx(y_d, rel=1e-11, abs=1e-11)


@quick
@given(bank=banks(ticks=3), start=st.lists(st.floats(-3, 3), min_size=1, max_size=5), rise=st.lists(st.floats(0, 2)))
def test_monotone_input_gives_monotone_output(bank, start, rise) -> None:
    r, slope_rows, _ = bank
    model = PrandtlIshlinskii(r=r, w_h=np.diff(slope_rows[0], prepend=0.0))
    x = np.concatenate([start, start[-1] + np.cumsum(rise)])
    assert (np.diff(model.predict(x)[len(start) - 1 :]) >= -1e-11).all()


@quick
@given(
    sums=st.lists(st.floats(0.2, 5.0), min_size=1, max_size=5),
    gaps=st.lists(st.floats(0.1, 10.0), min_size=5, max_size=5),
    z=st.floats(-30.0, 60.0),
)
def test_dead_zones_and_their_inverse_undo_each_other(sums, gaps, z) -> None:
    w_s, d = np.diff(sums, prepend=0.0), np.cumsum([0.0, *gaps])[: len(sums)]
    w_s1, d1 = inverse_dead_zones(w_s, d)
    assert dead_zone(dead_zone(z, d1) @ w_s1, d) @ w_s == pytest.approx(z, rel=1e-9, abs=1e-9)
    twice = inverse_dead_zones(w_s1, d1)
    np.testing.assert_allclose(twice[0], w_s, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(twice[1], d, rtol=1e-9, atol=1e-9)


def test_the_published_stack_is_undone_within_rounding_at_every_rate() -> None:
    """Sec. 4.3: a wave of 30 um whose rate passes 300 um/s both ways."""
    stack = RateDependentModel(
        r=np.arange(8) / 8 * 1.5,
        a=[8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23],
        b=[-0.9, 1.03, -0.244, 0.1, 0.05, -0.02, 0.01, -0.01],
        d=[0.0, 12.0, 20.0],
        w_s=[1.0, 0.06, -0.04],
    )
    phase = np.linspace(0, 25, 1000)
    z_d, zdot_d = 15 - 15 * np.cos(phase), 300 * np.sin(phase)
    np.testing.assert_allclose(stack.predict(stack.invert(z_d, zdot_d), zdot_d), z_d, rtol=0, atol=1e-11)


# ---- Limits ----------------------------------------------------------------------------------------------------------


def test_the_singularity_has_no_inverse_and_the_guard_keeps_off_it() -> None:
    with pytest.raises(SettingError, match=r"w_h = .* um/V: must be numbers whose partial sums are all above 0"):
        inverse_parameters([1.0, -1.0], [0.0, 0.5], [0.0, 0.0])
    slopes, moved = limit_slopes(np.array([1.0, 0.0, 4.0]), (0.3, 3.0))
    assert moved
    np.testing.assert_array_equal(slopes, [1.0, 0.3, 3.0])
    assert not limit_slopes(np.array([0.3, 3.0]), (0.3, 3.0))[1]
    slopes, moved = limit_slopes(np.array([np.nan, np.inf]), (0.3, 3.0))
    assert moved
    np.testing.assert_array_equal(slopes, [0.3, 3.0])


# ---- Terms -----------------------------------------------------------------------------------------------------------


def test_creep_states_are_the_step_response_of_a_first_order_lag() -> None:
    """1 V from tick 0 on: 1 - exp(-t / tau) after each tick."""
    tau, T = np.array([0.003, 0.3]), 1 / 2000.0
    c = np.zeros(2)
    for tick in range(1, 400):
        c = creep_step(c, 1.0, 1 - np.exp(-T / tau))
        np.testing.assert_allclose(c, 1 - np.exp(-tick * T / tau), rtol=1e-12)


def test_creep_states_of_a_record_are_those_of_its_ticks_from_rest_at_its_first_voltage() -> None:
    x = 3.0 + np.random.default_rng(0).normal(size=300)
    c, expected = np.full(2, x[0]), []
    for volts in [x[0], *x[:-1]]:
        c = creep_step(c, volts, 1 - np.exp(-1 / 2000.0 / np.array([0.003, 0.3])))
        expected.append(c)
    np.testing.assert_allclose(creep_states(x, (0.003, 0.3), 2000.0), np.transpose(expected), rtol=1e-12)
    assert creep_states(x, (), 2000.0) == []


@quick
@given(s=st.floats(0.0, 1.0))
def test_asymmetry_vanishes_at_the_ends_and_is_even_and_odd_about_the_middle(s) -> None:
    first, second = asymmetry_terms(30.0 * s, 30.0)
    assert asymmetry_terms(0.0, 30.0) == asymmetry_terms(30.0, 30.0) == (0.0, 0.0)
    mirrored = asymmetry_terms(30.0 * (1 - s), 30.0)
    np.testing.assert_allclose(mirrored, [first, -second], rtol=0, atol=1e-12)
    assert 0 <= first <= 1
    assert abs(second) <= 0.7699  # 4 / (3 sqrt 3) at s = (1 - 1 / sqrt 3) / 2
    assert np.isfinite(asymmetry_terms(1e300, 30.0)).all()


def test_the_terms_stand_in_the_order_of_the_layout() -> None:
    layout = Layout(thresholds=(0.0, 0.2, 0.4), rate_dependent=(0, 2), creep_times=(0.3,), asymmetry=2)
    states = np.array([1.0, 2.0, 3.0])
    assert play_terms(layout, states, 10.0).tolist() == [1.0, 10.0, 2.0, 3.0, 30.0]
    assert known_terms(layout, np.array([0.7]), Motion(15.0, 50.0), 30.0).tolist() == [0.7, 50.0, 1.0, 1.0, 0.0]
    none = Layout(thresholds=(0.0,), lag=False, offset=False)
    assert known_terms(none, np.zeros(0), Motion(15.0, 50.0), 30.0).size == 0


def test_terms_along_a_record_are_those_of_each_sample() -> None:
    layout = Layout(thresholds=(0.0, 0.2), rate_dependent=(1,), creep_times=(0.3,), asymmetry=1)
    states, creep, z, rate = (
        np.arange(6.0).reshape(2, 3),
        np.array([[0.1, 0.2, 0.3]]),
        5.0 * np.arange(3),
        np.arange(3.0),
    )
    plays, known = play_terms(layout, states, rate), known_terms(layout, creep, Motion(z, rate), 30.0)
    for k in range(3):
        assert plays[:, k].tolist() == play_terms(layout, states[:, k], float(rate[k])).tolist()
        assert (
            known[:, k].tolist() == known_terms(layout, creep[:, k], Motion(float(z[k]), float(rate[k])), 30.0).tolist()
        )


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"r": [0.1, 0.2]}, "r = .* V: must be numbers that start at 0"),
        ({"a": [1.0]}, "a = .* um/V: must be 2 numbers, one for each of r"),
        ({"b": [1.0, np.nan]}, r"b\[1\] = nan um/V: must be finite"),
        ({"w_s": [1.0, 2.0]}, "w_s = .*: must be 1 numbers, one for each of d"),
        ({"rate_scale": np.inf}, "rate_scale = inf s/um: must be finite"),
    ],
)
def test_a_bad_model_is_named(bad, words) -> None:
    with pytest.raises(SettingError, match=words):
        RateDependentModel(**({"r": [0.0, 0.5], "a": [5.0, 1.0], "b": [0.0, 0.0]} | bad))


def test_the_displacement_less_its_asymmetry_is_the_sum_of_the_other_terms() -> None:
    """Within the stroke, below it, and beyond twice of it, where the asymmetry is constant; of any number of terms."""
    weights, sums = np.array([0.5, 2.0]), np.linspace(-70.0, 100.0, 171)
    known = np.vstack([np.cos(sums), np.full(sums.size, 3.0)])
    for asymmetry in (np.zeros(0), np.array([1.0]), np.array([1.0, -0.1])):
        z = np.empty_like(sums)
        _kernel.displacement(sums, known, weights, asymmetry, 30.0, z)
        curve = sum((w * term for w, term in zip(asymmetry, asymmetry_terms(z, 30.0), strict=False)), np.zeros(z.size))
        np.testing.assert_allclose(z - curve, sums + weights @ known, rtol=0, atol=1e-11)
