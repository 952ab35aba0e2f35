"""The set that was chosen on the fold that nothing was fitted to; with `conclude` the only look at *confirm*."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.choosing import Chosen
from simgap.diagnosis.result import Concentrated, Stretches
from simgap.diagnosis.search.confidence import chi2_dof, independent_share
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import A_FEW, FIT_QUALITY, LEAPS_ANYHOW, MOST
from simgap.diagnosis.verdict.horizon import HorizonError
from simgap.diagnosis.verdict.judge import Evidence, HeldOut, excess_share, folds_agree, judge, needed
from simgap.diagnosis.verdict.score import Errors, Gain, gained


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
    return Evidence(before, after, old, new, share, whole, is_borne_out(old.errors, new.errors), agree, wanted)


def is_borne_out(declared: Errors, corrected: Errors) -> bool:
    """Whether errors on *confirm* by itself get smaller by a size that matters, and in no channel larger by as much."""
    gains = (corrected.by_channel() - declared.by_channel()).mean(axis=0)
    whole, *losses = (Gain(float(nats), 0.0) for nats in (gains.mean(), *-gains))
    return whole.matters and not any(loss.matters for loss in losses)


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


def concentrated(confirm: Problem, names: Sequence[str], old: HeldOut, new: HeldOut) -> Concentrated | None:
    """Where a small part of the predictions on *confirm* carries most of the squared error that is left.

    Args:
        confirm: the problem; names: of its traces.
        old, new: errors of the declared model and of the one that is judged.

    Returns:
        None where nothing is above the noise, predictions are few, or the error is spread over the time.
    """
    before, after = old.horizon, new.horizon
    if new.at_noise or before is None or after is None or A_FEW * len(after.error) < 1.0:
        return None
    size = np.sort(_size(after, confirm.sigma))[::-1]
    carried = np.cumsum(size) / np.sum(size)
    count = int(np.searchsorted(carried, MOST)) + 1
    if count > A_FEW * len(size):
        return None
    worst = [_worst(h, count, confirm.sigma) for h in (before, after)]
    rest = [~_touched(h, bad) for h, bad in zip((before, after), worst, strict=True)]
    if not all(r.any() for r in rest):
        return None
    was, now = (_excess(h, r, after.floor, confirm.sigma) for h, r in zip((before, after), rest, strict=True))
    share, medians = math.sqrt(now / was) if was > 0.0 else 1.0, (_median(before, confirm), _median(after, confirm))
    return Concentrated(_places(confirm, names, after, worst[1]), float(carried[count - 1]), share, *medians)


def _size(h: HorizonError, sigma: Floats) -> Floats:
    return np.asarray(np.mean((h.error / sigma) ** 2, axis=1))


def _worst(h: HorizonError, count: int, sigma: Floats) -> Bools:
    """So many predictions that miss most, of each model its own: to leave out where one misses would flatter it."""
    bad = np.zeros(len(h.error), dtype=bool)
    bad[np.argsort(-_size(h, sigma))[:count]] = True
    return bad


def _touched(h: HorizonError, bad: Bools) -> Bools:
    """Predictions that overlap a bad one."""
    spans = zip(h.begin[bad], h.end[bad], strict=True)
    return np.any([(h.begin <= b) & (h.end >= a) for a, b in spans], axis=0)


def _excess(h: HorizonError, which: Bools, floor: Floats, sigma: Floats) -> float:
    """Mean square above the floor, of some of the predictions, in units of the noise."""
    return float(np.mean(np.maximum(np.mean(h.error[which] ** 2, axis=0) - floor**2, 0.0) / sigma**2))


def _median(h: HorizonError, confirm: Problem) -> dict[str, float]:
    return dict(zip(confirm.model.measured, map(float, np.median(np.abs(h.error), axis=0)), strict=True))


def _places(confirm: Problem, names: Sequence[str], after: HorizonError, bad: Bools) -> Stretches:
    """What most of the bad predictions around have in common, as stretches of time."""
    change = np.zeros(len(confirm.t) + 1)
    np.add.at(change, after.begin[bad], 1.0)
    np.add.at(change, after.end[bad] + 1, -1.0)
    cover = np.cumsum(change)[:-1]
    out, k = [], 0
    while k < len(cover):
        if cover[k] == 0.0:
            k += 1
            continue
        stop = k + int(np.argmax(np.append(cover[k:], 0.0) == 0.0))
        core = k + np.flatnonzero(cover[k:stop] > 0.5 * cover[k:stop].max())
        trace = int(np.searchsorted(confirm.firsts, k, side="right")) - 1
        out.append((names[trace], float(confirm.t[core[0]]), float(confirm.t[core[-1]])))
        k = stop
    return tuple(out)
