"""Simulated actuators: what the controller does not know."""
