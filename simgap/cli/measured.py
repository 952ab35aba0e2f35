"""Subcommands around measured data: a rig that stands in for hardware, and the diagnosis."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import AsJson, CasePath, Log, Out, app, new_folder, start_log, values_of
from simgap.cli.terminal import say, say_json
from simgap.errors import UserError
from simgap.io.atomic import no_links_below


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
    out: Annotated[Path, typer.Option(help="Folder for the results.", callback=new_folder)] = Path("diagnosis"),
    as_json: AsJson = False,
    log: Log = None,
) -> None:
    """Find the physical effect that the nominal model lacks, from recordings."""
    from simgap.cli.progress import progress
    from simgap.stages import diagnosis as stage

    if out != Path():  # before the search, and not when its results are written; beside the case there may be links
        no_links_below(out)
    journal = log or out / "diagnosis.log"
    start_log(journal)
    out.mkdir(parents=True, exist_ok=True)  # paths of the corrected case begin there
    try:
        with progress("starting") as tell:
            result = stage.run(case, data or [], out, tell)
    except (UserError, OSError, MemoryError):  # nothing half-written is left, the log of a default place included
        if log is None:
            journal.unlink(missing_ok=True)
        with suppress(OSError):
            out.rmdir()
        raise
    if as_json:
        say_json(result)
        return
    first, *rest = result.get("sentences", [result["sentence"]])
    for line in (f"{result['verdict']}: {first}", *rest, *result["columns"], f"Report: {out / 'report.html'}"):
        say(line)


@app.command("next")
def next_experiment(
    case: CasePath,
    found: Annotated[Path, typer.Argument(help="Folder of a diagnosis of it.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the results.", callback=new_folder)] = Path("next"),
    seconds: Annotated[float | None, typer.Option(min=0.0, help="How long the recording is, s.")] = None,
    start: Annotated[str, typer.Option(help="State at its first sample, such as q=0.5,v=0.")] = "",
    log: Log = None,
) -> None:
    """Propose the recording that separates explanations that a diagnosis left open."""
    from simgap.cli.progress import progress
    from simgap.stages import next as stage

    start_log(log or out / "next.log")
    with progress("starting") as tell:
        result = stage.run(case, found, out, seconds, values_of(start, "--start"), tell)
    for line in (result["paragraph"], f"Picture: {out / 'next.png'}" if result["input"] else ""):
        say(line)
