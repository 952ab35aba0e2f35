"""The set that was chosen on the fold that nothing was fitted to; with `conclude` the only look at *confirm*."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.diagnosis.choosing import Chosen
from simgap.diagnosis.result import Concentrated
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import FIT_QUALITY, LEAPS_ANYHOW
from simgap.diagnosis.verdict.concentration import concentrated
from simgap.diagnosis.verdict.judge import Evidence, HeldOut, chi2_dof, excess_share, folds_agree, judge, needed
from simgap.diagnosis.verdict.score import gained
from simgap.diagnosis.verdict.transfer import independent_share


@dataclass(frozen=True, eq=False)
class Confirmed:
    """What *confirm* says.

    Attributes:
        chosen: the set, without what halves of the other folds disagree on if that is needed and enough.
        old, new: errors of the model as declared and with the set; where: the places that carry most of the second.
        evidence: what the verdict is made of.
    """

    chosen: Chosen
    old: HeldOut
    new: HeldOut
    where: Concentrated | None
    evidence: Evidence


def confirmed(parts: Parts, chosen: Chosen, names: Sequence[str], horizon_s: float) -> Confirmed:
    """Judge a set on *confirm*; a smaller one where that leaves doubt and halves disagree on a part of it."""
    old = judge(parts.confirm, chosen.base.theta, horizon_s)
    found = _judged(parts, chosen, names, old, horizon_s)
    if not chosen.at_floor or found.evidence.agree:
        return found
    less: Explanation | None = _steadier(parts.known, chosen.full, chosen.kept)
    return found if less is None else _judged(parts, chosen.less(less), names, old, horizon_s)


def _judged(parts: Parts, chosen: Chosen, names: Sequence[str], old: HeldOut, horizon_s: float) -> Confirmed:
    new = judge(parts.confirm, chosen.kept.fit.theta, horizon_s)
    where = concentrated(parts.confirm, names, old, new)
    return Confirmed(chosen, old, new, where, _evidence(parts, chosen, old, new))


def _evidence(parts: Parts, chosen: Chosen, old: HeldOut, new: HeldOut) -> Evidence:
    known, confirm = parts.known, parts.confirm
    found, full, agree = chosen.kept, chosen.full, chosen.agree
    share = excess_share(old, new, known.sigma)
    wanted = bool(found.members) and needed(full, found, confirm, new)
    sure = wanted and new.at_noise
    if found.members and chosen.search.watch.stopped:  # nothing compared the halves yet
        agree = folds_agree(known, found, full.steps, independent_share(known, found.fit))
    elif chosen.at_floor and (len(found.members) > LEAPS_ANYHOW or (found.members and not sure)):
        agree = folds_agree(known, found, full.steps, 1.0)
    before, after = (chi2_dof(known, at) for at in (chosen.base, found.fit))
    here, carried = (old.errors.density(), new.errors.density()), chosen.carried
    chose = (np.zeros(0), np.zeros(0)) if carried is None else (carried.declared, carried.predicted)
    whole = gained(*(np.concatenate(each) for each in zip(chose, here, strict=True)))
    return Evidence(before, after, old, new, share, whole, gained(*here).matters, agree, wanted)


def _steadier(known: Problem, search: Search, found: Explanation) -> Explanation | None:
    """The best smaller set that still reaches the noise and on which halves agree; None if there is none.

    An effect that BIC adds for a small misfit (a drift of a position, where dry friction creeps before it slides) must
    not take a right and steady one with it. One effect goes at a time, the one that BIC misses least.
    """
    while len(found.members) > 1:
        smaller = [search.without(found, c) for c in found.members]
        near = sorted((e for e in smaller if e.physical and chi2_dof(known, e.fit) <= FIT_QUALITY), key=lambda e: e.bic)
        for e in near:
            if folds_agree(known, e, search.steps, 1.0):
                return e
        if not near:
            return None
        found = near[0]
    return None
