"""A directed search over histories and headings for steps outside the bound of a robot that remembers its inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.errors import UserError
from simgap.gap.directed_search import Found, Histories, directed_search
from simgap.gap.hidden_state import COORDINATES, extrapolated_maximum
from simgap.gap.previous import PreviousClasses
from simgap.geometry import Floats
from simgap.simulators.body_samples import BodySamples, Ints, joined

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
        """By how much steps lie outside, negative inside: (n, 5), the gap's three dimensions, then the path's two."""
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
class Searched:
    """What the search found.

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

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        own = {"excess": self.excess.tolist(), "margin": self.margin.tolist()}
        return own | {"evaluations": self.evaluations, "outside": self.outside, "worst": self.worst}


def search(
    table: BoundTable, steps: Steps, inputs: Floats, length: int, budget: int, rng: np.random.Generator
) -> Searched:
    """Attack a bound with `budget` steps, each after `length` inputs from rest, at headings of the search's choice."""
    values = [np.unique(inputs[:, j]) for j in range(inputs.shape[1])]
    counts = tuple(len(own) for own in values)
    if len(inputs) != int(np.prod(counts)):
        raise UserError("hidden states need an input set that is a full grid", key="domain.U")
    number = np.zeros(counts, np.int64)
    number[tuple(np.searchsorted(own, inputs[:, j]) for j, own in enumerate(values))] = np.arange(len(inputs))
    tried: list[BodySamples] = []

    def score(chosen: Ints, headings: Floats) -> Floats:
        tried.append(steps(number[tuple(np.moveaxis(chosen, -1, 0))], headings))
        return np.asarray((table.excess(tried[-1]) / table.scale).max(axis=1))

    found = directed_search(score, Histories(counts, length + 1), budget, rng)
    excess = table.excess(joined(tried))
    beyond = np.maximum(excess, 0.0)
    margin = np.array([extrapolated_maximum(own, COORDINATES) for own in beyond.T])
    return Searched(beyond.max(axis=0), margin, len(excess), int((excess > 0).any(axis=1).sum()),
                    _worst(found.worst(5), inputs, number))  # fmt: skip


def _worst(found: Found, inputs: Floats, number: Ints) -> list[dict[str, Any]]:
    numbers = number[tuple(np.moveaxis(found.values, -1, 0))]
    rows = zip(numbers, found.headings.tolist(), found.scores.tolist(), strict=True)
    return [{"inputs": inputs[n].tolist(), "heading": heading, "score": score} for n, heading, score in rows]
