"""One-step margins against their definition: the abstraction with a gap that has grown by that much."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from simgap.geometry import Box, Grid
from simgap.plants.context import Context
from simgap.stages.synthesis import pose_problem
from simgap.synthesis.abstraction.cells import nominal_abstraction
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.margins import (
    AROUND,
    ASKED,
    BESIDE,
    CELLS,
    GAMMA,
    LARGEST_FACTOR,
    NOTHING,
    Remembered,
    margins_of,
    one_step_margins,
    shown_layers,
)
from simgap.synthesis.synthesise import synthesise
from tests.synthesis import synthesis_plants as plants


def within(
    model, grid, inputs, gap, winning, mask, cell, factor=1.0, more=0.0, kind=None, acting=None, reach=None, error=0.0,
    whole=True,
):  # fmt: skip
    """Whether some admissible input's successors lie in winning cells only, gamma's half-width times `factor`.

    With `kind`, of each input, in those of winning (cells, C) that win with it. With `acting` it is that input which
    moves the plant, whatever is chosen. With `reach` that has to be so for every measurement within so many cells; with
    `error` the cells are of measurements. Not `whole`, it is about the centre of the cell alone.
    """
    k = np.array(np.unravel_index(cell, grid.cells))
    lo, hi = grid.box.lo + 2 * grid.h * k - error, grid.box.lo + 2 * grid.h * (k + 1) + error
    ends = [j not in grid.periodic for j in range(len(k))]
    lo, hi = np.where(ends, np.maximum(lo, grid.box.lo), lo), np.where(ends, np.minimum(hi, grid.box.hi), hi)
    lo, hi = (lo, hi) if whole else ((lo + hi) / 2, (lo + hi) / 2)
    centre, below, above = (lo + hi) / 2, np.empty(len(k)), np.empty(len(k))
    fits = []
    for m in range(len(inputs)):
        u = inputs[m if acting is None else acting]
        inside = (winning if kind is None else winning[:, kind[m]]).reshape(grid.cells)
        steep = np.abs(np.array(model.jacobian_interval_kernel(lo, hi, u, u))).max(axis=1).reshape(len(k), len(k))
        middle, spread = np.array(model.kernel(centre, u)), steep @ ((hi - lo) / 2)
        gap.py_func(lo, hi, u, below, above)
        half = (factor - 1.0) * (above - below) / 2 + more + error
        first = np.floor((middle - spread + below - half - grid.box.lo) / (2 * grid.h)).astype(int)
        last = np.floor((middle + spread + above + half - grid.box.lo) / (2 * grid.h)).astype(int)
        ranges = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        ranges = [r % c if j in grid.periodic else r for j, (r, c) in enumerate(zip(ranges, grid.cells, strict=True))]
        ends = zip(ranges, grid.cells, strict=True)
        fits.append(all(r.min() >= 0 and r.max() < c for r, c in ends) and inside[np.ix_(*ranges)].all())
    return all(
        any(fit and mask[y, m >> 3] >> (m & 7) & 1 for m, fit in enumerate(fits)) for y in measured(grid, k, reach)
    )


def measured(grid, k, reach):
    """Flat numbers of the cells in which a state of cell k may be measured, on the grid that is larger by `reach`."""
    if reach is None:
        return [int(np.ravel_multi_index(tuple(k), grid.cells))]
    wraps = [j in grid.periodic for j in range(len(k))]
    sizes = [c if w else c + 2 * r for c, w, r in zip(grid.cells, wraps, reach, strict=True)]
    near = [[(i + d) % c if w else i + d + r for d in range(-r, r + 1)] for i, c, w, r in
            zip(k, sizes, wraps, reach, strict=True)]  # fmt: skip
    return [int(np.ravel_multi_index(y, sizes)) for y in itertools.product(*near)]


def check(model, grid, inputs, gap, winning, mask, found, cells, kind=None, acting=None, reach=None, error=0.0):
    about = {"kind": kind, "acting": acting, "reach": reach, "error": error}
    for cell in cells:
        at, factor = (model, grid, inputs, gap, winning, mask, cell), float(found.factor[cell])
        assert within(*at, 1.0 + (factor - 1.0) * (1 - 1e-6) - 1e-6, **about)
        if factor < LARGEST_FACTOR * 0.999:
            assert not within(*at, 1.0 + (factor - 1.0) * (1 + 4.5e-3) + 3e-6, **about)


def test_the_margins_of_the_pendulum_are_those_of_the_definition():
    model, inputs = plants.pendulum()
    grid, gap = Grid(Box([0.0, -0.5], [0.2, 0.5]), (200, 100)), plants.constant_gap(1e-5, 1e-3)
    won = invariance(nominal_abstraction(model, grid, inputs, gap))
    found = one_step_margins(model, grid, inputs, gap, won.winning, won.mask)
    assert np.array_equal(~np.isnan(found.factor), won.winning)
    assert (found.factor[won.winning] >= 1.0).all()
    cells = np.random.default_rng(1).choice(np.flatnonzero(won.winning), 40)
    check(model, grid, inputs, gap, won.winning, won.mask, found, cells)


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
    check(model, grid, inputs, gap, won.winning, won.mask, found, cells)


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
    won = reach_avoid(boxes, target, np.ones(grid.size, bool), kind=kind)
    sets, masks = won.winning.reshape(-1, 2), won.mask.reshape(grid.size, 2, -1)
    assert (sets[:, 0] & ~sets[:, 1]).any()  # the class matters
    for c, gap in enumerate(gaps):
        own, mask = sets[:, c], np.ascontiguousarray(masks[:, c])
        found = one_step_margins(model, grid, inputs, gap, own, mask, (2,), None, Remembered(sets, kind))
        moving = own & ~target
        assert np.array_equal(~np.isnan(found.factor), moving)
        assert (found.factor[moving] >= 1.0).all()
        cells = np.random.default_rng(3).choice(np.flatnonzero(moving), 30)
        check(model, grid, inputs, gap, sets, mask, found, cells, kind)
        layers = shown_layers(8, 3)
        assert layers.tolist() == [0, 2, 5]
        looked_at = np.isin(np.arange(grid.size) % 8, layers)
        some = one_step_margins(model, grid, inputs, gap, own & looked_at, mask, (2,), None, Remembered(sets, kind))
        assert np.array_equal(some.factor, np.where(looked_at, found.factor, np.nan), equal_nan=True)


def test_what_losing_cells_lose_by_is_that_of_the_definition():
    """Random sets, gaps with a middle that is not 0: how narrow gamma would have to be, and what else is at fault."""
    model, _ = plants.pendulum()
    inputs, seen = np.linspace(-1.0, 1.0, 5)[:, None], dict.fromkeys((GAMMA, CELLS, AROUND, BESIDE), 0)
    for seed in range(60):
        rng = np.random.default_rng([seed, 11])
        periodic = ((), (1,))[seed % 2]
        grid = Grid(Box([0.0, -0.5], [0.2, 0.5]), tuple(int(c) for c in rng.integers(7, 12, 2)), periodic)
        gap = plants.constant_gap(*(float(w) for w in rng.choice([1e-4, 1e-2, 1e-1], 2)))
        sets = rng.random((grid.size, 2)) < rng.choice([0.5, 0.9])
        kind, losing = rng.integers(0, 2, 5), rng.random(grid.size) < 0.5
        every = np.full((grid.size, 1), 255, np.uint8)
        known = Remembered(sets, kind)
        found = one_step_margins(model, grid, inputs, gap, sets[:, 0] & ~losing, every, remembered=known, losing=losing)
        assert np.array_equal(found.loses_by != NOTHING, losing)
        for cell in np.flatnonzero(losing):
            at, cause = (model, grid, inputs, gap, sets, every, cell), int(found.loses_by[cell])
            seen[cause] += 1
            # a box that ends on a face is in both cells, which rounding may hide from the oracle
            fits, spills = {"kind": kind}, {"kind": kind, "more": 1e-9}
            if cause == BESIDE:
                assert within(*at, 1.0, **fits)
            elif cause == GAMMA:
                factor = float(found.factor[cell])
                assert within(*at, factor * (1 - 1e-6), **fits)
                assert not within(*at, min(1.0, factor * (1 + 4.5e-3) + 1e-6), **spills)
            else:
                assert not within(*at, 0.0, **spills)
                if cause == CELLS:
                    assert within(*at, 0.0, **fits, whole=False)
                else:
                    assert not within(*at, 0.0, **spills, whole=False)
    assert min(seen.values()) > 30, seen


@pytest.mark.parametrize("acting", [None, 2])
def test_margins_of_true_cells_are_the_least_over_their_measurements(acting):
    """Random sets and random inputs at random measurements, with and without a sample of latency: the definition."""
    model, _ = plants.pendulum()
    gap, inputs, checked, lost = plants.constant_gap(1e-5, 1e-3), np.linspace(-1.0, 1.0, 5)[:, None], 0, 0
    for seed in range(80):
        rng = np.random.default_rng([seed, 9])
        periodic, reach = ((), (1,))[seed % 2], ((1, 2), (0, 3), (2, 0))[seed % 3]
        grid = Grid(Box([0.0, -0.5], [0.2, 0.5]), tuple(int(c) for c in rng.integers(7, 12, 2)), periodic)
        sets = rng.random((grid.size, 1 if acting is None else 5)) < 0.97
        kind = np.zeros(5, np.int64) if acting is None else np.arange(5)
        inside = sets[:, 0] & (rng.random(grid.size) < 0.8)
        rows = int(np.prod([c if j in periodic else c + 2 * reach[j] for j, c in enumerate(grid.cells)]))
        mask = np.packbits(rng.random((rows, 5)) < rng.choice([0.5, 0.9]), axis=1, bitorder="little")
        found = one_step_margins(
            model, grid, inputs, gap, inside, mask, None, None, Remembered(sets, kind, acting=acting), reach
        )
        about = (model, grid, inputs, gap, sets, mask)
        kept = [bool(inside[c]) and within(*about, c, kind=kind, acting=acting, reach=reach) for c in range(grid.size)]
        assert np.array_equal(~np.isnan(found.factor), kept), seed
        cells = rng.permutation(np.flatnonzero(kept))[:3]
        check(model, grid, inputs, gap, sets, mask, found, cells, kind, acting, reach)
        checked, lost = checked + len(cells), lost + int(inside.sum()) - sum(kept)
    assert min(checked, lost) > 100


@pytest.mark.parametrize(("tau", "formula"), [("0.05 s", "G F left & G F right"), ("0.05 s", "!left U right")])
def test_margins_of_a_task_are_those_of_the_states_that_follow_its_letters(vary, tau, formula):
    """Cells whose letter moves the task on are looked at with the sets of the state that it moves on to."""
    regions = {"left": {"x1": [-0.15, -0.05]}, "right": {"x1": [0.05, 0.15]}}
    task = {"kind": "task", "formula": formula, "regions": regions}
    changes = {"domain.tau": tau, "synthesis.cells": [60, 40], "synthesis.specification": task}
    context = Context.load(vary("pendulum", changes))
    gap = plants.constant_gap(2e-3, 2e-2)
    problem = replace(pose_problem(context, None)[0], gap=gap)
    solution = synthesise(problem)
    grid, progress, model = solution.grid, solution.progress, context.plant.sampled
    bound = SimpleNamespace(kernel=lambda: gap, domain=SimpleNamespace(read=(0, 1)))
    found = margins_of(context, bound, solution)
    begins = solution.at_first(solution.served) & solution.winning
    assert np.array_equal(found.factor >= 1.0, begins)
    assert 0.1 < begins.mean() < 0.95
    assert found.only == "where the task begins"
    following = progress(solution.first, np.arange(grid.size))
    nodes = (solution.value >= 0).reshape(grid.size, solution.memory)
    mask = solution.admitted(len(context.input_set), np.arange(grid.size) * solution.memory + solution.first)
    rng, zeros = np.random.default_rng(5), np.zeros(len(context.input_set), np.int64)
    for state in np.unique(following[begins]):
        sets = nodes[:, [state]]
        about = (model, grid, context.input_set, gap, sets)
        check(*about, mask, found, rng.permutation(np.flatnonzero(begins & (following == state)))[:15], zeros)
        for cell in np.flatnonzero((found.loses_by == GAMMA) & (following == state))[:15]:
            every, factor = np.full_like(mask, 255), float(found.factor[cell])
            assert within(*about, every, cell, factor * (1 - 1e-6), kind=zeros)
            assert not within(*about, every, cell, min(1.0, factor * (1 + 4.5e-3) + 1e-6), 1e-9, zeros)
    letters = problem.specification.fit(problem.space, grid, np.zeros(2))
    assert np.array_equal(found.loses_by != NOTHING, ~nodes[:, solution.first])
    assert np.array_equal(found.loses_by == ASKED, ~letters)
    assert letters.all() == formula.startswith("G F")
