"""Thousands of controllers, each against its own simulated actuator, in threads without the GIL: the bits of `run`."""

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, system
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.control import feasibility
from truestroke.control.controller import AdaptiveController
from truestroke.control.settings import ControllerSettings
from truestroke.plant import MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant, StagePlant, StageSettings
from truestroke.runtime.agreement import wanted
from truestroke.runtime.native import Pair
from truestroke.runtime.ticks import MARK, SIMULATED
from truestroke.signals.channels import dtype
from truestroke.signals.trajectories import Trajectory

__all__ = ["Batch", "Simulation", "SimulationError", "simulate_many"]

Array = npt.NDArray[Any]
Reduce = Callable[[int, Mapping[str, Array]], Any]

SEGMENT = 16384  # noise numbers between two checks whether to stop, some milliseconds; they fit the cache


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulation:
    """One run of a batch.

    Attributes
    ----------
    trajectory : Trajectory, or function without arguments that returns one
        Desired motion. A function is called in the thread that runs the simulation, so that thousands of trajectories
        need not be in memory at a time.
    controller : ControllerSettings
        Of an `AdaptiveController`.
    plant : MatchedSettings, PlantSettings or StageSettings
        Of a `MatchedPlant`, which gets the velocity of the trajectory, a `RealisticPlant` or a `StagePlant`.
    seed : int
        Of the plant.
    dropouts : tuple of (int, int)
        Bursts without a measurement, not of a `MatchedPlant`: first tick of each, and the first after it.

    Raises
    ------
    SettingError
        A member is not of its kind.
    """

    trajectory: Trajectory | Callable[[], Trajectory]
    controller: ControllerSettings
    plant: MatchedSettings | PlantSettings | StageSettings
    seed: int = 0
    dropouts: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.trajectory, Trajectory):
            checks.able("trajectory", self.trajectory, ("__call__",), "a Trajectory, or a function that returns one")
        checks.instance("controller", self.controller, ControllerSettings, "a ControllerSettings")
        kinds = (MatchedSettings, PlantSettings, StageSettings)
        checks.instance("plant", self.plant, kinds, "a MatchedSettings, PlantSettings or StageSettings")


class SimulationError(TruestrokeError, RuntimeError):
    """A simulation of a batch failed; ``__cause__`` is the reason.

    Attributes
    ----------
    index : int
        Its place in the batch, from 0.
    """

    def __init__(self, index: int, cause: Exception) -> None:
        self.index = index
        super().__init__(f"simulation {index}: {type(cause).__name__}: {cause}")


@dataclass(frozen=True, eq=False)
class Batch:
    """What `simulate_many` gives; ``batch["true"]`` is ``batch.channels["true"]``.

    Attributes
    ----------
    ticks : ndarray, shape (runs,)
        Length of each simulation.
    channels : dict of str to ndarray, shape (runs, ticks)
        Those that were asked for: volts [V], measured, true, innovation [um], flags (uint8). What is after the end of
        a simulation that is shorter than others is NaN, and 0 in flags.
    results : list
        What `reduce` returned, simulation by simulation; without it None.
    """

    ticks: npt.NDArray[np.int64]
    channels: dict[str, Array]
    results: list[Any]

    def __getitem__(self, name: str) -> Array:
        return self.channels[name]


def simulate_many(
    simulations: Iterable[Simulation],
    *,
    record: Sequence[str] | None = None,
    reduce: Reduce | None = None,
    out: Mapping[str, Array] | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Batch:
    """Run simulations in threads; each gives the same bits as `run`, for any number of threads.

    Parameters
    ----------
    simulations : iterable of Simulation
        In any mixture of plants, settings, seeds, lengths and sample rates.
    record : sequence of str, optional
        Channels to keep, of `ticks.SIMULATED`; by default measured and true, and none where there is `reduce`.
    reduce : callable, optional
        Called as reduce(index, channels) in the thread that ran the simulation, to keep metrics in place of arrays:
        memory then does not grow with the number of ticks. channels maps the names of a recording (time, desired,
        desired_velocity, flat where the motion marks it, and `SIMULATED`) to arrays of shape (ticks,), which are used
        again when it has returned.
    out : mapping of str to ndarray, optional
        Arrays to fill in place of new ones, for any of the recorded channels: shape (runs, longest), C-contiguous,
        float64, flags uint8.
    threads : int, optional
        1 to 1024; by default one for each core that the process may use.
    progress : callable, optional
        Called as progress(simulations done, all simulations) in the calling thread.

    Raises
    ------
    SettingError
        An argument is out of its bounds; nothing has run.
    SimulationError
        A simulation, or `reduce`, failed; the others were stopped.

    Examples
    --------
    >>> from truestroke.signals import metrics, trajectories
    >>> wave = trajectories.random_wave(duration=2.0, velocity_limit=300.0)
    >>> paper = ControllerSettings.paper(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> plants = [Simulation(trajectory=wave, controller=paper, plant=MatchedSettings(), seed=n) for n in range(4)]
    >>> simulate_many(plants)["true"].shape
    (4, 4000)
    >>> batch = simulate_many(plants, reduce=lambda index, run: metrics.rmse(run["desired"], run["true"]))
    >>> [round(rmse, 3) for rmse in batch.results]
    [0.01, 0.01, 0.01, 0.01]
    """
    queue = list(checks.several("simulations", simulations, of="Simulation"))
    for index, simulation in enumerate(queue):
        made = "a Simulation(trajectory=, controller=, plant=)"
        checks.instance(f"simulations[{index}]", simulation, Simulation, made)
    if reduce is not None:
        checks.able("reduce", reduce, ("__call__",), "a function of index and channels")
    count = len(system.processors()) if threads is None else checks.count("threads", threads, 1, 1024)
    names = record if record is not None else () if reduce else ("measured", "true")
    batch = Batch(np.zeros(len(queue), np.int64), _arrays(queue, names, out or {}), [None] * len(queue))
    buffers, stop = _Buffers(), threading.Event()
    with ThreadPoolExecutor(count, "simulation") as pool:
        jobs = [pool.submit(_run, index, queue[index], batch, reduce, buffers, stop) for index in range(len(queue))]
        try:
            for done, job in enumerate(as_completed(jobs), 1):
                job.result()
                if progress:
                    progress(done, len(jobs))
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return batch


def _arrays(queue: Sequence[Simulation], names: Sequence[str], out: Mapping[str, Array]) -> dict[str, Array]:
    """The arrays to fill, one row a simulation."""
    if other := sorted(set(out) - set(names)):
        raise SettingError("out", other, "of the recorded channels")
    if not names:
        return {}
    lengths = [len(s.trajectory) for s in queue if isinstance(s.trajectory, Trajectory)]
    if len(lengths) < len(queue):
        raise SettingError("record", names, "empty where a trajectory is a function: its length is not known")
    shape = (len(queue), max(lengths, default=0))
    arrays = {}
    for name in names:
        if name not in SIMULATED:
            raise SettingError("record", repr(name), f"of {', '.join(SIMULATED)}")
        array = arrays[name] = out[name] if name in out else np.empty(shape, dtype(name))
        if array.shape != shape or array.dtype != dtype(name) or not array.flags.c_contiguous:
            found = f"{array.dtype} array of shape {array.shape}"
            raise SettingError(
                f"out[{name!r}]", found, f"a C-contiguous {np.dtype(dtype(name))} array of shape {shape}"
            )
    return arrays


class _Buffers(threading.local):
    """Arrays of one thread, which grow to its longest run and are used again."""

    def __init__(self) -> None:
        self.arrays: dict[str, Array] = {}

    def take(self, name: str, size: int) -> Array:
        """Shape (size,), with anything in it."""
        if name not in self.arrays or self.arrays[name].size < size:
            self.arrays[name] = np.empty(size, dtype(name))
        return self.arrays[name][:size]


@lru_cache(maxsize=16)
def _time(ticks: int, sample_rate: float) -> Array:
    """As `Trajectory.time`, once for all of the same length: a new array takes longer to get than to fill."""
    time = np.arange(ticks) / sample_rate
    time.flags.writeable = False
    return time


def _run(
    index: int, simulation: Simulation, batch: Batch, reduce: Reduce | None, buffers: _Buffers, stop: threading.Event
) -> None:
    """One simulation into its row of the batch."""
    try:
        wave = simulation.trajectory if isinstance(simulation.trajectory, Trajectory) else simulation.trajectory()
        batch.ticks[index] = ticks = len(wave)
        for name, array in batch.channels.items():
            array[index, ticks:] = 0 if name == "flags" else np.nan
        rows = {name: array[index, :ticks] for name, array in batch.channels.items()}
        rows |= {name: buffers.take(name, ticks) for name in SIMULATED if name not in rows}
        _simulate(simulation, wave, rows, buffers, stop)
        if reduce and not stop.is_set():
            motion: dict[str, Array] = {"desired": wave.position, "desired_velocity": wave.velocity}
            motion |= {} if wave.flat is None else {MARK: wave.flat}
            batch.results[index] = reduce(index, {"time": _time(ticks, wave.sample_rate), **motion, **rows})
    except Exception as error:
        raise SimulationError(index, error) from error


def _simulate(
    simulation: Simulation, wave: Trajectory, rows: Mapping[str, Array], buffers: _Buffers, stop: threading.Event
) -> None:
    """Command, exchange, adapt: a segment at a time without the GIL."""
    for whose, settings in (("controller", simulation.controller), ("plant", simulation.plant)):
        if settings.sample_rate != wave.sample_rate:
            bound = f"{settings.sample_rate} Hz, that of the {whose}"
            raise SettingError("trajectory.sample_rate", wave.sample_rate, bound, "Hz")
    plant = _plant(simulation, wave)
    controller = AdaptiveController.from_settings(simulation.controller)
    feasibility.raise_slew(wave, controller)
    pair = Pair(controller, plant, wanted(wave, controller))
    segment = max(SEGMENT // pair.samples, 1)
    noise = buffers.take("noise", segment * pair.samples)
    for start in range(0, len(wave), segment):
        if stop.is_set():
            return
        pair.run(slice(start, min(start + segment, len(wave))), rows, noise)


def _plant(simulation: Simulation, wave: Trajectory) -> MatchedPlant | RealisticPlant | StagePlant:
    if isinstance(simulation.plant, MatchedSettings):
        if simulation.dropouts:
            raise SettingError("dropouts", simulation.dropouts, "empty for a matched plant")
        return MatchedPlant(wave.velocity, simulation.plant, simulation.seed)
    if isinstance(simulation.plant, StageSettings):
        return StagePlant(simulation.plant, simulation.seed, simulation.dropouts)
    return RealisticPlant(simulation.plant, simulation.seed, simulation.dropouts)
