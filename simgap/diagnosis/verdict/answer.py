"""From a search to the parts of a diagnosis that people read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from simgap.diagnosis.record.faults.measurement import effect_or_fault, is_fault
from simgap.diagnosis.result import Alternative, CandidateScore, Collinear, Estimate, FoundEffect, Key, WindowPrediction
from simgap.diagnosis.search.confidence import chi2_dof, degrees_of_freedom, interval, standard_errors
from simgap.diagnosis.search.equivalence import Rival
from simgap.diagnosis.search.explanations import Explanation, Search, sound
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.effects import AppliedEffect
from simgap.model.symbolic import SymbolicModel

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
    search: Search, found: Explanation, rivals: Sequence[Rival], reduced: float, at_floor: bool, model: SymbolicModel
) -> tuple[FoundEffect, ...]:
    """What was chosen, faults of the recording included, with intervals and what could stand in its place."""
    errors = standard_errors(search.problem, found.fit, search.steps, reduced, at_floor)
    by_slot = dict(zip(found.fit.slots, errors.tolist(), strict=True))
    dof = degrees_of_freedom(search.problem, found.fit, at_floor)
    effects = []
    for c in found.members:
        units, values = c.effect.units(model, c.on), parameter_values(c, found.fit)
        estimates = {}
        for p, k in zip(c.effect.parameters, c.slots, strict=True):
            ends = p.widened(interval(values[p.symbol], by_slot.get(k, 0.0), dof))
            estimates[p.symbol] = Estimate(values[p.symbol], ends, units[p.symbol])
        effects.append(FoundEffect(c.effect.name, c.on, estimates, _replacements(c.key, found, rivals)))
    return tuple(effects)


def _replacements(key: Key, found: Explanation, rivals: Sequence[Rival]) -> tuple[tuple[Key, ...], ...]:
    sets = []
    for r in rivals:
        keys = r.explanation.keys
        if key not in keys:
            sets.append(tuple(sorted(keys - found.keys)))
    return tuple(dict.fromkeys(s for s in sets if s))


def alternatives(found: Explanation, rivals: Sequence[Rival]) -> tuple[Alternative, ...]:
    """Whole sets that fit as well."""
    return tuple(Alternative(whole_set(r.explanation), r.explanation.bic - found.bic, r.exact) for r in rivals)


_NOT_PHYSICAL = "its best fit is unphysical or zero"


def candidate_scores(search: Search, empty: Explanation, barred: Mapping[Key, str]) -> tuple[CandidateScore, ...]:
    """Every candidate beside the model as declared, the most promising first; `barred`: why some were not tried."""
    promised = {s.candidate.key: s.drop for s in search.ranked(empty)}
    singles = sorted((e for e in search.tried.values() if len(e.members) == 1), key=lambda e: -e.bic)
    alone = {e.members[0].key: e for e in singles}
    rows = []
    for c in search.problem.model.candidates:
        e: Explanation | None = alone.get(c.key)
        reason = "" if c.key in promised else "the data imply the opposite sign or no effect"
        if c.key in search.unseen[empty.keys]:
            reason = "these data do not show it"
        reason = barred.get(c.key, reason)
        if e is not None and not e.physical:
            bent = c.effect.one_curve and sound(c, e.fit)
            reason = "it fits almost anything, and still leaves more than noise" if bent else _NOT_PHYSICAL
        rows.append(
            CandidateScore(
                c.effect.name,
                c.on,
                promised.get(c.key, 0.0),
                None if e is None else empty.bic - e.bic,
                {} if e is None else parameter_values(c, e.fit),
                reason,
                None if e is None else chi2_dof(search.problem, e.fit),
            )
        )
    return tuple(sorted(rows, key=lambda r: -max(r.bic_gain or -math.inf, 0.0) - 1e-3 * r.chi2_drop))


def collinear_table(pairs: Sequence[tuple[Key, Key, float]], exact: float) -> tuple[Collinear, ...]:
    """Pairs with what would separate them."""
    rows = []
    for a, b, correlation in pairs:
        known, other = effect_or_fault(a[0]).excitation, effect_or_fault(b[0]).excitation
        advice = known if known and known == other else _ANY_EXCITATION
        if correlation > exact:
            advice = "to first order no motion separates them: measure one directly"
        rows.append(Collinear(a, b, correlation, advice))
    return tuple(rows)


def predictions(
    problem: Problem,
    names: Sequence[str],
    before: tuple[Fit, np.ndarray],
    after: tuple[Fit, np.ndarray],
    held_out: bool,
) -> list[WindowPrediction]:
    """Measured, before and after on evenly picked windows; each model comes with its initial states (w, nx)."""
    most = max(_MOST_WINDOWS, _MOST_SAMPLES * len(problem.windows) // max(problem.windows.samples, 1))
    few = np.unique(np.linspace(0, len(problem.windows) - 1, most).astype(int))
    part = problem.on(problem.windows.pick(few))
    old = part.predict(before[0].theta, before[1][few])
    new, states = part.predict(after[0].theta, after[1][few]), part.states(after[0].theta, after[1][few])
    out = []
    for w, (a, b) in enumerate(itertools.pairwise(part.rows.tolist())):
        s = slice(int(part.windows.start[w]), int(part.windows.stop[w]))
        name = names[int(part.windows.trace[w])]
        own = (problem.t[s], problem.y[s], old[a:b], new[a:b], states[a:b], problem.u[s])
        out.append(WindowPrediction(name, held_out, *own, problem.used[s]))
    return out
