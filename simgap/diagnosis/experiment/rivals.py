"""Explanations that the recordings at hand cannot tell apart, fitted to them again for their information."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from simgap.diagnosis.experiment.bench import Rival
from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import choose_step, linearise, slot_direction, with_values
from simgap.diagnosis.simulation.supermodel import Candidate, SuperModel
from simgap.diagnosis.verdict.judge import chi2_dof
from simgap.effects import EFFECTS, AppliedEffect
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel
from simgap.notation import joined

_ROUNDS = 10  # what a diagnosis fitted is near its end already
Explained = Sequence[AppliedEffect]


@dataclass(frozen=True, eq=False)
class Known:
    """What the recordings at hand say.

    Attributes:
        problem: their windows; rivals: fitted to them, the answer of the diagnosis first.
        excess: chi^2/dof of the best of them, at least 1.
    """

    problem: Problem
    rivals: tuple[Rival, ...]
    excess: float


def known_rivals(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, sets: Sequence[Explained],
    noise: Mapping[str, float],
) -> Known:  # fmt: skip
    """Fit each set of effects to the recordings, begun where the diagnosis ended.

    Args:
        model, record, settings: of the diagnosis; noise: what it took for each measured state.
        sets: the answer and what cannot be told from it, with their numbers.
    """
    parts, _ = parts_of(model, record, replace(settings, noise=dict(noise), effects=library_names(sets)))
    problem = coarse(parts.known)
    found = [_fitted(problem, effects) for effects in sets]
    return Known(problem, tuple(r for r, _ in found), max(1.0, min(reduced for _, reduced in found)))


def library_names(sets: Sequence[Explained]) -> tuple[str, ...]:
    """Names of the effects in some sets, without faults of the recording, which every compiled model has."""
    names = dict.fromkeys(a.name for effects in sets for a in effects)
    return tuple(n for n in names if n in EFFECTS) or ("viscous_friction",)


def translated(rival: Rival, effects: Explained, here: SuperModel, there: SuperModel) -> Rival:
    """The same explanation in another compiled model of the same plant."""
    values: dict[int, float] = {}
    places: dict[int, int] = {}
    for own, other in zip(members(here, effects), members(there, effects), strict=True):
        for k, new in zip(own.slots, other.slots, strict=True):
            values[new], places[k] = float(rival.theta[k]), new
    return replace(rival, theta=with_values(there.null, values), slots=tuple(places[k] for k in rival.slots))


def members(model: SuperModel, effects: Explained) -> tuple[Candidate, ...]:
    """The candidates of a compiled model that a set of effects is made of.

    Raises:
        UserError: effects that the model cannot have: they are of another one.
    """
    there = {c.key for c in model.candidates}
    for a in effects:
        if (a.name, a.on) not in there:
            raise UserError(
                f"the diagnosis names '{a.name}' on '{a.on}', which this case cannot have", remedy="Diagnose it again."
            )
    return tuple(model.find(a.name, a.on) for a in effects)


def label(model: SuperModel, effects: Explained) -> str:
    """A set in words, without numbers."""
    return joined([c.effect.phrase(c.on) for c in members(model, effects)]) if effects else "the model as declared"


def keys(effects: Explained) -> frozenset[Key]:
    """Names and targets."""
    return frozenset((a.name, a.on) for a in effects)


def _fitted(problem: Problem, effects: Explained) -> tuple[Rival, float]:
    """A set fitted to a problem, and its chi^2/dof."""
    model = problem.model
    chosen = members(model, effects)
    values: dict[int, float] = {}
    for c, a in zip(chosen, effects, strict=True):
        values |= {k: float(a.values[p.symbol]) for p, k in zip(c.effect.parameters, c.slots, strict=True)}
    theta, x0 = with_values(model.null, values), initial_states(problem)
    open_ = [(p, k) for c in chosen for p, k in zip(c.effect.parameters, c.slots, strict=True) if not p.integer]
    slots = tuple(k for _, k in open_)
    steps = {k: choose_step(problem, theta, x0, k, 1e-4) for k in slots}
    ends = fit(problem, theta, x0, slots, steps, _ROUNDS)
    steps = {k: choose_step(problem, ends.theta, ends.x0, k, 1e-4) for k in slots}
    directions = [slot_direction(problem, ends.theta, k, steps[k]) for k in slots]
    information = linearise(problem, ends.theta, ends.x0, directions).gram
    count = sum(len(c.slots) for c in chosen)
    rival = Rival(label(model, effects), ends.theta, slots, tuple(steps.values()), count, information)
    return rival, chi2_dof(problem, ends)
