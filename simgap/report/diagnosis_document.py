"""The content of `diagnosis.json`: plain values, the contract's keys first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from pydantic_core import to_jsonable_python

from simgap.diagnosis.arms.answer import ArmDiagnosis
from simgap.diagnosis.record.survey import Survey
from simgap.diagnosis.record.traces import Reading
from simgap.diagnosis.result import (
    Alternative,
    CandidateScore,
    Concentrated,
    Diagnosis,
    FoundEffect,
    LeftOver,
    Nearest,
    Stretches,
)
from simgap.diagnosis.verdict.remainder import Remainder, RemainderUse
from simgap.diagnosis.verdict.words import verdict_parts

NUMBER_FROM = {
    "effects": ("fit", "choose"),
    "recording": ("fit", "choose"),
    "candidates": ("fit", "choose"),
    "steps": ("fit", "choose"),
    "alternatives": ("fit", "choose"),
    "indistinguishable": ("fit", "choose"),
    "fit_quality.chi2_dof": ("fit", "choose"),
    "verdict": ("fit", "choose", "confirm"),
    "error": ("confirm",),
    "explained_share": ("confirm",),
    "explained_error": ("fit", "choose", "confirm"),
    "nearest.explained_share": ("confirm",),
    "left_over.share": ("confirm",),
    "concentrated": ("confirm",),
    "fit_quality.held_out_ratio": ("confirm",),
    "remainder": ("confirm",),
    "noise": ("fit", "choose", "confirm"),
}
"""Which folds a key of the document is from. A verdict asks *confirm* on top of the two that it was found on."""


def document(
    found: Diagnosis,
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
    folds = {name: _fold(getattr(found.folds, name), reading) for name in ("fit", "choose", "confirm")}
    content: dict[str, Any] = to_jsonable_python({
        **shared(found, reading, look, error, folds),
        "sentences": [],
        "number_from": NUMBER_FROM,
        "candidates": [_candidate(c) for c in found.candidates],
        "steps": found.steps,
        **_judgement(found),
        "noise": found.sigma,
        "remainder": _remainder(remainder, use) if remainder is not None else None,
        "units": units,
        "provenance": provenance,
    }, fallback=dict)  # fmt: skip
    content["sentences"] = verdict_parts(content)
    content["sentence"] = " ".join(content["sentences"])
    return content


def shared(
    found: Diagnosis | ArmDiagnosis, reading: Reading, look: Survey, error: Mapping[str, Any], folds: Mapping[str, Any]
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


def _judgement(found: Diagnosis) -> dict[str, Any]:
    """Judgement on how far the answer goes: what is left, what cannot be told apart."""
    sides = {"before": found.before, "after": found.after}
    return {
        "fit_quality": {key: {s: getattr(j, key) for s, j in sides.items()} for key in ("chi2_dof", "held_out_ratio")},
        "nearest": _nearest(found.nearest),
        "left_over": _left_over(found.left_over),
        "concentrated": _concentrated(found.concentrated),
        "doubts": found.doubts,
        "stopped": found.stopped,
        "unconfirmed": found.unconfirmed,
        "faint_memory": found.faint_memory,
        "at_most": found.at_most,
        "alternatives": [_alternative(a) for a in found.alternatives],
        "indistinguishable": [
            {"candidates": [_key(c.first), _key(c.second)], "correlation": c.correlation, "advice": c.advice}
            for c in found.collinear
        ],
    }


def _nearest(n: Nearest | None) -> dict[str, Any] | None:
    """Set of effects that comes nearest where none is named, as plain data."""
    if n is None:
        return None
    return {"effects": [effect_entry(e) for e in n.effects], "explained_share": n.share, "reasons": n.reasons}


def _concentrated(c: Concentrated | None) -> dict[str, Any] | None:
    """Stretches in which the error is, as plain data."""
    if c is None:
        return None
    return {
        "stretches": [{"trace": t, "from": a, "to": b} for t, a, b in c.stretches],
        "error_share": c.error_share,
        "explained_share_without": 1.0 - c.excess_share_without,
        "median": {"before": c.median_before, "after": c.median_after},
    }


def _left_over(over: Sequence[LeftOver] | None) -> list[dict[str, Any]] | None:
    """Effects that would take away a part of the rest, as plain data."""
    return None if over is None else [effect_entry(o.effect) | {"share": o.share} for o in over]


def _alternative(a: Alternative) -> dict[str, Any]:
    effects = [{"name": e.name, "on": e.on, "parameters": e.values} for e in a.effects]
    return {"effects": effects, "bic_excess": a.bic_excess, "exact": a.exact}


def _remainder(remainder: Remainder, use: RemainderUse) -> dict[str, Any]:
    """The bounds, and what was really done with them."""
    return {**to_jsonable_python(remainder), "bounded": use.bounded, "reason": use.reason}


def _key(key: Sequence[str]) -> dict[str, str]:
    return {"name": key[0], "on": key[1]}


def effect_entry(e: FoundEffect) -> dict[str, Any]:
    """An effect with its numbers and what could stand in its place."""
    return asdict(e) | {"alternatives": [[_key(k) for k in alternative] for alternative in e.alternatives]}


def _fold(stretches: Stretches, reading: Reading) -> dict[str, Any]:
    """Traces, or windows of them, of which a fold is made."""
    whole = {t for t, _, _ in stretches if _covers(stretches, reading, t)}
    return {
        "traces": [t.name for t in reading.record.traces if t.name in whole],
        "windows": [{"trace": t, "from": a, "to": b} for t, a, b in stretches if t not in whole],
    }


def _covers(stretches: Stretches, reading: Reading, trace: str) -> bool:
    """True if the stretches of a trace are all of it."""
    duration = next(t.duration for t in reading.record.traces if t.name == trace)
    held = sum(b - a for t, a, b in stretches if t == trace)
    return math.isclose(held, duration, rel_tol=0.05)


def _candidate(c: CandidateScore) -> dict[str, Any]:
    return asdict(c) | {"score": c.bic_gain if c.bic_gain is not None else c.chi2_drop}
