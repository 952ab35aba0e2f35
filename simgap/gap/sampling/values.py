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
    def rows(self, first: int, last: int) -> Floats:
        """Rows from `first` to before `last`, (last - first, M); they may be a view."""

    @abstractmethod
    def take(self, index: Rows) -> Floats:
        """Rows by index: (k,) -> (k, M)."""

    @property
    def size(self) -> int:
        """N M."""
        return self.shape[0] * self.shape[1]

    def whole(self) -> Floats:
        """All of them in memory, (N, M)."""
        return self.rows(0, self.shape[0])

    def blocks(self, first: int = 0, last: int | None = None) -> Iterator[tuple[int, int]]:
        """Ends of consecutive rows that are looked at together; of all, if no others are named."""
        step, end = max(1, BLOCK // self.shape[1]), self.shape[0] if last is None else last
        for start in range(first, end, step):
            yield start, min(start + step, end)

    def mean(self) -> float:
        """Mean of all."""
        return float(sum(float(self.rows(*block).sum()) for block in self.blocks()) / self.size)

    def ends(self) -> tuple[float, float]:
        """The least and the largest."""
        found = [(float(own.min()), float(own.max())) for own in (self.rows(*block) for block in self.blocks())]
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

    def rows(self, first: int, last: int) -> Floats:
        """See `Values`; a view."""
        return self.array[first:last]

    def take(self, index: Rows) -> Floats:
        """See `Values`."""
        return self.array[index]

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

    def rows(self, first: int, last: int) -> Floats:
        """See `Values`."""
        return self.function(*(own.rows(first, last) for own in self.sources))

    def take(self, index: Rows) -> Floats:
        """See `Values`."""
        return self.function(*(own.take(index) for own in self.sources))


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

    def rows(self, first: int, last: int) -> Floats:
        """See `Values`."""
        return self.function(self.x.rows(first, last))

    def take(self, index: Rows) -> Floats:
        """See `Values`."""
        return self.function(self.x.take(index))


@dataclass(frozen=True, eq=False)
class Joined(Values):
    """Values with further rows (E, M) after them."""

    head: Values
    more: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """(N + E, M)."""
        return self.head.shape[0] + len(self.more), self.head.shape[1]

    def rows(self, first: int, last: int) -> Floats:
        """See `Values`."""
        count = self.head.shape[0]
        if last <= count:
            return self.head.rows(first, last)
        further = self.more[max(0, first - count) : last - count]
        return np.concatenate([self.head.rows(first, count), further]) if first < count else further

    def take(self, index: Rows) -> Floats:
        """See `Values`."""
        count, found = self.head.shape[0], np.empty((len(index), self.shape[1]))
        own = index < count
        found[own], found[~own] = self.head.take(index[own]), self.more[index[~own] - count]
        return found


@dataclass(frozen=True, eq=False)
class Centres(Values):
    """Cell centres of a grid, (N, nx): computed where they are asked for."""

    grid: Grid

    @property
    def shape(self) -> tuple[int, int]:
        """(N, nx)."""
        return self.grid.size, self.grid.box.size

    def rows(self, first: int, last: int) -> Floats:
        """See `Values`."""
        return self.take(np.arange(first, last))

    def take(self, index: Rows) -> Floats:
        """See `Values`."""
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
