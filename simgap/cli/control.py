"""Subcommands of the controller: synthesis and the closed loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import CasePath, Log, Out, Shards, app, new_file, start_log
from simgap.cli.terminal import say
from simgap.config.validation import Trials

TrialsOption = Annotated[Trials, typer.Option(help="How many, where the case does not say it.")]


@app.command()
def synthesis(
    case: CasePath,
    out: Out,
    summary: Annotated[Path, typer.Option(help="File for the figures of the synthesis (JSON).")],
    bound: Annotated[Path | None, typer.Option("--gap", help="gap.json; the nominal model alone if not given.")] = None,
    careful: Annotated[
        bool, typer.Option("--careful", help="Without a gap: check the path between samples (fair baseline).")
    ] = False,
    workers: Annotated[int, typer.Option(help="Threads.")] = 2,
    log: Log = None,
) -> None:
    """Synthesise the controller on the abstraction of f with its gap, or of f alone."""
    from simgap.stages import synthesis as stage

    start_log(log)
    stage.run(case, bound, out, summary, workers, careful)


@app.command()
def twin(
    case: CasePath,
    shards: Shards,
    fresh: Annotated[Path, typer.Option(help="Fresh samples.")],
    out: Out,
    traces: Annotated[Path | None, typer.Option(help="Traces that the validation kept (Parquet).")] = None,
    log: Log = None,
) -> None:
    """Compare the simulator with the engine that it stands for, on every sample of the run."""
    from simgap.stages import twin as stage

    start_log(log)
    stage.run(case, stage.Inputs(shards, fresh, traces), out, log)


@app.command()
def validation(
    case: CasePath,
    nominal: Annotated[Path, typer.Option(help="Controller made for the nominal model.")],
    robust: Annotated[Path, typer.Option(help="Controller made for the model with its gap.")],
    bound: Annotated[Path, typer.Option("--gap", help="gap.json")],
    out: Out,
    traces: Annotated[Path, typer.Option(help="File for the traces that are kept (Parquet).")],
    careful: Annotated[Path | None, typer.Option(help="Controller of the fair baseline.")] = None,
    trials: TrialsOption = Trials.PLAIN,
    workers: Annotated[int, typer.Option(help="Engine processes.")] = 2,
    log: Log = None,
) -> None:
    """Run both controllers in the simulator and on the nominal model, and count what they promise."""
    from simgap.stages import validation as stage

    start_log(log)
    stage.run(case, nominal, robust, bound, out, traces, workers, log, careful, trials)


@app.command()
def audit(
    case: CasePath,
    bound: Annotated[Path, typer.Option("--gap", help="gap.json")],
    controller: Annotated[Path, typer.Option(help="Controller made for the model with its gap.")],
    rollouts: Shards,
    fresh: Annotated[Path, typer.Option(help="Fresh samples (Parquet).")],
    out: Out,
    margins: Annotated[Path, typer.Option(help="File for the margins of every cell (Parquet).")],
    witness: Annotated[Path, typer.Option(help="File for what breaks the promise, if anything does (JSON).")],
    trials: TrialsOption = Trials.PLAIN,
    workers: Annotated[int, typer.Option(help="Engine processes.")] = 2,
    log: Log = None,
) -> None:
    """Let an adversary attack the bound and the controller; one violation fails."""
    from simgap.stages import audit as stage

    start_log(log)
    files = stage.Inputs(bound, controller, rollouts, fresh)
    stage.run(case, files, stage.Outputs(out, margins, witness), workers, log, trials)


@app.command()
def replay(
    witness: Annotated[Path, typer.Argument(help="witness.json of an audit.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Recording for Rerun to write.", callback=new_file)] = None,
) -> None:
    """Simulate a witness of an audit again, and print it step by step."""
    from simgap.stages import replay as stage

    start_log(None)
    say(stage.run(witness, out))
