"""A simulated stack in a feedback loop of python-control: an integrator around it."""

# %%
import control
import numpy as np

from truestroke import plant
from truestroke.identification.adapters.control import actuator_system

stack = actuator_system(plant.RealisticPlant(seed=0))  # volts -> z (um), 2000 ticks a second
integrator = control.tf([0.01, 0], [1, -1], stack.dt, inputs="error", outputs="volts", name="integrator")
difference = control.summing_junction(["z_d", "-z"], "error")
loop = control.interconnect([integrator, difference, stack], inputs="z_d", outputs="z")

# %%
time = np.arange(600) * stack.dt
response = control.input_output_response(loop, time, np.where(time > 0.05, 10.0, 0.0))
z = np.asarray(response.outputs)
print(f"90 % of the step after {1000 * (time[np.argmax(z > 9.0)] - 0.05):.0f} ms; at the end {z[-1]:.1f} um")

# %% [markdown]
# Prints:
#
#     90 % of the step after 10 ms; at the end 10.0 um
