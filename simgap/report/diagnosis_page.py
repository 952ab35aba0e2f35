"""The pictures and the page of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY
from simgap.diagnosis.verdict.missing import Missing
from simgap.io import figure_style as style
from simgap.io.pages import render, script_data
from simgap.notation import joined
from simgap.report.explorer import explored_predictions
from simgap.report.figures.diagnosis import error_figure, missing_figure, overlay_figure, steps_figure

TEMPLATE = "diagnosis.html.j2"
MOST_OVERLAYS, WINDOWS_SHOWN = 2, 6
MEANING = {
    "none": (
        "The declared model predicts all windows, those of confirm too, down to the noise, and no candidate improves "
        "enough on it. Faults of the recording, if any were found, are allowed for."
    ),
    "attributed": (
        "With these effects the fit reaches the noise floor, and so do data that were never fitted; each effect is "
        "needed."
    ),
    "partial": (
        "The effects have their physical sign, agree between folds and significantly lower the error ahead, by a tenth "
        "or more, on data that were never fitted; the noise floor is not reached. They may stand in for another cause."
    ),
    "unexplained": (
        "No set of effects reaches the noise floor or predicts data that were never fitted significantly better. The "
        "corrected case equals the case."
    ),
}
DOUBTED = (
    "With these effects all data are predicted down to their noise, but others may be behind them: see the verdict."
)
UNCONFIRMED = (
    "With these effects all data that were kept are predicted down to their noise; the data that were left out lie "
    "where nothing confirms that no other effect acts."
)
STEPS = (
    "From the declared model to the answer, one effect at a time. A line runs from the error before a step to the "
    "error with that effect, as chi² per degree of freedom of fit and choose; 1 is the noise. Effects of the answer "
    "are listed in the order in which each removes most, beside the other effects that were fitted at that step. "
    "What gains less than "
    f"{BIC_GAIN:g} in BIC, or does not carry over to other data, is not taken; the other candidates, with the "
    "predicted drop of each, are in diagnosis.json."
)
FAINT = (
    "What is left looks like coloured noise; mechanisms outside the library would leave the same, so nothing is "
    "attributed."
)


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
    held = [w for w in windows if w.held_out] or list(windows)
    own = sorted((w for w in windows if w.trace == held[0].trace), key=lambda w: float(w.t[0]))
    explored = explored_predictions(own, names[0], document["units"])
    texts: dict[str, Any] = {"overlays": [], "missing": [], "error": "", "steps": "", "explored": explored}
    with style.figure_style():
        if document["error"]["before"]["horizon_rmse"]:
            figure = partial(error_figure, document["error"], document["units"])
            texts["error"] = style.drawn(figure, folder / "error.svg")
        for k, shown in enumerate(stretches(windows)):
            figure = partial(overlay_figure, shown, *names, document)
            texts["overlays"].append((shown[0].trace, style.drawn(figure, folder / f"measured-{k + 1}.svg")))
        for k, m in enumerate(missing):
            drawn = style.drawn(partial(missing_figure, m), folder / f"residual-{k + 1}.svg")
            texts["missing"].append((m.label, drawn))
        if document["steps"]:
            texts["steps"] = style.drawn(partial(steps_figure, document["steps"]), folder / "steps.svg")
    return texts


def page(document: Mapping[str, Any], title: str, figures: Mapping[str, Any]) -> str:
    """The page as one HTML text."""
    from markupsafe import Markup

    texts = {k: v for k, v in figures.items() if k != "explored"}
    marked = {k: [(n, Markup(f)) for n, f in v] if isinstance(v, list) else Markup(v) for k, v in texts.items()}
    return render(
        TEMPLATE,
        d=document,
        title=title,
        figures=marked,
        meaning=f"{_meaning(document)} {_limits(document['fit_quality'])}",
        folds={name: _fold(fold) for name, fold in document["folds"].items()},
        quality=_quality(document["fit_quality"]),
        steps_note=STEPS,
        explorer=script_data(figures["explored"]),
        rejected={(c["name"], c["on"]): c["rejected"] for c in document["candidates"]},
    )


def _fold(fold: Mapping[str, Any]) -> str:
    windows = fold["windows"]
    more = len(windows) - 5 if len(windows) > 6 else 0
    by_trace = groupby(windows[: len(windows) - more], key=itemgetter("trace"))
    spans = [f"{joined([_span(w) for w in own])} s of {trace}" for trace, own in by_trace]
    return joined([*fold["traces"], *spans, *([f"{more} more stretches"] if more else [])])


def _span(window: Mapping[str, Any]) -> str:
    return f"{window['from']:.3g} to {window['to']:.3g}"


def _meaning(document: Mapping[str, Any]) -> str:
    if document.get("faint_memory"):
        return FAINT
    if document.get("doubts"):
        return DOUBTED
    return UNCONFIRMED if document.get("unconfirmed") else MEANING[document["verdict"]]


def _limits(quality: Mapping[str, Any]) -> str:
    fit, held = quality["chi2_dof"]["after"], quality["held_out_ratio"]["after"]
    limits = f"limits {FIT_QUALITY:g} and {FIT_QUALITY**0.5:.3g}, wider for few readings"
    return f"Here: chi²/dof {fit:.3g}, RMSE/σ of confirm {held:.3g} ({limits})."


def _quality(quality: Mapping[str, Any]) -> str:
    fit, held = quality["chi2_dof"], quality["held_out_ratio"]
    return (
        f"chi²/dof of fit and choose: {fit['before']:.4g} before, {fit['after']:.4g} after; "
        f"RMSE/σ of confirm: {held['before']:.4g} before, {held['after']:.4g} after."
    )
