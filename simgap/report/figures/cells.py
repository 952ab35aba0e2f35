"""Maps over cells: the winning domains with the runs in them, and the one-step margins, in the plane or in slices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.geometry import Grid
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.traces import GAP_AWARE, NOMINAL, SIMULATOR, TITLES, Trace
from simgap.notation import axis_label, number, pretty_unit
from simgap.synthesis.controller import Controller
from simgap.synthesis.margins import AROUND, ASKED, BESIDE, CAUSES, CELLS, GAMMA, LARGEST_FACTOR, NOTHING, shown_layers


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


SLICES = 6
_PALE = {GAP_AWARE: "#BBD9EC", NOMINAL: "#F6D3BC"}


def domains_figure(
    controllers: Mapping[str, Controller],
    traces: Sequence[Trace],
    units: Mapping[str, str],
    surroundings: Callable[[Any], None] | None = None,
    violated: str = "violation",
) -> Any:
    """The winning domains of both controllers over two states, each with its runs in the simulator.

    Args:
        controllers: by kind, "nominal" and "gap"; two states each.
        traces: runs; those in the simulator are drawn, with a cross where they violate.
        units: of the states; surroundings: draws the specification on axes.
        violated: what the cross at the end of a run says.
    """
    figure, ((left, right),) = style.panels(1, 2, 4.0, sharex=True, sharey=True)
    free = max(1, *(int(own.solution.free.sum()) for own in controllers.values()))  # one whole for both shares
    for axis, kind in ((left, NOMINAL), (right, GAP_AWARE)):
        controller = controllers[kind]
        _region(axis, controller, _PALE[kind])
        if surroundings is not None:
            surroundings(axis)
        other = GAP_AWARE if kind == NOMINAL else NOMINAL
        _outline(axis, controllers[other], COLOURS[other])
        for trace in traces:
            if trace.controller == kind and trace.plant == SIMULATOR:
                _run(axis, trace, COLOURS[kind], violated)
        share = controller.solution.winning.sum() / free
        axis.set_title(f"{TITLES[kind]}: {100.0 * share:.1f} % of the cells")
        axis.set_xlabel(axis_label(controller.states[0], units))
    left.set_ylabel(axis_label(controllers[GAP_AWARE].states[1], units))
    style.legend(figure)
    return figure


def _region(axis: Any, controller: Controller, colour: str) -> None:
    from matplotlib.colors import ListedColormap

    winning = controller.solution.winning.reshape(controller.grid.cells)
    cell_map(axis, controller.grid, np.ma.masked_equal(winning, False), cmap=ListedColormap([colour]))
    axis.fill([], [], color=colour, label="winning domain")  # a map has no place in a legend


def _outline(axis: Any, controller: Controller, colour: str) -> None:
    grid = controller.grid
    winning = np.pad(controller.solution.winning.reshape(grid.cells).T.astype(float), 1)
    centres = [grid.box.lo[j] + grid.h[j] * (2.0 * np.arange(-1, grid.cells[j] + 1) + 1.0) for j in (0, 1)]
    if winning.any():
        axis.contour(*centres, winning, levels=[0.5], colors=[colour], linewidths=1.4, linestyles="--")
    axis.plot([], [], color=colour, ls="--", lw=1.4, label="outline of the other domain")  # nor has a contour


def _run(axis: Any, trace: Trace, colour: str, violated: str) -> None:
    begin = {"marker": "o", "markevery": [0], "ms": 6, "mec": "white", "mew": 0.8}
    axis.plot(trace.x[:, 0], trace.x[:, 1], color=colour, lw=1.2, label="run in the simulator", **begin)
    if trace.violates:
        cross = {"color": style.BLACK, "ms": 10, "mec": "white", "mew": 1.0, "clip_on": False, "zorder": 5}
        axis.plot(*trace.x[-1, :2], "X", label=violated, **cross)


def domain_slices_figure(controller: Controller, units: Mapping[str, str], goal: str) -> Any:
    """Winning domain over the first two states at `SLICES` values of the third, shaded by steps to the target.

    White cells lose; without a value function all winning cells have one shade.
    """
    grid, solution = controller.grid, controller.solution
    field = solution.at_first(solution.value) if solution.value is not None else None
    shades = np.where(solution.winning, 0 if field is None else field, -1).reshape(grid.cells).astype(float)
    layers = np.unique((np.arange(SLICES) * grid.cells[2]) // SLICES).tolist()
    look: dict[str, Any] = {"cmap": "viridis_r", "vmin": 0.0, "vmax": max(1.0, float(shades.max()))}
    label = f"worst-case steps to {goal}" if field is not None else ""
    return layer_maps(grid, np.ma.masked_less(shades, 0.0), layers, (controller.states, units), label, **look)[0]


MAP = "cividis"  # one hue after another in order of lightness, alike to all kinds of colour vision
FACTOR = "gamma may grow by a factor of"
LOST = {GAMMA: "#F3B49F", CELLS: "#E3CDE0", AROUND: "#E4E6EA", BESIDE: "#BFE3D4", ASKED: "#C9CCD3"}
"""Colours of what cells are lost to, pale beside those of margins."""
REACHED = 1e-5  # a margin this near to the largest that is looked for is that one: margins are rounded down


def margins_figure(grid: Grid, factor: Floats, loses_by: Ints, states: Sequence[str], units: Mapping[str, str]) -> Any:
    """The factor (cells,) over two states or, of three, over the first two at `SLICES` values of the third, with any.

    Cells that lose have the colour of what they lose by, `loses_by` (cells,).
    """
    won = np.where(factor >= 1.0, factor, np.nan)
    values, causes, scale = won.reshape(grid.cells), loses_by.reshape(grid.cells), _scale(won)
    if len(states) == 2:
        figure, ((axis,),) = style.panels(1, 1, 4.4)
        picture = cell_map(axis, grid, _cut(values, scale), cmap=MAP, norm=scale)
        axis.set(xlabel=axis_label(states[0], units), ylabel=axis_label(states[1], units))
        bar, maps = figure.colorbar(picture, ax=axis, label=FACTOR), [causes]
    else:
        layers = [k for k in shown_layers(grid.cells[2], SLICES) if np.isfinite(values[:, :, k]).any()] or [0]
        look = {"aspect": "equal", "cmap": MAP, "norm": scale}
        figure, bar = layer_maps(grid, _cut(values, scale), layers, (states, units), FACTOR, **look)
        maps = [causes[:, :, k] for k in layers]
    _causes(figure.axes[: len(maps)], maps, grid, figure)
    _ends(bar, won, LARGEST_FACTOR)
    return figure


def _causes(axes: Sequence[Any], maps: Sequence[Any], grid: Grid, figure: Any) -> None:
    """What losing cells lose by, in pale colours on maps (c0, c1), with a legend of those that occur."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap(list(LOST.values()))
    for axis, values in zip(axes, maps, strict=True):
        shown = np.ma.masked_equal(values, NOTHING)
        cell_map(axis, grid, shown, axis.get_aspect(), cmap=colours, vmin=GAMMA - 0.5, vmax=ASKED + 0.5)
        for cause in np.unique(shown.compressed()):
            axis.fill([], [], color=LOST[cause], label=f"lost to {CAUSES[cause]}")  # a map has no place in a legend
    style.legend(figure)


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
    if len(known) and known.max() >= most * (1.0 - REACHED):
        ticks[high] = f"\u2265 {number(float(high), 3)}"
    if len(known) and known.min() < low:
        ticks[low] = f"\u2264 {low:.3g}"
    bar.set_ticks(list(ticks), labels=list(ticks.values()))


def _cut(values: Floats, scale: Any) -> Any:
    """Margins as they are drawn: 0 at the low end of the scale, blank where there is none."""
    return np.ma.masked_invalid(np.where(values > 0, values, np.where(np.isnan(values), np.nan, scale.vmin)))
