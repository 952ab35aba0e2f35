"""Search for the worst step of a simulator: over states and inputs, and over histories where it remembers.

Over states and inputs climbers move along axes and at random, each with a step of its own that halves when nothing near
is worse, and begin again elsewhere when it is small (a pattern search with restarts: Hooke & Jeeves 1961). Part of the
budget goes to differential evolution (Storn & Price 1997, SciPy), which needs no good place to begin. All work on
batches, so that the cost is that of the simulator.

Of a robot with hidden state a candidate is a sequence of inputs from rest at a heading. Every step of it is compared
with the bound in the robot's own frame, and counts. The search is that of the bound itself (`gap.memory.search`), on
another objective.

What all of them look for is the `share` of a bound's width by which a gap lies outside it; a `SearchRecord` keeps what
they find.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

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
        out = SearchRecord()
        for part in parts:
            out.evaluations += part.evaluations
            out.violations += part.violations
            out.outside += part.outside[: KEPT - len(out.outside)]
            if part.worst is not None and (out.worst is None or part.worst.share > out.worst.share):
                out.worst = part.worst
            out.by.update(part.by)
        return out


CLIMBERS = 64
LARGEST_STEP, SMALLEST_STEP = 0.1, 1e-7  # shares of the width of X
EVOLVED = 0.15  # share of the budget
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


class PointSearch:
    """A search with a budget; `found` is what it brings home."""

    def __init__(self, question: GapProblem, budget: int, rng: np.random.Generator) -> None:
        self.q, self.budget, self.rng = question, budget, rng
        self.found = SearchRecord()
        self.width = question.box.hi - question.box.lo
        self._near = neighbours(question.inputs)
        self._axes = [j for j in range(question.box.size) if j not in question.free]

    @property
    def left(self) -> int:
        """Evaluations left."""
        return self.budget - self.found.evaluations

    def run(self, x: Floats, m: Ints) -> SearchRecord:
        """Spend the budget, beginning at states (n, nx) and inputs (n,) that are known to be bad, worst first."""
        self.evolve(int(EVOLVED * self.budget))
        x, m, shares = self._beginnings(x, m)
        self._climb(x, m, shares)
        return self.found

    def evaluate(self, x: Floats, m: Ints, kind: str) -> Floats:
        """Shares of steps: (n, nx), (n,) -> (n,); those beyond the budget are not taken and count as -inf."""
        count = min(len(x), max(self.left, 0))
        out = np.full(len(x), -np.inf)
        if count == 0:
            return out
        x, m = x[:count], m[:count]
        u = self.q.inputs[m]
        least, largest = self.q.successors(x, u)
        predicted = self.q.step(x, u)
        least, largest = least - predicted, largest - predicted
        lo, hi = self.q.bounds(x, u)
        out[:count] = share(least, largest, lo, hi)

        def step(k: int) -> GapStep:
            d = np.where(largest[k] - hi[k] >= lo[k] - least[k], largest[k], least[k])
            return GapStep(float(out[k]), x[k].copy(), u[k].copy(), d, lo[k].copy(), hi[k].copy())

        self.found.see(kind, out[:count], step)
        return out

    def _beginnings(self, x: Floats, m: Ints) -> tuple[Floats, Ints, Floats]:
        """Known bad steps and all places under all inputs, worst first; no more than a share of the budget."""
        places, count = self.q.places, len(self.q.inputs)
        most, every = int(BEGINNING * self.budget), len(places) * count
        known = min(len(x), max(most // 2, most - every))
        rows = np.sort(self.rng.choice(every, min(every, most - known), replace=False))
        x, m = np.concatenate([x[:known], places[rows // count]]), np.concatenate([m[:known], rows % count])
        shares = self.evaluate(x, m, "worst known steps, border of X, switching surfaces")
        order = np.argsort(-shares, kind="stable")
        return x[order], m[order], shares[order]

    def _climb(self, x: Floats, m: Ints, shares: Floats) -> None:
        """Climbers from these, in order, then from random places."""
        own_x, own_m, own = self._beginners(x, m, shares, CLIMBERS)
        size, taken = np.full(CLIMBERS, LARGEST_STEP), CLIMBERS
        while self.left > 0:
            tried_x, tried_m = self._proposals(own_x, own_m, size)
            tried = self.evaluate(tried_x.reshape(-1, self.q.box.size), tried_m.ravel(), "climbing")
            tried = tried.reshape(CLIMBERS, -1)
            best = np.argmax(tried, axis=1)
            every = np.arange(CLIMBERS)
            better = tried[every, best] > own
            own_x = np.where(better[:, None], tried_x[every, best], own_x)
            own_m, own = np.where(better, tried_m[every, best], own_m), np.where(better, tried[every, best], own)
            size = np.where(better, np.minimum(1.6 * size, LARGEST_STEP), 0.4 * size)
            done = np.flatnonzero(size < SMALLEST_STEP)
            if len(done):
                left = x[taken:], m[taken:], shares[taken:]
                own_x[done], own_m[done], own[done] = self._beginners(*left, len(done))
                size[done], taken = LARGEST_STEP, taken + len(done)

    def _beginners(self, x: Floats, m: Ints, shares: Floats, count: int) -> tuple[Floats, Ints, Floats]:
        """States, inputs and shares of so many climbers: the first of these, and random ones where there are fewer."""
        more_x, more_m = self._random(max(0, count - len(x)))
        more = self.evaluate(more_x, more_m, "climbing")
        places = np.concatenate([x[:count], more_x]), np.concatenate([m[:count], more_m])
        return *places, np.concatenate([shares[:count], more])

    def _proposals(self, x: Floats, m: Ints, size: Floats) -> tuple[Floats, Ints]:
        """Moves both ways along each axis, one at random, to neighbouring inputs, to any input: (P, K, nx), (P, K)."""
        moves, inputs = [], []
        for j in self._axes:
            for sign in (-1.0, 1.0):
                to = x.copy()
                to[:, j] += sign * size * self.width[j]
                moves.append(to)
                inputs.append(m)
        to = x + self.rng.standard_normal(x.shape) * size[:, None] * self.width
        to[:, list(self.q.free)] = x[:, list(self.q.free)]
        moves.append(to)
        inputs.append(m)
        for k in range(self._near.shape[1]):
            moves.append(x)
            inputs.append(self._near[m, k])
        moves.append(x)
        inputs.append(self.rng.integers(0, len(self.q.inputs), len(m)))
        return np.clip(np.stack(moves, axis=1), self.q.box.lo, self.q.box.hi), np.stack(inputs, axis=1)

    def _random(self, count: int) -> tuple[Floats, Ints]:
        x = pinned_to_border(self.q.box, self.rng, count, self.q.free)
        return x, self.rng.integers(0, len(self.q.inputs), count)

    def evolve(self, budget: int) -> None:
        """Differential evolution over X and the number of the input, in one batch a generation."""
        from scipy.optimize import differential_evolution

        box, count = self.q.box, len(self.q.inputs)
        people = 15 * (box.size + 1)
        rounds = budget // people - 1
        if rounds < 1:
            return
        bounds = [*zip(box.lo, box.hi, strict=True), (0, count - 1)]

        def cost(population: Floats) -> Floats:  # (nx + 1, S)
            x, m = np.clip(population[:-1].T, box.lo, box.hi), np.rint(population[-1]).astype(np.int64)
            return -self.evaluate(np.ascontiguousarray(x), np.clip(m, 0, count - 1), "differential evolution")

        differential_evolution(
            cost, bounds, maxiter=rounds, popsize=15, tol=0.0, atol=-1.0, rng=self.rng, polish=False,
            integrality=[False] * box.size + [True], vectorized=True, updating="deferred", init="sobol",
        )  # fmt: skip


def neighbours(inputs: Floats) -> Ints:
    """For each input those nearest to it, two for each component, each component in shares of its range: (M, k)."""
    scale = np.maximum(inputs.max(axis=0) - inputs.min(axis=0), 1e-300)
    count = min(2 * inputs.shape[1], len(inputs) - 1)
    far = (((inputs[:, None] - inputs[None]) / scale) ** 2).sum(axis=2)
    np.fill_diagonal(far, np.inf)
    return np.argsort(far, axis=1, kind="stable")[:, :count].astype(np.int64)


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


def pinned_to_border(box: Box, rng: np.random.Generator, count: int, free: tuple[int, ...] = ()) -> Floats:
    """Random points with each coordinate at an end of X every third time: (count, nx)."""
    x = box.sample(rng, count)
    ends = np.where(rng.integers(0, 2, x.shape) == 1, box.hi, box.lo)
    pinned = rng.integers(0, 3, x.shape) == 0
    pinned[:, list(free)] = False
    return np.where(pinned, ends, x)


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


LINEAGES = 12


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
        rows = late[np.argsort(-found[late], kind="stable")[:WORST_SEQUENCES]]
        sequences = np.concatenate([sequences, own.m[rows[:, None] + np.arange(-length, 1)]])
        shares = np.concatenate([shares, found[rows]])
    return sequences[np.argsort(-shares, kind="stable")[:WORST_SEQUENCES]]
