"""Rows of a grid shared among threads; the kernels release the interpreter lock and write disjoint rows."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def over_rows(work: Callable[[int, int], int], rows: int, threads: int, chunk: int = 0) -> int:
    """Call `work(first, last)` over [0, rows) in chunks and add up what it returns; the result is order-independent."""
    if threads <= 1 or rows < 2 * threads:
        return work(0, rows)
    chunk = chunk or max(1, rows // (8 * threads))
    starts = range(0, rows, chunk)
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(lambda first: work(first, min(rows, first + chunk)), starts))
