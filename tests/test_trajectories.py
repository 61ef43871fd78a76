"""Trajectories: bounds, exact velocity, spectrum, files."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from truestroke import Dynamics, Mode, SettingError
from truestroke import trajectories as tr
from truestroke.control import stage as inverting
from truestroke.control.stage import INVERTED, strain, strain_within
from truestroke.signals import shaping
from truestroke.signals.tables import RecordError

MAKERS = {
    "sine": lambda **kw: tr.sine(frequency=12.0, **kw),
    "triangle": lambda **kw: tr.triangle(speed=300.0, **kw),
    "staircase": lambda **kw: tr.staircase(**kw),
    "raster": lambda **kw: tr.raster(frequency=12.0, **kw),
    "step": lambda **kw: tr.step(**kw),
    "random wave": lambda **kw: tr.random_wave(seed=3, **kw),
    "slow random wave": lambda **kw: tr.random_wave(seed=3, velocity_limit=300.0, **kw),
}


def simpson_defect(wave):
    """What Simpson's rule on the velocity and the step of position disagree by, um."""
    v, z, h = wave.velocity, wave.position, 1 / wave.sample_rate
    return np.abs(z[2:] - z[:-2] - h / 3 * (v[:-2] + 4 * v[1:-1] + v[2:]))


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_starts_at_rest_at_zero_and_stays_in_the_stroke(make):
    wave = make(duration=4.0)
    assert len(wave) == 8000
    assert wave.duration == 4.0
    assert wave.time[1] == 1 / 2000
    assert (wave.position[0], wave.velocity[0]) == (0.0, 0.0)
    assert wave.position.min() > -1e-12
    assert wave.position.max() < 30.0


@pytest.mark.parametrize("name", ["sine", "staircase", "random wave"])
def test_velocity_is_the_integrand_of_position(name):
    wave = MAKERS[name](duration=2.0)
    assert simpson_defect(wave).max() < {"sine": 2e-8, "staircase": 3e-5, "random wave": 4e-5}[name]
    if name == "sine":  # smooth after its ramp: the defect falls as the fifth power of the tick, 4^5 = 1024
        defects = [
            simpson_defect(MAKERS[name](duration=2.0, sample_rate=r))[int(0.3 * r) :].max() for r in (2000, 8000)
        ]
        assert 900 < defects[0] / defects[1] < 1100


@pytest.mark.parametrize(("name", "bound"), [("sine", 3e-6), ("staircase", 3e-3), ("random wave", 4e-4)])
def test_acceleration_is_the_integrand_of_velocity(name, bound):
    wave = MAKERS[name](duration=2.0)
    v, a, h = wave.velocity, wave.acceleration, 1 / wave.sample_rate
    defect = np.abs(v[2:] - v[:-2] - h / 3 * (a[:-2] + 4 * a[1:-1] + a[2:]))  # Simpson's rule
    assert defect.max() < bound * wave.peak_speed
    assert wave.acceleration[0] == 0.0
    assert "acceleration" not in wave.settings


def test_triangle_accelerates_in_its_ramp_alone():
    wave = tr.triangle(frequency=2.0, peak_to_peak=20.0, duration=2.0, ramp=0.2)
    assert not wave.acceleration[400:].any()
    v, a, h = wave.velocity[:400], wave.acceleration[:400], 1 / 2000  # up to the ramp's end: without a corner
    assert np.abs(v[2:] - v[:-2] - h / 3 * (a[:-2] + 4 * a[1:-1] + a[2:])).max() < 1e-4


def test_an_acceleration_that_nobody_gave_is_estimated_and_says_so():
    wave = tr.sine(frequency=20.0, duration=1.0, ramp=0.0)
    guessed = tr.Trajectory("own", wave.sample_rate, wave.position, wave.velocity)
    assert guessed.settings["acceleration"] == tr.ESTIMATED
    # central differences of a sine are short by (w T)^2 / 6 of its peak
    off = np.abs(guessed.acceleration - wave.acceleration)[1:-1].max() / wave.peak_acceleration
    assert off == pytest.approx((2 * np.pi * 20.0 / 2000) ** 2 / 6, rel=0.01)
    with pytest.raises(SettingError, match=r"acceleration = .* \(3,\): must be 4 ent"):
        tr.Trajectory("x", 2000.0, np.zeros(4), np.zeros(4), acceleration=np.zeros(3))


def test_random_wave_against_a_fine_simulation_of_the_analogue_filter():
    # scipy's design, each number held for 64 sub-ticks, integrated by scipy's own discretisation
    numbers = np.random.Generator(np.random.PCG64(8)).uniform(-1.0, 1.0, 400)
    z, zdot, zddot = tr._butterworth(numbers, 20.0, 2000.0)
    b, a = signal.butter(4, 2 * np.pi * 20.0, analog=True)
    system = signal.TransferFunction(b, a).to_ss()
    t = np.arange(400 * 64) / (2000.0 * 64)
    _, y, x = signal.lsim(system, np.repeat(numbers, 64), t, interp=False)
    np.testing.assert_allclose(z, y[::64], atol=1e-9)
    np.testing.assert_allclose(zdot, (x @ system.A.T @ system.C.T)[::64, 0], atol=1e-7)
    np.testing.assert_allclose(zddot, (x @ system.A.T @ system.A.T @ system.C.T)[::64, 0], atol=1e-4)


def test_spectrum_falls_as_a_butterworth_of_order_four():
    wave = tr.random_wave(cutoff=40.0, duration=200.0, seed=5)
    f, density = signal.welch(wave.position[500:], 2000.0, nperseg=4096, window="blackmanharris")
    bands = [(4, 12), (30, 50), (75, 85), (150, 170), (310, 330)]
    level = np.array([density[(f >= lo) & (f <= hi)].mean() for lo, hi in bands])
    butterworth = np.array([np.mean(1 / (1 + (f[(f >= lo) & (f <= hi)] / 40) ** 8)) for lo, hi in bands])
    np.testing.assert_allclose(level / level[0], butterworth / butterworth[0], rtol=0.25)


@given(
    seed=st.integers(0, 2**32),
    limit=st.one_of(st.none(), st.floats(120.0, 1000.0)),
    span=st.floats(1.0, 29.0),
    ramp=st.sampled_from([0.0, 0.25, 0.5]),
)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_random_wave_keeps_its_bounds_for_any_seed(seed, limit, span, ramp):
    wave = tr.random_wave(seed=seed, duration=5.0, velocity_limit=limit, peak_to_peak=span, ramp=ramp)
    after = wave.position[wave.time >= ramp]
    assert after.min() == pytest.approx(0.7, abs=1e-9)
    assert np.ptp(after) == pytest.approx(span, abs=1e-9)
    assert wave.position.min() >= (0.0 if ramp else 0.7 - 1e-9)
    assert wave.position.max() <= 0.7 + span + 1e-9
    if limit:
        assert wave.peak_speed <= limit
        assert wave.settings["cutoff"] == 20.0 or wave.peak_speed > 0.5 * limit  # no slower than needed


def test_seed_gives_the_same_bits():
    a, b, other = (tr.random_wave(seed=s, duration=2.0, velocity_limit=300.0) for s in (7, 7, 8))
    assert a.position.tobytes() == b.position.tobytes()
    assert a.velocity.tobytes() == b.velocity.tobytes()
    assert not np.array_equal(a.position, other.position)


def test_sine_after_the_ramp():
    wave = tr.sine(frequency=8.0, peak_to_peak=24.0, offset=13.0, duration=2.0, ramp=0.5)
    t = wave.time[1000:]
    np.testing.assert_allclose(wave.position[1000:], 13 + 12 * np.sin(16 * np.pi * t), rtol=0, atol=1e-12)
    np.testing.assert_allclose(wave.velocity[1000:], 192 * np.pi * np.cos(16 * np.pi * t), rtol=0, atol=1e-9)
    assert abs(wave.peak_to_peak - 25.0) < 0.01  # from 0 um to 25 um


@pytest.mark.parametrize("frequency", [1.0, 4.0, 12.5, 25.0])
def test_triangle_has_the_speed_exactly_and_turns_on_its_tick(frequency):
    wave = tr.triangle(frequency=frequency, peak_to_peak=20.0, duration=4.0)
    position, velocity = wave.position[500:], wave.velocity[500:]
    assert set(velocity) == {-40.0 * frequency, 40.0 * frequency}
    np.testing.assert_allclose(np.diff(position), velocity[:-1] / 2000.0, atol=1e-10)  # at the corners, too
    assert np.ptp(position) == pytest.approx(20.0)


def stage(frequency=700.0, damping=0.02):
    return Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=frequency, damping=damping),))


def answer(command, rate, frequency, damping, finer=10):
    """Of a second-order stage to commands that are held for a tick, by scipy; time, s, and displacement, um."""
    w = 2 * np.pi * frequency
    t = np.arange(command.size * finer) / (rate * finer)
    (b,), poles, _ = signal.cont2discrete(([w**2], [1, 2 * damping * w, w**2]), t[1])
    return t, signal.lfilter(b, poles, np.repeat(command, finer))


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("wrong", [0.95, 1.0, 1.05])
@pytest.mark.parametrize(("frequency", "damping"), [(400.0, 0.01), (900.0, 0.02)])
def test_a_step_settles_to_a_hundredth_within_one_and_a_half_periods(frequency, damping, wrong, inverted):
    wave = tr.step(settle=stage(frequency, damping), hold=0.05, ramp=0.0, duration=0.1, sample_rate=1e4)
    command = wave.position
    if inverted:  # by a controller that takes the resonance for the wrong one, too
        w = 2 * np.pi * frequency
        command = wave.position + 2 * damping / w * wave.velocity + wave.acceleration / w**2
    t, z = answer(command, 1e4, wrong * frequency, damping)
    assert np.abs(z - 5.0)[t >= 0.05 + 1.5 / frequency].max() < 0.05
    assert np.abs(z - 5.0)[t >= 0.05 + 1.0 / frequency].max() > 0.05


def test_what_a_plain_step_leaves_is_what_the_formula_of_a_move_states():
    move = shaping.minimum_jerk(1.2e-3)
    t = np.arange(20_000) / 1e6
    w, zeta = 2 * np.pi * 800.0, 0.03
    z = signal.lsim(signal.TransferFunction([w**2], [1, 2 * zeta * w, w**2]), move.at(t)[0], t)[1]
    envelope = np.hypot(z - 1, (np.gradient(z, t) + zeta * w * (z - 1)) / (w * np.sqrt(1 - zeta**2)))
    assert envelope[1200] == pytest.approx(move.vibration(800.0, zeta), rel=1e-3)


@pytest.mark.parametrize(("shape", "left", "width"), [("zv", 0.0, 0.006), ("zvd", 0.0, 0.064), ("ei", 0.01, 0.089)])
def test_shapers_leave_a_hundredth_as_far_from_the_mode_as_published(shape, left, width):
    # an undamped mode: sums of unit vectors; ZV abs(cos), ZVD cos^2, EI (1 - V)/2 + (1 + V)/2 cos, each < 0.01
    impulses = shaping.impulses(Mode(frequency=500.0, damping=1e-9), shape)

    def vibration(frequency):
        return abs(sum(a * np.exp(2j * np.pi * frequency * t) for a, t in impulses))

    assert vibration(500.0) == pytest.approx(left, abs=1e-6)
    assert max(vibration(500.0 * (1 + s * width)) for s in (-1, 1)) < 0.0101
    assert min(vibration(500.0 * (1 + s * (width + 0.003))) for s in (-1, 1)) > 0.0099


def test_a_step_excites_no_second_mode_and_keeps_its_limits():
    both = Dynamics(
        sample_rate=1e4,
        modes=(Mode(frequency=500.0, damping=0.02, share=0.9), Mode(frequency=1300.0, damping=0.01, share=0.1)),
    )
    wave = tr.step(settle=both, hold=0.02, ramp=0.0, duration=0.04, sample_rate=1e4)
    t, z = answer(wave.position, 1e4, 1300.0, 0.01)
    assert wave.settings["rise"] < 1.5 / 500
    assert 0.1 * np.abs(z - 5.0)[t >= 0.02 + wave.settings["rise"] + 1e-4].max() < 0.005  # um, of its share
    slow = tr.step(settle=both, velocity_limit=1500.0, acceleration_limit=3e6, hold=0.02, duration=1.0, sample_rate=1e4)
    assert 1425.0 < slow.peak_speed <= 1500.0
    assert slow.peak_acceleration <= 3e6


def of_several_modes(number):
    """Two or three modes, some near to each other: exact zeros at all would shake a stage by many times the height."""
    random, count = np.random.default_rng(number), 2 + number % 2
    ratios = 1.0, random.uniform(1.2, 2.0), random.uniform(2.1, 3.5)
    shares = (0.8, 0.2) if count == 2 else (0.7, 0.2, 0.1)
    dampings = np.exp(random.uniform(np.log(0.005), np.log(0.08), 3))
    each = zip(ratios, dampings, shares, strict=False)
    modes = tuple(Mode(frequency=300.0 * ratio, damping=zeta, share=share) for ratio, zeta, share in each)
    return Dynamics(sample_rate=1e4, modes=modes)


@pytest.mark.parametrize("number", range(12))
@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_a_step_between_several_modes_settles_and_does_not_swing(number, factor):
    known = of_several_modes(number)
    wave = tr.step(settle=known, hold=0.04, ramp=0.0, duration=0.08, sample_rate=1e4)
    assert wave.settings["rise"] < 2.0 / 300
    assert -0.05 < wave.position.min() <= wave.position.max() < 5.05
    parts = [(mode.share, answer(wave.position, 1e4, factor * mode.frequency, mode.damping)) for mode in known.modes]
    t, z = parts[0][1][0], sum(share * answered for share, (_, answered) in parts)
    assert np.abs(z - 5.0)[t >= 0.04 + wave.settings["rise"] + 2e-4].max() < 0.012 * 5.0
    assert z.max() < 5.0 * 1.02


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("frequency", [20.0, 40.0, 90.0])
def test_a_turn_between_several_modes_does_not_swing(number, frequency):
    """The turn goes as far beyond its line as one that knows of no modes, and at most a fifth of it further."""
    asked = {"frequency": frequency, "peak_to_peak": 10.0, "duration": 1.0, "sample_rate": 1e4}
    wave = tr.raster(turn=of_several_modes(number), **asked)
    plain = tr.raster(turn=wave.settings["turn"], **asked)
    assert wave.settings["line"] > 0.8 * plain.settings["line"]
    assert np.abs(wave.acceleration[3000:]).max() < 6 * np.abs(plain.acceleration[3000:]).max()


@pytest.mark.parametrize("damping", [0.3, 0.45, 0.6])
def test_a_turn_of_a_damped_stage_hardly_exceeds_the_speed_of_its_lines(damping):
    """Which forgets by itself: exact zeros made the velocity twice that of the lines, and back."""
    damped = Dynamics(sample_rate=1e4, modes=(Mode(frequency=300.0, damping=damping),))
    wave = tr.raster(turn=damped, frequency=20.0, peak_to_peak=10.0, duration=0.5, sample_rate=1e4)
    assert np.abs(wave.velocity[wave.time > 0.26]).max() < 1.3 * wave.settings["speed"]
    after = tr.step(settle=damped, hold=0.04, ramp=0.0, duration=0.08, sample_rate=1e4)
    t, z = answer(after.position, 1e4, 300.0, damping)
    assert np.abs(z - 5.0)[t >= 0.04 + 1.5 / 300].max() < 0.05


def test_a_step_has_nothing_at_the_zero_between_two_modes():
    """There the inverse of the stage is large: a step without that zero needs a strain twice as large."""
    pair = Mode(frequency=417.0, damping=0.004, share=0.89), Mode(frequency=1688.0, damping=0.04, share=0.11)
    stiff = Dynamics(sample_rate=1e4, modes=pair, amplifier_bandwidth=1400.0)
    asked = {"hold": 0.05, "ramp": 0.05, "duration": 0.3, "sample_rate": 1e4}
    for settle, least, most in ((stiff, 1.0, 2.0), (replace(stiff, modes=(replace(pair[0], share=1.0),)), 2.0, 20.0)):
        position = tr.step(peak_to_peak=5.0, settle=settle, **asked).position
        needed = np.ptp(strain_within(stiff, position, INVERTED[0])) / 5.0
        assert least < needed < most
        assert np.ptp(strain(stiff, position)) < 2.0 * 5.0


def test_the_inverse_of_a_long_motion_is_computed_once_for_all_its_columns(monkeypatch):
    """As of an hour of lines, whose 1 / G is computed and kept in five parts."""
    monkeypatch.setattr(inverting, "KEPT", 2**12)
    inverting._inverse.cache_clear()
    stiff = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=900.0, damping=0.02),))
    for _ in range(3):
        strain_within(stiff, np.sin(np.arange(20_000) / 500.0), INVERTED[0])
    assert inverting._inverse.cache_info().misses == 5


def test_turns_of_a_raster_leave_no_vibration_on_its_lines():
    wave = tr.raster(frequency=90.0, turn=stage(), peak_to_peak=20.0, duration=0.5, sample_rate=1e4)
    assert set(wave.velocity[wave.flat]) == {-wave.settings["speed"], wave.settings["speed"]}
    assert wave.peak_to_peak == pytest.approx(20.0, abs=1e-3)
    sharp = tr.triangle(frequency=90.0, peak_to_peak=20.0, duration=0.5, sample_rate=1e4)
    left = []
    for motion in (wave, sharp):
        _, z = answer(motion.position, 1e4, 1.03 * 700.0, 0.02)  # nobody knows it better
        lag = 2 * 0.02 / (2 * np.pi * 721.0) + 0.5e-4  # of a line: that of the mode, and half a tick
        error = z[::10] - (motion.position - lag * motion.velocity)
        left.append(np.abs(error[wave.flat & (wave.time > 0.3)]).max())
    assert left[0] < 0.01  # um
    assert left[1] > 20 * left[0]


def test_turns_have_little_that_no_controller_inverts_and_take_no_more_than_their_share():
    """Beyond 2.5 resonances, where a second mode may be; 20 um lines, 40 a second, on a stage of 400 Hz."""
    slow = Dynamics(sample_rate=5000.0, modes=(Mode(frequency=400.0, damping=0.02),))
    wave = tr.raster(frequency=40.0, turn=slow, peak_to_peak=20.0, duration=1.0, sample_rate=5000.0)
    part = slice(2500, 2625)
    Z = np.fft.rfft(wave.position[part] * 20.0 / wave.settings["line"])
    Z[np.arange(Z.size) * 40.0 <= 1000.0] = 0.0
    assert np.abs(np.fft.irfft(Z, 125)[wave.flat[part]]).max() < 1.5e-3  # um
    for frequency, periods in ((10.0, 1.8), (50.0, 1.6), (57.0, 0.2 / 57.0 * 400.0), (100.0, 1.4), (141.0, 1.4)):
        fast = tr.raster(frequency=frequency, turn=slow, duration=1.0, sample_rate=5000.0)
        assert fast.settings["turn_time"] == pytest.approx(periods / 400.0), frequency
    with pytest.raises(SettingError, match=r"at most 141\.4 Hz: a turn takes 3\.5 ms, 1\.4 periods"):
        tr.raster(frequency=142.0, turn=slow, sample_rate=5000.0)


@pytest.mark.parametrize("turn", [0.05, 0.4, 0.9])
def test_raster_is_one_smooth_motion(turn):
    wave = tr.raster(frequency=7.3, turn=turn, peak_to_peak=20.0, duration=2.0, offset=3.0)
    v, a, h = wave.velocity, wave.acceleration, 1 / 2000
    assert simpson_defect(wave)[600:].max() < 2e-3
    assert np.abs(v[2:] - v[:-2] - h / 3 * (a[:-2] + 4 * a[1:-1] + a[2:]))[600:].max() < 2e-2 * wave.peak_speed
    assert wave.flat[600:].mean() == pytest.approx(1 - turn, abs=0.02)
    assert not wave.flat[:500].any()  # the ramp
    after = wave.position[500:]
    assert (after.min(), after.max()) == pytest.approx((-7.0, 13.0), abs=0.05)


def test_staircase_rests_on_each_level():
    wave = tr.staircase(steps=4, peak_to_peak=20.0, hold=0.2, velocity_limit=100.0, duration=4.0)
    resting = np.unique(wave.position[wave.velocity == 0].round(9))
    assert resting.tolist() == [0.0, 5.0, 10.0, 15.0, 20.0]
    assert 99.9 < wave.peak_speed <= 100.0
    assert np.abs(np.diff(wave.position)).max() <= 100.0 / 2000  # no jump anywhere


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tr.sine(frequency=1000.0), "frequency = 1000.0 Hz: must be below half of the sample rate, 1000 Hz"),
        (
            lambda: tr.sine(duration=1e9),
            "duration = 1000000000.0 s: must be from 0.001 to 500000 s, 2 to 1000000000 ticks",
        ),
        (
            lambda: tr.sine(sample_rate=0.05),
            r"duration = 20.0 s: must be from 40 to .* s, 2 to 1000000000 ticks of 0.05",
        ),
        (lambda: tr.sine(ramp=11.0), "ramp = 11.0 s: must be from 0 to 10 s, half of the duration of 20 s"),
        (lambda: tr.triangle(), "speed = None um/s: must be given"),
        (lambda: tr.triangle(speed=1.0, frequency=1.0), "not both"),
        (
            lambda: tr.raster(frequency=300.0, turn=stage(), sample_rate=1e4),
            "= 300.0 Hz: must be at most 247.5",
        ),
        (lambda: tr.raster(turn=1.0), "turn = 1.0 of the period: must be from 0.01 to 0.99"),
        (lambda: tr.step(settle=stage(), hold=1.5e-3, sample_rate=1e4), "hold = 0.0015 s: must be at least 0.002 s"),
        (lambda: tr.step(settle=700.0), "settle = 700.0: must be a Dynamics"),
        (lambda: tr.step(settle=stage(), shape="box"), "shape = 'box': must be"),
        (lambda: tr.step(settle=stage(), rise=0.1), "rise = 0.1 s: must be left out"),
        (lambda: tr.staircase(steps=2.5), "steps = 2.5: must be a whole number"),
        (lambda: tr.random_wave(cutoff=300.0), "cutoff = 300.0 Hz: must be from 0.05 to 200 Hz"),
        (lambda: tr.random_wave(duration=2.0, sample_rate=4.0), "sample_rate = 4.0 Hz: must be from 5 to"),
        (
            lambda: tr.random_wave(velocity_limit=0.5, peak_to_peak=20.0, low=-10.0, ramp=10.0, duration=20.0),
            "velocity_limit = 0.5",
        ),
        (
            lambda: tr.random_wave(velocity_limit=50.0),
            "ramp = 0.25 s: must be longer: at the velocity limit it takes 0.5",
        ),
        (lambda: tr.random_wave(seed=-1), "seed = -1"),
        (lambda: tr.Trajectory("x", 2000.0, np.zeros(3), np.zeros(4)), r"velocity = .* \(4,\): must be 3 ent"),
        (lambda: tr.Trajectory("x", 2000.0, np.array([0.0, np.nan]), np.zeros(2)), r"position\[1\]"),
        (lambda: tr.VelocityEstimator(0.0), "sample_rate"),
    ],
)
def test_bad_settings_are_named(call, message):
    with pytest.raises(SettingError, match=message):
        call()


# ---- Files ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "move.csv"
        path.write_text(text)
        return path

    return write


def test_csv_round_trip_with_units_and_velocity(write):
    wave = tr.sine(duration=0.5, sample_rate=1000.0)
    rows = np.column_stack([wave.time, 1e3 * wave.position, 1e3 * wave.velocity, 1e3 * wave.acceleration])
    path = write("time, z, v, a\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    move = tr.from_csv(path, position="z", time="time", velocity="v", acceleration="a", unit="nm", ramp=0.0)
    np.testing.assert_allclose(move.position, wave.position, atol=1e-12)
    np.testing.assert_allclose(move.velocity, wave.velocity, atol=1e-9)
    np.testing.assert_allclose(move.acceleration, wave.acceleration, atol=1e-7)
    assert move.settings["acceleration"] == "a"
    assert move.sample_rate == 1000.0
    guessed = tr.from_csv(path, position=2, sample_rate=1000.0, unit="nm", ramp=0.0)
    assert np.abs(guessed.velocity - wave.velocity).max() < 1e-3 * wave.peak_speed
    assert guessed.settings["acceleration"] == tr.ESTIMATED


def test_columns_by_name_by_number_and_from_npz_are_one_motion(write, tmp_path):
    wave = tr.sine(duration=0.5, sample_rate=1000.0)
    z = [repr(v) for v in (1e3 * wave.position).tolist()]
    path = write("volts (V),time (s),desired (nm)\n" + "\n".join(f"9,{k / 1000},{v}" for k, v in enumerate(z)))
    arrays = tmp_path / "move.npz"
    np.savez(arrays, time=wave.time, desired=wave.position, sample_rate=1000.0)
    asked = (
        {"time": "time", "position": "desired"},
        {"time": 2, "position": 3},
        {"time": "2", "position": "desired (nm)"},
    )
    moves = [tr.from_csv(path, ramp=0.0), *(tr.from_csv(path, ramp=0.0, **columns) for columns in asked)]
    for move in (*moves, tr.from_csv(arrays, ramp=0.0)):
        assert move.sample_rate == 1000.0
        np.testing.assert_allclose(move.position, wave.position, atol=1e-12)


def test_a_motion_is_headed_in_the_languages_of_a_record(tmp_path) -> None:
    rows = "".join(f"{k / 1000:.3f};{k * k / 1e4:.4f}\n" for k in range(100)).replace(".", ",")
    (tmp_path / "move.csv").write_text("Zeit [s];Weg [µm]\n" + rows, encoding="latin-1")
    move = tr.from_csv(tmp_path / "move.csv", ramp=0.0)
    assert (move.sample_rate, move.position[-1] - move.position[0]) == (1000.0, pytest.approx(0.9801))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"z": np.array([0.0, 1.0, np.nan, 3.0])}, "row 3: position is missing or no number"),
        ({"z": np.zeros(3)}, "3 rows; at least 4 are needed"),
        ({"z": np.array(["a"] * 5)}, "z is of type <U1, not a row of numbers"),
    ],
)
def test_npz_errors_name_the_array(tmp_path, arrays, message):
    np.savez(tmp_path / "move.npz", **arrays)
    with pytest.raises(RecordError, match=message):
        tr.from_csv(tmp_path / "move.npz", sample_rate=1.0)


def test_csv_starts_from_zero_by_the_ramp(write):
    move = tr.from_csv(write("7.5\n" * 1000), sample_rate=1000.0)
    assert move.position[0] == 0.0
    assert move.position[-1] == 7.5
    assert simpson_defect(move).max() < 1e-4


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, "the file is empty: was its program ended before it wrote"),
        ("1\n2\n3\n", {}, "3 rows; at least 4 are needed"),
        ("z\n1\n2\nnan\n4\n", {}, "line 4: position is missing or no number in 'nan'"),
        ("1\n2\nx\n4\n", {}, "line 3: position is missing or no number in 'x'"),
        ("1\n2\ninf\n4\n", {}, "line 3: position is infinite"),
        ("1,2\n2,3\n3\n4,5\n", {"position": 2}, "line 3: position is missing or no number in '3'"),
        ("0,1\n1,1\n2,1\n3.5,1\n4,1\n", {"position": 2, "time": 1}, "line 4: time is 3.5 s: must be 3 s"),
        ("t (ms),z\n0,1\n1,1\n2,1\n3.5,1\n4,1\n", {}, "line 5: time is 0.0035 s: must be 0.003 s"),
        ("t,z,desired\n0,1,1\n1,1,1\n2,1,1\n3,1,1\n", {}, "position: several columns could be it"),
        ("t,error (um)\n0,1\n1,1\n2,1\n3,1\n", {}, "which column is position"),
        ("0,1\n0,1\n0,1\n0,1\n", {"position": 2, "time": 1}, "must be above 0.0 s"),
        (
            "0,1,2\n1,1,2\n2,1,2\n3,1,2\n",
            {},
            r"which column is position\? Name it by `position`; there are column 1 \(begins 0",
        ),
        ("0,1\n1,1\n2,1\n3,1\n", {"position": 0}, "position: no column 0; they count from 1"),
        ("0\n1\n2\n3\n", {"position": 2}, r"no column 2; they count from 1, there is column 1 \(begins 0"),
        ("0,1\n1,1\n2,1\n3,1\n", {"position": "3"}, "position: no column 3; they count from 1"),
        ("t (s),z (inch)\n0,1\n1,1\n2,1\n3,1\n", {}, "is in inch; position is in um or nm or mm or m"),
        (
            "t,z\n1,1\n2,1\n3,1\n4,1\n",
            {"position": "y"},
            "position: no column 'y'; there are column 1 't'",
        ),
        ("0,1\n1,1\n2,1\n3,1\n", {"position": 2, "time": 1, "sample_rate": 2.0}, "sample_rate = 2.0 Hz: must be 1 Hz"),
        ("0\n1\n2\n3\n", {"sample_rate": None}, "which column is time"),
        ("0\n1\n2\n3\n", {"unit": "inch"}, "unit = 'inch': must be one of um, nm, mm, m"),
    ],
)
def test_csv_errors_name_the_row_and_the_reason(write, text, options, message):
    if "time" not in options and "sample_rate" not in options and "t" not in text:
        options = {**options, "sample_rate": 1.0}
    with pytest.raises((SettingError, RecordError), match=message):
        tr.from_csv(write(text), ramp=0.0, **options)


# ---- Sample by sample ----------------------------------------------------------------------------------------------


def test_velocity_estimate_is_exact_for_quadratics_and_errs_as_stated():
    rate, t = 2000.0, np.arange(4000) / 2000.0
    estimator = tr.VelocityEstimator(rate)
    quadratic = [estimator.update(z) for z in 3 + 2 * t - 5 * t**2]
    np.testing.assert_allclose(quadratic[2:], (2 - 10 * t)[2:], atol=1e-8)
    estimator.reset()
    assert estimator.update(5.0) == 0.0  # at rest
    estimator.reset()
    w = 2 * np.pi * 12.0
    error = np.array([estimator.update(z) for z in np.sin(w * t)]) - w * np.cos(w * t)
    assert np.abs(error[10:]).max() / w == pytest.approx((w / rate) ** 2 / 3, rel=0.02)


def test_velocity_estimate_passes_noise_as_stated():
    noise = np.random.Generator(np.random.PCG64(1)).normal(0.0, 1e-3, 100_000)
    estimator = tr.VelocityEstimator(2000.0)
    assert np.std([estimator.update(z) for z in noise]) == pytest.approx(5.1, rel=0.02)


def test_velocity_estimate_refuses_nan_and_goes_on():
    estimator = tr.VelocityEstimator(1.0)
    estimator.update(1.0)
    with pytest.raises(SettingError, match="z_d"):
        estimator.update(float("nan"))
    assert estimator.update(3.0) == 2.0


@pytest.mark.parametrize("absurd", [{"peak_to_peak": 1e300}, {"low": -1e300}])
def test_a_wave_beyond_a_kilometre_is_refused_by_name(absurd) -> None:
    with pytest.raises(SettingError, match=next(iter(absurd))):
        tr.random_wave(duration=1.0, **absurd)


def test_a_motion_that_does_not_fit_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr("truestroke.base.system.free_memory", lambda: 1.2e9)
    with pytest.raises(SettingError, match=r"duration = 20000\.0 s: must be at most 5e\+03 s at 2000 Hz: 4e\+07 ticks"):
        tr.sine(frequency=1.0, duration=20_000.0)
