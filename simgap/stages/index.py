"""Stage `index`: the page that links the reports of all cases."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.documents import read_json
from simgap.io.pages import render
from simgap.stages.context import log


def run(summaries: Sequence[Path], out: Path, earlier: Sequence[Path] = ()) -> None:
    """Write the page: the cases of this run, then those that earlier runs made.

    Raises:
        UserError: a summary of this run that is missing or damaged; an earlier one is left out, and the log says so.
    """
    rows = [_row(path, out) for path in summaries]
    for path in earlier:
        try:
            rows.append(_row(path, out))
        except UserError as error:
            log.warning("%s", error)
    write_text(out, render("index.html.j2", rows=rows))


def _row(path: Path, out: Path) -> dict[str, Any]:
    folder = Path(os.path.relpath(path.parent, out.parent))
    row = {**read_json(path), "page": (folder / "report.html").as_posix(), "trace": path.parent / "trace/trace.rrd"}
    row["diagnosed"] = (folder / "diagnosis" / "report.html").as_posix() if row["diagnosis"] is not None else None
    return row
