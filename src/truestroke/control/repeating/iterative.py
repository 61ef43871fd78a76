"""Iterative learning of a motion that repeats, in the frequency domain, for a loop that is closed from pass to pass.

A pass repeats one period of voltage, and the mean of the periods is measured. The law of `harmonics` makes of
both the strain of the next pass, and a model of the hysteresis, which the first pass shows, its voltage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, figures, quantity, taken_for_um
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.base.verdict import Verdict
from truestroke.control.actuator import ActuatorModel
from truestroke.control.repeating.harmonics import BoolArray, PassLaw, later, nearest
from truestroke.control.repeating.periodic_hysteresis import PeriodicHysteresis, identified
from truestroke.control.repeating.response_prior import (
    DAMPING,
    FREQUENCY,
    GAIN,
    LATE,
    UNSURE,
    FewNumbers,
    Independent,
    Prior,
    beside,
)
from truestroke.control.repeating.steps import finished
from truestroke.control.settings import UNLIMITED
from truestroke.model.dynamics import Dynamics
from truestroke.signals.clipping import at_an_end, clipped
from truestroke.signals.judgement import GOES_ON, TINY, WITHIN
from truestroke.signals.metrics import noise
from truestroke.signals.trajectories import Trajectory

SIZE = "size of the motion"  # as errors name what an option of the command sets
FREQUENCY_OF = "frequency of the motion"
BAND = 2.4  # times the first resonance: harmonics up to there are learned
SEEN = 0.45  # of the sample rate: none beyond it is
WHOLE = 1e-6  # of a sample: a period this near to whole samples has as many
REPETITIONS = 200  # periods of the motion at most, until they take whole samples
PERIODIC = 1e-6  # of the peak-to-peak: how well a motion has to repeat
LIMITED = 0.01  # of the samples at a limit: beyond, the verdict says so
ABOVE = 0.2  # of the square of the noise: what else may be in an error that is called noise
NEAR = 2.0  # times the noise: an error that more passes hardly lower
SPOILT = 0.1  # of the peak-to-peak, rms: above it a waveform that a limit cuts off is bad
FINE = 1e-3  # of the peak-to-peak, rms: a result that is good
FEWEST_PERIODS = 5  # among which a spike is seen
SPIKE = 15.0  # times the median of all deviations from the other periods: ten standard deviations of noise
MOST_SPIKES = 0.03  # of the samples: more are none
HELD = 0.4  # of the noise of a pass: what of it is learned, and moves the stage
SLOW = 0.8  # times the rmse: what the next pass must be expected to have, where more passes help,
STOPPED = 4  # and what one of the last passes must have had of the best one before
SHOWN = 2.0  # times the noise: with no more a pass shows no motion
CROSSED = 0.05  # of the span of the voltage: how far it goes on while a sensor is at the end of its range
LATE_BY = 0.7  # samples: a record that begins so much later or earlier than it should has another trigger
EXPLAINED = 0.1  # of the power of what was not expected: no more remains where another trigger explains it
OTHER_PASS = 1.0, 25.0  # times the power of the change, and of the noise: beyond, a pass is not what was expected
RICH = 0.05  # of the power of the velocity: what other harmonics than the largest have where a phase shows a time
FINER = 8  # times the samples: where a record begins is looked for
FIRST_LATE = 4.0, 0.02  # samples, of the period: a first record that is later than both is not that of its voltage,
LIKE_IT = 0.3  # where no more of its power remains then; half of a period is the other sign of the sensor
BELOW = 0.7  # of the first resonance: what turns with the voltage, whatever the hysteresis
AGREE = 1.5  # samples: two first records that are as late show a dead time
GAINS = 0.1, 10.0  # times the gain that was given: the first pass corrects it within


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Pass(Displayed):
    """What one pass did, and what is expected of the next one.

    Attributes
    ----------
    number : int
        From 0 on, which has learned nothing.
    volts : ndarray, shape (samples,)
        One period, V.
    measured : ndarray, shape (samples,)
        Mean of the measured periods, um; empty of a pass that was missed.
    error : ndarray, shape (samples,)
        Measured minus what is desired of the sensor, um.
    rmse, maximum : float
        Of the error where it counts (`Trajectory.flat`), um.
    noise : float
        Standard deviation of the mean of the periods, um: an error like it cannot be learned.
    expected : float
        Rmse that the next pass should have, noise and the harmonics that are not learned included, um.
    limited : float
        Share of the samples of `volts` at a limit of voltage or slew.
    undone : str
        In a sentence, why the next pass does not build on this one; empty where it does.
    missed : str
        Why this pass counts for nothing, and the same voltage comes again; empty where it counts.
    limit : str
        In a sentence, the limit that holds most of them and what helps; empty where none does.
    spikes : float
        Share of the measured samples that no other period has at its place: they do not count.
    """

    number: int
    volts: FloatArray
    measured: FloatArray
    error: FloatArray
    rmse: float
    maximum: float
    noise: float
    expected: float
    limited: float
    undone: str = ""
    missed: str = ""
    limit: str = ""
    spikes: float = 0.0

    @property
    def verdict(self) -> Verdict:
        """Doubtful where it was undone or at a limit."""
        reasons = [self.undone] if self.undone else []
        if self.limited > LIMITED:
            reasons.append(self.limit)
        return Verdict("doubtful", tuple(reasons)) if reasons else Verdict("good")

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, quantity(getattr(self, name), "um")) for name in ("rmse", "maximum", "noise", "expected")]
        return f"Pass {self.number}: {self.undone or self.verdict.level}", rows


class _Held(NamedTuple):
    """What limits hold of a waveform: the share of all of them, and a sentence of the one that holds most."""

    share: float
    words: str

    @classmethod
    def of(cls, shares: Mapping[tuple[str, str], float]) -> _Held:
        """`shares` of the samples by what holds them, a voltage or the slew, and its remedy."""
        share = sum(shares.values())
        if not share > 0:
            return cls(0.0, "")
        limit, remedy = max(shares, key=lambda one: shares[one])
        holds = f"{limit} holds {figures(100 * share, 2)} % of the waveform: what it cuts off cannot be learned."
        return cls(share, f"{holds} {remedy}")


class IterativeLearning(Displayed):
    """The voltage for a motion that repeats, learned from pass to pass.

    Parameters
    ----------
    motion : Trajectory or array_like, shape (samples,)
        What repeats: a sine, triangle or raster of `truestroke.trajectories`, or one period as an array, um. Errors
        count where `flat` of a trajectory says so.
    sample_rate : float, optional
        Of an array, Hz, and needed then.
    gain : float
        Displacement by voltage, um/V: stroke over voltage range. The first pass corrects it, within ten times.
    dynamics : Dynamics, optional
        Of the stage, as `truestroke bode` measures them. Without them the stage is taken for a spring, and `bandwidth`
        is needed.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage, V.
    slew_limit : float
        Fastest change of the voltage, V/s.
    bandwidth : float, optional
        Highest harmonic that is learned, Hz; by default 2.4 times the first resonance, at most 0.45 of the sample rate.
    model : ActuatorModel, optional
        Of the actuator: its inverse makes the first pass.

    Attributes
    ----------
    desired : ndarray, shape (samples,)
        One period of what is learned, um: the motion without harmonics beyond the bandwidth, as near to it as they
        allow where errors count.
    samples, periods : int
        Of a repetition: where a period of the motion takes no whole number of samples, it has several periods.
    bandwidth, limited_to : float
        Highest harmonic that is learned, Hz, and the one that was given, beyond which none is; infinite where none was.
    dead_time : float
        By which the first two records were late for their voltage, s; 0 where the first one was not.

    Raises
    ------
    SettingError
        The motion does not repeat, its period is no whole number of samples, the bandwidth is below its frequency, the
        rates differ, or a limit does not allow the first pass: the message names what it needs.

    Examples
    --------
    A spring that is a fifth softer than its gain says, and late by a tick:

    >>> wave = 10.0 - 10.0 * np.cos(np.arange(100) * 2 * np.pi / 100)
    >>> learned = IterativeLearning(wave, 1000.0, gain=5.0, bandwidth=100.0, voltage_limits=(0.0, 6.0))
    >>> for _ in range(4):
    ...     made = learned.learn(np.tile(4.0 * np.roll(learned.volts, 1), (3, 1)))
    ...     print(f"{made.rmse:.2f} um")
    2.49 um
    0.32 um
    0.02 um
    0.01 um
    """

    def __init__(
        self,
        motion: Trajectory | npt.ArrayLike,
        sample_rate: float | None = None,
        *,
        gain: float,
        voltage_limits: tuple[float, float],
        slew_limit: float = UNLIMITED,
        dynamics: Dynamics | None = None,
        bandwidth: float | None = None,
        model: ActuatorModel | None = None,
    ) -> None:
        wave, counts, self.sample_rate, self.periods = one_period(motion, sample_rate)
        self.samples = wave.size
        self.gain = checks.positive("gain", gain, "um/V")
        self.voltage_limits = checks.interval("voltage_limits", voltage_limits, "V")
        self.slew_limit = checks.positive("slew_limit", slew_limit, "V/s")
        if dynamics is not None:
            words = "a Dynamics, such as truestroke.measure_dynamics gives"
            dynamics = checks.instance("dynamics", dynamics, Dynamics, words).check_rate(self.sample_rate)
        self.dynamics, self.counts = dynamics, counts
        self._frequency: FloatArray = np.fft.rfftfreq(self.samples, 1 / self.sample_rate).astype(np.float64)
        self.bandwidth = self._band(bandwidth)
        self.limited_to = math.inf if bandwidth is None else self.bandwidth
        self._learned = (self._frequency <= self.bandwidth) & (np.arange(self._frequency.size) % self.periods == 0)
        self.desired = finished(nearest(wave, counts, self._learned))
        G, sensor, self._variance = response_of(dynamics, self._frequency, self.sample_rate, self.gain)
        D = sensor * np.fft.rfft(self.desired)
        beyond = self._beyond(bandwidth)
        self._few = FewNumbers(dynamics, self._frequency, self.sample_rate, self._own)
        prior: Prior = self._few
        if dynamics is None:
            prior = Independent(np.where(beyond, UNSURE, self._variance))
        self._moved = self._learned | beyond
        size = {"samples": self.samples, "periods": self.periods}
        self._law = PassLaw(D, G, prior, self._learned, beyond=beyond, **size)
        self._best = math.nan, np.empty(0)
        self._number = 0
        self._began, self.dead_time = 0.0, 0.0  # samples that the first record was late; s, that the next one was, too
        self._elsewhere = ""  # of the last pass, why its record is not that of its voltage
        self._hysteresis: PeriodicHysteresis | None = None
        self._seen: list[tuple[FloatArray, ComplexArray, ComplexArray, FloatArray]] = []  # volts, U, Z and its variance
        self.volts, self._held = self._first(model)
        self._base = self.volts  # of the pass on which the next one builds

    # ---- The first pass --------------------------------------------------------------------------------------------

    def _band(self, bandwidth: float | None) -> float:
        lowest = self._frequency[self.periods]
        if bandwidth is None:
            if self.dynamics is None:
                bound = "highest harmonic to learn, Hz, or dynamics, as `truestroke bode` measures them"
                raise SettingError("bandwidth", None, bound)
            bandwidth = band(self.dynamics, self.sample_rate)
            _check_band(float(lowest), bandwidth)
        return checks.within("bandwidth", bandwidth, float(lowest), SEEN * self.sample_rate, "Hz")

    def _beyond(self, bandwidth: float | None) -> BoolArray:
        """Harmonics beyond a bandwidth that nobody has given."""
        if bandwidth is not None:
            return np.zeros(self._frequency.size, dtype=bool)
        whole = np.arange(self._frequency.size) % self.periods == 0
        return np.asarray((self._frequency > self.bandwidth) & (self._frequency <= SEEN * self.sample_rate) & whole)

    @property
    def _own(self) -> FloatArray:
        """Variance of R at each harmonic by itself."""
        if self.dynamics is None:
            return self._variance
        return beside(self._frequency, self.dynamics.modes[0].frequency, self.bandwidth)

    def _first(self, model: ActuatorModel | None) -> tuple[FloatArray, _Held]:
        """By the inverse of the model, or by the response where it is sure; refused where a limit forbids it."""
        if model is None:
            excess = np.maximum(self._variance - GAIN**2, 0.0)
            U = np.where(self._learned, self._law.desired / (self._law.response * (1 + excess)), 0.0)
            volts = np.fft.irfft(U, self.samples)
        else:
            checks.instance("model", model, ActuatorModel, "an ActuatorModel, such as of truestroke.load_model(path)")
            periods = 1 + math.ceil(0.1 * self.sample_rate / self.samples)
            volts = model.invert(np.tile(self.desired, periods), self.sample_rate, warn=False)[-self.samples :]
            if not np.ptp(volts) > 0:
                low, high = model.voltage_range
                span, what = figures(float(np.ptp(self.desired))), f"one of {figures(model.stroke)} um"
                bound = (
                    f"one of this axis: by it a motion of {span} um is at one voltage; leave it out, or identify anew"
                )
                raise SettingError("model", f"{what} for {figures(low)} to {figures(high)} V", bound)
        fastest = float(np.abs(np.diff(volts, append=volts[:1])).max()) * self.sample_rate
        if fastest > self.slew_limit:
            bound = f"at least {figures(fastest, 4)} V/s, which the motion needs: raise it, or move slower or less"
            raise SettingError("slew_limit", self.slew_limit, bound, "V/s")
        held = self._within(volts)
        if not np.ptp(held[0]) > 0:
            low, high = self.voltage_limits
            bound = (
                f"within {self.gain * low:.4g} to {self.gain * high:.4g} um, which voltage_limits, {low:g} to {high:g} "
                f"V, reach at {self.gain:.3g} um/V: all of its voltage is at a limit; shift it (`offset`), or correct "
                "the stroke"
            )
            ends = (figures(float(end)) for end in (self.desired.min(), self.desired.max()))
            raise SettingError("place of the motion", " to ".join(ends), bound, "um")
        return held

    def _within(self, volts: FloatArray) -> tuple[FloatArray, _Held]:
        """The same within limits and slew, around the period; and what they hold."""
        low, high = self.voltage_limits
        held = np.clip(volts, low, high)
        most = self.slew_limit / self.sample_rate
        if np.abs(np.diff(held, append=held[:1])).max() > most:
            x = held.tolist()
            for k in range(2 * self.samples):  # the second time around from where the first one has ended
                before = x[k % self.samples - 1]
                x[k % self.samples] = min(max(x[k % self.samples], before - most), before + most)
            held = np.array(x)
        least = 1e-9 * (high - low)
        below, above = volts < low - least, volts > high + least
        slewed = (np.abs(held - volts) > least) & ~below & ~above
        smaller = "or make it smaller."
        shares = {
            ("The slew limit", "Make the motion smaller or slower, or raise the limit."): slewed,
            (f"The lowest voltage, {low:g} V,", f"Move the motion up (`offset`), {smaller}"): below,
            (f"The highest voltage, {high:g} V,", f"Move the motion down (`offset`), {smaller}"): above,
        }
        return held, _Held.of({words: float(np.mean(one)) for words, one in shares.items()})

    # ---- Passes ----------------------------------------------------------------------------------------------------

    def learn(self, measured: npt.ArrayLike | None) -> Pass:
        """What the pass with `volts` has shown; from it `volts` of the next one.

        Parameters
        ----------
        measured : array_like, shape (periods, samples) or (periods * samples,), or None
            Displacement while `volts` was repeated, um, from the beginning of a period, when the start had decayed; NaN
            where a sample was lost. None, or a phase of the period that was never seen, is a pass that was missed: the
            same voltage comes again.

        Raises
        ------
        SettingError
            The pass was cut short: not a whole number of periods. Or the displacement went against the voltage, two
            passes in a row, where it had gone with it, or the record began elsewhere, two passes in a row. What was
            learned so far stays.
        """
        z = self._periods(measured)
        if z is None:
            return self._missed("samples were lost")
        self._refuse_clipped(z)
        spikes = _spikes(z)
        mean, noise2 = self._mean(np.where(spikes, np.nan, z))
        Z, first = np.fft.rfft(mean), self._hysteresis is None
        if first:
            if elsewhere := self._late_at_first(Z):
                return self._missed(elsewhere)
            self._scale(np.fft.rfft(self.volts), Z, noise2)
        elif elsewhere := self._not_of_its_voltage(Z, noise2):
            return self._missed(elsewhere)
        error = mean - np.fft.irfft(self._law.desired, self.samples)
        rmse = float(np.sqrt(np.mean(error[self.counts] ** 2)))
        if first or float(np.std(error[self.counts])) < self._law.best:
            self._model(Z, noise2)
        assert self._hysteresis is not None
        shown = np.fft.rfft(finished(self._hysteresis.strain(self.volts)))
        if first:
            self._law.scale(self._law.gain(shown, Z))
        self._law.see(shown, Z, noise2)
        self._seen = [*(one for one in self._seen if self._law.remembers(one[1])), (self.volts, shown, Z, noise2)]
        if not rmse >= self._best[0]:
            self._best = rmse, self.volts
        following = self._law.follow(float(np.std(error[self.counts])))
        made = Pass(
            number=self._number,
            volts=self.volts,
            measured=mean,
            error=error,
            rmse=rmse,
            maximum=float(np.abs(error[self.counts]).max()),
            noise=self._law.noise(noise2),
            expected=following.expected,
            limited=self._held.share,
            limit=self._held.words,
            undone=following.undone,
            spikes=float(np.mean(spikes)),
        )
        if not following.undone:
            self._base = self.volts
        strain = np.fft.irfft(following.output, self.samples)
        self.volts, self._held = self._within(finished(self._hysteresis.volts(strain, self._base, self._moved)))
        self._number += 1
        return made

    def _not_of_its_voltage(self, Z: ComplexArray, noise2: FloatArray) -> str:
        """Why the record of a pass is not that of its voltage; refused where the one before was none, too."""
        if against := not self._law.gain(np.fft.rfft(self.volts), Z) > 0:
            found, bound = "against the voltage", "of a sensor that rises with the voltage, as in the first pass"
            remedy = "look at its sign, channel and cable, and at the trigger of the recording"
        elif late := self._late(Z, noise2):
            found = self._size(late)
            bound = "recorded from where the first pass was, as the voltage before shows"
            remedy = "look at the trigger of the recording, or learn anew with where it is now"
        else:
            self._elsewhere = ""
            return ""
        if self._elsewhere:
            before = "" if against or found == self._elsewhere else f", after {self._elsewhere}"
            raise SettingError("measured", f"{found}{before}, two passes in a row", f"{bound}: {remedy}")
        self._elsewhere = found
        return f"it was {found}"

    def _late_at_first(self, Z: ComplexArray) -> str:
        """Why a first record is not that of its voltage: it turns later or earlier, and nothing else has shown that.

        The same voltage comes again. A stage with a dead time that its dynamics do not have is as late then.
        """
        late, before = self._turns_late(Z), self._began
        self._began = late
        if not late:
            return ""
        if before and abs(late - before) < AGREE:
            self.dead_time = late / self.sample_rate
            self._law.delay(late)
            return ""
        if before:
            bound = "recorded from the same place in each pass: look at the trigger of the recording"
            raise SettingError("measured", f"{self._size(late)}, after {self._size(before)}", bound)
        return f"it was {self._size(late)} for its voltage"

    def _turns_late(self, Z: ComplexArray) -> float:
        """Samples that the turns of a first record are later than those of its voltage; 0 where hysteresis may be why.

        The fourth powers of the frequencies weigh the turns, which hysteresis leaves in their place.
        """
        f0 = math.inf if self.dynamics is None else self.dynamics.modes[0].frequency
        f = np.where(self._learned & (self._frequency < BELOW * f0), self._frequency / self._frequency[self.periods], 0)
        Y, Z = f**2 * self._law.response * np.fft.rfft(self.volts), f**2 * Z
        power = (f > 0) * np.abs(Y / np.maximum(f, 1.0)) ** 2
        if power.sum() - power.max() < RICH * power.sum():
            return 0.0
        late, moved = self._most_alike(Y, Z)
        moved *= np.real(np.vdot(moved, Z)) / max(float(np.vdot(moved, moved).real), TINY)
        if np.sum(np.abs(Z - moved) ** 2) > LIKE_IT * np.sum(np.abs(Z) ** 2):
            return 0.0
        period = self.samples / self.periods
        least = max(FIRST_LATE[0], FIRST_LATE[1] * period)
        return late if least < abs(late) < period / 2 - least else 0.0

    def _most_alike(self, Y: ComplexArray, Z: ComplexArray) -> tuple[float, ComplexArray]:
        """Samples by which Y has to be later to be most like Z, within half a period, and Y as it is then."""
        steps = int(np.argmax(np.fft.irfft(Z * np.conj(Y), FINER * self.samples)))
        most = FINER * self.samples / self.periods
        late = (steps - most * round(steps / most)) / FINER
        return late, later(Y, late, self.samples)

    def _size(self, late: float) -> str:
        """How late or early so many samples are, in words."""
        size = f"{figures(abs(late), 2)} samples, {figures(abs(late) / self.sample_rate, 2)} s,"
        return f"{size} too {'late' if late > 0 else 'early'}"

    def _late(self, Z: ComplexArray, noise2: FloatArray) -> float:
        """Samples that the record begins too late; 0 where nothing else explains as little of it.

        A single harmonic shows a phase, which is that of a stage, too. So a sine shows no time.
        """
        assert self._hysteresis is not None
        shown = np.fft.rfft(finished(self._hysteresis.strain(self.volts)))
        Y, change, noise = self._law.expected(shown)
        Z = np.where(Y != 0, Z, 0.0)
        other = float(np.sum(np.abs(Z - Y) ** 2))
        power = (np.arange(Y.size) * np.abs(Y)) ** 2
        if power.sum() - power.max() < RICH * power.sum():
            return 0.0
        enough, of_noise = OTHER_PASS
        if other < enough * float(np.sum(np.abs(change) ** 2)) + of_noise * float(np.sum(noise + noise2)):
            return 0.0
        late, moved = self._most_alike(Y, Z)
        left = float(np.sum(np.abs(Z - moved) ** 2))
        return late if abs(late) >= LATE_BY and left < EXPLAINED * other else 0.0

    def _model(self, Z: ComplexArray, noise2: FloatArray) -> None:
        """The hysteresis as this pass shows it, and what it differs by from those that the law remembers."""
        about = {"few": self._few, "learned": self._learned, "periods": self.periods}
        others = [(volts, Y, noise) for volts, _, Y, noise in self._seen]
        made = identified(self.volts, Z, self._law.response, noise2, others=others, **about)
        self._hysteresis, before = finished(made), [one[1] for one in self._seen]
        again = [np.fft.rfft(finished(self._hysteresis.strain(one[0]))) for one in self._seen]
        self._law.output_again(before, again)
        self._seen = [(x, U, Y, noise) for (x, _, Y, noise), U in zip(self._seen, again, strict=True)]

    def _periods(self, measured: npt.ArrayLike | None) -> FloatArray | None:
        """As rows; None where the pass was missed."""
        if measured is None:
            return None
        z = checks.signal("measured", measured, "um", (1, 2))
        if not z.size or z.size % self.samples:
            bound = f"a whole number of periods of {self.samples} samples: the pass was cut short, repeat it"
            raise SettingError("measured", f"{z.size} samples", bound)
        z = np.where(np.isfinite(z), z, np.nan).reshape(-1, self.samples)
        return None if np.isnan(z).all(axis=0).any() else z

    def _refuse_clipped(self, z: FloatArray) -> None:
        """SettingError where the sensor is at the end of its range: the law would raise the voltage up to its limit."""
        volts, seen = np.tile(self.volts, len(z)), np.isfinite(z.ravel())
        z, volts, desired = z.ravel()[seen], volts[seen], np.tile(self.desired, len(z))[seen]
        crossed, band = CROSSED * float(np.ptp(self.volts)), WITHIN * noise(z)
        gain = float(np.std(z)) / max(float(np.std(volts)), TINY)
        noisy, _ = at_an_end(z, volts, desired, band, max(crossed * gain, GOES_ON[1] * band))
        cut = clipped(z, volts, crossed) | noisy
        if np.mean(cut) <= LIMITED:
            return
        end = float(np.median(z[cut]))
        share = figures(100 * float(np.mean(cut)), 2)
        value = f"{share} % of the samples at {figures(end, 4)} um, while the voltage goes on"
        bound = (
            f"of a sensor that goes beyond, for a motion of {figures(float(self.desired.min()))} to "
            f"{figures(float(self.desired.max()))} um: shift its range, or the motion (`offset`), or make it smaller"
        )
        raise SettingError("measured", value, bound)

    def _mean(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean of the periods, um, and variance of each harmonic of it: from one period to the next, without creep."""
        mean = np.nanmean(z, axis=0)
        lost = np.isnan(z)
        Z = np.fft.rfft(np.where(lost, mean, z), axis=1)
        if len(z) > 1:
            return mean, np.asarray(np.mean(np.abs(np.diff(Z, axis=0)) ** 2, axis=0) / (2 * len(z)))
        beyond = ~self._learned & (self._frequency > self.bandwidth)
        level = float(np.median(np.abs(Z[0, beyond]) ** 2)) / math.log(2) if beyond.any() else 0.0
        return mean, np.full(Z.shape[1], level)

    def _missed(self, why: str) -> Pass:
        nothing = np.empty(0)
        same = {"rmse": math.nan, "maximum": math.nan, "noise": math.nan}
        self._number += 1
        return Pass(
            number=self._number - 1,
            volts=self.volts,
            measured=nothing,
            error=nothing,
            expected=self._best[0],
            limited=self._held.share,
            limit=self._held.words,
            undone=f"This pass was missed, {why}: the same voltage comes again.",
            missed=why,
            **same,
        )

    def _scale(self, U: ComplexArray, Z: ComplexArray, noise2: FloatArray) -> None:
        """Correct the gain by the first pass."""
        found, moved = self._law.gain(U, Z), self._learned & (self._frequency > 0)
        low, high = GAINS
        rms, noise = (math.sqrt(2 * np.sum(one[moved])) / self.samples for one in (np.abs(Z) ** 2, noise2))
        span = float(np.ptp(self.desired))
        if abs(found) < low and rms <= SHOWN * noise + PERIODIC * span:
            seen = f"{round(rms / span, 9) * span:.2g} um rms, with a noise of {noise:.2g}"
            remedy = "look at the sensor, its cable and channel, and at the amplifier"
            raise SettingError("measured", seen, f"a motion of about {figures(span)} um: {remedy}")
        if not low <= found <= high and span <= SHOWN * noise:
            remedy = "move further, or measure more periods (`averaged`)"
            raise SettingError(SIZE, f"{figures(span)} um", f"above the noise of a pass, {noise:.2g} um: {remedy}")
        if not low <= found <= high:
            value = f"{self.gain:g} um/V, where the first pass shows {figures(found * self.gain)}"
            why = taken_for_um(found, "is the recording of this axis, and in um, and does it begin with its voltage?")
            bound = f"within ten times of it, and of its sign: {why}"
            raise SettingError("gain", value, bound)
        self._law.scale(found)

    # ---- What is known ---------------------------------------------------------------------------------------------

    @property
    def harmonics(self) -> tuple[FloatArray, BoolArray]:
        """Frequencies that are learned, Hz, without 0; and which entries of a Fourier transform of a period they are.

        The mask has an entry for each harmonic of `samples`, as `numpy.fft.rfft` has them.
        """
        learned = self._learned & (self._frequency > 0)
        return self._frequency[learned], learned

    @property
    def best(self) -> float:
        """Rmse of the best pass so far, um; NaN before the first one."""
        return self._best[0]

    @property
    def best_volts(self) -> FloatArray:
        """One period of the best pass, V, as it was output; `volts` before the first one."""
        return self._best[1] if self._best[1].size else self.volts

    def _display(self) -> tuple[str, Rows]:
        rows = [
            ("period", f"{self.samples} samples, {quantity(self.samples / self.sample_rate, 's')}"),
            ("bandwidth", quantity(self.bandwidth, "Hz")),
            ("harmonics", str(int(self._learned.sum()) - 1)),
            ("passes", str(self._number)),
            ("best rmse", quantity(self.best, "um")),
        ]
        return "IterativeLearning", rows


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Learned(Displayed):
    """What a series of passes has learned.

    Attributes
    ----------
    passes : tuple[Pass, ...]
        All of them, the first one without having learned.
    learning : IterativeLearning
        Goes on where they end.
    zero : float
        Reading of a sensor that was not zeroed, um, subtracted from all measurements; 0 of one that was.
    records : tuple of (ndarray, ndarray)
        Voltage, V, and measurement, um, of the first and the last two passes, periods that count: for a model.
    spring : str
        In a sentence, why measured dynamics were not used, and up to which frequency the stage is taken for a spring.
    """

    passes: tuple[Pass, ...]
    learning: IterativeLearning
    zero: float = 0.0
    records: tuple[tuple[FloatArray, FloatArray], ...] = ()
    spring: str = ""

    @property
    def best(self) -> Pass:
        """The pass with the smallest rmse."""
        return min((one for one in self.passes if one.measured.size), key=lambda one: one.rmse)

    @property
    def verdict(self) -> Verdict:
        """Good where the error is within 0.1 % of the motion, without what noise explains; bad where none improved.

        Bad is also an error above 10 % of the motion where a limit cuts off the waveform: no pass can lower it.
        Doubtful where it is not, or where the noise of a pass is too large to show it.
        """
        made = [one for one in self.passes if one.measured.size]
        best, findings, span = self.best, [], float(np.ptp(self.learning.desired))
        left = math.hypot(math.sqrt(max(0.0, best.rmse**2 - best.noise**2)), HELD * best.noise)
        if len(made) > 1 and best is made[0] and not at_the_noise(best):
            findings.append(("bad", "No pass was better than the first one: measure the dynamics again."))
        elif not at_the_noise(best, NEAR) and best.rmse > FINE * span:
            times = figures(best.rmse / best.noise) if best.noise else ""
            text = f"The error is {times} times the noise of a pass" if times else "It is not 0"
            findings.append(("doubtful", text + self._further([one.rmse for one in made])))
        elif min(best.rmse, left) > FINE * span:
            text = f"The noise of a pass is {100 * best.noise / span:.2g} % of the motion, {quantity(span, 'um')}, so"
            text += f" that no pass shows whether it was learned to {100 * FINE:g} %: measure more periods "
            text += "(`averaged`), wait for longer before them (`settle`), or move further."
            findings.append(("doubtful", text))
        cut = best.limited > LIMITED and best.rmse > SPOILT * span
        findings += [("bad" if cut and reason == best.limit else "doubtful", reason) for reason in best.verdict.reasons]
        late = bool(self.learning.dead_time)  # of a stage, not of a trigger
        if missed := [one for one in self.passes if one.missed][late:]:
            were = "was" if len(missed) == 1 else "were"
            why = "; ".join(dict.fromkeys(one.missed for one in missed))
            findings.append(("doubtful", f"{len(missed)} of {len(self.passes)} passes {were} missed: {why}."))
        return Verdict.of(findings)  # type: ignore[arg-type]

    def _further(self, errors: list[float]) -> str:
        """What more passes do, after those with these errors, um, and what helps: the end of a sentence, and others."""
        if self.best.limited > LIMITED:  # its own reason says why passes do not help
            return f".{self._beyond()}"
        if len(errors) > STOPPED and min(errors[-STOPPED:]) > SLOW * min(errors[:-STOPPED]):
            why = self._beyond() or (
                " Look for steps of the converter or the sensor, for friction, and for a stage that is another one in "
                "each pass, as one is that warms up."
            )
            return f", and has hardly fallen in the last {STOPPED} passes: more will not lower it.{why}"
        lower = self.best.expected < SLOW * self.best.rmse
        return f": more passes will {'lower' if lower else 'hardly lower'} it.{self._beyond()}"

    def _beyond(self) -> str:
        """A sentence where most of the error is in harmonics that are not learned."""
        power = 2 * np.abs(np.fft.rfft(self.best.error)) ** 2
        power[0] /= 2
        learned = self.learning.harmonics[1] | (np.arange(power.size) == 0)  # the mean creeps, and is followed
        if power[~learned].sum() < power[learned].sum():
            return ""
        rate, samples = self.learning.sample_rate, self.learning.samples
        most = np.argmax(np.where(learned, 0.0, power)) * rate / samples
        if most < self.learning.bandwidth:
            whole = rate / math.ceil(samples / self.learning.periods)
            return (
                f" Most of it is at {most:.4g} Hz, which is no harmonic of the motion, and is not learned: choose a "
                f"frequency whose period is a whole number of samples, such as {whole:.8g} Hz."
            )
        remedy = "choose a frequency whose harmonics meet no resonance, or longer turns (`turn` of a raster)"
        if self.learning.limited_to <= most <= SEEN * rate:
            remedy = f"raise `bandwidth`, with dynamics that are known so far, or {remedy}"
        return f" Most of it is at {most:.4g} Hz, beyond the bandwidth of {self.learning.bandwidth:.4g} Hz: {remedy}."

    def _display(self) -> tuple[str, Rows]:
        rows = [(f"pass {one.number}", quantity(one.rmse, "um"), one.undone) for one in self.passes]
        return f"Learned: {self.verdict.level}, rmse {quantity(self.best.rmse, 'um')}", rows


def at_the_noise(one: Pass, times: float = 1.0) -> bool:
    """Whether the error of a pass is hardly more than its noise, or `times` of it."""
    return bool(one.rmse**2 < (times**2 + ABOVE) * one.noise**2)


def _spikes(z: FloatArray) -> BoolArray:
    """Which samples of the periods, as rows, are not those of the others at their place; none of fewer than five.

    Deviations are from the median of the periods, without that of each period, which creeps.

    >>> z = np.tile([0.0, 1.0, 2.0, 1.0], (10, 1)) + 0.01 * np.sin(np.arange(40.0)).reshape(10, 4)
    >>> z[3, 2] += 1.0
    >>> np.argwhere(_spikes(z)).tolist()
    [[3, 2]]
    """
    none = np.zeros(z.shape, dtype=bool)
    if len(z) < FEWEST_PERIODS:
        return none
    off = z - np.nanmedian(z, axis=0)
    off -= np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else 0.0 for row in off])[:, np.newaxis]
    size = np.abs(off)
    far = size > SPIKE * float(np.nanmedian(size))
    whole = (far | np.isnan(z)).all(axis=0).any()  # no sample would be there
    return none if whole or np.mean(far) > MOST_SPIKES or not np.nanmedian(size) > 0 else far


# ---- The motion ----------------------------------------------------------------------------------------------------


def one_period(
    motion: Trajectory | npt.ArrayLike, sample_rate: float | None
) -> tuple[FloatArray, BoolArray, float, int]:
    """One repetition of whole samples, um; where errors count; sample rate, Hz; and how many periods it is."""
    if not isinstance(motion, Trajectory):
        wave = checks.finite_array("motion", motion, "um")
        if wave.size < 4:
            raise SettingError("motion", f"array of {wave.size} samples", "a period of at least 4")
        _moves(wave)
        if sample_rate is None:
            raise SettingError("sample_rate", None, "that of the array of one period, a number", "Hz")
        return wave, np.ones(wave.size, dtype=bool), checks.positive("sample_rate", sample_rate, "Hz"), 1
    rate, frequency = motion.sample_rate, motion.settings.get("frequency")
    if sample_rate is not None and sample_rate != rate:
        raise SettingError("sample_rate", sample_rate, f"that of the trajectory, {rate:g} Hz, or left out", "Hz")
    if not isinstance(frequency, (int, float)):
        bound = "a motion that repeats, such as a sine, a triangle or a raster, or one period of it as an array"
        raise SettingError("motion", f"a {motion.name}", bound)
    samples, periods = repetition(rate, float(frequency))
    ramp = motion.settings.get("ramp", 0.0)
    start = math.ceil((ramp if isinstance(ramp, (int, float)) else 0.0) * rate / samples) * samples
    if start + samples > motion.position.size:
        bound = f"at least {(start + samples) / rate:.4g} s: one repetition of {samples} samples after the ramp"
        raise SettingError("duration of the motion", motion.duration, bound, "s")
    wave = motion.position[start : start + samples]
    _moves(wave)
    later = motion.position[start + samples : start + 2 * samples]
    if np.abs(later - wave[: later.size]).max(initial=0.0) > PERIODIC * np.ptp(wave):
        raise SettingError("motion", f"a {motion.name} that is another in its next period", "a motion that repeats")
    counts = np.ones(samples, dtype=bool) if motion.flat is None else motion.flat[start : start + samples]
    return wave, counts, rate, periods


def check_motion(motion: Trajectory | npt.ArrayLike, sample_rate: float | None, resonance: float = 0.0) -> float:
    """The sample rate of a motion that repeats, Hz; refuses one that no stage of this first resonance, Hz, learns.

    0 is a resonance that is not known.

    >>> check_motion(np.sin(np.pi / 2 * np.arange(4)), 10_000.0, resonance=900.0)
    Traceback (most recent call last):
        ...
    truestroke.SettingError: frequency of the motion = 2500.0 Hz: must be at most 2160 Hz, 2.4 times the first resonance
    """
    wave, _, rate, periods = one_period(motion, sample_rate)
    if resonance:
        _check_band(periods * rate / wave.size, BAND * resonance)
    return rate


def least_slew(motion: Trajectory | npt.ArrayLike, sample_rate: float | None, gain: float) -> tuple[float, float]:
    """Slew of a spring of this gain, um/V, where the error counts, V/s; and the frequency of the motion, Hz.

    >>> fastest, frequency = least_slew(5.0 * np.sin(2 * np.pi * np.arange(200) / 200), 10_000.0, gain=10.0)
    >>> round(fastest), frequency
    (157, 50.0)
    """
    wave, counts, rate, periods = one_period(motion, sample_rate)
    steps = np.abs(np.diff(wave, append=wave[:1]))[counts]
    return float(steps.max(initial=0.0)) * rate / gain, periods * rate / wave.size


def _check_band(frequency: float, highest: float) -> None:
    if highest < frequency:
        bound = f"at most {highest:.4g} Hz, {BAND} times the first resonance"
        raise SettingError(FREQUENCY_OF, frequency, bound, "Hz")


def _moves(wave: FloatArray) -> None:
    if not np.ptp(wave):
        raise SettingError(SIZE, 0.0, "above 0 um: a motion that rests has nothing to learn", "um")


def repetition(sample_rate: float, frequency: float) -> tuple[int, int]:
    """Samples of the shortest repetition that takes a whole number of them, and how many periods it has.

    Parameters
    ----------
    sample_rate, frequency : float
        Hz; the frequency is that of the motion.

    Raises
    ------
    SettingError
        No 200 periods or fewer take a whole number of samples, or the frequency is above 0.45 of the sample rate.

    Examples
    --------
    >>> repetition(10_000.0, 50.0), repetition(10_000.0, 97.0)
    ((200, 1), (10000, 97))
    """
    rate = checks.positive("sample_rate", sample_rate, "Hz")
    checks.positive("frequency", frequency, "Hz")
    if frequency > SEEN * rate:
        bound = f"at most {SEEN * rate:.4g} Hz, {SEEN} of the sample rate"
        raise SettingError(FREQUENCY_OF, frequency, bound, "Hz")
    for periods in range(1, REPETITIONS + 1):
        samples = periods * rate / frequency
        if abs(samples - round(samples)) < WHOLE * samples / 100:
            return round(samples), periods
    near = rate / max(round(rate / frequency), math.ceil(1 / SEEN))
    bound = f"one whose period is a whole number of samples, such as {near:.8g} Hz at {rate:g} Hz"
    raise SettingError(FREQUENCY_OF, frequency, bound, "Hz")


# ---- What is known beforehand --------------------------------------------------------------------------------------


def band(dynamics: Dynamics | None, rate: float) -> float:
    """Highest harmonic that is learned by itself, Hz."""
    seen = SEEN * rate
    return seen if dynamics is None else min(BAND * dynamics.modes[0].frequency, seen)


def response_of(
    dynamics: Dynamics | None, f: FloatArray, rate: float, gain: float
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """From V to the measurement, um/V; from displacement to measurement; variance of the ratio of true to given."""
    late = np.abs(np.exp(-2j * np.pi * f * LATE / rate) - 1) ** 2
    if dynamics is None:
        ones = np.ones(f.size, dtype=np.complex128)
        return gain * ones, ones, np.minimum(GAIN**2 + late, UNSURE)
    G = dynamics.response(f, sensor=True)
    sensor = G / dynamics.response(f)
    variance = GAIN**2 + late
    s = 2j * np.pi * f
    whole = sum(mode.response(s) for mode in dynamics.modes)
    for i, mode in enumerate(dynamics.modes):
        own = dynamics.uncertainty.get(f"frequency[{i}]", 0.0) / mode.frequency
        moved = math.hypot(FREQUENCY, own)
        for frequency, damping, share in ((1 + moved, 1.0, 0.5), (1 - moved, 1.0, 0.5), (1.0, 1 + DAMPING, 1.0)):
            other = replace(mode, frequency=frequency * mode.frequency, damping=min(damping * mode.damping, 0.99))
            variance = variance + share * np.abs((other.response(s) - mode.response(s)) / whole) ** 2
    return gain * G, sensor, np.minimum(variance, UNSURE)
