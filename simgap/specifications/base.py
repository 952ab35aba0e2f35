"""The interface of every specification, and the game that a controller is found by.

A specification is a frozen section of a case: its fields are the keys, its methods do the rest. It says which cells are
allowed and asks a `Game` for sets of cells from which that can be kept or reached; it judges runs, and it has the words
and the picture for a report. Nobody asks for its class: what differs between kinds is a method or a trait here. A
`Monitor` says when a run is over, how it ended, and what is counted; a `Picture` is boxes over two states, or the floor
of a robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.config.base import Section
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.plants.context import Context
from simgap.specifications.solution import Solution
from simgap.specifications.space import KEY, Space

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
    """True if a path between samples matters; a run then ends where `clearance` is no longer positive."""

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


@dataclass(frozen=True)
class Look:
    """Colours of matplotlib for what is to be reached (face, edge), avoided, and never left."""

    target: tuple[str, str]
    obstacle: str
    border: str


@dataclass(frozen=True, eq=False)
class Plane:
    """A floor seen from above.

    Attributes:
        axes: which states are x, y and heading.
        arena, target, obstacles: boxes over (x, y), no target where nothing is to be reached; radius: of the
            footprint, in the unit of x.
    """

    axes: tuple[int, int, int]
    arena: Box
    target: Box | None
    obstacles: tuple[Box, ...]
    radius: float


def projected(box: Box, outer: Box, shown: tuple[int, int]) -> Box:
    """A box over two of its states, cut at `outer` where it has no end."""
    i = list(shown)
    return Box(
        np.where(np.isfinite(box.lo[i]), box.lo[i], outer.lo[i]),
        np.where(np.isfinite(box.hi[i]), box.hi[i], outer.hi[i]),
    )


def rectangle(axes: Any, box: Box, **look: Any) -> None:
    """A box over two states as a patch."""
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((box.lo[0], box.lo[1]), *(box.hi - box.lo), **look))


class Game(Protocol):
    """A plant on cells, against whatever its gap and the measurement error may do: the operators of the field.

    Cells are of the true state or of the measured one, with or without a pending input; a specification need not know.
    """

    @property
    def space(self) -> Space:
        """The states."""

    @property
    def grid(self) -> Grid:
        """The cells that sets are made of."""

    @property
    def error(self) -> Floats:
        """Largest distance of the state from the cell that it is counted in, (nx,): 0 for cells of the true state."""

    @property
    def stray(self) -> Floats:
        """Distance by which a path may stray from its samples if clearance is to cover that (`SynthesisProblem`)."""

    def invariant(self, safe: Bools) -> Solution:
        """The largest set of safe cells that some input keeps for ever: the greatest fixed point; (cells,) bool."""

    def reach(self, target: Bools, free: Bools, through: Bools | None = None, steps: int | None = None) -> Solution:
        """Cells that reach the target in bounded time through free cells: the least fixed point; all (cells,) bool.

        The target may be nodes (cells * memory,) of another solution of the same game. On the way a run is in cells
        `through`, all free ones when None; target cells among them have inputs, too, that lead back into what is won.
        `steps` is the largest level; with 1, the inputs are all that lead into the target.
        """

    def certain(self, cells: Bools) -> Bools:
        """Cells (cells,) of which every measurement is in one of the given cells."""


class Words(Section):
    """Words of a report on a kind of specification, phrases that stand in its sentences."""

    runs: str = "Runs"
    """Heading of the part that shows the runs."""
    caption: str = (
        "Runs of both controllers in the simulator (in colour) and from the same starts on the nominal model (grey, "
        "dashed)."
    )
    """Sentence or two on what the picture of the runs shows."""
    kept: str = "as specified"
    """'1,000 of 1,000 runs ...'."""
    allowed: str = "free cells"
    """Set of which winning fractions are shares: '0.9 of the ...'."""
    promise: str = "keeps the specification"
    """'From every winning cell the controller ... if gamma holds.'"""
    violated: str = "breaks the specification"
    """Legend of a run's last state where it breaks the specification."""
    failed: str = "failed"
    """The same in the past tense, in a sentence: 'the controller never ...', '... in 289 of 980 runs'."""
    goal: str = "the target"
    """'... promises ... within 3 s from every winning state', 'worst-case steps to ...'."""
    between: str = "The specification is promised"
    """'... for the path between samples too'."""
    limits: str = "region"
    """Set to which the ends belong that are drawn beside each state: 'the safe set'."""


class Specification(Section, ABC):
    """Requirement on the closed loop. `kind` names the plug-in."""

    kind: str

    between_samples: ClassVar[bool] = False
    """True if it also holds between samples; the clearance then covers what a path may stray from its samples."""
    swept_boxes: ClassVar[bool] = False
    """True if the swept boxes of a wheeled robot may do that instead, input by input."""
    holds: ClassVar[bool] = True
    """True if a run must be held in a bounded set for ever, and not only go somewhere."""
    on_true_cells: ClassVar[bool] = False
    """True if it may be solved on cells of the true state where sensing is not perfect, which wins more: then its only
    operator is `Game.invariant`."""
    words: ClassVar[Words] = Words()

    def memory_states(self, space: Space) -> int:
        """How many states a controller tells apart of what the specification has come to; 1 for most."""
        return 1

    def on_floor(self, space: Space) -> bool:
        """True if what a body that drives must not touch is said by its place alone, as swept boxes need it."""
        return space.pose is not None

    @abstractmethod
    def region(self, space: Space) -> Box:
        """The box that the cells tile; the closed loop never leaves it.

        Raises:
            UserError: a specification that does not fit the states or X.
        """

    def fit(self, space: Space, grid: Grid, error: Floats) -> Bools:
        """Cells in which a run may begin as far as these cells, with a measurement error (nx,), express it: (cells,).

        Raises:
            UserError: as `solve` would, where they cannot; before anything is rolled out.
        """
        return np.ones(grid.size, np.bool_)

    @abstractmethod
    def solve(self, game: Game) -> Solution:
        """The winning domain and all admissible inputs.

        Raises:
            UserError: cells that cannot express the specification.
        """

    def recognise(self, space: Space, solution: Solution, error: Floats) -> None:
        """Refuse a solution that keeps an account of another task, with a measurement error (nx,).

        Raises:
            UserError: what it has come to is not what this specification says of its cells.
        """
        if solution.progress is not None:
            raise UserError("the controller is of a task, which this case does not have")

    @abstractmethod
    def monitor(self, space: Space, solution: Solution) -> Monitor:
        """Monitor of the runs of the controller with that solution."""

    @abstractmethod
    def sentence(self, space: Space) -> str:
        """Clause for a sentence, without a full stop: 'stay for ever in x in [0, 1] m'."""

    def free(self, space: Space, grid: Grid, margin: Floats) -> Bools:
        """Cells that it allows at all, `margin` farther from what must not be touched than it says: (cells,).

        The margin is (nx,), or (2, nx) where less does from the walls of a box: from obstacles, and from walls.
        """
        return np.ones(grid.size, np.bool_)

    def limits(self, space: Space) -> Box:
        """The interval that each state must keep to, infinite where none needs to be drawn."""
        return self.region(space)

    def bands(self, space: Space) -> Sequence[Sequence[tuple[str, float, float]]]:
        """Of each state, the named intervals (name, lo, hi) that are asked for; empty where there is nothing named."""
        return ()

    def plane(self, space: Space) -> Plane | None:
        """Boxes on the floor for a body that drives there; None where there is nothing of the kind to show."""
        return None

    def draw(self, axes: Any, space: Space, shown: tuple[int, int], look: Look) -> None:
        """Draw what it says about two states on matplotlib axes; nothing unless a kind has something to show."""


def specification_of(case: Case) -> Specification:
    """The specification of a case.

    Raises:
        UserError: a case without one, or a plug-in that is not derived from `Specification`.
    """
    if case.synthesis is None:
        raise UserError("this stage needs the section", key="synthesis", remedy="Add `synthesis:`.")
    found = case.synthesis.specification
    if not isinstance(found, Specification):
        raise UserError(
            "the plug-in is not a specification",
            key=KEY,
            remedy="Derive it from simgap.specifications.base.Specification.",
        )
    return found


def path_aware_baseline(context: Context) -> Context:
    """The case with the fair baseline: a nominal-only controller that checks its model between samples.

    Raises:
        UserError: a specification of the samples alone.
    """
    if not specification_of(context.case).between_samples:
        raise UserError(
            "needs a specification between samples; this one is about sampling instants alone",
            file=context.path, key="validation.fair_baseline", remedy="Remove the key.",
        )  # fmt: skip
    section = context.need(context.case.synthesis, "synthesis")
    checked = section.model_copy(update={"nominal_between_samples": True})
    return replace(context, case=context.case.model_copy(update={"synthesis": checked}))
