"""A steady tone in the error: a load from outside, and no ringing of the stage."""

import math

from truestroke.control.angles import arctangent, tangent

BLOCK_PERIODS = 4  # of the centre: a block
LONGEST_BLOCK = 1e8  # ticks
FEWEST_BLOCKS = 9  # of a window, half a block after each other: fewer show nothing
STEADY_TONE = 0.95  # of the square of a block: its product with the one before; a steady tone neither decays nor grows
ORDERS_OF_STAGE = 40.5  # of a harmonic of the motion, as 840 Hz of lines of 40 Hz, at which the stage rings
OFF_HARMONIC = 0.04  # of the motion's frequency: what is nearer to a harmonic is not distinguished from it,
OFF_HARMONIC_OF_STAGE = 0.12  # nor this from one that grows or shrinks where the stage rings at it
OFF_MOTION = 0.01  # the same, of the motion itself, so far from the centre that it shows another frequency:
MOST_TURNS = 3  # by so many turns in half a block, at most
OF_LOAD = 0.35  # of the frequency of a load: what is shown so near to it is the load


class ToneDetector:
    """Whether what is about a frequency in the error is a load: a pump, the mains, another axis.

    A stage that rings decays, and what the motion excites again and again is a harmonic of it. A load does neither. In
    blocks of four periods of the centre, each half a block after the last one and weighted as 1 - cos over it, the
    amplitude of the error is a complex number A_k. The tone is steady where ::

        |sum A_k A*_(k-2)| > 0.95 max(sum |A_k|^2, sum |A_(k-2)|^2)

    of at least nine of them: the ringing of a mode with a damping of 0.002 does not last so long. The angle of
    sum A_k A*_(k-1) shows its frequency within a quarter of the centre. The period of the motion is that from one turn
    upwards to the next. A motion beside that quarter, which a block weakens but does not take away, shows a frequency
    there, from which it is some turns in half a block away: such a tone is none.

    Parameters
    ----------
    centre : float
        About which frequency, cycles per tick.

    Examples
    --------
    A pump of 76 Hz beside a motion of 5 Hz, and a stage of 76 Hz that rings with a damping of 0.01, seen about 80 Hz:

    >>> tick = 1e-4
    >>> for damping in 0.0, 0.01:
    ...     tone = ToneDetector(80 * tick)
    ...     for k in range(3000):
    ...         w = 2 * math.pi * 76 * tick * k
    ...         tone.update(0.1 * math.exp(-damping * w) * math.sin(w), math.cos(2 * math.pi * 5 * tick * k))
    ...     print(f"{tone.of_load / tick:.1f} Hz, {tone.amplitude:.3f} um")
    76.0 Hz, 0.097 um
    0.0 Hz, 0.046 um
    """

    def __init__(self, centre: float) -> None:
        half = BLOCK_PERIODS / (2 * centre) + 0.5
        self._block = 2 * int(min(max(half, 4.0), LONGEST_BLOCK))  # ticks
        g = tangent(math.pi / self._block)
        whole = 1 + g * g
        self._step = (1 - g * g) / whole, 2 * g / whole  # of a phasor that turns once in a block: in a tick,
        self._turn = 1.0, 0.0  # and now
        self._sums = [[0.0, 0.0], [0.0, 0.0]]  # of blocks that go on, um
        self._last = self._same = [0.0, 0.0]  # of the last one that ended, and of the one before, um
        self._advance = [0.0, 0.0]  # um^2: products of blocks half a block apart,
        self._product = [0.0, 0.0]  # and of those a block apart
        self._later = self._earlier = 0.0  # um^2: squares of the latter
        self._ticks = self._blocks = self._passed = self._turns = 0
        self._rate = self._first_turn = self._last_turn = 0.0

    def update(self, error: float, zdot_d: float) -> None:
        """One tick: measured less desired, um, and the desired velocity, um/s."""
        cosine, sine = self._turn
        x, y = cosine * cosine - sine * sine, 2 * cosine * sine  # twice the angle,
        in_phase, behind = (x * x - y * y) * error, -(2 * x * y) * error  # and four times
        now, between = self._sums
        now[0] += (1 - cosine) * in_phase
        now[1] += (1 - cosine) * behind
        between[0] += (1 + cosine) * in_phase
        between[1] += (1 + cosine) * behind
        step = self._step
        self._turn = cosine * step[0] - sine * step[1], cosine * step[1] + sine * step[0]
        self._follow_turns(zdot_d)
        self._ticks += 1
        if 2 * self._ticks == self._block:
            if self._blocks > 0:
                self._end_block(self._sums[1])
            self._sums[1] = [0.0, 0.0]  # the first one had only half of its ticks
        elif self._ticks >= self._block:
            self._end_block(self._sums[0])
            self._sums[0], self._turn, self._ticks = [0.0, 0.0], (1.0, 0.0), 0

    @property
    def of_load(self) -> float:
        """The frequency of a steady tone that is no harmonic of the motion, cycles per tick; 0: there is none."""
        return self.shown(STEADY_TONE, ORDERS_OF_STAGE, OFF_HARMONIC_OF_STAGE)

    def shown(self, steady: float, orders: float, off: float = OFF_HARMONIC) -> float:
        """The same, where the product of a block and the one before is such a share of the squares.

        orders: of harmonics of the motion; a higher one is not distinguished from a load. off: of the motion's
        frequency; what is nearer to a harmonic is none.
        """
        larger = max(self._later, self._earlier)
        if self._blocks < FEWEST_BLOCKS or not math.sqrt(_square(self._product)) > steady * larger:
            return 0.0
        frequency = self._frequency
        if self._turns < 2:
            return frequency
        period = (self._last_turn - self._first_turn) / (self._turns - 1)
        order = frequency * period
        if not 0 <= order < orders:
            return frequency
        if not abs(order - int(order + 0.5)) > off:
            return 0.0
        apart, beside = 2 * period / self._block, abs(order - 1)
        for turns in range(1, MOST_TURNS + 1):
            if not abs(beside - turns * apart) > OFF_MOTION:
                return 0.0
        return frequency

    @property
    def knows_motion(self) -> bool:
        """Whether the period of the motion is known: it has turned upwards twice."""
        return self._turns > 1

    @property
    def ticks(self) -> int:
        """That have passed."""
        return self._passed

    @property
    def blocks(self) -> int:
        """That have ended."""
        return self._blocks

    @property
    def amplitude(self) -> float:
        """Of what is about the centre, um."""
        return 2 * math.sqrt(self._later / (self._blocks - 2)) / self._block if self._blocks > 2 else 0.0

    @property
    def _frequency(self) -> float:
        """Cycles per tick; 0: half a turn in half a block, of which the sign is not known."""
        x, y = self._advance
        real = math.sqrt(_square(self._advance)) + x
        if not real > 0:
            return 0.0
        half_angle = -arctangent(-y / real) if y < 0 else arctangent(y / real)
        return (BLOCK_PERIODS + 2 * half_angle / math.pi) / self._block

    def _follow_turns(self, zdot_d: float) -> None:
        """When the desired motion turns upwards, within the tick."""
        self._passed += 1
        if self._rate < 0 <= zdot_d:
            self._last_turn = self._passed + zdot_d / (self._rate - zdot_d)
            if self._turns == 0:
                self._first_turn = self._last_turn
            self._turns += 1
        self._rate = zdot_d

    def _end_block(self, a: list[float]) -> None:
        if self._blocks > 0:
            _add_product(self._advance, a, self._last)
        if self._blocks > 1:
            _add_product(self._product, a, self._same)
            self._later += _square(a)
            self._earlier += _square(self._same)
        self._same, self._last = self._last, a
        self._blocks += 1


def _square(a: list[float]) -> float:
    return a[0] * a[0] + a[1] * a[1]


def _add_product(total: list[float], a: list[float], b: list[float]) -> None:
    """Adds a times b conjugated."""
    total[0] += a[0] * b[0] + a[1] * b[1]
    total[1] += a[1] * b[0] - a[0] * b[1]
