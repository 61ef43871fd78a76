"""The paper's figures and tables, a function each; nothing is tuned per figure.

>>> from truestroke.studies import paper
>>> paper.NAMES
('fig4', 'fig6', 'fig7', 'fig8', 'fig10', 'fig11', 'fig12', 'fig13', 'table1', 'table2')
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from truestroke.base.checks import SettingError
from truestroke.studies.paper.reproduction import Reproduction, Row

__all__ = ["NAMES", "Reproduction", "Row", "reproduce"]

NAMES = ("fig4", "fig6", "fig7", "fig8", "fig10", "fig11", "fig12", "fig13", "table1", "table2")


def reproduce(
    names: Iterable[str] = (),
    output: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Reproduction]:
    """Repeat the runs of the paper, and print its numbers beside ours.

    Runs that several of them need are made once. All ten take about 15 s.

    Parameters
    ----------
    names : iterable of str
        Of `NAMES`, in any order; none means all.
    output : path, optional
        Folder for the plots, NAME-light.png and NAME-dark.png; without it nothing is plotted.
    progress : callable, optional
        Called as progress(names done, all names).

    Returns
    -------
    list of Reproduction
        In the order asked for.

    Raises
    ------
    SettingError
        A name is not one of `NAMES`.

    Examples
    --------
    >>> (fig10,) = reproduce(["fig10"])
    >>> for row in fig10.rows[:2]:
    ...     print(row.cells())
    ('rmse, 0.75 to 1 s', '0.1211', '0.052', 'um')
    ('rmse, 10 to 20 s', '0.0584', '0.033', 'um')
    """
    asked = [names] if isinstance(names, str) else list(names)
    for name in asked:
        if name not in NAMES:
            raise SettingError("names", repr(name), f"one of {', '.join(NAMES)}")
    asked = asked or list(NAMES)
    results: list[Reproduction] = []
    from truestroke.studies.paper import figures

    for done, name in enumerate(asked, 1):
        results.append(getattr(figures, name)())
        if progress is not None:
            progress(done, len(asked))
    if output is not None:
        from truestroke.report.page import save_plots

        save_plots(lambda theme: {result.name: result.plot(theme) for result in results}, output)
    return results
