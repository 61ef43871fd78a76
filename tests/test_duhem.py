"""States of Duhem in the controller's model: minor loops that do not close."""

import numpy as np
import pytest

import truestroke
from truestroke import AdaptiveController, ControllerSettings, SettingError, run, trajectories
from truestroke.control.reference import ReferenceController
from truestroke.model.models import duhem_change
from truestroke.plant import StagePlant, StageSettings

AXIS = {"sample_rate": 10_000.0, "stroke": 24.0, "voltage_limits": (-0.6, 3.6)}


def exact(c: float, before: float, x: float, length: float) -> float:
    """The solution of dc / d|x| = (x - c) / length on a straight way."""
    way, sign = abs(x - before), 1.0 if x > before else -1.0
    return x - sign * length + (c - before + sign * length) * np.exp(-way / length)


def stepped(volts: np.ndarray, length: float) -> np.ndarray:
    """The state after each voltage, from rest at 0 V."""
    c, before, states = np.zeros(1), 0.0, []
    for x in volts.tolist():
        c = c + duhem_change(c, before, x - before, np.array([length]))
        before = x
        states.append(float(c[0]))
    return np.array(states)


class TestStates:
    @pytest.mark.parametrize("ticks", [20, 40, 80])
    def test_they_follow_the_equation_to_the_second_order(self, ticks):
        turns, c, before = [2.0, -1.0, 1.5], 0.0, 0.0
        for x in turns:
            c, before = exact(c, before, x, 1.3), x
        ways = [np.linspace(a, b, ticks + 1)[1:] for a, b in zip([0.0, *turns], turns, strict=False)]
        assert abs(stepped(np.concatenate(ways), 1.3)[-1] - c) < 2.0 / ticks**2

    def test_minor_loops_do_not_close_and_end_about_their_middle(self):
        up, down = np.linspace(0.0, 2.0, 400), np.linspace(2.0, 1.0, 200)
        loops = np.concatenate([up, *[down, down[::-1]] * 30])
        tops = stepped(loops, 0.5)[399::400]
        assert abs(tops[1] - tops[0]) > 0.1  # the first loop does not come back to where it began
        assert abs(tops[-1] - tops[-2]) < 1e-6
        forgotten = np.exp(-2.0)  # of a way of 1 V, two lengths; the loop that closes is symmetrical about 1.5 V
        assert tops[-1] == pytest.approx(1.5 + forgotten / (1 + forgotten), abs=1e-5)

    def test_a_way_that_is_far_longer_than_the_length_ends_in_the_middle_of_it(self):
        change = duhem_change(np.zeros(1), 0.0, 1e6, np.array([1e-6]))
        assert change == pytest.approx(5e5, rel=1e-3)


def with_weights(seed: int, **changes: object) -> ControllerSettings:
    """A controller whose first weights have states of Duhem that act."""
    default = ControllerSettings(**AXIS, **changes)
    weights, random = np.array(default.initial_weights), np.random.default_rng(seed)
    weights[default.columns["duhem"]] = random.uniform(-0.3, 0.3, 2) * default.q
    return ControllerSettings(**AXIS, **changes, initial_weights=tuple(weights.tolist()))


class TestCommand:
    @pytest.mark.parametrize("seed", range(8))
    def test_the_model_goes_where_it_is_asked(self, seed):
        """With the voltages of the command, plays and exact states give the desired displacement."""
        settings = with_weights(seed, creep_times=(), lag=False, offset=False, asymmetry=0, rate_dependent=())
        controller = AdaptiveController.from_settings(settings)
        wave = trajectories.random_wave(
            cutoff=80.0, peak_to_peak=14.0, low=3.0, duration=0.5, sample_rate=10_000.0, seed=seed
        )
        w, r, play = np.array(settings.initial_weights), np.array(settings.thresholds), np.zeros(settings.plays)
        states, before, errors = [0.0, 0.0], 0.0, []
        for z_d, zdot_d in zip(wave.position.tolist(), wave.velocity.tolist(), strict=True):
            x = controller.command(z_d, zdot_d)
            play = np.maximum(x - r, np.minimum(x + r, play))
            states = [exact(c, before, x, length) for c, length in zip(states, settings.duhem_lengths, strict=True)]
            before = x
            errors.append(w[settings.a] @ play + w[settings.columns["duhem"]] @ states - z_d)
        assert np.abs(errors[50:]).max() < 2e-3  # um: the slew limit is met at the start

    def test_kernel_and_text_have_the_same_bits(self):
        settings = with_weights(3)
        pair = AdaptiveController.from_settings(settings), ReferenceController(settings)
        plant, wave = (
            StagePlant(StageSettings(**AXIS), seed=1),
            trajectories.sine(
                frequency=70.0, peak_to_peak=9.0, offset=8.0, duration=0.2, ramp=0.05, sample_rate=10_000.0
            ),
        )
        plant.open()
        for z_d, zdot_d in zip(wave.position.tolist(), wave.velocity.tolist(), strict=True):
            volts = [controller.command(z_d, zdot_d) for controller in pair]
            assert volts[0] == volts[1]
            z = float(plant.exchange(np.array(volts[:1]))[0])
            for controller in pair:
                controller.adapt(z)
        assert np.array_equal(pair[0].weights, pair[1].weights)
        assert np.abs(pair[0].weights[settings.columns["duhem"]]).min() > 0


class TestLaw:
    @pytest.mark.parametrize("exponent", [1.0, 1.8])
    def test_of_a_bouc_wen_stage_half_of_the_error_is_gone(self, exponent):
        stage = StageSettings(**AXIS, hysteresis_kind="bouc-wen", bouc_wen_exponent=exponent)
        wave = trajectories.random_wave(
            cutoff=170.0, peak_to_peak=13.0, low=4.0, duration=2.0, sample_rate=10_000.0, seed=4
        )
        measured = truestroke.measure_dynamics(StagePlant(stage, seed=1), voltage_limits=AXIS["voltage_limits"])
        errors = []
        for lengths in ((), None):
            controller = AdaptiveController(**AXIS, dynamics=measured, duhem_lengths=lengths)
            recording = run(wave, controller, StagePlant(stage, seed=2))
            errors.append((recording["true"] - recording["desired"])[10_000:].std())
        assert errors[1] < 0.5 * errors[0]


class TestSettings:
    def test_the_paper_has_none_and_the_default_follows_the_voltage_range(self):
        assert ControllerSettings.paper(**AXIS).duhem_lengths == ()
        assert ControllerSettings(**AXIS, law="rls").duhem_lengths == ()
        assert ControllerSettings(**AXIS).duhem_lengths == pytest.approx((4.2, 1.05))
        assert ControllerSettings(**AXIS).names[-2:] == ("duhem 4.2 V", "duhem 1.05 V")

    @pytest.mark.parametrize("lengths", [(0.0,), (-1.0,), (float("nan"),), (1.0,) * 5, 3.0, ("far",)])
    def test_lengths_that_are_none_are_refused(self, lengths):
        with pytest.raises(SettingError, match="duhem_lengths"):
            ControllerSettings(**AXIS, duhem_lengths=lengths)
