"""Follow a random wave with a simulated stack, and judge the run."""

# %%
import truestroke
from truestroke import plant, trajectories

wave = trajectories.random_wave(duration=4.0, seed=1)  # um, 2000 ticks a second
controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
recording = truestroke.run(wave, controller, plant.RealisticPlant(seed=1))

# %% [markdown]
# A recording holds what was asked for, what was put out and what came back. `judge` says whether that is good.

# %%
desired, measured = recording["desired"], recording["measured"]
print(f"rmse of the second half {truestroke.metrics.rmse(desired[4000:], measured[4000:]):.3f} um")
print(truestroke.judge(recording).level)

# %% [markdown]
# Prints:
#
#     rmse of the second half 0.014 um
#     good
