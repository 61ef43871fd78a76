from collections.abc import Mapping

from truestroke._typing import FloatArray

MAX_PLAYS: int
MAX_CREEP_OPERATORS: int
MATCHED_MAX_PLAYS: int
MATCHED_MAX_DEAD_ZONES: int

class Plant:
    def __init__(self, settings: Mapping[str, float]) -> None: ...
    def reset(self) -> None: ...
    def run(self, volts: FloatArray, noise: FloatArray, measured: FloatArray, truth: FloatArray) -> int: ...

class Matched:
    def __init__(self, settings: Mapping[str, float | list[float]]) -> None: ...
    def reset(self) -> None: ...
    def run(
        self, volts: FloatArray, velocity: FloatArray, noise: FloatArray, measured: FloatArray, truth: FloatArray
    ) -> int: ...
