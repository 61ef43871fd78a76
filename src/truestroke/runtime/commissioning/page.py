"""The page of an axis that was commissioned."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import truestroke
from truestroke.base import files
from truestroke.report import style
from truestroke.report.page import render, sentence, svg
from truestroke.runtime.commissioning.findings import Findings
from truestroke.runtime.commissioning.pictures import pictures

CAPTIONS = {
    "steps": (
        "The first steps",
        "Voltage from the safe voltage up and back, in steps that grow until the answer is clear, and the "
        "displacement. Both must go the same way.",
    ),
    "answer": (
        "Answer to a step",
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
WORDS = {"good": "The axis answers as it was told.", "doubtful": "Read this before you use the axis."}


def save_page(found: Findings, path: Path, written: list[str], command: str) -> Path:
    """Write the page to `path`; nothing outside the file is needed to read it.

    Parameters
    ----------
    found : Findings
        The axis.
    path : Path
        HTML.
    written : list[str]
        What went into the configuration, a line each.
    command : str
        What repeats it.
    """
    drawn, verdict = pictures(found, style.PAGE), found.verdict()
    keys = [["written", "-", "nothing: the configuration is as it was"]] if not written else []
    keys += [["written", *line.split(" = ", 1)] for line in written]
    rows = [[cell.replace(" um", " µm") for cell in row] for row in [*found.rows(), *keys]]
    safe = found.limits.get("safe_voltage", 0.0)
    low, high = found.limits["voltage_limits"]
    page = render(
        "zoo",
        title=f"Axis {found.name}, commissioned",
        lead=f"Steps of up to {found.small.gain.step:.3g} V from {safe:g} V, then slowly to {high:g} and {low:g} V.",
        verdict=verdict.level,
        verdict_words=WORDS[verdict.level],
        reasons=[sentence(reason) for reason in verdict.reasons],
        tables=[{"columns": ["", "found", ""], "rows": rows, "words": True, "note": ""}],
        figures=[
            {"heading": heading, "caption": caption, "svg": svg(drawn[name], name, caption)}
            for name, (heading, caption) in CAPTIONS.items()
        ],
        command=command,
        footer=f"truestroke {truestroke.__version__} · made {datetime.now(UTC).isoformat(timespec='seconds')}",
    )
    return files.write(path, page, files.PAGE)
