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
residual, from the samples themselves. The other two never enter the program and are added after it (`side.padded`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.forms import Form
from simgap.gap.fitting.design import Design
from simgap.gap.fitting.scenario import solve_scenario
from simgap.gap.fitting.side import SideFit, numerical, with_coefficients
from simgap.gap.lipschitz.enclosed import EnclosedPadding
from simgap.gap.lipschitz.local import Beside, Fit, LocalPadding
from simgap.gap.sampling.samples import DimensionSamples, Directed
from simgap.gap.sampling.values import Centres, Combined, Held, Joined, Room, Values, largest_of
from simgap.gap.settings import GapSettings
from simgap.geometry import Grid

_PASSES = 5


@dataclass(frozen=True, eq=False)
class SideProblem:
    """What one side needs: targets [(N, M), ...] that q.p must cover, and where they were sampled.

    `directed` are samples beside the grid, with their own targets [(E, M), ...] in the same order; `room` is where
    paddings are kept.
    """

    design: Design
    targets: Sequence[Values]
    grid: Grid
    free: tuple[int, ...]
    floor: float
    blank: Form  # zero coefficients; carries the ranges of the basis
    directed: Directed | None = None
    beside_targets: Sequence[Floats] = ()
    enclosed: Sequence[EnclosedPadding] = ()  # of the targets, for a gap that is known in closed form
    room: Room = Held.room

    def local(self) -> list[LocalPadding]:
        """Local paddings of the targets."""
        return [LocalPadding(t, self.grid, self.free, self.floor, self.room) for t in self.targets]

    def beside(self, directed: Directed, residual: Floats) -> Beside:
        """The samples beside the grid, with the residual (E, M) there."""
        return Beside(self.grid.index(directed.x), directed.at, residual)

    def joined(self) -> SideProblem:
        """The problem whose design has the samples beside the grid as further rows."""
        if self.directed is None:
            return self
        return replace(self, design=replace(self.design, x=Joined(self.design.x, self.directed.x)))

    @property
    def every_target(self) -> list[Values]:
        """Targets of all rows of the design."""
        if self.design.shape[0] == self.grid.size:
            return list(self.targets)
        return [Joined(*pair) for pair in zip(self.targets, self.beside_targets, strict=True)]

    def fit(self, q: Floats) -> Fit:
        """q.p at the samples of the grid, as a padding needs it."""
        design, form = replace(self.design, x=Centres(self.grid)), with_coefficients(self.blank, q)
        return Fit(design.product(q), lambda j: design.slope(q, j), form.hessian_bound)


class TargetPadding(Protocol):
    """Paddings of one target t: estimated from samples, or enclosed where the gap is known in closed form."""

    @property
    def axes(self) -> tuple[int, ...]:
        """Axes along which the gap may change."""

    def of_target(self) -> tuple[Values, float]:
        """Padding of t itself: (N, M), and the share of rough cells."""

    def of_residual(self, fit: Fit) -> tuple[Values, float]:
        """Padding of t - q.p: (N, M), and the share of rough cells."""


def enclosed(samples: DimensionSamples, sides: Sequence[bool]) -> tuple[EnclosedPadding, ...]:
    """Paddings of the targets of upper (True) and lower sides where the gap is known in closed form, else none.

    Raises:
        UserError: a gap in closed form that cannot be enclosed.
        BrokenPromise: samples that are not those of the closed form.
    """
    known = samples.ranges
    return () if known is None else tuple(EnclosedPadding(samples.side(up), known, up) for up in sides)


def local_padding(samples: DimensionSamples, upper: bool) -> TargetPadding:
    """The paddings of what one side has to cover.

    Raises:
        UserError: a gap in closed form that cannot be enclosed.
        BrokenPromise: samples that are not those of the closed form.
    """
    known = enclosed(samples, [upper])
    if known:
        return known[0]
    return LocalPadding(samples.side(upper), samples.where.grid, samples.where.free, samples.floor, samples.room)


def fit_side(problem: SideProblem, settings: GapSettings) -> SideFit:
    """Fit one side; with padding `inflate` the local paddings are part of the program."""
    alone = _solved(problem, settings)
    if problem.directed is None:
        return alone
    short, factor = _shortfall(problem, problem.directed, settings, alone)
    fit = alone if short <= 0.0 else _solved(problem.joined(), settings)
    return replace(fit, directed=len(problem.directed.x), factor=factor)


def _solved(problem: SideProblem, settings: GapSettings) -> SideFit:
    if settings.padding == "inflate":
        return _inflate(problem, settings)
    target = largest_of(tuple(problem.every_target))
    result = solve_scenario(problem.design, target, settings.objective, settings.slack)
    return SideFit(result, 0.0, 0.0, result.worst_violation, 1, 0.0)


def _shortfall(problem: SideProblem, directed: Directed, settings: GapSettings, fit: SideFit) -> tuple[float, float]:
    """What the bound of the grid lacks at the samples beside it, and how they compare with what padded their cells.

    The second number: the largest rise of the residual from the centre of a cell to such a sample, over what the slopes
    allow across the surface (1 or less: they said the truth).
    """
    q = fit.scenario.coefficients
    form, known = with_coefficients(problem.blank, q), problem.fit(q)
    there = Design.of(problem.design.basis, directed.x, problem.design.u).product(q).whole()
    short, factor = -np.inf, 0.0
    for own, at, target in zip(problem.local(), problem.beside_targets, problem.targets, strict=True):
        beside = problem.beside(directed, at - there)
        along, across = own.along(beside, known)
        needed = at + (along if settings.padding == "inflate" else 0.0)
        short = max(short, float((needed - there).max()) - fit.missing - numerical(form, problem.floor))
        risen = (at - there) - (target.take(beside.cells) - known.values.take(beside.cells))
        factor = max(factor, float((risen / np.maximum(across, problem.floor)).max()))
    return short, factor


def _inflate(problem: SideProblem, settings: GapSettings) -> SideFit:
    n, targets = problem.grid.size, problem.every_target
    plain = largest_of(tuple(targets))
    estimated = problem.local()
    local: Sequence[TargetPadding] = problem.enclosed or estimated
    result = solve_scenario(problem.design, plain, settings.objective, settings.slack)
    goal = "sup" if settings.objective == "eta" else "mean"
    fits: list[tuple[float, SideFit]] = []
    for count in range(1, _PASSES + 1):
        q = result.coefficients
        values, known, form = problem.design.product(q), problem.fit(q), with_coefficients(problem.blank, q)
        pads = [padding.of_residual(known) for padding in local]
        top = max(pad.ends()[1] for pad, _ in pads)
        mean = float(np.mean([pad.mean() for pad, _ in pads]))
        rough = max(share for _, share in pads)
        every = [pad for pad, _ in pads]
        if problem.directed is not None and problem.design.shape[0] > n:
            there = values.rows(n, problem.design.shape[0])
            moved = [
                own.along(problem.beside(problem.directed, at - there), known)[0]
                for own, at in zip(estimated, problem.beside_targets, strict=True)
            ]
            every = [Joined(*pair) for pair in zip(every, moved, strict=True)]
        padded = largest_of(tuple(Combined(np.add, pair) for pair in zip(targets, every, strict=True)))
        missing = Combined(np.subtract, (padded, values)).ends()[1]
        reached = float(getattr(result, goal)) + (missing + numerical(form, problem.floor))
        fits.append((reached, SideFit(result, top, mean, missing, count, rough)))
        if abs(missing) <= 1e-2 * top or count == _PASSES:
            break
        result = solve_scenario(problem.design, padded, settings.objective, settings.slack, warm=result.rows)
    return min(fits, key=lambda pair: pair[0])[1]
