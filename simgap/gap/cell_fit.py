"""Bounds on cells from samples: piecewise constant on blocks, and the Lipschitz envelope (set membership)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.errors import UserError
from simgap.gap.cells import CellGap
from simgap.gap.lipschitz.grid import GridLipschitz
from simgap.gap.lipschitz.local import LocalPadding
from simgap.gap.samples import GapSamples
from simgap.gap.settings import GapSettings
from simgap.gap.tiers import Tier, deterministic_tier, estimate_tier
from simgap.geometry import Floats, Grid


def fit_blocks(samples: GapSamples, settings: GapSettings, lipschitz: Sequence[GridLipschitz]) -> CellGap:
    """The scenario program on the basis of indicator functions of blocks, which solves itself: one maximum a block.

    Block borders lie on cell borders, so a cell belongs to one block and the padding of its sample covers it.

    Raises:
        UserError: for block counts that do not fit the grid.
    """
    counts, per_input = _counts(samples, settings)
    member, edges = _blocks(samples.grid, counts)
    n, nx = int(np.prod(counts)), len(samples.states)
    columns = len(samples.inputs) if per_input else 1
    tables = {True: np.empty((n, columns, nx)), False: np.empty((n, columns, nx))}
    rough = []
    for i, found in enumerate(lipschitz):
        for up in (True, False):
            tables[up][:, :, i], share = _block_maxima(samples, settings, i, up, member, n, per_input, found)
        rough.append(share)
    lower, upper = -tables[False], tables[True]
    if not settings.signed:
        upper = np.maximum(upper, -lower)
        lower = -upper
    upper = np.maximum(upper, lower)
    nodes = tuple(0.5 * (e[:-1] + e[1:]) for e in edges)
    kind = "cells" if settings.padding != "inflate" else "inflate"
    tiers = (deterministic_tier(kind), estimate_tier(samples.states, [f.constants for f in lipschitz], rough))
    return CellGap(samples.domain, tiers, edges, nodes, lower, upper, np.zeros((nx, nx)))


def _counts(samples: GapSamples, settings: GapSettings) -> tuple[tuple[int, ...], bool]:
    options = dict(settings.basis_options)
    given = options.get("blocks", tuple(min(8, c) for c in samples.grid.cells))
    counts = tuple(int(c) for c in given) if isinstance(given, Sequence) else ()
    fits = len(counts) == len(samples.grid.cells) and all(
        1 <= c <= cells for c, cells in zip(counts, samples.grid.cells, strict=True)
    )
    if not fits:
        raise UserError(
            f"blocks {list(counts)} do not fit a sampling grid of {list(samples.grid.cells)} cells",
            key="gap.basis.blocks",
            remedy="Give one count for each state, between 1 and the cells of the grid.",
        )
    counts = tuple(1 if j in samples.free else c for j, c in enumerate(counts))
    return counts, bool(options.get("per_input", True))


def _blocks(grid: Grid, counts: Sequence[int]) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], tuple[Floats, ...]]:
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


def _block_maxima(
    samples: GapSamples, settings: GapSettings, i: int, up: bool,
    member: np.ndarray[tuple[int], np.dtype[np.int64]], n: int, per_input: bool, found: GridLipschitz,
) -> tuple[Floats, float]:  # fmt: skip
    target, floor = samples.side(i, up), float(samples.rounding[i])
    if settings.padding == "inflate":
        pad, share = LocalPadding(target, samples.grid, samples.free, floor).of_target()
    else:
        h = np.where(np.isin(np.arange(len(found.constants)), samples.free), 0.0, samples.grid.h)
        reach = found.constants @ h if settings.padding == "per_axis" else found.euclidean * np.linalg.norm(h)
        pad, share = np.full_like(target, reach), found.rough_share
    padded = target + pad + floor / 16.0
    if not per_input:
        padded = padded.max(axis=1, keepdims=True)
    table = np.full((n, padded.shape[1]), -np.inf)
    np.maximum.at(table, member, padded)
    return table, share


def fit_envelope(samples: GapSamples, settings: GapSettings, lipschitz: Sequence[GridLipschitz]) -> CellGap:
    """Set membership: d lies within `sum_j L_ij |x_j - node_j|` of its value at a node (Milanese & Novara 2004).

    Each cell uses its own node. When the table would exceed `envelope_nodes` numbers, every k-th sample along each
    axis is a node.
    """
    grid, m, nx = samples.grid, len(samples.inputs), len(samples.states)
    stride = 1
    while np.prod([-(-c // stride) for c in grid.cells]) * m * nx > settings.envelope_nodes and stride < max(
        grid.cells
    ):
        stride += 1
    kept = [np.arange(min(stride // 2, c - 1), c, stride) for c in grid.cells]
    nodes = tuple(grid.axis(j)[k] for j, k in enumerate(kept))
    middle = [0.5 * (n[:-1] + n[1:]) for n in nodes]
    edges = tuple(np.concatenate([[grid.box.lo[j]], e, [grid.box.hi[j]]]) for j, e in enumerate(middle))
    flat = np.ravel_multi_index(tuple(k.ravel() for k in np.meshgrid(*kept, indexing="ij")), grid.cells)
    numerical = samples.rounding / 16.0
    lower = samples.d[flat] - numerical
    upper = (samples.d if samples.d_upper is None else samples.d_upper)[flat] + numerical
    if not settings.signed:
        upper = np.maximum(upper, -lower)
        lower = -upper
    slopes = np.stack([found.constants for found in lipschitz])
    tiers: tuple[Tier, ...] = (
        deterministic_tier("cells"),
        estimate_tier(samples.states, list(slopes), [f.rough_share for f in lipschitz]),
    )
    return CellGap(samples.domain, tiers, edges, nodes, lower, upper, slopes)
