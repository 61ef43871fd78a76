"""Stages whose first resonance is high for the sample rate: how well does the default controller follow sines there?

The plants of `soft_stages.py`, of another structure than the controller's model, with the first resonance f0 from 0.1
to 0.35 of the sample rate; sines of 20 um peak to peak at f0/16, f0/8 and f0/4 with an amplitude that grows for 0.3 s.
Nothing is given to the controller. Prints the rms of the second half, % of peak to peak.

    python -m benchmarks.stiff_stages          # a minute
"""

from __future__ import annotations

import argparse
import itertools
import math

import numpy as np
from benchmarks.soft_stages import HIGH, LOW, RANGE, STROKE, BoucWen, Plays, Preisach, Stage

from truestroke import AdaptiveController

SHARES = (0.10, 0.13, 0.16, 0.20, 0.25, 0.30, 0.35)  # f0 over the sample rate
SLOWER = (16.0, 8.0, 4.0)  # f0 over the frequency of the motion
PEAK_TO_PEAK, RAMP = 20.0, 0.3  # um, s


def follow(share: float, slower: float, kind: type, zeta: float, sample_rate: float, duration: float) -> float:
    """rms of the second half, % of peak to peak."""
    f0 = share * sample_rate
    swift = 1e4 * RANGE  # V/s: no motion here needs as many
    controller = AdaptiveController(
        sample_rate=sample_rate, stroke=STROKE, voltage_limits=(LOW, HIGH), slew_limit=swift
    )
    stage, time = Stage(kind(), f0, zeta, sample_rate, 0), np.arange(round(duration * sample_rate)) / sample_rate
    omega, grown = 2 * math.pi * f0 / slower, np.minimum(time / RAMP, 1.0)
    position = PEAK_TO_PEAK / 2 * (1.2 + grown * np.sin(omega * time))
    velocity = PEAK_TO_PEAK / 2 * (omega * grown * np.cos(omega * time) + (time < RAMP) / RAMP * np.sin(omega * time))
    error = np.empty(time.size)
    for k, (z_d, zdot_d) in enumerate(zip(position.tolist(), velocity.tolist(), strict=True)):
        true, measured = stage.exchange(controller.command(z_d, zdot_d))
        controller.adapt(measured)
        error[k] = true - z_d
    return 100 / PEAK_TO_PEAK * float(np.sqrt(np.mean(error[time.size // 2 :] ** 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sample-rate", type=float, default=5000.0)
    parser.add_argument("--duration", type=float, default=4.0)
    options = parser.parse_args()
    print("f0 / sample rate  rms, % of p-p: median, worst  of 18 runs below 0.5 %")
    for share in SHARES:
        cases = itertools.product(SLOWER, (Plays, Preisach, BoucWen), (0.01, 0.03))
        rms = np.array([follow(share, *case, options.sample_rate, options.duration) for case in cases])
        print(f"{share:16.2f}  {np.median(rms):22.3f}, {rms.max():5.2f}  {np.count_nonzero(rms < 0.5):22d}", flush=True)


if __name__ == "__main__":
    main()
