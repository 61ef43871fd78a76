"""Signals over time: trajectories, recordings, their metrics."""
