"""The dynamics of a stage from a record of its small motion, with what shows how far they may be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, figures, quantity
from truestroke.base.errors import TruestrokeError
from truestroke.base.threads import one_thread
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.identification.dynamics.excitation import Multisine
from truestroke.identification.dynamics.fit import Fit, Problem, Spectra, beside_a_lag, fits, small_hysteresis
from truestroke.identification.dynamics.response import LocalResponse, local_response, smoothed
from truestroke.model.dynamics import EARLIEST, LATEST, SEEN, Dynamics, Mode

COHERENT = 0.9  # coherence up to which a model is trusted
SEEN_AT_ALL = 0.5  # coherence below which a line is not used
MISFIT = 0.05  # relative: of the model against the measurement, beyond its scatter
WRONG = 0.2  # relative: a misfit around the first resonance that makes the model useless
LINES = 3000  # that are fitted, at most, beside those near the peak
PROMINENT = 3.0  # a resonance, over the response of the lowest lines
LIFTED = 1.4  # and over the least response below it
STILL = 20  # lines: the lowest
LOWEST = 60  # lines: where any stage follows
RISE = 1.4  # relative: from where a resonance is prominent to its peak, at most
NEAR = 0.1  # relative: about a peak all lines are fitted
LOW = 0.05  # of the first resonance: below it nothing is judged
FOLDED = 0.2  # of the sample rate: a resonance above half of the rate appears from there on, with another phase
ALL = 0.9  # of the highest frequency that a sample rate shows: a band that goes so far is as wide as can be
SPRING = 0.3  # of it: below, the stage is a spring, and hysteresis and creep scatter and curve the response
BELOW = 0.6  # of it: up to there a controller needs the response
BINS = 60  # a decade, of what is shown and judged
FEWEST = 8  # lines of a bin
SLIGHT = 0.005  # periods of the first resonance: a dead time that is too early by as much is none
CERTAIN = 3.0  # standard deviations: a difference beyond is none of noise
LOST = 0.01  # of the samples, that may be lost
CURVED = 3  # numbers of what is smooth
FLAT = 0.5  # relative: a response so near to the static one is that of a spring


class DynamicsError(TruestrokeError, RuntimeError):
    """The dynamics cannot be measured: the reason, and what to do."""


class NoResonanceError(DynamicsError):
    """The response shows no resonance.

    Attributes
    ----------
    spring_to : float
        Frequency up to which the stage answers as a spring would, within half of its static response, Hz.
    """

    def __init__(self, message: str, spring_to: float) -> None:
        super().__init__(message)
        self.spring_to = spring_to


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallMotion:
    """A record of a small motion around a bias voltage.

    Attributes
    ----------
    sample_rate : float
        Hz.
    excitation : Multisine
        One period, V.
    z : ndarray, shape (ticks,)
        Measured displacement of the ticks of that period, um; NaN where a sample was lost.
    bias : float
        V.
    noise : float
        Standard deviation of a sample at rest, um; NaN if not known.
    gain : float
        As the way to the bias voltage shows it, um/V; NaN if not known.
    latency : int
        Ticks that pass in this loop before a measurement can be used, beside the one until the next command.
    slew_limit, wanted_slew : float
        What the voltage was held to, and what the excitation as large as it was to be would need, V/s.
    travel : float
        How far somebody has let the stage go, um; infinite where nobody has said.
    """

    sample_rate: float
    excitation: Multisine
    z: FloatArray
    bias: float = 0.0
    noise: float = math.nan
    gain: float = math.nan
    latency: int = 0
    slew_limit: float = math.inf
    wanted_slew: float = 0.0
    travel: float = math.inf

    @property
    def louder(self) -> str:
        """What makes the stage answer more clearly, in words: a longer record has more lines, each as faint."""
        if self.wanted_slew <= self.slew_limit:
            further = "" if math.isinf(self.travel) else f" and, with it, `travel` ({figures(self.travel)} um)"
            return f"raise `amplitude`{further}"
        return (
            f"raise the slew limit, {self.slew_limit:g} V/s, which makes the excitation small: up to "
            f"{figures(self.wanted_slew)} V/s helps, as does a lower `band`"
        )

    @property
    def finer(self) -> str:
        """The same, or what shows a peak that is narrower than the spacing of the lines."""
        if self.wanted_slew > self.slew_limit:
            return self.louder
        return f"{self.louder}{'' if math.isinf(self.travel) else ','} or `duration`"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Bode(Displayed):
    """Measured frequency response and the dynamics fitted to it.

    Attributes
    ----------
    dynamics : Dynamics
        Modes, lag and dead time with their standard deviations.
    verdict : Verdict
        Whether they may be used.
    gain : float
        Of the small motion, static, um/V.
    loss : float
        Phase by which hysteresis and creep are late at a tenth of the first resonance, rad: not in `dynamics`.
    frequency : ndarray, shape (bins,)
        Hz, ascending.
    measured, model : ndarray of complex, shape (bins,)
        From commands to measurements, over `gain`, without unit.
    coherence : ndarray, shape (bins,)
        1 / (1 + scatter of the lines of a bin about their mean), 0 to 1.
    residual : ndarray, shape (bins,)
        |measured / model - 1|, without unit.
    scatter : ndarray, shape (bins,)
        Standard deviation of it that noise explains.
    record : SmallMotion
        What was measured.
    """

    dynamics: Dynamics
    verdict: Verdict
    gain: float
    loss: float
    frequency: FloatArray
    measured: ComplexArray
    model: ComplexArray
    coherence: FloatArray
    residual: FloatArray
    scatter: FloatArray
    record: SmallMotion

    def _display(self) -> tuple[str, Rows]:
        title, rows = self.dynamics._display()
        more = [("gain", quantity(self.gain, "um/V")), ("verdict", self.verdict.level)]
        return f"Bode: {title.partition(': ')[2]}", [*rows, *more]


@one_thread
def identify_dynamics(
    record: SmallMotion,
    *,
    modes: int | None = None,
    sensor_delay: float = 0.0,
    sensor_bandwidth: float = 0.0,
    amplifier_bandwidth: float = 0.0,
) -> Bode:
    """Modes, lag of the amplifier and dead time of a record.

    Parameters
    ----------
    record : SmallMotion
        Of `excite`, for one.
    modes : int, optional
        1 to 3; by default as many as the record gives evidence of.
    sensor_delay, sensor_bandwidth
        Of the sensor, s and Hz, from its data sheet: they are not taken for the stage's.
    amplifier_bandwidth : float
        Hz, from its data sheet; 0 is not known, and the record shows it.

    Raises
    ------
    DynamicsError
        The record shows no resonance, or one that cannot be used.
    """
    z = _complete(record.z)
    lines = record.excitation.lines
    U, Y = np.fft.rfft(record.excitation.volts)[lines], np.fft.rfft(z)[lines]
    known = _lags(record.excitation.frequency, sensor_delay, sensor_bandwidth, amplifier_bandwidth)
    local = local_response(U, Y)
    whole = Spectra(record.sample_rate, z.size, record.excitation.frequency, U * known, Y, local.variance)
    peak = _peak(whole, local, record.louder)
    chosen = _chosen(whole, local, peak)
    made = fits(chosen, peak, _delay(whole, local, peak), modes or 3, lags=not amplifier_bandwidth)
    best = beside_a_lag(_best(made, modes, chosen, record), made)
    dynamics = _dynamics(best, record, chosen, sensor_delay, sensor_bandwidth)
    if amplifier_bandwidth:
        dynamics = replace(dynamics, amplifier_bandwidth=amplifier_bandwidth)
    return _judged(dynamics, best, whole, record, known)


def _complete(z: FloatArray) -> FloatArray:
    """The samples, with straight lines over those that are lost."""
    used = np.isfinite(z)
    if 1 - used.mean() > LOST:
        lost = 100 * (1 - used.mean())
        raise DynamicsError(
            f"{lost:.2g} % of the samples are lost, at most {100 * LOST:g} % may be: look at the sensor"
        )
    ticks = np.arange(z.size)
    return np.interp(ticks, ticks[used], z[used])


def _lags(frequency: FloatArray, delay: float, *bandwidths: float) -> ComplexArray:
    """Response of what is known of sensor and amplifier; a bandwidth of 0 is none."""
    lags = math.prod(1 + 1j * frequency / bandwidth for bandwidth in bandwidths if bandwidth)
    return np.asarray(np.exp(-2j * np.pi * frequency * delay) / lags)


def _peak(spectra: Spectra, local: LocalResponse, louder: str) -> float:
    """Frequency of the first resonance, Hz: of the first peak that is prominent, or where the phase turns by 90 deg."""
    f, seen = spectra.frequency, local.coherence > SEEN_AT_ALL
    if (level := float(np.median(local.coherence[:LOWEST]))) < SEEN_AT_ALL:
        raise DynamicsError(
            f"the displacement hardly follows the excitation: coherence {level:.2f} from {figures(f[0])} Hz on; "
            f"{louder}, or look at cables and channels"
        )
    magnitude = np.where(seen, smoothed(np.abs(local.response), 1), 0.0)
    # A second mode with little damping may be higher; that the first is prominent is seen beside it, too.
    # Some lines in the noise far above seem seen, by chance, and high.
    prominent = (smoothed(magnitude, 2) > PROMINENT * np.median(magnitude[:STILL])) & (_beside(local) > STILL)
    if not prominent[STILL:].any():  # an amplifier that lags lowers the peak of a damped mode
        smooth = smoothed(magnitude, STILL)
        prominent = smooth > LIFTED * np.minimum.accumulate(smooth)
        clear = np.logical_and.accumulate(smoothed(local.coherence, STILL) > COHERENT)
        prominent &= clear
        if not prominent[STILL:].any():  # one that is slow lowers a narrow peak, too
            prominent = clear & (smoothed(magnitude, 2) > PROMINENT * np.minimum.accumulate(smooth))
    if prominent[STILL:].any():
        begin = STILL + int(np.argmax(prominent[STILL:]))
        magnitude[np.searchsorted(f, RISE * f[begin]) :] = 0.0
        magnitude[:begin] = 0.0
        return float(f[np.argmax(magnitude)])
    # A damped mode hardly has a peak, and hysteresis lifts the lowest lines.
    turned = seen & (smoothed(np.unwrap(np.angle(local.response)), 2) < -math.pi / 2)
    return float(f[np.argmax(turned if turned.any() else magnitude)])


def _beside(local: LocalResponse) -> FloatArray:
    """How many of the lines around each are seen: one alone may be by chance."""
    seen = local.coherence > SEEN_AT_ALL
    return np.asarray(np.convolve(seen, np.ones(2 * STILL + 1))[STILL : STILL + seen.size])


def _delay(spectra: Spectra, local: LocalResponse, peak: float) -> float:
    """Dead time in ticks, roughly: from the slope of the phase below the peak."""
    part = (spectra.frequency < 0.6 * peak) & (local.coherence > SEEN_AT_ALL)
    if part.sum() < 20:
        return 0.0
    f, phase = spectra.frequency[part], np.unwrap(np.angle(local.response[part]))
    slope = float(np.polyfit(f, phase, 1, w=np.abs(spectra.U[part]))[0])
    return float(np.clip(-slope * spectra.sample_rate / (2 * np.pi), -0.9, 21.0))


def _chosen(spectra: Spectra, local: LocalResponse, peak: float) -> Spectra:
    """The lines that are fitted: where the response is seen at all, thinned out away from the peak."""
    f = spectra.frequency
    end = max(int(np.flatnonzero(_beside(local) > STILL).max(initial=0)), int(np.searchsorted(f, 1.5 * peak))) + 1
    kept = np.zeros(f.size, dtype=bool)
    kept[: end : max(1, math.ceil(end / LINES))] = True
    kept[:end] |= np.abs(f[:end] / peak - 1) < NEAR
    s = spectra
    return Spectra(s.sample_rate, s.ticks, f[kept], s.U[kept], s.Y[kept], s.variance[kept])


def _best(made: list[Fit], modes: int | None, used: Spectra, record: SmallMotion) -> Fit:
    """The best whose inverse is stable, with modes that are seen: one beyond is none, but the slope of a lag."""
    end = min(0.99 * used.frequency[-1], SEEN * used.sample_rate)
    wanted = [fit for fit in made if modes in (None, fit.frequency.size) and fit.frequency.max() < end]
    for fit in wanted:
        if _minimum_phase(fit):
            return fit
    if wanted:
        raise DynamicsError(
            "the modes that fit the record are not minimum-phase: their inverse is unstable. Ask for fewer, `modes=1`, "
            "measure the displacement where the load is, or raise `amplitude`"
        )
    if modes is None:
        raise _no_resonance(used, record)
    count = made[0].frequency.size
    raise DynamicsError(f"the record has no evidence of {modes} modes, but of {count}: leave `modes` out")


def _no_resonance(used: Spectra, record: SmallMotion) -> NoResonanceError:
    """What helps depends on what ends first: what is seen of the response, the band, or what the sample rate shows."""
    rate, (low, high) = used.sample_rate, used.frequency[[0, -1]]
    sees = f"{rate:g} Hz sees up to {SEEN * rate:g} Hz"
    excited = record.excitation.frequency[-1]
    wide = excited > ALL * SEEN * rate
    if high < ALL * excited:
        remedy = record.finer if wide else f"{record.finer}; if none is seen then, use a higher `band` ({sees})"
    elif wide:
        remedy = f"raise the sample rate ({sees})"
    else:
        remedy = f"excite it by a higher `band` ({sees})"
    return NoResonanceError(
        f"no resonance from {figures(low)} to {figures(high, 4)} Hz, where the response was seen: if there is one "
        f"above, {remedy}; if it is well damped, use the controller without dynamics",
        spring_to(used.frequency, _averaged(used)),
    )


def _averaged(used: Spectra) -> ComplexArray:
    """Response of each line with those beside it, um/V: sum of Y U* over that of |U|^2."""
    beside = np.ones(2 * STILL + 1)
    both = np.convolve(used.Y * used.U.conj(), beside, "same")
    return np.asarray(both / np.convolve(np.abs(used.U) ** 2, beside, "same"))


def spring_to(frequency: FloatArray, response: ComplexArray) -> float:
    """Up to which frequency, Hz, a response is within `FLAT` of the static one, that of the lowest frequencies.

    >>> f = np.array([10.0, 20.0, 40.0, 80.0, 160.0])
    >>> spring_to(f, 5.0 / (1 + 1j * f / 100.0))
    40.0
    """
    beyond = np.abs(response / response[0] - 1) > FLAT
    return float(frequency[int(np.argmax(beyond)) - 1 if beyond.any() else -1])


def _modes(fit: Fit) -> tuple[Mode, ...]:
    order = np.argsort(fit.frequency)
    shares = fit.share[order] / math.fsum(fit.share)
    each = zip(fit.frequency[order], fit.damping[order], shares, strict=True)
    return tuple(Mode(frequency=f, damping=zeta, share=share) for f, zeta, share in each)


def _minimum_phase(fit: Fit) -> bool:
    try:
        Dynamics(sample_rate=2.3 * float(fit.frequency.max()), modes=_modes(fit))
    except SettingError:
        return False
    return True


def _dynamics(fit: Fit, record: SmallMotion, used: Spectra, sensor_delay: float, sensor_bandwidth: float) -> Dynamics:
    """Of a fit; refused with a reason where it is no stage that can be inverted."""
    rate, (low, high) = record.sample_rate, used.frequency[[0, -1]]
    first = int(np.argmin(fit.frequency))
    if not (low < fit.frequency[first] < high and fit.resonates(first)):
        raise _no_resonance(used, record)
    ticks, sure = fit.delay * rate, fit.deviations.get("dead_time", 0.0) * rate
    early = max(EARLIEST - ticks, 0.0)  # a soft stage shows lag and dead time as one: what is too early is less lag
    slight = SLIGHT * rate / fit.frequency[first]  # what hysteresis alone does to the phase of a soft stage
    if early > max(CERTAIN * sure, slight) or ticks > LATEST:
        raise DynamicsError(
            f"the measurement comes {ticks:.2f} ticks after its command, beyond the latency that the driver states; "
            f"from {EARLIEST:g} to {LATEST:g} is possible: {_beyond(rate) if early else ''}look at the latency of the "
            "driver; a digital filter in the sensor or its converter looks like that, too: widen it or switch it off"
        )
    lag = fit.lag - early / rate
    order = list(np.argsort(fit.frequency))
    names = {f"{name}[{i}]": f"{name}[{order.index(i)}]" for name in ("frequency", "damping") for i in order}
    return Dynamics(
        sample_rate=rate,
        modes=_modes(fit),
        amplifier_bandwidth=1 / (2 * math.pi * lag) if lag > 0 else 0.0,
        dead_time=max(fit.delay, EARLIEST / rate),  # of both: a sum may be too early by its last digit
        sensor_delay=sensor_delay,
        sensor_bandwidth=sensor_bandwidth,
        uncertainty={names.get(name, name): value for name, value in fit.deviations.items()},
    )


def _beyond(rate: float) -> str:
    """What a resonance beyond the sample rate does, whose phase below it seems early."""
    return (
        f"a stage that resonates above {SEEN * rate:g} Hz, beyond what {rate:g} Hz sees, looks like that: measure at a "
        "higher sample rate; or "
    )


# ---- How far it is right -------------------------------------------------------------------------------------------


def _judged(dynamics: Dynamics, fit: Fit, whole: Spectra, record: SmallMotion, known: ComplexArray) -> Bode:
    """Model beside measurement in bins of frequency, and the verdict."""
    f = whole.frequency
    response, measured = Problem(whole, fit.frequency.size, fit.lag > 0).at(fit.x)
    weight = np.abs(response * whole.U) ** 2 / whole.variance
    which = _bins(f)
    total = np.bincount(which, weight)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(which, weight * values) / total)

    apart = measured / response - 1
    difference = mean(apart.real) + 1j * mean(apart.imag)
    centre = np.exp(mean(np.log(f)))
    # Lines scatter about the mean of their bin by noise, distortion, and modes that are not in the model.
    spread = mean(np.abs(apart - difference[which]) ** 2)
    coherence = 1 / (1 + smoothed(spread, 1))
    scatter = np.sqrt(np.maximum(smoothed(spread / np.maximum(np.bincount(which) - 1, 1), 3), 1 / total))
    at = np.interp(centre, f, response.real) + 1j * np.interp(centre, f, response.imag)
    model = np.asarray(at) * (np.interp(centre, f, known.real) + 1j * np.interp(centre, f, known.imag)) / fit.gain
    first = dynamics.modes[0].frequency
    missed = np.abs(difference - _of_hysteresis(centre, difference, scatter, SPRING * first))
    trusted, findings = _findings(first, centre, coherence, missed, scatter, record)
    findings += _of_the_amplifier(dynamics)
    dynamics = _trusted(dynamics, trusted)
    return Bode(
        dynamics=dynamics,
        verdict=Verdict.of(findings),
        gain=fit.gain,
        loss=-float(np.angle(small_hysteresis(np.array([first / 10]), fit.hysteresis, f[-1]))[0]),
        frequency=centre,
        measured=model * (1 + difference),
        model=np.asarray(model, dtype=np.complex128),
        coherence=coherence,
        residual=np.abs(difference),
        scatter=scatter,
        record=record,
    )


def _bins(f: FloatArray) -> npt.NDArray[np.intp]:
    """The bin of each line: so many a decade, with so many lines at least."""
    starts, start = [0], 0
    while True:
        start = max(int(np.searchsorted(f, f[start] * 10 ** (1 / BINS))), start + FEWEST)
        if start + FEWEST > f.size:
            break
        starts.append(start)
    return np.searchsorted(np.array(starts), np.arange(f.size), side="right") - 1


def _trusted(dynamics: Dynamics, frequency: float) -> Dynamics:
    return replace(dynamics, trusted_to=min(frequency, dynamics.sample_rate / 2))


def _findings(
    first: float,
    f: FloatArray,
    coherence: FloatArray,
    residual: FloatArray,
    scatter: FloatArray,
    record: SmallMotion,
) -> tuple[float, list[tuple[Level, str]]]:
    """Up to which frequency the model is right, and what is not good; `first` is that of the first resonance, Hz."""
    misfit = _together((residual - CERTAIN * scatter > MISFIT) & (f > LOW * first))
    bad = misfit | _together((coherence < COHERENT) & (f > SPRING * first))
    run = np.flatnonzero(bad)
    end = int(run[0]) if run.size else f.size
    trusted = float(f[end - 1]) if end else 0.0
    findings: list[tuple[Level, str]] = []
    around = misfit & (f < 1.3 * first)
    if around.any() and float(residual[around].max()) > WRONG and first > FOLDED * record.sample_rate:
        half = f"{record.sample_rate / 2:g} Hz"
        words = f"A resonance above half of the sample rate, {half}, appears below it, with a response like this one"
        findings.append(("bad", f"{words}: measure at a higher sample rate."))
    if trusted < 0.5 * first:
        at = f"the first resonance is at {figures(first, 4)} Hz"
        reason = f"The model may be trusted to {figures(trusted)} Hz only, {at}"
        findings.append(("bad", f"{reason}: {record.finer if misfit[end] else record.louder}."))
    elif trusted < first:
        findings.append(("doubtful", f"The model may be trusted to {figures(trusted)} Hz, below the first resonance."))
    if around.any():
        most = float(residual[around].max())
        where = f"{figures(f[around].min())} to {figures(f[around].max())} Hz"
        level: Level = "bad" if most > WRONG else "doubtful"
        words = f"From {where} model and measurement differ by up to {figures(100 * most, 2)} %"
        findings.append((level, f"{words}: the stage has another mode there, or the excitation was disturbed."))
    return trusted, findings


def _of_the_amplifier(dynamics: Dynamics) -> list[tuple[Level, str]]:
    """Whether a lag that is far below the resonance is known: hysteresis and creep look like it, and it is a gain."""
    corner, deviation = dynamics.amplifier_bandwidth, dynamics.uncertainty.get("amplifier_bandwidth", 0.0)
    if not corner:
        return []
    below = (BELOW * dynamics.modes[0].frequency / corner) ** 2
    unsure = deviation / corner * below / (1 + below)  # of |1 / (1 + j f / corner)|
    if unsure <= MISFIT:
        return []
    return [(
        "bad" if unsure > WRONG else "doubtful",
        f"The bandwidth of the amplifier, {figures(corner)} Hz, has a standard deviation of {figures(deviation)} Hz: "
        "so slow a lag looks like hysteresis and creep, and the response above it has its error. State "
        "that of its data sheet (`amplifier_bandwidth`), or use a faster one.",
    )]  # fmt: skip


def _of_hysteresis(f: FloatArray, difference: ComplexArray, scatter: FloatArray, end: float) -> ComplexArray:
    """What is smooth in the relative difference of measurement and model up to a frequency, Hz; 0 above.

    Hysteresis curves a response over a decade; a mode that the model has not is narrow.
    """
    below = f < end
    smooth = np.zeros_like(difference)
    if below.sum() > 2 * CURVED:
        powers = np.vander(np.log(f[below]), CURVED)
        weighted = powers / scatter[below, None], difference[below] / scatter[below]
        smooth[below] = powers @ np.linalg.lstsq(*weighted, rcond=None)[0]
    return smooth


def _together(bins: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Those that have a neighbour: one bin alone is an accident."""
    both = bins[:-1] & bins[1:]
    return np.asarray(np.append(both, False) | np.append(False, both))
