"""The linear dynamics between hysteresis and sensor: modes of the stage, lag of the amplifier, dead time, sensor."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, files, toml
from truestroke.base.checks import SettingError
from truestroke.base.declared import FOLLOWS
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import ComplexArray, FloatArray

FORMAT, VERSION = "truestroke dynamics", 1
MODES = 3  # at most
SEEN = 0.45  # of the sample rate: a resonance must be below
EARLIEST, LATEST = -0.5, 20.0  # ticks: of the dead time; a sample at the end of its tick is half a tick early
NARROWEST = 1e-4  # of a tick: a mean over so little is a sample
PIECE = 512  # frequencies that are computed at a time: what they need stays in the cache
ROUNDED = 1 + 1e-12  # half of a sample rate by np.fft.rfftfreq may be a bit above it
ALIASES = 20  # on each side: what is beyond is below 2e-6 of the response
SHARES = 1e-6  # by how much the sum of the shares may differ from 1
APPROXIMATED = 0.01  # relative: error of the response that `from_control` accepts
EXPECTED = "a Dynamics, such as of truestroke.measure_dynamics(actuator) or Dynamics.load(path)"

_HZ, _S = {"unit": "Hz"}, {"unit": "s"}


def averaged(delay: float) -> float:
    """The part of a tick, up to its end, over which a measurement is the mean; of a dead time in ticks.

    A measurement that is earlier than the mean over its tick would know the next command if it were the mean over a
    whole tick.

    >>> averaged(0.7), averaged(-0.3)
    (1.0, 0.4)
    """
    return max(1.0 + 2.0 * min(delay, 0.0), NARROWEST)


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One second-order mode of the stage: share w^2 / (s^2 + 2 zeta w s + w^2), w = 2 pi frequency.

    Attributes
    ----------
    frequency : float
        Undamped natural frequency, Hz.
    damping : float
        zeta, above 0 and below 1.
    share : float
        Part of the static displacement, without unit; it may be negative.

    Raises
    ------
    SettingError
        A number is out of bounds.

    Examples
    --------
    >>> Mode(frequency=700.0, damping=0.02)
    Mode(frequency=700.0, damping=0.02, share=1.0)
    """

    frequency: float = field(metadata=_HZ)
    damping: float
    share: float = 1.0

    def __post_init__(self) -> None:
        values = {
            "frequency": checks.sized("frequency", self.frequency, "Hz", 1e-3, 1e9),
            "damping": checks.number("damping", self.damping),
            "share": checks.within("share", self.share, -10.0, 10.0),
        }
        if not 0.0 < values["damping"] < 1.0:
            bound = "above 0 and below 1: a stage that does not resonate is an amplifier_bandwidth"
            raise SettingError("damping", self.damping, bound)
        if values["share"] == 0.0:
            raise SettingError("share", self.share, "another number than 0: leave the mode out")
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def response(self, s: npt.ArrayLike) -> ComplexArray:
        """The transfer function at s, rad/s, complex, of any shape.

        >>> Mode(frequency=700.0, damping=0.02).response(2j * np.pi * np.array([0.0, 700.0])).round(6)
        array([1. +0.j, 0.-25.j])
        """
        s, w = np.asarray(s, dtype=np.complex128), 2 * math.pi * self.frequency
        return np.asarray(self.share * w**2 / (s**2 + 2 * self.damping * w * s + w**2))


@dataclass(frozen=True, kw_only=True, repr=False)
class Dynamics(Displayed):
    """The stage, linear, from the displacement that hysteresis alone would give to what it is; the static gain is 1.

    ::

        G(s) = exp(-s dead_time) / (1 + s / (2 pi f_a)) * sum_i share_i w_i^2 / (s^2 + 2 zeta_i w_i s + w_i^2)

    with f_a the amplifier's bandwidth. The measurement is S G, S(s) = exp(-s sensor_delay) / (1 + s / (2 pi f_s)). The
    hold of a command for a tick and the mean of a measurement over its tick are in neither: `response` adds them.

    Attributes
    ----------
    sample_rate : float
        Of the loop that it was measured with, or will run in, Hz.
    modes : tuple of Mode
        One to three, with ascending frequencies below 0.45 of the sample rate; their shares sum to 1.
    amplifier_bandwidth : float
        Corner f_a of the amplifier's first-order lag, Hz; 0 is none. It acts on the voltage, before the hysteresis.
    dead_time : float
        Between command and displacement, s, of any fraction of a tick, from -0.5 to 20 ticks. -0.5 is a measurement
        that is sampled at the end of its tick; between -0.5 and 0 it is the mean over the last part of the tick.
    sensor_delay : float
        Of the measurement, not of the true displacement, s.
    sensor_bandwidth : float
        Corner f_s of the sensor's first-order lag, Hz; 0 is none.
    uncertainty : mapping of str to float
        Standard deviations of the numbers by name, such as "frequency[0]" (Hz), "damping[0]", "dead_time" (s).
    trusted_to : float
        Highest frequency at which the model is right, Hz; by default the frequency of the last mode. The feedback
        counts with further modes beyond it.

    Raises
    ------
    SettingError
        A number is out of bounds, the modes do not fit each other, or have no stable inverse.

    Examples
    --------
    >>> Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),), amplifier_bandwidth=3000.0)
    Dynamics: 1 mode, first resonance 700 Hz
      sample_rate          10000 Hz
      mode 0               700 Hz, damping 0.02, share 1
      amplifier_bandwidth  3000 Hz
      dead_time            0 s
      sensor_delay         0 s
      sensor_bandwidth     0 Hz
      trusted_to           700 Hz
    >>> Dynamics(sample_rate=1000.0, modes=(Mode(frequency=700.0, damping=0.02),))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: modes[0].frequency = 700.0 Hz: must be below 450 Hz, 0.45 of the sample rate, which does \
not see it: raise the sample rate
    """

    sample_rate: float = field(metadata=_HZ)
    modes: tuple[Mode, ...]
    amplifier_bandwidth: float = field(default=0.0, metadata=_HZ)
    dead_time: float = field(default=0.0, metadata=_S)
    sensor_delay: float = field(default=0.0, metadata=_S)
    sensor_bandwidth: float = field(default=0.0, metadata=_HZ)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    trusted_to: float = field(default=FOLLOWS, metadata=_HZ)

    def __post_init__(self) -> None:
        rate = checks.sized("sample_rate", self.sample_rate, "Hz", 1e-3, 1e9)
        modes = _checked(self.modes, rate)
        trusted = modes[-1].frequency if self.trusted_to is None else self.trusted_to
        values: dict[str, object] = {
            **{name: _delay(name, getattr(self, name), rate) for name in ("dead_time", "sensor_delay")},
            **{name: _corner(name, getattr(self, name)) for name in ("amplifier_bandwidth", "sensor_bandwidth")},
            "sample_rate": rate,
            "modes": modes,
            "uncertainty": self._deviations(),
            "trusted_to": checks.within("trusted_to", trusted, 0.0, rate / 2, "Hz"),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _deviations(self) -> dict[str, float]:
        each = [f"{name}[{i}]" for name in ("frequency", "damping", "share") for i in range(len(self.modes))]
        single = ("amplifier_bandwidth", "dead_time", "sensor_delay", "sensor_bandwidth")
        words = "a mapping of names to standard deviations"
        given = checks.instance("uncertainty", self.uncertainty, Mapping, words)
        with checks.inside("uncertainty."):
            checks.known(given, (*each, *single))
            return {name: checks.within(name, value, 0.0, 1e12) for name, value in given.items()}

    def _display(self) -> tuple[str, Rows]:
        rows = [("sample_rate", quantity(self.sample_rate, "Hz"))]
        rows += [
            (f"mode {i}", f"{self._with_deviation(f'frequency[{i}]', mode.frequency, 'Hz')}, damping "
             f"{self._with_deviation(f'damping[{i}]', mode.damping)}, share {quantity(mode.share)}")
            for i, mode in enumerate(self.modes)
        ]  # fmt: skip
        units = {"amplifier_bandwidth": "Hz", "dead_time": "s", "sensor_delay": "s", "sensor_bandwidth": "Hz"}
        rows += [(name, self._with_deviation(name, getattr(self, name), unit)) for name, unit in units.items()]
        rows += [("trusted_to", quantity(self.trusted_to, "Hz"))]
        count = f"{len(self.modes)} mode{'s' * (len(self.modes) > 1)}"
        return f"Dynamics: {count}, first resonance {quantity(self.modes[0].frequency, 'Hz')}", rows

    def _with_deviation(self, name: str, value: float, unit: str = "") -> str:
        deviation = f" +- {self.uncertainty[name]:.2g}" if name in self.uncertainty else ""
        return f"{quantity(value)}{deviation} {unit}".rstrip()

    # ---- Responses -------------------------------------------------------------------------------------------------

    def continuous(self, frequency: npt.ArrayLike, *, sensor: bool = False) -> ComplexArray:
        """G(2 pi j f), without the hold of a tick and the mean over a tick.

        Parameters
        ----------
        frequency : array_like
            f, Hz, of any shape.
        sensor : bool
            Whether the sensor is in it: S G in place of G.

        Returns
        -------
        ndarray of complex
            Without unit, of the shape of `frequency`.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
        >>> abs(stage.continuous([0.0, 350.0, 700.0])).round(2)
        array([ 1.  ,  1.33, 25.  ])
        """
        s = 2j * math.pi * np.asarray(frequency, dtype=np.float64)
        delay, corners = self.dead_time, [self.amplifier_bandwidth]
        if sensor:
            delay, corners = delay + self.sensor_delay, [*corners, self.sensor_bandwidth]
        found = sum(mode.response(s) for mode in self.modes)
        lags = [1 + s / (2 * math.pi * corner) for corner in corners if corner]
        late = np.exp(-s * delay) if delay else 1.0
        return np.asarray((late / math.prod(lags) if lags else late) * found)

    def response(self, frequency: npt.ArrayLike, *, sensor: bool = False) -> ComplexArray:
        """From the sequence of commands, each held for a tick, to the sequence of displacements, each the mean over it.

        Entry k of both belongs to tick k. The sum over the aliases is exact::

            sum_n G(2 pi j f_n) sinc(f_n / f_s) sinc(w f_n / f_s),   f_n = f + n f_s,   sinc(x) = sin(pi x) / (pi x)

        with w = 1, or less where the dead time is negative: see `averaged`.

        Parameters
        ----------
        frequency : array_like
            f, Hz, of any shape, up to half of the sample rate f_s.
        sensor : bool
            Whether the sensor is in it: the sequence of measurements.

        Returns
        -------
        ndarray of complex
            Without unit, of the shape of `frequency`; 1 at 0 Hz.

        Raises
        ------
        SettingError
            A frequency is beyond half of the sample rate.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=1e-4)
        >>> np.degrees(np.angle(stage.response([0.0, 100.0, 300.0]))).round(1) + 0.0
        array([  0. ,  -3.9, -12. ])
        """
        f = np.asarray(frequency, dtype=np.float64)
        if f.size and not np.max(np.abs(f)) <= ROUNDED * self.sample_rate / 2:
            bound = f"up to {self.sample_rate / 2:g} Hz, half of the sample rate"
            raise SettingError("frequency", float(np.max(np.abs(f))), bound, "Hz")
        parts = np.split(f.ravel(), range(PIECE, f.size, PIECE))
        return np.concatenate([self._with_aliases(part, sensor=sensor) for part in parts]).reshape(f.shape)

    def _with_aliases(self, f: FloatArray, *, sensor: bool) -> ComplexArray:
        turns, aliases = f[:, None] / self.sample_rate, np.arange(-ALIASES, ALIASES + 1)
        tick = turns + aliases
        delay = self.dead_time + self.sensor_delay if sensor else self.dead_time
        share, sine = averaged(delay * self.sample_rate), np.sin(math.pi * turns) * (1 - 2 * (aliases % 2))
        means = np.divide(sine, math.pi * tick, out=np.ones_like(tick), where=tick != 0)  # sinc, of one sine for all
        means *= means if share == 1.0 else np.sinc(share * tick)
        return np.asarray(np.sum(self.continuous(self.sample_rate * tick, sensor=sensor) * means, axis=-1))

    # ---- Sample rates ----------------------------------------------------------------------------------------------

    def at(self, sample_rate: float) -> Dynamics:
        """The same stage for a loop of another sample rate, Hz: G(s) does not depend on it.

        Raises
        ------
        SettingError
            A resonance is above 0.45 of it, or a dead time beyond 20 ticks.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
        >>> stage.at(2000.0).sample_rate
        2000.0
        """
        return replace(self, sample_rate=sample_rate, trusted_to=min(self.trusted_to, sample_rate / 2))

    def check_rate(self, sample_rate: float) -> Dynamics:
        """Itself, if it is for this sample rate, Hz.

        Raises
        ------
        SettingError
            It is for another one; `at` converts it.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
        >>> stage.check_rate(2000.0)
        Traceback (most recent call last):
            ...
        truestroke.SettingError: dynamics.sample_rate = 10000 Hz: must be 2000 Hz, that of the controller: \
measure them at this rate, or convert them by `Dynamics.at`
        """
        if self.sample_rate != sample_rate:
            remedy = "measure them at this rate, or convert them by `Dynamics.at`"
            bound = f"{sample_rate:g} Hz, that of the controller: {remedy}"
            raise SettingError("dynamics.sample_rate", f"{self.sample_rate:g}", bound, "Hz")
        return self

    # ---- python-control --------------------------------------------------------------------------------------------

    def to_control(self, pade: int = 3, *, sensor: bool = False) -> Any:
        """G(s) as a `control.TransferFunction` of python-control (extra `control`).

        Parameters
        ----------
        pade : int
            Order of the Pade approximation of the dead time, 0 to 12; 0 leaves the dead time out.
        sensor : bool
            Whether the sensor is in it.

        Raises
        ------
        ImportError
            python-control is not installed.
        SettingError
            The dead time is negative: it has no approximation.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=1e-4)
        >>> system = stage.to_control()
        >>> print(f"{abs(system(2j * np.pi * 100.0) / stage.continuous(100.0) - 1):.9f}")
        0.000000000
        """
        import control

        order = checks.count("pade", pade, 0, 12)
        numerator, denominator = _polynomials(self.modes)
        corners, delay = [self.amplifier_bandwidth], self.dead_time
        if sensor:
            corners, delay = [*corners, self.sensor_bandwidth], delay + self.sensor_delay
        for corner in filter(None, corners):
            denominator = np.asarray(np.polymul(denominator, [1 / (2 * math.pi * corner), 1.0]))
        if delay < 0 and order:
            bound = "0 s or more; leave it out with pade=0"
            raise SettingError("dead_time", delay, bound, "s")
        late = control.pade(delay, order) if delay and order else ([1.0], [1.0])
        return control.tf(np.polymul(numerator, late[0]), np.polymul(denominator, late[1]))

    @classmethod
    def from_control(cls, system: Any, sample_rate: float, **others: Any) -> Dynamics:
        """Of a continuous transfer function or state space of python-control.

        Each pair of complex poles is a mode, a real pole the amplifier. Zeros in the right half plane whose mirror
        images are poles are a Pade approximation, and go into the dead time. The static gain becomes 1.

        Parameters
        ----------
        system : control.TransferFunction or control.StateSpace
            With one input and one output, continuous in time.
        sample_rate : float
            Of the loop, Hz.
        **others
            Other members, such as `sensor_delay`; a `dead_time` is added to that of the system, s.

        Raises
        ------
        SettingError
            The system is unstable, not minimum-phase, of another structure, or discrete in time.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=1e-4)
        >>> again = Dynamics.from_control(stage.to_control(), 10000.0)
        >>> round(again.modes[0].frequency, 6), round(again.dead_time, 9)
        (700.0, 0.0001)
        """
        poles, zeros = _structure(system)
        zeros, poles, delay = _without_pade(zeros, poles)
        if zeros.size and zeros.real.max() >= 0:
            raise SettingError("system", f"a zero at {_hz(zeros[zeros.real.argmax()])}", MINIMUM_PHASE)
        pairs = sorted(poles[poles.imag > 0], key=abs)
        slow = -poles[poles.imag == 0].real
        if not 1 <= len(pairs) <= MODES or slow.size > 1:
            bound = f"1 to {MODES} pairs of complex poles, and at most one real pole: reduce it to its first modes"
            raise SettingError("system", f"{len(pairs)} pairs and {slow.size} real poles", bound)
        modes = [Mode(frequency=abs(p) / (2 * math.pi), damping=-p.real / abs(p)) for p in pairs]
        return cls(
            sample_rate=sample_rate,
            modes=_shared(modes, zeros, pairs),
            amplifier_bandwidth=float(slow[0]) / (2 * math.pi) if slow.size else 0.0,
            **{**others, "dead_time": delay + others.get("dead_time", 0.0)},
        )

    # ---- Files -----------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """All members as plain data, for JSON and TOML.

        >>> Dynamics(sample_rate=1e4, modes=(Mode(frequency=700.0, damping=0.02),)).to_dict()["modes"]
        [{'frequency': 700.0, 'damping': 0.02, 'share': 1.0}]
        """
        return {**asdict(self), "modes": [asdict(mode) for mode in self.modes], "uncertainty": dict(self.uncertainty)}

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> Dynamics:
        """What `to_dict` made, or a table of a file with the same keys.

        Raises
        ------
        SettingError
            A key is unknown or missing, or its value is out of bounds.

        Examples
        --------
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
        >>> Dynamics.from_dict(stage.to_dict()) == stage
        True
        """
        return toml.decode(cls, given)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a TOML file, such as dynamics.toml; dynamics that are there are replaced.

        Raises
        ------
        FileExistsError
            A file is there that has no dynamics; within `files.overwriting` it is replaced.
        """
        table = self.to_dict()
        lines = [f"format = {toml.text(FORMAT)}", f"version = {VERSION}", ""]
        lines += [f"{name} = {toml.text(table[name])} # {unit}" for name, unit in _UNITS.items()]
        for mode in table["modes"]:
            lines += ["", "[[modes]] # frequency: Hz; share: of the static displacement"]
            lines += [f"{name} = {toml.text(value)}" for name, value in mode.items()]
        lines += ["", "[uncertainty] # standard deviations"]
        lines += [f"{toml.text(name)} = {toml.text(value)}" for name, value in self.uncertainty.items()]
        files.write(checks.path("path", path), "\n".join(lines) + "\n", files.DYNAMICS)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Dynamics:
        """Read what `save` wrote, perhaps edited since.

        Raises
        ------
        FileError
            The file is not there, is no TOML, has no dynamics, or an entry is unknown, missing or out of bounds.
        """
        name = os.fspath(checks.path("path", path))
        try:
            return cls._of_file(toml.read(path))
        except FileNotFoundError:
            raise files.FileError(f"{name}: there is no such file; truestroke bode writes it") from None
        except (OSError, SettingError) as error:
            raise files.FileError(f"{name}: {error}") from error

    @classmethod
    def _of_file(cls, document: dict[str, Any]) -> Dynamics:
        if (kind := document.pop("format", "no format")) != FORMAT:
            raise SettingError("format", repr(kind), f"{FORMAT!r}: this is no file of truestroke bode")
        if (version := document.pop("version", "no version")) != VERSION:
            words = f"{VERSION}, the one that this truestroke reads: measure again with truestroke bode"
            raise SettingError("version", repr(version), words)
        return cls.from_dict(document)


_UNITS = {name: str(entry.metadata["unit"]) for name, entry in Dynamics.__dataclass_fields__.items() if entry.metadata}

MINIMUM_PHASE = (
    "minimum-phase, for its inverse would be unstable: leave out the mode with the negative share, "
    "or describe the delay as a dead time"
)


# ---- Checks --------------------------------------------------------------------------------------------------------


def _delay(name: str, value: float, rate: float) -> float:
    return checks.within(name, value, EARLIEST / rate, LATEST / rate, "s")


def _corner(name: str, value: float) -> float:
    if checks.number(name, value, "Hz") < 0:
        raise SettingError(name, value, "above 0 Hz, or 0 where it is not known", "Hz")
    return checks.sized(name, value, "Hz", 1e-3, 1e9) if value else 0.0


def _checked(given: Sequence[Mode], rate: float) -> tuple[Mode, ...]:
    """The modes, where they fit the sample rate and each other."""
    modes = checks.several("modes", given, of="Mode")
    checks.count("the number of modes", len(modes), 1, MODES)
    for i, mode in enumerate(modes):
        checks.instance(f"modes[{i}]", mode, Mode, "a Mode(frequency=..., damping=...)")
        if mode.frequency >= SEEN * rate:
            bound = f"below {SEEN * rate:g} Hz, {SEEN} of the sample rate, which does not see it: raise the sample rate"
            raise SettingError(f"modes[{i}].frequency", mode.frequency, bound, "Hz")
        if i and mode.frequency <= modes[i - 1].frequency:
            bound = f"above {modes[i - 1].frequency:g} Hz, that of the mode before: sort the modes"
            raise SettingError(f"modes[{i}].frequency", mode.frequency, bound, "Hz")
    total = math.fsum(mode.share for mode in modes)
    if abs(total - 1) > SHARES:
        raise SettingError("the sum of the shares", f"{total:.6g}", "1: they are parts of the static displacement")
    zeros = zeros_of(modes)
    if zeros.size and zeros.real.max() >= 0:
        raise SettingError("modes", f"modes with a zero at {_hz(zeros[zeros.real.argmax()])}", MINIMUM_PHASE)
    return modes


def zeros_of(modes: Sequence[Mode]) -> ComplexArray:
    """Zeros of the sum of the modes, rad/s: between two of them the stage hardly moves.

    >>> pair = Mode(frequency=700.0, damping=0.02, share=0.9), Mode(frequency=1900.0, damping=0.03, share=0.1)
    >>> (np.abs(zeros_of(pair)) / (2 * np.pi)).round().tolist()
    [1485.0, 1485.0]
    """
    return np.asarray(np.roots(_polynomials(modes)[0]), dtype=np.complex128)


def _polynomials(modes: Sequence[Mode]) -> tuple[FloatArray, FloatArray]:
    """Numerator and denominator of the sum of the modes, highest power of s first."""
    w = [2 * math.pi * mode.frequency for mode in modes]
    parts = [np.array([1 / w_i**2, 2 * mode.damping / w_i, 1.0]) for w_i, mode in zip(w, modes, strict=True)]
    numerator, denominator = np.zeros(1), np.ones(1)
    for i, (mode, part) in enumerate(zip(modes, parts, strict=True)):
        others = np.array([mode.share])
        for other in (*parts[:i], *parts[i + 1 :]):
            others = np.polymul(others, other)
        numerator, denominator = np.polyadd(numerator, others), np.polymul(denominator, part)
    return numerator, denominator


def _hz(root: complex) -> str:
    return f"{abs(root) / (2 * math.pi):.4g} Hz"


# ---- Systems of python-control -------------------------------------------------------------------------------------


def _structure(system: Any) -> tuple[ComplexArray, ComplexArray]:
    """Poles and zeros of a stable continuous system, rad/s."""
    words = "a control.TransferFunction or control.StateSpace of python-control"
    checks.able("system", system, ("poles", "zeros", "dcgain"), words)
    if getattr(system, "dt", 0) not in (0, None):
        raise SettingError("system", f"one with dt = {system.dt}", "continuous in time, without the hold of a tick")
    if (getattr(system, "ninputs", 1), getattr(system, "noutputs", 1)) != (1, 1):
        raise SettingError("system", f"{system.noutputs} x {system.ninputs}", "of one input and one output")
    found = system.poles(), _zeros(system) if hasattr(system, "A") else system.zeros()
    poles, zeros = (np.asarray(roots, dtype=np.complex128) for roots in found)
    if poles.size and poles.real.max() >= 0:
        bound = "stable: fit it again with fewer modes, or measure it with truestroke.measure_dynamics"
        raise SettingError("system", f"a pole at {_hz(poles[poles.real.argmax()])} that does not decay", bound)
    gain = complex(np.squeeze(system.dcgain()))
    if not (math.isfinite(gain.real) and gain.real > 0):
        bound = "above 0: a command that rises moves the stage up"
        raise SettingError("system", f"a static gain of {gain.real:g}", bound)
    return poles, zeros


def _zeros(system: Any) -> ComplexArray:
    """Zeros of a state space, rad/s: of its balanced states, for those of a companion form lose all digits."""
    from scipy.linalg import eigvals, matrix_balance

    A, (scale, _) = matrix_balance(system.A, permute=False, separate=True)
    B, C = system.B / scale[:, None], system.C * scale
    pencil = np.block([[A, B / abs(B).max()], [C / abs(C).max(), system.D / (abs(B).max() * abs(C).max())]])
    zeros = eigvals(pencil, np.diag([*np.ones(len(A)), 0.0]))
    return np.asarray(zeros[np.isfinite(zeros)])


def _without_pade(zeros: ComplexArray, poles: ComplexArray) -> tuple[ComplexArray, ComplexArray, float]:
    """Zeros and poles without the pairs z, -z of an all-pass, and the delay of that, sum 2 / z, s."""
    kept_zeros, kept_poles, delay = [], list(poles), 0.0
    for zero in zeros:
        mirrored = [p for p in kept_poles if abs(p + zero) < 1e-4 * abs(zero)] if zero.real > 0 else []
        if mirrored:
            kept_poles.remove(mirrored[0])
            delay += (2 / zero).real
        else:
            kept_zeros.append(zero)
    return np.array(kept_zeros, dtype=np.complex128), np.array(kept_poles, dtype=np.complex128), delay


def _shared(modes: Sequence[Mode], zeros: ComplexArray, pairs: Sequence[complex]) -> tuple[Mode, ...]:
    """The modes with the shares that give these zeros; SettingError where none do."""
    s = 2j * math.pi * np.concatenate([m.frequency * np.geomspace(0.3, 1.5, 25) for m in modes])
    wanted = np.prod([1 - s / z for z in zeros], axis=0) if zeros.size else np.ones(s.size)
    wanted = wanted / np.prod([(1 - s / p) * (1 - s / np.conj(p)) for p in pairs], axis=0)
    parts = np.column_stack([mode.response(s) for mode in modes]) / abs(wanted)[:, None]
    # The last share is 1 minus the others.
    left, right = parts[:, :-1] - parts[:, -1:], wanted / abs(wanted) - parts[:, -1]
    both = np.vstack([left.real, left.imag]), np.concatenate([right.real, right.imag])
    first = np.linalg.lstsq(*both, rcond=None)[0] if len(modes) > 1 else np.zeros(0)
    error = float(np.max(np.abs(left @ first - right)))
    if error > APPROXIMATED:
        bound = f"a sum of modes, share w^2 / (s^2 + 2 zeta w s + w^2), within {100 * APPROXIMATED:g} %"
        raise SettingError("system", f"a response that modes meet within {100 * error:.2g} %", bound)
    shares = [*map(float, first), 1.0 - math.fsum(first)]
    return tuple(replace(mode, share=share) for mode, share in zip(modes, shares, strict=True))
