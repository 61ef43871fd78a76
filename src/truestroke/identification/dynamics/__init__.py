"""The dynamics of a stage by a small multisine: excitation, frequency response, modes, verdict."""

from truestroke.identification.dynamics.bode import Bode, DynamicsError, SmallMotion, identify_dynamics
from truestroke.identification.dynamics.measure import measure_bode, measure_dynamics

__all__ = ["Bode", "DynamicsError", "SmallMotion", "identify_dynamics", "measure_bode", "measure_dynamics"]
