"""Symbolic dynamics: expressions, discretisation, compiled steps, Jacobians and bounds."""
