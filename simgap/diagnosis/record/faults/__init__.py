"""Faults of a recording: what of the data is no measurement of the plant, found and mended."""
