"""Types that the whole package shares."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""An array of float64; its shape and unit are stated where it is used."""

ComplexArray = npt.NDArray[np.complex128]
"""An array of complex128, as frequency responses are."""
