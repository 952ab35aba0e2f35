"""The command line as a whole: the application, what its subcommands share, where their logs go."""

from __future__ import annotations

import logging
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
CasePath = Annotated[Path, typer.Argument(help="Case file (YAML).", show_default=False)]
Out = Annotated[Path, typer.Option(help="File to write.", show_default=False)]
Grid = Annotated[Path, typer.Option("--grid", help="Folder of a grid.", show_default=False)]
Shards = Annotated[list[Path], typer.Option("--rollouts", help="Roll-out shards of the grid, in order.")]
Borders = Annotated[
    Path | None, typer.Option("--borders", help="Samples on borders and beside switching surfaces; not for a robot.")
]
State = Annotated[str, typer.Option(help="Which state.", show_default=False)]
Log = Annotated[Path | None, typer.Option(help="File for the log of this stage; stderr if not given.")]


def start_log(path: Path | None) -> None:
    """Send this package's log to a file, or to stderr for a person at the keyboard."""
    if path is None:
        from rich.console import Console
        from rich.logging import RichHandler

        handler: logging.Handler = RichHandler(console=Console(stderr=True), show_path=False)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
        handler = logging.FileHandler(path, mode="a")  # engines append to the same file
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger = logging.getLogger("simgap")
    logger.handlers, logger.propagate = [handler], False
    logger.setLevel(logging.INFO)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"simgap {metadata.version('simgap')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Measure, bound and close the gap between a robot model, its simulator and its recordings."""
