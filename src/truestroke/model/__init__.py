"""The model of the actuator: operators, weights, what is believed before the first measurement."""
