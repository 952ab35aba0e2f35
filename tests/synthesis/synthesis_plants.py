"""Small nominal models and gap kernels for the tests."""

from functools import cache

import numpy as np
import sympy as sp
from numba import njit

from simgap.geometry import Box
from simgap.model.sampled import NominalModel
from simgap.specifications.space import Space
from simgap.synthesis.games.game import NodeGame


@cache
def pendulum(tau=0.005):
    """The paper's pendulum, explicit Euler, with its 25 inputs."""
    a, b, u = sp.symbols("x1 x2 u", real=True)
    f = (a + tau * b, b - 1.5 * 9.81 * tau * sp.sin(a) + 3 * tau * u)
    return NominalModel((a, b), (u,), f, tau), np.round(np.linspace(-1.2, 1.2, 25), 12)[:, None]


@cache
def rubbing(tau=0.1):
    """A mass on which dry friction acts, explicit Euler: the speed jumps where it is 0."""
    q, v, u = sp.symbols("q v u", real=True)
    return NominalModel((q, v), (u,), (q + tau * v, v + tau * (u - sp.Float("0.3") * sp.sign(v))), tau)


@cache
def unicycle(tau=1.0, exact=False):
    """A unicycle, explicit Euler or the second-order arc."""
    x, y, t, v, w = sp.symbols("x y t v w", real=True)
    heading = t + tau * w / 2 if exact else t
    return NominalModel(
        (x, y, t), (v, w), (x + tau * v * sp.cos(heading), y + tau * v * sp.sin(heading), t + tau * w), tau
    )


@cache
def random_plant(seed):
    """A coupled plant of two states and an input with random smooth terms."""
    rng = np.random.default_rng([seed, 11])
    a, b, u = sp.symbols("a b u", real=True)
    c = [sp.Float(round(float(v), 6)) for v in rng.uniform(-1, 1, 10)]
    f = (
        a + c[0] * b + c[1] * sp.sin(3 * a + b) / 4 + c[2] * a * u / 3 + c[3] * u,
        b * (1 + c[4] / 5) + c[5] * sp.cos(2 * b) * a + c[6] * u**2 + c[7] * a**2 * b / 2 + c[8] * u,
    )
    return NominalModel((a, b), (u,), f, 1.0)


@cache
def constant_gap(*size):
    """The gap kernel of |d_i| <= size_i; more sizes than states do no harm."""
    sizes = np.array(size)

    @njit
    def gap(xlo, xhi, u, lo, hi):
        for i in range(xlo.size):
            lo[i], hi[i] = -sizes[i], sizes[i]

    return gap


@cache
def sloped_gap():
    """A signed gap that depends on the first state and the input: d in [0.02 x, 0.02 x + 0.01 |u|], then + 0.01."""

    @njit
    def gap(xlo, xhi, u, lo, hi):
        for i in range(xlo.size):
            lo[i] = 0.02 * xlo[0] + 0.01 * i
            hi[i] = 0.02 * xhi[0] + 0.01 * abs(u[0]) + 0.01 * i + 1e-12

    return gap


@cache
def small_slope():
    """A signed gap of the pendulum's size that depends on both states."""

    @njit
    def gap(xlo, xhi, u, lo, hi):
        for i in range(2):
            lo[i] = 1e-3 * (xlo[0] + 0.1 * xlo[1] + 0.01 * u[0])
            hi[i] = 1e-3 * (xhi[0] + 0.1 * xhi[1] + 0.01 * u[0]) + 1e-5

    return gap


def held_by_measurements(abstraction, error, late=False, first=0):
    """What can be held of all cells of the true state, measured with an error, perhaps a sample late."""
    grid = abstraction.grid
    space = Space(("a", "b"), Box(grid.box.lo, grid.box.hi), grid.periodic)
    game = NodeGame((abstraction,), space, np.zeros(2), late=late, first=first, blur=np.asarray(error))
    return game.invariant(np.ones(grid.size, np.bool_))
