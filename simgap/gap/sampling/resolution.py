"""Along which axes a grid of samples has to be fine: from lines of samples through X, one axis at a time.

On a line with many points, what the gap (less the basis) moves from the middle of a cell to elsewhere in it is known
for every number of cells. Summed over the axes it is what a bound loses between its samples, and the cells go where
one more of them takes most of that away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Box

POINTS, LINES = 192, 64
"""Points of a line, and lines along each axis at random places. Judgement: 12,000 roll-outs an axis, a few seconds."""
COUNTS = (4, 6, 8, 12, 16, 24, 32, 48, 96)
"""Cells along an axis that are weighed: each has an even number of points; four are the fewest that a slope takes."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Samples along one axis: x (LINES, POINTS, nx), u (LINES, nu), the points in the middle of as many equal parts."""

    axis: int
    x: Floats
    u: Floats

    @staticmethod
    def random(box: Box, inputs: Floats, axis: int, rng: np.random.Generator) -> Lines:
        """Through random states of the box under random inputs (M, nu)."""
        x = np.repeat(rng.uniform(box.lo, box.hi, (LINES, box.size))[:, None], POINTS, axis=1)
        lo, hi = box.lo[axis], box.hi[axis]
        x[:, :, axis] = lo + (hi - lo) * (np.arange(POINTS) + 0.5) / POINTS
        return Lines(axis, x, inputs[rng.integers(0, len(inputs), LINES)])

    @property
    def rows(self) -> tuple[Floats, Floats]:
        """States (LINES POINTS, nx) and inputs (LINES POINTS, nu)."""
        return self.x.reshape(-1, self.x.shape[2]), np.repeat(self.u, POINTS, axis=0)


def movement(values: Floats) -> dict[int, Floats]:
    """Mean over the cells of the largest distance from the value in the middle: (LINES, POINTS, nx) -> count: (nx,)."""
    found = {}
    for count in COUNTS:
        cells = values.reshape(len(values), count, POINTS // count, -1)
        half = cells.shape[2] // 2
        middle = 0.5 * (cells[:, :, half - 1] + cells[:, :, half])
        found[count] = np.abs(cells - middle[:, :, None]).max(axis=2).mean(axis=(0, 1))
    return found


def at_count(moved: Mapping[int, Floats], count: int) -> Floats:
    """Movement at a count between those of COUNTS, (nx,): linear in its logarithm, the ends held."""
    where = np.log(COUNTS)
    every = np.stack([moved[n] for n in COUNTS])
    return np.array([np.interp(math.log(count), where, own) for own in every.T])


def counts_for(moved: Sequence[Mapping[int, Floats]], weights: Floats, most: int) -> tuple[int, ...]:
    """Cells along each axis, at most `most` in all: greedily where a step up takes most away for its cost.

    Args:
        moved: for each axis, see `movement`. weights: (nx,), of the states, for what is lost to be one number.
    """
    chosen = [COUNTS[0]] * len(moved)
    following = dict(pairwise(COUNTS))
    while True:
        gains = {}
        for j, own in enumerate(moved):
            n = chosen[j]
            if n not in following or math.prod(chosen) // n * following[n] > most:
                continue
            less = float(weights @ (own[n] - own[following[n]]))
            gains[j] = less / math.log(following[n] / n)
        if not gains or max(gains.values()) <= 0.0:
            return _filled(chosen, most)
        best = max(gains, key=gains.__getitem__)
        chosen[best] = following[chosen[best]]


def _filled(counts: Sequence[int], most: int) -> tuple[int, ...]:
    """Counts with the samples that are left, spread evenly over the axes."""
    more = (most / math.prod(counts)) ** (1.0 / len(counts))
    return tuple(int(n * more * (1.0 + 1e-12)) for n in counts)
