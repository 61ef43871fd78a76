"""What a recorded run has learned, as the start of a controller on another machine."""

from __future__ import annotations

import dataclasses

import numpy as np

from truestroke.base import toml
from truestroke.base.checks import SettingError
from truestroke.control.settings import ControllerSettings
from truestroke.signals import judgement
from truestroke.signals.recording import Recording


def learned(recording: Recording, name: str) -> ControllerSettings:
    """The settings of the controller of a recording, with its last weights in place of those of its start.

    How certain the weights are is learned again: the prior's covariance stays.

    Parameters
    ----------
    recording : Recording
        Of one axis.
    name : str
        What messages call it.

    Raises
    ------
    SettingError
        It is not one of the kernel's controllers, or the verdict on it is bad.
    """
    given = judgement.settings(recording, "controller")
    weights = np.asarray(recording.get("weights", []), dtype=float)
    if "initial_weights" not in given or not weights.size or weights.shape[-1] != len(given["initial_weights"]):
        raise SettingError("state", name, "the recording of a controller that `export` can write, with its weights")
    verdict = judgement.judge(recording)
    if verdict.is_bad or not np.all(np.isfinite(weights[-1])):
        because = verdict.reasons[0] if verdict.reasons else "Its last weights are not finite."
        raise SettingError("state", name, f"a good run: its weights are not to be used. {because}")
    settings = ControllerSettings(**toml.arguments(ControllerSettings, given))
    return dataclasses.replace(settings, initial_weights=tuple(weights[-1].tolist()))
