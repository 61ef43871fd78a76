"""The inverse without singularity: against (12), the mapping iterated with (10) and (12), a grid, and the plant."""

import numpy as np
import pytest
from benchmarks.singularity_free_inverse import mapped_weights, singularity_free_inverse
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from truestroke.base.checks import SettingError
from truestroke.model.models import play_inverse_literal
from truestroke.model.operators import dot, play, play_history
from truestroke.plant import MatchedPlant
from truestroke.plant.settings import MatchedSettings

R = np.array([0.0, 0.2, 0.5, 0.9, 1.4])  # V
LIMITS = (-2.0, 4.0)  # V
slopes = st.lists(st.floats(-6, 14).map(lambda s: round(s, 2)), min_size=R.size, max_size=R.size)
steep_slopes = slopes.map(lambda sums: [s + np.copysign(0.5, s) for s in sums])
positive_slopes = st.lists(st.floats(0.5, 14), min_size=R.size, max_size=R.size)
histories = st.lists(st.floats(*LIMITS), min_size=1, max_size=6)  # V
gaps = st.floats(-20, 20)  # um


def weights_of(partial_sums):
    return np.diff(partial_sums, prepend=0.0)


def after(history):
    return play_history(history, R)[-1]


def output(x, w, y):
    return float(w @ play(x, R, y))


@given(positive_slopes, histories, gaps)
def test_it_is_the_inverse_of_the_paper_where_all_slopes_are_positive(partial_sums, history, gap):
    w, y = weights_of(partial_sums), after(history)
    y_d = float(dot(w, y)) + gap
    assert singularity_free_inverse(y_d, w, R, y) == pytest.approx(play_inverse_literal(y_d, w, R, y), abs=1e-9)


@settings(max_examples=40)
@given(steep_slopes, st.floats(1, 14), histories, gaps, st.floats(0.1, 5))
def test_it_is_the_limit_of_the_mapping_whatever_c(partial_sums, last, history, gap, margin):
    """x = Gamma'^-1[y_d + c x], repeated from the last input with (10) and (12) of the mapped plays as printed."""
    w, y = weights_of([*partial_sums[:-1], last]), after(history)
    gap += np.sqrt(2) / 1000  # so that y_d does not just touch a corner: there rounding decides
    y_d = float(dot(w, y)) + gap
    w_mapped, c = mapped_weights(w, margin)
    x, step = y[0], np.inf
    for _ in range(3000):
        x, before = play_inverse_literal(y_d + c * x, w_mapped, R, y), x
        step = x - before
        assert step * np.sign(gap) >= -1e-9  # no overshoot, so it is the first solution that is found
        if abs(step) < 1e-13:
            break
    assume(abs(step) < 1e-13)  # just past a corner the iteration creeps
    assert singularity_free_inverse(y_d, w, R, y) == pytest.approx(x, abs=1e-9)


@given(slopes, histories, gaps)
def test_within_limits_no_input_comes_closer(partial_sums, history, gap):
    w, y = weights_of(partial_sums), after(history)
    y_d = float(dot(w, y)) + gap
    x = singularity_free_inverse(y_d, w, R, y, LIMITS)
    grid = np.concatenate([np.linspace(*LIMITS, 601), np.clip(np.concatenate([y - R, y + R]), *LIMITS)])
    assert LIMITS[0] <= x <= LIMITS[1]
    assert abs(output(x, w, y) - y_d) <= min(abs(output(g, w, y) - y_d) for g in grid) + 1e-9


@given(slopes, histories, gaps)
def test_of_all_exact_inputs_it_is_the_first_in_the_direction_of_the_gap(partial_sums, history, gap):
    w, y = weights_of(partial_sums), after(history)
    y_d = float(dot(w, y)) + gap
    x = singularity_free_inverse(y_d, w, R, y, LIMITS)
    between = np.linspace(y[0], x, 400)[1:-1]
    if abs(output(x, w, y) - y_d) < 1e-9 and (x - y[0]) * gap > 0:
        assert all((y_d - output(b, w, y)) * np.sign(gap) >= -1e-9 for b in between)


@given(st.floats(0.5, 14), histories, st.sampled_from([-1.0, 1.0]))
def test_the_input_is_monotone_and_bounded_as_a_slope_passes_zero(last, history, direction):
    """The first slope falls from 2 to -2 um/V: the answer to one rise moves out steadily, through the singular zero."""
    y = after(history)
    answers = []
    for first in np.linspace(2, -2, 41):
        w = weights_of([first, last, last, last, last])
        answers.append(direction * (singularity_free_inverse(float(dot(w, y)) + direction, w, R, y) - y[0]))
    reach = 2 * R[1] + (1 + 2 * 2 * R[1]) / last  # to the first corner and back up what the fall has cost
    assert np.all(np.diff(answers) >= -1e-12)
    assert answers[0] > 0
    assert answers[-1] <= reach + 1e-12


def test_the_published_stack_is_followed_through_its_singularity():
    """Sec. 4.3: w_h0 is below zero above 1333 um/s. The simulated plant, which is other code, goes where it is told."""
    stack = MatchedSettings(noise=0.0)
    t = np.arange(2000) / 2000.0
    z_d, zdot_d = 14 - 14 * np.cos(2 * np.pi * 20 * t), 14 * 2 * np.pi * 20 * np.sin(2 * np.pi * 20 * t)
    plant = MatchedPlant(velocity=zdot_d, settings=stack)
    r, y, truth = np.array(stack.thresholds), np.zeros(8), []
    a, b = np.array(stack.a), np.array(stack.b)
    for z, v in zip(z_d, zdot_d, strict=True):
        x = singularity_free_inverse(z, a + stack.rate_scale * v * b, r, y, (-0.6, 3.6))
        y = play(x, r, y)
        truth += plant.exchange(np.array([x])).tolist()
    assert zdot_d.max() > 1700
    np.testing.assert_allclose(truth, z_d, rtol=0, atol=1e-12)


def test_rest_is_rest_and_zero_is_no_division():
    y = after([1.0, 0.7])
    for partial_sums in ([-1.0, 2, 3, 4, 5], [0.0, 0, 0, 0, 0], [-1.0, -2, -3, -4, -5]):
        w = weights_of(partial_sums)
        assert singularity_free_inverse(float(dot(w, y)), w, R, y, LIMITS) == 0.7
    assert singularity_free_inverse(7.0, np.zeros(5), R, y) == 0.7  # nothing helps: stay


def test_the_mapping_is_the_least_that_is_needed():
    w, c = mapped_weights([8.0, -10.0, 5.0], 0.25)
    assert c == 2.25
    np.testing.assert_array_equal(np.cumsum(w), [10.25, 0.25, 5.25])
    assert mapped_weights([8.0, 1.0], 0.25)[1] == 0.0
    with pytest.raises(SettingError, match=r"slope_min = 0\.0 um/V"):
        mapped_weights([1.0], 0.0)
    with pytest.raises(SettingError, match=r"w_h\[1\] = nan"):
        mapped_weights([1.0, np.nan], 0.5)
