"""Stage `index`: the page that links the reports of all cases."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from simgap.io.atomic import write_text
from simgap.io.documents import read_json
from simgap.io.pages import render


def run(summaries: Sequence[Path], out: Path) -> None:
    """Write the page.

    Raises:
        UserError: a summary that is missing or damaged.
    """
    rows = []
    for path in summaries:
        folder = Path(os.path.relpath(path.parent, out.parent))
        row = {**read_json(path), "page": (folder / "report.html").as_posix(), "trace": path.parent / "trace/trace.rrd"}
        row["diagnosed"] = (folder / "diagnosis" / "report.html").as_posix() if row["diagnosis"] is not None else None
        rows.append(row)
    write_text(out, render("index.html.j2", rows=rows))
