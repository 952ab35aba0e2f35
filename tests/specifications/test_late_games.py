"""Reaching with a measurement error, a sample of latency and both, against the definitions by brute force.

The oracle lists nodes (measured cell, input that acts now) and what may follow them from the random numbers themselves,
and asks "is it won within n steps", n = 0, 1, ... It shares no code with what it tests.
"""

import itertools

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.geometry import Box
from simgap.specifications.reaching import ReachAndStay, ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.intersample import SweptCells
from simgap.synthesis.abstraction.post import table_meta, table_post
from simgap.synthesis.games.game import NodeGame

INPUTS, PROBLEMS = 3, 100
NAMES = "abc"
KINDS = [(ReachAvoid, "reach_avoid"), (ReachAndStay, "reach_and_stay")]


def random_box(rng, cells, least, most):
    low = [int(rng.integers(0, max(n - least, 0) + 1)) for n in cells]
    high = [int(rng.integers(min(a + least, n), min(n, a + most) + 1)) for a, n in zip(low, cells, strict=True)]
    return {name: (float(a), float(b)) for name, a, b in zip(NAMES, low, high, strict=False)}


class Tiny:
    """A random plant on a few unit cells of 1 to 3 states, one of which may wrap around."""

    def __init__(self, seed, blurred, late, swept):
        rng = np.random.default_rng(seed)
        self.n, self.late = int(rng.integers(1, 4)), late
        least, most = {1: (5, 10), 2: (4, 6), 3: (3, 5)}[self.n]
        self.cells = tuple(int(k) for k in rng.integers(least, most, self.n))
        self.periodic = (self.n - 1,) if rng.random() < 0.4 else ()
        # states that are measured exactly among others that are not; never a whole number of cells
        self.error = np.zeros(self.n)
        if blurred:
            self.error[rng.integers(self.n)] = rng.choice([0.3, 0.8])
        self.every = list(itertools.product(*(range(k) for k in self.cells)))
        low = rng.integers(-1, 2, (self.n, len(self.every), INPUTS))
        self.offsets = np.stack([low, low + (rng.random(low.shape) < 0.15)], axis=-1)
        self.obstacles = [random_box(rng, self.cells, 1, 1) for _ in range(rng.integers(0, 2))]
        self.target = random_box(rng, self.cells, 3 if blurred else 2, 4)
        self.first = int(rng.integers(INPUTS))
        self.paths = None
        if swept:
            start = rng.integers(-1, 1, (self.cells[-1], INPUTS, self.n))
            self.paths = start, start + rng.integers(0, 2, start.shape) * (rng.random(start.shape) < 0.5)

    def wrapped(self, cells):
        """The cells with periodic indices in range, None where one of them lies outside."""
        out = {tuple(k % c if j in self.periodic else k for j, (k, c) in enumerate(zip(cell, self.cells, strict=True)))
               for cell in cells}  # fmt: skip
        return out if out <= set(self.every) else None

    def after(self, cell, m):
        at = self.every.index(cell)
        ends = [(cell[j] + self.offsets[j, at, m, 0], cell[j] + self.offsets[j, at, m, 1]) for j in range(self.n)]
        return self.wrapped(set(itertools.product(*(range(a, b + 1) for a, b in ends))))

    def path(self, cell, m):
        if self.paths is None:
            return {cell}
        low, high = (ends[cell[-1], m] for ends in self.paths)
        spans = [range(k + a, k + b + 1) for k, a, b in zip(cell, low, high, strict=True)]
        return self.wrapped(itertools.product(*spans))

    def solve(self, kind, name):
        space = Space(tuple(NAMES[: self.n]), Box([0] * self.n, self.cells), self.periodic)
        asked = kind(kind=name, obstacles=self.obstacles, target=self.target)
        grid = space.grid(space.box, self.cells)
        axes = tuple(tuple(range(self.n)) for _ in range(self.n))
        meta, _ = table_meta(grid, INPUTS, axes)
        table = self.offsets.astype(np.int32).reshape(-1)
        swept = None
        if self.paths is not None:
            swept = SweptCells(self.n - 1, *(ends.astype(np.int32) for ends in self.paths))
        u = np.arange(INPUTS, dtype=float)[:, None]
        a = Abstraction(grid, u, table_post(), meta, np.zeros(1), table, axes, self.error, swept)
        return asked.solve(NodeGame((a,), space, np.zeros(self.n), late=bool(self.late), first=self.first))


class Oracle:
    def __init__(self, tiny, stay):
        self.tiny = tiny
        goal = {y for y in tiny.every if self.free(y) and self.all_near(y, tiny.target)}
        self.reached = {y for y in tiny.every if self.free(y)} & goal
        pending = range(INPUTS) if tiny.late else [0]
        self.nodes = [(y, p) for y in tiny.every for p in pending]
        end = {node for node in self.nodes if node[0] in goal}
        if stay:
            while (kept := {node for node in end if self.inputs(node, end, check=False)}) != end:
                end = kept
        self.end, self.level, self.good = end, dict.fromkeys(end, 0), {}
        for steps in range(1, len(self.nodes) + 1):
            within = set(self.level)
            new = {n: own for n in self.nodes if n not in within and (own := self.inputs(n, within, check=True))}
            self.level |= dict.fromkeys(new, steps)
            self.good |= new
            if not new:
                break
        self.good |= {n: self.inputs(n, end, check=False) if stay else [] for n in end}

    def inputs(self, node, good, check):
        """The inputs that may be chosen at a node so that whatever is measured next, the run is in a good node."""
        tiny, (y, p) = self.tiny, node
        out = []
        for u in range(INPUTS):
            acts = p if tiny.late else u
            after, path = tiny.after(y, acts), tiny.path(y, acts)
            clear = path is not None and all(self.free(c) for c in path)
            if check and not (self.free(y) and clear):
                continue
            if after is not None and all((k, u if tiny.late else 0) in good for k in after):
                out.append(u)
        return out

    def near(self, y):
        """For each state the open interval in which it may be when the measurement is in cell y."""
        return [(k - e, k + 1 + e) for k, e in zip(y, self.tiny.error, strict=True)]

    def copies(self, j, ends):
        turn = self.tiny.cells[j] if j in self.tiny.periodic else 0
        return [(a + s * turn, b + s * turn) for a, b in [ends] for s in (-1, 0, 1)]

    def free(self, y):
        """Every state that it may stand for is in X and in no obstacle."""
        around, tiny = self.near(y), self.tiny
        if any(j not in tiny.periodic and (a < 0 or b > tiny.cells[j]) for j, (a, b) in enumerate(around)):
            return False
        meets = [
            all(any(a < hi and b > lo for lo, hi in self.copies(j, box[NAMES[j]])) for j, (a, b) in enumerate(around))
            for box in tiny.obstacles
        ]
        return not any(meets)

    def all_near(self, y, box):
        """Every state that it may stand for is in the box."""
        fits = [any(lo <= a and b <= hi for lo, hi in self.copies(j, box[NAMES[j]])) for j, (a, b) in
                enumerate(self.near(y))]  # fmt: skip
        return all(fits)

    def starts(self):
        """Cells of the true state whose every measurement is in a winning node of a start."""
        tiny, first = self.tiny, self.tiny.first if self.tiny.late else 0
        reach = [range(-int(np.ceil(e)), int(np.ceil(e)) + 1) for e in tiny.error]
        out = set()
        for x in tiny.every:
            seen = tiny.wrapped([tuple(np.add(x, by).tolist()) for by in itertools.product(*reach)])
            if seen is not None and all((y, first) in self.level for y in seen):
                out.add(x)
        return out


@pytest.mark.parametrize(("blurred", "late", "swept"), [(1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 1, 1)])
@pytest.mark.parametrize(("kind", "name"), KINDS)
def test_winning_nodes_inputs_and_starts_are_those_of_the_definition(kind, name, blurred, late, swept):
    stay, solved, won, sizes = kind is ReachAndStay, 0, 0, set()
    if stay and swept:
        pytest.skip("a set that is held relies on clearance, not on swept boxes")
    for seed in itertools.count():
        if solved == PROBLEMS:
            break
        tiny = Tiny([seed, blurred, late, swept], blurred, late, swept)
        truth = Oracle(tiny, stay)
        if not truth.reached:  # no cell fits, or all of the target is too near to something
            with pytest.raises(UserError, match="target"):
                tiny.solve(kind, name)
            continue
        found = tiny.solve(kind, name)
        assert found.value.tolist() == [truth.level.get(node, -1) for node in truth.nodes], seed
        assert found.target.tolist() == [node in truth.end for node in truth.nodes], seed
        bits = np.unpackbits(found.mask, axis=1, count=INPUTS, bitorder="little")
        for node, own in zip(truth.nodes, bits, strict=True):
            assert np.flatnonzero(own).tolist() == truth.good.get(node, []), (seed, node)
        assert {x for x, w in zip(tiny.every, found.winning, strict=True) if w} == truth.starts(), seed
        assert (found.memory, found.late) == ((INPUTS, True) if late else (1, False))
        sizes.add((tiny.n, len(tiny.periodic)))
        solved += 1
        won += any(level > 0 for level in truth.level.values())
    assert won > (0.25 if stay else 0.5) * PROBLEMS
    assert len(sizes) == 6


@pytest.mark.parametrize("seed", range(120))
def test_a_plant_that_remembers_the_class_of_the_input_before(seed):
    rng = np.random.default_rng([seed, 3])
    cells, inputs, kind = (4, 4), 4, rng.integers(0, 2, 4)
    every = list(itertools.product(range(4), range(4)))
    space = Box([0, 0], cells)
    grid = Space(("a", "b"), space, (1,)).grid(space, cells)
    axes, u = ((0, 1), (0, 1)), np.arange(inputs, dtype=float)[:, None]
    meta, _ = table_meta(grid, inputs, axes)
    low = rng.integers(-1, 2, (2, 2, 16, inputs))
    offsets = np.stack([low, low + (rng.random(low.shape) < 0.2)], axis=-1).astype(np.int32)
    boxes = [Abstraction(grid, u, table_post(), meta, np.zeros(1), o.reshape(-1), axes, np.zeros(2)) for o in offsets]
    first, rest = int(rng.integers(inputs)), int(rng.integers(2))
    about = tuple(boxes), Space(("a", "b"), space, (1,)), np.zeros(2), 2
    game = NodeGame(*about, late=True, first=first, kind=kind.astype(np.int64), rest=rest)
    target = rng.random((2, 16, inputs)) < 0.3
    free = rng.random(16) < 0.9

    def after(c, at, p):
        (a, b), (ends, others) = every[at], offsets[c, :, at, p]
        spans = range(a + ends[0], a + ends[1] + 1), range(b + others[0], b + others[1] + 1)
        into = [(i, j % 4) for i, j in itertools.product(*spans)]
        return [every.index(k) for k in into] if all(0 <= i < 4 for i, _ in into) else None

    def choices(node, good):
        c, at, p = node
        to = after(c, at, p)
        return [v for v in range(inputs) if to is not None and all((kind[p], k, v) in good for k in to)]

    nodes = list(np.ndindex(2, 16, inputs))
    level = {n: 0 for n in nodes if target[n] and free[n[1]]}
    inputs_of, steps = {}, 0
    while True:
        steps += 1
        good = set(level)
        new = {n: own for n in nodes if n not in good and free[n[1]] and (own := choices(n, good))}
        if not new:
            break
        level |= dict.fromkeys(new, steps)
        inputs_of |= new
    found = game.reach(np.moveaxis(target, 0, 2).reshape(-1), free)
    assert np.moveaxis(found.value.reshape(16, inputs, 2), 2, 0).reshape(-1).tolist() == [
        level.get(n, -1) for n in nodes
    ]
    rows = np.unpackbits(found.mask, axis=1, count=inputs, bitorder="little").reshape(16, inputs, 2, inputs)
    for c, at, p in nodes:
        assert np.flatnonzero(rows[at, p, c]).tolist() == inputs_of.get((c, at, p), [])
    kept = {n for n in nodes if free[n[1]]}
    while (left := {n for n in kept if choices(n, kept)}) != kept:
        kept = left
    held = game.invariant(free)
    served = np.moveaxis(held.served.reshape(16, inputs, 2), 2, 0)
    assert {tuple(n) for n in np.argwhere(served).tolist()} == kept
    assert held.winning.tolist() == [(rest, k, first) in kept for k in range(16)]
    rows = np.unpackbits(held.mask, axis=1, count=inputs, bitorder="little").reshape(16, inputs, 2, inputs)
    for c, at, p in kept:
        assert np.flatnonzero(rows[at, p, c]).tolist() == choices((c, at, p), kept)
    # A run begins at rest, in the class of rest, whatever input acts first.
    solution = game.reach(target[0, :, 0], free)
    goal = {(c, k, p) for c, k, p in nodes if target[0, k, 0] and free[k]}
    level = dict.fromkeys(goal, 0)
    while new := [n for n in nodes if n not in level and free[n[1]] and choices(n, set(level))]:
        level |= dict.fromkeys(new, 1)
    assert solution.winning.tolist() == [(rest, k, first) in level for k in range(16)]
    assert solution.first == first * 2 + rest
