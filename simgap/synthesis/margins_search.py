"""Compiled search of `margins`: how far the boxes of a cell may grow, input by input, and over all its measurements."""

from __future__ import annotations

from functools import cache
from typing import Any

import numba as nb
import numpy as np

from simgap.model.kept import kept
from simgap.synthesis.frame import cell_box, to_cells
from simgap.synthesis.product import Kernel

LARGEST_FACTOR = 1e4
"""Factors are looked for up to here; a margin that reaches it is at least that."""
RESOLUTION = 2e-3
"""Relative accuracy of a margin, which is rounded down."""


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _fits(shape, n, table, lo, hi, header, work):  # type: ignore[no-untyped-def]
    """Whether the cells in which [lo, hi] can be measured lie in the set; `work` holds 2n numbers."""
    for j in range(n):
        first, last = to_cells(lo[j], hi[j], j, n, header)
        cells = shape[0, j]
        if shape[1, j] == 0:
            if first < 0 or last >= cells:
                return False
        elif last - first >= cells:
            first, last = 0, cells - 1
        else:
            turns = cells * (first // cells)
            first, last = first - turns, last - turns
        work[j], work[n + j] = first, last + 1
    total = 0
    for corner in range(1 << n):
        sign, index = 1, 0
        for j in range(n):
            if corner >> j & 1:
                sign = -sign
                index += work[j] * shape[3, j]
            else:
                index += work[n + j] * shape[3, j]
        total += sign * table[index]
    return total == 0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _grown(shape, n, table, lo, hi, by, size, header, work, spare):  # type: ignore[no-untyped-def]
    """Whether the box still fits when it grows by size * by on both sides, (n,)."""
    for j in range(n):
        spare[j], spare[n + j] = lo[j] - size * by[j], hi[j] + size * by[j]
    return _fits(shape, n, table, spare[:n], spare[n:], header, work)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _largest(shape, n, table, lo, hi, by, best, most, header, work, spare):  # type: ignore[no-untyped-def]
    """Largest size in (best, most] whose box fits, rounded down; `best` if none is larger by the resolution.

    A `best` below 0 says that nothing is known to fit, not even the box itself.
    """
    if best < 0.0:
        if not _fits(shape, n, table, lo, hi, header, work):
            return best
        best = 0.0
    step = max(best * (1.0 + RESOLUTION), most * 1e-9)
    if not _grown(shape, n, table, lo, hi, by, step, header, work, spare):
        return best
    if _grown(shape, n, table, lo, hi, by, most, header, work, spare):
        return most
    low, high = step, most
    while high > low * (1.0 + RESOLUTION):
        middle = np.sqrt(low * high)
        if _grown(shape, n, table, lo, hi, by, middle, header, work, spare):
            low = middle
        else:
            high = middle
    return low


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _of_input(  # type: ignore[no-untyped-def]
    m, q, best, most, boxes, shift, spare, kind, shape, tables, header, work
):  # fmt: skip
    """Largest growth of the box of input m: by gamma's half-widths for q = 0, else along axis q - 1 alone."""
    n = shift.size
    low, high, axis = spare[0], spare[1], spare[2]
    for j in range(n):
        low[j], high[j] = boxes[0, m, j] + shift[j], boxes[1, m, j] + shift[j]
        axis[j] = boxes[2, m, j] if q == 0 else (1.0 if q - 1 == j else 0.0)
    return _largest(shape, n, tables[kind[m]], low, high, axis, best, most, header, work, spare[3])


@nb.njit(cache=True, nogil=True)
def _others(index, reach, wide, wraps, seen, common, rows):  # type: ignore[no-untyped-def]
    """What each measurement of a cell admits beyond what all of them do, into `rows`: how many measurements that is.

    None where some measurement admits no more than that: the largest margin of the common inputs is then the cell's.
    """
    n, total = index.size, 1
    for j in range(n):
        total *= 2 * reach[j] + 1
    for number in range(total):
        rest, flat, stride = number, 0, 1
        for j in range(n - 1, -1, -1):
            off = rest % (2 * reach[j] + 1)
            rest //= 2 * reach[j] + 1
            at = (index[j] + off - reach[j]) % wide[j] if wraps[j] else index[j] + off
            flat += at * stride
            stride *= wide[j]
        some = False
        for b in range(common.size):
            rows[number, b] = seen[flat, b] & ~common[b]
            some |= rows[number, b] != 0
        if not some:
            return 0
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _worst_measurement(  # type: ignore[no-untyped-def]
    rows, found, q, best, most, boxes, shift, spare, kind, shape, tables, header, work, score
):  # fmt: skip
    """The least over measurements of the largest over their inputs, where `best` is that of the common inputs."""
    for m in range(kind.size):
        score[m] = -2.0
    worst = most
    for y in range(found):
        own = best
        for m in range(kind.size):
            if rows[y, m >> 3] >> (m & 7) & 1:
                if score[m] == -2.0:
                    score[m] = _of_input(m, q, best, most, boxes, shift, spare, kind, shape, tables, header, work)
                own = max(own, score[m])
                if own >= worst:
                    break
        worst = min(worst, own)
    return worst


@cache
def searcher(image_of_box: Kernel, gap: Kernel) -> Any:
    """numba: the loop over cells; boxes are computed once for all cells that differ along axes that do not matter."""

    @kept
    def search(  # type: ignore[no-untyped-def]
        cells, rest, strides, free, header, inputs, kind, shape, tables, inside, mask, reach, wide, seen, factor, extra
    ):  # fmt: skip
        n, count = cells.shape[1], inputs.shape[0]
        boxes, box, ranges = np.empty((3, count, n)), np.empty((3, n)), np.empty((2, n))
        work, spare, score = np.empty(2 * n, np.int64), np.empty((4, 2 * n)), np.empty(count)
        liked, index, shift = np.zeros(n + 1, np.int64), np.empty(n, np.int64), np.empty(n)
        window, found = 1, 0
        for j in range(n):
            window *= 2 * reach[j] + 1
        rows = np.empty((window, mask.shape[1]), np.uint8)
        for r in range(cells.shape[0]):
            cell_box(cells[r], n, free, box[0], box[1])
            for m in range(count):
                image_of_box(box[0], box[1], inputs[m], n, boxes[0, m], boxes[1, m], box[2])
                gap(box[0], box[1], inputs[m], ranges[0], ranges[1])
                for j in range(n):
                    boxes[0, m, j] += ranges[0, j]
                    boxes[1, m, j] += ranges[1, j]
                    boxes[2, m, j] = 0.5 * (ranges[1, j] - ranges[0, j])
            for t in range(rest.shape[0]):
                flat = 0
                for j in range(n):
                    index[j] = cells[r, j] + rest[t, j]
                    shift[j] = header[n + j] * rest[t, j]
                    flat += index[j] * strides[j]
                if not inside[flat]:
                    continue
                if window > 1:
                    found = _others(index, reach, wide, shape[1], seen, mask[flat], rows)
                for q in range(n + 1):  # the factor, then each axis alone
                    best = -1.0
                    most = LARGEST_FACTOR - 1.0 if q == 0 else header[n + q - 1] * shape[0, q - 1]
                    for turn in range(-1, count):
                        m = liked[q] if turn < 0 else turn  # what served the last cell best rarely leaves more to find
                        if (turn == liked[q]) or not mask[flat, m >> 3] >> (m & 7) & 1:
                            continue
                        own = _of_input(m, q, best, most, boxes, shift, spare, kind, shape, tables, header, work)
                        if own > best:
                            best, liked[q] = own, m
                        if best >= most:
                            break
                    if found:
                        best = _worst_measurement(
                            rows, found, q, best, most, boxes, shift, spare, kind, shape, tables, header, work, score
                        )
                    if best >= 0.0 and q == 0:
                        factor[flat] = 1.0 + best
                    elif best >= 0.0:
                        extra[flat, q - 1] = best

    return search
