"""Processor time of `identify` on long records, beside that of one QR decomposition in the same run.

    python benchmarks/identify_speed.py [SAMPLES ...]

Records of the simulated stage, of the same behind a dead time and a lag, and behind a resonance; and of steps and noise
that excite three modes. The ratio to the QR
decomposition of 100,000 x 30 numbers, on one thread, says less about the machine than seconds do.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from truestroke import trajectories
from truestroke.control import stage
from truestroke.identification import identify
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.model.sampled import respond
from truestroke.plant import RealisticPlant

EXCITED = "three modes, excited"
SAMPLES, RATE = (10_000, 100_000, 1_000_000), 2000.0
MODE = Dynamics(sample_rate=RATE, modes=(Mode(frequency=180.0, damping=0.03),))
MODES = Dynamics(
    sample_rate=RATE,
    modes=tuple(
        Mode(frequency=f, damping=damping, share=share)
        for f, damping, share in ((90.0, 0.03, 0.75), (190.0, 0.02, 0.15), (340.0, 0.02, 0.1))
    ),
)
KINDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "stage": lambda z: z,
    "6 ms and a lag of 12 ms": lambda z: respond(z, 12.0, 24.0),
    "resonance at 180 Hz": lambda z: stage.through(MODE, z),
    EXCITED: lambda z: stage.through(MODES, z),
}


def record(samples: int, excited: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Volts and displacement of a random wave; `excited`, with a step each 0.2 s and noise of 0.04 V."""
    wave = trajectories.random_wave(duration=samples / RATE, seed=5, peak_to_peak=28.0)
    plant, volts = RealisticPlant(seed=3), wave.position[:samples] / 12.0
    if excited:
        rng = np.random.Generator(np.random.PCG64(11))
        steps = rng.uniform(0.0, 1.0, 1 + samples // 400)[np.arange(samples) // 400]
        volts = 0.6 * volts + steps + 0.04 * rng.standard_normal(samples)
    plant.open()
    return volts, plant.exchange(volts)


def seconds(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def main() -> None:
    sizes = [int(entry) for entry in sys.argv[1:]] or SAMPLES
    reference = np.random.Generator(np.random.PCG64(0)).standard_normal((100_000, 30))
    identify((*(a[:2000] for a in record(2000)), RATE))  # what is imported
    print(f"{'record':<26}{'samples':>10}{'s':>8}{'QRs':>8}")
    for samples in sizes:
        for name, behind in KINDS.items():
            volts, z = record(samples, name == EXCITED)
            with threadpool_limits(1, "blas"):
                one = min(seconds(lambda: np.linalg.qr(reference, mode="r")) for _ in range(3))
            took = seconds(lambda behind=behind, volts=volts, z=z: identify((volts, behind(z), RATE)))  # type: ignore[misc]
            print(f"{name:<26}{samples:>10}{took:>8.2f}{took / one:>8.0f}", flush=True)


if __name__ == "__main__":
    main()
