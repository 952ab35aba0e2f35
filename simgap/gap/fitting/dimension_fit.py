"""Fits of one dimension and the gap function made of all of them: linear in a basis, or a table over blocks of cells.

What a bound rests on is said by its tiers (`guarantee`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.config.gap import BasisSection, GapSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Blocks
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import PROVEN, GapFunction, Tier
from simgap.gap.bounds.linear import Basis, Form, LinearGap, make_form, negated
from simgap.gap.fitting.acceptance import remedy
from simgap.gap.fitting.padding import (
    PaddedSide,
    SideFit,
    SideProblem,
    constant_padding,
    estimated_padding,
    fit_side,
    local_padding,
    padded,
)
from simgap.gap.fitting.scenario import Design
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.grid import DimensionLipschitz
from simgap.gap.lipschitz.local import OffGrid
from simgap.gap.sampling.borders import Directed
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import centres, combined, joined
from simgap.geometry import Box, Grid, mesh

Sides = dict[str, PaddedSide]
"""Fitted sides by name (`upper` and `lower`, or `both`)."""


class DimensionFit(JsonRecord, ABC):
    """Fit of one dimension; a form of bound is a subclass."""

    @classmethod
    @abstractmethod
    def of(cls, samples: DimensionSamples, settings: GapSection) -> Self:
        """Fit one dimension.

        Raises:
            UserError: for settings that do not fit the samples.
        """

    @classmethod
    @abstractmethod
    def bound(
        cls, fits: Sequence[Self], where: SampleGrid, settings: GapSection, lipschitz: Sequence[DimensionLipschitz]
    ) -> tuple[GapFunction, list[Sides]]:
        """The gap function of all dimensions, padded, and the fitted sides of each; none of a bound without a program.

        Raises:
            BrokenPromise: when the grid does not resolve a residual, or the bound stays upside down.
        """


def guarantee(
    padding: str, states: Sequence[str], lipschitz: Sequence[DimensionLipschitz], rough: Sequence[float], directed: int,
    factors: Sequence[float], extra: str = "",
) -> tuple[Tier, ...]:  # fmt: skip
    """Tiers of a padded bound.

    Args:
        padding: see `deterministic_tier`. states: their names. lipschitz: constants of each.
        rough: each state's share of cells with a jump that a sample stands in for.
        directed, factors: see `directed_words`. extra: a sentence on the padding.
    """
    slopes = [known.grid for known in lipschitz]
    if all(known.proven for known in slopes):
        return (PROVEN,)
    text = f"{extra} {directed_words(states, directed, factors)}".strip()
    return deterministic_tier(padding), estimate_tier(states, [known.constants for known in slopes], rough, text)


def deterministic_tier(padding: str) -> Tier:
    """Tier 1 for the three padding modes."""
    how = {
        "inflate": "the local Lipschitz constants of the gap on every cell; those of the basis are analytic",
        "per_axis": "the Lipschitz constants of the gap per axis; those of the basis are analytic bounds",
        "paper": "the Lipschitz constant of the gap; that of the basis is an analytic bound",
        "cells": "the Lipschitz constants of the gap per axis",
    }[padding]
    return Tier(1, f"The bound holds at every state of X and input of U, rounding included, given {how}.")


def estimate_tier(states: Sequence[str], lipschitz: Sequence[Floats], rough: Sequence[float], extra: str = "") -> Tier:
    """Tier 2: Lipschitz constants, (nx,) a state, are estimates; `rough` is each state's share of cells with a jump."""
    table = "; ".join(f"{s}: {', '.join(f'{v:.3g}' for v in row)}" for s, row in zip(states, lipschitz, strict=True))
    text = (
        "These Lipschitz constants are estimates (largest slope between neighbouring samples plus the local change "
        f"of slope), not bounds; per axis {table}."
    )
    jumps = [f"{100 * share:.2g} % of the cells for {s}" for s, share in zip(states, rough, strict=True) if share > 0]
    if jumps:
        text += (
            f" The gap jumps in {', '.join(jumps)}; there the spread of the neighbouring samples is used instead. It "
            "covers a jump between two samples, and misses a peak narrower than a cell by any factor."
        )
    return Tier(2, f"{text} {extra}".strip())


def directed_words(states: Sequence[str], count: int, factors: Sequence[float]) -> str:
    """Sentence on the samples on borders and beside switching surfaces; empty without them."""
    if not count:
        return ""
    table = ", ".join(f"{factor:.2g} for {s}" for s, factor in zip(states, factors, strict=True))
    return (
        f"{count:,} states on the border of X and on both sides of the switching surfaces that the case declares are "
        "covered too. Between the centre of its cell and such a state the gap rises by at most this factor times "
        f"what the slopes allow: {table}. Where a surface is not declared, that factor is unlimited."
    )


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
        basis = listed_basis(settings.basis, where.states, where.input_names, where.grid.box, where.free)
        design, blank = Design(basis, centres(where.grid), where.inputs), blank_form(basis, where)
        wanted = {"upper": (True,), "lower": (False,)} if settings.signed else {"both": (True, False)}
        problems = {name: SideProblem(design, samples, sides, blank) for name, sides in wanted.items()}
        return cls(basis.terms, {name: fit_side(problem, settings) for name, problem in problems.items()})

    @classmethod
    def bound(
        cls, fits: Sequence[LinearFit], where: SampleGrid, settings: GapSection, lipschitz: Sequence[DimensionLipschitz]
    ) -> tuple[LinearGap, list[Sides]]:
        """Pad every side and put the dimensions together."""
        blank = blank_form(Basis(fits[0].terms, where.states, where.input_names), where)
        sides: list[Sides] = []
        for i, (fit, known) in enumerate(zip(fits, lipschitz, strict=True)):
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
        tiers = _tiers(settings.padding, where.states, lipschitz, sides)
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


def _tiers(
    padding: str, states: Sequence[str], lipschitz: Sequence[DimensionLipschitz], sides: Sequence[Sides]
) -> tuple[Tier, ...]:
    def largest(name: str) -> list[Any]:
        return [max(getattr(side.fit, name) for side in own.values()) for own in sides]

    extra = ""
    if padding == "inflate":
        pads = "; ".join(f"{n}: {v:.3g}" for n, v in zip(states, largest("padding"), strict=True))
        extra = f"The padding uses the local slopes in each cell, less those of the fit; at most {pads}."
    rough, directed, factors = (largest(name) for name in ("rough_share", "directed", "factor"))
    return guarantee(padding, states, lipschitz, rough, max(directed), factors, extra)


@dataclass(frozen=True, eq=False)
class BlockFit(
    DimensionFit, kind="blocks", program="solved in closed form: on indicator functions of blocks, one maximum a block"
):
    """Largest values that the sides of one dimension have to cover on each block: the program solves itself.

    Attributes:
        upper, lower: (blocks, M), of d and of -d; padding `inflate` is in them, the others are not.
        rough_share: cells with a jump, as far as the local padding looked for them.
        directed: samples on borders and beside switching surfaces that are in the tables, too. factor: see `SideFit`.
    """

    upper: Floats
    lower: Floats
    rough_share: float
    directed: int = 0
    factor: float = 0.0

    @classmethod
    def of(cls, samples: DimensionSamples, settings: GapSection) -> BlockFit:
        """The scenario program on the basis of indicator functions of blocks, which solves itself: a maximum a block.

        Block borders lie on cell borders, so a cell belongs to one block and the padding of its sample covers it.

        Raises:
            UserError: for block counts that do not fit the grid.
        """
        counts = _counts(samples.where, settings)
        member, _ = _blocks(samples.where.grid, counts)
        tables, rough, factor, directed = {}, 0.0, 0.0, samples.beside
        for up in (True, False):
            padded, share, of_row = samples.side(up), 0.0, member
            if settings.padding == "inflate":
                pad, share = local_padding(samples, up).of()
                padded = combined(np.add, padded, pad)
            if directed is not None:
                beside, risen = _beside(samples, directed, settings, up)
                padded, factor = joined(padded, beside), max(factor, risen)
                of_row = np.concatenate([member, member[samples.where.grid.index(directed.x)]])
            tables[up] = np.full((int(np.prod(counts)), padded.shape[1]), -np.inf)
            for block in padded.blocks():
                np.maximum.at(tables[up], of_row[block], padded[block])
            rough = max(rough, share)
        return cls(tables[True], tables[False], rough, 0 if directed is None else len(directed.x), factor)

    @classmethod
    def bound(
        cls, fits: Sequence[BlockFit], where: SampleGrid, settings: GapSection, lipschitz: Sequence[DimensionLipschitz]
    ) -> tuple[CellGap, list[Sides]]:
        """The tables of all dimensions side by side, with the padding that is not in them yet."""
        _, edges = _blocks(where.grid, _counts(where, settings))
        inflated, h = settings.padding == "inflate", where.moving_half_widths
        pads = [0.0 if inflated else constant_padding(settings.padding, own.grid, h, 0.0 * h) for own in lipschitz]
        upper, below = (
            np.stack([getattr(fit, side) for fit in fits], axis=-1) + pads + where.rounding / 16.0
            for side in ("upper", "lower")
        )
        lower = -below
        if not settings.signed:
            upper = np.maximum(upper, -lower)
            lower = -upper
        upper = np.maximum(upper, lower)
        shares = zip([fit.rough_share for fit in fits], [known.grid.rough_share for known in lipschitz], strict=True)
        rough = [padded if inflated else estimated for padded, estimated in shares]
        directed, factors = max(fit.directed for fit in fits), [fit.factor for fit in fits]
        tiers = guarantee("inflate" if inflated else "cells", where.states, lipschitz, rough, directed, factors)
        return CellGap(where.domain, tiers, edges, lower, upper), [{} for _ in fits]


def _beside(samples: DimensionSamples, directed: Directed, settings: GapSection, up: bool) -> tuple[Floats, float]:
    """(E, M) target of a side beside the grid, padded along its surface with `inflate`; the factor of `SideFit`."""
    target, at = samples.side(up), directed.side(up)
    beside = OffGrid.of(directed, samples.where.grid, at)
    along, across = estimated_padding(samples, up).along(beside)
    factor = float(((at - target[beside.cells]) / np.maximum(across, samples.floor)).max())
    return at + (along if settings.padding == "inflate" else 0.0), max(factor, 0.0)


def _counts(where: SampleGrid, settings: GapSection) -> tuple[int, ...]:
    basis = settings.basis
    if not isinstance(basis, Blocks):
        raise UserError(f"the basis '{basis.kind}' has no blocks", key="gap.basis.kind", remedy="Use `blocks`.")
    counts = basis.blocks if basis.blocks is not None else tuple(min(8, c) for c in where.grid.cells)
    fits = len(counts) == len(where.grid.cells) and all(
        1 <= c <= cells for c, cells in zip(counts, where.grid.cells, strict=True)
    )
    if not fits:
        raise UserError(
            f"blocks {list(counts)} do not fit a sampling grid of {list(where.grid.cells)} cells",
            key="gap.basis.blocks",
            remedy="Give one count for each state, between 1 and the cells of the grid.",
        )
    return tuple(1 if j in where.free else c for j, c in enumerate(counts))


def _blocks(grid: Grid, counts: Sequence[int]) -> tuple[Ints, tuple[Floats, ...]]:
    """Block of each cell (N,) and the block borders per axis."""
    index, edges = [], []
    for j, (cells, count) in enumerate(zip(grid.cells, counts, strict=True)):
        of_cell = np.arange(cells) * count // cells
        index.append(of_cell)
        first = np.searchsorted(of_cell, np.arange(1, count))
        lo, hi = grid.box.lo[j], grid.box.hi[j]
        edges.append(np.concatenate([[lo], lo + 2.0 * grid.h[j] * first, [hi]]))
    return np.ravel_multi_index(tuple(mesh(*index).T), tuple(counts)), tuple(edges)


FITS: Mapping[str, type[DimensionFit]] = {"linear": LinearFit, "blocks": BlockFit}


def fit_dimension(samples: DimensionSamples, settings: GapSection) -> DimensionFit:
    """Fit one dimension; local slopes of the samples enter where they pad inside the program, no Lipschitz constant.

    Raises:
        UserError: for settings that do not fit the samples.
    """
    form = BlockFit if isinstance(settings.basis, Blocks) else LinearFit
    return form.of(samples, settings)


def fit_from_json(data: Mapping[str, Any]) -> DimensionFit:
    """A fit from what its `to_json` gave; KeyError, TypeError or ValueError for anything else."""
    return FITS[data["kind"]].from_json(data)
