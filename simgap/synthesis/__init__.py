"""Symbolic synthesis: abstraction of the nominal map and its gap, fixed points, controllers."""
