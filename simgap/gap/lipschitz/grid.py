"""Lipschitz estimates from neighbouring samples of a grid, and the cells where the grid does not resolve the gap.

Along axis j with spacing s = 2 h, a sample's slope is the larger of the differences to its two neighbours, over s; its
change of slope is the second difference over s, and half the mixed ones for the way to the cell's corners. The estimate
of a constant is the largest slope plus change of slope. It is an *estimate*: samples cannot prove a bound between them.
The resolution ratio L(s) / L(2 s) tells whether the grid sees the steepest part: above `GATE` it does not, and the
constant must not be used, unless the steep cells are few and are covered by the jump seen there, as with Coulomb
friction at rest.

Rough cells: steep differences are taken out, steepest first, until the ratio of the rest is within `GATE`; the cells on
both sides of those and their neighbours are rough. Then the same over two cells, for jumps on a sample: they are split
in two and no steeper over one cell than over two. Two numbers an axis say what is out, and cells are marked where they
are looked at.

Inputs meet in largest values and counts alone, so some are taken at a time, on all cells: memory does not grow with
their number, and the result is the same to the last bit. Arrays are (cells_1, ..., cells_nx, M).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.errors import UserError
from simgap.gap.json_record import JsonRecord
from simgap.gap.sampling.values import Values, centres, values
from simgap.gap.thresholds import CROWDED, EVERYWHERE, GATE, SPLIT_GATE, STEEP_SHARE
from simgap.geometry import Grid
from simgap.late import scipy


def steps(e: Floats, j: int, grid: Grid, cells: int = 1) -> Floats:
    """Differences over `cells` cells along j: (..., k, ..., M) -> (..., k - cells, ..., M), or k if periodic."""
    if j in grid.periodic:
        return np.roll(e, -cells, axis=j) - e
    before = (slice(None),) * j
    return e[(*before, slice(cells, None))] - e[(*before, slice(max(0, e.shape[j] - cells)))]


def contain(out: Bools, j: int, grid: Grid, cells: int) -> Bools:
    """Differences over twice `cells` cells that contain one of `out`, which are over `cells` cells."""
    if j in grid.periodic:
        return np.logical_or.reduce([np.roll(out, -k, axis=j) for k in range(cells + 1)])
    n = out.shape[j] - cells
    return np.logical_or.reduce([np.take(out, range(k, n + k), axis=j) for k in range(cells + 1)])


def middle(out: Bools, j: int, grid: Grid) -> Bools:
    """The cells in the middle of differences over two cells."""
    if j in grid.periodic:
        return np.roll(out, 1, axis=j)
    edge = np.zeros_like(np.take(out, [0], axis=j))
    return np.concatenate([edge, out, edge], axis=j)


def to_cells(step: Floats | Bools, j: int, grid: Grid, expected: Floats | None = None) -> Floats:
    """Larger absolute difference beside each cell, less its `expected`: `steps` -> (cells_1, ..., cells_nx, M)."""
    if j in grid.periodic:
        forward, backward = step, np.roll(step, 1, axis=j)
    else:
        first, last = np.take(step, [0], axis=j), np.take(step, [-1], axis=j)
        forward, backward = np.concatenate([step, last], axis=j), np.concatenate([first, step], axis=j)
    if expected is None:
        return np.maximum(np.abs(forward), np.abs(backward))
    return np.maximum(np.abs(forward - expected), np.abs(backward - expected))


def bends(step: Floats, j: int, grid: Grid) -> Floats:
    """Absolute second differences at each cell, at an edge its neighbour's: `steps` -> (cells_1, ..., cells_nx, M)."""
    if j in grid.periodic:
        return np.abs(step - np.roll(step, 1, axis=j))
    inner = np.abs(np.diff(step, axis=j))
    return np.concatenate([np.take(inner, [0], axis=j), inner, np.take(inner, [-1], axis=j)], axis=j)


def turns(step: Floats, j: int, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Change of `steps` along j within a cell: along j, half a cell along the others; (cells_1, ..., cells_nx, M)."""
    total = bends(step, j, grid)
    for k in axes:
        if k != j:
            total += 0.5 * to_cells(to_cells(steps(step, k, grid), k, grid), j, grid)
    return total


def window(grid: Grid, axes: tuple[int, ...]) -> tuple[int, ...]:
    """Filter size that reaches the neighbours of a cell, diagonal ones included."""
    return (*(3 if j in axes else 1 for j in range(len(grid.cells))), 1)


def modes(grid: Grid) -> list[str]:
    """Filter border modes."""
    return [*("wrap" if j in grid.periodic else "nearest" for j in range(len(grid.cells))), "nearest"]


def widest(e: Floats, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Largest value around each cell, diagonal neighbours included."""
    return np.asarray(scipy.ndimage.maximum_filter(e, size=window(grid, axes), mode=modes(grid)))


PIECE = 2**20
"""Samples that are looked at together; at least all cells for one input."""


def pieces(inputs: int, grid: Grid) -> Iterator[slice]:
    """Inputs that are looked at together, on all cells."""
    step = max(1, PIECE // grid.size)
    yield from (slice(first, min(first + step, inputs)) for first in range(0, inputs, step))


def on_cells(numbers: Values, some: slice, grid: Grid) -> Floats:
    """Values (N, M) of some inputs: (cells_1, ..., cells_nx, inputs)."""
    return numbers.of_inputs(some).reshape(*grid.cells, -1)


@dataclass(frozen=True)
class Layer(JsonRecord):
    """Cells between lo and hi along an axis, of which the share `rough` is rough, and clearly fewer beside them."""

    axis: int
    lo: float
    hi: float
    rough: float

    @property
    def middle(self) -> float:
        """Between lo and hi; 0 if it is that but for rounding."""
        middle = 0.5 * (self.lo + self.hi)
        return middle if abs(middle) > 1e-9 * (self.hi - self.lo) else 0.0


@dataclass(frozen=True, eq=False)
class GridLipschitz(
    JsonRecord,
    names={"jump": "largest_jump", "layers": "rough_layers", "at": "largest_jump_at"},
):
    """Per-axis estimate for one dimension of the gap.

    Attributes:
        constants: (nx,) largest slope plus change of slope along each axis; 0 along free axes.
        ratio: (nx,) resolution ratio, also taken at twice the spacing.
        euclidean: estimate of the constant in the Euclidean norm, sqrt(sum_j L_j^2).
        rough_share: share of the cells that are rough.
        jump: largest spread of neighbours there. at: (nx,) the centre of the cell that has it, None without one.
        layers: where rough cells crowd along an axis.
        proven: whether the constants are bounds, enclosed on every cell, and no estimates.
    """

    constants: Floats
    ratio: Floats
    rough_share: float
    jump: float = 0.0
    at: Floats | None = None
    layers: tuple[Layer, ...] = ()
    proven: bool = False

    @property
    def euclidean(self) -> float:
        """sqrt(sum_j L_j^2)."""
        return float(np.linalg.norm(self.constants))

    @property
    def resolved(self) -> bool:
        """True if the grid resolves the slope along every axis."""
        return bool(np.all(self.ratio <= GATE))

    def place(self, states: Sequence[str]) -> str:
        """Sentence on where the gap jumps, by how much, and the usual cause: what switches near values of states."""
        ratios = ", ".join(f"{r:.2f} along {s}" for s, r in zip(states, self.ratio, strict=True) if r > GATE)
        evidence = ratios or "in what the basis leaves"
        if not self.rough_share:
            return f"the gap has no jump, it bends faster than the grid sees ({evidence})"
        if not self.layers and self.rough_share > EVERYWHERE:
            return f"that is so almost everywhere: no jump, the cells are too few to follow the gap ({evidence})"
        spot = ", ".join(f"{s} = {v:.3g}" for s, v in zip(states, self.at if self.at is not None else (), strict=False))
        found = f"the gap jumps by up to {self.jump:.3g}{f', the largest beside {spot}' if spot else ''}"
        if not self.layers:
            return f"{found} ({evidence})"
        where = [f"{o.lo:.3g} < {states[o.axis]} < {o.hi:.3g} ({100 * o.rough:.0f} %)" for o in self.layers]
        near = " and near ".join(f"{states[o.axis]} = {o.middle:.3g}" for o in self.layers)
        return (
            f"{found}; most cells are rough where {' or '.join(where)}: something switches near {near}, such as dry "
            "friction at rest, a contact or a stop"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data, with what follows from the constants."""
        return super().to_json() | {"euclidean": self.euclidean, "resolved": self.resolved}


def worse(a: GridLipschitz, b: GridLipschitz) -> GridLipschitz:
    """Number by number the larger of two estimates: what holds for both; the places of both their rough cells."""
    constants, ratio = (np.maximum(getattr(a, name), getattr(b, name)) for name in ("constants", "ratio"))
    share, top = max(a.rough_share, b.rough_share), a if a.jump >= b.jump else b
    return GridLipschitz(constants, ratio, share, top.jump, top.at, _united((*a.layers, *b.layers)))


def _united(layers: Sequence[Layer]) -> tuple[Layer, ...]:
    """The same, those that overlap along an axis as one."""
    found: list[Layer] = []
    for own in sorted(layers, key=lambda layer: (layer.axis, layer.lo)):
        if found and found[-1].axis == own.axis and own.lo < found[-1].hi:
            last = found.pop()
            own = Layer(own.axis, last.lo, max(last.hi, own.hi), max(last.rough, own.rough))
        found.append(own)
    return tuple(found)


@dataclass(frozen=True)
class LipschitzRow(JsonRecord):
    """One estimate of the Euclidean constant: method, value, p-value of its goodness of fit (None: no fit), note."""

    method: str
    value: float
    ks_p: float | None
    note: str


@dataclass(frozen=True, eq=False)
class DimensionLipschitz(
    JsonRecord,
    kind="slopes",
    names={"grid": "lipschitz", "estimates": "lipschitz_estimates", "largest": "largest_sampled_gap"},
):
    """Grid estimate of one dimension, the estimates side by side, and the largest sampled |d| (the scale of both)."""

    grid: GridLipschitz
    estimates: tuple[LipschitzRow, ...]
    largest: float


@dataclass(frozen=True)
class Roughness:
    """Above which differences cells are rough: for each axis over one cell, and over two cells without one of those."""

    axes: tuple[int, ...]
    one: Mapping[int, float]
    two: Mapping[int, float]

    @property
    def any(self) -> bool:
        """True if any cell is rough."""
        return bool(np.isfinite([*self.one.values(), *self.two.values()]).any())

    def marks(self, e: Floats, grid: Grid) -> Bools:
        """Rough cells of values (cells_1, ..., cells_nx, M), the same shape."""
        rough = np.zeros(e.shape, dtype=bool)
        for j in self.axes:
            two = self.two.get(j, np.inf)
            if not np.isfinite(min(self.one[j], two)):
                continue
            out = np.abs(steps(e, j, grid)) > self.one[j]
            rough |= to_cells(out, j, grid) > 0
            if np.isfinite(two):
                far = np.abs(steps(e, j, grid, 2)) > two
                rough |= middle(far & ~contain(out, j, grid, 1), j, grid)
        if rough.any():
            rough = (
                scipy.ndimage.maximum_filter(rough.view(np.uint8), size=window(grid, self.axes), mode=modes(grid)) > 0
            )
        return rough


def roughness(d: Values, grid: Grid, axes: tuple[int, ...], floor: float, split: bool = True) -> Roughness:
    """Roughness of values (N, M) on a grid; differences up to `floor` are never rough. `split`: also over two cells."""
    one = _gates(d, grid, axes, floor, GATE, None)
    longer = [j for j in axes if split and grid.cells[j] > 4]
    return Roughness(axes, one, _gates(d, grid, longer, floor, SPLIT_GATE, one))


def _gates(
    d: Values, grid: Grid, axes: Sequence[int], floor: float, gate: float, known: Mapping[int, float] | None
) -> dict[int, float]:
    """For each axis the number above which differences are out: over one cell, or, with `known` ones, over two.

    Without them the largest difference over as many cells is within `gate` of that over twice as many.
    """
    found, left, cells = dict.fromkeys(axes, np.inf), list(axes), 1 if known is None else 2
    while left:
        fine, broad = dict.fromkeys(left, 0.0), dict.fromkeys(left, 0.0)
        for some in pieces(d.shape[1], grid):
            e = on_cells(d, some, grid)
            for j in left:
                own = _rest(e, j, grid, cells, found[j], np.inf if known is None else known[j])
                fine[j], broad[j] = max(fine[j], own[0]), max(broad[j], 0.5 * own[1])
        left = [j for j in left if fine[j] > max(gate * broad[j], floor)]
        for j in left:
            found[j] = min(found[j], max(gate * broad[j], STEEP_SHARE * fine[j], floor))
    return found


def _rest(e: Floats, j: int, grid: Grid, cells: int, above: float, known: float) -> tuple[float, float]:
    """Largest differences over `cells` cells and over twice as many, without those that are out."""
    step, wide = (np.abs(steps(e, j, grid, n)) for n in (cells, 2 * cells))
    if np.isfinite(min(above, known)):
        out = step > above
        if np.isfinite(known):
            out |= contain(np.abs(steps(e, j, grid)) > known, j, grid, 1)
        step, wide = step[~out], wide[~contain(out, j, grid, cells)]
    return float(step.max(initial=0.0)), float(wide.max(initial=0.0))


FEWEST = 4
"""Cells along an axis at least: a difference over two cells and one over one have to be compared."""


def estimate(d: Values | Floats, grid: Grid, free: tuple[int, ...] = (), floor: float = 0.0) -> GridLipschitz:
    """Per-axis estimate from values (N, M) at the cell centres; differences up to `floor` count as rounding.

    Raises:
        UserError: with fewer than four cells along an axis that is not free.
    """
    given, axes = values(d), moving_axes(grid, free)
    found = _Found(grid, given.shape[1])
    rough = roughness(given, grid, axes, floor)
    for some in pieces(given.shape[1], grid):
        e = on_cells(given, some, grid)
        marked = rough.marks(e, grid) if rough.any else None
        for j in axes:
            step = steps(e, j, grid)
            local = (to_cells(step, j, grid) + turns(step, j, grid, axes)) / (2.0 * grid.h[j])
            found.constants[j] = max(found.constants[j], float(local.max()))
        if marked is not None:
            found.add_rough(marked, np.where(marked, _spread(e, grid, axes), 0.0))
    ratio = np.ones(len(grid.cells))
    ratio[list(axes)] = _resolution(given, axes, grid, floor)
    return found.result(ratio, axes)


class _Found:
    """Largest slopes and rough cells, collected over the inputs."""

    def __init__(self, grid: Grid, inputs: int) -> None:
        self.grid, self.inputs, self.constants = grid, inputs, np.zeros(len(grid.cells))
        self.rough = [np.zeros(count, dtype=np.int64) for count in grid.cells]  # samples in each layer of each axis
        self.jump, self.at = 0.0, grid.size

    def add_rough(self, rough: Bools, spread: Floats) -> None:
        """Rough cells, and how far the values around them are apart."""
        for j, layers in enumerate(self.rough):
            layers += rough.sum(axis=tuple(k for k in range(rough.ndim) if k != j))
        largest = spread.reshape(-1, spread.shape[-1]).max(axis=1)
        at = int(largest.argmax())
        if largest[at] > self.jump or (largest[at] == self.jump and at < self.at):
            self.jump, self.at = float(largest[at]), at

    def result(self, ratio: Floats, axes: tuple[int, ...]) -> GridLipschitz:
        """All of it."""
        share = int(self.rough[0].sum()) / (self.grid.size * self.inputs)
        if not share:
            return GridLipschitz(self.constants, ratio, share)
        layers = tuple(o for j in axes if (o := self._layer(j)) is not None)
        at = centres(self.grid)[np.array([self.at])][0]
        return GridLipschitz(self.constants, ratio, share, self.jump, at, layers)

    def _layer(self, j: int) -> Layer | None:
        """Layer in which rough cells crowd along axis j: neighbours with clearly more of them than the others."""
        own = self.rough[j] / (self.grid.size * self.inputs // self.grid.cells[j])
        if own.max() <= CROWDED * own.min():
            return None
        crowded = np.flatnonzero(own > 0.5 * (own.min() + own.max()))
        first, last = int(crowded[0]), int(crowded[-1])
        if last - first + 1 > min(len(crowded), 0.5 * len(own)):
            return None
        ends = self.grid.axis(j)[[first, last]] + self.grid.h[j] * np.array([-1.0, 1.0])
        return Layer(j, float(ends[0]), float(ends[1]), float(own[crowded].mean()))


def _resolution(d: Values, axes: tuple[int, ...], grid: Grid, floor: float) -> list[float]:
    """L(s) / L(2 s), or L(2 s) / L(4 s) if larger: a jump on a sample is split in two and hides from the first."""
    known = {j: [cells for cells in (1, 2, 4) if cells < grid.cells[j]] for j in axes}
    top = {(j, n): 0.0 for j in axes for n in known[j]}
    for some in pieces(d.shape[1], grid):
        e = on_cells(d, some, grid)
        for j, n in top:
            top[j, n] = max(top[j, n], float(np.abs(steps(e, j, grid, n)).max(initial=0.0)))
    pairs = {j: list(pairwise(top[j, n] / n for n in known[j])) for j in axes}
    return [max((a / b if b > 0.0 else np.inf for a, b in pairs[j] if a > floor), default=1.0) for j in axes]


def moving_axes(grid: Grid, free: tuple[int, ...]) -> tuple[int, ...]:
    """Axes along which the gap may change; each needs four cells."""
    axes = tuple(j for j in range(len(grid.cells)) if j not in free)
    for j in axes:
        if grid.cells[j] < FEWEST:
            raise UserError(
                f"axis {j + 1} of the sampling grid has {grid.cells[j]} cells, too few for a Lipschitz estimate",
                key="grid", remedy=f"Use a smaller eps or half-width: at least {FEWEST} cells along each axis.",
            )  # fmt: skip
    return axes


def _spread(e: Floats, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Largest less least value around each cell."""
    return np.asarray(
        widest(e, grid, axes) - scipy.ndimage.minimum_filter(e, size=window(grid, axes), mode=modes(grid))
    )
