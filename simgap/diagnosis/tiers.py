"""Further tiers of the library: what refines or resembles other effects, and motors that do not move as their joint.

They are left out of the first search because each promises at least as much as what it resembles, or begins where no
derivative leads: elastic gears and play have states of their own. Once the first search has ended they are tried alone,
beside its answer, and in the place of what they resemble, and take over if one of them explains most of what that
leaves; within the noise, if it is told clearly better. What takes over goes on with the rest of the library.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.noise_colour import memory_left
from simgap.diagnosis.search.scoring import Starts
from simgap.diagnosis.search.selection import explained_by_one_more, grow, preferred, taken_over
from simgap.diagnosis.seek import Searched, begun, ended, looked_again
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit
from simgap.diagnosis.simulation.sensitivity import choose_steps, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY, LEAPS_ANYHOW, MOST, NARROW, NEAR
from simgap.effects import EFFECTS
from simgap.model.symbolic import SymbolicModel

Begun = tuple[Parts, Search, Fit]
"""The folds, a search on them in which nothing was tried yet, and the model as declared."""
_EVERY = 3  # of the windows, for a first try of a motor
_STEPS = 8  # of a first try of a motor
_FEW = 6  # linearisations of the initial states at a start


@dataclass(frozen=True, eq=False)
class Tiers:
    """The tiers of the library for one record.

    Attributes:
        model, settings: of the diagnosis; not_tried: candidates that are barred.
        like: the folds of the first tier, whose windows and law of gross errors hold for all.
    """

    model: SymbolicModel
    settings: DiagnosisSettings
    not_tried: Mapping[Key, str]
    like: Parts

    def _begun(self, first: Search, last: bool = False, few: Collection[str] = ()) -> Begun:
        settings = replace(self.settings, effects=tuple(few)) if few else self.settings
        parts = self.like.with_tier(settings, not few or last, last)
        return parts, *begun(parts.known, self.not_tried, first.watch)

    def screened(self, search: Search, base: Fit) -> tuple[tuple[Parts, Searched] | None, Begun | None]:
        """One effect of the second tier, if it reaches the noise and none of the first does by itself; cheap, so first.

        What comes within the noise need not be all: whatever still pays joins it. Beside it the search in which they
        were tried, so that `second` goes on with it.
        """
        if self.settings.effects or chi2_dof(search.problem, base) <= FIT_QUALITY:
            return None, None
        wide: list[Begun] = []

        def look() -> tuple[Parts, Searched] | None:
            if any(search.reached(e) for e in search.joined(search.empty(base))):
                return None
            wide.append(self._begun(search))
            parts, other, start = wide[0]
            bends = [c.key for c in other.problem.model.candidates if c.effect.one_curve]  # to what others do
            alone = other.joined(other.empty(start), exclude=[*_first(other), *bends])
            fine = [e for e in alone if other.reached(e)]
            if not fine:
                return None
            best = grow(other, min(fine, key=lambda e: e.bic), self.settings.max_effects)
            return parts, ended(other, start, best, self.settings.max_effects)

        return looked_again(search.watch, look), wide[0] if wide else None

    def explain_all(self, found: Explanation, wide: Begun | None) -> bool:
        """Whether one effect of the second tier beside what was found without some of the data explains these too."""
        if wide is None:
            return False
        _, search, base = wide

        def look() -> bool:
            known = taken_over(search, base, found)
            return explained_by_one_more(search.near(known), known, _first(search))

        return bool(looked_again(search.watch, look))

    def second(self, first: Search, found: Explanation, wide: Begun | None) -> tuple[Parts, Searched] | None:
        """The search with the second tier, where the first answer leaves more than noise or holds what one resembles.

        Args:
            first, found: the search without it and its answer; wide: the search with it, where that was begun.
        """
        likes = [e.name for e in EFFECTS.values() if e.second and _names(found) & set(e.resembles)]
        before = chi2_dof(first.problem, found.fit)
        off = before > FIT_QUALITY
        if self.settings.effects or not (off or likes):
            return None
        most = self.settings.max_effects

        def look() -> tuple[Parts, Searched] | None:
            trial = (wide or self._begun(first)) if off else self._begun(first, few=(*sorted(_names(found)), *likes))
            _, search, base = trial
            known = taken_over(search, base, found)
            options = _in_the_place(search, known)
            if off:
                options += search.joined(search.empty(base), exclude=_first(search))
                options += search.joined(known, _first(search)) if known.members else []
                most_here = min(most, max(LEAPS_ANYHOW, len(found.members)))
                for e in sorted(options, key=lambda e: e.bic)[:NARROW]:
                    grow(search, preferred(search, e, most_here) if len(e.members) >= most_here else e, most_here)
                new = [e for e in search.sound() if len(e.members) <= most_here]
                fine = [e for e in new if math.isfinite(e.bic) and any(c.effect.second for c in e.members)]
                best = preferred(search, min(fine, key=lambda e: e.bic), most_here) if fine else known
            else:
                best = preferred(search, known, most)
            if not any(c.effect.second for c in best.members) or not _takes(search, best, before, known.bic):
                return None
            parts, search, base = trial if off else self._begun(first)
            return parts, ended(search, base, best if off else taken_over(search, base, best), most)

        return looked_again(first.watch, look)

    def motors(self, first: Search, found: Explanation) -> tuple[Parts, Searched] | None:
        """The search with elastic joints and play, where one of them takes over.

        They are sought where the first answer leaves more than noise, and where it holds what they resemble: if the
        settings name them, or if the misses remember themselves. One that nobody named has to come down to the noise,
        and to leave nothing that remembers itself: a spring takes most of what play on a spring leaves, and is none.
        """
        asked, names = self.settings.effects, _names(found)
        lasts = [
            e for e in EFFECTS.values() if e.last and (e.targets(self.model) if asked else e.sought_on(self.model))
        ]
        lasts = [e for e in lasts if not asked or e.name in asked]
        before = chi2_dof(first.problem, found.fit)
        off = before > FIT_QUALITY
        if not lasts or not (off or any(names & set(e.resembles) for e in lasts)):
            return None
        if not (asked or off or memory_left(first.problem, found.fit)):
            return None

        def look() -> tuple[Parts, Searched] | None:
            _, search, base = self._begun(first, True, (*sorted(names), *(e.name for e in lasts)))
            known = taken_over(search, base, found)
            near = None if asked else min(NEAR * FIT_QUALITY, max(FIT_QUALITY, 1.0 + MOST * (before - 1.0)))
            options = _from_far(search, base, known, near, self.settings.max_effects)
            best = min((e for e in options if e.physical), key=lambda e: e.bic, default=known)
            if best is known or not _takes(search, best, before, min(known.bic, found.bic)):
                return None
            if not asked and (not search.reached(best) or memory_left(search.problem, best.fit)):
                return None
            parts, search, base = self._begun(first, True)
            search.starts = Starts(tuple((c, s) for c, s in search.starts.items if not c.effect.last))  # one is enough
            best, most = taken_over(search, base, best), self.settings.max_effects
            grow(search, best, most)
            best = preferred(search, best, most)
            return (parts, ended(search, base, best, most)) if any(c.effect.last for c in best.members) else None

        return looked_again(first.watch, look)


def _names(found: Explanation) -> set[str]:
    return {c.effect.name for c in found.members if not c.of_recording}


def _first(search: Search) -> list[Key]:
    """Effects of the first tier."""
    return [c.key for c in search.problem.model.candidates if not c.effect.second]


def _takes(search: Search, new: Explanation, before: float, bic: float) -> bool:
    """Whether a set takes over: of most that is above the noise, or within it by what it tells better."""
    if before > FIT_QUALITY:
        return chi2_dof(search.problem, new.fit) - 1.0 <= MOST * (before - 1.0)
    return new.bic < bic - BIC_GAIN


def _in_the_place(search: Search, found: Explanation) -> list[Explanation]:
    """New effects in the place of each one that was found, those that promise most."""
    first = _first(search)
    return [e for m in found.members for e in search.joined(search.without(found, m), first, NARROW)]


def _less(search: Search, found: Explanation, gone: Collection[Candidate]) -> Explanation:
    for m in gone:
        found = search.without(found, m)
    return found


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
        places = {e.keys: e for e in (search.empty(base), _less(search, known, alike), known)}
        for place in places.values():
            if len(place.members) >= most:
                continue
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
