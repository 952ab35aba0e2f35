"""A picture of the question: states X and inputs U that the bound is for, and what the specification asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.notation import axis_label

PALE = "#EEF1F4"
MOST_DOTS = 2000  # of U; of more, the corners alone
BAR = 0.3  # half of the width of the interval of a single state


def problem_figure(
    box: Box,
    inputs: Floats,
    names: tuple[Sequence[str], Sequence[str]],
    units: Mapping[str, str],
    specified: Callable[[tuple[int, int], Any], None],
) -> Any:
    """X two states at a time with the specification on it, and U beside it.

    Args:
        box: X, (nx,); inputs: the values of U, (M, nu), drawn for one or two inputs.
        names: of the states, of the inputs; units: by name.
        specified: draws the specification over two states on axes.
    """
    states, drives = names
    pairs = [(j, j + 1) for j in range(0, len(states) - 1, 2)]
    alone = [len(states) - 1] if len(states) % 2 else []
    shown_inputs = 1 <= len(drives) <= 2
    widths = [3.0] * len(pairs) + [0.9] * len(alone) + [2.2 if len(drives) == 2 else 0.9] * shown_inputs
    figure, axes = style.panels(1, len(widths), 3.7, width_ratios=widths)
    panels = list(axes[0])
    for axis, pair in zip(panels, pairs, strict=False):
        _states(axis, box, pair, states, units)
        specified(pair, axis)
        _room(axis)
    for axis, j in zip(panels[len(pairs) :], alone, strict=False):
        _interval(axis, box.lo[j], box.hi[j], axis_label(states[j], units))
    panels[0].set_title("states")
    if shown_inputs:
        _inputs(panels[-1], inputs, drives, units)
        panels[-1].set_title("inputs")
    style.legend(figure)
    return figure


def _x_box(axis: Any, corner: tuple[float, float], size: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    axis.add_patch(Rectangle(corner, *size, facecolor=PALE, edgecolor=style.GREY, ls="--", lw=1.2, label="X"))
    axis.grid(visible=False)


def _states(axis: Any, box: Box, pair: tuple[int, int], states: Sequence[str], units: Mapping[str, str]) -> None:
    lo, hi = box.lo[list(pair)], box.hi[list(pair)]
    _x_box(axis, tuple(lo), tuple(hi - lo))
    axis.set_xlabel(axis_label(states[pair[0]], units))
    axis.set_ylabel(axis_label(states[pair[1]], units))


def _room(axis: Any) -> None:
    """Limits a little beyond everything that was drawn."""
    drawn = [p.get_path().get_extents(p.get_patch_transform()) for p in axis.patches]  # X is among them
    for limit, ends in ((axis.set_xlim, [b.intervalx for b in drawn]), (axis.set_ylim, [b.intervaly for b in drawn])):
        lo, hi = float(np.min(ends)), float(np.max(ends))
        limit(lo - 0.05 * (hi - lo), hi + 0.05 * (hi - lo))


def _interval(axis: Any, lo: float, hi: float, label: str) -> None:
    _x_box(axis, (-BAR, lo), (2 * BAR, hi - lo))
    axis.set_xlim(-1, 1)
    axis.set_ylim(lo - 0.05 * (hi - lo), hi + 0.05 * (hi - lo))
    axis.set_xticks([])
    axis.set_ylabel(label)


def _inputs(axis: Any, values: Floats, drives: Sequence[str], units: Mapping[str, str]) -> None:
    """Each value of U as a dot; of very many, the corners of their box."""
    shown = np.unique(values, axis=0)
    if len(shown) > MOST_DOTS:
        lo, hi = values.min(axis=0), values.max(axis=0)
        shown = np.array(list(product(*zip(lo, hi, strict=True))))
    if len(drives) == 1:
        axis.plot(np.zeros(len(shown)), shown[:, 0], "o", color=style.PURPLE, ms=4, label="value of U")
        axis.set_xlim(-1, 1)
        axis.set_xticks([])
        axis.set_ylabel(axis_label(drives[0], units))
    else:
        axis.plot(shown[:, 0], shown[:, 1], "o", color=style.PURPLE, ms=2.5, label="value of U")
        axis.set_xlabel(axis_label(drives[0], units))
        axis.set_ylabel(axis_label(drives[1], units))
