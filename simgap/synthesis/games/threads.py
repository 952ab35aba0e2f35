"""Rows of a grid shared among threads; the kernels release the interpreter lock and write disjoint rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="synthesis")


def over_rows(work: Callable[[int, int], int], rows: int, threads: int) -> int:
    """Call `work(first, last)` over [0, rows) in chunks and add up what it returns; the sum is order-independent."""
    if threads <= 1 or rows < 2 * threads:
        return work(0, rows)
    chunk = -(-rows // (4 * threads))
    return sum(_pool(threads).map(lambda first: work(first, min(rows, first + chunk)), range(0, rows, chunk)))


def over_items(work: Callable[[T], R], items: Sequence[T], threads: int) -> list[R]:
    """Results of `work(item)` for every item; they must write to different places."""
    return list(map(work, items) if threads <= 1 else _pool(threads).map(work, items))
