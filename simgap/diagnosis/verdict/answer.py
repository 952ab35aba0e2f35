"""From a search to the parts of a diagnosis that people read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.measurement import effect_or_fault, is_fault
from simgap.diagnosis.result import (
    Alternative,
    CandidateScore,
    Collinear,
    Estimate,
    FoundEffect,
    Key,
    LeftOver,
    Option,
    Step,
    WindowPrediction,
)
from simgap.diagnosis.search.confidence import chi2_dof, interval
from simgap.diagnosis.search.equivalence import EXACTLY_COLLINEAR, Rival, collinear_pairs
from simgap.diagnosis.search.explanations import Explanation, Search, sound
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.simulation.supermodel import Candidate, SuperModel
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN, MATTERS, NARROW
from simgap.diagnosis.verdict.held_out import HeldOut, excess_share, judge
from simgap.diagnosis.verdict.sets import errors_of
from simgap.effects import EFFECTS, AppliedEffect
from simgap.effects.sensors import LINEAR, is_linear
from simgap.notation import joined

_ANY_EXCITATION = "a different excitation: other frequencies, amplitudes and positions"
_MOST_WINDOWS, _MOST_SAMPLES = 100, 20_000
"""Of each kind, for plots and for the bound of what is left: whichever allows more windows."""


def parameter_values(c: Candidate, at: Fit) -> dict[str, float]:
    """Fitted values of an effect, as they are reported."""
    return c.effect.canonical(c.values(at.theta.tolist()))


def applied(found: Explanation) -> tuple[AppliedEffect, ...]:
    """The effects with their numbers, faults of the recording apart."""
    return tuple(a for a in whole_set(found) if not is_fault(a.name))


def whole_set(found: Explanation) -> tuple[AppliedEffect, ...]:
    """Effects and faults of the recording with their numbers."""
    return tuple(AppliedEffect(c.effect.name, c.on, parameter_values(c, found.fit)) for c in found.members)


def found_effects(
    search: Search, found: Explanation, rivals: Sequence[Rival], at_floor: bool
) -> tuple[FoundEffect, ...]:
    """What was chosen, faults of the recording included, with intervals and what could stand in its place."""
    errors, dof = errors_of(search, found, at_floor)
    by_slot = dict(zip(found.fit.slots, errors.tolist(), strict=True))
    effects = []
    for c in found.members:
        units, values = c.effect.units(search.problem.model.model, c.on), parameter_values(c, found.fit)
        estimates = {}
        for p, k in zip(c.effect.parameters, c.slots, strict=True):
            ends = p.widened(interval(values[p.symbol], by_slot.get(k, 0.0), dof))
            estimates[p.symbol] = Estimate(values[p.symbol], ends, units[p.symbol])
        effects.append(FoundEffect(c.effect.name, c.on, estimates, _replacements(c.key, found, rivals)))
    return tuple(effects)


def _replacements(key: Key, found: Explanation, rivals: Sequence[Rival]) -> tuple[tuple[Key, ...], ...]:
    others = (r.explanation.keys for r in rivals if key not in r.explanation.keys)
    return tuple(dict.fromkeys(tuple(sorted(keys - found.keys)) for keys in others if keys - found.keys))


def alternatives(found: Explanation, rivals: Sequence[Rival]) -> tuple[Alternative, ...]:
    """Whole sets that fit as well."""
    return tuple(Alternative(whole_set(r.explanation), r.explanation.bic - found.bic, r.exact) for r in rivals)


def candidate_scores(search: Search, empty: Explanation, barred: Mapping[Key, str]) -> tuple[CandidateScore, ...]:
    """Every candidate beside the model as declared, the most promising first; `barred`: why some were not tried."""
    promised, unseen = {s.candidate.key: s.drop for s in search.ranked(empty)}, search.screen(empty).unseen
    singles = sorted((e for e in search.tried.values() if len(e.members) == 1), key=lambda e: -e.bic)
    alone = {e.members[0].key: e for e in singles}
    rows = []
    for c in search.problem.model.candidates:
        reason = "" if c.key in promised else "the data imply the opposite sign or no effect"
        if c.key in unseen:
            reason = "these data do not show it"
        reason = barred.get(c.key, reason)
        e: Explanation | None = alone.get(c.key)
        if e is None:
            rows.append(CandidateScore(*c.key, promised.get(c.key, 0.0), None, {}, reason))
            continue
        if not e.physical:
            reason = "its best fit is unphysical or zero"
            if c.effect.one_curve and sound(c, e.fit):
                reason = "it fits almost anything, and still leaves more than noise"
        gain, left = empty.bic - e.bic, chi2_dof(search.problem, e.fit)
        rows.append(CandidateScore(*c.key, promised.get(c.key, 0.0), gain, parameter_values(c, e.fit), reason, left))
    return tuple(sorted(rows, key=lambda r: -max(r.bic_gain or -math.inf, 0.0) - 1e-3 * r.chi2_drop))


def collinear_table(search: Search, empty: Explanation) -> tuple[Collinear, ...]:
    """Pairs that the declared model can hardly tell apart, with what would separate them."""
    rows = []
    for a, b, correlation in collinear_pairs(search, empty):
        known, other = effect_or_fault(a[0]).excitation, effect_or_fault(b[0]).excitation
        advice = known if known and known == other else _ANY_EXCITATION
        if correlation > EXACTLY_COLLINEAR:
            advice = "to first order no motion separates them: measure one directly"
        rows.append(Collinear(a, b, correlation, advice))
    return tuple(rows)


def predictions(
    problem: Problem, names: Sequence[str], before: tuple[Fit, Floats], after: tuple[Fit, Floats], held_out: bool
) -> Iterator[WindowPrediction]:
    """Measured, before and after on evenly picked windows; each model comes with its initial states (w, nx)."""
    most = max(_MOST_WINDOWS, _MOST_SAMPLES * len(problem.windows) // max(problem.windows.samples, 1))
    part, few = problem.some(most)
    old = part.predict(before[0].theta, before[1][few])
    new, states = part.predict(after[0].theta, after[1][few]), part.states(after[0].theta, after[1][few])
    for (start, stop, trace), (a, b) in zip(part.windows, itertools.pairwise(part.rows.tolist()), strict=True):
        s = slice(start, stop)
        own = (problem.t[s], problem.y[s], old[a:b], new[a:b], states[a:b], problem.u[s])
        yield WindowPrediction(names[trace], held_out, *own, problem.used[s])


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
            at = sorted(tried.items(), key=lambda option: (option[0] != best, option[1].fit.chi2))
            options = (Option(*key, chi2_dof(search.problem, e.fit), here.bic - e.bic, key == best) for key, e in at)
            out.append(Step(chi2_dof(search.problem, here.fit), tuple(options)))
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


def second_look(
    search: Search, found: Explanation, confirm: Problem, left: HeldOut, horizon_s: float
) -> tuple[LeftOver, ...] | None:
    """Effects beside the chosen ones that lower what is left by `MATTERS` at least, the largest share first.

    They are fitted to what the search knows; what they would take away is judged on *confirm*, which chooses none of
    them: they are told of and not named, as the limit on the number of effects or the data spoke against them. None if
    the fitted data are down to their noise.
    """
    if search.reached(found):
        return None
    said = []
    for e in search.joined(found, most=NARROW):
        (added,) = (c.key for c in e.members if c.key not in found.keys)
        if is_fault(added[0]):
            continue
        share = 1.0 - excess_share(left, judge(confirm, e.fit.theta, horizon_s), confirm.sigma)
        if share >= MATTERS:
            told = found_effects(search, e, (), False)
            said += [LeftOver(f, share) for f in told if (f.name, f.on) == added]
    return tuple(sorted(said, key=lambda s: -s.share))


def restatements(model: SuperModel, found: Sequence[AppliedEffect]) -> Iterator[Alternative]:
    """Sets in which one effect of the library stands for some of those found, exactly."""
    for e in EFFECTS.values():
        for on in e.targets(model.model):
            same = e.restates(model.model, on, found, model.measured)
            if same is not None:
                kept = tuple(a for k, a in enumerate(found) if k not in same[0])
                yield Alternative((*kept, AppliedEffect(e.name, on, same[1])), 0.0, True)
    if len(model.model.inputs) == 1:
        yield from _by_the_sensors(model, found)


def _by_the_sensors(model: SuperModel, found: Sequence[AppliedEffect]) -> Iterator[Alternative]:
    """Readings that are all as late as the only input was found to act; or a sensor that is as slow, of a linear plant.

    Whether a command or a reading is under way for so long, no record of these channels tells; in a closed loop both
    act alike.
    """
    plant, measured = model.model, model.measured
    for a in found:
        kept = tuple(b for b in found if b is not a)
        names = {b.name for b in kept}
        if a.name == "input_delay" and "late_reading" not in names:
            late = [AppliedEffect("late_reading", on, {"late": a.values["delay"]}) for on in measured]
        elif a.name == "input_lag" and len(measured) == 1 and names <= LINEAR and is_linear(plant):
            late = [AppliedEffect("filtered_reading", measured[0], {"lag": a.values["T"]})]
        else:
            continue
        yield Alternative((*kept, *late), 0.0, True)


def with_restatements(
    effects: Sequence[FoundEffect], alternatives: Sequence[Alternative], model: SuperModel, kept: Explanation
) -> tuple[tuple[FoundEffect, ...], tuple[Alternative, ...]]:
    """The effects and the alternatives with what restates them or an equal of theirs, the smallest of nested ones."""

    def keys(whole: Sequence[AppliedEffect]) -> frozenset[Key]:
        return frozenset((a.name, a.on) for a in whole)

    listed, changed, found = list(alternatives), list(effects), applied(kept)
    known = {keys(found), *(keys(other.effects) for other in alternatives)}
    exact = [other.effects for other in alternatives if other.exact]
    equals = (found, *(own for own in exact if not any(is_fault(a.name) for a in own)))
    for other in sorted((o for e in equals for o in restatements(model, e)), key=lambda o: len(o.effects)):
        mine = keys(other.effects)
        if not any(whole <= mine for whole in known):
            known.add(mine)
            listed.append(other)
            new = tuple((a.name, a.on) for a in other.effects if (a.name, a.on) not in keys(found))
            changed = [
                e if (e.name, e.on) in mine else replace(e, alternatives=(*e.alternatives, new)) for e in changed
            ]
    return tuple(changed), tuple(listed)


def contested(others: Sequence[Rival], found: Explanation) -> tuple[str, ...]:
    """What is to be said of a listed set that fits clearly better, or as well without being the same thing.

    A fault of the readings in the place of an effect is told beside it and does not contest it.
    """

    def named(e: Explanation) -> str:
        return f"An alternative, {joined([c.effect.phrase(c.on) for c in e.members])},"

    best = min((r.explanation for r in others), key=lambda e: e.bic, default=found)
    if found.bic - best.bic >= BIC_GAIN:
        return (
            f"{named(best)} fits the fitted data better (BIC lower by {found.bic - best.bic:.0f}): it predicts the "
            "others no better, or was found after the choice.",
        )
    close = [
        r.explanation for r in others
        if (r.level or r.explanation.bic <= found.bic + AS_GOOD) and not r.exact
        and not any(c.of_recording for c in r.explanation.members if c.key not in found.keys)
    ]  # fmt: skip
    if not close:
        return ()
    best = min(close, key=lambda e: e.bic)
    more = best.bic - found.bic
    how = "as well, one window aside" if more > BIC_GAIN else "nearly as well" if more > AS_GOOD else "as well"
    return (f"{named(best)} fits {how} (BIC {more:+.1f}): these data do not decide.",)
