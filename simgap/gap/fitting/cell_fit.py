"""Piecewise constant bounds: on each block of cells the largest sampled gap, padded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.gap.bases import Blocks
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.tiers import directed_words, guarantee
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.result import DimensionLipschitz
from simgap.gap.sampling.samples import DimensionSamples, Directed, SampleGrid
from simgap.gap.sampling.values import Combined, Joined, Values
from simgap.gap.settings import GapSettings
from simgap.geometry import Grid


@dataclass(frozen=True, eq=False)
class BlockFit(
    JsonRecord, kind="blocks", program="solved in closed form: on indicator functions of blocks, one maximum a block"
):
    """Largest values that the sides of one dimension have to cover on each block: the program solves itself.

    Attributes:
        upper, lower: (blocks, M or 1), of d and of -d; padding `inflate` is in them, the others are not.
        rough_share: cells with a jump, as far as the local padding looked for them.
        directed: samples on borders and beside switching surfaces that are in the tables, too. factor: see `SideFit`.
    """

    upper: Floats
    lower: Floats
    rough_share: float
    directed: int = 0
    factor: float = 0.0


def fit_blocks(samples: DimensionSamples, settings: GapSettings) -> BlockFit:
    """The scenario program on the basis of indicator functions of blocks, which solves itself: one maximum a block.

    Block borders lie on cell borders, so a cell belongs to one block and the padding of its sample covers it.

    Raises:
        UserError: for block counts that do not fit the grid.
    """
    counts, per_input = _counts(samples.where, settings)
    member, _ = _blocks(samples.where.grid, counts)
    tables, rough, factor, directed = {}, 0.0, 0.0, samples.beside
    for up in (True, False):
        padded, share = _locally_padded(samples, settings, up)
        of_row = member
        if directed is not None:
            beside, risen = _beside(samples, directed, settings, up)
            padded, factor = Joined(padded, beside), max(factor, risen)
            of_row = np.concatenate([member, member[samples.where.grid.index(directed.x)]])
        tables[up] = np.full((int(np.prod(counts)), padded.shape[1] if per_input else 1), -np.inf)
        for first, last in padded.blocks():
            own = padded.rows(first, last)
            np.maximum.at(tables[up], of_row[first:last], own if per_input else own.max(axis=1, keepdims=True))
        rough = max(rough, share)
    return BlockFit(tables[True], tables[False], rough, 0 if directed is None else len(directed.x), factor)


def _beside(samples: DimensionSamples, directed: Directed, settings: GapSettings, up: bool) -> tuple[Floats, float]:
    """(E, M) target of a side beside the grid, padded along its surface with `inflate`; the factor of `SideFit`."""
    from simgap.gap.lipschitz.local import Beside, LocalPadding

    where, target, at = samples.where, samples.side(up), directed.side(up)
    cells = where.grid.index(directed.x)
    own = LocalPadding(target, where.grid, where.free, samples.floor)
    along, across = own.along(Beside(cells, directed.at, at))
    factor = float(((at - target.take(cells)) / np.maximum(across, samples.floor)).max())
    return at + (along if settings.padding == "inflate" else 0.0), max(factor, 0.0)


def blocks_gap(
    where: SampleGrid, settings: GapSettings, fits: Sequence[BlockFit], lipschitz: Sequence[DimensionLipschitz]
) -> CellGap:
    """The tables of all dimensions side by side, with the padding that is not in them yet."""
    _, edges = _blocks(where.grid, _counts(where, settings)[0])
    nx, inflated = len(where.states), settings.padding == "inflate"
    sides = []
    for name in ("upper", "lower"):
        padded = [
            getattr(fit, name) + (0.0 if inflated else _reach(where, settings, known)) + floor / 16.0
            for fit, known, floor in zip(fits, lipschitz, where.rounding, strict=True)
        ]
        sides.append(np.stack(padded, axis=-1))
    upper, lower = sides[0], -sides[1]
    if not settings.signed:
        upper = np.maximum(upper, -lower)
        lower = -upper
    upper = np.maximum(upper, lower)
    nodes = tuple(0.5 * (e[:-1] + e[1:]) for e in edges)
    rough = [
        fit.rough_share if inflated else known.grid.rough_share for fit, known in zip(fits, lipschitz, strict=True)
    ]
    used = [known.grid for known in lipschitz]
    beside = directed_words(where.states, max(fit.directed for fit in fits), [fit.factor for fit in fits])
    tiers = guarantee("inflate" if inflated else "cells", where.states, used, rough, beside)
    return CellGap(where.domain, tiers, edges, nodes, lower, upper, np.zeros((nx, nx)))


def _reach(where: SampleGrid, settings: GapSettings, known: DimensionLipschitz) -> float:
    """How far the gap may move within a cell, by its Lipschitz constants."""
    h = where.moving_half_widths
    if settings.padding == "per_axis":
        return float(known.grid.constants @ h)
    return float(known.grid.euclidean * np.linalg.norm(h))


def _locally_padded(samples: DimensionSamples, settings: GapSettings, up: bool) -> tuple[Values, float]:
    """(N, M) target of one side, with its local padding if that is the case's, and the share of rough cells."""
    from simgap.gap.fitting.padding import local_padding

    target = samples.side(up)
    if settings.padding != "inflate":
        return target, 0.0
    pad, share = local_padding(samples, up).of_target()
    return Combined(np.add, (target, pad)), share


def _counts(where: SampleGrid, settings: GapSettings) -> tuple[tuple[int, ...], bool]:
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
    counts = tuple(1 if j in where.free else c for j, c in enumerate(counts))
    return counts, basis.per_input


def _blocks(grid: Grid, counts: Sequence[int]) -> tuple[Ints, tuple[Floats, ...]]:
    """Block of each cell (N,) and the block borders per axis."""
    index, edges = [], []
    for j, (cells, count) in enumerate(zip(grid.cells, counts, strict=True)):
        of_cell = np.arange(cells) * count // cells
        index.append(of_cell)
        first = np.searchsorted(of_cell, np.arange(1, count))
        lo, hi = grid.box.lo[j], grid.box.hi[j]
        edges.append(np.concatenate([[lo], lo + 2.0 * grid.h[j] * first, [hi]]))
    mesh = np.meshgrid(*index, indexing="ij")
    return np.ravel_multi_index(tuple(m.ravel() for m in mesh), tuple(counts)), tuple(edges)
