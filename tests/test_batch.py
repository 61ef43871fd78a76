"""simulate_many: the bits of `run`, whatever the threads; the GIL free; errors by name; Ctrl-C at once."""

import os
import signal
import threading
import time
import tracemalloc

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings, Simulation, SimulationError, metrics, run, simulate_many
from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant
from truestroke.plant.noise import Noise
from truestroke.runtime.batch import SEGMENT
from truestroke.runtime.native import Pair
from truestroke.runtime.ticks import SIMULATED
from truestroke.signals.trajectories import random_wave, sine

RANGE = {"stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
PAPER = ControllerSettings.paper(sample_rate=2000.0, **RANGE)
DEFAULT = ControllerSettings(sample_rate=2000.0, **RANGE)
CHANGE = Change(time=1.0, gain=0.6, hysteresis=1.5)


def simulation(**given):
    known = {"trajectory": sine(duration=0.5), "controller": PAPER, "plant": MatchedSettings(), "seed": 0}
    return Simulation(**known | given)


def kinds():
    """Pairs of every kind: laws, plants, changes, limits that are met, number types, rates, lengths, seeds."""
    wave = random_wave(seed=1, duration=(SEGMENT + 116) / 2000)  # more than a segment
    fast = random_wave(seed=2, duration=0.6, sample_rate=5000.0)
    return [
        simulation(trajectory=wave),
        simulation(trajectory=wave, controller=DEFAULT, seed=1),
        simulation(trajectory=wave, controller=DEFAULT, plant=PlantSettings(), seed=2),
        simulation(trajectory=wave, plant=PlantSettings(change=CHANGE, samples_per_tick=2), seed=3),
        simulation(trajectory=wave, controller=DEFAULT, plant=MatchedSettings(change=CHANGE, weight_spread=0.3)),
        simulation(
            trajectory=fast,
            controller=ControllerSettings(sample_rate=5000.0, stroke=20.0, voltage_limits=(0.0, 1.8), slew_limit=900.0),
            plant=PlantSettings(sample_rate=5000.0),
        ),
        simulation(
            trajectory=wave,
            controller=ControllerSettings(sample_rate=2000.0, **RANGE, precision="single", measurement_limit=25.0),
            plant=PlantSettings(),
            seed=2**40,
        ),
    ]


def alone(s):
    """What `run` gives."""
    matched = isinstance(s.plant, MatchedSettings)
    plant = MatchedPlant(s.trajectory.velocity, s.plant, s.seed) if matched else RealisticPlant(s.plant, s.seed)
    return run(s.trajectory, AdaptiveController.from_settings(s.controller), plant)


def test_every_kind_of_pair_gives_the_bits_of_run_for_any_number_of_threads():
    simulations, seen = kinds(), 0
    recordings = [alone(s) for s in simulations]
    for threads in (1, 2, 5):
        batch = simulate_many(simulations, record=SIMULATED, threads=threads)
        for i, recording in enumerate(recordings):
            ticks = batch.ticks[i]
            assert ticks == recording["time"].size
            seen |= int(np.bitwise_or.reduce(recording["flags"]))
            for name in SIMULATED:
                np.testing.assert_array_equal(batch[name][i, :ticks], recording[name], f"{name} of {i}", strict=True)
                rest = batch[name][i, ticks:]
                assert np.all(rest == 0 if name == "flags" else np.isnan(rest))
    assert seen & (1 | 4 | 16 | 32) == 1 | 4 | 16 | 32  # or nothing was told of limits, rejection, change


def test_figures_are_those_of_the_recordings_and_name_their_simulation():
    simulations = kinds()
    batch = simulate_many(simulations, reduce=lambda i, channels: (i, metrics.summary(channels)), threads=2)
    assert batch.results == [(i, metrics.summary(alone(s))) for i, s in enumerate(simulations)]
    assert not batch.channels


def test_a_trajectory_may_be_made_where_it_is_run():
    wave = random_wave(seed=4, duration=0.5)
    simulations = [simulation(trajectory=lambda: random_wave(seed=4, duration=0.5)), simulation(trajectory=wave)]
    one, other = simulate_many(simulations, reduce=lambda _, channels: channels["true"].copy()).results
    np.testing.assert_array_equal(one, other, strict=True)


def test_given_arrays_are_filled_in_place():
    out = {"true": np.zeros((3, 1000)), "flags": np.ones((3, 1000), np.uint8)}
    batch = simulate_many([simulation(seed=n) for n in range(3)], record=("true", "flags", "volts"), out=out)
    assert batch["true"] is out["true"]
    assert batch["flags"] is out["flags"]
    np.testing.assert_array_equal(out["true"][2], alone(simulation(seed=2))["true"])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"record": ("volt",)}, "record = 'volt': must be of volts"),
        ({"out": {"true": np.zeros((1, 999))}}, r"out\['true'\] = float64 array of shape \(1, 999\)"),
        ({"out": {"true": np.zeros((1, 1000), np.float32)}}, "float32 array"),
        ({"out": {"flags": np.zeros((1, 1000), np.uint8)}}, "out = .*flags.*must be of the recorded channels"),
        ({"threads": 0}, "threads = 0"),
    ],
)
def test_bad_arguments_are_named_before_anything_runs(given, words):
    with pytest.raises(ValueError, match=words):
        simulate_many([simulation()], **given)


def test_lengths_must_be_known_where_ticks_are_kept():
    with pytest.raises(ValueError, match="trajectory is a function"):
        simulate_many([simulation(trajectory=sine)])


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"plant": PlantSettings(sample_rate=5000.0)}, "trajectory.sample_rate = 2000.0 Hz: must be 5000.0 Hz"),
        ({"seed": -1}, "seed = -1"),
        ({"trajectory": lambda: 1 / 0}, "ZeroDivisionError"),
    ],
)
def test_an_error_names_its_simulation_and_stops_the_others(bad, words):
    ran = []
    good = simulation(trajectory=sine(duration=5.0))
    with pytest.raises(SimulationError, match=f"simulation 3: .*{words}") as caught:
        simulate_many(
            [good, good, good, simulation(**bad), *[good] * 500], reduce=lambda i, _: ran.append(i), threads=2
        )
    assert caught.value.index == 3
    assert caught.value.__cause__ is not None
    assert len(ran) < 100


def test_an_error_in_figures_names_its_simulation():
    with pytest.raises(SimulationError, match="simulation 1: KeyError: 'no such'"):
        simulate_many([simulation(), simulation()], reduce=lambda i, channels: channels["no such"] if i else 0)


def test_ctrl_c_stops_within_a_segment(monkeypatch):
    """Each simulation would take seconds: those that run when it comes are not run to their ends."""
    long = simulation(trajectory=sine(duration=2000.0))
    segment, begun = Pair.run, []

    def counted(pair, part, *arguments):
        begun.append(part)
        if len(begun) == 20:
            os.kill(os.getpid(), signal.SIGINT)
        segment(pair, part, *arguments)

    monkeypatch.setattr(Pair, "run", counted)
    with pytest.raises(KeyboardInterrupt):
        simulate_many([long] * 50, reduce=lambda *_: None)
    assert 20 <= len(begun) < len(long.trajectory) // SEGMENT


def test_other_python_threads_run_meanwhile():
    """With the GIL held for a segment, this thread would get a turn only between two of them."""
    stop, turns = threading.Event(), []

    def count():
        while not stop.is_set():
            turns.append(time.perf_counter())
            time.sleep(1e-4)

    counter = threading.Thread(target=count)
    counter.start()
    batch = simulate_many([simulation(trajectory=sine(duration=60.0), controller=DEFAULT)], reduce=lambda *_: 1)
    stop.set()
    counter.join()
    assert len(turns) > 10 * batch.ticks.sum() / SEGMENT


def test_progress_counts_simulations():
    seen = []
    simulate_many([simulation()] * 5, progress=lambda *done: seen.append(done))
    assert seen == [(n, 5) for n in range(1, 6)]


def test_memory_does_not_grow_with_simulations():
    """Figures only: as much for 400 simulations as for 4, but for what a job takes."""

    one = simulation()

    def peak(count):
        tracemalloc.start()
        simulate_many([one] * count, reduce=lambda *_: None, threads=2)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(4)
    assert peak(400) - peak(4) < 400 * 4000  # a single channel of 1000 ticks has 8000 bytes


def test_an_empty_batch_is_empty():
    batch = simulate_many([])
    assert batch["true"].shape == (0, 0)
    assert batch.results == []


def test_noise_is_one_stream_however_it_is_taken():
    whole, parts, out = Noise(3).take(40_000), Noise(3), np.empty(20_000)
    first = parts.take(7).copy()
    parts.fill(out)
    np.testing.assert_array_equal(whole, np.concatenate([first, out, parts.take(19_993)]))
