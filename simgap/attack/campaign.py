"""All closed-loop attacks on one plant: every rule in turn from the worst starts, each run judged.

A rule picks one of the admissible inputs, the worst in some sense: it gives every input a number and the largest is
taken; equal ones are told apart at random. The plants are a simulator's, or the model with its disturbance. The starts
are those that are won most narrowly, and a greedy adversary steers towards losing cells (`Danger`).

At every sample the adversary takes any corner of the error box (or its middle) as the measurement, and any input that
the controller admits there. If the controller has no input at one of these measurements, and is not at its end there,
the promise is broken already.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.attack.worst_step import KEPT, share
from simgap.closed_loop import BEYOND, Judge, Record, split_by_run
from simgap.gap.bounds.function import GapFunction
from simgap.gap.json_record import JsonRecord
from simgap.geometry import Grid, drawn_in_cells
from simgap.plants.context import Context
from simgap.simulators.base import Simulator
from simgap.specifications.base import Monitor, Run, specification_of
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.input_sets import unpack


@dataclass(frozen=True, eq=False)
class Options:
    """Choices of the adversary at one sample of n runs.

    Attributes:
        inputs: (n, M) admissible at some measurement. corner: (n, M) which measurement, the first that admits it.
        stuck: (n,) corner without an input that is not the end, -1 where there is none.
        ended: (n,) corner at which the run is over, -1 where there is none.
    """

    inputs: Bools
    corner: Ints
    stuck: Ints
    ended: Ints


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A solution with the error of what is measured, (nx,)."""

    solution: Solution
    inputs: Floats
    error: Floats

    @cached_property
    def corners(self) -> Floats:
        """The middle and the corners of the error box, (c, nx)."""
        signs = [(-1.0, 1.0) if e > 0 else (0.0,) for e in self.error]
        corners = np.array(list(itertools.product(*signs)), dtype=float) * self.error
        return np.unique(np.concatenate([np.zeros((1, len(self.error))), corners]), axis=0)

    def acting(self, memory: Ints, last: Ints) -> Ints:
        """The input that acts now whatever is chosen, where inputs are late; else the `last` one, (n,) each."""
        return self.solution.step(memory, np.zeros_like(memory), 0)[0] if self.solution.late else last

    def options(self, x: Floats, memory: Ints) -> Options:
        """At true states (n, nx) and memories (n,)."""
        n, count = len(x), len(self.inputs)
        inputs, corner = np.zeros((n, count), np.bool_), np.zeros((n, count), np.int64)
        stuck, ended = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
        for c in range(len(self.corners) - 1, -1, -1):
            own, over = self._at(x + self.corners[c], memory)
            none = ~own.any(axis=1)
            stuck[none & ~over], ended[none & over] = c, c
            inputs |= own
            corner[own] = c
        return Options(inputs, corner, stuck, ended)

    def _at(self, y: Floats, memory: Ints) -> tuple[Bools, Bools]:
        """Admissible inputs (n, M) at measurements, and whether a run is over there (n,)."""
        s = self.solution
        cells = s.grid.index(y)
        known = cells >= 0
        rows = np.where(known, cells * s.memory + memory, 0)
        admitted = unpack(s.admitted(len(self.inputs), rows), len(self.inputs)) & known[:, None]
        over = np.zeros(len(y), np.bool_) if s.target is None else s.target[rows]
        return admitted, over & known


NOWHERE = 1e9  # outside the grid: nothing is nearer to losing


@dataclass(frozen=True, eq=False)
class Danger:
    """Two measures over the cells, larger where it is worse.

    Attributes:
        grid: the cells. edge: (cells,) minus the distance to the nearest losing cell, in cells; the seam of a periodic
            axis is taken for an end, which makes this a guide and no bound.
        level: (cells,) worst-case steps to the target, None where nothing is to be reached.
    """

    grid: Grid
    edge: NDArray[np.float32]
    level: NDArray[np.float32] | None

    @staticmethod
    def of(solution: Solution) -> Danger:
        """From a winning domain."""
        from scipy.ndimage import distance_transform_edt

        grid = solution.grid
        inside = np.pad(
            solution.winning.reshape(grid.cells), [(int(j not in grid.periodic),) * 2 for j in range(len(grid.cells))]
        )
        trimmed = tuple(slice(None) if j in grid.periodic else slice(1, -1) for j in range(len(grid.cells)))
        edge = -np.asarray(distance_transform_edt(inside), np.float32)[trimmed].reshape(-1)
        if solution.value is None:
            return Danger(grid, edge, None)
        level = solution.value.reshape(grid.size, -1).max(axis=1).astype(np.float32)
        return Danger(grid, edge, np.where(level < 0, np.float32(NOWHERE), level))

    def __call__(self, x: Floats, by_level: bool = False) -> Floats:
        """Danger of states (..., nx): -> (...)."""
        cells = self.grid.index(x.reshape(-1, x.shape[-1]))
        field = self.level if by_level and self.level is not None else self.edge
        return np.where(cells >= 0, field[cells], NOWHERE).reshape(x.shape[:-1]).astype(np.float64)


NARROWEST = 0.02  # share of the cells, or all of the same number, from which narrow ones are drawn


class WorstStarts:
    """Cells in which a run does not end at once, by what makes them narrow; the `danger` is of the solution's cells.

    A quarter of the starts each come from cells of the smallest `margin` (cells,) if it is known, from those at the
    edge of the winning domain, from those of the greatest level, and from all of them.
    """

    def __init__(self, solution: Solution, margin: NDArray[np.float32] | None = None) -> None:
        danger, cells = Danger.of(solution), solution.beginnings
        fields = [danger.edge[cells]]
        fields += [np.nan_to_num(-margin[cells], nan=-np.inf)] if margin is not None else []
        fields += [danger.level[cells]] if danger.level is not None else []
        self.danger = danger
        self._pools = [cells, *(_cells_with_largest(cells, field) for field in fields)]

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """States (count, nx): half of them at corners of their cells, a quarter on a face, a quarter inside."""
        turns = rng.integers(0, len(self._pools), count)
        chosen = np.array([rng.choice(self._pools[k]) for k in turns], dtype=np.int64)
        return drawn_in_cells(self.danger.grid, chosen, rng, (0, 1))


def _cells_with_largest(cells: Ints, field: NDArray[np.float32]) -> Ints:
    """Cells whose number is among the largest."""
    limit = np.quantile(field, 1.0 - NARROWEST, method="lower")
    return cells[field >= limit]


Bounds = Callable[[Floats, Floats, Ints], tuple[Floats, Floats]]
Step = Callable[[Floats, Floats], Floats]


class Plants(ABC):
    """Some plants, each a run."""

    def reset(self, x: Floats) -> None:  # noqa: B027 - most have nothing to put there
        """Put them at states (n, nx)."""

    @abstractmethod
    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """From states (n, nx), where they are, under inputs (n, nu): -> states (n, nx), clearance of the paths (n,).

        `before` (n,) are the numbers of the inputs that acted last, -1 at rest.
        """


class RolledOut(Plants):
    """Runs of a simulator whose whole state is x: a step is a roll-out, so runs go side by side."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """See `Plants`; (n, nx), (n, nu), (n,)."""
        return self._simulator.rollouts(x, u), None


class OneByOne(Plants):
    """One run of a simulator that remembers more than x; its paths are watched where it records them."""

    def __init__(self, simulator: Simulator, monitor: Monitor) -> None:
        self._simulator, self._monitor = simulator, monitor

    def reset(self, x: Floats) -> None:
        """Put the simulator at x, (1, nx)."""
        self._simulator.reset(x[0])

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """See `Plants`; (1, nx), (1, nu), (1,)."""
        following = self._simulator.advance(u[0])[None]
        path = getattr(self._simulator, "path", None)
        if path is None or not self._monitor.measures_clearance:
            return following, None
        return following, np.array([self._monitor.clearance(path)])


class WorstDisturbance(Plants):
    """The model that the controller is made for, `f + [lo, hi]`: the next state is the worst corner of that box.

    What counts as worst is nearness to losing; every fourth time a corner is drawn.
    """

    def __init__(self, step: Step, bounds: Bounds, danger: Danger, monitor: Monitor, rng: np.random.Generator) -> None:
        self._step, self._bounds, self._danger, self._rng = step, bounds, danger, rng
        self._monitor = monitor

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """See `Plants`; (n, nx), (n, nu), (n,). Clearance is that of the samples: the box says nothing of the path."""
        predicted, (lo, hi) = self._step(x, u), self._bounds(x, u, before)
        corners = np.stack(
            [predicted + np.where(c, hi, lo) for c in itertools.product((False, True), repeat=x.shape[1])]
        )
        worst = np.argmax(self._danger(corners, self._danger.level is not None), axis=0)
        drawn = self._rng.integers(0, len(corners), len(x))
        taken = np.where(self._rng.integers(0, 4, len(x)) == 0, drawn, worst)
        following = corners[taken, np.arange(len(x))]
        if not self._monitor.measures_clearance:
            return following, None
        return following, np.array([self._monitor.clearance(state[None]) for state in following])


LENGTH = 200
"""Samples for which a run is to stay: more starts find more than longer runs, which end in the same few corners."""
TOGETHER = 32  # runs side by side
NEAREST, SLOWEST, LARGEST_GAP = "nearest to losing", "slowest", "largest use of gamma"
REVERSAL, ALTERNATING, ANY = "largest change of input", "alternating extremes", "any admissible"
_TIE = 1e-6  # of the range of a rule's numbers


@dataclass(frozen=True, eq=False)
class Scene:
    """Data that rules rank inputs by.

    Attributes:
        predict: states (n, nx), input numbers (n,) and those before them (n,), -1 at rest -> where the plant gets to,
            (n, nx): the middle of what is possible.
        gap_share: how much of gamma a step uses, (n, nx), (n,) -> (n,); None where asking the simulator costs too much.
        danger: of states; inputs: U, (M, nu); late: whether an input acts one sample after it is chosen.
    """

    predict: Callable[[Floats, Ints, Ints], Floats]
    gap_share: Callable[[Floats, Ints], Floats] | None
    danger: Danger
    inputs: Floats
    late: bool = False

    def rules(self) -> tuple[str, ...]:
        """Names of all rules that there are here."""
        own = [NEAREST]
        own += [SLOWEST] if self.danger.level is not None else []
        own += [LARGEST_GAP] if self.gap_share is not None else []
        own += [f"{end} of input {k + 1}" for k in range(self.inputs.shape[1]) for end in ("least", "largest")]
        return (*own, REVERSAL, ALTERNATING, ANY)


def choose(
    rule: str, scene: Scene, x: Floats, acting: Ints, last: Ints, step: int, admissible: Bools,
    rng: np.random.Generator,
) -> Ints:  # fmt: skip
    """One of the admissible inputs (n, M) for runs at states x (n, nx), by a rule: -> (n,).

    `last` (n,) is the input that acted last, -1 where there is none, `acting` (n,) the one that acts now where inputs
    are late, else `last` too; `step` counts the samples. Rows without an admissible input get any number.
    """
    row, column = np.nonzero(admissible)
    score = np.full(admissible.shape, -np.inf)
    if len(row):
        values = _scores(rule, scene, x[row], acting[row], last[row], column, step)
        spread = np.ptp(values) if len(values) > 1 else 0.0
        score[row, column] = values + _TIE * (spread + 1e-12) * rng.uniform(size=len(row))
    return np.argmax(score, axis=1).astype(np.int64)


def _scores(rule: str, scene: Scene, x: Floats, acting: Ints, last: Ints, m: Ints, step: int) -> Floats:
    """Numbers for pairs of a run and an input, (k,)."""
    u, inputs = scene.inputs[m], scene.inputs
    scale = np.maximum(np.abs(inputs).max(axis=0), 1e-300)
    if rule in (NEAREST, SLOWEST):
        at = scene.predict(x, acting, last) if scene.late else x
        return scene.danger(scene.predict(at, m, acting), rule == SLOWEST)
    if rule == LARGEST_GAP and scene.gap_share is not None:
        return scene.gap_share(x, m)
    if rule == REVERSAL:
        before = np.where(acting[:, None] >= 0, inputs[acting], 0.0)
        return np.abs((u - before) / scale).sum(axis=1)
    if rule == ALTERNATING:
        return (1.0 if step % 2 else -1.0) * (u / scale).sum(axis=1)
    if rule == ANY:
        return np.zeros(len(m))
    end, axis = rule.split(" of input ")
    return (1.0 if end == "largest" else -1.0) * u[:, int(axis) - 1]


@dataclass(frozen=True, eq=False)
class BrokenRun:
    """A run that breaks what the controller promises.

    Attributes:
        rule: by which inputs were chosen; end: how it ended; run: it. outside: steps outside gamma, (k,) bool.
        d, lo, hi: (k, nx) gap and bound of each step; not numbers where the plant is the model with its disturbance.
    """

    rule: str
    end: str
    run: Run
    outside: Any
    d: Floats
    lo: Floats
    hi: Floats


@dataclass
class Campaign(JsonRecord, names={"outside_gamma": "steps_outside_gamma", "by": "steps_by_rule"}):
    """Counts over the runs against one plant.

    Attributes:
        runs, steps: made; violations: runs that broke the promise; outside_gamma: steps.
        ends: runs by their end; by: steps by rule. broken: the first few broken runs, which are not written.
    """

    runs: int = 0
    steps: int = 0
    violations: int = 0
    outside_gamma: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    by: Counter[str] = field(default_factory=Counter)
    broken: list[BrokenRun] = field(default_factory=list, repr=False)

    @staticmethod
    def joined(parts: Sequence[Campaign]) -> Campaign:
        """Campaigns side by side."""
        counted = ("runs", "steps", "violations", "outside_gamma")
        runs, steps, violations, outside = (sum(getattr(p, n) for p in parts) for n in counted)
        ends, by = (sum((getattr(p, n) for p in parts), Counter[str]()) for n in ("ends", "by"))
        broken = [run for p in parts for run in p.broken][:KEPT]
        return Campaign(runs, steps, violations, outside, ends, by, broken)


@dataclass(frozen=True, eq=False)
class Opponent:
    """A plant to attack the controller on.

    Attributes:
        plants: it. judge: of its runs. held: whether gamma is to hold its steps; the disturbance is gamma itself.
        together: most runs side by side. holds: whether a run that has reached its target must stay there.
    """

    plants: Plants
    judge: Judge
    held: bool
    together: int
    holds: bool = False


def campaign(
    opponent: Opponent, law: ControlLaw, scene: Scene, starts: Callable[[int], Floats], budget: int,
    rng: np.random.Generator,
) -> Campaign:  # fmt: skip
    """Attack until `budget` steps are made, by every rule at least once; `starts(n)` draws n states, (n, nx)."""
    out, rules, value = Campaign(), scene.rules(), law.solution.value
    steps = _length(opponent, value)
    together = min(opponent.together, -(-budget // (len(rules) * steps)))
    turn = 0
    while out.steps < budget or turn < len(rules):
        rule = rules[turn % len(rules)]
        runs = play(opponent.plants, law, scene, rule, opponent.judge.space, starts(together), steps, rng)
        _count(out, opponent, rule, runs, steps)
        turn += 1
        if turn >= len(rules) and out.steps == 0:
            break  # every run is over where it begins
    return out


def _length(opponent: Opponent, value: Any) -> int:
    """Samples of a run: as many as it may take to the target (levels, or None without one), and those to stay for."""
    if value is None:
        return min(opponent.judge.steps, LENGTH)
    return int(value.max()) + 1 + (LENGTH if opponent.holds else 0)


def _count(out: Campaign, opponent: Opponent, rule: str, runs: list[Run], steps: int) -> None:
    judge = opponent.judge
    verdicts = [judge.monitor.judge(run, steps) for run in runs]
    kept = [v.run for v in verdicts]
    if opponent.held:
        audit = judge.audit(kept)
        outside, d, lo, hi = audit.outside, audit.d, audit.lo, audit.hi
    else:
        count = sum(len(run.inputs) for run in kept)
        outside = np.zeros(count, np.bool_)
        d = lo = hi = np.full((count, judge.space.size), np.nan)
    ends = np.cumsum([0, *(len(run.inputs) for run in kept)])
    for i, (verdict, count) in enumerate(zip(verdicts, split_by_run(outside, kept), strict=True)):
        outcome, rows = judge.certified(verdict, count).outcome, slice(ends[i], ends[i + 1])
        out.runs, out.steps = out.runs + 1, out.steps + outcome.steps
        out.outside_gamma += count
        out.ends[outcome.end] += 1
        out.by[rule] += outcome.steps
        if not outcome.kept and outcome.end != BEYOND:
            out.violations += 1
            if len(out.broken) < KEPT:
                out.broken.append(BrokenRun(rule, outcome.end, verdict.run, outside[rows], d[rows], lo[rows], hi[rows]))


def play(
    plants: Plants, law: ControlLaw, scene: Scene, rule: str, space: Space, starts: Floats, steps: int,
    rng: np.random.Generator,
) -> list[Run]:  # fmt: skip
    """Runs from `starts` (n, nx) of at most `steps` samples, side by side, under one rule.

    A run ends early where the controller has no input at some measurement (it is then `stuck`), and where it may be
    over: at once where every measurement says so, by chance where only some do.
    """
    record = Record(starts, steps, law.solution.first)
    x, memory = starts.copy(), record.memory[0].copy()
    alive, last = np.arange(len(x)), np.full(len(x), -1)
    plants.reset(starts)
    for k in range(steps):
        options = law.options(space.wrapped(x[alive]), memory[alive])
        going = _sort_out(record, law, k, alive, options, rng)
        alive = alive[going]
        if len(alive) == 0:
            break
        own = options.inputs[going]
        acting = law.acting(memory[alive], last[alive])
        m = choose(rule, scene, space.wrapped(x[alive]), acting, last[alive], k, own, rng)
        record.measured[k, alive] = x[alive] + law.corners[options.corner[going][np.arange(len(m)), m]]
        cells = law.solution.grid.index(record.measured[k, alive])
        now, memory[alive] = law.solution.step(memory[alive], m, cells)
        x[alive], near = plants.advance(x[alive], law.inputs[now], last[alive])
        last[alive] = now
        record.add(k, alive, x[alive], now, memory[alive], near)
    return record.runs()


def _sort_out(
    record: Record, law: ControlLaw, k: int, alive: Ints, options: Options, rng: np.random.Generator
) -> Bools:
    """Note how sample k of the runs that are alive (n,) is measured where they end; which of them go on: (n,)."""
    stuck = options.stuck >= 0
    over = ~stuck & (options.ended >= 0)
    over &= ~options.inputs.any(axis=1) | (rng.integers(0, 2, len(alive)) == 0)
    for which, corner in ((stuck, options.stuck), (over, options.ended)):
        record.measured[k, alive[which]] += law.corners[corner[which]]
    record.stuck[alive[stuck]] = True
    return ~stuck & ~over


def each_once(starts: Callable[[int], Floats], part: int, parts: int) -> Callable[[int], Floats]:
    """The draws of `starts` that did not come before, nor in another part of the attack: no two parts share a state.

    From the same start a random simulator draws the same noise again, and steps that are counted must be independent.
    """
    seen = set[bytes]()

    def new() -> Floats:
        while (own := (x := starts(1)).tobytes()) in seen or crc32(own) % parts != part:
            pass
        seen.add(own)
        return x

    return lambda count: np.concatenate([new() for _ in range(count)])


def attack_loops(
    context: Context, simulator: Simulator, gap: GapFunction, solution: Solution, worst: WorstStarts, steps: int,
    rng: np.random.Generator, part: tuple[int, int] = (0, 1),
) -> dict[str, Campaign]:  # fmt: skip
    """Both campaigns, of `steps` each: in the simulator and against the worst disturbance.

    `part` is the number of this part of the attack, and how many there are.
    """
    case, space = context.case, Space.of(context.case)
    danger = worst.danger
    monitor = specification_of(case).monitor(space, solution)
    error = space.vector(case.sensing.error if case.sensing else {})
    law = ControlLaw(solution, context.input_set, error)
    model, inputs = context.plant.sampled, context.input_set
    most = case.validation.steps if case.validation is not None else 2000
    judge = Judge(space, monitor, most, inputs, model, gap, solution, case.is_random, case.is_random)

    def bounds(x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats]:
        return gap.bounds_after(space.wrapped(x), u, before)

    def predict(x: Floats, m: Ints, before: Ints) -> Floats:
        lo, hi = bounds(x, inputs[m], before)
        return model.step(x, inputs[m]) + 0.5 * (lo + hi)

    def use(x: Floats, m: Ints) -> Floats:
        u = inputs[m]
        d, (lo, hi) = simulator.rollouts(x, u) - model.step(x, u), gap.bounds(x, u)
        return share(d, d, lo, hi)

    holds = specification_of(case).holds
    memoryless = case.hidden_state is None and not simulator.remembers
    plant: Plants = RolledOut(simulator) if memoryless else OneByOne(simulator, monitor)
    scene = Scene(predict, use if memoryless else None, danger, inputs, solution.late)
    simulated = Opponent(plant, judge, True, TOGETHER if memoryless else 1, holds)
    disturbed = Opponent(WorstDisturbance(model.step, bounds, danger, monitor, rng), judge, False, TOGETHER, holds)
    attack, starts = partial(campaign, law=law, budget=steps, rng=rng), partial(worst.draw, rng=rng)
    return {
        "simulator": attack(simulated, scene=scene, starts=each_once(starts, *part) if case.is_random else starts),
        "disturbance": attack(disturbed, scene=replace(scene, gap_share=None), starts=starts),
    }
