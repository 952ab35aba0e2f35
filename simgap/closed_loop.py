"""One loop for validation, replay and rigs: a controller and a plant, sample by sample, until a monitor says so.

The judge compares every step with the gap bound and every sample with the specification.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Protocol

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.gap.bounds.function import GapFunction
from simgap.model.sampled import NominalModel
from simgap.simulators.body_samples import REST
from simgap.specifications.base import Monitor, Outcome, Run, Verdict
from simgap.specifications.solution import Solution, after_choice
from simgap.specifications.space import Space


class Plant(Protocol):
    """Plant that the loop drives: a simulator, a rig, the nominal model.

    One that records the path between samples has it as `path` (k, nx) after each step.
    """

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,)."""

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for one sampling time: -> (nx,)."""


class Policy(Protocol):
    """Policy that the loop queries: `synthesis.controller.Controller` is one."""

    @property
    def input_set(self) -> Floats: ...  # noqa: D102
    def lookup(self, x: Floats, pending: Ints | int) -> Ints:
        """Chosen input numbers for measured states (n, nx) and pending inputs: -> (n,), -1 where there is none."""


@dataclass(frozen=True, eq=False)
class Sensing:
    """Knowledge of the controller: bounded measurement error (nx,) and whole samples of latency (0 or 1)."""

    error: Floats
    latency: int = 0

    def measure(self, x: Floats, rng: np.random.Generator) -> Floats:
        """A measurement of x (nx,): corners of the error box as often as its inside, because corners are worst."""
        unit = rng.uniform(-1.0, 1.0, x.shape)
        return x + self.error * (np.sign(unit) if rng.integers(2) else unit)


def closed_loop(
    plant: Plant,
    policy: Policy,
    start: Floats,
    steps: int,
    sensing: Sensing,
    rng: np.random.Generator,
    monitor: Monitor,
    first_measured: Floats | None = None,
) -> Run:
    """Run from `start` (nx,) until `steps` samples, or until the monitor ends it or the controller has no input.

    `first_measured` (nx,) is the first measurement, `start` itself if not given. With one sample of latency the input
    decided from a measurement acts one sample later; until the first one does, the controller's `first` acts. A run
    also ends after a step whose path touches what the monitor watches, where the plant records its path.
    """
    lookup, inputs, progress = scalar_lookup(policy), policy.input_set, getattr(policy, "progress", None)
    exact = not np.any(sensing.error)
    plant.reset(start)
    x = np.array(start, dtype=np.float64)
    y = x if first_measured is None else first_measured
    pending, kind = int(getattr(policy, "first", 0)), getattr(policy, "kind", None)
    states, measured, applied, known = [x], [y], [], [pending]
    watched = monitor.measures_clearance and getattr(plant, "path", None) is not None
    near = [monitor.clearance(x[None])] if watched else []
    stuck = False
    for _ in range(steps):
        if monitor.over(x, y):
            break
        cell, decided = lookup(y, pending)
        if decided < 0:
            stuck = True
            break
        now, pending = map(int, after_choice(kind, bool(sensing.latency), pending, decided, progress, cell))
        x = plant.advance(inputs[now])
        y = x if exact else sensing.measure(x, rng)
        states.append(x)
        measured.append(y)
        applied.append(now)
        known.append(pending)
        if watched:
            near.append(monitor.clearance(plant.path))  # type: ignore[attr-defined]
            if near[-1] <= 0.0:
                break
    path, near_path = np.array(states), np.array(near) if watched else None
    measured_path = path if exact else np.array(measured)
    return Run(
        path, np.array(applied, dtype=np.int64), stuck, measured_path, near_path, np.array(known, dtype=np.int64)
    )


def scalar_lookup(policy: Policy) -> Callable[[Floats, int], tuple[int, int]]:
    """The policy for one state at a time, (nx,) -> cell, input number; a grid controller answers without arrays."""
    grid, choice = getattr(policy, "grid", None), getattr(policy, "choice", None)
    cell_of = grid.finder() if grid is not None else lambda x: -1
    if choice is None:
        return lambda x, pending: (cell_of(x), int(policy.lookup(x[None], pending)[0]))
    memory = int(getattr(policy, "memory", 1))
    picked = memoryview(choice)  # it answers faster than an array, one element at a time, and copies nothing

    def find(x: Floats, pending: int) -> tuple[int, int]:
        cell = cell_of(x)
        return cell, int(picked[cell * memory + pending]) if cell >= 0 else -1

    return find


def batch_loop(
    step: Callable[[Floats, Floats], Floats], policy: Policy, starts: Floats, steps: int, monitor: Monitor
) -> list[Run]:
    """Many runs side by side on a memoryless map `step` (n, nx), (n, nu) -> (n, nx), with exact measurements.

    Each run is the one of `closed_loop`. A map records no path between samples.
    """
    late, kind = bool(getattr(policy, "late", False)), getattr(policy, "kind", None)
    progress = getattr(policy, "progress", None)
    record, alive = Record(starts, steps, int(getattr(policy, "first", 0))), np.arange(len(starts))
    for k in range(steps):
        alive = alive[~monitor.over_each(record.x[k, alive], record.x[k, alive])]
        decided = policy.lookup(record.x[k, alive], record.memory[k, alive])
        record.stuck[alive[decided < 0]] = True
        alive, decided = alive[decided >= 0], decided[decided >= 0]
        if len(alive) == 0:
            break
        cells = 0 if progress is None else policy.grid.index(record.x[k, alive])  # type: ignore[attr-defined]
        now, after = after_choice(kind, late, record.memory[k, alive], decided, progress, cells)
        record.add(k, alive, step(record.x[k, alive], policy.input_set[now]), now, after)
    return record.runs()


class Record:
    """States, measurements, inputs and memories of runs side by side, from their starts (n, nx) and first memory."""

    def __init__(self, starts: Floats, steps: int, first: int) -> None:
        n, nx = starts.shape
        self.x, self.measured = np.full((steps + 1, n, nx), np.nan), np.full((steps + 1, n, nx), np.nan)
        self.x[0] = self.measured[0] = starts
        self.inputs, self.memory = np.full((steps, n), -1, np.int64), np.full((steps + 1, n), first, np.int64)
        self.near, self.watched = np.full((steps + 1, n), np.inf), False
        self.length, self.stuck = np.zeros(n, np.int64), np.zeros(n, np.bool_)

    def add(self, k: int, alive: Ints, x: Floats, now: Ints, memory: Ints, near: Floats | None = None) -> None:
        """Note the step after sample k of these runs, (n,) each, to states x (n, nx)."""
        self.x[k + 1, alive] = self.measured[k + 1, alive] = x
        self.inputs[k, alive], self.memory[k + 1, alive] = now, memory
        self.length[alive] = k + 1
        if near is not None:
            self.near[k + 1, alive], self.watched = near, True

    def runs(self) -> list[Run]:
        """The runs, one by one."""
        out = []
        for i, n in enumerate(self.length.tolist()):
            near = self.near[: n + 1, i] if self.watched else None
            x, measured, known = self.x[: n + 1, i], self.measured[: n + 1, i], self.memory[: n + 1, i]
            out.append(Run(x, self.inputs[:n, i], bool(self.stuck[i]), measured, near, known))
        return out


LEFT = "left what is certified"
"""How a run ends that did what was asked, but not by way of what the controller's certificate says."""
BEYOND = "failed after a step outside gamma"
"""How a run of a simulator with noise ends that fails after a step that gamma leaves out: no promise speaks of it."""
BATCH = 100  # runs whose steps are compared with the bound at once


@dataclass(frozen=True, eq=False)
class GapAudit:
    """`lo(x, u) <= x+ - f(x, u) <= hi(x, u)` at every step of some runs.

    Attributes:
        d, lo, hi: (k, nx) gap and its bounds at each step.
        outside: (k,) steps at which some dimension leaves its bound.
    """

    d: Floats
    lo: Floats
    hi: Floats

    @property
    def outside(self) -> Bools:
        """Steps at which gamma did not hold: (k,) bool."""
        return ~np.all((self.lo <= self.d) & (self.d <= self.hi), axis=1)


@dataclass(frozen=True, eq=False)
class Judge:
    """Bound and specification that the runs of one controller must keep.

    Attributes:
        space: the states; monitor: of the specification; steps: samples that a run has.
        inputs: U, (M, nu); model, gap: f and the bound that the controller was made for.
        certificate: what a controller proves of this plant; a run that leaves it counts as a violation even if it comes
            back. None for a controller that proves nothing of it: the specification alone is judged.
        tolerant: whether the case tolerates steps outside gamma, so that a run with one is judged like that too.
        noisy: whether the simulator is random, so that a run may fail after such a step (`BEYOND`).
    """

    space: Space
    monitor: Monitor
    steps: int
    inputs: Floats
    model: NominalModel
    gap: GapFunction
    certificate: Solution | None = None
    tolerant: bool = False
    noisy: bool = False

    def audit(self, runs: Sequence[Run]) -> GapAudit:
        """All steps of some runs, one under the other, against the bound; periodic states are brought into X."""
        x, u, following = steps_of(runs, self.inputs)
        if len(x) == 0:
            empty = np.empty((0, self.space.size))
            return GapAudit(empty, empty, empty)
        x, following = self.space.unwound(x, following)
        previous = np.concatenate([np.array([REST, *r.inputs[:-1]], np.int64)[: len(r.inputs)] for r in runs])
        lo, hi = self.gap.bounds_after(x, u, previous)
        return GapAudit(following - self.model.step(x, u), lo, hi)

    def certified(self, verdict: Verdict, outside: int) -> Verdict:
        """The verdict, or that of a run that left its certificate: steps outside gamma, or states it does not hold."""
        if self.noisy and outside and self.certificate is not None and not verdict.outcome.kept:
            return replace(verdict, outcome=replace(verdict.outcome, end=BEYOND))
        if self.certificate is None or not verdict.outcome.kept or (outside and self.tolerant):
            return verdict
        if not outside and not strays(self.certificate, verdict.run):
            return verdict
        return replace(verdict, outcome=replace(verdict.outcome, end=LEFT, kept=False))

    def count(
        self, runs: Iterable[Run], numbers: Iterable[int], keep: int, again: Collection[int] = ()
    ) -> tuple[dict[str, Any], dict[int, Verdict]]:
        """Judge and audit every run: -> figures as plain data, the runs to look at by the numbers of their starts.

        Args:
            runs: from starts with these `numbers`.
            keep: how many to look at; again: starts that another controller or plant was looked at from: if any of them
                is among the numbers, these are kept, and the first other one that breaks what its certificate promises.
        """
        numbers = list(numbers)
        wanted = set(again) & set(numbers)
        outcomes, outside_gamma, kept = list[Outcome](), 0, dict[int, Verdict]()
        promised, broken = self.certificate is not None, False
        following, number = iter(runs), iter(numbers)
        while batch := [self.monitor.judge(run, self.steps) for run in islice(following, BATCH)]:
            outside = split_by_run(self.audit([v.run for v in batch]).outside, [v.run for v in batch])
            for verdict, count in zip(batch, outside, strict=True):
                held, start = self.certified(verdict, count), next(number)
                outcomes.append(held.outcome)
                outside_gamma += count
                if start in wanted:
                    kept[start] = held
                elif not wanted:
                    keep_some(kept, start, held, keep)
                elif not held.outcome.kept and promised and not broken:  # what breaks a promise is always to be seen
                    kept[start], broken = held, True
        return self.monitor.summary(outcomes) | tallied(outcomes, outside_gamma), kept


def strays(certificate: Solution, run: Run) -> int:
    """Steps of a run after which it is not where the certificate says.

    Towards a target: the level at what is measured and pending falls with every step, and stays 0 once it is; of a
    task, it falls until it is 0, again and again, or stays at its goal and never rises. To stay: the state is in a
    winning cell, or in one from which the pending input may act. A controller of measured cells that remembers the
    pending input has no such set of states: it is held by having an input at every sample, without which a run is
    stuck.
    """
    grid, value = certificate.grid, certificate.value
    if value is None:
        cells = grid.index(run.x)
        if not certificate.late:
            inside = certificate.winning[cells]
        elif certificate.acting is not None and run.memory is not None:
            inside = (certificate.acting[cells, run.memory >> 3] >> (run.memory & 7) & 1) == 1
        else:
            return 0
        return int((~inside | (cells < 0))[1:].sum())
    levels = certificate.levels(run.measured, run.memory)
    before, after = levels[:-1], levels[1:]
    arrived = (before == 0) & (after == 0)
    if certificate.progress is not None:
        rows = grid.index(run.measured[:-1]) * certificate.memory + (0 if run.memory is None else run.memory[:-1])
        assert certificate.target is not None
        arrived = certificate.target[rows] & (after <= before if certificate.progress.persists else before == 0)
    kept = (after >= 0) & ((after < before) | arrived)
    return int((~kept).sum())


def tallied(outcomes: Sequence[Outcome], outside_gamma: int) -> dict[str, Any]:
    """Counts over runs as plain data; `outside_gamma` is how many of their steps lie outside gamma."""
    failed = [o.steps for o in outcomes if not o.kept]
    ends = [o.end for o in outcomes]
    return {
        "runs": len(outcomes),
        "steps": sum(o.steps for o in outcomes),
        "runs_that_kept_the_specification": len(outcomes) - len(failed),
        "runs_that_violated_it": len(failed),
        "ends": {end: ends.count(end) for end in sorted(set(ends))},
        "steps_outside_gamma": outside_gamma,
        "median_steps_until_violation": float(np.median(failed)) if failed else None,
    }


def keep_some(kept: dict[int, Verdict], number: int, verdict: Verdict, count: int) -> None:
    """Keep the first runs; the first that failed takes the last place if none of them did, so that it can be seen."""
    if len(kept) >= count and not verdict.outcome.kept and all(v.outcome.kept for v in kept.values()):
        kept.popitem()
    if len(kept) < count:
        kept[number] = verdict


def steps_of(runs: Sequence[Run], inputs: Floats) -> tuple[Floats, Floats, Floats]:
    """All steps of some runs under each other, `inputs` (M, nu): x (k, nx), u (k, nu), x+ (k, nx)."""
    x = np.concatenate([r.x[: len(r.inputs)] for r in runs])
    u = inputs[np.concatenate([r.inputs for r in runs])]
    return x, u, np.concatenate([r.x[1 : len(r.inputs) + 1] for r in runs])


def split_by_run(flags: Sequence[bool] | Bools, runs: Sequence[Run]) -> list[int]:
    """Number of flagged steps of each run: (k,) bool, the steps of all runs under each other."""
    ends = np.cumsum([len(r.inputs) for r in runs])
    counts = np.concatenate([[0], np.cumsum(np.asarray(flags, dtype=np.int64))])
    return np.diff(counts[np.concatenate([[0], ends])]).astype(int).tolist()
