"""Diagnosis: from a declared model and a record to the physical effect that the model lacks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.noise import noise_floor
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.windows import Windows, held_out_mask, split_windows
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, Judged
from simgap.diagnosis.search.equivalence import Rival, collinear_pairs, rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.scoring import list_starts
from simgap.diagnosis.search.selection import carried_over, on_all, preferred, select
from simgap.diagnosis.simulation.coarse import JUDGED_ROWS, coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem, build_problem
from simgap.diagnosis.simulation.step_length import settled
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.diagnosis.thresholds import EXACTLY_COLLINEAR, FIT_QUALITY, HELD_OUT_QUALITY
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.judge import HeldOut, chi2_dof, excess, judge, judged, real, verdict
from simgap.diagnosis.verdict.transfer import transferable
from simgap.effects import apply_effects
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel

Floats = NDArray[np.float64]


def diagnose(model: SymbolicModel, record: Record, settings: DiagnosisSettings | None = None) -> Diagnosis:
    """Attribute what a model fails to predict to physical effects that it lacks.

    Args:
        model: continuous dynamics as declared; effects are sought on all its coordinates, inputs, sensors, parameters.
        record: measured traces in the model's units.
        settings: choices; the defaults if not given.

    Raises:
        UserError: no trace as long as a window, inputs that are not the model's, unknown effects.
    """
    settings = settings or DiagnosisSettings()
    if record.inputs != model.input_names:
        raise UserError(f"the record has inputs {list(record.inputs)}", remedy=f"Give {list(model.input_names)}.")
    problem, held = _problems(model, record, settings)
    search, base, found = _searched(problem, settings.max_effects)
    reach = problem.reach(found.fit.theta)
    if reach > problem.reach(problem.model.null):  # what was commanded before the record began is unknown: masked
        alone = held is problem
        problem = problem.past_the_unknown(reach)
        held = problem if alone else held.past_the_unknown(reach)
        search, base, found = _searched(problem, settings.max_effects, found)
    return _conclude(model, record, settings, search, base, found, problem, held)


def _searched(problem: Problem, most: int, known: Explanation | None = None) -> tuple[Search, Fit, Explanation]:
    """A search on the problem, the model as declared, and what explains it best; begun from what is `known`."""
    sought = coarse(problem)
    base = fit(sought, sought.model.null, initial_states(sought), [], {})
    search = Search(sought, list_starts(sought))
    found = select(search, base, most) if known is None else carried_over(search, base, known, most)
    rivals(search, found)  # what could stand in its place is fitted, and may turn out to be simpler
    return search, base, preferred(search, found, most)


def _problems(model: SymbolicModel, record: Record, settings: DiagnosisSettings) -> tuple[Problem, Problem]:
    """What is fitted and what is held out."""
    compiled = cached_supermodel(model, record.measured, settings.effects)
    sigma = noise_floor(record)
    for name, value in settings.noise.items():
        if name in record.measured:
            sigma[record.measured.index(name)] = value
    windows = split_windows(record, settings.window_s)
    held = held_out_mask(record, windows, settings.held_out_traces, settings.held_out_share, _together(settings))
    every = settled(build_problem(compiled, record, windows, sigma))
    reach = every.reach(compiled.null)  # of delays that the model declares
    if held.all() or not held.any():
        every = every.past_the_unknown(reach)
        return every, every
    fitted, judged_on = every.on(windows.pick(~held)), every.on(windows.pick(held))
    return fitted.past_the_unknown(reach), judged_on.past_the_unknown(reach)


def _together(settings: DiagnosisSettings) -> int:
    """Neighbouring windows that a prediction over the horizon needs."""
    return math.ceil((settings.horizon_s + 0.5 * settings.window_s) / settings.window_s)


def _conclude(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, search: Search, sparse: Fit, found: Explanation,
    problem: Problem, held: Problem,
) -> Diagnosis:  # fmt: skip
    """From what the search chose to the answer, on every sample."""
    full = search if search.problem is problem else Search(problem, search.starts)
    base = sparse if full is search else fit(problem, problem.model.null, initial_states(problem), [], {})
    empty, chosen = full.empty(base), on_all(full, search, found, base)
    old, new = (judge(held, at.theta, settings.horizon_s) for at in (base, chosen.fit))
    at_floor = chi2_dof(problem, chosen.fit) <= FIT_QUALITY and new.ratio <= HELD_OUT_QUALITY
    agree, carried = at_floor, None
    if found.members and not at_floor:
        fewer = search.problem if held is problem else coarse(held, JUDGED_ROWS, _together(settings))
        carried = transferable(search, sparse, found, fewer, settings.horizon_s, settings.max_effects)
        agree = carried is not None
        if carried is not None:
            search, found = carried.search, carried.chosen
            chosen = on_all(full, search, found, base)
            new = judge(held, chosen.fit.theta, settings.horizon_s)
    kept_alone = real(full, chosen, at_floor)
    if kept_alone is not chosen:
        chosen, new = kept_alone, judge(held, kept_alone.fit.theta, settings.horizon_s)
    share = _share(old, new, problem)
    word = verdict(chi2_dof(problem, base), chi2_dof(problem, chosen.fit), new.ratio, chosen, share, agree)
    named = word in ("attributed", "partial")
    kept, kept_held, kept_share = (chosen, new, share) if named else (empty, old, 1.0)
    others = rivals(search, found) if named else []
    if carried is not None:  # what fits as well need not carry over as well
        others = [r for r in others if r.exact] + [Rival(e, False) for e in carried.rivals]
    names = [trace.name for trace in record.traces]
    windows = answer.predictions(problem, names, (base, base.x0), (kept.fit, kept.fit.x0), False)
    if held is not problem:
        windows += answer.predictions(held, names, (base, old.states), (kept.fit, kept_held.states), True)
    return Diagnosis(
        verdict=word,
        effects=answer.found_effects(full, kept, others, chi2_dof(problem, kept.fit), at_floor, model),
        alternatives=answer.alternatives(found, others),
        before=judged(problem, base, old, settings.horizon_s),
        after=judged(problem, kept.fit, kept_held, settings.horizon_s),
        floor=_floor(problem, kept_held, settings.horizon_s),
        excess_share=kept_share,
        sigma=dict(zip(record.measured, map(float, problem.sigma), strict=True)),
        candidates=answer.candidate_scores(search, search.empty(sparse)),
        collinear=answer.collinear_table(collinear_pairs(search, search.empty(sparse)), EXACTLY_COLLINEAR),
        held_out=_stretches(held.windows, problem.t, names) if held is not problem else (),
        warnings=_warnings(problem, held, kept, settings),
        applied=answer.applied(kept),
        corrected=apply_effects(model, answer.applied(kept)),
        windows=tuple(windows),
    )


def _share(old: HeldOut, new: HeldOut, problem: Problem) -> float:
    """Held-out excess after over before."""
    floor = None if new.horizon is None else new.horizon.floor
    was = excess(old, floor, problem.sigma)
    return excess(new, floor, problem.sigma) / was if was > 0 else 1.0


def _floor(problem: Problem, held: HeldOut, horizon_s: float) -> Judged:
    names = problem.model.measured
    sigma = dict(zip(names, map(float, problem.sigma), strict=True))
    ahead = {} if held.horizon is None else dict(zip(names, map(float, held.horizon.floor), strict=True))
    return Judged(sigma, horizon_s, ahead, 1.0, 1.0)


def _stretches(windows: Windows, t: Floats, names: list[str]) -> tuple[tuple[str, float, float], ...]:
    """Held-out stretches, neighbouring windows of a trace joined."""
    joined: list[list[int]] = []
    for a, b, k in zip(windows.start.tolist(), windows.stop.tolist(), windows.trace.tolist(), strict=True):
        if joined and joined[-1][1] == a and joined[-1][2] == k:
            joined[-1][1] = b
        else:
            joined.append([a, b, k])
    return tuple((names[k], float(t[a]), float(t[b - 1])) for a, b, k in joined)


def _warnings(problem: Problem, held: Problem, kept: Explanation, settings: DiagnosisSettings) -> tuple[str, ...]:
    said = []
    if held is problem:
        said.append("The record is a single window: nothing could be held out, the errors are of fitted data.")
    if not kept.fit.converged:
        said.append("The last fit had not settled: take its numbers with care.")
    if settings.horizon_s > 0 and not len(held.windows):
        said.append("No held-out stretch is as long as the horizon.")
    return tuple(said)
