"""Which set of effects: what the linear problems promise, then forward selection with removals and swaps under BIC.

Best subsets come from the normal equations around sets that were fitted (Furnival, Wilson (1974), Technometrics 16(4)).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.explanations import SAME, SAME_PROMISE, Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit, states_fitted
from simgap.diagnosis.search.scoring import Screen, Starts, begun_at, screen
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import scaled, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import (
    BIC_GAIN,
    FAR,
    LEAPS_ANYHOW,
    MATTERS,
    MOST,
    NARROW,
    OUT_OF_SIGHT,
    WIDTH,
)  # fmt: skip

_BEGINNING = 0.25  # of a window
_KEPT = 40  # sets of each size that the normal equations keep
_LEFT = 1e-8  # a column of which less is left (of its square) is in the span of the others
_RIDGE = 1e-10


def choose(options: Iterable[Explanation]) -> Explanation | None:
    """Smallest BIC; among near-ties the one with fewest parameters, of equals the one that stands first in the library.

    A fit that diverged is none.
    """
    listed = [e for e in options if math.isfinite(e.bic)]
    if not listed:
        return None
    best = min(e.bic for e in listed)
    first = min((e for e in listed if e.bic - best < BIC_GAIN), key=lambda e: (e.count, e.bic))
    same = [e for e in listed if e.count == first.count and e.bic - first.bic < SAME]
    return min(same, key=by_place)


def by_place(e: Explanation) -> tuple[object, ...]:
    """Of sets that predict the same: what stands first in the library, then ratios nearest to what is declared."""
    slots = sorted((c.slots[0] for c in e.members), reverse=True)
    pairs = [(p, float(e.fit.theta[k])) for c in e.members for p, k in zip(c.effect.parameters, c.slots, strict=True)]
    ratios = [abs(v) for p, v in pairs if p.symbol == "ratio" and p.null == 1.0 and v != 0.0]
    return slots[:1], round(sum(abs(math.log(r)) for r in ratios), 2), slots, e.bic  # their logarithms, to a hundredth


def select(search: Search, base: Fit, most: int) -> Explanation:
    """What the linear problems promise where no single effect reaches the noise; else forward selection.

    The second: add the best effect, drop what is not worth it, swap what has a better rival; repeat.
    """
    empty = search.empty(base)
    if not search.reached(empty) and not _alone(search, empty):
        found = _leapt(search, base, most)
        if found.members:
            return found
    found = grow(search, empty, most)
    if len(found.members) > 1:  # two effects that look like a third, or like two others
        merge(search, found)
        found = preferred(search, found, most)
    return found


def _alone(search: Search, empty: Explanation) -> bool:
    """Whether one effect reaches the noise; what contains the best one is tried in its place."""
    singles = search.joined(empty)
    if not singles or any(search.reached(e) for e in singles):
        return bool(singles)
    return any(search.reached(e) for e in search.refined(min(singles, key=lambda e: e.bic)))


def _leapt(search: Search, base: Fit, most: int) -> Explanation:
    """The best of what the linear problems promise; what contains one of its effects is tried in that one's place."""
    leap(search, base, most)
    found = preferred(search, _best(search, most) or search.empty(base), most)
    if not search.reached(found):
        search.refined(found)
    else:
        if any(s.drop > FAR * BIC_GAIN * search.scale for s in search.ranked(found)[:1]):
            found = grow(search, found, most)  # it reached the noise without an effect that the data show clearly
        if len(found.members) > 2:
            merge(search, found)
    found = preferred(search, found, most)
    empty = search.empty(base)
    return found if empty.bic - found.bic >= BIC_GAIN else empty


def preferred(search: Search, found: Explanation, most: int) -> Explanation:
    """The best of all that was tried, the simpler of near-ties, without effects that are worth too little."""
    if len(found.members) > 2:  # one of its equals may hold an effect that is worth nothing
        equals = [e for e in search.sound() if abs(e.bic - found.bic) < SAME]
        for e in equals[:WIDTH]:
            _prune(search, e)
    best = _best(search, most)
    return found if best is None or not found.members else _prune(search, best)


def _best(search: Search, most: int) -> Explanation | None:
    """The best of all that was tried."""
    return choose(e for e in search.sound() if len(e.members) <= most)


def grow(search: Search, current: Explanation, most: int, finer: bool = True) -> Explanation:
    """Add, drop and swap effects from here on while that pays; what contains one of them is tried in its place, if
    `finer`."""
    while current.members or most:
        more = search.joined(current) if len(current.members) < most else []
        option = choose([*more, *(search.refined(current) if finer else [])])
        if option is None or current.bic - option.bic < BIC_GAIN:
            break
        current = _prune(search, _swap(search, _prune(search, option)))
    return current


def _prune(search: Search, current: Explanation) -> Explanation:
    """Drop effects while one of them is worth less than the threshold."""
    while len(current.members) > 1:
        options = [search.without(current, c) for c in current.members if not search.surely(current, c)]
        best = min(options, key=lambda e: e.bic, default=current)
        if best is current or best.bic - current.bic >= BIC_GAIN:
            return current
        current = best
    return current


def _swap(search: Search, current: Explanation) -> Explanation:
    """Replace one effect by a rival while that lowers BIC."""
    for _ in range(WIDTH if len(current.members) > 1 else 0):
        swap(search, current)
        rest = [current.keys - {c.key} for c in current.members]
        same = search.sound(len(current.members))
        option = choose([current, *(e for e in same if any(kept < e.keys for kept in rest))])
        if option is None or option.keys == current.keys:
            return current
        current = option
    return current


def best_so_far(search: Search, base: Fit, most: int) -> Explanation:
    """The answer of a search that ended early: the best of what was fitted, if it is worth its parameters."""
    empty, best = search.empty(base), _best(search, most)
    return empty if best is None or empty.bic - best.bic < BIC_GAIN else best


def carried_over(search: Search, base: Fit, found: Explanation, reduced: float, most: int) -> Explanation:
    """What was found on other windows, fitted on these; sought again if that tells more here and is not down to noise.

    Args:
        search: a new search on these windows; base: the model as declared, fitted here.
        found: what another search chose, and `reduced`, its chi^2/dof there; most: largest number of effects.
    """
    here = fitted_here(search, base, found)
    now = chi2_dof(search.problem, here.fit)
    return here if search.reached(here) or now > MOST * reduced else select(search, base, most)


def fitted_here(search: Search, base: Fit, found: Explanation) -> Explanation:
    """What another search found, fitted to the data of this one; effects that are worth nothing here are dropped."""
    return _prune(search, taken_over(search, base, found))


def taken_over(search: Search, base: Fit, found: Explanation) -> Explanation:
    """What another search found, as far as it is tried in this one, fitted here from its own numbers."""
    own = {c.key: c for c in search.problem.model.candidates}
    pairs = [(c, own[c.key]) for c in found.members if c.key in own]
    if not pairs:
        return search.empty(base)
    values = {
        new: float(found.fit.theta[old])
        for c, m in pairs for old, new in zip(c.slots, m.slots, strict=True)
    }  # fmt: skip
    theta = with_values(search.problem.model.null, values)
    return search.explain(tuple(m for _, m in pairs), theta, fit(search.problem, theta, base.x0, [], {}))


def explained_by_one_more(search: Search, known: Explanation, exclude: Collection[Key] = ()) -> bool:
    """Whether a set is down to the noise, by itself or with one effect more that is not excluded."""
    return search.reached(known) or any(search.reached(e) for e in search.joined(known, exclude))


@dataclass(frozen=True, eq=False)
class Subset:
    """Effects that could join a fit together.

    Attributes:
        members: these effects; values: where a fit of all begins, slot -> value.
        left: chi^2 that the linear problem leaves.
    """

    members: tuple[Candidate, ...]
    values: dict[int, float]
    left: float


_Partial = tuple[tuple[int, ...], float]
"""Which of the candidates that are asked, and the drop of chi^2 that the linear problem promises of them."""


def best_subsets(seen: Screen, size: int) -> list[Subset]:
    """Sets of `size` effects beside the fit, those that leave the least chi^2 first, one of each span.

    An effect that contains another acts as that one at its null, and is left out.
    """
    gram, scale = scaled(seen.gram)
    gradient = seen.gradient / scale
    kept: list[_Partial] = [((), 0.0)]
    for _ in range(size):
        kept = _distinct(seen, [wider for picks, _ in kept for wider in _with_one_more(seen, gram, gradient, picks)])
    found = [_subset(seen, gram, gradient, scale, *p) for p in kept]
    return sorted((s for s in found if s is not None), key=lambda s: s.left)


def _columns(seen: Screen, picks: tuple[int, ...]) -> list[int]:
    return [*range(seen.own), *(j for k in picks for j in seen.asked[k][2])]


def _with_one_more(seen: Screen, gram: Floats, gradient: Floats, picks: tuple[int, ...]) -> list[_Partial]:
    """One more effect in all ways."""
    have = _columns(seen, picks)
    inner = gram[np.ix_(have, have)] + _RIDGE * np.eye(len(have))
    weights = np.linalg.solve(inner, np.column_stack([gram[have], gradient[have]]))
    rest = gram - gram[:, have] @ weights[:, :-1]
    pull = gradient - gram[:, have] @ weights[:, -1]
    whole = float(gradient[have] @ weights[:, -1])
    taken = {seen.asked[k][0].key for k in picks}
    out = list[_Partial]()
    for k, (c, _, columns) in enumerate(seen.asked):
        own = [j for j in columns if rest[j, j] > _LEFT]
        if c.key in taken or c.effect.contains is not None or not own:
            continue
        block = rest[np.ix_(own, own)] + _RIDGE * np.eye(len(own))
        out.append(((*picks, k), whole + float(pull[own] @ np.linalg.solve(block, pull[own]))))
    return out


def _distinct(seen: Screen, options: list[_Partial]) -> list[_Partial]:
    """The best ones, one of those that promise exactly the same (what stands first in the library), one of each set."""

    def place(picks: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(sorted((seen.asked[k][0].slots[0] for k in picks), reverse=True))

    kept, sets = list[_Partial](), set[frozenset[Key]]()
    for picks, drop in sorted(options, key=lambda p: -p[1]):
        keys = frozenset(seen.asked[k][0].key for k in picks)
        same = bool(kept) and abs(kept[-1][1] - drop) <= SAME_PROMISE * max(abs(seen.rest - drop), 1.0)
        if keys in sets or (same and place(picks) >= place(kept[-1][0])):
            continue
        if same:
            kept.pop()
        elif len(kept) == _KEPT:
            break
        kept.append((picks, drop))
        sets.add(keys)
    return kept


def _subset(
    seen: Screen, gram: Floats, gradient: Floats, scale: Floats, picks: tuple[int, ...], drop: float
) -> Subset | None:
    """The set with where its fit begins; None if an effect of it is not physical there."""
    have = _columns(seen, picks)
    inner = gram[np.ix_(have, have)] + _RIDGE * np.eye(len(have))
    step = np.linalg.solve(inner, gradient[have]) / scale[have]
    values = {k: float(seen.at.theta[k] + s) for k, s in zip(seen.at.slots, step[: seen.own], strict=True)}
    by_column = dict(zip(have, step, strict=True))
    for c, start, columns in (seen.asked[k] for k in picks):
        begun = begun_at(c, start, np.array([by_column[j] for j in columns]))
        if begun is None:
            return None
        values |= begun
    return Subset(tuple(seen.asked[k][0] for k in picks), values, seen.rest - drop)


def leap(search: Search, base: Fit, most: int) -> None:
    """Fit what the linear problems promise, two effects first, then more, until a set reaches the noise.

    More than `LEAPS_ANYHOW` effects are tried only where that promises to take most of what is left away: what nothing
    in the library explains is bent a little by everything.
    """
    for size in range(2, most + 1):
        if size > LEAPS_ANYHOW and not _pays(search, size, most):
            return
        fit_larger(search, _sources(search, base, size), size)
        for best in (e for _ in range(2) for e in _best_of_size(search, size, 1) if not search.reached(e)):
            swap(search, best)
        if any(map(search.reached, _best_of_size(search, size, 1))):
            return


def leap_from_beginnings(search: Search, base: Fit, most: int) -> None:
    """Fit sets of two effects or more that promise to leave next to nothing at the beginnings of windows, where little
    has bent yet.

    Those that reach the noise are kept: what stays out of sight of them is then given up.
    """
    seen = at_beginnings(search.problem, base.theta, search.starts)
    one, two = (min((s.left for s in best_subsets(seen, size)), default=seen.rest) for size in (1, 2))
    if two > MOST * one:
        return
    apart = replace(search, tried={}, limit=OUT_OF_SIGHT * search.problem.size)
    for size in range(2, min(most, LEAPS_ANYHOW) + 1):
        near = (s for s in best_subsets(seen, size)[:NARROW] if s.left < MATTERS * seen.rest)
        _fitted(apart, [(search.empty(base), s) for s in near])
        found = {k: e for k, e in apart.tried.items() if e.physical and search.reached(e)}
        search.tried |= found
        if found:
            return


def at_beginnings(problem: Problem, theta: Floats, starts: Starts) -> Screen:
    """The linear problem of the beginnings of windows: in one as long as a swing a spring turns its force round."""
    part = problem.on(problem.windows.begun(_BEGINNING))
    return screen(part, states_fitted(part, theta), {}, Starts(starts.items))


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
    smaller, more = _best_of_size(search, size - 1, 1), range(1, most - size + 2)
    return any(s.left < MOST * e.fit.chi2 for e in smaller for k in more for s in best_subsets(search.screen(e), k)[:1])


def _best_of_size(search: Search, size: int, most: int) -> list[Explanation]:
    """The best physical sets of one size, those aside that refine another."""
    return [e for e in search.sound(size) if all(c.effect.contains is None for c in e.members)][:most]


def _sources(search: Search, base: Fit, size: int) -> list[Explanation]:
    """The best smaller sets, those that lack one effect and more."""
    fewest = max(1, size - LEAPS_ANYHOW)
    smaller = [e for own in range(size - 1, fewest - 1, -1) for e in _best_of_size(search, own, NARROW)]
    return [search.empty(base), *smaller] if size <= LEAPS_ANYHOW else smaller


def _options(
    search: Search, sources: list[Explanation], size: int, below: float = np.inf
) -> list[tuple[Explanation, Subset]]:
    """Sets of one size that are promised less than `below`, the best first, each set once."""
    every = [(e, s) for e in sources for s in best_subsets(search.screen(e), size - len(e.members)) if s.left < below]
    tried, best = {e.keys for e in search.tried.values()}, dict[frozenset[Key], tuple[Explanation, Subset]]()
    for e, s in sorted(every, key=lambda it: it[1].left):
        best.setdefault(e.keys | {c.key for c in s.members}, (e, s))
    return [option for keys, option in best.items() if keys not in tried][:WIDTH]


def _fitted(search: Search, options: Iterable[tuple[Explanation, Subset]]) -> None:
    lower, upper = search.problem.model.lower, search.problem.model.upper
    for e, s in options:
        theta = np.clip(with_values(e.fit.theta, s.values), lower, upper)
        search.explain((*e.members, *s.members), theta, e.fit)
