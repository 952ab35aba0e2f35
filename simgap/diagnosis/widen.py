"""A second look with the whole library: effects that refine or resemble others, where these leave more than noise.

They are left out of the first search because each promises at least as much as what it resembles: they would cost as
much again and crowd it out. Here they are tried alone and beside the first answer, and take over if one of them
explains what that leaves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.explanations import Explanation, Search, sound
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.selection import grow, preferred
from simgap.diagnosis.search.watch import Stopped
from simgap.diagnosis.seek import Searched, begun, ended, looked_again
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.thresholds import FIT_QUALITY, LEAPS_ANYHOW, NEAR_TIE, SECOND_EFFECTS, SECOND_SHARE
from simgap.diagnosis.verdict.judge import chi2_dof
from simgap.effects import EFFECTS
from simgap.model.symbolic import SymbolicModel

Wide = tuple[Parts, Search, Fit]
"""The folds, a search and the model as declared with every effect of the library."""


def screened(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, search: Search, base: Fit,
    not_tried: Mapping[Key, str],
) -> tuple[tuple[Parts, Searched] | None, Wide | None]:  # fmt: skip
    """One such effect by itself, if it reaches the noise and none of the others does by itself; cheap, and first.

    What comes within the noise need not be all: whatever still pays joins it. Beside it the search in which they were
    tried, so that `widened` goes on with it.

    Args:
        model, record, settings: of the diagnosis; search, base: without those effects, and the model as declared there.
        not_tried: candidates that are barred.
    """
    if settings.effects or chi2_dof(search.problem, base) <= FIT_QUALITY:
        return None, None
    wide: Wide | None = None
    try:
        if any(chi2_dof(search.problem, e.fit) <= FIT_QUALITY for e in search.joined(search.empty(base))):
            return None, None
        wide = _wide(model, record, settings, search, not_tried)
        if wide is None:
            return None, None
        parts, other, start = wide
        bends = [c.key for c in other.problem.model.candidates if c.effect.one_curve]  # to what others do: never first
        alone = other.joined(other.empty(start), exclude=[*_known(other), *bends])
        fine = [e for e in alone if chi2_dof(other.problem, e.fit) <= FIT_QUALITY]
        if not fine:
            return None, wide
        best = grow(other, min(fine, key=lambda e: e.bic), settings.max_effects)
        return (parts, ended(other, start, best, settings.max_effects)), wide
    except Stopped:
        return None, wide
    except KeyboardInterrupt:
        search.watch.interrupted()
        return None, wide


def widened(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, first: Search, found: Explanation,
    not_tried: Mapping[Key, str], begun_before: Wide | None = None,
) -> tuple[Parts, Searched] | None:  # fmt: skip
    """The folds and the search with every effect of the library; None if the first search has all that is needed.

    Args:
        model, record, settings: of the diagnosis; where the case names the effects to try, there is no second look.
        first: the search without those effects, and what it found; not_tried: candidates that are barred.
        begun_before: that search, where `screened` began it on the same windows.
    """
    left = chi2_dof(first.problem, found.fit) - 1.0
    if settings.effects or first.watch.stopped or left <= FIT_QUALITY - 1.0:
        return None

    def look() -> tuple[Parts, Searched] | None:
        wide = begun_before or _wide(model, record, settings, first, not_tried)
        if wide is None:
            return None
        parts, search, base = wide
        most = min(settings.max_effects, max(LEAPS_ANYHOW, len(found.members)))
        best = _best(search, base, _again(search, base, found), most)
        if best is None or chi2_dof(search.problem, best.fit) - 1.0 > SECOND_SHARE * left:
            return None
        return parts, ended(search, base, best, settings.max_effects)

    return looked_again(first.watch, look)


def clearer(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, first: Search, found: Explanation,
    not_tried: Mapping[Key, str],
) -> tuple[Parts, Searched] | None:  # fmt: skip
    """The search with every effect, where one of them in the place of what it resembles tells the data clearly better.

    A plain limit comes within the noise of a torque-speed limit that is seldom reached. Only these few effects are
    compiled and tried, and only where what they resemble was found.

    Args:
        model, record, settings: of the diagnosis; first: the search without those effects, and what it found.
        not_tried: candidates that are barred.
    """
    names = {c.effect.name for c in found.members if not c.of_recording}
    likes = {e.name: e for e in EFFECTS.values() if e.second and names & set(e.resembles)}
    off = chi2_dof(first.problem, found.fit) > FIT_QUALITY
    if not likes or settings.effects or first.watch.stopped or off:
        return None

    def look() -> tuple[Parts, Searched] | None:
        parts, _ = parts_of(model, record, replace(settings, effects=(*sorted(names), *likes)))
        search, base = begun(parts.known, not_tried, first.watch)
        known = _again(search, base, found)
        _in_the_place(search, known)
        best = preferred(search, known, settings.max_effects)
        if not any(c.effect.second for c in best.members) or best.bic > known.bic - NEAR_TIE:
            return None
        wide = _wide(model, record, settings, first, not_tried)
        if wide is None:
            return None
        parts, search, base = wide
        return parts, ended(search, base, _again(search, base, best), settings.max_effects)

    return looked_again(first.watch, look)


def _wide(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, first: Search, not_tried: Mapping[Key, str]
) -> Wide | None:
    """The folds, a search and the model as declared with every effect of the library; None if that adds none."""
    parts, _ = parts_of(model, record, settings, second=True)
    if not any(c.effect.second for c in parts.known.model.candidates):
        return None
    return parts, *begun(parts.known, not_tried, first.watch)


def _known(search: Search) -> list[Key]:
    """Effects that the first search tries."""
    return [c.key for c in search.problem.model.candidates if not c.effect.second]


def _again(search: Search, base: Fit, found: Explanation) -> Explanation:
    """What the first search found, fitted in the wider problem."""
    if not found.members:
        return search.empty(base)
    members = tuple(search.problem.model.find(*c.key) for c in found.members)
    values = {
        new: float(found.fit.theta[old])
        for c, m in zip(found.members, members, strict=True) for old, new in zip(c.slots, m.slots, strict=True)
    }  # fmt: skip
    return search.explain(members, with_values(search.problem.model.null, values), base)


def _best(search: Search, base: Fit, found: Explanation, most: int) -> Explanation | None:
    """The best set with one of the effects that were not tried yet; the rest of the library joins it freely."""
    known = [c.key for c in search.problem.model.candidates if not c.effect.second]
    options = [
        *search.joined(search.empty(base), exclude=known),
        *(search.joined(found, known) if found.members else ()),
    ]
    options += [*_in_the_place(search, found), *_without_the_idle(search)]
    for e in sorted(options, key=lambda e: e.bic)[:SECOND_EFFECTS]:
        grow(search, preferred(search, e, most) if len(e.members) >= most else e, most)
    new = [e for e in search.tried.values() if e.physical and any(c.effect.second for c in e.members)]
    fine = [e for e in new if len(e.members) <= most and math.isfinite(e.bic)]
    return preferred(search, min(fine, key=lambda e: e.bic), most) if fine else None


def _in_the_place(search: Search, found: Explanation) -> list[Explanation]:
    """Each new effect in the place of what it resembles, where that was found: of one such effect and of all."""
    options: list[Explanation] = []
    for c in search.problem.model.candidates:
        like = [m for m in found.members if m.effect.name in c.effect.resembles]
        others = [k.key for k in search.problem.model.candidates if k.key != c.key]
        for gone in [[m] for m in like] + ([like] if len(like) > 1 else []):
            kept = found
            for m in gone:
                kept = search.without(kept, m)
            options += search.joined(kept, others)
    return options


def _without_the_idle(search: Search) -> list[Explanation]:
    """The best sets in which a new effect leaves others nothing to do, without those: they had stood in for it."""
    idle = [
        e for e in search.tried.values()
        if not e.physical and math.isfinite(e.bic)
        and any(c.effect.second and sound(c, e.fit) for c in e.members)
    ]  # fmt: skip
    found = []
    for e in sorted(idle, key=lambda e: e.bic)[:SECOND_EFFECTS]:
        while e.members and not e.physical:
            gone = next((c for c in e.members if not sound(c, e.fit)), None)
            if gone is None:
                break
            e = search.without(e, gone)
        if any(c.effect.second for c in e.members):
            found.append(e)
    return found
