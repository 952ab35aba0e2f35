"""A last look, for a motor that does not move as its joint does: elastic gears and play.

These have states of their own and begin far from a rigid joint, where no derivative leads: they are fitted from several
places, alone and beside the first answer, where that leaves more than noise; at the noise in the place of what they
resemble. What the rest of the library then adds joins them.
"""

from __future__ import annotations

from collections.abc import Mapping

from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.scoring import Starts
from simgap.diagnosis.search.selection import grow, preferred
from simgap.diagnosis.seek import Searched, begun, ended, looked_again
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.refit import refit
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import FIT_QUALITY, MOTOR_FITS, NEAR_TIE, SECOND_SHARE
from simgap.diagnosis.verdict.judge import chi2_dof
from simgap.effects import EFFECTS
from simgap.model.symbolic import SymbolicModel

_FEW = 6  # linearisations of the initial states at a start


def behind(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, first: Search, found: Explanation,
    not_tried: Mapping[Key, str],
) -> tuple[Parts, Searched] | None:  # fmt: skip
    """The folds and a search with such effects, where one of them tells the data clearly better; else None.

    Args:
        model, record, settings: of the diagnosis; these effects are sought where the settings name them.
        first: the search without them, and what it found; not_tried: candidates that are barred.
    """
    lasts = [e for e in EFFECTS.values() if e.last and e.name in settings.effects and e.targets(model)]
    off = chi2_dof(first.problem, found.fit) > FIT_QUALITY
    names = {c.effect.name for c in found.members if not c.of_recording}
    like = any(names & set(e.resembles) for e in lasts)
    if not lasts or first.watch.stopped or not (off or like):
        return None

    def look() -> tuple[Parts, Searched] | None:
        parts, _ = parts_of(model, record, settings, last=True)
        search, base = begun(parts.known, not_tried, first.watch)
        known = _again(search, base, found)
        left = chi2_dof(first.problem, found.fit) - 1.0 if off else 0.0
        best = _best(search, base, known, min(known.bic, found.bic), left, settings.max_effects)
        return None if best is None else (parts, ended(search, base, best, settings.max_effects))

    return looked_again(first.watch, look)


def _best(
    search: Search, base: Fit, known: Explanation, bic: float, left: float, most: int
) -> Explanation | None:  # fmt: skip
    """The best set with such an effect; None if it is not clearly better than what is known.

    `bic`: of the answer before; `left`: of its chi^2/dof above 1, where that is more than noise, else 0.
    """
    lasts = {c.key: c for c, _ in search.starts.items if c.effect.last}
    starts = search.starts
    options = []
    for c in lasts.values():
        beside = _without_alike(search, known, c)
        for place in [search.empty(base)] + ([beside] if 0 < len(beside.members) < most else []):
            options += _joined(search, place, c, starts)
    search.starts = Starts(tuple((c, s) for c, s in starts.items if not c.effect.last))  # one motor is enough
    options = [e for e in options if e.physical]
    if not options:
        return None
    best = min(options, key=lambda e: e.bic)
    if left == 0.0 and best.bic >= bic - NEAR_TIE:
        return None
    if left > 0.0 and chi2_dof(search.problem, best.fit) - 1.0 > SECOND_SHARE * left:
        return None
    grow(search, preferred(search, best, most), most)
    found = preferred(search, best, most)
    return found if any(c.key in lasts for c in found.members) else None


def _joined(search: Search, place: Explanation, c: Candidate, starts: Starts) -> list[Explanation]:
    """The place and the effect, fitted from the starts that come nearest once their initial states are fitted."""
    problem, tried = search.problem, []
    for other, start in starts.items:
        if other.key == c.key:
            values = start.point([1.0])
            slots = {k: values[p.symbol] for p, k in zip(c.effect.parameters, c.slots, strict=True)}
            theta = with_values(place.fit.theta, slots)
            tried.append((float(refit(problem, theta, place.fit.x0, _FEW).chi2.sum()), theta))
    tried.sort(key=lambda pair: pair[0])
    members = (*place.members, c)
    return [search.explain(members, theta, place.fit, again=True) for _, theta in tried[:MOTOR_FITS]]


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
