"""The thin layer that reads, calls and writes: one file a stage, named like its rule and its subcommand.

The arguments of a stage on the command line are those of its signature; `simgap.cli.commands` makes options of it.
A parameter is `Annotated[type, Argument(...)]` or `Annotated[type, Option(...)]`. One that is a dataclass stands for
its fields, and one without such a mark is for callers in Python.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from simgap.config.controller import Trials

log = logging.getLogger("simgap")


@dataclass(frozen=True)
class Argument:
    """A word at its place: its help, and what it is called there if not as the parameter."""

    help: str
    name: str | None = None


@dataclass(frozen=True)
class Option:
    """An option with its help.

    Attributes:
        flag: `--name`, if it is not the parameter's own name.
        writes: what is written there, a file or a folder; whether that can be is asked before anything is computed.
    """

    help: str
    flag: str | None = None
    writes: Literal["file", "folder"] | None = None


CasePath = Annotated[Path, Argument("Case file (YAML).", "case")]
SweepPath = Annotated[Path, Argument("Sweep file (YAML).", "file")]
Out = Annotated[Path, Option("File to write.", "--out", "file")]
Workers = Annotated[int, Option("Engine processes.")]
Grid = Annotated[Path, Option("Folder of a grid.", "--grid")]
Shards = Annotated[list[Path], Option("Roll-out shards of the grid, in order.", "--rollouts")]
Borders = Annotated[
    Path | None, Option("Samples on borders and beside switching surfaces; not for a robot.", "--borders")
]
Point = Annotated[str | None, Option("eps~ and the radius of the balls that cover X.")]
Gap = Annotated[Path, Option("gap.json", "--gap")]
NominalController = Annotated[Path, Option("Controller made for the nominal model.", "--nominal")]
HowMany = Annotated[Trials, Option("How many, if the case does not state it.", "--trials")]
GapAwareController = Annotated[Path, Option("Controller made for the model with its gap.", "--gap-aware")]
Traces = Annotated[Path, Option("Traces that the validation kept (Parquet).", "--traces")]
