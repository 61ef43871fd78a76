"""A voltage waveform for a motion, from a model, with what the model says of it."""

# %%
import tempfile
from pathlib import Path

import numpy as np

import truestroke
from truestroke import trajectories

model = truestroke.ActuatorModel(  # yours: truestroke.load_model("model.toml")
    thresholds=(0.0, 0.4, 0.8),
    weights=[8.0, 1.0, 2.0, 0.0, 0.0],
    covariance=np.eye(5) * 1e-4,
    stroke=25.0,
    voltage_range=(-0.6, 3.0),
    velocity=500.0,
)
motion = trajectories.triangle(frequency=5.0, peak_to_peak=32.0, duration=1.0)
made = truestroke.waveform(model, motion.position, motion.sample_rate)
print(f"{made.volts.max():.2f} V at the most, predicted error {made.rmse:.2f} um rms")
print("\n".join(made.warnings))

# %%
with tempfile.TemporaryDirectory() as folder:
    truestroke.save_waveform(Path(folder) / "triangle.csv", made)
    print(truestroke.load_waveform(Path(folder) / "triangle.csv").volts.size, "samples")

# %% [markdown]
# Prints:
#
#     3.00 V at the most, predicted error 0.09 um rms
#     out of reach: ..., 4 times, first at 0.297 s, ...
#     2000 samples
