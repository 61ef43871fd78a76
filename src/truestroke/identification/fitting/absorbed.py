"""A mode of the stage that a model without it has followed: what weights that are fitted anew would leave behind it."""

import math

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting.modes import FIRST_LOWER, ModeSearch
from truestroke.identification.fitting.regression import Data, Structure
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.model.sampled import central_difference

CANDIDATES = 40  # frequencies at which such a mode is looked for
DAMPING = 0.1  # of a candidate


def absorbed(search: ModeSearch, data: Data, structure: Structure, weight: float) -> Dynamics | None:
    """The mode that leaves least if the weights are fitted anew behind it; None where none would lower the residual.

    What a mode makes of the strain is small, and so is the change of the weights: what it makes of that change is
    neglected, so that one decomposition of the columns without a mode is enough for all candidates.

    Parameters
    ----------
    search : ModeSearch
        Behind the model without a mode.
    data : Data
        The samples of the search.
    structure : Structure
        Of that model.
    weight : float
        Of its prior, um^2.
    """
    fitted = data.fitted(structure.rested)
    columns = data.columns(structure, search.strain)[fitted, :-1]
    pull = data.prior(structure).rows(weight)[:, :-1]
    late = central_difference(search.strain, data.sample_rate)[:: data.every][fitted]  # of a dead time, which is free
    A = np.column_stack([np.vstack([columns, pull]), np.append(late, np.zeros(len(pull)))])
    Q = np.linalg.qr(A)[0][: len(columns)]

    def left(rest: FloatArray) -> float:
        rows = rest[:: data.every][fitted]
        return float(np.std(rows - Q @ (Q.T @ rows)))

    still = left(search.z - search.strain)
    each = [(left(search.behind(frequency, DAMPING)), frequency) for frequency in search.frequencies(CANDIDATES)]
    least, frequency = min(each, default=(math.inf, 0.0))
    if least >= FIRST_LOWER * still:
        return None
    return Dynamics(sample_rate=data.sample_rate, modes=(Mode(frequency=frequency, damping=DAMPING),))
