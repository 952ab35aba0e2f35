"""Scans of all rows of a scenario program for the most violated ones, block by block."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simgap.gap.values import Rows, Values
from simgap.geometry import Floats


class Most:
    """The largest number of each of some columns so far, and the first row where it stands."""

    def __init__(self, columns: int) -> None:
        self.top, self.at = np.full(columns, -np.inf), np.zeros(columns, dtype=np.int64)

    def update(self, some: Floats, first: int) -> None:
        """Look at further rows (n, columns), which begin with row `first`."""
        at = some.argmax(axis=0)
        top = some[at, np.arange(len(at))]
        better = top > self.top
        self.top[better], self.at[better] = top[better], first + at[better]


def outermost(x: Values) -> Rows:
    """The first rows that are least and largest along each axis, and largest along each diagonal, of states (N, nx)."""
    lo = np.min([x.rows(*block).min(axis=0) for block in x.blocks()], axis=0)
    hi = np.max([x.rows(*block).max(axis=0) for block in x.blocks()], axis=0)
    signs = np.array(np.meshgrid(*([[-1.0, 1.0]] * len(lo)), indexing="ij")).reshape(len(lo), -1)
    signs /= np.where(hi > lo, hi - lo, 1.0)[:, None]
    most = Most(2 * len(lo) + signs.shape[1])
    for first, last in x.blocks():
        own = x.rows(first, last)
        diagonals = np.sum([own[:, [j]] * row for j, row in enumerate(signs)], axis=0)
        most.update(np.concatenate([-own, own, diagonals], axis=1), first)
    return most.at


@dataclass(frozen=True)
class Worst:
    """Violations of rows: the largest for each slice of states and each input, so that they are spread out."""

    slices: tuple[Most, ...]
    most: int

    @property
    def largest(self) -> float:
        """The largest of all."""
        return max(float(own.top.max()) for own in self.slices)

    def rows(self, tolerance: float) -> Rows:
        """Row numbers of the worst ones that are larger than the tolerance, `most` of them at most."""
        inputs = np.arange(len(self.slices[0].at))
        rows = np.concatenate([own.at * len(inputs) + inputs for own in self.slices])
        size = np.concatenate([own.top for own in self.slices])
        order = np.argsort(-size)[: self.most]
        return rows[order][size[order] > tolerance]


@dataclass(frozen=True)
class Scan:
    """By how much rows fall short of their targets, and by how much they exceed eta."""

    short: Worst
    over: Worst

    @property
    def largest(self) -> float:
        """The largest violation of all."""
        return max(self.short.largest, self.over.largest)


def scan(target: Values, product: Values, eta: float | None, most: int) -> Scan:
    """Scan rows `target <= product <= eta`, (N, M), and keep `most` of each kind; without `eta` nothing exceeds it."""
    n, m = target.shape
    slices = min(n, max(1, most // m))
    ends = np.cumsum([0, *(n // slices + (k < n % slices) for k in range(slices))])
    short, over = (tuple(Most(m) for _ in range(slices)) for _ in range(2))
    for k, (start, stop) in enumerate(pairwise(ends.tolist())):
        for first, last in product.blocks(start, stop):
            values = product.rows(first, last)
            short[k].update(target.rows(first, last) - values, first)
            if eta is not None:
                over[k].update(values - eta, first)
    return Scan(Worst(short, most), Worst(over, most))
