"""What closed-loop runs are held against: the gap bound at every step, the specification at every sample."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from simgap.closed_loop import Run
from simgap.gap.function import GapFunction
from simgap.geometry import Box, Floats
from simgap.model.sampled import NominalModel


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
    def outside(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Steps at which gamma did not hold."""
        return ~np.all((self.lo <= self.d) & (self.d <= self.hi), axis=1)


def audit_gap(x: Floats, u: Floats, following: Floats, model: NominalModel, gap: GapFunction) -> GapAudit:
    """Compare steps (k, nx), (k, nu) -> (k, nx) with the bound that the controller was made for."""
    if len(x) == 0:
        empty = np.empty((0, model.nx))
        return GapAudit(empty, empty, empty)
    lo, hi = gap.bounds(x, u)
    return GapAudit(following - model.step(x, u), lo, hi)


@dataclass
class Tally:
    """Counts over runs; `ends` maps how a run ended to how many did."""

    runs: int = 0
    steps: int = 0
    kept: int = 0
    ends: dict[str, int] = field(default_factory=dict)
    outside_gamma: int = 0
    failure_steps: list[int] = field(default_factory=list)

    def add(self, end: str, kept: bool, steps: int, outside: int = 0) -> None:
        """Count one run; `kept` says that it did what the specification asks."""
        self.runs += 1
        self.steps += steps
        self.kept += kept
        self.ends[end] = self.ends.get(end, 0) + 1
        self.outside_gamma += outside
        if not kept:
            self.failure_steps.append(steps)

    def to_json(self) -> dict[str, object]:
        """Plain data."""
        median = float(np.median(self.failure_steps)) if self.failure_steps else None
        return {
            "runs": self.runs,
            "steps": self.steps,
            "runs_that_kept_the_specification": self.kept,
            "runs_that_violated_it": self.runs - self.kept,
            "ends": dict(sorted(self.ends.items())),
            "steps_outside_gamma": self.outside_gamma,
            "median_steps_until_violation": median,
        }


def judge_invariance(run: Run, safe: Box, steps: int) -> tuple[str, bool]:
    """How a run ended and whether it stayed in the safe set for all its samples."""
    if not bool(safe.contains(run.x[-1])):
        return "left the safe set", False
    if run.stuck:
        return "no admissible input", False
    return ("stayed", True) if len(run.inputs) >= steps else ("ended early", False)


def steps_of(runs: Iterable[Run], inputs: Floats) -> tuple[Floats, Floats, Floats]:
    """All steps of some runs under each other: x, u, x+."""
    runs = list(runs)
    x = np.concatenate([r.x[: len(r.inputs)] for r in runs])
    u = inputs[np.concatenate([r.inputs for r in runs])]
    return x, u, np.concatenate([r.x[1 : len(r.inputs) + 1] for r in runs])


def split_by_run(
    flags: Sequence[bool] | np.ndarray[tuple[int, ...], np.dtype[np.bool_]], runs: Sequence[Run]
) -> list[int]:
    """How many flagged steps each run has."""
    ends = np.cumsum([len(r.inputs) for r in runs])
    counts = np.concatenate([[0], np.cumsum(np.asarray(flags, dtype=np.int64))])
    return np.diff(counts[np.concatenate([[0], ends])]).astype(int).tolist()
