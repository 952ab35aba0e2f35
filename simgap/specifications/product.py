"""The game of a task: the product of the plant's game with a deterministic automaton, never built.

A node of the product is a cell k, what the plant's own game remembers, and the state q of the automaton, which has read
the letter of k. From there an input leads to the cells k' that may follow, and the automaton to step(q, letter of k').
So, for one q, every set of nodes of the product is read as a set of nodes of the plant's game: those that are in the
set once their letter is read. Both operators of the game then solve a state of the automaton at a time.

Buechi (good moves infinitely often): X is the largest set from which a good move into X can be forced; within a round,
a state q is won by way of cells that leave it as it is, until a good move into X or a move into what is won already.
Nodes keep the inputs of the time when they were won, so that every input leads down a rank until the next good move.

Co-Buechi (only finitely many moves that are not good), of an automaton with one state: what can be held in good cells,
what reaches that, and again with what is won in the place of good cells, until nothing is added.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from simgap.arrays import Bools, Ints
from simgap.specifications.base import Game
from simgap.specifications.formula import Automaton
from simgap.specifications.solution import Progress, Solution


def solve(game: Game, automaton: Automaton, letters: Ints, free: Bools) -> Solution:
    """Winning domain and admissible inputs of a task.

    Args:
        game: of the plant, on measured cells.
        automaton: of the task, over `letters` (cells,), the number of each cell's letter.
        free: cells that a run may visit at all, (cells,).
    """
    won = Won(automaton, letters, free)
    last = won.persist(game) if automaton.persists else won.recur(game)
    return won.solution(game, last)


class Won:
    """Nodes that are won in each state of the automaton: their inputs, and by how many steps the next good move comes.

    With `persists`, good cells keep the rank at which they were won: a run stays at it, or goes down.

    Attributes:
        following: (Q, cells) state after the letter of a cell, -1 where the task is broken or the cell is not free.
        good: (Q, cells) whether that move is good.
        rank: for each state (cells, base), -1 where losing; mask: for each state (cells, base, bytes).
    """

    def __init__(self, automaton: Automaton, letters: Ints, free: Bools) -> None:
        self.automaton, self.free = automaton, free
        self.following = np.where(free, automaton.step[:, letters], -1)
        self.good = automaton.good[:, letters] & (self.following >= 0)
        self.seen: dict[int, Bools] = {}
        self.rank: dict[int, Any] = {}
        self.mask: dict[int, Any] = {}
        self.rounds = 0

    def add(self, q: int, found: Solution, where: Bools, rank: int) -> bool:
        """Win nodes of q that are not won yet, (cells, base), with the inputs and above the rank; whether any is."""
        levels = found.value if found.value is not None else np.zeros(len(found.mask), np.int32)
        levels = levels.reshape(len(self.free), -1)
        if q not in self.rank:
            self.rank[q] = np.full(levels.shape, -1, np.int32)
            self.mask[q] = np.zeros((*levels.shape, found.mask.shape[1]), np.uint8)
        new = where & (self.rank[q] < 0)
        self.rank[q][new] = rank + levels[new]
        self.mask[q][new] = found.mask.reshape(self.mask[q].shape)[new]
        return bool(new.any())

    @property
    def highest(self) -> int:
        """The largest rank of all."""
        return max((int(rank.max(initial=0)) for rank in self.rank.values()), default=0)

    def arriving(self, q: int, sets: dict[int, Bools], good: bool) -> Any:
        """Nodes of the plant's game that are in a set of the product after a move from q, (cells, base) or False."""
        out: Any = False
        for to, nodes in sets.items():
            moves = (self.following[q] == to) & (self.good[q] == good) & (good | (to != q))
            if moves.any():
                out = out | (nodes & moves[:, None])
        return out

    def recur(self, game: Game) -> Solution:
        """Good moves infinitely often: the greatest fixed point over rounds; what the game found last."""
        states, done = len(self.following), self.automaton.done
        everywhere = self.free[:, None]
        goals = self._goals(dict.fromkeys(range(states), everywhere))
        while True:
            self.rank, self.mask, self.seen, self.rounds = {}, {}, {}, self.rounds + 1
            last = self._round(game, goals)
            kept = {q: self.rank[q] >= 0 for q in self.rank} | ({done: everywhere} if done >= 0 else {})
            before, goals = goals, self._goals(kept)
            if all(np.all(goals[q] == before[q]) for q in goals):
                return last

    def _goals(self, kept: dict[int, Bools]) -> dict[int, Any]:
        """Nodes at which a good move into the `kept` ones ends, by the state that it leaves."""
        return {q: self.arriving(q, kept, True) for q in self._order()}

    def _round(self, game: Game, goals: dict[int, Any]) -> Solution:
        """Nodes from which a good move into its goals can be forced: the least fixed point over states."""
        done, grows, found = self.automaton.done, True, None
        while grows:
            grows = False
            for q in self._order():
                so_far = {p: self.rank[p] >= 0 for p in self.rank} | ({done: self.free[:, None]} if done >= 0 else {})
                target = goals[q] | self.arriving(q, so_far, False)
                target = np.broadcast_to(target, (len(self.free), 1)) if np.ndim(target) < 2 else target
                if q in self.seen and np.array_equal(self.seen[q], target):
                    continue
                self.seen[q], stays, rank = target, self.following[q] == q, self.highest
                found = game.reach(target.reshape(-1), self.free, stays)
                nodes = self._nodes(found)
                grows |= self.add(q, found, (nodes > 0) & stays[:, None], rank)
                enters = np.any(self.following == q, axis=0) & ~stays
                if enters.any():
                    rank = self.highest
                    into = game.reach((nodes >= 0).reshape(-1), self.free, enters, 1)
                    grows |= self.add(q, into, (self._nodes(into) > 0) & enters[:, None], rank)
        assert found is not None
        return found

    def _nodes(self, found: Solution) -> Any:
        assert found.value is not None
        return found.value.reshape(len(self.free), -1)

    def _order(self) -> Iterator[int]:
        """States that can be left or watched over, the last ones first."""
        return (q for q in reversed(range(len(self.following))) if q != self.automaton.done)

    def persist(self, game: Game) -> Solution:
        """All but finitely many moves good, with one state."""
        grows, free = True, self.following[0] == 0
        home, won = self.good[0], np.zeros((len(free), 1), np.bool_)
        while grows:
            self.rounds += 1
            held = game.invariant((free[:, None] & (home[:, None] | won)).reshape(-1))
            grows = self.add(0, held, held.served.reshape(len(free), -1) & home[:, None], self.highest)
            found = game.reach((self.rank[0] >= 0).reshape(-1), self.free, free)
            nodes = self._nodes(found)
            grows |= self.add(0, found, nodes > 0, self.highest)
            won = self.rank[0] >= 0
            won = won if found.late else np.all(won, axis=1, keepdims=True)
        return found

    def solution(self, game: Game, last: Solution) -> Solution:
        """The solution with the automaton's state remembered: that of before the letter of the present cell."""
        cells, states, done = len(self.free), len(self.following), self.automaton.done
        base = last.memory
        value = np.full((cells, states, base), -1, np.int32)
        mask = np.zeros((cells, states, base, last.mask.shape[1]), np.uint8)
        for p in range(states):
            for q in range(states):
                here = self.following[p] == q
                if q == done:
                    value[here, p] = 0
                elif q in self.rank and here.any():
                    rank = self.rank[q][here]
                    done_now = self.good[p, here, None] & (rank >= 0) & (not self.automaton.persists)
                    value[here, p] = np.where(done_now, 0, rank)
                    mask[here, p] = self.mask[q][here]
        nodes = value.reshape(-1)
        return Solution(
            grid=last.grid,
            winning=game.certain(value[:, 0, last.first] >= 0),
            mask=mask.reshape(len(nodes), -1),
            free=self.free,
            value=nodes,
            target=self._goal(nodes, base),
            memory=states * base,
            statistics={**last.statistics, "steps": int(nodes.max(initial=0)), "states": states, "rounds": self.rounds},
            first=last.first,
            late=last.late,
            kind=last.kind,
            progress=Progress(
                np.maximum(self.following, 0).T.astype(np.int16), base, self.automaton.persists, self.automaton.awaits
            ),
        )

    def _goal(self, value: Any, base: int) -> Any:
        """Nodes at a good move: those of value 0; where the task is to stay in good cells, all that are won there."""
        home = np.repeat(self.good[0], base)
        return (value >= 0) & home if self.automaton.persists else value == 0
