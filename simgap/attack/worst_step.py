"""Search for the worst step of a simulator: over states and inputs, and over histories where it remembers.

Both are the directed search of the bound itself (`gap.memory.search`): points are followed side by side, a changed one
is kept where it is worse, and what finds nothing worse for long begins anew. Over states and inputs a change is a step
along an axis or in all of them, from a tenth of X to a ten-millionth of it, or another input.

Of a robot with hidden state a candidate is a sequence of inputs from rest at a heading. Every step of it is compared
with the bound in the robot's own frame, and counts.

What all of them look for is the `share` of a bound's width by which a gap lies outside it; a `SearchRecord` keeps what
they find.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapFunction
from simgap.gap.memory.hidden_state import InputGrid
from simgap.gap.memory.search import Histories, directed_search
from simgap.gap.sampling.borders import critical_points, switching_surfaces
from simgap.gap.sampling.points import SEQUENCE, Columns, body_samples, gap_ends
from simgap.gap.sampling.samples import motion_of
from simgap.geometry import Box, nearest_inputs
from simgap.plants.context import Context, pose_axes
from simgap.simulators.base import PathSimulator, Simulator
from simgap.simulators.body_samples import REST, BodySamples

KEPT = 10  # witnesses of one search
_NARROW = 1e-300


def share(least: Floats, largest: Floats, lo: Floats, hi: Floats) -> Floats:
    """Distance of a gap beyond its bound, in widths of the bound: max_i max(d_i - hi_i, lo_i - d_i) / (hi_i - lo_i).

    -0.5 in the middle of the bound, 0 on it, positive outside; a gap that is no number counts as outside.

    Args:
        least, largest: (n, nx) range of the gap, equal where it is one number. lo, hi: (n, nx) its bounds.
    """
    excess = np.maximum(largest - hi, lo - least)
    relative = (excess / np.maximum(hi - lo, _NARROW)).max(axis=1)
    return np.where(np.isnan(relative), np.inf, relative)


@dataclass(frozen=True, eq=False)
class GapStep:
    """One step that the gap's bound was checked against.

    Attributes:
        share: see `share`; x, u: (nx,), (nu,); d, lo, hi: (nx,) gap and bound, of a robot in its own frame.
        history: (k, nu) inputs before it from rest, and heading (rad) there, where the simulator remembers them.
    """

    share: float
    x: Floats
    u: Floats
    d: Floats
    lo: Floats
    hi: Floats
    history: Floats | None = None
    heading: float | None = None


@dataclass
class SearchRecord:
    """Record of a search over the gap.

    Attributes:
        evaluations: steps of the simulator that were checked against the bound; violations: those outside.
        worst: the worst step; outside: the first few that lie outside, in the order in which they were found.
        by: evaluations of each kind of search.
    """

    evaluations: int = 0
    violations: int = 0
    worst: GapStep | None = None
    outside: list[GapStep] = field(default_factory=list)
    by: Counter[str] = field(default_factory=Counter)

    def see(self, kind: str, shares: Floats, step: Callable[[int], GapStep]) -> None:
        """Take note of evaluations, (n,) shares; `step(k)` describes the k-th."""
        self.evaluations += len(shares)
        self.by[kind] += len(shares)
        bad = np.flatnonzero(shares > 0.0)
        self.violations += len(bad)
        self.outside += [step(int(k)) for k in bad[: KEPT - len(self.outside)]]
        if len(shares):
            best = int(np.argmax(shares))
            if self.worst is None or shares[best] > self.worst.share:
                self.worst = step(best)

    @staticmethod
    def joined(parts: Sequence[SearchRecord]) -> SearchRecord:
        """Searches side by side."""
        evaluations, violations = (sum(getattr(p, n) for p in parts) for n in ("evaluations", "violations"))
        worst = max((p.worst for p in parts if p.worst is not None), key=lambda step: step.share, default=None)
        outside = [step for p in parts for step in p.outside][:KEPT]
        return SearchRecord(evaluations, violations, worst, outside, sum((p.by for p in parts), Counter[str]()))


LINEAGES, HISTORIES = 64, 12
"""Points that are followed side by side: of states and inputs, and of histories."""
DECADES = 0.1, 6.0
"""Largest step of a state, as a share of the width of X, and over how many powers of ten steps are drawn below it."""
TOGETHER = 65_536  # evaluations at once, so that memory does not grow with the budget
BEGINNING = 0.3  # most of the budget that goes to looking at the places to begin
BINS = 6  # along each axis of X; known steps of one bin are taken in turns with those of others
WORST, WORST_SEQUENCES = 2_000, 200  # known steps, and sequences of them: the worst of each table of samples
MOST_PLACES = 2_000  # states on the border of X and beside switching surfaces; a finer lattice is thinned


@dataclass(frozen=True, eq=False)
class GapProblem:
    """Gap, bound and domain of a simulator.

    Attributes:
        successors: least and largest successors of states (n, nx) under inputs (n, nu), two (n, nx); equal if there is
            one.
        step: the nominal map. bounds: of the gap, (n, nx), (n, nu) -> two (n, nx).
        box: X; inputs: U, (M, nu); free: axes on which nothing depends.
        places: (n, nx) states to look at under every input, such as those of `critical_points`.
    """

    successors: Callable[[Floats, Floats], tuple[Floats, Floats]]
    step: Callable[[Floats, Floats], Floats]
    bounds: Callable[[Floats, Floats], tuple[Floats, Floats]]
    box: Box
    inputs: Floats
    places: Floats
    free: tuple[int, ...] = ()

    @staticmethod
    def of(context: Context, simulator: Simulator, gap: GapFunction) -> GapProblem:
        """Search for a simulator that is a function of state and input, or a range of it where commands are late."""
        step, domain = context.plant.sampled.step, gap.domain
        places = critical_points(domain, switching_surfaces(context), most=MOST_PLACES).x
        return GapProblem(simulator.spread, step, gap.bounds, context.box, context.input_set, places, domain.free)

    def look(self, x: Floats, m: Ints, kind: str, found: SearchRecord) -> Floats:
        """Shares of steps from states (n, nx) under inputs (n,), noted in `found`: -> (n,)."""
        u = self.inputs[m]
        predicted, (lo, hi) = self.step(x, u), self.bounds(x, u)
        least, largest = (own - predicted for own in self.successors(x, u))
        shares = share(least, largest, lo, hi)

        def step(k: int) -> GapStep:
            d = np.where(largest[k] - hi[k] >= lo[k] - least[k], largest[k], least[k])
            return GapStep(float(shares[k]), x[k].copy(), u[k].copy(), d, lo[k].copy(), hi[k].copy())

        found.see(kind, shares, step)
        return shares


@dataclass(frozen=True, eq=False)
class StatesAndInputs:
    """Search space X x U: states, and the number of an input."""

    box: Box
    inputs: Floats
    free: tuple[int, ...] = ()
    patience: int = 60

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Floats, Ints]:
        """Random points, each coordinate at an end of X every third time: (n, nx), (n,)."""
        x = self.box.sample(rng, n)
        ends = np.where(rng.integers(0, 2, x.shape) == 1, self.box.hi, self.box.lo)
        pinned = rng.integers(0, 3, x.shape) == 0
        pinned[:, list(self.free)] = False
        return np.where(pinned, ends, x), rng.integers(0, len(self.inputs), n)

    def moved(self, x: Floats, m: Ints, *, rng: np.random.Generator) -> tuple[Floats, Ints]:
        """The same points, each moved along an axis, along all of them, or with another input, (n, nx), (n,)."""
        n, nx = x.shape
        largest, decades = DECADES
        size = largest * 10.0 ** -rng.uniform(0.0, decades, (n, 1)) * (self.box.hi - self.box.lo)
        kind = rng.integers(0, 3, n)
        along = (kind == 1)[:, None] | ((kind == 0)[:, None] & (rng.integers(0, nx, (n, 1)) == np.arange(nx)))
        along[:, list(self.free)] = False
        x = np.clip(x + np.where(along, size * rng.standard_normal(x.shape), 0.0), self.box.lo, self.box.hi)
        near = self._near[m, rng.integers(0, self._near.shape[1], n)]
        other = np.where(rng.integers(0, 2, n) == 0, near, rng.integers(0, len(self.inputs), n))
        return x, np.where(kind == 2, other, m)

    @cached_property
    def _near(self) -> Ints:
        """For each input those nearest to it, two for each component in shares of its range, or itself: (M, k)."""
        scale = np.maximum(np.ptp(self.inputs, axis=0), 1e-300)
        far = (((self.inputs[:, None] - self.inputs[None]) / scale) ** 2).sum(axis=2)
        return np.argsort(far, axis=1, kind="stable")[:, : 1 + 2 * self.inputs.shape[1]].astype(np.int64)


def search_points(question: GapProblem, budget: int, rng: np.random.Generator, x: Floats, m: Ints) -> SearchRecord:
    """Spend the budget, beginning at states (n, nx) and inputs (n,) that are known to be bad, worst first."""
    q, found = question, SearchRecord()
    kinds = iter(["worst known steps, border of X, switching surfaces, drawn steps"])

    def score(x: Floats, m: Ints) -> Floats:
        kind, pieces = next(kinds, "climbing"), (slice(k, k + TOGETHER) for k in range(0, len(x), TOGETHER))
        return np.concatenate([q.look(x[piece], m[piece], kind, found) for piece in pieces])

    places, count = q.places, len(q.inputs)
    most, every = int(BEGINNING * budget), len(places) * count
    known = min(len(x), max(most // 2, most - every))
    rows = np.sort(rng.choice(every, min(every, most - known), replace=False))
    seeds = np.concatenate([x[:known], places[rows // count]]), np.concatenate([m[:known], rows % count])
    directed_search(score, StatesAndInputs(q.box, q.inputs, q.free), budget, rng, LINEAGES, seeds, most=0)
    return found


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


def worst_steps(context: Context, gap: GapFunction, tables: Sequence[Columns]) -> tuple[Floats, Ints]:
    """States (n, nx) and input numbers (n,) of the worst steps of some tables of roll-outs, worst first."""
    found = []
    for table in tables:
        own_x, own_u, least, largest = gap_ends(context.plant.sampled.step, table, context.states, context.inputs)
        own = share(least, largest, *gap.bounds(own_x, own_u))
        rows = worst_first(context.box, own_x, own, WORST)
        found.append((own_x[rows], own_u[rows], own[rows]))
    x, u, shares = (np.concatenate(part) for part in zip(*found, strict=True))
    order = worst_first(context.box, x, shares, WORST)
    return x[order], nearest_inputs(context.input_set, u[order])


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
    kinds = iter(["worst known histories"] * len(known) + ["drawn histories"] * max(HISTORIES, sequences // 4))
    climbing = "climbing over histories and headings"

    def score(values: Ints, headings: Floats) -> Floats:
        first = found.evaluations == 0
        rows = zip(grid.numbers(values), headings.tolist(), strict=True)
        return np.array(
            [_worst(question, m, at, next(kinds, climbing) if first else climbing, found) for m, at in rows]
        )

    seeds = grid.values(known), rng.uniform(-np.pi, np.pi, len(known))
    directed_search(score, Histories(grid.counts, size), sequences, rng, HISTORIES, seeds)
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
        rows = late[np.argsort(-found[late], kind="stable")[:WORST_SEQUENCES]]
        sequences = np.concatenate([sequences, own.m[rows[:, None] + np.arange(-length, 1)]])
        shares = np.concatenate([shares, found[rows]])
    return sequences[np.argsort(-shares, kind="stable")[:WORST_SEQUENCES]]
