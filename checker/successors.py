"""Where a step may end, and where its path lies, as expressions; numbers that differ from pair to pair are names.

In the frame of a body at heading theta the gap lies in [a0, a1] x [b0, b1], seen from the world

    x:  a cos theta - b sin theta,      y:  a sin theta + b cos theta,

which for every theta is extreme at a corner: a range over theta is the hull of those of the four corners.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import intervals
import numpy as np
from certificate import Certificate
from expressions import Place
from reach import OWN

CORNERS = [(a, b) for a in "01" for b in "01"]


class Steps:
    """The expressions of a certificate, made once.

    Attributes:
        ends: for each state expressions whose ranges hold its successor between them.
        within: for a simulator in closed form, expressions none of which may be negative: gap - lower, upper - gap.
        path: for the axes x and y expressions whose ranges hold the path between them; empty where there is no box.
        split: axes along which smaller parts of a cell have smaller ranges together: not those on which one successor
            alone depends, and in proportion.
    """

    def __init__(self, c: Certificate) -> None:
        self.c, head = c, c.header
        values = [[intervals.number(v) for v in row] for row in c.inputs]
        self.low, self.high = (np.array([[v[end] for v in row] for row in values]) for end in (0, 1))
        self.within: list[Any] = []
        if c.reach is not None and c.reach.pose is not None:
            self.cos, self.sin = ["cos", c.states[c.reach.pose[2]]], ["sin", c.states[c.reach.pose[2]]]
        if c.reach is not None and c.reach.bound is not None:
            self.ends = self._framed()
        else:
            sides = [(head["gap"][s]["lower"], head["gap"][s]["upper"]) for s in c.states]
            self.ends = [[["+", head["nominal"][s], e] for e in own] for s, own in zip(c.states, sides, strict=True)]
            if head["simulator"]:
                for s, (lower, upper) in zip(c.states, sides, strict=True):
                    d = ["+", head["simulator"][s], ["*", -1, head["nominal"][s]]]
                    self.within += [["+", d, ["*", -1, lower]], ["+", upper, ["*", -1, d]]]
        self.path = self._paths() if c.reach is not None and c.reach.swept is not None else {}
        pool: dict[Any, list[Any]] = {}
        self.ends = [[shared(e, pool) for e in own] for own in self.ends]
        self.path = {j: [shared(e, pool) for e in own] for j, own in self.path.items()}
        self.within = [shared(e, pool) for e in self.within]
        axes = {s: j for j, s in enumerate(c.states)}
        ends = [set().union(*(_axes(e, axes) for e in own)) for own in self.ends]
        every = [e for own in [*self.ends, *self.path.values(), self.within] for e in own]
        self.split = set().union(*(_curved(e, axes) for e in every))
        self.split |= {j for j in axes.values() if sum(j in own for own in ends) > 1}

    def _framed(self) -> list[list[Any]]:
        c, (i, j, k) = self.c, self.c.reach.pose
        nominal = [c.header["nominal"][s] for s in c.states]
        turned = self._turned("a", "b")
        found: list[list[Any]] = [[] for _ in c.states]
        found[i] = [["+", nominal[i], *terms] for terms in turned[0]]
        found[j] = [["+", nominal[j], *terms] for terms in turned[1]]
        found[k] = [["+", nominal[k], OWN + "t0"], ["+", nominal[k], OWN + "t1"]]
        return found

    def _paths(self) -> dict[int, list[Any]]:
        c, (i, j, _) = self.c, self.c.reach.pose
        turned = self._turned("p", "q")
        return {
            axis: [["+", c.states[axis], *terms] for terms in own] for axis, own in zip((i, j), turned, strict=True)
        }

    def _turned(self, a: str, b: str) -> tuple[list[list[Any]], list[list[Any]]]:
        """Terms of x and of y for each corner."""
        along, across = [], []
        for one, other in CORNERS:
            first, second = OWN + a + one, OWN + b + other
            along.append([["*", first, self.cos], ["*", -1, second, self.sin]])
            across.append([["*", first, self.sin], ["*", second, self.cos]])
        return along, across

    def place(self, box, mid, classes, ms, arithmetic) -> Place:
        """Where to ask for them: boxes, classes and inputs of pairs (n,), or of one pair in rational numbers."""
        c, named = self.c, {}
        for u, name in enumerate(c.input_names):
            exactly = arithmetic is not intervals
            named[name] = (c.inputs[ms][u],) * 2 if exactly else (self.low[ms, u], self.high[ms, u])
        if c.reach is not None and c.reach.bound is not None:
            i, j, k = c.reach.pose
            for letter, axis in (("a", i), ("b", j), ("t", k)):
                named |= _sides(c.reach.bound, letter, classes, ms, axis, arithmetic)
        if self.path:
            for letter, axis in (("p", 0), ("q", 1)):
                named |= _sides(c.reach.swept, letter, classes, ms, axis, arithmetic)
        return Place(arithmetic, {s: j for j, s in enumerate(c.states)}, box, mid, named)


def shared(e: Any, pool: dict[Any, list[Any]]) -> Any:
    """An expression whose equal parts are one list, also those of others of the pool: a place evaluates them once."""
    if not isinstance(e, list):
        return e
    own = [shared(part, pool) for part in e]
    return pool.setdefault(tuple(("list", id(part)) if isinstance(part, list) else part for part in own), own)


def _axes(e: Any, axes: dict[str, int]) -> set[int]:
    """Axes that an expression depends on."""
    if isinstance(e, list):
        return set().union(*(_axes(part, axes) for part in e[1:]))
    return {axes[e]} if isinstance(e, str) and e in axes else set()


def _curved(e: Any, axes: dict[str, int]) -> set[int]:
    """Axes on which an expression depends otherwise than in proportion."""
    if not isinstance(e, list):
        return set()
    depends = [part for part in e[1:] if _axes(part, axes)]
    if e[0] == "+" or (e[0] == "*" and len(depends) == 1):
        return set().union(*(_curved(part, axes) for part in depends))
    return _axes(e, axes)


def _sides(table, letter: str, classes, ms, axis: int, arithmetic) -> dict[str, tuple]:
    found = {}
    for side in (0, 1):
        value = table[side, classes, ms, axis]
        exactly = arithmetic is not intervals
        found[f"{OWN}{letter}{side}"] = (Fraction(float(value)),) * 2 if exactly else (value, value)
    return found


def hull(where: Place, expressions: list[Any]) -> tuple[Any, Any]:
    """The hull of the ranges of expressions."""
    arithmetic, ranges = where.arithmetic, [where.range(e) for e in expressions]
    total = ranges[0]
    for other in ranges[1:]:
        total = arithmetic.hull(total, other)
    return total
