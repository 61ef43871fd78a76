"""The model of the actuator: operators, weights, prior."""
