"""How much each candidate promises: the drop of chi^2 in the direction of its projected sensitivity."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.noise import rates
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import Direction, linearise, promised, slot_direction, step_of, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.effects import EFFECTS
from simgap.effects.base import Scales, Start, driven_by
from simgap.effects.rigid_body import ParameterError, ReflectedInertia
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel
from simgap.units import full_turn

_RESPONSE, _TRIAL = 0.001, 1.0  # of the noise: a small step for derivatives; a finite one where there is a kink
_AMPLITUDES = (1e-9, 1e2)
_SECANT = (0.3, 2.0)  # how far from a secant's own size its estimate may be


@dataclass(frozen=True)
class Score:
    """What a candidate promises from one start.

    Attributes:
        drop: of chi^2; values: to begin a fit with, slot -> value.
        columns: those of the start in its screen; none of a trial of finite size, which is not the effect's direction.
    """

    candidate: Candidate
    drop: float
    values: dict[int, float]
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Starts:
    """All starts of all candidates that may be tried, with their amplitudes (kept between rounds)."""

    items: tuple[tuple[Candidate, Start], ...]
    amplitudes: dict[int, float] = field(default_factory=dict)


def list_starts(problem: Problem, barred: Collection[Key] = ()) -> Starts:
    """The starts of every candidate that is not barred, at the scales of this record."""
    model, spacing = problem.model.model, problem.spacing
    commands = dict(zip(model.input_names, np.abs(problem.u).max(axis=0), strict=True))
    items = []
    for c in (c for c in problem.model.candidates if c.key not in barred):
        scales = Scales(spacing)
        if c.effect.kind == "input":
            speed = _speed(problem, model.driven[c.on]) if c.on in model.driven else 1.0
            scales = Scales(spacing, float(commands[c.on]) or 1.0, speed)
        elif c.effect.kind == "plant" and model.wheels is not None:
            scales = Scales(spacing, float(commands[model.wheels.linear]) or 1.0)
        elif c.effect.kind == "coordinate":
            drive, places = sum(float(commands[u]) for u in driven_by(model, c.on)), visited(problem, c)
            ends = float(np.nanmin(places)), float(np.nanmax(places))
            scales = Scales(spacing, drive or 1.0, _speed(problem, c.on), _inertia(model, c.on), ends)
        items += [(c, start) for start in c.effect.starts(scales)]
    return Starts(tuple(items))


def _speed(problem: Problem, coordinate: str) -> float:
    """Root mean square speed of a coordinate, from its own channel or its position's differences."""
    c, measured = problem.model.model.coordinate(coordinate), problem.model.measured
    if c.velocity in measured:
        v = problem.y[:, measured.index(c.velocity)]
    elif c.position in measured:
        v = rates(problem.t, problem.y[:, measured.index(c.position)])
    else:
        return 1.0
    return max(float(np.sqrt(np.mean(v**2))), 1e-9)


def visited(problem: Problem, c: Candidate) -> Floats:
    """What the input of a candidate was in the windows, or the position of its coordinate in the record: (n,).

    A single 0 where it acts on neither, or nothing reads that.
    """
    model, measured = problem.model.model, problem.model.measured
    if c.effect.kind == "input":
        return problem.u[problem.samples, model.input_names.index(c.on)]
    position = model.coordinate(c.on).position if c.effect.kind == "coordinate" else None
    return problem.y[:, measured.index(position)] if position in measured else np.zeros(1)


def _inertia(model: SymbolicModel, coordinate: str) -> float:
    """What a force on a coordinate meets of it as declared, all states at 0, other coordinates free; 1 if unknown."""
    row = model.state_names.index(model.coordinate(coordinate).velocity)
    zero = {v.symbol: 0.0 for v in (*model.states, *model.inputs)}
    ease = sp.sympify(model.force_map[coordinate][row]).subs(model.values() | zero)
    return 1.0 / float(ease) if ease.is_number and ease.is_positive else 1.0


def barred(model: SymbolicModel, record: Record, named: Collection[str], known: Collection[str] = ()) -> dict[Key, str]:
    """Effects and targets that are not tried, with the reason: parameters that are `known`, springs, rotors.

    What pulls a joint back to one place pulls it to that place on every turn: on an angle that winds it would be a
    force that grows with the turns counted, which a joint has only where something winds up. Where nothing was
    commanded an inertia is the plant's own, and no rotor's. Both are tried if `named`.
    """
    winding = [c.name for c in model.coordinates if _winds(model, record, c.name)]
    springs = {
        (e.name, on): "the joint makes full turns: name the effect under measured.effects if something winds up on it"
        for e in EFFECTS.values()
        if e.pulls_to_a_place and e.name not in named
        for on in e.targets(model)
        if on in winding
    }
    driven = ReflectedInertia.name in named or any(trace.u.any() for trace in record.traces)
    behind = () if driven else ReflectedInertia().targets(model)
    rotors = {(ReflectedInertia.name, on): "nothing drives the plant" for on in behind}
    return springs | rotors | {(ParameterError.name, on): "it is known (measured.known)" for on in known}


def _winds(model: SymbolicModel, record: Record, coordinate: str) -> bool:
    """Whether the coordinate is an angle that travels more than a full turn in a trace, by itself or its speed."""
    c, measured = model.coordinate(coordinate), record.measured
    turn = full_turn(model.units[c.position])
    if turn is None or not {c.position, c.velocity} & set(measured):
        return False
    if c.position in measured:
        way = [float(np.ptp(trace.y[:, measured.index(c.position)])) for trace in record.traces]
    else:
        speed = measured.index(c.velocity)
        way = [float(np.ptp(np.cumsum(t.y[1:, speed] * np.diff(t.t)))) for t in record.traces]
    return any(each > abs(turn) for each in way)


@dataclass(frozen=True, eq=False)
class Screen:
    """The linear problem around a fit, with the starts of every candidate among its columns.

    Attributes:
        at: the fit; own: its free parameters, the first columns.
        asked: candidates that the data see, each with one of its starts and the columns of it.
        gram: (p, p), gradient: (p,), rest: projected J^T J, J^T r and r^T r of all columns.
        unseen: candidates that these data cannot see at all.
    """

    at: Fit
    own: int
    asked: tuple[tuple[Candidate, Start, tuple[int, ...]], ...]
    gram: Floats
    gradient: Floats
    rest: float
    unseen: frozenset[Key]


def screen(problem: Problem, at: Fit, steps: dict[int, float], starts: Starts, exclude: Collection[Key] = ()) -> Screen:
    """One linearisation for the whole library.

    Args:
        problem: data and model.
        at: fit around which sensitivities are taken; its free parameters may move along.
        steps: difference steps of the free parameters.
        starts: from `list_starts`.
        exclude: keys of candidates that are not asked.
    """
    directions = [slot_direction(problem, at.theta, k, steps[k]) for k in at.slots]
    asked: list[tuple[Candidate, Start, tuple[int, ...]]] = []
    for index, (c, start) in enumerate(starts.items):
        if c.key in exclude:
            continue
        amplitude = small_amplitude(problem, at, c, start, index, starts)
        asked.append((c, start, tuple(range(len(directions), len(directions) + start.size))))
        directions += [column(at.theta, c, start, j, amplitude) for j in range(start.size)]
    linear = linearise(problem, at.theta, at.x0, directions)
    seen = [it for it in asked if linear.visible[list(it[2])].any()]
    unseen = frozenset(c.key for c, _, _ in asked) - {c.key for c, _, _ in seen}
    return Screen(at, len(at.slots), tuple(seen), linear.gram, linear.gradient, linear.rest, unseen)


def score(seen: Screen) -> list[Score]:
    """Every start of every candidate beside the fit, best first; starts of the wrong sign are left out."""
    scores = []
    alone, _ = promised(seen.gram[: seen.own, : seen.own], seen.gradient[: seen.own])
    for c, start, columns in seen.asked:
        free = [*range(seen.own), *columns]
        whole, coefficients = promised(seen.gram[np.ix_(free, free)], seen.gradient[free])
        values = begun_at(c, start, coefficients[seen.own :])
        if whole > alone and values is not None:
            scores.append(Score(c, whole - alone, values, columns if start.amplitude is None else ()))
    return sorted(scores, key=lambda s: -s.drop)


def begun_at(c: Candidate, start: Start, coefficients: Floats) -> dict[int, float] | None:
    """Where a fit begins that the linear problem sends to these coefficients: slot -> value; None if not physical."""
    if start.amplitude is not None:
        if coefficients[0] <= 0.0:
            return None
        coefficients = np.clip(coefficients, *_SECANT) * start.amplitude
    values = start.point(list(coefficients))
    return c.by_slot(values) if c.effect.physical(values) else None


def best_of_each(scores: Sequence[Score]) -> list[Score]:
    """The best start of every candidate, best first."""
    seen: dict[tuple[str, str], Score] = {}
    for s in scores:
        seen.setdefault(s.candidate.key, s)
    return list(seen.values())


def column(theta: Floats, c: Candidate, start: Start, j: int, amplitude: float) -> Direction:
    """Direction of one coefficient of a start in theta (q,), from the point where the others are zero."""
    coefficients = [amplitude if i == j else 0.0 for i in range(start.size)]
    return Direction(with_values(theta, c.by_slot(start.point(coefficients))), amplitude)


def small_amplitude(problem: Problem, at: Fit, c: Candidate, start: Start, index: int, starts: Starts) -> float:
    """A small coefficient whose response is a fraction of the noise, found once on a few windows.

    As large as the noise for an effect with a kink: what it does at nothing is not what it does at its size.
    """
    if start.amplitude is not None:
        return start.amplitude
    if index not in starts.amplitudes:
        unit, model = start.point([1.0] * start.size), problem.model.model
        turns = not c.of_recording and c.effect.surfaces(model, c.on, unit)  # what it does turns round somewhere
        wanted = _TRIAL if turns else _RESPONSE
        (part, few), way = problem.some(6), partial(column, at.theta, c, start, 0)
        starts.amplitudes[index] = step_of(part, at.theta, at.x0[few], way, wanted, _AMPLITUDES, 4)
    return starts.amplitudes[index]
