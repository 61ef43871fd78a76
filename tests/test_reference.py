"""The kernel is the NumPy text: to the last bit in double, within a stated bound in single; it lives through rest."""

import dataclasses
import functools
import math
import types
from typing import Any

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings, Dynamics, Mode, SettingError, _kernel
from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LMS, RLS
from truestroke.control.baselines import ProjectedGradient
from truestroke.control.reference import HISTORY, ReferenceController
from truestroke.control.reference.published import PublishedController
from truestroke.model.models import ModifiedPrandtlIshlinskii, RateDependentModel

BASIC = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
STACK = RateDependentModel(  # Sec. 4.3
    r=np.arange(8) / 8 * 1.5,
    a=[8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23],
    b=[-0.9, 1.03, -0.244, 0.1, 0.05, -0.02, 0.01, -0.01],
)
STAGE = Dynamics(
    sample_rate=2000.0,
    modes=(Mode(frequency=220.0, damping=0.02, share=0.9), Mode(frequency=600.0, damping=0.03, share=0.1)),
    amplifier_bandwidth=500.0,
    dead_time=1.3e-3,
    sensor_delay=0.2e-3,
    sensor_bandwidth=700.0,
)
PLAIN = {"creep_times": (), "lag": False, "offset": False, "asymmetry": 0}  # no terms but the plays
MADE = {
    "paper": lambda: ControllerSettings.paper(**BASIC),
    "default": lambda: ControllerSettings(**BASIC),
    "no terms": lambda: ControllerSettings(**BASIC, **PLAIN),
    "rls with terms": lambda: ControllerSettings(**BASIC, law="rls", plays=8),
    "slow": lambda: ControllerSettings(**BASIC | {"sample_rate": 200.0}, slew_limit=40.0),
    "soon back": lambda: ControllerSettings(
        **BASIC, plays=5, rate_dependent=(1, 4), prior_return_time=0.02, change_share=1.0, asymmetry=1
    ),
    "at once, trimmed": lambda: ControllerSettings(
        **BASIC, smoothing_time=0.0, trim_rate=20.0, slope_limits=(7.0, 9.0)
    ),
    "one play": lambda: ControllerSettings.paper(**BASIC, plays=1, forgetting=1.0),
    "stage": lambda: ControllerSettings(**BASIC, dynamics=STAGE),
    "fed back": lambda: ControllerSettings(
        **BASIC, dynamics=Dynamics(sample_rate=2000.0, modes=(Mode(frequency=200.0, damping=0.02),)), hum=(50.0,)
    ),
    "hum alone": lambda: ControllerSettings(**BASIC, hum=50.0),
    "limits too wide": lambda: ControllerSettings(**BASIC | {"voltage_limits": (-10.0, 10.0)}, prior_return_time=0.5),
    "late sensor": lambda: ControllerSettings(**BASIC, sensor_delay=1.7e-3, sensor_bandwidth=300.0, resonance=400.0),
    "one of three axes": lambda: ControllerSettings(**BASIC, other_axes=2, plays=9),
    "beside one, stage": lambda: ControllerSettings(**BASIC, other_axes=1, dynamics=STAGE),
    "dead zones": lambda: ControllerSettings(
        **BASIC, dead_zone_thresholds=(0.0, 12.0, 20.0), dead_zone_weights=(1.0, -0.05, 0.03), offset=False
    ),
}


@functools.cache
def settings_of(name):
    """Made when a test wants them: to design a feedback takes as long as to collect all tests of this file."""
    return MADE[name]()


def random_wave(rng, ticks, swing=13.0):
    """Sum of six sines below 20 Hz around 15 um, from rest; um and um/s."""
    t = np.arange(ticks)[:, np.newaxis] / 2000.0
    amplitude = rng.uniform(0.2, 1.0, 6)
    omega, phase = 2 * np.pi * rng.uniform(1.0, 20.0, 6), rng.uniform(0, 2 * np.pi, 6)
    ramp = np.minimum(t[:, 0] / 0.1, 1.0)
    z_d = ramp * (15.0 + swing * (amplitude * np.sin(omega * t + phase)).sum(axis=1) / amplitude.sum())
    return z_d, np.gradient(z_d, 1 / 2000.0)


def observed(controller, whole=True):
    """Whatever both controllers show; of a part of it: what a tick may differ in without a trace in the next ones."""
    if not whole:
        return [controller.weights, controller.innovation, controller.flag_bits]
    if isinstance(controller, ReferenceController):
        counters = list(controller.counters.values())
        slopes, states = controller.partial_slopes, controller.play_states
    else:
        counted, diagnostics = controller.counters, controller.diagnostics
        counters = [getattr(counted, field.name) for field in dataclasses.fields(counted)]
        slopes, states = diagnostics.partial_slopes, diagnostics.play_states
    return [controller.weights, slopes, states, controller.innovation, controller.flag_bits, counters]


def assert_same(text, kernel, when="", whole=True):
    """To the last bit; the comparison that says where they differ costs as much as a tick, so it comes second."""
    for ours, theirs in zip(observed(text, whole), observed(kernel, whole), strict=True):
        if np.asarray(ours).tobytes() != np.asarray(theirs).tobytes():
            np.testing.assert_array_equal(ours, theirs, err_msg=when)


# ---- Kernel equals NumPy ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MADE)
def test_kernel_equals_numpy_to_the_last_bit(name) -> None:
    """Limits, guard, NaN, spikes, a change, missing, late and repeated measurements, nonsense that leads to the limits,
    hold, rest, start, new settings: voltage, weights, innovation, flags every tick; all that both show every tenth."""
    rng = np.random.default_rng(len(name))
    kernel, text = AdaptiveController.from_settings(settings_of(name)), ReferenceController(settings_of(name))
    z_d, zdot_d = random_wave(rng, 1300, swing=16.0)
    z_d[150:170] += 60.0  # saturation
    zdot_d[200:220] *= 1e4  # singularity: the guard
    z_d[500:600], zdot_d[500:600] = z_d[500], 0.0  # rest
    plant = ModifiedPrandtlIshlinskii(r=STACK.r, w_h=STACK.a, d=[0, 12, 20], w_s=[1, 0.06, -0.04])
    z_a, y = np.zeros(z_d.size), np.zeros(8)
    seen = 0
    kernel.start(1.25, 17.0), text.start(1.25, 17.0)
    ago_most = 5 if name == "slow" else 67
    for k in range(z_d.size):
        known = [(), (30.0 * zdot_d[k],), (None, z_d[k] + 1e-3 * zdot_d[k])][k // 10 % 3]
        others = settings_of(name).other_axes
        taken = 0.5 * z_d[k] * np.cos(0.3 * k + np.arange(3.0 * others)) * np.tile([1.0, 1e2, 1e4], others)
        among = {"others": taken.tolist()} if others and k % 7 else {}
        x = kernel.command(z_d[k], zdot_d[k], *known, **among)
        assert text.command(z_d[k], zdot_d[k], *known, **among) == x
        z_a[k], y = plant.step(x, y)
        z_a[k] += 0.05 * taken[:1].sum()
        z_a[k] *= 1.0 if k < 700 else 0.75  # a sudden change
        ago = int(rng.choice([0, 0, 0, 0, 1, rng.integers(-1, ago_most)])) if k < 650 or k > 800 else 0
        measured = z_a[min(max(k - ago, 0), k)] + 0.03 * rng.standard_normal() + 40.0 * (rng.random() < 0.02)
        if 1050 <= k < 1150:
            measured = 0.03 * rng.standard_normal()  # the cable is off: to the limit, and beyond the aim when it is on
        fate = rng.random()
        if k % 90 == 0 and name != "slow" and not 600 <= k < 850:
            ago = HISTORY + k // 90 % 3 - 1  # the oldest that may come, and one too old
        if fate > 0.1 and not 850 <= k < 940:  # and a silence
            measured = {0: np.nan, 1: -np.inf, 2: 1e9}.get(int(fate * 100) % 25, measured)
            kernel.adapt(measured, ago)
            text.adapt(measured, ago)
        if fate > 0.99:
            kernel.hold(), text.hold()
        elif fate > 0.9:
            kernel.resume(), text.resume()
        assert_same(text, kernel, f"tick {k}", whole=k % 10 == 0)
        seen |= text.flag_bits
        if k == 1000 and name != "paper":
            same = kernel.settings.dead_zone_weights
            changes = {"trim_rate": 5.0, "prior_return_time": 1.0, "dead_zone_weights": same}
            kernel.change(**changes), text.change(dataclasses.replace(text.settings, **changes))
    assert seen & 0b001101 == 0b001101, "limits, refusals and hold were met"
    assert name not in ("paper", "at once, trimmed") or seen & 0b000010, "slopes were limited"
    if text.settings.law == "kalman":
        assert seen & 0b100000, "the slew limit was met"
        rests = name == "fed back"  # behind each hold its law waits for a period of its stage
        assert rests or seen & 0b10010000, "a change, or learning that failed, was met"
    kernel.reset(), text.reset()
    assert_same(text, kernel, "reset")


def closed_loop(controller, z_d, zdot_d, noise):
    y, z_a, volts = np.zeros(8), np.zeros(z_d.size), np.zeros(z_d.size)
    for k in range(z_d.size):
        volts[k] = controller.command(z_d[k], zdot_d[k])
        z_a[k], y = STACK.step(volts[k], zdot_d[k], y)
        controller.adapt(z_a[k] + noise[k])
    return volts, z_a - z_d


@pytest.mark.parametrize("seed", [0, 1])
def test_single_precision_is_within_its_bound(seed) -> None:
    """Five seconds of the published stack with 20 nm noise: 50 mV at any tick, and no larger error after 2.5 s."""
    rng = np.random.default_rng(seed)
    z_d, zdot_d = random_wave(rng, 10_000)
    noise = 0.02 * rng.standard_normal(z_d.size)
    double, error = closed_loop(AdaptiveController.from_settings(settings_of("paper")), z_d, zdot_d, noise)
    settings = dataclasses.replace(settings_of("paper"), precision="single")
    single, error_single = closed_loop(AdaptiveController.from_settings(settings), z_d, zdot_d, noise)
    assert np.max(np.abs(single - double)) < 0.05
    assert np.sqrt(np.mean(error_single[5000:] ** 2)) < 1.1 * np.sqrt(np.mean(error[5000:] ** 2)) + 0.001


@pytest.mark.parametrize("name", ["paper", "default"])
def test_every_variant_of_the_kernel_gives_the_same_bits(name) -> None:
    """Vectors of any width, and none: what the processor has must not show."""
    z_d, zdot_d = random_wave(np.random.default_rng(2), 1500)
    fastest, states = _kernel.variant(), {}
    assert fastest == _kernel.variants()[-1]
    try:
        for variant in _kernel.variants():
            _kernel.use_variant(variant)
            controller = AdaptiveController.from_settings(settings_of(name))
            volts = controller.process(z_d, zdot_d, z_d + 0.3 * np.sin(np.arange(z_d.size)))
            states[variant] = controller.state() | {"volts": volts}
    finally:
        _kernel.use_variant(fastest)
    assert {"plain", "vector"} <= set(states)
    for variant, state in states.items():
        for entry, value in state.items():
            np.testing.assert_array_equal(value, states["plain"][entry], err_msg=f"{variant}: {entry}")
    with pytest.raises(ValueError, match="no kernel variant mmx"):
        _kernel.use_variant("mmx")


# ---- Algebra of the interface ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("ago", [0, 7])
@pytest.mark.parametrize("name", ["paper", "default"])
def test_a_block_is_sample_by_sample_and_a_saved_run_goes_on(name, precision, ago) -> None:
    """To the last bit; blocks of uneven length, saved and restored between them."""
    rng = np.random.default_rng(5)
    settings = dataclasses.replace(settings_of(name), precision=precision)
    z_d, zdot_d = random_wave(rng, 700)
    measured = z_d + 0.5 * rng.standard_normal(z_d.size)
    measured[rng.random(z_d.size) < 0.05] = np.nan
    one_by_one = AdaptiveController.from_settings(settings)
    volts = []
    for k in range(z_d.size):
        volts.append(one_by_one.command(z_d[k], zdot_d[k]))
        one_by_one.adapt(measured[k], ago)
    state, blocks = AdaptiveController.from_settings(settings).state(), []
    for block in np.split(np.arange(z_d.size), [1, 20, 333, 640]):
        controller = AdaptiveController.from_settings(settings)
        controller.restore(state)
        blocks.append(controller.process(z_d[block], zdot_d[block], measured[block], ago=ago))
        state = controller.state()
    np.testing.assert_array_equal(np.concatenate(blocks), volts)
    for name, value in one_by_one.state().items():
        np.testing.assert_array_equal(state[name], value, err_msg=name)


# ---- Five minutes ----------------------------------------------------------------------------------------------------

MINUTES_5 = 600_000  # with P as printed the law stopped after two


def inputs(kind, rng):
    """Ten seconds: desired displacement, velocity, measurement."""
    rest, t = np.zeros(20_000), np.arange(20_000) / 2000.0
    noise = 0.03 * rng.standard_normal(t.size)
    if kind == "zero":
        return rest, rest, noise
    if kind == "constant":
        return rest + 15.0, rest, 15.0 + noise
    omega = 2 * np.pi * 8.0
    z_d, zdot_d = 15.0 + 12.0 * np.sin(omega * t), 12.0 * omega * np.cos(omega * t)
    lost = rng.choice([0.0, np.nan, np.inf], t.size, p=[0.7, 0.29, 0.01])
    return z_d, zdot_d, z_d + noise + lost


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ["paper", "default"])
@pytest.mark.parametrize("kind", ["zero", "constant", "NaN-laced sine"])
def test_five_minutes_leave_every_state_finite_and_the_law_alive(kind, name, precision) -> None:
    rng = np.random.default_rng(9)
    controller = AdaptiveController.from_settings(dataclasses.replace(settings_of(name), precision=precision))
    z_d, zdot_d, measured = inputs(kind, rng)
    for _ in range(MINUTES_5 // z_d.size):
        controller.process(z_d, zdot_d, measured)
    assert controller.counters.commands == MINUTES_5
    for entry, value in controller.state().items():
        assert np.isfinite(value).all(), entry
    # Next to no measurement but the lost ones was refused, and P stayed within its limit.
    lost = np.count_nonzero(~np.isfinite(measured)) * MINUTES_5 // z_d.size
    assert lost <= controller.counters.rejected <= lost + 20
    if name == "paper":
        assert controller.diagnostics.trace_P <= controller.settings.covariance_limit * 1.0001
        return
    P0 = np.array(controller.settings.prior_covariance)
    within = np.sqrt(np.diag(controller.covariance) / np.diag(P0))
    assert within.max() < 1.0 + 1e-6
    np.linalg.cholesky(controller.covariance)  # positive definite
    # The measurement does not answer the voltage here, so the weights may wander; the prior and the slopes hold them.
    deviation = (controller.weights - controller.settings.initial_weights) / np.sqrt(np.diag(P0))
    assert np.abs(deviation).max() < 20.0


def exactly_modelled(controller, z_d, zdot_d, noise, memory=0.0):
    """A plant that the paper's thresholds can hold, 9 x + 4 H_0.375[x]; returns the true error, um, and memory, V."""
    error = np.zeros(z_d.size)
    for k, (z, v, e) in enumerate(zip(z_d.tolist(), zdot_d.tolist(), noise.tolist(), strict=True)):
        x = controller.command(z, v)
        memory = max(x - 0.375, min(x + 0.375, memory))
        error[k] = 9.0 * x + 4.0 * memory - z
        controller.adapt(9.0 * x + 4.0 * memory + e)
    return error, memory


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize(("name", "bound"), [("paper", 0.01), ("default", 0.01)])
@pytest.mark.parametrize("z_rest", [0.0, 15.0])
def test_after_rest_the_law_follows_again(z_rest, name, bound, precision) -> None:
    """True rmse in um half a second after the rest, with 20 nm noise.

    With P as printed the law stopped for good: in double after two minutes, in single after 0.2 s.
    """
    rng = np.random.default_rng(4)
    controller = AdaptiveController.from_settings(dataclasses.replace(settings_of(name), precision=precision))
    wave = random_wave(rng, 4000)
    rest = np.full(30_000, z_rest), np.zeros(30_000)  # 15 s
    memory = 0.0
    for z_d, zdot_d in (wave, rest, wave):
        noise = 0.02 * rng.standard_normal(z_d.size)
        error, memory = exactly_modelled(controller, z_d, zdot_d, noise, memory)
    assert controller.counters.rejected <= 3
    assert np.sqrt(np.mean(error[1000:] ** 2)) < bound


# ---- Any law ---------------------------------------------------------------------------------------------------------


def test_any_law_goes_in_the_loop_and_learns() -> None:
    """LMS on the published stack ends below a tenth of where it began; on hold it does not learn."""
    rng = np.random.default_rng(2)
    z_d, zdot_d = random_wave(rng, 3000)
    settings = settings_of("paper")
    controller = ReferenceController(settings, LMS(settings.initial_weights, step_size=0.5))
    _, error = closed_loop(controller, z_d, zdot_d, np.zeros(z_d.size))
    held = ReferenceController(settings, LMS(settings.initial_weights))
    held.hold()
    _, error_held = closed_loop(held, z_d, zdot_d, np.zeros(z_d.size))
    assert np.sqrt(np.mean(error[1500:] ** 2)) < 0.1 * np.sqrt(np.mean(error_held[1500:] ** 2))
    np.testing.assert_array_equal(held.weights, settings.initial_weights)


@pytest.mark.parametrize("dead_zones", [{}, {"dead_zone_thresholds": (0.0, 10.0), "dead_zone_weights": (1.0, 0.05)}])
@pytest.mark.parametrize("kind", ["LMS", "gradient"])
def test_what_the_paper_has_alone_gives_the_same_bits(kind: str, dead_zones: dict[str, Any]) -> None:
    """Beyond its voltage limits and without some measurements, too."""
    settings = ControllerSettings.paper(**BASIC, **dead_zones)
    first = settings.initial_weights
    law: Any = {"LMS": lambda: LMS(first), "gradient": lambda: ProjectedGradient(first, forgetting=0.9, slope_min=0.3)}
    whole, alone = (make(settings, law[kind]()) for make in (ReferenceController, PublishedController))
    rng = np.random.default_rng(4)
    for k, (z_d, zdot_d) in enumerate(zip(*random_wave(rng, 400), strict=True)):
        volts = whole.command(1.6 * z_d, zdot_d)
        assert alone.command(1.6 * z_d, zdot_d) == volts
        for controller in (whole, alone):
            controller.adapt(np.nan if k % 50 == 7 else 10.0 * volts + 0.3 * math.sin(0.1 * k))
        np.testing.assert_array_equal(alone.weights, whole.weights)
        np.testing.assert_array_equal(alone.partial_slopes, whole.partial_slopes)
        assert (alone.innovation, alone.flag_bits) == (whole.innovation, whole.flag_bits)
    assert min(whole.counters["saturated"], whole.counters["rejected"]) > 0


def test_a_part_that_the_paper_does_not_have_is_refused() -> None:
    for more in ({"offset": True}, {"trim_rate": 20.0}):
        settings = ControllerSettings.paper(**BASIC, **more)
        with pytest.raises(SettingError, match=r"settings = .*: must be those of ControllerSettings.paper"):
            PublishedController(settings, LMS(settings.initial_weights))
    published = PublishedController(settings_of("paper"), LMS(settings_of("paper").initial_weights))
    published.command(10.0, 0.0)
    with pytest.raises(SettingError, match="ago = 1"):
        published.adapt(10.0, 1)


class Broken(LMS):
    """A law of a user's own, with a mistake."""

    def __init__(self, mistake: str) -> None:
        super().__init__(settings_of("default").initial_weights)
        self.mistake = mistake

    def update(self, u: FloatArray, e_m: float) -> Any:
        if self.mistake == "returns":
            return self.weights + e_m * u
        made = {"NaN": self.weights * np.nan, "column": self.weights[:, None], "list": list(self.weights)}
        self.weights = made[self.mistake]
        return None


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        ("returns", r"law.update\(\) = array of shape \(41,\): must be None; assign new weights to self.weights"),
        ("NaN", r"law.weights\[0\] = nan um/V: must be finite"),
        ("column", r"law.weights = array of shape \(41, 1\): must be an array of shape \(41,\)"),
        ("list", r"law.weights = .*: must be an array of shape \(41,\)"),
    ],
)
def test_a_mistake_in_a_law_of_ones_own_is_named_at_its_first_tick(mistake: str, said: str) -> None:
    controller = ReferenceController(settings_of("default"), Broken(mistake))
    controller.command(10.0, 0.0)
    with pytest.raises(SettingError, match=said):
        controller.adapt(9.0)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (LMS, "law = the class LMS: must be a law, .*; call the class to make one"),
        (types.SimpleNamespace(weights=np.ones(41)), r"must be a law, .*; it has no update\(\)"),
        (
            types.SimpleNamespace(weights=np.ones(41), update=lambda u: None),
            r"law.update = update\(u\): must be callable as update\(u, e_m\)",
        ),
        (types.SimpleNamespace(update=print), r"law.weights = None: must be an array of shape \(41,\)"),
    ],
)
def test_what_is_no_law_is_refused(law: Any, said: str) -> None:
    with pytest.raises(SettingError, match=said):
        ReferenceController(settings_of("default"), law)
    with pytest.raises(SettingError, match=r"settings = .*: must be a ControllerSettings"):
        ReferenceController(BASIC)  # type: ignore[arg-type]


def test_a_bad_desired_value_or_setting_is_named_and_changes_nothing() -> None:
    controller = ReferenceController(settings_of("default"))
    for measured, words in (
        ((1.0, "3"), "ago = '3'"),
        ((1.0, 1.5), "ago = 1.5: must be a whole"),
        ((None,), "z_measu"),
    ):
        with pytest.raises(SettingError, match=words):
            controller.adapt(*measured)
    controller.command(10.0, 0.0)
    before = observed(controller)
    with pytest.raises(SettingError, match="zdot_d = nan um/s: must be finite"):
        controller.command(1.0, np.nan)
    for ours, theirs in zip(observed(controller), before, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    with pytest.raises(SettingError, match="precision = 'single'"):
        ReferenceController(dataclasses.replace(settings_of("default"), precision="single"))
    with pytest.raises(SettingError, match=r"law.weights = array of shape \(2,\): must be an array of shape \(41,\)"):
        ReferenceController(settings_of("default"), RLS([5.0, 0.0]))
