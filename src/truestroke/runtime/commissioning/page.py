"""The page of an axis that was commissioned."""

from __future__ import annotations

from truestroke.report import words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.runtime.commissioning.findings import Findings
from truestroke.runtime.commissioning.plots import plots

CAPTIONS = {
    "steps": (
        "The first steps",
        "Voltage from the safe voltage up and back, in steps that grow until the response is clear, and the "
        "displacement. Both must go the same way.",
    ),
    "answer": (
        "Step response",
        "The first of the steps that ring, at time 0, and a stage with one resonance behind a lag and a delay, fitted "
        "to all of them. Look for points that leave the line.",
    ),
    "ringing": (
        "Ringing",
        "How fast the axis moves at each frequency in the same steps. The peak is the first resonance, where known.",
    ),
    "range": (
        "The whole range",
        "Slowly to the voltage limits and back. The loop is hysteresis; the band is the stroke.",
    ),
}
WORDS = {"good": "The axis responds as configured.", "doubtful": "Read this before you use the axis."}


def page(found: Findings, written: list[str], command: str) -> Page:
    """The page of an axis.

    Parameters
    ----------
    found : Findings
        The axis.
    written : list[str]
        What went into the configuration, a line each.
    command : str
        What repeats it.
    """
    keys = [["written", "-", "nothing: the configuration is as it was"]] if not written else []
    keys += [["written", *line.split(" = ", 1)] for line in written]
    safe, verdict = found.limits.get("safe_voltage", 0.0), found.verdict()
    low, high = found.limits["voltage_limits"]
    return Page(
        title=f"Axis {found.name}, commissioned",
        lead=f"Steps of up to {found.small.gain.step:.3g} V from {safe:g} V, then slowly to {high:g} and {low:g} V.",
        verdict=verdict,
        remark=WORDS[verdict.level],
        sections=[
            Section(tables=[Table(columns=["", "found", ""], rows=[*found.rows(), *keys], text=True)]),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: plots(found, theme),
        command=command,
        footer=words.made_now(),
    )
