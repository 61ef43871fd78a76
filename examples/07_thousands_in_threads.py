"""Many controllers, each with an actuator of its own, in threads: what a change of gain does."""

# %%
import truestroke
from truestroke import plant, trajectories

settings = truestroke.ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
wave = trajectories.random_wave(duration=2.0, velocity_limit=300.0)
runs = [
    truestroke.Simulation(trajectory=wave, controller=settings, plant=plant.PlantSettings(sensitivity=s), seed=seed)
    for s in (0.6, 1.0, 1.4)
    for seed in range(20)
]


# %%
def rmse(index, channels):
    """Of the second half of a run, um; called in the thread that ran it."""
    return truestroke.metrics.rmse(channels["desired"][2000:], channels["true"][2000:])


errors = truestroke.simulate_many(runs, reduce=rmse).results
for k, s in enumerate((0.6, 1.0, 1.4)):
    print(f"sensitivity {s}: the worst of 20 has an rmse of {max(errors[20 * k : 20 * k + 20]):.4f} um")

# %% [markdown]
# Prints:
#
#     sensitivity 0.6: the worst of 20 has an rmse of 0.0056 um
#     sensitivity 1.0: the worst of 20 has an rmse of 0.0064 um
#     sensitivity 1.4: the worst of 20 has an rmse of 0.0064 um
