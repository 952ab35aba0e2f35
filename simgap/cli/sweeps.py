"""Subcommands of sweeps: all of one, a point's case, the page over the points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import Log, Out, app, new_file, start_log

SweepPath = Annotated[Path, typer.Argument(help="Sweep file (YAML).", show_default=False)]


@app.command()
def sweep(
    file: SweepPath,
    cores: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 2,
) -> None:
    """Make every point of a sweep, one table and one page: results/sweeps/<name> of this folder."""
    from simgap.cli.workflow import snakemake
    from simgap.config.sweep import base_of, points_of_sweep

    points_of_sweep(file)
    base = base_of(file)
    snakemake(base.parent, [base.stem], cores, ["--", f"results/sweeps/{file.stem}/report.html"], file.parent)


@app.command()
def point(
    file: SweepPath,
    name: Annotated[str, typer.Argument(help="Name of the point.", show_default=False)],
    out: Out,
    log: Log = None,
) -> None:
    """Write the case of one point of a sweep."""
    from simgap.stages import sweep as stage

    start_log(log)
    stage.write_point(file, name, out)


@app.command(name="sweep-page")
def sweep_page(
    file: SweepPath,
    results: Annotated[list[Path], typer.Option("--result", help="summary.json or gap.json of each point, in order.")],
    out: Out,
    table: Annotated[Path, typer.Option(help="File for the table (Parquet).", callback=new_file)],
    log: Log = None,
) -> None:
    """Write the table and the page of a sweep."""
    from simgap.stages import sweep as stage

    start_log(log)
    stage.run(file, results, out, table)
