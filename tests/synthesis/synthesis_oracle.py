"""Plain-Python fixed points on tiny grids, and random abstractions to try them on. Shares no code with the kernels."""

import itertools

import numpy as np

from simgap.geometry import Box, Grid
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import table_meta, table_post


def random_abstraction(rng, cells, periodic=(), inputs=5, axes=None, spread=2, drift=3):
    """An abstraction whose boxes are random offsets, dimension i depending on the cell through `axes[i]` only."""
    n = len(cells)
    axes = tuple(tuple(range(n)) for _ in range(n)) if axes is None else axes
    grid = Grid(Box(np.zeros(n), np.ones(n)), cells, periodic)
    meta, total = table_meta(grid, inputs, axes)
    low = rng.integers(-drift, drift + 1, total)
    table = np.stack([low, low + rng.integers(0, spread + 1, total)], axis=1).astype(np.int32)
    return Abstraction(
        grid,
        np.arange(inputs, dtype=float)[:, None],
        table_post(),
        meta,
        np.zeros(1),
        table.reshape(-1),
        axes,
        np.zeros(n),
    )


def post_cells(lower, upper, cells, periodic):
    """All cells of a box as index tuples, None if it leaves the grid."""
    ranges = []
    for j, count in enumerate(cells):
        if j in periodic:
            ranges.append({k % count for k in range(lower[j], upper[j] + 1)})
        elif lower[j] < 0 or upper[j] >= count:
            return None
        else:
            ranges.append(set(range(lower[j], upper[j] + 1)))
    return set(itertools.product(*ranges))


def transitions(abstraction):
    """{cell index tuple: [set of successors or None, one per input]}."""
    grid = abstraction.grid
    boxes = abstraction.boxes(np.arange(grid.size)).tolist()
    every = itertools.product(*(range(c) for c in grid.cells))
    return {
        k: [post_cells(low, high, grid.cells, grid.periodic) for low, high in row]
        for k, row in zip(every, boxes, strict=True)
    }


def invariant(moves, safe=None):
    """Greatest invariant set and its admissible inputs: ({cell}, {cell: [input]})."""
    inside = set(moves) if safe is None else set(safe)
    while True:
        good = {k: [m for m, to in enumerate(moves[k]) if to is not None and to <= inside] for k in inside}
        left = {k for k in inside if good[k]}
        if left == inside:
            return inside, good
        inside = left


def reach(moves, target, free):
    """Least steps to the target and the inputs that go down a level: ({cell: level}, {cell: [input]})."""
    level = dict.fromkeys(target & free, 0)
    good = {}
    step = 0
    while True:
        step += 1
        won = set(level)
        new = {}
        for k in free - won:
            inputs = [m for m, to in enumerate(moves[k]) if to is not None and to <= won]
            if inputs:
                new[k] = inputs
        if not new:
            return level, good
        level |= dict.fromkeys(new, step)
        good |= new


def delayed(moves, inputs):
    """Greatest set of (cell, pending input) pairs when the next input rests on the measurement before."""
    pairs = {(k, p) for k in moves for p in range(inputs) if moves[k][p] is not None}
    while True:
        left = {(k, p) for k, p in pairs if any(all((to, u) in pairs for to in moves[k][p]) for u in range(inputs))}
        if left == pairs:
            return pairs
        pairs = left


def flat(cells, shape):
    """Index tuples as sorted flat numbers."""
    return sorted(int(np.ravel_multi_index(k, shape)) for k in cells)
