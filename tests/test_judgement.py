"""The verdict of a run: the mistakes that owners make, and good runs that look odd."""

from __future__ import annotations

import dataclasses
import json
import re
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from truestroke import AdaptiveController, Timing, metrics, run, trajectories
from truestroke.base.flags import BIT
from truestroke.base.verdict import Verdict
from truestroke.cli import main
from truestroke.cli.realtime import code_of
from truestroke.control.baselines import ConstantGain
from truestroke.plant import Change, PlantSettings, RealisticPlant
from truestroke.runtime.drivers import SimulatedDriver, SimulatedSettings
from truestroke.runtime.realtime import Axis, RealtimeSettings, config, run_realtime
from truestroke.runtime.realtime.ending import Cause
from truestroke.signals import judgement
from truestroke.signals.judgement import judge
from truestroke.signals.recording import Channel, Recording

RATE, LIMITS = 2000.0, (-0.6, 3.6)
UNITS = {"time": "s", "flags": "", "volts": "V"}
TIME = np.arange(8000) / RATE
NOISE = np.random.Generator(np.random.PCG64(0)).normal(size=40_000)


class Wired:
    """A stack of 10 um/V that answers at once, behind a sensor with 10 nm of noise; `wrongly` is what went wrong."""

    def __init__(self, wrongly=lambda z, k: z):
        self.wrongly, self.ticks = wrongly, 0

    def open(self):
        return Timing(sample_rate=RATE)

    def exchange(self, volts):
        k = self.ticks + np.arange(volts.size)
        self.ticks += volts.size
        return self.wrongly(10.0 * volts, k) + 0.01 * NOISE[k % NOISE.size]


def followed(wrongly=lambda z, k: z, peak_to_peak=20.0, duration=2.0, **settings):
    controller = AdaptiveController(sample_rate=RATE, stroke=30.0, voltage_limits=LIMITS, **settings)
    wave = trajectories.sine(frequency=4.0, peak_to_peak=peak_to_peak, duration=duration)
    return run(wave, controller, Wired(wrongly))


def made(measured, desired=None, metadata=None, **more):
    """A recording of these arrays; its stroke is 30 um."""
    time = np.arange(measured.size) / RATE
    desired = wave(measured.size) if desired is None else desired
    arrays = {"time": time, "desired": desired, "measured": measured, **more}
    about = {"controller": {"name": "AdaptiveController", "settings": {"stroke": 30.0}}} | (metadata or {})
    return Recording({name: Channel(data, UNITS.get(name, "um"), name) for name, data in arrays.items()}, about)


def wave(ticks=8000, size=10.0, frequency=4.0):
    return size * (1 - np.cos(2 * np.pi * frequency * np.arange(ticks) / RATE))


def noisy(z, sigma=0.013):
    return z + sigma * NOISE[: z.size]


def flags(ticks=8000, **parts):
    bits = np.zeros(ticks, np.uint8)
    for name, part in parts.items():
        bits[part] |= BIT[name]
    return bits


def judged(recording):
    verdict = judgement.judge(recording)
    return verdict.level, " ".join(verdict.reasons)


# ---- The mistakes of the issue -------------------------------------------------------------------------------------

MISTAKES = {
    "sign": (followed, {"wrongly": lambda z, k: -z}, "the sign of sensor or actuator is wrong"),
    "gain": (followed, {"wrongly": lambda z, k: z / 20}, "voltage limit"),
    "no sensor": (followed, {"wrongly": lambda z, k: 0 * z}, "voltage limit"),
    "another axis": (followed, {"wrongly": lambda z, k: 5 * np.sin(k / 900)}, "voltage limit"),
    "beyond the stroke": (followed, {"peak_to_peak": 200.0}, "voltage limit"),
    "not zeroed": (followed, {"wrongly": lambda z, k: z + 55}, "voltage limit"),
}


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")  # one is beyond the stroke
@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_of_the_owner_is_bad_and_says_why(kind):
    make, options, why = MISTAKES[kind]
    recording = make(**options)
    level, text = judged(recording)
    assert level == "bad"
    assert why in text
    assert "of the motion's peak-to-peak" in text
    assert metrics.summary(recording, stroke=30.0).convergence_time_s is None


def test_the_sensor_that_goes_against_the_motion_is_named():
    level, text = judged(made(noisy(-wave())))
    assert level == "bad"
    assert "moved -1.00 times as far as desired: the sign" in text
    assert "the unit or the gain" in judged(made(noisy(3 * wave())))[1]
    assert "not its sensor" in judged(made(noisy(0 * wave())))[1]


@pytest.mark.parametrize(("times", "words"), [(1e3, "report in nm"), (1e-3, "report in mm"), (100.0, "not its scale")])
def test_a_sensor_in_another_unit_is_named_and_no_resonance(times, words):
    about = {"controller": {"settings": {"stroke": 30.0, "voltage_limits": LIMITS}}}
    made_of = made(times * noisy(wave()), metadata=about, volts=wave() / 10.0, flags=flags(saturated=slice(4000, 8000)))
    unit, *others = judge(made_of).reasons
    assert words in unit
    assert "um/V, where stroke and voltage limits make 7.14" in unit
    assert all(one.startswith("The error is") for one in others)
    assert judge(followed(lambda z, k: 1e3 * z, duration=0.5)).reasons[0].startswith("The sensor shows 10000 um/V")


def test_a_stage_that_shakes_is_bad_however_much_its_shaking_looks_like_noise():
    for frequency in (50.0, 80.0, 200.0, 500.0, 900.0):
        shaking = 8.0 * np.sin(2 * np.pi * frequency * np.arange(8000) / RATE)
        assert judged(made(noisy(wave() + shaking)))[0] == "bad", frequency


@pytest.mark.parametrize("what", ["a load", "a wrong sign", "a voltage limit", "a sensor at its end"])
def test_what_is_not_followed_at_all_is_not_put_down_to_a_load(what):
    """A controller that is wrong about its actuator hears lines in the error."""
    heard, load = {"load": {"frequency_hz": 41.2, "amplitude_um": 0.85}}, 0.85 * np.sin(2 * np.pi * 41.2 * TIME)
    runs = {
        "a load": made(noisy(wave() + load), metadata=heard),
        "a wrong sign": made(noisy(-wave()), metadata=heard),
        "a voltage limit": made(noisy(np.minimum(wave(), 12.0)), metadata=heard, flags=flags(saturated=wave() > 12.0)),
        "a sensor at its end": made(np.minimum(noisy(wave()), 12.0), volts=wave() / 10.0, metadata=heard),
    }
    assert ("A load of 41.2 Hz" in judged(runs[what])[1]) is (what == "a load")


def test_a_mode_that_the_dynamics_lack_is_said_where_it_rang_with_a_quarter_of_what_is_tolerable():
    """Of 2 % of the motion, 0.1 um; not where another cause is certain, nor beside a sensor at its end."""
    heard = {"beyond_resonance": {"frequency_hz": 1718.2, "amplitude_um": 0.15}}
    assert judged(made(noisy(wave()), metadata=heard))[0] == "doubtful"
    assert "1718 Hz" in judged(made(noisy(wave()), metadata=heard))[1]
    assert judged(made(noisy(wave()), metadata={"beyond_resonance": None}))[0] == "good"
    heard["beyond_resonance"]["amplitude_um"] = 0.05
    assert judged(made(noisy(wave()), metadata=heard))[0] == "good"
    heard["beyond_resonance"]["amplitude_um"] = 8.5
    at_its_end = made(np.minimum(noisy(wave()), 12.0), volts=wave() / 10.0, metadata=heard)
    for other in (made(noisy(-wave()), metadata=heard), at_its_end):
        assert "1718 Hz" not in judged(other)[1]


def test_a_shaken_stage_that_the_controller_calmed_is_said():
    level, text = judged(made(noisy(wave()), flags=flags(oscillating=slice(100, 900))))
    assert level == "doubtful"
    assert "10 % of the ticks" in text
    assert "`resonance` (Hz)" in text


def test_a_shaken_stage_is_told_with_the_resonance_that_was_found():
    for known, name in ((79.31, "x"), ({"x": 79.31, "y": None}, "x")):
        about = {"resonance": known, "axis": {"name": name}}
        text = judged(made(noisy(wave()), flags=flags(oscillating=slice(100, 900)), metadata=about))[1]
        assert "at about 79 Hz" in text
        assert "`resonance = 79` (Hz)" in text
    for known in ("79", {"y": 79.31}, -79.31, None, [79.31]):
        about = {"resonance": known, "axis": {"name": "x"}}
        text = judged(made(noisy(wave()), flags=flags(oscillating=slice(100, 900)), metadata=about))[1]
        assert "`resonance` (Hz)" in text


@pytest.mark.filterwarnings("ignore::truestroke.LatenessWarning")  # what is found does not depend on it
def test_runs_write_down_the_resonance_that_they_found(tmp_path):
    soft = PlantSettings(resonance=80.0)
    sine = trajectories.sine(frequency=10.0, peak_to_peak=20.0, duration=1.0)

    def controller():
        return AdaptiveController(sample_rate=RATE, stroke=30.0, voltage_limits=(-0.6, 3.6), slew_limit=1000.0)

    axis = Axis(trajectory=sine, controller=controller(), voltage_limits=(-0.6, 3.6), slew=1000.0)
    settings = RealtimeSettings(spin=0.0, watchdog_timeout=9.0, overrun_streak=0)
    file = tmp_path / "soft.h5"
    run_realtime(SimulatedDriver(SimulatedSettings(plant={"resonance": 80.0})), [axis], file, settings=settings)
    for recording in (run(sine, controller(), RealisticPlant(soft)), Recording.load(file)):
        assert "`resonance = 79` (Hz)" in " ".join(judge(recording).reasons)
    quiet = trajectories.sine(frequency=2.0, peak_to_peak=1.0, duration=0.5)
    assert run(quiet, controller(), RealisticPlant()).metadata["resonance"] is None


def test_a_controller_that_goes_on_from_another_place_is_named():
    """A simulated actuator is at rest again when it is opened; seven changes were "the sensor jumps"."""
    controller = AdaptiveController(sample_rate=RATE, stroke=30.0, voltage_limits=LIMITS)
    wave, stack = trajectories.sine(frequency=10.0, peak_to_peak=20.0, duration=0.75), RealisticPlant()
    first, second = (judge(run(wave, controller, stack)) for _ in range(2))
    assert first == Verdict("good")
    (reason,) = second.reasons
    assert reason.startswith("The controller goes on from 1500 ticks of earlier runs, but the actuator began ")
    assert "`reset()`" in reason
    controller.reset()
    assert judge(run(wave, controller, stack)) == first


def test_alarms_in_a_row_are_no_changes_of_the_actuator():
    assert judged(made(noisy(wave()), flags=flags(changed=[900])))[0] == "good"
    assert "detected 20 sudden changes" in judged(made(noisy(wave()), flags=flags(changed=slice(0, 8000, 400))))[1]


def test_without_a_measurement_there_is_no_good_run():
    z = noisy(wave())
    for part, level in ((slice(0, 300), "good"), (slice(0, 800), "doubtful"), (slice(0, 3000), "bad")):
        missing = z.copy()
        missing[part] = np.nan
        assert judged(made(missing))[0] == level, part
        assert judged(made(z, flags=flags(rejected=part)))[0] == level, part
    assert judged(made(np.full(8000, np.nan))) == ("bad", "No measurement came in the second half of the run.")
    assert judged(made(np.zeros(0))) == ("bad", "Nothing was recorded.")
    unanswered = made(np.zeros(0), metadata={"interrupted": "axis x: no answer to a small motion"})
    assert judged(unanswered)[1] == "Nothing was recorded: axis x: no answer to a small motion."


def test_tracking_that_was_lost_for_a_while_or_at_the_end_is_said():
    z = noisy(wave())
    z[5000:5500] += 1.1
    level, text = judged(made(z))
    assert level == "doubtful"
    assert "From 2.5 s on the error was" in text
    z = noisy(wave(40_000), 0.01)
    z[-500:] += 9.0
    level, text = judged(made(z))
    assert level == "bad"
    assert text.startswith("At the end the error was 9 um rms over 0.25 s: it has not converged.")


def burst(z, at, size=2.0, ticks=20):
    """With ringing of that size, um, over so many ticks."""
    z = z.copy()
    z[at : at + ticks] += size * np.where(np.arange(ticks) % 4 < 2, 1.0, -1.0)
    return z


@pytest.mark.parametrize("at", [0.6, 1.9, 3.7])
@pytest.mark.parametrize("sigma", [0.0, 0.013, 0.1])
def test_a_burst_of_milliseconds_is_said_also_where_a_quarter_of_a_second_does_not_show_it(at, sigma):
    level, text = judged(made(noisy(burst(wave(), round(at * RATE)), sigma)))
    assert level == "doubtful"
    begins, error = re.search(r"^From (\S+) s on the error was (\S+) um rms over 5 ms, although", text).groups()
    assert abs(float(begins) - at) < 0.0051
    assert 1.4 < float(error) < 2.1


@pytest.mark.parametrize("seconds", [0.5, 2.0])
def test_an_error_of_milliseconds_while_nothing_was_followed_yet_is_none(seconds):
    learning = wave() + 6.0 * np.exp(-np.arange(8000) / RATE / 0.1) * np.sin(50 * np.arange(8000) / RATE)
    assert judged(made(noisy(burst(learning, 400))))[0] == "good"
    rested = np.concatenate([np.zeros(round(seconds * RATE)), learning])
    begun = np.concatenate([np.zeros(round(seconds * RATE)), wave()])
    assert judged(made(noisy(rested), begun))[0] == "good"


@pytest.mark.parametrize(("size", "level"), [(0.5, "good"), (1.5, "doubtful")])
def test_a_burst_is_twice_what_is_tolerable(size, level):
    assert judged(made(noisy(burst(wave(), 5000, size))))[0] == level


def test_a_jump_of_the_motion_is_no_burst():
    steps = np.repeat([0.0, 5.0, 1.0, 6.0, 0.0, 5.0, 1.0, 6.0], 2000)
    followed = np.convolve(np.pad(steps, (1, 0)), [0.6, 0.4])[1 : 1 + steps.size]
    assert judged(made(noisy(followed), steps))[0] == "good"
    assert judged(made(noisy(burst(followed, 11500)), steps))[0] == "doubtful"


@pytest.mark.parametrize("held", [500, 1000, 1300, 2000])
def test_the_error_of_a_staircase_does_not_grow_where_steps_fall_into_other_windows(held):
    steps = np.repeat([0.0, 5.0, 1.0, 6.0, 3.0, 4.0, 2.0, 5.0], held)
    followed = np.convolve(np.pad(steps, (1, 0)), [0.6, 0.4])[1 : 1 + steps.size]
    assert "grew" not in judged(made(noisy(followed), steps))[1]
    worse = noisy(followed) + 0.05 * np.linspace(0, 1, steps.size) ** 4 * np.sin(np.arange(steps.size))
    assert ("grew" in judged(made(worse, steps))[1]) == (held > 500)


def test_a_burst_just_after_a_known_change_of_the_plant_is_none():
    about = {"plant": {"settings": {"change": {"time": 2.5}}}}
    assert judged(made(noisy(burst(wave(), 5001)), metadata=about))[0] == "good"
    assert judged(made(noisy(burst(wave(), 7001)), metadata=about))[0] == "doubtful"


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(
    ("ends", "level"),
    [
        ((9.0, 99.0), "bad"),
        ((3.0, 99.0), "bad"),
        ((-1.0, 9.0), "bad"),
        ((-1.0, 19.0), "doubtful"),
        ((-1.0, 99.0), "good"),
    ],
)
def test_a_sensor_at_an_end_of_its_range_is_named(ends, level, noise):
    """Its rest is the zero, as in a run in real time: the motion was 9 um too high, and the run good."""
    zero, seen = max(ends[0], 0.0), NOISE[:3000] * noise
    desired = wave(3000)
    moved = desired + zero
    moved[:100] = np.minimum(moved[:100], 0.3 * np.arange(100))  # the voltage rises until the sensor answers
    found, text = judged(made(np.clip(moved, *ends) - zero + seen, desired, volts=moved / 10.0))
    assert found == level
    assert ("range ends" in text) is (level != "good")
    assert ("its zero is not that of the stage" in text) is (zero > 0.0)


def test_what_stands_still_is_not_always_at_an_end():
    """A sensor that is late, of coarse steps, or steps that are held."""
    time = np.arange(4000) / RATE
    square = 10.0 * (np.floor(8.0 * time) % 2)
    for desired in (wave(4000), wave(4000, 0.2), square):
        for late, step in ((0, 0.15), (40, 0.15), (40, 0.0), (0, 0.01)):
            z = np.r_[np.zeros(late), desired][:4000]
            z = step * np.round(z / step) if step else z
            assert "range ends" not in judged(made(z, desired, volts=desired / 10.0))[1], (late, step)


def test_an_error_at_rest_of_a_controller_without_a_stroke_is_said():
    at_rest = Recording(made(np.ones(4000), np.zeros(4000)).channels)
    assert judged(at_rest) == ("bad", "The error is 1 um rmse, at rest.")


def test_an_error_that_grows_is_said_though_it_is_small():
    """As beside a second mode that nobody measured; a motion that becomes faster has a larger error anyway."""
    time = np.arange(8000) / RATE
    grows = np.interp(time, [0.0, 1.0, 4.0], [0.01, 0.01, 0.4]) * np.sin(2 * np.pi * 92.0 * time)
    level, text = judged(made(noisy(wave()) + grows))
    assert level == "doubtful"
    assert text.startswith("The error grew from 0.00")
    assert "second mode" in text
    assert judged(made(noisy(wave()) + grows[::-1]))[0] == "good"
    chirp = 10.0 * (1 - np.cos(2 * np.pi * (2.0 + time) * time))
    assert judged(made(noisy(chirp) + grows, desired=chirp))[0] == "good"
    assert judged(made(noisy(wave()) + 0.3 * grows))[0] == "good"


@pytest.mark.parametrize(
    ("period", "learned", "level"),
    [(59.47, 0.02, "doubtful"), (59.0, 0.02, "good"), (59.47, 0.2, "good"), (59.47, None, "good")],
)
def test_what_does_not_repeat_is_put_down_to_a_period_of_broken_ticks(period, learned, level):
    """Batches had 0.1 % and the run 1.1 %; where it had grown, the actuator "has changed"."""
    ticks = np.arange(8000)
    desired = 10.0 * (1 - np.cos(2 * np.pi * ticks / period))
    error = np.interp(ticks, [0, 2000], [0.05, 0.3]) * np.sin(2 * np.pi * 5.53 * ticks / period)
    found = {} if learned is None else {"repetition": {"period_s": period / RATE, "rmse_um": [0.4, learned]}}
    seen, text = judged(made(noisy(desired) + error, desired=desired, metadata=found))
    assert ("Take 59 or 60 ticks, 33.8983 or 33.3333 Hz" in text) is (level == "doubtful")
    assert seen == level or "grew" in text


def test_an_error_above_the_resonance_that_was_found_is_said_sooner():
    """The law spoils its learning there; noise, a steady ringing, and an error below the resonance are other things."""
    time, found = np.arange(8000) / RATE, {"resonance": 100.0}
    rises = np.interp(time, [0.0, 1.0, 4.0], [0.01, 0.01, 0.05])
    above, below = (rises * np.sin(2 * np.pi * f * time) for f in (260.0, 60.0))
    level, text = judged(made(noisy(wave()) + above, metadata=found))
    assert level == "doubtful"
    assert "at 260 Hz" in text
    assert "found at 100 Hz: a second mode" in text
    for error, metadata in (
        (above, {}),
        (below, found),
        (above[::-1], found),
        (0.03 * np.sin(2 * np.pi * 260.0 * time), found),
        (above, found | {"controller": {"settings": {"dynamics": {"modes": []}}}}),
    ):
        assert judged(made(noisy(wave()) + error, metadata=metadata))[0] == "good"
    large = made(noisy(wave()) + 8 * above, metadata=found)
    assert "no faster" not in judged(large)[1]


def test_errors_that_did_not_count_before_have_not_grown():
    """Of a scan, whose first rows are none of its image: the error of its image was a second mode."""
    time, flat = np.arange(8000) / RATE, np.arange(8000) >= 4500
    for frequency, found in ((260.0, {"resonance": 100.0}), (92.0, {})):
        steady = noisy(wave()) + 0.25 * np.sin(2 * np.pi * frequency * time)
        assert judge(made(steady, metadata=found, flat=flat.astype(np.uint8))) == Verdict("good")


# ---- How it ended --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interrupted", "cause", "level"),
    [
        (None, "finished", "good"),
        ("an operator asked for it", "stopped", "good"),
        ("Ctrl-C", "interrupted", "doubtful"),
        ("SIGTERM", "terminated", "doubtful"),
        ("KeyboardInterrupt()", None, "doubtful"),
        ("the recording was not ended: it is still running, or its process was killed", None, "doubtful"),
        ("axis x: no usable measurement for 200 ticks", "sensor", "bad"),
        ("the process of the run was killed; the watchdog set the output to the safe voltage", "killed", "bad"),
        ("RuntimeError('boom')", None, "bad"),
    ],
)
def test_a_run_that_did_not_end_by_itself(interrupted, cause, level):
    about = {"interrupted": interrupted, "trajectory": {"ticks": 20_000, "sample_rate": RATE, "name": "sine"}}
    about |= {"ended": {"cause": cause}} if cause else {}
    found, text = judged(made(noisy(wave()), metadata=about))
    assert found == level
    if level != "good":
        assert text.startswith("The run ended before its time, after 4 of 10 s: ")
        assert interrupted == "KeyboardInterrupt()" or interrupted in text


# ---- Good runs that look odd ---------------------------------------------------------------------------------------


def test_good_runs_are_good():
    assert judged(followed()) == ("good", "")
    assert judged(followed(peak_to_peak=0.05)) == ("good", "")
    assert judged(made(noisy(wave(400)))) == ("good", "")
    assert judged(made(noisy(wave()))) == ("good", "")  # without flags


def test_a_motion_in_the_noise_is_not_bad_but_one_that_did_not_happen_is():
    tiny = wave(size=0.025)  # 50 nm peak-to-peak on 13 nm of noise
    assert judged(made(noisy(tiny), tiny)) == ("good", "")
    assert judged(made(noisy(0 * tiny), tiny))[0] == "bad"
    assert judged(made(noisy(-tiny), tiny))[0] == "bad"


def test_a_motion_that_the_noise_hides_is_not_good() -> None:
    """Whether the actuator stands still or follows, the measurements look alike; of more of them, or a larger motion,
    they do not."""
    for ticks, size, stands, level in ((8000, 0.01, 0, "doubtful"), (8000, 0.01, 1, "doubtful"), (8000, 0.1, 1, "good"),
                                       (400_000, 0.01, 1, "good"), (400_000, 0.01, 0, "bad")):  # fmt: skip
        motion = wave(ticks, size)
        noise = np.random.Generator(np.random.PCG64(7)).normal(0.0, 0.014, ticks)
        found = judge(made(stands * motion + noise, motion))
        assert found.level == level, (ticks, size, stands, found)
        assert ("hidden by the noise of the sensor, 0.01" in " ".join(found.reasons)) == (level == "doubtful")


def test_rest_is_good_also_at_a_limit_and_with_a_coarse_sensor():
    rest = np.zeros(8000)
    at_limit = flags(saturated=slice(0, 8000))
    assert judged(made(noisy(rest), rest, flags=at_limit)) == ("good", "")
    coarse = 0.3 * np.round(noisy(rest, 0.2) / 0.3)
    assert judged(made(coarse, rest, metadata={"controller": {"settings": {"stroke": 100.0}}})) == ("good", "")
    level, text = judged(made(noisy(rest) + 3.0, rest))
    assert level == "bad"
    assert "10 % of the stroke, at rest" in text


def test_an_error_in_the_turns_of_a_raster_does_not_count():
    wave = trajectories.raster(frequency=4.0, turn=0.3, peak_to_peak=20.0, duration=4.0)
    recording = run(wave, ConstantGain(10.0, LIMITS), Wired(lambda z, k: z + 2.0 * ~wave.flat[k]))
    np.testing.assert_array_equal(recording["flat"], wave.flat)
    assert metrics.summary(recording).measured_maximum_um < 0.2
    assert metrics.summary(recording).peak_to_peak_um == pytest.approx(wave.settings["line"], abs=0.2)
    everywhere = Recording({name: c for name, c in recording.channels.items() if name != "flat"})
    assert metrics.summary(everywhere).measured_maximum_um > 1.5
    assert judge(recording).level == "good"
    assert judge(everywhere).level != "good"


def test_spikes_that_were_rejected_are_no_error_but_in_the_figures():
    z = noisy(wave())
    z[::100] += 40.0
    level, text = judged(made(z, flags=flags(rejected=slice(0, 8000, 100))))
    assert level == "doubtful"
    assert "without them it is 0.01" in text


def test_a_constant_gain_is_doubtful_and_a_sudden_change_is_not():
    motion = trajectories.random_wave(cutoff=10.0, duration=3.0)
    line = ConstantGain(13.0, LIMITS)
    for _ in range(2):
        recording = run(motion, line, RealisticPlant())
        offset, gain = np.polynomial.Polynomial.fit(recording["volts"], recording["true"], 1).convert().coef
        line = ConstantGain(float(gain), LIMITS, offset=float(offset))
    assert judged(recording)[0] == "doubtful"
    plant = RealisticPlant(PlantSettings(change=Change(time=2.0, gain=0.8, hysteresis=1.3)))
    controller = AdaptiveController(sample_rate=RATE, stroke=30.0, voltage_limits=LIMITS)
    recording = run(motion, controller, plant)
    assert judged(recording) == ("good", "")
    assert judgement.summary(recording).recovery_time_s is None  # less than 1 s is left
    paper = AdaptiveController.paper(sample_rate=RATE, stroke=30.0, voltage_limits=LIMITS)
    assert judged(run(motion, paper, RealisticPlant())) == ("good", "")


def test_metadata_from_anywhere_do_no_harm():
    for stroke in ("30", None, -1, 0.0, [1]):
        assert judged(made(noisy(wave()), metadata={"controller": {"settings": {"stroke": stroke}}})) == ("good", "")
    for trajectory in ("sine", None, {"ticks": "x", "sample_rate": 0}):
        about = {"interrupted": "x", "trajectory": trajectory, "ended": "no table"}
        assert judged(made(noisy(wave()), metadata=about)) == ("bad", "The run ended before its time, after 4 s: x.")


def test_hours_take_seconds():
    ticks = 2_000_000
    recording = made(wave(ticks, frequency=0.01) + 0.013 * np.resize(NOISE, ticks), wave(ticks, frequency=0.01))
    assert judged(recording) == ("good", "")


# ---- Converged -----------------------------------------------------------------------------------------------------


def test_converged_means_against_motion_and_noise_and_not_against_its_own_error():
    bad = made(noisy(wave()) + 2 * np.sin(0.03 * np.arange(8000)))
    assert judgement.summary(bad).convergence_time_s is None
    half_as_bad = made(noisy(wave()) + 0.5 * np.sin(0.03 * np.arange(8000)))
    assert judgement.summary(half_as_bad).convergence_time_s == 0.0
    clipped = made(noisy(np.minimum(wave(), 19.0)), flags=flags(saturated=wave() > 19.0))
    assert judgement.summary(clipped).convergence_time_s is None
    assert judged(clipped)[0] == "doubtful"


def test_several_axes_have_the_worst_verdict():
    verdicts = {"x": judgement.judge(made(noisy(wave()))), "y": judgement.judge(made(noisy(-wave())))}
    assert judgement.worst(verdicts).is_bad
    assert all(reason.startswith("y: ") for reason in judgement.worst(verdicts).reasons)
    assert judgement.worst({"x": verdicts["y"]}) == verdicts["y"]
    assert dataclasses.asdict(judgement.worst({"x": verdicts["x"]})) == {"level": "good", "reasons": ()}


# ---- The same words everywhere -------------------------------------------------------------------------------------

AT_A_LIMIT = ["track", "--duration", "2", "--voltage-limits", "-0.6", "0.9"]


@pytest.mark.usefixtures("each_picture_once")
def test_a_bad_run_is_bad_in_terminal_page_json_and_exit_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, [*AT_A_LIMIT, "--output", "x"])
    assert done.exit_code == 4
    reasons = judgement.judge(Recording.load("x.h5")).reasons
    said = " ".join(done.stdout.split())
    assert "verdict BAD" in said
    assert all(reason in said for reason in reasons)
    assert "converged not before the end" in said
    page = (tmp_path / "x.html").read_text()
    assert '<div class="verdict bad"' in page
    assert "<h1>NOT FOLLOWED: random wave, " in page
    assert "<title>NOT FOLLOWED: " in page
    assert all(reason.replace(" um", " µm") in unescape(page) for reason in reasons)
    again = CliRunner().invoke(main, ["report", "x.h5", "--json"])
    assert again.exit_code == 4
    told = json.loads(again.stdout)
    assert (told["verdict"], told["reasons"]) == ("bad", list(reasons))


@pytest.mark.usefixtures("each_picture_once")
def test_a_good_run_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["track", "--duration", "2", "--output", "x"])
    assert done.exit_code == 0
    assert "verdict    good\n" in done.stdout
    assert '<div class="verdict good"' in (tmp_path / "x.html").read_text()


def test_a_recording_without_measurements_has_a_verdict_in_place_of_figures(tmp_path):
    file = made(np.full(8000, np.nan), volts=np.zeros(8000)).save(tmp_path / "x.h5")
    done = CliRunner().invoke(main, ["report", str(file)])
    assert done.exit_code == 4
    assert "No measurement came in the second half of the run." in done.stdout
    assert json.loads(CliRunner().invoke(main, ["report", str(file), "--json"]).stdout)["verdict"] == "bad"


@pytest.mark.parametrize(
    ("cause", "level", "code"),
    [
        (Cause.FINISHED, "good", 0),
        (Cause.FINISHED, "doubtful", 0),
        (Cause.FINISHED, "bad", 4),
        (Cause.SENSOR, "bad", 10),
    ],
)
def test_a_run_keeps_the_code_of_its_cause(cause, level, code):
    assert code_of(SimpleNamespace(cause=cause), Verdict(level)) == code


@pytest.mark.usefixtures("forked_helpers")
@pytest.mark.filterwarnings("ignore::truestroke.LatenessWarning")
def test_a_run_whose_supervision_is_off_ends_with_its_verdict(tmp_path, monkeypatch):
    text = config.example().replace("voltage_limits = [-0.6, 3.6]", "voltage_limits = [-0.6, 1.1]")
    text = text.replace("duration = 20.0", "duration = 1.0").replace("overrun_streak = 20", "overrun_streak = 0")
    text = text.replace("watchdog_timeout = 0.25", "watchdog_timeout = 9.0\nlimit_time = 0.0\nerror_time = 0.0")
    (tmp_path / "run.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["run", "--config", "run.toml", "--json"])
    told = json.loads(done.stdout)
    assert (done.exit_code, told["exit_code"], told["cause"], told["verdict"]) == (4, 4, "finished", "bad")
    assert told["axes"]["x"]["reasons"] == told["reasons"]
    assert told["reasons"] == list(judgement.judge(Recording.load(tmp_path / "run.h5")).reasons)


@pytest.mark.parametrize("begun", [0.0, 1e-9])
def test_a_motion_at_rest_has_no_share_of_peak_to_peak(begun: float) -> None:
    """In the table of the terminal and of the page; it was "inf %", and of one that ended at once 148338011783.28 %."""
    from truestroke.report import words

    rest = np.linspace(5.0, 5.0 + begun, 4000)
    cells = [cell for _, row in words.table(judgement.summary(made(rest + 0.01 * NOISE[:4000], rest))) for cell in row]
    assert [share for _, share in cells] == ["-", "-"]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motion_above_the_resonance_is_too_fast_and_no_wrong_sign(sign: float) -> None:
    """There a stage goes against its voltage, and with it in the slow parts; a wrong sign is wrong in both."""
    time = np.arange(8000) / RATE
    place = 10.0 * np.minimum(time, 1.0)  # from 0 um to where it repeats
    fast = 3.0 * np.sin(2 * np.pi * 200.0 * time) * (time > 1.0)
    volts = 0.1 * (place + fast)
    measured = noisy(sign * (place - 0.3 * fast))  # a resonance of about 100 Hz
    reasons = judge(made(measured, place + fast, volts=volts)).reasons
    if sign > 0:
        assert reasons[0].startswith("The motion, of 200 Hz, is faster than the stage or its sensor: there a volt")
        assert "30 %" in reasons[0]
        assert "wrong" not in " ".join(reasons)
    else:
        assert any("the sign of sensor or actuator is wrong" in one for one in reasons)
        assert "faster" not in " ".join(reasons)


def test_what_several_checks_ask_for_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a run that goes through all checks, and of one in another unit, which ends after the first."""
    asked: list[str] = []

    def counted(check):
        def find(run):
            asked.append(check.__name__)
            return check(run)

        return find

    of = {check: counted(check) for check in (*judgement.CHECKS, judgement._other_unit)}
    for check, one in of.items():
        monkeypatch.setattr(judgement, check.__name__, one)
    for name in ("CHECKS", "OTHER_CAUSES"):
        monkeypatch.setattr(judgement, name, tuple(of[check] for check in getattr(judgement, name)))
    wave = 10.0 * np.sin(2 * np.pi * 20.0 * np.arange(4000) / RATE)
    assert judge(made(noisy(-wave), wave, volts=0.1 * wave)).level == "bad"
    assert sorted(asked) == sorted(check.__name__ for check in of)
    asked.clear()
    settings = {"name": "AdaptiveController", "settings": {"stroke": 30.0, "voltage_limits": LIMITS}}
    assert (
        "Scale what it reports"
        in judge(made(1000.0 * noisy(wave), wave, {"controller": settings}, volts=0.1 * wave)).reasons[0]
    )
    assert asked.count("_other_unit") == 1


@pytest.mark.parametrize("name", ["the sign is wrong", "the sensor stands still", "the sensor jumps"])
def test_a_resonance_that_was_given_is_no_cause_where_a_sensor_is(name: str) -> None:
    """Which takes the command to a voltage limit; none of 54 runs with a wrong f0 is there."""
    wrongly = {
        "the sign is wrong": lambda z, k: -z,
        "the sensor stands still": lambda z, k: np.where(k > 1500, 5.0, z),
        "the sensor jumps": lambda z, k: z + 20.0 * (k > 2000),
    }[name]
    reasons = " ".join(judge(followed(wrongly, resonance=400.0)).reasons)
    assert "the error is" in reasons.lower()
    assert "resonance =" not in reasons


@pytest.mark.parametrize(
    ("given", "known", "off", "said"),
    [
        (90.0, 90.0, 1.5, "resonance = 90 Hz, and nothing has shown it"),
        (90.0, 900.0, 1.5, "resonance = 90 Hz, and the measurements showed 900 Hz"),
        (90.0, 90.0, 0.01, ""),
    ],
)
def test_a_resonance_that_was_given_is_named_where_the_motion_is_not_followed(given, known, off, said) -> None:
    desired = wave(4 * int(RATE))
    settings = {"name": "AdaptiveController", "settings": {"stroke": 30.0, "resonance": given}}
    found = judge(
        made(desired + off * np.sin(np.arange(desired.size)), desired, {"controller": settings, "resonance": known})
    )
    reasons = " ".join(found.reasons)
    assert said in reasons
    assert ("resonance =" in reasons) is bool(said)


@pytest.mark.parametrize(
    ("known", "what", "said"),
    [
        (150.0, {"restored": slice(400, 900)}, True),
        (150.0, {"changed": slice(400, 440)}, True),
        (150.0, {}, False),
        (370.0, {"restored": slice(400, 900)}, False),
    ],
)
def test_a_resonance_that_was_given_is_named_where_the_motion_burst_and_was_followed_later(known, what, said):
    settings = {"name": "AdaptiveController", "settings": {"stroke": 30.0, "resonance": 400.0}}
    about = {"controller": settings, "resonance": known}
    text = judged(made(noisy(wave()), metadata=about, flags=flags(**what)))[1]
    assert ("resonance = 400 Hz, and the measurements showed 150 Hz" in text) is said
    assert ("resonance =" in text) is said
