"""Pictures of the one-step margins: by how much gamma could grow at each winning cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Grid
from simgap.io import figure_style as style
from simgap.notation import axis_label, number, pretty_unit
from simgap.report.figures.cells import cell_map, layer_maps
from simgap.synthesis.margins import LARGEST_FACTOR, shown_layers

MAP = "cividis"  # one hue after another in order of lightness, alike to all kinds of colour vision
FACTOR = "gamma may grow by a factor of"
REACHED = 1e-5  # a margin this near to the largest that is looked for is that one: margins are rounded down


def plane_figure(grid: Grid, factor: Floats, extra: Floats, states: Sequence[str], units: Mapping[str, str]) -> Any:
    """Margins over two states: the common factor, and what may be added to each state alone.

    Args:
        grid: cells; factor: (cells,), extra: (cells, 2), not numbers where a cell does not win.
        states, units: names and units.
    """
    titles = ["factor on gamma", *(f"added to {n} alone ({pretty_unit(units.get(n, ''))})" for n in states)]
    figure, (axes,) = style.panels(1, 3, 4.2, 1.4 * style.WIDTH, sharex=True, sharey=True)
    most = (LARGEST_FACTOR, *(2.0 * grid.h * grid.cells).tolist())
    for axis, title, values, end in zip(axes, titles, (factor, *extra.T), most, strict=True):
        scale = _scale(values)
        picture = cell_map(axis, grid, _cut(values.reshape(grid.cells), scale), cmap=MAP, norm=scale)
        axis.set_title(title)
        axis.set_xlabel(axis_label(states[0], units))
        _ends(figure.colorbar(picture, ax=axis, orientation="horizontal", shrink=0.95), values, end)
    axes[0].set_ylabel(axis_label(states[1], units))
    return figure


def slices_figure(grid: Grid, factor: Floats, states: Sequence[str], units: Mapping[str, str], count: int = 6) -> Any:
    """The common factor (cells,) over the first two states at `count` values of the third, those with any."""
    shown, scale = factor.reshape(grid.cells), _scale(factor)
    layers = [k for k in shown_layers(grid.cells[2], count) if np.isfinite(shown[:, :, k]).any()] or [0]
    look = {"aspect": "equal", "cmap": MAP, "norm": scale}
    figure, bar = layer_maps(grid, _cut(shown, scale), layers, (states, units), FACTOR, **look)
    _ends(bar, factor, LARGEST_FACTOR)
    return figure


def _scale(values: Floats) -> Any:
    """A logarithmic scale over what occurs, the lowest thousandth cut off."""
    from matplotlib.colors import LogNorm

    known = values[np.isfinite(values) & (values > 0)]
    low, high = (float(v) for v in np.quantile(known, (0.001, 1.0))) if len(known) else (1.0, 10.0)
    return LogNorm(low, max(high, 1.01 * low))


def _ends(bar: Any, values: Floats, most: float) -> None:
    """Say at the ends of a colour bar that margins were looked for up to `most` only, and that small ones are cut."""
    bar.ax.minorticks_off()
    low, high = bar.norm.vmin, bar.norm.vmax
    known = values[values > 0]
    ticks = {float(tick): number(float(tick), 3) for tick in bar.get_ticks() if low < tick < high}
    row = "\n" if bar.orientation == "horizontal" else ""  # the ends have a row of their own, below the other ticks
    if len(known) and known.max() >= most * (1.0 - REACHED):
        ticks[high] = f"{row}\u2265 {number(float(high), 3)}"
    if len(known) and known.min() < low:
        ticks[low] = f"{row}\u2264 {low:.3g}"
    bar.set_ticks(list(ticks), labels=list(ticks.values()))
    if row:  # what stands at an end stays beside its own bar
        for label, tick in zip(bar.ax.get_xticklabels(), ticks, strict=True):
            label.set_ha("left" if tick == low else "right" if tick == high else "center")


def _cut(values: Floats, scale: Any) -> Any:
    """Margins as they are drawn: 0 at the low end of the scale, blank where there is none."""
    return np.ma.masked_invalid(np.where(values > 0, values, np.where(np.isnan(values), np.nan, scale.vmin)))
