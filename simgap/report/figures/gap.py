"""Pictures of the gap bound: its surface with the samples under it, over the inputs, and against eps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.function import GapFunction
from simgap.io import figure_style as style
from simgap.notation import axis_label, pretty_unit

_PREFIXES = ((1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""))
MESH = 25  # points a side of a surface


def scaled(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit with which numbers up to `largest` are printed: (2e-4, 'rad') -> (1e6, 'µrad')."""
    pretty = pretty_unit(unit)
    for size, prefix in reversed(_PREFIXES):
        if largest >= size or size == _PREFIXES[0][0]:
            return (1.0 / size, f"{prefix}{pretty}") if pretty else (1.0, "")
    return 1.0, pretty


def middle_input(gap: GapFunction) -> Floats:
    """The input of U nearest to its centre: (nu,)."""
    inputs = gap.domain.input_set
    centre = 0.5 * (inputs.min(axis=0) + inputs.max(axis=0))
    return np.asarray(inputs[np.argmin(np.abs(inputs - centre).sum(axis=1))])


def shown_inputs(gap: GapFunction) -> list[Floats]:
    """With one input its lowest, middle and highest value; with more, the middle of U: (nu,) each."""
    inputs = gap.domain.input_set
    if inputs.shape[1] != 1:
        return [middle_input(gap)]
    order = np.argsort(inputs[:, 0])
    return [np.asarray(inputs[k]) for k in dict.fromkeys((order[0], order[len(order) // 2], order[-1]))]


def surface_figure(gap: GapFunction, x: Floats, u: Floats, d: Floats, units: Mapping[str, str]) -> Any:
    """A row a state: the bound as surfaces over the first two states with samples, and what it leaves around them.

    Args:
        gap: the bound; at least two states.
        x, u, d: samples (n, nx), (n, nu), (n, nx); those of the inputs shown are put on the surfaces.
        units: of the states and inputs.
    """
    import matplotlib.pyplot as plt

    states = gap.domain.states
    n = len(states)
    figure = plt.figure(figsize=(style.WIDTH, 3.6 * n))
    figure.set_layout_engine("none")  # automatic layouts waste room around 3-D axes
    for i in range(n):
        bottom = (n - 1 - i) / n
        surface: Any = figure.add_axes((0.0, bottom + 0.02 / n, 0.56, 0.96 / n), projection="3d")
        _surfaces(surface, gap, i, x, u, d, units)
        _residual(figure.add_axes((0.67, bottom + 0.16 / n, 0.32, 0.74 / n)), gap, i, x, u, d, units)
    return figure


def _at(gap: GapFunction, u: Floats, units: Mapping[str, str]) -> str:
    pairs = zip(gap.domain.inputs, u, strict=True)
    return ", ".join(f"{n} = {round(v, 12) + 0.0:g} {pretty_unit(units.get(n, ''))}" for n, v in pairs)


def _surfaces(axes: Any, gap: GapFunction, i: int, x: Floats, u: Floats, d: Floats, units: Mapping[str, str]) -> None:
    """Upper and lower bound of one state for a few inputs, with the samples of these inputs."""
    box, chosen = gap.domain.box, shown_inputs(gap)
    gx, gy = np.meshgrid(*(np.linspace(box.lo[j], box.hi[j], MESH) for j in (0, 1)), indexing="ij")
    points = np.tile(0.5 * (box.lo + box.hi), (gx.size, 1))
    points[:, 0], points[:, 1] = gx.ravel(), gy.ravel()
    bounds = [gap.bounds(points, np.tile(at, (gx.size, 1))) for at in chosen]
    largest = float(max(np.abs(side[:, i]).max() for pair in bounds for side in pair))
    factor, unit = scaled(largest, units[gap.domain.states[i]])
    for pair, at in zip(bounds, chosen, strict=True):
        for values, colour in zip(pair, (style.ORANGE, style.BLUE), strict=True):
            height = factor * values[:, i].reshape(gx.shape)
            axes.plot_surface(gx, gy, height, color=colour, alpha=0.4, lw=0, rcount=MESH, ccount=MESH)
        own = np.abs(u - at).max(axis=1) < 1e-9
        axes.scatter(x[own, 0], x[own, 1], factor * d[own, i], s=3, color=style.BLACK, depthshade=False, lw=0)
        end = factor * float(pair[1][0, i])
        axes.text(box.lo[0], box.lo[1], end, f"{_at(gap, at, units)}  ", fontsize=11, ha="right", va="center")
    names = gap.domain.states
    axes.set_xlabel(axis_label(names[0], units), labelpad=6)
    axes.set_ylabel(axis_label(names[1], units), labelpad=6)
    axes.set_zlabel(f"gap of {names[i]} ({unit})", labelpad=5)
    axes.tick_params(labelsize=10, pad=1)
    for each in (axes.xaxis, axes.yaxis, axes.zaxis):
        each.set_major_locator(_locator(4))
    axes.view_init(elev=20, azim=-58)
    axes.set_box_aspect((1, 1, 0.9), zoom=0.93)


def _residual(axes: Any, gap: GapFunction, i: int, x: Floats, u: Floats, d: Floats, units: Mapping[str, str]) -> None:
    """Samples with the middle of the bound taken away, and the band that the bound leaves around it."""
    lo, hi = gap.bounds(x, u)
    middle, half = 0.5 * (lo + hi)[:, i], 0.5 * (hi - lo)[:, i]
    name = gap.domain.states[i]
    factor, unit = scaled(float(half.max()), units[name])
    order = np.argsort(x[:, 0])
    edge, widest, narrowest = _envelope(x[order, 0], half[order])
    for sign, colour, name_ in ((1.0, style.BLUE, "upper bound"), (-1.0, style.ORANGE, "lower bound")):
        axes.fill_between(edge, sign * factor * narrowest, sign * factor * widest, color=colour, alpha=0.45, lw=0)
        axes.plot(edge, sign * factor * narrowest, color=colour, lw=1.4, label=name_)
    axes.scatter(x[:, 0], factor * (d[:, i] - middle), s=1.2, color=style.BLACK, lw=0, label="samples", rasterized=True)
    axes.set_xlabel(axis_label(gap.domain.states[0], units))
    axes.set_ylabel(f"gap of {name} − middle ({unit})")
    axes.set_title("around the middle of the bound", fontsize=11)
    axes.margins(x=0)
    axes.set_ylim(top=1.55 * factor * float(half.max()))
    axes.legend(
        loc="upper center", ncols=3, markerscale=6, fontsize=9.5, columnspacing=0.7, handlelength=1.2, handletextpad=0.3
    )


def _envelope(x: Floats, half: Floats, bins: int = 60) -> tuple[Floats, Floats, Floats]:
    """Largest and smallest half-width in bins of sorted x."""
    parts = [p for p in np.array_split(np.arange(len(x)), min(bins, len(x))) if len(p)]
    centre = np.array([x[p].mean() for p in parts])
    centre[0], centre[-1] = x[0], x[-1]
    return centre, np.array([half[p].max() for p in parts]), np.array([half[p].min() for p in parts])


def _locator(count: int) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count)


def slices_figure(gap: GapFunction, x: Floats, u: Floats, d: Floats, units: Mapping[str, str]) -> Any:
    """A panel a state: its gap and bound along the state that it follows most, for plants with one state or many.

    The samples are `x` (n, nx), `u` (n, nu) and `d` (n, nx); those of the input at the middle of U are shown, with the
    hull of the bounds at them, whatever their other states are.
    """
    import matplotlib.pyplot as plt

    states, at = gap.domain.states, middle_input(gap)
    figure, axes = plt.subplots(1, len(states), figsize=(style.WIDTH, 3.2), squeeze=False)
    own = np.abs(u - at).max(axis=1) < 1e-9
    x, d = x[own], d[own]
    lo, hi = gap.bounds(x, np.tile(at, (len(x), 1)))
    for i, (axis, name) in enumerate(zip(axes[0], states, strict=True)):
        j = followed_axis(gap, x, d[:, i])
        edges, bins = _bins(gap, x, j)
        factor, unit = scaled(float(np.abs([lo[:, i], hi[:, i]]).max()), units[name])
        hull = np.array([[lo[bins == k, i].min(), hi[bins == k, i].max()] for k in np.unique(bins)]) * factor
        left, right = edges[np.unique(bins)], edges[np.unique(bins) + 1]
        for a, b, (low, high) in zip(left, right, hull, strict=True):
            axis.fill_between(
                [a, b], low, high, color=style.SKY, alpha=0.5, lw=0, label="bound" if a == left[0] else None
            )
        axis.scatter(x[:, j], factor * d[:, i], s=3, color=style.BLACK, lw=0, label="samples")
        axis.set_xlabel(axis_label(states[j], units))
        axis.set_ylabel(f"gap of {name} ({unit})")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2, markerscale=4)
    return figure


def followed_axis(gap: GapFunction, x: Floats, d: Floats) -> int:
    """The state along which means of samples (n,) at x (n, nx) differ most, none along which a translation holds."""
    moving = [j for j in range(x.shape[1]) if j not in gap.domain.free]
    spread = {}
    for j in moving:
        bins = _bins(gap, x, j)[1]
        spread[j] = sum(float(np.count_nonzero(bins == k)) * d[bins == k].mean() ** 2 for k in np.unique(bins))
    return max(moving, key=spread.__getitem__)


def _bins(gap: GapFunction, x: Floats, j: int, count: int = 24) -> tuple[Floats, Any]:
    """Edges of equal parts of X along state j, and the part of each sample."""
    edges = np.linspace(gap.domain.box.lo[j], gap.domain.box.hi[j], count + 1)
    return edges, np.clip(np.searchsorted(edges, x[:, j], side="right") - 1, 0, count - 1)


def over_inputs(gap: GapFunction) -> tuple[Floats, Floats] | None:
    """Bounds for each input, (M, nx) each, of a gap that depends on the input alone; None for any other.

    A gap given in the robot's own frame is returned in that frame; else the bound must vary over X by less than a
    hundredth of its size.
    """
    from simgap.gap.bounds.body_frame import BodyFrameGap

    if isinstance(gap, BodyFrameGap):
        return gap.lower, gap.upper
    box, inputs = gap.domain.box, gap.domain.input_set
    n = len(inputs)
    lo, hi = gap.box_bounds(np.tile(box.lo, (n, 1)), np.tile(box.hi, (n, 1)), inputs)
    point_lo, point_hi = gap.bounds(np.tile(0.5 * (box.lo + box.hi), (n, 1)), inputs)
    size = np.maximum(np.abs(lo), np.abs(hi)).max(axis=0)
    change = np.maximum(point_lo - lo, hi - point_hi).max(axis=0)
    return (lo, hi) if np.all(change <= 0.01 * size) else None


def inputs_figure(gap: GapFunction, lo: Floats, hi: Floats, units: Mapping[str, str]) -> Any:
    """A panel a state: the size of the bound over two inputs.

    Args:
        gap: names and inputs; lo, hi: bounds for each input, (M, nx).
        units: of states and inputs.
    """
    import matplotlib.pyplot as plt

    states, inputs = gap.domain.states, gap.domain.input_set
    size = np.maximum(np.abs(lo), np.abs(hi))
    first, second = (np.unique(inputs[:, j].round(12)) for j in (0, 1))
    rows, columns = (np.searchsorted(axis, inputs[:, j].round(12)) for j, axis in enumerate((first, second)))
    figure, axes = plt.subplots(1, len(states), figsize=(style.WIDTH, 3.7), squeeze=False, sharey=True)
    for i, (axis, name) in enumerate(zip(axes[0], states, strict=True)):
        factor, unit = scaled(float(size[:, i].max()), units[name])
        table = np.full((len(first), len(second)), np.nan)
        table[rows, columns] = factor * size[:, i]
        mesh = axis.pcolormesh(first, second, table.T, cmap="cividis", vmin=0.0, rasterized=True)
        axis.set_xlabel(axis_label(gap.domain.inputs[0], units))
        axis.set_title(name)
        axis.grid(visible=False)
        figure.colorbar(mesh, ax=axis, location="bottom", label=f"bound of the gap ({unit})", shrink=0.95)
    axes[0, 0].set_ylabel(axis_label(gap.domain.inputs[1], units))
    return figure


def sweep_figure(rows: Sequence[Mapping[str, Any]], states: Sequence[str], units: Mapping[str, str]) -> Any:
    """Suprema of the bound against eps, a panel a state, with values printed elsewhere where there are any.

    Args:
        rows: each {eps, states: {state: {size, width, sampled, printed (number or None)}}}, largest eps first.
        states: to show; units: of the states.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(states), figsize=(style.WIDTH, 3.4), squeeze=False)
    eps = [r["eps"] for r in rows]
    looks = (
        ("printed", style.VERMILLION, "s", "printed in the paper"),
        ("size", style.BLUE, "o", "sup of the size"),
        ("width", style.GREEN, "D", "sup of the width"),
        ("sampled", style.BLACK, "_", "largest sampled gap"),
    )
    for axis, state in zip(axes[0], states, strict=True):
        for key, colour, marker, label in looks:
            own = [(e, r["states"][state][key]) for e, r in zip(eps, rows, strict=True)]
            points = [(e, v) for e, v in own if v is not None and v > 0]
            if points:
                ls = "" if key == "sampled" else "-"
                axis.plot(*zip(*points, strict=True), color=colour, marker=marker, ms=8, ls=ls, label=label)
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xticks(eps, [f"{e:g}" for e in eps])
        axis.minorticks_off()
        axis.set_xlabel("eps, radius of the balls that cover X")
        axis.set_ylabel(f"{axis_label(state, units)}")
        axis.margins(0.15)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=4, columnspacing=1.0)
    return figure
