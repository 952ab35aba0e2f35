"""The pictures and the page of an arm's diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from simgap.diagnosis.arms.result import ArmDiagnosis
from simgap.diagnosis.arms.terms import TERMS
from simgap.io import figure_style as style
from simgap.io.arm_figures import torque_error_figure, torque_figure
from simgap.io.pages import render
from simgap.notation import joined

TEMPLATE = "arm_diagnosis.html.j2"
COLUMNS = (*TERMS, "input_gain")
MOST_TRACES = 3
MEANING = {
    "none": "On data that were never fitted the model as declared misses the torques by no more than their noise.",
    "attributed": "With these effects, torques that were never fitted are missed by no more than their noise.",
    "partial": (
        "The effects have their physical sign, their intervals leave out 'no effect', and at least half of the excess "
        "error of torques that were never fitted is gone; the noise of the torques is not reached."
    ),
    "unexplained": "Nothing that was tried halves the excess error of torques that were never fitted.",
}


def draw(found: ArmDiagnosis, inputs: Sequence[str], units: Mapping[str, str], folder: Path) -> dict[str, Any]:
    """All figures: written as PNG into `folder`, returned as SVG text for the page."""

    longest = sorted(found.predictions, key=lambda p: -len(p.t))[:MOST_TRACES]
    with style.figure_style():
        error = style.drawn(lambda: torque_error_figure(found, inputs, units), folder / "error.png")
        overlays = [
            style.drawn(partial(torque_figure, p, inputs, units), folder / f"torques-{k + 1}.png")
            for k, p in enumerate(longest)
        ]
    return {"error": error, "overlays": overlays}


def page(document: Mapping[str, Any], title: str, figures: Mapping[str, Any]) -> str:
    """The page as one HTML text."""
    from markupsafe import Markup

    marked = {k: [Markup(f) for f in v] if isinstance(v, list) else Markup(v) for k, v in figures.items()}
    return render(
        TEMPLATE, d=document, title=title, figures=marked, meaning=MEANING[document["verdict"]], terms=list(COLUMNS),
        folds={name: joined(fold["traces"]) for name, fold in document["folds"].items()},
        rows=[_joint_row(document, row) for row in document["joints"]],
    )  # fmt: skip


def _joint_row(document: Mapping[str, Any], row: Mapping[str, str]) -> dict[str, Any]:
    """Of a joint: effect -> its estimate, or None."""
    places = {row["joint"], row["input"]}
    own = {e["name"]: next(iter(e["parameters"].values())) for e in document["effects"] if e["on"] in places}
    return {"joint": row["joint"], "found": {name: own.get(name) for name in COLUMNS}}
