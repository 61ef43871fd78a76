"""Signals over time: trajectories, recordings, their figures."""
