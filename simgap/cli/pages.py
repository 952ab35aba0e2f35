"""Subcommands for what a person looks at: recording, page, index."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import CasePath, Log, Out, app, new_folder, start_log
from simgap.cli.terminal import say


@app.command()
def trace(
    case: CasePath,
    nominal: Annotated[Path, typer.Option(help="Controller made for the nominal model.")],
    robust: Annotated[Path, typer.Option(help="Controller made for the model with its gap.")],
    traces: Annotated[Path, typer.Option(help="Traces that the validation kept (Parquet).")],
    out: Out,
    log: Log = None,
) -> None:
    """Record the closed loop for Rerun, and read the recording back."""
    from simgap.stages import trace as stage

    start_log(log)
    stage.run(case, nominal, robust, traces, out)


@app.command()
def report(
    case: CasePath,
    gaps: Annotated[list[Path], typer.Option("--gap", help="gap.json of each eps.")],
    samples: Annotated[Path, typer.Option(help="Thinned samples of the gap (Parquet).")],
    nominal: Annotated[Path, typer.Option(help="Controller made for the nominal model.")],
    nominal_summary: Annotated[Path, typer.Option(help="Its synthesis.json.")],
    robust: Annotated[Path, typer.Option(help="Controller made for the model with its gap.")],
    robust_summary: Annotated[Path, typer.Option(help="Its synthesis.json.")],
    validation: Annotated[Path, typer.Option(help="validation.json")],
    traces: Annotated[Path, typer.Option(help="Traces that the validation kept (Parquet).")],
    out: Out,
    summary: Annotated[Path, typer.Option(help="File for the figures that a script wants (JSON).")],
    diagnosis: Annotated[Path | None, typer.Option(help="diagnosis.json, if there is one.")] = None,
    transitions: Annotated[Path | None, typer.Option(help="Transitions that the diagnosis held out.")] = None,
    corrected: Annotated[Path | None, typer.Option(help="The corrected case, if it has results.")] = None,
    corrected_gap: Annotated[Path | None, typer.Option(help="Its gap.json.")] = None,
    corrected_summary: Annotated[Path | None, typer.Option(help="Its summary.json.")] = None,
    corrected_nominal: Annotated[Path | None, typer.Option(help="Its controller for the nominal model.")] = None,
    corrected_robust: Annotated[Path | None, typer.Option(help="Its controller for the model with its gap.")] = None,
    picture: Annotated[Path | None, typer.Option(help="File for a small PNG that stands for the case.")] = None,
    figures: Annotated[Path | None, typer.Option(help="Folder for the figures as files.", callback=new_folder)] = None,
    twin: Annotated[Path | None, typer.Option(help="twin.json, if the simulator stands for another engine.")] = None,
    printed: Annotated[Path | None, typer.Option(help="Values that the paper prints (YAML).")] = None,
    audit: Annotated[Path | None, typer.Option(help="audit.json")] = None,
    margins: Annotated[Path | None, typer.Option(help="Margins of every cell (Parquet).")] = None,
    later: Annotated[str | None, typer.Option(help="The page, seen from this one, that waits for all of it.")] = None,
    log: Log = None,
) -> None:
    """Write the page of a case: pictures, tables and what the guarantee rests on."""
    from simgap.stages import report as stage

    start_log(log)
    controllers, syntheses = stage.by_kind(nominal, robust), stage.by_kind(nominal_summary, robust_summary)
    measured = stage.Measured(diagnosis, transitions) if diagnosis is not None else None
    repaired = stage.corrected_files(corrected, corrected_gap, corrected_summary, corrected_nominal, corrected_robust)
    given = stage.Inputs(
        gaps, samples, controllers, syntheses, validation, traces, measured, repaired, printed, audit, margins, twin
    )
    stage.run(case, given, out, summary, picture, figures, later)
    whole = os.path.normpath(out.parent / (later or ""))
    follows = f", audit pending. Next: {whole}, after {stage.wait(case)}" if later is not None else ""
    say(f"Ready to open: {out}{follows}")


@app.command()
def index(
    summaries: Annotated[list[Path], typer.Option("--summary", help="summary.json of each case.")],
    out: Out,
    earlier: Annotated[list[Path] | None, typer.Option(help="summary.json of cases of other runs.")] = None,
    log: Log = None,
) -> None:
    """Write the page that links the reports of all cases."""
    from simgap.stages import index as stage

    start_log(log)
    stage.run(summaries, out, earlier or [])
