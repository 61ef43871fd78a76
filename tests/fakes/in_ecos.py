"""Steps the FMUs of a loop in Ecos: those of controller, stack and actuator; writes their outputs of 200 ticks as JSON.

The two outputs of a tick go to the inputs of the next: Ecos steps all FMUs at the same time.
"""

import json
import os
import sys
from typing import Any


def main(controller: str, stack: str, actuator: str) -> None:
    """Outputs of each tick: volts, measurement, displacement of the actuator."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        for name, file in (("law", controller), ("stack", stack), ("actuator", actuator)):
            structure.add_model(name, file)
        structure.make_real_connection("law::volts", "stack::volts")
        structure.make_real_connection("law::volts", "actuator::volts")
        structure.make_real_connection("stack::measured", "law::z")
        structure.add_parameter_set("late", {"law::late": 1})
        with EcosSimulation(structure=structure, step_size=5e-4) as simulation:
            simulation.init(parameter_set="late")
            sys.stdout.write(json.dumps([stepped(simulation, k) for k in range(200)]) + "\n")
            simulation.terminate()


def stepped(simulation: Any, k: int) -> list[float]:
    """One tick of a ramp."""
    simulation.set_real("law::z_d", 10.0 + k / 20)
    simulation.set_real("law::zdot_d", 100.0)
    simulation.step(1)
    return [simulation.get_real(name) for name in ("law::volts", "stack::measured", "actuator::displacement")]


main(*sys.argv[1:])
sys.stdout.flush()
os._exit(0)  # Ecos and its threads end in any order: one in a hundred ends of a busy computer is a fault of memory
