"""Where searches over X x U begin: the worst steps that are known, and the border of X."""

from __future__ import annotations

import itertools

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.geometry import Box

BINS = 6  # along each axis of X; known steps of one bin are taken in turns with those of others


def worst_first(box: Box, x: Floats, shares: Floats, count: int) -> Ints:
    """Rows of the `count` worst of some steps, the worst of each part of X before the second worst of any.

    A gap is often worst on one ridge; a search that begins on it alone would not see another.

    Args:
        box: X; x: (n, nx) states; shares: (n,).
    """
    place = np.clip((x - box.lo) / (box.hi - box.lo), 0.0, 1.0 - 1e-12)
    part = np.ravel_multi_index(tuple((place * BINS).astype(np.int64).T), (BINS,) * box.size)
    order = np.lexsort((-shares, part))
    first = np.concatenate([[True], part[order][1:] != part[order][:-1]])
    begins = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order)) - begins
    return np.lexsort((-shares, rank))[:count]


def border(box: Box, free: tuple[int, ...] = (), between: int = 5) -> Floats:
    """Corners, edges, faces and centre of X, with `between` points along what each of them leaves free: (n, nx).

    Axes in `free`, on which nothing depends, stay in the middle.
    """
    levels = [
        np.array([0.5 * (lo + hi)]) if j in free else np.linspace(lo, hi, between + 2)
        for j, (lo, hi) in enumerate(zip(box.lo, box.hi, strict=True))
    ]
    points = np.array(list(itertools.product(*levels)))
    ends = (points == box.lo) | (points == box.hi)
    middle = np.all(points == 0.5 * (box.lo + box.hi), axis=1)
    return points[ends.any(axis=1) | middle]


def pinned_to_border(box: Box, rng: np.random.Generator, count: int, free: tuple[int, ...] = ()) -> Floats:
    """Random points with each coordinate at an end of X every third time: (count, nx)."""
    x = box.sample(rng, count)
    ends = np.where(rng.integers(0, 2, x.shape) == 1, box.hi, box.lo)
    pinned = rng.integers(0, 3, x.shape) == 0
    pinned[:, list(free)] = False
    return np.where(pinned, ends, x)
