"""Monitors, which judge a run: when it is over, how it ended, and what is counted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from simgap.arrays import Bools, Floats, Ints

STUCK, EARLY = "no admissible input", "ended early"


@dataclass(frozen=True, eq=False)
class Run:
    """One run of a controller on a plant.

    Attributes:
        x: (k + 1, nx) states, periodic ones not wrapped; measured: (k + 1, nx) what was measured of them.
        inputs: (k,) numbers of the inputs applied.
        stuck: whether the controller had no input at the last state.
        memory: (k + 1,) what the controller remembered at each sample, the pending input; None for one without memory.
        clearance: (k + 1,) least distance to what must not be touched, at the start and then along each step; None
            where no path between samples was recorded.
    """

    x: Floats
    inputs: Ints
    stuck: bool
    measured: Floats
    clearance: Floats | None = None
    memory: Ints | None = None

    def until(self, steps: int) -> Run:
        """Its first steps."""
        near = None if self.clearance is None else self.clearance[: steps + 1]
        known = None if self.memory is None else self.memory[: steps + 1]
        cut = self.stuck and steps == len(self.inputs)
        return Run(self.x[: steps + 1], self.inputs[:steps], cut, self.measured[: steps + 1], near, known)


@dataclass(frozen=True, eq=False)
class Outcome:
    """End of a run.

    Attributes:
        end: in words, one of few; kept: whether the run did what the specification asks.
        steps: that it took; figures: what else was measured, for the monitor's own summary.
    """

    end: str
    kept: bool
    steps: int
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Verdict:
    """A judged run.

    Attributes:
        run: what counts of it, up to its end; safe: (k + 1,) samples at which nothing was violated yet.
    """

    outcome: Outcome
    run: Run
    safe: Bools


class Monitor(ABC):
    """Judges runs of one controller, one at a time."""

    measures_clearance: bool = False
    """Whether a path between samples matters; a run then ends where `clearance` is no longer positive."""

    @abstractmethod
    def over_each(self, x: Floats, measured: Floats) -> Bools:
        """True where runs end at a sample, from states (n, nx) and what is measured of them (n, nx): -> (n,)."""

    def over(self, x: Floats, measured: Floats) -> bool:
        """The same for one run: (nx,), (nx,). It runs at every sample, so that a kind may have a faster way."""
        return bool(self.over_each(x[None], measured[None])[0])

    @abstractmethod
    def judge(self, run: Run, steps: int) -> Verdict:
        """Verdict on a run that had `steps` samples to take."""

    def clearance(self, path: Floats) -> float:
        """Least distance along points (k, nx) to what must not be touched; not positive where it is touched."""
        return np.inf

    def summary(self, outcomes: Sequence[Outcome]) -> dict[str, Any]:
        """Figures over all runs beside those that every specification has; plain data."""
        return {}


class Always(Monitor):
    """Judges runs every sample of which must satisfy the same condition."""

    violated: str = "violation"
    """How a run ends that does not."""

    @abstractmethod
    def satisfied(self, x: Floats) -> Bools:
        """True where states satisfy the condition: (n, nx) -> (n,)."""

    def over_each(self, x: Floats, measured: Floats) -> Bools:
        """Runs end where the condition does not hold: (n, nx), (n, nx) -> (n,)."""
        return ~self.satisfied(x)

    def judge(self, run: Run, steps: int) -> Verdict:
        """Verdict on the condition at all samples that a run had."""
        safe = self.satisfied(run.x)
        if not safe[-1]:
            end, kept = self.violated, False
        elif run.stuck:
            end, kept = STUCK, False
        else:
            kept = len(run.inputs) >= steps
            end = "stayed" if kept else EARLY
        return Verdict(Outcome(end, kept, len(run.inputs)), run, safe)
