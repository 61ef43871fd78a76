"""The base class of all errors that truestroke raises, which `except truestroke.TruestrokeError` catches; a warning."""

import copyreg
from typing import Any


class TruestrokeError(Exception):
    """Base class of all errors of truestroke; each is also of the kind of Python that fits.

    Examples
    --------
    >>> import truestroke
    >>> try:
    ...     truestroke.AdaptiveController(sample_rate=0.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    ... except truestroke.TruestrokeError as error:
    ...     print(type(error), isinstance(error, ValueError))
    <class 'truestroke.SettingError'> True
    """

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        shown_as_public(cls)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled without a call of `__init__`, which takes other arguments than a message."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


def shown_as_public(cls: type) -> type:
    """The same class, named in tracebacks as a user imports it: `truestroke.SettingError`, wherever it is defined."""
    if cls.__module__.startswith("truestroke."):
        cls.__module__ = "truestroke"
    return cls


class LatenessWarning(UserWarning):
    """The system lacks what punctual ticks need; `truestroke.run_realtime` gives it before the run begins."""


class ModelWarning(UserWarning):
    """The verdict of a model is not good, and it is used; commands and configurations give it before anything moves."""


class PlaceWarning(UserWarning):
    """Moves end beside their place, as the sensor shows, of an axis whose resonance is not stated; given once."""


shown_as_public(TruestrokeError)
shown_as_public(LatenessWarning)
shown_as_public(ModelWarning)
shown_as_public(PlaceWarning)
