"""Why a winning domain is empty, in one line that names the dimension and the numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.late import njit
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.nominal import Model
from simgap.synthesis.abstraction.product import Kernel, no_gap

_SAMPLES = 4096


class EmptyDomain(UserError):
    """No run can start anywhere.

    `alone` is the share that the nominal model alone wins on the same cells, None where that was not looked at.
    """

    alone: float | None = None


def hopeless_dimension(
    model: Model, grid: Grid, inputs: Floats, gap: Kernel | None, space: Space, holding: bool
) -> EmptyDomain | None:
    """A dimension in which the gap exceeds the largest step that f can make, everywhere looked at.

    Then none of the inputs (M, nu) can hold (`holding`) or advance that state against the gap in any cell. Looked at
    are up to some thousand cell centres spread over the grid, with all inputs; the fixed point has found the domain
    empty before this is asked.
    """
    centres = grid.centres()[:: max(1, grid.size // _SAMPLES)]
    steps = np.zeros((len(centres), grid.box.size, 4))
    extremes(model.kernel, no_gap if gap is None else gap, centres, inputs, steps)
    for j, name in enumerate(space.states):
        authority = float(np.abs(steps[:, j, :2]).max())
        below, above = float(steps[:, j, 2].min()), float(steps[:, j, 3].min())
        worst = max(below, above) if holding else min(below, above)
        if worst > authority and j not in grid.periodic:
            return EmptyDomain(
                f"no input can {'hold' if holding else 'steer'} {name}: the gap in {name} is at least {worst:.6g} "
                f"everywhere, while the largest step of the nominal model in {name} is {authority:.6g} (cell centres)",
                key="synthesis",
                remedy="Tighten the gap (smaller eps, signed bound, better model), enlarge tau or the inputs",
            )
    return None


def reason_for_empty(
    space: Space,
    grid: Grid,
    error: Floats | None,
    latency: int,
    causes: Sequence[str],
    undisturbed: Solution,
) -> EmptyDomain:
    """The reason when no single dimension is hopeless: `causes` and what the controller does not know.

    `error` is (nx,); `undisturbed` is the solution for f alone on the same cells, at sampling instants.
    """
    cells = ", ".join(f"{2 * h:.6g} along {name}" for name, h in zip(space.states, grid.h, strict=True))
    if not undisturbed.useful:
        return EmptyDomain(
            f"the winning domain is empty even for the nominal model alone, on cells of {cells}",
            key="synthesis.cells",
            remedy="Use more cells, or a specification that the inputs can meet",
        )
    causes = list(causes)
    if error is not None and np.any(np.asarray(error) > 0):
        causes.append(f"the measurement error {np.asarray(error).tolist()}")
    if latency:
        causes.append(f"the latency of {latency} sample")
    return EmptyDomain(
        f"the winning domain is empty because of {' and '.join(causes) or 'the disturbance'}: the nominal model alone "
        f"wins {undisturbed.fraction:.3f} of the free cells ({cells})",
        key="synthesis",
        remedy="Tighten the gap or the sensing, or use more cells if the gap is smaller than a cell",
    )


@njit(error_model="numpy")
def extremes(kernel, gap, centres, inputs, out):  # type: ignore[no-untyped-def]
    """Per centre and dimension over U: least and largest f_i - x_i, then the least -lo_i and hi_i of the gap."""
    n = centres.shape[1]
    lo, hi = np.empty(n), np.empty(n)
    for c in range(centres.shape[0]):
        for j in range(n):
            out[c, j, 0], out[c, j, 1], out[c, j, 2], out[c, j, 3] = np.inf, -np.inf, np.inf, np.inf
        for m in range(inputs.shape[0]):
            value = kernel(centres[c], inputs[m])
            gap(centres[c], centres[c], inputs[m], lo, hi)
            for j in range(n):
                step = value[j] - centres[c, j]
                out[c, j, 0], out[c, j, 1] = min(out[c, j, 0], step), max(out[c, j, 1], step)
                out[c, j, 2], out[c, j, 3] = min(out[c, j, 2], -lo[j]), min(out[c, j, 3], hi[j])
