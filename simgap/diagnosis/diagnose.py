"""Diagnosis: from a declared model and a record to the physical effect that the model lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.reading.exchanged import put_back
from simgap.diagnosis.reading.hum import without_hum
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.repair import repaired
from simgap.diagnosis.reading.windows import stretches
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, FoldStretches, Judged, Key, RecordingFault
from simgap.diagnosis.search.barred import barred
from simgap.diagnosis.search.columns import better_columns
from simgap.diagnosis.search.equivalence import Rival, as_good, collinear_pairs, once, rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.noise_colour import noise_colour
from simgap.diagnosis.search.scoring import list_starts
from simgap.diagnosis.search.selection import best_so_far, carried_over, on_all, preferred, select
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.diagnosis.simulation.coarse import JUDGED_ROWS, coarse
from simgap.diagnosis.simulation.colour import Colour
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.recording import is_fault
from simgap.diagnosis.thresholds import EXACTLY_COLLINEAR, FIT_QUALITY, HELD_OUT_QUALITY, MOST_COLOURED
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.concentration import concentrated
from simgap.diagnosis.verdict.faults import filtered_channels, fitted_faults, gain_faults, noise_faults
from simgap.diagnosis.verdict.judge import (
    Evidence,
    HeldOut,
    chi2_dof,
    excess_share,
    folds_agree,
    judge,
    judged,
    needed,
    real,
    verdict,
)
from simgap.diagnosis.verdict.restated import told
from simgap.diagnosis.verdict.second_look import nearest, second_look
from simgap.diagnosis.verdict.transfer import Carried, Trial, independent_share, transferable
from simgap.diagnosis.widen import screened, widened
from simgap.effects import apply_effects
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel

Floats = NDArray[np.float64]


def diagnose(
    model: SymbolicModel,
    record: Record,
    settings: DiagnosisSettings | None = None,
    tell: Callable[[str], None] = lambda words: None,
) -> Diagnosis:
    """Attribute what a model fails to predict to physical effects that it lacks.

    Args:
        model: continuous dynamics as declared; effects are sought on all its coordinates, inputs, sensors, parameters.
        record: measured traces in the model's units.
        settings: choices; the defaults if not given.
        tell: told in words how far the search is. An interrupt (Ctrl-C) ends the search, and the best answer so far is
            judged.

    Raises:
        UserError: no trace as long as a window, inputs that are not the model's, unknown effects.
    """
    settings = settings or DiagnosisSettings()
    if record.inputs != model.input_names:
        raise UserError(f"the record has inputs {list(record.inputs)}", remedy=f"Give {list(model.input_names)}.")
    record, parts, said, faults = _mended(model, record, settings)
    not_tried = barred(parts.known.model, record, settings.effects)
    watch = Watch(settings.budget_s, tell)
    begun = _begun(parts.known, not_tried, watch)
    wider = screened(model, record, settings, *begun, not_tried)
    if wider is None:
        search, base, found = _searched(parts.known, settings.max_effects, not_tried, watch, begun=begun)
        wider = widened(model, record, settings, search, found, not_tried)
    if wider is not None:
        parts, (search, base, found) = wider
    reach = parts.known.reach(found.fit.theta)
    if reach > parts.known.reach(search.problem.model.null):  # commands from before the record are unknown: masked
        parts = parts.past_the_unknown(reach)
        if watch.stopped:
            search, base, found = _fitted_again(parts.known, search, found, not_tried)
        else:
            reduced = chi2_dof(search.problem, found.fit)
            search, base, found = _searched(parts.known, settings.max_effects, not_tried, watch, (found, reduced))
    filtered = () if watch.stopped else filtered_channels(search, found)
    if filtered:
        parts = parts.without(np.isin(record.measured, [f.channel for f in filtered]))
        not_tried |= {(f.fault, f.channel): "the channel was left out" for f in filtered}
        search, base, found = _searched(parts.known, settings.max_effects, not_tried, watch)
    full = len(found.members) >= settings.max_effects  # all that it may take: what is left is no noise
    noise = None if watch.stopped or full else _noise(parts.known, search, found)
    if noise is not None:
        louder = parts.with_noise(*noise)
        ends = _searched(louder.known, settings.max_effects, not_tried, watch)
        if chi2_dof(ends[0].problem, ends[2].fit) <= FIT_QUALITY:  # else it was not the noise that was missing
            parts, (search, base, found) = louder, ends
    chosen = _chosen(parts, search, base, found, settings, not_tried)
    return _conclude(model, record, settings, parts, chosen, said, (*faults, *filtered))


@dataclass(frozen=True, eq=False)
class _Chosen:
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


def _mended(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings
) -> tuple[Record, Parts, tuple[str, ...], tuple[RecordingFault, ...]]:
    """The record without what a look at it shows to be no measurement, its folds, what is to be said, the faults."""
    record, seen = repaired(record)
    record, lines = without_hum(record)
    record, places = put_back(record, model.coordinates)
    seen = (*seen, *lines, *places)
    parts, said = parts_of(model, record, settings)
    columns = better_columns(coarse(parts.known))
    if columns is None:
        return record, parts, said, seen
    record = columns.of_record(record)
    return record, *parts_of(model, record, settings), (*seen, columns.finding)


def _noise(known: Problem, search: Search, found: Explanation) -> tuple[Floats, Colour] | None:
    """The law of the noise, where what was found leaves more than white noise and that is no trace of a force."""
    if not FIT_QUALITY < chi2_dof(search.problem, found.fit) <= MOST_COLOURED:
        return None
    at = found.fit
    if search.problem is not known:
        at = fit(known, at.theta, initial_states(known), [], {})
    return noise_colour(known, at.theta, at.x0)


def _fitted_again(
    problem: Problem, search: Search, found: Explanation, not_tried: Collection[Key]
) -> tuple[Search, Fit, Explanation]:
    """What a search found before it was stopped, fitted on another problem; nothing else is tried there."""
    sought = coarse(problem)
    base = fit(sought, sought.model.null, initial_states(sought), [], {})
    again = Search(sought, list_starts(sought, not_tried), watch=search.watch)
    return again, base, on_all(again, search, found, base)


def _begun(problem: Problem, not_tried: Collection[Key], watch: Watch) -> tuple[Search, Fit]:
    """A search on the problem in which nothing was tried yet, and the model as declared."""
    sought = coarse(problem)
    base = fit(sought, sought.model.null, initial_states(sought), [], {})
    return Search(sought, list_starts(sought, not_tried), watch=watch), base


def _searched(
    problem: Problem, most: int, not_tried: Collection[Key], watch: Watch,
    known: tuple[Explanation, float] | None = None, begun: tuple[Search, Fit] | None = None,
) -> tuple[Search, Fit, Explanation]:  # fmt: skip
    """A search on the problem, the model as declared, and what explains it best; begun from what is `known`.

    What is known comes with its chi^2/dof where it was found. A search that is stopped ends with its best so far; one
    that was `begun` goes on.
    """
    search, base = begun or _begun(problem, not_tried, watch)
    if watch.stopped:
        return search, base, best_so_far(search, base, most)
    try:
        found = select(search, base, most) if known is None else carried_over(search, base, *known, most)
        rivals(search, found)  # what could stand in its place is fitted, and may turn out to be simpler
        return search, base, preferred(search, found, most)
    except Stopped:
        pass
    except KeyboardInterrupt:
        watch.interrupted()
    return search, base, best_so_far(search, base, most)


def _chosen(
    parts: Parts, search: Search, sparse: Fit, found: Explanation, settings: DiagnosisSettings,
    not_tried: Mapping[Key, str],
) -> _Chosen:  # fmt: skip
    """From what the search found to the set that is put to *confirm*, fitted on every sample of the other folds."""
    known = parts.known
    full = search if search.problem is known else Search(known, search.starts)
    base = sparse if full is search else fit(known, known.model.null, initial_states(known), [], {})
    kept = on_all(full, search, found, base)
    at_floor = chi2_dof(known, kept.fit) <= FIT_QUALITY
    agree, carried = True, None
    if found.members and not at_floor:
        together = math.ceil((settings.horizon_s + 0.5 * settings.window_s) / settings.window_s)
        trial = Trial(coarse(parts.fit), coarse(parts.choose, JUDGED_ROWS, together), settings.horizon_s)
        try:
            stopped = bool(search.watch.stopped)
            carried = None if stopped else transferable(search, sparse, found, trial, settings.max_effects)
        except Stopped:
            carried = None
        except KeyboardInterrupt:
            search.watch.interrupted()
        agree = carried is not None and carried.agrees
        if carried is not None:
            search, found = carried.search, carried.chosen
            kept = on_all(full, search, found, base)
    return _Chosen(search, sparse, found, real(full, kept, at_floor), full, base, carried, at_floor, agree, not_tried)


def _conclude(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, parts: Parts, chosen: _Chosen,
    said: tuple[str, ...], faults: tuple[RecordingFault, ...],
) -> Diagnosis:  # fmt: skip
    """From what was chosen to the answer; here alone *confirm* is looked at."""
    known, confirm, search, full, base = parts.known, parts.confirm, chosen.search, chosen.full, chosen.base
    at, horizon = chosen.kept.fit, settings.horizon_s
    old, new = (judge(confirm, theta, horizon) for theta in (base.theta, at.theta))
    evidence = _evidence(known, confirm, chosen, old, new)
    word, share = verdict(chosen.kept, evidence), evidence.share
    named = word in ("attributed", "partial") or (word == "none" and bool(chosen.kept.members))
    short = nearest(full, chosen.kept, evidence, chosen.at_floor, model) if word == "unexplained" else None
    kept, kept_held = (chosen.kept, new) if named else (full.empty(base), old)
    others = _rivals(chosen) if named else []
    names = [trace.name for trace in record.traces]
    windows = answer.predictions(known, names, (base, base.x0), (kept.fit, kept.fit.x0), False)
    windows += answer.predictions(confirm, names, (base, old.states), (kept.fit, kept_held.states), True)
    empty = search.empty(chosen.sparse)
    tested = word in ("partial", "unexplained") and short is None
    every = answer.found_effects(full, kept, others, chi2_dof(known, kept.fit), chosen.at_floor, model)
    listed = answer.alternatives(chosen.found, others)
    effects, listed = told([e for e in every if not is_fault(e.name)], listed, model, answer.applied(kept))
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
        warnings=(*said, *_warnings(search.watch, kept_held, kept, horizon)),
        applied=answer.applied(kept),
        corrected=apply_effects(model, answer.applied(kept)),
        windows=tuple(windows),
        nearest=short,
        left_over=second_look(search, chosen.found if named else empty, confirm, kept_held, horizon, model)
        if tested
        else None,
        concentrated=concentrated(confirm, names, old, new),
        recording=(*faults, *fitted_faults(every), *gain_faults(every), *noise_faults(known)),
    )


def _evidence(known: Problem, confirm: Problem, chosen: _Chosen, old: HeldOut, new: HeldOut) -> Evidence:
    """What the verdict is made of."""
    found, full, agree = chosen.kept, chosen.full, chosen.agree
    share = excess_share(old, new, known.sigma)
    wanted = bool(found.members) and needed(full, found, confirm, new)
    if found.members and chosen.search.watch.stopped:  # nothing compared the halves yet
        agree = folds_agree(known, found, full.steps, independent_share(known, found.fit))
    elif found.members and chosen.at_floor and not (wanted and new.ratio <= HELD_OUT_QUALITY):
        agree = folds_agree(known, found, full.steps, 1.0)
    before, after = (chi2_dof(known, at) for at in (chosen.base, found.fit))
    return Evidence(before, after, old, new, share, agree, wanted)


def _rivals(chosen: _Chosen) -> list[Rival]:
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


def _warnings(watch: Watch, held: HeldOut, kept: Explanation, horizon_s: float) -> tuple[str, ...]:
    said = []
    if watch.stopped:
        said.append(f"{watch.stopped}: the answer is the best of {watch.sets} sets of effects that were fitted.")
    if not kept.fit.converged:
        said.append("The last fit had not settled: take its numbers with care.")
    if horizon_s > 0 and held.horizon is None:
        said.append("No stretch of the fold that confirms is as long as the horizon: the errors are within windows.")
    return tuple(said)
