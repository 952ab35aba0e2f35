"""Numbers of N states (rows) and M inputs (columns) that need not be in memory: read some at a time, or made of others.

What goes through all of them takes `blocks`, which depend on the shape alone: sums then have the same bits wherever the
numbers are kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.geometry import Grid

Rows = Ints
BLOCK = 2**20
"""Numbers that are looked at together, 8 MiB: of up to so many, sums are those of one array."""


class Values(ABC):
    """Numbers (N, M)."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """(N, M)."""

    @abstractmethod
    def __getitem__(self, rows: slice | Rows) -> Floats:
        """Rows from one to before another, which may be a view, or by index (k,): -> (n, M)."""

    @property
    def size(self) -> int:
        """N M."""
        return self.shape[0] * self.shape[1]

    def whole(self) -> Floats:
        """All of them in memory, (N, M)."""
        return self[0 : self.shape[0]]

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


class Kept(Values):
    """Numbers that are kept somewhere, and can be written."""

    @abstractmethod
    def put(self, first: int, rows: Floats) -> None:
        """Write rows (n, M) from `first` on."""


Room = Callable[[tuple[int, int]], Kept]
"""Where so many numbers can be kept."""


@dataclass(frozen=True, eq=False)
class Held(Kept):
    """Numbers in memory."""

    array: Floats

    @staticmethod
    def room(shape: tuple[int, int]) -> Held:
        """Memory for so many numbers."""
        return Held(np.empty(shape))

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return len(self.array), self.array.shape[1]

    def __getitem__(self, rows: slice | Rows) -> Floats:
        return self.array[rows]

    def put(self, first: int, rows: Floats) -> None:
        """See `Kept`."""
        self.array[first : first + len(rows)] = rows


def values(given: Values | Floats) -> Values:
    """Values as they are, or an array (N, M) as values."""
    return given if isinstance(given, Values) else Held(np.ascontiguousarray(given))


@dataclass(frozen=True, eq=False)
class Combined(Values):
    """A function of the numbers of `sources` at the same places, such as a difference."""

    function: Callable[..., Floats]
    sources: tuple[Values, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return self.sources[0].shape

    def __getitem__(self, rows: slice | Rows) -> Floats:
        return self.function(*(own[rows] for own in self.sources))


def largest_of(sources: tuple[Values, ...]) -> Values:
    """The largest number of all sources at each place."""
    return sources[0] if len(sources) == 1 else Combined(lambda *own: np.maximum.reduce(own), sources)


@dataclass(frozen=True, eq=False)
class OfStates(Values):
    """A function of states x (N, nx), for M inputs: (n, nx) -> (n, M)."""

    function: Callable[[Floats], Floats]
    x: Values
    inputs: int

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return self.x.shape[0], self.inputs

    def __getitem__(self, rows: slice | Rows) -> Floats:
        return self.function(self.x[rows])


@dataclass(frozen=True, eq=False)
class Joined(Values):
    """Values with further rows (E, M) after them."""

    head: Values
    more: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """(N + E, M)."""
        return self.head.shape[0] + len(self.more), self.head.shape[1]

    def __getitem__(self, rows: slice | Rows) -> Floats:
        count = self.head.shape[0]
        if isinstance(rows, slice):
            if rows.stop <= count:
                return self.head[rows]
            further = self.more[max(0, rows.start - count) : rows.stop - count]
            return np.concatenate([self.head[rows.start : count], further]) if rows.start < count else further
        found, own = np.empty((len(rows), self.shape[1])), rows < count
        found[own], found[~own] = self.head[rows[own]], self.more[rows[~own] - count]
        return found


@dataclass(frozen=True, eq=False)
class Centres(Values):
    """Cell centres of a grid, (N, nx): computed where they are asked for."""

    grid: Grid

    @property
    def shape(self) -> tuple[int, int]:
        """(N, nx)."""
        return self.grid.size, self.grid.box.size

    def __getitem__(self, rows: slice | Rows) -> Floats:
        index = np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows
        places = np.unravel_index(index, self.grid.cells)
        return np.stack([self.grid.axis(j)[k] for j, k in enumerate(places)], axis=-1)


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
