"""The simulated stack that commands drive, and what the same motion would be without compensation."""

from typing import Literal

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.control.actuator import ActuatorModel
from truestroke.control.baselines import ConstantGain
from truestroke.model.dynamics import Dynamics
from truestroke.plant import (
    Change,
    MatchedPlant,
    MatchedSettings,
    PlantSettings,
    RealisticPlant,
    StagePlant,
    StageSettings,
)
from truestroke.signals.recording import Channel, Recording
from truestroke.signals.trajectories import Trajectory

STROKE = 30.0  # um, of the simulated stack
VOLTAGE_LIMITS = (-0.6, 3.6)  # V at the D/A converter
SENSITIVITY = 13.0  # um/V, about that of the simulated stacks
ALIKE = 2.5  # times more or less
RESONANCE, STAGE_RATE = StageSettings().resonances[0], StageSettings().sample_rate  # Hz, of the simulated stage
NEAR = 1.2  # times its resonance, or less
BLOCK = 10_000  # ticks: Ctrl-C is heard between two of them

Plant = RealisticPlant | MatchedPlant | StagePlant


def like_the_stack(model: ActuatorModel) -> bool:
    """Whether it may be a model of the simulated stack."""
    return SENSITIVITY / ALIKE < model.sensitivity < SENSITIVITY * ALIKE


def like_the_stage(dynamics: Dynamics) -> bool:
    """Whether they may be those of the simulated stage."""
    return RESONANCE / NEAR < dynamics.modes[0].frequency < RESONANCE * NEAR


def plant(
    kind: Literal["realistic", "matched", "stage"], trajectory: Trajectory, seed: int, change_at: float | None = None
) -> Plant:
    """A plant at the sample rate of a motion; it changes suddenly at `change_at`, s (Sec. 4.2).

    Raises
    ------
    SettingError
        `change_at` is not within the motion, or of a stage, which does not change.
    """
    rate = trajectory.sample_rate
    if kind == "stage":
        if change_at is not None:
            raise SettingError(
                "change_at", change_at, "left out: the stage does not change; --plant realistic does", "s"
            )
        return StagePlant(StageSettings(sample_rate=rate), seed=seed)
    if change_at is not None and not 0 < change_at < trajectory.duration:
        raise SettingError("change_at", change_at, f"between 0 and the end of the run, {trajectory.duration:g} s", "s")
    if kind == "matched":
        matched = MatchedSettings(
            sample_rate=rate,
            change=None if change_at is None else Change(time=change_at),
            weight_spread=0.0 if change_at is None else 0.3,
        )
        return MatchedPlant(velocity=trajectory.velocity, settings=matched, seed=seed)
    change = None if change_at is None else Change(time=change_at, gain=0.8, hysteresis=1.3)
    return RealisticPlant(PlantSettings(sample_rate=rate, change=change), seed=seed)


def with_uncompensated(recording: Recording, trajectory: Trajectory, plant: Plant) -> Recording:
    """The recording with what the same motion would be with the straight line that fits the actuator best."""
    if not np.ptp(recording["volts"]):
        return recording  # at rest there is nothing to compare
    (offset, gain) = np.polynomial.Polynomial.fit(recording["volts"], recording["true"], 1).convert().coef
    line = ConstantGain(float(gain), VOLTAGE_LIMITS, offset=float(offset))
    volts = np.array([line.command(z, 0.0) for z in trajectory.position.tolist()])
    plant.open()
    before = np.empty(volts.size)  # what `run` gives, but nothing waits for a measurement: a block at a time
    for start in range(0, volts.size, BLOCK):
        block = slice(start, start + BLOCK)
        plant.exchange(volts[block])
        before[block] = plant.truth
    kept = Channel(before, "um", f"true displacement if z = {offset:.3g} um + {gain:.4g} um/V x were all")
    return Recording(recording.channels | {"uncompensated": kept}, recording.metadata)
