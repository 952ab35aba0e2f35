"""Bounds that are tables: a maximum for each block of cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.config.gap import GapSection
from simgap.errors import UserError
from simgap.gap.bases import Blocks
from simgap.gap.bounds.cells import CellGap
from simgap.gap.fitting.dimension_fit import BoundInputs, DimensionFit, Sides, guarantee
from simgap.gap.fitting.padding import constant_padding, estimated_padding, local_padding
from simgap.gap.lipschitz.local import OffGrid
from simgap.gap.sampling.borders import Directed
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import combined, joined
from simgap.geometry import Grid, mesh


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
    def bound(cls, fits: Sequence[BlockFit], given: BoundInputs) -> tuple[CellGap, list[Sides]]:
        """The tables of all dimensions side by side, with the padding that is not in them yet."""
        where, settings, lipschitz = given.where, given.settings, given.lipschitz
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
        tiers = guarantee("inflate" if inflated else "cells", given, rough, directed, factors)
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
