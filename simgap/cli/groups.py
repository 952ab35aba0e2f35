"""The help of `simgap`: commands in groups, stages of the workflow only where they are asked for (`--all`)."""

from __future__ import annotations

from collections.abc import Sequence

import typer
from typer.core import TyperGroup

from simgap.cli.terminal import say

GROUPS: dict[str, Sequence[str]] = {
    "Your robot": ("tutorial", "new", "check", "run", "propose", "refine", "sweep", "certify", "export"),
    "Your recordings": ("diagnose", "next", "effects"),
    "Results": ("view", "times", "replay"),
    "Stages, which `simgap run` calls in order": (
        "grid", "rollouts", "fresh", "borders", "calibration", "scp", "lipschitz", "gap", "synthesis", "twin",
        "validation", "audit", "trace", "report", "index", "rig", "point", "sweep-page",
    ),
    "For those who work on simgap": ("paper", "schema", "reference"),
}  # fmt: skip
SHOWN = 3
"""So many groups stand in `simgap --help`; all of them in `simgap --all`."""


class Groups(TyperGroup):
    """Lists the commands of each group under its title, with the whole of their first sentence."""

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """Names in the order of the groups."""
        return [name for names in GROUPS.values() for name in names if name in self.commands]

    def format_commands(self, ctx: typer.Context, formatter: object) -> None:  # type: ignore[override]
        """Write the groups that are to be shown."""
        for title, names in list(GROUPS.items())[: None if ctx.meta.get("all") else SHOWN]:
            with formatter.section(title):  # type: ignore[attr-defined]
                formatter.write_dl([(n, self.commands[n].get_short_help_str(200)) for n in names])  # type: ignore[attr-defined]


def show_all(context: typer.Context, wanted: bool) -> None:
    """Callback of `--all`: the help with every group."""
    if wanted:
        context.meta["all"] = True
        say(context.get_help())
        raise typer.Exit
