"""Every way in which an input takes cells to cells, sorted so that each eroded set is made once and used at once.

Cells that differ along an idle axis share their boxes. A *slab* is all cells of one index along the other axes: rows of
bits (along the bit axis), one below the other along a second idle axis where there is one. A *move* is a slab, a class
and an input: the cells of the slab that the input takes into the winning set are those of another slab of that set,
eroded by the extent of the box and shifted by its lower offset, by whole rows and bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import reduced_cells, reduced_size

MAX_BOXES = 40_000_000


MAX_SHAPE_CELLS = 4_000_000_000  # bits: 500 MB of free cells eroded by swept boxes


@dataclass(frozen=True, eq=False)
class RowSystem:
    """All boxes of an abstraction whose offsets do not depend on the bit axis.

    Attributes:
        count: cells along the bit axis, whose cells share machine words.
        lengths, periodic: (3,) of the other axes, the row axes, padded with 1 and 0 in front; the last one is idle too
            where `slab_rows` is more than 1.
        slab_rows: rows that lie below each other with the same boxes.
        base: (rows,) flat index of a row's first cell; stride: from one cell of a row to the next.
        layer: (rows,) which boxes a row uses.
        rel, extent: (layers, M, 4) int32 lower offsets and sizes of the boxes along the row axes and the bit axis.
        swept, swept_of, swept_shapes: the same for the swept box of each input: (layers, M, 4), which of the sizes
            (k, 4); nothing where it does not matter.
    """

    count: int
    lengths: Ints
    periodic: Ints
    slab_rows: int
    base: Ints
    stride: int
    layer: NDArray[np.int32]
    rel: NDArray[np.int32]
    extent: NDArray[np.int32]
    swept: NDArray[np.int32]
    swept_of: NDArray[np.int32]
    swept_shapes: Ints

    @staticmethod
    def of(abstraction: Abstraction) -> RowSystem | None:
        """The row system, or None where the structure does not allow one or it would not pay."""
        grid, inputs = abstraction.grid, len(abstraction.inputs)
        used = sorted(set().union(*abstraction.axes))
        idle = [j for j in range(grid.box.size) if j not in used and j not in grid.periodic]
        if not idle or reduced_size(grid, tuple(used)) * inputs > min(MAX_BOXES, 4 * grid.size + 1_000_000):
            return None
        bit_axis = max(idle, key=lambda j: grid.cells[j])
        below = max((j for j in idle if j != bit_axis), key=lambda j: grid.cells[j], default=None)
        others = [j for j in range(grid.box.size) if j not in (bit_axis, below)]
        row_axes = (*others, *(() if below is None else (below,)))
        slab_rows = 1 if below is None else grid.cells[below]
        if grid.size // grid.cells[bit_axis] // slab_rows * inputs > MAX_BOXES:
            return None
        rel, extent = _offsets(abstraction, tuple(used), [*row_axes, bit_axis])
        swept, length = rel[:0], extent[:0]
        if abstraction.swept is not None:
            swept, length = _offsets(abstraction.paths(), tuple(used), [*row_axes, bit_axis])
        swept_shapes, swept_of = np.unique(length.reshape(-1, 4), axis=0, return_inverse=True)
        if len(swept_shapes) * grid.size > MAX_SHAPE_CELLS:
            return None
        missing = 3 - len(row_axes)
        lengths = np.array([1] * missing + [grid.cells[j] for j in row_axes])
        strides = np.cumprod([1, *grid.cells[:0:-1]])[::-1]
        index = np.stack(np.unravel_index(np.arange(int(lengths.prod())), tuple(lengths)), axis=-1)[:, missing:]
        layer = np.zeros(len(index), np.int64)
        for j in used:
            layer = layer * grid.cells[j] + index[:, row_axes.index(j)]
        return RowSystem(
            count=grid.cells[bit_axis],
            lengths=lengths,
            periodic=np.array([0] * missing + [int(j in grid.periodic) for j in row_axes]),
            slab_rows=slab_rows,
            base=index @ strides[list(row_axes)],
            stride=int(strides[bit_axis]),
            layer=layer.astype(np.int32),
            rel=rel,
            extent=extent,
            swept=swept,
            swept_of=swept_of.reshape(swept.shape[:2]).astype(np.int32),
            swept_shapes=swept_shapes.astype(np.int64),
        )


def _offsets(abstraction: Abstraction, used: tuple[int, ...], order: list[int]) -> tuple[NDArray[np.int32], ...]:
    """Lower offsets and extents (layers, M, 4) in the given order of axes, padded in front; wide boxes are cut."""
    grid = abstraction.grid
    cells = reduced_cells(grid, used)
    flat = np.ravel_multi_index(tuple(cells.T), grid.cells)
    size, wraps = np.array(grid.cells), np.isin(np.arange(grid.box.size), grid.periodic)
    lower = np.zeros((len(cells), len(abstraction.inputs), 4), np.int32)
    extent = np.ones_like(lower)
    for first in range(0, len(flat), 256):
        block = abstraction.boxes(flat[first : first + 256])
        k = cells[first : first + 256, None, :]
        low, high = (block[:, :, side].astype(np.int64) - k for side in (0, 1))
        turns = np.where(wraps, size * (low // size), 0)
        low, high = low - turns, high - turns
        low, high = np.maximum(low, -2 * size), np.minimum(high, 2 * size)  # beyond any cell of the grid either way
        whole = wraps & (high - low >= size)
        low, high = np.where(whole, 0, low), np.where(whole, size - 1, high)
        lower[first : first + 256, :, -len(order) :] = low[..., order]
        extent[first : first + 256, :, -len(order) :] = (high - low + 1)[..., order]
    return lower, extent


def with_common_sweeps(systems: Sequence[RowSystem]) -> list[RowSystem]:
    """The systems with sizes of swept boxes that are counted through all of them; one alone is as it was."""
    if len(systems) == 1:
        return list(systems)
    own = [s.swept_shapes[s.swept_of] for s in systems]
    shapes, place = np.unique(np.concatenate([o.reshape(-1, 4) for o in own]), axis=0, return_inverse=True)
    each = np.split(place.reshape(-1), np.cumsum([o.size // 4 for o in own])[:-1])
    return [
        replace(s, swept_shapes=shapes, swept_of=p.reshape(s.swept_of.shape).astype(np.int32))
        for s, p in zip(systems, each, strict=True)
    ]


class Moves(NamedTuple):
    """Blocks of jobs of moves: a block is an AND of neighbouring slabs, a job an erosion of it within the slab.

    Attributes:
        lead: (2, 3) how many slabs there are along each of the other axes; which of these axes wrap.
        size: (3,) rows of a slab, words of a row, the widest box in rows.
        block_class, block_at, block_extent: (B,), (B, 3), (B, 3) whose winning set, first slab, slabs along each axis.
        block_jobs: (B + 1,) where its jobs begin.
        job_bits, job_rows: (J,) extent of the box along a row and in rows. job_moves: (J + 1,) where its moves begin.
        to: (V,) class times slabs plus slab that is moved from. rows, words, bits: (V,) the offset: rows; words of a
            flat slab, the rows' included; bits.
        clear_at: (V,) first word of the slab of free cells eroded by the swept box, -1 where nothing is swept;
            clear_rows, clear_words, clear_bits: its offset.
        inputs_from: (V + 1,) where the inputs of a move begin in `inputs`: several may have the same boxes.
    """

    lead: Ints
    size: Ints
    block_class: NDArray[np.int32]
    block_at: NDArray[np.int32]
    block_extent: NDArray[np.int32]
    block_jobs: Ints
    job_bits: NDArray[np.int32]
    job_rows: NDArray[np.int32]
    job_moves: Ints
    to: NDArray[np.int32]
    rows: NDArray[np.int32]
    words: NDArray[np.int32]
    bits: NDArray[np.uint64]
    clear_at: Ints
    clear_rows: NDArray[np.int32]
    clear_words: NDArray[np.int32]
    clear_bits: NDArray[np.uint64]
    inputs_from: Ints
    inputs: NDArray[np.int32]


def words_of_a_row(systems: Sequence[RowSystem]) -> int:
    """Words that hold a row and, behind it, as many empty bits as the farthest shift along a row."""
    count = systems[0].count
    farthest = max(
        (int(np.abs(a[..., 3]).clip(max=count).max(initial=1)) for s in systems for a in (s.rel, s.swept)), default=1
    )
    return (count + farthest + 63) // 64


def moves_of(systems: Sequence[RowSystem], kind: Ints) -> Moves:
    """The moves of all inputs of all classes, of those that stay on the grid.

    Args:
        systems: boxes after a previous input of each class; their `swept_of` counts through common shapes.
        kind: (M,) class of each input.
    """
    first, words = systems[0], words_of_a_row(systems)
    lead, rows = _lead(first), first.slab_rows
    found = [_of_class(c, s, kind, lead, words) for c, s in enumerate(systems)]
    table = {name: np.concatenate([f[name] for f in found]) for name in found[0]}
    return _sorted(table, lead, rows, words)


def _lead(s: RowSystem) -> Ints:
    """Lengths and wrapping of the axes along which slabs lie, (2, 3)."""
    lead = np.stack([s.lengths, s.periodic]).astype(np.int64)
    if s.slab_rows > 1:
        lead[:, 2] = 1, 0
    return lead


def _of_class(c: int, s: RowSystem, kind: Ints, lead: Ints, words: int) -> dict[str, Ints]:
    """Columns of one class's moves, unsorted: slab by slab, input by input."""
    slabs, inputs, n = int(lead[0].prod()), len(kind), s.slab_rows
    layer = s.layer[::n]
    rel, extent = s.rel[layer].astype(np.int64), s.extent[layer].astype(np.int64)
    at = np.stack(np.unravel_index(np.arange(slabs), tuple(lead[0])), axis=-1)[:, None, :]
    start, good = _slab_of(at, rel, lead, n, extent)
    limit = np.array([*lead[0], s.count])
    limit[2] = max(limit[2], n)
    good &= np.all(extent <= limit, axis=2) & (np.abs(rel[..., 3]) < s.count)
    good &= np.abs(rel[..., 2]) < n if n > 1 else True
    below = (extent[..., 2], np.int64(1)) if n > 1 else (np.int64(1), extent[..., 2])  # each other, or slabs
    columns = {
        "class": kind,
        "start": start,
        **dict(zip(("e0", "e1", "e2", "e3"), (extent[..., 0], extent[..., 1], below[1], extent[..., 3]), strict=True)),
        "rows_extent": below[0],
        "to": (c * slabs + np.arange(slabs))[:, None],
        "rows": rel[..., 2] if n > 1 else np.int64(0),
        "bits": rel[..., 3],
        "clear": np.int64(-1),
        "clear_rows": np.int64(0),
        "clear_bits": np.int64(0),
        "input": np.arange(inputs),
    }
    if len(s.swept):
        swept, of = s.swept[layer].astype(np.int64), s.swept_of[layer].astype(np.int64)
        shape = s.swept_shapes[of]
        along, stays = _slab_of(at, swept, lead, n, shape)
        good &= stays & (np.abs(swept[..., 3]) < s.count)
        columns["clear"] = (of * slabs + along) * n * words
        columns["clear_rows"] = swept[..., 2] if n > 1 else np.int64(0)
        columns["clear_bits"] = swept[..., 3]
    return {name: np.broadcast_to(column, (slabs, inputs))[good] for name, column in columns.items()}


def _slab_of(at: Ints, rel: Ints, lead: Ints, rows: int, extent: Ints) -> tuple[Ints, Bools]:
    """Slab in which the box begins, and whether it stays on the axes along which slabs lie."""
    own = rel[..., :3].copy()
    size = extent[..., :3].copy()
    if rows > 1:
        own[..., 2], size[..., 2] = 0, 1
    low = at + own
    good = np.all((lead[1] == 1) | ((low >= 0) & (low + size <= lead[0])), axis=2)
    low %= lead[0]
    return (low[..., 0] * lead[0, 1] + low[..., 1]) * lead[0, 2] + low[..., 2], good


def _sorted(t: dict[str, Ints], lead: Ints, rows: int, words: int) -> Moves:
    """Columns by block, job and place; equal moves of several inputs become one."""
    place = _code(t, ("rows", "bits"))
    clear = _code(t, ("clear", "clear_rows", "clear_bits"))
    block = _code(t, ("start", "class", "e0", "e1", "e2"))  # moves to near slabs stay near each other in memory
    job = _code({"block": block, **t}, ("block", "e3", "rows_extent"))
    order = np.lexsort((t["input"], clear, place, t["to"], job))
    t = {name: column[order] for name, column in t.items()}
    block, job, place, clear = (column[order] for column in (block, job, place, clear))
    new_block, new_job = _new(block), _new(job)
    new_move = new_job | _new(t["to"]) | _new(place) | _new(clear)
    moves, jobs, blocks = (np.flatnonzero(flags) for flags in (new_move, new_job, new_block))
    number, job_number = np.cumsum(new_move) - 1, np.cumsum(new_job) - 1
    one = {name: column[moves] for name, column in t.items()}
    starts = np.stack(np.unravel_index(t["start"][blocks], tuple(lead[0])), axis=-1).reshape(-1, 3)
    return Moves(
        lead=lead,
        size=np.array([rows, words, t["rows_extent"].max(initial=1)], np.int64),
        block_class=t["class"][blocks].astype(np.int32),
        block_at=starts.astype(np.int32),
        block_extent=np.stack([t[f"e{j}"][blocks] for j in range(3)], axis=-1).astype(np.int32),
        block_jobs=np.append(job_number[blocks], len(jobs)),
        job_bits=t["e3"][jobs].astype(np.int32),
        job_rows=t["rows_extent"][jobs].astype(np.int32),
        job_moves=np.append(number[jobs], len(moves)),
        to=one["to"].astype(np.int32),
        rows=one["rows"].astype(np.int32),
        words=(one["rows"] * words + (one["bits"] >> 6)).astype(np.int32),
        bits=(one["bits"] & 63).astype(np.uint64),
        clear_at=one["clear"],
        clear_rows=one["clear_rows"].astype(np.int32),
        clear_words=(one["clear_rows"] * words + (one["clear_bits"] >> 6)).astype(np.int32),
        clear_bits=(one["clear_bits"] & 63).astype(np.uint64),
        inputs_from=np.append(moves, len(order)),
        inputs=t["input"].astype(np.int32),
    )


def _code(t: dict[str, Ints], names: Sequence[str]) -> Ints:
    """One number for several columns that sorts as they do, the first before the others."""
    code = np.zeros(len(t[names[0]]), np.int64)
    largest = 1
    for name in names:
        low, high = int(t[name].min(initial=0)), int(t[name].max(initial=0))
        if largest > 2**62 // (high - low + 1):
            values, code = np.unique(code, return_inverse=True)
            largest = len(values)
        code = code * (high - low + 1) + (t[name] - low)
        largest *= high - low + 1
    return code


def _new(column: Ints) -> Bools:
    """True where a sorted column differs from the entry before."""
    return np.concatenate([np.ones(min(1, len(column)), bool), column[1:] != column[:-1]])
