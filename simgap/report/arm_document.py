"""The content of `diagnosis.json` of an arm: plain values, the keys of every diagnosis first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from simgap.diagnosis.arms.answer import ArmDiagnosis
from simgap.diagnosis.arms.problem import INERTIAL, TERMS
from simgap.diagnosis.record.survey import Survey
from simgap.diagnosis.record.traces import Reading
from simgap.diagnosis.verdict import words
from simgap.effects import effect
from simgap.effects.base import Quoted
from simgap.io import figure_style as style
from simgap.io.pages import render, script_data
from simgap.model.tree import Tree
from simgap.notation import joined
from simgap.report.diagnosis_document import effect_entry, explained_error
from simgap.report.explorer import explored_predictions
from simgap.report.figures.arm import torque_error_figure, torque_figure

Document = Mapping[str, Any]


def sentence(document: Document) -> str:
    """Torque columns that are wrong and what to do; what was found, what it explains, what was mounted."""
    wrong = "".join(f"{f['sentence']} {f['remedy']} " for f in document["recording"])
    return wrong + _found(document)


def _found(document: Document) -> str:
    verdict, effects = document["verdict"], document["effects"]
    if verdict == "none":
        return f"The model explains the torques down to their noise: no effect is missing.{_mounted(document)}"
    if verdict == "unexplained":
        return (
            "No friction, inertia, bias or change of inertial parameters surely lowers the error of the torques on "
            "data that were never fitted: look for a torque column or a drive gain that is not what the case says, or "
            "for a force that was not measured."
        )
    own = _told([e for e in effects if e["name"] != INERTIAL])
    links = [e["on"] for e in effects if e["name"] == INERTIAL]
    parts = [*own, *([f"other inertial parameters of {joined(links)}"] if links else [])]
    what = joined(parts)
    verb = "explains" if own == parts and len(parts) == 1 else "explain" if len(parts) == 1 else "together explain"
    text = f"{what[0].upper()}{what[1:]} {verb} {words.explained(document)} of the torques."
    return f"{text}{_mounted(document)}"


def _told(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """Each effect with its numbers, or of many the kinds with their places: the table has the numbers."""
    if len(effects) <= MOST_NUMBERS:
        return [words.describe(e) for e in effects]
    places: dict[str, list[str]] = {}
    for e in effects:
        places.setdefault(e["name"], []).append(str(e["on"]))
    return [effect(name).phrase(joined(own)) for name, own in places.items()]


def _mounted(document: Document) -> str:
    """A sentence about each payload whose mass was found."""
    text = ""
    for p in (p for p in document["payloads"] if "m" in p["parameters"]):
        few = p["traces"] if len(p["traces"]) <= 4 else [*p["traces"][:3], f"{len(p['traces']) - 3} more"]
        text += f" In {joined(few)} {p['link']} carries {Quoted(p['parameters']).number('m')} more."
    return text


TEMPLATE = "arm_diagnosis.html.j2"
COLUMNS = (*TERMS, "input_gain")
MOST_TRACES = 3
MOST_NUMBERS = 4
MEANING = {
    "none": "On data that were never fitted the model as declared misses the torques by no more than their noise.",
    "attributed": "With these effects, torques that were never fitted are missed by no more than their noise.",
    "partial": (
        "The effects have their physical sign, their intervals leave out 'no effect', and torques that were never "
        "fitted are surely missed by less, by a tenth or more; the noise of the torques is not reached."
    ),
    "unexplained": "Nothing that was tried surely lowers the error of torques that were never fitted.",
}


def draw(found: ArmDiagnosis, inputs: Sequence[str], units: Mapping[str, str], folder: Path) -> dict[str, Any]:
    """All figures: SVG files in `folder`, and their text for the page."""

    longest = sorted(found.predictions, key=lambda p: -len(p.t))[:MOST_TRACES]
    with style.figure_style():
        error = style.drawn(lambda: torque_error_figure(found, inputs, units), folder / "error.svg")
        overlays = [
            style.drawn(partial(torque_figure, p, inputs, units), folder / f"torques-{k + 1}.svg")
            for k, p in enumerate(longest)
        ]
    explored = explored_predictions(longest[:1], inputs, units) if longest else {}
    return {"error": error, "overlays": overlays, "explored": explored}


def page(document: Mapping[str, Any], title: str, figures: Mapping[str, Any]) -> str:
    """The page as one HTML text."""
    from markupsafe import Markup

    marked = {"error": Markup(figures["error"]), "overlays": [Markup(f) for f in figures["overlays"]]}
    return render(
        TEMPLATE, d=document, title=title, figures=marked, meaning=MEANING[document["verdict"]], terms=list(COLUMNS),
        explorer=script_data(figures["explored"]),
        folds={name: joined(fold["traces"]) for name, fold in document["folds"].items()},
        rows=[_joint_row(document, row) for row in document["joints"]],
    )  # fmt: skip


def _joint_row(document: Mapping[str, Any], row: Mapping[str, str]) -> dict[str, Any]:
    """Of a joint: effect -> its estimate, or None."""
    places = {row["joint"], row["input"]}
    own = {e["name"]: next(iter(e["parameters"].values())) for e in document["effects"] if e["on"] in places}
    return {"joint": row["joint"], "found": {name: own.get(name) for name in COLUMNS}}


def document(
    found: ArmDiagnosis, reading: Reading, look: Survey, tree: Tree, inputs: Sequence[str], units: Mapping[str, str],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Everything that is reported, as JSON takes it. The errors are of torques: `fit_rmse` by input, no horizon."""
    content: dict[str, Any] = to_jsonable_python({
        "verdict": found.verdict,
        "sentence": "",
        "method": "inverse dynamics",
        "effects": [effect_entry(e) for e in found.effects],
        "base_parameters": found.base,
        "consistent": None if found.distance is None else {"distance": found.distance},
        "payloads": found.payloads,
        "recording": found.recording,
        "error": {
            "before": _error(found.before),
            "after": _error(found.after),
            "noise_floor": _error(found.floor),
            "by_trace": found.by_trace,
        },
        "explained_share": 1.0 - found.excess_share,
        "explained_error": explained_error(found.explained_error),
        "held_out": _fold(found.folds["confirm"]),
        "folds": {name: _fold(traces) for name, traces in found.folds.items()},
        "data": reading.files,
        "candidates": found.sought,
        "columns": reading.columns,
        "warnings": [*reading.warnings, *look.warnings, *found.warnings],
        "low_pass_hz": found.cut_hz,
        "independent_rows": found.independent,
        "joints": [
            {"joint": j, "input": u, "link": link} for j, u, link in zip(tree.joints, inputs, tree.links, strict=True)
        ],
        "survey": look,
        "units": units,
        "provenance": provenance,
    }, fallback=dict)  # fmt: skip
    content["sentence"] = sentence(content)
    return content


def _error(rms: Mapping[str, float]) -> dict[str, Any]:
    return {"fit_rmse": rms, "horizon_s": 0.0, "horizon_rmse": {}}


def _fold(traces: Sequence[str]) -> dict[str, Any]:
    return {"traces": traces, "windows": []}
