"""Directed search for the worst sequence of inputs and heading: an adversary with a budget, without gradients.

Random histories are no test of a bound: what breaks it needs several inputs in a row at the right values. From the
worst of a random draw each lineage changes one coordinate at a time (one input of one sample to a neighbouring value,
to an extreme or to any other, or the heading by steps of several sizes) and keeps what scores higher; one that stands
still starts anew from a random point. What it finds is a lower bound of the supremum, so a bound that it cannot break
is not thereby proven.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.geometry import Floats

Ints = NDArray[np.int64]
Objective = Callable[[Ints, Floats], Floats]
"""Sequences of value numbers (n, L, nu) and headings (n,), rad -> scores (n,); the search looks for large ones."""

TURNS = (1.0, 0.1, 0.01, 1e-3)  # rad: sizes of a change of the heading
PATIENCE = 12  # rounds without a better score after which a lineage starts anew


@dataclass(frozen=True, eq=False)
class Found:
    """Every sequence that was tried, the worst first.

    Attributes:
        values: (n, L, nu) value numbers. headings: (n,) rad. scores: (n,), falling.
    """

    values: Ints
    headings: Floats
    scores: Floats

    @property
    def evaluations(self) -> int:
        """How many sequences were tried."""
        return len(self.scores)

    def worst(self, count: int) -> Found:
        """The first `count`."""
        return Found(self.values[:count], self.headings[:count], self.scores[:count])


@dataclass(frozen=True)
class Histories:
    """Where to search: L inputs in a row, each a number of a value per axis, and a heading.

    Attributes:
        counts: how many values each input has; length: L; turns: whether the heading is searched or stays 0.
    """

    counts: tuple[int, ...]
    length: int
    turns: bool = True

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Ints, Floats]:
        """Random points, half of their values at an extreme: values (n, L, nu), headings (n,)."""
        values = np.stack([rng.integers(c, size=(n, self.length)) for c in self.counts], axis=-1)
        ends = np.stack([(c - 1) * rng.integers(2, size=(n, self.length)) for c in self.counts], axis=-1)
        values = np.where(rng.random(values.shape) < 0.5, ends, values)
        return values, rng.uniform(-np.pi, np.pi, n) if self.turns else np.zeros(n)

    def moved(self, values: Ints, headings: Floats, rng: np.random.Generator) -> tuple[Ints, Floats]:
        """The same points, each with one coordinate changed: (n, L, nu), (n,) -> the same shapes."""
        values, headings = values.copy(), headings.copy()
        coordinates = self.length * len(self.counts) + self.turns
        for k, c in enumerate(rng.integers(coordinates, size=len(values))):
            if c == self.length * len(self.counts):
                headings[k] += rng.normal() * TURNS[rng.integers(len(TURNS))]
                continue
            sample, axis = divmod(int(c), len(self.counts))
            values[k, sample, axis] = _other(int(values[k, sample, axis]), self.counts[axis], rng)
        return values, np.remainder(headings + np.pi, 2.0 * np.pi) - np.pi


def _other(value: int, count: int, rng: np.random.Generator) -> int:
    """Another value number below `count`: a neighbour, an extreme, or any."""
    kind = rng.integers(3)
    if kind == 0:
        return int(np.clip(value + rng.choice([-1, 1]), 0, count - 1))
    return int((count - 1) * rng.integers(2) if kind == 1 else rng.integers(count))


def directed_search(
    objective: Objective, space: Histories, budget: int, rng: np.random.Generator, lineages: int = 16,
    seeds: tuple[Ints, Floats] | None = None,
) -> Found:  # fmt: skip
    """Search with `budget` evaluations, a quarter of them on the random draw.

    Args:
        objective: see `Objective`; called with one point per lineage at a time.
        space: where to search.
        budget: most evaluations.
        rng: of draws and moves.
        lineages: how many points are followed side by side.
        seeds: points to begin with, values (n, L, nu) and headings (n,), before random ones.
    """
    values, headings = space.draw(max(min(budget, lineages), budget // 4), rng)
    if seeds is not None:
        values, headings = np.concatenate([seeds[0], values]), np.concatenate([seeds[1], headings])
    values, headings = values[:budget], headings[:budget]
    tried = [Found(values, headings, np.asarray(objective(values, headings), dtype=np.float64))]
    first = np.argsort(-tried[0].scores, kind="stable")[:lineages]
    here = Found(values[first], headings[first], tried[0].scores[first])
    idle, left = np.zeros(len(first), np.int64), budget - len(values)
    while left > 0:
        trial = space.moved(here.values, here.headings, rng)
        anew = idle >= PATIENCE
        drawn = space.draw(len(idle), rng)
        values = np.where(anew[:, None, None], drawn[0], trial[0])[:left]
        headings = np.where(anew, drawn[1], trial[1])[:left]
        scores = np.asarray(objective(values, headings), dtype=np.float64)
        tried.append(Found(values, headings, scores))
        left -= len(values)
        if len(values) < len(idle):
            break
        better = (scores > here.scores) | anew
        here = Found(
            np.where(better[:, None, None], values, here.values),
            np.where(better, headings, here.headings),
            np.where(better, scores, here.scores),
        )
        idle = np.where(better, 0, idle + 1)
    return _sorted(tried)


def _sorted(tried: list[Found]) -> Found:
    values, headings = np.concatenate([f.values for f in tried]), np.concatenate([f.headings for f in tried])
    scores = np.concatenate([f.scores for f in tried])
    order = np.argsort(-scores, kind="stable")
    return Found(values[order], headings[order], scores[order])
