"""Pictures of the one-step margins: by how much gamma could grow at each winning cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.geometry import Floats, Grid
from simgap.io import figure_style as style
from simgap.notation import axis_label, pretty_unit

MAP = "cividis"  # one hue after another in order of lightness, alike to all kinds of colour vision
FACTOR = "gamma may grow by a factor of"


def plane_figure(grid: Grid, factor: Floats, extra: Floats, states: Sequence[str], units: Mapping[str, str]) -> Any:
    """Margins over two states: the common factor, and what may be added to each state alone.

    Args:
        grid: cells; factor: (cells,), extra: (cells, 2), not numbers where a cell does not win.
        states, units: names and units.
    """
    import matplotlib.pyplot as plt

    titles = ["factor on gamma", *(f"added to {n} alone ({pretty_unit(units.get(n, ''))})" for n in states)]
    figure, axes = plt.subplots(1, 3, figsize=(1.4 * style.WIDTH, 4.2), sharex=True, sharey=True)
    for axis, title, values in zip(axes, titles, (factor, *extra.T), strict=True):
        picture = _layer(axis, grid, values.reshape(grid.cells), _scale(values))
        axis.set_title(title)
        axis.set_xlabel(axis_label(states[0], units))
        bar = figure.colorbar(picture, ax=axis, orientation="horizontal", shrink=0.95)
        bar.ax.minorticks_off()
    axes[0].set_ylabel(axis_label(states[1], units))
    return figure


def slices_figure(grid: Grid, factor: Floats, states: Sequence[str], units: Mapping[str, str], count: int = 6) -> Any:
    """The common factor (cells,) over the first two states at `count` values of the third."""
    import matplotlib.pyplot as plt

    layers = np.unique((np.arange(count) * grid.cells[2]) // count)
    columns = min(3, len(layers))
    rows = -(-len(layers) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(style.WIDTH, 2.75 * rows + 0.5), sharex=True, sharey=True, squeeze=False
    )
    shown, scale = factor.reshape(grid.cells), _scale(factor)
    picture: Any = None
    for axis, k in zip(axes.ravel(), layers, strict=False):
        picture = _layer(axis, grid, shown[:, :, k], scale, "equal")
        third = grid.box.lo[2] + grid.h[2] * (2 * k + 1)
        axis.set_title(f"{states[2]} = {third:.2f} {pretty_unit(units.get(states[2], ''))}")
    for axis in axes[-1]:
        axis.set_xlabel(axis_label(states[0], units))
    for axis in axes[:, 0]:
        axis.set_ylabel(axis_label(states[1], units))
    figure.colorbar(picture, ax=axes, label=FACTOR, shrink=0.8).ax.minorticks_off()
    return figure


def _scale(values: Floats) -> Any:
    """A logarithmic scale over what occurs, the lowest thousandth cut off."""
    from matplotlib.colors import LogNorm

    known = values[np.isfinite(values) & (values > 0)]
    low, high = (float(v) for v in np.quantile(known, (0.001, 1.0))) if len(known) else (1.0, 10.0)
    return LogNorm(low, max(high, 1.01 * low))


def _layer(axis: Any, grid: Grid, values: Floats, scale: Any, aspect: str = "auto") -> Any:
    extent = (grid.box.lo[0], grid.box.hi[0], grid.box.lo[1], grid.box.hi[1])
    shown = np.ma.masked_invalid(np.where(values > 0, values, np.where(np.isnan(values), np.nan, scale.vmin)).T)
    axis.grid(visible=False)
    return axis.imshow(
        shown, origin="lower", extent=extent, aspect=aspect, cmap=MAP, norm=scale, interpolation="nearest"
    )
