"""Any signals over time, as `Recording.plot` shows them."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from truestroke.base.checks import SettingError
from truestroke.report import style, units
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.channels import Channel, Signals, split

NAMED = 6  # lines that a legend can name


def signals(held: Signals, names: Sequence[str] = (), theme: Theme = LIGHT) -> Figure:
    """The channels of these names over their time, or all of them: a panel for each unit and time axis.

    Raises
    ------
    SettingError
        There is no such channel.
    """
    channels = held.labelled()
    for name in names:
        if name not in channels:
            raise SettingError("channel", repr(name), f"one of {', '.join(channels)}")
    shown = names or [name for name, channel in channels.items() if name != channel.time]
    panels: dict[tuple[str, str], dict[str, Channel]] = {}
    for name in shown:
        panels.setdefault((channels[name].unit, channels[name].time), {})[name] = channels[name]
    with style.use(theme):
        figure, axes = style.panels(1.0 + 1.6 * max(1, len(panels)), max(1, len(panels)), sharex=True)
        for panel, ((unit, time), lines) in zip(axes, panels.items(), strict=False):
            columns = split(lines)
            for i, (label, line) in enumerate(columns.items()):
                colour = theme.series[i % style.SERIES]
                panel.plot(*style.thin(channels[time].data, line), color=colour, lw=0.8, label=label)
            named = 1 < len(columns) <= NAMED
            what = "displacement" if named and unit == "um" else ",\n".join(lines)
            panel.set_ylabel(f"{what}\n({units.micro(unit)})" if unit else what)
            if named:
                style.legend_above(panel)
        axes[-1].set_xlabel("time (s)")
    return figure
