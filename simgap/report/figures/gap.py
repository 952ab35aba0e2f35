"""Pictures of the gap bound: along a state with the samples in it, over the inputs, and against eps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.function import GapFunction
from simgap.io import figure_style as style
from simgap.notation import axis_label, pretty_unit

_PREFIXES = ((1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""))


def scaled(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit with which numbers up to `largest` are printed: (2e-4, 'rad') -> (1e6, 'µrad')."""
    pretty = pretty_unit(unit)
    size, prefix = next(((s, p) for s, p in reversed(_PREFIXES) if largest >= s), _PREFIXES[0])
    return (1.0 / size, f"{prefix}{pretty}") if pretty else (1.0, "")


def middle_input(gap: GapFunction) -> Floats:
    """The input of U nearest to its centre: (nu,)."""
    inputs = gap.domain.input_set
    centre = 0.5 * (inputs.min(axis=0) + inputs.max(axis=0))
    return np.asarray(inputs[np.argmin(np.abs(inputs - centre).sum(axis=1))])


def bound_figure(gap: GapFunction, x: Floats, u: Floats, d: Floats, units: Mapping[str, str]) -> Any:
    """A column a state: its gap and bound along the state that it follows most, and every sample between its bounds.

    The samples are `x` (n, nx), `u` (n, nu) and `d` (n, nx). Above are those of the input at the middle of U, with the
    hull of the bounds at them, whatever their other states are; below are the samples of all inputs.
    """
    states, at = gap.domain.states, middle_input(gap)
    figure, axes = style.panels(2, len(states), 4.8, sharex="col", height_ratios=[1.25, 1.0])
    own = np.abs(u - at).max(axis=1) < 1e-9
    lo, hi = gap.bounds(x, u)
    place = (d - 0.5 * (lo + hi)) / np.maximum(0.5 * (hi - lo), np.finfo(float).tiny)
    for (above, below), i in zip(axes.T, range(len(states)), strict=True):
        j = followed_axis(gap, x[own], d[own, i])
        edges, bins = _bins(gap, x[own], j)
        factor, unit = scaled(float(np.abs([lo[own, i], hi[own, i]]).max()), units[states[i]])
        filled = np.unique(bins)
        ends = np.array([[lo[own, i][bins == k].min(), hi[own, i][bins == k].max()] for k in filled]) * factor
        for left, right, (low, high) in zip(edges[filled], edges[filled + 1], ends, strict=True):
            above.fill_between([left, right], low, high, color=style.SKY, alpha=0.5, lw=0)
        above.scatter(x[own, j], factor * d[own, i], s=3, color=style.BLACK, lw=0)
        above.set_ylabel(f"gap of {states[i]} ({unit})")
        above.set_title(f"{states[i]} at {_at(gap, at, units)}", fontsize=11)
        below.scatter(x[:, j], place[:, i], s=1, color=style.BLACK, lw=0, label="samples", rasterized=True)
        below.set_xlabel(axis_label(states[j], units))
    places(axes[1])
    style.legend(figure, markerscale=6)
    return figure


def places(axes: Any) -> None:
    """Make axes (n,) show places between a lower bound, -1, and an upper one, 1."""
    for axis in axes:
        axis.axhspan(-1, 1, color=style.SKY, alpha=0.4, lw=0, label="bound")
        axis.set_ylim(-1.25, 1.25)
        axis.set_yticks([-1, 0, 1], ["lower", "middle", "upper"])
    axes[0].set_ylabel("place in the bound")


def _at(gap: GapFunction, u: Floats, units: Mapping[str, str]) -> str:
    pairs = zip(gap.domain.inputs, u, strict=True)
    return ", ".join(f"{n} = {round(v, 12) + 0.0:g} {pretty_unit(units.get(n, ''))}" for n, v in pairs)


def followed_axis(gap: GapFunction, x: Floats, d: Floats) -> int:
    """The state along which means of samples (n,) at x (n, nx) differ most, none along which a translation holds."""

    def spread(j: int) -> float:
        bins = _bins(gap, x, j)[1]
        return sum(float(np.count_nonzero(bins == k)) * d[bins == k].mean() ** 2 for k in np.unique(bins))

    return max((j for j in range(x.shape[1]) if j not in gap.domain.free), key=spread)


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
    states, inputs = gap.domain.states, gap.domain.input_set
    size = np.maximum(np.abs(lo), np.abs(hi))
    first, second = (np.unique(inputs[:, j].round(12)) for j in (0, 1))
    rows, columns = (np.searchsorted(axis, inputs[:, j].round(12)) for j, axis in enumerate((first, second)))
    figure, axes = style.panels(1, len(states), 3.7, sharey=True)
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
    figure, axes = style.panels(1, len(states), 3.4)
    eps = [r["eps"] for r in rows]
    looks = (
        ("printed", style.VERMILLION, "s", "printed in the paper"),
        ("size", style.BLUE, "o", "sup of the size"),
        ("width", style.GREEN, "D", "sup of the width"),
        ("sampled", style.BLACK, "_", "largest sampled gap"),
    )
    for axis, state in zip(axes[0], states, strict=True):
        for key, colour, marker, label in looks:
            values = {r["eps"]: r["states"][state][key] for r in rows}
            known = {e: v for e, v in values.items() if v is not None and v > 0}
            if known:
                look = {"color": colour, "marker": marker, "ms": 8, "ls": "" if key == "sampled" else "-"}
                axis.plot([*known], [*known.values()], label=label, **look)
        axis.set(xscale="log", yscale="log", xlabel="eps, radius of the balls that cover X")
        axis.set_ylabel(axis_label(state, units))
        axis.set_xticks(eps, [f"{e:g}" for e in eps])
        axis.minorticks_off()
        axis.margins(0.15)
    style.legend(figure)
    return figure
