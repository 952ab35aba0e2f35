"""The picture of a sweep: curves over one numeric key, heat maps over two, nothing where keys are no numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.io import figure_style as style

MOST_PANELS = 4


def figure(keys: Sequence[str], shown: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> str | None:
    """SVG text over the first one or two keys with more than one value, or None if they are no numbers.

    Args:
        keys: dotted keys of the sweep; shown: names of figures; rows: keys and figures of each point.
    """
    varied = [k for k in keys if len({str(row.get(k)) for row in rows}) > 1]
    panels = [n for n in shown if _numeric(n, rows) and len({row[n] for row in rows}) > 1][:MOST_PANELS]
    if not 1 <= len(varied) <= 2 or not panels or not all(_numeric(k, rows) for k in varied):
        return None
    with style.figure_style():
        made, axes = style.panels(1, len(panels), 3.6, style.WIDTH * max(1.0, len(panels) / 2))
        for axis, name in zip(axes[0], panels, strict=True):
            axis.set(title=name, xlabel=varied[0])
            if len(varied) == 1:
                order = sorted(rows, key=lambda row: float(row[varied[0]]))
                x, y = ([float(row[k]) for row in order] for k in (varied[0], name))
                axis.plot(x, y, "o-", color=style.BLUE)
            else:
                _map(made, axis, varied, name, rows)
        return style.svg_text(made)


def _map(made: Any, axis: Any, keys: Sequence[str], name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    ticks = [sorted({float(row[k]) for row in rows}) for k in keys]
    values = np.full((len(ticks[1]), len(ticks[0])), np.nan)
    for row in rows:
        values[ticks[1].index(float(row[keys[1]])), ticks[0].index(float(row[keys[0]]))] = float(row[name])
    picture = axis.imshow(values, origin="lower", aspect="auto", cmap="cividis")
    axis.set_xticks(range(len(ticks[0])), [f"{v:g}" for v in ticks[0]])
    axis.set_yticks(range(len(ticks[1])), [f"{v:g}" for v in ticks[1]])
    axis.set_ylabel(keys[1])
    axis.grid(False)
    made.colorbar(picture, ax=axis)


def _numeric(name: str, rows: Sequence[Mapping[str, Any]]) -> bool:
    return all(isinstance(row.get(name), int | float) and not isinstance(row.get(name), bool) for row in rows)
