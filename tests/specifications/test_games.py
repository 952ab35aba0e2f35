"""Winning sets against brute force on explicit lists of transitions, by the definitions of the two games.

The oracle asks "can s be kept n steps" and "can s win within k steps" by recursion; with as many steps as there are
cells nothing changes any more. It shares no code with what it tests: transitions are listed from the random numbers
themselves.
"""

import itertools
from functools import lru_cache

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.geometry import Box
from simgap.specifications.reaching import ReachAndStay, ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import table_meta, table_post
from simgap.synthesis.games.game import NodeGame

INPUTS = 4
PROBLEMS = 250


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

    def solve(self, kind, name):
        space = Space(("a", "b"), Box([0, 0], self.cells), self.periodic)
        asked = kind(kind=name, obstacles=self.obstacles, target=self.target)
        grid = space.grid(space.box, self.cells)
        meta, _ = table_meta(grid, INPUTS, self.axes)
        table = self.offsets.astype(np.int32).reshape(-1)
        u = np.arange(INPUTS, dtype=float)[:, None]
        a = Abstraction(grid, u, table_post(), meta, np.zeros(1), table, self.axes, np.zeros(2))
        return asked.solve(NodeGame((a,), space, np.zeros(2)))


class Oracle:
    def __init__(self, tiny, stay):
        self.every = list(itertools.product(*(range(n) for n in tiny.cells)))
        self.after = {s: tiny.moves(s) for s in self.every}
        self.free = {s for s in self.every if not any(inside(s, box) for box in tiny.obstacles)}
        self.goal = {s for s in self.free if inside(s, tiny.target)}
        long = len(self.every)
        keep = lru_cache(None)(lambda s, n: s in self.goal and (n == 0 or any(self.by(lambda t: keep(t, n - 1), s))))
        self.end = {s for s in self.goal if keep(s, long)} if stay else self.goal
        self.win = lru_cache(None)(
            lambda s, k: s in self.end
            or (k > 0 and s in self.free and any(self.by(lambda t: self.win(t, k - 1), s)))
        )  # fmt: skip
        self.steps = {s: next((k for k in range(long + 1) if self.win(s, k)), -1) for s in self.every}

    def by(self, good, s):
        """For each input whether all that may follow is good."""
        return [after is not None and all(good(t) for t in after) for after in self.after[s]]

    def inputs(self, s):
        """What a controller may apply: inputs that get nearer, in the end set those that stay in it."""
        k = self.steps[s]
        if k > 0:
            return self.by(lambda t: self.win(t, k - 1), s)
        return self.by(lambda t: t in self.end, s) if k == 0 else [False] * INPUTS


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.parametrize(("kind", "name"), [(ReachAvoid, "reach_avoid"), (ReachAndStay, "reach_and_stay")])
def test_winning_sets_are_those_of_the_definition(kind, name, rows):
    stay, sizes, empty = kind is ReachAndStay, [], 0
    for seed in range(PROBLEMS):
        tiny = Tiny([seed, rows], rows)
        truth = Oracle(tiny, stay)
        if not truth.goal:
            empty += 1
            with pytest.raises(UserError, match="every cell of the target is inside an obstacle"):
                tiny.solve(kind, name)
            continue
        found = tiny.solve(kind, name)
        assert found.value.tolist() == [truth.steps[s] for s in truth.every], seed
        assert found.winning.tolist() == [truth.steps[s] >= 0 for s in truth.every], seed
        bits = np.unpackbits(found.mask, axis=1, count=INPUTS, bitorder="little").astype(bool)
        for s, own in zip(truth.every, bits.tolist(), strict=True):
            ends = s in truth.end and not stay
            assert own == ([False] * INPUTS if ends else truth.inputs(s)), (seed, s)
        assert found.statistics["backend"] == ("bit_rows" if rows else "table")
        sizes.append(sum(k > 0 for k in truth.steps.values()))
    assert len(sizes) >= 200
    assert np.mean([n > 0 for n in sizes]) > 0.3
    assert empty < PROBLEMS // 4
