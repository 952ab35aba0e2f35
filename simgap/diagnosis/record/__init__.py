"""Recordings as people have them -> traces in the model's units, their noise, lags and stillness, windows."""
