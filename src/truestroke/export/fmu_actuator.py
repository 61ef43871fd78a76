"""The constants of an FMU of an identified model: sizes and members of c/fmi/unit_actuator.h at one sample rate."""

from __future__ import annotations

from typing import Any

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import stage
from truestroke.control.actuator import ActuatorModel
from truestroke.model import sampled
from truestroke.model.branches import CURVES

HUGE = float(np.finfo(np.float64).max)  # V: of cells without an end
LONGEST = 100_000  # ticks of dead time that an FMU keeps


def constants(model: ActuatorModel, sample_rate: float) -> tuple[dict[str, int], dict[str, Any], int]:
    """Sizes, members, and the ticks by which the displacement is later than `ActuatorModel.predict` has it.

    The velocity looks ahead by some ticks; dead time of the model makes up for it as far as there is any.

    Raises
    ------
    SettingError
        The dead time is too long.
    """
    look = sampled.velocity_span(sample_rate)
    staged = _staged(model, sample_rate)
    dead = staged.pop("dead", 0)
    delay, lag = model.delay * sample_rate, model.time_constant * sample_rate
    if dead + delay > LONGEST:
        bound = f"{LONGEST / sample_rate:g} s or less, {LONGEST} ticks, which an FMU keeps: take a lower sample rate"
        raise SettingError("model.delay", model.delay, bound, "s")
    whole = int(delay)
    from_dead = min(dead, look)
    from_whole = min(whole, look - from_dead)
    last, before, kept = sampled.lag_coefficients(lag)
    faster = sampled.lag_coefficients(model.proven_lag * sample_rate)
    members = {
        **_terms(model, sample_rate),
        **_branches(model),
        **staged,
        "delayed": bool(delay or lag),
        "last": last,
        "before": before,
        "kept": kept,
        "part": delay - whole,
        "proven": model.proven_lag,
        "faster": faster,
    }
    sizes = _sizes(model) | {
        "LOOK": look,
        "DEAD": dead - from_dead,
        "SECTIONS": len(staged.get("section", ())),
        "WHOLE": whole - from_whole,
    }
    return sizes, members, look - from_dead - from_whole


def _sizes(model: ActuatorModel) -> dict[str, int]:
    b = model.branches
    return {
        "PLAYS": len(model.thresholds),
        "OF_PLAYS": model.of_plays,
        "TERMS": model.parameters - model.of_plays,
        "CREEPS": len(model.creep_times),
        "ASYMMETRIES": model.asymmetry,
        "CURVES": 0 if b is None else len(b.curves),
        "CURVED": 0 if b is None else b.plays,
        "LEVELS": 0 if b is None else b.levels,
        "CELLS": 0 if b is None else len(b.cells[0]),
        "DUHEM": 0 if b is None else len(b.betas),
        "BRANCHES": 0 if b is None else len(b.weights),
    }


def _terms(model: ActuatorModel, sample_rate: float) -> dict[str, Any]:
    """The terms of `Layout`; places of the known ones are behind the weights of the plays."""
    place = {name: at.start - model.of_plays if at.start < at.stop else -1 for name, at in model.columns.items()}
    b = np.full(len(model.thresholds), -1)
    b[model.rate_plays] = model.b
    return {
        "sample_rate": sample_rate,
        "rate_scale": model.rate_scale,
        "velocity": model.velocity,
        "fastest": model.fastest,
        "stroke": model.stroke,
        "zero": model.zero,
        "volts_low": model.voltage_range[0],
        "volts_high": model.voltage_range[1],
        "r": model.thresholds,
        "a": model.a.tolist(),
        "b": b.tolist(),
        "lag": place["lag"],
        "offset": place["offset"],
        "asymmetry": max(place["asymmetry"], 0),
        "creep": sampled.creep_shares(model.creep_times, sample_rate),
    }


def _branches(model: ActuatorModel) -> dict[str, Any]:
    b = model.branches
    if b is None:
        return {}
    return {
        "low": b.voltage_range[0],
        "half": b.half,
        "curve": [[*CURVES].index(curve) for curve in b.curves],
        "curve_at_zero": [b.at_zero[curve] for curve in b.curves],
        "curve_r": b.thresholds.tolist(),
        "cell_r": b.cell_thresholds.tolist(),
        "cell_low": np.maximum(b.cells[1], -HUGE).tolist(),
        "cell_high": np.minimum(b.cells[2], HUGE).tolist(),
        "cell_at_zero": np.clip(0.0, *b.cells[1:]).tolist(),
        "beta": [beta / 2 for beta in b.betas],
        "branch": b.weights,
    }


def _staged(model: ActuatorModel, sample_rate: float) -> dict[str, Any]:
    """Of the dynamics; empty without any, or where the sample rate does not see the resonances."""
    known = model.stage(sample_rate)
    if known is None:
        return {}
    direct, section, dead = stage.difference_equation(known)
    return {"staged": True, "direct": _list(direct), "section": _list(section), "dead": dead}


def _list(array: FloatArray) -> list[Any]:
    return list(array.tolist())
