"""Commands about recordings: the diagnosis, the next recording, and the effects that a diagnosis may find."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.terminal import AsJson, CasePath, Log, new_folder, progress, say, say_json, start_log, values_of
from simgap.errors import UserError
from simgap.io.atomic import no_links_below


def diagnose(
    case: CasePath,
    data: Annotated[list[Path] | None, typer.Argument(help="Recordings; those of the case if none is given.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.", callback=new_folder)] = Path("diagnosis"),
    as_json: AsJson = False,
    log: Log = None,
) -> None:
    """Find the physical effects that the nominal model lacks, from recordings."""
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


def next_experiment(
    case: CasePath,
    found: Annotated[Path, typer.Argument(help="Folder of a diagnosis of it.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the results.", callback=new_folder)] = Path("next"),
    seconds: Annotated[float | None, typer.Option(min=0.0, help="How long the recording is, s.")] = None,
    start: Annotated[str, typer.Option(help="State at its first sample, such as q=0.5,v=0.")] = "",
    log: Log = None,
) -> None:
    """Propose a recording that separates the explanations a diagnosis left open."""
    from simgap.extras import next as stage

    start_log(log or out / "next.log")
    with progress("starting") as tell:
        result = stage.run(case, found, out, seconds, values_of(start, "--start"), tell)
    for line in (result["paragraph"], f"Picture: {out / 'next.png'}" if result["input"] else ""):
        say(line)


def effects(
    case: Annotated[Path | None, typer.Argument(help="Case file; lists what it can act on.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the effects with formula, parameters and units; with a case, what each can act on."""
    from simgap.stages.effects import listed, printed

    start_log(None)
    if as_json:
        say_json(listed(case))
    else:
        say(printed(listed(case)))
