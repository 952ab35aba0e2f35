"""Content of a case's page: the verdict, tables and the guarantee, as plain data for the template."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simgap.gap.bounds.function import PROVEN
from simgap.io.traces import GAP_AWARE
from simgap.notation import pretty_unit
from simgap.report import tables
from simgap.report.headline import common_free, verdict
from simgap.report.material import Material
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space

INTEGRATORS = {
    "explicit_euler": "explicit Euler step",
    "semi_implicit_euler": "semi-implicit Euler step",
    "rk4": "Runge-Kutta step of order 4",
    "exact_arc": "exact arc of a unicycle",
}
ENGINES = {
    "pybullet": "PyBullet",
    "pybullet_wheeled": "PyBullet with wheels",
    "mujoco": "MuJoCo",
    "mujoco_wheeled": "MuJoCo with wheels",
    "drake": "Drake",
    "fmu": "FMU",
}
INERTIAS = {"engine": "inertia computed by the engine, not the file's", "file": "inertia of the file"}

SAID = ("plain", "little", "gap_aware", "nominal", "baseline", "arrival", "winning")
"""Sentences of the headline, in order."""


def content(m: Material) -> dict[str, Any]:
    """Everything that the template prints."""
    case, audit = m.context.case, m.audit or {}
    specification = specification_of(case)
    return {
        "m": m,
        "tables": tables,
        "case": case,
        "title": case.title or case.name,
        "units": m.context.units,
        "verdict": verdict(m),
        "specification": specification,
        "specification_sentence": specification.sentence(Space.of(case)),
        "settings": settings(m),
        "gap": m.gap,
        "sweep": tables.sweep(m),
        "syntheses": m.syntheses,
        "common_free": common_free(m.syntheses),
        "between": between_samples(m),
        "unproven": unproven(m.gap),
        "adversary": tables.adversary(m),
        "margins": audit.get("margins"),
        "no_margins": audit.get("no_margins", ""),
        "diagnosis": tables.diagnosis(m),
    }


def unproven(gap: Mapping[str, Any]) -> str:
    """Why the rate within a step is an assumption, as a clause: a bound of whole steps says nothing of it."""
    if any(tier["text"] == PROVEN.text for tier in gap["guarantee"]):
        return "is not part of the proof: what is proven is the bound of whole steps"
    return "samples alone cannot prove"


def between_samples(m: Material) -> dict[str, float]:
    """Distances by which states may stray between samples with the gap-aware controller; empty if nothing says so."""
    said = m.syntheses[GAP_AWARE].get("between_samples") or {}
    return {state: bound for state, bound in said.items() if bound}


def settings(m: Material) -> list[tuple[str, str]]:
    """Model, simulator and grid as names with text."""
    case, domain = m.context.case, m.context.domain
    plant = case.plant
    source = f"{plant.urdf.rsplit('/', 1)[-1]} (URDF)" if plant.urdf else "equations in the case file"
    names = m.context.units
    boxes = [f"{n} in [{lo:g}, {hi:g}] {pretty_unit(names[n])}" for n, (lo, hi) in domain.X.items()]
    grid = m.context.input_set
    inputs = [
        f"{n} in [{grid[:, j].min():g}, {grid[:, j].max():g}] {pretty_unit(names[n])}"
        for j, n in enumerate(m.context.inputs)
    ]
    rows = [
        ("nominal model", f"{source}, {INTEGRATORS[plant.integrator]}, sampling time {domain.tau:g} s"),
        ("states X", "; ".join(boxes)),
        ("inputs U", f"{'; '.join(inputs)} ({len(grid)} values)"),
    ]
    rows += [("effect in the model", _effect(e)) for e in plant.effects]
    if case.simulator is not None:
        given = case.simulator.model_dump(mode="json")
        given.pop("effects", None)
        engine, urdf = str(given.pop("engine")), given.pop("urdf", None)
        inertia = INERTIAS.get(str(given.pop("inertia", "")), "")
        rows.append(
            ("simulator", "; ".join(filter(None, [ENGINES.get(engine, engine), urdf, inertia, *_plain(given)])))
        )
        rows += [("effect in the simulator", _effect(e)) for e in getattr(case.simulator, "effects", ())]
    if m.twin is not None:
        rows.append(("twin of", twin_sentence(m.twin)))
    rows.append(("specification", specification_of(m.context.case).sentence(Space.of(m.context.case))))
    sensing = case.sensing
    if sensing is not None:
        rows.append(("sensing", "; ".join(_plain(sensing.model_dump(mode="json")))))
    return rows


def twin_sentence(twin: Mapping[str, Any]) -> str:
    """Sentence on how far the simulator is from the engine that it stands for."""
    parts = [f"{name} {row['difference']:.2g} {pretty_unit(row['unit'])}" for name, row in twin["largest"].items()]
    total = sum(twin["samples"].values())
    return f"{twin['engine']}: largest difference after one step, over all {total:,} samples: {', '.join(parts)}"


def _plain(given: Mapping[str, Any], prefix: str = "") -> list[str]:
    out = []
    for key, value in given.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            out += _plain(value, f"{name} ")
        elif value is not None:
            out.append(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}")
    return out


def _effect(effect: Any) -> str:
    numbers = ", ".join(f"{k} = {v:g}" for k, v in effect.parameters.items())
    return f"{effect.name.replace('_', ' ')} on {effect.on}: {numbers}"


def summary(m: Material, page: Mapping[str, Any]) -> dict[str, Any]:
    """The figures that a script wants."""
    return {
        "case": m.context.case.name,
        "title": page["title"],
        "promise_kept": page["verdict"]["good"],
        "verdict": [page["verdict"][k] for k in SAID if page["verdict"][k]],
        "eps": m.gap.get("eps"),
        "units": {state: m.context.units[state] for state in m.context.states},
        "sup_gamma": [{"eps": r["eps"], "states": r["states"]} for r in page["sweep"]],
        "fresh": {
            k: v for k, v in m.gap.get("fresh", {}).items() if k in ("samples", "violations", "upper", "confidence")
        },
        "winning_fraction": {kind: s["winning_fraction"] for kind, s in m.syntheses.items()},
        "winning_cells": {kind: s["winning_cells"] for kind, s in m.syntheses.items()},
        "closed_loop": m.validation["controllers"],
        "between_samples": page["between"],
        "audit": tables.adversary_figures(m),
        "margins": page["margins"],
        "guarantee": m.gap["guarantee"],
        "diagnosis": page["diagnosis"]["verdict"] if page["diagnosis"] else None,
        **({"twin": {k: m.twin[k] for k in ("engine", "samples", "largest")}} if m.twin is not None else {}),
    }
