"""The Lipschitz envelope around samples (set membership): no program is solved.

d lies within `sum_j L_ij |x_j - node_j|` of its value at a node (Milanese & Novara 2004). Each cell uses its own node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.tiers import directed_words, guarantee
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.local import Beside
from simgap.gap.lipschitz.result import DimensionLipschitz
from simgap.gap.sampling.samples import DimensionSamples, Directed, SampleGrid
from simgap.gap.settings import GapSettings


@dataclass(frozen=True, eq=False)
class NodeFit(JsonRecord, kind="envelope", program="none: an envelope is made of samples and Lipschitz constants"):
    """Samples of one dimension at the nodes of an envelope: lower, upper (nodes, M), rounding included."""

    lower: Floats
    upper: Floats


def fit_envelope(samples: DimensionSamples, settings: GapSettings) -> NodeFit:
    """The samples at the nodes."""
    kept = _kept(samples.where, settings)
    flat = np.ravel_multi_index(tuple(k.ravel() for k in np.meshgrid(*kept, indexing="ij")), samples.where.grid.cells)
    numerical = samples.floor / 16.0
    lower = samples.d.take(flat) - numerical
    upper = samples.ends[-1].take(flat) + numerical
    if not settings.signed:
        upper = np.maximum(upper, -lower)
        lower = -upper
    return NodeFit(lower, upper)


def envelope_gap(
    where: SampleGrid, settings: GapSettings, fits: Sequence[NodeFit], lipschitz: Sequence[DimensionLipschitz],
    directed: Sequence[Directed] = (),
) -> CellGap:  # fmt: skip
    """The tables of all dimensions side by side, with their slopes.

    A cell whose envelope a sample on a border or beside a switching surface leaves is raised to cover it, with what
    slopes allow along the surface until the next such sample.
    """
    nodes = tuple(where.grid.axis(j)[k] for j, k in enumerate(_kept(where, settings)))
    middle = [0.5 * (n[:-1] + n[1:]) for n in nodes]
    ends = zip(where.grid.box.lo, middle, where.grid.box.hi, strict=True)
    edges = tuple(np.concatenate([[lo], e, [hi]]) for lo, e, hi in ends)
    slopes = np.stack([known.grid.constants for known in lipschitz])
    rough = [known.grid.rough_share for known in lipschitz]
    lower, upper = (np.stack([getattr(fit, side) for fit in fits], axis=-1) for side in ("lower", "upper"))
    factors = []
    for i, own in enumerate(directed):
        numerical = float(where.rounding[i])
        above, rise = _raised(upper[:, :, i], where, (nodes, edges), slopes[i], own, own.side(True), numerical)
        below, fall = _raised(-lower[:, :, i], where, (nodes, edges), slopes[i], own, own.side(False), numerical)
        if not settings.signed:
            above = below = np.maximum(above, below)
        upper[:, :, i], lower[:, :, i] = above, -below
        factors.append(max(rise, fall))
    beside = directed_words(where.states, len(directed[0].x) if directed else 0, factors)
    tiers = guarantee("cells", where.states, [known.grid for known in lipschitz], rough, beside)
    return CellGap(where.domain, tiers, edges, nodes, lower, upper, slopes)


def _raised(
    top: Floats, where: SampleGrid, table: tuple[Sequence[Floats], Sequence[Floats]], slopes: Floats, own: Directed,
    target: Floats, floor: float,
) -> tuple[Floats, float]:  # fmt: skip
    """Values at the nodes (nodes, M), raised where targets (E, M) leave their envelope; the factor of `SideFit`."""
    nodes, edges = table
    place = [np.clip(np.searchsorted(e, own.x[:, j], side="right") - 1, 0, len(e) - 2) for j, e in enumerate(edges)]
    cell = np.ravel_multi_index(tuple(place), tuple(len(n) for n in nodes))
    far = np.abs(own.x - np.stack([n[k] for n, k in zip(nodes, place, strict=True)], axis=1)) @ slopes
    beside, along = Beside(cell, own.at, target), np.where(own.at.fixed, 0.0, where.moving_half_widths) @ slopes
    steeper = np.zeros(target.shape)  # than the envelope is, along the surface
    for j, h in enumerate(where.moving_half_widths):
        steeper += np.where(own.at.fixed[:, [j]], 0.0, np.maximum(beside.moved(j, float(h)) - slopes[j] * h, 0.0))
    short = target + steeper - top[cell] - far[:, None]
    raised = top.copy()
    np.maximum.at(raised, cell, np.where(short > 0.0, top[cell] + short + along[:, None] + floor / 16.0, top[cell]))
    return raised, float(((short + far[:, None]) / np.maximum(far[:, None], floor)).max(initial=0.0))


def _kept(where: SampleGrid, settings: GapSettings) -> list[Ints]:
    """The samples along each axis that are nodes: every k-th one where a table would exceed `envelope_nodes`."""
    cells, size, stride = where.grid.cells, len(where.inputs) * len(where.states), 1
    while np.prod([-(-c // stride) for c in cells]) * size > settings.envelope_nodes and stride < max(cells):
        stride += 1
    return [np.arange(min(stride // 2, c - 1), c, stride) for c in cells]
