"""An actuator that the loop calls in each tick or block, though its plant is native: the other half of a comparison."""


class InPython:
    """What `run` needs of an actuator, of any simulated plant."""

    def __init__(self, plant):
        self.plant = plant

    def open(self):
        return self.plant.open()

    def exchange(self, volts):
        measured = self.plant.exchange(volts)
        self.truth = self.plant.truth
        return measured
