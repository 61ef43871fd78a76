"""An actuator of your own: open() returns the timing, exchange(volts) moves it and measures."""

# %%
import numpy as np

import truestroke
from truestroke import trajectories


class TwoSprings:
    """10 um/V, and a part of 2 um/V that moves only behind a slack of 0.3 V: replace `exchange` by your converters."""

    def open(self):
        self.held = 0.0
        return truestroke.Timing(sample_rate=2000.0)  # with block= and latency= where the converters need them

    def exchange(self, volts):
        z = np.empty(len(volts))
        for k, x in enumerate(volts):
            self.held = max(x - 0.3, min(x + 0.3, self.held))
            z[k] = 10 * x + 2 * self.held
        return z


# %%
wave = trajectories.sine(frequency=5.0, peak_to_peak=24.0, duration=2.0)
controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
recording = truestroke.run(wave, controller, TwoSprings())
error = recording["measured"] - recording["desired"]
print(f"largest error in the last second {1000 * abs(error[-2000:]).max():.0f} nm")

# %% [markdown]
# Prints:
#
#     largest error in the last second 30 nm
