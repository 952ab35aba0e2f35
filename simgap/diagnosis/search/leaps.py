"""Sets of growing size that the linear problems around smaller ones promise, fitted until one reaches the noise."""

from __future__ import annotations

import itertools

import numpy as np

from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.subsets import Subset, best_subsets
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.thresholds import LEAPS_ANYHOW, MOST, NARROW, OUT_OF_SIGHT, WIDTH


def leap(search: Search, base: Fit, most: int) -> None:
    """Fit what the linear problems promise, two effects first, then more, until a set reaches the noise.

    More than `LEAPS_ANYHOW` effects are tried only where that promises to take most of what is left away: what nothing
    in the library explains is bent a little by everything.
    """
    for size in range(2, most + 1):
        if size > LEAPS_ANYHOW and not _pays(search, size, most):
            return
        _fitted(search, _options(search, _sources(search, base, size), size))
        for _ in range(2):
            best = _best(search, size, 1)
            if not best or search.reached(best[0]):
                break
            swapped = [search.without(best[0], c) for c in best[0].members]
            _fitted(search, _options(search, swapped, size, best[0].fit.chi2))
        if any(search.reached(e) for e in _best(search, size, 1)):
            return


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
    same = [
        e for e in search.tried.values()
        if e.physical and len(e.members) == size and all(c.effect.contains is None for c in e.members)
    ]  # fmt: skip
    return sorted(same, key=lambda e: e.bic)[:most]


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
