"""Lipschitz constants of the gap: the grid estimate, local paddings, and the extreme-value estimates of the paper."""
