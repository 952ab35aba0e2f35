"""Simulators that remember earlier inputs: what that hides, searched and bounded."""
