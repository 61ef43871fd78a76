"""The loop: each measurement meets its command, whatever block and latency are; nothing recorded is lost."""

from typing import Any

import numpy as np
import pytest

import truestroke
from truestroke import AdaptiveController, Recording, RunInterrupted, SettingError, Timing, run, trajectories
from truestroke.plant import RealisticPlant
from truestroke.runtime.agreement import count_latency

PAPER = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
WAVE = trajectories.random_wave(duration=1.0, velocity_limit=300.0)


class Fake:
    """A play and a spring; measurements come `latency` ticks late, before them 99."""

    def __init__(self, block=1, latency=0, **tricks):
        self.timing = Timing(sample_rate=2000.0, block=block, latency=latency)
        self.tricks = tricks

    def open(self):
        self.y, self.tick, self.sizes = 0.0, 0, []
        self.late = [(99.0, 99.0)] * self.timing.latency
        return self.timing

    def respond(self, volt):
        self.y = max(volt - 0.2, min(volt + 0.2, self.y))
        self.tick += 1
        true = 5 * volt + 4 * self.y
        return (true + 0.01 * np.sin(7.0 * self.tick), true)

    def exchange(self, volts):
        self.sizes.append(volts.size)
        if self.tick >= self.tricks.get("fails_at", np.inf):
            raise self.tricks["error"]
        self.late += [self.respond(v) for v in volts.tolist()]
        out, self.late = self.late[: volts.size], self.late[volts.size :]
        self.truth = np.array([true for _, true in out])
        measured = np.array([z for z, _ in out])
        if self.tick == self.tricks.get("nan_at"):
            measured[-1] = np.nan
        return measured

    def describe(self):
        return {"play": 0.2}


class Listener:
    """A baseline without flags, innovation or weights; notes what it is told."""

    def __init__(self):
        self.commands, self.answers = [], {}

    def command(self, z_d, zdot_d):
        self.commands.append(z_d)
        return z_d / 9.0

    def adapt(self, z_measured, ago=0):
        self.answers[len(self.commands) - 1 - ago] = z_measured


@pytest.mark.parametrize(("block", "latency"), [(1, 0), (5, 0), (1, 7), (5, 7), (7, 3), (63, 1), (1, 63), (600, 424)])
def test_each_measurement_meets_its_command(block, latency):
    listener, direct = Listener(), run(WAVE, Listener(), Fake())
    recording = run(WAVE, listener, Fake(block, latency))
    ticks = len(WAVE) - latency
    assert list(listener.answers) == list(range(ticks))  # every one, once, in order
    for name in ("volts", "desired", "time"):
        np.testing.assert_array_equal(recording[name], direct[name])
    for name in ("measured", "true"):
        np.testing.assert_array_equal(recording[name][:ticks], direct[name][:ticks])
        assert np.isnan(recording[name][ticks:]).all()
    np.testing.assert_array_equal(list(listener.answers.values()), direct["measured"][:ticks])
    assert "innovation" not in recording
    assert "flags" not in recording
    assert "weights" not in recording


def test_blocks_have_their_size_and_the_last_may_be_shorter():
    actuator = Fake(block=63)
    run(WAVE, Listener(), actuator)
    assert actuator.sizes == [63] * 31 + [2000 - 31 * 63]


def test_on_hold_a_late_measurement_says_the_same_as_one_at_once():
    # on hold the voltages do not depend on what was measured, so the innovations depend on the pairing alone
    direct, late = AdaptiveController.paper(**PAPER), AdaptiveController.paper(**PAPER)
    direct.hold()
    late.hold()
    direct, late = run(WAVE, direct, Fake()), run(WAVE, late, Fake(5, 7))
    np.testing.assert_array_equal(direct["innovation"][:-7], late["innovation"][:-7])
    assert np.abs(direct["innovation"]).max() > 1.0
    assert np.isnan(late["innovation"][-7:]).all()
    assert (late["flags"] & 8).all()


def test_learning_late_is_what_the_kernel_does_with_its_own_latency():
    recording = run(WAVE, AdaptiveController.paper(**PAPER), Fake(latency=7))
    kernel = AdaptiveController.paper(**PAPER)
    as_it_came = np.concatenate([np.full(7, np.nan), recording["measured"][:-7]])
    volts = kernel.process(recording["desired"], recording["desired_velocity"], as_it_came, ago=7)
    np.testing.assert_array_equal(recording["volts"], volts)


def test_learning_late_still_tracks():
    for actuator in (Fake(), Fake(5, 7)):
        recording = run(WAVE, AdaptiveController.paper(**PAPER), actuator)
        error = recording["true"] - recording["desired"]
        assert np.sqrt(np.nanmean(error[1000:] ** 2)) < 0.05


def test_the_recording_is_what_the_bare_loop_gives():
    controller, actuator = AdaptiveController.paper(**PAPER), Fake()
    actuator.open()
    volts, measured, innovation, flags, weights, slopes = [], [], [], [], [], []
    for k, (z_d, zdot_d) in enumerate(zip(WAVE.position.tolist(), WAVE.velocity.tolist(), strict=True)):
        volts.append(controller.command(z_d, zdot_d))
        measured.append(actuator.exchange(np.array([volts[-1]]))[0])
        controller.adapt(measured[-1])
        innovation.append(controller.innovation)
        flags.append(controller.flag_bits)
        if k % 20 == 0:
            weights.append(controller.weights)
            slopes.append(controller.diagnostics.partial_slopes)
    recording = run(WAVE, AdaptiveController.paper(**PAPER), Fake())
    expected = {"volts": volts, "measured": measured, "innovation": innovation, "flags": flags}
    for name, values in (expected | {"weights": weights, "partial_slopes": slopes}).items():
        np.testing.assert_array_equal(recording[name], values, strict=False)
    np.testing.assert_array_equal(recording["weights_time"], WAVE.time[::20])
    assert recording["trace_P"].shape == (100,)
    assert recording["flags"].dtype == np.uint8


def test_a_missing_measurement_is_flagged_at_its_own_tick():
    for block, latency in ((1, 0), (5, 0), (1, 7), (5, 5)):
        recording = run(WAVE, AdaptiveController.paper(**PAPER), Fake(block, latency, nan_at=500))
        gone = 499 - latency
        assert np.flatnonzero(recording["flags"] & 4).tolist() == [gone]
        for name in ("measured", "innovation"):
            assert np.flatnonzero(np.isnan(recording[name])[: 2000 - latency]).tolist() == [gone]


@pytest.mark.parametrize("kind", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize(("block", "latency", "kept"), [(1, 0, 700), (64 - 8, 7, 728)])
def test_what_was_recorded_is_kept_when_a_run_is_interrupted(tmp_path, kind, block, latency, kept):
    error = kind("cable")
    whole = run(WAVE, AdaptiveController.paper(**PAPER), Fake(block, latency))
    with pytest.raises(RunInterrupted, match=f"ended after {kept} ticks: {kind.__name__}") as caught:
        run(WAVE, AdaptiveController.paper(**PAPER), Fake(block, latency, fails_at=700, error=error))
    assert caught.value.__cause__ is error
    part = Recording.load(caught.value.recording.save(tmp_path / "part.h5"))
    assert part["time"].size == kept
    assert part["weights"].shape == (-(-kept // 20), 16)
    for name in ("volts", "measured", "innovation", "flags"):
        np.testing.assert_array_equal(part[name][: kept - latency], whole[name][: kept - latency])
    assert np.isfinite(part["measured"][: kept - latency]).all()
    assert part.metadata["interrupted"] == repr(error)
    assert whole.metadata["interrupted"] is None


def test_interrupted_before_the_first_tick():
    with pytest.raises(RunInterrupted, match="after 0 ticks") as caught:
        run(WAVE, AdaptiveController.paper(**PAPER), Fake(fails_at=0, error=OSError()))
    assert caught.value.recording["measured"].size == 0


def test_progress_is_told_about_a_hundred_times():
    calls = []
    run(WAVE, Listener(), Fake(block=7), progress=lambda done, ticks: calls.append((done, ticks)))
    assert 90 <= len(calls) <= 100
    assert calls == sorted(calls)
    assert calls[-1] == (2000, 2000)


def test_metadata_tells_what_was_run():
    metadata = run(WAVE, AdaptiveController.paper(**PAPER), Fake(5, 7)).metadata
    assert metadata["trajectory"]["settings"]["seed"] == 0
    assert metadata["controller"]["name"] == "AdaptiveController"
    assert metadata["controller"]["settings"]["forgetting"] == 0.9999
    assert metadata["plant"] == {"name": "Fake", "settings": {"play": 0.2}}
    assert {"sample_rate": 2000.0, "block": 5, "latency": 7}.items() <= metadata["timing"].items()
    assert metadata["versions"]["truestroke"] == truestroke.__version__


def test_same_seed_same_bits():
    a, b = (run(WAVE, AdaptiveController.paper(**PAPER), Fake()) for _ in range(2))
    assert all(a[name].tobytes() == b[name].tobytes() for name in a.channels)


def test_what_does_not_fit_together_is_refused():
    with pytest.raises(
        SettingError, match=r"trajectory.sample_rate = 1000.0 Hz: must be 2000.0 Hz, that of the actuator"
    ):
        run(trajectories.sine(sample_rate=1000.0), Listener(), Fake())
    with pytest.raises(SettingError, match=r"must be 1000.0 Hz, that of the controller"):
        run(WAVE, AdaptiveController.paper(**PAPER | {"sample_rate": 1000.0}), Fake())
    with pytest.raises(
        SettingError, match=r"latency = 1029 ticks: must be at most 1023 ticks, .*: take a smaller block"
    ):
        run(WAVE, Listener(), Fake(1023, 7))

    class Odd(Fake):
        def describe(self):
            return {"gain": np.inf}

    actuator = Odd()
    with pytest.raises(SettingError, match="metadata"):
        run(WAVE, Listener(), actuator)
    assert actuator.sizes == []  # nothing has moved

    class TooMuch(Fake):
        def exchange(self, volts):
            return np.zeros(volts.size + 1)

    with pytest.raises(RunInterrupted, match=r"exchange = array of shape \(2,\) um: must be of shape \(1,\)"):
        run(WAVE, Listener(), TooMuch())


class Proportional:
    """A controller of a user's own, whose command is what it is made with."""

    def __init__(self, volts: Any) -> None:
        self.volts = volts

    def command(self, z_d: float, zdot_d: float) -> Any:
        return self.volts

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        pass


@pytest.mark.parametrize(
    ("volts", "said"),
    [
        (None, r"controller.command\(\) = None V: must be a number"),
        (np.nan, r"controller.command\(\) = nan V: must be finite"),
        ("3", r"controller.command\(\) = '3' V: must be a number"),
        (np.zeros(2), r"controller.command\(\) = array of shape \(2,\) V: must be a number"),
    ],
)
def test_a_command_of_ones_own_controller_is_a_number(volts: Any, said: str) -> None:
    wave = trajectories.sine(frequency=5.0, peak_to_peak=20.0, duration=0.5)
    with pytest.raises(RunInterrupted, match=said):
        run(wave, Proportional(volts), RealisticPlant(seed=0))
    assert run(wave, Proportional(1), RealisticPlant(seed=0))["volts"][-1] == 1.0


def test_calls_that_take_other_arguments_are_named_before_the_first_tick() -> None:
    wave = trajectories.sine(frequency=5.0, peak_to_peak=20.0, duration=0.5)
    late, fast, bench = Proportional(1.0), Proportional(1.0), RealisticPlant(seed=0)
    late.adapt = lambda z: None  # type: ignore[method-assign, assignment, misc]
    fast.command = lambda z_d: 1.0  # type: ignore[method-assign, assignment, misc]
    bench.exchange = lambda: None  # type: ignore[method-assign, assignment, misc]
    with pytest.raises(SettingError, match=r"adapt = adapt\(z\): must be callable as adapt\(z_measured, ago=0\)"):
        run(wave, late, RealisticPlant(seed=0))
    with pytest.raises(SettingError, match=r"command = command\(z_d\): must be callable as command\(z_d, zdot_d\)"):
        run(wave, fast, RealisticPlant(seed=0))
    with pytest.raises(SettingError, match=r"exchange = exchange\(\): must be callable as exchange\(volts\)"):
        run(wave, Proportional(1.0), bench)


def test_a_recording_that_does_not_fit_the_memory_is_refused_before_anything_moves(monkeypatch):
    wave = trajectories.sine(frequency=8.0, peak_to_peak=20.0, duration=400.0)
    monkeypatch.setattr("truestroke.base.system.free_memory", lambda: 1e8)
    controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    with pytest.raises(
        truestroke.SettingError, match=r"trajectory = of 800000 ticks: must be at most 4\.55e\+05: a rec"
    ):
        truestroke.run(wave, controller, RealisticPlant())


def test_a_latency_that_no_feedback_is_designed_for_names_the_block():
    """It was a whole number from 0 to 20, of what the reader had to guess."""
    known = truestroke.Dynamics(sample_rate=2000.0, modes=(truestroke.Mode(frequency=300.0, damping=0.02),))
    controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6), dynamics=known)
    timing = Timing(sample_rate=2000.0, block=50, latency=0)
    words = r"^block - 1 \+ latency = 49 ticks: must be at most 20 ticks with dynamics, .*: take a smaller block"
    with pytest.raises(SettingError, match=words):
        count_latency(controller, timing)
