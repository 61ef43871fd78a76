"""A stage that is shown, before it is put into the model."""

from dataclasses import dataclass, field

from truestroke.control.stage import found

TOO_MUCH = 4.0  # times the rms of what the law misses: a stage that misses more is not that of the measurements
FEWEST = 20  # ticks that show it


@dataclass
class Moments:
    """Sums of a signal, and of its squares."""

    first: float = 0.0
    second: float = 0.0

    def add(self, x: float) -> None:
        """One more value."""
        self.first += x
        self.second += x * x

    def spread(self, ticks: int) -> float:
        """Mean square about the mean."""
        mean = self.first / ticks
        return self.second / ticks - mean * mean


@dataclass
class Candidate:
    """What a stage that is shown would have missed in a window, beside what the law misses."""

    frequency: float = 0.0  # cycles per tick; 0: there is none
    section: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    direct: float = 0.0
    strain: float = 0.0  # um: of the tick before,
    made: tuple[float, float] = (0.0, 0.0)  # what the section made of it then, and before that
    ticks: int = 0
    product: float = 0.0  # sum of what it misses times the velocity
    missed: Moments = field(default_factory=Moments)
    speed: Moments = field(default_factory=Moments)
    own: Moments = field(default_factory=Moments)  # of what the law misses
    worse: float = 0.0  # cycles per tick: one that missed much more than the law in the last window; 0: none did

    def count(self, z: float, zdot_d: float, strain: float, own: float) -> None:
        """One tick: z, um, would be that of the stage at this strain, um, but for a lag; the law misses `own`, um."""
        q = self.section
        made = q[0] * strain + q[1] * self.strain - q[2] * self.made[0] - q[3] * self.made[1]
        missed = z - made - self.direct * strain
        self.made = made, self.made[0]
        self.ticks += 1
        self.missed.add(missed)
        self.speed.add(zdot_d)
        self.own.add(own)
        self.product += missed * zdot_d

    def end(self) -> None:
        """A window has ended: what the stage misses beside an offset and a lag."""
        tried, n = self.frequency, self.ticks
        self.worse = self.frequency = 0.0
        if not (tried > 0 and n > FEWEST):
            return
        missed, speed = self.missed.spread(n), self.speed.spread(n)
        both = self.product / n - self.missed.first / n * (self.speed.first / n)
        if speed > 0:
            missed -= both * both / speed
        if missed > TOO_MUCH * TOO_MUCH * self.own.spread(n):
            self.worse = tried


def begun(frequency: float, tick: float, strain: float, before: float) -> Candidate:
    """A stage of this frequency, cycles per tick, at rest at this strain, um, and at that of the tick before."""
    if not frequency > 0:
        return Candidate()
    g = found(frequency, tick)
    q = tuple(g["dynamics.section"][0])
    gain = (q[0] + q[1]) / (1 + q[2] + q[3])
    made = gain * strain, gain * before
    return Candidate(frequency, q, g["dynamics.direct"][0], before, made)
