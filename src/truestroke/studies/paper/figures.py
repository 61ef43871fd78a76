"""The paper's figures and tables, a function each: Sec. 2.4, the simulations of Sec. 4, the experiments of Sec. 5.

The numbers of Figs. 6 to 8 are means over five waves on the plant (13); the experiments are on the realistic plant.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.plant import MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant
from truestroke.report import plots, style
from truestroke.signals import metrics
from truestroke.signals.recording import Recording
from truestroke.studies.characterisation import Characterisation, characterise, sweep
from truestroke.studies.characterisation.page import name_weights, plot_lines, plot_points
from truestroke.studies.paper import bench
from truestroke.studies.paper.bench import window
from truestroke.studies.paper.reproduction import Reproduction, Row

STROKE = 38.0  # um: all that the stack has, so that all eight plays move
SINES = {4: (0.0638, 0.0028), 8: (0.0619, 0.0026), 12: (0.0584, 0.0027)}  # rmse in um, and over the stroke
RMSE = 0.0943, 0.0159  # um, mean and sigma over the paper's five waves
MAXIMUM = 0.3899, 0.0291


def found_on(plant: MatchedPlant | RealisticPlant) -> Characterisation:
    """The procedure as Sec. 2.4 has it: the paper's thresholds, weights and nothing else."""
    limits, thresholds = bench.SETTINGS.voltage_limits, bench.SETTINGS.thresholds
    return characterise(plant, stroke=STROKE, voltage_limits=limits, thresholds=thresholds, offset=False)


@cache
def matched() -> Characterisation:
    """The plant (13) with the published weights, whose lines are known."""
    return found_on(MatchedPlant(sweep(stroke=STROKE).velocity))


@cache
def realistic(settings: PlantSettings = PlantSettings()) -> Characterisation:  # noqa: B008 (it is frozen)
    """The realistic plant."""
    return found_on(RealisticPlant(settings))


def branch(found: Characterisation, sign: int) -> tuple[FloatArray, FloatArray]:
    """Lines a, b through the rising (1) or the falling (-1) branches alone, um/V."""
    there = found.velocities * sign > 0
    columns = np.column_stack([np.ones(there.sum()), bench.SETTINGS.rate_scale * found.velocities[there]])
    a, b = np.linalg.lstsq(columns, found.weights[there], rcond=None)[0]
    return a, b


def fig4() -> Reproduction:
    """Lines through both directions of the matched plant, where the truth is known, and the realistic plant's."""
    plant, found = MatchedSettings(), matched()
    rising, falling = branch(realistic(), 1), branch(realistic(), -1)
    rows = (
        *_weight_rows(plant, found.a, found.b, ", matched plant"),
        *(Row(f"b{i}, realistic plant, rising", None, x, "um/V", 2) for i, x in enumerate(rising[1])),
        Row("a0, realistic plant, rising", None, rising[0][0], "um/V", 2),
        Row("a0, realistic plant, falling", None, falling[0][0], "um/V", 2),
    )
    sentence = (
        "Fig. 4 is of another stack and prints no number, so the procedure is tried where the lines are known, and "
        "finds them; on the realistic plant they do not have the published slopes, because its rate dependence is lag "
        "and creep, and rising and falling branches differ at rest, in contrast to (7), because of asymmetry and "
        "creep."
    )
    return Reproduction("fig4", "Fig. 4: weights against velocity", rows, sentence, _lines)


def _weight_rows(plant: MatchedSettings, a: FloatArray, b: FloatArray, where: str = "") -> Iterator[Row]:
    """Each weight of the plant, and what was found of it."""
    for name, published, found in (("a", plant.a, a), ("b", plant.b, b)):
        for i, (paper, ours) in enumerate(zip(published, found, strict=True)):
            yield Row(f"{name}{i}{where}", paper, ours, "um/V")


def _lines(theme: style.Theme) -> Figure:
    """Weight 0 above, the others below; left the matched plant with its known lines, right the realistic one."""
    plant = MatchedSettings()
    with style.use(theme):
        figure, axes = style.panels(5.2, 2, 2, sharex=True, height_ratios=[1, 2])
        for column, found in enumerate((matched(), realistic())):
            panels = [axes[column], axes[column + 2]]
            plot_points(panels, found, theme)
            for sign in (-1, 1):
                a, b = branch(found, sign) if column else (np.array(plant.a), np.array(plant.b))
                plot_lines(panels, np.array([0.0, sign * found.velocities.max()]), a, b, theme)
            name_weights(panels, found.weights[-1])
            panels[1].set_xlabel("desired velocity (µm/s)")
        axes[0].set_title("Matched plant; lines: its own weights (7)")
        axes[1].set_title("Realistic plant; lines: best fit of each branch")
        for panel in (axes[0], axes[2]):
            panel.set_ylabel("weights (µm/V)")
    return figure


def fig6() -> Reproduction:
    """The plant with the published weights."""
    runs = [bench.simulated_run(seed) for seed in bench.SEEDS]
    rows = (
        window(runs, 10, 20, digits=4),
        window(runs, 0.75, 1, channel="true", digits=4),
        window(runs, 10, 20, channel="true", digits=4),
        window(runs, 10, 20, "maximum", channel="true", digits=4),
    )
    sentence = (
        "The paper prints no number; ours is the 50 nm of sensor noise and nothing else, because this plant is of the "
        "controller's own structure, which it inverts exactly."
    )
    title = "Fig. 6: simulation, stationary plant"
    return Reproduction("fig6", title, rows, sentence, lambda theme: bench.picture(runs[0], 0, 5, theme))


def fig7() -> Reproduction:
    """All weights of the plant change within 30 % at 2.5 s."""
    runs = [bench.simulated_run(seed, bench.CHANGE) for seed in bench.SEEDS]
    times = ((1, 2.5), (2.5, 3), (3, 3.5), (4.5, 5), (9.5, 10), (19, 20))
    largest = max(bench.maximum(run, 2.5, 20, "true") for run in runs)
    rows = (
        *(window(runs, *time, channel="true") for time in times),
        Row("largest true error of all", None, largest, "um", 1),
    )
    sentence = (
        "The paper says that the controller adapts and prints no number; ours does, but slowly: by 2.5 s P has become "
        "small, and with a fixed forgetting factor of 0.9999 it takes seconds to grow again; the last plays, which "
        "such waves hardly move, are not relearned in 20 s on four of the five."
    )
    title = "Fig. 7: simulation, sudden change at 2.5 s"
    return Reproduction("fig7", title, rows, sentence, lambda theme: _change(runs[0], theme))


def _change(run: Recording, theme: style.Theme) -> Figure:
    """Ten seconds; the change is marked."""
    figure = bench.picture(run, 0, 10, theme)
    with style.use(theme):
        for panel in figure.axes:
            panel.axvline(2.5, color=theme["text"], lw=0.9, ls=(0, (4, 3)))
        below = figure.axes[1]
        below.text(2.4, 0.9, "sudden change", transform=below.get_xaxis_transform(), fontsize=8, ha="right")
    return figure


def fig8() -> Reproduction:
    """The weights that the first wave ends with beside the published ones of the plant (Sec. 4.3)."""
    plant = MatchedSettings()
    runs = [bench.simulated_run(seed) for seed in bench.SEEDS]
    a, b = bench.adapted(runs[0])
    deviations = [np.abs(bench.adapted(run) - np.array([plant.a, plant.b])).max() for run in runs]
    rows = (
        *_weight_rows(plant, a, b),
        Row("largest deviation, 5 waves", None, max(deviations), "um/V"),
        *(Row(f"first {n} partial slopes within 5 %", None, bench.settling(runs, n), "s", 2) for n in (5, 8)),
    )
    sentence = (
        "The weights are those of the plant, within the uncertainty by 50 nm of noise; on two of the five waves the "
        "last partial slopes converge only with the first fall that is long enough to move play 4 or 5 back."
    )
    return Reproduction("fig8", "Fig. 8: simulation, convergence of the weights", rows, sentence, _weights)


def _weights(theme: style.Theme) -> Figure:
    """Five seconds; the plant's own weights are dashed."""
    plant = MatchedSettings()
    figure = plots.weights(bench.between(bench.simulated_run(bench.SEEDS[0]), 0, 5), theme)
    for panel, weights in zip(figure.axes, (plant.a, plant.b), strict=True):
        for weight, colour in zip(weights, theme.series, strict=True):
            panel.axhline(weight, color=colour, lw=0.8, ls=(0, (2, 3)))
    with style.use(theme):
        figure.axes[0].set_title("Dotted: the weights of the plant")
    return figure


def fig10() -> Reproduction:
    """A sine of 12 Hz from an unknown actuator: the first second, and later."""
    run = bench.sine_run(12.0)
    rows = (
        window([run], 0.75, 1, paper=0.1211),
        window([run], 10, 20, paper=0.0584),
        Row("true, 0.75 to 1 s", None, bench.rmse(run, 0.75, 1, "true"), "um"),
        Row("true, 10 to 20 s", None, bench.rmse(run, 10, 20, "true"), "um"),
    )
    sentence = (
        "As in the paper the error decreases further after the first second; both of ours are lower, the later one "
        "because our sensor is quieter (13 nm a tick; with the 50 nm of Sec. 4 it meets the paper's), the earlier one "
        "only in part, since the paper gives neither its lambda nor its delta."
    )
    return Reproduction("fig10", "Fig. 10: a sine of 12 Hz", rows, sentence, lambda t: bench.picture(run, 0, 1, t))


def fig11() -> Reproduction:
    """Weights of the first random wave; times are means over the five waves."""
    runs = [bench.random_run(seed) for seed in bench.SEEDS]
    rows = (
        Row("first 3 partial slopes within 5 %", 1.0, bench.settling(runs, 3), "s", 2),
        Row("all 8 partial slopes within 5 %", None, bench.settling(runs, 8), "s", 2),
        window(runs, 0.75, 1),
        window(runs, 10, 20, paper=RMSE[0]),
    )
    sentence = (
        "The slopes that every motion uses settle within a second, as the paper says; the last plays move only at the "
        "largest strokes, so their weights follow creep and asymmetry for as long as the run lasts."
    )
    title = "Fig. 11: convergence of the weights, random wave"
    return Reproduction("fig11", title, rows, sentence, lambda theme: plots.weights(runs[0], theme))


def fig12() -> Reproduction:
    """The first of the five waves; the paper's numbers are means over its five."""
    run = bench.random_run(bench.SEEDS[0])
    rows = (
        window([run], 10, 20, paper=RMSE[0]),
        window([run], 10, 20, "maximum", paper=MAXIMUM[0]),
        window([run], 0, 1, "maximum"),
        window([run], 10, 20, channel="true"),
    )
    sentence = (
        "The wave is another one, of the same kind (the paper prints no seed); the error is smaller, as in Table 2, "
        "in part because our sensor is quieter."
    )
    title = "Fig. 12: tracking of a random wave"
    return Reproduction("fig12", title, rows, sentence, lambda theme: bench.picture(run, 0, 20, theme))


def fig13() -> Reproduction:
    """The wave of Fig. 12 from 5 to 8 s."""
    run = bench.random_run(bench.SEEDS[0])
    rows = (window([run], 5, 8), window([run], 5, 8, "maximum"), window([run], 5, 8, channel="true"))
    sentence = (
        "The paper prints no number for this section; ours is not yet as good as the same wave's 10 to 20 s (Fig. 12): "
        "four fifths of the square of its true error are creep, without which both are the same."
    )
    title = "Fig. 13: the wave of Fig. 12, 5 to 8 s"
    return Reproduction("fig13", title, rows, sentence, lambda theme: bench.picture(run, 5, 8, theme))


def table1() -> Reproduction:
    """Sines of 4, 8 and 12 Hz: errors over 10 to 20 s."""
    rows = []
    for frequency, (rmse, relative) in SINES.items():
        run = bench.sine_run(float(frequency))
        ours, stroke = bench.rmse(run, 10, 20), metrics.peak_to_peak(bench.between(run, 10, 20)["desired"])
        rows += [
            Row(f"{frequency} Hz, rmse", rmse, ours, "um"),
            Row(f"{frequency} Hz, rmse / stroke", relative, ours / stroke, "", 4),
            Row(f"{frequency} Hz, true rmse", None, bench.rmse(run, 10, 20, "true"), "um"),
        ]
    sentence = (
        "Ours is smaller because our sensor is quieter (13 nm a tick; with the 50 nm of Sec. 4 it meets the paper's); "
        "five sixths of the square of the true error are creep, which the law with its long memory follows slowly."
    )
    title = "Table 1: sines of 22.8 um peak-to-peak"
    return Reproduction("table1", title, tuple(rows), sentence, lambda theme: _by_frequency(rows, theme))


def _by_frequency(rows: list[Row], theme: style.Theme) -> Figure:
    """The paper's rmse and ours at each frequency."""
    with style.use(theme):
        figure, (panel,) = style.panels(2.6)
        x = range(len(SINES))
        panel.plot(x, [1e3 * rmse for rmse, _ in SINES.values()], "D", color=theme["before"], label="paper, measured")
        panel.plot(x, [1e3 * row.ours for row in rows[0::3]], "o", color=theme["measured"], label="ours, measured")
        panel.plot(x, [1e3 * row.ours for row in rows[2::3]], "o", color=theme["true"], label="ours, true")
        panel.set(ylabel="rmse, 10 to 20 s (nm)", xlabel="frequency of the sine (Hz)", xlim=(-0.5, 2.5))
        panel.set_ylim(0, 75)
        panel.set_xticks(list(x), [str(frequency) for frequency in SINES])
        style.legend_above(panel)
    return figure


def table2() -> Reproduction:
    """Five random waves: errors over 10 to 20 s; sigma is the sample standard deviation over the waves."""
    runs = [bench.random_run(seed) for seed in bench.SEEDS]
    spans = np.array([metrics.peak_to_peak(bench.between(run, 10, 20)["desired"]) for run in runs])
    rmse, true_rmse = (np.array([bench.rmse(run, 10, 20, c) for run in runs]) for c in ("measured", "true"))
    largest, true_largest = (np.array([bench.maximum(run, 10, 20, c) for run in runs]) for c in ("measured", "true"))
    rows = (
        Row("rmse, mean", RMSE[0], rmse.mean(), "um"),
        Row("rmse, sigma", RMSE[1], rmse.std(ddof=1), "um"),
        Row("rmse / peak-to-peak", 0.33, (100 * rmse / spans).mean(), "%", 2),
        Row("maximum, mean", MAXIMUM[0], largest.mean(), "um"),
        Row("maximum, sigma", MAXIMUM[1], largest.std(ddof=1), "um"),
        Row("maximum / peak-to-peak", 1.35, (100 * largest / spans).mean(), "%", 2),
        Row("true rmse, mean", None, true_rmse.mean(), "um"),
        Row("true maximum, mean", None, true_largest.mean(), "um"),
    )
    sentence = (
        "Ours is smaller in part because our sensor is quieter (13 nm a tick; with the 50 nm of Sec. 4 nearly half of "
        "the difference is gone); of the square of the true error two fifths are creep, three tenths the asymmetry, "
        "because the dead zones are identity, and the rest is a smooth hysteresis that eight plays only approximate."
    )
    title = f"Table 2: {len(runs)} random waves of 28.6 um peak-to-peak, errors over 10 to 20 s"
    return Reproduction("table2", title, rows, sentence, lambda theme: _by_wave(rmse, largest, theme))


def _by_wave(rmse: np.ndarray, largest: np.ndarray, theme: style.Theme) -> Figure:
    """Each wave's errors, and the paper's mean and sigma."""
    with style.use(theme):
        figure, (left, right) = style.panels(2.8, 1, 2)
        _dots(left, rmse, RMSE, "rmse (nm)", theme)
        _dots(right, largest, MAXIMUM, "maximum error (nm)", theme)
        style.legend_above(left)
    return figure


def _dots(panel: Axes, ours: np.ndarray, paper: tuple[float, float], label: str, theme: style.Theme) -> None:
    mean, sigma = 1e3 * paper[0], 1e3 * paper[1]
    panel.axhspan(mean - sigma, mean + sigma, color=theme["before"], alpha=0.25, lw=0)
    panel.axhline(mean, color=theme["before"], label="paper: mean ± sigma")
    panel.plot(range(ours.size), 1e3 * ours, "o", color=theme["true"], label="ours")
    panel.set(ylabel=label, xlabel="wave (seed)", xticks=range(ours.size), xlim=(-0.5, ours.size - 0.5))
    panel.set_ylim(bottom=0)
