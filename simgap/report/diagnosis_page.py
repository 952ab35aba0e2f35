"""The pictures and the page of a diagnosis, of a plant or of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY
from simgap.diagnosis.verdict.missing import Missing
from simgap.io import figure_style as style
from simgap.io.pages import render
from simgap.notation import joined, number
from simgap.report.explorer import explored_predictions
from simgap.report.figures import diagnosis as pictures

TEMPLATE, ARM_TEMPLATE = "diagnosis.html.j2", "arm_diagnosis.html.j2"
MOST_OVERLAYS, WINDOWS_SHOWN = 2, 6
MOST_ARM_TRACES = 3


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
            texts["error"] = style.drawn(folder / "error.svg", pictures.error_figure, document["error"], units)
        content = names[0], units, document["noise"], names[1]
        texts["overlays"] = [
            (shown[0].trace, style.drawn(folder / f"measured-{k}.svg", pictures.overlay_figure, shown, *content))
            for k, shown in enumerate(stretches(windows), start=1)
        ]
        texts["missing"] = [
            (m.label, style.drawn(folder / f"residual-{k}.svg", pictures.missing_figure, m))
            for k, m in enumerate(missing, start=1)
        ]
        if document["steps"]:
            texts["steps"] = style.drawn(folder / "steps.svg", pictures.steps_figure, document["steps"])
    return texts


def draw_arm(
    document: Mapping[str, Any], traces: Sequence[WindowPrediction], inputs: Sequence[str], folder: Path
) -> dict[str, Any]:
    """Figures as those of `draw`, of an arm: errors of its torques, and the longest of its traces."""
    longest, units = sorted(traces, key=lambda p: -len(p.t))[:MOST_ARM_TRACES], document["units"]
    before, after = (document["error"][side]["fit_rmse"] for side in ("before", "after"))
    with style.figure_style():
        return {
            "error": style.drawn(folder / "error.svg", pictures.torque_error_figure, before, after, inputs, units),
            "overlays": [
                (p.trace, style.drawn(folder / f"torques-{k + 1}.svg", pictures.overlay_figure, [p], inputs, units))
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
