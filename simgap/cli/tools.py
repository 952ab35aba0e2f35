"""Commands beside the stages: where time went, a witness again, the paper's numbers, the schema and the reference."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simgap import reading
from simgap.cli.terminal import AsJson, CasePath, Log, Out, console, new_file, say, say_json, start_log, values_of
from simgap.errors import UserError

if TYPE_CHECKING:
    from simgap.io.runs import JobTime


def times(
    results: Annotated[Path, typer.Argument(help="Folder of results, or of one case.")] = Path("results"),
    as_json: AsJson = False,
) -> None:
    """Show where the time of a run went: each job's wall time, CPU time and memory, the costliest first."""
    from simgap.io.runs import job_times

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


def why(
    case: CasePath,
    at: Annotated[str, typer.Option(help="The state: q=0.5,v=0.", show_default=False)],
    results: Annotated[Path | None, typer.Option(help="Results of the case; by default results/<case>.")] = None,
) -> None:
    """Say why the controller of a run wins or loses at a state: what its inputs run into, and what loses the cell."""
    from simgap.stages import why as stage

    for sentence in stage.run(case, values_of(at, "--at"), results):
        say(sentence)


def replay(
    witness: Annotated[Path, typer.Argument(help="witness.json of an audit.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Recording for Rerun to write.", callback=new_file)] = None,
) -> None:
    """Simulate a witness of an audit again, and print it step by step."""
    from simgap.stages import replay as stage

    start_log(None)
    say(stage.run(witness, out))


def shield(
    what: Annotated[Path, typer.Argument(help="Case file, or its folder in results/.", show_default=False)],
    policy: Annotated[
        str, typer.Option(help="my.py:policy, a function of the measured state that gives the input; or random.")
    ] = "random",
    runs: Annotated[int, typer.Option(min=1, help="How many.")] = 100,
    controller: Annotated[Path | None, typer.Option(help="controller.npz, if it is elsewhere.")] = None,
    bound: Annotated[Path | None, typer.Option("--gap", help="gap.json, if it is elsewhere.")] = None,
    as_json: AsJson = False,
    log: Log = None,
) -> None:
    """Run a policy in the simulator of a case, alone and through the controller's shield, and count violations."""
    from simgap.extras import shield as stage

    start_log(log)
    found = stage.run(what, policy, runs, controller, bound, log)
    if as_json:
        say_json(found)
    else:
        say(stage.text(found))


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


def reference(out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("docs/reference")) -> None:
    """Write the pages of all keys of a case and of all effects."""
    from simgap.io.atomic import write_text
    from simgap.stages.reference import reference as pages

    for name, text in pages().items():
        write_text(out / name, text)


RECORDINGS = ("trace/trace.rrd", "trace.rrd", "residual.rrd", "diagnosis/residual.rrd")
"""Where recordings stand in a folder of results, the first that is there is meant."""
LOOPBACK = "127.0.0.1"  # Rerun's own default is every network that the machine is on


def view(
    what: Annotated[
        Path, typer.Argument(help="results/CASE, the folder of a diagnosis, or a recording.", show_default=False)
    ],
    web: Annotated[bool, typer.Option("--web", help="In the browser, the default without a display.")] = False,
    only_print: Annotated[bool, typer.Option("--print", help="Print the command and exit.")] = False,
) -> None:
    """Open a recording in Rerun's viewer, on this machine only."""
    file = recording_of(what)
    words = command(file, web or not displayed())
    if only_print:
        say(shlex.join(words))
        return
    others = [str(p) for p in (what / name for name in RECORDINGS) if reading.is_file(p) and p != file]
    say(f"Opening {file}" + (f" (there is also {', '.join(others)})" if others else ""))
    raise typer.Exit(_until_closed(words))


def recording_of(what: Path) -> Path:
    """The recording that is meant by a file or a folder of results.

    Raises:
        UserError: none is there.
    """
    if what.suffix == ".rrd" and reading.is_file(what):
        return what
    folder = what if what.is_dir() else what.parent
    found = next((folder / name for name in RECORDINGS if reading.is_file(folder / name)), None)
    if found is None or not what.exists():
        remedy = "Give results/CASE of a case that has run to its end, the --out of a diagnosis, or a .rrd file."
        raise UserError("no recording here" if what.exists() else "does not exist", file=what, remedy=remedy)
    return found


def displayed() -> bool:
    """True if a window can be opened here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def command(file: Path, web: bool) -> Sequence[str]:
    """Words of a command that opens a recording, in a window or in the browser."""
    viewer = Path(sys.executable).with_name("rerun")
    shown = [str(viewer) if reading.is_file(viewer) else "rerun", str(file), "--bind", LOOPBACK, "--port", "auto"]
    return [*shown, "--web-viewer"] if web else shown


def _until_closed(words: Sequence[str]) -> int:
    """Run the viewer to its end: -> its status. A wrapper starts it, so its group is ended."""
    try:
        viewer = subprocess.Popen(words, start_new_session=True)
    except FileNotFoundError:
        raise UserError("Rerun's viewer is not installed", key=words[0], remedy="pip install rerun-sdk") from None
    try:
        return viewer.wait()
    except KeyboardInterrupt:
        return 0
    finally:
        with suppress(ProcessLookupError):
            os.killpg(viewer.pid, signal.SIGTERM)
