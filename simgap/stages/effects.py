"""Stage `effects`: the library as a person reads it, and what of it applies to a case."""

from __future__ import annotations

import io
from pathlib import Path

from rich.console import Console
from rich.table import Table

from simgap.effects import EFFECTS
from simgap.stages.context import Context


def listing(case_path: Path | None) -> str:
    """The table of effects; with a case also the targets of each and the plant's named parameters."""
    buffer = io.StringIO()
    console = Console(file=buffer, width=160)
    model = None
    if case_path is not None:
        context = Context.load(case_path)
        with context.blame():
            model = context.plant.declared
    table = Table("effect", "on", "formula", "parameters", box=None, pad_edge=False)
    for name, kind in EFFECTS.items():
        symbols = ", ".join(f"{p.symbol} ({p.description}, {p.unit})" for p in kind.parameters)
        targets = kind.kind if model is None else ", ".join(kind.targets(model)) or "-"
        table.add_row(name, targets, kind.formula, symbols)
    console.print(table)
    if model is not None:
        named = Table("parameter", "declared", "unit", box=None, pad_edge=False)
        for parameter in model.named_parameters.values():
            named.add_row(parameter.name, f"{parameter.value:.6g}", parameter.unit)
        console.print("\nNamed parameters of the plant (what parameter_error can scale):")
        console.print(named)
    return buffer.getvalue()
