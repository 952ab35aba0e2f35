"""Columns that are not what the case says: a wrong sign or unit, two that were swapped.

Such a fault is discrete and large: no effect leads there step by step, and a search under it leads nowhere. Each
possibility is tried on a few windows before the search, with the model as declared and with friction, biases and gains
beside it, and one is taken up where it misses by a small part of what the columns as they are miss. One that is better
by less is a hypothesis of the record: what is found under it has to predict better. So is an input's sign, as its gain
may be negative. Whether a velocity has the sign of its position's derivative is kinematics, which no missing effect
masks: no possibility is tried under which it has not, and if the columns as they are have not, one of the others is.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.columns import SwappedColumns, VelocityLag, WrongSign, WrongUnit
from simgap.diagnosis.record.record import Record, exchanged
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.search.scoring import list_starts
from simgap.diagnosis.search.selection import at_beginnings, best_subsets
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import FARTHEST, Memo, Problem
from simgap.diagnosis.simulation.refit import refit, window_chi2
from simgap.diagnosis.simulation.sensitivity import choose_steps
from simgap.diagnosis.simulation.step_length import resolved
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import FAR, MATTERS, MOST, OUT_OF_SIGHT, PLAUSIBLE_RATIO
from simgap.notation import joined

_OWN_GAIN = np.sqrt(2.0 * np.pi)  # half the way, as a ratio, to the nearest other unit: turns for radians
_DESCENTS, _FIRST_DESCENTS = 10, 3  # linearisations of a fit that need not settle, and of its beginning
_HALVINGS = 3  # of the interval of the readings, for a step
_THOUSANDS = (("a thousandth of the declared unit", 1e-3), ("a thousand times the declared unit", 1e3))


@dataclass(frozen=True, eq=False)
class Columns:
    """What the columns may really be.

    Attributes:
        finding: the fault, if it is one.
        y, u: (k,), (m,) factors from logged to true, after the order below.
        y_order, u_order: which logged column each channel is in.
        words: which column is in which unit; "" where it is no unit.
        sure: whether it is better by far, before anything is sought.
    """

    finding: RecordingFault
    y: Floats
    u: Floats
    y_order: tuple[int, ...]
    u_order: tuple[int, ...]
    words: str = ""
    sure: bool = True

    @property
    def reverses(self) -> bool:
        """Whether it turns an input round, as a gain may do as well."""
        return bool(np.any(self.u < 0.0))

    def applied(self, problem: Problem) -> Problem:
        """The problem with the columns as they may really be."""
        read, put = list(self.y_order), list(self.u_order)
        own = problem.y[:, read] * self.y, problem.u[:, put] * self.u, problem.used[:, read], problem.weight[:, read]
        y, u, used, weight = map(np.ascontiguousarray, own)
        sigma = problem.sigma[read] * np.abs(self.y)
        return replace(problem, y=y, u=u, sigma=sigma, used=used, weight=weight, memo=Memo())

    def derives(self, problem: Problem, lags: Sequence[VelocityLag]) -> bool:
        """Whether velocities that are multiples of their positions' derivatives have the sign of these."""
        place = {n: j for j, n in enumerate(problem.model.measured)}
        pairs = [(lag.scale, place[lag.position], place[lag.velocity]) for lag in lags if lag.related]
        return all(scale * self.y[q] * self.y[v] > 0.0 for scale, q, v in pairs)

    def leads_out(self, problem: Problem, within: Mapping[str, tuple[float, float]]) -> bool:
        """Whether its factors move a channel whose readings lie within its range out of it."""
        low, high = np.array([within.get(name, (-np.inf, np.inf)) for name in problem.model.measured]).T
        ends = np.array([np.nanmin(problem.y, axis=0), np.nanmax(problem.y, axis=0)])
        inside, moved = (np.all((low <= e) & (e <= high), axis=0) for e in (ends, self.y * ends))
        return bool(np.any(inside & ~moved))

    def beside(self, others: Sequence[Columns]) -> Columns:
        """The same, saying what else would explain the data: of a linear plant inputs and readings scale alike."""
        words = [o.words for o in others if o.words]
        if not (words and self.words):
            return self
        also = f"{self.finding.sentence} These data would be the same with {joined(words, 'or')}."
        return replace(self, finding=replace(self.finding, sentence=also))

    def of_record(self, record: Record) -> Record:
        """The record with the columns as they really are."""
        return record.with_columns(self.y_order, self.u_order, self.y, self.u)


def better_columns(
    problem: Problem, lags: Sequence[VelocityLag], within: Mapping[str, tuple[float, float]]
) -> Columns | None:
    """What the columns may be rather than what the case says; None where nothing speaks for another possibility.

    Readings `within` the range where the plant works, state -> (least, largest), are not led out of it. Where `lags`
    show that the columns as they are cannot be, and the declared model decides for none of the others surely, it is the
    one under which the library promises to explain most.
    """
    options = [option for option in _options(problem) if not option.leads_out(problem, within)]
    derived = [option for option in options if option.derives(problem, lags)]
    best = _best_by_trial(problem, derived or options)
    if not derived or (best is not None and best.sure) or all(lag.scale > 0.0 for lag in lags if lag.related):
        return best
    return min(derived, key=lambda option: _promised(option.applied(problem)))


def _best_by_trial(problem: Problem, options: Sequence[Columns]) -> Columns | None:
    """The option under which the declared model misses least, if it is better than the columns as they are by more than
    a few times; sure, if by far and no input is reversed.

    Nor may friction, biases and gains do as well with the columns as they are: a reversed reading keeps an unstable
    plant in its place, as a better gain does. A large missing effect hides a wrong unit from the declared model: where
    no option is better by far, each is tried once more with these free, those out of sight aside. Small inputs and
    large readings take the plant out of sight: such a factor must also do better than one that leaves nothing of it.
    Windows are so short that the model stays where the readings are: what falls from there tells nothing of columns.
    """
    part, _ = problem.some()
    own = _begun(part, np.inf)
    whole = float(np.mean((np.ptp(part.y, axis=0) / part.sigma) ** 2))
    while own.left > whole and (shorter := part.windows.begun(0.5)).samples < part.windows.samples:
        part = part.on(shorter)
        own = _begun(part, np.inf)
    if (alone := own.left) < OUT_OF_SIGHT:
        return None
    far = OUT_OF_SIGHT * alone
    begun = [(option, _begun(option.applied(part), far)) for option in options]
    tried = [(option, trial.left) for option, trial in begun]
    bar = _beside_effects(own, np.inf, PLAUSIBLE_RATIO)  # as they are: with what the search may find
    best = _best(part, tried, bar / OUT_OF_SIGHT)
    if (best is None or best.reverses) and bar >= OUT_OF_SIGHT:
        beside = [(option, _beside_effects(trial, bar / FAR)) for option, trial in begun if trial.left <= far]
        best = _best(part, beside, bar / OUT_OF_SIGHT) or _best(part, beside, bar / FAR, sure=False)
    return best or _best(part, tried, alone / FAR, sure=False)


def _promised(problem: Problem) -> float:
    """The least BIC that the linear problem of the beginnings of windows promises of up to two effects."""
    seen = at_beginnings(problem, problem.model.null, list_starts(problem))
    sets = (s for size in range(3) for s in best_subsets(seen, size)[:1])
    return min(s.left + sum(len(c.slots) for c in s.members) * float(np.log(problem.size)) for s in sets)


def _best(part: Problem, tried: Sequence[tuple[Columns, float]], bar: float, sure: bool = True) -> Columns | None:
    """The best of what was tried, with what does as well in its words; None where none misses by less than the bar.

    It is `sure`, if it is to be and reverses nothing.
    """
    best, least = None, np.inf
    for option, left in tried:
        if left < min(bar, (1.0 - MATTERS) * least) and left < MOST * _missed_without_plant(part, option):
            best, least = option, left
    if best is None:
        return None
    others = [option for option, left in tried if option is not best and left < least / MOST]
    return replace(best.beside(others), sure=sure and not best.reverses)


def _missed_without_plant(part: Problem, option: Columns) -> float:
    """chi^2/dof with no input and with readings beyond all that moves the plant; inf where the option goes neither way.

    What a factor explains that this explains as well, a straight line does: it is no unit.
    """
    small, large = np.abs(option.u) < 1.0, option.y > 1.0
    if not (small.any() or large.any()):
        return np.inf
    beyond = replace(option, u=np.where(small, 0.0, option.u), y=np.where(large, 1e3 * option.y, option.y))
    return _fitted(beyond.applied(part)).left


@dataclass(frozen=True, eq=False)
class _Trial:
    """A few windows with the initial states (w, nx) that suit theta (q,)."""

    part: Problem
    theta: Floats
    x0: Floats

    @cached_property
    def left(self) -> float:
        """chi^2/dof of the window in the middle: a wrong column shows in all, and a model that runs away in some."""
        free = (self.part.size - self.part.taken) / self.part.size
        each = window_chi2(self.part, self.theta, self.x0) / self.part.counts
        return float(np.median(each)) / max(free, 1.0 / self.part.size)


def _fitted(part: Problem, useless: float = np.inf) -> _Trial:
    """The declared model, initial states fitted, while that may leave less than a useless chi^2/dof."""
    null = part.model.null
    return _Trial(part, null, refit(part, null, initial_states(part), useless=useless * part.counts).x0)


def _begun(part: Problem, far: float) -> _Trial:
    """The same by the longest steps that do; by shorter ones than the columns as they are need only if it misses by
    less than `far`.

    Readings a thousand times too large, as speeds, would take the shortest of steps, and miss all the same; columns
    that are wrong take shorter steps than the right ones.
    """
    needed = part.h_max
    least = min(needed, part.spacing * 2.0**-_HALVINGS)
    trial, before = _fitted(replace(part, h_max=part.spacing), far), np.inf
    while (h := trial.part.h_max) > needed or (h > least and trial.left <= far):
        same = abs(trial.left - before) <= MATTERS * trial.left or resolved(trial.part, trial.theta, trial.x0)
        if same and trial.left < FARTHEST**2 / part.counts.max():  # one reading that diverged is no end
            break
        trial, before = _fitted(replace(part, h_max=h / 2), far), trial.left
    return trial


def _beside_effects(trial: _Trial, most: float, far: float = _OWN_GAIN) -> float:
    """What is left with friction and biases that are free, and gains where they stay nearer to what is declared than
    `far`.

    A gain far from it, or reversed, would be another unit or sign by another name. What leaves more than `most` after
    the first few steps of a fit is not fitted on: the right columns are near their end by then.
    """
    part, theta, x0 = trial.part, trial.theta, trial.x0
    every = [c for c in part.model.candidates if c.effect.hides_columns]
    gains = [c for c in every if c.effect.parameters[0].null == 1.0]
    for free in (every, [c for c in every if c not in gains]):
        slots = [k for c in free for k in c.slots]
        steps = choose_steps(part, theta, x0, slots)
        if most < np.inf:
            soon = fit(part, theta, x0, slots, steps, _FIRST_DESCENTS, rounds=1)
            if not _near_declared(gains, soon.theta, far):
                continue
            if _Trial(part, soon.theta, soon.x0).left > most:
                break
        at = fit(part, theta, x0, slots, steps, _DESCENTS)
        if _near_declared(gains, at.theta, far):
            return min(_Trial(part, at.theta, at.x0).left, trial.left)
    return trial.left


def _near_declared(gains: Sequence[Candidate], theta: Floats, far: float) -> bool:
    """Whether each gain is so near to what is declared; one that may be far may be reversed too."""
    values = [float(theta[c.slots[0]]) for c in gains]
    return all(1.0 / far <= (g if far <= _OWN_GAIN else abs(g)) <= far for g in values)


def _options(problem: Problem) -> Iterator[Columns]:
    """Signs, units that are smaller than the declared one, larger ones, exchanged columns: likelier ones first."""
    names, inputs = problem.model.measured, problem.model.model.input_names
    units = problem.model.model.units
    ones, same = (np.ones(len(names)), np.ones(len(inputs))), (tuple(range(len(names))), tuple(range(len(inputs))))

    def scaled(which: list[int], of_input: bool, factor: float, finding: RecordingFault, words: str = "") -> Columns:
        y, u = ones[0].copy(), ones[1].copy()
        (u if of_input else y)[which] = factor
        return Columns(finding, y, u, *same, words)

    places = [([j], of_input, n) for of_input, each in ((True, inputs), (False, names)) for j, n in enumerate(each)]
    for which, of_input, name in places:
        yield scaled(which, of_input, -1.0, WrongSign().of(name))
    together = [*places, *_groups(names, units)]
    for larger in (False, True):
        for which, of_input, name in together:
            for words, factor in _MISTAKEN.get(units[name.split(", ")[0]], _THOUSANDS):
                if (factor > 1.0) is larger:
                    yield scaled(which, of_input, factor, WrongUnit().of(name, words, factor), f"{name} in {words}")
    for of_inputs, each in enumerate((names, inputs)):
        for i, j in itertools.combinations(range(len(each)), 2):
            y, u = (exchanged(own, i, j) if which == of_inputs else own for which, own in enumerate(same))
            yield Columns(SwappedColumns().of(each[i], each[j]), *ones, y, u)


def _groups(names: Sequence[str], units: Mapping[str, str]) -> Iterator[tuple[list[int], bool, str]]:
    """Readings whose units are mistaken together: all angles and their rates, all lengths and theirs."""
    for kind in ("rad", "m"):
        which = [j for j, n in enumerate(names) if units[n] in (kind, f"{kind}/s")]
        if len(which) > 1:
            yield which, False, ", ".join(names[j] for j in which)


_MISTAKEN = {
    "rad": (("degrees", np.pi / 180), ("turns", 2 * np.pi), *_THOUSANDS),
    "rad/s": (
        ("degrees a second", np.pi / 180),
        ("turns a minute", np.pi / 30),
        ("turns a second", 2 * np.pi),
        *_THOUSANDS,
    ),
    "m": (("millimetres", 1e-3), ("metres that were read as millimetres", 1e3)),
    "m/s": (("millimetres a second", 1e-3), ("metres a second that were read as millimetres a second", 1e3)),
}
"""Unit -> those that are mistaken for it, with the factor to it; `_THOUSANDS` of any other."""
