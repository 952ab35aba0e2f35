"""A certificate: what a controller promises and why, in plain files that `checker/` verifies without this package."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.gap.closed_form import ClosedFormGap
from simgap.gap.forms import Form
from simgap.gap.function import GapFunction
from simgap.gap.linear import LinearGap
from simgap.geometry import Box, Floats
from simgap.io.atomic import atomic
from simgap.model.prefix import prefix
from simgap.model.sampled import NominalModel
from simgap.specifications.solution import Solution

FORMAT, VERSION = "simgap certificate", 1
HEADER, INPUTS, WINNING = "certificate.json", "inputs.npy", "winning.npy"
BETWEEN = "What happens between two sampling instants: a certificate is about the states at them."
BLACK_BOX = (
    "That the bound of the gap holds for the simulator, which is a black box: the certificate takes it as stated, with "
    "the guarantee that stands in its header."
)
HARDWARE = "That the simulator, or its equations, describe the real plant."


@dataclass(frozen=True, eq=False)
class Certified:
    """What a certificate is made of.

    Attributes:
        case: its name. units: by state and input.
        model: the nominal map; bound: of its gap; known: the gap in closed form, None for a black box.
        solution: cells, winning domain, admissible inputs; input_set: U, (M, nu); input_names: in order.
        safe: the box in which an invariance stays.
    """

    case: str
    units: Mapping[str, str]
    model: NominalModel
    bound: GapFunction
    known: ClosedFormGap | None
    solution: Solution
    input_set: Floats
    input_names: Sequence[str]
    safe: Box


def write_certificate(folder: Path, what: Certified, record: Mapping[str, Any]) -> dict[str, Any]:
    """Write header and tables; `record` says what made them. Returns the header.

    Raises:
        UserError: what this version of the form does not cover.
    """
    tables = {INPUTS: what.solution.mask, WINNING: what.solution.winning.astype(np.uint8)}
    head = header(what)
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: _write_table(folder / name, table) for name, table in tables.items()}
    head |= {"files": files, "provenance": dict(record)}
    head["digest"] = digest(head)
    with atomic(folder / HEADER) as temporary:
        Path(temporary).write_text(json.dumps(head, indent=1) + "\n")
    return head


def header(what: Certified) -> dict[str, Any]:
    """Everything but the tables.

    Raises:
        UserError: a bound, a memory or an expression that the form does not cover.
    """
    solution, model, bound = what.solution, what.model, what.bound
    if solution.value is not None or solution.memory != 1:
        raise UserError(
            "a certificate covers invariance without latency, and this controller is for something else",
            key="synthesis.specification",
            remedy="The closed loop and the audit are what checks it.",
        )
    if not isinstance(bound, LinearGap):
        raise UserError(
            "a certificate covers bounds that are linear in a basis, and this one is not", key="gap.bound",
            remedy="Use gap.bound: scenario with a basis of terms, or constant.",
        )  # fmt: skip
    states, grid = bound.domain.states, solution.grid
    sides = zip(states, bound.lower, bound.upper, strict=True)
    not_covered = [BETWEEN, HARDWARE] if what.known is not None else [BETWEEN, BLACK_BOX, HARDWARE]
    return {
        "format": FORMAT,
        "version": VERSION,
        "kind": "invariance",
        "case": what.case,
        "states": [{"name": s, "unit": what.units[s]} for s in states],
        "inputs": [{"name": u, "unit": what.units[u]} for u in what.input_names],
        "grid": {
            "lo": _hex(grid.box.lo),
            "hi": _hex(grid.box.hi),
            "cells": list(grid.cells),
            "periodic": [j in grid.periodic for j in range(grid.box.size)],
        },
        "input_set": [_hex(row) for row in what.input_set],
        "domain": _ends(states, bound.domain.box),
        "safe": _ends(states, what.safe),
        "nominal": dict(zip(states, map(prefix, model.f), strict=True)),
        "gap": {s: {"lower": _form(lo), "upper": _form(hi)} for s, lo, hi in sides},
        "simulator": dict(zip(states, map(prefix, what.known.simulator), strict=True)) if what.known else None,
        "guarantee": [tier.text for tier in bound.tiers],
        "not_covered": not_covered,
    }


def digest(head: Mapping[str, Any]) -> str:
    """SHA-256 of the header without the key `digest`, as compact JSON with sorted keys."""
    rest = {key: value for key, value in head.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _form(form: Form) -> Any:
    """q.p + offset with the coefficients that the bound has."""
    terms = [
        ["*", float(q).hex(), prefix(e)] for q, e in zip(form.coefficients, form.basis.exprs, strict=True) if q != 0.0
    ]
    return ["+", float(form.offset).hex(), *terms]


def _hex(values: Floats) -> list[str]:
    return [float(v).hex() for v in values]


def _ends(states: Sequence[str], box: Box) -> dict[str, list[str]]:
    return {s: _hex(np.array([lo, hi])) for s, lo, hi in zip(states, box.lo, box.hi, strict=True)}


def _write_table(path: Path, table: NDArray[Any]) -> str:
    """Write an array as .npy: -> SHA-256 of the file."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(table), allow_pickle=False)
    with atomic(path) as temporary:
        Path(temporary).write_bytes(stream.getvalue())
    return hashlib.sha256(stream.getvalue()).hexdigest()
