"""One search from its beginning to its end: on a problem, with what is known before, as far as the budget goes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.folds import Span
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.confidence import chi2_dof, independent_share
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.noise_colour import noise_colour
from simgap.diagnosis.search.scoring import list_starts
from simgap.diagnosis.search.selection import (
    best_so_far,
    carried_over,
    explained_by_one_more,
    fitted_here,
    grow,
    leap,
    preferred,
    select,
)
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.noise_law import Colour, usual_size
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.step_length import resolved_everywhere
from simgap.diagnosis.thresholds import FAR, FIT_QUALITY, LEAPS_ANYHOW, MATTERS, MOST
from simgap.diagnosis.verdict.faults import gross_spans

Searched = tuple[Search, Fit, Explanation]
"""The search, the model as declared on it, and what explains it best."""

Found = TypeVar("Found")
_HALVINGS = 3  # of the integration step
_PAIRS = 2  # effects that are sought together under the law of gross errors
_QUIETER = 3  # estimates of the noise, each from the misses under the one before


def looked_again(watch: Watch, look: Callable[[], Found | None]) -> Found | None:
    """What one more look finds; None where it finds nothing, or the search is stopped."""
    if watch.stopped:
        return None
    try:
        return look()
    except Stopped:
        return None
    except KeyboardInterrupt:
        watch.stopped = "The search was interrupted"
        return None


def ended(search: Search, base: Fit, best: Explanation, most: int) -> Searched:
    """A search that ends with `best`: what could stand in its place is fitted, and may turn out to be simpler."""
    rivals(search, best)
    return search, base, preferred(search, best, most)


def begun(problem: Problem, not_tried: Collection[Key], watch: Watch) -> tuple[Search, Fit]:
    """A search on the problem in which nothing was tried yet, and the model as declared."""
    sought = coarse(problem)
    base = fit(sought, sought.model.null, initial_states(sought), [], {})
    return Search(sought, list_starts(sought, not_tried), watch=watch), base


def searched(
    problem: Problem, most: int, not_tried: Collection[Key], watch: Watch,
    known: tuple[Explanation, float] | None = None, before: tuple[Search, Fit] | None = None,
) -> Searched:  # fmt: skip
    """A search on the problem, the model as declared, and what explains it best; begun from what is `known`.

    What is known comes with its chi^2/dof where it was found. A search that is stopped ends with its best so far, what
    was known among it; one that was begun `before` goes on.
    """
    search, base = before or begun(problem, not_tried, watch)

    def look() -> Searched:
        found = select(search, base, most) if known is None else carried_over(search, base, *known, most)
        if before is not None and acts_later(search, found):  # sought once more without what was commanded before
            return search, base, found
        return ended(search, base, found, most)

    if (ends := looked_again(watch, look)) is not None:
        return ends
    if known is not None:
        fitted_here(search, base, known[0])
    return search, base, best_so_far(search, base, most)


def on_its_step(parts: Parts, ends: Searched, most: int, not_tried: Collection[Key]) -> tuple[Parts, Searched]:
    """The search again with half the integration step, until that suits an answer at the noise and what is part of it.

    An effect that cuts the steps shorter, such as a delay, must not be needed for that alone. A search that is stopped
    leaves the answer before it.
    """
    for _ in range(_HALVINGS):
        search, _, found = ends
        inside = [found, *(e for e in search.tried.values() if e.members and e.keys < found.keys)]
        if search.watch.stopped or not found.members or not search.reached(found):
            break
        if all(resolved_everywhere(search.problem, e.fit.theta, e.fit.x0) for e in inside):
            break
        finer = parts.changed(lambda p: replace(p, h_max=p.h_max / 2))
        again = searched(finer.known, most, not_tried, search.watch, (found, chi2_dof(search.problem, found.fit)))
        if search.watch.stopped:
            break
        parts, ends = finer, again
    return parts, ends


def acts_later(search: Search, found: Explanation) -> bool:
    """Whether commands from outside the record act on it under what was found, and not as declared."""
    problem, null = search.problem, search.problem.model.null
    return problem.ahead(found.fit.theta) > 0.0 or problem.reach(found.fit.theta) > problem.reach(null)


def explained_by_one(search: Search, base: Fit) -> bool:
    """Whether the model as declared or with one effect more is down to the noise."""
    return bool(looked_again(search.watch, lambda: explained_by_one_more(search, search.empty(base))))


def under_its_law(
    parts: Parts, plain: Search, base: Fit, most: int, not_tried: Collection[Key]
) -> tuple[Parts, Searched] | None:
    """The search on without pushes; under their law alone where more than noise is left; None where nobody pushed.

    Misses far beyond the usual ones are gross errors, and usual ones get smaller. What the model misses all the time
    says first what is usual, so that nothing it lacks is a gross error; what is worth its parameters at that size
    joins, and leaves smaller ones. Where one effect more explains everything down to the noise, nothing was a gross
    error. The search that it begins with is as it was.
    """
    search, start, found, problem = plain, base, plain.empty(base), plain.problem
    spans: tuple[Span, ...] = ()
    last = least = np.full(len(problem.sigma), np.inf)
    smaller = True
    while not (search.watch.stopped or search.reached(found)):
        misses = problem.misses(found.fit.theta, found.fit.x0)
        size = np.maximum(usual_size(misses, problem.used[problem.samples]), 1.0)
        usual = size * problem.sigma
        smaller, before, least = bool(np.any(usual < MOST * least)), smaller, np.minimum(least, usual)
        if not (smaller or before):  # once more after the last: windows are cut where the errors end by then
            break
        if search is not plain and np.all(np.abs(misses) <= FAR * size):  # nothing stands out
            break
        last, problem = usual, coarse(parts.with_gross_errors(usual, spans).known)
        start = fit(problem, base.theta, base.begin(problem), [], {})
        scale = float(np.mean(problem.spread**2)) * independent_share(problem, start)
        search = Search(problem, plain.starts, scale, watch=search.watch)
        if not smaller:  # a set that was grown step by step may hold the misses up; three far from the noise cost much
            looked_again(search.watch, partial(leap, search, start, min(most, _PAIRS)))
        found = _grown_from(search, start, found, min(most, LEAPS_ANYHOW))
        spans = gross_spans(problem, found.fit)
    if not spans or search.watch.stopped:
        return None
    if not search.reached(found):  # what is left may be no push: nothing is left out
        return parts.with_gross_errors(last, spans), (search, start, found)
    if looked_again(plain.watch, lambda: _is_explained(plain, found)):
        return None
    aside = 0.25 * problem.brief
    around = tuple((k, a - aside, b + aside) for k, a, b in spans)
    kept = parts.leaving_out(around).with_gross_errors(last, ())
    return kept, searched(kept.known, most, not_tried, search.watch, (found, chi2_dof(problem, found.fit)))


def _is_explained(plain: Search, found: Explanation) -> bool:
    """Whether what was found, it with one effect more or with a finer one, explains what looked like gross errors."""
    apart = Search(plain.problem, plain.starts, plain.scale, ends=plain.ends, watch=plain.watch)
    known = apart.explain(found.members, found.fit.theta, found.fit)
    return explained_by_one_more(apart, known) or any(apart.reached(e) for e in apart.refined(known))


def _grown_from(search: Search, base: Fit, found: Explanation, most: int) -> Explanation:
    """The best that a search finds from what another one found."""

    def look() -> Explanation:
        known = search.explain(found.members, found.fit.theta, found.fit) if found.members else search.empty(base)
        return preferred(search, grow(search, known, most, finer=False), most)

    return looked_again(search.watch, look) or best_so_far(search, base, most)


def no_louder_than_misses(
    parts: Parts, ends: Searched, least: Floats, most: int, not_tried: Collection[Key]
) -> tuple[Parts, Searched]:
    """The search again under the size of the misses, as long as these are less than noise: no noise is larger.

    A step of an input that a plant follows at once, or an odd reading, is taken for noise where it is estimated from
    neighbouring readings. `least` (k,): standard deviations that are known, or that rounding makes.
    """
    for _ in range(_QUIETER):
        search, _, found = ends
        problem = search.problem
        if search.watch.stopped or chi2_dof(problem, found.fit) * FIT_QUALITY >= 1.0:
            break
        free = problem.size / max(problem.size - problem.taken - len(found.fit.slots), 1.0)
        misses = problem.misses(found.fit.theta, found.fit.x0)
        size = np.sqrt(np.sum(misses**2, axis=0) / problem.compared * free)
        sigma = np.clip(parts.known.sigma * size, least, parts.known.sigma)
        if np.all(sigma > parts.known.sigma / np.sqrt(FIT_QUALITY)):
            break
        parts = parts.changed(partial(replace, sigma=sigma))
        ends = searched(parts.known, most, not_tried, search.watch)
    return parts, ends


def under_its_noise(
    parts: Parts, ends: Searched, most: int, not_tried: Collection[Key]
) -> tuple[Parts, Searched] | None:
    """The search again under a noise with a colour, where it then reaches that noise; None where it does not."""
    search, _, found = ends
    noise = None if search.watch.stopped else _noise(parts.known, search, found)
    if noise is None:
        return None
    size, colour = noise  # its standard deviation over that of before
    louder = parts.changed(lambda p: replace(p, sigma=p.sigma * size, colour=colour))
    again = searched(louder.known, most, not_tried, search.watch)
    if search.watch.stopped or chi2_dof(again[0].problem, again[2].fit) > FIT_QUALITY:  # the noise was not what lacked
        return None
    limit = min(most, LEAPS_ANYHOW)
    full = len(found.members) >= limit  # all that it takes anyhow bends to anything, and a little memory to the rest
    if full and (len(again[2].members) >= limit or colour.faint.any()):
        return None
    return louder, again


def _noise(known: Problem, search: Search, found: Explanation) -> tuple[Floats, Colour] | None:
    """The law of the noise, where what was found leaves more than white noise and that is no trace of a force."""
    if not FIT_QUALITY < chi2_dof(search.problem, found.fit) <= 1.0 / MATTERS:
        return None
    at = found.fit
    if search.problem is not known:
        at = fit(known, at.theta, initial_states(known), [], {})
    return noise_colour(known, at.theta, at.x0)
