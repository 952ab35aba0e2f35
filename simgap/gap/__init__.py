"""The gap between simulator and nominal model, bounded by a function of state and input."""
