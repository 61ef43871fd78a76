"""Models from records: recovery, honest intervals, the measured stack, speed, controllers and voltages from them."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from truestroke import AdaptiveController, SettingError, run, trajectories
from truestroke.base.threads import one_blas_thread
from truestroke.identification import Record, identify, load_model, read_record, save_model
from truestroke.identification.fitting.structure import _of_model
from truestroke.model.models import RateDependentModel, play_inverse_literal
from truestroke.model.operators import play
from truestroke.plant import RealisticPlant

R, A = (0.0, 0.2, 0.45, 0.8), (8.0, 1.5, 1.0, 0.7)  # V, um/V
LIMITS = (-0.6, 3.6)
SHARED = Path(os.environ.get("TRUESTROKE_SHARED", Path(__file__).parents[2] / "shared"))
MEASURED = SHARED / "data/p885_91/Model_Vi_Do.dat"


def plays(x, y0=None):
    """Plain Python, one play at a time."""
    z = np.zeros(len(x))
    for r, a in zip(R, A, strict=True):
        y = 0.0
        for k, v in enumerate(x):
            y = max(v - r, min(v + r, y))
            z[k] += a * y
    return z


def record(samples, seed, noise=0.0, colour=0.0, rate=1000.0):
    """A wave of twelve sines below 20 Hz from 0 V, the displacement of four plays, noise white or of first order."""
    rng = np.random.Generator(np.random.PCG64(seed))
    t = np.arange(samples) / rate
    s = np.sin(2 * np.pi * rng.uniform(0.5, 20.0, 12) * t[:, None] + rng.uniform(0, 6.28, 12)).sum(axis=1)
    x = (s - s.min()) / np.ptp(s) * 2.6 * np.minimum(1.0, t / 0.1)
    e = rng.standard_normal(samples)
    for k in range(1, samples if colour else 0):
        e[k] = colour * e[k - 1] + np.sqrt(1 - colour**2) * e[k]
    return x, plays(x) + noise * e, rate


KNOWN = {"thresholds": R, "creep_times": (), "asymmetry": 0, "rate": False, "delay": 0.0}


def test_weights_are_recovered_and_the_rest_is_zero():
    x, z, fs = record(4000, 1)
    found = identify((x, z + 50.0, fs), **KNOWN)
    np.testing.assert_allclose(found.model.weights[:4], A, atol=2e-4)
    assert found.model.predict(x, fs) == pytest.approx(z + 50.0, abs=2e-3)
    assert found.held_out.rmse_um < 1e-3


@pytest.mark.parametrize(("noise", "colour"), [(0.005, 0.0), (0.05, 0.95), (0.2, 0.0)])
def test_intervals_of_95_percent_cover_the_truth(noise, colour):
    inside = []
    for seed in range(7):
        model = identify(record(1500, seed, noise, colour), **KNOWN).model
        inside += list(np.abs(model.weights[:4] - A) < 1.96 * model.deviations[:4])
    assert 0.85 <= np.mean(inside) <= 1.0


def test_error_and_claim_fall_with_the_length_of_the_record():
    errors, claims = [], []
    for samples in (1000, 9000):
        models = [identify(record(samples, seed, 0.05), **KNOWN).model for seed in range(4)]
        errors.append(np.sqrt(np.mean([(m.weights[:4] - A) ** 2 for m in models])))
        claims.append(np.sqrt(np.mean([m.deviations[:4] ** 2 for m in models])))
    for first, last in (errors, claims):
        assert 1.8 < first / last < 6.0  # 3 for independent samples


def test_delay_offset_and_an_unknown_start_are_found():
    x, z, fs = record(6000, 2, 0.01)
    late = identify((x[1000:], z[1000 - 7 : -7] - 80.0, fs), rate=False, creep_times=(), asymmetry=0)
    lag = late.model.weights[late.model.names.index("lag")]
    assert late.model.delay - lag == pytest.approx(7e-3, abs=1e-3)
    assert late.held_out.rmse_um < 0.1


def test_threads_that_identify_leave_blas_as_it_was():
    """The second one begins later and ends last; without the count it would leave one thread behind."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info, threadpool_limits

    def threads():
        return {entry["num_threads"] for entry in threadpool_info() if entry["user_api"] == "blas"}

    with threadpool_limits(2, "blas"):
        one_blas_thread.__enter__()
        one_blas_thread.__enter__()
        one_blas_thread.__exit__(None, None, None)
        assert threads() == {1}
        one_blas_thread.__exit__(None, None, None)
        assert threads() == {2}
        with pytest.raises(SettingError):
            identify((np.zeros(10), np.zeros(10), 100.0))
        assert threads() == {2}


@pytest.mark.skipif(
    not MEASURED.exists(),
    reason=f"the measured record is not at {MEASURED}; set TRUESTROKE_SHARED to its folder 'shared'",
)
def test_measured_stack():
    rows = np.loadtxt(MEASURED)
    found = identify((rows[:, 0], rows[:, 4], 200.0))
    assert found.held_out.samples == pytest.approx(0.4 * len(rows), abs=1)
    assert found.held_out.rmse_percent <= 0.85
    assert found.held_out.maximum_percent <= 2.0
    assert 0.90 <= found.held_out.coverage <= 0.97
    train = int(0.6 * len(rows))  # and so it is for someone who holds it out himself
    model = identify((rows[:train, 0], rows[:train, 4], 200.0)).model
    error = (rows[:, 4] - model.predict(rows[:, 0], 200.0))[train:]
    assert np.sqrt(np.mean(error**2)) <= 0.0085 * np.ptp(rows[:, 4])
    assert np.abs(error).max() <= 0.02 * np.ptp(rows[:, 4])


@pytest.fixture(scope="module")
def stage():
    """20 s of the simulated stage, open loop, and its model."""
    wave = trajectories.random_wave(duration=20.0, seed=5, peak_to_peak=28.0)
    plant = RealisticPlant(seed=3)
    plant.open()
    volts = wave.position / 12.0
    return identify((volts, plant.exchange(volts), 2000.0))


def test_a_stage_is_identified(stage):
    assert stage.held_out.rmse_percent < 0.5


def first_second(controller, wave):
    recording = run(wave, controller, RealisticPlant(seed=7))
    error = (recording["true"] - recording["desired"])[:2000]
    return np.sqrt(np.mean(error**2))


@pytest.mark.parametrize(
    ("law", "limits", "times"),
    [("kalman", (-2.0, 10.0), 2.0), ("rls", LIMITS, 4.0), ("kalman", LIMITS, 0.7)],  # the last has nothing to learn
)
def test_a_controller_from_the_model_has_learned_before_it_starts(stage, law, limits, times, tmp_path):
    save_model(tmp_path / "stage.toml", stage.model)
    wave = trajectories.sine(frequency=12.0, peak_to_peak=24.0, duration=1.0)
    bench = {"sample_rate": 2000.0, "voltage_limits": limits}
    fresh = (AdaptiveController if law == "kalman" else AdaptiveController.paper)(stroke=30.0, **bench)
    known = AdaptiveController.from_model(tmp_path / "stage.toml", **bench, law=law)
    assert first_second(known, wave) < first_second(fresh, wave) / times


def test_voltage_of_the_inverse_makes_the_displacement(stage):
    model = stage.model
    z_d = model.predict(record(4000, 4)[0], 2000.0)
    volts = model.invert(z_d, 2000.0, voltage_limits=LIMITS)
    assert model.predict(volts, 2000.0) == pytest.approx(z_d, abs=0.02 * np.ptp(z_d))
    assert LIMITS[0] <= volts.min() <= volts.max() <= LIMITS[1]
    wave = trajectories.sine(frequency=12.0, peak_to_peak=24.0, duration=2.0)
    plant = RealisticPlant(seed=7)
    plant.open()
    plant.exchange(model.invert(wave.position, 2000.0, voltage_limits=LIMITS))
    assert np.sqrt(np.mean((plant.truth - wave.position) ** 2)) < 0.15  # open loop, um


def test_arrays_of_the_rate_dependent_model_follow_the_text():
    stack = RateDependentModel(r=R, a=A, b=[-0.9, 0.8, 0.1, 0.0], d=[0.0, 12.0], w_s=[1.0, 0.1])
    x = record(3000, 6)[0]
    rate = np.gradient(x, 1e-3)
    z, y, back = stack.predict(x, rate), np.zeros(4), np.zeros(4)
    for k in range(300):
        once, y = stack.step(x[k], rate[k], y)
        assert once == z[k]
    volts = stack.invert(z, rate)
    for k in range(300):
        once, back = stack.invert_step(z[k], rate[k], back)
        assert once == pytest.approx(volts[k], abs=1e-10)
    np.testing.assert_allclose(volts, x, atol=1e-9)
    with pytest.raises(SettingError, match=r"w_h\(zdot_d\[1\]\)"):
        stack.invert([1.0, 1.0], [0.0, 2000.0])
    assert play_inverse_literal(7.0, [8.0, 2.0], [0.0, 0.5], [0.0, 0.0]) == 0.8
    assert play(1.0, [0.5], [0.0]) == 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x, z: (0 * x + 1, z), "volts"),
        (lambda x, z: (x, 0 * z), "displacement"),
        (lambda x, z: (x, -z), "rises"),
        (lambda x, z: (x, np.where(np.arange(z.size) == 7, np.nan, z)), r"displacement\[7\]"),
        (lambda x, z: (x[:2], z[:2]), "50 samples"),
        (lambda x, z: (x, z[:-1]), "as long as"),
    ],
)
def test_records_that_say_nothing_are_refused(change, words):
    x, z, fs = record(1000, 1)
    with pytest.raises(SettingError, match=words):
        identify((*change(x, z), fs))


@pytest.mark.parametrize("nothing", [None, "sweep.csv", np.zeros(100), (np.zeros(100), np.zeros(100))])
def test_what_is_no_record_is_refused(nothing):
    with pytest.raises(SettingError, match=r"record .* must be a Record, as of read_record, or"):
        identify(nothing)


def test_no_samples_are_predicted_from_none(stage):
    model = stage.model
    assert model.predict([], 2000.0).shape == model.invert([], 2000.0).shape == (0,)


def test_model_file_comes_back_to_the_last_bit(stage, tmp_path):
    model = stage.model
    save_model(tmp_path / "a.toml", model)
    save_model(tmp_path / "b.toml", load_model(tmp_path / "a.toml"))
    assert (tmp_path / "a.toml").read_bytes() == (tmp_path / "b.toml").read_bytes()
    again = load_model(tmp_path / "a.toml")
    assert again.weights.tobytes() == model.weights.tobytes()
    assert again.covariance.tobytes() == model.covariance.tobytes()
    assert dict(again.metrics) == dict(model.metrics)


def test_a_covariance_beside_branches_has_no_negative_variance():
    """Rounding of a covariance of which the weights are known exactly where the branches are."""
    ways = np.random.Generator(np.random.PCG64(2)).standard_normal((6, 3))
    known = _of_model(ways, SimpleNamespace(parameters=3, further=("a", "b", "c")))
    assert np.linalg.eigvalsh(known).min() > -1e-15
    assert np.abs(known).max() < 1e-15
    wide = ways @ ways.T + np.eye(6)
    expected = np.linalg.inv(np.linalg.inv(wide)[:3, :3])  # of a normal distribution, with the others as they are
    root = np.linalg.cholesky(wide)
    np.testing.assert_allclose(_of_model(root, SimpleNamespace(parameters=3, further=("a", "b", "c"))), expected)


def test_pieces_that_hardly_move_beside_the_step_between_them_are_refused():
    """Their rests are all that is behind it: it was a division by zero."""
    ripple = 1e-4 * np.sin(2 * np.pi * np.arange(5000) / 200)
    volts = np.concatenate([1.5 + ripple, 1.4547 + ripple, 1.4550 + ripple])
    time = np.concatenate([start + np.arange(5000) / 10_000.0 for start in (0.0, 0.6, 1.2)])
    noise = 0.005 * np.random.default_rng(1).standard_normal(volts.size)
    record = Record.from_arrays(volts, 8.3 * volts + noise, time=time, source="passes")
    with pytest.raises(SettingError, match=r"no motion behind the first sweep of its 0\.0273 V: must be one that"):
        identify(record)


def test_a_part_with_too_few_samples_is_refused_with_its_file_and_what_helps(tmp_path: Path) -> None:
    t = np.arange(50) / 100.0
    x = 1.5 - 1.5 * np.cos(30 * t)
    np.savetxt(tmp_path / "short.csv", np.column_stack([t, x, 10 * x]), delimiter=",", header="t (s),V,z (um)")
    with pytest.raises(SettingError, match=r"in the held-out part of .*short.csv: must be .*record for longer"):
        identify(read_record(tmp_path / "short.csv"), held_out=0.3)


@pytest.mark.parametrize(
    ("size", "noise", "rate", "member"), [(1e-10, 0.0, 100.0, "stroke"), (1.0, 3.0, 1e-6, "jitter")]
)
def test_a_model_out_of_bounds_is_said_to_be_that_of_the_record(size, noise, rate, member):
    """Of a unit or a clock that is wrong by far: nobody has set the member whose bound it is."""
    t, rng = np.arange(600) / 100.0, np.random.default_rng(1)
    x = 50 - 30 * np.cos(2 * np.pi * 1.1 * t) - 20 * np.cos(2 * np.pi * 0.37 * t)
    with pytest.raises(SettingError, match="are its units, its clock and its columns right") as raised:
        identify((x, size * (x + noise * rng.standard_normal(x.size)), rate))
    assert raised.value.argument == "record"
    assert f"whose model has {member} = " in str(raised.value)
