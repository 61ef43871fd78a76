"""Page of the paper's figures and tables beside ours."""

from collections.abc import Sequence

from truestroke.report import words
from truestroke.report.page import Page, Section, Table
from truestroke.studies.paper.reproduction import Reproduction

LEAD = (
    "What the paper prints (Tan et al., Sensors and Actuators A 150, 2009, 116-123) beside what its algorithm does "
    "here to the letter, on simulated actuators. One set of settings makes everything; a dash is a number that the "
    "paper does not print."
)
COLUMNS = ("quantity", "paper", "ours", "unit")


def page(results: Sequence[Reproduction], command: str | None = None) -> Page:
    """The page of figures and tables, in the order of `results`; `command` is what repeats it."""
    return Page(
        title="The paper's figures beside ours",
        lead=LEAD,
        sections=[
            Section(
                heading=result.title,
                text=result.sentence,
                tables=[Table(columns=COLUMNS, rows=[row.cells() for row in result.rows], text=True)],
                plot=result.name,
            )
            for result in results
        ],
        plots=lambda theme: {result.name: result.plot(theme) for result in results},
        command=command,
        footer=words.made_now(),
    )
