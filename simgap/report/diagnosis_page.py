"""The pictures and the page of a diagnosis, of a plant or of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY
from simgap.diagnosis.verdict.words import phrase
from simgap.io import figure_style as style
from simgap.io.pages import render
from simgap.notation import axis_label, joined, number, pretty_unit
from simgap.report.explorer import Row, explored, line
from simgap.report.missing import Missing

TEMPLATE, ARM_TEMPLATE = "diagnosis.html.j2", "arm_diagnosis.html.j2"
MOST_OVERLAYS, WINDOWS_SHOWN = 2, 6
MOST_ARM_TRACES = 3
MOST_SAMPLES = 4000
"""Samples of a trace that are drawn: a page stays below two megabytes with the script in it."""


def stretches(windows: Sequence[WindowPrediction]) -> list[list[WindowPrediction]]:
    """A few windows around a held-out one, for the first traces that have any."""
    held = [w for w in windows if w.held_out] or list(windows)
    out = []
    for trace in list(dict.fromkeys(w.trace for w in held))[:MOST_OVERLAYS]:
        own = sorted((w for w in windows if w.trace == trace), key=lambda w: float(w.t[0]))
        centre = next((k for k in range(len(own) // 2, len(own)) if own[k].held_out), len(own) // 2)
        first = min(max(0, centre - WINDOWS_SHOWN // 2), max(0, len(own) - WINDOWS_SHOWN))
        out.append(own[first : first + WINDOWS_SHOWN])
    return out


def draw(
    document: Mapping[str, Any],
    windows: Sequence[WindowPrediction],
    names: tuple[Sequence[str], Sequence[str]],
    missing: Sequence[Missing],
    folder: Path,
) -> dict[str, Any]:
    """All figures: SVG files in `folder`, their text for the page, and the curves that are `explored` there.

    `names`: of measured states and of inputs.
    """
    held, units = [w for w in windows if w.held_out] or list(windows), document["units"]
    own = sorted((w for w in windows if w.trace == held[0].trace), key=lambda w: float(w.t[0]))
    texts: dict[str, Any] = {"error": "", "steps": "", "explored": explored_predictions(own, names[0], units)}
    with style.figure_style():
        if document["error"]["before"]["horizon_rmse"]:
            texts["error"] = style.drawn(folder / "error.svg", error_figure, document["error"], units)
        content = names[0], units, document["noise"], names[1]
        texts["overlays"] = [
            (shown[0].trace, style.drawn(folder / f"measured-{k}.svg", overlay_figure, shown, *content))
            for k, shown in enumerate(stretches(windows), start=1)
        ]
        texts["missing"] = [
            (m.label, style.drawn(folder / f"residual-{k}.svg", missing_figure, m))
            for k, m in enumerate(missing, start=1)
        ]
        if document["steps"]:
            texts["steps"] = style.drawn(folder / "steps.svg", steps_figure, document["steps"])
    return texts


def draw_arm(
    document: Mapping[str, Any], traces: Sequence[WindowPrediction], inputs: Sequence[str], folder: Path
) -> dict[str, Any]:
    """Figures as those of `draw`, of an arm: errors of its torques, and the longest of its traces."""
    longest, units = sorted(traces, key=lambda p: -len(p.t))[:MOST_ARM_TRACES], document["units"]
    before, after = (document["error"][side]["fit_rmse"] for side in ("before", "after"))
    with style.figure_style():
        return {
            "error": style.drawn(folder / "error.svg", torque_error_figure, before, after, inputs, units),
            "overlays": [
                (p.trace, style.drawn(folder / f"torques-{k + 1}.svg", overlay_figure, [p], inputs, units))
                for k, p in enumerate(longest)
            ],
            "explored": explored_predictions(longest[:1], inputs, units) if longest else None,
        }


def page(document: Mapping[str, Any], title: str, figures: Mapping[str, Any], template: str = TEMPLATE) -> str:
    """The page as one HTML text."""
    folds = {name: _fold(fold) for name, fold in document["folds"].items()}
    limits = {"bic": BIC_GAIN, "chi2": FIT_QUALITY, "rmse": FIT_QUALITY**0.5}
    return render(template, d=document, title=title, figures=figures, folds=folds, limits=limits)


def _fold(fold: Mapping[str, Any]) -> str:
    windows = fold["windows"]
    more = len(windows) - 5 if len(windows) > 6 else 0
    by_trace = groupby(windows[: len(windows) - more], key=itemgetter("trace"))
    spans = [f"{joined([_span(w) for w in own])} s of {trace}" for trace, own in by_trace]
    return joined([*fold["traces"], *spans, *([f"{more} more stretches"] if more else [])])


def _span(window: Mapping[str, Any]) -> str:
    return f"{number(window['from'])} to {number(window['to'])}"


def explored_predictions(
    windows: Sequence[WindowPrediction], names: Sequence[str], units: Mapping[str, str]
) -> dict[str, Any]:
    """Measured and predicted values of one trace, a row for each name: windows in order, with a break between them."""
    ends = np.cumsum([len(w.t) for w in windows])
    t, lines = in_sequence(windows[: max(1, int(np.searchsorted(ends, MOST_SAMPLES)))])
    dashes = {word: "dash" if "ls" in look else "solid" for word, look in LOOKS.items()}
    rows = [
        Row(axis_label(n, units), [line(w, t, lines[w][:, k], LOOKS[w]["color"], dash) for w, dash in dashes.items()])
        for k, n in enumerate(names)
    ]
    return explored(rows, float(t[-1]), float(t[0]))


LOOKS: dict[str, dict[str, Any]] = {
    "measured": {"color": style.MEASURED, "lw": 3.2, "alpha": 0.35},
    "before": {"color": style.BEFORE, "ls": (0, (5, 2))},
    "after": {"color": style.AFTER, "lw": 1.3},
}
COLUMNS = (*LOOKS, "inputs")
INPUTS = (style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
MOST_POINTS = 1500
NO_LESS = 0.5  # of chi^2/dof that is shown
MOST_OPTIONS = 5  # of a step that are drawn
TAKEN = (style.AFTER, 5.0, 8.0, "taken")
NOT_TAKEN = ("#8A929B", 2.5, 6.0, "fitted there, not taken")
"""Colour, width of the line, size of the dot and words of an option of a step."""


def in_sequence(windows: Sequence[WindowPrediction]) -> tuple[Floats, dict[str, Floats]]:
    """Times (n,), and `measured`, `before`, `after`, `inputs` by name, (n, k) each; NaN follows each window."""
    t = np.concatenate([np.append(w.t, w.t[-1]) for w in windows])
    rows = {k: [np.pad(getattr(w, k), ((0, 1), (0, 0)), constant_values=np.nan) for w in windows] for k in COLUMNS}
    return t, {k: np.concatenate(own) for k, own in rows.items()}


def overlay_figure(
    windows: Sequence[WindowPrediction], names: Sequence[str], units: Mapping[str, str],
    noise: Mapping[str, float] | None = None, inputs: Sequence[str] = (),
) -> Any:  # fmt: skip
    """Measured against predicted for every name; residuals before and after where a noise is known; the inputs last.

    Args:
        windows: of one trace, in order; predictions start anew with each.
        names: of the columns; units: by name; noise: name -> standard deviation; inputs: names of their columns.
    """
    t, curves = in_sequence(windows)
    pick = np.arange(0, t.size, max(1, t.size // MOST_POINTS))
    whole, each = all(w.held_out for w in windows), [2.4, 1.1, 1.1] if noise else [1.5]
    heights = each * len(names) + ([1.2] if inputs else [])
    figure, axes = style.panels(len(heights), 1, sum(heights) + 0.6, sharex=True, height_ratios=heights)
    for k, name in enumerate(names):
        top, *low = axes[len(each) * k : len(each) * (k + 1), 0]
        for word, look in LOOKS.items():
            top.plot(t[pick], curves[word][pick, k], label=word, **look)
        top.set_ylabel(axis_label(name, units))
        for axis, word in zip(low, ("before", "after"), strict=False):  # each on its own scale, or no noise were seen
            wide = 2 * (noise or {})[name]
            axis.axhspan(-wide, wide, color=style.FLOOR, alpha=0.45, lw=0, label="noise, ±2σ")
            axis.plot(t[pick], (curves["measured"] - curves[word])[pick, k], **LOOKS[word] | {"lw": 1.3})
            unit = f"({pretty_unit(units[name])})" if pretty_unit(units[name]) else ""
            axis.set_ylabel("\n".join(filter(None, ("residual", word, unit))))  # short lines: the panels are low
    if inputs:
        own = axes[-1, 0]
        for j, name in enumerate(inputs):
            own.step(t[pick], curves["inputs"][pick, j], where="post", lw=1.2, color=INPUTS[j % 4], label=name)
        own.set_ylabel(axis_label(inputs[0], units) if len(inputs) == 1 else "inputs")
    for axis in axes[:, 0]:
        for w in () if whole else (w for w in windows if w.held_out):
            axis.axvspan(w.t[0], w.t[-1], color=style.YELLOW, alpha=0.25, lw=0, label="never fitted")
    axes[0, 0].set_title(f"{windows[0].trace}: " + ("never fitted" if whole else "shaded windows were never fitted"))
    axes[-1, 0].set_xlabel("time (s)")
    figure.align_ylabels()
    style.legend(figure)
    return figure


def missing_figure(m: Missing) -> Any:
    """The missing term against each regressor, under the nominal and under the corrected model."""
    names = list(m.before)[:3]
    figure, axes = style.panels(1, len(names), 3.5, sharey=True)
    for axis, name in zip(axes[0], names, strict=True):
        for b, colour, marker, label in (
            (m.before[name], style.BEFORE, "s", "before"),
            (m.after[name], style.AFTER, "o", "after"),
        ):
            look = {"color": colour, "marker": marker, "ms": 5, "lw": 1.4, "elinewidth": 1.1, "capsize": 0}
            axis.errorbar(b.centre, b.mean, yerr=b.half, label=label, **look)
        axis.axhline(0.0, color="#55595F", lw=1.0)
        axis.set_xlabel(axis_label(name, m.units) + (", within a turn" if name in m.folded else ""))
    what = m.label.replace(" at ", "\nat ")
    axes[0, 0].set_ylabel(f"missing {what}\n({pretty_unit(m.unit)})")
    style.legend(figure)
    return figure


def _gain(value: float) -> str:
    """Whole numbers as far as they leave room for what stands beside them."""
    return (f"{value:,.0f}" if abs(value) < 1e7 else number(value, 3)).replace("-", "\u2212")


def steps_figure(steps: Sequence[Mapping[str, Any]]) -> Any:
    """From the declared model to the answer, one effect at a time: what each option of a step leaves of chi^2/dof.

    Args:
        steps: each with `chi2_dof` before it and its `options`, what was taken first; the last step takes none.
    """
    rows = [row for k, step in enumerate(steps) for row in _rows_of(k, step)]
    height = 1.5 + 0.34 * max(len(rows), 3)
    figure, ((axis, numbers),) = style.panels(1, 2, height, sharey=True, width_ratios=(2.6, 1.0))
    numbers.set_axis_off()
    for y, (_, before, option) in enumerate(rows):
        if option is None:
            continue
        colour, width, size, kind = TAKEN if option["taken"] else NOT_TAKEN
        ends = [max(float(x), NO_LESS) for x in (before, option["chi2_dof"])]
        axis.plot(ends, [y, y], color=colour, lw=width, solid_capstyle="butt", zorder=2)
        axis.plot(ends[1], y, "o", color=colour, ms=size, zorder=3, label=kind)
        for x, said in ((0.38, number(option["chi2_dof"])), (1.0, _gain(float(option["bic_gain"])))):
            numbers.text(x, y, said, va="center", ha="right", fontsize=11)
    for x, head in ((0.38, "left"), (1.0, "BIC gain")):
        numbers.text(x, 0, head, va="center", ha="right", fontsize=11, fontweight="bold")
    axis.set_yticks(range(len(rows)), [label for label, *_ in rows])
    for tick, (_, _, option) in zip(axis.get_yticklabels(), rows, strict=True):
        tick.set_fontweight("bold" if option is None else "normal")
    largest = max((float(o["chi2_dof"]) for *_, o in rows if o is not None), default=1.0)
    most = 2.0 * max(largest, 5.0, *(before for _, before, _ in rows))
    axis.set(xscale="log", xlim=(NO_LESS, most), ylim=(len(rows) - 0.3, -0.7))
    axis.axvline(1.0, color="#55595F", lw=1.4, ls=(0, (4, 2)))
    axis.set_xlabel("remaining chi²/dof (log); 1 is the noise (dashed)")
    axis.grid(axis="y", visible=False)
    style.legend(figure)
    return figure


def _rows_of(k: int, step: Mapping[str, Any]) -> list[tuple[str, float, Mapping[str, Any] | None]]:
    """A title without an option, then the options: label, chi^2/dof before, and the option."""
    before, options = float(step["chi2_dof"]), step["options"][:MOST_OPTIONS]
    taken = any(o["taken"] for o in options)
    title = f"step {k + 1}, from {number(before)}" if taken else "nothing more taken" if k else "nothing taken"
    return [(title, before, None), *((phrase(o), before, o) for o in options)]


def error_figure(error: Mapping[str, Any], units: Mapping[str, str]) -> Any:
    """Error h seconds ahead on held-out data: before, after and the floor of a perfect model, one panel a state."""
    states, which = list(error["before"]["horizon_rmse"]), ("noise_floor", "after", "before")
    figure, axes = style.panels(1, len(states), 3.2)
    for axis, state in zip(axes[0], states, strict=True):
        values = [float(error[key]["horizon_rmse"][state]) for key in which]
        bars = axis.barh(range(3), values, color=(style.FLOOR, style.AFTER, style.BEFORE), height=0.66)
        axis.bar_label(bars, [f" {number(value, 3)}" for value in values], fontsize=11)
        axis.set_yticks(range(3), ["expected\nnoise floor", "after", "before"])
        axis.set_xlabel(f"RMS error {error['before']['horizon_s']:g} s ahead, {axis_label(state, units)}")
        axis.margins(x=0.18)
        axis.grid(axis="y", visible=False)
    return figure


def torque_error_figure(
    before: Mapping[str, float], after: Mapping[str, float], inputs: Sequence[str], units: Mapping[str, str]
) -> Any:
    """RMS error of the torque of each joint of an arm on *confirm*, before and after."""
    figure, ((axis,),) = style.panels(1, 1, 3.2)
    place = np.arange(len(inputs))
    for shift, rms, colour, label in ((-0.2, before, style.BEFORE, "before"), (0.2, after, style.AFTER, "after")):
        bars = axis.bar(place + shift, [rms[name] for name in inputs], 0.38, color=colour, label=label)
        axis.bar_label(bars, fmt="%.2g", fontsize=10)
    axis.set_xticks(place, [axis_label(name, units) for name in inputs])
    axis.set_ylabel("RMS error")
    axis.grid(axis="x", visible=False)
    style.legend(figure)
    return figure
