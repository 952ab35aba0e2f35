"""Curves to be explored on a page: zoom, values under the pointer, all rows on one time axis.

Plotly draws them (`reports/plotly-basic.min.js`, MIT licence, inside the page). Where scripts are off and in print the
still pictures say the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.io import figure_style as style
from simgap.io.traces import GAP_AWARE, NOMINAL, TITLES, first_seconds, shown
from simgap.notation import axis_label
from simgap.report.figures.gap import scaled
from simgap.report.scene import limits
from simgap.report.tables import Material

HEIGHT = 190
"""Height of a row, pixels."""


@dataclass(frozen=True, eq=False)
class Row:
    """Lines of one quantity, as `line` makes them, and limits that are drawn across."""

    title: str
    lines: Sequence[dict[str, Any]]
    limits: Sequence[float] = ()


def line(name: str, t: Floats, values: Floats, colour: str, dash: str = "solid", **more: Any) -> dict[str, Any]:
    """A named line of a row, as Plotly takes it: t, values (n,), NaN where it breaks."""
    look = {"width": 1.5, "color": colour, "dash": dash}
    return {
        "type": "scatter", "mode": "lines", "name": name, "legendgroup": name, "line": look,
        "x": _rounded(t), "y": _rounded(values), **more,
    }  # fmt: skip


def explored_runs(m: Material) -> dict[str, Any]:
    """A row for each state, with both controllers, and a row for its gap in its bound."""
    runs = [shown(m.traces, kind) for kind in (NOMINAL, GAP_AWARE)]
    until = first_seconds({trace.controller: trace for trace in runs})
    return explored(list(_rows_of_runs(m, runs)), until)


def _rows_of_runs(m: Material, runs: Sequence[Any]) -> Iterator[Row]:
    units, safe = m.context.units, limits(m.context)
    for j, name in enumerate(m.context.states):
        states = [line(TITLES[r.controller], r.t, r.x[:, j], style.COLOURS[r.controller]) for r in runs]
        sides = [float(side) for side in (safe.lo[j], safe.hi[j]) if np.isfinite(side)]
        yield Row(axis_label(name, units), states, sides)
        aware, own = runs[1], np.isfinite(runs[1].d[:, j])
        factor, unit = scaled(float(np.abs(aware.d[own, j]).max(initial=0.0)), units[name])
        low, high, gap = (factor * values[own, j] for values in (aware.lo, aware.hi, aware.d))
        bound = [
            line("lower bound", aware.t[own], low, style.SKY),
            line("upper bound", aware.t[own], high, style.SKY, fill="tonexty"),
        ]
        yield Row(f"gap of {name} ({unit})", [*bound, line("gap", aware.t[own], gap, style.BLACK)])


def explored(rows: Sequence[Row], until: float, since: float = 0.0) -> dict[str, Any]:
    """Plotly's data and layout; a name stands in the legend once, and a click on it there hides it in all rows."""
    named = dict.fromkeys(own["name"] for row in rows for own in row.lines)
    data = []
    for k, row in enumerate(rows):
        for own in row.lines:
            name = own["name"]
            said = {"showlegend": name in named, "hovertemplate": f"{row.title}, {name}: %{{y:.4g}}<extra></extra>"}
            data.append({**own, **said, "xaxis": "x", "yaxis": _axis(k)})
            named.pop(name, None)
    shapes = [_limit(k, side) for k, row in enumerate(rows) for side in row.limits]
    return {"data": data, "layout": _layout([row.title for row in rows], shapes, [since, until])}


def _rounded(values: Floats) -> list[float | None]:
    """Numbers of six digits, which no screen can tell from all of them; None where there is none."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values]


def _limit(row: int, side: float) -> dict[str, Any]:
    look = {"color": style.GREEN, "width": 1.5}
    return {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "yref": _axis(row), "y0": side, "y1": side, "line": look}


def _axis(k: int) -> str:
    """Plotly's name of the y-axis of row k."""
    return f"y{k + 1}" if k else "y"


def _layout(titles: Sequence[str], shapes: Sequence[Any], span: Sequence[float]) -> dict[str, Any]:
    rows = [_axis(k) for k in range(len(titles))]
    axes = {
        row.replace("y", "yaxis"): {"title": {"text": title}, "zeroline": False}
        for row, title in zip(rows, titles, strict=True)
    }
    return axes | {
        "grid": {"rows": len(rows), "columns": 1, "xaxes": ["x"], "yaxes": rows, "ygap": 0.12},
        "xaxis": {"title": {"text": "time (s)"}, "anchor": rows[-1], "range": list(span)},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "height": HEIGHT * len(rows) + 80,
        "margin": {"l": 60, "r": 10, "t": 10, "b": 40},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"},
        "shapes": list(shapes),
    }
