"""From samples to all of X: fit one side of a bound and pad it so that it holds between the samples.

Three ways, tightest first (t is what the side has to cover, e = t - q.p its residual, h the cell half-widths):

- inflate: every cell must satisfy `e_r + pad_r <= 0` with the local padding of e (`lipschitz/local.py`). It depends on
  q, so the program is solved for the padded target and the padding taken again, until both agree; what is missing at
  the end is added as a constant. Since the residual is flat where the basis follows the gap, this costs least.
- per_axis: q.p covers the samples; `sum_j (L1_j + L2_j) h_j` is added.
- paper: q.p covers the samples; `(L1 + L2) eps` is added, eps the half-diagonal of a cell (paper, eq. actual_gamma).

L1 is of the signed gap (L(|d|) <= L(d)) and an estimate; L2 of q.p is an analytic bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.gap.design import Design
from simgap.gap.forms import Form
from simgap.gap.lipschitz.grid import GridLipschitz
from simgap.gap.lipschitz.local import LocalPadding
from simgap.gap.scenario import ScenarioResult, solve_scenario
from simgap.gap.settings import GapSettings
from simgap.geometry import Floats, Grid

_PASSES = 5


@dataclass(frozen=True, eq=False)
class SideFit:
    """One padded side: `form` covers its targets on all of X x U, given the Lipschitz constants.

    Attributes:
        scenario: the last scenario program. padding: largest local padding (inflate) or the constant (others).
        padding_mean: its mean over the cells. raised: constant added after the program: padding that is not in its
            constraint, worst violation and rounding. passes: programs solved. rough_share: cells with a jump.
    """

    form: Form
    scenario: ScenarioResult
    padding: float
    padding_mean: float
    raised: float
    passes: int
    rough_share: float


@dataclass(frozen=True, eq=False)
class SideProblem:
    """What one side needs: targets [(N, M), ...] that q.p must cover, and where they were sampled."""

    design: Design
    targets: Sequence[Floats]
    grid: Grid
    free: tuple[int, ...]
    floor: float
    blank: Form  # zero coefficients; carries the ranges of the basis


def fit_side(problem: SideProblem, lipschitz: GridLipschitz, settings: GapSettings) -> SideFit:
    """Fit and pad one side by the case's padding mode."""
    if settings.padding == "inflate":
        return _inflate(problem, settings)
    target = np.maximum.reduce(list(problem.targets))
    result = solve_scenario(problem.design, target, settings.objective, settings.slack)
    form = _with(problem.blank, result.coefficients)
    h = np.where(np.isin(np.arange(len(problem.grid.cells)), problem.free), 0.0, problem.grid.h)
    if settings.padding == "per_axis":
        padding = float((lipschitz.constants + form.gradient_bound) @ h)
    else:
        padding = float((lipschitz.euclidean + np.linalg.norm(form.gradient_bound)) * np.linalg.norm(h))
    raised = padding + result.worst_violation + _numerical(problem, form)
    return SideFit(form.with_offset(raised), result, padding, padding, raised, 1, lipschitz.rough_share)


def _inflate(problem: SideProblem, settings: GapSettings) -> SideFit:
    plain = np.maximum.reduce(list(problem.targets))
    local = [LocalPadding(t, problem.grid, problem.free, problem.floor) for t in problem.targets]
    result = solve_scenario(problem.design, plain, settings.objective, settings.slack)
    fits: list[SideFit] = []
    for count in range(1, _PASSES + 1):
        q = result.coefficients
        values, form = problem.design.product(q), _with(problem.blank, q)
        slopes = {j: problem.design.slope(q, j) for j in local[0].axes}
        pads = [padding.of_residual(values, slopes.__getitem__, form.hessian_bound) for padding in local]
        padded = np.maximum.reduce([t + pad for t, (pad, _) in zip(problem.targets, pads, strict=True)])
        missing = float((padded - values).max())
        raised = missing + _numerical(problem, form)
        top = max(float(pad.max()) for pad, _ in pads)
        mean = float(np.mean([pad.mean() for pad, _ in pads]))
        rough = max(share for _, share in pads)
        fits.append(SideFit(form.with_offset(raised), result, top, mean, raised, count, rough))
        if abs(missing) <= 1e-2 * top or count == _PASSES:
            break
        result = solve_scenario(problem.design, padded, settings.objective, settings.slack, warm=result.rows)
    goal = "sup" if settings.objective == "eta" else "mean"
    return min(fits, key=lambda fit: float(getattr(fit.scenario, goal)) + fit.raised)


def _with(blank: Form, coefficients: Floats) -> Form:
    return Form(blank.basis, blank.ranges, blank.domain, coefficients)


def _numerical(problem: SideProblem, form: Form) -> float:
    """Rounding of q.p at the samples and of the sampled gap itself."""
    return form.rounding + problem.floor / 16.0
