"""From samples to all of X: fit one side of a bound and pad it so that it holds between the samples.

Three ways, tightest first (t is what the side has to cover, e = t - q.p its residual, h the cell half-widths):

- inflate: every cell must satisfy `e_r + pad_r <= 0` with the local padding of e (`lipschitz/local.py`). It depends on
  q, so the program is solved for the padded target and the padding taken again, until both agree; what is missing at
  the end is added as a constant. Since the residual is flat where the basis follows the gap, this costs least.
- per_axis: q.p covers the samples; `sum_j (L1_j + L2_j) h_j` is added.
- paper: q.p covers the samples; `(L1 + L2) eps` is added, eps the half-diagonal of a cell (paper, eq. actual_gamma).

The first is why a scenario program is not done before its padding is known: the slopes that it takes are those of the
residual, from the samples themselves. The other two never enter the program and are added after it (`side.padded`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simgap.gap.design import Design
from simgap.gap.forms import Form
from simgap.gap.lipschitz.enclosed import EnclosedPadding
from simgap.gap.lipschitz.local import LocalPadding
from simgap.gap.samples import DimensionSamples
from simgap.gap.scenario import solve_scenario
from simgap.gap.settings import GapSettings
from simgap.gap.side import SideFit, numerical, with_coefficients
from simgap.geometry import Floats

_PASSES = 5


@dataclass(frozen=True, eq=False)
class SideProblem:
    """What one side needs: targets that q.p must cover, each with its local paddings."""

    design: Design
    local: Sequence[TargetPadding]
    floor: float
    blank: Form  # zero coefficients; carries the ranges of the basis

    @property
    def targets(self) -> list[Floats]:
        """[(N, M), ...] values at the samples."""
        return [padding.target for padding in self.local]


class TargetPadding(Protocol):
    """Paddings of one target t: estimated from samples, or enclosed where the gap is known in closed form."""

    @property
    def target(self) -> Floats:
        """t at the samples, (N, M)."""

    @property
    def axes(self) -> tuple[int, ...]:
        """Axes along which the gap may change."""

    def of_target(self) -> tuple[Floats, float]:
        """Padding of t itself: (N, M), and the share of rough cells."""

    def of_residual(self, values: Floats, slope: Callable[[int], Floats], curvature: Floats) -> tuple[Floats, float]:
        """Padding of t - q.p: (N, M), and the share of rough cells."""


def local_padding(samples: DimensionSamples, upper: bool) -> TargetPadding:
    """The paddings of what one side has to cover.

    Raises:
        UserError: a gap in closed form that cannot be enclosed.
        BrokenPromise: samples that are not those of the closed form.
    """
    target = samples.side(upper)
    if samples.ranges is not None:
        return EnclosedPadding(target, samples.ranges, upper)
    return LocalPadding(target, samples.where.grid, samples.where.free, samples.floor)


def fit_side(problem: SideProblem, settings: GapSettings) -> SideFit:
    """Fit one side; with padding `inflate` the local paddings are part of the program."""
    if settings.padding == "inflate":
        return _inflate(problem, settings)
    target = np.maximum.reduce(problem.targets)
    result = solve_scenario(problem.design, target, settings.objective, settings.slack)
    return SideFit(result, 0.0, 0.0, result.worst_violation, 1, 0.0)


def _inflate(problem: SideProblem, settings: GapSettings) -> SideFit:
    plain, local = np.maximum.reduce(problem.targets), problem.local
    result = solve_scenario(problem.design, plain, settings.objective, settings.slack)
    goal = "sup" if settings.objective == "eta" else "mean"
    fits: list[tuple[float, SideFit]] = []
    for count in range(1, _PASSES + 1):
        q = result.coefficients
        values, form = problem.design.product(q), with_coefficients(problem.blank, q)
        slopes = {j: problem.design.slope(q, j) for j in local[0].axes}
        pads = [padding.of_residual(values, slopes.__getitem__, form.hessian_bound) for padding in local]
        padded = np.maximum.reduce([t + pad for t, (pad, _) in zip(problem.targets, pads, strict=True)])
        missing = float((padded - values).max())
        top = max(float(pad.max()) for pad, _ in pads)
        mean = float(np.mean([pad.mean() for pad, _ in pads]))
        rough = max(share for _, share in pads)
        reached = float(getattr(result, goal)) + (missing + numerical(form, problem.floor))
        fits.append((reached, SideFit(result, top, mean, missing, count, rough)))
        if abs(missing) <= 1e-2 * top or count == _PASSES:
            break
        result = solve_scenario(problem.design, padded, settings.objective, settings.slack, warm=result.rows)
    return min(fits, key=lambda pair: pair[0])[1]
