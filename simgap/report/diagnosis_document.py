"""The content of `diagnosis.json` of a plant and of an arm: plain values, the contract's keys first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from pydantic_core import to_jsonable_python

from simgap.correction.remainder import Remainder, RemainderUse
from simgap.diagnosis import result
from simgap.diagnosis.arms.diagnose import ArmDiagnosis
from simgap.diagnosis.arms.problem import INERTIAL
from simgap.diagnosis.record.survey import Survey
from simgap.diagnosis.record.traces import Reading
from simgap.diagnosis.verdict import words
from simgap.effects import effect
from simgap.effects.base import Quoted
from simgap.model.tree import Tree
from simgap.notation import capitalised, joined

Document = Mapping[str, Any]
_NUMBERS = {
    ("fit", "choose"): "effects recording candidates steps alternatives indistinguishable fit_quality.chi2_dof",
    ("confirm",): "error explained_share nearest.explained_share left_over.share concentrated remainder "
    "fit_quality.held_out_ratio",
    ("fit", "choose", "confirm"): "verdict explained_error noise",
}
NUMBER_FROM = {key: folds for folds, keys in _NUMBERS.items() for key in keys.split()}
"""Which folds a key of the document is from. A verdict asks *confirm* on top of the two that it was found on."""


def document(
    found: result.Diagnosis,
    reading: Reading,
    look: Survey,
    remainder: Remainder | None,
    use: RemainderUse,
    units: Mapping[str, str],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:
    """Everything that is reported, as JSON takes it."""
    sides = {"before": found.before, "after": found.after, "noise_floor": found.floor}
    error = {
        side: {"fit_rmse": j.fit_rmse, "horizon_s": j.horizon_s, "horizon_rmse": j.horizon_rmse}
        for side, j in sides.items()
    }
    folds = {name: _fold(own, reading) for name, own in found.folds.items()}
    content: dict[str, Any] = to_jsonable_python({
        **shared(found, reading, look, error, folds),
        "sentences": [],
        "number_from": NUMBER_FROM,
        "candidates": [
            asdict(c) | {"score": c.bic_gain if c.bic_gain is not None else c.chi2_drop} for c in found.candidates
        ],
        "steps": found.steps,
        **_judgement(found),
        "noise": found.sigma,
        "remainder": _remainder(remainder, use) if remainder is not None else None,
        "units": units,
        "provenance": provenance,
    }, fallback=dict)  # fmt: skip
    content["sentences"] = words.verdict_parts(content)
    content["sentence"] = " ".join(content["sentences"])
    return content


def shared(
    found: result.Diagnosis | ArmDiagnosis,
    reading: Reading,
    look: Survey,
    error: Mapping[str, Any],
    folds: Mapping[str, Any],
) -> dict[str, Any]:
    """The keys of every diagnosis, of a plant and of an arm.

    Args:
        error: before, after and noise_floor; folds: by name, each with its traces and windows.
    """
    share = found.explained_error
    return {
        "verdict": found.verdict,
        "sentence": "",
        "effects": [effect_entry(e) for e in found.effects],
        "recording": found.recording,
        "error": error,
        "held_out": folds["confirm"],
        "folds": folds,
        "data": reading.files,
        "columns": reading.columns,
        "warnings": [*reading.warnings, *look.warnings, *(w for w in found.warnings if w not in look.warnings)],
        "explained_share": 1.0 - found.excess_share,
        "explained_error": None if share is None else {"share": share[0], "ci95": share[1:]},
        "survey": look,
    }


def _judgement(found: result.Diagnosis) -> dict[str, Any]:
    """Judgement on how far the answer goes: what is left, what cannot be told apart."""
    sides, left = {"before": found.before, "after": found.after}, found.left_over
    return {
        "fit_quality": {key: {s: getattr(j, key) for s, j in sides.items()} for key in ("chi2_dof", "held_out_ratio")},
        "nearest": _nearest(found.nearest),
        "left_over": None if left is None else [effect_entry(o.effect) | {"share": o.share} for o in left],
        "concentrated": _concentrated(found.concentrated),
        **{key: getattr(found, key) for key in ("doubts", "stopped", "unconfirmed", "faint_memory", "at_most")},
        "alternatives": [_alternative(a) for a in found.alternatives],
        "indistinguishable": [
            {"candidates": [_key(c.first), _key(c.second)], "correlation": c.correlation, "advice": c.advice}
            for c in found.collinear
        ],
    }


def _nearest(n: result.Nearest | None) -> dict[str, Any] | None:
    """Set of effects that comes nearest where none is named, as plain data."""
    if n is None:
        return None
    return {"effects": [effect_entry(e) for e in n.effects], "explained_share": n.share, "reasons": n.reasons}


def _concentrated(c: result.Concentrated | None) -> dict[str, Any] | None:
    """Stretches in which the error is, as plain data."""
    if c is None:
        return None
    return {
        "stretches": _spans(c.stretches),
        "error_share": c.error_share,
        "explained_share_without": 1.0 - c.excess_share_without,
        "median": {"before": c.median_before, "after": c.median_after},
    }


def _alternative(a: result.Alternative) -> dict[str, Any]:
    effects = [{"name": e.name, "on": e.on, "parameters": e.values} for e in a.effects]
    return {"effects": effects, "bic_excess": a.bic_excess, "exact": a.exact}


def _remainder(remainder: Remainder, use: RemainderUse) -> dict[str, Any]:
    """The bounds, and what was really done with them."""
    return {
        **to_jsonable_python(remainder),
        "bounded": use.bounded,
        "reason": use.reason,
        "asked": use.asked,
    }


def _key(key: Sequence[str]) -> dict[str, str]:
    return {"name": key[0], "on": key[1]}


def effect_entry(e: result.FoundEffect) -> dict[str, Any]:
    """An effect with its numbers and what could stand in its place."""
    return asdict(e) | {"alternatives": [[_key(k) for k in alternative] for alternative in e.alternatives]}


def _fold(stretches: result.Stretches, reading: Reading) -> dict[str, Any]:
    """Traces, or windows of them, of which a fold is made."""
    pairs = [(t, sum(b - a for name, a, b in stretches if name == t.name)) for t in reading.record.traces]
    whole = [trace.name for trace, held in pairs if math.isclose(held, trace.duration, rel_tol=0.05)]
    return {"traces": whole, "windows": _spans(s for s in stretches if s[0] not in whole)}


def _spans(stretches: Iterable[tuple[str, float, float]]) -> list[dict[str, Any]]:
    return [{"trace": trace, "from": a, "to": b} for trace, a, b in stretches]


def arm_sentence(document: Document) -> str:
    """Torque columns that are wrong and what to do; what was found, what it explains, what was mounted."""
    wrong = "".join(f"{f['sentence']} {f['remedy']} " for f in document["recording"])
    return wrong + _arm_found(document)


def _arm_found(document: Document) -> str:
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
    text = f"{capitalised(what)} {verb} {words.explained(document)} of the torques."
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


def arm_document(
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
    content["sentence"] = arm_sentence(content)
    return content
