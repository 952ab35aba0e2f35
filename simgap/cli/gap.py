"""Subcommands from the grid to the bound of the gap."""

from __future__ import annotations

import logging
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import AsJson, Borders, CasePath, Grid, Log, Out, Shards, app, new_file, new_folder, start_log
from simgap.cli.terminal import console, say_json


@app.command()
def check(
    case: CasePath,
    out: Annotated[Path | None, typer.Option(help="File for what was found (JSON).", callback=new_file)] = None,
    as_json: AsJson = False,
    log: Log = None,
) -> None:
    """Check a case before anything runs: model file, engine, cells, and what every stage will cost."""
    from simgap.cli.checked import show
    from simgap.cli.progress import progress
    from simgap.stages import check as stage

    start_log(log)
    if log is None:  # the findings are shown below
        logging.getLogger("simgap").setLevel(logging.ERROR)
    with progress("reading the case") as tell:
        checked = stage.run(case, out, log, tell)
    if as_json:
        say_json(asdict(checked))
    else:
        show(console(), checked, case)


@app.command()
def grid(
    case: CasePath,
    out: Annotated[
        Path,
        typer.Option(help="Folder to write states and inputs to (Parquet).", show_default=False, callback=new_folder),
    ],
    point: Annotated[
        str | None,
        typer.Option(help="eps~ and the radius of the balls that cover X; hidden-state or full-table for a robot."),
    ] = None,
    log: Log = None,
) -> None:
    """Cover X by samples, or list the earlier inputs that stand for a hidden state, and write them with the inputs."""
    from simgap.stages import grid as stage

    start_log(log)
    stage.run(case, point, out)


@app.command()
def rollouts(
    case: CasePath,
    out: Out,
    samples: Grid,
    shard: Annotated[int, typer.Option(help="Which part of the grid.")] = 0,
    log: Log = None,
) -> None:
    """Run the simulator on one shard of grid x inputs."""
    from simgap.stages import rollouts as stage

    start_log(log)
    stage.run(case, samples, shard, out, log)


@app.command()
def fresh(
    case: CasePath,
    out: Out,
    workers: Annotated[int, typer.Option(help="Engine processes.")] = 2,
    log: Log = None,
) -> None:
    """Run the simulator on random samples that no fit will see."""
    from simgap.stages import fresh as stage

    start_log(log)
    stage.run(case, out, log, workers)


@app.command()
def borders(
    case: CasePath,
    out: Out,
    point: Annotated[str | None, typer.Option(help="eps~ and the radius of the balls that cover X.")] = None,
    log: Log = None,
) -> None:
    """Run the simulator on the border of X and on both sides of switching surfaces."""
    from simgap.stages import borders as stage

    start_log(log)
    stage.run(case, point, out, log)


@app.command()
def calibration(
    case: CasePath,
    out: Out,
    workers: Annotated[int, typer.Option(help="Engine processes.")] = 2,
    log: Log = None,
) -> None:
    """Run the simulator on random samples that set the width of a conformal bound."""
    from simgap.stages import calibration as stage

    start_log(log)
    stage.run(case, out, log, workers)


@app.command()
def scp(case: CasePath, samples: Grid, shards: Shards, out: Out, borders: Borders = None, log: Log = None) -> None:
    """Solve the scenario programs of the gap, one for each dimension."""
    from simgap.stages import scp as stage

    start_log(log)
    stage.run(case, samples, shards, out, borders)


@app.command()
def lipschitz(case: CasePath, samples: Grid, shards: Shards, out: Out, log: Log = None) -> None:
    """Estimate the Lipschitz constants of the gap, one for each dimension."""
    from simgap.stages import lipschitz as stage

    start_log(log)
    stage.run(case, samples, shards, out)


@app.command()
def gap(
    case: CasePath,
    grid: Grid,
    shards: Shards,
    programs: Annotated[Path, typer.Option("--scp", help="Scenario programs.")],
    slopes: Annotated[Path, typer.Option("--lipschitz", help="Lipschitz estimates.")],
    checked: Annotated[Path, typer.Option("--fresh", help="Fresh samples to check the bound on.")],
    out: Out,
    samples: Annotated[Path, typer.Option(help="File for thinned samples, for pictures (Parquet).")],
    borders: Borders = None,
    drawn: Annotated[Path | None, typer.Option("--calibration", help="Samples for a conformal bound.")] = None,
    log: Log = None,
) -> None:
    """Put the dimensions together to a bound of the gap by a function of state and input, and check it."""
    from simgap.stages import gap as stage

    start_log(log)
    stage.run(case, stage.Inputs(grid, shards, programs, slopes, checked, drawn, borders), out, samples)
