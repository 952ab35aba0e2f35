"""The examples that SCOTS ships, on its own grids: growth bounds by the ordinary differential equations stated there.

Rungger and Zamani (2016), "SCOTS: a tool for the synthesis of symbolic controllers"; the aircraft is that of Reissig,
Weber and Rungger (2017). Cells are centred at the nodes, so the grid reaches half a spacing beyond the states.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from growth import Floats, growth_abstraction

from simgap.geometry import Box, Grid
from simgap.synthesis.abstraction.cells import Abstraction

TOUCH = 1e-10  # of a length: an obstacle that touches a cell counts as meeting it
OBSTACLES = [
    (1, 1.2, 0, 9), (2.2, 2.4, 0, 5), (2.2, 2.4, 6, 10), (3.4, 3.6, 0, 9), (4.6, 4.8, 1, 10), (5.8, 6, 0, 6),
    (5.8, 6, 7, 10), (7, 7.2, 1, 10), (8.2, 8.4, 0, 8.5), (8.4, 9.3, 8.3, 8.5), (9.3, 10, 7.1, 7.3),
    (8.4, 9.3, 5.9, 6.1), (9.3, 10, 4.7, 4.9), (8.4, 9.3, 3.5, 3.7), (9.3, 10, 2.3, 2.5),
]  # fmt: skip


def runge_kutta(slope: Callable[[Floats], Floats], x: Floats, tau: float, steps: int) -> Floats:
    """The classical method of fourth order over tau, (n, nx) -> (n, nx)."""
    h = tau / steps
    for _ in range(steps):
        a = slope(x)
        b = slope(x + h / 2 * a)
        c = slope(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))
    return x


def within(grid: Grid, ends: list[tuple[float, float]]) -> Any:
    """Cells contained in a box over the first axes: (cells,)."""
    centre = grid.centres()
    inside = np.ones(grid.size, bool)
    for j, (lo, hi) in enumerate(ends):
        inside &= (centre[:, j] - grid.h[j] >= lo - TOUCH) & (centre[:, j] + grid.h[j] <= hi + TOUCH)
    return inside


def converter() -> tuple[Abstraction, Any]:
    """`dcdc`: a switch keeps coil current and scaled voltage in a box, (abstraction, safe cells)."""
    load, supply, coil, inductance, capacitance = 1.0, 1.0, 0.05, 3.0, 70.0
    inner = coil / 10
    ratio = load / (load + inner)
    closed = np.diag([-coil / inductance, -1 / (capacitance * (load + inner))])
    opened = np.array([[-(coil + ratio * inner) / inductance, -ratio / inductance / 5],
                       [5 * ratio / capacitance, closed[1, 1]]])  # fmt: skip
    apart = opened * [[1, -1], [1, 1]]  # off the diagonal only the size matters

    def linear(first: Floats, second: Floats, add: float, x: Floats, u: Floats) -> Floats:
        # A step of the method is affine too: where it takes 0 and the unit vectors says all.
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        moved = [runge_kutta(lambda z, m=m: z @ m.T + [add, 0.0], corners, 0.5, 5) for m in (first, second)]
        at = np.stack(moved)[(u[:, 0] != 1.0).astype(np.intp)]  # (n, 3, 2)
        return at[:, 0] + x[:, :1] * (at[:, 1] - at[:, 0]) + x[:, 1:] * (at[:, 2] - at[:, 0])

    eta = 1 / 2000
    grid = Grid(Box([1.15 - eta / 2, 5.45 - eta / 2], [1.55 + eta / 2, 5.85 + eta / 2]), (801, 801))
    abstraction = growth_abstraction(
        grid, np.array([[1.0], [2.0]]),
        lambda x, u: linear(closed, opened, supply / inductance, x, u),
        lambda r, u: linear(closed, apart, 0.0, r, u),
        ((0, 1), (0, 1)),
    )  # fmt: skip
    return abstraction, within(grid, [(1.15, 1.55), (5.45, 5.85)])


def vehicle() -> tuple[Abstraction, Any, Any]:
    """`vehicle`: a bicycle through a maze, (abstraction, target cells, free cells)."""
    tau, eta = 0.3, 0.2
    axis = np.round(0.3 * np.arange(-3, 4), 12)
    inputs = np.array([(a, b) for a in axis for b in axis])

    def step(x: Floats, u: Floats) -> Floats:
        slip, turn = np.arctan(np.tan(u[:, 1]) / 2), u[:, 0] * np.tan(u[:, 1])
        pace = u[:, 0] / np.cos(slip)
        return runge_kutta(
            lambda z: np.stack([pace * np.cos(slip + z[:, 2]), pace * np.sin(slip + z[:, 2]), turn], 1), x, tau, 5
        )

    def growth(r: Floats, u: Floats) -> Floats:
        slide = tau * np.abs(u[:, 0]) * np.sqrt(np.tan(u[:, 1]) ** 2 / 4 + 1) * r[:, 2]
        return np.stack([r[:, 0] + slide, r[:, 1] + slide, r[:, 2]], 1)

    grid = Grid(Box([-eta / 2, -eta / 2, -17.5 * eta], [10 + eta / 2, 10 + eta / 2, 17.5 * eta]), (51, 51, 35))
    centre, free = grid.centres(), np.ones(grid.size, bool)
    for box in np.array(OBSTACLES, dtype=float).reshape(-1, 2, 2):
        near = (centre[:, :2] >= box[:, 0] - eta / 2 - TOUCH) & (centre[:, :2] <= box[:, 1] + eta / 2 + TOUCH)
        free &= ~near.all(axis=1)
    return growth_abstraction(grid, inputs, step, growth, ((2,), (2,), ())), within(grid, [(9, 9.51), (0, 0.51)]), free


def aircraft() -> tuple[Abstraction, Any, Any]:
    """`aircraft`: a landing with disturbed inputs and measurements, (abstraction, target cells, free cells)."""
    tau, mass, gravity = 0.25, 60000.0, 9.81
    degree = np.pi / 180
    seen = np.array([0.0125, 0.0025 * degree, 0.05])  # measurement error
    pushed = np.array([0.108, 0.002, 0.0])
    eta = np.array([25 / 362, 3 * degree / 66, 56 / 334])
    lo, hi = np.array([58, -3 * degree, 0]), np.array([83, 0, 56])
    inputs = np.array([(a, b * 8 / 9 * degree) for a in (0.0, 32000.0) for b in range(10)])

    def step(x: Floats, u: Floats) -> Floats:
        lift = 1.25 + 4.2 * u[:, 1]

        def slope(z: Floats) -> Floats:
            v, path = z[:, 0], z[:, 1]
            along = u[:, 0] * np.cos(u[:, 1]) - (2.7 + 3.08 * lift**2) * v**2 - mass * gravity * np.sin(path)
            across = u[:, 0] * np.sin(u[:, 1]) + 68.6 * lift * v**2 - mass * gravity * np.cos(path)
            return np.stack([along / mass, across / (mass * v), v * np.sin(path)], 1)

        return runge_kutta(slope, x, tau, 10)

    def growth(r: Floats, u: Floats) -> Floats:
        lift = 1.25 + 4.2 * u[:, 1]
        slow, bend = -0.001919 * (2.7 + 3.08 * lift**2), 0.00294 + 0.00481 * u[:, 1]

        def slope(z: Floats) -> Floats:
            a, b = z[:, 0], z[:, 1]
            return np.stack([slow * a + gravity * b, bend * a + 0.003526 * b, 0.074252 * a + 83.2 * b], 1) + pushed

        return runge_kutta(slope, r + seen, tau, 10) + seen

    cells = tuple(int(n) for n in np.round((hi - lo) / eta) + 1)
    grid = Grid(Box(lo - eta / 2, hi + eta / 2), cells)
    centre = grid.centres()
    target = within(grid, [(63, 75), (-3 * degree, 0), (0, 2.5)])
    target &= (centre[:, 0] + eta[0] / 2) * np.sin(centre[:, 1] - eta[1] / 2) >= -0.91
    abstraction = growth_abstraction(grid, inputs, step, growth, ((0, 1), (0, 1), (0, 1)))
    return abstraction, target, np.ones(grid.size, bool)
