"""Names and units of columns, as their headings state them."""

import re
from collections.abc import Iterable, Mapping, Sequence

UNITS: Mapping[str, Mapping[str, float]] = {
    "volts": {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "displacement": {"um": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0},
}
"""What one of each unit is in V, um and s."""

OF_LANGUAGES: Mapping[str, tuple[str, ...]] = {
    "volts": (
        *("spannung", "tension", "tensión", "tensione", "tensão", "spanning", "napięcie", "напряжение"),
        *("电压", "電圧", "전압"),
    ),
    "displacement": (
        *("auslenkung", "weg", "déplacement", "desplazamiento", "spostamento", "deslocamento", "verplaatsing"),
        *("przemieszczenie", "перемещение", "смещение", "位移", "変位", "변위"),
    ),
    "time": (
        *("zeit", "temps", "tiempo", "tempo", "tijd", "czas", "время"),
        *("时间", "時間", "시간"),
    ),
}
"""Words of eleven languages for what is in a column, in lower case."""

OTHERS = (
    *("rad", "mrad", "urad", "nrad", "deg", "°", "arcsec", "arcmin", "pm", "å", "angstrom", "cm", "inch", "mil"),
    *("in", "a"),
    *("count", "counts", "lsb", "digit", "digits", "code", "codes", "px", "pixel", "pixels"),
    *("%", "percent", "ppm", "db", "a.u.", "arb.", "arb. u.", "arb. units"),
    *("kv/cm", "kv/mm", "v/m", "v/cm", "v/mm", "v/um", "mv/m", "ma", "ka/m", "oe", "mt"),  # fields and currents
    *("strain", "microstrain", "ustrain", "ue", "u\u03b5"),
)
"""Further units, in lower case, that a column is not read in."""

LETTERS = "m", "h"  # z_m is more often "measured" than metres
_LENGTHS = {"um": "micro", "nm": "nano", "mm": "milli", "m": ""}
_METRES = "meter", "meters", "metre", "metres"
_SPELLINGS = {
    **{"V": ("v", "volt", "volts"), "mV": ("millivolt", "millivolts"), "kV": ("kilovolt", "kilovolts")},
    **{"s": ("sec", "second", "seconds"), "ms": ("msec", "millisecond", "milliseconds")},
    **{"us": ("usec", "microsecond", "microseconds"), "min": ("minute", "minutes")},
    **{"h": ("hr", "hour", "hours"), "day": ("days",)},
    **{ours: tuple(part + end for end in _METRES) for ours, part in _LENGTHS.items()},
}
_SPELLINGS["um"] += ("micron", "microns", "mikrometer")


_WIDE = str.maketrans("\uff08\uff09\uff3b\uff3d\uff0f", "()[]/")  # of Chinese and Japanese keyboards
_CYRILLIC = str.maketrans("\u043c\u043d\u0441\u0412\u043a", "mnsVk")


def unit(text: str) -> str:
    """A unit as `UNITS` spells it, also of Greek and Cyrillic letters.

    Examples
    --------
    >>> unit("µm"), unit("Volts"), unit("mV"), unit("мкм"), unit("Nanometers")
    ('um', 'V', 'mV', 'um', 'nm')
    """
    text = text.strip().replace("µ", "u").replace("\u03bc", "u").replace("\u043c\u043a", "u").translate(_CYRILLIC)
    return next((usual for usual, others in _SPELLINGS.items() if text.lower() in others), text)


def is_unit(text: str) -> bool:
    """Whether `UNITS` has it."""
    return any(unit(text) in units for units in UNITS.values())


def name_and_unit(text: str) -> tuple[str, str]:
    """Name and unit of a column from its heading.

    Examples
    --------
    >>> name_and_unit("z (µm)"), name_and_unit("Drive [mV]"), name_and_unit("time_s"), name_and_unit("CH1")
    (('z', 'um'), ('Drive', 'mV'), ('time', 's'), ('CH1', ''))
    >>> name_and_unit("电压\uff08V\uff09")
    ('电压', 'V')
    """
    text = text.strip().translate(_WIDE)
    if match := re.fullmatch(r"(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]", text):
        return match[1] or match[2], unit(match[2])
    match = re.fullmatch(r"(.+?)\s*([_/, ])\s*([^_/, ]+)", text)
    if match and is_unit(match[3]) and (match[2] == "/" or unit(match[3]) not in LETTERS):
        return match[1], unit(match[3])
    return text, unit(text) if is_unit(text) and text not in LETTERS else ""


def names_and_units(last: Sequence[str], before: Sequence[str] = ()) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Of the row above the numbers, or of two, one with names and the other with units alone.

    Examples
    --------
    >>> names_and_units(["z (nm)", "CH1"]), names_and_units(["[V]", "(um)"], ["drive", "sensor"])
    ((('z', 'CH1'), ('nm', '')), (('drive', 'sensor'), ('V', 'um')))
    >>> names_and_units(["[V]", ""], ["drive", "row"])
    (('drive', 'row'), ('V', ''))
    >>> names_and_units(["drive", "sensor"], ["V", "um"])
    (('drive', 'sensor'), ('V', 'um'))
    """
    alone = [text.strip("()[] ") for text in last]
    if before and any(alone) and all(is_unit(one) if one else name for one, name in zip(alone, before, strict=True)):
        return tuple(before), tuple(map(unit, alone))
    names, units = zip(*map(name_and_unit, last), strict=True)
    above = [text.strip("()[] ") for text in before]
    if above and all(is_unit(one) and said in ("", unit(one)) for said, one in zip(units, above, strict=True)):
        return names, tuple(map(unit, above))
    return names, units


def stated_units(units: Sequence[str], moments: Iterable[bool]) -> tuple[str, ...]:
    """The units, and s of dates and times of the day, which are read as seconds."""
    return tuple("s" if moment and not unit else unit for unit, moment in zip(units, moments, strict=True))
