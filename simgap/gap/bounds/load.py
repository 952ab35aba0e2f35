"""A saved gap bound read back: every kind of bound by the name under which it saves itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.errors import UserError, excerpt
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapDomain, GapFunction, Tier
from simgap.gap.bounds.linear import LinearGap
from simgap.geometry import Grid

_POINTS = 1000  # of X, at which the sides of a formula are compared
_INPUTS = 50


def check_complete(gap: GapFunction) -> None:
    """Refuse what is no bound on all of its X and U.

    Raises:
        UserError: naming the part that is wrong.
    """
    domain = gap.domain
    nx, m = len(domain.states), len(domain.input_set)
    _require(nx > 0 and domain.box.size == nx, "its X has not one interval for each state")
    _finite("its X", np.stack([domain.box.lo, domain.box.hi]), (2, nx))
    _require(m > 0, "its U is empty")
    _finite("its U", domain.input_set, (m, len(domain.inputs)))
    _require(len(gap.tiers) > 0, "it does not say what it rests on")
    _require(all(tier.level in (1, 2, 3) for tier in gap.tiers), "it rests on a tier that does not exist")
    if isinstance(gap, LinearGap):
        _check_linear(gap)
    elif isinstance(gap, CellGap):
        _check_cells(gap)
    elif isinstance(gap, BodyFrameGap):
        _check_body_frame(gap)


def _require(holds: Any, problem: str) -> None:
    if not holds:
        raise UserError(problem)


def _finite(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    numbers = np.issubdtype(array.dtype, np.number) and array.shape == shape and np.isfinite(array).all()
    _require(numbers, f"{name} is not a table of finite numbers of shape {shape}")


def _ordered(lower: Floats, upper: Floats) -> None:
    _require((lower <= upper).all(), "its lower side is above its upper side")


def _check_linear(gap: LinearGap) -> None:
    for side in (*gap.lower, *gap.upper):
        _finite("a row of coefficients", side.coefficients, (gap.basis.size,))
        _require(np.isfinite(side.offset), "an offset is not a finite number")
    box, inputs = gap.domain.box, gap.domain.input_set
    axis = max(2, int(_POINTS ** (1.0 / box.size)))
    grid = Grid(box, [axis] * box.size)
    corners = np.stack([c.ravel() for c in np.meshgrid(*zip(box.lo, box.hi, strict=True), indexing="ij")], axis=-1)
    x = np.concatenate([grid.centres(), corners])
    chosen = inputs[np.unique(np.linspace(0, len(inputs) - 1, _INPUTS).astype(int))]
    rows, each = np.repeat(x, len(chosen), axis=0), np.tile(chosen, (len(x), 1))
    lower, upper = gap.bounds(rows, each)
    _finite("its value on X", lower, rows.shape)
    _finite("its value on X", upper, rows.shape)
    _ordered(lower, upper)


def _check_cells(gap: CellGap) -> None:
    box, nx, m = gap.domain.box, len(gap.domain.states), len(gap.domain.input_set)
    for j, (edges, nodes) in enumerate(zip(gap.edges, gap.nodes, strict=True)):
        _finite("a row of nodes", nodes, (max(1, nodes.size),))
        _finite("a row of edges", edges, (len(nodes) + 1,))
        _require((np.diff(edges) > 0).all(), "its cells do not follow each other")
        _require(edges[0] == box.lo[j] and edges[-1] == box.hi[j], "its cells do not cover X")
        _require(((edges[:-1] <= nodes) & (nodes <= edges[1:])).all(), "a node lies outside its cell")
    cells = int(np.prod([len(nodes) for nodes in gap.nodes]))
    kinds = m if gap.upper.ndim == 3 and gap.upper.shape[1] != 1 else 1
    _finite("its lower side", gap.lower, (cells, kinds, nx))
    _finite("its upper side", gap.upper, (cells, kinds, nx))
    _finite("its slopes", gap.slopes, (nx, nx))
    _require((gap.slopes >= 0).all(), "a slope is negative")
    _ordered(gap.lower, gap.upper)


def _check_body_frame(gap: BodyFrameGap) -> None:
    _require(sorted(gap.pose) == [0, 1, 2] and len(gap.domain.states) == 3, "its pose is not x, y and heading")
    shape = (len(gap.domain.input_set), 3)
    _finite("its lower side", gap.lower, shape)
    _finite("its upper side", gap.upper, shape)
    _ordered(gap.lower, gap.upper)
    if gap.previous is None or gap.by_class is None:
        return
    kind, count = gap.previous.kind, len(gap.by_class[0])
    _require(kind.shape == shape[:1] and count > 0, "its classes are not one for each input")
    _require(np.isin(np.append(kind, gap.previous.rest), np.arange(count)).all(), "its classes are not numbered")
    for name, side in zip(("lower", "upper"), gap.by_class, strict=True):
        _finite(f"its {name} side after a class", side, (count, *shape))
    _ordered(*gap.by_class)
    _require(
        (gap.lower <= gap.by_class[0].min(axis=0)).all() and (gap.by_class[1].max(axis=0) <= gap.upper).all(),
        "its bound after any input does not hold those after each class",
    )


KINDS: Mapping[str, type[LinearGap] | type[CellGap] | type[BodyFrameGap]] = {
    "linear": LinearGap,
    "cells": CellGap,
    "body_frame": BodyFrameGap,
}


def from_json(data: Any) -> GapFunction:
    """A gap function from what `to_json` gave, complete and right side up.

    Raises:
        UserError: for an unknown kind, missing parts, numbers that are none, or a lower side above the upper one.
    """
    try:
        domain = GapDomain.from_json(data["domain"])
        tiers = tuple(Tier.from_json(t) for t in data["guarantee"])
        gap = KINDS[data["kind"]].from_content(data, domain, tiers)
        check_complete(gap)
    except UserError as error:
        raise UserError(f"not a saved gap bound: {error.problem}", remedy="Run the gap stage again.") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise UserError(f"not a saved gap bound ({excerpt(repr(error))})", remedy="Run the gap stage again.") from None
    return gap
