"""How many threads linear algebra has."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from functools import cache, wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
T = TypeVar("T")


class _OneThread:
    """A context in which BLAS has one thread; several may overlap in any order, in threads too.

    The number of threads of BLAS is one for the whole process. The first that enters sets it to one, the last that
    leaves sets it back (decision 46).
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._limits = threading.Lock(), 0, contextlib.ExitStack()

    def __enter__(self) -> None:
        import scipy.linalg  # noqa: F401, its BLAS is not that of NumPy

        with self._lock:
            if not self._inside:
                self._limits.enter_context(_libraries().limit(limits=1, user_api="blas"))
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._limits.close()


@cache
def _libraries() -> ThreadpoolController:
    """Those of this process, looked for once: that takes longer than a small fit."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


one_blas_thread = _OneThread()


def one_thread(call: Callable[P, T]) -> Callable[P, T]:
    """The same function on one thread of BLAS: matrices are small here, and threads mostly wait for each other."""

    @wraps(call)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        with one_blas_thread:
            return call(*args, **kwargs)

    return alone
