"""Sets of inputs as packed bits: bit m % 8 of byte m // 8 is input m; words of 64 bits where sets are combined."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.geometry import Box, Grid
from simgap.late import njit

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint64]
Number = TypeVar("Number", bound=np.generic)


LARGEST_TABLES = 1_500_000_000
"""Most bytes of the tables of a game with pending inputs, or of those that margins are looked up in."""


def packed_width(inputs: int) -> int:
    """Bytes that hold one bit per input."""
    return (inputs + 7) // 8


def to_words(mask: Bytes) -> Words:
    """Packed bytes as words: (..., ceil(M / 8)) -> (..., ceil(M / 64)), input m is bit m % 64 of word m // 64."""
    wide = np.zeros((*mask.shape[:-1], 8 * (-(-mask.shape[-1] // 8))), np.uint8)
    wide[..., : mask.shape[-1]] = mask
    return wide.view("<u8").astype(np.uint64, copy=False)


def words_of(flags: Bools) -> Words:
    """Flags of inputs as words: (..., M) -> (..., ceil(M / 64))."""
    return to_words(np.packbits(flags, axis=-1, bitorder="little"))


def to_bytes(words: Words, inputs: int) -> Bytes:
    """Words as packed bytes: (n, words) -> (n, ceil(M / 8))."""
    flat = np.ascontiguousarray(words.astype("<u8", copy=False)).view(np.uint8).reshape(len(words), -1)
    return np.ascontiguousarray(flat[:, : packed_width(inputs)])


def every_input(inputs: int) -> Words:
    """The set of all inputs, (words,)."""
    return words_of(np.ones(inputs, np.bool_))


def margins(grid: Grid, error: Floats) -> tuple[int, ...]:
    """Cells to either side of the measured one in which the true state may be, per axis; error (nx,)."""
    return tuple(int(np.ceil(e / (2.0 * h) + 1e-9)) if e > 0 else 0 for e, h in zip(error, grid.h, strict=True))


def padded(grid: Grid, margin: tuple[int, ...]) -> Grid:
    """The grid with `margin` more cells at both ends of each axis that ends: where its states are measured."""
    width = 2.0 * grid.h
    pad = np.array([0 if j in grid.periodic else m for j, m in enumerate(margin)])
    if not pad.any():
        return grid
    box = Box(grid.box.lo - pad * width, grid.box.hi + pad * width)
    return Grid(box, [c + 2 * int(p) for c, p in zip(grid.cells, pad, strict=True)], grid.periodic)


def embed(values: NDArray[Number], grid: Grid, larger: Grid, outside: Any) -> NDArray[Number]:
    """Rows of the grid's cells (cells, k) in the larger grid's, `outside`, (k,) or one for all, elsewhere."""
    out = np.empty((*larger.cells, values.shape[1]), values.dtype)
    out[...] = outside
    out[inner(grid, larger)] = values.reshape(*grid.cells, -1)
    return out.reshape(larger.size, -1)


def crop(values: NDArray[Number], grid: Grid, larger: Grid) -> NDArray[Number]:
    """Values of the grid's cells among those of the larger one's: (larger cells, ...) -> (cells, ...)."""
    rest = values.shape[1:]
    return np.ascontiguousarray(values.reshape(*larger.cells, *rest)[inner(grid, larger)]).reshape(grid.size, *rest)


def inner(grid: Grid, larger: Grid) -> tuple[slice, ...]:
    """Slices of the larger grid that hold the cells of a grid."""
    return tuple(slice((b - a) // 2, (b - a) // 2 + a) for a, b in zip(grid.cells, larger.cells, strict=True))


def window_and(values: Words, grid: Grid, margin: tuple[int, ...]) -> Words:
    """Bitwise AND over the cells within `margin` of each cell: (cells, k) -> (cells, k). Periodic axes wrap."""
    own = values.reshape(*grid.cells, -1)
    for j, m in enumerate(margin):
        out, cells = own.copy(), grid.cells[j]
        m = min(m, cells)
        for by in (*range(-m, 0), *range(1, m + 1)):
            to, near = np.moveaxis(out, j, 0), np.moveaxis(own, j, 0)
            if j in grid.periodic:
                to &= np.roll(near, by, axis=0)
            else:
                to[max(by, 0) : cells + min(by, 0)] &= near[max(-by, 0) : cells + min(-by, 0)]
        own = out
    return own.reshape(values.shape)


def unpack(mask: Bytes, inputs: int) -> Bools:
    """(..., ceil(M / 8)) -> (..., M)."""
    return np.unpackbits(mask, axis=-1, count=inputs, bitorder="little").view(np.bool_)


def preferred(mask: Bytes, order: Ints) -> NDArray[np.int16]:
    """The first input of `order` that each set holds, -1 for the empty set: (n, bytes), (M,) -> (n,)."""
    out = np.empty(len(mask), np.int16)
    _preferred(mask, order, out)
    return out


@njit(cache=True, nogil=True)
def _preferred(mask, order, out):  # type: ignore[no-untyped-def]
    for i in range(mask.shape[0]):
        out[i] = -1
        for m in order:
            if mask[i, m >> 3] >> (m & 7) & 1:
                out[i] = m
                break
