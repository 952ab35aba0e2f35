"""Sets of growing size that the linear problems around smaller ones promise, fitted until one reaches the noise."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.search.explanations import SAME_PROMISE, Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.scoring import Screen, begun_at
from simgap.diagnosis.simulation.sensitivity import scaled, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import LEAPS_ANYHOW, MOST, NARROW, OUT_OF_SIGHT, WIDTH

_KEPT = 40  # sets of each size that the normal equations keep
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
    gram, scale = scaled(seen.gram)
    gradient = seen.gradient / scale
    options = [k for k, (c, _, _) in enumerate(seen.asked) if c.effect.contains is None]
    kept = [_Partial((), 0.0)]
    for _ in range(size):
        kept = _distinct(seen, [wider for p in kept for wider in _with_one_more(seen, gram, gradient, options, p)])
    found = [_subset(seen, gram, gradient, scale, p) for p in kept]
    return sorted((s for s in found if s is not None), key=lambda s: s.left)


def _columns(seen: Screen, picks: tuple[int, ...]) -> list[int]:
    return [*range(seen.own), *(j for k in picks for j in seen.asked[k][2])]


def _with_one_more(seen: Screen, gram: Floats, gradient: Floats, options: list[int], p: _Partial) -> list[_Partial]:
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
        if len(kept) == _KEPT:
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


def leap(search: Search, base: Fit, most: int) -> None:
    """Fit what the linear problems promise, two effects first, then more, until a set reaches the noise.

    More than `LEAPS_ANYHOW` effects are tried only where that promises to take most of what is left away: what nothing
    in the library explains is bent a little by everything.
    """
    for size in range(2, most + 1):
        if size > LEAPS_ANYHOW and not _pays(search, size, most):
            return
        fit_larger(search, _sources(search, base, size), size)
        for _ in range(2):
            best = _best(search, size, 1)
            if not best or search.reached(best[0]):
                break
            swap(search, best[0])
        if any(search.reached(e) for e in _best(search, size, 1)):
            return


def fit_larger(search: Search, sources: list[Explanation], size: int) -> None:
    """Fit the sets of one size that the linear problems around smaller ones promise most of."""
    _fitted(search, _options(search, sources, size))


def swap(search: Search, found: Explanation) -> None:
    """Fit what the linear problems promise to be better than a set in the place of one of its effects."""
    lacking = [search.without(found, c) for c in found.members]
    _fitted(search, _options(search, lacking, len(found.members), found.fit.chi2))


def merge(search: Search, found: Explanation) -> None:
    """Fit one effect, and two, in the place of any two, where the linear problem without those promises to come near.

    A set that came within the noise may hold two effects that stand in for two others.
    """
    for gone in itertools.combinations(found.members, 2):
        kept = search.without(search.without(found, gone[0]), gone[1])
        for size in (1, 2):
            near = _options(search, [kept], len(kept.members) + size, OUT_OF_SIGHT * found.fit.chi2)
            _fitted(search, near[:NARROW])


def _pays(search: Search, size: int, most: int) -> bool:
    """Whether the linear problem around the best smaller set promises `MOST`, with one effect more or several."""
    for e in _best(search, size - 1, 1):
        left = [s.left for more in range(1, most - size + 2) for s in best_subsets(search.screen(e), more)[:1]]
        return min(left, default=np.inf) < MOST * e.fit.chi2
    return False


def _best(search: Search, size: int, most: int) -> list[Explanation]:
    """The best physical sets of one size, those aside that refine another."""
    return [e for e in search.sound(size) if all(c.effect.contains is None for c in e.members)][:most]


def _sources(search: Search, base: Fit, size: int) -> list[Explanation]:
    """The best smaller sets, those that lack one effect and more."""
    found = [search.empty(base)] if size <= LEAPS_ANYHOW else []
    for lacking in range(1, LEAPS_ANYHOW + 1):
        found += _best(search, size - lacking, NARROW)
    return [e for e in found if e.members or size <= LEAPS_ANYHOW]


def _options(
    search: Search, sources: list[Explanation], size: int, below: float = np.inf
) -> list[tuple[Explanation, Subset]]:
    """Sets of one size that are promised less than `below`, the best first, each set once."""
    every = [(e, s) for e in sources for s in best_subsets(search.screen(e), size - len(e.members)) if s.left < below]
    kept, seen = [], {e.keys for e in search.tried.values()}
    for e, s in sorted(every, key=lambda it: it[1].left):
        keys = e.keys | {c.key for c in s.members}
        if keys not in seen:
            seen.add(keys)
            kept.append((e, s))
    return kept[:WIDTH]


def _fitted(search: Search, options: list[tuple[Explanation, Subset]]) -> None:
    lower, upper = search.problem.model.lower, search.problem.model.upper
    for e, s in options:
        theta = np.clip(with_values(e.fit.theta, s.values), lower, upper)
        search.explain((*e.members, *s.members), theta, e.fit)
