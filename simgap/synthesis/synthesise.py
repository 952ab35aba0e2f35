"""From a nominal model, a gap and a specification to a controller, or to the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.specifications.solution import Solution
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.nominal import Model, nominal_abstraction
from simgap.synthesis.product import Kernel
from simgap.synthesis.refusals import hopeless_dimension, reason_for_empty
from simgap.synthesis.sensing import sensed_invariance
from simgap.synthesis.specifications import InvarianceSpecification, Specification
from simgap.synthesis.sweep import Sweep

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that synthesis reads.

    Attributes:
        model: nominal map f.
        specification: what is asked for; its region is tiled by the cells.
        cells: cells per state.
        inputs: U, (M, nu).
        periodic: state axes that wrap.
        gap: kernel of the gap function, None for f alone.
        gap_axes: state axes on which the gap depends, None for all.
        error: bound of the measurement error per state, (nx,); None for a perfect measurement.
        latency: whole samples between a measurement and the input that uses it, 0 or 1.
        sweep: cells that the way between samples may touch, for each input; None where the specification's clearance
            covers it.
    """

    model: Model
    specification: Specification
    cells: tuple[int, ...]
    inputs: Floats
    periodic: tuple[int, ...] = ()
    gap: Kernel | None = None
    gap_axes: Sequence[int] | None = None
    error: Floats | None = None
    latency: int = 0
    sweep: Sweep | None = None

    @property
    def grid(self) -> Grid:
        """Cells on the region of the specification.

        Raises:
            UserError: when the number of axes is wrong.
        """
        if len(self.cells) != self.specification.region.size:
            raise UserError(
                f"{len(self.cells)} cell counts for {self.specification.region.size} states", key="synthesis.cells"
            )
        return Grid(self.specification.region, self.cells, self.periodic)

    @property
    def sensed(self) -> bool:
        """Whether the invariance controller sees less than the present state itself."""
        blurred = self.error is not None and bool(np.any(np.asarray(self.error) > 0))
        return isinstance(self.specification, InvarianceSpecification) and (blurred or self.latency > 0)

    def abstraction(self) -> Abstraction:
        """The abstraction of the model with its gap; of measured cells for reach-avoid, of true ones otherwise."""
        error = None if self.sensed else self.error
        plain = nominal_abstraction(self.model, self.grid, self.inputs, self.gap, self.gap_axes, error)
        return replace(plain, sweep=self.sweep)


def synthesise(problem: Problem, threads: int = 1) -> Solution:
    """Winning domain and all admissible inputs.

    Raises:
        UserError: empty winning domain, naming the dimension and the disturbance or spacing that caused it; a
            specification that the grid cannot express; latency with anything but invariance.
    """
    solution = _solve(problem, problem.abstraction(), threads)
    target = 0 if solution.target is None else int(solution.target.sum())
    if int(solution.winning.sum()) > target:
        return solution
    hopeless = hopeless_dimension(problem.model, problem.grid, problem.inputs, problem.gap, problem.specification)
    if hopeless is not None:
        raise hopeless
    undisturbed = replace(problem, gap=None, error=None, latency=0, sweep=None)
    alone = _solve(undisturbed, undisturbed.abstraction(), threads) if problem is not undisturbed else solution
    causes = [name for name, holds in (("the gap", problem.gap), ("the way between samples", problem.sweep)) if holds]
    raise reason_for_empty(problem.specification, problem.grid, problem.error, problem.latency, causes, alone)


def _solve(problem: Problem, abstraction: Abstraction, threads: int) -> Solution:
    if problem.sensed:
        error = np.zeros(abstraction.grid.box.size) if problem.error is None else np.asarray(problem.error)
        return sensed_invariance(abstraction, error, problem.latency, threads)
    if problem.latency != 0:
        raise UserError(
            f"a controller that reaches a target cannot take a latency yet; the case states {problem.latency} sample",
            key="sensing.latency",
            remedy="Set it to 0 and raise sensing.error by what a state can move in that time, or ask for invariance.",
        )
    return problem.specification.solve(abstraction, threads)
