"""Subcommands of sweeps: all of one, a point's case, the page over the points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import Log, Out, app, new_file, start_log
from simgap.cli.terminal import say
from simgap.errors import UserError

SweepPath = Annotated[Path, typer.Argument(help="Sweep file (YAML).", show_default=False)]


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def sweep(
    context: typer.Context,
    file: SweepPath,
    cores: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 2,
) -> None:
    """Make every point of a sweep, one table and one page: results/sweeps/<name> of this folder.

    Other options, such as --dry-run, --unlock or --keep-going, are passed to Snakemake.
    """
    from simgap.cli.workflow import looks_on, require_made, snakemake, split
    from simgap.stages.sweep import checked_points

    files, words = split([str(file), *context.args])
    if len(files) != 1:
        raise UserError(f"{len(files) or 'no'} sweep files are given", remedy="Name one, such as sweeps/radii.yaml.")
    path = files[0]
    base, points = checked_points(path)
    target = f"results/sweeps/{path.stem}/report.html"
    snakemake(base.parent, [base.stem], cores, [*words, "--", target], path.parent)
    if not looks_on(words):
        require_made(Path(target))
        say(f"{path.stem}: {len(points)} points. Page: {target}, table: {Path(target).parent}/table.parquet")


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
