"""One-step margins against their definition: the abstraction with a gap that has grown by that much."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import synthesis_plants as plants

from simgap.geometry import Box, Grid
from simgap.synthesis.invariance import invariance
from simgap.synthesis.margins import LARGEST_FACTOR, Remembered, one_step_margins, shown_layers
from simgap.synthesis.nominal import nominal_abstraction
from simgap.synthesis.previous_rows import reach_by_classes
from simgap.synthesis.reach import reach_avoid


def within(model, grid, inputs, gap, winning, mask, cell, factor=1.0, more=0.0, kind=None):
    """Whether some admissible input's successors lie in winning cells only, gamma's half-width times `factor`.

    With the class of each input, `kind`, in those of winning (cells, C) that win after an input of its class.
    """
    k = np.array(np.unravel_index(cell, grid.cells))
    lo, hi = grid.box.lo + 2 * grid.h * k, grid.box.lo + 2 * grid.h * (k + 1)
    centre, below, above = (lo + hi) / 2, np.empty(len(k)), np.empty(len(k))
    for m, u in enumerate(inputs):
        if not mask[cell, m >> 3] >> (m & 7) & 1:
            continue
        inside = (winning if kind is None else winning[:, kind[m]]).reshape(grid.cells)
        steep = np.abs(np.array(model.jacobian_interval_kernel(lo, hi, u, u))).max(axis=1).reshape(len(k), len(k))
        middle, spread = np.array(model.kernel(centre, u)), steep @ ((hi - lo) / 2)
        gap.py_func(lo, hi, u, below, above)
        half = (factor - 1.0) * (above - below) / 2 + more
        first = np.floor((middle - spread + below - half - grid.box.lo) / (2 * grid.h)).astype(int)
        last = np.floor((middle + spread + above + half - grid.box.lo) / (2 * grid.h)).astype(int)
        ranges = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        ranges = [r % c if j in grid.periodic else r for j, (r, c) in enumerate(zip(ranges, grid.cells, strict=True))]
        ends = zip(ranges, grid.cells, strict=True)
        if all(r.min() >= 0 and r.max() < c for r, c in ends) and inside[np.ix_(*ranges)].all():
            return True
    return False


def check(model, grid, inputs, gap, winning, mask, found, cells, n, kind=None):
    for cell in cells:
        at = (model, grid, inputs, gap, winning, mask, cell)
        factor, extra = float(found.factor[cell]), found.extra[cell].astype(float)
        assert within(*at, 1.0 + (factor - 1.0) * (1 - 1e-6) - 1e-6, kind=kind)
        if factor < LARGEST_FACTOR * 0.999:
            assert not within(*at, 1.0 + (factor - 1.0) * (1 + 4.5e-3) + 3e-6, kind=kind)
        for i in range(n):
            width, only = 2 * grid.h[i] * grid.cells[i], np.arange(n) == i
            assert within(*at, 1.0, only * (extra[i] * (1 - 1e-6) - 1e-9 * width), kind=kind)
            more = extra[i] * (1 + 4.5e-3) + 3e-9 * width
            if more < width:
                assert not within(*at, 1.0, only * more, kind=kind)


def test_the_margins_of_the_pendulum_are_those_of_the_definition():
    model, inputs = plants.pendulum()
    grid, gap = Grid(Box([0.0, -0.5], [0.2, 0.5]), (200, 100)), plants.constant_gap(1e-5, 1e-3)
    won = invariance(nominal_abstraction(model, grid, inputs, gap))
    found = one_step_margins(model, grid, inputs, gap, won.winning, won.mask)
    assert np.array_equal(~np.isnan(found.factor), won.winning)
    assert (found.factor[won.winning] >= 1.0).all()
    cells = np.random.default_rng(1).choice(np.flatnonzero(won.winning), 40)
    check(model, grid, inputs, gap, won.winning, won.mask, found, cells, 2)


@pytest.mark.parametrize("gap_axes", [None, (2,)])
def test_the_margins_of_a_robot_are_those_of_the_definition(gap_axes):
    """Boxes that depend on the heading alone are computed once for a layer; the answer is the same."""
    model = plants.unicycle()
    inputs = np.array([[v, w] for v in (-0.5, 0.0, 0.5) for w in (-0.5, 0.0, 0.5)])
    grid = Grid(Box([0.0, 0.0, -np.pi], [3.0, 3.0, np.pi]), (12, 12, 8), (2,))
    gap = plants.constant_gap(0.03, 0.02, 0.05)
    centres = grid.centres()
    target = (centres[:, 0] > 2) & (centres[:, 1] > 2)
    won = reach_avoid(nominal_abstraction(model, grid, inputs, gap, gap_axes), target, np.ones(grid.size, bool))
    assert won.winning.sum() > target.sum()
    found = one_step_margins(model, grid, inputs, gap, won.winning, won.mask, gap_axes)
    assert np.array_equal(~np.isnan(found.factor), won.winning & ~target)
    cells = np.random.default_rng(2).choice(np.flatnonzero(won.winning & ~target), 40)
    check(model, grid, inputs, gap, won.winning, won.mask, found, cells, 3)


def test_a_gap_without_width_has_no_factor_that_matters():
    model, inputs = plants.pendulum()
    grid, gap = Grid(Box([0.0, -0.5], [0.2, 0.5]), (100, 50)), plants.constant_gap(0.0, 0.0)
    won = invariance(nominal_abstraction(model, grid, inputs, gap))
    found = one_step_margins(model, grid, inputs, gap, won.winning, won.mask)
    assert (found.factor[won.winning] == LARGEST_FACTOR).all()


def test_margins_after_an_input_of_a_class_are_those_of_the_definition():
    """Two classes with gaps of their own: successors have to win in the class of the input that leads there."""
    model = plants.unicycle()
    inputs = np.array([[v, w] for v in (-0.5, 0.0, 0.5) for w in (-0.5, 0.0, 0.5)])
    kind = (inputs[:, 0] > 0).astype(np.int64)
    grid = Grid(Box([0.0, 0.0, -np.pi], [3.0, 3.0, np.pi]), (12, 12, 8), (2,))
    gaps = plants.constant_gap(0.03, 0.02, 0.05), plants.constant_gap(0.09, 0.07, 0.2)
    centres = grid.centres()
    target = (centres[:, 0] > 2) & (centres[:, 1] > 2)
    boxes = [nominal_abstraction(model, grid, inputs, gap, (2,)) for gap in gaps]
    won = reach_by_classes(boxes, kind, target, np.ones(grid.size, bool))
    sets = won.value >= 0
    assert (sets[:, 0] & ~sets[:, 1]).any()  # the class matters
    for c, gap in enumerate(gaps):
        own, mask = sets[:, c], np.ascontiguousarray(won.mask[:, c])
        found = one_step_margins(model, grid, inputs, gap, own, mask, (2,), None, Remembered(sets, kind))
        moving = own & ~target
        assert np.array_equal(~np.isnan(found.factor), moving)
        assert (found.factor[moving] >= 1.0).all()
        cells = np.random.default_rng(3).choice(np.flatnonzero(moving), 30)
        check(model, grid, inputs, gap, sets, mask, found, cells, 3, kind)
        layers = shown_layers(8, 3)
        some = one_step_margins(model, grid, inputs, gap, own, mask, (2,), None, Remembered(sets, kind, layers))
        looked_at = np.isin(np.arange(grid.size) % 8, layers)
        assert layers.tolist() == [0, 2, 5]
        assert np.array_equal(some.factor, np.where(looked_at, found.factor, np.nan), equal_nan=True)
        assert np.array_equal(some.extra, np.where(looked_at[:, None], found.extra, np.nan), equal_nan=True)
