"""From what was chosen to the answer; here alone the fold *confirm* is looked at."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.windows import stretches
from simgap.diagnosis.result import (
    Concentrated,
    Diagnosis,
    DiagnosisSettings,
    FoldStretches,
    FoundEffect,
    Judged,
    Key,
    RecordingFault,
    Verdict,
)
from simgap.diagnosis.search.equivalence import Rival, as_good, collinear_pairs, once, rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.recording import is_fault
from simgap.diagnosis.thresholds import BIC_GAIN, EXACTLY_COLLINEAR, HELD_OUT_QUALITY, LEAPS_ANYHOW
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.beyond import beyond
from simgap.diagnosis.verdict.concentration import concentrated, elsewhere
from simgap.diagnosis.verdict.faults import faint_memory, fitted_faults, gain_faults, noise_faults
from simgap.diagnosis.verdict.judge import (
    Evidence,
    HeldOut,
    chi2_dof,
    excess_share,
    folds_agree,
    judge,
    judged,
    needed,
    verdict,
)
from simgap.diagnosis.verdict.restated import told
from simgap.diagnosis.verdict.second_look import nearest, second_look
from simgap.diagnosis.verdict.size import slight
from simgap.diagnosis.verdict.steadier import steadier
from simgap.diagnosis.verdict.steps import steps
from simgap.diagnosis.verdict.transfer import Carried, independent_share
from simgap.effects import apply_effects
from simgap.model.symbolic import SymbolicModel
from simgap.notation import joined


@dataclass(frozen=True, eq=False)
class Chosen:
    """What fit and choose ended with.

    Attributes:
        search, sparse: the search, on fewer samples where there are many, and the model as declared there.
        found: what it chose there; kept: the same on every sample.
        full, base: a search on every sample, and the model as declared there.
        carried: from the choice off the noise floor.
        at_floor: whether the fit reaches the noise; agree: whether halves of the data give the same coefficients.
        barred: candidates that were not tried, and why.
    """

    search: Search
    sparse: Fit
    found: Explanation
    kept: Explanation
    full: Search
    base: Fit
    carried: Carried | None
    at_floor: bool
    agree: bool
    barred: Mapping[Key, str]

    def less(self, kept: Explanation) -> Chosen:
        """The same with some effects of what was chosen alone."""
        gone = [c for c in self.found.members if c.key not in kept.keys]
        return replace(self, kept=kept, found=reduce(self.search.without, gone, self.found))


def conclude(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, parts: Parts, chosen: Chosen,
    said: tuple[str, ...], faults: tuple[RecordingFault, ...],
) -> Diagnosis:  # fmt: skip
    """From what was chosen to the answer; here alone *confirm* is looked at."""
    known, confirm, search, full, base = parts.known, parts.confirm, chosen.search, chosen.full, chosen.base
    horizon = settings.horizon_s
    old, new = (judge(confirm, theta, horizon) for theta in (base.theta, chosen.kept.fit.theta))
    names = [trace.name for trace in record.traces]
    where = concentrated(confirm, names, old, new)
    evidence = _evidence(known, confirm, chosen, old, new, where)
    less = steadier(known, full, chosen.kept) if chosen.at_floor and not evidence.agree else None
    if less is not None:
        chosen = chosen.less(less)
        new = judge(confirm, less.fit.theta, horizon)
        where = concentrated(confirm, names, old, new)
        evidence = _evidence(known, confirm, chosen, old, new, where)
    share, said_of = evidence.share, _worded(record, known, confirm, chosen, evidence)
    word, named, others = said_of.word, said_of.named, said_of.others
    short = nearest(full, chosen.kept, evidence, chosen.at_floor, model) if word == "unexplained" else None
    kept, kept_held = (chosen.kept, new) if named else (full.empty(base), old)
    windows = answer.predictions(known, names, (base, base.x0), (kept.fit, kept.fit.x0), False)
    windows += answer.predictions(confirm, names, (base, old.states), (kept.fit, kept_held.states), True)
    empty = search.empty(chosen.sparse)
    most = settings.max_effects if chosen.at_floor else min(settings.max_effects, settings.most_off_floor)
    tested = word in ("partial", "unexplained") and short is None
    every = answer.found_effects(full, kept, others, chi2_dof(known, kept.fit), chosen.at_floor, model)
    listed = answer.alternatives(chosen.found, others)
    small = slight(full, kept, base)
    fitted = [e for e in every if (e.name, e.on) not in small]
    effects, listed = told(
        [e for e in every if not is_fault(e.name)], listed, model, answer.applied(kept), record.measured
    )
    return Diagnosis(
        verdict=word,
        effects=effects,
        alternatives=listed,
        before=judged(known, base, old, horizon),
        after=judged(known, kept.fit, kept_held, horizon),
        floor=_floor(known, kept_held, horizon),
        excess_share=share if named else 1.0,
        sigma=dict(zip(record.measured, map(float, known.sigma), strict=True)),
        candidates=answer.candidate_scores(search, empty, chosen.barred),
        collinear=answer.collinear_table(collinear_pairs(search, empty), EXACTLY_COLLINEAR),
        folds=FoldStretches(*(stretches(p.windows, known.t, names) for p in (parts.fit, parts.choose, confirm))),
        warnings=(
            *said,
            *_of_no_size(every, small),
            *_warnings(search.watch, kept_held, kept, horizon),
            *said_of.fitter,
        ),
        unconfirmed=said_of.further,
        faint_memory=said_of.faint,
        at_most=most if len(chosen.kept.members) >= most else None,
        applied=answer.applied(kept),
        corrected=apply_effects(model, answer.applied(kept)),
        windows=tuple(windows),
        nearest=short,
        left_over=second_look(search, chosen.found if named else empty, confirm, kept_held, horizon, model)
        if tested
        else None,
        concentrated=where,
        recording=(
            *faults,
            *fitted_faults(fitted),
            *gain_faults(every),
            *noise_faults(known),
        ),
        steps=steps(search, empty, chosen.kept),
    )


@dataclass(frozen=True, eq=False)
class _Worded:
    """The verdict, and what keeps it from `attributed`.

    Attributes:
        word: the verdict; named: whether effects are; others: what explains the data as well.
        further, faint: as `unconfirmed` and `faint_memory` of the answer; fitter: what fits clearly better.
    """

    word: Verdict
    named: bool
    others: list[Rival]
    further: tuple[str, ...]
    faint: tuple[str, ...]
    fitter: tuple[str, ...]


def _worded(record: Record, known: Problem, confirm: Problem, chosen: Chosen, evidence: Evidence) -> _Worded:
    """The verdict by the evidence, held back where something else may have acted or fits better."""
    word, members = verdict(chosen.kept, evidence), chosen.kept.members
    further = beyond(record, confirm) if word in ("attributed", "none") and record.left_out else ()
    word = "partial" if further and members else word
    named = word in ("attributed", "partial") or (word == "none" and evidence.needed)
    others = _rivals(chosen) if named else []
    fitter = better(others, chosen.found)
    faint = faint_memory(known) if word == "attributed" and members else ()
    word = "partial" if (fitter or faint) and word == "attributed" else word
    return _Worded(word, named, others, further, faint, fitter)


def _evidence(
    known: Problem, confirm: Problem, chosen: Chosen, old: HeldOut, new: HeldOut, where: Concentrated | None
) -> Evidence:
    """What the verdict is made of."""
    found, full, agree = chosen.kept, chosen.full, chosen.agree
    share = excess_share(old, new, known.sigma)
    wanted = bool(found.members) and needed(full, found, confirm, new)
    sure = wanted and new.ratio <= HELD_OUT_QUALITY
    if found.members and chosen.search.watch.stopped:  # nothing compared the halves yet
        agree = folds_agree(known, found, full.steps, independent_share(known, found.fit))
    elif chosen.at_floor and (len(found.members) > LEAPS_ANYHOW or (found.members and not sure)):
        agree = folds_agree(known, found, full.steps, 1.0)
    before, after = (chi2_dof(known, at) for at in (chosen.base, found.fit))
    return Evidence(before, after, old, new, share, agree, wanted, elsewhere(where))


def _rivals(chosen: Chosen) -> list[Rival]:
    """What explains the data as well, each set once."""
    search, found = chosen.search, chosen.found
    if search.watch.stopped:
        return once(as_good(search, found))
    others = rivals(search, found)
    if chosen.carried is not None:  # what fits as well need not carry over as well
        others = [r for r in others if r.exact] + [Rival(e, False) for e in chosen.carried.rivals]
    return once([*others, *as_good(search, found)])


def better(others: Sequence[Rival], found: Explanation) -> tuple[str, ...]:
    """What is to be said of a listed set that fits clearly better than the answer."""
    best = min((r.explanation for r in others), key=lambda e: e.bic, default=found)
    if found.bic - best.bic < BIC_GAIN:
        return ()
    named = joined([c.effect.phrase(c.on) for c in best.members])
    return (
        f"Among the alternatives {named} fits better (BIC lower by {found.bic - best.bic:.0f}), but did not carry over "
        "to the data that choose as well, or was found after they chose.",
    )


def _floor(problem: Problem, held: HeldOut, horizon_s: float) -> Judged:
    names = problem.model.measured
    sigma = dict(zip(names, map(float, problem.sigma), strict=True))
    ahead = {} if held.horizon is None else dict(zip(names, map(float, held.horizon.floor), strict=True))
    return Judged(sigma, horizon_s, ahead, 1.0, 1.0)


def _of_no_size(every: Sequence[FoundEffect], small: Collection[Key]) -> tuple[str, ...]:
    """Faults of the recording that are told of and allowed for, and are no findings."""
    found = fitted_faults(e for e in every if (e.name, e.on) in small)
    return tuple(f"{f.sentence} It is of no practical size and allowed for." for f in found)


def _warnings(watch: Watch, held: HeldOut, kept: Explanation, horizon_s: float) -> tuple[str, ...]:
    said = []
    if watch.stopped:
        said.append(f"{watch.stopped}: the answer is the best of {watch.sets} sets of effects that were fitted.")
    if not kept.fit.converged:
        said.append("The last fit had not settled: take its numbers with care.")
    if horizon_s > 0 and held.horizon is None:
        said.append("No stretch of the fold that confirms is as long as the horizon: the errors are within windows.")
    return tuple(said)
