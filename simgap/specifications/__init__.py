"""Specifications of the closed loop, one a file, found by name."""
