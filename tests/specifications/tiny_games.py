"""Random plants on a few unit cells, as lists of transitions and as abstractions."""

import itertools

import numpy as np

from simgap.geometry import Box
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import table_meta, table_post
from simgap.synthesis.games.game import NodeGame

INPUTS = 4


def random_box(rng, cells, least):
    low = [int(rng.integers(0, n)) for n in cells]
    high = [int(rng.integers(a + 1, min(n, a + least) + 1)) for a, n in zip(low, cells, strict=True)]
    return {name: (float(a), float(b)) for name, a, b in zip("ab", low, high, strict=True)}


def inside(cell, box):
    return all(box[name][0] <= k and k + 1 <= box[name][1] for name, k in zip("ab", cell, strict=True))


class Tiny:
    """A random plant on a few unit cells, with obstacles and a target of whole cells."""

    def __init__(self, seed, rows):
        rng = np.random.default_rng(seed)
        self.cells = tuple(int(n) for n in rng.integers(3, 6, 2))
        self.periodic = (1,) if rng.random() < 0.3 else ()
        self.axes = ((1,), (1,)) if rows else ((0, 1), (0, 1))
        layers = self.cells[1] if rows else self.cells[0] * self.cells[1]
        low = rng.integers(-1, 2, (2, layers, INPUTS))
        self.offsets = np.stack([low, low + (rng.random(low.shape) < 0.25)], axis=-1)
        self.obstacles = [random_box(rng, self.cells, 2) for _ in range(rng.integers(0, 3))]
        self.target = random_box(rng, self.cells, 3)

    def moves(self, cell):
        """For each input the cells that may follow, None where one of them lies outside."""
        layer = cell[1] if self.axes == ((1,), (1,)) else cell[0] * self.cells[1] + cell[1]
        out = []
        for m in range(INPUTS):
            ends = [(cell[i] + self.offsets[i, layer, m, 0], cell[i] + self.offsets[i, layer, m, 1]) for i in (0, 1)]
            reached = set(itertools.product(*(range(a, b + 1) for a, b in ends)))
            if 1 in self.periodic:
                reached = {(a, b % self.cells[1]) for a, b in reached}
            fits = all(0 <= a < self.cells[0] and 0 <= b < self.cells[1] for a, b in reached)
            out.append(reached if fits else None)
        return out

    def game(self, late=False):
        """The game on the plant."""
        space = Space(("a", "b"), Box([0, 0], self.cells), self.periodic)
        grid = space.grid(space.box, self.cells)
        meta, _ = table_meta(grid, INPUTS, self.axes)
        table = self.offsets.astype(np.int32).reshape(-1)
        u = np.arange(INPUTS, dtype=float)[:, None]
        a = Abstraction(grid, u, table_post(), meta, np.zeros(1), table, self.axes, np.zeros(2))
        return NodeGame((a,), space, np.zeros(2), late=late)
