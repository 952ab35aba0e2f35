"""Bounds that are tables over cells: a maximum for each block of cells, or a Lipschitz envelope around samples.

The envelope (set membership) solves no program: d lies within `sum_j L_ij |x_j - node_j|` of its value at a node
(Milanese & Novara 2004). Each cell uses its own node.
"""

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
        nx, inflated, h = len(where.states), settings.padding == "inflate", where.moving_half_widths
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
        nodes = tuple(0.5 * (e[:-1] + e[1:]) for e in edges)
        shares = zip([fit.rough_share for fit in fits], [known.grid.rough_share for known in lipschitz], strict=True)
        rough = [padded if inflated else estimated for padded, estimated in shares]
        directed, factors = max(fit.directed for fit in fits), [fit.factor for fit in fits]
        tiers = guarantee("inflate" if inflated else "cells", given, rough, directed, factors)
        return CellGap(where.domain, tiers, edges, nodes, lower, upper, np.zeros((nx, nx))), [{} for _ in fits]


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


@dataclass(frozen=True, eq=False)
class NodeFit(DimensionFit, kind="envelope", program="none: an envelope is made of samples and Lipschitz constants"):
    """Samples of one dimension at the nodes of an envelope: lower, upper (nodes, M), rounding included."""

    lower: Floats
    upper: Floats

    @classmethod
    def of(cls, samples: DimensionSamples, settings: GapSection) -> NodeFit:
        """The samples at the nodes."""
        places, cells = _nodes(samples.where), samples.where.grid.cells
        flat = np.ravel_multi_index(tuple(mesh(*places).T), cells)
        numerical = samples.floor / 16.0
        lower = samples.d[flat] - numerical
        upper = samples.ends[-1][flat] + numerical
        if not settings.signed:
            upper = np.maximum(upper, -lower)
            lower = -upper
        return cls(lower, upper)

    @classmethod
    def bound(cls, fits: Sequence[NodeFit], given: BoundInputs) -> tuple[CellGap, list[Sides]]:
        """The tables of all dimensions side by side, with their slopes.

        A cell whose envelope a sample on a border or beside a switching surface leaves is raised to cover it, with
        what slopes allow along the surface until the next such sample.
        """
        where, settings, lipschitz = given.where, given.settings, given.lipschitz
        nodes = tuple(where.grid.axis(j)[k] for j, k in enumerate(_nodes(where)))
        middle = [0.5 * (n[:-1] + n[1:]) for n in nodes]
        ends = zip(where.grid.box.lo, middle, where.grid.box.hi, strict=True)
        edges = tuple(np.concatenate([[lo], e, [hi]]) for lo, e, hi in ends)
        slopes = np.stack([known.grid.constants for known in lipschitz])
        rough = [known.grid.rough_share for known in lipschitz]
        lower, upper = (np.stack([getattr(fit, side) for fit in fits], axis=-1) for side in ("lower", "upper"))
        directed, factors = given.directed if where.known is None else (), []
        for i, own in enumerate(directed):
            numerical = float(where.rounding[i])
            above, rise = _raised(upper[:, :, i], where, (nodes, edges), slopes[i], own, own.side(True), numerical)
            below, fall = _raised(-lower[:, :, i], where, (nodes, edges), slopes[i], own, own.side(False), numerical)
            if not settings.signed:
                above = below = np.maximum(above, below)
            upper[:, :, i], lower[:, :, i] = above, -below
            factors.append(max(rise, fall))
        tiers = guarantee("cells", given, rough, len(directed[0].x) if directed else 0, factors)
        return CellGap(where.domain, tiers, edges, nodes, lower, upper, slopes), [{} for _ in fits]


def _raised(
    top: Floats, where: SampleGrid, table: tuple[Sequence[Floats], Sequence[Floats]], slopes: Floats, own: Directed,
    target: Floats, floor: float,
) -> tuple[Floats, float]:  # fmt: skip
    """Values at the nodes (nodes, M), raised where targets (E, M) leave their envelope; the factor of `SideFit`."""
    nodes, edges = table
    place = [np.clip(np.searchsorted(e, own.x[:, j], side="right") - 1, 0, len(e) - 2) for j, e in enumerate(edges)]
    cell = np.ravel_multi_index(tuple(place), tuple(len(n) for n in nodes))
    far = np.abs(own.x - np.stack([n[k] for n, k in zip(nodes, place, strict=True)], axis=1)) @ slopes
    beside, along = OffGrid(cell, own.at, target), np.where(own.at.fixed, 0.0, where.moving_half_widths) @ slopes
    steeper = np.zeros(target.shape)  # than the envelope is, along the surface
    for j, h in enumerate(where.moving_half_widths):
        steeper += np.where(own.at.fixed[:, [j]], 0.0, np.maximum(beside.moved(j, float(h)) - slopes[j] * h, 0.0))
    short = target + steeper - top[cell] - far[:, None]
    raised = top.copy()
    np.maximum.at(raised, cell, np.where(short > 0.0, top[cell] + short + along[:, None] + floor / 16.0, top[cell]))
    return raised, float(((short + far[:, None]) / np.maximum(far[:, None], floor)).max(initial=0.0))


MOST_NODES = 200_000
"""Numbers in the table of an envelope."""


def _nodes(where: SampleGrid) -> list[Ints]:
    """The samples along each axis that are nodes: every k-th one where a table would exceed `MOST_NODES` numbers."""
    cells, size, stride = where.grid.cells, len(where.inputs) * len(where.states), 1
    while np.prod([-(-c // stride) for c in cells]) * size > MOST_NODES and stride < max(cells):
        stride += 1
    return [np.arange(min(stride // 2, c - 1), c, stride) for c in cells]
