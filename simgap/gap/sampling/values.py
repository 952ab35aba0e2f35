"""Numbers of N states (rows) and M inputs (columns) that need not be in memory: read some at a time, or made of others.

What goes through all of them takes `blocks`, which depend on the shape alone: sums then have the same bits wherever the
numbers are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.geometry import Grid

Rows = Ints
BLOCK = 2**20
"""Numbers that are looked at together, 8 MiB: of up to so many, sums are those of one array."""


@dataclass(frozen=True, eq=False)
class Values:
    """Numbers (N, M).

    Attributes:
        shape: (N, M). read: rows from one to before another, which may be a view, or by index (k,): -> (n, M).
    """

    shape: tuple[int, int]
    read: Callable[[slice | Rows], Floats]

    def __getitem__(self, rows: slice | Rows) -> Floats:
        return self.read(rows)

    @property
    def size(self) -> int:
        """N M."""
        return self.shape[0] * self.shape[1]

    def whole(self) -> Floats:
        """All of them in memory, (N, M)."""
        return self[0 : self.shape[0]]

    def of_inputs(self, some: slice) -> Floats:
        """Those of some inputs in memory, (N, k)."""
        return np.concatenate([self[block][:, some] for block in self.blocks()])

    def blocks(self, first: int = 0, last: int | None = None) -> Iterator[slice]:
        """Consecutive rows that are looked at together; of all, if no others are named."""
        step, end = max(1, BLOCK // self.shape[1]), self.shape[0] if last is None else last
        for start in range(first, end, step):
            yield slice(start, min(start + step, end))

    def mean(self) -> float:
        """Mean of all."""
        return float(sum(float(self[block].sum()) for block in self.blocks()) / self.size)

    def ends(self) -> tuple[float, float]:
        """The least and the largest."""
        found = [(float(own.min()), float(own.max())) for own in (self[block] for block in self.blocks())]
        return min(lo for lo, _ in found), max(hi for _, hi in found)


@dataclass(frozen=True, eq=False)
class Kept(Values):
    """Numbers that are kept somewhere, and can be written: `put` writes rows (n, M) from a first one on."""

    put: Callable[[int, Floats], None]

    def put_inputs(self, some: slice, columns: Floats) -> None:
        """Write those of some inputs, (N, k)."""
        for block in self.blocks():
            rows = self[block]
            rows[:, some] = columns[block]
            self.put(block.start, rows)


Room = Callable[[tuple[int, int]], Kept]
"""Where so many numbers can be kept."""


def in_memory(shape: tuple[int, int]) -> Kept:
    """Memory for so many numbers."""
    array = np.empty(shape)

    def put(first: int, rows: Floats) -> None:
        array[first : first + len(rows)] = rows

    return Kept(shape, array.__getitem__, put)


def values(given: Values | Floats) -> Values:
    """Values as they are, or an array (N, M) as values."""
    if isinstance(given, Values):
        return given
    array = np.ascontiguousarray(given)
    return Values((array.shape[0], array.shape[1]), array.__getitem__)


def combined(function: Callable[..., Floats], *sources: Values) -> Values:
    """A function of the numbers of `sources` at the same places, such as a difference."""
    return Values(sources[0].shape, lambda rows: function(*(own[rows] for own in sources)))


def largest_of(sources: Sequence[Values]) -> Values:
    """The largest number of all sources at each place."""
    return sources[0] if len(sources) == 1 else combined(lambda *own: np.maximum.reduce(own), *sources)


def of_states(function: Callable[[Floats], Floats], x: Values, inputs: int) -> Values:
    """A function of states x (N, nx), for M inputs: (n, nx) -> (n, M)."""
    return Values((x.shape[0], inputs), lambda rows: function(x[rows]))


def joined(head: Values, more: Floats) -> Values:
    """Values with further rows (E, M) after them."""
    count, width = head.shape

    def read(rows: slice | Rows) -> Floats:
        if isinstance(rows, slice):
            if rows.stop <= count:
                return head[rows]
            further = more[max(0, rows.start - count) : rows.stop - count]
            return np.concatenate([head[rows.start : count], further]) if rows.start < count else further
        found, own = np.empty((len(rows), width)), rows < count
        found[own], found[~own] = head[rows[own]], more[rows[~own] - count]
        return found

    return Values((count + len(more), width), read)


def centres(grid: Grid) -> Values:
    """Cell centres of a grid, (N, nx): computed where they are asked for."""

    def read(rows: slice | Rows) -> Floats:
        index = np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows
        places = np.unravel_index(index, grid.cells)
        return np.stack([grid.axis(j)[k] for j, k in enumerate(places)], axis=-1)

    return Values((grid.size, grid.box.size), read)


def check_numbers(shape: tuple[int, ...], given: dict[str, Floats | None]) -> None:
    """Refuse gap samples of another shape, and such that are not finite.

    Raises:
        UserError: with the shape, or how many are not.
    """
    for name, own in given.items():
        if own is not None and own.shape != shape:
            raise UserError(f"the gap samples {name} have shape {own.shape}, not {shape}")
        if own is not None and not np.isfinite(own).all():
            raise UserError(
                f"{int((~np.isfinite(own)).sum())} gap samples are not finite",
                remedy="A roll-out diverged: lower tau or add sub-steps.",
            )
