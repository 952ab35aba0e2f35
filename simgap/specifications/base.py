"""The interface of every specification, and the game that a controller is found by.

A specification is a frozen section of a case: its fields are the keys, its methods do the rest. It says which cells are
allowed and asks a `Game` for sets of cells from which that can be kept or reached; it judges runs, and it has the words
and the picture for a report. Nobody asks for its class: what differs between kinds is a method or a trait here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, ClassVar, Protocol

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.config.base import Section
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.plants.context import Context
from simgap.specifications.monitor import Monitor
from simgap.specifications.picture import Look, Plane
from simgap.specifications.regions import KEY
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space


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
        """How far the state may be from the cell that it is counted in, (nx,): 0 for cells of the true state."""

    @property
    def stray(self) -> Floats:
        """How far a path may stray from its samples where clearance is to cover that; see `SynthesisProblem`."""

    def invariant(self, safe: Bools) -> Solution:
        """The largest set of safe cells that some input keeps for ever: the greatest fixed point; (cells,) bool."""

    def reach(self, target: Bools, free: Bools) -> Solution:
        """Cells that reach the target in bounded time through free cells: the least fixed point; both (cells,) bool.

        The target may be nodes (cells * memory,) of an `invariant` of the same game, its `served`.
        """


class Words(Section):
    """Words of a report on a kind of specification, phrases that stand in its sentences."""

    runs: str = "Runs"
    """Heading of the part that shows the runs."""
    caption: str = (
        "Runs of both controllers in the simulator (in colour) and from the same starts on the nominal model (grey, "
        "dashed)."
    )
    """What the picture of the runs shows, a sentence or two."""
    kept: str = "as specified"
    """'1,000 of 1,000 runs ...'."""
    allowed: str = "free cells"
    """What winning fractions are of: '0.9 of the ...'."""
    promise: str = "keeps the specification"
    """'From every winning cell the controller ... if gamma holds.'"""
    violated: str = "breaks the specification"
    """Legend of a run's last state where it breaks the specification."""
    failed: str = "failed"
    """The same in the past tense, in a sentence: 'the controller never ...', '... in 289 of 980 runs'."""
    limits: str = "region"
    """What the ends that are drawn beside each state belong to: 'the safe set'."""


class Specification(Section, ABC):
    """Requirement on the closed loop. `kind` names the plug-in."""

    kind: str

    between_samples: ClassVar[bool] = False
    """Whether it also holds between samples; the clearance then covers what a path may stray from its samples."""
    swept_boxes: ClassVar[bool] = False
    """Whether the swept boxes of a wheeled robot may do that instead, input by input."""
    holds: ClassVar[bool] = True
    """Whether a run must be held in a bounded set for ever, and not only go somewhere."""
    on_true_cells: ClassVar[bool] = False
    """Whether it may be solved on cells of the true state where sensing is not perfect, which wins more: then its only
    operator is `Game.invariant`."""
    words: ClassVar[Words] = Words()

    def on_floor(self, space: Space) -> bool:
        """True if what a body that drives must not touch is said by its place alone, as swept boxes need it."""
        return space.pose is not None

    @abstractmethod
    def region(self, space: Space) -> Box:
        """The box that the cells tile; the closed loop never leaves it.

        Raises:
            UserError: a specification that does not fit the states or X.
        """

    @abstractmethod
    def solve(self, game: Game) -> Solution:
        """The winning domain and all admissible inputs.

        Raises:
            UserError: cells that cannot express the specification.
        """

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
