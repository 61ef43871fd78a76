"""After a run: what its recording says of trajectory, controller and actuator, also where it ended before its time."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

from truestroke.base.errors import TruestrokeError
from truestroke.control.repeating.learned_strain import LearnedStrain
from truestroke.control.repeating.repetitive import RepetitiveController
from truestroke.runtime.agreement import Motion
from truestroke.signals.recording import Recording, versions
from truestroke.signals.timing import Timing


class RunInterrupted(TruestrokeError, RuntimeError):  # noqa: N818 (it is no error that Ctrl-C ends a run)
    """A run ended before its time; its cause is ``__cause__``.

    Attributes
    ----------
    recording : Recording
        The ticks that were completed.
    """

    def __init__(self, recording: Recording, cause: BaseException) -> None:
        self.recording = recording
        super().__init__(f"the run ended after {recording['time'].size} ticks: {type(cause).__name__} {cause}".rstrip())


def about(trajectory: Motion, controller: Any, actuator: Any, timing: Timing) -> dict[str, Any]:
    """Metadata of a recording: what is run; SettingError where it cannot be written, before anything moves."""
    metadata = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "interrupted": None,
        "trajectory": {
            "name": trajectory.name,
            "sample_rate": trajectory.sample_rate,
            "ticks": len(trajectory),
            "settings": trajectory.settings,
        },
        "controller": {
            "name": type(controller).__name__,
            "settings": getattr(controller, "settings", {}),
            "parameters": getattr(getattr(controller, "settings", None), "names", ()),
            "ticks_before": ticks_before(controller),
        },
        "plant": {
            "name": type(actuator).__name__,
            "settings": actuator.describe() if hasattr(actuator, "describe") else {},
        },
        "timing": timing,
        "versions": versions(),
    }
    return Recording({}, metadata).metadata


def ticks_before(controller: Any) -> int:
    """Ticks of earlier runs, from which the controller goes on; 0 of one that does not count."""
    return int(getattr(getattr(controller, "counters", None), "commands", 0))


def resonance(controller: Any) -> float | None:
    """First resonance of the stage, Hz, of the controller's settings or found by it; None if it has none."""
    known = getattr(controller, "resonance", None)
    return known if isinstance(known, float) and math.isfinite(known) else None


def found(controller: Any, learner: Any = None, sample_rate: float = math.nan) -> dict[str, object]:
    """What a controller found in a run, for its recording.

    `resonance`, Hz; `load` and `beyond_resonance`, tones that it heard; `repetition` of a `learner`, or of itself.
    """
    return {
        "resonance": resonance(controller),
        "load": heard(controller, "load"),
        "beyond_resonance": heard(controller, "beyond_resonance"),
        "repetition": repetition(learner or controller, sample_rate),
    }


def heard(controller: Any, what: str) -> dict[str, float] | None:
    """A tone that the controller heard: `frequency_hz`, `amplitude_um`; None if there was none."""
    frequency, amplitude = getattr(controller, what, (math.nan, math.nan))
    return {"frequency_hz": frequency, "amplitude_um": amplitude} if amplitude > 0 else None


def repetition(learner: Any, sample_rate: float = math.nan) -> dict[str, object] | None:
    """What was learned of a motion that repeats: its period, s, and the rms of the mean error of each batch, um.

    Of a `RepetitiveController`, or a `LearnedStrain` with its ticks per second, Hz; None of anything else.
    """
    if isinstance(learner, RepetitiveController):
        return {"period_s": learner.period, "rmse_um": [batch.rmse for batch in learner.batches]}
    if isinstance(learner, LearnedStrain):
        return {"period_s": learner.period / sample_rate, "rmse_um": list(learner.errors)}
    return None
