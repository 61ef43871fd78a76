"""Units as a page and a plot show them: prefixes of the SI, and µm where the terminal says um."""

import math
import re


def micro(text: str) -> str:
    """A text of the terminal with µm in place of um; names and files keep their letters.

    Examples
    --------
    >>> micro("maximum: 1 um at 2 um/s, of um.csv with um_per_volt")
    'maximum: 1 µm at 2 µm/s, of um.csv with um_per_volt'
    """
    return re.sub(r"\bum\b(?!\.\w)", "µm", text)


def length(um: float) -> str:
    """A length, um, in the unit that suits it, three digits.

    Examples
    --------
    >>> length(0.17666), length(1.0731), length(0.9999), length(2.0e5)
    ('177 nm', '1.07 µm', '1 µm', '200 mm')
    """
    from matplotlib.ticker import EngFormatter

    return EngFormatter(unit="m")(float(f"{1e-6 * um:.3g}"))


def scaled_length(largest: float) -> tuple[float, str]:
    """Factor from um, and unit, in which to show lengths up to `largest` um.

    Examples
    --------
    >>> scaled_length(0.3), scaled_length(49.0)
    ((1000.0, 'nm'), (1.0, 'µm'))
    """
    factor, unit = scaled(1e-6 * largest, "m")
    return float(f"{1e-6 * factor:.3g}"), unit


def scaled(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit in which to show values up to `largest` of `unit`.

    Examples
    --------
    >>> scaled(0.3e-6, "m"), scaled(49e-6, "m"), scaled(2e-3, "s"), scaled(0.0, "V")
    ((1000000000.0, 'nm'), (1000000.0, 'µm'), (1000.0, 'ms'), (1.0, 'V'))
    """
    from matplotlib.ticker import EngFormatter

    power = 3 * math.floor(math.log10(largest) / 3) if largest > 0 else 0
    power = min(max(power, -30), 30)
    return 10.0**-power, f"{EngFormatter.ENG_PREFIXES[power]}{unit}"
