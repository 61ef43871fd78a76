"""Sentences on a recording: shared by the page and the command line."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from truestroke.base.flags import FLAGS
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.report import units
from truestroke.signals import judgement
from truestroke.signals.judgement import change_time
from truestroke.signals.judgement import settings as _settings
from truestroke.signals.metrics import TrackingSummary
from truestroke.signals.recording import Recording, versions

SENSELESS = 1e4  # % of peak-to-peak and more: the motion has hardly begun
FINE = 1e-3  # um: errors below have two more digits
NAMES = {
    "AdaptiveController": "the adaptive inverse controller",
    "paper": "the adaptive inverse controller of the paper, to the letter",
    "RealisticPlant": "a simulated stack (realistic: more than the controller's model can describe)",
    "MatchedPlant": "a simulated stack (matched: of exactly the controller's structure)",
    "StagePlant": "a simulated stage",
    "MultiAxisStage": "a simulated stage of several axes",
    "MultiAxisController": "controllers that know how the other axes move",
    "SimulatedDriver": "a simulated stack in real time",
    "NidaqmxDriver": "hardware with an NI-DAQmx card",
    "PiDriver": "a controller of Physik Instrumente",
    "Nv200Driver": "a controller of piezosystem jena",
    "VisaDriver": "an instrument with VISA",
    "OneAxis": "one channel of hardware",
}
REMARKS = {
    "good": "It was followed as it should be.",
    "doubtful": "Read this before you use the metrics.",
    "bad": "Do not use the metrics of this run.",
}
HAPPENED = {flag.name: flag.words for flag in FLAGS} | {"missing": "had no measurement"}

MADE_OF = (
    "Spectrum: how much of the error{part} each frequency has; a peak is what repeats, such as the motion, a resonance "
    "or the mains. Histogram: how often each error occurs; noise alone is a bell."
)
CAPTIONS = {
    "tracking": (
        "Tracking",
        "Desired motion and what the actuator did. Look at the lower panel: where the coloured line leaves the grey "
        "one is the worst half second of the second half.",
    ),
    "error": (
        "Error",
        "Displacement minus desired displacement. Look above at how soon it becomes small, below at whether it stays "
        "so; note that the scales differ.",
    ),
    "spectrum": ("Of what the error is made", ""),  # its caption is by `spectrum`
    "loop": (
        "Hysteresis, before and after",
        "Displacement over desired displacement in the last seconds of the same wave, first with a constant gain in "
        "place of the controller. A loop that has closed to a straight line is hysteresis that has been compensated.",
    ),
    "weights": (
        "Weights",
        "What the controller has learned about the actuator. Look for lines that become level; a jump is a "
        "change of the actuator or of what its motion excites.",
    ),
    "voltage": (
        "Voltage",
        "The command of the controller. A line that touches the limits had no travel left.",
    ),
}


def _section(recording: Recording, name: str) -> Mapping[str, Any]:
    """A section of the metadata, empty where there is none."""
    value = recording.metadata.get(name)
    return value if isinstance(value, Mapping) else {}


def _name(recording: Recording, section: str, otherwise: str) -> str:
    name = str(_section(recording, section).get("name", otherwise))
    return NAMES.get(name, name)


def voltage_limits(recording: Recording) -> tuple[float, float] | None:
    """Lowest and highest voltage of the controller, V."""
    limits = _settings(recording, "controller").get("voltage_limits")
    return None if limits is None else (float(limits[0]), float(limits[1]))


def title(recording: Recording, summary: TrackingSummary, verdict: Verdict) -> str:
    """The heading of a page: the motion and how well it was followed, or that it was not."""
    kind, motion = kinds(summary)[-1], _name(recording, "trajectory", "motion")
    rmse = units.length(getattr(summary, f"{kind}_rmse_um"))
    if verdict.is_bad:
        cut = recording.metadata.get("interrupted")
        return f"NOT FOLLOWED{' TO THE END' if cut else ''}: {motion}, {rmse} rmse{' until then' if cut else ''}"
    return f"{motion.capitalize()}, followed to {rmse} rmse"


def run(recording: Recording, summary: TrackingSummary, verdict: Verdict) -> str:
    """What was run, in a sentence or two."""
    motion, driver = _name(recording, "trajectory", "motion"), _name(recording, "controller", "a controller")
    driver = NAMES.get(_section(recording, "options").get("controller", ""), driver)
    span = _settings(recording, "trajectory").get("peak_to_peak", summary.peak_to_peak_um)
    did = "was to follow" if verdict.is_bad else "followed"
    what = (
        f"{_name(recording, 'plant', 'an actuator')} {did} a {motion} of {span:.1f} um peak to "
        f"peak{_rate(recording)} for {summary.duration_s:.4g} s at {summary.ticks / summary.duration_s:.0f} ticks per "
        f"second, driven by {driver}."
    )
    change = change_time(recording)
    sudden = "" if change is None else f" At {change:g} s it changed suddenly."
    cut = " The run was interrupted." if recording.metadata.get("interrupted") else ""
    notices = recording.metadata.get("notices")
    stated = [str(notice) for notice in notices] if isinstance(notices, list) else []
    before = f" Stated before the run: {'; '.join(stated)}." if stated else ""
    subtracted = f" {words[0].upper()}{words[1:]}" if (words := zero(zero_of(recording))) else ""
    return what[0].upper() + what[1:] + sudden + cut + before + subtracted


def zero_of(recording: Recording) -> float:
    """What was subtracted of each measurement, um, because the sensor was not zeroed or the settings say so."""
    found = _section(recording, "axis_check").get(_section(recording, "axis").get("name", ""))
    return float(found.get("zero", 0.0)) if isinstance(found, dict) else 0.0


def zero(subtracted: float) -> str:
    """The same as a sentence that begins small; empty of 0 um."""
    return f"a zero of the sensor of {subtracted:.4g} um is subtracted (`zero`)." if subtracted else ""


def _rate(recording: Recording) -> str:
    settings = _settings(recording, "trajectory")
    frequency = settings.get("frequency", settings.get("cutoff"))
    return "" if frequency is None else f" and {'up to about ' if 'cutoff' in settings else ''}{frequency:g} Hz"


def span(summary: TrackingSummary) -> str:
    """The time over which the metrics in the table are taken."""
    return f"{summary.counted_from_s:.4g} to {summary.duration_s:.4g} s"


def kinds(summary: TrackingSummary) -> list[str]:
    """The kinds of error that are known: measured, and true where it was simulated."""
    return ["measured"] if summary.true_rmse_um is None else ["measured", "true"]


def table(summary: TrackingSummary) -> list[tuple[str, list[tuple[str, str]]]]:
    """Rows of (name, cells), each cell (um, "% of peak-to-peak"), in the order of `kinds`; "-" of a motion at rest."""
    found = summary.as_dict()

    def cell(what: str) -> tuple[str, str]:
        share, um = float(found[f"{what}_percent"] or 0.0), float(found[f"{what}_um"] or 0.0)
        return f"{um:.6f}" if 0 < um < FINE else f"{um:.4f}", f"{share:.2f} %" if share < SENSELESS else "-"

    return [(row, [cell(f"{kind}_{row}") for kind in kinds(summary)]) for row in ("rmse", "maximum")]


def course(summary: TrackingSummary) -> list[tuple[str, str]]:
    """When the error became small, and small again after a sudden change: rows of (name, in a few words)."""
    rows = [("converged", _converged(summary))]
    return rows if summary.change_s is None else [*rows, ("recovered", _recovered(summary, summary.change_s))]


def _converged(summary: TrackingSummary) -> str:
    time, change = summary.convergence_time_s, summary.change_s
    if time is not None:
        return f"after {time:.2f} s" if time > 0 else "from the start"
    until, end = ("the change", change) if change is not None else ("the end", summary.duration_s)
    if end >= 1 > summary.judged_s:
        return "not known: errors are judged for less than 1 s"
    return f"not before {until}" if end >= 1 else f"not known: {until} comes within 1 s"


def _recovered(summary: TrackingSummary, change: float) -> str:
    time, left = summary.recovery_time_s, summary.duration_s - change
    if time is not None:
        return (
            f"{time:.2f} s after the change at {change:g} s" if time > 0 else f"at once from the change at {change:g} s"
        )
    if min(left, change) < 1:
        return f"not known: there is less than 1 s {'after' if left < 1 else 'before'} the change at {change:g} s"
    return f"not within the {left:.4g} s after the change"


def repeated(recording: Recording) -> list[tuple[str, str]]:
    """The row of what was learned of a motion that repeats; none where nothing was to be learned."""
    period, errors = judgement.repetition(recording)
    if not period:
        return []
    of_period = f"of the period of {1e3 * period:.4g} ms"
    if not errors:
        return [("repeats", f"nothing learned {of_period}: no batch of it was complete")]
    first, last = (units.length(um) for um in (errors[0], errors[-1]))
    if len(errors) == 1:
        return [("repeats", f"mean error {of_period}: {first} rms in one batch, nothing learned yet")]
    return [("repeats", f"mean error {of_period}: {first} rms in the first batch, {last} in the last of {len(errors)}")]


def flags(summary: TrackingSummary) -> list[str]:
    """The events of the run, in a few words for each kind of flag; empty without events."""
    counts = summary.as_dict()
    return [
        f"{what} in {count:,.0f} tick{'' if count == 1 else 's'} ({_percent(count / summary.ticks)})"
        for kind, what in HAPPENED.items()
        if (count := counts[f"{kind}_ticks"])
    ]


def _percent(part: float) -> str:
    return f"{100 * part:.1f} %" if part >= 0.0005 else "below 0.1 %"


def command(recording: Recording) -> str | None:
    """The command that makes this recording again, where a command made it."""
    made_by = recording.metadata.get("command")
    return None if made_by is None else str(made_by)


def footer(recording: Recording) -> str:
    """Versions, seed and date of a recording in a line."""
    seed = _settings(recording, "plant").get("seed")
    known = [] if seed is None else [f"seed {seed}"]
    return made(_section(recording, "versions"), recording.metadata.get("created"), *known)


def made_now() -> str:
    """Versions and date of what is computed now, in a line."""
    return made(versions(), datetime.now(UTC).isoformat(timespec="seconds"))


def made(versions: Mapping[str, str], created: str | None, *known: str) -> str:
    """Versions, what else is known, and date in a line.

    Examples
    --------
    >>> made({"truestroke": "0.1.0", "python": "3.12.1"}, "2026-01-31T12:00:00+00:00", "seed 7")
    'truestroke 0.1.0 · python 3.12.1 · seed 7 · made 2026-01-31T12:00:00+00:00'
    """
    shown = [f"{name} {versions[name]}" for name in ("truestroke", "numpy", "python") if name in versions]
    if "commit" in versions:
        shown[0] += f" ({versions['commit'][:12]})"
    return " · ".join([*shown, *known, *([f"made {created}"] if created else [])])


def spectrum(errors: Iterable[FloatArray], part: str = "", between: int = 0) -> tuple[str, str]:
    """Heading and caption of the pictures: what they show, and what was done where samples are missing.

    Parameters
    ----------
    errors : iterable of ndarray
        As `spectra.spectrum` takes them, of equal length.
    part : str
        Of what they are, such as "of the second half".
    between : int
        Samples between the lines of a scan, which are no number and no loss.

    Examples
    --------
    >>> print(spectrum([np.array([1.0, np.nan, 3.0])])[1].partition("bell. ")[2])
    1 of 3 samples are missing: the spectrum has a straight line in their place, so that all others keep their time; \
the histogram leaves them out.
    >>> print(spectrum([np.array([1.0, np.nan, 3.0])], between=1)[1].partition("bell. ")[2])
    Between the lines the spectrum has a straight line; the histogram leaves these samples out.
    """
    known = [np.isfinite(error) for error in errors]
    missing = max((int(np.count_nonzero(~one)) for one in known), default=0) - between
    text = MADE_OF.format(part=f" {part}" if part else "")
    if between:
        text += " Between the lines the spectrum has a straight line; the histogram leaves these samples out."
    if missing > 0:
        text += (
            f" {missing:,} of {known[0].size:,} samples are missing: the spectrum has a straight line in their place, "
            "so that all others keep their time; the histogram leaves them out."
        )
    return CAPTIONS["spectrum"][0], text
