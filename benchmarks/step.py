"""What a tick costs: the default controller against the paper's, in the kernel and through Python, in one run.

    python benchmarks/step.py

Seconds do not repeat on shared machines; the ratios of one run do. Each figure is the best of several rounds.
"""

import timeit

from truestroke import AdaptiveController, ControllerSettings
from truestroke.plant import RealisticPlant
from truestroke.runtime.loop import run
from truestroke.signals.trajectories import random_wave

BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
ROUNDS = 7


def main() -> None:
    wave = random_wave(seed=0, duration=10.0)
    z = run(wave, AdaptiveController(**BENCH), RealisticPlant(seed=0))["measured"]
    ticks = len(wave)
    rows = {
        "paper": ControllerSettings.paper(**BENCH),
        "default": ControllerSettings(**BENCH),
        "paper, single": ControllerSettings.paper(**BENCH, precision="single"),
        "default, single": ControllerSettings(**BENCH, precision="single"),
    }
    print(f"{'':18}{'weights':>8}{'block, ns':>11}{'ratio':>7}{'tick by tick, ns':>18}{'ratio':>7}")
    first: tuple[float, float] | None = None
    for name, settings in rows.items():
        controller = AdaptiveController.from_settings(settings)

        def block() -> None:
            controller.process(wave.position, wave.velocity, z)  # noqa: B023

        def ticks_one_by_one() -> None:
            command, adapt = controller.command, controller.adapt  # noqa: B023
            for z_d, zdot_d, measured in zip(wave.position.tolist(), wave.velocity.tolist(), z.tolist(), strict=True):
                command(z_d, zdot_d)
                adapt(measured)

        a, b = (1e9 * min(timeit.repeat(f, number=1, repeat=ROUNDS)) / ticks for f in (block, ticks_one_by_one))
        first = first or (a, b)
        print(f"{name:18}{settings.parameters:8}{a:11.0f}{a / first[0]:7.2f}{b:18.0f}{b / first[1]:7.2f}")


if __name__ == "__main__":
    main()
