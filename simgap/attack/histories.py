"""Search for the worst step of a robot that remembers: over the inputs before it and the heading at which they began.

A candidate is a sequence of inputs from rest at a heading. Every step of it is held against the bound in the robot's
own frame, and counts; climbers change one input or the heading at a time, and begin again when nothing is worse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.attack.points import neighbours
from simgap.attack.share import Searched, Step, share

CLIMBERS = 12
PATIENCE = 25  # candidates of one climber without progress before it begins again


@dataclass(frozen=True, eq=False)
class HistoryQuestion:
    """What is asked of a robot.

    Attributes:
        gaps: body-frame gaps (k, 3) of the steps under input numbers (k,) from rest at a heading (rad).
        bounds: of steps with these input numbers (k,) and those before them (k,), -1 at rest: two (k, 3).
        inputs: U, (M, 2); length: inputs before the present one.
        heading: which state the heading is.
    """

    gaps: Callable[[Ints, float], Floats]
    bounds: Callable[[Ints, Ints], tuple[Floats, Floats]]
    inputs: Floats
    length: int
    heading: int = 2


class HistorySearch:
    """A search with a budget; `found` is what it brings home."""

    def __init__(self, question: HistoryQuestion, budget: int, rng: np.random.Generator) -> None:
        self.q, self.budget, self.rng = question, budget, rng
        self.found = Searched()
        self._near = neighbours(question.inputs)
        scale = np.maximum(np.abs(question.inputs).max(axis=0), 1e-300)
        extent = np.abs(question.inputs / scale).sum(axis=1)
        self._extreme = np.flatnonzero(extent >= 0.9 * extent.max())

    def run(self, known: Ints) -> Searched:
        """Spend the budget; `known` (n, length + 1) are sequences that end in a bad step, worst first."""
        queue = [np.asarray(row, np.int64) for row in known]
        climbers = [self._begin(queue) for _ in range(CLIMBERS)]
        while self.found.evaluations < self.budget:
            for climber in climbers:
                if self.found.evaluations >= self.budget:
                    break
                self._move(climber, queue)
        return self.found

    def evaluate(self, sequence: Ints, heading: float, kind: str) -> float:
        """The largest share along a sequence, (k,)."""
        d = self.q.gaps(sequence, heading)
        lo, hi = self.q.bounds(sequence, np.concatenate([[-1], sequence[:-1]]))
        shares = share(d, d, lo, hi)
        u = self.q.inputs[sequence]

        def step(k: int) -> Step:
            x = np.where(np.arange(3) == self.q.heading, heading, 0.0)
            return Step(float(shares[k]), x, u[k], d[k], lo[k], hi[k], u[:k], heading)

        self.found.see(kind, shares, step)
        return float(shares.max())

    def _begin(self, queue: list[Ints]) -> _Climber:
        known = bool(queue)
        sequence = queue.pop(0) if known else self._drawn()
        heading = float(self.rng.uniform(-np.pi, np.pi))
        kind = "worst known histories" if known else "drawn histories"
        return _Climber(sequence, heading, self.evaluate(sequence, heading, kind))

    def _drawn(self) -> Ints:
        """A random sequence, half of its inputs extreme ones."""
        size = self.q.length + 1
        extreme = self.rng.choice(self._extreme, size)
        every = self.rng.integers(0, len(self.q.inputs), size)
        return np.where(self.rng.integers(0, 2, size) == 1, extreme, every).astype(np.int64)

    def _move(self, own: _Climber, queue: list[Ints]) -> None:
        sequence, heading = self._changed(own)
        score = self.evaluate(sequence, heading, "climbing over histories and headings")
        if score > own.score:
            own.sequence, own.heading, own.score, own.tries = sequence, heading, score, 0
            return
        own.tries += 1
        if own.tries > PATIENCE:
            fresh = self._begin(queue)
            own.sequence, own.heading, own.score, own.tries = fresh.sequence, fresh.heading, fresh.score, 0

    def _changed(self, own: _Climber) -> tuple[Ints, float]:
        """One input replaced by a neighbour, any or an extreme one; or all moved on by one; or another heading."""
        sequence, heading, what = own.sequence.copy(), own.heading, int(self.rng.integers(0, 6))
        k = int(self.rng.integers(0, len(sequence)))
        if what <= 1:
            sequence[k] = self.rng.choice(self._near[sequence[k]])
        elif what == 2:
            sequence[k] = self.rng.choice(self._extreme)
        elif what == 3:
            sequence[k] = self.rng.integers(0, len(self.q.inputs))
        elif what == 4:
            sequence = np.append(sequence[1:], self.rng.choice(self._extreme))
        else:
            by = self.rng.standard_normal() * (0.05 if self.rng.integers(0, 2) else 1.0)
            heading = float(np.remainder(heading + by + np.pi, 2.0 * np.pi) - np.pi)
        return sequence, heading


@dataclass
class _Climber:
    sequence: Ints
    heading: float
    score: float
    tries: int = 0
