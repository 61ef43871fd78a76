import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray

def run(
    controller: object,
    actuator: object,
    z_d: FloatArray,
    zdot_d: FloatArray,
    zddot_d: FloatArray | None,
    strain_d: FloatArray | None,
    noise: FloatArray,
    volts: FloatArray,
    measured: FloatArray,
    truth: FloatArray,
    innovation: FloatArray,
    flags: npt.NDArray[np.uint8],
) -> None: ...
def run_axes(
    controllers: list[object],
    actuator: object,
    motion: FloatArray,
    strain_d: FloatArray,
    others: FloatArray,
    to_axes: FloatArray,
    noise: FloatArray,
    volts: FloatArray,
    measured: FloatArray,
    truth: FloatArray,
    innovation: FloatArray,
    flags: npt.NDArray[np.uint8],
) -> None: ...
def first_order(real: float, imaginary: float, u: FloatArray, x: FloatArray) -> None: ...
