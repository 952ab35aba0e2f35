"""Maps of values over cells: one in a panel, or a panel for each of several values of the third state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.geometry import Grid
from simgap.io import figure_style as style
from simgap.notation import axis_label, pretty_unit


def cell_map(axis: Any, grid: Grid, values: Any, aspect: str = "auto", **look: Any) -> Any:
    """The image of values of cells over the first two states, masked ones blank: (cells[0], cells[1])."""
    axis.grid(visible=False)
    extent = tuple(np.stack([grid.box.lo, grid.box.hi], axis=1)[:2].ravel())
    return axis.imshow(values.T, origin="lower", extent=extent, aspect=aspect, interpolation="nearest", **look)


def layer_maps(
    grid: Grid, values: Any, layers: Sequence[int], names: tuple[Sequence[str], Mapping[str, str]], label: str,
    aspect: str = "auto", **look: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """Values (c0, c1, c2) over the first two states, a panel for each layer of the third: the figure and its bar.

    `names`: states, and their units. `label`: of the colour bar; without one there is none.
    """
    (states, units), columns = names, min(3, len(layers))
    rows = -(-len(layers) // columns)
    figure, axes = style.panels(rows, columns, 2.75 * rows + 0.5, sharex=True, sharey=True)
    for axis, k in zip(axes.ravel(), layers, strict=False):
        picture = cell_map(axis, grid, values[:, :, k], aspect, **look)
        third = grid.box.lo[2] + grid.h[2] * (2 * k + 1)
        axis.set_title(f"{states[2]} = {third:.2f} {pretty_unit(units.get(states[2], ''))}")
    for axis in axes[-1]:
        axis.set_xlabel(axis_label(states[0], units))
    for axis in axes[:, 0]:
        axis.set_ylabel(axis_label(states[1], units))
    return figure, figure.colorbar(picture, ax=axes, label=label, shrink=0.8) if label else None
