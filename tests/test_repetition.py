"""What is added in a motion that repeats: the bits of kernel and NumPy text, and no bump at both ends."""

import pickle

import numpy as np
import pytest

from truestroke import RepetitiveController, _kernel, _kernel32
from truestroke.control.baselines import ConstantGain
from truestroke.control.repeating.repetition import (
    LearnedPeriod,
    Repetition,
    RepetitionSettings,
    Shape,
    kernel_repetition,
)


def sine(turns):
    return np.cos(2 * np.pi * turns) + 0.2 * np.sin(6 * np.pi * turns)


def triangle(turns):
    return 2 * np.abs(2 * (turns % 1) - 1) - 1


def learned(form=sine, size=100, period=None, change=30.0, settles=60):
    """Of a motion of 6 um about 5 um: a correction of some harmonics, and a level of 0.2 V."""
    turns = np.arange(size) / size
    volts = 0.1 * np.sin(2 * np.pi * turns + 1) + 0.03 * np.cos(10 * np.pi * turns)
    known = LearnedPeriod(Shape.of(5 - 3 * form(turns)), volts, 0.2, 10.0)
    return RepetitionSettings(
        period=period or size, change=change, share=0.3, ratio=5.0, settles=settles, learned=known
    )


def corrected(turns):
    """What it says at a phase, V, with its level."""
    return 0.1 * np.sin(2 * np.pi * turns + 1) + 0.03 * np.cos(10 * np.pi * turns), 0.2


def follow(repetition, motion, ticks, inside=lambda z_d: 0.1 * z_d, slew=10.0):
    """Added volts in each tick of a range."""
    added = []
    for k in ticks:
        z_d = float(motion(k))
        repetition.tick(z_d)
        added.append(repetition.volts(inside(z_d), -10.0, 10.0, slew) - inside(z_d))
    return np.array(added)


def moving(form=sine, period=100.0, amplitude=1.0, offset=0.0, turns=0.0):
    return lambda k: offset + amplitude * (5 - 3 * form(k / period + turns))


# ---- Bits ----------------------------------------------------------------------------------------------------------


def same(one, other):
    mine, its = one.state(), other.state()
    assert mine.keys() == its.keys()
    return [name for name in mine if not np.array_equal(mine[name], its[name])]


@pytest.mark.parametrize("share", [0.003, 0.01])
def test_a_long_period_that_wanders_repeats(share):
    """By so much within 50 periods: none of a thousand ticks was ever within 0.015 ticks of the one before."""
    settings, w = RepetitionSettings(period=1000.0), 2 * np.pi / 50
    text, kernel = Repetition(settings), kernel_repetition(settings)
    turns = np.arange(15_000) / 1000.0
    turns = turns + share * np.sin(w * turns) / w
    for z_d in (5 - 3 * sine(turns)).tolist():
        text.tick(z_d)
        kernel.tick(z_d)
    assert text.repeats
    assert same(text, kernel) == []


@pytest.mark.parametrize("seed", range(12))
def test_the_kernel_has_the_bits_of_the_text(seed):
    """Drawn forms, periods, amplitudes, offsets, rests, NaN, triggers, changes and limits."""
    rng = np.random.Generator(np.random.PCG64(seed))
    size, form = int(rng.integers(16, 120)), (sine, triangle)[seed % 2]
    settings = learned(form, size, size + rng.uniform(-0.45, 0.45) * (seed % 3 > 0), rng.uniform(5, 60), 50)
    if seed % 4 == 0:
        settings = RepetitionSettings(period=settings.period, change=settings.change, share=0.3)
    text, kernel = Repetition(settings), kernel_repetition(settings)
    amplitude, offset, turns = 1.0, 0.0, rng.uniform()
    pace = 1 / (settings.period * rng.choice([1.0, 0.99, 1.01]))
    joined = repeated = 0
    for k in range(3000):
        if rng.uniform() < 5e-4:
            amplitude, offset = rng.uniform(0.3, 1.5), rng.uniform(-3, 3)
        turns += pace * (k % 1500 < 1300)
        z_d = offset + amplitude * (5 - 3 * float(form(turns)))
        if seed % 5 == 4 and turns % 1 < pace and rng.uniform() < 0.999:
            text.trigger(), kernel.trigger()
        told = float(rng.choice([np.nan, np.inf, 1e60])) if rng.uniform() < 5e-4 else z_d
        assert text.tick(told) == kernel.tick(told)
        if settings.learned is None and text.repeats and rng.uniform() < 0.02:
            volts = rng.normal(size=size)
            assert text.become(volts, 0.1) == kernel.become(volts, 0.1)
            text.move(0.3, 20), kernel.move(0.3, 20)
        if settings.learned is None and rng.uniform() < 0.003:
            text.become(None, waits=30), kernel.become(None, waits=30)
        inside = 0.1 * z_d + 0.01 * rng.normal()
        assert text.volts(inside, -0.3, 0.8, 0.08) == kernel.volts(inside, -0.3, 0.8, 0.08)
        error = float(rng.choice([np.nan, 1e9])) if rng.uniform() < 0.01 else rng.normal()
        assert text.see(error, 10.0) == kernel.see(error, 10.0)
        assert (text.at, text.corrects, text.joined) == (kernel.at, kernel.corrects, kernel.joined)
        joined, repeated = joined + text.joined, repeated + text.repeats
        if k % 50 == 0:
            assert same(text, kernel) == []
    assert repeated
    assert joined or settings.learned is None or size < 40


class Reference(RepetitiveController):
    """With the NumPy text in place of the kernel."""

    _text = staticmethod(Repetition)


def test_a_repetitive_controller_has_the_same_bits_with_either():
    given = {"sample_rate": 2000.0, "voltage_limits": (-1.0, 2.02), "bandwidth": 250.0, "averaged": 0.1}
    both = [
        kind(ConstantGain(10.0, voltage_limits=(-1.0, 4.0)), 0.0503, **given)
        for kind in (RepetitiveController, Reference)
    ]
    z = [0.0, 0.0]
    for k in range(7000):
        w = 2 * np.pi * 20.0 / 2000.0
        z_d, velocity = 12.0 - 8.0 * np.cos(w * k), 8.0 * w * 2000.0 * np.sin(w * k)
        if k > 5000:
            z_d, velocity = 20.0, 0.0
        volts = [one.command(z_d, velocity) for one in both]
        assert volts[0] == volts[1], k
        for i, one in enumerate(both):
            z[i] += 0.6 * (10.0 * volts[i] - 0.15 * (volts[i] - 1.5) ** 3 - z[i])
            one.adapt(z[i] if k % 97 else np.nan)
    assert len(both[0].batches) == len(both[1].batches) > 1
    assert both[0].limited == both[1].limited > 0


def test_single_precision_follows_the_double():
    settings = learned(triangle, 100, 100.3)
    double, single = kernel_repetition(settings), _kernel32.Repetition(settings.members())
    motion = moving(triangle, 100.3 * 1.01, 0.7, 2.0, 0.3)
    added = [follow(one, motion, range(30_000), slew=0.5) for one in (double, single)]
    assert double.joined
    assert single.joined
    assert np.abs(added[0] - added[1])[5000:].max() < 1e-3


# ---- What was learned, alone -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [sine, triangle])
@pytest.mark.parametrize("told", [0.99, 1.0, 1.01])
def test_a_motion_of_the_learned_form_is_corrected_at_its_phase_and_amplitude(form, told):
    period = 100.0 * told
    motion = moving(form, period, amplitude=0.6, offset=1.5, turns=0.37)
    repetition = kernel_repetition(learned(form))
    added = follow(repetition, motion, range(4000))
    shape, level = corrected(np.arange(3000, 4000) / period + 0.37)
    assert repetition.joined
    assert repetition.period == pytest.approx(period, rel=1e-5)
    np.testing.assert_allclose(added[3000:], 0.6 * shape + level, atol=5e-4)
    assert not added[:200].any(), "three periods are needed"


def test_it_joins_leaves_and_joins_again_without_a_bump():
    """Another amplitude; a rest; the steepest step of the change is 15 / 8 of the mean one."""
    repetition, last = kernel_repetition(learned()), 0.0
    steepest = (15 / 8) * 0.33 / 30 + np.abs(np.diff(corrected(np.arange(1000) / 100)[0])).max()
    for motion, ticks in (
        (moving(), 1500),
        (moving(amplitude=0.7, offset=1.0), 1500),
        (lambda k: 5.0, 500),
        (moving(), 1500),
    ):
        added = follow(repetition, motion, range(ticks))
        assert abs(added[0] - last) < steepest
        assert np.abs(np.diff(added)).max() < steepest
        last = added[-1]
        rests = motion(0) == motion(25)
        assert repetition.joined != rests
        assert repetition.corrects != rests
        if rests:
            assert not added[-300:].any()


def test_a_triggered_motion_has_the_phase_of_the_trigger():
    """A motion with no phase of its own that a trigger, which is up to a tick late, does not tell."""
    motion, repetition = moving(period=99.3, turns=0.0), kernel_repetition(learned())
    added, turns = [], -1
    for k in range(6000):
        if int(k / 99.3) > turns:
            turns = int(k / 99.3)
            repetition.trigger()
        repetition.tick(motion(k))
        added.append(repetition.volts(0.0, -10.0, 10.0, 10.0))
    shape, level = corrected(np.arange(5000, 6000) / 99.3)
    assert repetition.joined
    assert np.abs(added[5000:] - shape - level).max() < 0.1 * np.ptp(shape)


@pytest.mark.parametrize("motion", [moving(triangle), moving(amplitude=0.05), moving(period=103.0), lambda k: 0.01 * k])
def test_another_motion_is_not_corrected(motion):
    """Another form, an amplitude that is far away, a period beyond 1.5 %, and none."""
    repetition = kernel_repetition(learned())
    assert not follow(repetition, motion, range(4000)).any()
    assert not repetition.corrects


def test_the_mean_of_the_error_is_taken_away_and_the_level_stays_within_the_range():
    repetition = kernel_repetition(learned())
    motion, plant = moving(), 0.0
    means = []
    for k in range(6000):
        z_d = float(motion(k))
        repetition.tick(z_d)
        volts = repetition.volts(0.1 * z_d, -10.0, 10.0, 10.0)
        plant = 10.0 * volts + (1.5 if k < 4000 else 3e3)
        repetition.see(plant - z_d, 10.0)
        means.append(plant - z_d)
        assert abs(repetition.goal) <= 20.0
    assert abs(np.mean(means[3900:4000])) < 0.01
    for k in range(100_000):
        repetition.see(5.9, 1e-3)
        repetition.tick(float(motion(6000 + k)))
        repetition.volts(0.0, -10.0, 10.0, 10.0)
    assert abs(repetition.goal) == 20.0


# ---- The state -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ticks", [0, 150, 420, 600, 2210])
def test_a_state_goes_on_with_the_same_bits(ticks):
    motion = moving(period=100.7, turns=0.2)
    one = kernel_repetition(learned())
    follow(one, motion, range(ticks))
    twin, other = kernel_repetition(learned()), pickle.loads(pickle.dumps(one))
    twin.restore(one.state())
    again = [follow(each, motion, range(ticks, ticks + 700)) for each in (one, twin, other)]
    assert np.array_equal(again[0], again[1])
    assert np.array_equal(again[0], again[2])


def wrong(name, place, value):
    def change(state):
        state[name][place] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        wrong("numbers", 2, np.nan),
        wrong("numbers", 1, 0.0),
        wrong("counts", 0, 100),
        wrong("counts", 0, -1),
        wrong("other", 3, np.inf),
        wrong("flags", 11, False),
        lambda state: state.pop("now"),
        lambda state: state.update(now=np.zeros(3)),
        lambda state: state.update(numbers=np.zeros(3)),
    ],
)
def test_what_is_no_state_is_refused_and_changes_nothing(change):
    repetition = kernel_repetition(learned())
    follow(repetition, moving(), range(1000))
    before = repetition.state()
    state = {name: array.copy() for name, array in before.items()}
    change(state)
    with pytest.raises(ValueError, match="state"):
        repetition.restore(state)
    after = repetition.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_settings_that_are_out_of_their_range_are_refused():
    members = learned().members()
    for name, value in (
        ("size", 8),
        ("size", 9000),
        ("period", 120.0),
        ("change", 0.5),
        ("share", 2.0),
        ("settles", -1),
        ("ratio", 0.5),
        ("sine", 0.5),
    ):
        with pytest.raises(ValueError, match=r"repetition|phase"):
            _kernel.Repetition({**members, name: value})
