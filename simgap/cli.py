"""The command line: one subcommand a stage, each named like its rule and its module."""

from __future__ import annotations

import logging
import sys
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import typer

from simgap.errors import SimgapError, UserError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
# Typer carries a click of its own; its usage errors are found through one of them.
_USAGE: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")
CasePath = Annotated[Path, typer.Argument(help="Case file (YAML).", show_default=False)]
Out = Annotated[Path, typer.Option(help="File to write.", show_default=False)]
Grid = Annotated[Path, typer.Option("--grid", help="Folder of a grid.", show_default=False)]
Shards = Annotated[list[Path], typer.Option("--rollouts", help="Roll-out shards of the grid, in order.")]
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


@app.command()
def grid(
    case: CasePath,
    out: Annotated[Path, typer.Option(help="Folder to write states and inputs to (Parquet).", show_default=False)],
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
def scp(case: CasePath, state: State, samples: Grid, shards: Shards, out: Out, log: Log = None) -> None:
    """Solve the scenario program of one dimension of the gap."""
    from simgap.stages import scp as stage

    start_log(log)
    stage.run(case, state, samples, shards, out)


@app.command()
def lipschitz(case: CasePath, state: State, samples: Grid, shards: Shards, out: Out, log: Log = None) -> None:
    """Estimate the Lipschitz constant of one dimension of the gap."""
    from simgap.stages import lipschitz as stage

    start_log(log)
    stage.run(case, state, samples, shards, out)


@app.command()
def gap(
    case: CasePath,
    grid: Grid,
    shards: Shards,
    programs: Annotated[list[Path], typer.Option("--scp", help="Scenario program of each state.")],
    slopes: Annotated[list[Path], typer.Option("--lipschitz", help="Lipschitz estimate of each state.")],
    checked: Annotated[Path, typer.Option("--fresh", help="Fresh samples to check the bound on.")],
    out: Out,
    samples: Annotated[Path, typer.Option(help="File for thinned samples, for pictures (Parquet).")],
    drawn: Annotated[Path | None, typer.Option("--calibration", help="Samples for a conformal bound.")] = None,
    log: Log = None,
) -> None:
    """Put the dimensions together to a bound of the gap by a function of state and input, and check it."""
    from simgap.stages import gap as stage

    start_log(log)
    stage.run(case, stage.Inputs(grid, shards, programs, slopes, checked, drawn), out, samples)


@app.command()
def synthesis(
    case: CasePath,
    out: Out,
    summary: Annotated[Path, typer.Option(help="File for the figures of the synthesis (JSON).")],
    bound: Annotated[Path | None, typer.Option("--gap", help="gap.json; the nominal model alone if not given.")] = None,
    workers: Annotated[int, typer.Option(help="Threads.")] = 2,
    log: Log = None,
) -> None:
    """Synthesise the controller on the abstraction of f with its gap, or of f alone."""
    from simgap.stages import synthesis as stage

    start_log(log)
    stage.run(case, bound, out, summary, workers)


@app.command()
def validation(
    case: CasePath,
    nominal: Annotated[Path, typer.Option(help="Controller made for the nominal model.")],
    robust: Annotated[Path, typer.Option(help="Controller made for the model with its gap.")],
    bound: Annotated[Path, typer.Option("--gap", help="gap.json")],
    out: Out,
    traces: Annotated[Path, typer.Option(help="File for the traces that are kept (Parquet).")],
    workers: Annotated[int, typer.Option(help="Engine processes.")] = 2,
    log: Log = None,
) -> None:
    """Run both controllers in the simulator and on the nominal model, and count what they promise."""
    from simgap.stages import validation as stage

    start_log(log)
    stage.run(case, nominal, robust, bound, out, traces, workers, log)


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
    printed: Annotated[Path | None, typer.Option(help="Values that the paper prints (YAML).")] = None,
    log: Log = None,
) -> None:
    """Write the page of a case: pictures, tables and what the guarantee rests on."""
    from simgap.stages import report as stage

    start_log(log)
    controllers, syntheses = stage.by_kind(nominal, robust), stage.by_kind(nominal_summary, robust_summary)
    measured = stage.Measured(diagnosis, transitions) if diagnosis is not None else None
    later = stage.corrected_files(corrected, corrected_gap, corrected_summary, corrected_nominal, corrected_robust)
    given = stage.Inputs(gaps, samples, controllers, syntheses, validation, traces, measured, later, printed)
    stage.run(case, given, out, summary)


@app.command()
def index(
    summaries: Annotated[list[Path], typer.Option("--summary", help="summary.json of each case.")],
    out: Out,
    log: Log = None,
) -> None:
    """Write the page that links the reports of all cases."""
    from simgap.stages import index as stage

    start_log(log)
    stage.run(summaries, out)


@app.command()
def rig(
    file: Annotated[Path, typer.Argument(help="Rig file (YAML).", show_default=False)], out: Out, log: Log = None
) -> None:
    """Move a stand-in for hardware and record it."""
    from simgap.stages import rig as stage

    start_log(log)
    stage.run(file, out, log)


@app.command()
def diagnose(
    case: CasePath,
    data: Annotated[list[Path] | None, typer.Argument(help="Recordings; those of the case if none is given.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("diagnosis"),
    log: Log = None,
) -> None:
    """Find the physical effect that the nominal model lacks, from recordings."""
    from rich.console import Console
    from rich.markup import escape

    from simgap.stages import diagnosis as stage

    journal = log or out / "diagnosis.log"
    start_log(journal)
    try:
        with Console(stderr=True).status("starting") as status:
            result = stage.run(case, data or [], out, lambda words: status.update(escape(words)))
    except UserError:  # nothing half-written is left, the log of a default place included
        if log is None:
            journal.unlink(missing_ok=True)
            with suppress(OSError):
                out.rmdir()
        raise
    for line in (f"{result['verdict']}: {result['sentence']}", f"Report: {out / 'report.html'}"):
        Console().print(line, soft_wrap=True, highlight=False, markup=False)


@app.command()
def paper(
    folder: Annotated[Path, typer.Argument(help="Folder with the paper's cases and printed.yaml.")],
    pendulum: Annotated[Path, typer.Option(help="Case whose simulator is PyBullet with its default inertia.")],
    out: Out,
    workers: Annotated[int, typer.Option(help="Threads.")] = 2,
    log: Log = None,
) -> None:
    """Show what the paper's printed gap functions allow, and printed numbers beside reproduced ones."""
    from simgap.paper import table
    from simgap.stages import paper as stage

    start_log(log)
    typer.echo(table(stage.run(folder, pendulum, out, workers, log)))


@app.command()
def effects(case: Annotated[Path | None, typer.Argument(help="Case file; lists what it can act on.")] = None) -> None:
    """List the effects with formula, parameters and units; with a case, what each can act on."""
    from simgap.stages.effects import listing

    typer.echo(listing(case))


@app.command()
def schema(out: Annotated[Path, typer.Option(help="File to write.")] = Path("configs/schema.json")) -> None:
    """Write the JSON schema of case files, for editors that complete and check."""
    from simgap.config.schema import schema_text
    from simgap.io.atomic import write_text

    write_text(out, schema_text())


def main(arguments: list[str] | None = None) -> None:
    """Entry point: a person's mistake is one line on stderr and status 2, a broken promise status 1."""
    logging.getLogger("simgap").addHandler(logging.NullHandler())  # without a log, errors are told once, below
    try:
        result: Any = app(arguments if arguments is not None else sys.argv[1:], standalone_mode=False)
        status = result if isinstance(result, int) else 0
    except SimgapError as error:
        if any(isinstance(h, logging.FileHandler) for h in logging.getLogger("simgap").handlers):
            logging.getLogger("simgap").error("%s", error)
        sys.stderr.write(f"simgap: {error}\n")
        status = error.exit_status
    except _USAGE as error:
        sys.stderr.write(f"simgap: {error} (simgap --help lists what there is)\n")
        status = 2
    except (typer.Abort, KeyboardInterrupt):
        sys.stderr.write("simgap: interrupted\n")
        status = 130
    finally:
        for handler in logging.getLogger("simgap").handlers[:]:
            logging.getLogger("simgap").removeHandler(handler)
            handler.close()
    sys.exit(status)


if __name__ == "__main__":
    main()
