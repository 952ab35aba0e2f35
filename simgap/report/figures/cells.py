"""Maps of values over cells: one in a panel, or a panel for each of several values of the third state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.geometry import Grid
from simgap.io import figure_style as style
from simgap.notation import axis_label, pretty_unit


def cell_map(axis: Any, grid: Grid, values: Any, aspect: str = "auto", **look: Any) -> Any:
    """The image of values of cells over the first two states, masked ones blank: (cells[0], cells[1])."""
    lo, hi = grid.box.lo, grid.box.hi
    axis.grid(visible=False)
    extent = (lo[0], hi[0], lo[1], hi[1])
    return axis.imshow(values.T, origin="lower", extent=extent, aspect=aspect, interpolation="nearest", **look)


def layer_panels(
    grid: Grid, layers: Sequence[int], states: Sequence[str], units: Mapping[str, str]
) -> tuple[Any, Any, list[tuple[Any, int]]]:
    """A figure with a panel for each layer of the third state: figure, all axes, and pairs of panel and layer."""
    columns = min(3, len(layers))
    rows = -(-len(layers) // columns)
    figure, axes = style.panels(rows, columns, 2.75 * rows + 0.5, sharex=True, sharey=True)
    pairs = list(zip(axes.ravel(), layers, strict=False))
    for axis, k in pairs:
        third = grid.box.lo[2] + grid.h[2] * (2 * k + 1)
        axis.set_title(f"{states[2]} = {third:.2f} {pretty_unit(units.get(states[2], ''))}")
    for axis in axes[-1]:
        axis.set_xlabel(axis_label(states[0], units))
    for axis in axes[:, 0]:
        axis.set_ylabel(axis_label(states[1], units))
    return figure, axes, pairs
