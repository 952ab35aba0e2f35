"""What `simgap check` prints."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from simgap.lint.costs import duration, size
from simgap.stages.check import Checked, conclusion


def show(console: Console, checked: Checked, case: Path) -> None:
    """A table of what the stages cost, the cells an axis, what the engine makes of the model file, and what follows."""
    if checked.costs:
        table = Table("stage", "what", "CPU time, about", "memory, about", box=None)
        for cost in checked.costs:
            table.add_row(cost.stage, f"{cost.count:,} {cost.of}", duration(cost.seconds), size(cost.bytes))
        console.print(table)
    for what, cells in checked.cells.items():
        console.print(f"cells of the {what}: {', '.join(f'{name} {count}' for name, count in cells.items())}")
    for finding in checked.findings:
        console.print(f"{finding.key}: {finding.problem}. {finding.remedy}", soft_wrap=True, highlight=False)
    if checked.compared and not checked.findings:
        console.print("Nothing in the model file that the engine drops or changes.")
    if not checked.costs:
        console.print(
            "Nothing here is to be computed but a diagnosis: there is no `domain:` with a simulator or a controller.",
            soft_wrap=True, highlight=False,
        )  # fmt: skip
    console.print(conclusion(checked, case), soft_wrap=True, highlight=False)
