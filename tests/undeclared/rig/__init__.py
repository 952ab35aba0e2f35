"""Rigs with undeclared effects; nothing here imports the package under test."""
