"""The same recursive least squares, 16 parameters, as others offer it."""

from __future__ import annotations

import importlib.metadata
import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from truestroke.base.typing import FloatArray

PARAMETERS, FORGETTING, REGULARIZATION = 16, 0.9999, 1e-3
DLIB_HEADER = Path("/usr/include/dlib/filtering/rls_filter.h")


class Rival(Protocol):
    """A law: the weights, and a step with a regressor and what it should give."""

    @property
    def weights(self) -> FloatArray:
        """Shape (m,)."""

    def step(self, u: FloatArray, y: float) -> None:
        """Learn from one sample."""


class Numpy:
    """(23) as printed, in NumPy."""

    def __init__(self) -> None:
        self.weights = np.zeros(PARAMETERS)
        self.P = np.eye(PARAMETERS) / REGULARIZATION

    def step(self, u: FloatArray, y: float) -> None:
        """Learn from one sample."""
        pi = self.P @ u
        mu = pi / (FORGETTING + u @ pi)
        self.weights = self.weights + mu * (y - self.weights @ u)
        self.P = (self.P - mu[:, None] * pi) / FORGETTING


class Padasip:
    """`FilterRLS.adapt` of padasip."""

    def __init__(self) -> None:
        from padasip.filters import FilterRLS

        self.law = FilterRLS(n=PARAMETERS, mu=FORGETTING, eps=REGULARIZATION, w="zeros")

    @property
    def weights(self) -> FloatArray:
        """Shape (m,)."""
        return np.asarray(self.law.w, float)

    def step(self, u: FloatArray, y: float) -> None:
        """Learn from one sample."""
        self.law.adapt(y, u)


class Filterpy:
    """`KalmanFilter` of filterpy: constant weights, fading memory alpha = lambda^(-1/2), R = 1, is (23)."""

    def __init__(self) -> None:
        from filterpy.kalman import KalmanFilter

        self.law = KalmanFilter(dim_x=PARAMETERS, dim_z=1)
        self.law.P = np.eye(PARAMETERS) / REGULARIZATION
        self.law.Q = np.zeros((PARAMETERS, PARAMETERS))
        self.law.R = np.array([[1.0]])
        self.law.alpha = FORGETTING**-0.5

    @property
    def weights(self) -> FloatArray:
        """Shape (m,)."""
        return np.asarray(self.law.x, float).ravel()

    def step(self, u: FloatArray, y: float) -> None:
        """Learn from one sample."""
        self.law.predict()
        self.law.update(y, H=u[None, :])


class River:
    """`BayesianLinearRegression.learn_one` of river: lambda = 1, for with forgetting it inverts a matrix each step."""

    def __init__(self) -> None:
        from river.linear_model import BayesianLinearRegression

        self.law = BayesianLinearRegression(alpha=REGULARIZATION, beta=1.0)

    @property
    def weights(self) -> FloatArray:
        """Shape (m,)."""
        axes = [{i: float(i == j) for i in range(PARAMETERS)} for j in range(PARAMETERS)]
        return np.array([self.law.predict_one(axis) for axis in axes])

    def step(self, u: FloatArray, y: float) -> None:
        """Learn from one sample; what it needs is a dict."""
        self.law.learn_one(dict(enumerate(u.tolist())), y)


@dataclass(frozen=True)
class Offer:
    """Somebody's recursive least squares: what it is called, whose package it is, how it is made."""

    name: str
    package: str
    make: Callable[[], Rival]
    forgetting: float = FORGETTING

    def version(self) -> str | None:
        """Of the package, None where it is not installed."""
        try:
            return importlib.metadata.version(self.package)
        except importlib.metadata.PackageNotFoundError:
            return None


OFFERS = (
    Offer("NumPy", "numpy", Numpy),
    Offer("padasip FilterRLS", "padasip", Padasip),
    Offer("filterpy KalmanFilter", "filterpy", Filterpy),
    Offer("river BayesianLinearRegression", "river", River, forgetting=1.0),
)


def dlib(u: FloatArray, y: FloatArray) -> FloatArray | None:
    """Time `rls.train` of dlib, where its headers and g++ are: each step, ns, shape (steps,); else None."""
    compiler = shutil.which("g++")
    if compiler is None or not DLIB_HEADER.exists():
        return None
    source = Path(__file__).with_name("dlib.cpp")
    with tempfile.TemporaryDirectory() as folder:
        program, samples = Path(folder, "dlib"), Path(folder, "samples")
        subprocess.run([compiler, "-O3", "-march=native", "-w", source, "-o", program], check=True)
        np.column_stack([y, u]).tofile(samples)
        found = subprocess.run([program, samples, str(y.size)], check=True, capture_output=True, text=True)
    return np.array(json.loads(found.stdout), float)
