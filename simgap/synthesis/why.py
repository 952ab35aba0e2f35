"""Why a state wins or loses: what each input can do from its cell, with the gap and without."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.synthesis.controller import Controller
from simgap.synthesis.synthesise import SynthesisProblem

_FORBIDDEN = "The specification or its clearance forbids this cell: the answer is the same for every controller."


def why(problem: SynthesisProblem, controller: Controller, nominal: Controller, x: Floats) -> tuple[str, ...]:
    """Sentences on a state x (nx,): whether its cell wins, and if it does not, what its inputs run into.

    Args:
        problem, controller: with the gap; nominal: the nominal-only controller.

    Raises:
        UserError: a controller that remembers: its cell alone does not decide.
    """
    solution, grid, names = controller.solution, controller.grid, problem.space.states
    if solution.memory > 1 or problem.on_true_cells:
        raise UserError("the controller remembers an input or a measurement", remedy="`why` looks at cells alone.")
    cell = int(grid.index(x[None])[0])
    if cell < 0:
        far = [n for n, v, lo, hi in zip(names, x, grid.box.lo, grid.box.hi, strict=True) if not lo <= v <= hi]
        return (f"Outside the region of the specification: {', '.join(far)}.",)
    if not solution.free[cell]:
        return (_FORBIDDEN,)
    if solution.winning[cell]:
        return (f"It wins: {len(controller.inputs(x))} of {len(problem.inputs)} inputs are admissible.",)
    boxes = problem.abstraction().boxes(np.array([cell]))[0]
    leaves, lost = _fates(grid, solution.winning, boxes)
    return ("It loses: no input keeps every successor in cells that win.", *_inputs(problem, boxes, leaves, lost),
            _without_the_gap(problem, nominal, cell))  # fmt: skip


def _fates(grid: Grid, winning: Bools, boxes: Ints) -> tuple[Bools, Ints]:
    """Of boxes of successors (M, 2, nx): axes along which each may leave the region (M, nx), cells in it that lose."""
    count, table = np.array(grid.cells), winning.reshape(grid.cells)
    out = (boxes[:, 0] < 0) | (boxes[:, 1] >= count)
    out[:, list(grid.periodic)] = False
    lost = np.zeros(len(boxes), dtype=np.int64)
    for m, (low, high) in enumerate(boxes):
        axes = [
            np.unique(np.arange(a, b + 1) % n) if j in grid.periodic else np.arange(max(a, 0), min(b, n - 1) + 1)
            for j, (a, b, n) in enumerate(zip(low, high, count, strict=True))
        ]
        lost[m] = np.count_nonzero(~table[np.ix_(*axes)])
    return out, lost


def _inputs(problem: SynthesisProblem, boxes: Ints, leaves: Bools, lost: Ints) -> Sequence[str]:
    names, M = problem.space.states, len(boxes)
    along = [f"{int(n)} along {name}" for n, name in zip(leaves.sum(axis=0), names, strict=True) if n]
    inside = ~leaves.any(axis=1)
    said = [f"Of {M} inputs {M - int(inside.sum())} may leave the region ({', '.join(along)})."] if along else []
    bad = inside & (lost > 0)
    if bad.any():
        m = int(np.flatnonzero(bad)[np.argmin(lost[bad])])
        size, best = boxes[m, 1] - boxes[m, 0] + 1, problem.inputs[m].tolist()
        many = f"{int(np.prod(size))} ({' x '.join(map(str, size))})"
        said.append(f"{int(bad.sum())} of {M} may end in cells that lose; the best, {best}, in {lost[m]} of {many}.")
    if (inside & (lost == 0)).any():
        said.append("The others end in cells that win, but what their path touches between samples may not.")
    return said


def _without_the_gap(problem: SynthesisProblem, nominal: Controller, cell: int) -> str:
    if nominal.grid.cells == problem.cells and nominal.solution.winning[cell]:
        return "The nominal-only controller wins here: the gap, or the path between samples, costs this cell."
    return "The nominal-only controller loses here too: inputs, cells or the specification cost this cell."
