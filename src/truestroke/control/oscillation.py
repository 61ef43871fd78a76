"""Self-excited oscillation: its detection in the error, half-wave by half-wave."""

import math
from dataclasses import dataclass

FASTER = 2.5  # times as fast as the motion: a slower ringing is its error
WITHOUT_FIRST = 7  # half-waves of an oscillation that grows: six without the first, which may not be whole
COLD = 0.2  # s: with the first covariance an oscillation grows fivefold in a half-wave
LONGEST_GAP = 1 << 20  # ticks that count as missed at the most: TS_LONGEST_GAP of the kernel
HALF_WAVES = 12  # that are kept: TS_HALF_WAVES of the kernel


@dataclass(frozen=True, kw_only=True)
class OscillationSettings:
    """Settings of `OscillationDetector`: ts_oscillation_settings of the kernel.

    Attributes
    ----------
    tick : float
        Length of a tick, s; 0: the detector is off.
    corner : float
        Highest frequency that is detected, cycles per tick.
    fast, slow : float
        Coefficients of the poles between which the error passes, per tick, 0 to 1.
    motion_rate : float
        How fast the means of the motion follow, per tick, 0 to 1.
    noise_share : float
        Three standard deviations of the noise between the poles, in those of a measurement.
    floor, large : float
        Peak below which an oscillation is ignored, and above which it need not grow, um.
    """

    tick: float
    corner: float
    fast: float
    slow: float
    motion_rate: float
    noise_share: float
    floor: float
    large: float


class OscillationDetector:
    """Finds an oscillation of the error that grows, faster than the motion and below the corner of the law's filter.

    Then the law excites a resonance of the stage: because of its phase there the correction increases the error. The
    error passes a band: one pole against noise, two against the error of the motion. Half-waves are of about one length
    where one takes at most one and a half times the time of the other. An oscillation grows where

    - of six half-waves in a row, and one before them, the last peak is 1.8 times the first one of the six, and none is
      below 3/4 of the one before it;
    - or, below a third of the corner, where there is no time for six: three peaks grow by 1.5 each, or the half-wave
      that goes on is already far larger than two before it, or, in the first 0.2 s, than one, and no jump; while
      nothing was `learned`, that is so above a third of the corner, too, but for the single one;
    - or twelve are large and do not decay.

    Hum is as large from its first half-wave on, and the error of a motion makes one of them larger. So the peaks before
    the last one have to be larger than those before them, too.

    It begins small, unlike the error of a sensor failure: the first of these peaks is below a tenth of the stroke, and
    the slow part of the error below a fifth. It is one of the stage where its frequency is above 2.5 times that of the
    motion, mean |change of zdot_d| / (2 pi mean |zdot_d|), and it is at least half as fast as the motion. After one was
    `found`, only six half-waves that grow threefold, or twelve, are another.

    Parameters
    ----------
    settings : OscillationSettings
        Frequencies and sizes.

    Attributes
    ----------
    found : bool
        Whether one was found before; set by the caller that reacts to it.

    Examples
    --------
    >>> tick = 1 / 2000
    >>> settings = OscillationSettings(tick=tick, corner=0.17, fast=0.6, slow=0.05, motion_rate=0.005, noise_share=2.0,
    ...                                floor=0.1, large=0.6)
    >>> detector = OscillationDetector(settings)
    >>> for k in range(2000):
    ...     error = 0.01 * math.exp(20 * k * tick) * math.sin(2 * math.pi * 100 * k * tick)
    ...     if frequency := detector.update(error, 0.0, 0.01):
    ...         break
    >>> round(frequency / tick), round(k * tick, 2)
    (101, 0.21)
    """

    def __init__(self, settings: OscillationSettings) -> None:
        self.settings = settings
        self.fast = self.slow = self.slower = self.h = 0.0  # um: after the poles, and between them
        self.error = 0.0  # um: of the tick before
        self.time = 0.0  # s: since the start
        self.speed = self.acceleration = self.zdot_d = 0.0  # um/s
        self.peak = self.steepest = 0.0  # um, um per tick: of this half-wave so far
        self.peaks, self.lengths = [0.0] * HALF_WAVES, [0] * HALF_WAVES  # um, ticks: of those before it, newest first
        self.sign = self.length = 0  # of this half-wave; sign 0: none has begun
        self.regular = 0  # half-waves before it of about one length
        self.missed = 0  # ticks before this one of which there is no error
        self.started = self.found = False

    def update(self, error: float, zdot_d: float, noise: float, *, learned: bool = True) -> float:
        """One tick: error, um, desired velocity, um/s, standard deviation of a measurement, um.

        `learned`: weights were good before. Returns the frequency of an oscillation that grows, cycles per tick, or 0.
        """
        s = self.settings
        if not self.started:
            self.started, self.fast, self.slow, self.zdot_d = True, error, error, zdot_d
        self._follow_motion(zdot_d)
        self.error = error
        if self.time < COLD:
            self.time += self.settings.tick * (1 + self.missed)
        self.fast += s.fast * (error - self.fast)
        self.slow += s.slow * (self.fast - self.slow)
        self.slower += s.slow * (self.fast - self.slow - self.slower)
        threshold = max(s.noise_share * noise, s.floor / 3)
        ended = self._follow_half_waves(self.fast - self.slow - self.slower, threshold)
        n = self._grows() if ended else self._grows_fast() if self.sign and not self.found else 0
        peak = self.peaks[0] if ended else self.peak
        if n == 0 or not peak > s.floor:
            return 0.0
        if self.peaks[n - 1] > 5 * s.large or abs(self.slow) > 10 * s.large:  # it begins small and on the way
            return 0.0
        frequency = self.frequency(n)
        if n < (6 if learned else 2) and 3 * frequency > s.corner:
            return 0.0
        return frequency if self._is_of_the_stage(frequency, peak) else 0.0

    def miss(self, error: float | None) -> None:
        """A tick without a measurement (None), or the error of one that was rejected: it is checked for a jump only."""
        self.missed = min(self.missed + 1, LONGEST_GAP)
        if error is not None:
            self.steepest = max(self.steepest, self.settings.fast * abs(error - self.error))
            self.error = error

    def frequency(self, n: int) -> float:
        """Cycles per tick of the last n half-waves."""
        return n / (2 * float(sum(self.lengths[:n])))

    def _follow_motion(self, zdot_d: float) -> None:
        rate, change = self.settings.motion_rate, abs(zdot_d - self.zdot_d)
        self.speed += rate * (abs(zdot_d) - self.speed)
        self.acceleration += rate * (change - self.acceleration)
        self.zdot_d = zdot_d

    def _follow_half_waves(self, h: float, threshold: float) -> bool:
        """Whether a half-wave has ended in this tick; those before it are kept."""
        size, step = abs(h), abs(h - self.h) / (1 + self.missed)
        ended = h < -threshold if self.sign > 0 else self.sign < 0 and h > threshold
        self.h = h
        self.length += 1 + self.missed if self.length < 2**31 // 2 - 1 else 0
        self.missed = 0
        if ended:
            self._keep_half_wave()
        if ended or (not self.sign and size > threshold):
            self.sign, self.peak, self.steepest, self.length = (1 if h > 0 else -1), size, step, 0
        elif self.sign and self.length > 10 / self.settings.corner:
            self.sign = self.regular = 0
        else:
            if size > self.peak and (h > 0) == (self.sign > 0):
                self.peak = size
            self.steepest = max(self.steepest, step)
        return ended

    def _keep_half_wave(self) -> None:
        shorter, longer = sorted((self.length, self.lengths[0]))
        regular = self.regular > 0 and longer <= 1.5 * shorter + 1
        self.peaks = [self.peak, *self.peaks[:-1]]
        self.lengths = [self.length, *self.lengths[:-1]]
        self.regular = min(self.regular + 1, HALF_WAVES) if regular else 1

    def _grows_fast(self) -> int:
        """How many half-waves show an oscillation that cannot wait for the end of this one; 0: none do."""
        A = self.peaks
        if self.regular >= 2 and self.peak > 2 * A[0] and self._exceeds(0, 1.5, 1, 6):
            return 2
        if self.regular < 1 or not self.time < COLD:
            return 0
        speed = math.pi * self.peak / (self.lengths[0] * self.settings.tick)
        wave = self.steepest * self.lengths[0] < 5 * self.peak and 4 * self.length > self.lengths[0]  # no jump
        grows = self.peak > 2.5 * A[0] and self._exceeds(0, 1.1, 1, 6)
        return 1 if wave and grows and speed > max(2 * self.speed, abs(self.zdot_d)) else 0

    def _exceeds(self, i: int, factor: float, begin: int, end: int) -> bool:
        """Whether half-wave i is so many times as large as each of those from `begin` to before `end`.

        An oscillation of the loop has grown up to there; hum has been as large from its first half-wave on.
        """
        return all(self.peaks[i] >= factor * peak for peak in self.peaks[begin:end])

    def _grows(self) -> int:
        """How many of the half-waves that have ended show an oscillation that grows, or is large and does not decay."""
        A, n = self.peaks, self.regular
        three = not self.found and n >= 3 and A[0] >= 1.5 * A[1] and A[1] >= 1.5 * A[2]
        if three and self._exceeds(1, 1.2, 2, 6):
            return 3
        steady = all(A[i] >= 0.75 * A[i + 1] for i in range(5))
        steady = steady and self._exceeds(1, 1.2, 5, min(n, 8)) and self._exceeds(2, 1.1, 5, 6)
        if n >= (6 if self.found else WITHOUT_FIRST) and A[0] >= (3 if self.found else 1.8) * A[5] and steady:
            return 6
        return HALF_WAVES if n >= HALF_WAVES and A[0] > self.settings.large and A[0] >= A[-1] else 0

    def is_fast(self, frequency: float) -> bool:
        """Whether a ringing of this frequency, cycles per tick, is faster than the motion."""
        return 2 * math.pi * frequency * self.speed >= FASTER * self.acceleration

    def _is_of_the_stage(self, frequency: float, peak: float) -> bool:
        large = 2 * math.pi * frequency * peak / self.settings.tick > 0.5 * self.speed
        return frequency < self.settings.corner and self.is_fast(frequency) and large
