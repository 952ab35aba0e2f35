"""Bounds that are linear in a basis: the scenario programs of one dimension, and the gap function made of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.config.gap import BasisSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Expressions
from simgap.gap.bounds.basis import Basis, Form, make_form, negated
from simgap.gap.bounds.linear import LinearGap
from simgap.gap.bounds.tiers import Tier, directed_words, guarantee
from simgap.gap.fitting.acceptance import remedy
from simgap.gap.fitting.design import Design
from simgap.gap.fitting.padding import PaddedSide, SideFit, padded
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.result import DimensionLipschitz
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import Centres
from simgap.gap.settings import GapSettings
from simgap.geometry import Box

Sides = dict[str, PaddedSide]


@dataclass(frozen=True, eq=False)
class LinearFit(JsonRecord, kind="linear"):
    """Scenario programs of one dimension over the terms of a basis; `sides`: upper and lower, or both."""

    terms: tuple[str, ...]
    sides: Mapping[str, SideFit]


def basis_of(where: SampleGrid, settings: GapSettings) -> Basis:
    """The basis that the settings ask for.

    Raises:
        UserError: for terms that are no basis, or a term that depends on an axis along which a symmetry is declared.
    """
    chosen = Expressions(terms=("1",)) if settings.bound == "constant" else settings.basis
    return listed_basis(chosen, where.states, where.input_names, where.grid.box, where.free)


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


def fit_linear(samples: DimensionSamples, settings: GapSettings) -> LinearFit:
    """Solve the scenario programs of one dimension: two sides, or one for both."""
    from simgap.gap.fitting.padding import SideProblem, enclosed, fit_side

    where = samples.where
    basis = basis_of(where, settings)
    design, blank = Design(basis, Centres(where.grid), where.inputs), blank_form(basis, where)
    upper, lower = samples.side(upper=True), samples.side(upper=False)
    asked = {"upper": [upper], "lower": [lower]} if settings.signed else {"both": [upper, lower]}
    own = samples.beside
    beside = {"upper": (True,), "lower": (False,), "both": (True, False)}
    fits = {
        name: fit_side(
            SideProblem(
                design, targets, where.grid, where.free, samples.floor, blank, own,
                [own.side(up) for up in beside[name]] if own is not None else (), enclosed(samples, beside[name]),
                samples.room,
            ),
            settings,
        )
        for name, targets in asked.items()
    }  # fmt: skip
    return LinearFit(basis.terms, fits)


def linear_gap(
    where: SampleGrid, settings: GapSettings, fits: Sequence[LinearFit], lipschitz: Sequence[DimensionLipschitz]
) -> tuple[LinearGap, list[Sides]]:
    """Pad every side and put the dimensions together.

    Raises:
        BrokenPromise: when the grid does not resolve a residual, or the bound stays upside down.
    """
    blank = blank_form(Basis(fits[0].terms, where.states, where.input_names), where)
    sides: list[Sides] = []
    for i, (fit, known) in enumerate(zip(fits, lipschitz, strict=True)):
        floor = float(where.rounding[i])
        sides.append(
            {name: padded(s, blank, where, floor, known.grid, settings.padding) for name, s in fit.sides.items()}
        )
        rough = max(side.rough_share for side in sides[-1].values())
        if settings.padding == "inflate" and rough > settings.rough_limit:
            raise BrokenPromise(
                f"the residual of {where.states[i]} is not Lipschitz at this grid: {100 * rough:.2g} % of the cells "
                f"are rough; {known.grid.place(where.states, where.grid.box.lo, where.grid.box.hi)}",
                remedy(where, settings, known.grid, rough, residual=True),
            )
    tiers = _tiers(where, settings, lipschitz, sides)
    if settings.signed:
        lows = tuple(negated(s["lower"].form) for s in sides)
        return _lifted(LinearGap(where.domain, tiers, lows, tuple(s["upper"].form for s in sides))), sides
    return _lifted(LinearGap.unsigned(where.domain, tiers, [s["both"].form for s in sides])), sides


def _lifted(function: LinearGap) -> LinearGap:
    """The bound moved outward until lo <= hi on all of X x U, verified by branch and bound, not at samples alone."""
    for _ in range(3):
        missing = 0.5 * np.maximum(-function.narrowest(), 0.0)
        if not missing.any():
            return function
        function = function.raised(missing * 1.000001, missing * 1.000001)
    raise BrokenPromise("the gap bound cannot be made wide enough to be never upside down")


def _tiers(
    where: SampleGrid, settings: GapSettings, lipschitz: Sequence[DimensionLipschitz], sides: Sequence[Sides]
) -> tuple[Tier, ...]:
    rough = [max(s.rough_share for s in own.values()) for own in sides]
    extra = ""
    if settings.padding == "inflate":
        pads = "; ".join(
            f"{n}: {max(s.padding for s in own.values()):.3g}" for n, own in zip(where.states, sides, strict=True)
        )
        extra = f"The padding uses the local slopes in each cell, less those of the fit; at most {pads}."
    directed = max(s.fit.directed for own in sides for s in own.values())
    factors = [max(s.fit.factor for s in own.values()) for own in sides]
    beside = directed_words(where.states, directed, factors)
    slopes = [known.grid for known in lipschitz]
    return guarantee(settings.padding, where.states, slopes, rough, f"{extra} {beside}".strip())
