"""Tables and page of the zoo."""

from __future__ import annotations

from collections.abc import Sequence

from truestroke.report import words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.signals.recording import Recording
from truestroke.studies.zoo import pictures
from truestroke.studies.zoo.figures import SHOCK, START
from truestroke.studies.zoo.pictures import NAMES
from truestroke.studies.zoo.table import COLUMNS, LIMIT, Result, beyond, lines

SHOWN = 5  # runs with the largest errors
CAPTIONS = {
    "distribution": (
        "How the errors are distributed",
        "Part of the runs whose true rmse is at most so much. Further left is better, and steeper: the same for every "
        "actuator. Mind the scale, which is logarithmic.",
    ),
    "largest": (
        "The largest error of each run",
        "A burst shows here even where the rmse forgives it: the higher above the diagonal, the rarer and the larger.",
    ),
    "worst": (
        "The worst run",
        "The run with the largest error that counts: its motion and its error after the first 0.5 s, and around that "
        "error. A triangle marks what is off the scale.",
    ),
}
LEFT_OUT = f"the first {START:g} s and the {1e3 * SHOCK:g} ms after a change"
WORST_NOTE = (
    "µm. Ringing is what the jump of a change leaves of the free resonance 50 ms later; no controller can take it away."
)
NOTE = (
    "True displacement. rmse and maximum are of the second half of the motion without 0.1 s after a change; the "
    f"largest error that counts leaves out {LEFT_OUT}, which have a row of their own. The ratio is run by run."
)


def table(results: Sequence[Result]) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the table, as text: median, 95th percentile and worst, um, and the ratio to the paper's."""
    found, rows = lines(results), []
    ratio = any(line.ratio for line in found)
    for line in found:
        cells = [f"{COLUMNS[line.figure]}, {NAMES[line.controller]}", str(line.runs)]
        cells += [f"{value:.4f}" for value in (line.median, line.p95, line.worst)]
        if ratio:
            cells.append("1/" + " 1/".join(f"{1 / part:.0f}" for part in line.ratio) if line.ratio else "")
        rows.append(cells)
    return ["true displacement, um", "runs", "median", "95 %", "worst"] + ["of the paper's"] * ratio, rows


def worst_runs(results: Sequence[Result]) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the runs with the largest errors, as text."""
    controller = pictures.first(results)
    ordered = sorted(results, key=lambda result: -result.figures[controller].largest)[:SHOWN]
    rows = []
    for result in ordered:
        found = result.figures[controller]
        cells = [f"{found.rmse:.4f}", f"{found.largest:.3f}", f"{found.largest_at:.2f} s", f"{found.ringing:.3f}"]
        cells.append(f"{found.left_out:.3f}")
        rows.append([str(result.number), *cells, result.words])
    return ["run", "rmse", "largest", "at", "ringing", "left out", "what happened"], rows


def verdict(results: Sequence[Result], controller: str) -> str:
    """How many runs have an error above the limit, in a sentence."""
    above, beyond_ringing = beyond(results, controller)
    name = NAMES[controller].capitalize()
    outside = [result.figures[controller].left_out for result in results]
    text = f"{name}: {above} of {len(results)} runs have an error above {LIMIT:g} um, {LEFT_OUT} left out"
    if above > beyond_ringing:
        text += f"; in {above - beyond_ringing} of them it is what the jump of the change leaves ringing freely"
    return f"{text}. In what is left out {sum(e > LIMIT for e in outside)} have one, up to {max(outside):.2f} um."


def page(results: Sequence[Result], recording: Recording, seed: int, command: str | None = None) -> Page:
    """The page of the zoo.

    Parameters
    ----------
    results : sequence of Result
        The runs.
    recording : Recording
        Of the worst run, with the first controller.
    seed : int
        Of the zoo.
    command : str, optional
        What makes this page again.
    """
    (columns, rows), (worst_columns, worst_rows) = table(results), worst_runs(results)
    found = Table(columns=columns, rows=rows, note=NOTE)
    worst = Table(columns=worst_columns, rows=worst_rows, note=WORST_NOTE, text=True)
    return Page(
        title=f"{len(results)} plants, drawn at random",
        lead=" ".join(verdict(results, name) for name in results[0].figures),
        sections=[Section(tables=[found, worst]), *captioned(CAPTIONS)],
        plots=lambda theme: pictures.pictures(results, recording, seed, theme),
        command=command,
        footer=words.footer(recording),
    )
