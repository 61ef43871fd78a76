"""The first resonance from what is measured anyway: least squares of the stage's equation in a band about it."""

import math
from typing import NamedTuple

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.angles import arctangent, tangent
from truestroke.control.tone import OF_LOAD, OFF_HARMONIC_OF_STAGE, ORDERS_OF_STAGE, STEADY_TONE, ToneDetector

SHOWN = 7  # plays that stand for the hysteresis: TS_SHOWN of the kernel
BAND, HIGH, THIRD, LOW = range(SHOWN, SHOWN + 4)  # of the measurement: places behind the plays
SEARCH_FROM = 0.15  # cycles per tick: where the search begins,
SEARCH_TO = 40  # Hz: where it ends,
OF_MOTION = 2  # or at so many times the motion's frequency,
AGAIN_FROM = 0.36  # cycles per tick: and where every second one begins after that;
HIGHEST = 0.4  # the highest resonance
NEXT = 0.6  # of a centre: the next one, where there was no resonance
POINTS = 0.05  # standard deviation of an estimate, over it, that says where the next window is,
MOST_POINTED = 3  # and so many of these between two that show a resonance, or in a search
PASSES = 0.35  # of the centre: corner of the filter that takes the motion away
SHARP = 1.4  # twice the damping of that filter,
ROUND = 1  # and of the one behind it, which takes noise away
SETTLED_IN = 3  # periods of the centre until both have settled,
WINDOW = 20  # and of a window,
SHORTEST = 0.06  # s: but no shorter,
SUDDEN = 4  # times the mean square of a burst: an error with which one begins
QUIET = 25  # times the mean square at rest is less than that of a burst
LONGEST = 1e8  # ticks: and no longer
RIDGE = 1e-4  # of the largest of the plays: how well each of them is known before
LAG_STEPS = 4  # of Newton's method: enough for a lag up to 1 / w0
COARSE = 4  # plays, those of the smallest thresholds, with which the resonance is found once more
COSTS = 0.5  # of the range: the error of a stage that is wrong by itself, in a motion as fast as it is
SHOWS = 0.5  # of the error of plays alone: a resonance leaves less
RINGS_ALONE = 0.45  # and what rings without our voltage: white noise leaves 0.48 to 0.65
NEAREST, FURTHEST = 0.6, 1.4  # of the centre: bounds of an estimate in that window
AGREE = 1.05  # centre and estimate
SURE, TRUST = 0.02, 5  # standard deviation of an estimate, over it, and how many of these its error is,
SURE_EXPECTED, TRUST_EXPECTED = 0.03, 3  # where the weights of the plays are expected
ABOUT = 0.04  # that of one about its centre, where no stage is in the model,
EXPLAIN = 0.5  # and the share of the plays there: what our voltage does not drive is noise
DRIVEN_ALONE = 0.95  # that of a resonance that is not a load which the command answers: TS_DRIVEN_ALONE of the kernel
EXPECTED = 0.1  # of the gain of all plays: how far a weight is from the one that is expected,
EXPECTS = 5  # where the error of a window is so many times its residual
SAME = 0.05  # of what a load shows: what is known so near to it was of the load, too
STANDS = 0.1  # of a resonance that is shown so, or about its centre: where fewer plays move it further there is none
LEAST = 0.005  # the smallest error of an estimate, over it
LEAST_IN_BURST = 0.01  # that of one that need not be near its centre, in a burst
WALK = 0.002  # how far the resonance moves in a window
OF_FOURTH = 6.675  # mean magnitude of the fourth difference of white noise, over its standard deviation
HALVINGS = 12  # of the noise of a measurement, until what is measured has it,
CORRECTED = 0.5  # and of how far that moves the resonance: what counts as an error
JUMPS = 3  # standard deviations of a difference
MOST = 1000  # windows that are counted


def shown(play: FloatArray) -> FloatArray:
    """The play states that stand for the hysteresis, shape (7,), V."""
    return play[[(i * (play.size - 1) + (SHOWN - 1) // 2) // (SHOWN - 1) for i in range(SHOWN)]]


_Coefficients = tuple[float, float, float]


class _Window(NamedTuple):
    """What a window shows."""

    f0: float = 0.0  # cycles per tick; 0: none
    variance: float = 0.0  # square of its error, over it
    lag: float = 0.0
    first_order: float = 0.0
    sensitivity: float = 0.0
    left: float = 0.0  # sum of squares of the residual
    points: float = 0.0  # cycles per tick: to a resonance that is further away or less certain; 0: to none


class _Filter:
    """A second-order filter in the form of two integrators, of several signals at once."""

    def __init__(self, frequency: float, k: float) -> None:
        g = tangent(math.pi * frequency)
        self.a = 1 / (1 + g * (g + k))
        self.b = g * self.a
        self.c = g * self.b
        self.first, self.second = np.zeros(SHOWN + 2), np.zeros(SHOWN + 2)

    def update(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Band and low pass; the high pass is x - k band - low."""
        v = x - self.second
        band = self.a * self.first + self.b * v
        low = self.second + self.b * self.first + self.c * v
        self.first, self.second = 2 * band - self.first, 2 * low - self.second
        return band, low


class _Pole:
    """A first-order low pass in the form of an integrator, of several signals at once."""

    def __init__(self, frequency: float, signals: int) -> None:
        g = tangent(math.pi * frequency)
        self.share = g / (1 + g)
        self.state = np.zeros(signals)

    def update(self, x: FloatArray) -> FloatArray:
        v = self.share * (x - self.state)
        low = self.state + v
        self.state = low + v
        return low


class ResonanceEstimator:
    """Finds the first resonance f0 of a stage in a loop, and follows it.

    The stage is (1 + t d/dt) (z + c1 z' + c2 z'') = h, c2 = 1 / w0^2, with the strain h of the hysteresis and a lag t
    of amplifier and dead time. Seven plays are h::

        F z = sum of w_i F p_i - (c1 + t) F z' - (c2 + t c1) F z'' - t c2 F z'''

    F is a band of an octave and a half about a `centre`, so that neither the motion below nor the noise above decide.
    A window of 20 periods, at least 60 ms, gives them all by least squares. A resonance shows where the derivatives
    leave less than half of the error of the plays alone, c2 is known within 4 % and f0 is near the centre; the next
    centre is that f0, also where it is further away, or c2 known within 10 %, three times in a row at most. Otherwise
    it is 0.6 times as high, from 0.15 of the sample rate down to 40 Hz or twice the frequency of the motion, and then,
    in turns, from there again and from 0.36 of the sample rate on.

    Until a stage is in the model, an estimate about its centre counts where c2 is known within 8 %, if four of the
    plays show it within 10 %, too, and the plays explain half of what ringing alone does not. Each second window of a
    search is about what is known then, where anything is.

    What the windows show becomes `known`, by a scalar Kalman filter. A model of hysteresis that is not right shifts an
    estimate by more than its noise: five times its deviation and 0.5 % count. Where five times the deviation is below
    0.5 %, one window is enough, wherever its centre was. Two windows in a row beyond three deviations of what is known
    are a jump.

    A sine has two or three harmonics in such a band, too few for seven plays and a stage. A window that shows nothing
    is looked at once more with the weights that are `expected` of the plays: each within a tenth of the gain of all,
    if the residual of free plays is a fifth of what the model misses. Then 3 % and three deviations count, and four of
    the plays may not show a resonance that is more than 10 % away.

    In a burst, an error beyond `burst`, 20 periods are a window, an estimate that is known within 1 % need not be near
    the centre, and a window of a low frequency gives way to the first of the search. At rest, where nothing moves and
    the error is small, the search stays where it is.

    A load from outside is a steady tone in the error (`truestroke.control.tone`), and meets any equation of ringing
    without damping. What a window shows within 35 % of one is no resonance.

    With four of the seven plays the same window shows another f0. By how much is its sensitivity: where a stage that is
    wrong by so much would leave a larger error in the motion than there is, the window shows nothing.

    Attributes
    ----------
    known, variance : float
        f0, cycles per tick, 0 where it is not known, and its relative variance.
    lag, first_order : float
        Ticks of a dead time that turns f0 as far as the lag t does, arctan(w0 t) / w0, where f0 is known; and t.
    driven : float
        In the last window that showed a resonance: the share that the plays explain of the residual of an equation
        without them. A tone that the voltage does not drive has a small one.
    sensitivity : float
        In the same window: how far fewer plays move the resonance, over it, at most 1.
    windows : int
        That made it known.
    motion, power : float
        Of the last window: frequency of the motion, cycles per tick; mean square of the error, um^2.
    load, load_at : float
        Amplitude, um, and frequency, cycles per tick, of a `load` that a window has seen, no larger than the error
        allows; 0: of none.
    ticks : int
        Of the present window; 0: it begins anew.

    Examples
    --------
    A stage of 150 Hz behind the hysteresis of two plays, without noise:

    >>> from truestroke.control.stage import Stage, found
    >>> tick, estimator = 1 / 2000, ResonanceEstimator()
    >>> stage, play, r = Stage(found(150 * tick, tick), 1), np.zeros(2), np.array([0.0, 1.0])
    >>> for k in range(2000):
    ...     volts = 2 * math.sin(2 * math.pi * 20 * k * tick)
    ...     play = np.maximum(volts - r, np.minimum(volts + r, play))
    ...     stage.strain[k] = float(play @ [5.0, 2.0])
    ...     z = stage.expected()
    ...     _ = stage.notched(z)
    ...     changed = estimator.update(tick, shown(play), z, 0.0, 0.0, 0.0)
    >>> round(estimator.known / tick), estimator.windows > 2
    (149, True)
    """

    def __init__(self) -> None:
        self.centre = self.known = self.variance = self.lag = self.first_order = self.motion = self.power = 0.0
        self.driven = self.sensitivity = self.load = self.load_at = 0.0
        self.ticks = self.windows = 0
        self._pointed = 0  # windows that pointed elsewhere since one showed a resonance, or since the search began
        self._speed = self._change = self._error = 0.0  # sums of a window
        self._tone = ToneDetector(SEARCH_FROM)
        self._strange = False  # the last window was far from what is known
        self._again = False  # the next search begins above
        self._swept = 0.0  # where the search goes on behind a window about what is known; 0: about that

    def lowest(self, tick: float) -> float:
        """Where the search ends, cycles per tick: 40 Hz, or twice the frequency of the motion. tick: s."""
        return max(SEARCH_TO * tick, OF_MOTION * self.motion)

    def look(self, frequency: float) -> None:
        """The next window is about this frequency, cycles per tick, where it is one of the search.

        One that is about it already goes on: an oscillation that comes again and again would end each of them.
        """
        if 0 < frequency < HIGHEST and not self._is_about(frequency):
            self.centre, self.ticks = frequency, 0

    def _is_about(self, frequency: float) -> bool:
        """Whether a window about this frequency is the present one."""
        return self.centre < AGREE * frequency and frequency < AGREE * self.centre

    @property
    def suffices(self) -> bool:
        """Whether there were enough windows: two, or one that is as sure as any can be."""
        return self.windows > 1 or (self.windows > 0 and self.variance < 2 * LEAST * LEAST)

    @property
    def window(self) -> int:
        """Ticks of the window that has just ended."""
        return self._window

    @property
    def ringing(self) -> float:
        """What inertia and damping explain beside the plays, in the band of the window that has just ended, um^2.

        0 of what may be noise: the plays do not drive it, and inertia and damping explain no more of it than of that.
        """
        N = self._sums()
        if not _eliminate(N, 0, BAND):
            return 0.0
        plays = N[LOW][LOW]
        if not _eliminate(N, BAND, LOW) or not (self.driven > EXPLAIN or N[LOW][LOW] < RINGS_ALONE * plays):
            return 0.0
        return (plays - N[LOW][LOW]) / self._window

    def update(
        self,
        tick: float,
        plays: FloatArray,
        z: float,
        error: float,
        zdot_d: float,
        change: float,
        span: float = 0.0,
        highest: float = HIGHEST,
        burst: float = 0.0,
        expected: FloatArray | None = None,
        powers: tuple[float, float, float] = (0.0, math.inf, 0.0),
        steady: float = STEADY_TONE,
        driven: float = 1.0,
    ) -> bool:
        """One tick; returns whether a window has ended that adds to what is known.

        Parameters
        ----------
        tick : float
            Its length, s.
        plays : ndarray, shape (7,)
            Play states, V, a dead time before the measurement.
        z, error : float
            The measurement, and how far it is from the desired displacement, um.
        zdot_d, change : float
            Desired velocity, and its change in the tick, um/s.
        span : float
            Range of a motion that is followed well enough to lose by a stage that is wrong, um, or 0.
        highest : float
            Cycles per tick: a resonance above it is not the first.
        burst : float
            Mean square of an error for which the estimate makes haste, um^2; 0: for none.
        expected : ndarray, shape (7,), optional
            Weights of the plays, um/V; they are read in the tick that `ends` the window.
        powers : tuple of float
            Mean squares, um^2: of an error below which nothing is shown; of one from which on a tone is no load; of the
            noise of a measurement, at most.
        steady : float
            Of the square of a block: from which share on a tone is a load.
        driven : float
            Of the plays: from which share on, in less than two periods of the motion, a tone is no load; 1: never.
        """
        if self._begins_to_burst(tick, error, burst):
            self.centre, self.ticks, self._pointed = SEARCH_FROM, 0, 0
        last = self._suffices_in_burst(burst)
        x = np.append(plays, z)
        if self.ticks == 0:
            self._begin(tick, x)
        self._count(x, error)
        self._tone.update(error, zdot_d)
        self._speed += abs(zdot_d)
        self._change += abs(change)
        self.ticks += 1
        if last:
            self._window = self.ticks - self._settling
        ended = self.ticks >= self._settling + self._window
        return ended and self._end(tick, span, highest, burst, expected, powers, steady, driven)

    def ends(self, above: float, below: float) -> bool:
        """Whether the next tick ends a window whose mean square error is between these, um^2."""
        last = self.ticks > 0 and self.ticks + 1 >= self._settling + self._window
        return last and above * self._window < self._error < below * self._window

    def _begins_to_burst(self, tick: float, error: float, burst: float) -> bool:
        """Whether the error has become that of a burst in a window that lasts too long to wait for."""
        if not (self.ticks > 0 and burst > 0):
            return False
        counted = self.ticks - self._settling
        now = counted > 0 and error * error > SUDDEN * burst and self._error < burst * counted
        return now and WINDOW / self.centre - counted > SHORTEST / tick

    def _suffices_in_burst(self, burst: float) -> bool:
        """Whether the window has the periods that it needs, in a burst, which does not let it wait for more."""
        if not (self.ticks > 0 and burst > 0):
            return False
        counted = self.ticks - self._settling
        return counted * self.centre > WINDOW and self._error > burst * counted

    def _begin(self, tick: float, x: FloatArray) -> None:
        if not self.centre > 0:
            self.centre = SEARCH_FROM
        self._settling = int(min(SETTLED_IN / self.centre, LONGEST))
        self._window = int(min(max(WINDOW / self.centre, SHORTEST / tick), LONGEST))
        self._motion_filter, self._noise_filter = _Filter(PASSES * self.centre, SHARP), _Filter(self.centre, ROUND)
        self._pole = _Pole(self.centre, SHOWN + 6)
        self._first, self._sum = x, np.zeros((LOW + 1, LOW + 1))
        self._of_noise = np.zeros((4, 4))  # products of what is measured, for each sample of white noise of 1 um
        self._speed = self._change = self._error = self._fourth = 0.0
        self._before = [0.0] * 4  # measurements, less the first
        self._tone = ToneDetector(self.centre)

    def _count(self, x: FloatArray, error: float) -> None:
        x = np.concatenate([x - self._first, [1.0 if self.ticks == 0 else 0.0]])  # and a single sample
        z, before = float(x[SHOWN]), self._before
        fourth = z - 4 * before[0] + 6 * before[1] - 4 * before[2] + before[3]
        self._before = [z, *before[:3]]
        band, low = self._motion_filter.update(x)
        high = x - SHARP * band - low
        band, low = self._noise_filter.update(high)
        above = (high - ROUND * band - low)[SHOWN:]
        passed = self._pole.update(np.concatenate([low[:SHOWN], band[SHOWN:], above, low[SHOWN:]]))
        plays, measured = passed[:SHOWN], passed[SHOWN:].reshape(3, 2)
        first, second, itself = measured
        of_both = np.array([first, second, above - second, itself])
        if self.ticks < self._settling:  # what noise makes of the products is over when the band has settled
            self._of_noise = self._of_noise + np.outer(of_both[:, 1], of_both[:, 1])
            return
        v = np.concatenate([plays, of_both[:, 0]])
        self._sum = self._sum + np.outer(v, v)
        self._error += error * error
        self._fourth += abs(fourth)

    def _end(
        self,
        tick: float,
        span: float,
        highest: float,
        burst: float,
        expected: FloatArray | None,
        powers: tuple[float, float, float],
        steady: float,
        driven: float,
    ) -> bool:
        self.motion = self._change / (2 * math.pi * self._speed) if self._speed > 0 else 0.0
        self.power = self._error / self._window
        lowest = self.lowest(tick)
        window = self._shown(lowest, expected, burst > 0 and self._speed > 0, powers[2])
        if window.f0 > 0:
            fast = self.motion / window.f0
            cost = COSTS * span * window.sensitivity * (fast * fast)
            window = window._replace(f0=0.0) if self.power < cost * cost or window.f0 > highest else window
        window = self._passed_over_load(window, powers[1], steady, driven)
        if self.power < powers[0]:
            window = window._replace(f0=0.0, points=0.0)
        least = LEAST_IN_BURST if burst > 0 and self.power > burst else LEAST
        near = window.f0 > 0 and (self._is_about(window.f0) or window.variance < least * least)
        self.centre = self._next(window, lowest, highest, burst)
        self.ticks = 0
        if near:
            self._know(window)
        return near

    def _passed_over_load(self, window: _Window, loudest: float, steady: float, driven: float) -> _Window:
        """What a window shows that may see a load: near to that, or pointing to it, it is no resonance.

        In less than two periods of the motion its harmonics are not known, and what rings at one of them looks like a
        load: it is the resonance where the plays explain more than this share of it.
        """
        load, amplitude = self._tone.shown(steady, ORDERS_OF_STAGE, OFF_HARMONIC_OF_STAGE), self._tone.amplitude
        self.load = min(self.load, math.sqrt(2 * self.power))
        if not load > 0 or not self.power < loudest:
            return window
        near = abs(window.f0 / load - 1) < OF_LOAD
        if near and self.driven > driven and not self._tone.knows_motion:
            return window
        self.load, self.load_at = max(self.load, amplitude), load
        shown = window.f0 if window.f0 > 0 else window.points
        if not abs(shown / load - 1) < OF_LOAD:
            return window
        if self.known > 0 and abs(shown / self.known - 1) < SAME:
            self.known, self.windows = 0.0, 0
        return window._replace(f0=0.0, points=0.0)

    def _next(self, window: _Window, lowest: float, highest: float, burst: float) -> float:
        """The next centre, behind a window."""
        first, about, points = burst > 0, self._is_about(self.known), window.points  # no stage is in the model
        below = NEXT * (self._swept if first and about and self._swept > 0 else self.centre)
        if window.f0 > 0:
            self._pointed = 0
            return window.f0
        if not self._speed > 0 and QUIET * self.power < burst:  # at rest nothing shows, wherever the window is
            return self.centre
        elsewhere = 0 < points <= highest and not self._is_about(points)
        if elsewhere and first and self._pointed < MOST_POINTED:
            self._pointed += 1
            return points
        if first and self.known > lowest and not about:
            self._swept = self.centre
            return self.known
        if below > lowest:
            return below
        self._pointed = 0
        self._again = not self._again
        return SEARCH_FROM if self._again else AGAIN_FROM

    def _sums(self) -> list[list[float]]:
        """Those of the window, where the plays are known as well as before."""
        N: list[list[float]] = self._sum.tolist()
        largest = max(0.0, *[N[i][i] for i in range(SHOWN)])
        for i in range(SHOWN):
            N[i][i] += RIDGE * largest
        return N

    def _sums_with_expected(self, expected: FloatArray, left: float) -> list[list[float]]:
        """Those of the window, where the weights of the plays are known.

        They are those that are expected, um/V, as well as their gain is, and as the residual of free plays allows.
        """
        N: list[list[float]] = self._sum.tolist()
        weights: list[float] = expected.tolist()
        gain, by = 0.0, [0.0] * (LOW + 1)
        for weight in weights:
            gain += weight
        for i in range(LOW + 1):
            for j, weight in enumerate(weights):
                by[i] += weight * (N[i][j] if j < i else N[j][i])
        for i, weight in enumerate(weights):
            by[LOW] -= weight * (by[i] - N[LOW][i])
        for i in range(LOW + 1):
            N[LOW][i] -= by[i]
        spread = EXPECTED / EXPECTS * gain
        for i in range(SHOWN):
            N[i][i] += left / (self._window * (spread * spread))
        return N

    def _shown(self, lowest: float, expected: FloatArray | None, first: bool, noise: float) -> _Window:
        """What the window shows with plays that are free, or else with those that are expected.

        Where something moves and no stage is in the model, `first`, an estimate about the centre may be less certain.
        """
        of_plays = self._shown_by(self._sums(), lowest, SURE, ABOUT if first else SURE, TRUST, noise)
        if of_plays.f0 > 0 or expected is None or not of_plays.left > 0:
            return of_plays
        N = self._sums_with_expected(expected, of_plays.left)
        about = ABOUT if first else SURE_EXPECTED
        window = self._shown_by(N, lowest, SURE_EXPECTED, about, TRUST_EXPECTED, noise)
        f0 = 0.0 if window.sensitivity > STANDS else window.f0
        return window._replace(f0=f0, points=of_plays.points)

    def _shown_by(
        self, N: list[list[float]], lowest: float, sure: float, about: float, trust: float, noise: float
    ) -> _Window:
        """What sums of products show."""
        if not _eliminate(N, 0, COARSE):
            return _Window()
        fewer = [list(row) for row in N]
        if not _eliminate(N, COARSE, BAND):
            return _Window()
        measured = [list(row) for row in N]
        plays = N[LOW][LOW]
        c = _solved(N)
        left = N[LOW][LOW]
        nothing = _Window(left=left)
        if not c[1] > 0:
            return nothing
        ratio, lag, derivative = _without_lag(*c)  # (centre / f0)^2, of their tangents
        if not (ratio > 0 and left < SHOWS * plays):
            return nothing
        y0 = derivative[0]
        y1 = derivative[1] - N[HIGH][BAND] / N[BAND][BAND] * y0
        y2 = derivative[2] - N[THIRD][BAND] / N[BAND][BAND] * y0 - N[THIRD][HIGH] / N[HIGH][HIGH] * y1
        spread = y0 * y0 / N[BAND][BAND] + y1 * y1 / N[HIGH][HIGH] + y2 * y2 / N[THIRD][THIRD]
        of_ratio = left * spread / self._window if left > 0 else 0.0
        doubtful = 2 * POINTS * ratio
        if not of_ratio < doubtful * doubtful:
            return nothing
        f0 = self._frequency(ratio)
        if not lowest < f0 < HIGHEST:
            return nothing
        f0, lag, corrected = self._corrected(self._without_noise(measured, noise, left, c), lowest, f0, lag)
        sensitivity = _sensitivity(fewer, ratio)
        share = self._share_of_plays(left)
        stands = self._is_about(f0) and not sensitivity > STANDS and share > EXPLAIN
        deviation = 2 * (about if stands else sure) * ratio
        if not of_ratio < deviation * deviation:
            return _Window(sensitivity=sensitivity, left=left, points=f0)
        first_order = lag / (2 * tangent(math.pi * self.centre))
        lag = _dead_time(first_order, 2 * math.pi * f0)
        self.driven, self.sensitivity = share, sensitivity
        within = NEAREST * self.centre < f0 < FURTHEST * self.centre
        variance = trust * trust * of_ratio / (4 * ratio * ratio) + corrected * corrected
        return _Window(f0 if within else 0.0, variance, lag, first_order, sensitivity, left, f0)

    def _frequency(self, ratio: float) -> float:
        """The resonance of (centre / f0)^2, of their tangents, cycles per tick."""
        return arctangent(tangent(math.pi * self.centre) / math.sqrt(ratio)) / math.pi

    def _corrected(self, c: _Coefficients | None, lowest: float, f0: float, lag: float) -> tuple[float, float, float]:
        """Resonance and lag as these coefficients have them, where it is one of the search; how wrong f0 may be."""
        ratio, t, _ = _without_lag(*c) if c else (0.0, 0.0, None)
        f = self._frequency(ratio) if ratio > 0 else 0.0
        if not lowest < f < HIGHEST:
            return f0, lag, 0.0
        return f, t, CORRECTED * (f / f0 - 1)

    def _without_noise(self, N: list[list[float]], most: float, left: float, c: _Coefficients) -> _Coefficients | None:
        """Coefficients without noise of a measurement; None: there are none.

        Noise is like ringing at the centre behind the band: the more of it, the nearer to that is the estimate. It is
        no more than `most`, um^2, or the residual shows, and half of what the products can have: near that the
        coefficients are anything.
        """
        v, of_one, seen = (*c, 1.0), 0.0, self._fourth / (OF_FOURTH * self._window)
        noise = min(seen * seen, most)
        for i in range(4):
            for j in range(i + 1):
                of_one += (2 if j < i else 1) * (v[i] * v[j]) * float(self._of_noise[i, j])
        of_one *= self._window
        if left < noise * of_one:
            noise = left / of_one
        for _ in range(HALVINGS):
            if self._solved_without(N, noise):
                break
            noise /= 2
        return self._solved_without(N, noise / 2)

    def _solved_without(self, N: list[list[float]], noise: float) -> _Coefficients | None:
        """Coefficients without so much noise of a measurement, um^2, in the products N; None: they have less."""
        M, every = [list(row) for row in N], noise * self._window
        for i in range(4):
            for j in range(i + 1):
                M[BAND + i][BAND + j] -= every * float(self._of_noise[i, j])
        c = _solved(M)
        return c if c[1] > 0 and M[LOW][LOW] > 0 else None

    def _share_of_plays(self, left: float) -> float:
        """How much smaller `left` is than the residual of an equation without plays, that of ringing alone."""
        N = self._sum.tolist()
        eliminated = _eliminate(N, BAND, LOW)
        alone = N[LOW][LOW] if eliminated else 0.0
        return float(1 - left / alone) if alone > left else 0.0

    def _know(self, window: _Window) -> None:
        """After a window that shows a resonance."""
        f0, lag, first_order, new = window.f0, window.lag, window.first_order, window.variance + LEAST * LEAST
        self.variance += WALK * WALK
        change = f0 / self.known - 1 if self.known > 0 else 0.0
        gain = self.variance / (self.variance + new)
        far = change * change > JUMPS * JUMPS * (self.variance + new)
        if not self.known > 0 or (far and self._strange):
            self.known, self.variance, self.windows = f0, new, 1
            self.lag, self.first_order = lag, first_order
        elif not far:
            self.known *= 1 + gain * change
            self.lag += gain * (lag - self.lag)
            self.first_order += gain * (first_order - self.first_order)
            self.variance = (1 - gain) * self.variance
            self.windows = min(self.windows + 1, MOST)
        self._strange = far and not self._strange


def _solved(N: list[list[float]]) -> _Coefficients:
    """Coefficients of the derivatives, behind the plays, which are eliminated; 0 where they cannot be, or show none."""
    if not _eliminate(N, BAND, LOW):
        return 0.0, 0.0, 0.0
    third = -N[LOW][THIRD] / N[THIRD][THIRD]
    second = -(N[LOW][HIGH] + third * N[THIRD][HIGH]) / N[HIGH][HIGH]
    first = -(N[LOW][BAND] + third * N[THIRD][BAND] + second * N[HIGH][BAND]) / N[BAND][BAND]
    return first, second, third


def _sensitivity(N: list[list[float]], ratio: float) -> float:
    """How far the resonance moves, over it, where the hysteresis is that of fewer plays, which N is without."""
    first, second, third = _solved(N)
    coarse = _without_lag(first, second, third)[0] if second > 0 else 0.0
    return min(abs(math.sqrt(ratio / coarse) - 1), 1.0) if coarse > 0 else 1.0


def _without_lag(first: float, second: float, third: float) -> tuple[float, float, tuple[float, float, float]]:
    """1 + c1 s + c2 s^2 + c3 s^3 without its lag: c of (1 + t s) (1 + (c1 - t) s + c s^2), t, and the derivatives of c.

    t by Newton's method, from that of a large inertia. Where there is none c is 0.
    """
    t, slope = third / second, second
    for _ in range(LAG_STEPS):
        slope = (3 * t - 2 * first) * t + second
        if not slope > 0:
            return 0.0, 0.0, (0.0, 0.0, 0.0)
        t -= (((t - first) * t + second) * t - third) / slope
    of_lag = (2 * t - first) / slope
    return second - t * (first - t), t, (of_lag * (t * t) - t, 1 - of_lag * t, of_lag)


def _dead_time(lag: float, w0: float) -> float:
    """The dead time that turns w0 as far as a lag does, in ticks."""
    return math.copysign(arctangent(w0 * abs(lag)) / w0, lag) if lag != 0 else 0.0


def _eliminate(N: list[list[float]], begin: int, end: int) -> bool:
    """Eliminates the unknowns from `begin` to before `end`, in the lower triangle; whether all of them could be."""
    for k in range(begin, end):
        if not N[k][k] > 0:
            return False
        for i in range(k + 1, LOW + 1):
            factor = N[i][k] / N[k][k]
            for j in range(k + 1, i + 1):
                N[i][j] -= factor * N[j][k]
    return True
