"""The path between samples: boxes of cells against points on it, reach-avoid against brute force, its file."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.geometry import Box, Grid
from simgap.io.results import read_json, write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.stages.synthesis import pose_problem
from simgap.synthesis.abstraction.cells import nominal_abstraction
from simgap.synthesis.abstraction.intersample import SweptCells, planar_swept_cells
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import unpack
from tests.synthesis import synthesis_oracle as oracle
from tests.synthesis.synthesis_plants import constant_gap, unicycle

SPEEDS = {"v": {"min": -0.2, "max": 0.2, "step": 0.2}, "w": {"min": -0.5, "max": 0.5, "step": 0.5}}


@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_every_point_of_a_path_is_in_its_cells(axes):
    i, j, k = axes
    lo, hi, counts = np.zeros(3), np.zeros(3), [0, 0, 0]
    lo[[i, j, k]], hi[[i, j, k]] = [0.0, -1.0, -np.pi], [4.0, 2.0, np.pi]
    for axis, count in zip(axes, (40, 25, 16), strict=True):
        counts[axis] = count
    grid = Grid(Box(lo, hi), counts, (k,))
    lower, upper = np.array([[-0.05, -0.1], [-0.4, 0.0]]), np.array([[0.3, 0.02], [0.0, 0.0]])
    swept = planar_swept_cells(grid, lower, upper, axes)
    corner, turn = np.array(list(itertools.product([0.001, 0.999], repeat=2))), np.linspace(0, 1, 41)
    for layer, m in itertools.product(range(16), range(2)):
        theta = grid.box.lo[k] + 2 * grid.h[k] * (layer + turn)
        a = lower[m] + (upper[m] - lower[m]) * np.array(list(itertools.product([0.0, 0.4, 1.0], repeat=2)))
        c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
        moved = np.stack([c * a[:, 0] - s * a[:, 1], s * a[:, 0] + c * a[:, 1]], axis=-1) / (2 * grid.h[[i, j]])
        offset = np.floor(moved[..., None, :] + corner).astype(int)[..., :].reshape(-1, 2)
        low, high = swept.lower[layer, m, [i, j]], swept.upper[layer, m, [i, j]]
        assert np.all((low <= offset) & (offset <= high))
        assert np.all(offset.min(axis=0) - 1 <= low)  # and hardly more than what is touched
        assert np.all(high <= offset.max(axis=0) + 1)
        assert swept.lower[layer, m, k] == swept.upper[layer, m, k] == 0


def random_sweep(rng, grid, inputs, axis, reach):
    low = -rng.integers(0, reach + 1, (grid.cells[axis], inputs, len(grid.cells)))
    high = rng.integers(0, reach + 1, low.shape)
    low[..., axis] = high[..., axis] = 0
    return SweptCells(axis, low.astype(np.int32), high.astype(np.int32))


@pytest.mark.parametrize(
    ("cells", "periodic", "axes"),
    [((7, 66, 5), (2,), ((2,), (2,), ())), ((70, 6), (), ((1,), (1,))), ((9, 8, 6), (2,), ((2,), (2,), (2,)))],
)
@pytest.mark.parametrize("seed", range(4))
def test_an_input_counts_only_where_its_whole_path_is_free(cells, periodic, axes, seed):
    rng = np.random.default_rng([seed, 8, *cells])
    a = oracle.random_abstraction(rng, cells, periodic, inputs=9, axes=axes, spread=1, drift=2)
    swept = random_sweep(rng, a.grid, 9, axes[0][0], 1)
    free, target = rng.random(a.grid.size) < 0.95, rng.random(a.grid.size) < 0.3
    named = [{k for k, s in zip(np.ndindex(*cells), flags, strict=True) if s} for flags in (target, free)]
    moves, low, high = oracle.transitions(a), swept.lower.tolist(), swept.upper.tolist()
    for k, row in moves.items():
        for m in range(9):
            ends = ([c + o for c, o in zip(k, side[k[swept.axis]][m], strict=True)] for side in (low, high))
            path = oracle.post_cells(*ends, cells, periodic)
            row[m] = row[m] if path is not None and path <= named[1] else None
    level, good = oracle.reach(moves, *named)
    found = reach_avoid(replace(a, swept=swept), target, free, threads=2)
    assert found.value.tolist() == [level.get(k, -1) for k in np.ndindex(*cells)]
    bits = unpack(found.mask, 9)
    assert {k: np.flatnonzero(b).tolist() for k, b in zip(np.ndindex(*cells), bits, strict=True) if b.any()} == good
    assert bits.sum() < unpack(reach_avoid(a, target, free).mask, 9).sum()


def test_paths_need_an_axis_that_nothing_depends_on():
    rng = np.random.default_rng(0)
    busy = oracle.random_abstraction(rng, (6, 5))
    everything = np.ones(30, bool)
    with pytest.raises(UserError, match="path between samples"):
        reach_avoid(replace(busy, swept=random_sweep(rng, busy.grid, 5, 0, 1)), everything, everything)


def test_a_run_between_samples_touches_no_obstacle():
    """The unicycle's own arcs, finely sampled, from anywhere in a winning cell under any admissible input."""
    model = unicycle(exact=True)
    inputs = np.array([(v, w) for v in (-0.25, 0.0, 0.25) for w in (-0.5, 0.0, 0.5)])
    grid = Grid(Box([0, 0, -np.pi], [3, 2, np.pi]), (60, 40, 24), (2,))
    t = np.linspace(0, 1, 101)[1:]
    turn = inputs[:, 1, None] * t
    path = inputs[:, 0, None, None] * np.stack(
        [np.sinc(turn / np.pi) * t, t * np.sinc(turn / 2 / np.pi) ** 2 * turn / 2], 2
    )
    lower, upper = np.minimum(path.min(1), 0) - 1e-3, np.maximum(path.max(1), 0) + 1e-3
    abstraction = nominal_abstraction(model, grid, inputs, constant_gap(0.01, 0.01, 0.02), ())
    a = replace(abstraction, swept=planar_swept_cells(grid, lower, upper))
    centres = grid.centres()
    free = ~((np.abs(centres[:, 0] - 1.5) < 0.1) & (centres[:, 1] < 1.2))
    target = (centres[:, 0] > 2.4) & (centres[:, 1] < 1)
    found = reach_avoid(a, target & free, free)
    assert found.winning.mean() > 0.5
    rng = np.random.default_rng(1)
    cells = rng.choice(np.flatnonzero(found.value > 0), 3000)
    start = centres[cells] + grid.h * rng.uniform(-1, 1, (3000, 3))
    bits = unpack(found.mask, len(inputs))[cells]
    m = np.array([rng.choice(np.flatnonzero(b)) for b in bits])
    c, s = np.cos(start[:, 2, None]), np.sin(start[:, 2, None])
    x = start[:, 0, None] + c * path[m, :, 0] - s * path[m, :, 1]
    y = start[:, 1, None] + s * path[m, :, 0] + c * path[m, :, 1]
    assert np.all((x >= 0) & (x <= 3) & (y >= 0) & (y <= 2))
    assert not np.any((np.abs(x - 1.5) < 0.1) & (y < 1.2))


def saved(context, folder):
    """A gap.json made by hand: -> its path, the bound, the box of each input's path."""
    rng, count = np.random.default_rng(2), len(context.input_set)
    lower = rng.uniform(-0.02, 0.0, (count, 3))
    domain = GapDomain(tuple(context.states), tuple(context.inputs), context.box, context.input_set, (0, 1), (2,))
    upper = lower + rng.uniform(0.0, 0.03, (count, 3))
    gap = BodyFrameGap(domain, (Tier(1, "Made up."),), lower[None], upper[None])
    box = rng.uniform(-0.3, 0.0, (count, 2)), rng.uniform(0.0, 0.3, (count, 2))
    record = provenance("gap", context.case, context.folder)
    more = {"swept_boxes": {"lower": box[0], "upper": box[1]}, "provenance": record}
    write_json(folder / "gap.json", gap.to_json() | more)
    return folder / "gap.json", gap, box


def test_bound_and_paths_come_back_from_the_file(vary, tmp_path):
    context = Context.load(vary("turtlebot", {"domain.U": SPEEDS, "synthesis.cells": [20, 20, 12]}))
    path, gap, box = saved(context, tmp_path)
    problem, _ = pose_problem(context, path)
    want = planar_swept_cells(problem.grid, *box)
    assert np.array_equal(problem.swept.lower, want.lower)
    assert np.array_equal(problem.swept.upper, want.upper)
    low, high = np.empty(3), np.empty(3)
    for m, u in enumerate(context.input_set):
        problem.gap(np.array([5.0, 5.0, 0.3]), np.array([5.1, 5.1, 0.3]), u, low, high)
        lo, hi = gap.bounds(np.array([[5.0, 5.0, 0.3]]), u[None])
        assert np.allclose([low, high], [lo[0], hi[0]], rtol=1e-12)
        assert np.all(low <= lo[0] + 1e-12), m
    content = read_json(path)
    del content["gap"]["theta"]
    write_json(path, content)
    with pytest.raises(UserError, match=r"not a saved gap bound.*Run the gap stage of this case again"):
        pose_problem(context, path)
