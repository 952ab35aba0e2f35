"""The command line: one subcommand a stage, each named like its rule and its module."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from simgap.errors import SimgapError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Measure, bound and close the gap between a robot model, its simulator and its recordings.",
)
_USAGE = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")  # typer carries its own click
CasePath = Annotated[Path, typer.Argument(help="Case file (YAML).", show_default=False)]
Out = Annotated[Path, typer.Option(help="File to write.", show_default=False)]
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


@app.command()
def rollouts(
    case: CasePath,
    out: Out,
    eps: Annotated[float, typer.Option(help="Radius of the balls that cover X.", show_default=False)],
    shard: Annotated[int, typer.Option(help="Which part of the grid.")] = 0,
    log: Log = None,
) -> None:
    """Run the simulator on one shard of grid x inputs."""
    from simgap.stages import rollouts as stage

    start_log(log)
    stage.run(case, eps, shard, out, log)


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
def gap(
    case: CasePath,
    shards: Annotated[list[Path], typer.Option("--rollouts", help="Roll-out shards of one eps.")],
    eps: Annotated[float, typer.Option(help="Radius of the balls that cover X.", show_default=False)],
    checked: Annotated[Path, typer.Option("--fresh", help="Fresh samples to check the bound on.")],
    out: Out,
    samples: Annotated[Path, typer.Option(help="File for thinned samples, for pictures (Parquet).")],
    log: Log = None,
) -> None:
    """Bound the gap by a function of state and input, and check the bound on fresh samples."""
    from simgap.stages import gap as stage

    start_log(log)
    stage.run(case, eps, shards, checked, out, samples)


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
def schema(out: Annotated[Path, typer.Option(help="File to write.")] = Path("configs/schema.json")) -> None:
    """Write the JSON schema of case files, for editors that complete and check."""
    from simgap.config.schema import schema_text
    from simgap.io.atomic import write_text

    write_text(out, schema_text())


def main(arguments: list[str] | None = None) -> None:
    """Entry point: a person's mistake is one line on stderr and status 2, a broken promise status 1."""
    try:
        result: Any = app(arguments if arguments is not None else sys.argv[1:], standalone_mode=False)
        status = result if isinstance(result, int) else 0
    except SimgapError as error:
        logging.getLogger("simgap").error("%s", error)
        sys.stderr.write(f"simgap: {error}\n")
        status = error.exit_status
    except _USAGE as error:
        sys.stderr.write(f"simgap: {error.format_message()} (simgap --help lists what there is)\n")
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
