"""Further tiers of the library: what refines or resembles other effects, and motors that do not move as their joint.

They are left out of the first search because each promises at least as much as what it resembles, or begins where no
derivative leads: elastic gears and play have states of their own. Once the first search has ended they are tried alone,
beside its answer, and in the place of what they resemble, and take over if one of them explains most of what that
leaves; within the noise, if it is told clearly better. What takes over goes on with the rest of the library.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from functools import reduce

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.noise_colour import memory_left
from simgap.diagnosis.search.scoring import Starts
from simgap.diagnosis.search.selection import explained_by_one_more, grow, preferred, taken_over
from simgap.diagnosis.seek import Hypothesis, looked_again
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit
from simgap.diagnosis.simulation.sensitivity import choose_steps, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY, LEAPS_ANYHOW, MOST, NARROW, NEAR
from simgap.effects import EFFECTS

_EVERY = 3  # of the windows, for a first try of a motor
_STEPS = 8  # of a first try of a motor
_FEW = 6  # linearisations of the initial states at a start


def _begun(under: Hypothesis, last: bool = False, few: Collection[str] = ()) -> Hypothesis:
    """The same windows and law of the noise with other tiers of candidates, or a `few`."""
    settings = replace(under.settings, effects=tuple(few)) if few else under.settings
    return under.anew(under.parts.with_tier(settings, not few or last, last))


def screened(start: Hypothesis) -> tuple[Hypothesis | None, Hypothesis | None]:
    """One effect of the second tier, if it reaches the noise and none of the first does by itself; cheap, so first.

    What comes within the noise need not be all: whatever still pays joins it. Beside it the hypothesis under which they
    were tried, so that `second` goes on with it.
    """
    if start.settings.effects or start.reached:
        return None, None
    wide: list[Hypothesis] = []

    def look() -> Hypothesis | None:
        if any(start.search.reached(e) for e in start.search.joined(start.found)):
            return None
        wide.append(_begun(start))
        search, empty = wide[0].search, wide[0].found
        bends = [c.key for c in search.problem.model.candidates if c.effect.one_curve]  # to what others do
        fine = [e for e in search.joined(empty, exclude=[*_first(search), *bends]) if search.reached(e)]
        if not fine:
            return None
        return wide[0].ending(grow(search, min(fine, key=lambda e: e.bic), start.most))

    return looked_again(start.watch, look), wide[0] if wide else None


def explain_all(wide: Hypothesis, found: Explanation) -> bool:
    """Whether one effect of the second tier beside what was found without some of the data explains these too."""
    search = wide.search

    def look() -> bool:
        known = taken_over(search, wide.base, found)
        return explained_by_one_more(search.near(known), known, _first(search))

    return bool(looked_again(wide.watch, look))


def second(first: Hypothesis, wide: Hypothesis | None) -> Hypothesis | None:
    """The search with the second tier, where the first answer leaves more than noise or holds what one resembles.

    Args:
        first: the search without it and its answer; wide: the one with it, where that was begun.
    """
    found, most, off = first.found, first.most, not first.reached
    likes = [e.name for e in EFFECTS.values() if e.second and _names(found) & set(e.resembles)]
    if first.settings.effects or not (off or likes):
        return None

    def look() -> Hypothesis | None:
        trial = (wide or _begun(first)) if off else _begun(first, few=(*sorted(_names(found)), *likes))
        search = trial.search
        known = taken_over(search, trial.base, found)
        options = _in_the_place(search.near(known), known)
        if off:
            options += search.joined(search.empty(trial.base), exclude=_first(search))
            options += search.joined(known, _first(search)) if known.members else []
            most_here = min(most, max(LEAPS_ANYHOW, len(found.members)))
            for e in sorted(options, key=lambda e: e.bic)[:NARROW]:
                grow(search, preferred(search, e, most_here) if len(e.members) >= most_here else e, most_here)
            new = [e for e in search.sound() if len(e.members) <= most_here]
            fine = [e for e in new if math.isfinite(e.bic) and any(c.effect.second for c in e.members)]
            best = preferred(search, min(fine, key=lambda e: e.bic), most_here) if fine else known
        else:
            best = preferred(search, known, most)
        if not any(c.effect.second for c in best.members) or not _takes(search, best, first, known.bic):
            return None
        if off:
            return trial.ending(best)
        whole = _begun(first)
        return whole.ending(taken_over(whole.search, whole.base, best))

    return looked_again(first.watch, look)


def motors(first: Hypothesis) -> Hypothesis | None:
    """The search with elastic joints and play, where one of them takes over.

    They are sought where the first answer leaves more than noise, and where it holds what they resemble: if the
    settings name them, or if the misses remember themselves. One that nobody named has to come down to the noise,
    and to leave nothing that remembers itself: a spring takes most of what play on a spring leaves, and is none.
    """
    found, most, asked = first.found, first.most, first.settings.effects
    model, names, off = first.parts.known.model.model, _names(first.found), not first.reached
    lasts = [e for e in EFFECTS.values() if e.last and (e.targets(model) if asked else e.sought_on(model))]
    lasts = [e for e in lasts if not asked or e.name in asked]
    if not lasts or not (off or any(names & set(e.resembles) for e in lasts)):
        return None
    if not (asked or off or memory_left(first.search.problem, found.fit)):
        return None

    def look() -> Hypothesis | None:
        trial = _begun(first, True, (*sorted(names), *(e.name for e in lasts)))
        search = trial.search
        known = taken_over(search, trial.base, found)
        near = None if asked else min(NEAR * FIT_QUALITY, max(FIT_QUALITY, 1.0 + MOST * (first.left - 1.0)))
        options = _from_far(search, trial.base, known, near, most)
        best = min((e for e in options if e.physical), key=lambda e: e.bic, default=known)
        if best is known or not _takes(search, best, first, min(known.bic, found.bic)):
            return None
        if not asked and (not search.reached(best) or memory_left(search.problem, best.fit)):
            return None
        whole = _begun(first, True)
        search = whole.search
        search.starts = Starts(tuple((c, s) for c, s in search.starts.items if not c.effect.last))  # one is enough
        best = taken_over(search, whole.base, best)
        grow(search, best, most)
        best = preferred(search, best, most)
        return whole.ending(best) if any(c.effect.last for c in best.members) else None

    return looked_again(first.watch, look)


def _names(found: Explanation) -> set[str]:
    return {c.effect.name for c in found.members if not c.of_recording}


def _first(search: Search) -> list[Key]:
    """Effects of the first tier."""
    return [c.key for c in search.problem.model.candidates if not c.effect.second]


def _takes(search: Search, new: Explanation, first: Hypothesis, bic: float) -> bool:
    """Whether a set takes over: of most that is above the noise, or within it by what it tells better."""
    if not first.reached:
        return chi2_dof(search.problem, new.fit) - 1.0 <= MOST * (first.left - 1.0)
    return new.bic < bic - BIC_GAIN


def _in_the_place(search: Search, found: Explanation) -> list[Explanation]:
    """New effects in the place of each one that was found, those that promise most."""
    first = _first(search)
    return [e for m in found.members for e in search.joined(search.without(found, m), first, NARROW)]


def _from_far(search: Search, base: Fit, known: Explanation, near: float | None, most: int) -> list[Explanation]:
    """Each motor alone, beside what is known, and there in the place of what it resembles, from its nearest starts.

    Those are the ones that come nearest once their initial states are fitted. With a largest chi^2/dof, `near`, starts
    are tried on a third of the windows, and only those are fitted to the end from which a few steps come down to it
    there: far from it a fit wanders for long.
    """
    options, few = [], np.arange(0, len(search.problem.windows), 1 if near is None else _EVERY)
    part = search.problem.on(search.problem.windows.pick(few))
    for c in {c.key: c for c, _ in search.starts.items if c.effect.last}.values():
        alike = [m for m in known.members if m.effect.name in c.effect.resembles]
        places = {e.keys: e for e in (search.empty(base), reduce(search.without, alike, known), known)}
        for place in (e for e in places.values() if len(e.members) < most):
            x0, tried, members = place.fit.x0[few], [], (*place.members, c)
            for other, start in search.starts.items:
                if other.key == c.key:
                    theta = with_values(place.fit.theta, c.by_slot(start.point([1.0])))
                    tried.append((float(refit(part, theta, x0, _FEW).chi2.sum()), theta))
            for _, theta in sorted(tried, key=lambda pair: pair[0])[:NARROW]:
                if near is None or _promises(part, members, theta, x0) <= near:
                    options.append(search.explain(members, theta, place.fit, again=True))
    return options


def _promises(part: Problem, members: tuple[Candidate, ...], theta: Floats, x0: Floats) -> float:
    """What a few steps of a fit on some windows leave, chi^2 for each reading."""
    slots = [k for c in members for k in c.free]
    steps = choose_steps(part, theta, x0, slots)
    return fit(part, theta, x0, slots, steps, _STEPS, 1).chi2 / part.size
