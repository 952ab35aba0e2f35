"""Pairs of a state and an input at which the simulator is asked."""

from __future__ import annotations

import numpy as np

from simgap.geometry import Box, Floats


def product(x: Floats, u: Floats) -> tuple[Floats, Floats]:
    """All pairs, the input running fastest: (n, nx), (M, nu) -> (n M, nx), (n M, nu)."""
    return np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))


def draw(box: Box, inputs: Floats, count: int, seed: int) -> tuple[Floats, Floats]:
    """`count` pairs, uniform on the box and on the input set (M, nu): (count, nx), (count, nu)."""
    rng = np.random.default_rng(seed)
    return box.sample(rng, count), inputs[rng.integers(0, len(inputs), count)]
