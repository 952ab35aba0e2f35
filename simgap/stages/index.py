"""Stage `index`: the page that shows all cases side by side and links their reports."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Annotated, Any

from simgap import reading
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.pages import render
from simgap.io.results import read_json
from simgap.report.tables import overview
from simgap.stages import Option, Out, log

PICTURE = "picture.png"


def run(
    summaries: Annotated[list[Path], Option("summary.json of each case.", "--summary")],
    out: Out,
    earlier: Annotated[list[Path] | None, Option("summary.json of cases of other runs.")] = None,
) -> None:
    """Write the page: the cases of this run, then those that earlier runs made.

    Raises:
        UserError: a summary of this run that is missing or damaged; an earlier one is left out, and the log says so.
    """
    rows = [_row(path, out) for path in summaries]
    for path in earlier or ():
        try:
            rows.append(_row(path, out))
        except UserError as error:
            log.warning("%s", error)
    write_text(out, render("index.html.j2", rows=rows))


def _row(path: Path, out: Path) -> dict[str, Any]:
    """A case: its figures, its pages, its picture; the same of its corrected case below it."""
    folder = Path(os.path.relpath(path.parent, out.parent))
    row = _figures(path) | {
        "page": (folder / "report.html").as_posix(),
        "results": path.parent.as_posix(),
        "picture": _picture(path.with_name(PICTURE)),
    }
    row["diagnosed"] = (folder / "diagnosis/report.html").as_posix() if row["diagnosis"] is not None else None
    later, row["corrected"] = path.parent / "corrected/summary.json", None
    if row["diagnosed"] and reading.is_file(later):
        row["corrected"] = _figures(later) | {
            "page": (folder / "corrected/report.html").as_posix(),
            "case_file": (folder / "diagnosis/corrected_case.yaml").as_posix(),
        }
    return row


def _figures(path: Path) -> dict[str, Any]:
    """Figures that the page shows of a case.

    Raises:
        UserError: a summary that is missing, damaged, or of another version.
    """
    content = read_json(path)
    try:
        return {k: content[k] for k in ("title", "promise_kept", "verdict", "diagnosis")} | overview(content)
    except (KeyError, TypeError):
        raise UserError("the summary is of another version", file=path, remedy="Run its report again.") from None


def _picture(path: Path) -> str | None:
    """A PNG as an address that carries it, so that the page stands alone; None if there is none."""
    if not reading.is_file(path):
        return None
    return f"data:image/png;base64,{base64.b64encode(reading.read_bytes(path)).decode()}"
