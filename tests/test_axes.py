"""Two and three axes: what they do to each other is learned, in any frame of the sensors; one loop, native or not."""

import copy
import dataclasses
import json
import pickle
import tracemalloc

import numpy as np
import pytest
from click.testing import CliRunner
from fakes.in_python import InPython
from matplotlib.figure import Figure
from scipy import signal

from truestroke import (
    AdaptiveController,
    ControllerSettings,
    MultiAxisController,
    Recording,
    RunInterrupted,
    SettingError,
    judge,
    run,
    save_page,
    scans,
)
from truestroke.base import frames
from truestroke.cli import main
from truestroke.control.repeating.learned_strain import LearnedStrain, filled
from truestroke.control.repeating.turns import Turns, turns_of
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.plant import MultiAxisSettings, MultiAxisStage, StagePlant, StageSettings
from truestroke.runtime.drivers.turned import Turned
from truestroke.runtime.realtime import config, run_realtime
from truestroke.signals.trajectories import Trajectory, raster, sine

RATE = 10_000.0
RANGE = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
FAST, SLOW = StageSettings(resonances=(900.0,)), StageSettings(resonances=(600.0,), hysteresis_kind="preisach")
LINES = raster(frequency=40.0, peak_to_peak=20.0, duration=3.0, sample_rate=RATE)


def frame_motion(seconds):
    """The slow axis: a ramp of 5 um a second from rest to 5 um."""
    time = np.arange(round(RATE * seconds)) / RATE
    gone = np.exp(-time / 0.05)
    return Trajectory("frame", RATE, 5.0 * time - 0.25 * (1 - gone), 5.0 * (1 - gone), acceleration=100.0 * gone)


MOTION = {"x": LINES, "y": frame_motion(3.0)}


class Flat:
    """A controller that does nothing."""

    def command(self, z_d, zdot_d):
        return 0.0

    def adapt(self, z, ago=0):
        pass


def settings(stage, known=True, **given):
    dynamics = {"dynamics": stage.dynamics(), "feedback": False} if known else {}
    return ControllerSettings(**{**RANGE, **dynamics, **given})


def rms(recording, seconds=2.0):
    """Of the true error of each axis on the lines, after so many seconds, nm."""
    counts = (recording["time"] >= seconds) & (recording["flat_x"] > 0)
    return [
        1e3 * np.sqrt(np.mean((recording[f"true_{name}"] - recording[f"desired_{name}"])[counts] ** 2))
        for name in recording.axes
    ]


# ---- The simulated axes ----------------------------------------------------------------------------------------------


def test_coupled_linear_stages_are_those_of_an_independent_simulation():
    """Without hysteresis the axes are linear: their state space, by scipy. What acts is a step of the latter late."""
    coupling, push, drag, frame = (
        np.array(m)
        for m in ([[0, 0.03], [0, 0]], [[0, 0], [0.05, 0]], [[0, 2e-5], [0, 0]], frames.sensor_frame(5.0, -2.0))
    )
    given = {"coupling": coupling, "push": push, "drag": drag, "frame": frame}
    volts = np.repeat(np.random.default_rng(1).uniform(0.0, 3.0, (30, 2)), 10, axis=0)

    def simulated(steps):
        plain = {"loop_width": 0.0, "creep": 0.0, "noise": 0.0, "amplifier_bandwidth": 800.0, "samples_per_tick": 1}
        x = StageSettings(resonances=(700.0,), steps_per_tick=steps, **plain)
        y = StageSettings(resonances=(400.0,), dampings=(0.1,), steps_per_tick=steps, **plain)
        return MultiAxisStage(MultiAxisSettings(axes=(x, y), **given)).exchange(volts)

    w, zeta, lag = 2 * np.pi * np.array([700.0, 400.0]), np.array([0.02, 0.1]), 2 * np.pi * 800.0
    A, B = np.zeros((6, 6)), np.zeros((6, 2))  # of each axis z, z', and the voltage behind the amplifier
    for i, j in ((0, 1), (1, 0)):
        A[3 * i, 3 * i + 1] = 1.0
        A[3 * i + 1, 3 * i : 3 * i + 3] = -(w[i] ** 2), -2 * zeta[i] * w[i], w[i] ** 2 * 30.0 / 3.6
        A[3 * i + 1, 3 * j] = push[i, j] * w[i] ** 2
        A[3 * i + 2, 3 * i + 2], B[3 * i + 2, i] = -lag, lag
    C = np.array([[1.0, 0.0, 0.0, coupling[0, 1], drag[0, 1], 0.0], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    A[4, 3:5] += push[1, 0] * w[1] ** 2 * C[0, 3:5]  # what axis 1 has given to axis 0 comes back
    fine = np.repeat(volts, 100, axis=0)
    _, z, _ = signal.lsim(
        signal.StateSpace(A, B, C, np.zeros((2, 2))), fine, np.arange(len(fine)) / (100 * RATE), interp=False
    )
    expected = z[50::100] @ frame.T  # in the middle of each tick
    coarse, close = (np.abs(simulated(steps) - expected).max() for steps in (10, 60))
    assert close < coarse / 5, "the error is that of the step"
    assert close < 0.06, "um, of 1.5 that each takes of the other"
    assert np.abs(expected - z[50::100]).max() > 1.0


def test_an_axis_alone_is_a_stage_plant():
    from truestroke.plant import StagePlant

    quiet = StageSettings(noise=0.0, dead_time=1.3e-4, sensor_delay=2e-5)
    axes, one = MultiAxisStage(MultiAxisSettings(axes=(SLOW, quiet))), StagePlant(quiet)
    volts = np.random.default_rng(0).uniform(0.0, 3.0, 400)
    np.testing.assert_array_equal(axes.exchange(np.stack([0 * volts, volts], 1))[:, 1], one.exchange(volts))


# ---- Learned, and what it is worth -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("share", "kind"), [(0.03, "coupling"), (-0.03, "push")])
def test_cross_talk_of_lines_is_learned_within_two_seconds(share, kind):
    """The goal: 3 % at 40 Hz lines of 20 um, both axes within 10 nm rms; a load to the slow axis leaves more."""
    plant = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW), **{kind: ((0.0, share), (share, 0.0))}), seed=3)
    controller = MultiAxisController({"x": settings(FAST), "y": settings(SLOW)})
    recording = run(MOTION, controller, plant)
    assert max(rms(recording)) < 10.0
    assert [judge(recording.axis(name)).level for name in "xy"] == ["good", "good"]
    known = controller.prepare(MOTION)
    known.others[:] = 0.0  # neither knows how the other moves: its lines are a load of one frequency
    blind = MultiAxisController({"x": settings(FAST), "y": settings(SLOW)})
    plant.open()
    error = []
    for k in range(20_000):
        z = plant.exchange(blind.follow(known, k)[np.newaxis])[0]
        blind.adapt(z)
        error.append(plant.truth[0, 1] - MOTION["y"].position[k])
    assert 1e3 * np.std(error[15_000:]) > 12.0


def test_nothing_known_of_the_stage_and_a_small_error_of_the_frame():
    """Without dynamics, and with sensors a degree from where the user thinks they are."""
    turned = frames.sensor_frame(31.0, 1.0)
    given = {"coupling": ((0.0, 0.03), (0.02, 0.0)), "frame": turned}
    plant = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW), **given), seed=1)
    given = {"frequency": 4.0, "duration": 3.0, "sample_rate": RATE}
    motion = {"x": sine(peak_to_peak=8.0, offset=8.0, **given), "y": raster(peak_to_peak=6.0, offset=8.0, **given)}
    controller = MultiAxisController({n: settings(FAST, known=False) for n in "xy"}, frame=frames.sensor_frame(30.0))
    error = [run(motion, controller, plant)[f"true_{n}"][20_000:] - motion[n].position[20_000:] for n in "xy"]
    assert max(1e3 * np.std(e) for e in error) < 12.0
    assert controller.coupling[0, 1] == pytest.approx(0.03 - np.radians(1.0) - np.radians(1.0), abs=0.03)


def test_three_axes():
    """Each takes of both others; a circle in x and y, whose axes move at one frequency."""
    stages = (FAST, SLOW, StageSettings(hysteresis_kind="bouc-wen"))
    coupling = ((0.0, 0.02, -0.01), (0.03, 0.0, 0.02), (-0.02, 0.01, 0.0))
    plant = MultiAxisStage(MultiAxisSettings(axes=stages, coupling=coupling), seed=2)
    controller = MultiAxisController({n: settings(s) for n, s in zip("xyz", stages, strict=True)})
    given = {"peak_to_peak": 15.0, "offset": 10.0, "duration": 2.0, "sample_rate": RATE}
    motion = {n: sine(frequency=f, **given) for n, f in (("x", 20.0), ("y", 20.0), ("z", 3.0))}
    recording = run(motion, controller, plant)
    for n in "xyz":
        error = (recording[f"true_{n}"] - recording[f"desired_{n}"])[15_000:]
        assert 1e3 * np.sqrt(np.mean(error**2)) < 25.0, n


# ---- One loop --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False])
def test_the_native_loop_has_the_bits_of_calls(known, tmp_path):
    def both():
        frame = frames.sensor_frame(3.0)
        plant = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW), coupling=((0.0, 0.03), (0.03, 0.0)), frame=frame))
        return MultiAxisController({"x": settings(FAST, known), "y": settings(SLOW, known)}, frame=frame), plant

    motion = {
        n: sine(frequency=f, peak_to_peak=9.0, duration=0.3, ramp=0.1, sample_rate=RATE)
        for n, f in (("x", 30.0), ("y", 7.0))
    }
    (fast, moved), (slow, called) = both(), both()
    one, other = run(motion, fast, moved), run(motion, slow, InPython(called))
    assert list(one) == list(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name, strict=True)
    for name, value in slow.state().items():
        if name != "velocity":
            np.testing.assert_array_equal(fast.state()[name], value, name)
    np.testing.assert_array_equal(moved.exchange(np.full((50, 2), 0.5)), called.exchange(np.full((50, 2), 0.5)))
    read = Recording.load(one.save(tmp_path / "axes.h5"))
    assert read.axes == ("x", "y")
    assert read.metadata["controller"]["name"] == "MultiAxisController"
    np.testing.assert_array_equal(read.axis("y")["measured"], one["measured_y"])
    assert read.axis("y").metadata["controller"]["settings"]["other_axes"] == 1


def test_blocks_and_latency():
    """A card that moves four ticks at once and measures two ticks late: each entry is put at its command."""

    class Late(InPython):
        def open(self):
            self.past = np.zeros((2, 2, 2))
            return dataclasses.replace(self.plant.open(), block=4, latency=2)

        def exchange(self, volts):
            came = np.concatenate([self.past, [self.plant.exchange(volts), self.plant.truth]], axis=1)
            self.past = came[:, -2:]
            self.truth = came[1, :-2]
            return came[0, :-2]

    given = {"coupling": ((0.0, 0.03), (0.03, 0.0))}
    plant = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW), **given), seed=6)
    controller = MultiAxisController({"x": settings(FAST, False), "y": settings(SLOW, False)})
    given = {"peak_to_peak": 8.0, "duration": 1.0, "sample_rate": RATE}
    motion = {"x": sine(frequency=20.0, **given), "y": sine(frequency=5.0, **given)}
    recording = run(motion, controller, Late(plant))
    assert np.isnan(recording["measured_x"][-2:]).all()
    for name in "xy":
        error = (recording[f"true_{name}"] - recording[f"desired_{name}"])[5000:-2]
        assert 1e3 * np.std(error) < 25.0, name
    assert judge(recording).level == "good"


def test_controllers_of_any_law_move_their_axes_as_if_each_were_alone():
    """Axes that disturb nothing, and a law in ten lines beside the default one: the bits of two runs of one axis."""

    class Line:
        volts = 0.0

        def command(self, z_d, zdot_d):
            self.volts = min(z_d / 8.0, 3.6)
            return self.volts

        def adapt(self, z, ago=0):
            self.last = z, ago

    stages = StageSettings(noise=0.0), StageSettings(resonances=(600.0,), noise=0.0)
    motion = {
        name: sine(frequency=f, peak_to_peak=10.0, duration=0.6, sample_rate=RATE)
        for name, f in (("x", 5.0), ("y", 9.0))
    }
    own, law = AdaptiveController(**RANGE), Line()
    both = run(motion, {"x": own, "y": law}, MultiAxisStage(MultiAxisSettings(axes=stages)))
    for name, alone, stage in (("x", AdaptiveController(**RANGE), stages[0]), ("y", Line(), stages[1])):
        one = run(motion[name], alone, StagePlant(stage))
        for key in ("volts", "measured", "true"):
            np.testing.assert_array_equal(both[f"{key}_{name}"], one[key])
    assert law.last == (both["measured_y"][-1], 0)
    assert [name for name in both if name.startswith("weights")] == ["weights_time", "weights_x"]
    assert both.metadata["controller"] == {"name": "SeparateControllers"}
    assert both.axis("y").metadata["controller"]["name"] == "Line"


@pytest.mark.parametrize(
    ("controllers", "words"),
    [
        (lambda one: {"x": one, "y": one}, "of its own for each axis"),
        (lambda one: {}, "no axis"),
        (lambda one: {"x": one, "y": 3.0}, r"controller\['y'\] = 3.0"),
        (lambda one: {"x": one, 3: Flat()}, "of letters and digits"),
        (lambda one: {"x": one, "z": Flat()}, "one for each of the axes x, z"),
        (
            lambda one: {"x": one, "y": Flat(), "z": Flat()},
            "controllers of x, y, z: must be one for each of 2",
        ),
        (lambda one: {"x": one}, "controllers of x: must be one for each of 2 channels of the actuator"),
        (
            lambda one: {"x": one, "y": MultiAxisController({"x": settings(FAST, False), "y": settings(SLOW, False)})},
            r"controller\['y'\] = a MultiAxisController: must be a controller.*in place of the mapping",
        ),
    ],
)
def test_controllers_that_do_not_fit_are_named(controllers, words):
    plant = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW)))
    with pytest.raises(SettingError, match=words):
        run(MOTION, controllers(AdaptiveController(**RANGE)), plant)


def test_a_state_goes_on_alike():
    plant = MultiAxisStage(seed=4)
    plant.open()
    controller = MultiAxisController({"x": settings(FAST, False), "y": settings(SLOW, False)})

    def ticks(one, start, stop):
        volts = np.array([one.command((5.0 + 0.01 * k, 3.0 + 0.02 * k), (100.0, 200.0)) for k in range(start, stop)])
        one.adapt((1.0, 2.0))
        return volts

    ticks(controller, 0, 50)
    twin = MultiAxisController({"x": settings(FAST, False), "y": settings(SLOW, False)})
    twin.restore(controller.state())
    others = [copy.copy(controller), pickle.loads(pickle.dumps(controller)), twin]
    expected = ticks(controller, 50, 80)
    for other in others:
        np.testing.assert_array_equal(ticks(other, 50, 80), expected)
    before = {name: value.tolist() for name, value in controller.state().items()}
    broken = {**controller.state(), "y weights": np.full(3, np.nan)}
    with pytest.raises(SettingError, match=r"y\.state"):
        controller.restore(broken)
    assert {name: value.tolist() for name, value in controller.state().items()} == before
    other = {"x": settings(FAST, False), "y": dataclasses.replace(settings(SLOW, False), trim_rate=20.0)}
    with pytest.raises(SettingError, match=r"y\.state = one made with trim_rate 20 1/s: .* trim_rate 0 1/s"):
        controller.restore(MultiAxisController(other).state())
    turned = MultiAxisController(other, frame=frames.sensor_frame(5.0))
    with pytest.raises(SettingError, match=r"made with frame\[0\] \(0.996195, -0.0871557\)"):
        controller.restore(turned.state())
    assert {name: value.tolist() for name, value in controller.state().items()} == before


def test_a_fault_on_the_way_keeps_the_recording():
    class Breaks(InPython):
        def exchange(self, volts):
            self.ticks = getattr(self, "ticks", 0) + 1
            if self.ticks > 40:
                raise OSError("the cable")
            return super().exchange(volts)

    controller = MultiAxisController({"x": settings(FAST), "y": settings(SLOW)})
    with pytest.raises(RunInterrupted) as caught:
        run(MOTION, controller, Breaks(MultiAxisStage()))
    assert caught.value.recording["measured_y"].size == 40
    assert "the cable" in caught.value.recording.metadata["interrupted"]


# ---- In real time ----------------------------------------------------------------------------------------------------

CONFIG = """
[driver]
name = "simulated"
sample_rate = 2000.0
channels = 2
seed = 5
[driver.axes]
stages = [{resonances = [700.0], noise = 0.01}, {resonances = [500.0], hysteresis_kind = "preisach"}]
coupling = [[0.0, 0.03], [-0.03, 0.0]]
frame = [[0.9848, -0.1736], [0.1736, 0.9848]]
AXES
[coupled]
rotation = 10.0
[realtime]
spin = 0.0
overrun_streak = 0
watchdog_timeout = 20.0
[recording]
file = "run.h5"
"""
AXIS = """
[[axis]]
name = "NAME"
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 4000.0
trajectory = {kind = "sine", frequency = RATE, peak_to_peak = 6.0, offset = 7.0, duration = 0.6}
"""


def configuration(folder, *changes):
    axes = "".join(AXIS.replace("NAME", name).replace("RATE", rate) for name, rate in (("x", "10.0"), ("y", "4.0")))
    text = CONFIG.replace("AXES", axes)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "xy.toml").write_text(text)
    return config.load(folder / "xy.toml")


@pytest.mark.usefixtures("forked_helpers")
def test_the_loop_in_real_time_is_that_of_run(tmp_path):
    """Volts and what is learned of each axis; its files are in the frame of the axes."""
    job = configuration(tmp_path)
    outcome = run_realtime(job.driver, job.axes, tmp_path / "run.h5", settings=job.settings)
    assert outcome.reason == ""
    x, y = (Recording.load(file) for file in outcome.files)
    stages = [StageSettings(sample_rate=2000.0, resonances=(700.0,), noise=0.01)]
    stages += [StageSettings(sample_rate=2000.0, resonances=(500.0,), hysteresis_kind="preisach")]
    given = {"coupling": ((0.0, 0.03), (-0.03, 0.0)), "frame": ((0.9848, -0.1736), (0.1736, 0.9848))}
    plant = MultiAxisStage(MultiAxisSettings(axes=tuple(stages), **given), seed=5)
    controller = MultiAxisController(
        {name: settings(FAST, False, sample_rate=2000.0, slew_limit=4000.0) for name in "xy"}, frames.sensor_frame(10.0)
    )
    given = {"peak_to_peak": 6.0, "offset": 7.0, "duration": 0.6}
    motion = {"x": sine(frequency=10.0, **given), "y": sine(frequency=4.0, **given)}
    expected = run(motion, controller, plant)
    for name, one in (("x", x), ("y", y)):
        np.testing.assert_array_equal(one["volts"], expected[f"volts_{name}"])
        np.testing.assert_array_equal(one["weights"], expected[f"weights_{name}"])
    measured = np.linalg.inv(frames.sensor_frame(10.0)) @ [expected["measured_x"], expected["measured_y"]]
    np.testing.assert_allclose(y["measured"], measured[1], atol=1e-12)
    assert x.metadata["plant"]["name"] == "SimulatedDriver"
    np.testing.assert_allclose(x.metadata["plant"]["settings"]["frame"], frames.sensor_frame(10.0))


@pytest.mark.usefixtures("forked_helpers")
def test_a_run_says_by_which_angle_its_sensors_are_turned(tmp_path, monkeypatch):
    """A radian, as 0.17 in place of 10, was taken in silence."""
    monkeypatch.chdir(tmp_path)
    configuration(tmp_path, ("rotation = 10.0", "rotation = 0.17\nskew = 0.5"))
    done = CliRunner().invoke(main, ["run", "--config", "xy.toml"])
    assert "The sensors are turned by 0.17 degrees (2.97 mrad), and 90.5 degrees apart." in done.stderr


def repeated(folder, *changes):
    """The same with dynamics, and a period that all axes learn."""
    for name, frequency in (("x", 700.0), ("y", 500.0)):
        StageSettings(sample_rate=2000.0, resonances=(frequency,)).dynamics().save(folder / f"{name}.dynamics")
    given = [
        (f'name = "{name}"', f'name = "{name}"\nsettings = {{dynamics = "{name}.dynamics", feedback = false}}')
        for name in "xy"
    ]
    longer = ("duration = 0.6", "duration = 1.5")
    return configuration(folder, *given, longer, ("rotation = 10.0", "rotation = 10.0\nperiod = 0.1"), *changes)


@pytest.mark.usefixtures("each_picture_once", "forked_helpers")
@pytest.mark.filterwarnings("ignore::truestroke.LatenessWarning")
def test_axes_learn_what_repeats_in_real_time_with_the_bits_of_run(tmp_path):
    """And the recordings, and the page, say what each batch was."""
    job = repeated(tmp_path)
    outcome = run_realtime(job.driver, job.axes, tmp_path / "run.h5", settings=job.settings)
    assert outcome.reason == ""
    plant = job.driver.driver.settings.together()
    controller = MultiAxisController(
        {axis.name: axis.controller.settings for axis in job.axes}, frames.sensor_frame(10.0), period=0.1
    )
    given = {"peak_to_peak": 6.0, "offset": 7.0, "duration": 1.5}
    motion = {"x": sine(frequency=10.0, **given), "y": sine(frequency=4.0, **given)}
    expected = run(motion, controller, plant)
    assert np.abs(controller.learned["x"].of(range(2900, 3000))).max() > 1e-3
    for name, file in zip("xy", outcome.files, strict=True):
        one = Recording.load(file)
        np.testing.assert_array_equal(one["volts"], expected[f"volts_{name}"])
        learned = one.metadata["repetition"][name]
        assert expected.axis(name).metadata["repetition"]["rmse_um"] == controller.learned[name].errors
        errors = controller.learned[name].errors[:2]  # no tick is left for the third
        assert learned == {"period_s": 0.1, "rmse_um": errors}
        page = save_page(one, tmp_path / "page.html").read_text(encoding="utf-8")
        assert f"of the period of 100 ms: {1e3 * learned['rmse_um'][0]:.3g} nm rms" in page


def test_a_configuration_of_axes_that_does_not_fit_is_named(tmp_path):
    def wrong(words, *changes):
        refused(words, configuration, tmp_path, *changes)

    wrong("coupled.rotatoin = 10.0: must be left out; did you mean rotation", ("rotation = 10", "rotatoin = 10"))
    wrong("coupled.frame = .*the sensors read almost the same", ("rotation = 10.0", "frame = [[1.0, 1.0], [1.0, 1.0]]"))
    wrong(
        "coupled.frame = .*left out, or rotation", ("rotation = 10.0", "skew = 1.0\nframe = [[1.0, 0.0], [0.0, 1.0]]")
    )
    paper = 'name = "y"\ncontroller = "paper"'
    wrong('controller of axis y = another: must be "adaptive" where axes are coupled', ('name = "y"', paper))
    wrong("name = x, x: must be different for each axis", ('name = "y"', 'name = "x"'))
    wrong("driver.axes.stages = 2 tables: must be 3", ("channels = 2", "channels = 3"))
    wrong("driver.axes.couplin = .*did you mean coupling", ("coupling = [[0", "couplin = [[0"))
    point = 'trajectory = {kind = "set_point", reach = [0.0, 9.0], speed = 10.0, duration = 0.6}'
    wave = 'trajectory = {kind = "sine", frequency = 4.0, peak_to_peak = 6.0, offset = 7.0, duration = 0.6}'
    wrong("trajectory of axis y = a set-point", (wave, point))
    wrong("trajectory\\['y'\\] = 1400 ticks: must be 1200, as of x", (wave, wave.replace("0.6", "0.7")))
    apart = ('name = "y"', 'name = "y"\nperiod = 0.25')
    wrong(r"\[\[axis\]\] 2: period = 0.25 s: must be left out, and in \[coupled\]", apart)
    unknown = ("rotation = 10.0", "rotation = 10.0\nperiod = 0.1")
    wrong("dynamics of axis x = None: must be given where axes learn a period: settings = ", unknown)
    refused("coupled.period = 0.03 s: must be a period of", repeated, tmp_path, ("period = 0.1", "period = 0.03"))
    job = configuration(tmp_path, ("channels = 2", "channels = 2\nblock = 2"))
    assert Turned(job.driver.driver, np.eye(2)).open().block == 2
    refused("frame = of 3 axes: must be of 2, the channels of the driver", Turned(job.driver.driver, np.eye(3)).open)


def test_verdict_and_page_have_every_axis(tmp_path, monkeypatch):
    def drawn(recording, theme):
        assert recording.axes == (), "the page of an axis has the plots of a run of one"
        return {"tracking": Figure(figsize=(1, 1))}

    monkeypatch.setattr("truestroke.report.recording.run_plots", drawn)
    plant = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW)), seed=3)
    controller = MultiAxisController({"x": settings(FAST, False), "y": settings(SLOW, False)})
    given = {"peak_to_peak": 6.0, "duration": 0.6, "sample_rate": RATE}
    recording = run({"x": sine(frequency=10.0, **given), "y": sine(frequency=4.0, **given)}, controller, plant)
    assert judge(recording).level == "good"
    recording.save(tmp_path / "xy.h5")
    report = CliRunner().invoke(
        main, ["report", str(tmp_path / "xy.h5"), "--output", str(tmp_path / "again"), "--json"]
    )
    assert json.loads(report.stdout)["axes"]["y"]["true_rmse_um"] < 0.02
    page = (tmp_path / "again.html").read_text()
    assert all(f"Axis {name}: tracking" in page for name in "xy")
    lost = dataclasses.replace(recording.channels["measured_y"], data=0 * recording["measured_y"])
    spoilt = Recording(recording.channels | {"measured_y": lost}, recording.metadata)
    assert judge(spoilt).level == "bad"
    assert all(reason.startswith("axis y: ") for reason in judge(spoilt).reasons)
    with pytest.raises(SettingError, match="name = 'z': must be"):
        recording.axis("z")


# ---- What is refused -------------------------------------------------------------------------------------------------


def refused(words, make, *arguments, **given):
    with pytest.raises(SettingError, match=words):
        make(*arguments, **given)


def test_what_does_not_fit_is_named():
    x, y = settings(FAST, False), settings(SLOW, False)
    slower = settings(FAST, False, sample_rate=5000.0)
    refused("axes\\['y'\\].sample_rate = 5000.0 Hz: must be 10000 Hz", MultiAxisController, {"x": x, "y": slower})
    refused("number of axes = 1", MultiAxisController, {"x": x})
    refused("name of an axis", MultiAxisController, {"x": x, "the y": y})
    refused(
        "frame = .*singular value.*almost the same", MultiAxisController, {"x": x, "y": y}, [[1.0, 1.0], [1.0, 1.0]]
    )
    refused("frame = array of shape \\(1, 2\\)", MultiAxisController, {"x": x, "y": y}, [[1.0, 1.0]])
    controller = MultiAxisController({"x": x, "y": y})
    refused("z_d = \\[1.0\\] um: must be 2 numbers, one for each of the axes x, y", controller.command, [1.0], [0.0])
    refused("z_d = nan", controller.command, [1.0, np.nan], [0.0, 0.0])
    assert controller.counters["x"].commands == 0
    refused("motions of x: must be one for each of the axes x, y", run, {"x": LINES}, controller, MultiAxisStage())
    shorter = frame_motion(1.0)
    refused(
        "trajectory\\['y'\\] = 10000 ticks: must be 30000, as of x",
        run,
        {"x": LINES, "y": shorter},
        controller,
        MultiAxisStage(),
    )
    other = sine(duration=1.0, sample_rate=5000.0)
    refused("trajectory\\['x'\\].sample_rate = 5000.0 Hz", run, {"x": other, "y": other}, controller, MultiAxisStage())
    refused("a MultiAxisController", run, MOTION, controller.axes["x"], MultiAxisStage())
    three = MultiAxisStage(MultiAxisSettings(axes=(FAST, SLOW, FAST)))
    refused("controllers of x, y: must be one for each of 3 channels", run, MOTION, controller, three)
    refused("others = \\[1.0\\].*3 finite numbers", controller.axes["x"].command, 0.0, 0.0, None, None, [1.0])
    refused("axes\\[1\\].sample_rate", MultiAxisSettings, axes=(FAST, StageSettings(sample_rate=5000.0)))
    refused("the largest of coupling = 0.6", MultiAxisSettings, coupling=((0.0, 0.6), (0.0, 0.0)))
    refused("volts\\[1, 0\\] = nan", MultiAxisStage().exchange, np.array([[0.0, 0.0], [np.nan, 0.0]]))


# ---- What repeats ----------------------------------------------------------------------------------------------------

STIFF = StageSettings(resonances=(1165.0,), dampings=(0.01,), hysteresis_kind="bouc-wen")
"""A stage whose 29th harmonic of 40 Hz is at its resonance."""


def told(stage, share):
    """Settings of a stage whose resonance is another than it is."""
    known = stage.dynamics()
    modes = tuple(dataclasses.replace(mode, frequency=mode.frequency * share) for mode in known.modes)
    return settings(stage, dynamics=dataclasses.replace(known, modes=modes))


def pair(period=0.025, share=1.0, **given):
    plant = MultiAxisStage(MultiAxisSettings(axes=(STIFF, SLOW), coupling=((0.0, 0.03), (0.03, 0.0)), **given), seed=1)
    frame = given.get("frame")
    return MultiAxisController({"x": told(STIFF, share), "y": told(SLOW, share)}, frame, period=period), plant


@pytest.mark.parametrize("share", [1.03])
def test_what_repeats_is_learned_on_both_axes_within_two_seconds(share):
    alone, known = (rms(run(MOTION, *pair(period, share))) for period in (None, 0.025))
    assert alone[0] > 7.0, "hysteresis meets the resonance of the fast axis"
    assert max(known) < 5.0


def test_what_a_wrong_first_step_has_shown_of_the_stage_is_kept():
    """The 29th harmonic is between the resonance that is given, 5 % too low, and the true one: its sign is another."""
    controller, plant = pair(share=0.95)
    recording = run(MOTION, controller, plant)
    errors = controller.learned["x"].errors
    assert max(errors) > 2 * errors[0], "else the test shows nothing"
    assert max(rms(recording)) < 8.0


def test_calls_and_the_native_loop_learn_alike_and_a_state_goes_on():
    """Sensors that are turned; the calls are interrupted, saved and go on in another controller."""
    frame = frames.sensor_frame(3.0)
    motion = {name: dataclasses.replace(one, **short(one, 10_500)) for name, one in MOTION.items()}
    fast, moved = pair(frame=frame)
    expected = run(motion, fast, moved)
    assert len(fast.learned["x"].errors) >= 1
    one, plant = pair(frame=frame)
    known = one.prepare(motion)
    plant.open()
    volts = np.empty((10_500, 2))
    for k in range(10_500):
        if k in (7_000, 9_000):  # before and after the first batch
            other = pair(frame=frame)[0]
            known = other.prepare(motion)
            other.restore(one.state())
            one = other
        volts[k] = one.follow(known, k)
        one.adapt(plant.exchange(volts[k][np.newaxis])[0])
    for i, name in enumerate("xy"):
        np.testing.assert_array_equal(volts[:, i], expected[f"volts_{name}"], name)


def test_commands_by_hand_after_a_motion_that_is_known_teach_its_period_nothing():
    controller, plant = pair()
    motion = {name: dataclasses.replace(one, **short(one, 6_100)) for name, one in MOTION.items()}
    known = controller.prepare(motion)
    plant.open()
    for k in range(6_100):  # within a batch
        controller.adapt(plant.exchange(controller.follow(known, k)[np.newaxis])[0])
    before = {key: array.copy() for key, array in controller.learned["x"].state().items()}
    for _ in range(10):
        controller.adapt(plant.exchange(controller.command([9.0, 9.0], [0.0, 0.0])[np.newaxis])[0])
    for key, array in controller.learned["x"].state().items():
        np.testing.assert_array_equal(array, before[key], key)


def short(motion, ticks):
    parts = ("position", "velocity", "acceleration", "flat")
    return {name: getattr(motion, name)[:ticks] for name in parts if getattr(motion, name) is not None}


@pytest.mark.parametrize(("sign", "least"), [(1.0, 0.02), (-1.0, None)])
def test_the_learned_strain_of_a_linear_stage(sign, least):
    """The stage by its formula, 3 % from what is known; one that moves the other way is never much worse than alone."""
    known = Dynamics(sample_rate=RATE, modes=(Mode(frequency=412.0, damping=0.02),))
    learned, period = LearnedStrain(known, 250), 250
    wave = 5.0 * np.cos(2 * np.pi * np.arange(period) / period)
    learned.follow(wave, np.ones(period, dtype=bool), Turns(period, 0, 100_000))
    f = np.arange(period // 2 + 1) * 40.0 / 400.0
    hold = np.sinc(f * 400.0 / RATE) * np.exp(-1j * np.pi * f * 400.0 / RATE)
    response = sign * hold / (1 - f**2 + 2j * 0.02 * f)
    begin = np.fft.irfft(np.where((f > 0) & (f < 1.6), np.exp(1j * f) * period / 100, 0.0), period)
    for tick in range(0, 60_000, period):
        r = learned.of(range(tick, tick + period))
        learned.see(tick, begin + np.fft.irfft(response * np.fft.rfft(r), period))
    assert len(learned.errors) > 10
    if least is None:
        assert max(learned.errors) < 4.0 * learned.errors[0]
        assert learned.errors.count(pytest.approx(learned.errors[0])) > 2, "it begins again"
    else:
        assert learned.errors[-1] < least * learned.errors[0]


# ---- Turns that grow -------------------------------------------------------------------------------------------------


def spiral(turns=256, rotation=100.0, rate=RATE, **given):
    scan = scans.spiral(turns=turns, rotation=rotation, sample_rate=rate, offset=(15.0, 15.0), **given)
    return dict(zip("xy", scan.axes, strict=True)), scan.inside


def off(motion, inside, period):
    """Of a spiral whose 7th harmonic is at the resonance of Bouc-Wen, % of its diameter, rms."""
    stages = (StageSettings(), StageSettings(resonances=(700.0,), hysteresis_kind="bouc-wen"))
    controller = MultiAxisController(
        {name: told(one, 1.0) for name, one in zip("xy", stages, strict=True)}, period=period
    )
    recording = run(motion, controller, MultiAxisStage(MultiAxisSettings(axes=stages), seed=1))
    errors = np.stack([recording[f"true_{name}"] - recording[f"desired_{name}"] for name in "xy"])[:, inside]
    return 100 / 20.0 * np.sqrt(np.mean(np.sum(errors**2, axis=0)))


def test_what_is_alike_in_turns_that_grow_is_learned():
    motion, inside = spiral()
    assert off(motion, inside, 0.01) < 0.07 < 0.5 * off(motion, inside, None)


@pytest.mark.parametrize("shrinks", [False, True])
def test_turns_that_grow_are_as_large_as_they_are(shrinks):
    """A spiral r = pitch phi / (2 pi), with a slow drift."""
    period, n = 50, 200
    k = np.arange(n * period)[:: -1 if shrinks else 1]
    z = 5.0 * k / k.size * np.sin(2 * np.pi * k / period) + 1e-4 * k
    motion = Trajectory("turns", RATE, z, np.gradient(z, 1 / RATE))
    found = turns_of([motion], period, 0)
    here = np.arange(found.start, found.stop)
    radius = k[here] / k[here].max()
    np.testing.assert_allclose(found.size(here), np.maximum(radius, 0.2), atol=0.01)
    assert len(here) > 0.9 * k.size
    assert found.at(found.start + 777) == found.size(here)[777]
    assert 0.9 * np.ptp(z) < np.ptp(z[found.largest]) + 1e-4 * k.size


@pytest.mark.parametrize(
    "z",
    [
        10.0 * np.sin(2 * np.pi * np.arange(20_000) / 10_000),  # much slower: each part is like the next
        np.linspace(0.0, 10.0, 20_000),
        10.0 * np.sin(2 * np.pi * np.linspace(0.0, 7.0, 2_000) ** 2),  # a chirp
        np.linspace(0.0, 10.0, 450) * np.sin(2 * np.pi * np.arange(450) / 50),  # nine turns
        np.random.default_rng(0).standard_normal(20_000),
    ],
)
def test_what_has_no_turns_of_this_period_is_refused(z):
    with pytest.raises(SettingError, match=r"period = .* s: must be a period of the motion, here a "):
        turns_of([Trajectory("turns", RATE, z, np.gradient(z, 1 / RATE))], 50, 0)


def test_few_turns_are_refused_with_the_number_of_them():
    """Their first batches, which may be wrong, would be all."""
    known = settings(SLOW, dynamics=SLOW.dynamics())
    motion, _ = spiral(turns=64)
    with pytest.raises(
        SettingError,
        match=r"period = 0.01 s: must be left out, or the motion 13 turns longer: 59 turns grow .* damping 72 are",
    ):
        MultiAxisController({"x": known, "y": known}, period=0.01).prepare(motion)


@pytest.mark.parametrize(
    ("scan", "ticks", "words"),
    [
        (lambda: scans.spiral(turns=256, rotation=100.5, sample_rate=RATE), 100, "its own is 99.5025 ticks, .* 100 Hz"),
        (lambda: scans.spiral(turns=256, rotation=90.0, sample_rate=RATE), 111, r"111.111 ticks.* 90.0900\d* Hz"),
        (lambda: scans.spiral(turns=256, rotation=100.0, sample_rate=RATE), 99, "here a spiral: 0.01 s"),
        (lambda: scans.spiral(turns=256, rotation=100.0, sample_rate=RATE), 50, "here a spiral: 0.01 s"),
        (lambda: scans.spiral(turns=256, rotation=100.0, velocity="linear", sample_rate=RATE), 100, "leave it out"),
        (lambda: scans.raster(lines=96, rate=40.1, sample_rate=RATE), 250, "249.377 ticks, .* 0.0249 s"),
        (lambda: scans.raster(lines=96, rate=40.0, sample_rate=RATE), 251, "here a raster: 0.025 s"),
        (lambda: scans.cycloid(rate=40.0, pitch=0.2, sample_rate=RATE), 249, "here a cycloid: 0.025 s"),
    ],
)
def test_a_period_that_is_a_little_wrong_is_refused_with_the_right_one(scan, ticks, words):
    """What is learned would come ever earlier or later: a raster of 40.1 Hz was worse with 0.025 s than without."""
    with pytest.raises(SettingError, match=words):
        turns_of(scan().axes, ticks, 5_000)


def test_a_motion_that_ends_before_anything_is_learned_is_refused():
    short = sine(frequency=20.0, peak_to_peak=9.0, offset=9.0, duration=0.53, ramp=0.05, sample_rate=RATE)
    known = settings(SLOW, dynamics=SLOW.dynamics())
    with pytest.raises(SettingError, match=r"0.55 s long or longer: nothing is learned in its first 0.5 s, and it has"):
        MultiAxisController({"x": known, "y": known}, period=0.05).prepare({"x": short, "y": short})


def test_turns_that_one_axis_refuses_change_no_axis():
    """The stage of x is damped well, that of y is not."""
    damped, slow = (settings(SLOW, dynamics=Dynamics(sample_rate=RATE, modes=(m,))) for m in DAMPED_AND_NOT)
    controller = MultiAxisController({"x": damped, "y": slow}, period=0.01)
    motion, _ = spiral(turns=40)
    before = controller.state()
    with pytest.raises(SettingError, match="turns longer: 35 turns grow evenly"):
        controller.prepare(motion)
    after = controller.state()
    assert before.keys() == after.keys()
    for name, entry in before.items():
        np.testing.assert_array_equal(after[name], entry)


DAMPED_AND_NOT = Mode(frequency=700.0, damping=0.2), Mode(frequency=700.0, damping=0.01)


def test_each_tick_of_turns_that_grow_has_the_bits_of_blocks():
    """A batch is concluded in several ticks, and in one call; a state goes on in the middle."""
    known = Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),))
    wave, counts = np.sin(2 * np.pi * np.arange(50) / 50), np.ones(50, dtype=bool)
    turns = Turns(50, 500, 10_500, np.linspace(0.2, 1.0, 200))
    noise = np.random.default_rng(0).standard_normal(10_600)
    blocks, ticks = (LearnedStrain(known, 50) for _ in range(2))
    added = []
    for one in (blocks, ticks):
        one.follow(wave, counts, turns)
    begin = 0
    while begin < 10_600:
        stop = next((stop for stop in blocks.stops if stop > begin), 10_600)
        added.append(blocks.of(range(begin, stop)))
        blocks.see(begin, noise[begin:stop])
        begin = stop
    one_by_one = []
    for tick in range(10_600):
        if tick == 6_000:
            other = LearnedStrain(known, 50)
            other.restore(ticks.state())
            ticks = other
        one_by_one.append(ticks.at(tick))
        ticks.put(tick, noise[tick])
    assert len(blocks.errors) >= 10
    np.testing.assert_array_equal(np.concatenate(added), one_by_one)


def of_a_line(learned, period, batches, errors, noise):
    """Rms of batches that learn a strain r; `errors(r, batch)` is the spectrum of the error of a period."""
    random, tick = np.random.default_rng(1), 0
    while len(learned.errors) < batches:
        r = learned.of(range(tick, tick + period))
        error = np.fft.irfft(errors(np.fft.rfft(r), len(learned.errors)), period)
        learned.see(tick, error + noise * random.standard_normal(period))
        tick += period
    return learned.errors


def behind_a_mode(rate, period, f0, damping):
    """What learns lines on a stage whose mode is known, harmonics of them over f0, and its response there."""
    learned = LearnedStrain(Dynamics(sample_rate=rate, modes=(Mode(frequency=f0, damping=damping),)), period)
    learned.follow(np.cos(2 * np.pi * np.arange(period) / period), np.ones(period, dtype=bool), Turns(period, 0, 10**7))
    f = np.arange(period // 2 + 1) * rate / period / f0
    response = np.exp(-1j * np.pi * f * f0 / rate) / (1 - f**2 + 2j * damping * f)
    return learned, f, response


@pytest.mark.parametrize("changes", ["the stage", "the motion"])
def test_the_learned_strain_after_a_change(changes):
    """A stage that answers otherwise contradicts all that was learned of it; a motion that drifts shows nothing of it.

    100 lines a second, whose seventh harmonic meets the resonance of 700 Hz.
    """
    rate, period, f0, damping = 5000.0, 50, 700.0, 0.01
    learned, f, response = behind_a_mode(rate, period, f0, damping)
    seventh = np.arange(f.size) == 7
    calls = iter(range(10**6))

    def errors(r, batch):
        other = 6 * np.exp(1.2j) if changes == "the stage" and batch >= 8 else 1.0
        walk = 0.0 if changes == "the stage" or batch < 4 else 0.003 * np.exp(0.02j * next(calls))
        return other * response * r + np.where(seventh, (0.003 + walk) * period / 2, 0.0)

    found = of_a_line(learned, period, 20, errors, 1e-3)
    assert found[3] < 0.3 * found[0]
    if changes == "the stage":
        assert found[8] > 4 * found[0]
        assert max(found[14:]) < 0.5 * found[0], "it was learned again"
    else:
        assert max(found[5:]) < found[0], "no wrong answer is learned"


def test_noise_shows_nothing_of_the_stage():
    """A change that was made of noise meets it again in the difference of two batches; the dynamics are exact."""
    rate, period, f0, damping = 10_000.0, 500, 1235.0, 0.013
    learned, f, response = behind_a_mode(rate, period, f0, damping)
    of_a_line(learned, period, 60, lambda r, _: response * r, 1e-3)
    ratio = learned._law.ratio[(f > 0.8) & (f < 1.2)]
    assert np.abs(np.angle(ratio)).max() < np.radians(60.0), "a step in a wrong direction"
    assert np.abs(ratio).max() < 9.0, "no step"


def test_a_ringing_that_goes_on_for_periods_is_no_part_of_what_repeats():
    """Noise rings at 598 Hz, the sixth harmonic of 100 lines a second, for seven of them: neighbours are alike."""
    rate, period, f0, damping = 5000.0, 50, 598.0, 0.0039
    learned, f, response = behind_a_mode(rate, period, f0, damping)
    sixth, kept, random = np.arange(f.size) == 6, np.exp(-1 / 7), np.random.default_rng(0)
    ringing, moved = 0j, []

    def errors(r, _):
        nonlocal ringing
        ringing = kept * ringing + np.sqrt(1 - kept**2) * 1e-3 * complex(*random.normal(size=2))
        moved.append(np.std(np.fft.irfft(response * r, period)))
        return response * r + np.where(sixth, ringing * period / 2, 0.0)

    of_a_line(learned, period, 40, errors, 0.0)
    assert max(moved[200:]) < 0.4e-3, "less than half of what rings is put out"


def test_held_axes_keep_what_they_have_learned_of_a_period():
    """And go on learning without a bump, as soon as they are resumed."""
    motion = {name: dataclasses.replace(one, **short(one, 15_000)) for name, one in MOTION.items()}
    controller, plant = pair()
    known, learned = controller.prepare(motion), controller.learned["x"]
    plant.open()
    volts, found = np.empty((15_000, 2)), []
    for k in range(15_000):
        if k == 9_800:  # the strain of the first batch is there
            controller.hold()
        if k == 12_000:
            controller.resume()
        if k in (9_800, 12_000):
            found.append((learned.errors.copy(), copy.deepcopy(learned).of(range(k, k + 250)).tolist()))
        volts[k] = controller.follow(known, k)
        controller.adapt(plant.exchange(volts[k][np.newaxis])[0])
    shift = 9_800 % 250 - 12_000 % 250
    assert np.roll(found[0][1], shift).tolist() == found[1][1]
    assert np.any(found[0][1])
    assert (len(found[0][0]), found[0][0]) == (1, found[1][0])
    assert len(learned.errors) == 2
    bends = np.abs(np.diff(volts[:, 0], 2))
    assert bends[11_990:12_260].max() < 1.01 * bends[11_000:11_990].max(), "no bump"


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_sudden_steps_of_one_axis_do_not_shake_a_stiff_one(share):
    """y of 2 kHz steps by a pixel in four ticks, after each row of x, on which Bouc-Wen has its largest error."""
    x = StageSettings(resonances=(2144.0,), dampings=(0.0071,), hysteresis_kind="bouc-wen", noise=0.001)
    y = StageSettings(resonances=(2020.0,), dampings=(0.0071,), noise=0.001)
    moves = {"turn": x.dynamics(), "settle": y.dynamics(), "over_scan": 0.01, "lead_in": 4, "offset": (14.5, 14.0)}
    scan = scans.raster(width=20.0, height=0.625, lines=16, rate=5.0, sample_rate=RATE, **moves)
    controller = MultiAxisController({"x": settings(x), "y": settings(y)})
    plant = MultiAxisStage(MultiAxisSettings(axes=(x, y), coupling=[[0.0, share], [0.0, 0.0]]))
    recording = run({"x": scan.x, "y": scan.y}, controller, plant)
    error = (recording["true_x"] - recording["desired_x"])[scan.inside & (recording["time"] > 2.0)]
    assert np.abs(error).max() < 0.05


def test_the_prior_of_what_another_axis_does_is_scaled_by_the_stage():
    """A drag of 5 % of another axis, and a lag of as much, are 0.05 / w0 at most; a softer stage keeps 50 us."""
    lags = [settings(StageSettings(resonances=(f0,))).among(1) for f0 in (250.0, 900.0, 2144.0)]
    deviations = [np.sqrt(np.diag(one.prior_covariance))[one.columns["coupling_lag"]].item() for one in lags]
    assert deviations[0] == pytest.approx(5e-5)
    assert deviations[1] / deviations[2] == pytest.approx(2144.0 / 900.0)
    assert 0.05 < deviations[2] * 2 * np.pi * 2144.0 < 0.5


def test_what_a_limit_takes_is_not_learned():
    """Lines beyond the lowest voltage: no strain brings them back, and none is tried."""
    low = {**MOTION, "x": dataclasses.replace(LINES, position=LINES.position - 8.0)}
    controller, plant = pair()
    with pytest.warns(match="axis x"):
        run(low, controller, plant)
    assert controller.counters["x"].saturated > 1000
    assert not controller.learned["x"].errors
    assert not controller.learned["x"].of(range(20_000, 20_250)).any()
    assert controller.learned["y"].errors


def test_a_repetition_that_does_not_fit_is_named():
    with pytest.raises(SettingError, match=r"axes\['y'\]\.dynamics = None: must be the dynamics of the axis"):
        MultiAxisController({"x": settings(FAST), "y": settings(SLOW, False)}, period=0.025)
    with pytest.raises(SettingError, match=r"a whole number of ticks of 10000 Hz, not 244\.8.*such as 0\.0245 s"):
        pair(period=0.02448)
    with pytest.raises(SettingError, match=r"not 250\.05: such as 0\.025 s"):  # the nearest, not the next
        pair(period=0.025005)
    controller = pair(period=0.03)[0]
    with pytest.raises(
        SettingError, match=r"period = 0\.03 s: must be a period of the motion, here a raster: 0\.025 s"
    ):
        controller.prepare(MOTION)
    controller.restore(controller.state())
    with pytest.raises(SettingError, match=r"period 300 ticks: must be one made with period 250 ticks"):
        pair()[0].restore(controller.state())
    with pytest.raises(SettingError, match=r"another period than 250 ticks"):
        pair()[0].learned["x"].restore(controller.learned["x"].state())


def test_a_long_motion_is_prepared_in_little_more_than_what_is_kept():
    """64 bytes of a tick are kept, and a column is inverted in blocks: of the whole motion at once it took 113."""
    stage = Dynamics(sample_rate=5000.0, modes=(Mode(frequency=900.0, damping=0.02),))
    settings = ControllerSettings(sample_rate=5000.0, stroke=30.0, voltage_limits=(-0.6, 3.6), dynamics=stage)
    controller = MultiAxisController({"x": settings, "y": settings})
    ticks = 1_000_000
    motion = sine(frequency=1.0, peak_to_peak=10.0, duration=ticks / 5000.0, sample_rate=5000.0)
    tracemalloc.start()
    try:
        controller.prepare({"x": motion, "y": motion})
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most / ticks < 92, most / ticks


class Lossy:
    """A stage that hands its calls on, some of whose samples are lost, or are spikes of 5 um."""

    def __init__(self, stage, share, spikes):
        self._stage, self._share, self._spikes = stage, share, spikes
        self._random = np.random.default_rng(3)

    def __getattr__(self, name):
        return getattr(self._stage, name)

    def exchange(self, volts):
        measured = np.array(self._stage.exchange(volts))
        measured[self._random.random(len(measured)) < self._share] += 5.0 if self._spikes else np.nan
        return measured


@pytest.mark.parametrize("spikes", [False, True], ids=["lost", "spikes"])
def test_what_repeats_is_learned_though_samples_are_lost_or_are_spikes(spikes):
    """With a sample in fifty lost nothing was learned, as each period missed one; of spikes it learned their mean."""
    rate, kept = 5000.0, {}
    axes = tuple(StageSettings(sample_rate=rate, resonances=(f,)) for f in (900.0, 600.0))
    known = {"sample_rate": rate, "stroke": 30.0, "voltage_limits": (-0.6, 3.6), "feedback": False}
    lines = raster(frequency=40.0, peak_to_peak=20.0, duration=1.6, sample_rate=rate)
    rest = Trajectory("rest", rate, np.zeros(len(lines)), np.zeros(len(lines)))
    for share in (0.0, 0.02):
        controller = MultiAxisController(
            {n: ControllerSettings(**known, dynamics=one.dynamics()) for n, one in zip("xy", axes, strict=True)},
            period=0.025,
        )
        stage = MultiAxisStage(MultiAxisSettings(axes=axes, coupling=[[0.0, 0.03], [0.03, 0.0]]))
        recording = run({"x": lines, "y": rest}, controller, Lossy(stage, share, spikes) if share else stage)
        error = (recording["true_x"] - recording["desired_x"])[round(1.2 * rate) :]
        kept[share] = len(controller.learned["x"].errors), np.sqrt(np.mean(error[lines.flat[-len(error) :] > 0] ** 2))
    assert kept[0.02][0] == kept[0.0][0] >= 2
    assert kept[0.02][1] < 1.5 * kept[0.0][1]


def test_a_period_with_a_limit_or_many_lost_samples_does_not_count():
    periods = np.tile(np.sin(np.arange(40.0)), (6, 1)) + np.arange(6.0)[:, np.newaxis]
    periods[0, 3] = np.inf  # a limit held the voltage
    periods[1, :9] = np.nan
    periods[2, 5:9] = np.nan
    found = filled(periods)
    np.testing.assert_array_equal(found[1:], periods[3:])
    np.testing.assert_allclose(found[0, 5:9], np.sin(np.arange(5.0, 9.0)) + 4.0)
    periods[:, 0] = np.nan  # a place that no period shows
    assert len(filled(periods)) == 0
