"""Stage `effects`: the library as a person reads it, and what of it applies to a case."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from simgap.effects import EFFECTS, Effect
from simgap.model.symbolic import SymbolicModel
from simgap.notation import pretty_unit
from simgap.plants.context import Context


def _units(kind: Effect, model: SymbolicModel | None, found: Sequence[str]) -> list[tuple[str, Mapping[str, str]]]:
    """Rows of an effect: one for all its targets where their units are the same, else one for each (target, units)."""
    rows: list[tuple[str, Mapping[str, str]]] = []
    if model is not None:
        rows = [(on, kind.units(model, on)) for on in found]
    if not rows:
        return [("", {p.symbol: p.unit for p in kind.parameters})]
    return [("", rows[0][1])] if all(units == rows[0][1] for _, units in rows) else rows


def listed(case_path: Path | None) -> dict[str, Any]:
    """Effects with formula and parameters, of a case those that it can have: why not the others, its own parameters."""
    model = None
    if case_path is not None:
        context = Context.load(case_path)
        with context.blame():
            model = context.plant.declared
    effects = list[dict[str, Any]]()
    lacking: dict[str, list[str]] = {}
    for name, kind in EFFECTS.items():
        found = kind.targets(model) if model is not None else ()
        if model is not None and not found:
            lacking.setdefault(kind.needs, []).append(name)
            continue
        targets = kind.kind if model is None else ", ".join(found)
        for on, units in _units(kind, model, found):
            parameters = [
                {"symbol": p.symbol, "description": p.description, "unit": pretty_unit(units[p.symbol])}
                for p in kind.parameters
            ]
            effects.append({"effect": name, "on": on or targets, "formula": kind.formula, "parameters": parameters})
    named = model.named_parameters.values() if model is not None else ()
    return {
        "effects": effects,
        "not on this plant": lacking,
        "parameters": [{"name": p.name, "declared": p.value, "unit": pretty_unit(p.unit)} for p in named],
    }


def printed(found: Mapping[str, Any]) -> str:
    """Tables of what `listed` gives."""
    buffer = io.StringIO()
    console = Console(file=buffer, width=160, markup=False, emoji=False)
    table = Table("effect", "on", "formula", "parameters", box=None, pad_edge=False)
    for row in found["effects"]:
        about = [(p["symbol"], filter(None, (p["description"], p["unit"]))) for p in row["parameters"]]
        symbols = ", ".join(f"{symbol} ({', '.join(words)})" for symbol, words in about)
        table.add_row(row["effect"], row["on"], row["formula"], symbols)
    console.print(table)
    for needs, absent in found["not on this plant"].items():
        console.print(f"\nNot on this plant, which lacks {needs}: {', '.join(absent)}.")
    if found["parameters"]:
        named = Table("parameter", "declared", "unit", box=None, pad_edge=False)
        for parameter in found["parameters"]:
            named.add_row(parameter["name"], f"{parameter['declared']:.6g}", parameter["unit"])
        console.print("\nNamed parameters of the plant (what parameter_error can scale):")
        console.print(named)
    return buffer.getvalue()
