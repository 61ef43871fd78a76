"""The terms of the model: plays with their rates, and those that are known before the voltage is chosen."""

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.reference.state import Memory, State
from truestroke.model.models import Motion, creep_step, duhem_change, known_terms, play_terms
from truestroke.model.operators import dead_zone, dot, play

AT_ITS_END = 0.999  # of its threshold: a play that is so far from the voltage moves with it


def through_dead_zones(c: State, z: float) -> float:
    """(11) of a desired, (14) of a measured displacement; the settings hold the dead zones of the inverse."""
    if c.dead_zones.size == 1:  # the usual one, of 0 um: the same bits without arrays
        return float(z * c.dead_zone_weights[0] + 0.0)
    return float(dot(dead_zone(z, c.dead_zones), c.dead_zone_weights))


def of_known_terms(c: State, motion: Motion) -> float:
    """The displacement of the known terms, um."""
    s = c.settings
    return float(dot(c.law.weights[s.of_plays :], known_terms(s, c.now.creep, motion, s.stroke, c.now.duhem)))


def remember_creep(c: State, memory: Memory) -> None:
    """Creep states follow the voltage of the tick before."""
    memory.creep = creep_step(memory.creep, memory.play[0], c.creep_rates)


def slope_of_duhem(c: State, moved: float, up: bool) -> float:
    """By how much the states of Duhem change the displacement per volt, um/V; `up` where the voltage begins to move."""
    before = float(c.now.play[0])
    if moved:
        slopes = duhem_change(c.now.duhem, before, moved, c.duhem_lengths) / moved
    else:
        slopes = (before - c.now.duhem) / (c.duhem_lengths if up else -c.duhem_lengths)
    total = 0.0
    for weight, slope in zip(c.law.weights[c.settings.columns["duhem"]].tolist(), slopes.tolist(), strict=True):
        total += weight * slope
    return total


def behind_amplifier(c: State, memory: Memory, x: float) -> float:
    """The output of the amplifier after a tick with the voltage x, V."""
    kept = c.amplifier
    return float(x + kept * (memory.play[0] - x)) if kept > 0 else x


def before_amplifier(c: State, memory: Memory, x: float) -> float:
    """The voltage for a tick after which the output of the amplifier is x, V."""
    kept = c.amplifier
    return float(x + kept / (1 - kept) * (x - memory.play[0])) if kept > 0 else x


def remember_voltage(c: State, memory: Memory, x: float) -> None:
    """(1): the play states after a tick with the voltage x, V, and those of Duhem."""
    x = behind_amplifier(c, memory, x)
    before = float(memory.play[0])
    memory.duhem = memory.duhem + duhem_change(memory.duhem, before, x - before, c.duhem_lengths)
    memory.play = play(x, c.thresholds, memory.play)
    memory.ticks += 1


def move_voltage(c: State, memory: Memory, to: float) -> None:
    """The plays as if the voltage had been `to`, V, where it had to come to.

    Those that move go with it, the others stay where they can.
    """
    before, r = float(memory.play[0]), c.thresholds
    moves = ~(np.abs(memory.play - before) < AT_ITS_END * r)
    memory.play = np.clip(memory.play + np.where(moves, to - before, 0.0), to - r, to + r)


def regressor(c: State, memory: Memory, motion: Motion) -> FloatArray:
    """(20): u = [H_0, c_b zdot_d H_0, H_1, ...], with c_a = 1; and the known terms."""
    s = c.settings
    plays = play_terms(s, memory.play, s.rate_scale * motion.zdot_d)
    return np.concatenate([plays, known_terms(s, memory.creep, motion, s.stroke, memory.duhem)])
