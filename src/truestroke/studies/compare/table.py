"""The same actuator and waves under every controller: one table."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from truestroke.base import checks
from truestroke.base.verdict import Verdict
from truestroke.control.controller import Controller
from truestroke.runtime.loop import Actuator, run
from truestroke.signals import judgement, metrics
from truestroke.signals.metrics import TrackingSummary
from truestroke.signals.recording import Recording
from truestroke.signals.trajectories import Trajectory


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """One controller on one wave. All metrics are of the second half of the run.

    Attributes
    ----------
    controller, wave : str
        Names.
    summary : TrackingSummary
        rmse and maximum, measured and true, um and % of peak-to-peak, and what else it holds.
    delay_ms : float
        Time by which the motion comes after the desired one, ms.
    phase_lag_deg : float or None
        Angle by which it comes after, degrees, where the wave has one frequency.
    verdict : Verdict
        Of the run, as `truestroke.judge` has it.
    recording : Recording
        The whole run, for pictures.
    """

    controller: str
    wave: str
    summary: TrackingSummary
    delay_ms: float
    phase_lag_deg: float | None
    verdict: Verdict
    recording: Recording = field(repr=False)

    def as_dict(self) -> dict[str, object]:
        """All but the recording, for JSON."""
        return {
            "controller": self.controller,
            "wave": self.wave,
            **self.summary.as_dict(),
            "delay_ms": self.delay_ms,
            "phase_lag_deg": self.phase_lag_deg,
            **self.verdict.as_dict(),
        }


def compare(
    make_actuator: Callable[[], Actuator],
    trajectories: Iterable[Trajectory],
    controllers: Mapping[str, Callable[[], Controller]],
    progress: Callable[[int, int], None] | None = None,
) -> list[Row]:
    """Every controller on every wave, each time with a fresh actuator and a fresh controller.

    Parameters
    ----------
    make_actuator : callable
        Gives the same actuator each time: the same settings and the same seed.
    trajectories : iterable of Trajectory
        The waves.
    controllers : mapping of str to callable
        By name, what gives a fresh controller.
    progress : callable, optional
        Called as progress(runs done, all runs).

    Returns
    -------
    list of Row
        Controller by controller, each with all waves.

    Examples
    --------
    >>> from truestroke.control.baselines import ConstantGain
    >>> from truestroke.signals.timing import Timing
    >>> from truestroke.signals.trajectories import sine
    >>> class Spring:
    ...     def open(self):
    ...         return Timing(sample_rate=2000.0)
    ...     def exchange(self, volts):
    ...         return 10.0 * volts
    >>> waves = [sine(frequency=8.0, peak_to_peak=20.0, duration=2.0)]
    >>> limits = (-0.6, 3.6)
    >>> gains = {"right": lambda: ConstantGain(10.0, limits), "wrong": lambda: ConstantGain(11.0, limits)}
    >>> for row in compare(Spring, waves, gains):
    ...     print(row.controller, row.wave, round(row.summary.measured_rmse_percent, 3), abs(round(row.delay_ms, 3)))
    right sine 0.0 0.0
    wrong sine 5.567 0.0
    """
    checks.able("make_actuator", make_actuator, ("__call__",), "a function that gives an actuator")
    waves = checks.several("trajectories", trajectories, of="Trajectory")
    checks.instance("controllers", controllers, Mapping, "a mapping of names to functions that give a controller")
    for name, make in controllers.items():
        checks.able(f"controllers[{name!r}]", make, ("__call__",), "a function that gives a controller")
    rows = []
    for name, make in controllers.items():
        for wave in waves:
            rows.append(_row(name, run(wave, make(), make_actuator()), wave))
            if progress:
                progress(len(rows), len(waves) * len(controllers))
    return rows


def _row(name: str, recording: Recording, wave: Trajectory) -> Row:
    half = len(wave) // 2
    moved = recording["true" if "true" in recording else "measured"][half:]
    frequency = wave.settings.get("frequency")
    pair = wave.position[half:], moved
    return Row(
        controller=name,
        wave=wave.name,
        summary=metrics.summary(recording),
        delay_ms=metrics.delay(*pair, wave.sample_rate),
        phase_lag_deg=None
        if not isinstance(frequency, float)
        else metrics.phase_lag(*pair, wave.sample_rate, frequency),
        verdict=judgement.judge(recording),
        recording=recording,
    )


def judge(rows: Sequence[Row]) -> Verdict:
    """Of the last of the controllers over all waves: the others are there to be compared with."""
    return judgement.worst({row.wave: row.verdict for row in rows if row.controller == rows[-1].controller})
