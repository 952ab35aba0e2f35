"""From samples to all of X: fit one side of a bound and pad it so that it holds between the samples.

Three ways, tightest first (t is what the side has to cover, e = t - q.p its residual, h the cell half-widths):

- inflate: every cell must satisfy `e_r + pad_r <= 0` with the local padding of e (`lipschitz/local.py`). It depends on
  q, so the program is solved for the padded target and the padding taken again, until both agree; what is missing at
  the end is added as a constant. Since the residual is flat where the basis follows the gap, this costs least.
- per_axis: q.p covers the samples; `sum_j (L1_j + L2_j) h_j` is added.
- paper: q.p covers the samples; `(L1 + L2) eps` is added, eps the half-diagonal of a cell (paper, eq. actual_gamma).

Samples on the border of X and beside switching surfaces (`directed`) stand for the border and the surface around them:
q.p must cover them with what e may move along the surface. Where the bound of the grid does so already, as that of a
smooth gap does, it stays as it is; else the program is solved again with these samples in it.

The first is why a scenario program is not done before its padding is known: the slopes that it takes are those of the
residual, from the samples themselves. The other two never enter the program and are added after it (`padded`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.gap.bounds.linear import Form
from simgap.gap.fitting.scenario import Design, ScenarioResult, solve_scenario
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.grid import GridLipschitz
from simgap.gap.lipschitz.local import EnclosedPadding, FitSlopes, LocalPadding, OffGrid
from simgap.gap.sampling.borders import Directed
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import Values, centres, combined, joined, largest_of


@dataclass(frozen=True, eq=False)
class SideFit(JsonRecord, names={"scenario": "program"}):
    """Result of the scenario program of one side, before rounding and before a padding that is no part of it.

    Attributes:
        scenario: the last program.
        padding: largest local padding over the cells where it is inside the program, else 0.
        missing: what q.p lacks to cover the (padded) targets at the samples.
        passes: programs solved. rough_share: cells with a jump, as far as the program looked for them.
        directed: samples on borders and beside switching surfaces that were covered, too. factor: by how many times
            what the slopes allow the residual rises from the centre of a cell to such a sample; at most 1 if they hold.
    """

    scenario: ScenarioResult
    padding: float
    missing: float
    passes: int
    rough_share: float
    directed: int = 0
    factor: float = 0.0


@dataclass(frozen=True, eq=False)
class PaddedSide:
    """One padded side: `form` covers its targets on all of X x U, given the Lipschitz constants.

    Attributes:
        fit: what it was made from, with its padding: the local one (inflate) or the constant (others).
        raised: constant added after the program: padding that is not in its constraint, worst violation and rounding.
    """

    form: Form
    fit: SideFit
    raised: float

    def to_json(self) -> dict[str, Any]:
        """Numbers for gap.json and the report."""
        program = {name: own for name, own in self.fit.scenario.to_json().items() if name != "coefficients"}
        return {
            **program, "padding": self.fit.padding,
            "raised": self.raised, "passes": self.fit.passes,
            "rough_share": self.fit.rough_share, "directed": self.fit.directed, "directed_factor": self.fit.factor,
        }  # fmt: skip


def numerical(form: Form, floor: float) -> float:
    """Rounding of q.p at the samples and of the sampled gap itself."""
    return form.rounding + floor / 16.0


def padded(
    fit: SideFit, blank: Form, where: SampleGrid, floor: float, lipschitz: GridLipschitz, padding: str
) -> PaddedSide:
    """A side that covers X x U: `inflate` has its padding inside the program, the others take it from `lipschitz`.

    L1 is of the signed gap (L(|d|) <= L(d)) and an estimate; L2 of q.p is an analytic bound.
    """
    form, reach = replace(blank, coefficients=fit.scenario.coefficients), 0.0
    if padding != "inflate":
        reach = constant_padding(padding, lipschitz, where.moving_half_widths, form.gradient_bound)
        fit = replace(fit, padding=reach, rough_share=lipschitz.rough_share)
    raised = reach + fit.missing + numerical(form, floor)
    return PaddedSide(form.with_offset(raised), fit, raised)


def constant_padding(padding: str, lipschitz: GridLipschitz, h: Floats, gradient: Floats) -> float:
    """Largest move within a cell of half-widths h (nx,), by the constants and a gradient (nx,): `per_axis`, `paper`."""
    if padding == "per_axis":
        return float((lipschitz.constants + gradient) @ h)
    return float((lipschitz.euclidean + np.linalg.norm(gradient)) * np.linalg.norm(h))


_PASSES = 5


@dataclass(frozen=True, eq=False)
class SideProblem:
    """The problem of one side of the bound of a dimension, or of both at once.

    Attributes:
        design: its rows. samples: of the dimension. sides: True for the upper one, False for the lower; q.p must cover
            the target of each. blank: the form with zero coefficients; it carries the ranges of the basis.
    """

    design: Design
    samples: DimensionSamples
    sides: tuple[bool, ...]
    blank: Form

    @cached_property
    def targets(self) -> list[Values]:
        """Values that q.p must cover at the samples of the grid, (N, M) a side."""
        return [self.samples.side(up) for up in self.sides]

    @cached_property
    def beside_targets(self) -> list[Floats]:
        """Values that it must cover at the samples beside the grid, (E, M) a side; none without them."""
        beside = self.samples.beside
        return [beside.side(up) for up in self.sides] if beside is not None else []

    def joined(self) -> SideProblem:
        """The problem whose design has the samples beside the grid as further rows."""
        beside = self.samples.beside
        return self if beside is None else replace(self, design=replace(self.design, x=joined(self.design.x, beside.x)))

    @property
    def is_joined(self) -> bool:
        """True if the design has the samples beside the grid as further rows."""
        return self.design.shape[0] > self.samples.where.grid.size

    @property
    def every_target(self) -> list[Values]:
        """Targets of all rows of the design."""
        if not self.is_joined:
            return self.targets
        return [joined(*pair) for pair in zip(self.targets, self.beside_targets, strict=True)]

    def fit(self, q: Floats) -> FitSlopes:
        """q.p at the samples of the grid, as a padding needs it."""
        design, form = replace(self.design, x=centres(self.samples.where.grid)), replace(self.blank, coefficients=q)
        return FitSlopes(design.product(q), lambda j: design.slope(q, j), form.hessian_bound)


def estimated_padding(samples: DimensionSamples, upper: bool) -> LocalPadding:
    """The paddings of what one side has to cover, from the slopes of the samples."""
    return LocalPadding(samples.side(upper), samples.where.grid, samples.where.free, samples.floor, samples.room)


def local_padding(samples: DimensionSamples, upper: bool) -> LocalPadding | EnclosedPadding:
    """The paddings of what one side has to cover: enclosed where the gap is known in closed form, else estimated.

    Raises:
        UserError: a gap in closed form that cannot be enclosed.
        BrokenPromise: samples that are not those of the closed form.
    """
    if samples.ranges is None:
        return estimated_padding(samples, upper)
    return EnclosedPadding(samples.side(upper), samples.ranges, upper)


def fit_side(problem: SideProblem, settings: GapSection) -> SideFit:
    """Fit one side; with padding `inflate` the local paddings are part of the program."""
    alone, beside = _solved(problem, settings), problem.samples.beside
    if beside is None:
        return alone
    short, factor = _shortfall(problem, beside, settings, alone)
    fit = alone if short <= 0.0 else _solved(problem.joined(), settings)
    return replace(fit, directed=len(beside.x), factor=factor)


def _solved(problem: SideProblem, settings: GapSection) -> SideFit:
    if settings.padding == "inflate":
        return _inflate(problem, settings)
    target = largest_of(problem.every_target)
    result = solve_scenario(problem.design, target, settings.objective, settings.slack)
    return SideFit(result, 0.0, result.worst_violation, 1, 0.0)


def _shortfall(problem: SideProblem, directed: Directed, settings: GapSection, fit: SideFit) -> tuple[float, float]:
    """Shortfall of the grid's bound at the samples beside it, and their rise over the padding of their cells.

    The second number: the largest rise of the residual from the centre of a cell to such a sample, over what the slopes
    allow across the surface (1 or less: they said the truth).
    """
    q, samples = fit.scenario.coefficients, problem.samples
    form, known = replace(problem.blank, coefficients=q), problem.fit(q)
    there = Design.of(problem.design.basis, directed.x, problem.design.u).product(q).whole()
    short, factor = -np.inf, 0.0
    for up, at, target in zip(problem.sides, problem.beside_targets, problem.targets, strict=True):
        beside = OffGrid.of(directed, samples.where.grid, at - there)
        along, across = estimated_padding(samples, up).along(beside, known)
        needed = at + (along if settings.padding == "inflate" else 0.0)
        short = max(short, float((needed - there).max()) - fit.missing - numerical(form, samples.floor))
        risen = (at - there) - (target[beside.cells] - known.values[beside.cells])
        factor = max(factor, float((risen / np.maximum(across, samples.floor)).max()))
    return short, factor


def _inflate(problem: SideProblem, settings: GapSection) -> SideFit:
    targets, samples = problem.every_target, problem.samples
    local = [local_padding(samples, up) for up in problem.sides]
    result = solve_scenario(problem.design, largest_of(targets), settings.objective, settings.slack)
    goal = "sup" if settings.objective == "eta" else "mean"
    fits: list[tuple[float, SideFit]] = []
    for count in range(1, _PASSES + 1):
        q = result.coefficients
        values, known, form = problem.design.product(q), problem.fit(q), replace(problem.blank, coefficients=q)
        pads = [padding.of(known) for padding in local]
        top = max(pad.ends()[1] for pad, _ in pads)
        rough = max(share for _, share in pads)
        every = [pad for pad, _ in pads]
        if samples.beside is not None and problem.is_joined:
            there = values[samples.where.grid.size : problem.design.shape[0]]
            for k, (up, at) in enumerate(zip(problem.sides, problem.beside_targets, strict=True)):
                beside = OffGrid.of(samples.beside, samples.where.grid, at - there)
                every[k] = joined(every[k], estimated_padding(samples, up).along(beside, known)[0])
        padded = largest_of([combined(np.add, *pair) for pair in zip(targets, every, strict=True)])
        missing = combined(np.subtract, padded, values).ends()[1]
        reached = float(getattr(result, goal)) + (missing + numerical(form, samples.floor))
        fits.append((reached, SideFit(result, top, missing, count, rough)))
        if abs(missing) <= 1e-2 * top or count == _PASSES:
            break
        result = solve_scenario(problem.design, padded, settings.objective, settings.slack, warm=result.rows)
    return min(fits, key=lambda pair: pair[0])[1]
