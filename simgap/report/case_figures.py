"""The pictures of a case's page, each as text to put into it and as a file."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.rerun.recording import PlanarScene
from simgap.io.results import stack
from simgap.io.traces import GAP_AWARE, NOMINAL, SIMULATOR, first_seconds, shown
from simgap.notation import axis_label
from simgap.plants.context import Context
from simgap.report.figures import cells, gap, runs
from simgap.report.scene import limits, scene
from simgap.report.tables import Material, promised_steps, sweep
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space

NAMES = ("problem", "bound", "inputs", "sweep", "domains", "trajectories", "gap", "times", "corrected", "margins")
DENSE = ("bound", "inputs", "margins")  # too many paths for SVG
DPI, SMALL_DPI = 170, 62


def png(figure: Any, dpi: int) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    style.save(figure, buffer, "png", dpi)
    return buffer.getvalue()


def embedded(data: bytes) -> str:
    """A PNG as an image element that carries it."""
    from markupsafe import Markup

    text = base64.b64encode(data).decode()
    return Markup(f'<img alt="" style="width: 100%" src="data:image/png;base64,{text}">')


@dataclass(frozen=True)
class Drawn:
    """The pictures of a page.

    Attributes:
        markup: by name, empty where a case has no use for one.
        files: the same pictures as files, by file name; picture: a small PNG that stands for the case.
    """

    markup: Mapping[str, Any]
    files: Mapping[str, bytes]
    picture: bytes


def draw(m: Material) -> Drawn:
    """Every figure that the case has a use for."""
    figures: dict[str, Any] = dict.fromkeys(NAMES, "")
    files: dict[str, bytes] = {}
    picture = b""
    with style.figure_style():
        made = {"problem": _problem(m), **_bound(m), "sweep": _sweep(m), **_loop(m), "margins": _margins(m)}
        if m.corrected is not None and len(m.context.states) == 2:
            made["corrected"] = cells.domains_figure(m.corrected.controllers, [], m.context.units)
        plane = len(m.context.states) == 2 and made.get("domains") is not None
        small = "domains" if plane else "trajectories"  # where the controllers win, or the runs where that takes slices
        for name, figure in made.items():
            if figure is None:
                continue
            if name in DENSE:
                files[f"{name}.png"] = png(figure, DPI)
                figures[name] = embedded(files[f"{name}.png"])
            else:
                figures[name] = style.svg_text(figure)
                files[f"{name}.svg"] = figures[name].encode()
            if name == small:
                picture = png(figure, SMALL_DPI)
    return Drawn(figures, files, picture)


def _problem(m: Material) -> Any:
    """X, U and what the specification asks for; None where a single state leaves nothing to draw."""
    context = m.context
    if len(context.states) < 2:
        return None

    names = context.states, context.inputs
    return problem_figure(
        context.box, context.input_set, names, context.units, lambda pair, axis: surroundings(context, pair)(axis)
    )


def _bound(m: Material) -> dict[str, Any]:
    """The bound over states or, where it depends on two inputs alone, over these."""
    by_input = gap.over_inputs(m.bound) if len(m.context.inputs) == 2 else None
    if by_input is not None:
        return {"inputs": gap.inputs_figure(m.bound, *by_input, m.context.units)}
    states, inputs = m.context.states, m.context.inputs
    x, u = stack(m.samples, states), stack(m.samples, inputs)
    d = stack(m.samples, [f"gap_{n}" for n in states])
    return {"bound": gap.bound_figure(m.bound, x, u, d, m.context.units)}


def _sweep(m: Material) -> Any:
    rows = sweep(m)
    return gap.sweep_figure(rows, m.context.states, m.context.units) if len(rows) > 1 else None


def _loop(m: Material) -> dict[str, Any]:
    """Winning domains, trajectories, the gap along the run, and the times to the target where there is one."""
    context, where = m.context, scene(m.context)
    chosen = {kind: shown(m.traces, kind) for kind in (NOMINAL, GAP_AWARE)}
    until = first_seconds(chosen)
    steps = {k: t[SIMULATOR].get("steps_to_target", ()) for k, t in m.validation["controllers"].items()}
    out = {"gap": runs.gap_figure(chosen[GAP_AWARE], context.states, context.units, until)}
    if len(context.states) == 2:
        out["domains"] = cells.domains_figure(
            m.controllers, m.traces, context.units, surroundings(context), specification_of(context.case).words.violated
        )
    elif len(context.states) == 3:
        out["domains"] = cells.domain_slices_figure(
            m.controllers[GAP_AWARE], context.units, specification_of(context.case).words.goal
        )
    if isinstance(where, PlanarScene):
        draw_floor = surroundings(context, where.axes[:2])
        out["trajectories"] = runs.arena_figure(where, m.traces, context.units, context.states, draw_floor)
    else:
        section, towards = context.case.validation, any(len(s) for s in steps.values())
        stuck = 0.0 if section is None or towards else section.steps * (1.0 - 1e-9) * context.domain.tau
        out["trajectories"] = runs.trajectories_figure(
            chosen, m.traces, limits(context), context.states, context.inputs, context.units, stuck,
            specification_of(context.case).bands(Space.of(context.case)),
        )  # fmt: skip
    if any(len(s) for s in steps.values()):
        out["times"] = runs.times_figure(steps, context.domain.tau, promised_steps(m))
    return out


def _margins(m: Material) -> Any:
    """Maps of the one-step margins over two or three states; None where they are not known."""
    grid, states = m.controllers[GAP_AWARE].grid, m.context.states
    if m.margins is None or m.margins.num_rows != grid.size or not 2 <= len(states) <= 3:
        return None
    factor, loses_by = m.margins["factor"].to_numpy().astype(np.float64), m.margins["loses_by"].to_numpy()
    return cells.margins_figure(grid, factor, loses_by, states, m.context.units)


def surroundings(context: Context, axes: tuple[int, int] = (0, 1)) -> Callable[[Any], None]:
    """Function that draws the specification over two states on axes of matplotlib."""
    specification, space = specification_of(context.case), Space.of(context.case)
    return lambda own: specification.draw(own, space, axes, style.SURROUNDINGS)


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
