"""Search for the worst step of a robot with hidden state, over the inputs before it and the heading where they began.

A candidate is a sequence of inputs from rest at a heading. Every step of it is compared with the bound in the robot's
own frame, and counts. The search is that of the bound itself (`gap.memory.search`), on another objective.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.attack.share import GapStep, SearchRecord, share
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapFunction
from simgap.gap.memory.hidden_state import InputGrid
from simgap.gap.memory.search import Histories, directed_search
from simgap.gap.sampling.points import SEQUENCE, Columns, body_samples
from simgap.gap.sampling.samples import motion_of
from simgap.plants.context import Context, pose_axes
from simgap.simulators.base import PathSimulator, Simulator
from simgap.simulators.body_samples import REST, BodySamples

LINEAGES = 12
WORST = 200  # known sequences, the worst of each table of samples


@dataclass(frozen=True, eq=False)
class HistoryProblem:
    """Gap and bound of a robot's steps.

    Attributes:
        gaps: body-frame gaps (k, 3) of the steps under input numbers (k,) from rest at a heading (rad).
        bounds: of steps with these input numbers (k,) and those before them (k,), -1 at rest: two (k, 3).
        inputs: U, (M, 2); length: inputs before the present one.
        heading: which state the heading is.
    """

    gaps: Callable[[Ints, float], Floats]
    bounds: Callable[[Ints, Ints], tuple[Floats, Floats]]
    inputs: Floats
    length: int
    heading: int = 2

    @staticmethod
    def of(context: Context, robot: Simulator, gap: GapFunction, length: int) -> HistoryProblem:
        """Histories of a robot, in its own frame."""
        assert isinstance(robot, PathSimulator)
        assert isinstance(gap, BodyFrameGap)
        motion, pose = motion_of(context), pose_axes(context)

        def gaps(m: Ints, heading: float) -> Floats:
            start = np.zeros(3)
            start[pose[2]] = heading
            paths = robot.chain(start, context.input_set[m])[1]
            return BodySamples.of_paths(m, paths, robot.pose).final - motion[m]

        return HistoryProblem(gaps, gap.bounds_of_inputs, context.input_set, length, pose[2])


def search_histories(question: HistoryProblem, budget: int, rng: np.random.Generator, known: Ints) -> SearchRecord:
    """Spend about `budget` steps, beginning at sequences `known` (n, length + 1) that end in a bad step, worst first.

    Raises:
        UserError: inputs that are not a full grid.
    """
    grid, found, size = InputGrid.of(question.inputs), SearchRecord(), question.length + 1
    sequences = -(-budget // size)
    known = known[: sequences // 2]
    kinds = iter(["worst known histories"] * len(known) + ["drawn histories"] * max(LINEAGES, sequences // 4))
    climbing = "climbing over histories and headings"

    def score(values: Ints, headings: Floats) -> Floats:
        first = found.evaluations == 0
        rows = zip(grid.numbers(values), headings.tolist(), strict=True)
        return np.array(
            [_worst(question, m, at, next(kinds, climbing) if first else climbing, found) for m, at in rows]
        )

    seeds = grid.values(known), rng.uniform(-np.pi, np.pi, len(known))
    directed_search(score, Histories(grid.counts, size), sequences, rng, LINEAGES, seeds)
    return found


def _worst(question: HistoryProblem, m: Ints, heading: float, kind: str, found: SearchRecord) -> float:
    """The largest share along a sequence of input numbers (k,), every step of it noted in `found`."""
    d = question.gaps(m, heading)
    lo, hi = question.bounds(m, np.concatenate([[-1], m[:-1]]))
    shares, u = share(d, d, lo, hi), question.inputs[m]

    def step(k: int) -> GapStep:
        x = np.where(np.arange(3) == question.heading, heading, 0.0)
        return GapStep(float(shares[k]), x, u[k], d[k], lo[k], hi[k], u[:k], heading)

    found.see(kind, shares, step)
    return float(shares.max())


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
        found, row = share(d, d, *gap.bounds_of_inputs(own.m, own.previous)), np.arange(len(own.m))
        began = np.maximum.accumulate(np.where(own.previous == REST, row, 0))
        late = np.flatnonzero(row - began >= length)
        rows = late[np.argsort(-found[late], kind="stable")[:WORST]]
        sequences = np.concatenate([sequences, own.m[rows[:, None] + np.arange(-length, 1)]])
        shares = np.concatenate([shares, found[rows]])
    return sequences[np.argsort(-shares, kind="stable")[:WORST]]
