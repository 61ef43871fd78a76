"""What was found on an axis: rows with their bounds, a verdict, and what is written into the configuration."""

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from truestroke.base import files, toml
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.verdict import Verdict
from truestroke.runtime.commissioning.procedure import Range, Small
from truestroke.runtime.gains import COMMISSIONING

MARGIN = 0.9  # of what is reached: the stroke that is proposed
ZERO = 0.01  # of what is reached: a zero beyond it goes into the configuration
LOSSES = 0.001  # of the samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """An axis, commissioned.

    Attributes
    ----------
    name : str
        Of the axis.
    small, whole : Small, Range
        What was measured.
    limits : dict
        voltage_limits (V), slew (V/s), safe_voltage (V).
    asked : float or None
        The stroke of the configuration, um.
    stroke : float or None
        The stroke as it was decided, um.
    resonance : float or None
        That of the configuration, Hz.
    zero : float, "measured" or None
        What the configuration subtracts from the sensor, um.
    """

    name: str
    small: Small
    whole: Range
    limits: dict[str, Any]
    asked: float | None = None
    stroke: float | None = None
    resonance: float | None = None
    zero: float | str | None = None

    @property
    def proposed(self) -> float:
        """A stroke that is reached from rest with something to spare, um."""
        whole = self.whole
        return rounded_down(MARGIN * (whole.high if whole.high > 0.5 * whole.reach else whole.reach))

    @property
    def beyond(self) -> bool:
        """Whether the stroke of the configuration is more than the axis reaches."""
        return self.asked is not None and self.asked > self.whole.reach

    @property
    def shifted(self) -> bool:
        """Whether the sensor shows another zero than the configuration says."""
        if isinstance(self.zero, str):  # run measures it
            return False
        return abs(self.small.rest.zero - (self.zero or 0.0)) > ZERO * self.whole.reach

    def rows(self) -> list[list[str]]:
        """Quantity, what was found, what it is compared with."""
        return [*small_rows(self.small, self.asked, self.limits), *self._range_rows()]

    def _range_rows(self) -> list[list[str]]:
        low, high = self.limits["voltage_limits"]
        stroke = "none was given" if self.asked is None else f"{self.asked:g} um was given"
        return [
            ["range", f"{self.whole.low:.4g} to {self.whole.high:.4g} um", f"at {low:g} and {high:g} V, from rest"],
            ["stroke", "-" if self.stroke is None else f"{self.stroke:g} um", stroke],
        ]

    def verdict(self) -> Verdict:
        """Doubtful where something has to be looked at."""
        s, reasons = self.small, []
        stated = s.timing.latency
        if abs(s.latency - stated) > s.unsure:
            reasons.append(
                f"The response comes {s.latency:.1f} ticks after its command, the driver states {stated}: with a wrong "
                "latency the error is the motion in that time."
            )
        if s.resonance.doubtful:
            reasons.append(f"The first resonance is not known: {s.resonance.reason}.")
        if self.whole.ends:
            reasons.append(f"The range ends early: {self.whole.ends}.")
        if self.beyond:
            reasons.append(
                f"The stroke of {self.asked:g} um is beyond reach, {self.whole.reach:.4g} um; it is {self.stroke:g} um "
                "now: motions that go further are refused."
            )
        elif self.stroke is not None and self.stroke > self.whole.high:
            reasons.append(
                f"From rest upwards the axis reaches {self.whole.high:.4g} um of the stroke of {self.stroke:g} um."
            )
        if s.rest.lost > LOSSES:
            reasons.append(f"{100 * s.rest.lost:.2g} % of the samples were lost at rest.")
        return Verdict("doubtful" if reasons else "good", tuple(reasons))

    def changes(self) -> dict[tuple[str, str], tuple[float, str]]:
        """Keys of the configuration, their values, and what they are."""
        made: dict[tuple[str, str], tuple[float, str]] = {}
        if self.stroke is not None and self.stroke != self.asked:
            made["axis", "stroke"] = self.stroke, "um, within reach"
        if self.small.resonance.frequency is not None and not self._as_told():
            frequency = float(f"{self.small.resonance.frequency:.4g}")
            made["axis", "resonance"] = frequency, "Hz, first resonance of the stage"
        if self.shifted:
            made["axis", "zero"] = float(f"{self.small.rest.zero:.6g}"), "um, what the sensor shows at rest"
        return made

    def _as_told(self) -> bool:
        """Whether the resonance of the configuration is the one that was found."""
        found = self.small.resonance
        if self.resonance is None or found.frequency is None or found.uncertainty is None:
            return False
        return abs(self.resonance - found.frequency) <= 2 * found.uncertainty

    def as_dict(self) -> dict[str, Any]:
        """For JSON: values with their unit in the name."""
        s = self.small
        return {
            "noise_um": s.rest.noise,
            "zero_um": s.rest.zero,
            "drift_um_per_s": s.rest.drift,
            "polarity": 1,
            "gain_um_per_V": s.gain.gain,
            "gain_uncertainty_um_per_V": s.gain.uncertainty,
            "latency_ticks": s.latency,
            "latency_uncertainty_ticks": s.unsure,
            "latency_told_ticks": s.timing.latency,
            "resonance_Hz": s.resonance.frequency,
            "resonance_uncertainty_Hz": s.resonance.uncertainty,
            "resonance_unknown_because": s.resonance.reason,
            "damping": s.resonance.damping if s.resonance.frequency else None,
            "range_um": [self.whole.low, self.whole.high],
            "stroke_um": self.stroke,
        }


def small_rows(small: Small, stroke: float | None, limits: dict[str, Any]) -> list[list[str]]:
    """Those of `Findings.rows` that the small steps give."""
    s, (low, high) = small, limits["voltage_limits"]
    expected = None if stroke is None else stroke / (high - low)
    bounds, resonance = "no stroke was given", ["not known", s.resonance.reason]
    if expected is not None:
        bounds = f"{COMMISSIONING[0] * expected:.3g} to {COMMISSIONING[1] * expected:.3g} by stroke and limits"
    if (found := s.resonance).frequency is not None:
        resonance = [f"{found.frequency:.4g} ± {found.uncertainty:.1g} Hz", f"damping {found.damping:.2g}"]
    return [
        ["noise", f"{s.rest.noise:.3g} um rms", f"of a tick; drift {figures(s.rest.drift, 2)} um/s"],
        ["zero", f"{round(s.rest.zero, 3) + 0.0:.3f} um", f"at rest under {limits.get('safe_voltage', 0.0):g} V"],
        ["polarity", "right", "more voltage extends"],
        ["gain", f"{s.gain.gain:.3g} ± {s.gain.uncertainty:.1g} um/V", bounds],
        ["latency", f"{max(s.latency, 0.0):.1f} ± {s.unsure:.1g} ticks", f"{s.timing.latency} by the driver"],
        ["resonance", *resonance],
    ]


def rounded_down(value: float) -> float:
    """To two digits.

    >>> rounded_down(45.4), rounded_down(0.0678)
    (45.0, 0.067)
    """
    if not value > 0:
        return value
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / power + 1e-9) * power:.2g}")


CONFIGURATION = files.Kind("a configuration", lambda path: True)  # as it was it stays beside it

Changes = Mapping[tuple[str, str], tuple[float, str]]
"""("axis" or "driver", key) to the value and what it is, with unit."""


def changed(text: str, changes: Changes, axis: str | None = None) -> str:
    r"""The text of a configuration with these values; those of "axis" are of the first [[axis]], or of this name.

    Raises
    ------
    SettingError
        The text cannot be changed by these keys alone.

    Examples
    --------
    >>> text = "[[axis]] # of the stage\nname = 'x'\n[axis.trajectory]\nkind = 'sine'\n"
    >>> print(changed(text, {("axis", "stroke"): (30.0, "um")}).partition(" # um")[0])
    [[axis]] # of the stage
    name = 'x'
    stroke = 30.0
    """
    import tomlkit

    document = tomlkit.parse(text)
    wanted = tomllib.loads(text)
    place = next(i for i, one in enumerate(wanted.get("axis", [{}])) if axis in (None, one.get("name", "axis")))
    for (table, key), (value, what) in changes.items():
        given: Any = document["axis"][place] if table == "axis" else document[table]
        item = tomlkit.item(value)
        item.comment(f"{what}, found by truestroke commission on {date.today():%Y-%m-%d}")
        given[key] = item
        (wanted["axis"][place] if table == "axis" else wanted[table])[key] = value
    new = tomlkit.dumps(document)
    if tomllib.loads(new) != wanted:
        raise SettingError("the configuration", "its form", "one that takes new keys: write them by hand")
    return new


def write(path: Path, changes: Changes, axis: str | None = None) -> Path:
    """Change the configuration at `path`; where the file as it was now is.

    It is replaced at once and as a whole; FILE.bak, or FILE.bak1 and so on, is the file as it was.

    Raises
    ------
    SettingError, OSError
        It cannot be changed; it is as it was.
    """
    path = path.resolve()
    new = changed(toml.source(path), changes, axis)
    backup = _beside(path, path.read_bytes())
    with files.writing(path, CONFIGURATION) as draft:
        draft.write_text(new, encoding="utf-8", newline="")
    return backup


def _beside(path: Path, data: bytes) -> Path:
    """A copy under a name that no file had."""
    number = 0
    while True:
        backup = path.with_name(f"{path.name}.bak{number or ''}")
        try:
            with backup.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            return backup
        except FileExistsError:
            number += 1
