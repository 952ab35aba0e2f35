"""Where searches over the gap begin: the worst steps of the samples that made the bound, and of fresh ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.attack.memory import REST, class_bounds
from simgap.attack.seeds import worst_first
from simgap.attack.share import share
from simgap.gap.bounds.function import GapFunction
from simgap.gap.bounds.symmetry import BodyFrameGap
from simgap.gap.sampling.points import Columns
from simgap.gap.sampling.tables import SEQUENCE, body_samples, stacked, successors
from simgap.plants.context import Context

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
    """Which inputs of U (M, nu) these are, (n, nu) -> (n,)."""
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
