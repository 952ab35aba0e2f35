"""What a winning domain promises for random plants, cells and inputs: any state, any admissible input, any gap."""

from functools import cache

import numpy as np
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simgap.geometry import Box, Grid
from simgap.model.sampled import NominalModel
from simgap.synthesis.abstraction.cells import nominal_abstraction
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import unpack
from tests.synthesis.synthesis_plants import constant_gap, sloped_gap

RELAXED = settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
BOX = Box([-1.0, -1.5], [1.2, 1.0])
GAPS = {"constant": constant_gap(0.01, 0.02), "sloped": sloped_gap()}


@cache
def family():
    """Plants of two states whose coefficients are inputs, so that one compilation serves every one of them."""
    a, b, u = sp.symbols("a b u", real=True)
    c = sp.symbols("c0:6", real=True)
    f = (
        c[0] * a + c[1] * b + c[2] * u + c[5] * sp.sin(2 * a + b) / 5,
        c[3] * b - c[1] * a / 2 + c[4] * u**3 + c[5] * a**2 * b / 5,
    )
    return NominalModel((a, b), (u, *c), f, 1.0)


def bounds(gap, x, u):
    """lo, hi of the two gap kernels, written out."""
    if gap == "constant":
        size = np.tile([0.01, 0.02], (len(x), 1))
        return -size, size
    lo = 0.02 * x[:, :1] + 0.01 * np.arange(2)
    return lo, lo + 0.01 * np.abs(u[:, :1])


def problem(seed, counts, gap):
    rng = np.random.default_rng(seed)
    c = rng.uniform([0.5, -0.3, 0.1, 0.5, 0.1, -1.0], [1.0, 0.3, 0.4, 1.0, 0.4, 1.0])
    values = np.sort(rng.uniform(-1.0, 1.0, rng.integers(2, 8)))
    inputs = np.column_stack([values, np.tile(c, (len(values), 1))])
    grid = Grid(BOX, counts)
    axes = () if gap == "constant" else (0,)
    return rng, grid, inputs, nominal_abstraction(family(), grid, inputs, GAPS[gap], axes)


def fall(rng, grid, inputs, gap, cells, m):
    """Successors of states anywhere in the cells, borders included, under any gap within the bound."""
    place = np.where(rng.random((len(cells), 1)) < 0.5, rng.choice([-1.0, 1.0], (len(cells), 2)), 0.0)
    place = np.where(place == 0.0, rng.uniform(-1, 1, (len(cells), 2)), place)
    x = np.clip(grid.centres()[cells] + place * grid.h, BOX.lo, BOX.hi)
    lo, hi = bounds(gap, x, inputs[m])
    return family().step(x, inputs[m]) + lo + (hi - lo) * rng.choice([0.0, 0.5, 1.0], x.shape)


def some_pairs(rng, mask, inputs, cells):
    """For each cell an admissible input at random; every cell has one."""
    bits = unpack(mask, inputs)[cells]
    assert bits.any(axis=1).all()
    return np.array([rng.choice(np.flatnonzero(b)) for b in bits])


def touched(grid, x):
    """Cells that x lies in, all of them on a shared border to 1e-9 of a cell: (n,), (n, 4)."""
    k = (x - grid.box.lo) / (2 * grid.h)
    ends = [np.clip(np.floor(k + s * 1e-9), 0, np.array(grid.cells) - 1).astype(int) for s in (-1, 1)]
    corners = [np.stack([ends[i][:, 0], ends[j][:, 1]], axis=1) for i in (0, 1) for j in (0, 1)]
    flat = np.stack([np.ravel_multi_index(tuple(c.T), grid.cells) for c in corners], axis=1)
    return np.all((k >= -1e-9) & (k <= np.array(grid.cells) + 1e-9), axis=1), flat


counted = st.lists(st.integers(5, 45), min_size=2, max_size=2)


def test_a_state_of_the_winning_domain_can_be_kept_in_it():
    sizes = []

    @given(seed=st.integers(0, 10**6), counts=counted, gap=st.sampled_from(sorted(GAPS)))
    @RELAXED
    def check(seed, counts, gap):
        rng, grid, inputs, a = problem(seed, counts, gap)
        safe = rng.random(grid.size) < 0.999
        found = invariance(a, safe)
        sizes.append(found.winning.mean())
        assert not np.any(found.winning & ~safe)
        if not found.winning.any():
            return
        cells = rng.choice(np.flatnonzero(found.winning), 400)
        m = some_pairs(rng, found.mask, len(inputs), cells)
        inside, flat = touched(grid, fall(rng, grid, inputs, gap, cells, m))
        assert inside.all()
        assert found.winning[flat].all()

    check()
    assert np.mean([0.05 < s < 1 for s in sizes]) > 0.4


def test_a_state_of_the_winning_domain_comes_nearer_to_the_target():
    sizes, depths = [], []

    @given(seed=st.integers(0, 10**6), counts=counted, gap=st.sampled_from(sorted(GAPS)))
    @RELAXED
    def check(seed, counts, gap):
        rng, grid, inputs, a = problem(seed, counts, gap)
        centres = grid.centres()
        target = np.all(np.abs(centres - rng.uniform(-0.5, 0.5, 2)) < 0.35, axis=1)
        free = rng.random(grid.size) < 0.98
        found = reach_avoid(a, target, free)
        more = found.value > 0
        sizes.append(more.mean())
        depths.append(found.steps)
        assert not np.any(found.winning & ~free)
        if not more.any():
            return
        cells = rng.choice(np.flatnonzero(more), 400)
        m = some_pairs(rng, found.mask, len(inputs), cells)
        inside, flat = touched(grid, fall(rng, grid, inputs, gap, cells, m))
        assert inside.all()
        assert np.all((found.value[flat] >= 0) & (found.value[flat] < found.value[cells][:, None]))

    check()
    assert np.mean([s > 0.02 for s in sizes]) > 0.4
    assert max(depths) > 3
