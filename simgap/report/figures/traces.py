"""Pictures of the closed loop over time: states against the safe set, and the gap against its bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.rerun.recording import share_of_bound
from simgap.io.traces import GAP_AWARE, NOMINAL, TITLES, Trace, twin
from simgap.notation import axis_label
from simgap.report.figures.gap import scaled

UNSAFE = "#EFE3DC"


def trajectories_figure(
    shown: Mapping[str, Trace], traces: Sequence[Trace], safe: Box, states: Sequence[str], units: Mapping[str, str],
    stuck: float = 0.0,
) -> Any:  # fmt: skip
    """States over time: nominal-only and gap-aware side by side at first, then the gap-aware run to its end.

    Args:
        shown: run in the simulator by controller; traces: all, for the same start on the nominal model.
        safe: what is outside is shaded; states and units: names.
        stuck: a run of the simulator that is shorter, s, and does not violate ended without an admissible input.
    """
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    window = first_seconds(shown)
    columns = [(NOMINAL, window), (GAP_AWARE, window), (GAP_AWARE, shown[GAP_AWARE].duration)]
    if window >= 0.8 * shown[GAP_AWARE].duration:
        columns.pop()
    size = (style.WIDTH, 0.8 + 2.3 * len(states))
    figure, axes = plt.subplots(len(states), len(columns), figsize=size, squeeze=False, sharex="col", sharey="row")
    for k, (kind, until) in enumerate(columns):
        trace = shown[kind]
        for j in range(len(states)):
            _states(axes[j, k], trace, twin(traces, trace), safe, j, until)
            if trace.duration < stuck and not trace.violates:
                axes[j, k].plot(trace.t[-1], trace.x[-1, j], "|", color=COLOURS[kind], ms=13, mew=2.5)
        title = TITLES[kind] if k < 2 else f"{TITLES[kind]}, whole run"
        axes[0, k].set_title(title, color=COLOURS[kind])
        axes[-1, k].set_xlabel("time (s)")
        axes[-1, k].xaxis.set_major_locator(MaxNLocator(3))
    for j, name in enumerate(states):
        axes[j, 0].set_ylabel(axis_label(name, units))
    _legend(figure)
    return figure


def first_seconds(shown: Mapping[str, Trace]) -> float:
    """How much of the runs is shown enlarged: enough to see the shortest one end, s."""
    durations = [t.duration for t in shown.values()]
    return max(0.05 * max(durations), min(max(durations), 6.0 * min(durations)))


def _states(axis: Any, trace: Trace, model: Trace | None, safe: Box, j: int, until: float) -> None:
    lo, hi = _limits(trace, model, safe, j, until)
    for side, end in ((safe.lo[j], lo), (safe.hi[j], hi)):
        if np.isfinite(side):
            axis.axhspan(min(side, end), max(side, end), color=UNSAFE, lw=0)
            axis.axhline(side, color=style.GREEN, lw=1.2)
    if model is not None:
        axis.plot(model.t, model.x[:, j], color="#6C727B", lw=1.6, ls=(0, (4, 2)))
        if model.duration < until and model.duration < trace.duration:
            axis.plot(model.t[-1], model.x[-1, j], "|", color="#6C727B", ms=13, mew=2.5)
    axis.plot(trace.t, trace.x[:, j], color=COLOURS[trace.controller], lw=2.2)
    if trace.violates:
        axis.plot(trace.t[-1], trace.x[-1, j], "X", color=style.BLACK, ms=10, mec="white", zorder=5)
    axis.set_xlim(0.0, until)
    axis.set_ylim(lo, hi)


def _limits(trace: Trace, model: Trace | None, safe: Box, j: int, until: float) -> tuple[float, float]:
    """What the axis shows: the safe interval and the runs, with a margin."""
    seen = [t.x[t.t <= until, j] for t in (trace, model) if t is not None]
    ends = [v for v in (safe.lo[j], safe.hi[j]) if np.isfinite(v)]
    values = np.concatenate([*seen, ends])
    margin = 0.12 * (values.max() - values.min() or 1.0)
    return float(values.min() - margin), float(values.max() + margin)


def _legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    named = {
        "simulator": (Line2D([], [], color=style.BLUE, lw=2.2), Line2D([], [], color=style.VERMILLION, lw=2.2)),
        "nominal model": Line2D([], [], color="#6C727B", ls=(0, (4, 2))),
        "no admissible input": Line2D([], [], color="#6C727B", marker="|", ls="", ms=13, mew=2.5),
        "violation": Line2D([], [], color=style.BLACK, marker="X", ls="", mec="white", ms=10),
        "unsafe": Patch(facecolor=UNSAFE, edgecolor=style.GREEN),
    }
    style.legend(figure, named, 5)


def gap_figure(trace: Trace, states: Sequence[str], units: Mapping[str, str], until: float) -> Any:
    """A column a state: the gap of each step with its bound, and below where in its bound the gap lies."""
    import matplotlib.pyplot as plt

    size, heights = (style.WIDTH, 4.8), [1.25, 1.0]
    figure, axes = plt.subplots(2, len(states), figsize=size, squeeze=False, sharex=True, height_ratios=heights)
    share = share_of_bound(trace)
    own = (trace.t <= until) & np.isfinite(trace.d).all(axis=1)
    t = trace.t[own]
    for j, name in enumerate(states):
        bounded = np.isfinite(trace.lo[own, j]) & np.isfinite(trace.hi[own, j])
        _band(axes[0, j], t, trace, own, j, bounded, name, units[name])
        axes[1, j].axhspan(-1, 1, color=style.SKY, alpha=0.3, lw=0)
        axes[1, j].plot(t, share[own, j], ".", color=style.BLACK, ms=3)
        axes[1, j].set_ylim(-1.25, 1.25)
        axes[1, j].set_yticks([-1, 0, 1], ["lower", "middle", "upper"])
        axes[1, j].set_xlabel("time (s)")
        axes[1, j].set_xlim(0.0, until)
    axes[1, 0].set_ylabel("place in the bound")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2, markerscale=3)
    return figure


def _band(axis: Any, t: Floats, trace: Trace, own: Any, j: int, bounded: Any, name: str, unit: str) -> None:
    d, lo, hi = trace.d[own, j], trace.lo[own, j], trace.hi[own, j]
    factor, label = scaled(float(np.abs(d).max(initial=0.0)), unit)
    axis.fill_between(t[bounded], factor * lo[bounded], factor * hi[bounded], color=style.SKY, alpha=0.6, label="bound")
    axis.plot(t[bounded], factor * hi[bounded], color=style.BLUE, lw=0.8)
    axis.plot(t[bounded], factor * lo[bounded], color=style.BLUE, lw=0.8)
    axis.plot(t, factor * d, ".", color=style.BLACK, ms=3, label="gap of each step")
    axis.set_ylabel(f"gap of {name} ({label})")
