"""Page of the paper's figures and tables beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from truestroke.base import files
from truestroke.report import style, words
from truestroke.report.page import render, svg
from truestroke.signals.recording import Recording, versions
from truestroke.studies.paper.reproduction import Reproduction

LEAD = (
    "What the paper prints (Tan et al., Sensors and Actuators A 150, 2009, 116-123) beside what its algorithm does "
    "here to the letter, on simulated actuators. One set of settings makes everything; a dash is a number that the "
    "paper does not print."
)


def save_page(results: Sequence[Reproduction], path: str | Path, command: str | None = None) -> Path:
    """Write the page of figures and tables to `path`; nothing outside the file is needed to read it.

    Parameters
    ----------
    results : sequence of Reproduction
        In the order of the page.
    path : path
        Of the page.
    command : str, optional
        What makes this page again.
    """
    path = Path(path)
    about = {"versions": versions(), "created": datetime.now(UTC).isoformat(timespec="seconds")}
    page = render(
        "reproduction",
        title="The paper's figures beside ours",
        lead=LEAD,
        results=[
            {
                "title": result.title,
                "rows": [[cell.replace("um", "µm") for cell in row.cells()] for row in result.rows],
                "sentence": result.sentence,
                "svg": svg(result.draw(style.PAGE), result.name, result.title),
            }
            for result in results
        ],
        command=command,
        footer=words.footer(Recording({}, about)),
    )
    return files.write(path, page, files.PAGE)
