"""The pictures of a diagnosis, each from plain arrays to a matplotlib figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.diagnosis.reading.table import Floats
from simgap.diagnosis.verdict.missing import Binned, Missing
from simgap.diagnosis.verdict.words import phrase
from simgap.io import figure_style as style
from simgap.notation import axis_label, pretty_unit

MOST_POINTS = 1500
NO_LESS = 0.5  # of chi^2/dof that is shown


@dataclass(frozen=True, eq=False)
class Overlay:
    """Data beside what the models predict, over one stretch.

    Attributes:
        trace: name of the trace.
        t: (n,) s.
        measured, before, after: (n, k); predictions are nan where no window is, and start anew with each window.
        u: (n, m) inputs.
        states, inputs: names of the columns.
        sigma: (k,) noise of the channels.
        held_out: stretches (from, to) that were never fitted, s.
        whole: whether all of it was never fitted.
    """

    trace: str
    t: Floats
    measured: Floats
    before: Floats
    after: Floats
    u: Floats
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sigma: Floats
    held_out: tuple[tuple[float, float], ...] = ()
    whole: bool = True


def overlay_figure(o: Overlay, units: Mapping[str, str]) -> Any:
    """Measured against predicted, and the residuals below each other, for every measured state; the inputs last."""
    import matplotlib.pyplot as plt

    rows = 2 * len(o.states) + (1 if o.inputs else 0)
    heights = [2.4, 1.5] * len(o.states) + ([1.2] if o.inputs else [])
    figure, axes = plt.subplots(
        rows, 1, sharex=True, figsize=(style.WIDTH, sum(heights) + 0.6), height_ratios=heights, squeeze=False
    )
    pick = np.arange(0, o.t.size, max(1, o.t.size // MOST_POINTS))
    for k, name in enumerate(o.states):
        top, low = axes[2 * k, 0], axes[2 * k + 1, 0]
        top.plot(o.t[pick], o.measured[pick, k], color=style.MEASURED, lw=3.2, alpha=0.35, label="measured")
        top.plot(o.t[pick], o.before[pick, k], color=style.BEFORE, ls=(0, (5, 2)), label="before")
        top.plot(o.t[pick], o.after[pick, k], color=style.AFTER, lw=1.3, label="after")
        top.set_ylabel(axis_label(name, units))
        for predicted, colour, dash in ((o.before, style.BEFORE, (0, (5, 2))), (o.after, style.AFTER, "-")):
            low.plot(o.t[pick], (o.measured - predicted)[pick, k], color=colour, ls=dash, lw=1.3)
        low.axhspan(-2 * o.sigma[k], 2 * o.sigma[k], color=style.FLOOR, alpha=0.35, lw=0, label="noise, ±2σ")
        low.set_ylabel(f"residual\n{axis_label(name, units)}")
    if o.inputs:
        colours = (style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
        for j, name in enumerate(o.inputs):
            axes[-1, 0].step(o.t[pick], o.u[pick, j], where="post", lw=1.2, color=colours[j % 4], label=name)
        axes[-1, 0].set_ylabel(axis_label(o.inputs[0], units) if len(o.inputs) == 1 else "inputs")
        if len(o.inputs) > 1:
            axes[-1, 0].legend(loc="upper right", ncols=4)
    for axis in axes[:, 0]:
        for a, b in () if o.whole else o.held_out:
            axis.axvspan(a, b, color=style.YELLOW, alpha=0.25, lw=0, label="never fitted")
    axes[0, 0].set_title(f"{o.trace}: " + ("never fitted" if o.whole else "shaded windows were never fitted"))
    axes[-1, 0].set_xlabel("time (s)")
    figure.align_ylabels()
    entries = [axis.get_legend_handles_labels() for axis in axes[:2, 0]]
    named = {label: handle for handles, labels in entries for handle, label in zip(handles, labels, strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside upper left", ncols=5, columnspacing=1.2)
    return figure


def missing_figure(m: Missing) -> Any:
    """The missing term against each regressor, under the nominal and under the corrected model."""
    import matplotlib.pyplot as plt

    names = list(m.before)[:3]
    figure, axes = plt.subplots(1, len(names), sharey=True, figsize=(style.WIDTH, 3.5), squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        _errorbars(axis, m.before[name], style.BEFORE, "s", "before")
        _errorbars(axis, m.after[name], style.AFTER, "o", "after")
        axis.axhline(0.0, color="#55595F", lw=1.0)
        axis.set_xlabel(axis_label(name, m.units))
    axes[0, 0].set_ylabel(f"missing {_folded(m.label)}\n({pretty_unit(m.unit)})")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


def _folded(label: str) -> str:
    return label.replace(" at ", "\nat ")


def _errorbars(axis: Any, b: Binned, colour: str, marker: str, label: str) -> None:
    axis.errorbar(
        b.centre, b.mean, yerr=b.half, color=colour, marker=marker, ms=5, lw=1.4, elinewidth=1.1, capsize=0, label=label
    )


def ranking_figure(
    candidates: Sequence[Mapping[str, Any]], chosen: Sequence[Mapping[str, Any]], quality: Mapping[str, float]
) -> Any:
    """What is left of chi^2 with each candidate fitted alone, as numbers beside bars, between no effect and the answer.

    Args:
        candidates: those that were fitted have `chi2_dof`; chosen: the answer; quality: chi^2/dof before and after.
    """
    import matplotlib.pyplot as plt
    from matplotlib.patches import Patch

    fitted = sorted((c for c in candidates if c.get("chi2_dof") is not None), key=lambda c: float(c["chi2_dof"]))
    keys = {(e["name"], e["on"]) for e in chosen}
    rows = [("the model as declared", float(quality["before"]), style.BEFORE)]
    rows += [
        (phrase(c), float(c["chi2_dof"]), style.SKY if (c["name"], c["on"]) in keys else "#CBD1D8") for c in fitted[:12]
    ]
    rows += [
        (
            "the answer" if len(keys) < 2 else f"the {len(keys)} of the answer together",
            float(quality["after"]),
            style.AFTER,
        )
    ]
    figure, axis = plt.subplots(figsize=(style.WIDTH, 1.3 + 0.36 * max(len(rows), 3)))
    for y, (_, left, colour) in enumerate(rows[::-1]):
        axis.barh(y, max(left, NO_LESS), color=colour, height=0.7, left=0.0)
        axis.annotate(f" {left:.4g}", (max(left, NO_LESS), y), va="center", fontsize=11)
    axis.set_yticks(range(len(rows)), [name for name, *_ in rows[::-1]])
    axis.set_xscale("log")
    axis.set_xlim(NO_LESS, 6.0 * max(left for _, left, _ in rows))
    axis.axvline(1.0, color="#55595F", lw=1.4, ls=(0, (4, 2)))
    axis.set_xlabel("chi²/dof that is left (log); 1 is the noise (dashed)")
    axis.grid(axis="y", visible=False)
    handles = [Patch(color=c) for c in (style.BEFORE, style.SKY, "#CBD1D8", style.AFTER)]
    labels = ["no effect", "in the answer, alone", "not in the answer, alone", "answer"]
    figure.legend(handles, labels, loc="outside upper left", ncols=4, columnspacing=1.2)
    return figure


def error_figure(error: Mapping[str, Any], units: Mapping[str, str]) -> Any:
    """Error h seconds ahead on held-out data: before, after and the floor of a perfect model, one panel a state."""
    import matplotlib.pyplot as plt

    states = list(error["before"]["horizon_rmse"])
    figure, axes = plt.subplots(1, len(states), figsize=(style.WIDTH, 3.2), squeeze=False)
    rows = (
        ("noise_floor", style.FLOOR, "perfect\nmodel"),
        ("after", style.AFTER, "after"),
        ("before", style.BEFORE, "before"),
    )
    for axis, state in zip(axes[0], states, strict=True):
        for y, (which, colour, _) in enumerate(rows):
            value = float(error[which]["horizon_rmse"][state])
            axis.barh(y, value, color=colour, height=0.66)
            axis.annotate(f" {value:.3g}", (value, y), va="center", fontsize=11)
        axis.set_yticks(range(3), [label for _, _, label in rows])
        axis.set_xlabel(f"RMS error {error['before']['horizon_s']:g} s ahead, {axis_label(state, units)}")
        axis.margins(x=0.18)
        axis.grid(axis="y", visible=False)
    return figure
