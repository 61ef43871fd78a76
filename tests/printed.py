"""What a page says that is printed, beside what is printed."""

from __future__ import annotations

import re

import pytest

NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"


def assert_prints(expected: str, printed: str, tolerance: float) -> None:
    """Words must be equal, numbers within the relative tolerance; a `...` stands for anything."""
    tokens = re.findall(rf"\.\.\.|{NUMBER}|[^\W\d_]+|\S", expected)
    parts = [r".*?" if t == "..." else rf"({NUMBER})" if re.fullmatch(NUMBER, t) else re.escape(t) for t in tokens]
    match = re.search(r"\s*".join(parts), printed, flags=re.DOTALL)
    assert match, f"expected\n{expected}\nprinted\n{printed}"
    numbers = [float(t) for t in tokens if re.fullmatch(NUMBER, t)]
    assert [float(group) for group in match.groups()] == pytest.approx(numbers, rel=tolerance, abs=1e-3), printed
