"""Bounds that are linear in a basis, by the scenario program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.config.gap import BasisSection, GapSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.function import Tier
from simgap.gap.bounds.linear import Basis, Form, LinearGap, make_form, negated
from simgap.gap.fitting.acceptance import remedy
from simgap.gap.fitting.dimension_fit import BoundInputs, DimensionFit, Sides, guarantee
from simgap.gap.fitting.padding import SideFit, SideProblem, fit_side, padded
from simgap.gap.fitting.scenario import Design
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import centres
from simgap.geometry import Box


def basis_of(where: SampleGrid, settings: GapSection) -> Basis:
    """The basis that the settings ask for.

    Raises:
        UserError: for terms that are no basis, or a term that depends on an axis along which a symmetry is declared.
    """
    return listed_basis(settings.basis, where.states, where.input_names, where.grid.box, where.free)


def listed_basis(
    chosen: BasisSection, states: Sequence[str], inputs: Sequence[str], box: Box, free: Sequence[int]
) -> Basis:
    """The terms of a basis that do not depend on the axes `free`, along which a symmetry is declared.

    Raises:
        UserError: for terms that are no basis, or a written term that depends on a free axis.
    """
    kept = [j for j in range(len(states)) if j not in free]
    terms = chosen.listed([states[j] for j in kept], inputs, Box(box.lo[kept], box.hi[kept]))
    basis = Basis(tuple(map(str, terms)), tuple(states), tuple(inputs))
    for j in free:
        for term, row in zip(basis.terms, basis.gradients, strict=True):
            if row[j] != 0:
                raise UserError(
                    f"the term '{term}' depends on {states[j]}, along which a symmetry is declared",
                    key="gap.basis",
                    remedy="Leave it out, or withdraw the symmetry.",
                )
    return basis


def blank_form(basis: Basis, where: SampleGrid) -> Form:
    """A form with zero coefficients; it carries the ranges of the basis."""
    return make_form(basis, where.grid.box, where.inputs, np.zeros(basis.size))


@dataclass(frozen=True, eq=False)
class LinearFit(DimensionFit, kind="linear"):
    """Scenario programs of one dimension over the terms of a basis; `sides`: upper and lower, or both."""

    terms: tuple[str, ...]
    sides: Mapping[str, SideFit]

    @classmethod
    def of(cls, samples: DimensionSamples, settings: GapSection) -> LinearFit:
        """Solve the scenario programs of one dimension: two sides, or one for both."""
        where, _ = samples.where, samples.ranges  # refuses samples that are not those of a known gap
        basis = basis_of(where, settings)
        design, blank = Design(basis, centres(where.grid), where.inputs), blank_form(basis, where)
        wanted = {"upper": (True,), "lower": (False,)} if settings.signed else {"both": (True, False)}
        problems = {name: SideProblem(design, samples, sides, blank) for name, sides in wanted.items()}
        return cls(basis.terms, {name: fit_side(problem, settings) for name, problem in problems.items()})

    @classmethod
    def bound(cls, fits: Sequence[LinearFit], given: BoundInputs) -> tuple[LinearGap, list[Sides]]:
        """Pad every side and put the dimensions together."""
        where, settings = given.where, given.settings
        blank = blank_form(Basis(fits[0].terms, where.states, where.input_names), where)
        sides: list[Sides] = []
        for i, (fit, known) in enumerate(zip(fits, given.lipschitz, strict=True)):
            floor = float(where.rounding[i])
            sides.append(
                {name: padded(s, blank, where, floor, known.grid, settings.padding) for name, s in fit.sides.items()}
            )
            rough = max(side.fit.rough_share for side in sides[-1].values())
            if settings.padding == "inflate" and rough > settings.lipschitz.rough_limit:
                raise BrokenPromise(
                    f"the residual of {where.states[i]} is not Lipschitz at this grid: {100 * rough:.2g} % of the "
                    f"cells are rough; {known.grid.place(where.states)}",
                    remedy(where, settings, known.grid, rough, residual=True),
                )
        tiers = _tiers(given, sides)
        below, above = (
            tuple(s[name if settings.signed else "both"].form for s in sides) for name in ("lower", "upper")
        )
        return _lifted(LinearGap(where.domain, tiers, tuple(map(negated, below)), above)), sides


def _lifted(function: LinearGap) -> LinearGap:
    """The bound moved outward until lo <= hi on all of X x U, verified by branch and bound, not at samples alone."""
    for _ in range(3):
        missing = 0.5 * np.maximum(-function.narrowest(), 0.0)
        if not missing.any():
            return function
        function = function.raised(missing * 1.000001, missing * 1.000001)
    raise BrokenPromise("the gap bound cannot be made wide enough to be never upside down")


def _tiers(given: BoundInputs, sides: Sequence[Sides]) -> tuple[Tier, ...]:
    def largest(name: str) -> list[Any]:
        return [max(getattr(side.fit, name) for side in own.values()) for own in sides]

    padding, extra = given.settings.padding, ""
    if padding == "inflate":
        pads = "; ".join(f"{n}: {v:.3g}" for n, v in zip(given.where.states, largest("padding"), strict=True))
        extra = f"The padding uses the local slopes in each cell, less those of the fit; at most {pads}."
    return guarantee(padding, given, largest("rough_share"), max(largest("directed")), largest("factor"), extra)
