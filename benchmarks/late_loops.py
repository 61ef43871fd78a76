"""Loops that are later than the controller knows, by the dead time of a card, a bus or an amplifier: decision 249.

Sines of f0/50, f0/10 and 3/10 f0 on Preisach stages of 200 to 1500 Hz, with nothing given and with `resonance`, at
10 kHz. Prints for each dead time in how many runs the true rms of the second half is above 1 and above 10 % of
peak to peak, the largest rms, and for how long errors are above 10 %.

    python benchmarks/late_loops.py                # half a minute
    python benchmarks/late_loops.py --measured     # dynamics measured first
"""

from __future__ import annotations

import argparse
import warnings
from multiprocessing import Pool

import numpy as np

from truestroke import AdaptiveController, LimitWarning, measure_dynamics, run, trajectories
from truestroke.plant import StagePlant, StageSettings

RATE, LIMITS = 10_000.0, (0.0, 10.0)
STAGES = (200.0, 0.02), (700.0, 0.02), (700.0, 0.005), (1500.0, 0.01)  # f0, Hz, and damping
SHARES = 0.02, 0.1, 0.3  # of f0: the motion
SPAN, DURATION = 16.0, 3.0  # um, s
TICKS = 0, 2, 3, 5, 8, 10, 15


def error_of(ticks: int, f0: float, damping: float, share: float, given: str) -> tuple[float, float]:
    """True rms, % of peak to peak, and for how long the error is above 10 %, s."""
    stage = StageSettings(
        sample_rate=RATE,
        voltage_limits=LIMITS,
        hysteresis_kind="preisach",
        resonances=(f0,),
        dampings=(damping,),
        dead_time=ticks / RATE,
    )
    known: dict[str, object] = {"resonance": f0} if given == "resonance" else {}
    if given == "dynamics":
        known = {"dynamics": measure_dynamics(StagePlant(stage, seed=ticks + 50), voltage_limits=LIMITS)}
    controller = AdaptiveController(sample_rate=RATE, stroke=24.0, voltage_limits=LIMITS, **known)  # type: ignore[arg-type]
    wave = trajectories.sine(frequency=share * f0, peak_to_peak=SPAN, offset=12.0, duration=DURATION, sample_rate=RATE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LimitWarning)
        recording = run(wave, controller, StagePlant(stage, seed=ticks))
    error = (recording["true"] - recording["desired"]) / SPAN * 100
    return float(error[error.size // 2 :].std()), float(np.sum(np.abs(error) > 10) / RATE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--measured", action="store_true", help="measure the dynamics first, in place of the others")
    kinds = ("dynamics",) if parser.parse_args().measured else ("nothing", "resonance")
    print("ticks  given       runs  above 1 %  above 10 %  largest, %  above 10 %, s")
    with Pool(2) as pool:
        for ticks in TICKS:
            for given in kinds:
                runs = [(ticks, f0, damping, share, given) for f0, damping in STAGES for share in SHARES]
                rms, seconds = np.array(pool.starmap(error_of, runs)).T
                counts = f"{np.sum(rms > 1):>9d}  {np.sum(rms > 10):>10d}  {rms.max():>10.3g}"
                print(f"{ticks:>5d}  {given:<10}  {rms.size:>4d}  {counts}  {seconds.sum():>13.2f}", flush=True)


if __name__ == "__main__":
    main()
