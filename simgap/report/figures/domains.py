"""Pictures of the winning domains, in the plane or in slices, with the runs in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.traces import NOMINAL, ROBUST, SIMULATOR, TITLES, Trace
from simgap.notation import axis_label, pretty_unit
from simgap.synthesis.controller import Controller

_PALE = {ROBUST: "#BBD9EC", NOMINAL: "#F6D3BC"}


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
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(style.WIDTH, 4.0), sharex=True, sharey=True)
    for axis, kind in zip(axes, (NOMINAL, ROBUST), strict=True):
        controller = controllers[kind]
        _region(axis, controller, _PALE[kind])
        if surroundings is not None:
            surroundings(axis)
        other = controllers[ROBUST if kind == NOMINAL else NOMINAL]
        _outline(axis, other, COLOURS[ROBUST if kind == NOMINAL else NOMINAL])
        for trace in traces:
            if trace.controller == kind and trace.plant == SIMULATOR:
                _run(axis, trace, COLOURS[kind])
        axis.set_title(f"{TITLES[kind]}: {100.0 * controller.solution.fraction:.1f} % of the cells")
        axis.set_xlabel(axis_label(controller.states[0], units))
        axis.grid(visible=False)
    axes[0].set_ylabel(axis_label(controllers[ROBUST].states[1], units))
    _legend(figure, bool(traces), violated)
    return figure


def _region(axis: Any, controller: Controller, colour: str) -> None:
    from matplotlib.colors import ListedColormap

    box = controller.grid.box
    winning = controller.solution.winning.reshape(controller.grid.cells)
    shown = np.ma.masked_equal(winning.T, False)
    extent = (box.lo[0], box.hi[0], box.lo[1], box.hi[1])
    axis.imshow(
        shown, origin="lower", extent=extent, aspect="auto", cmap=ListedColormap([colour]), interpolation="nearest"
    )


def _outline(axis: Any, controller: Controller, colour: str) -> None:
    grid = controller.grid
    winning = np.pad(controller.solution.winning.reshape(grid.cells).T.astype(float), 1)
    centres = [grid.box.lo[j] + grid.h[j] * (2.0 * np.arange(-1, grid.cells[j] + 1) + 1.0) for j in (0, 1)]
    if winning.any():
        axis.contour(*centres, winning, levels=[0.5], colors=[colour], linewidths=1.4, linestyles="--")


def _run(axis: Any, trace: Trace, colour: str) -> None:
    axis.plot(trace.x[:, 0], trace.x[:, 1], color=colour, lw=1.2)
    axis.plot(*trace.x[0, :2], "o", color=colour, ms=6, mec="white", mew=0.8)
    if trace.violates:
        axis.plot(*trace.x[-1, :2], "X", color=style.BLACK, ms=10, mec="white", mew=1.0, clip_on=False, zorder=5)


def _legend(figure: Any, runs: bool, violated: str) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(color="#C9CDD2"),
        Line2D([], [], color=style.GREY, ls="--"),
        Line2D([], [], color=style.GREY, marker="o", mec="white", ms=7),
        Line2D([], [], color=style.BLACK, marker="X", ls="", mec="white", ms=10),
    ]
    labels = ["winning domain", "outline of the other one", "run in the simulator", violated]
    shown = 4 if runs else 2
    figure.legend(handles[:shown], labels[:shown], loc="outside upper left", ncols=4, columnspacing=1.1)


def slices_figure(
    controller: Controller, units: Mapping[str, str], count: int = 6, values: bool = True, title: str = ""
) -> Any:
    """Winning domain over the first two states at `count` values of the third, shaded by steps to the target.

    White cells lose; without a value function all winning cells have one shade.
    """
    import matplotlib.pyplot as plt

    grid = controller.grid
    solution = controller.solution
    field = solution.at_first(solution.value) if values and solution.value is not None else None
    shades = np.where(solution.winning, 0 if field is None else field, -1).reshape(grid.cells).astype(float)
    shades = np.ma.masked_less(shades, 0.0)
    layers = np.unique((np.arange(count) * grid.cells[2]) // count)
    columns = min(3, len(layers))
    rows = -(-len(layers) // columns)
    size = (style.WIDTH, 2.75 * rows + 0.5)
    figure, axes = plt.subplots(rows, columns, figsize=size, sharex=True, sharey=True, squeeze=False)
    extent = (grid.box.lo[0], grid.box.hi[0], grid.box.lo[1], grid.box.hi[1])
    picture, most = None, max(1.0, float(np.max(shades.filled(0.0))))
    for axis, k in zip(axes.ravel(), layers, strict=False):
        look = {"cmap": "viridis_r", "vmin": 0.0, "vmax": most, "interpolation": "nearest"}
        picture = axis.imshow(shades[:, :, k].T, origin="lower", extent=extent, **look)
        third = grid.box.lo[2] + grid.h[2] * (2 * k + 1)
        axis.set_title(f"{controller.states[2]} = {third:.2f} {pretty_unit(units.get(controller.states[2], ''))}")
        axis.grid(visible=False)
    for axis in axes[-1]:
        axis.set_xlabel(axis_label(controller.states[0], units))
    for axis in axes[:, 0]:
        axis.set_ylabel(axis_label(controller.states[1], units))
    if picture is not None and field is not None:
        figure.colorbar(picture, ax=axes, label=title or "worst-case steps to the target", shrink=0.8)
    return figure
