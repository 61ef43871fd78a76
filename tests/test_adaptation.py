"""Laws: (23) against 50 digits and against batch least squares, LMS by its defining properties."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truestroke import ControllerSettings, SettingError, _kernel, _kernel32
from truestroke.control.adaptation import (
    LMS,
    RETURN_EVERY,
    RLS,
    BoundedKalman,
    KalmanSettings,
    UpdateRefused,
    rls_update,
)
from truestroke.control.settings import kernel_settings
from truestroke.model.operators import play_history

LOOP = json.loads((Path(__file__).parent / "vectors" / "loop.json").read_text())
quick = settings(derandomize=True, max_examples=50, deadline=None)


def regressors(case, x):
    H = play_history(x, case["r"])
    return np.stack([H, case["c_b"] * np.array(case["zdot_d"])[:, None] * H], axis=-1).reshape(len(x), -1)


def run_kernel(case, kernel=_kernel, **other):
    """The loop of Sec. 3.3 in the kernel: voltages, innovations, weights of every tick, and P after the last."""
    wide = {"sample_rate": 1.0, "stroke": 30.0, "voltage_limits": (-1e6, 1e6), "slope_limits": (1e-3, 1e9)}
    law = {"forgetting": case["lambda"], "regularization": case["delta"], "covariance_limit": 1e9} | other
    start = {"thresholds": tuple(case["r"]), "initial_weights": tuple(case["w0"]), "rate_scale": case["c_b"]}
    k = kernel.Kernel(kernel_settings(ControllerSettings.paper(**wide, **start, **law)))
    x, e_m, w = [], [], []
    for z_d, zdot_d, z_a in zip(case["z_d"], case["zdot_d"], case["z_a"], strict=True):
        x.append(k.command(z_d, zdot_d))
        k.adapt(z_a)
        e_m.append(k.innovation())
        w.append(k.weights().astype(float))
    return np.array(x), np.array(e_m), np.array(w), np.asarray(k.covariance(), dtype=float)


# ---- RLS -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", LOOP, ids=lambda case: f"{len(case['r'])} plays")
def test_rls_is_the_exact_one(case) -> None:
    law = RLS(case["w0"], forgetting=case["lambda"], regularization=case["delta"])
    printed = np.array(case["w0"]), np.eye(len(case["w0"])) / case["delta"]
    for u, z_a, e_m, w in zip(regressors(case, case["x"]), case["z_a"], case["e_m"], case["w"], strict=True):
        assert z_a - law.weights @ u == pytest.approx(e_m, abs=1e-11)
        law.update(u, e_m)
        printed = rls_update(*printed, u, e_m, case["lambda"])
        np.testing.assert_allclose(law.weights, w, rtol=0, atol=1e-11)
        np.testing.assert_allclose(printed[0], w, rtol=0, atol=1e-11)
    for P in (law.P, printed[1]):
        np.testing.assert_allclose(P, case["P"], rtol=0, atol=1e-12 * np.max(case["P"]))


@pytest.mark.parametrize(("kernel", "bound"), [(_kernel, 1e-11), (_kernel32, 2e-3)], ids=["double", "float"])
@pytest.mark.parametrize("case", LOOP, ids=lambda case: f"{len(case['r'])} plays")
def test_the_kernel_s_loop_is_the_exact_one(case, kernel, bound) -> None:
    """Bounds in V, um and um/V; P relative to its largest entry. Errors of one tick come back in the next command."""
    x, e_m, w, P = run_kernel(case, kernel)
    np.testing.assert_allclose(x, case["x"], rtol=0, atol=bound)
    np.testing.assert_allclose(e_m, case["e_m"], rtol=0, atol=bound)
    np.testing.assert_allclose(w, case["w"], rtol=0, atol=bound)
    np.testing.assert_allclose(P, case["P"], rtol=0, atol=bound * np.max(case["P"]))


@pytest.mark.parametrize("case", LOOP, ids=lambda case: f"{len(case['r'])} plays")
def test_lambda_1_is_regularised_batch_least_squares(case) -> None:
    """min |y - U w|^2 + delta |w - w0|^2: w0 is the mean, I / delta the covariance of the prior."""
    x, _, w_kernel, P_kernel = run_kernel(case, forgetting=1.0)
    U, delta = regressors(case, x), case["delta"]
    m = U.shape[1]
    stacked = np.vstack([U, np.sqrt(delta) * np.eye(m)])
    y = np.concatenate([case["z_a"], np.sqrt(delta) * np.array(case["w0"])])
    batch = np.linalg.lstsq(stacked, y)[0]
    law = RLS(case["w0"], forgetting=1.0, regularization=delta)
    for u, z_a in zip(U, case["z_a"], strict=True):
        law.update(u, z_a - law.weights @ u)
    for w, P in ((law.weights, law.P), (w_kernel[-1], P_kernel)):
        np.testing.assert_allclose(w, batch, rtol=0, atol=1e-10)
        np.testing.assert_allclose(P @ (U.T @ U + delta * np.eye(m)), np.eye(m), rtol=0, atol=1e-9)


def test_forgetting_is_exponentially_weighted_least_squares() -> None:
    """The data of k ticks ago counts lambda^k; so does the prior."""
    rng = np.random.default_rng(3)
    U, y, lambda_ = rng.standard_normal((60, 3)), rng.standard_normal(60), 0.95
    law = RLS([1.0, 2.0, 3.0], forgetting=lambda_, regularization=0.5)
    for u, y_k in zip(U, y, strict=True):
        law.update(u, y_k - law.weights @ u)
    root = np.sqrt(lambda_ ** np.arange(59, -1, -1))
    prior = np.sqrt(0.5 * lambda_**60) * np.eye(3)
    batch = np.linalg.lstsq(np.vstack([root[:, None] * U, prior]), np.concatenate([root * y, prior @ [1.0, 2.0, 3.0]]))[
        0
    ]
    np.testing.assert_allclose(law.weights, batch, rtol=0, atol=1e-12)


def test_p_stops_growing_at_its_limit_and_stays_definite_at_rest() -> None:
    law = RLS([5.0, 0.0, 0.0], forgetting=0.9, regularization=1e-3, covariance_limit=1e9)
    u = np.array([2.0, 1.7, 0.3])
    for _ in range(3000):
        law.update(u, 0.01)
    assert np.trace(law.P) <= 1e9
    assert 0 < u @ law.P @ u < 1e-3  # 1 / 3000, had nothing been forgotten


@pytest.mark.parametrize("make", [RLS, LMS, lambda w: LMS(w, normalised=False, step_size=0.1)])
def test_a_law_refuses_what_is_not_finite_and_does_not_change(make) -> None:
    law = make([1.0, 2.0])
    for u, e_m in (([1.0, 1.0], np.nan), ([1.0, 1.0], np.inf)):
        with pytest.raises(UpdateRefused):
            law.update(np.array(u), e_m)
    np.testing.assert_array_equal(law.weights, [1.0, 2.0])


# ---- Bounded Kalman filter -------------------------------------------------------------------------------------------


def exact_kalman():
    """The vectors of the kernel: c/tests/vectors.py states the filter in its information form, in exact fractions."""
    text = (Path(__file__).parent.parent / "c" / "tests" / "vectors.h").read_text()
    arrays = re.findall(r"double (K_\w+)\[\d+\] = \{([^}]*)\}", text)
    v = {name: np.array([float(x) for x in body.split(",")[:-1]]) for name, body in arrays}
    P = np.zeros((len(v["K_P"]) // 10 + 1, 4, 4))
    lower = np.tril_indices(4)
    P[:, lower[0], lower[1]] = np.vstack([v["K_P0"], v["K_P"].reshape(-1, 10)])
    return v, P + np.swapaxes(np.tril(P, -1), 1, 2)


EXACT = KalmanSettings(
    filter=0.5, model_error=0.125, first_noise=0.125, noise_rate=0.0, ringing_rate=0.0, prior_return=1 / 32,
    change_threshold=8.0, change_rate=0.25, refractory=10, change_gain=0.25, change_hysteresis=0.375,
    change_share=0.125, outlier=1e6,
)  # fmt: skip


def test_the_kalman_filter_is_the_exact_one() -> None:
    """Weights, covariance, return to the prior, and the growth after a change, which is found at the same tick."""
    v, P = exact_kalman()
    law = BoundedKalman(v["K_W0"], P[0], [1, 2, 2, 0], EXACT)
    rows = zip(v["K_U"].reshape(-1, 4), v["K_Y"], v["K_W"].reshape(-1, 4), v["K_CHANGED"], strict=True)
    for k, (u, y, w, changed) in enumerate(rows):
        law.update(u, y - law.weights @ u)
        np.testing.assert_allclose(law.weights, w, rtol=0, atol=1e-10)
        assert law.changed == bool(changed)
        if k % 2:
            np.testing.assert_allclose(law.P, P[k // 2 + 1], rtol=0, atol=1e-11)
    assert v["K_CHANGED"].any()


@pytest.mark.parametrize(("size", "steady", "changed"), [(20.0, False, True), (20.0, True, False), (40.0, True, True)])
def test_where_the_error_has_long_been_small_a_change_has_to_be_clearer(size, steady, changed) -> None:
    """`size`: mean square of the innovation over what noise explains, for a threshold of 12."""
    settings = KalmanSettings(
        filter=1.0, model_error=0.1, first_noise=0.0, noise_rate=0.0, ringing_rate=0.0, outlier=1e6,
        change_threshold=12.0, change_rate=1.0, refractory=0,
    )  # fmt: skip
    law = BoundedKalman([8.0, 2.0], 1e-12 * np.eye(2), [1, 2], settings)
    law.steady = steady
    law.update(np.ones(2), 0.1 * np.sqrt(size / 2))
    assert law.changed == changed


@pytest.mark.parametrize(
    ("steeper", "calm", "faster"),
    [(0.3, True, 1.0), (2.9, True, 1.0), (4.0, True, 16.0), (50.0, True, 25.0), (4.0, False, 1.0)],
)
def test_where_the_actuator_is_far_steeper_the_covariance_returns_sooner(steeper, calm, faster) -> None:
    settings = KalmanSettings(filter=1.0, model_error=1.0, prior_return=1e-6, first_noise=0.0, noise_rate=0.0)
    law = BoundedKalman([2.0, 0.5], np.diag([3.0, 0.5]), [1, 2], settings)
    law.weights, law.P, law.calm = np.array([2.0 * steeper, 0.5]), np.diag([1e-9, 0.1]), calm
    for _ in range(RETURN_EVERY):
        law.update(np.array([1.0, 0.0]), 0.0)
    assert law.P[1, 1] - 0.1 == pytest.approx(faster * 1e-6 * 0.4, rel=1e-4)


def test_three_spikes_are_not_believed_and_a_fourth_is() -> None:
    law = BoundedKalman([8.0, 2.0], np.eye(2), [1, 2], KalmanSettings(filter=1.0, model_error=0.006))
    rng = np.random.default_rng(1)
    for _ in range(200):
        u = rng.uniform(0.5, 3.0, 2)
        law.update(u, float((np.array([9.0, 1.0]) - law.weights) @ u) + 0.02 * rng.standard_normal())
    before = law.weights
    for _ in range(3):
        with pytest.raises(UpdateRefused, match="spike"):
            law.update(np.ones(2), 5.0)
    assert law.weights is before
    law.update(np.ones(2), 5.0)
    law.update(np.ones(2), 5.0)
    assert not np.array_equal(law.weights, before)


@quick
@given(seed=st.integers(0, 10_000), columns=st.integers(1, 5), rate=st.floats(-3.0, 3.0), missing=st.floats(-5.0, 5.0))
def test_projection_is_the_nearest_point_of_the_plane_in_the_metric_of_the_data(seed, columns, rate, missing) -> None:
    """Against the quadratic programme, solved by its conditions (KKT): min (w - w0)' P^-1 (w - w0) with g.w = value."""
    rng = np.random.default_rng(seed)
    A, w0 = rng.standard_normal((5, 5)), rng.standard_normal(5)
    P, g = A @ A.T + 0.1 * np.eye(5), np.array([1, rate, 1, 1, rate]) * (np.arange(5) < columns)
    law = BoundedKalman(w0, P, [1, 0, 2, 2, 0], EXACT)
    law.project(columns, rate, missing)
    H = np.linalg.inv(P)
    kkt = np.block([[H, g[:, np.newaxis]], [g, np.zeros(1)]])
    nearest = np.linalg.solve(kkt, np.append(H @ w0, g @ w0 + missing))[:5]
    np.testing.assert_allclose(law.weights, nearest, rtol=1e-7, atol=1e-7)


def test_a_tick_that_is_not_used_leaves_no_trace() -> None:
    v, P = exact_kalman()
    taught, held = (BoundedKalman(v["K_W0"], P[0], [1, 2, 2, 0], EXACT) for _ in range(2))
    held.update(np.full(4, 1e6), 1e9, learn=False)
    for u, y in zip(v["K_U"].reshape(-1, 4), v["K_Y"], strict=True):
        for law in (taught, held):
            law.update(u, y - law.weights @ u)
    np.testing.assert_array_equal(held.weights, taught.weights)


# ---- LMS -------------------------------------------------------------------------------------------------------------

vectors = st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3).map(np.array)


@quick
@given(w=vectors, truth=vectors, u=vectors, step_size=st.floats(0.01, 1.99))
def test_normalised_lms_never_moves_away_from_the_truth(w, truth, u, step_size) -> None:
    """Without noise, for any u and any 0 < eta < 2."""
    law = LMS(w, step_size=step_size)
    law.update(u, float((truth - w) @ u))
    assert np.linalg.norm(truth - law.weights) <= np.linalg.norm(truth - w) + 1e-12


@quick
@given(w=vectors, u=vectors.filter(lambda u: np.linalg.norm(u) > 0.1), y=st.floats(-30.0, 30.0))
def test_a_full_step_explains_the_measurement_with_the_smallest_change(w, u, y) -> None:
    law = LMS(w, step_size=1.0, regularization=0.0)
    law.update(u, y - float(w @ u))
    assert law.weights @ u == pytest.approx(y, abs=1e-10)
    smallest = np.linalg.pinv(u[np.newaxis]) @ [y - w @ u]
    np.testing.assert_allclose(law.weights - w, smallest, rtol=0, atol=1e-9)


def test_widrow_hoff_is_stable_below_its_bound_and_not_above() -> None:
    """eta < 2 / u'u."""
    u, truth = np.array([1.0, 2.0]), np.array([3.0, -1.0])
    errors = []
    for factor in (0.95, 1.05):
        law = LMS([0.0, 0.0], step_size=factor * 2 / (u @ u), normalised=False)
        for _ in range(200):
            law.update(u, float((truth - law.weights) @ u))
        errors.append(abs((truth - law.weights) @ u))
    assert errors[0] < 1e-6
    assert errors[1] > 1e6


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LMS([0.0], step_size=2.0), "step_size = 2.0: must be below 2"),
        (lambda: LMS([0.0], step_size=-1.0, normalised=False), r"step_size = -1.0 1/V\^2: must be above 0"),
        (lambda: RLS([0.0], forgetting=1.01), "forgetting = 1.01: must be"),
        (lambda: RLS([0.0], regularization=0.0), r"regularization = 0.0 V\^2: must be above 0"),
        (lambda: RLS([np.nan]), r"initial_weights\[0\] = nan um/V: must be finite"),
    ],
)
def test_a_bad_law_is_named(make, words) -> None:
    with pytest.raises(SettingError, match=words):
        make()
