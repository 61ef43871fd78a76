"""Tangent and arctangent by their series, as the kernel has them: the same bits without a mathematical library."""

import math


def tangent(x: float) -> float:
    """Of 0 to 1.3, by the series of sine and cosine."""
    sine = cosine = 1.0
    square = x * x
    for k in range(9, 0, -1):
        sine = 1 - square * sine / (2 * k * (2 * k + 1))
        cosine = 1 - square * cosine / (2 * k * (2 * k - 1))
    return x * sine / cosine


def arctangent(x: float) -> float:
    """Of a number above 0, by the series of a quarter of the angle; 0 of one whose square overflows."""
    for _ in range(2):
        x /= 1 + math.sqrt(1 + x * x)
    total, square = 0.0, x * x
    for k in range(9, -1, -1):
        total = 1 / (2 * k + 1) - square * total
    return 4 * (x * total)
