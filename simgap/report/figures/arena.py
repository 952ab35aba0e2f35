"""Pictures of a robot on a floor: the runs of both controllers among obstacles, and how long they take."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.rerun.recording import PlanarScene
from simgap.io.traces import BASELINE, EVERY_TITLE, GAP_AWARE, NOMINAL, SIMULATOR, TITLES, Trace
from simgap.notation import axis_label

FOOTPRINTS = 7


def arena_figure(
    scene: PlanarScene,
    traces: Sequence[Trace],
    units: Mapping[str, str],
    states: Sequence[str],
    surroundings: Callable[[Any], None],
) -> Any:
    """The arena twice: the nominal-only controller's runs on the left, the gap-aware one's on the right.

    Args:
        scene: arena, obstacles, target and footprint; traces: those in the simulator in colour, on the model in grey.
        units, states: of the axes; surroundings: draws arena, obstacles and target on axes.
    """
    figure, axes = style.panels(1, 2, 5.2, sharex=True, sharey=True)
    for axis, kind in zip(axes[0], (NOMINAL, GAP_AWARE), strict=True):
        surroundings(axis)
        _frame(axis, scene)
        for trace in traces:
            if trace.controller == kind:
                _run(axis, scene, trace, COLOURS[kind] if trace.plant == SIMULATOR else style.GREY)
        axis.set_title(TITLES[kind], color=COLOURS[kind])
        axis.set_xlabel(axis_label(states[scene.axes[0]], units))
    axes[0, 0].set_ylabel(axis_label(states[scene.axes[1]], units))
    style.legend(figure)
    return figure


def _frame(axis: Any, scene: PlanarScene) -> None:
    (x, y), margin = np.stack([scene.arena.lo, scene.arena.hi]).T, 0.03 * float(np.max(scene.arena.hi - scene.arena.lo))
    axis.set(xlim=(x[0] - margin, x[1] + margin), ylim=(y[0] - margin, y[1] + margin), aspect="equal")
    axis.grid(visible=False)


def _run(axis: Any, scene: PlanarScene, trace: Trace, colour: str) -> None:
    simulated = trace.plant == SIMULATOR
    x, y = (trace.x[:, j] for j in scene.axes[:2])
    if not simulated:
        axis.plot(x, y, color=colour, lw=1.1, ls=(0, (4, 2)), zorder=4, label="nominal model")
        return
    axis.plot(x, y, color=colour, lw=1.6, zorder=4, label="simulator")
    for k in np.unique(np.linspace(0, len(x) - 1, FOOTPRINTS).astype(int)):
        _footprint(axis, scene, trace.x[k], colour)
    axis.plot(x[0], y[0], "o", color=colour, ms=6, mec="white", mew=0.8, zorder=6)
    if trace.violates:
        first = int(np.flatnonzero(~trace.safe)[0])
        _footprint(axis, scene, trace.x[first], style.BLACK)
        axis.plot(x[first], y[first], "X", color=style.BLACK, ms=10, mec="white", zorder=7, label="collision")


def _footprint(axis: Any, scene: PlanarScene, x: Floats, colour: str) -> None:
    """A circle of the robot's size with a nose."""
    from matplotlib.patches import Circle

    centre, heading = x[list(scene.axes[:2])], x[scene.axes[2]]
    nose = centre + scene.radius * np.array([np.cos(heading), np.sin(heading)])
    axis.add_patch(Circle((centre[0], centre[1]), scene.radius, facecolor="none", edgecolor=colour, lw=0.9, zorder=5))
    axis.plot(*np.column_stack([centre, nose]), color=colour, lw=0.9, zorder=5)


def times_figure(steps: Mapping[str, Sequence[int]], tau: float, promised: int | None = None) -> Any:
    """Histogram of the times to the target, for each controller.

    Args:
        steps: by controller, steps to the target of the runs that reach it; tau: sampling time, s.
        promised: steps within which the gap-aware controller arrives from any winning cell, whatever the gap within
            gamma; None: nothing is drawn.
    """
    figure, ((axis,),) = style.panels(1, 1, 3.0)
    kinds = [kind for kind in (NOMINAL, BASELINE, GAP_AWARE) if len(steps.get(kind, ()))]
    own = {kind: tau * np.asarray(steps[kind], dtype=float) for kind in kinds}
    longest = max([float(t.max()) for t in own.values()] + ([tau * promised] if promised else []))
    bins = np.linspace(0.0, longest, 41).tolist()
    for kind, t in own.items():
        label = f"{EVERY_TITLE[kind]}: {len(t):,} runs, median {np.median(t):g} s, longest {t.max():g} s"
        axis.hist(t, bins, histtype="stepfilled", color=COLOURS[kind], alpha=0.35, label=label)
        axis.hist(t, bins, histtype="step", color=COLOURS[kind], lw=1.6)
    if promised:
        label = f"promised by the gap-aware controller from any winning state: {tau * promised:g} s"
        axis.axvline(tau * promised, color=COLOURS[GAP_AWARE], ls=(0, (4, 2)), lw=1.8, label=label)
    axis.set(xlabel="time to the target (s)", ylabel="runs", xlim=(0.0, 1.02 * longest if promised else longest))
    style.legend(figure, 1)
    return figure
