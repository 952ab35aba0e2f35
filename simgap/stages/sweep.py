"""Stage `sweep`: cases of its points, and one table and page over their results."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import yaml

from simgap import reading
from simgap.config.named_files import move_files, plugin_copies, with_plugin_copies
from simgap.config.run import Point, base_of, load_sweep, points_of_sweep
from simgap.errors import UserError
from simgap.gap.bounds.load import from_json
from simgap.io.atomic import write_text
from simgap.io.pages import render
from simgap.io.results import read_json, write_parquet
from simgap.late import pyarrow as pa
from simgap.lint.costs import affordable, costs
from simgap.plants.context import Context
from simgap.report.figures.sweep import figure
from simgap.stages import Argument, Option, Out, SweepPath

GAP = "gap.json"
LEFT_OUT = ("provenance", "checksum", "guarantee", "case", "title", "verdict")
SHOWN = ("promise_kept", "sup_gamma", "winning_fraction", "audit.violations", "size", "width")
"""Figures on the page; all of them are in the table."""


def checked_points(path: Path) -> tuple[Path, list[Point]]:
    """The case that a sweep varies, and its points, each checked against the budget before any of them runs.

    Raises:
        UserError: a sweep that is none, or a point that costs too much, with the values that make it.
    """
    base, points = base_of(path), points_of_sweep(path)
    for point in points:
        context = Context(point.case, base)
        if point.case.gap is None and point.case.hidden_state is None:
            raise UserError("asks for no bound, which is what a sweep is over", file=base, key="gap", remedy="Add it.")
        if point.case.domain is None:
            continue
        try:
            affordable(context, costs(context))
        except UserError as error:
            values = ", ".join(f"{key} = {value}" for key, value in point.values.items())
            remedy = error.remedy
            raise UserError(f"the point {values}: {error.problem}", file=path, key=error.key, remedy=remedy) from None
    return base, points


def write_point(path: SweepPath, name: Annotated[str, Argument("Name of the point.")], out: Out) -> None:
    """Write the case file of one point; its model files are named as they are found from there.

    Raises:
        UserError: a sweep that is none, or no point of that name.
    """
    found = [p for p in points_of_sweep(path) if p.name == name]
    if not found:
        raise UserError(f"has no point '{name}'", file=path, key="axes", remedy="Its values have changed: run again.")
    folder = base_of(path).parent
    copies = plugin_copies(found[0].case, folder, out.parent)
    content = with_plugin_copies(found[0].content, copies)
    for copy in copies:  # first: a case does not name what is not there
        write_text(out.parent / copy.file, copy.content.decode())
    move_files(content, lambda name: reading.relative(folder / name, out.parent))
    write_text(out, f"# A point of the sweep {path.name}.\n" + yaml.safe_dump(content, sort_keys=False))


def run(
    path: SweepPath,
    results: Annotated[list[Path], Option("summary.json or gap.json of each point, in order.", "--result")],
    out: Out,
    table_out: Annotated[Path, Option("File for the table (Parquet).", "--table", "file")],
) -> None:
    """Write table and page of a sweep.

    Args:
        path: sweep file. results: summary.json (or gap.json) of its points, in their order.
        out: page. table_out: table, one row a point: its keys, then every figure.

    Raises:
        UserError: another number of results than points, or one that is damaged.
    """
    points = points_of_sweep(path)
    if len(points) != len(results):
        raise UserError(f"has {len(points)} points, {len(results)} results are given", file=path, remedy="Run again.")
    rows = [
        {"point": p.name, **{k: _plain(v) for k, v in p.values.items()}, **_figures(file)}
        for p, file in zip(points, results, strict=True)
    ]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    write_parquet(table_out, pa.table({name: _column([row.get(name) for row in rows]) for name in columns}))
    keys = list(dict.fromkeys(key for p in points for key in p.values))
    shown = [c for c in columns if c not in ("point", *keys) and c.startswith(SHOWN)]
    pages = [Path(os.path.relpath(file.parent / "report.html", out.parent)).as_posix() for file in results]
    links = [page if (out.parent / page).exists() else None for page in pages]
    sweep = load_sweep(path)
    title = sweep.title or f"Sweep {path.stem} over {', '.join(keys)}"
    drawn = figure(keys, shown, rows)
    about = {"title": title, "case": Path(sweep.case).stem, "file": table_out.name, "figure": drawn}
    pairs = list(zip(rows, links, strict=True))
    write_text(out, render("sweep.html.j2", **about, keys=keys, shown=shown, rows=pairs))


def _figures(file: Path) -> dict[str, Any]:
    """Figures of a summary, or of a bound with its suprema."""
    content = read_json(file)
    if file.name != GAP:
        return flat(content)
    return flat({"sup_gamma": {s: asdict(sup) for s, sup in from_json(content).sup().items()}}) | flat(content)


def flat(content: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Figures of a nested document by dotted name; texts and lists are left out."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        if not above and key in LEFT_OUT:
            continue
        if isinstance(value, Mapping):
            found |= flat(value, f"{above}{key}.")
        elif isinstance(value, bool | int | float):
            found[f"{above}{key}"] = value
    return found


def _plain(value: Any) -> Any:
    return value if isinstance(value, bool | int | float | str) else json.dumps(value)


def _column(values: list[Any]) -> pa.Array:
    kinds = {type(v) for v in values if v is not None}
    if kinds <= {int, float} and len(kinds) > 1:
        return pa.array([None if v is None else float(v) for v in values])
    if len(kinds) > 1:
        return pa.array([None if v is None else str(v) for v in values])
    return pa.array(values)
