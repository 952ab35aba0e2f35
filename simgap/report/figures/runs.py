"""Pictures of the closed loop: states and gap over time, a robot among obstacles, and how long runs take."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.rerun.recording import PlanarScene, share_of_bound
from simgap.io.traces import BASELINE, EVERY_TITLE, GAP_AWARE, NOMINAL, SIMULATOR, TITLES, Trace, first_seconds, twin
from simgap.notation import axis_label
from simgap.report.figures.gap import places, scaled

UNSAFE, ON_MODEL = "#EFE3DC", "#6C727B"


def trajectories_figure(
    shown: Mapping[str, Trace], traces: Sequence[Trace], safe: Box, states: Sequence[str], inputs: Sequence[str],
    units: Mapping[str, str], stuck: float = 0.0, bands: Sequence[Sequence[tuple[str, float, float]]] = (),
) -> Any:  # fmt: skip
    """States and inputs over time: nominal-only and gap-aware side by side at first, then the latter to its end.

    Args:
        shown: run in the simulator by controller; traces: all, for the same start on the nominal model.
        safe: what is outside is shaded; states, inputs and units: names.
        stuck: a run of the simulator that is shorter, s, and does not violate ended without an admissible input.
        bands: of each state, named intervals that are asked for; none if empty.
    """
    from matplotlib.ticker import MaxNLocator

    window = first_seconds(shown)
    columns = [(NOMINAL, window), (GAP_AWARE, window), (GAP_AWARE, shown[GAP_AWARE].duration)]
    if window >= 0.8 * shown[GAP_AWARE].duration:
        columns.pop()
    rows = [*states, *inputs]
    height = 0.8 + 2.3 * len(states) + 1.4 * len(inputs)
    ratios = [2.3] * len(states) + [1.4] * len(inputs)
    figure, axes = style.panels(len(rows), len(columns), height, sharex="col", sharey="row", height_ratios=ratios)
    runs = [(shown[kind], twin(traces, shown[kind]), until) for kind, until in columns]
    for j in range(len(states)):
        ends = [_limits(*run, safe, j) for run in runs]  # a row has one axis
        axes[j, 0].set_ylim(min(lo for lo, _ in ends), max(hi for _, hi in ends))
        for name, lo, hi in bands[j] if bands else ():
            _named(axes[j], name, lo, hi)
    for k, (kind, until) in enumerate(columns):
        trace = shown[kind]
        for j in range(len(states)):
            _states(axes[j, k], *runs[k], safe, j)
            if trace.duration < stuck and not trace.violates:
                _stopped(axes[j, k], trace, j, COLOURS[kind])
        for j in range(len(inputs)):
            now = trace.t <= until
            axes[len(states) + j, k].step(trace.t[now], trace.u[now, j], where="post", color=COLOURS[kind], lw=1.2)
        title = TITLES[kind] if k < 2 else f"{TITLES[kind]}, whole run"
        axes[0, k].set_title(title, color=COLOURS[kind])
        axes[-1, k].set_xlabel("time (s)")
        axes[-1, k].xaxis.set_major_locator(MaxNLocator(3))
    for j, name in enumerate(rows):
        axes[j, 0].set_ylabel(axis_label(name, units))
    style.legend(figure)
    return figure


def _states(axis: Any, trace: Trace, model: Trace | None, until: float, safe: Box, j: int) -> None:
    for side, end in zip((safe.lo[j], safe.hi[j]), axis.get_ylim(), strict=True):
        if np.isfinite(side):
            axis.axhspan(min(side, end), max(side, end), color=UNSAFE, lw=0, label="unsafe")
            axis.axhline(side, color=style.GREEN, lw=1.2)
    if model is not None:
        axis.plot(model.t, model.x[:, j], color=ON_MODEL, lw=1.6, ls=(0, (4, 2)), label="nominal model")
        if model.duration < until and model.duration < trace.duration:
            _stopped(axis, model, j, ON_MODEL)
    axis.plot(trace.t, trace.x[:, j], color=COLOURS[trace.controller], lw=2.2, label="simulator")
    if trace.violates:
        axis.plot(trace.t[-1], trace.x[-1, j], "X", color=style.BLACK, ms=10, mec="white", zorder=5, label="violation")
    axis.set_xlim(0.0, until)


def _named(axes: Sequence[Any], name: str, lo: float, hi: float) -> None:
    """An interval that is asked for, on the axes of one state, with its name on the last of them."""
    low, high = axes[0].get_ylim()
    if low < hi and lo < high:
        face, edge = style.SURROUNDINGS.target
        for axis in axes:
            axis.axhspan(max(lo, low), min(hi, high), facecolor=face, edgecolor=edge, alpha=0.3, zorder=0)
        axes[-1].annotate(
            name, (1.0, min(max(lo, low) / 2 + min(hi, high) / 2, high)), xycoords=("axes fraction", "data"),
            xytext=(3, 0), textcoords="offset points", va="center", fontsize="small",
        )  # fmt: skip


def _limits(trace: Trace, model: Trace | None, until: float, safe: Box, j: int) -> tuple[float, float]:
    """Ends of the axis: the safe interval and the runs, with a margin."""
    seen = [t.x[t.t <= until, j] for t in (trace, model) if t is not None]
    ends = [v for v in (safe.lo[j], safe.hi[j]) if np.isfinite(v)]
    values = np.concatenate([*seen, ends])
    margin = 0.12 * (values.max() - values.min() or 1.0)
    return float(values.min() - margin), float(values.max() + margin)


def _stopped(axis: Any, trace: Trace, j: int, colour: str) -> None:
    """A bar at the end of a run that found no admissible input."""
    axis.plot(trace.t[-1], trace.x[-1, j], "|", color=colour, ms=13, mew=2.5, label="no admissible input")


def gap_figure(trace: Trace, states: Sequence[str], units: Mapping[str, str], until: float) -> Any:
    """A column a state: the gap of each step with its bound, and below where in its bound the gap lies."""
    figure, axes = style.panels(2, len(states), 4.8, sharex=True, height_ratios=[1.25, 1.0])
    share = share_of_bound(trace)
    own = (trace.t <= until) & np.isfinite(trace.d).all(axis=1)
    t = trace.t[own]
    for j, name in enumerate(states):
        d, lo, hi = (values[own, j] for values in (trace.d, trace.lo, trace.hi))
        factor, unit = scaled(float(np.abs(d).max(initial=0.0)), units[name])
        _band(axes[0, j], t, factor * d, factor * lo, factor * hi)
        axes[0, j].set_ylabel(f"gap of {name} ({unit})")
        axes[1, j].plot(t, share[own, j], ".", color=style.BLACK, ms=3)
        axes[1, j].set(xlabel="time (s)", xlim=(0.0, until))
    places(axes[1])
    style.legend(figure, markerscale=3)
    return figure


def _band(axis: Any, t: Floats, d: Floats, lo: Floats, hi: Floats) -> None:
    """A gap and its bound over time, which is not drawn where there is none."""
    known = np.isfinite(lo) & np.isfinite(hi)
    axis.fill_between(t[known], lo[known], hi[known], color=style.SKY, alpha=0.6, label="bound")
    for side in (hi, lo):
        axis.plot(t[known], side[known], color=style.BLUE, lw=0.8)
    axis.plot(t, d, ".", color=style.BLACK, ms=3, label="gap of each step")


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
