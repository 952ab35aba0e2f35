"""The pictures of a case's page, each as text to put into it and as a file."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.io import figure_style as style
from simgap.io.rerun.recording import PlanarScene
from simgap.io.results import stack
from simgap.io.traces import GAP_AWARE, NOMINAL, SIMULATOR, first_seconds, shown
from simgap.plants.context import Context
from simgap.report.figures import cells, gap, problem, runs
from simgap.report.material import Material
from simgap.report.scene import limits, scene
from simgap.report.tables import promised_steps, sweep
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


def shown_on_the_index(made: Mapping[str, Any], states: int) -> str:
    """Figure that stands for a case: where the controllers win, or the runs where that takes slices."""
    return "domains" if states == 2 and made.get("domains") is not None else "trajectories"


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
        small = shown_on_the_index(made, len(m.context.states))
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

    def specified(pair: tuple[int, int], own: Any) -> None:
        surroundings(context, pair)(own)

    names = context.states, context.inputs
    return problem.problem_figure(context.box, context.input_set, names, context.units, specified)


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
    if len(states) == 3:
        return cells.margin_slices_figure(grid, factor, loses_by, states, m.context.units)
    extra = stack(m.margins, [f"extra_{n}" for n in states]).astype(np.float64)
    return cells.margins_figure(grid, factor, extra, loses_by, states, m.context.units)


def surroundings(context: Context, axes: tuple[int, int] = (0, 1)) -> Callable[[Any], None]:
    """Function that draws the specification over two states on axes of matplotlib."""
    specification, space = specification_of(context.case), Space.of(context.case)
    return lambda own: specification.draw(own, space, axes, style.SURROUNDINGS)
