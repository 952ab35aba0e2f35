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
from simgap.specifications.reaching import ReachAndStay, ReachAvoid
from tests.specifications.tiny_games import INPUTS, Tiny, inside

PROBLEMS = 250


def solve(tiny, kind, name):
    return kind(kind=name, obstacles=tiny.obstacles, target=tiny.target).solve(tiny.game())


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
                solve(tiny, kind, name)
            continue
        found = solve(tiny, kind, name)
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
