"""The content of `diagnosis.json` of an arm: plain values, the keys of every diagnosis first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic_core import to_jsonable_python

from simgap.diagnosis.arms.answer import ArmDiagnosis
from simgap.diagnosis.arms.problem import INERTIAL
from simgap.diagnosis.record.survey import Survey
from simgap.diagnosis.record.traces import Reading
from simgap.diagnosis.verdict import words
from simgap.effects import effect
from simgap.effects.base import Quoted
from simgap.model.tree import Tree
from simgap.notation import joined
from simgap.report.diagnosis_document import shared

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
    own = _told([e for e in effects if e["name"] != INERTIAL], document["joints"])
    links = [e["on"] for e in effects if e["name"] == INERTIAL]
    where = "every link" if len(links) == len(document["joints"]) else joined(links)
    parts = [*own, *([f"other inertial parameters of {where}"] if links else [])]
    what = joined(parts)
    verb = "explains" if own == parts and len(parts) == 1 else "explain" if len(parts) == 1 else "together explain"
    text = f"{what[0].upper()}{what[1:]} {verb} {words.explained(document)} of the torques."
    return f"{text}{_mounted(document)}"


def _told(effects: Sequence[Mapping[str, Any]], joints: Sequence[Mapping[str, str]]) -> list[str]:
    """Each effect with its numbers, or of many the kinds with their places: the table has the numbers."""
    if len(effects) <= MOST_NUMBERS:
        return [words.describe(e) for e in effects]
    places: dict[str, list[str]] = {}
    for e in effects:
        places.setdefault(e["name"], []).append(str(e["on"]))
    return [effect(name).phrase(_place(own, joints)) for name, own in places.items()]


def _place(names: Sequence[str], joints: Sequence[Mapping[str, str]]) -> str:
    """'joints' where these are all of them, 'joint j4' or 'joints j4 and j5' for some; inputs alike."""
    for key in ("joint", "input"):
        every = {row[key] for row in joints}
        if every.issuperset(names):
            return f"{key}s" if every == set(names) else f"{key}{'s' * (len(names) > 1)} {joined(names)}"
    return joined(names)


def _mounted(document: Document) -> str:
    """A sentence about each payload whose mass was found."""
    text = ""
    for p in (p for p in document["payloads"] if "m" in p["parameters"]):
        few = p["traces"] if len(p["traces"]) <= 4 else [*p["traces"][:3], f"{len(p['traces']) - 3} more"]
        mass, s = Quoted(p["parameters"]).number("m"), "s" * (len(few) > 1)
        text += f" In recording{s} {joined(few)}, {p['link']} carries {mass} more."
    return text


MOST_NUMBERS = 4


def document(
    found: ArmDiagnosis, reading: Reading, look: Survey, tree: Tree, inputs: Sequence[str], units: Mapping[str, str],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Everything that is reported, as JSON takes it. The errors are of torques: `fit_rmse` by input, no horizon."""
    sides = {"before": found.before, "after": found.after, "noise_floor": found.floor}
    error = {side: {"fit_rmse": rms, "horizon_s": 0.0, "horizon_rmse": {}} for side, rms in sides.items()}
    folds = {name: {"traces": traces, "windows": []} for name, traces in found.folds.items()}
    content: dict[str, Any] = to_jsonable_python({
        **shared(found, reading, look, error | {"by_trace": found.by_trace}, folds),
        "method": "inverse dynamics",
        "base_parameters": found.base,
        "consistent": None if found.distance is None else {"distance": found.distance},
        "payloads": found.payloads,
        "candidates": found.sought,
        "low_pass_hz": found.cut_hz,
        "independent_rows": found.independent,
        "joints": [
            {"joint": j, "input": u, "link": link} for j, u, link in zip(tree.joints, inputs, tree.links, strict=True)
        ],
        "units": units,
        "provenance": provenance,
    }, fallback=dict)  # fmt: skip
    content["sentence"] = sentence(content)
    return content
