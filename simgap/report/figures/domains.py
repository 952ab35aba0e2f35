"""Pictures of the winning domains, in the plane or in slices, with the runs in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.traces import GAP_AWARE, NOMINAL, SIMULATOR, TITLES, Trace
from simgap.notation import axis_label
from simgap.report.figures.cells import cell_map, layer_maps
from simgap.synthesis.controller import Controller

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
        axis.set_title(f"{TITLES[kind]}: {100.0 * controller.solution.fraction:.1f} % of the cells")
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


def slices_figure(controller: Controller, units: Mapping[str, str]) -> Any:
    """Winning domain over the first two states at `SLICES` values of the third, shaded by steps to the target.

    White cells lose; without a value function all winning cells have one shade.
    """
    grid, solution = controller.grid, controller.solution
    field = solution.at_first(solution.value) if solution.value is not None else None
    shades = np.where(solution.winning, 0 if field is None else field, -1).reshape(grid.cells).astype(float)
    layers = np.unique((np.arange(SLICES) * grid.cells[2]) // SLICES).tolist()
    look: dict[str, Any] = {"cmap": "viridis_r", "vmin": 0.0, "vmax": max(1.0, float(shades.max()))}
    label = "worst-case steps to the target" if field is not None else ""
    return layer_maps(grid, np.ma.masked_less(shades, 0.0), layers, (controller.states, units), label, **look)[0]
