"""Runs to be explored on the page: zoom, values under the pointer, states and gap on one time axis.

Plotly draws them (`reports/plotly-basic.min.js`, MIT licence, inside the page). Where scripts are off and in print the
still pictures say the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.io import figure_style as style
from simgap.io.traces import GAP_AWARE, NOMINAL, TITLES, shown
from simgap.notation import axis_label
from simgap.report.figures.gap import scaled
from simgap.report.figures.traces import first_seconds
from simgap.report.material import Material
from simgap.report.scene import limits

HEIGHT = 190
"""Of a row, pixels."""


def runs_figure(m: Material) -> dict[str, Any]:
    """Plotly's data and layout: a row for each state, with both controllers, and a row for its gap in its bound."""
    states, units, safe = m.context.states, m.context.units, limits(m.context)
    runs = [shown(m.traces, kind) for kind in (NOMINAL, GAP_AWARE)]
    data: list[dict[str, Any]] = []
    shapes: list[dict[str, Any]] = []
    titles: list[str] = []
    for j, name in enumerate(states):
        state, own = axis_label(name, units), np.isfinite(runs[1].d[:, j])
        factor, unit = scaled(float(np.abs(runs[1].d[own, j]).max(initial=0.0)), units[name])
        gap = f"gap of {name} ({unit})"
        for trace in runs:
            data.append(_line(2 * j, state, TITLES[trace.controller], trace.t, trace.x[:, j]))
            data[-1]["line"]["color"] = style.COLOURS[trace.controller]
        for title, values in (("lower bound", runs[1].lo), ("upper bound", runs[1].hi), ("gap", runs[1].d)):
            data.append(_line(2 * j + 1, gap, title, runs[1].t[own], factor * values[own, j]))
            data[-1]["line"]["color"] = style.BLACK if title == "gap" else style.SKY
        data[-2]["fill"] = "tonexty"
        shapes += [_limit(2 * j, float(side)) for side in (safe.lo[j], safe.hi[j]) if np.isfinite(side)]
        titles += [state, gap]
    return {"data": data, "layout": _layout(titles, shapes, first_seconds({trace.controller: trace for trace in runs}))}


def _line(row: int, quantity: str, name: str, t: Floats, values: Floats) -> dict[str, Any]:
    """A line in a row; its name stands in the legend once, and a click on it there hides it in all rows."""
    return {
        "type": "scatter", "mode": "lines", "line": {"width": 1.5}, "x": _rounded(t), "y": _rounded(values),
        "xaxis": "x", "yaxis": _axis(row), "name": name, "legendgroup": name, "showlegend": row < 2,
        "hovertemplate": f"{quantity}, {name}: %{{y:.4g}}<extra></extra>",
    }  # fmt: skip


def _rounded(values: Floats) -> list[float | None]:
    """Numbers of six digits, which no screen can tell from all of them; None where there is none."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values]


def _limit(row: int, side: float) -> dict[str, Any]:
    line = {"color": style.GREEN, "width": 1.5}
    return {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "yref": _axis(row), "y0": side, "y1": side, "line": line}


def _axis(k: int) -> str:
    """Plotly's name of the y-axis of row k."""
    return f"y{k + 1}" if k else "y"


def _layout(titles: Sequence[str], shapes: Sequence[Any], until: float) -> dict[str, Any]:
    rows = [_axis(k) for k in range(len(titles))]
    axes = {
        row.replace("y", "yaxis"): {"title": {"text": title}, "zeroline": False}
        for row, title in zip(rows, titles, strict=True)
    }
    return axes | {
        "grid": {"rows": len(rows), "columns": 1, "xaxes": ["x"], "yaxes": rows, "ygap": 0.12},
        "xaxis": {"title": {"text": "time (s)"}, "anchor": rows[-1], "range": [0.0, until]},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "height": HEIGHT * len(rows) + 80,
        "margin": {"l": 60, "r": 10, "t": 10, "b": 40},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"},
        "shapes": list(shapes),
    }
