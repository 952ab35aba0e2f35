"""Samples of the gap: where they are taken, and how they are kept."""
