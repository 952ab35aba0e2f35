"""Which set of effects: forward selection with removals and swaps under BIC."""

from __future__ import annotations

import math
from collections.abc import Iterable

from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.explanations import SAME, Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.leaps import leap, merge, swap
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.thresholds import BIC_GAIN, FAR, FIT_QUALITY, MOST, WIDTH


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
    return slots[:1], _departure(e), slots, e.bic


def _departure(e: Explanation) -> float:
    """By how much ratios of true to declared differ from 1: the sum of their logarithms, to a hundredth."""
    pairs = [(p, float(e.fit.theta[k])) for c in e.members for p, k in zip(c.effect.parameters, c.slots, strict=True)]
    ratios = [abs(v) for p, v in pairs if p.symbol == "ratio" and p.null == 1.0 and v != 0.0]
    return round(sum(abs(math.log(r)) for r in ratios), 2)


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


def grow(search: Search, current: Explanation, most: int) -> Explanation:
    """Add, drop and swap effects from here on while that pays; what contains one of them is tried in its place."""
    while current.members or most:
        more = search.joined(current) if len(current.members) < most else []
        option = choose([*more, *search.refined(current)])
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
    return here if now <= FIT_QUALITY or now > MOST * reduced else select(search, base, most)


def fitted_here(search: Search, base: Fit, found: Explanation) -> Explanation:
    """What another search found, fitted to the data of this one; effects that are worth nothing here are dropped."""
    if not found.members:
        return search.empty(base)
    kept = {k: float(found.fit.theta[k]) for c in found.members for k in c.slots}
    theta = with_values(search.problem.model.null, kept)
    start = fit(search.problem, theta, base.x0, [], {})
    return _prune(search, search.explain(found.members, theta, start))
