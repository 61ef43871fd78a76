"""The loop by hand: two calls a tick, with your converters between them."""

# %%
import math

import truestroke

controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
for tick in range(2000):
    phase = 2 * math.pi * 8 * tick / 2000
    z_d = 15 - 10 * math.cos(phase)  # um
    zdot_d = 2 * math.pi * 8 * 10 * math.sin(phase)  # um/s
    volts = controller.command(z_d, zdot_d)  # to the D/A converter
    z = 10 * volts  # in place of the A/D converter: an actuator of 10 um/V
    controller.adapt(z)  # may be left out in a tick; controller.adapt(z, ago=3) is one that comes late

print(f"desired {z_d:.3f} um, measured {z:.3f} um; flags {controller.flag_bits}")

# %% [markdown]
# Prints:
#
#     desired 5.003 um, measured 5.003 um; flags 0
