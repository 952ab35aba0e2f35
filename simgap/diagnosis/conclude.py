"""From what was chosen to the answer; here alone the fold *confirm* is looked at."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from simgap.diagnosis.choosing import Chosen
from simgap.diagnosis.confirming import confirmed
from simgap.diagnosis.record.faults.measurement import is_fault
from simgap.diagnosis.record.faults.registry import fitted_faults, gain_faults
from simgap.diagnosis.record.folds import Span, stretches
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import (
    Alternative,
    Diagnosis,
    DiagnosisSettings,
    FoldStretches,
    FoundEffect,
    Judged,
    Key,
    LeftOver,
    Nearest,
    Option,
    RecordingFault,
    Step,
    Verdict,
)
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.equivalence import EXACTLY_COLLINEAR, Rival, as_good, collinear_pairs, once, rivals
from simgap.diagnosis.search.explanations import Explanation, Search, doubted
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.noise_law import LIMIT
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN, FIT_QUALITY, MATTERS, NARROW
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.extrapolation import extrapolated
from simgap.diagnosis.verdict.faults import faint_memory, noise_faults, push_faults
from simgap.diagnosis.verdict.judge import (
    Evidence,
    HeldOut,
    ahead_alone,
    excess_share,
    judged,
    slight,
    verdict,
)
from simgap.effects import EFFECTS, AppliedEffect
from simgap.effects.sensors import LINEAR, is_linear
from simgap.model.symbolic import SymbolicModel
from simgap.notation import joined


def conclude(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, parts: Parts, choice: Chosen,
    said: tuple[str, ...], faults: tuple[RecordingFault, ...],
) -> Diagnosis:  # fmt: skip
    """From what was chosen to the answer; here alone *confirm* is looked at."""
    known, confirm, horizon = parts.known, parts.confirm, settings.horizon_s
    names = [trace.name for trace in record.traces]
    judgement = confirmed(parts, choice, names, horizon)
    chosen, old = judgement.chosen, judgement.old
    search, full, base = chosen.search, chosen.full, chosen.base
    grade = _graded(record, parts.left_out, known, confirm, chosen, judgement.evidence)
    word, named = grade.word, grade.named
    empty = search.empty(chosen.sparse)
    path = steps(search, empty, chosen.kept)
    ordered = in_order(chosen.kept, path)
    kept, held = (ordered, judgement.new) if named else (full.empty(base), old)
    short = nearest(full, ordered, judgement.evidence, chosen.at_floor, model) if word == "unexplained" else None
    watch = search.watch
    tested = word in ("partial", "unexplained") and short is None and not watch.stopped
    left = second_look(search, chosen.found if named else empty, confirm, held, horizon, model) if tested else None
    plain = replace(known, usual=None)
    declared = fit(plain, base.theta, base.x0, [], {})
    findings = _findings(model, record, known, chosen, kept, grade.others)
    windows = answer.predictions(known, names, (base, base.x0), (kept.fit, kept.fit.x0), False)
    windows += answer.predictions(confirm, names, (base, old.states), (kept.fit, held.states), True)
    return Diagnosis(
        verdict=word,
        effects=findings.effects,
        alternatives=findings.listed,
        before=judged(plain, declared, old, horizon),
        after=judged(known, kept.fit, held, horizon),
        floor=_floor(confirm, held, horizon),
        excess_share=judgement.evidence.share if named else 1.0,
        explained_error=judgement.evidence.gain.share if named and not chosen.at_floor else None,
        sigma=dict(zip(record.measured, map(float, confirm.sigma), strict=True)),
        candidates=answer.candidate_scores(search, empty, chosen.barred),
        collinear=answer.collinear_table(collinear_pairs(search, empty), EXACTLY_COLLINEAR),
        folds=FoldStretches(*(stretches(p.windows, confirm.t, names) for p in (parts.fit, parts.choose, confirm))),
        warnings=(*said, *findings.slight, *_warnings(held, kept, horizon), *grade.beside),
        doubts=grade.doubts,
        stopped=f"{watch.stopped}: the answer is the best of {watch.sets} sets of effects." if watch.stopped else "",
        unconfirmed=grade.further,
        faint_memory=grade.faint,
        at_most=_limit_reached(settings, chosen),
        applied=answer.applied(kept),
        windows=tuple(windows),
        nearest=short,
        left_over=left,
        concentrated=judgement.where,
        recording=(*faults, *push_faults(parts.left_out, known, names), *findings.faults, *noise_faults(known)),
        steps=path,
    )


def _limit_reached(settings: DiagnosisSettings, chosen: Chosen) -> int | None:
    """The limit on the number of effects, where a person set one and that many were chosen."""
    limits, usual = ((s.max_effects, s.most_off_floor) for s in (settings, DiagnosisSettings()))
    most = settings.max_effects if chosen.at_floor else min(limits)
    return most if limits != usual and len(chosen.kept.members) >= most else None


@dataclass(frozen=True, eq=False)
class _Findings:
    """Effects, sets that do as well, faults of the recording, and those of no practical size, as they are reported."""

    effects: tuple[FoundEffect, ...]
    listed: tuple[Alternative, ...]
    faults: tuple[RecordingFault, ...]
    slight: tuple[str, ...]


def _findings(
    model: SymbolicModel, record: Record, known: Problem, chosen: Chosen, kept: Explanation, others: Sequence[Rival]
) -> _Findings:
    every = answer.found_effects(chosen.full, kept, others, chi2_dof(known, kept.fit), chosen.at_floor, model)
    small = slight(chosen.full, kept, chosen.base)
    faults = (*fitted_faults([e for e in every if (e.name, e.on) not in small]), *gain_faults(every))
    plant = [e for e in every if not is_fault(e.name)]
    listed = answer.alternatives(chosen.found, others)
    effects, listed = with_restatements(plant, listed, model, answer.applied(kept), record.measured)
    return _Findings(effects, listed, faults, _of_no_size(every, small))


@dataclass(frozen=True, eq=False)
class _Grade:
    """The verdict, and what keeps it from `attributed`.

    Attributes:
        word: the verdict; named: whether effects are; others: what explains the data as well.
        further, faint, doubts: as `unconfirmed`, `faint_memory` and `doubts` of the answer; beside: doubts of one that
            leaves more than noise.
    """

    word: Verdict
    named: bool
    others: list[Rival]
    further: tuple[str, ...]
    faint: tuple[str, ...]
    doubts: tuple[str, ...]
    beside: tuple[str, ...]


def _graded(
    record: Record, left_out: tuple[Span, ...], known: Problem, confirm: Problem, chosen: Chosen, evidence: Evidence
) -> _Grade:
    """The verdict by the evidence, held back where something else may have acted or fits better."""
    word, members = verdict(chosen.kept, evidence), chosen.kept.members
    asked = left_out and word in ("attributed", "none")
    further = extrapolated(record, left_out, known, chosen.kept.fit, confirm) if asked else ()
    word = "partial" if further and members else word
    named = word in ("attributed", "partial") or (word == "none" and evidence.needed)
    others = _rivals(chosen) if named else []
    unsure = doubts(others, chosen.found, chosen.full.problem, chosen.kept)
    faint = faint_memory(known) if word == "attributed" and members else ()
    word = "partial" if (unsure or faint) and word == "attributed" else word
    if word != "partial" or not evidence.at_noise:
        return _Grade(word, named, others, further, faint, (), unsure)
    return _Grade(word, named, others, further, faint, unsure or evidence.short_of(chosen.kept), ())


def _rivals(chosen: Chosen) -> list[Rival]:
    """What explains the data as well, each set once."""
    search, found = chosen.search, chosen.found
    others = rivals(search, found)
    if chosen.carried is not None:  # what fits as well need not carry over as well
        others = [r for r in others if r.exact] + [Rival(e, False) for e in chosen.carried.rivals]
    return [r for r in once([*others, *as_good(search, found)]) if r.explanation.keys != found.keys]


def _floor(problem: Problem, held: HeldOut, horizon_s: float) -> Judged:
    names = problem.model.measured
    sigma = dict(zip(names, map(float, problem.sigma), strict=True))
    ahead = {} if held.horizon is None else dict(zip(names, map(float, held.horizon.floor), strict=True))
    return Judged(sigma, horizon_s, ahead, 1.0, 1.0)


def _of_no_size(every: Sequence[FoundEffect], small: Collection[Key]) -> tuple[str, ...]:
    """Faults of the recording that are told of and allowed for, and are no findings."""
    found = fitted_faults(e for e in every if (e.name, e.on) in small)
    return tuple(f"{f.sentence} It is negligible in practice and allowed for." for f in found)


def _warnings(held: HeldOut, kept: Explanation, horizon_s: float) -> tuple[str, ...]:
    said = []
    if not kept.fit.converged:
        said.append("The last fit had not converged: treat its numbers with care.")
    if held.stray and held.at_noise:
        said.append(
            f"Readings of the confirming data ({held.stray}) are gross errors, {LIMIT:.2g} times the noise or more: "
            "noise with heavy tails, or bad readings."
        )
    if horizon_s > 0 and held.horizon is None:
        said.append("No stretch of the confirming data is as long as the horizon: the errors are within windows.")
    return tuple(said)


def steps(search: Search, empty: Explanation, answer: Explanation) -> tuple[Step, ...]:
    """The effects of the answer in the order in which each takes away most, and a last step that takes none.

    The search itself adds, drops and swaps, so its own order need not lead to its answer; the sets in between that it
    never fitted are fitted here, unless it was stopped. The other options of a step are those that it fitted there.
    """
    here, left, out = empty, list(answer.members), []
    while True:
        own = {c.key: e for c in left if (e := _with(search, here, c, answer)) is not None}
        best = min(own, key=lambda key: own[key].fit.chi2, default=None)
        tried = _tried(search, here) | own
        if tried and (best is not None or not left):
            out.append(Step(chi2_dof(search.problem, here.fit), _options(search, here, tried, best)))
        if best is None:
            return tuple(out)
        here, left = own[best], [c for c in left if c.key != best]


def in_order(found: Explanation, path: Sequence[Step]) -> Explanation:
    """The same with its effects in the order of the steps, by whatever way the search came to them."""
    taken = [(o.name, o.on) for step in path for o in step.options if o.taken]
    place = {key: k for k, key in enumerate(taken)}
    return replace(found, members=tuple(sorted(found.members, key=lambda c: place.get(c.key, len(taken)))))


def _with(search: Search, here: Explanation, member: Candidate, answer: Explanation) -> Explanation | None:
    """A step with this member of the answer, from the answer's numbers; None if the search was stopped before it."""
    members = (*here.members, member)
    keys = here.keys | {member.key}
    fitted = [e for e in search.tried.values() if e.keys == keys]
    if fitted:
        return min(fitted, key=lambda e: e.fit.chi2)
    if search.watch.stopped:
        return None
    outside = [k for c in answer.members if c.key not in keys for k in c.slots]
    theta = with_values(answer.fit.theta, {k: float(search.problem.model.null[k]) for k in outside})
    return search.explain(members, theta, answer.fit)


def _tried(search: Search, here: Explanation) -> dict[Key, Explanation]:
    """What was fitted with one effect more, physical fits alone, the best fit of each."""
    more = sorted(search.sound(len(here.members) + 1), key=lambda e: -e.fit.chi2)
    return {next(iter(e.keys - here.keys)): e for e in more if here.keys < e.keys}


def _options(
    search: Search, here: Explanation, tried: dict[Key, Explanation], best: Key | None
) -> tuple[Option, ...]:  # fmt: skip
    ordered: Sequence[Key] = sorted(tried, key=lambda key: (key != best, tried[key].fit.chi2))
    return tuple(
        Option(*key, chi2_dof(search.problem, tried[key].fit), here.bic - tried[key].bic, key == best)
        for key in ordered
    )


def second_look(
    search: Search, found: Explanation, confirm: Problem, left: HeldOut, horizon_s: float, model: SymbolicModel
) -> tuple[LeftOver, ...] | None:
    """Effects beside the chosen ones that lower what is left by `MATTERS` at least, the largest share first.

    They are fitted to what the search knows; what they would take away is judged on *confirm*, which chooses none of
    them: they are told of and not named, as the limit on the number of effects or the data spoke against them. None if
    the fitted data are down to their noise.
    """
    if chi2_dof(search.problem, found.fit) <= FIT_QUALITY:
        return None
    said = []
    for e in search.joined(found, most=NARROW):
        (added,) = (c.key for c in e.members if c.key not in found.keys)
        if is_fault(added[0]):
            continue
        share = 1.0 - excess_share(left, ahead_alone(confirm, e.fit.theta, horizon_s, left), confirm.sigma)
        if share >= MATTERS:
            told = answer.found_effects(search, e, (), chi2_dof(search.problem, e.fit), False, model)
            said += [LeftOver(f, share) for f in told if (f.name, f.on) == added]
    return tuple(sorted(said, key=lambda s: -s.share))


def nearest(
    full: Search, found: Explanation, evidence: Evidence, at_floor: bool, model: SymbolicModel
) -> Nearest | None:
    """What was put to *confirm* and is not named, with the reasons; None if it explains next to nothing."""
    share = 1.0 - evidence.share if at_floor else evidence.gain.share[0]
    if not found.members or share < MATTERS:
        return None
    low, high = (100.0 * min(max(end, 0.0), 1.0) for end in evidence.gain.share[1:])
    reasons = (
        (
            not evidence.gain.sure,
            f"that share is not sure, its 95 % interval is {low:.0f} to {high:.0f} % (longer data narrow it)",
        ),
        (
            not evidence.borne_out,
            "the confirming data do not bear it out: a channel is predicted worse there, or none better",
        ),
        (not evidence.agree, "halves of the data give different numbers"),
        (not found.physical, "the numbers are not physical"),
        (not found.fit.converged, "the fit had not converged"),
        (all(c.of_recording for c in found.members), "it is a fault of the recording, and more than noise is left"),
    )
    effects = answer.found_effects(full, found, (), evidence.after, at_floor, model)
    return Nearest(effects, share, tuple(reason for holds, reason in reasons if holds))


def restatements(model: SymbolicModel, found: Sequence[AppliedEffect], measured: Sequence[str]) -> list[Alternative]:
    """Sets in which one effect of the library stands for some of those found, exactly."""
    out = []
    for e in EFFECTS.values():
        for on in e.targets(model):
            same = e.restates(model, on, found, measured)
            if same is not None:
                kept = tuple(a for k, a in enumerate(found) if k not in same[0])
                whole = (*kept, AppliedEffect(e.name, on, same[1]))
                out.append(Alternative(whole, 0.0, True))
    return out + _by_the_sensors(model, found, measured)


def _by_the_sensors(model: SymbolicModel, found: Sequence[AppliedEffect], measured: Sequence[str]) -> list[Alternative]:
    """Readings that are all as late as the only input was found to act; or a sensor that is as slow, of a linear plant.

    Whether a command or a reading is under way for so long, no record of these channels tells; in a closed loop both
    act alike.
    """
    if len(model.inputs) != 1:
        return []
    out = []
    for a in found:
        kept = tuple(b for b in found if b is not a)
        late: tuple[AppliedEffect, ...] = ()
        if a.name == "input_delay" and not any(b.name == "late_reading" for b in kept):
            late = tuple(AppliedEffect("late_reading", on, {"late": a.values["delay"]}) for on in measured)
        elif a.name == "input_lag" and len(measured) == 1 and {b.name for b in kept} <= LINEAR and is_linear(model):
            late = (AppliedEffect("filtered_reading", measured[0], {"lag": a.values["T"]}),)
        if late:
            out.append(Alternative((*kept, *late), 0.0, True))
    return out


def with_restatements(
    effects: Sequence[FoundEffect], alternatives: Sequence[Alternative], model: SymbolicModel,
    found: Sequence[AppliedEffect], measured: Sequence[str],
) -> tuple[tuple[FoundEffect, ...], tuple[Alternative, ...]]:  # fmt: skip
    """The effects and the alternatives with what restates them or an equal of theirs, the smallest of nested ones."""

    def keys(whole: Sequence[AppliedEffect]) -> frozenset[Key]:
        return frozenset((a.name, a.on) for a in whole)

    listed, changed = list(alternatives), list(effects)
    known = {keys(found), *(keys(other.effects) for other in alternatives)}
    exact = [other.effects for other in alternatives if other.exact]
    equals = (found, *(own for own in exact if not any(is_fault(a.name) for a in own)))
    for other in sorted((o for e in equals for o in restatements(model, e, measured)), key=lambda o: len(o.effects)):
        mine = keys(other.effects)
        if not any(whole <= mine for whole in known):
            known.add(mine)
            listed.append(other)
            new = tuple((a.name, a.on) for a in other.effects if (a.name, a.on) not in keys(found))
            changed = [
                e if (e.name, e.on) in mine else replace(e, alternatives=(*e.alternatives, new)) for e in changed
            ]
    return tuple(changed), tuple(listed)


def doubts(others: Sequence[Rival], found: Explanation, problem: Problem, kept: Explanation) -> tuple[str, ...]:
    """What is to be said, the strongest reason alone; empty if there is none.

    Args:
        others, found: what explains the data as well, and the answer, as the search compared them.
        problem, kept: everything that was fitted in the end, and the answer fitted to it.
    """
    return better(others, found) or contested(others, found) or doubted(problem, kept)


def better(others: Sequence[Rival], found: Explanation) -> tuple[str, ...]:
    """What is to be said of a listed set that fits clearly better than the answer."""
    best = min((r.explanation for r in others), key=lambda e: e.bic, default=found)
    if found.bic - best.bic < BIC_GAIN:
        return ()
    named = joined([c.effect.phrase(c.on) for c in best.members])
    return (
        f"Among the alternatives {named} fits better (BIC lower by {found.bic - best.bic:.0f}), but not on the data "
        "that choose, or it was found after the choice.",
    )


def contested(others: Sequence[Rival], found: Explanation) -> tuple[str, ...]:
    """What is to be said of a listed set that fits as well and is not the same thing: neither is sure.

    A fault of the readings in the place of an effect is told beside it and does not contest it.
    """
    close = [
        r.explanation for r in others
        if not r.exact and r.explanation.bic <= found.bic + AS_GOOD
        and not any(c.of_recording for c in r.explanation.members if c.key not in found.keys)
    ]  # fmt: skip
    if not close:
        return ()
    best = min(close, key=lambda e: e.bic)
    named = joined([c.effect.phrase(c.on) for c in best.members])
    return (
        f"Among the alternatives {named} fits as well (BIC {best.bic - found.bic:+.1f}): these data do not decide.",
    )
