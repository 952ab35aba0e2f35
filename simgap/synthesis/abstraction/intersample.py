"""Bounds of the path between two sampling instants, and the path as a swept box of cells.

Let |dx_i/dt| <= V_i. A point of the path is at most half a sampling time away from one of the two samples around it, so
it is within V_i tau / 2 of that sample in every coordinate at once. Hence a path whose samples all lie in a box leaves
it by at most that much, and a path whose samples all keep that distance from an obstacle never touches it.

A box is convex and an obstacle's surroundings are not: the chord between two samples stays in the box. With
dx/dt = g + d, where g = F(x, u) is Lipschitz in time with |dg_i/dt| <= A_i, and |d_i| <= D_i, the path leaves its chord
by at most A_i tau^2 / 8 + D_i tau / 2: linear interpolation errs by that much of the integral of g (Davis (1963),
Interpolation and Approximation, sec. 3.1), and the integral of d leaves its own chord by 2 D t (tau - t) / tau. The
walls need no more than the smaller of both. A_i bounds the rows of dF/dx (F + d).

With a swept box an input may be used only where all of its cells are free. This is tighter than keeping a uniform
clearance, because each input and heading has its own box: a slow input may be used near a wall where a fast one may
not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.errors import BrokenPromise
from simgap.gap.bounds.body_frame import rotated_box
from simgap.geometry import Box, Grid, mesh
from simgap.late import njit
from simgap.late import sympy as sp
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel, kinds
from simgap.specifications.space import SHRINK

Rates = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
_ROUNDS = 50
_LEAVES, _HALVINGS, _REFINED = 0.25, 24, 8
"""Of the width of a box, what a path may stray at a sampling time that a refusal names (judgement: half of the box is
left); how often tau is halved in search of it, and then how often bisected."""
_PIECES, _ALONG, _NARROWED, _SAME = 20_000, 12, 10, 0.99
"""Boxes, inputs counted, over which one bound is enclosed piece by piece, and pieces of an axis at most; how often what
a path may stray is bounded anew where it then may be, and the share of it that is as good as all. Of an arm of two
links the enclosed rates fall by a fifth from one piece to 8 along an axis, and by a fiftieth from there to 16."""
_SLACK = 1e-12
_KINKED = "sign Abs Min Max Heaviside Piecewise"


@dataclass(frozen=True, eq=False)
class Flow:
    """Continuous dynamics dx/dt = F(x, u), enclosed over boxes (n, nx), (n, nx) and inputs (n, nu).

    Attributes:
        rates: F, two (n, nx), state units/s, rounded outward.
        slopes: dF_i/dx_j, two (n, nx, nx), rounded outward; None where F has kinks, or its path may not be read off x.
        read: axes on which F depends; all when None.
    """

    rates: Rates
    slopes: Rates | None = None
    read: tuple[int, ...] | None = None


def flow_of(model: SymbolicModel, smooth: bool = True) -> Flow:
    """The enclosed dynamics of a model; `smooth` is false where hidden states make dx/dt leave F by more than a gap."""
    x, u = (tuple(v.symbol for v in group) for group in (model.states, model.inputs))
    own = NominalModel(x, u, model.numeric(), 0.0)
    read = set[sp.Basic]().union(*(e.free_symbols for e in own.f))
    kinked = any(e.has(*kinds(_KINKED)) for e in own.f)
    axes = tuple(j for j, symbol in enumerate(x) if symbol in read)
    return Flow(own.enclosure, own.jacobian_enclosure if smooth and not kinked else None, axes)


def excursion(
    flow: Flow,
    region: Box,
    inputs: Floats,
    tau: float,
    extra_rate: Floats | None = None,
    names: Sequence[str] = (),
) -> tuple[Floats, Floats]:
    """Bound of how far a path strays: -> ((2, nx) from its samples, and out of a box that holds them; V_i, (nx,)).

    Args:
        flow: the dynamics, enclosed.
        region: box that holds every sample.
        inputs: U, (M, nu); the input is constant between samples.
        tau: sampling time, s.
        extra_rate: bound of what the real dx/dt adds to the model's, (nx,). A gap bound at sampling instants does not
            give one; a caller who uses gamma / tau here makes an assumption and should say so.
        names: of the states, for the message.

    The rates are bounded over the region widened by the excursion itself, found by iteration from below; how they
    change over what that leaves, and then the rates once more.

    Raises:
        BrokenPromise: when the iteration does not settle (the dynamics may leave any bound within half a sample).
    """
    added = np.zeros(region.size) if extra_rate is None else np.asarray(extra_rate, dtype=np.float64)
    if (found := stray(flow, region, inputs, tau, added)) is not None:
        return found
    _, _, needed = _settled(flow, region, inputs, tau, added)
    axis = int(np.argmax(np.where(np.isfinite(needed), needed / (region.hi - region.lo), np.inf)))
    of = f" of {names[axis]}" if names else ""
    shorter = enough(flow, region, inputs, tau, added)
    raise BrokenPromise(
        f"the motion{of} between samples has no bound: within half of tau = {tau:g} s it may leave any box",
        f"Shorten domain.tau{f' to about {shorter:g} s' if shorter else ''}, or shrink domain.X",
    )


def stray(flow: Flow, region: Box, inputs: Floats, tau: float, added: Floats) -> tuple[Floats, Floats] | None:
    """Result of `excursion`, or None where it has no bound: without the search of a shorter sampling time."""
    reach, speed, _ = _settled(flow, region, inputs, tau, added)
    if speed is None:
        return None
    samples = walls = reach
    if flow.slopes is None:
        return np.stack([samples, walls]), speed
    for _ in range(_NARROWED):
        bent = 0.125 * tau**2 * _bends(flow, flow.slopes, region, inputs, walls, added) + 0.5 * tau * added
        bent *= 1.0 + _SLACK
        before, walls = walls, np.where(bent < walls, bent, walls)  # false for what is no number
        speed = np.minimum(speed, _speed(flow, region, inputs, walls, added))
        samples = np.minimum(samples, 0.5 * tau * speed * (1.0 + _SLACK))
        walls = np.minimum(walls, samples)
        if (walls >= _SAME * before).all():
            break
    return np.stack([samples, walls]), speed


def _pieces(flow: Flow, region: Box, inputs: Floats, reach: Floats) -> tuple[Floats, Floats, Floats]:
    """A cover of the widened region, with every input: boxes (n, nx), (n, nx) and inputs (n, nu)."""
    axes = range(region.size) if flow.read is None else flow.read
    share = max(1.0, _PIECES / len(inputs)) ** (1.0 / max(1, len(axes)))
    along = max(1, min(_ALONG, int(share)))
    low, high = region.lo - reach, region.hi + reach
    ends = [np.linspace(low[j], high[j], (along if j in axes else 1) + 1) for j in range(region.size)]
    lo, hi = (mesh(*(e[part] for e in ends)) for part in (slice(None, -1), slice(1, None)))
    return np.repeat(lo, len(inputs), axis=0), np.repeat(hi, len(inputs), axis=0), np.tile(inputs, (len(lo), 1))


def _speed(flow: Flow, region: Box, inputs: Floats, reach: Floats, added: Floats) -> Floats:
    """Largest |dx_i/dt| over the region widened by `reach`, (nx,)."""
    low, high = flow.rates(*_pieces(flow, region, inputs, reach))
    return np.asarray(np.maximum(np.abs(low), np.abs(high)).max(axis=0) + added)


def _bends(flow: Flow, slopes: Rates, region: Box, inputs: Floats, reach: Floats, added: Floats) -> Floats:
    """Largest |d/dt F_i(x(t), u)| along paths within the region widened by `reach`, (nx,)."""
    pieces = _pieces(flow, region, inputs, reach)
    low, high = (end[:, None, :] for end in flow.rates(*pieces))
    low, high = low - added, high + added
    down, up = slopes(*pieces)
    with np.errstate(all="ignore"):  # an enclosure may be infinite: then this is no number, and bounds nothing
        products = (down * low, down * high, up * low, up * high)
        least, most = np.minimum.reduce(products), np.maximum.reduce(products)
        rounding = _SLACK * np.maximum(np.abs(least), np.abs(most)).sum(axis=2)
        return np.asarray((np.maximum(-least.sum(axis=2), most.sum(axis=2)) + rounding).max(axis=0))


def enough(flow: Flow, region: Box, inputs: Floats, tau: float, extra_rate: Floats) -> float | None:
    """A shorter sampling time, two digits, at which a path strays by a quarter of the region at most; None if none is.

    The arguments are those of `excursion`. `extra_rate` is kept, as if what it stands for shrank as tau does.
    """

    def leaves(time: float) -> bool:
        found = stray(flow, region, inputs, time, extra_rate)
        return found is not None and bool((found[0][1] <= _LEAVES * (region.hi - region.lo)).all())

    low = next((own for own in tau / 2.0 ** np.arange(1, _HALVINGS) if leaves(own)), None)
    if low is None:
        return None
    high = 2.0 * low
    for _ in range(_REFINED):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if leaves(middle) else (low, middle)
    digits = 1 - math.floor(math.log10(low))
    return math.floor(low * 10.0**digits) / 10.0**digits


def _settled(
    flow: Flow, region: Box, inputs: Floats, tau: float, added: Floats
) -> tuple[Floats, Floats | None, Floats]:
    """The excursion, the rates over the region so widened (None where it does not settle), what it would take next."""
    reach = needed = np.zeros(region.size)
    for _ in range(_ROUNDS):
        speed = _speed(flow, region, inputs, reach, added)
        needed = 0.5 * tau * speed * (1.0 + _SLACK)
        if np.all(needed <= reach):
            return reach, speed, needed
        if not np.all(np.isfinite(needed)):
            break
        reach = needed * (1.0 + 1e-6)
    return reach, None, needed


@dataclass(frozen=True, eq=False)
class SweptCells:
    """Offsets of the touched cells from the cell of the start.

    Attributes:
        axis: the one axis on which they depend.
        lower, upper: (cells along that axis, M, nx) int32.
    """

    axis: int
    lower: NDArray[np.int32]
    upper: NDArray[np.int32]


def planar_swept_cells(
    grid: Grid, lower: Floats, upper: Floats, pose: tuple[int, int, int] = (0, 1, 2), error: Floats | None = None
) -> SweptCells:
    """From boxes in the robot's frame to cells, for every heading of a layer and every start in a cell.

    Where cells are of a measured state, the box is the path's as seen from the measured place: the headings are those
    that the robot may have, and a free cell keeps the error of its place from everything anyway (`Specification.free`).

    Args:
        grid: cells; pose: which axes are x, y and heading.
        lower, upper: (M, 2) box that holds the path of each input, the start at the origin included, m.
        error: bound of the measurement error, (nx,); None for cells of the true state.
    """
    i, j, k = pose
    width, off = 2.0 * grid.h, 0.0 if error is None else float(error[k])
    low = np.zeros((grid.cells[k], len(lower), 3), np.int32)
    high = np.zeros_like(low)
    box = np.ascontiguousarray(np.stack([lower[:, 0], upper[:, 0], lower[:, 1], upper[:, 1]], axis=1), np.float64)
    _sweep(box, float(grid.box.lo[k]), float(width[k]), off, i, j, float(width[i]), float(width[j]), low, high)
    return SweptCells(k, low, high)


@njit(cache=True, error_model="numpy")
def _sweep(box, first, step, off, i, j, width_i, width_j, low, high):  # type: ignore[no-untyped-def]
    for layer in range(low.shape[0]):
        t0 = first + step * layer
        for m in range(low.shape[1]):
            x0, x1, y0, y1 = rotated_box(t0 - off, t0 + step + off, box[m, 0], box[m, 1], box[m, 2], box[m, 3])
            low[layer, m, i], high[layer, m, i] = _cells(x0, x1, width_i)
            low[layer, m, j], high[layer, m, j] = _cells(y0, y1, width_j)


@njit(cache=True, error_model="numpy")
def _cells(a, b, width):  # type: ignore[no-untyped-def]
    return np.int32(np.floor(a / width + SHRINK)), np.int32(np.ceil(1.0 + b / width - SHRINK) - 1)
