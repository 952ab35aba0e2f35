"""Supremum of a form over X x U by branch and bound, with a rigorous upper end."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise
from simgap.gap.bounds.forms import Form

_ROUNDS = 400
_BOXES = 2_000_000


def supremum(form: Form, inputs: Floats, tolerance: float = 1e-7) -> tuple[float, float]:
    """Bracket (value reached, upper bound) of sup of g over the domain and the inputs (M, nu).

    Boxes of the domain, one set for each input, are halved along the axis that widens their range most; a box whose
    upper bound is below the best value found is dropped. Stops when the bracket is `tolerance` of the range of g, or
    as narrow as rounding allows.

    Raises:
        BrokenPromise: when the bracket does not close within the budget of boxes.
    """
    m, nx = len(inputs), form.domain.size
    lo, hi = np.tile(form.domain.lo, (m, 1)), np.tile(form.domain.hi, (m, 1))
    which, done = np.arange(m), 0
    best, scale, top = -np.inf, 0.0, np.inf
    for _ in range(_ROUNDS):
        below, above = form.box_range(lo, hi, inputs[which])
        best = max(best, float(form.values(0.5 * (lo + hi), inputs[which]).max()))
        scale = max(scale, float(above.max() - below.min()))
        top = float(above.max())
        if top - best <= max(tolerance * scale, 4.0 * form.rounding):
            return best, top
        keep = above > best
        lo, hi, which = lo[keep], hi[keep], which[keep]
        done += len(lo)
        if done > _BOXES:
            break
        lo, hi, which = _halved(form, lo, hi, which, inputs, nx)
    raise BrokenPromise(
        f"the supremum of a gap bound is only known to lie in [{best:.6g}, {top:.6g}]",
        "Use a basis with fewer or smoother terms.",
    )


def _halved(
    form: Form, lo: Floats, hi: Floats, which: np.ndarray[tuple[int], np.dtype[np.int64]], inputs: Floats, nx: int
) -> tuple[Floats, Floats, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    r = 0.5 * (hi - lo)
    slopes = np.einsum("nlj,l->nj", form.basis.evaluate_gradient(0.5 * (lo + hi), inputs[which]), form.coefficients)
    spread = np.abs(slopes) * r + 0.5 * r * (r @ form.hessian_bound)
    axis = spread.argmax(axis=1)
    rows, middle = np.arange(len(lo)), 0.5 * (lo + hi)
    left, right = hi.copy(), lo.copy()
    left[rows, axis] = middle[rows, axis]
    right[rows, axis] = middle[rows, axis]
    return np.concatenate([lo, right]), np.concatenate([left, hi]), np.concatenate([which, which])
