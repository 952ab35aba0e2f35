"""Commands beside the stages: where time went, a witness again, the paper's numbers, the schema and the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simgap.cli.options import AsJson, Log, Out, new_file, start_log
from simgap.cli.terminal import console, say, say_json

if TYPE_CHECKING:
    from simgap.io.job_times import JobTime


def times(
    results: Annotated[Path, typer.Argument(help="Folder of results, or of one case.")] = Path("results"),
    as_json: AsJson = False,
) -> None:
    """Show where the time of a run went: every job with its wall time, CPU time and memory, the costliest first."""
    from simgap.io.job_times import job_times

    jobs = job_times(results)
    if as_json:
        say_json([asdict(job) for job in jobs])
    else:
        _show_times(jobs)


def _show_times(jobs: Sequence[JobTime]) -> None:
    """A table of the jobs, the costliest first, with the share of the CPU time that each and all before it took."""
    from rich.table import Table

    from simgap.lint.costs import duration, size

    out = console()
    total, so_far = sum(job.cpu for job in jobs), 0.0
    table = Table("case", "job", "wall time", "CPU time", "so far", "memory", box=None)
    for job in jobs:
        so_far += job.cpu
        share = f"{so_far / total:.0%}" if total else "-"
        table.add_row(job.case, job.job, duration(job.wall), duration(job.cpu), share, size(job.memory))
    out.print(table)
    last = datetime.fromtimestamp(max(job.ended for job in jobs)).astimezone()
    out.print(f"{len(jobs)} jobs, {duration(total)} of CPU time; the last ended on {last:%Y-%m-%d at %H:%M %Z}")


def replay(
    witness: Annotated[Path, typer.Argument(help="witness.json of an audit.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Recording for Rerun to write.", callback=new_file)] = None,
) -> None:
    """Simulate a witness of an audit again, and print it step by step."""
    from simgap.stages import replay as stage

    start_log(None)
    say(stage.run(witness, out))


def paper(
    folder: Annotated[Path, typer.Argument(help="Folder with the paper's cases and printed.yaml.")],
    pendulum: Annotated[Path, typer.Option(help="Case whose simulator is PyBullet with its default inertia.")],
    out: Out,
    workers: Annotated[int, typer.Option(help="Threads.")] = 2,
    log: Log = None,
) -> None:
    """Show what the paper's printed gap functions allow, and printed numbers beside reproduced ones."""
    from simgap.extras import paper as stage
    from simgap.extras.paper import table

    start_log(log)
    say(table(stage.run(folder, pendulum, out, workers, log)))


def schema(
    out: Annotated[Path, typer.Option(help="File to write.", callback=new_file)] = Path("configs/schema.json"),
) -> None:
    """Write the JSON schema of case files, for editors that complete and check."""
    from simgap.config.case import schema_text
    from simgap.io.atomic import write_text

    write_text(out, schema_text())


def reference(
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("docs/reference"),
) -> None:
    """Write the pages of all keys of a case and of all effects."""
    from simgap.io.atomic import write_text
    from simgap.stages.reference import reference as pages

    for name, text in pages().items():
        write_text(out / name, text)
