"""From what was chosen to the answer; here alone the fold *confirm* is looked at."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from simgap.diagnosis.choosing import Chosen
from simgap.diagnosis.confirming import confirmed
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.windows import stretches
from simgap.diagnosis.result import (
    Alternative,
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
from simgap.diagnosis.search.explanations import Explanation
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.recording import is_fault
from simgap.diagnosis.thresholds import EXACTLY_COLLINEAR, FAR
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.beyond import beyond
from simgap.diagnosis.verdict.doubts import doubts
from simgap.diagnosis.verdict.faults import faint_memory, fitted_faults, gain_faults, noise_faults
from simgap.diagnosis.verdict.judge import (
    Evidence,
    HeldOut,
    chi2_dof,
    judged,
    slight,
    verdict,
)
from simgap.diagnosis.verdict.restated import told
from simgap.diagnosis.verdict.second_look import nearest, second_look
from simgap.diagnosis.verdict.steps import steps
from simgap.effects import apply_effects
from simgap.model.symbolic import SymbolicModel


def conclude(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, parts: Parts, put: Chosen,
    said: tuple[str, ...], faults: tuple[RecordingFault, ...],
) -> Diagnosis:  # fmt: skip
    """From what was chosen to the answer; here alone *confirm* is looked at."""
    known, confirm, horizon = parts.known, parts.confirm, settings.horizon_s
    names = [trace.name for trace in record.traces]
    seen = confirmed(parts, put, names, horizon)
    chosen, old = seen.chosen, seen.old
    search, full, base = chosen.search, chosen.full, chosen.base
    verdict_is = _worded(record, known, confirm, chosen, seen.evidence)
    word, named = verdict_is.word, verdict_is.named
    kept, held = (chosen.kept, seen.new) if named else (full.empty(base), old)
    short = nearest(full, chosen.kept, seen.evidence, chosen.at_floor, model) if word == "unexplained" else None
    tested = word in ("partial", "unexplained") and short is None
    empty = search.empty(chosen.sparse)
    left = second_look(search, chosen.found if named else empty, confirm, held, horizon, model) if tested else None
    told_of = _told(model, record, known, chosen, kept, verdict_is.others)
    windows = answer.predictions(known, names, (base, base.x0), (kept.fit, kept.fit.x0), False)
    windows += answer.predictions(confirm, names, (base, old.states), (kept.fit, held.states), True)
    most = settings.max_effects if chosen.at_floor else min(settings.max_effects, settings.most_off_floor)
    return Diagnosis(
        verdict=word,
        effects=told_of.effects,
        alternatives=told_of.listed,
        before=judged(known, base, old, horizon),
        after=judged(known, kept.fit, held, horizon),
        floor=_floor(confirm, held, horizon),
        excess_share=seen.evidence.share if named else 1.0,
        explained_error=seen.evidence.gain.share if named and not chosen.at_floor else None,
        sigma=dict(zip(record.measured, map(float, confirm.sigma), strict=True)),
        candidates=answer.candidate_scores(search, empty, chosen.barred),
        collinear=answer.collinear_table(collinear_pairs(search, empty), EXACTLY_COLLINEAR),
        folds=FoldStretches(*(stretches(p.windows, confirm.t, names) for p in (parts.fit, parts.choose, confirm))),
        warnings=(*said, *told_of.slight, *_warnings(search.watch, held, kept, horizon), *verdict_is.fitter),
        unconfirmed=verdict_is.further,
        faint_memory=verdict_is.faint,
        at_most=most if len(chosen.kept.members) >= most else None,
        applied=answer.applied(kept),
        corrected=apply_effects(model, answer.applied(kept)),
        windows=tuple(windows),
        nearest=short,
        left_over=left,
        concentrated=seen.where,
        recording=(*faults, *told_of.faults, *noise_faults(known)),
        steps=steps(search, empty, chosen.kept),
    )


@dataclass(frozen=True, eq=False)
class _Told:
    """What is told of a set: effects, sets that do as well, faults of the recording, and those of no practical size."""

    effects: tuple[FoundEffect, ...]
    listed: tuple[Alternative, ...]
    faults: tuple[RecordingFault, ...]
    slight: tuple[str, ...]


def _told(
    model: SymbolicModel, record: Record, known: Problem, chosen: Chosen, kept: Explanation, others: Sequence[Rival]
) -> _Told:
    every = answer.found_effects(chosen.full, kept, others, chi2_dof(known, kept.fit), chosen.at_floor, model)
    small = slight(chosen.full, kept, chosen.base)
    faults = (*fitted_faults([e for e in every if (e.name, e.on) not in small]), *gain_faults(every))
    plant = [e for e in every if not is_fault(e.name)]
    listed = answer.alternatives(chosen.found, others)
    effects, listed = told(plant, listed, model, answer.applied(kept), record.measured)
    return _Told(effects, listed, faults, _of_no_size(every, small))


@dataclass(frozen=True, eq=False)
class _Worded:
    """The verdict, and what keeps it from `attributed`.

    Attributes:
        word: the verdict; named: whether effects are; others: what explains the data as well.
        further, faint: as `unconfirmed` and `faint_memory` of the answer; fitter: why it may be another.
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
    further = (
        beyond(record, known, chosen.kept.fit, confirm) if word in ("attributed", "none") and record.left_out else ()
    )
    word = "partial" if further and members else word
    named = word in ("attributed", "partial") or (word == "none" and evidence.needed)
    others = _rivals(chosen) if named else []
    fitter = doubts(others, chosen.found, chosen.full.problem, chosen.kept)
    faint = faint_memory(known) if word == "attributed" and members else ()
    word = "partial" if (fitter or faint) and word == "attributed" else word
    return _Worded(word, named, others, further, faint, fitter)


def _rivals(chosen: Chosen) -> list[Rival]:
    """What explains the data as well, each set once."""
    search, found = chosen.search, chosen.found
    if search.watch.stopped:
        return once(as_good(search, found))
    others = rivals(search, found)
    if chosen.carried is not None:  # what fits as well need not carry over as well
        others = [r for r in others if r.exact] + [Rival(e, False) for e in chosen.carried.rivals]
    return once([*others, *as_good(search, found)])


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
    if held.stray:
        said.append(
            f"Single readings of the fold that confirms ({held.stray}) miss by more than {FAR:g} noises between "
            "neighbours that do not: noise with heavy tails, or bad readings. They are not counted in RMSE/sigma."
        )
    if horizon_s > 0 and held.horizon is None:
        said.append("No stretch of the fold that confirms is as long as the horizon: the errors are within windows.")
    return tuple(said)
