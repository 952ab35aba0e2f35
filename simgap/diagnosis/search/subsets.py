"""The best sets of effects that could join a fit, by the normal equations of one linearisation.

Two effects that are worth little alone may be worth all together (a delay and viscous friction, beside a dry friction
and a gain that stand in for them): no sequence of best single effects leads there. The normal equations that rank the
single effects rank all sets of them, for the price of small matrices: sets grow one effect at a time, the best of each
size are kept, and what is kept is projected out of the rest.
Source: Furnival, Wilson (1974), Regressions by leaps and bounds, Technometrics 16(4); Miller (2002), Subset Selection
in Regression, sec. 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.search.scoring import Screen, begun_at
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import SAME_PROMISE, SUBSETS_KEPT

_LEFT = 1e-8  # a column of which less is left (of its square) is in the span of the others
_RIDGE = 1e-10


@dataclass(frozen=True, eq=False)
class Subset:
    """Effects that could join a fit together.

    Attributes:
        members: these effects; values: where a fit of all begins, slot -> value.
        left: chi^2 that the linear problem leaves; count: parameters that they bring.
    """

    members: tuple[Candidate, ...]
    values: dict[int, float]
    left: float
    count: int


@dataclass(frozen=True)
class _Partial:
    picks: tuple[int, ...]
    drop: float


def best_subsets(seen: Screen, size: int) -> list[Subset]:
    """Sets of `size` effects beside the fit, those that leave the least chi^2 first, one of each span.

    An effect that contains another acts as that one at its null, and is left out.
    """
    scale = np.sqrt(np.maximum(np.diag(seen.gram), 1e-300))
    gram, gradient = seen.gram / np.outer(scale, scale), seen.gradient / scale
    options = [k for k, (c, _, _) in enumerate(seen.asked) if c.effect.contains is None]
    kept = [_Partial((), 0.0)]
    for _ in range(size):
        kept = _distinct(seen, [wider for p in kept for wider in _widened(seen, gram, gradient, options, p)])
    found = [_subset(seen, gram, gradient, scale, p) for p in kept]
    return sorted((s for s in found if s is not None), key=lambda s: s.left)


def _columns(seen: Screen, picks: tuple[int, ...]) -> list[int]:
    return [*range(seen.own), *(j for k in picks for j in seen.asked[k][2])]


def _widened(seen: Screen, gram: Floats, gradient: Floats, options: list[int], p: _Partial) -> list[_Partial]:
    """One more effect in all ways."""
    have = _columns(seen, p.picks)
    rest, pull = gram, gradient
    whole = 0.0
    if have:
        inner = gram[np.ix_(have, have)] + _RIDGE * np.eye(len(have))
        weights = np.linalg.solve(inner, np.column_stack([gram[have], gradient[have]]))
        rest = gram - gram[:, have] @ weights[:, :-1]
        pull = gradient - gram[:, have] @ weights[:, -1]
        whole = float(gradient[have] @ weights[:, -1])
    taken = {seen.asked[k][0].key for k in p.picks}
    out = []
    for k in options:
        c, _, columns = seen.asked[k]
        own = [j for j in columns if rest[j, j] > _LEFT]
        if c.key in taken or not own:
            continue
        block = rest[np.ix_(own, own)] + _RIDGE * np.eye(len(own))
        out.append(_Partial((*p.picks, k), whole + float(pull[own] @ np.linalg.solve(block, pull[own]))))
    return out


def _distinct(seen: Screen, options: list[_Partial]) -> list[_Partial]:
    """The best ones, one of those that promise exactly the same (what stands first in the library), one of each set."""

    def place(p: _Partial) -> tuple[int, ...]:
        return tuple(sorted((seen.asked[k][0].slots[0] for k in p.picks), reverse=True))

    kept: list[_Partial] = []
    sets: set[frozenset[tuple[str, str]]] = set()
    for p in sorted(options, key=lambda p: -p.drop):
        keys = frozenset(seen.asked[k][0].key for k in p.picks)
        left = seen.rest - p.drop
        same = bool(kept) and abs(seen.rest - kept[-1].drop - left) <= SAME_PROMISE * max(abs(left), 1.0)
        if keys in sets:
            continue
        if same:
            if place(p) < place(kept[-1]):
                kept[-1] = p
                sets.add(keys)
            continue
        if len(kept) == SUBSETS_KEPT:
            break
        kept.append(p)
        sets.add(keys)
    return kept


def _subset(seen: Screen, gram: Floats, gradient: Floats, scale: Floats, p: _Partial) -> Subset | None:
    """The set with where its fit begins; None if an effect of it is not physical there."""
    have = _columns(seen, p.picks)
    inner = gram[np.ix_(have, have)] + _RIDGE * np.eye(len(have))
    step = np.linalg.solve(inner, gradient[have]) / scale[have]
    values = {k: float(seen.at.theta[k] + s) for k, s in zip(seen.at.slots, step[: seen.own], strict=True)}
    place, count = seen.own, 0
    for k in p.picks:
        c, start, columns = seen.asked[k]
        begun = begun_at(c, start, step[place : place + len(columns)])
        if begun is None:
            return None
        values |= begun
        place, count = place + len(columns), count + len(c.slots)
    return Subset(tuple(seen.asked[k][0] for k in p.picks), values, seen.rest - p.drop, count)
