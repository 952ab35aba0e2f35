"""From a nominal model, a gap and a specification to a controller, or to the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid
from simgap.model.sampled import NominalModel
from simgap.specifications.base import Game, Specification
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction, nominal_abstraction
from simgap.synthesis.abstraction.intersample import SweptCells
from simgap.synthesis.abstraction.post import Kernel
from simgap.synthesis.controller import least_effort
from simgap.synthesis.games.game import NodeGame, PreviousBounds, one_input_only


class EmptyDomain(UserError):
    """No run can start anywhere; `explain` of `simgap.synthesis.explain` says why."""


@dataclass(frozen=True, eq=False)
class SynthesisProblem:
    """Everything that synthesis reads.

    Attributes:
        model: nominal map f.
        specification: what is asked for; its region is tiled by the cells.
        space: the states that it is about.
        cells: cells per state.
        inputs: U, (M, nu).
        gap: kernel of the gap function, None for f alone.
        gap_axes: state axes on which the gap depends, None for all.
        error: bound of the measurement error per state, (nx,); None for a perfect measurement.
        latency: whole samples between a measurement and the input that uses it, 0 or 1.
        swept: cells that the path between samples may touch, for each input; None where clearance covers it.
        previous: the gap and the swept cells after each class of the previous input; None where there is one class.
        first: number of the input that acts in the first sample where there is a latency; None for the least effort.
        stray: what the clearance has to cover of it, (nx,), or (2, nx): from obstacles, and from walls; None for a
            controller that looks at the samples only.
        one: whether the input of least effort alone is recorded of each cell, for what is to be reached.
    """

    model: NominalModel
    specification: Specification
    space: Space
    cells: tuple[int, ...]
    inputs: Floats
    gap: Kernel | None = None
    gap_axes: Sequence[int] | None = None
    error: Floats | None = None
    latency: int = 0
    swept: SweptCells | None = None
    stray: Floats | None = None
    first: int | None = None
    previous: PreviousBounds | None = None
    one: bool = False

    @property
    def grid(self) -> Grid:
        """Cells on the region of the specification.

        Raises:
            UserError: when the number of axes is wrong.
        """
        region = self.specification.region(self.space)
        if len(self.cells) != region.size:
            raise UserError(f"{len(self.cells)} cell counts for {region.size} states", key="synthesis.cells")
        return self.space.grid(region, self.cells)

    @property
    def blurred(self) -> bool:
        """True if the controller sees less than the present state itself."""
        return self.latency > 0 or (self.error is not None and bool(np.any(np.asarray(self.error) > 0)))

    @property
    def on_true_cells(self) -> bool:
        """True if cells are of the true state: where that costs no soundness, and the specification allows it."""
        return self.specification.on_true_cells and self.blurred

    def abstraction(self) -> Abstraction:
        """The abstraction of the model with its gap."""
        return self._boxes(self.gap, self.swept)

    def _boxes(self, gap: Kernel | GapFunction | None, swept: SweptCells | None) -> Abstraction:
        error = None if self.on_true_cells else self.error
        plain = nominal_abstraction(self.model, self.grid, self.inputs, gap, self.gap_axes, error)
        return replace(plain, swept=swept)

    def game(self, threads: int = 1) -> Game:
        """The game that the specification is solved on."""
        nothing = np.zeros(self.space.size)
        stray = nothing if self.stray is None else self.stray
        first = int(least_effort(self.inputs)[0]) if self.first is None else self.first
        if self.one and (self.on_true_cells or self.latency or self.previous is not None):
            raise one_input_only("a controller that remembers, or that keeps cells of the true state")
        about = self.space, stray, threads, self.latency > 0, first
        if self.on_true_cells:
            error = nothing if self.error is None else np.asarray(self.error)
            return NodeGame((self.abstraction(),), *about, blur=error)
        if self.previous is None:
            return NodeGame((self.abstraction(),), *about, one=self.one)
        own = self.previous
        boxes = tuple(self._boxes(*pair) for pair in zip(own.gaps, own.swept, strict=True))
        return NodeGame(boxes, *about, own.kind, own.rest, after_any=self.abstraction)


def synthesise(problem: SynthesisProblem, threads: int = 1) -> Solution:
    """Winning domain and all admissible inputs.

    Raises:
        EmptyDomain: no cell wins.
        UserError: a specification that the grid cannot express; more cells and inputs than a latency allows.
    """
    solution = problem.specification.solve(problem.game(threads))
    if solution.useful:
        return solution
    raise EmptyDomain("the winning domain is empty", key="synthesis", remedy="`simgap.synthesis.explain` says why.")
