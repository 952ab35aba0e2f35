"""A last look, for a motor that does not move as its joint does: elastic gears and play.

These have states of their own and begin far from a rigid joint, where no derivative leads. They are fitted from several
places in a model that holds little else: alone, beside the first answer, and in the place of what they resemble. Where
they tell the data clearly better, the search goes on from there with the rest of the library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.memory_left import memory_left
from simgap.diagnosis.search.scoring import Starts
from simgap.diagnosis.search.selection import grow, preferred
from simgap.diagnosis.seek import Searched, begun, ended, looked_again
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit
from simgap.diagnosis.simulation.sensitivity import choose_step, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import FIT_QUALITY, MOTOR_FITS, MOTOR_NEAR, MOTOR_STEPS, NEAR_TIE, SECOND_SHARE
from simgap.diagnosis.verdict.judge import chi2_dof
from simgap.effects import EFFECTS
from simgap.model.symbolic import SymbolicModel

_EVERY = 3  # of the windows, for a first try
_FEW = 6  # linearisations of the initial states at a start


def behind(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, first: Search, found: Explanation,
    not_tried: Mapping[Key, str],
) -> tuple[Parts, Searched] | None:  # fmt: skip
    """The folds and a search with such effects, where one of them tells the data clearly better; else None.

    They are sought where the first answer leaves more than noise, and where it holds what they resemble: if the
    settings name them, or if the misses remember themselves.

    Args:
        model, record, settings: of the diagnosis; first: the search without them, and what it found.
        not_tried: candidates that are barred.
    """
    asked = settings.effects
    lasts = [e for e in EFFECTS.values() if e.last and (e.targets(model) if asked else e.sought_on(model))]
    lasts = [e for e in lasts if not asked or e.name in asked]
    names = {c.effect.name for c in found.members if not c.of_recording}
    off = chi2_dof(first.problem, found.fit) > FIT_QUALITY
    like = any(names & set(e.resembles) for e in lasts)
    if not lasts or first.watch.stopped or not (off or like):
        return None
    if not asked and not off and not memory_left(first.problem, found.fit):
        return None

    def look() -> tuple[Parts, Searched] | None:
        few = replace(settings, effects=(*sorted(names), *(e.name for e in lasts)))
        near = _nearest(*_begun(model, record, few, first, not_tried), first, found, settings)
        if near is None:
            return None
        parts, search, base = _begun(model, record, settings, first, not_tried)
        search.starts = _one_motor_is_enough(search.starts)
        best, most = _again(search, near.fit, near), settings.max_effects
        grow(search, best, most)
        best = preferred(search, best, most)
        return (parts, ended(search, base, best, most)) if any(c.effect.last for c in best.members) else None

    return looked_again(first.watch, look)


def _begun(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, first: Search, not_tried: Mapping[Key, str]
) -> tuple[Parts, Search, Fit]:
    parts, _ = parts_of(model, record, settings, second=True, last=True)
    return parts, *begun(parts.known, not_tried, first.watch)


def _one_motor_is_enough(starts: Starts) -> Starts:
    return Starts(tuple((c, s) for c, s in starts.items if not c.effect.last))


def _nearest(
    parts: Parts, search: Search, base: Fit, first: Search, found: Explanation, settings: DiagnosisSettings
) -> Explanation | None:
    """The best set with such an effect; None if it is not clearly better than what is known.

    One that nobody named has to come down to the noise, and to leave nothing that remembers itself: a spring takes most
    of what play on a spring leaves, and is none.
    """
    known, options = _again(search, base, found), list[Explanation]()
    before = chi2_dof(first.problem, found.fit)
    near = min(MOTOR_NEAR * FIT_QUALITY, max(FIT_QUALITY, 1.0 + SECOND_SHARE * (before - 1.0)))
    for c in {c.key: c for c, _ in search.starts.items if c.effect.last}.values():
        for place in _places(search, search.empty(base), known, c, settings.max_effects):
            options += _joined(search, place, c, search.starts, None if settings.effects else near)
    options = [e for e in options if e.physical]
    if not options:
        return None
    best = min(options, key=lambda e: e.bic)
    after = chi2_dof(search.problem, best.fit)
    if before > FIT_QUALITY:
        better = after - 1.0 <= SECOND_SHARE * (before - 1.0)
    else:
        better = best.bic < min(known.bic, found.bic) - NEAR_TIE
    clean = bool(settings.effects) or (after <= FIT_QUALITY and not memory_left(search.problem, best.fit))
    return best if better and clean else None


def _places(search: Search, empty: Explanation, known: Explanation, c: Candidate, most: int) -> list[Explanation]:
    """Sets that the effect may join: none, what is known, and that without what it resembles."""
    sets = {e.keys: e for e in (empty, _without_alike(search, known, c), known)}
    return [e for e in sets.values() if len(e.members) < most]


def _joined(search: Search, place: Explanation, c: Candidate, starts: Starts, near: float | None) -> list[Explanation]:
    """The place and the effect, fitted from the starts that come nearest once their initial states are fitted.

    With a largest chi^2/dof, `near`, starts are tried on a third of the windows, and only those are fitted to the end
    from which a few steps come down to it there: far from it a fit wanders for long.
    """
    few = np.arange(0, len(search.problem.windows), 1 if near is None else _EVERY)
    part, x0, tried = search.problem.on(search.problem.windows.pick(few)), place.fit.x0[few], []
    for other, start in starts.items:
        if other.key == c.key:
            values = start.point([1.0])
            slots = {k: values[p.symbol] for p, k in zip(c.effect.parameters, c.slots, strict=True)}
            theta = with_values(place.fit.theta, slots)
            tried.append((float(refit(part, theta, x0, _FEW).chi2.sum()), theta))
    tried.sort(key=lambda pair: pair[0])
    members, found = (*place.members, c), []
    for _, theta in tried[:MOTOR_FITS]:
        if near is None or _promises(part, members, theta, x0) <= near:
            found.append(search.explain(members, theta, place.fit, again=True))
    return found


def _promises(part: Problem, members: tuple[Candidate, ...], theta: Floats, x0: Floats) -> float:
    """What a few steps of a fit on some windows leave, chi^2 for each reading."""
    slots = [k for c in members for p, k in zip(c.effect.parameters, c.slots, strict=True) if not p.integer]
    steps = {k: choose_step(part, theta, x0, k, 1e-4) for k in slots}
    return fit(part, theta, x0, slots, steps, MOTOR_STEPS, 1).chi2 / part.size


def _again(search: Search, base: Fit, found: Explanation) -> Explanation:
    """What was found before, as far as it is tried here, fitted in this search."""
    own = {c.key: c for c in search.problem.model.candidates}
    pairs = [(c, own[c.key]) for c in found.members if c.key in own]
    if not pairs:
        return search.empty(base)
    values = {
        new: float(found.fit.theta[old])
        for c, m in pairs for old, new in zip(c.slots, m.slots, strict=True)
    }  # fmt: skip
    return search.explain(tuple(m for _, m in pairs), with_values(search.problem.model.null, values), base)


def _without_alike(search: Search, known: Explanation, c: Candidate) -> Explanation:
    """The known set without what the effect resembles."""
    for m in known.members:
        if m.effect.name in c.effect.resembles:
            known = search.without(known, m)
    return known
