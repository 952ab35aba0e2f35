"""What to do where the grid does not resolve a gap, or what a basis leaves of it."""

from __future__ import annotations

import numpy as np

from simgap.gap.kinds.blocks import Blocks
from simgap.gap.lipschitz.result import GridLipschitz
from simgap.gap.sampling.samples import SampleGrid
from simgap.gap.settings import GapSettings
from simgap.gap.thresholds import GATE


def remedy(where: SampleGrid, settings: GapSettings, found: GridLipschitz, share: float, residual: bool = False) -> str:
    """More samples; or, where something switches, a model that does the same, or a bound that takes the jump in.

    Args:
        where, settings: of the bound. found: what is known of the gap.
        share: of the cells that are rough. residual: whether in what the basis leaves.
    """
    if not found.layers:
        if residual:
            return "Use a smaller eps, or a basis that follows the gap."
        return f"Use {_finer(where, found)}, or padding: inflate with a larger rough_limit if a jump is known."
    local = "" if settings.padding == "inflate" and settings.bound != "envelope" else "padding: inflate and "
    limit = min(1.0, 0.05 * np.ceil(20.0 * share + 0.2))
    table = "" if isinstance(settings.basis, Blocks) else " with gap.basis: {kind: blocks}, which is wide there alone,"
    return (
        "Declare what switches in plant.effects too, if the model lacks it; or take the jump into the bound:"
        f"{table} {local}gap.lipschitz.rough_limit: {limit:.2g}; or use {_finer(where, found)}."
    )


def _finer(where: SampleGrid, found: GridLipschitz) -> str:
    """Where samples are missing: along which states, and how many cells there are now."""
    coarse = [(s, n) for s, n, r in zip(where.states, where.grid.cells, found.ratio, strict=True) if r > GATE]
    along = ", ".join(f"{name} (now {count})" for name, count in coarse)
    return (
        f"more cells along {along}: a smaller grid.eps or half-width (`simgap refine` says where)"
        if along
        else "a smaller grid.eps"
    )
