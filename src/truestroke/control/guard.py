"""Never worse than not learning: the error of the weights that learn beside that of the weights at their best."""

import math
from dataclasses import dataclass
from enum import Enum

from truestroke.control.adaptation import LARGEST

SHARE = 0.02  # of the motion's range: a smaller error is no failure,
WORSE = 4  # nor one below so many times the best,
NOISES = 6  # nor one of so many standard deviations of a measurement
FALLS = 0.7  # of the window before: an error that falls so fast is being learned
BAD = 3  # windows in a row that are a failure,
BAD_AT_FIRST = 5  # while nothing is learned yet,
LARGER = 2  # or of a motion that is so many times as small,
BEYOND_ALL = 2  # and where it is larger than half of the motion
PROMISES = 0.5  # of the error that fails: weights that miss less than it are worth a trial
HARMS = 0.1  # of the motion's range: a larger error of a stage that has entered the model is a failure at once,
MADE_WORSE = 3  # above so many times what it was without it
BETTER = 0.7  # of the error that failed: what was restored is better
FIRST_WAIT = 4  # windows of the first hold,
LONGEST_WAIT = 256  # and of the longest
HOPELESS = 2  # times the error that failed: what was restored is worse,
TRANSIENT = 2  # after so many windows
SETTLES = 12  # windows in which the stage may calm down
LEAST_RANGE = 10  # of the floor: a smaller motion is rest
WIDENS = 1.5  # times the range of the window before: a motion that grows, in which no weights are good yet
RISE = 1.02  # of the best, per window
CENTRING = 0.5  # of the mean error, in a window
LEAST_BURST = 20  # of the floor: a smaller error is no burst
GROWS = 1.5  # times the half-wave before: a half-wave that grows
SWINGS = 2  # after so many of them, one more, beyond the motion so far, is driven by learning
DECAYS = 0.95  # in a window: what counts as ringing of a stage that was found
SETTLED = 20  # windows with a small error until weights that are kept are worth a return after a large one
LONG = 10  # windows with a small error after which other weights are kept, where the model was lost,
LONG_AT_REST = 100  # and where the range of the motion is less than half of what it was
MOVES = 0.1  # of the motion's range: less of it, up and down, shows nothing,
MOST_BLOCKS = 1000  # in which the motion may come so far
MISSED = 0.01  # of the motion since then: what kept weights may miss,
OF_NOISE = 2  # with so many standard deviations of a measurement,
MOVED_BY = 0.05  # and of the range: by how much they may be off as a whole
MOST_GAIN = 20.0  # times the first gain, or a share of it
FORGIVEN = 8  # times `wait` good windows until the next hold is shorter again


@dataclass(frozen=True, kw_only=True)
class GuardSettings:
    """Settings of `Guard`: ts_guard_settings of the kernel.

    Attributes
    ----------
    window : int
        Ticks over which an error is taken; 0: the guard is off.
    range_rate : float
        How fast the range of the motion shrinks to that of the present motion, per tick, 0 to 1.
    floor : float
        An error below it is no failure, um.
    burst : float
        Times the motion so far: before anything was good, an error beyond it is a burst; 0: none is.
    recall : int
        Ticks of a block in which the kept weights are compared with measurements after a large error; 0: they are not.
    """

    window: int
    range_rate: float
    floor: float
    burst: float = 0.0
    recall: int = 0


class Action(Enum):
    """What the controller does after a tick."""

    NOTHING = 0
    KEEP = 1  # the weights are the best of late: keep them
    RESTORE = 2  # learning has failed: set the present weights aside, and hold the kept ones
    FIRST = 3  # the kept ones are no better: hold those of the start
    ADOPT = 4  # what was held is better: learn on from there, with caution
    RETURN = 5  # it is not: the weights that were set aside again; learning was not the cause


class Spread:
    """Values as sums of what each is more than the first one: a large mean then takes no digits of their spread.

    Attributes
    ----------
    counted : int
        Values so far; 0: the next one is the first.
    """

    def __init__(self) -> None:
        self.first = self.sum = self.square = 0.0
        self.counted = 0

    def count(self, value: float) -> None:
        """One value more."""
        if self.counted == 0:
            self.first, self.sum, self.square = value, 0.0, 0.0
        e = value - self.first
        self.sum += e
        self.square += e * e
        self.counted += 1

    @property
    def mean(self) -> float:
        """Of at least one value."""
        return self.first + self.sum / self.counted

    @property
    def variance(self) -> float:
        """Rounding may make it less than 0."""
        mean = self.sum / self.counted
        return self.square / self.counted - mean * mean

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        return math.sqrt(max(self.variance, 0.0))


class Guard:
    """Compares the tracking error of the weights that learn with that of the weights at their best.

    An error is the standard deviation of z - z_d in a window, in which the motion's range of about the last second is
    the measure. What the learned weights predict is not compared: a law that bursts predicts its own burst well.

    - *Kept* are weights and covariance of the window with the least error over the range; that least error rises by 2 %
      a window, so that they are not old. The first are kept in a window whose motion is no larger than 1.5 times that
      of the window before: what follows the beginning of a motion need not follow all of it.
    - *Learning has failed* after three windows in which the error is above 2 % of the range, four times the least, six
      times the noise; one in which it falls by 30 %, as it does where a change is being learned, is not counted. Five
      it takes while nothing was good yet, or of a motion half as large; two where it is larger than half of the range.
      Then the kept weights are held, but for the offset, which follows the mean error.
    - *They promise nothing* where they miss more than half of that error of the measurements in the last window:
      weights of a slow motion may be 50 % off in a fast one, and an error that they would have, too, is not the fault
      of learning. They are then not held, unless the error is larger than half of the range.
    - *A stage that has entered the model* waits for its judgement as learned weights do after a hold, unless it makes
      the error more than three times what it was without it, and more than a tenth of the range: then that counts at
      once, whatever the kept weights promise.
    - *They are worse* where their error is twice the one that failed after two windows: the learned ones are taken back
      at once.
    - *They are better* where their error, once it has settled, is below 70 % of the one that failed: the controller
      learns on from there. If they are not, those of the start are held; if these are no better either, learning was
      not the cause, and goes on as if nothing had happened.
    - *Before anything was good* an error of `burst` times the motion so far, 20 floors and twice the first error is a
      burst: the first weights, with the gain that was measured, are held at once.
    - *An error swings up* where each of two half-waves was more than 1.5 times the one before, the third is so,
      too, and it is beyond the motion so far and 20 floors. With `burst`, and until the error was small for long, the
      kept weights are then held at once. The error of a sensor that fails jumps.
    - *Ringing* of a stage that was found just now is no failure: errors below what it was then, less 5 % a window.
    - Each time the next hold, or the time to the next failure, is twice as long, up to 256 windows; after many good
      windows it is halved.
    - *The model is lost* after an error as large as that of a failure, where weights had been kept after twenty windows
      in a row with a small one, its mean included. Others are then kept only after ten such windows; a hundred where
      the motion is less than half as large as it was. Meanwhile `Recall` looks whether the kept weights predict the
      measurements again.

    Parameters
    ----------
    settings : GuardSettings
        Lengths and sizes.

    Attributes
    ----------
    held : int
        Windows since weights were restored; 0: the law learns.
    lost : bool
        The error was large since weights were kept.

    Examples
    --------
    >>> guard = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.02))
    >>> for k in range(10_000):
    ...     z_d = 10 * math.sin(0.1 * k)
    ...     error = 0.01 * math.exp(1e-3 * k) * math.sin(0.7 * k)
    ...     if (action := guard.update(error, z_d, counts=True, noise=0.001)) is Action.RESTORE:
    ...         break
    >>> k, f"error {guard.failed:.1%} of the range"
    (4299, 'error 2.5% of the range')
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.settings = settings
        self.low = self.high = 0.0  # um: of the motion, over about a second
        self.start = 0.0  # um: the first error
        self.swing = self.swung = 0.0  # um: largest error since its sign changed, and how large it was before
        self.swings = 0  # half-waves of the error in a row, each of them larger than the one before
        self.ringing = 0.0  # um: an error below it is ringing that decays
        self.error = self.failed = 0.0  # over the range: of the window before, and at which learning has failed
        self.drift = 0.0  # um per tick: of the offset while the law does not learn, so that the mean error vanishes
        self.best = 0.0  # least error over the range while it learned
        self.span = 0.0  # um: range of the motion when weights were kept, or, before, in the window before
        self.grown = False  # the motion no longer grew in the window before, until weights were kept
        self.errors, self.missed = Spread(), Spread()  # um: in this window, and of the weights to be restored
        self.promised = 0.0  # error over the range that these had when they were asked last; 0: not asked
        self.entered = 0.0  # error over the range when a stage entered the model; 0: none has since the last hold
        self.ticks = self.bad = self.good = self.held = self.pause = self.small = 0
        self.wait = FIRST_WAIT  # windows: of the next hold
        self.kept = self.at_start = self.started = self.settled = self.lost = False

    @property
    def was_good(self) -> bool:
        """Whether weights were good, now or before the model was lost."""
        return self.kept or self.lost

    @property
    def range(self) -> float:
        """Of the motion, um: at least ten times the floor."""
        return max(self.high - self.low, LEAST_RANGE * self.settings.floor)

    def compare(self, missed: float) -> None:
        """Before a tick: by how much the weights that would be restored miss its measurement, um.

        They are asked after a window that was bad. Those of which nothing is known are restored.
        """
        self.missed.count(missed)

    def promises(self, error: float) -> bool:
        """Whether the weights that would be restored miss less than half of this error over the range."""
        return self.promised < PROMISES * error

    def update(self, error: float, z_d: float, *, counts: bool, noise: float) -> Action:
        """One tick.

        Parameters
        ----------
        error, z_d : float
            z - z_d, and the desired displacement, um.
        counts : bool
            Whether the measurement was used, and no voltage limit explains the error.
        noise : float
            Standard deviation of a measurement, um.
        """
        self._follow(error, z_d, counts)
        if counts and (self._bursts(abs(error), abs(z_d)) or self._swings_up(abs(error))):
            self.failed, self.held, self.drift = 1.0, 1, 0.0
            self._begin_window()
            return Action.RESTORE
        if self.ticks < self.settings.window:
            return Action.NOTHING
        enough, span = 4 * self.errors.counted >= self.settings.window, self.range
        found = self.errors.deviation / span if enough else 0.0
        if 4 * self.missed.counted >= self.settings.window:
            self.promised = self.missed.deviation / span
        elif self.bad == 0:
            self.promised = 0.0
        mean = self.errors.mean if enough else 0.0
        if enough:
            self.drift = CENTRING * mean / self.settings.window
        self._begin_window()
        if not enough:
            return Action.NOTHING
        if self.held > 0:
            return self._judge_held(found)
        least = SHARE
        for limit in (self.settings.floor, NOISES * noise):
            if least * span < limit:
                least = limit / span
        mean /= span
        return self._judge_learned(found, math.sqrt(found * found + mean * mean), least, span)

    def begin(self) -> None:
        """Learning begins anew, with other weights: nothing is held, and what is kept stays."""
        self._begin_window()
        self.entered, self.pause = self.error, self.wait
        self.held = self.bad = self.good = 0
        self.at_start = False

    def recall(self) -> None:
        """The kept weights are taken again, as if nothing had happened since."""
        self.begin()
        if not self.kept:
            self.best = SHARE
        self.kept, self.lost = True, False
        self.small, self.pause, self.wait, self.ringing = 0, 1, FIRST_WAIT, 0.0

    def _begin_window(self) -> None:
        self.ticks = self.errors.counted = self.missed.counted = 0

    def _bursts(self, size: float, away: float) -> bool:
        """Whether an error of this size, um, is far beyond the motion so far, before anything was good.

        The motion is at least `away`, um, from 0: where the sensor was not zeroed, the first command goes so far.
        """
        if self.kept or self.held > 0 or not self.settings.burst > 0:
            return False
        beyond = size > self.settings.burst * max(self.high - self.low, away)
        return beyond and size > LEAST_BURST * self.settings.floor and size > 2 * abs(self.start)

    def _swings_up(self, size: float) -> bool:
        """Whether an error of this size, um, swings up beyond the motion so far."""
        s = self.settings
        if not self.kept or self.settled or self.held > 0 or self.pause > 0 or self.swings < SWINGS:
            return False
        return size > max(GROWS * self.swung, self.high - self.low, LEAST_BURST * s.floor)

    def _follow_swings(self, error: float) -> None:
        """How many half-waves of the error in a row have each grown beyond the one before."""
        size = abs(self.swing)
        if (error < 0 < self.swing) or (self.swing < 0 < error):
            grows = size > self.settings.floor and size > GROWS * self.swung
            self.swings = min(self.swings + 1, SWINGS) if grows else 0
            self.swung, self.swing = size, error
        elif abs(error) > size:
            self.swing = error

    def _follow(self, error: float, z_d: float, counts: bool) -> None:
        if not self.started:
            self.started, self.low, self.high, self.start = True, z_d, z_d, error
        rate = self.settings.range_rate
        self.low += rate * (z_d - self.low)
        self.high += rate * (z_d - self.high)
        self.low, self.high = min(self.low, z_d), max(self.high, z_d)
        self.ticks += 1
        if not counts:
            return
        if self.settings.burst > 0:
            self._follow_swings(error)
        self.errors.count(error)

    def _judge_held(self, error: float) -> Action:
        """Whether the held weights are better is known when the error no longer falls."""
        falls = error < 0.9 * self.error and self.held < SETTLES + self.wait
        better = error < BETTER * self.failed
        self.error = error
        self.held += 1
        hopeless = self.held > TRANSIENT and error > HOPELESS * self.failed
        if not hopeless and (self.held <= (self.wait if better else FIRST_WAIT) or falls):
            return Action.NOTHING
        self.drift = 0.0
        if not hopeless and not better and self.kept and not self.at_start:
            self.at_start, self.held = True, 1
            return Action.FIRST
        self.held = self.bad = self.good = 0
        self.entered, self.pause = 0.0, 1 if better else self.wait
        self.wait = 2 * self.wait if self.wait < LONGEST_WAIT else LONGEST_WAIT
        if self.at_start and not hopeless:
            self.kept, self.best = False, 0.0
        self.at_start = False
        return Action.ADOPT if better else Action.RETURN

    def _judge_learned(self, error: float, whole: float, least: float, span: float) -> Action:
        """`whole`: the error with its mean."""
        large = error > least and error > WORSE * self.best and error * span > self.ringing
        falls = error < FALLS * self.error
        proven = self.kept and span < LARGER * self.span
        most = BEYOND_ALL if 2 * error > 1 else BAD if proven else BAD_AT_FIRST
        self.error = error
        self.ringing *= DECAYS
        self.small = 0 if whole > least else min(self.small + 1, LONG_AT_REST)
        self.lost = self.lost or (self.settings.recall > 0 and self.kept and self.settled and large)
        harmed = self.pause > 0 and self.entered > 0 and error > max(HARMS, MADE_WORSE * self.entered)
        excused = not large or (self.pause > 0 and not harmed and 2 * error <= 1)
        self.bad = 0 if excused else self.bad + (not falls and self.bad < most)
        self.pause -= self.pause > 0
        if self.bad >= most and not falls and (harmed or 2 * error > 1 or self.promises(error)):
            self.failed, self.held, self.drift, self.small = error, 1, 0.0, 0
            return Action.RESTORE
        self.good = 0 if error > least else min(self.good + 1, FORGIVEN * LONGEST_WAIT)
        if self.good >= FORGIVEN * self.wait and self.wait > FIRST_WAIT:
            self.wait, self.good = self.wait // 2, 0
        self.best *= RISE
        moves = self.high - self.low > LEAST_RANGE * self.settings.floor
        if not self.was_good:
            grows = span > WIDENS * self.span
            self.span, self.grown = span, moves and not grows
            if grows:
                return Action.NOTHING
        if not moves or error > least or (self.kept and error > self.best):
            return Action.NOTHING
        if self.lost and self.small < (LONG if 2 * span > self.span else LONG_AT_REST):
            return Action.NOTHING
        self.best, self.span, self.kept, self.lost = error, span, True, False
        self.settled = self.small >= SETTLED
        return Action.KEEP


class Recall:
    """Whether kept weights predict the measurements as well as when they were kept, but for an offset: block by block.

    What they miss has to have a standard deviation below two of a measurement and 1 % of what they predict to have
    moved, and a mean below 5 % of the motion's range, from the first block of `recall` ticks to that in which the
    prediction has risen and fallen by a tenth of the range: in one direction alone another hysteresis is an offset.
    Otherwise the comparison begins anew. Weights that were learned meanwhile are not asked: they fit what was measured
    last, and may be wrong about everything else.

    Attributes
    ----------
    offset : float
        Mean of what is missed, um.

    Examples
    --------
    An actuator of 10 um/V that was 20 % weaker for a while:

    >>> recall = Recall(GuardSettings(window=100, range_rate=1e-3, floor=0.02, recall=25))
    >>> for k in range(2000):
    ...     volts = math.sin(0.01 * k)
    ...     z = (8.0 if k < 1000 else 10.0) * volts
    ...     if recall.update(10.0 * volts, z - 10.0 * volts, span=20.0, noise=0.01):
    ...         break
    >>> k
    1174
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.settings = settings
        self.missed = Spread()  # um
        self.low = self.high = 0.0  # um: of what is predicted,
        self.rose = self.fell = 0.0  # and how far it went up and down
        self.offset = 0.0

    def begin(self) -> None:
        """The comparison begins anew."""
        self.missed.counted = 0

    def update(self, predicted: float, missed: float, *, span: float, noise: float) -> bool:
        """One tick; whether a block has ended in which the kept weights are as good as they were.

        Parameters
        ----------
        predicted, missed : float
            The displacement by the kept weights, and how much more was measured, um.
        span, noise : float
            Range of the motion, and standard deviation of a measurement, um.
        """
        if self.missed.counted == 0:
            self.low, self.high = predicted, predicted
            self.rose = self.fell = 0.0
        self.missed.count(missed)
        self.low, self.high = min(self.low, predicted), max(self.high, predicted)
        self.rose, self.fell = max(self.rose, predicted - self.low), max(self.fell, self.high - predicted)
        if self.missed.counted % self.settings.recall:
            return False
        self.offset = self.missed.mean
        most = MISSED * (self.high - self.low) + OF_NOISE * noise
        good = self.missed.variance < most * most and abs(self.offset) < MOVED_BY * span
        enough = min(self.rose, self.fell) > MOVES * span
        if not good or enough or self.missed.counted >= MOST_BLOCKS * self.settings.recall:
            self.begin()
        return good and enough


class FirstGain:
    """The gain of the first weights, until others are kept: measured displacements over those that they predict.

    By least squares, of both behind a slow pole, so that an oscillation counts little.

    Parameters
    ----------
    slow : float
        Coefficient of the pole, per tick, 0 to 1.
    sure : float
        How sure the first gain is: squares of displacements, summed over ticks, that count as much, um^2.

    Examples
    --------
    An actuator that is five times as strong as was expected:

    >>> gain = FirstGain(0.05, 0.1)
    >>> for k in range(200):
    ...     gain.update(0.01 * k, 0.05 * k)
    >>> round(gain.ratio, 2)
    5.0
    """

    def __init__(self, slow: float, sure: float) -> None:
        self.slow, self.sure = slow, sure
        self.begin()

    def begin(self) -> None:
        """Nothing is known."""
        self.product = self.square = self.sure  # um^2: sums over the ticks
        self.first: tuple[float, float] | None = None  # um: measured and predicted in the first tick,
        self.z = self.expected = 0.0  # and behind the pole since

    @property
    def shown(self) -> bool:
        """Whether measurements have shown it."""
        return self.first is not None and self.product > 0

    @property
    def ratio(self) -> float:
        """Times the first gain."""
        return min(max(self.product / self.square, 1 / MOST_GAIN), MOST_GAIN)

    @property
    def offset(self) -> float:
        """Displacement in the first tick that the gain leaves unexplained, um."""
        z, expected = self.first or (0.0, 0.0)
        return z - self.ratio * expected

    def update(self, expected: float, z: float) -> None:
        """One tick: what the first weights predict, and what was measured, um."""
        expected = min(max(expected, -LARGEST), LARGEST)
        if self.first is None:
            self.first = z, expected
        self.z += self.slow * (z - self.first[0] - self.z)
        self.expected += self.slow * (expected - self.first[1] - self.expected)
        most = LARGEST * LARGEST
        self.product = min(max(self.product + self.z * self.expected, -most), most)
        self.square = min(self.square + self.expected * self.expected, most)
