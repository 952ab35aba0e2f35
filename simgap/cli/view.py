"""`simgap view`: opens the recording of a case, of a diagnosis or of a witness in Rerun's viewer, on loopback."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import app
from simgap.errors import UserError

RECORDINGS = ("trace/trace.rrd", "trace.rrd", "residual.rrd", "diagnosis/residual.rrd")
"""Where recordings stand in a folder of results, the first that is there is meant."""
LOOPBACK = "127.0.0.1"  # Rerun's own default is every network that the machine is on


@app.command()
def view(
    what: Annotated[
        Path, typer.Argument(help="results/CASE, the folder of a diagnosis, or a recording.", show_default=False)
    ],
    web: Annotated[bool, typer.Option("--web", help="In the browser; so it is where there is no display.")] = False,
    only_print: Annotated[bool, typer.Option("--print", help="Print the command and stop.")] = False,
) -> None:
    """Open a recording in Rerun's viewer, which no other machine can reach."""
    file = recording_of(what)
    words = command(file, web or not displayed())
    if only_print:
        typer.echo(shlex.join(words))
        return
    others = [str(p) for p in (what / name for name in RECORDINGS) if p.is_file() and p != file]
    typer.echo(f"Opening {file}" + (f" (there is also {', '.join(others)})" if others else ""))
    raise typer.Exit(_until_closed(words))


def recording_of(what: Path) -> Path:
    """The recording that is meant by a file or a folder of results.

    Raises:
        UserError: none is there.
    """
    if what.suffix == ".rrd" and what.is_file():
        return what
    folder = what if what.is_dir() else what.parent
    found = next((folder / name for name in RECORDINGS if (folder / name).is_file()), None)
    if found is None or not what.exists():
        raise UserError(
            "no recording here" if what.exists() else "does not exist", file=what,
            remedy="Give results/CASE of a case that has run to its end, the --out of a diagnosis, or a .rrd file.",
        )  # fmt: skip
    return found


def displayed() -> bool:
    """Whether a window can be opened here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def command(file: Path, web: bool) -> Sequence[str]:
    """What opens a recording, in a window or in the browser."""
    viewer = Path(sys.executable).with_name("rerun")
    shown = [str(viewer) if viewer.is_file() else "rerun", str(file), "--bind", LOOPBACK, "--port", "auto"]
    return [*shown, "--web-viewer"] if web else shown


def _until_closed(words: Sequence[str]) -> int:
    """Run the viewer to its end: -> its status. What starts it is a wrapper, so all of its group is ended with it."""
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
