"""A sensor that drops out for half a second: the controller goes on with what it has learned, and says so."""

# %%
import numpy as np

import truestroke
from truestroke import plant, trajectories


class DropsOut(plant.RealisticPlant):
    """The simulated stack, whose sensor gives no number from 2.0 to 2.5 s."""

    def open(self):
        self.tick = 0
        return super().open()

    def exchange(self, volts):
        z = super().exchange(volts)
        self.tick += len(z)
        return np.full_like(z, np.nan) if 4000 <= self.tick < 5000 else z


# %%
wave = trajectories.random_wave(duration=4.0, velocity_limit=300.0)
controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
recording = truestroke.run(wave, controller, DropsOut(seed=0))
error = abs(recording["true"] - recording["desired"])
print("measurements not used:", controller.counters.rejected)
print(f"largest error before {error[2000:4000].max():.2f}, without sensor {error[4000:5000].max():.2f} um")
print(f"and in the last second {error[6000:].max():.2f} um")

# %% [markdown]
# Prints:
#
#     measurements not used: 1000
#     largest error before 0.03, without sensor 0.04 um
#     and in the last second 0.02 um
