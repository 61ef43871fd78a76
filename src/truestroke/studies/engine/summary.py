"""What the runs of a study have in common."""

from collections.abc import Sequence

import numpy as np


def quantiles(values: Sequence[float | None]) -> tuple[float, float, float]:
    """Median, 95th percentile and largest.

    Examples
    --------
    >>> quantiles([3.0, 1.0, 2.0])
    (2.0, 2.9, 3.0)
    """
    return tuple(float(q) for q in np.quantile(np.array(values, float), [0.5, 0.95, 1.0]))  # type: ignore[return-value]
