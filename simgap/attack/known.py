"""Beginnings of searches over X x U: the worst steps of samples that are there, and the border of X."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.attack.law import REST, class_bounds
from simgap.attack.share import share
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapFunction
from simgap.gap.sampling.points import SEQUENCE, Columns, body_samples, stacked, successors
from simgap.geometry import Box
from simgap.plants.context import Context

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


WORST = 2_000  # states; HISTORIES: sequences
HISTORIES = 200


def worst_steps(context: Context, gap: GapFunction, tables: Sequence[Columns]) -> tuple[Floats, Ints]:
    """States (n, nx) and input numbers (n,) of the worst steps of some tables of roll-outs, worst first."""
    x, u, shares = np.empty((0, len(context.states))), np.empty((0, len(context.inputs))), np.empty(0)
    for table in tables:
        own_x, own_u = stacked(table, context.states), stacked(table, context.inputs)
        ends = [successors(table, name) for name in context.states]
        predicted = context.plant.sampled.step(own_x, own_u)
        least, largest = (np.stack([pair[k] for pair in ends], axis=1) - predicted for k in (0, 1))
        own = share(least, largest, *gap.bounds(own_x, own_u))
        rows = worst_first(context.box, own_x, own, WORST)
        x, u = np.concatenate([x, own_x[rows]]), np.concatenate([u, own_u[rows]])
        shares = np.concatenate([shares, own[rows]])
    order = worst_first(context.box, x, shares, WORST)
    return x[order], numbers(context.input_set, u[order])


def numbers(inputs: Floats, u: Floats) -> Ints:
    """Numbers of inputs of U (M, nu): (n, nu) -> (n,)."""
    return np.argmin(((u[:, None] - inputs[None]) ** 2).sum(axis=2), axis=1).astype(np.int64)


def worst_histories(context: Context, gap: GapFunction, motion: Floats, tables: Sequence[Columns], length: int) -> Ints:
    """Input numbers of the worst steps of random sequences, each with the `length` before it: (n, length + 1).

    A table's rows are steps one after the other, of sequences that begin where the input before is `REST`; one without
    a column `part` holds sequences alone. Steps with less than `length` before them are no beginning.
    """
    sequences, shares = np.empty((0, length + 1), np.int64), np.empty(0)
    for table in tables:
        own = body_samples(context.case, table, SEQUENCE if "part" in table else None)
        if len(own.m) == 0 or not isinstance(gap, BodyFrameGap):
            continue
        d = own.final - motion[own.m]
        found, row = share(d, d, *class_bounds(gap, own.m, own.previous)), np.arange(len(own.m))
        began = np.maximum.accumulate(np.where(own.previous == REST, row, 0))
        late = np.flatnonzero(row - began >= length)
        rows = late[np.argsort(-found[late], kind="stable")[:HISTORIES]]
        sequences = np.concatenate([sequences, own.m[rows[:, None] + np.arange(-length, 1)]])
        shares = np.concatenate([shares, found[rows]])
    return sequences[np.argsort(-shares, kind="stable")[:HISTORIES]]
