"""Boxes and uniform grids of cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import UserError, excerpt

Number = TypeVar("Number", bound=np.generic)

MOST_CELLS = 2.0**53
"""Along one axis: beyond it doubles do not tell neighbouring cells apart."""


def rows(*groups: tuple[ArrayLike, Sequence[object]]) -> tuple[Floats, ...]:
    """Points that belong together, each list with the names of its columns: -> arrays (n, names), one n for all.

    A single point is one row.

    Raises:
        UserError: no such list, or more points in one than in another.
    """
    found = []
    for points, names in groups:
        try:
            array = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
        except (TypeError, ValueError):
            raise UserError(f"points are rows of numbers, not {excerpt(repr(points), 60)}") from None
        if array.ndim != 2 or array.shape[1] != len(names):
            wanted = f"{len(names)} numbers ({', '.join(map(str, names))})"
            raise UserError(f"points are rows of {wanted}, not an array of shape {np.shape(points)}")
        found.append(array)
    if len({len(own) for own in found}) > 1:
        raise UserError(f"points that belong together are {' and '.join(str(len(own)) for own in found)} in number")
    return tuple(found)


def mesh(*levels: NDArray[Number]) -> NDArray[Number]:
    """All combinations of levels, one array for each axis, those of the last running fastest: -> (n, axes)."""
    return np.stack(np.meshgrid(*levels, indexing="ij"), axis=-1).reshape(-1, len(levels))


def _frozen(values: ArrayLike) -> Floats:
    array = np.array(values, dtype=np.float64, ndmin=1)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Box:
    """The closed box `{x : lo <= x <= hi}` in R^n.

    Raises:
        UserError: if `lo` and `hi` differ in length or the box is upside down.
    """

    lo: Floats
    hi: Floats

    def __init__(self, lo: ArrayLike, hi: ArrayLike) -> None:
        object.__setattr__(self, "lo", _frozen(lo))
        object.__setattr__(self, "hi", _frozen(hi))
        if self.lo.shape != self.hi.shape:
            raise UserError(f"box corners have {self.lo.size} and {self.hi.size} numbers")
        if not np.all(self.lo < self.hi):
            raise UserError(f"box is upside down: lower {self.lo.tolist()}, upper {self.hi.tolist()}")

    @property
    def size(self) -> int:
        """Number of dimensions n."""
        return int(self.lo.size)

    def contains(self, x: Floats) -> Bools:
        """Membership of points: (..., n) -> (...)."""
        return np.all((x >= self.lo) & (x <= self.hi), axis=-1)

    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """n points drawn uniformly: -> (n, dimensions)."""
        return rng.uniform(self.lo, self.hi, size=(n, self.size))


@dataclass(frozen=True, eq=False)
class Grid:
    """A box tiled exactly by `cells[j]` equal cells along axis j; row-major, the last axis runs fastest."""

    box: Box
    cells: tuple[int, ...]
    periodic: tuple[int, ...] = ()

    def __init__(self, box: Box, cells: Sequence[int], periodic: Sequence[int] = ()) -> None:
        object.__setattr__(self, "box", box)
        object.__setattr__(self, "cells", tuple(int(c) for c in cells))
        object.__setattr__(self, "periodic", tuple(int(j) for j in periodic))
        if len(self.cells) != box.size or min(self.cells) < 1:
            raise UserError(f"a grid on {box.size} axes needs as many positive cell counts, not {list(cells)}")

    @staticmethod
    def covering(box: Box, eps: float) -> Grid:
        """The coarsest near-square cells whose half-diagonal is at most `eps` (paper, eq. max_epsilon)."""
        if not eps > 0:
            raise UserError(f"eps must be positive, not {eps}")
        with np.errstate(over="ignore", divide="ignore"):
            counts = np.ceil((box.hi - box.lo) / (2.0 * eps / np.sqrt(box.size)) * (1 - 1e-12))
        if not (counts < MOST_CELLS).all():
            problem = f"cells of radius {eps:g} are too many to count along an axis of X"
            raise UserError(problem, key="grid.eps", remedy="Use a larger radius, or a smaller X")
        return Grid(box, [int(count) for count in counts])

    @cached_property
    def h(self) -> Floats:
        """Half-widths of a cell, (n,)."""
        return _frozen((self.box.hi - self.box.lo) / (2.0 * np.array(self.cells)))

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.cells)

    def axis(self, j: int) -> Floats:
        """Cell centres along axis j, (cells[j],)."""
        return self.box.lo[j] + self.h[j] * (2.0 * np.arange(self.cells[j]) + 1.0)

    def centres(self) -> Floats:
        """All cell centres in row-major order, (size, n)."""
        return mesh(*(self.axis(j) for j in range(self.box.size)))

    def index(self, x: Floats) -> Ints:
        """Flat index of the cell holding each point, -1 outside: (m, n) -> (m,). Periodic axes wrap."""
        counts = np.array(self.cells)
        k = np.floor((x - self.box.lo) / (2.0 * self.h)).astype(np.int64)
        k = np.where((k == counts) & (x <= self.box.hi), counts - 1, k)  # the upper face belongs to the last cell
        for j in self.periodic:
            k[..., j] %= counts[j]
        inside = np.all((k >= 0) & (k < counts), axis=-1)
        flat = np.ravel_multi_index(tuple(np.moveaxis(np.where(inside[..., None], k, 0), -1, 0)), self.cells)
        return np.where(inside, flat, -1).astype(np.int64)

    def finder(self) -> Callable[[Floats], int]:
        """`index` for one point (n,) at a time, without the overhead of arrays; both agree on every bit."""
        lo, hi, width = self.box.lo.tolist(), self.box.hi.tolist(), (2.0 * self.h).tolist()
        axes = [(j, lo[j], hi[j], width[j], self.cells[j], j in self.periodic) for j in range(len(self.cells))]
        floor = math.floor

        def find(x: Floats) -> int:
            flat, values = 0, x.tolist()
            for j, low, high, size, count, wraps in axes:
                value = values[j]
                k = floor((value - low) / size)
                if k == count and value <= high:
                    k -= 1
                if wraps:
                    k %= count
                elif not 0 <= k < count:
                    return -1
                flat = flat * count + k
            return flat

        return find


def nearest_inputs(inputs: Floats, u: Floats) -> Ints:
    """Numbers of the inputs (M, nu) of U that are nearest to u (n, nu): (n,)."""
    return np.argmin(((u[:, None] - inputs[None]) ** 2).sum(axis=2), axis=1).astype(np.int64)


def drawn_in_cells(grid: Grid, cells: Ints, rng: np.random.Generator, corners: tuple[int, ...]) -> Floats:
    """A point of each flat cell (n,): (n, nx). One of four is on a face, one for each of `corners` at a corner.

    `corners` are some of the numbers 0, 1 and 3; with the others a point is inside.
    """
    count, nx = len(cells), grid.box.size
    place, end = rng.uniform(-0.999, 0.999, (count, nx)), 2.0 * rng.integers(0, 2, (count, nx)) - 1.0
    face = np.arange(nx) == rng.integers(0, nx, count)[:, None]
    where = rng.integers(0, 4, count)[:, None]
    return points_of_cells(grid, cells, np.where(np.isin(where, corners) | ((where == 2) & face), end, place))


LARGEST_NUDGE = 16
"""Rounds in which a point on a face is moved into its cell by ever more units in the last place; it takes two."""


def points_of_cells(grid: Grid, cells: Ints, place: Floats) -> Floats:
    """Points of flat cells (n,) at `place` (n, nx) from -1 to 1 along each axis: (n, nx).

    Upper faces belong to the next cell. A point there is moved inward by as little as makes it the cell's own.
    """
    k = np.stack(np.unravel_index(cells, grid.cells), axis=-1)
    centres = grid.box.lo + grid.h * (2.0 * k + 1.0)
    x = np.asarray(centres + grid.h * place)
    unit = np.spacing(np.maximum(np.abs(grid.box.lo), np.abs(grid.box.hi)))  # near 0 x has finer ones than its cell
    for nudge in range(LARGEST_NUDGE):
        astray = (grid.index(x) != cells)[:, None] & (np.abs(place) > 1.0 - 1e-12)
        if not astray.any():
            return x
        x = np.where(astray, x - np.sign(place) * nudge * unit, x)
    raise RuntimeError("a point on the face of a cell cannot be distinguished from the next cell")
