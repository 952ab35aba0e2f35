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
    pairs, alone = len(states) // 2, len(states) % 2
    shown_inputs = 1 <= len(drives) <= 2
    widths = [3.0] * pairs + [0.9] * alone + [2.2 if len(drives) == 2 else 0.9] * shown_inputs
    figure, (panels,) = style.panels(1, len(widths), 3.7, width_ratios=widths)
    for k in range(pairs):
        _states(panels[k], box, (2 * k, 2 * k + 1), states, units)
        specified((2 * k, 2 * k + 1), panels[k])
        _room(panels[k])
    if alone:
        _interval(panels[pairs], box.lo[-1], box.hi[-1], axis_label(states[-1], units))
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
    axis.set(**{f"{side}label": axis_label(states[j], units) for side, j in zip("xy", pair, strict=True)})


def _interval(axis: Any, lo: float, hi: float, label: str) -> None:
    _x_box(axis, (-BAR, lo), (2 * BAR, hi - lo))
    _room(axis)
    axis.set(xlim=(-1, 1), xticks=[], ylabel=label)


def _room(axis: Any) -> None:
    """Limits a little beyond everything that was drawn."""
    axis.margins(0.05)
    axis.autoscale()


def _inputs(axis: Any, values: Floats, drives: Sequence[str], units: Mapping[str, str]) -> None:
    """Each value of U as a dot; of very many, the corners of their box."""
    shown = np.unique(values, axis=0)
    if len(shown) > MOST_DOTS:
        shown = np.array(list(product(*zip(values.min(axis=0), values.max(axis=0), strict=True))))
    if len(drives) == 1:
        axis.plot(np.zeros(len(shown)), shown[:, 0], "o", color=style.PURPLE, ms=4, label="value of U")
        axis.set(xlim=(-1, 1), xticks=[], ylabel=axis_label(drives[0], units))
    else:
        axis.plot(shown[:, 0], shown[:, 1], "o", color=style.PURPLE, ms=2.5, label="value of U")
        axis.set(xlabel=axis_label(drives[0], units), ylabel=axis_label(drives[1], units))
