"""What is found in a record, as values, a sentence and a table."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from truestroke.base.display import figures

ALONG = 0.28  # of `Findings.stroke_places`: below, inner loops are of one family; random waves have 0.3 to 1.1
PACE = 1.3  # of `Findings.stroke_durations_s`, the longest over the shortest: below, speed is that of the length
ALIKE = 1.5  # of `Findings.stroke_lengths_percent`, the longest over the shortest: below, there are no inner loops
VISITED = 50.0  # of `Findings.volts_visited_percent`: below, the voltage is at few levels; other motion has 70 to 100


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What `examine` finds in a record; None where the record does not show it.

    Attributes
    ----------
    source : str
        The file, or "arrays".
    rows, dropped : int
        Rows in use, and rows left out on request.
    sample_rate_hz : float
        Rows per second, gaps left out.
    jitter_us : float or None
        Standard deviation of the intervals between time stamps, us; None without time stamps.
    duration_s : float
        From first to last row.
    gaps : tuple of (int, float)
        Row in front of each gap, from 0, and its length, s.
    voltage_v, displacement_um : tuple of float
        Least and largest value.
    stroke_um : float
        Difference of the two displacements.
    gain_um_per_v, offset_um : float
        The straight line through the record: its slope, and its displacement at 0 V.
    correlation : float
        Of voltage and displacement.
    loop_width_percent : float
        Mean width of the loop, 2 (closed integral of x dz) / (travel of x), % of stroke; below 0 where the
        displacement leads.
    hysteresis_percent : float or None
        The same with the delay taken out.
    delay_ms : float or None
        By which the displacement turns later than the voltage; the loop has no part in it (`turning.delay`).
    lag_ms : float or None
        Peak of the cross-correlation of the rates: delay and hysteresis together.
    noise_um : float
        Standard deviation of the noise of the displacement between neighbouring samples.
    voltage_noise_v : float
        The same of the voltage, if the displacement does not follow it: noise of its measurement; else 0.
    rates_um_s : tuple of float
        Median, 90 and 99 % of |dz/dt|.
    strokes : int
        Movements of the voltage between two reversals, of at least 5 % of its span.
    stroke_speeds_um_s : tuple of float
        Mean speed of the displacement in a stroke: 5 and 95 % of the time is spent in slower ones.
    stroke_lengths_percent : tuple of float
        The same of their lengths, % of the voltage span.
    stroke_durations_s : tuple of float
        The same of the times that they take, s.
    stroke_places : float or None
        How far the middles of strokes of one length are apart, over how far the voltage span would let them be: 0 for a
        motion that grows or decays about one voltage, or always comes back to one end; 0.3 to 1 for random ones.
    seldom_way_percent : float
        Share of the rows in the strokes of one direction, of that with fewer rows, %: 50 for a triangle, 0 for lines of
        a raster without the ways back.
    volts_visited_percent : float
        Share of twentieths of the voltage span in which more than a tenth as many rows are as of an even motion, %: 100
        for a triangle or a sine, 15 for steps between three levels.
    volts_mostly_v : tuple[float, float] or None
        Where these twentieths are, V, if they lie side by side: the voltage went further on single ways only.
    states_known_s : float
        Time at which the voltage has been at both its ends; before, the states of the widest plays are not known.
    clipped_displacement, clipped_volts : int
        Rows in which it stays at its largest or least value while the other one moves on.
    assumed_displacement : bool
        Whether nobody states the unit of the displacement, and um is assumed.
    rows_per_value : int
        In every which row the displacement has a new value: 1, or more with a sensor that is slower than the record.
    warnings : tuple[str, ...]
        What is suspicious, and what the record cannot identify, in words; the mistakes first.
    mistakes : tuple[str, ...]
        What contradicts that this is voltage and displacement in these units, each with its evidence (`mistakes`).
    implausible : tuple[str, ...]
        What is rare in a correct record (`rare.implausible`): the model is doubtful.
    """

    source: str
    rows: int
    dropped: int
    sample_rate_hz: float
    jitter_us: float | None
    duration_s: float
    gaps: tuple[tuple[int, float], ...]
    voltage_v: tuple[float, float]
    displacement_um: tuple[float, float]
    stroke_um: float
    gain_um_per_v: float
    offset_um: float
    correlation: float
    loop_width_percent: float
    hysteresis_percent: float | None
    delay_ms: float | None
    lag_ms: float | None
    noise_um: float
    voltage_noise_v: float
    rates_um_s: tuple[float, float, float]
    strokes: int
    stroke_speeds_um_s: tuple[float, float]
    stroke_lengths_percent: tuple[float, float]
    stroke_durations_s: tuple[float, float]
    stroke_places: float | None
    seldom_way_percent: float
    volts_visited_percent: float
    volts_mostly_v: tuple[float, float] | None
    states_known_s: float
    clipped_displacement: int
    clipped_volts: int
    assumed_displacement: bool = False
    rows_per_value: int = 1
    warnings: tuple[str, ...] = ()
    mistakes: tuple[str, ...] = ()
    implausible: tuple[str, ...] = ()

    @property
    def narrow(self) -> str:
        """In words, that most of the motion is in a part of the voltage's span; empty where it is not."""
        if self.volts_mostly_v is None or self.volts_visited_percent >= VISITED:
            return ""
        (low, high), share = self.volts_mostly_v, self.volts_visited_percent
        return f"most of the motion is at {low:.4g} to {high:.4g} V, {share:.0f} % of the voltage's span"

    @property
    def one_length(self) -> bool:
        """Whether all strokes are about as long: the record has no inner loops."""
        short, long = self.stroke_lengths_percent
        return long < ALIKE * short

    @property
    def one_family(self) -> bool:
        """Whether it has none, or inner loops at one voltage for each of their lengths."""
        return self.one_length or (self.stroke_places is not None and self.stroke_places < ALONG)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, text, lists and dicts, the types of JSON."""
        return {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(self).items()}

    def sentence(self) -> str:
        """What was moved, how far, how fast: in words in which a reader sees a wrong unit or clock."""
        volts = self.voltage_v[1] - self.voltage_v[0]
        strokes = f"{count(self.strokes, 'stroke')} in {self.duration_s:.4g} s"
        fast = f"99 % of the time below {figures(self.rates_um_s[2])} um/s"
        return f"{strokes}, up to {self.stroke_um:.4g} um for {volts:.4g} V, {fast}, at {self.sample_rate_hz:.6g} Hz"

    def table(self) -> list[tuple[str, str]]:
        """Names and values, with units, in the order in which an engineer checks a record."""
        jitter = "no time stamps"
        if self.jitter_us is not None:  # below a millionth of the interval it is the rounding of the stamps
            seen = 1e-6 * self.jitter_us * self.sample_rate_hz > 1e-6
            jitter = f"jitter {length(1e-6 * self.jitter_us, 's')}" if seen else "no jitter"
        longest = f", the longest {max((s for _, s in self.gaps), default=0.0):.3g} s" if self.gaps else ""
        delay = "not separable from hysteresis" if self.delay_ms is None else f"{self.delay_ms:.3g} ms"
        without = "" if self.hysteresis_percent is None else f", {self.hysteresis_percent:.1f} % without the delay"
        slow, fast = self.stroke_speeds_um_s
        clipped = f"{self.clipped_displacement} rows of displacement, {self.clipped_volts} of voltage"
        return [
            ("rows", f"{self.rows}, {self.duration_s:.4g} s"),
            ("sample rate", f"{self.sample_rate_hz:.6g} Hz, {jitter}"),
            ("gaps", f"{len(self.gaps)}{longest}"),
            ("voltage", f"{self.voltage_v[0]:.4g} to {self.voltage_v[1]:.4g} V"),
            ("stroke", f"{self.stroke_um:.4g} um, from {self.displacement_um[0]:.4g} um"),
            ("straight line", f"{self.gain_um_per_v:.4g} um/V, {self.offset_um:.4g} um at 0 V"),
            ("loop width", f"{self.loop_width_percent:.1f} % of stroke{without}"),
            ("delay", delay + ("" if self.lag_ms is None else f" (lag of the rates: {self.lag_ms:.3g} ms)")),
            ("noise", length(1e-6 * self.noise_um, "m")),
            ("rates", f"{', '.join(map(figures, self.rates_um_s))} um/s (median, 90 %, 99 %)"),
            ("strokes", f"{self.strokes}, at {figures(slow)} to {figures(fast)} um/s"),
            ("states known", f"after {self.states_known_s:.3g} s"),
            ("clipped", clipped if self.clipped_displacement or self.clipped_volts else "none"),
        ]


def length(value: float, unit: str) -> str:
    """Seconds or metres with a prefix."""
    for factor, prefix in ((1e9, "n"), (1e6, "u")):
        if value * factor < 100:
            return f"{value * factor:.3g} {prefix}{unit}"
    return f"{value * 1e3:.3g} m{unit}"


def count(number: int, what: str) -> str:
    """A number and what is counted, in the plural unless it is 1."""
    return f"{number} {what}{'' if number == 1 else 's'}"
