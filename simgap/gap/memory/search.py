"""A directed search, and with it one for steps outside the bound of a robot that remembers its inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.json_record import JsonRecord
from simgap.gap.memory.hidden_state import COORDINATES, InputGrid
from simgap.simulators.body_samples import BodySamples, joined
from simgap.statistics import extrapolated_maximum

Points = tuple[Any, ...]
"""Arrays of n rows each: the coordinates of n points."""
Objective = Callable[..., Floats]
"""Coordinates of n points, such as sequences of value numbers (n, L, nu) and headings (n,), rad -> scores (n,).

The search looks for large ones.
"""

TURNS = (1.0, 0.1, 0.01, 1e-3)  # rad: sizes of a change of the heading


@dataclass(frozen=True, eq=False)
class Tried:
    """Points that were tried, with their scores (n,)."""

    points: Points
    scores: Floats

    @staticmethod
    def of(objective: Objective, points: Points) -> Tried:
        """Points that are tried now."""
        return Tried(points, np.asarray(objective(*points), dtype=np.float64))

    def worst(self, count: int | None = None) -> Tried:
        """The first `count` in the order of falling scores, all without it."""
        first = np.argsort(-self.scores, kind="stable")[:count]
        return Tried(tuple(own[first] for own in self.points), self.scores[first])


class SearchSpace(Protocol):
    """Where a directed search looks."""

    @property
    def patience(self) -> int:
        """Rounds without a better score after which a lineage starts anew."""

    def draw(self, n: int, rng: np.random.Generator) -> Points:
        """Random points."""

    @property
    def moved(self) -> Callable[..., Points]:
        """Coordinates of points, `rng` -> as many points near these."""


@dataclass(frozen=True)
class Histories:
    """Search space: L inputs in a row, each a number of a value per axis, and a heading.

    Attributes:
        counts: how many values each input has; length: L; turns: whether the heading is searched or stays 0.
    """

    counts: tuple[int, ...]
    length: int
    turns: bool = True
    patience: int = 12

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Ints, Floats]:
        """Random points, half of their values at an extreme: values (n, L, nu), headings (n,)."""
        values = np.stack([rng.integers(c, size=(n, self.length)) for c in self.counts], axis=-1)
        ends = np.stack([(c - 1) * rng.integers(2, size=(n, self.length)) for c in self.counts], axis=-1)
        values = np.where(rng.random(values.shape) < 0.5, ends, values)
        return values, rng.uniform(-np.pi, np.pi, n) if self.turns else np.zeros(n)

    def moved(self, values: Ints, headings: Floats, *, rng: np.random.Generator) -> tuple[Ints, Floats]:
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
    objective: Objective, space: SearchSpace, budget: int, rng: np.random.Generator, lineages: int = 16,
    seeds: Points | None = None, most: int | None = None,
) -> Tried:  # fmt: skip
    """Search with `budget` evaluations, a quarter of them on the random draw: -> its points, the worst first.

    Args:
        objective: see `Objective`; called with one point per lineage at a time.
        space: where to search.
        budget: most evaluations.
        rng: of draws and moves.
        lineages: how many points are followed side by side.
        seeds: points to begin with, before random ones.
        most: points that are kept and returned, all when None: then memory grows with the budget.
    """
    points = space.draw(max(min(budget, lineages), budget // 4), rng)
    if seeds is not None:
        points = tuple(np.concatenate(pair) for pair in zip(seeds, points, strict=True))
    tried = [Tried.of(objective, tuple(own[:budget] for own in points))]
    here = tried[0].worst(lineages)
    idle, left = np.zeros(len(here.scores), np.int64), budget - len(tried[0].scores)
    while left > 0:
        trial, anew = space.moved(*here.points, rng=rng), idle >= space.patience
        points = _chosen(anew, space.draw(len(idle), rng), trial)
        tried.append(now := Tried.of(objective, tuple(own[:left] for own in points)))
        left -= len(now.scores)
        if len(now.scores) < len(idle):
            break
        better = (now.scores > here.scores) | anew
        here = Tried(_chosen(better, now.points, here.points), np.where(better, now.scores, here.scores))
        idle = np.where(better, 0, idle + 1)
        if most is not None:
            tried = [_joined(tried).worst(most)]
    return _joined(tried).worst(most)


def _joined(tried: Sequence[Tried]) -> Tried:
    every = (np.concatenate(parts) for parts in zip(*(own.points for own in tried), strict=True))
    return Tried(tuple(every), np.concatenate([own.scores for own in tried]))


def _chosen(rows: Bools, these: Points, those: Points) -> Points:
    """Points of the one where `rows` (n,) say so, of the other elsewhere."""
    pairs = zip(these, those, strict=True)
    return tuple(np.where(rows.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs)


SEARCH_LENGTH = 2
"""Inputs before the present one in a search that widens the bound or tries to break it."""
Steps = Callable[[Ints, Floats], BodySamples]
"""Numbers of inputs (n, L) and headings (n,) -> the last step of each."""


@dataclass(frozen=True, eq=False)
class BoundTable:
    """A bound for each class of the previous input and each input, as the search attacks it.

    Attributes:
        classes: of the previous input. motion: (M, 3) nominal step seen from the robot.
        lower, upper: (C, M, 3) of the gap. swept: lower and upper (C, M, 2) of the path.
        pose: which states are x, y and heading.
    """

    classes: PreviousClasses
    motion: Floats
    lower: Floats
    upper: Floats
    swept: tuple[Floats, Floats]
    pose: tuple[int, int, int] = (0, 1, 2)

    def excess(self, samples: BodySamples) -> Floats:
        """Excess of steps over the bound, negative inside: (n, 5), the gap's three dimensions, then the path's two."""
        place = self.classes.after(samples.previous), samples.m
        d = samples.final - self.motion[samples.m]
        low, high = (own[place] for own in self.swept)
        gap = np.maximum(self.lower[place] - d, d - self.upper[place])
        path = np.maximum(low - samples.extent[:, [0, 2]], samples.extent[:, [1, 3]] - high)
        return np.concatenate([gap, path], axis=1)

    @property
    def scale(self) -> Floats:
        """(5,) size of the gap in each dimension, so that excesses of metres and radians can be compared."""
        size = np.maximum(np.abs(self.lower), np.abs(self.upper)).max(axis=(0, 1))
        return np.maximum(np.concatenate([size, size[list(self.pose[:2])]]), 1e-12)


@dataclass(frozen=True, eq=False)
class HistorySearch(JsonRecord):
    """Result of the search.

    Attributes:
        excess: (5,) largest excess of any step tried, 0 if none; margin: (5,) the same, extrapolated.
        evaluations, outside: steps tried, and how many of them lay outside.
        worst: sequences as input numbers, headings and scores of the worst.
    """

    excess: Floats
    margin: Floats
    evaluations: int
    outside: int
    worst: list[dict[str, Any]]


def search(
    table: BoundTable, steps: Steps, inputs: Floats, length: int, budget: int, rng: np.random.Generator
) -> HistorySearch:
    """Attack a bound with `budget` steps, each after `length` inputs from rest, at headings of the search's choice."""
    grid = InputGrid.of(inputs)
    tried: list[BodySamples] = []

    def score(chosen: Ints, headings: Floats) -> Floats:
        tried.append(steps(grid.numbers(chosen), headings))
        return np.asarray((table.excess(tried[-1]) / table.scale).max(axis=1))

    found = directed_search(score, Histories(grid.counts, length + 1), budget, rng)
    excess = table.excess(joined(tried))
    positive = np.maximum(excess, 0.0)
    margin = np.array([extrapolated_maximum(own, COORDINATES) for own in positive.T])
    return HistorySearch(positive.max(axis=0), margin, len(excess), int((excess > 0).any(axis=1).sum()),
                    _worst(found.worst(5), grid))  # fmt: skip


def _worst(found: Tried, grid: InputGrid) -> list[dict[str, Any]]:
    (values, headings), scores = found.points, found.scores.tolist()
    rows = zip(grid.numbers(values), headings.tolist(), scores, strict=True)
    return [{"inputs": grid.inputs[n].tolist(), "heading": heading, "score": score} for n, heading, score in rows]
