"""A hypothesis of a record, and the search under it from its beginning to its end, as far as the budget goes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.folds import Span
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.confidence import chi2_dof, independent_share
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit, states_fitted
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
    taken_over,
)
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.noise_law import Colour, usual_size
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Memo, Problem
from simgap.diagnosis.simulation.step_length import resolved_everywhere
from simgap.diagnosis.thresholds import FAR, FIT_QUALITY, LEAPS_ANYHOW, MATTERS, MOST
from simgap.diagnosis.verdict.faults import around, gross_spans

Found = TypeVar("Found")
_HALVINGS = 3  # of the integration step
_PAIRS = 2  # effects that are sought together under the law of gross errors
_QUIETER = 3  # estimates of the noise, each from the misses under the one before


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What a record is taken for, and the search under it.

    Attributes:
        parts: the folds, with the law of their noise, the times that count and the candidates.
        settings: of the diagnosis; not_tried: candidates that are barred, and why.
        search, base: the search, on fewer samples where there are many, and the model as declared there.
        found: what explains it best; the model as declared before anything is sought.
    """

    parts: Parts
    settings: DiagnosisSettings
    not_tried: Mapping[Key, str]
    search: Search
    base: Fit
    found: Explanation

    @staticmethod
    def of(parts: Parts, settings: DiagnosisSettings, not_tried: Mapping[Key, str], watch: Watch) -> Hypothesis:
        """A hypothesis under which nothing was sought yet."""
        search, base = begun(parts.known, not_tried, watch)
        return Hypothesis(parts, settings, not_tried, search, base, search.empty(base))

    @property
    def most(self) -> int:
        """Largest number of effects."""
        return self.settings.max_effects

    @property
    def watch(self) -> Watch:
        """What may stop the search."""
        return self.search.watch

    @property
    def left(self) -> float:
        """chi^2/dof of what was found."""
        return chi2_dof(self.search.problem, self.found.fit)

    @property
    def reached(self) -> bool:
        """Whether what was found is down to the noise."""
        return self.search.reached(self.found)

    @property
    def acts_later(self) -> bool:
        """Whether commands from outside the record act on it under what was found, and not as declared."""
        problem, theta, null = self.search.problem, self.found.fit.theta, self.search.problem.model.null
        return problem.ahead(theta) > 0.0 or problem.reach(theta) > problem.reach(null)

    def anew(self, parts: Parts, not_tried: Mapping[Key, str] | None = None) -> Hypothesis:
        """Other folds, or fewer candidates, under which nothing was sought yet."""
        return Hypothesis.of(parts, self.settings, self.not_tried if not_tried is None else not_tried, self.watch)

    def ending(self, best: Explanation) -> Hypothesis:
        """With `best`, once what could stand in its place is fitted, which may turn out to be simpler."""
        rivals(self.search, best)
        return replace(self, found=preferred(self.search, best, self.most))

    def searched(self, passing: bool = False) -> Hypothesis:
        """From the beginning to the end; if it is stopped, with the best so far.

        Where that is only `passing`, and commands from outside the record act on what is found, nothing is tried in its
        place: it is sought once more without the samples on which they act.
        """

        def look() -> Hypothesis:
            under = replace(self, found=select(self.search, self.base, self.most))
            return under if passing and under.acts_later else self.ending(under.found)

        return looked_again(self.watch, look) or self._stopped()

    def with_what(self, known: Explanation, left: float) -> Hypothesis:
        """Begun from what is known, with its chi^2/dof where it was found; if it is stopped, that is among the rest."""

        def look() -> Hypothesis:
            return self.ending(carried_over(self.search, self.base, known, left, self.most))

        ended = looked_again(self.watch, look)
        if ended is None:
            fitted_here(self.search, self.base, known)
        return ended or self._stopped()

    def on(self, parts: Parts) -> Hypothesis:
        """What was found, on other folds."""
        return self.anew(parts).with_what(self.found, self.left)

    def read_on(self, plain: Problem) -> Hypothesis:
        """What was found, fitted by least squares to other data of which nothing was left out: the same instrument
        read them, and what follows a change of the plant is no gross error."""
        own, theta = self.parts.known, self.found.fit.theta
        laws = {name: getattr(own, name) for name in ("model", "h_max", "heard", "colour")}
        same = (
            plain.sigma**2 <= FIT_QUALITY * own.sigma**2
        )  # of two estimates of one noise the larger; else it was mended
        sigma = np.where(same, np.maximum(own.sigma, plain.sigma), own.sigma)
        every = replace(plain, **laws, sigma=sigma, memo=Memo())
        every = every.past_the_unknown(every.reach(theta)).before_the_end(every.ahead(theta))
        under = self.anew(replace(self.parts, known=every))
        return replace(under, found=taken_over(under.search, under.base, self.found))

    def _stopped(self) -> Hypothesis:
        return replace(self, found=best_so_far(self.search, self.base, self.most))


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


def begun(problem: Problem, not_tried: Collection[Key], watch: Watch) -> tuple[Search, Fit]:
    """A search on the problem in which nothing was tried yet, and the model as declared."""
    sought = coarse(problem)
    base = states_fitted(sought, sought.model.null)
    return Search(sought, list_starts(sought, not_tried), watch=watch), base


def on_its_step(under: Hypothesis) -> Hypothesis:
    """The search again with half the integration step, until that suits an answer at the noise and what is part of it.

    An effect that cuts the steps shorter, such as a delay, must not be needed for that alone. A search that is stopped
    leaves the answer before it.
    """
    for _ in range(_HALVINGS):
        search, found = under.search, under.found
        inside = [found, *(e for e in search.tried.values() if e.members and e.keys < found.keys)]
        if search.watch.stopped or not found.members or not search.reached(found):
            break
        if all(resolved_everywhere(search.problem, e.fit.theta, e.fit.x0) for e in inside):
            break
        finer = under.on(under.parts.changed(lambda p: replace(p, h_max=p.h_max / 2)))
        if search.watch.stopped:
            break
        under = finer
    return under


def explained(start: Hypothesis) -> bool:
    """Whether the model as declared, with one effect more, or with what was tried already, is down to the noise."""
    search = start.search
    return bool(
        any(map(search.reached, search.sound()))
        or looked_again(start.watch, lambda: explained_by_one_more(search, start.found))
    )


def under_its_law(plain: Hypothesis) -> Hypothesis | None:
    """The search on without pushes; under their law alone where more than noise is left; None where nobody pushed.

    Misses far beyond the usual ones are gross errors, and usual ones get smaller. What the model misses all the time
    says first what is usual, so that nothing it lacks is a gross error; what is worth its parameters at that size
    joins, and leaves smaller ones. Where one effect more explains everything down to the noise, nothing was a gross
    error. The search that it begins with is as it was.
    """
    parts, under = plain.parts, plain
    spans: tuple[Span, ...] = ()
    last = least = np.full(len(parts.known.sigma), np.inf)
    smaller = True
    while not (plain.watch.stopped or under.search.reached(under.found)):
        problem = under.search.problem
        misses = problem.misses(under.found.fit.theta, under.found.fit.x0)
        size = np.maximum(usual_size(misses, problem.used[problem.samples]), 1.0)
        usual = size * problem.sigma
        smaller, before, least = bool(np.any(usual < MOST * least)), smaller, np.minimum(least, usual)
        if not (smaller or before):  # once more after the last: windows are cut where the errors end by then
            break
        if under is not plain and np.all(np.abs(misses) <= FAR * size):  # nothing stands out
            break
        last, problem = usual, coarse(parts.with_gross_errors(usual, spans).known)
        base = fit(problem, plain.base.theta, plain.base.begin(problem), [], {})
        scale = float(np.mean(problem.spread**2)) * independent_share(problem, base)
        search = Search(problem, plain.search.starts, scale, watch=plain.watch)
        pairs = 0 if smaller else min(plain.most, _PAIRS)  # a set grown step by step may hold the misses up
        under = _grown_from(replace(under, search=search, base=base), min(plain.most, LEAPS_ANYHOW), pairs)
        spans = gross_spans(problem, under.found.fit)
    if not spans or plain.watch.stopped:
        return None
    if not under.search.reached(under.found):  # what is left may be no push: nothing is left out
        return replace(under, parts=parts.with_gross_errors(last, spans))
    if looked_again(plain.watch, lambda: _is_explained(plain.search, under.found)):
        return None
    return under.on(parts.leaving_out(around(spans, under.search.problem)).with_gross_errors(last, ()))


def _is_explained(plain: Search, found: Explanation) -> bool:
    """Whether what was found, it with one effect more, or with another or a finer one in the place of one, explains
    what looked like gross errors."""
    apart = Search(plain.problem, plain.starts, plain.scale, ends=plain.ends, watch=plain.watch)
    known = apart.explain(found.members, found.fit.theta, found.fit)
    return explained_by_one_more(apart, known) or any(
        apart.reached(e) for e in (*apart.refined(known), *_in_place(apart, known))
    )


def _in_place(search: Search, known: Explanation) -> list[Explanation]:
    """What could stand in the place of a set, fitted."""
    rivals(search, known)
    return search.sound(len(known.members))


def _grown_from(under: Hypothesis, most: int, pairs: int) -> Hypothesis:
    """The best that a new search finds from what another one found, and from sets of up to `pairs` effects near it."""
    search, base, found = under.search, under.base, under.found

    def look() -> Explanation:
        known = search.explain(found.members, found.fit.theta, found.fit) if found.members else search.empty(base)
        near = replace(search.near(known), ends=dict(search.ends), tried=dict(search.tried))
        leap(near, base, pairs)
        search.tried |= near.finished()
        return preferred(search, grow(search, known, most, finer=False), most)

    return replace(under, found=looked_again(search.watch, look) or best_so_far(search, base, most))


def no_louder_than_misses(under: Hypothesis, least: Floats) -> Hypothesis:
    """The search again under the size of the misses, as long as these are less than noise: no noise is larger.

    A step of an input that a plant follows at once, or an odd reading, is taken for noise where it is estimated from
    neighbouring readings. `least` (k,): standard deviations that are known, or that rounding makes.
    """
    for _ in range(_QUIETER):
        problem, found, parts = under.search.problem, under.found, under.parts
        if under.watch.stopped or under.left * FIT_QUALITY >= 1.0:
            break
        free = problem.size / max(problem.size - problem.taken - len(found.fit.slots), 1.0)
        misses = problem.misses(found.fit.theta, found.fit.x0)
        size = np.sqrt(np.sum(misses**2, axis=0) / problem.compared * free)
        sigma = np.clip(parts.known.sigma * size, least, parts.known.sigma)
        if np.all(sigma > parts.known.sigma / np.sqrt(FIT_QUALITY)):
            break
        under = under.anew(parts.changed(partial(replace, sigma=sigma))).searched()
    return under


def under_its_noise(under: Hypothesis) -> Hypothesis | None:
    """The search again under a noise with a colour, where it then reaches that noise; None where it does not."""
    noise = None if under.watch.stopped else _noise(under)
    if noise is None:
        return None
    size, colour = noise  # its standard deviation over that of before
    louder = under.anew(under.parts.changed(lambda p: replace(p, sigma=p.sigma * size, colour=colour))).searched()
    if under.watch.stopped or not louder.reached:  # the noise was not what lacked
        return None
    limit = min(under.most, LEAPS_ANYHOW)
    full = len(under.found.members) >= limit  # all that it takes anyhow bends to anything, a little memory to the rest
    return None if full and (len(louder.found.members) >= limit or colour.faint.any()) else louder


def _noise(under: Hypothesis) -> tuple[Floats, Colour] | None:
    """The law of the noise, where what was found leaves more than white noise and that is no trace of a force."""
    if under.reached or under.left > 1.0 / MATTERS:
        return None
    known, at = under.parts.known, under.found.fit
    if under.search.problem is not known:
        at = states_fitted(known, at.theta)
    return noise_colour(known, at.theta, at.x0)
