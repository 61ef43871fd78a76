"""Second-order modes of the stage from a record: what lies between the hysteresis and the displacement."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base.checks import SettingError
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control import stage
from truestroke.model.dynamics import MODES, SEEN, Dynamics, Mode

ROWS = 20_000  # of the record at most, from its start, to which the modes are fitted
CANDIDATES = 160  # frequencies at which a mode is looked for
PERIODS = 20.0  # of the lowest mode in the record, at least
SLOWEST = 2.01e-3  # Hz: a search goes down to half of it, the lowest frequency of a `Mode`
START = 0.03  # damping of a candidate
RINGS = 2.0  # times the strain: more of a line is that of a mode which rings
NARROW = (0.0007, 0.0013, 0.0025, 0.005, 0.01)  # damping of candidates at such a line
DAMPING = 5e-4, 0.5
FLAT = 0.3  # damping: a mode with more rings no more, and may stand for hysteresis, creep or lag
WIDTH = 3.0  # lines of the record's spectrum: a mode that is narrower may be hum, whose phase nothing in a motion knows
AROUND = 8  # lines on each side of such a mode's, in which it is compared with hum
STEADILY = 3  # coefficients of a polynomial in time: of amplitude and phase of hum
DRIVEN = 0.25  # of the square there, which a mode leaves at most: fitted to hum it leaves a half and more
LEAST = 0.05  # of the shares: that of the modes that ring, without those which do not
SHARE = -0.5, 1.2  # of a mode
INSIDE = 0.995  # of the highest frequency that is searched: a mode beyond is not located
NEAR = 1.12  # how far a frequency may move in a search, as a ratio; modes are not found twice within it
FIRST = 2.5  # the same of the only mode, which a static model hides
DELAY = 19.0  # samples of dead time, at most
FIRST_LOWER = 0.97  # of the rms: the first mode must lower it so far; the weights of the static model follow it in part
LOWER = 0.9  # the same of another mode
AGAIN = 0.97  # of the rms: modes that are fitted anew and lower it so far are fitted once more, behind another strain
KEPT = 12  # signals behind a mode
EVALUATIONS = 15  # steps of the search, at most


class ModeSearch:
    """Modes and dead time between strain and displacement, by output-error least squares.

    Parameters
    ----------
    strain : ndarray, shape (samples,)
        What the hysteresis gives, um.
    displacement : ndarray, shape (samples,)
        Measured, um.
    known : ndarray of bool, shape (samples,)
        Which samples are judged.
    sample_rate : float
        Hz.
    narrow : bool
        Whether modes as narrow as a line of the spectrum are taken: then ask whether they hum.
    flat : bool
        Whether modes with a damping above `FLAT` are taken.
    late : float
        By how much the displacement is later than the strain behind the modes that were found, samples: the dead time
        of the search begins with it.
    """

    def __init__(
        self,
        strain: FloatArray,
        displacement: FloatArray,
        known: npt.NDArray[np.bool_],
        sample_rate: float,
        narrow: bool = True,
        flat: bool = True,
        late: float = 0.0,
    ) -> None:
        self.strain, self.z, self.known = strain[:ROWS], displacement[:ROWS], known[:ROWS]
        self.rate, self.narrow, self.flat, self.late = sample_rate, narrow, flat, late
        self._last: dict[tuple[float, float, float], FloatArray] = {}
        self._delayed: tuple[float, FloatArray] = (0.0, self.strain - self.strain[0])
        self.lowest = max(PERIODS * sample_rate / self.strain.size, SLOWEST)
        self.highest = 0.99 * SEEN * sample_rate

    def run(self, found: Dynamics | None = None) -> tuple[Dynamics | None, bool]:
        """The modes that were found with another strain, fitted anew, and one more if it lowers the residual.

        None where there was none and none does. And whether another search, behind a model that was fitted with these
        modes, would find more: it has another strain.
        """
        least = self.rms(None)
        if found is not None:
            before = self.rms(found)
            again, least = self._refined(_vector(self._later(found)))
            if again is not None:
                found = again
                lower = AGAIN if self.late else LOWER
                if least < lower * before:  # first where they are, and then whether there are more
                    return found, True
        if not self.frequencies(2) or (found is not None and len(found.modes) == MODES):
            return found, False
        made, rms = self._refined(self._next(found))
        if made is None or rms >= (LOWER if found else FIRST_LOWER) * least or not self.inside(made):
            return found, False
        return made, True

    def _later(self, found: Dynamics) -> Dynamics:
        """The same with the dead time with which this search begins."""
        delay = min(max(found.dead_time * self.rate + self.late, 0.0), DELAY)
        return dataclasses.replace(found, dead_time=delay / self.rate) if self.late else found

    def rms(self, found: Dynamics | None) -> float:
        """Of the residual of these modes, or of none, in the known samples, um."""
        if found is None:
            return float(np.std((self.z - self._late(min(self.late, DELAY)))[self.known]))
        return float(np.std(self._off(_vector(found))))

    def frequencies(self, count: int) -> list[float]:
        """So many that are searched, Hz; none in a record that is too short for a search."""
        return np.geomspace(self.lowest, self.highest, count).tolist() if self.highest >= 1.5 * self.lowest else []

    def behind(self, frequency: float, damping: float) -> FloatArray:
        """Residual of one mode with all of the motion, in all samples, um, beside an offset."""
        return np.asarray(self.z - self.strain[0] - self._behind(frequency, damping, 0.0))

    def inside(self, found: Dynamics) -> bool:
        """Whether the highest mode is not the end of the search: there it stands for what is no mode."""
        return found.modes[-1].frequency < INSIDE * self.highest

    def _next(self, found: Dynamics | None) -> FloatArray:
        """One mode more, where the spectrum of the residual has most of it: the search starts there."""
        delay = min(self.late, DELAY) if found is None else found.dead_time * self.rate
        late = self._late(delay) + self.strain[0]
        made = late if found is None else stage.through(found, self.strain)
        f = np.fft.rfftfreq(self.strain.size, 1 / self.rate)
        seen = (f > self.lowest / 2) & (f < 0.49 * self.rate)
        window, f = np.hanning(self.strain.size), f[seen]

        def spectrum(x: FloatArray) -> ComplexArray:
            return np.asarray(np.fft.rfft(window * np.where(self.known, x - x[self.known].mean(), 0.0))[seen])

        U, E = spectrum(late), spectrum(self.z - made)
        base = np.ones_like(U) if found is None else sum(m.response(2j * math.pi * f) for m in found.modes)
        modes = () if found is None else found.modes
        candidates = self._apart(np.array(self.frequencies(CANDIDATES)), modes)
        columns = (
            (c, START, (Mode(frequency=c, damping=START).response(2j * math.pi * f) - base) * U) for c in candidates
        )
        rung = (
            (c, damping, spectrum(self._behind(c, damping, delay) + self.strain[0] - made))
            for c in (self._apart(self._line(f, U, E), modes) if self.narrow else ())
            for damping in NARROW
        )
        best, least = (0.0, START, 0.0), math.inf
        for candidate, damping, column in itertools.chain(columns, rung):
            # the only mode has all of the motion
            share = 1.0 if found is None else float(np.vdot(column, E).real / np.vdot(column, column).real)
            rest = float(np.sum(np.abs(E - share * column) ** 2))
            if rest < least:
                least, best = rest, (candidate, damping, float(np.clip(share, -0.9, 0.9)))
        frequency, damping, share = best
        if found is None:
            return np.array([math.log(frequency), math.log(damping), max(delay, 0.5)])
        f_, dampings, shares, delay = _parts(_vector(found))
        shares = np.append(shares[1:] * (1 - share), share)
        return np.concatenate([np.log([*f_, frequency]), np.log([*dampings, damping]), shares, [delay]])

    def _apart(self, frequencies: FloatArray, modes: tuple[Mode, ...]) -> list[float]:
        """Those that are not near a mode, Hz."""
        away = 2 * math.log(NEAR)
        return [float(f) for f in frequencies if all(abs(math.log(f / mode.frequency)) > away for mode in modes)]

    def _line(self, f: npt.NDArray[np.floating[Any]], U: ComplexArray, E: ComplexArray) -> FloatArray:
        """Frequencies about the strongest line of the residual that the strain does not have: a mode rings there."""
        power = np.abs(E) ** 2 * (np.abs(E) > RINGS * np.abs(U)) * (f >= self.lowest) * (f <= self.highest)
        top, line = int(power.argmax()), self.rate / self.strain.size
        return float(f[top]) + line * np.array([-0.4, 0.0, 0.4]) if power[top] > 0.0 else np.empty(0)

    def _refined(self, start: FloatArray) -> tuple[Dynamics | None, float]:
        """The numbers with the least sum of squares, beside an offset, and the rms of the residual, um.

        None where they have no stable inverse, or are narrow or flat and not asked for.
        """
        from scipy.optimize import least_squares

        n = start.size // 3
        near = np.array([*[math.log(NEAR if n > 1 else FIRST)] * n, *[math.inf] * 2 * n])
        low = [*[math.log(self.lowest / 2)] * n, *[math.log(DAMPING[0])] * n, *[SHARE[0]] * (n - 1), 0.0]
        top = [*[math.log(self.highest)] * n, *[math.log(DAMPING[1])] * n, *[SHARE[1]] * (n - 1), DELAY]
        scale = [*[0.01] * n, *[0.3] * n, *[0.05] * (n - 1), 0.3]
        first = np.clip(start, np.array(low) + 1e-6, np.array(top) - 1e-6)
        bounds = np.maximum(low, first - near), np.minimum(top, first + near)
        options = {"x_scale": scale, "ftol": 1e-4, "xtol": 1e-5, "max_nfev": EVALUATIONS}
        found = least_squares(self._off, first, bounds=bounds, **options)
        return self._dynamics(found.x), float(np.sqrt(np.mean(found.fun**2)))

    def _off(self, vector: FloatArray) -> FloatArray:
        """Residual of the modes in the known samples, um."""
        rest = self._rest(vector)[self.known]
        return np.asarray(rest - rest.mean())

    def _rest(self, vector: FloatArray) -> FloatArray:
        """The same of all samples, beside an offset: as of `stage.through`, ten times faster."""
        f, damping, shares, delay = _parts(vector)
        modes = zip(f.tolist(), damping.tolist(), strict=True)
        made = sum(share * self._behind(*mode, delay) for share, mode in zip(shares.tolist(), modes, strict=True))
        return np.asarray(self.z - self.strain[0] - made)

    def _behind(self, frequency: float, damping: float, delay: float) -> FloatArray:
        """The strain above its start behind dead time and one mode; the last few are kept, for derivatives."""
        from scipy.signal import lfilter

        key = frequency, damping, delay
        if key not in self._last:
            w = 2 * math.pi * frequency / self.rate
            self._last[key] = np.asarray(lfilter(*_of_lines(w, damping), self._late(delay)))
            if len(self._last) > KEPT:
                self._last.pop(next(iter(self._last)))
        return self._last[key]

    def _late(self, delay: float) -> FloatArray:
        """The strain above its start behind dead time; the last one is kept, for derivatives by the modes."""
        if delay != self._delayed[0]:
            ticks = np.arange(self.strain.size)
            self._delayed = delay, np.asarray(np.interp(ticks - delay, ticks, self.strain) - self.strain[0])
        return self._delayed[1]

    def hums(self, found: Dynamics) -> bool:
        """Whether a mode as narrow as a line of the spectrum may be hum.

        A mode rings when the motion shakes it, and decays: it is one where it explains nearly all near its frequency.
        Hum goes on, and nothing in the motion knows its phase. Nor is it a mode where a line whose amplitude and phase
        change slowly explains more.
        """
        vector, size = _vector(found), self.strain.size
        f, damping, shares, delay = _parts(vector)
        for k in np.flatnonzero(self._narrow(f, damping)).tolist():
            still = shares[k] * (self._late(delay) - self._behind(float(f[k]), float(damping[k]), delay))
            left, ticks = self._rest(vector), np.arange(size)
            line = round(f[k] * size / self.rate)
            turning = np.exp(2j * math.pi * line * ticks / size)
            hum = [turning * (ticks / size - 0.5) ** power for power in range(STEADILY)]
            mode, other, *columns = (self._near(line, x) for x in (left, left - still, *hum))
            A = np.column_stack(columns)
            beside = other - A @ np.linalg.lstsq(A, other, rcond=None)[0]
            of_mode, of_hum, of_all = (np.vdot(x, x).real for x in (mode, beside, other))
            if of_mode > min(DRIVEN * of_all, of_hum):
                return True
        return False

    def _narrow(self, f: FloatArray, damping: FloatArray) -> npt.NDArray[np.bool_]:
        return np.asarray(2 * damping * f < WIDTH * self.rate / self.strain.size)

    def _near(self, line: int, x: npt.NDArray[Any]) -> ComplexArray:
        """Spectrum of the known samples about a line."""
        window = np.hanning(x.size) * self.known
        spectrum = np.fft.fft(window * (x - x[self.known].mean()))
        return np.asarray(spectrum[max(line - AROUND, 0) : line + AROUND + 1])

    def _dynamics(self, vector: FloatArray) -> Dynamics | None:
        """As the controller takes them; None where they have no stable inverse, are near each other, narrow or flat."""
        f, damping, shares, delay = _parts(vector)
        if not self.flat and np.any(damping > FLAT):
            return None
        if not self.narrow and np.any(self._narrow(f, damping)):
            return None
        modes = [
            Mode(frequency=float(a), damping=float(b), share=float(c) or 1e-9)
            for a, b, c in sorted(zip(f, damping, shares, strict=True))
        ]
        try:
            made = Dynamics(sample_rate=self.rate, modes=tuple(modes), dead_time=float(delay) / self.rate)
            stage.through(made, self.strain[:2])
            return made
        except SettingError:
            return None


def flat(found: Dynamics) -> bool:
    """Whether a mode does not ring."""
    return any(mode.damping > FLAT for mode in found.modes)


def resonant(found: Dynamics) -> Dynamics | None:
    """Those modes alone that ring, with shares that sum to 1; None where none does, or they have hardly a share."""
    kept = [mode for mode in found.modes if mode.damping <= FLAT]
    total = sum(mode.share for mode in kept)
    if not kept or total < LEAST:
        return None
    modes = tuple(dataclasses.replace(mode, share=mode.share / total) for mode in kept)
    return dataclasses.replace(found, modes=modes)


def _of_lines(w: float, damping: float) -> tuple[list[float], list[float]]:
    """Numerator and denominator of a mode of w, rad per tick, for straight lines between ticks: in closed form."""
    decay, damped = damping * w, w * math.sqrt(1 - damping * damping)
    a1, a2 = -2 * math.exp(-decay) * math.cos(damped), math.exp(-2 * decay)

    def of_ramp(t: int) -> float:
        lost = (decay - damped * damped / decay) * math.sin(damped * t) / damped + 2 * math.cos(damped * t)
        return t - decay / (w * w) * (2 - math.exp(-decay * t) * lost)

    r1, r2, r3 = (of_ramp(t) for t in (1, 2, 3))
    g0, g1, g2 = r1, r2 - 2 * r1, r3 - 2 * r2 + r1  # of a line up, and down again
    return [g0, g1 + a1 * g0, g2 + a1 * g1 + a2 * g0], [1.0, a1, a2]


def _parts(vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Frequencies, Hz, damping and shares of the modes, and dead time in samples; its log, log, all but one share."""
    n = vector.size // 3
    shares = vector[2 * n : 3 * n - 1]
    f, damping = np.exp(vector[:n]), np.exp(vector[n : 2 * n])
    return f, damping, np.concatenate([[1 - shares.sum()], shares]), float(vector[-1])


def _vector(found: Dynamics) -> FloatArray:
    """The reverse of `_parts`."""
    modes = found.modes
    f, damping, shares = ([getattr(m, name) for m in modes] for name in ("frequency", "damping", "share"))
    return np.array([*np.log(f), *np.log(damping), *shares[1:], found.dead_time * found.sample_rate])
