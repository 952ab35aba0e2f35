"""Measures, bounds and closes the gap between a robot model, its simulator and its recordings."""
