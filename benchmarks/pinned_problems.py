"""The two pinned synthesis problems, with the counts that every correct implementation of their conventions finds.

Both give the growth bound instead of deriving it; they anchor `growth`, the fixed points and nothing else.
The counts agree with SCOTS v0.2 where it fits into memory.
"""

from __future__ import annotations

import numpy as np
from growth import growth_abstraction

from simgap.geometry import Box, Grid
from simgap.specifications.space import cells_meeting, cells_within, partial_box

PENDULUM = {  # cells: (winning cells, admissible (cell, input) pairs)
    (200, 100): (17_311, 420_269),
    (400, 200): (73_593, 1_798_920),
    (800, 400): (298_875, 7_324_970),
    (1600, 800): (1_204_305, 29_551_368),
}
UNICYCLE = {  # (spacing, values per input, target): (winning cells, steps)
    (0.2, 21, (8.6, 9.6)): (78_531, 163),
    (0.1, 7, (9.0, 9.5)): (650_286, 116),
    (0.1, 11, (9.0, 9.5)): (651_180, 107),
    (0.1, 21, (9.0, 9.5)): (651_350, 107),
}
OBSTACLES = [((2, 2.4), (0, 6)), ((4.6, 5), (4, 10)), ((7, 7.4), (0, 5)), ((7.4, 8.4), (6.4, 6.8))]
LAYERS = {0.2: 35, 0.1: 71}


def pendulum(cells):
    """Invariance of [0, .2] x [-.5, .5]: an abstraction."""
    tau, gravity = 0.005, 1.5 * 9.81
    inputs = np.linspace(-1.2, 1.2, 25)[:, None]

    def step(x, u):
        return np.stack([x[:, 0] + tau * x[:, 1], x[:, 1] - gravity * tau * np.sin(x[:, 0]) + 3 * tau * u[:, 0]], 1)

    def growth(r, u):
        return np.stack([r[:, 0] + tau * r[:, 1] + 1e-5, gravity * tau * r[:, 0] + r[:, 1] + 1e-3], 1)

    return growth_abstraction(Grid(Box([0, -0.5], [0.2, 0.5]), cells), inputs, step, growth, ((1,), (0,)))


def unicycle(spacing, values, target):
    """Reach-while-avoid on [0, 10]^2: (abstraction, target cells, free cells)."""
    count, half = round(10 / spacing), spacing * LAYERS[spacing] / 2
    grid = Grid(Box([0, 0, -half], [10, 10, half]), (count, count, LAYERS[spacing]))
    axis = np.round(np.linspace(-1, 1, values), 12)
    inputs = np.array([(a, b) for a in axis for b in axis])

    def step(x, u):
        moved = [u[:, 0] * np.cos(x[:, 2]), u[:, 0] * np.sin(x[:, 2]), u[:, 1]]
        return x + 0.3 * np.stack(moved, axis=1)

    def growth(r, u):
        slide = 0.3 * np.abs(u[:, 0]) * r[:, 2]
        return np.stack([r[:, 0] + slide + 0.01, r[:, 1] + slide + 0.01, r[:, 2] + 0.01], axis=1)

    abstraction = growth_abstraction(grid, inputs, step, growth, ((2,), (2,), ()))
    states = ("x", "y", "theta")
    free = np.ones(grid.size, bool)
    for x, y in OBSTACLES:
        free &= ~cells_meeting(grid, partial_box({"x": x, "y": y}, states))
    return abstraction, cells_within(grid, partial_box({"x": target, "y": target}, states)), free
