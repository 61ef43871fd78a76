"""The dynamics of a stage by a small multisine: excitation, frequency response, modes, verdict."""

from truestroke.identification.dynamics.bode import (
    Bode,
    DynamicsError,
    NoResonanceError,
    SmallMotion,
    identify_dynamics,
    spring_to,
)
from truestroke.identification.dynamics.measure import measure_bode, measure_dynamics

__all__ = [
    "Bode",
    "DynamicsError",
    "NoResonanceError",
    "SmallMotion",
    "identify_dynamics",
    "measure_bode",
    "measure_dynamics",
    "spring_to",
]
