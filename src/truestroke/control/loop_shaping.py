"""Filters with given poles that reduce loads most within margins: a log barrier, followed by Newton's method.

K(q) = sum_j x_j phi_j(q), each phi_j with poles that are given. Where L = K P, P of each plant, the sensitivity is
S = 1 / (1 + L), and x minimises

    J(x) = mean over the plants |load S|^2 + |noise L S|^2 + |noise K S|^2 + |Re(left S)|^2

so that |1 + g L| > 1 / peak for every plant, frequency and gain g of an interval, and |K| stays below a bound where the
plant is not known. That set is not convex, but K = 0 is in it, and a path on which 1 + g L is never 0 does not change
the number of its turns about 0: what begins stable stays so (Nyquist). The path is that of the minima of
J - mu mean log(|1 + g L|^2 - 1 / peak^2) - mu mean log(loudest^2 - |K|^2), mu falling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import ComplexArray, FloatArray

FALL = 0.03  # of mu, from one minimum to the next
LAST = 3e-3  # of J: the mu at which to stop
STEPS = 25  # of Newton's method, at most, for each mu
NEAR = 0.03  # of mu: the expected gain below which a minimum is near enough
ARMIJO = 0.1  # of the expected gain: what a step has to gain
SHORTEST = 1e-4  # of a step of Newton
PIECE = 256  # rows whose products are summed at a time


@dataclass(frozen=True, eq=False)
class Problem:
    """What is asked of the filters, on a grid of frequencies that is each plant's own.

    Attributes
    ----------
    plants : ndarray of complex, shape (plants, frequencies)
        P: from the filters' output to their input, without its sign.
    filters : ndarray of complex, shape (plants, frequencies, numbers)
        phi_j.
    load : ndarray, shape (plants, frequencies)
        Root of the power of the load at each frequency of each plant, um.
    noise : ndarray, shape (frequencies,)
        Root of that of the noise, um.
    nominal : int
        Which of the plants hears the noise.
    gains : tuple of (float, float)
        Least and largest g.
    peak : float
        Of |S|, at most; above 1.
    unknown : ndarray of complex, shape (frequencies, numbers)
        phi_j where |K| is bounded.
    loudest : ndarray, shape (frequencies,)
        Of |K| there, at most.
    left : ndarray of complex, shape (times, frequencies)
        From S of the nominal plant to what remains of a step of load at these times, by its real part.
    """

    plants: ComplexArray
    filters: ComplexArray
    load: FloatArray
    noise: FloatArray
    nominal: int
    gains: tuple[float, float]
    peak: float
    unknown: ComplexArray
    loudest: FloatArray
    left: ComplexArray


@dataclass(frozen=True, eq=False)
class _Point:
    """The loop with some x."""

    x: FloatArray
    L: ComplexArray
    nearest: ComplexArray  # 1 + g L for the g with which it is nearest to 0
    gain: FloatArray  # that g
    spare: FloatArray  # |1 + g L|^2 - 1 / peak^2
    K: ComplexArray  # where it is bounded
    loud_spare: FloatArray  # loudest^2 - |K|^2
    cost: float

    @property
    def barrier(self) -> float:
        """Large near the bounds; what is far from them does not count."""
        far = np.maximum(np.abs(self.nearest) ** 2, 1.0)
        return float(-np.mean(np.log(self.spare / far)) - np.mean(np.log(self.loud_spare)))


def shape(problem: Problem) -> FloatArray:
    """x, shape (numbers,), at which J is least within the bounds, near enough; 0 where nothing helps.

    Examples
    --------
    An integrator that leaks, w q / (1 - 0.99 q), without noise: |S| is 1.99 / (1.99 - w) at half of the sample rate, so
    that |S| < 2 needs w < 0.995:

    >>> f = np.linspace(1e-3, 0.5, 800)
    >>> q, none = np.exp(-2j * np.pi * f), np.zeros(f.size)
    >>> K = (1 / (1 - 0.99 * q))[np.newaxis, :, np.newaxis]
    >>> bounds = (1.0, 1.0), 2.0, K[0, -1:], np.array([9.0])
    >>> found = shape(Problem(q[np.newaxis], K, (0.1 / f)[np.newaxis], none, 0, *bounds, none[np.newaxis]))
    >>> bool(0.9 < found[0] < 0.995)
    True
    """
    m = problem.filters.shape[-1]
    loops = problem.plants[..., np.newaxis] * problem.filters
    point = _at(problem, loops, np.zeros(m))
    mu = point.cost
    while mu > LAST * point.cost:
        for _ in range(STEPS):
            moved = _step(problem, loops, point, mu)
            if moved is None:
                break
            point, near = moved
            if near:
                break
        mu *= FALL
    return point.x


def _at(p: Problem, loops: ComplexArray, x: FloatArray) -> _Point:
    L = np.einsum("pfi,i->pf", loops, x)  # here and below: few columns, faster without the threads of a BLAS
    gain = np.clip(-L.real / np.maximum(np.abs(L) ** 2, 1e-30), *p.gains)
    nearest = 1 + gain * L
    loud = np.einsum("fi,i->f", p.unknown, x)
    S = 1 / (1 + L)
    n = p.nominal
    K = np.einsum("fi,i->f", p.filters[n], x)
    heard = np.abs(p.noise * S[n]) ** 2 * (np.abs(L[n]) ** 2 + np.abs(K) ** 2)
    left = np.einsum("tf,f->t", p.left, S[n]).real
    cost = float(np.sum(np.abs(p.load * S) ** 2) / len(L) + np.sum(heard) + np.sum(left**2))
    spare = np.abs(nearest) ** 2 - p.peak**-2
    return _Point(x, L, nearest, gain, spare, loud, p.loudest**2 - np.abs(loud) ** 2, cost)


def _residual(p: Problem, loops: ComplexArray, point: _Point) -> tuple[ComplexArray, ComplexArray]:
    """r(x) with J = |r|^2, and its derivatives, shape (residuals, numbers)."""
    n, S = p.nominal, 1 / (1 + point.L)
    K = np.einsum("fi,i->f", p.filters[n], point.x)
    load, noise, squared = p.load / np.sqrt(len(S)), p.noise, S * S
    parts = load * S, noise * point.L[n] * S[n], noise * K * S[n], np.einsum("tf,f->t", p.left, S[n]).real
    of_load = -(load * squared)[..., np.newaxis] * loops
    of_noise = (noise * squared[n])[:, np.newaxis] * loops[n]
    of_command = (noise * S[n])[:, np.newaxis] * (p.filters[n] - (K * S[n])[:, np.newaxis] * loops[n])
    of_left = -np.einsum("tf,fi->ti", p.left, squared[n][:, np.newaxis] * loops[n]).real
    derivatives = np.concatenate([of_load.reshape(-1, point.x.size), of_noise, of_command, of_left])
    return np.concatenate([part.ravel() for part in parts]), derivatives


def _slope(p: Problem, loops: ComplexArray, point: _Point, mu: float) -> tuple[FloatArray, FloatArray]:
    """Gradient of J + mu barrier, and the part of its second derivatives that is never negative."""
    r, dr = _residual(p, loops, point)
    gradient, curvature = 2 * np.einsum("k,ki->i", r.conj(), dr).real, 2 * (_gram(dr.real) + _gram(dr.imag))
    distance = np.abs(point.nearest) ** 2
    weight = mu / distance.size
    moved = 2 * ((point.nearest.conj() * point.gain)[..., np.newaxis] * loops).real.reshape(-1, point.x.size)
    towards = np.where(distance > 1, 1 / np.maximum(distance, 1), 0.0) - 1 / point.spare
    gradient = gradient + weight * np.einsum("k,ki->i", towards.ravel(), moved)
    steep = moved / point.spare.reshape(-1, 1)
    curvature = curvature + weight * _gram(steep)
    louder = 2 * (point.K.conj()[:, np.newaxis] * p.unknown).real / point.loud_spare[:, np.newaxis]
    rows = p.unknown * np.sqrt(2 / point.loud_spare)[:, np.newaxis]
    gradient = gradient + mu * louder.mean(axis=0)
    curvature = curvature + mu / len(louder) * (_gram(louder) + _gram(rows.real) + _gram(rows.imag))
    return gradient, curvature


def _gram(columns: FloatArray) -> FloatArray:
    """Sums of the products of each two columns: in pieces so small that a BLAS takes no threads for them."""
    rows = np.ascontiguousarray(columns)
    whole = len(rows) - len(rows) % PIECE
    parts, rest = rows[:whole].reshape(-1, PIECE, rows.shape[1]), rows[whole:]
    return np.asarray(np.matmul(parts.transpose(0, 2, 1), parts).sum(axis=0) + rest.T @ rest)


def _step(p: Problem, loops: ComplexArray, point: _Point, mu: float) -> tuple[_Point, bool] | None:
    """One step of Newton's method, as long as J + mu barrier falls; and whether the minimum is near. None: no step."""
    gradient, curvature = _slope(p, loops, point, mu)
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    scaled = curvature / np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
    step = -np.linalg.solve(scaled, gradient / scale) / scale
    expected, before, length = float(gradient @ step), point.cost + mu * point.barrier, 1.0
    while length > SHORTEST:
        after = _at(p, loops, point.x + length * step)
        inside = after.spare.min() > 0 and after.loud_spare.min() > 0 and stable(after.L).all()
        if inside and after.cost + mu * after.barrier < before + ARMIJO * length * expected:
            return after, -expected < NEAR * mu
        length /= 2
    return None


def stable(L: ComplexArray) -> npt.NDArray[np.bool_]:
    """Whether 1 + L does not turn around 0 between 0 Hz and half of the sample rate, along the last axis (Nyquist).

    >>> q = np.exp(-2j * np.pi * np.linspace(0.0, 0.5, 500))
    >>> stable(np.array([0.5 * q, 3.0 * q**3]))
    array([ True, False])
    """
    distance = 1 + L
    turned = np.angle(distance[..., 1:] / distance[..., :-1]).sum(axis=-1) + np.angle(distance[..., 0])
    return np.asarray(np.abs(turned) < 1.0)
