"""From what was chosen to the answer; here alone the fold *confirm* is looked at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.diagnosis.choosing import Chosen
from simgap.diagnosis.record.faults.measurement import is_fault
from simgap.diagnosis.record.faults.registry import fitted_faults, gain_faults
from simgap.diagnosis.record.folds import stretches
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, FoundEffect, Judged, Nearest, RecordingFault, Verdict
from simgap.diagnosis.search.confidence import independent_share
from simgap.diagnosis.search.equivalence import Rival, once, rivals
from simgap.diagnosis.search.explanations import Explanation, Search, doubted
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.simulation.noise_law import LIMIT
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import LEAPS_ANYHOW, MATTERS, PLAUSIBLE_RATIO, SELDOM
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.faults import extrapolated, faint_memory, noise_faults, push_faults, pushes
from simgap.diagnosis.verdict.held_out import HeldOut, concentrated, excess_share, judge, judged, noise_floor
from simgap.diagnosis.verdict.score import Errors, Gain, gained
from simgap.diagnosis.verdict.sets import as_good, folds_agree, plausible, slight
from simgap.notation import percent
from simgap.statistics import chi2, norm


def conclude(
    record: Record, settings: DiagnosisSettings, parts: Parts, choice: Chosen, said: tuple[str, ...],
    faults: tuple[RecordingFault, ...],
) -> Diagnosis:  # fmt: skip
    """From what was chosen to the answer; here alone *confirm* is looked at."""
    horizon, names = parts.horizon_s, [trace.name for trace in record.traces]
    parts, chosen, evidence = confirmed(parts, choice, horizon)
    known, confirm = parts.known, parts.confirm
    old, base, search, watch = evidence.declared, chosen.base, chosen.search, chosen.search.watch
    grade = _graded(record, parts, chosen, evidence)
    word, named, doubtful = grade.word, grade.named, grade.word == "partial" and evidence.at_noise
    empty = search.empty(chosen.under.base)
    ordered = answer.in_order(chosen.kept, path := answer.steps(search, empty, chosen.kept))
    kept, held = (ordered, evidence.corrected) if named else (chosen.full.empty(base), old)
    short = nearest(chosen, ordered, evidence) if word == "unexplained" else None
    tested = word in ("partial", "unexplained") and short is None and not watch.stopped
    left = answer.second_look(search, chosen.found if named else empty, confirm, held, horizon) if tested else None
    fitted = answer.predictions(known, names, (base, base.x0), (kept.fit, kept.fit.x0), False)
    confirming = answer.predictions(confirm, names, (base, old.states), (kept.fit, held.states), True)
    every, seen, negligible = _findings(chosen, kept, grade.others)
    listed = answer.alternatives(chosen.found, grade.others)
    effects, listed = answer.with_restatements(every, listed, chosen.full.problem.model, kept)
    pushed = push_faults((*parts.left_out, *parts.disturbed), parts.every, names)
    floor = noise_floor(confirm, held, horizon)
    return Diagnosis(
        verdict=word,
        effects=effects,
        alternatives=listed,
        before=_before(known, base, old, horizon),
        after=judged(known, kept.fit, held, horizon),
        floor=floor,
        excess_share=evidence.share if named else 1.0,
        explained_error=evidence.gain.share if named and not chosen.at_floor else None,
        sigma=floor.fit_rmse,
        candidates=answer.candidate_scores(search, empty, chosen.under.not_tried),
        collinear=answer.collinear_table(search, empty),
        folds={f: stretches(getattr(parts, f).windows, confirm.t, names) for f in ("fit", "choose", "confirm")},
        warnings=(*said, *negligible, *_warnings(held, kept, horizon), *(() if doubtful else grade.unsure)),
        doubts=(grade.unsure or evidence.short_of(chosen.kept)) if doubtful else (),
        stopped=f"{watch.stopped}: the answer is the best of {watch.sets} sets of effects." if watch.stopped else "",
        unconfirmed=grade.further,
        faint_memory=grade.faint,
        at_most=_limit_reached(settings, chosen),
        applied=answer.applied(kept),
        windows=(*fitted, *confirming),
        nearest=short,
        left_over=left,
        concentrated=concentrated(confirm, names, old, evidence.corrected),
        recording=(*faults, *pushed, *seen, *noise_faults(known)),
        steps=path,
    )


def _before(known: Problem, base: Fit, old: HeldOut, horizon_s: float) -> Judged:
    """The figures of the model as declared, every error of the same weight."""
    plain = replace(known, usual=None)
    return judged(plain, fit(plain, base.theta, base.x0, [], {}), old, horizon_s)


def _limit_reached(settings: DiagnosisSettings, chosen: Chosen) -> int | None:
    """The limit on the number of effects, where a person set one and that many were chosen."""
    limits, usual = ((s.max_effects, s.most_off_floor) for s in (settings, DiagnosisSettings()))
    most = settings.max_effects if chosen.at_floor else min(limits)
    return most if limits != usual and len(chosen.kept.members) >= most else None


def _findings(
    chosen: Chosen, kept: Explanation, others: Sequence[Rival]
) -> tuple[list[FoundEffect], tuple[RecordingFault, ...], tuple[str, ...]]:
    """Effects of the plant, faults of the recording, and warnings of those of no practical size.

    The last are allowed for and are no findings.
    """
    every = answer.found_effects(chosen.full, kept, others, chosen.at_floor)
    small = slight(chosen.full, kept, chosen.base)
    faults = (*fitted_faults(e for e in every if (e.name, e.on) not in small), *gain_faults(every))
    beside = fitted_faults(e for e in every if (e.name, e.on) in small)
    said = tuple(f"{f.sentence} It is negligible in practice and allowed for." for f in beside)
    return [e for e in every if not is_fault(e.name)], faults, said


@dataclass(frozen=True, eq=False)
class _Grade:
    """The verdict, and what keeps it from `attributed`.

    Attributes:
        word: the verdict; named: whether effects are; others: what explains the data as well.
        further, faint: as `unconfirmed` and `faint_memory` of the answer; unsure: what speaks against it, in sentences.
    """

    word: Verdict
    named: bool
    others: list[Rival]
    further: tuple[str, ...]
    faint: tuple[str, ...]
    unsure: tuple[str, ...]


def _graded(record: Record, parts: Parts, chosen: Chosen, evidence: Evidence) -> _Grade:
    """The verdict by the evidence, held back where something else may have acted or fits better."""
    word = verdict(chosen.kept, evidence)
    asked = (parts.left_out or parts.disturbed) and word in ("attributed", "none")
    further = extrapolated(record, parts, chosen.kept.fit, evidence.corrected.states) if asked else ()
    if further:
        word = "partial" if chosen.kept.members else "unexplained"
    named = word in ("attributed", "partial") or (word == "none" and evidence.needed)
    others = _rivals(chosen) if named else []
    pushed = (_PUSHED,) if parts.disturbed and word in ("attributed", "none") else ()
    unsure = (*pushed, *answer.contested(others, chosen.found), *doubted(chosen.full.problem, chosen.kept))
    faint = faint_memory(parts.known, chosen.kept.fit) if word == "attributed" else ()
    word = "partial" if (unsure or faint) and word == "attributed" else word
    return _Grade(word, named, others, further, faint, unsure)


_PUSHED = "Something seems to have pushed the plant in the data that confirm; those times were left out."


def _rivals(chosen: Chosen) -> list[Rival]:
    """What explains the data as well, each set once."""
    search, found = chosen.search, chosen.found
    others = rivals(search, found)
    if chosen.carried is not None:  # what fits as well need not carry over as well
        others = [r for r in others if r.exact] + [Rival(e, False) for e in chosen.carried.rivals]
    return [r for r in once([*others, *as_good(search, found)]) if r.explanation.keys != found.keys]


def _warnings(held: HeldOut, kept: Explanation, horizon_s: float) -> Iterator[str]:
    if not kept.fit.converged:
        yield "The last fit had not converged: treat its numbers with care."
    by_chance = 2.0 * held.free * norm.cdf(-LIMIT)  # Gaussian noise has so many on average; limits by Garwood (1936)
    if held.stray and held.at_noise and chi2.ppf(SELDOM, 2 * held.stray) > 2.0 * by_chance:
        yield (
            f"Readings of the confirming data ({held.stray}) are gross errors, {LIMIT:.2g} times the noise or more: "
            "noise with heavy tails, or bad readings."
        )
    if horizon_s > 0 and held.horizon is None:
        yield (
            "No stretch of the confirming data is as long as the horizon and the time from which its start is "
            "estimated: the errors are within windows."
        )


def nearest(chosen: Chosen, found: Explanation, evidence: Evidence) -> Nearest | None:
    """What was put to *confirm* and is not named, with the reasons; None if it explains next to nothing."""
    share = 1.0 - evidence.share if chosen.at_floor else evidence.gain.share[0]
    if not found.members or share < MATTERS:
        return None
    effects = answer.found_effects(chosen.full, found, (), chosen.at_floor)
    return Nearest(effects, share, tuple(_short_of_named(found, evidence, chosen.at_floor)))


def _short_of_named(found: Explanation, evidence: Evidence, at_floor: bool) -> Iterator[str]:
    """Why a set that explains a part is not named."""
    low, high = map(percent, evidence.gain.share[1:])
    if not evidence.gain.sure:
        yield f"that share is not sure, its 95 % interval is {low} to {high} % (longer data narrow it)"
    if not evidence.borne_out:
        yield "the confirming data do not bear it out: a channel is predicted worse there, or none better"
    if not evidence.agree:
        yield "halves of the data give different numbers"
    if not found.physical:
        yield "the numbers are not physical"
    if not (at_floor or plausible(found)):
        yield (
            f"a ratio that is not between 1/{PLAUSIBLE_RATIO:g} and {PLAUSIBLE_RATIO:g} is rather a wrong unit: "
            "compare the units of the columns and of the case"
        )
    if not found.fit.converged:
        yield "the fit had not converged"
    if all(c.of_recording for c in found.members):
        yield "it is a fault of the recording, and more than noise is left"


def confirmed(parts: Parts, chosen: Chosen, horizon_s: float) -> tuple[Parts, Chosen, Evidence]:
    """The set and what *confirm* says of it; where that leaves doubt and halves disagree on a part, a smaller one.

    If no smaller one at the noise is steady, nothing is surely at it: sets compete by what they predict, as above it.
    What confirms goes without a push, where a set that fits the other data down to their noise misses by that.
    """
    evidence = _evidence(parts, chosen, horizon_s)
    spans = pushes(parts.confirm, chosen.kept.fit.theta) if chosen.at_floor and not evidence.corrected.at_noise else ()
    if spans:
        parts = parts.confirmed_without(spans)
        evidence = _evidence(parts, chosen, horizon_s)
    if chosen.at_floor and not evidence.agree:
        less = _steadier(chosen.full, chosen.kept)
        if less is not None or not chosen.search.watch.stopped:
            chosen = chosen.competing() if less is None else chosen.less(less)
        evidence = _evidence(parts, chosen, horizon_s)
    return parts, chosen, evidence


def _evidence(parts: Parts, chosen: Chosen, horizon_s: float) -> Evidence:
    known, confirm = parts.known, parts.confirm
    old = judge(confirm, chosen.base.theta, horizon_s)
    found, full, agree = chosen.kept, chosen.full, chosen.agree
    new = judge(confirm, found.fit.theta, horizon_s)
    share = excess_share(old, new, known.sigma)
    wanted = bool(found.members) and needed(full, found, confirm, new)
    sure = wanted and new.at_noise
    if found.members and chosen.search.watch.stopped:  # nothing compared the halves yet
        agree = folds_agree(known, found, full.steps, independent_share(known, found.fit))
    elif chosen.at_floor and (len(found.members) > LEAPS_ANYHOW or (found.members and not sure)):
        agree = folds_agree(known, found, full.steps, 1.0)
    before, after = map(full.at_noise, (chosen.base, found.fit))
    here, carried = (old.errors.density(), new.errors.density()), chosen.carried
    chose = (np.zeros(0), np.zeros(0)) if carried is None else (carried.declared, carried.predicted)
    whole = gained(*(np.concatenate(each) for each in zip(chose, here, strict=True)))
    return Evidence(before, after, old, new, share, whole, is_borne_out(old.errors, new.errors), agree, wanted)


def is_borne_out(declared: Errors, corrected: Errors) -> bool:
    """Whether errors on *confirm* by itself get smaller by a size that matters, and in no channel larger by as much."""
    gains = (corrected.by_channel() - declared.by_channel()).mean(axis=0)
    whole, *losses = (Gain(float(nats), 0.0) for nats in (gains.mean(), *-gains))
    return whole.matters and not any(loss.matters for loss in losses)


def _steadier(search: Search, found: Explanation) -> Explanation | None:
    """The best smaller set that still reaches the noise and on which halves agree; None if there is none.

    An effect that BIC adds for a small misfit (a drift of a position, where dry friction creeps before it slides) must
    not take a right and steady one with it. One effect goes at a time, the one that BIC misses least.
    """
    while len(found.members) > 1:
        smaller = [search.without(found, c) for c in found.members]
        near = sorted((e for e in smaller if e.physical and search.reached(e)), key=lambda e: e.bic)
        for e in near:
            if folds_agree(search.problem, e, search.steps, 1.0):
                return e
        if not near:
            return None
        found = near[0]
    return None


def needed(full: Search, found: Explanation, confirm: Problem, with_all: HeldOut) -> bool:
    """Whether leaving out any of the effects, the others fitted again to the known data, is worse on *confirm*."""
    lone = len(found.members) == 1
    kept = [full.problem.model.null if lone else full.without(found, c).fit.theta for c in found.members]
    return all(judge(confirm, theta, 0.0).chi2 > with_all.chi2 for theta in kept)


@dataclass(frozen=True)
class Evidence:
    """What a verdict is made of.

    Attributes:
        before, after: whether the fitted windows are down to their noise, by the declared and by the corrected model.
        declared, corrected: error on *confirm*; share: excess of the one over the other there.
        gain: what the corrected model predicts better, there and where sets competed.
        borne_out: whether that is of a size that matters there by itself, and no channel is predicted worse by as much.
        agree: whether the coefficients agree between halves of the fitted data.
        needed: whether *confirm* asks for each effect.
    """

    before: bool
    after: bool
    declared: HeldOut
    corrected: HeldOut
    share: float
    gain: Gain
    borne_out: bool
    agree: bool
    needed: bool

    @property
    def at_noise(self) -> bool:
        """Whether the fitted data and those that confirm are down to their noise."""
        return self.after and self.corrected.at_noise

    def short_of(self, found: Explanation) -> tuple[str, ...]:
        """Why what is down to the noise is not surely it."""
        reasons = (
            (found.fit.converged, "The last fit had not converged."),
            (self.needed, "The data that confirm do not ask for each of these effects."),
            (self.agree, "Halves of the data give different numbers."),
        )
        return tuple(reason for holds, reason in reasons if not holds)


def verdict(found: Explanation, evidence: Evidence) -> Verdict:
    """The table of verdicts; a fit that has not settled is never more than `partial`.

    More than `LEAPS_ANYHOW` effects bend to much: halves of the data must agree on them. Where faults of the recording
    alone explain the data down to their noise, the model lacks nothing; nor where it is at the noise as declared, and
    *confirm* does not ask for what was found.
    """
    at_noise = evidence.before and evidence.declared.at_noise
    if not found.members or (at_noise and not evidence.needed):
        return "none" if at_noise else "unexplained"
    plant = any(not c.of_recording for c in found.members)
    sure = evidence.agree or len(found.members) <= LEAPS_ANYHOW
    if evidence.at_noise and found.fit.converged and evidence.needed and sure:
        return "attributed" if plant else "none"
    if not plant:
        return "unexplained"
    carries = evidence.gain.sure and evidence.borne_out and found.physical and evidence.agree
    fits = evidence.after or plausible(found)
    return "partial" if carries and fits else "unexplained"
