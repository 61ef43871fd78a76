"""Simulated samples: a calibration grating and a random texture, each a function of the place."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray

TILE = 1024  # points of a texture in each direction; it repeats beyond them


class Grating:
    """A calibration grating: square pits in a square lattice, with edges of finite width.

    Parameters
    ----------
    pitch : float
        Distance of the pits, um.
    depth : float
        nm.
    edge : float
        Width of an edge between 10 and 90 % of the depth, um.

    Examples
    --------
    >>> grating = Grating(pitch=3.0, depth=100.0)
    >>> grating(np.array([0.0, 1.5]), np.array([0.0, 0.0])).round(3).tolist()
    [0.0, 100.0]
    """

    name = "grating"
    unit = "nm"

    def __init__(self, pitch: float = 3.0, depth: float = 100.0, edge: float = 0.1) -> None:
        self.pitch = checks.positive("pitch", pitch, "um")
        self.depth = checks.positive("depth", depth, "nm")
        self.edge = checks.within("edge", edge, 1e-6, self.pitch / 4, "um")

    def __call__(self, x: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Height, nm, at places, um: 0 in a pit, `depth` between them."""
        one, other = _places(x, y)
        inside = self._within(one) * self._within(other)
        return np.asarray(self.depth * (1 - inside))

    def _within(self, x: FloatArray) -> FloatArray:
        """1 inside of a pit along one axis, 0 outside: pits are half a pitch wide, with one around 0 um."""
        distance = np.abs(np.mod(x + self.pitch / 2, self.pitch) - self.pitch / 2) - self.pitch / 4
        return np.asarray(0.5 - 0.5 * np.tanh(2.197 * distance / self.edge))  # 10 to 90 % of tanh: 2.197 / 2 each side


class Texture:
    """A random texture: bumps and grains of many sizes, smooth at the scale of a pixel.

    Parameters
    ----------
    seed : int
        The same seed gives the same texture.
    tile : float
        Length after which it repeats, um.
    grain : float
        Size of the finest grains, um.
    height : float
        Standard deviation, nm.

    Examples
    --------
    >>> texture = Texture(seed=1)
    >>> x = np.linspace(0.0, 20.0, 1000)
    >>> float(np.std(texture(x, 0 * x))) > 3.0, bool(np.allclose(texture(x, x), texture(x + 40.0, x)))
    (True, True)
    """

    name = "texture"
    unit = "nm"

    def __init__(self, seed: int = 0, tile: float = 40.0, grain: float = 0.12, height: float = 10.0) -> None:
        self.seed = checks.count("seed", seed, 0, 2**63 - 1)
        self.tile = checks.positive("tile", tile, "um")
        self.grain = checks.within("grain", grain, 2 * self.tile / TILE, self.tile / 4, "um")
        self.height = checks.positive("height", height, "nm")

    @functools.cached_property
    def _table(self) -> FloatArray:
        """Coefficients of the cubic spline of one tile."""
        from scipy import fft, ndimage

        noise = np.random.Generator(np.random.PCG64(self.seed)).normal(size=(TILE, TILE))
        f = np.fft.fftfreq(TILE, self.tile / TILE)
        f2 = f[:, None] ** 2 + f[None, : TILE // 2 + 1] ** 2
        shape = np.exp(-0.5 * f2 * (np.pi * self.grain) ** 2) / (1 + f2 * (12 * self.grain) ** 2) ** 0.6
        shape[0, 0] = 0.0
        field = fft.irfft2(fft.rfft2(noise) * shape, s=(TILE, TILE))
        field = np.tanh(field / np.std(field) * 0.9)  # flat tops, as of grains
        made = ndimage.spline_filter(self.height * field / np.std(field), order=3, mode="grid-wrap")
        return np.asarray(made)

    def __call__(self, x: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Height, nm, at places, um."""
        from scipy import ndimage

        places = np.stack(_places(x, y)[::-1]) * (TILE / self.tile)
        return np.asarray(ndimage.map_coordinates(self._table, places, order=3, mode="grid-wrap", prefilter=False))


def _places(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both as arrays of one shape; SettingError where they have none."""
    try:
        first, second = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    except (TypeError, ValueError):
        found = " and ".join(checks.described(one) for one in (x, y))
        raise SettingError("x and y", found, "as many numbers of x as of y", "um") from None
    return first, second
