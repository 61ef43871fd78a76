"""The same stage and scan under three controllers: images of two samples, distortion, trace against retrace."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control.axes import MultiAxisController
from truestroke.control.controller import AdaptiveController
from truestroke.control.settings import ControllerSettings
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.plant import MultiAxisSettings, MultiAxisStage, StageSettings
from truestroke.signals import scans, shaping, trajectories
from truestroke.signals.scans import rates
from truestroke.signals.scans.images import Distortion, Image
from truestroke.signals.scans.motions import LEAD_OUT
from truestroke.signals.scans.scan import Scan
from truestroke.studies.scanning import lines

PIXELS = 512
WIDTH, OFFSET = 20.0, (14.5, 14.0)  # um of the image, and its centre
RATE = 40.0  # rows per second
BISECTED = 20  # times: to a millionth of the rates
SAMPLE_RATE = 5000.0  # Hz
SLOWEST = 1.0  # Hz of the rows: minutes, and 0.7 GB of memory
TICK = 2e-5  # s that a tick of all four runs takes, on two cores that are busy
SOFTEST, STIFFEST = 10.0, 2200.0  # Hz: slower rows would be needed, or more samples a second
LEAD_IN, LEAST_LEAD = 4.0, 8  # s of lines before the image, and their number at least
LEAD_ROWS, LEAD_SHARE = 96, 0.6  # rows over which y moves in the last of them, at most, and as a share
OVER_SCAN = 0.01  # of the width, at least
ROTATION, TURNS = 100.0, 256  # Hz of the spiral
LIMITS, STROKE = (-0.6, 3.6), 30.0
NOISE = 0.001  # um, a sample of a capacitive sensor
LOUDEST = 3.0  # um: a tenth of the stroke; with more a first measurement may be refused
COUPLING = ((0.0, 0.02), (0.03, 0.0))  # um/um
DAMPING = 0.02
FINE, SEEN = 0.1, 0.5  # pixels: largest distortion of a good image, and of a doubtful one
ROUND = 0.1  # % of the diameter, rms, of a good spiral
NAMES = {"open loop": "open loop", "paper": "the paper", "truestroke": "truestroke"}


@dataclass(frozen=True, eq=False)
class Imaged:
    """What one controller made of the scan.

    Attributes
    ----------
    name : str
        Of the controller.
    error : ndarray, shape (ticks,)
        True minus desired position of x, um, in single precision.
    distortion : Distortion
        True places of the pixels against those where they are shown.
    images : Mapping[str, Mapping[str, Image]]
        Of "grating" and "texture": "trace" and "retrace".
    shift : tuple[float, float]
        Of the retrace of the texture against its trace, in x and y, pixels, by `scans.shift`.
    remedy : str
        Another rate, where what harmonics of the rows do at a resonance, or what rings, may be why it is not good.
    limited : Mapping[str, float]
        Percent of the ticks in which a limit of voltage or slew held each axis, where one did; of truestroke alone.
    """

    name: str
    error: npt.NDArray[np.float32] = field(repr=False)
    distortion: Distortion
    images: Mapping[str, Mapping[str, Image]] = field(repr=False)
    shift: tuple[float, float]
    remedy: str = ""
    limited: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        x, y = self.distortion.rms_um()
        return {
            "controller": self.name,
            "distortion_largest_pixels": self.distortion.largest,
            "distortion_rms_pixels": self.distortion.rms,
            "trace_retrace_pixels": self.distortion.trace_retrace,
            "shift_pixels": self.shift,
            "x_rms_um": x,
            "y_rms_um": y,
        }


@dataclass(frozen=True, eq=False)
class Scanned:
    """The scan under all controllers, and a spiral under the last.

    Attributes
    ----------
    scan : Scan
        The raster.
    imaged : Mapping[str, Imaged]
        By the name of the controller.
    spiral : float
        Error of a spiral of 100 turns per second with truestroke, % of its diameter, rms.
    stage : MultiAxisSettings
        What was simulated.
    verdict : Verdict
        Of truestroke's image: good where no pixel is more than 0.1 pixel from its place, nor trace from retrace.
    """

    scan: Scan
    imaged: Mapping[str, Imaged]
    spiral: float
    stage: MultiAxisSettings
    verdict: Verdict

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "controllers": [one.as_dict() for one in self.imaged.values()],
            "spiral_percent_of_diameter": self.spiral,
            "rows_per_second": self.scan.settings["rate"],
            "pixels": PIXELS,
        }


def stage_of(resonances: tuple[float, float], kinds: tuple[str, str], noise: float) -> MultiAxisSettings:
    """Two axes of 30 um that disturb each other."""
    axes = tuple(
        StageSettings(sample_rate=SAMPLE_RATE, resonances=(f,), dampings=(DAMPING,), hysteresis_kind=kind, noise=noise)
        for f, kind in zip(resonances, kinds, strict=True)
    )
    return MultiAxisSettings(axes=axes, coupling=COUPLING)


def scan_of(
    stage: MultiAxisSettings,
    rate: float,
    width: float = WIDTH,
    *,
    lead_in: float = LEAD_IN,
    slow: str = "steps",
    stroke: float = math.inf,
) -> Scan:
    """The raster: turns and steps that leave each axis at rest, and the over-scan that the steps need.

    Behind so many seconds of lines (`lead_in`); `slow` is that of `scans.raster`. Lines whose turns go beyond the
    `stroke`, um, are refused.
    """
    x, y = (one.dynamics() for one in stage.axes)
    least, step = (shaping.settling_move(one).duration for one in (x, y))
    fastest = 0.5 / (least + 3.1 * max(0.0, (step - least) / 2))  # an over-scan of the width on either side
    if checks.number("rate", rate, "Hz") < SLOWEST or not _reached(rate, fastest, x, step, width, stroke):
        slower = SLOWEST
        for _ in range(BISECTED):
            middle = (slower + fastest) / 2
            inside = _reached(middle, fastest, x, step, width, stroke)
            slower, fastest = (middle, fastest) if inside else (slower, middle)
        fastest = slower
    if not SLOWEST <= rate <= fastest:
        first = " and ".join(f"{one.resonances[0]:g}" for one in stage.axes)
        within = "" if math.isinf(stroke) else f", within a stroke of {stroke:g} um"
        bound = (
            f"from {SLOWEST:g} to {math.floor(10 * fastest) / 10:.4g} Hz, as stages of {first} Hz need time to turn "
            f"and to step in each row{within}"
        )
        raise SettingError("rate", rate, bound, "Hz")
    over = _over_scan(rate, x, step)
    lead = max(math.ceil(lead_in * rate), LEAST_LEAD)
    made = scans.raster(
        width=width,
        lines=PIXELS,
        rate=rate,
        turn=x,
        settle=y,
        over_scan=over,
        lead_in=lead,
        lead_rows=min(LEAD_ROWS, round(LEAD_SHARE * lead)),
        lead_out=LEAD_OUT,
        offset=OFFSET,
        sample_rate=stage.sample_rate,
        slow=slow,
    )
    lines.period_of(made)
    return made


def _over_scan(rate: float, x: Dynamics, step: float) -> float:
    """Of lines that leave a step of y, s, its time, as a part of the width."""
    turn = shaping.turn_time(x, rate)
    margin = max(0.0, (step - turn) / 2)
    return max(OVER_SCAN, 1.001 * margin / max(0.5 / rate - turn - 2 * margin, 1e-9))


def _reached(rate: float, fastest: float, x: Dynamics, step: float, width: float, stroke: float) -> bool:
    """Whether lines that are no faster than `fastest`, Hz, have their turns within the stroke, um."""
    if rate > fastest or math.isinf(stroke):
        return rate <= fastest
    about = {"ramp": 0.0, "sample_rate": x.sample_rate, "peak_to_peak": 1.0}
    unit = trajectories.raster(frequency=rate, duration=2 / rate, turn=x, **about)
    return width * (1 + 2 * _over_scan(rate, x, step)) / float(unit.settings["line"]) <= stroke  # type: ignore[arg-type]


def seconds_for(rate: float) -> float:
    """About how long `image_stage` takes with so many rows per second, s.

    Examples
    --------
    >>> round(seconds_for(1.0)), round(seconds_for(40.0))
    (52, 2)
    """
    return TICK * SAMPLE_RATE * (PIXELS / rate + LEAD_IN)


def expected(rate: float, resonances: tuple[float, float]) -> str:
    """Before it begins: a sentence where the stage rings for so long that the image will hardly be good, or "".

    Examples
    --------
    >>> expected(40.0, (900.0, 700.0))
    ''
    """
    known = {name: Mode(frequency=f, damping=DAMPING) for name, f in zip("xy", resonances, strict=True) if f > 0}
    return rates.ringing(rate, known)


def controllers_of(stage: MultiAxisSettings, period: float | None = None) -> MultiAxisController:
    """Truestroke, with the dynamics that `truestroke bode` would measure, and the period of what repeats, s."""
    usual = {"sample_rate": stage.sample_rate, "stroke": STROKE, "voltage_limits": LIMITS, "feedback": False}
    return MultiAxisController(
        {
            name: ControllerSettings(**usual, dynamics=one.dynamics())  # type: ignore[arg-type]
            for name, one in zip("xy", stage.axes, strict=True)
        },
        period=period,
    )


def planned(
    rate: float, resonances: tuple[float, float], kinds: tuple[str, str], noise: float, seed: int
) -> tuple[MultiAxisSettings, Scan]:
    """Stage and raster of `image_stage`, of the same arguments; SettingError where one of them is out of its bounds."""
    checks.count("seed", seed, 0, 2**63 - 1)
    checks.within("noise", noise, 0.0, LOUDEST, "um")
    for frequency in resonances:
        checks.within("resonances", frequency, SOFTEST, STIFFEST, "Hz")
    stage = stage_of(resonances, kinds, noise)
    return stage, scan_of(stage, rate, stroke=STROKE)


def image_stage(
    *,
    rate: float = RATE,
    resonances: tuple[float, float] = (900.0, 700.0),
    kinds: tuple[str, str] = ("plays", "preisach"),
    noise: float = NOISE,
    seed: int = 0,
) -> Scanned:
    """Image a grating and a texture with a simulated XY stage under three controllers, and follow a spiral.

    Parameters
    ----------
    rate : float
        Rows per second, Hz; a period of whole ticks of 5 kHz.
    resonances : tuple[float, float]
        Of x and y, Hz.
    kinds : tuple[str, str]
        Hysteresis of x and y: "plays", "preisach" or "bouc-wen".
    noise : float
        Standard deviation of a sample of the sensors, um.
    seed : int
        Of the noise and the texture.

    Returns
    -------
    Scanned

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.
    """
    return image(*planned(rate, resonances, kinds, noise, seed), seed)


def image(
    stage: MultiAxisSettings, scan: Scan, seed: int, progress: Callable[[int, int], None] | None = None
) -> Scanned:
    """As `image_stage`, of what was `planned`; `progress` is called with ticks done and all ticks of the last run."""
    samples = scans.Grating(), scans.Texture(seed=seed)
    gains = [one.stroke / one.voltage_limits[1] for one in stage.axes]
    usual = {"sample_rate": SAMPLE_RATE, "stroke": STROKE, "voltage_limits": LIMITS}
    hungry = threading.Lock()  # one thread after the other takes hundreds of MB where rows are slow

    def tell(done: int, ticks: int) -> None:
        going()
        if progress is not None:
            progress(done, ticks)

    def made(name: str) -> Imaged:
        going()
        plant, controller = MultiAxisStage(stage, seed), controllers_of(stage, lines.period_of(scan))
        moving: dict[str, Callable[[], FloatArray]] = {
            "open loop": lambda: lines.open_loop(scan, plant, gains),
            "paper": lambda: lines.alone(scan, plant, [AdaptiveController.paper(**usual) for _ in gains]),  # type: ignore[arg-type]
            "truestroke": lambda: lines.together(scan, plant, controller, tell, hungry),
        }
        true = moving[name]()
        going()
        with hungry:
            if name != "truestroke":
                return _imaged(name, scan, true, samples, {})
            return replace(_imaged(name, scan, true, samples, _modes(stage)), limited=_limited(controller))

    with ThreadPoolExecutor(4) as several, _ended_together(several) as going:
        several.submit(samples[1], np.zeros(1), np.zeros(1))  # which makes the texture, once for all of them
        around = several.submit(_spiral, stage, seed, going)
        longest = [several.submit(made, name) for name in reversed(NAMES)]
        found = {one.name: one for one in (each.result() for each in reversed(longest))}
        spiral = around.result()
    verdict = judged(found["truestroke"], spiral.percent, spiral.remedy)
    return Scanned(scan, found, spiral.percent, stage, verdict)


def _limited(controller: MultiAxisController) -> dict[str, float]:
    """Percent of the ticks in which a limit held the voltage of each axis, where one did."""
    counted = {name: axis.counters for name, axis in controller.axes.items()}
    held = {name: 100 * max(one.saturated, one.slewed) / one.commands for name, one in counted.items()}
    return {name: percent for name, percent in held.items() if percent > 0}


def _modes(stage: MultiAxisSettings) -> dict[str, Mode]:
    """First ones of the axes."""
    return {name: one.dynamics().modes[0] for name, one in zip("xy", stage.axes, strict=True)}


def _frequencies(modes: Mapping[str, Mode]) -> dict[str, float]:
    """Theirs, Hz."""
    return {name: mode.frequency for name, mode in modes.items()}


def _remedy(scan: Scan, true: FloatArray, moved: Distortion, modes: Mapping[str, Mode]) -> str:
    """Another rate, where what harmonics of the rows do at a resonance, or what rings, may be why it is not good."""
    seen, known = (moved.largest, moved.trace_retrace), _frequencies(modes)
    if not known or max(seen) <= FINE:
        return ""
    if words := rates.advice(scan, known):
        x, y = (true - rates.at_resonances(scan, _off(scan, true), known)).T
        less = scans.distortion(scan, x, y, PIXELS)
        left = less.largest, less.trace_retrace
        if any(rates.is_why(one, other, FINE) for one, other in zip(seen, left, strict=True)):
            return words
    return rates.ringing(float(scan.settings["rate"]), modes)  # type: ignore[arg-type]


def _off(scan: Scan, true: FloatArray) -> FloatArray:
    """True minus desired positions, um, shape (ticks, axes)."""
    return true - np.stack([axis.position for axis in scan.axes], axis=1)


@contextmanager
def _ended_together(several: ThreadPoolExecutor) -> Iterator[Callable[..., None]]:
    """What the threads call now and then: it ends them where what waits for them has ended, as by Ctrl-C."""
    ended = threading.Event()

    def going(*_: int) -> None:
        if ended.is_set():
            raise CancelledError

    try:
        yield going
    except BaseException:
        ended.set()
        several.shutdown(wait=False, cancel_futures=True)
        raise


def _imaged(
    name: str,
    scan: Scan,
    true: FloatArray,
    samples: tuple[scans.Grating, scans.Texture],
    modes: Mapping[str, Mode],
) -> Imaged:
    x, y = true.T
    places = [scans.at_pixels(scan, axis, PIXELS) for axis in (x, y)]
    images = {one.name: scans.images(scan, one(*places), name=one.name, unit=one.unit) for one in samples}
    shift = scans.shift(images["texture"]["trace"], images["texture"]["retrace"])
    moved = scans.distortion(scan, x, y, PIXELS)
    error = (x - scan.x.position).astype(np.float32)
    return Imaged(name, error, moved, images, shift, _remedy(scan, true, moved, modes))


def spiral_of(stage: MultiAxisSettings, rotation: float = ROTATION) -> Scan:
    """The spiral, of constant angular velocity, Hz."""
    usual = {"offset": OFFSET, "lead_out": LEAD_OUT, "sample_rate": stage.sample_rate}
    return scans.spiral(diameter=WIDTH, turns=TURNS, rotation=rotation, **usual)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Spiral:
    """Error of the spiral, % of its diameter, rms, and another rotation where a resonance is why it is large."""

    percent: float
    remedy: str


def _spiral(stage: MultiAxisSettings, seed: int, going: Callable[..., None]) -> _Spiral:
    scan, known = spiral_of(stage), _frequencies(_modes(stage))
    controllers = controllers_of(stage, lines.period_of(scan))
    off = _off(scan, lines.together(scan, MultiAxisStage(stage, seed), controllers, going))
    found = percent_off(scan, off)
    words = rates.advice(scan, known) if found > ROUND else ""
    why = words and rates.is_why(found, percent_off(scan, off - rates.at_resonances(scan, off, known)), ROUND)
    return _Spiral(found, words if why else "")


def percent_off(scan: Scan, off: FloatArray) -> float:
    """Rms of the error (um, shape (ticks, 2)) of a spiral, % of its diameter."""
    return float(100 / WIDTH * np.sqrt(np.mean(np.sum(off[scan.inside] ** 2, axis=1))))


def judged(imaged: Imaged, spiral: float, for_spiral: str = "") -> Verdict:
    """Of an image: its largest distortion and shift, pixels; of the spiral, %; each with a remedy, if there is one."""
    findings: list[tuple[Level, str]] = []
    for words, pixels in (
        ("A pixel is up to {} pixels from its place.", imaged.distortion.largest),
        ("Trace and retrace are up to {} pixels apart.", imaged.distortion.trace_retrace),
    ):
        if pixels > FINE:
            shown = f"{pixels:.2g}" if pixels < 100 else f"{pixels:.0f}"
            findings.append(("bad" if pixels > SEEN else "doubtful", words.format(shown)))
    for name, percent in imaged.limited.items() if findings else ():
        time = f"{figures(percent, 2)} % of the time"
        text = f"A limit held the voltage of {name} in {time}: fewer rows a second need less."
        findings.append(("doubtful", text))
    findings += [("doubtful", imaged.remedy)] * bool(findings and imaged.remedy)
    if spiral > ROUND:
        text = f"The spiral of {ROTATION:g} turns per second is {spiral:.2g} % of its diameter off, rms."
        remedy = f"{for_spiral} In Python, scans.spiral takes this rotation." if for_spiral else ""
        findings += [("doubtful", words) for words in (text, remedy) if words]
    return Verdict.of(findings)
