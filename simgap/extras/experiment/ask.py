"""From what a diagnosis left open to the next experiment, or to what else would settle it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.conditions import conditioned
from simgap.diagnosis.record.folds import Windows, cut_in_folds
from simgap.diagnosis.record.noise import worth
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.diagnosis.thresholds import AS_MUCH, CONFIDENCE, MATTERS
from simgap.effects import AppliedEffect
from simgap.errors import UserError
from simgap.extras.experiment.propose import ENOUGH, Beside, InputProposal, beside, propose
from simgap.extras.experiment.rivals import Bench, Explained, KnownRivals, known_rivals, library_names, translated
from simgap.geometry import Box
from simgap.model.symbolic import SymbolicModel
from simgap.notation import number, pretty_unit

T = TypeVar("T")
LEAST = 16
"""Samples below which no recording is tried: two windows of the fewest samples."""


def windows_to_come(record: Record, settings: DiagnosisSettings, t: Floats) -> tuple[Windows, Bools]:
    """Windows of a recording t (n,) s, given before those at hand, and which of them tell explanations apart, (w,).

    Those of *confirm* do not: no explanation is fitted to them.

    Raises:
        UserError: if the diagnosis cannot use it: it is shorter than half a window, or all of it is held out.
    """
    windows, folds = _to_come(record, settings, t)
    tells = folds[0] | folds[1]
    if not tells.any():
        raise UserError(
            f"a recording of {t[-1] - t[0]:.3g} s is too short to separate explanations",
            key="--seconds", remedy=f"Give more, such as {2.0 * settings.window_s:.3g} s.",
        )  # fmt: skip
    return windows, tells


def as_usable(record: Record, settings: DiagnosisSettings, t: Floats, count: int) -> bool:
    """True if the first `count` samples of a recording t (n,) s are in each of the folds that the whole of it is in.

    Of confusions on a pendulum, an oscillator and a cart with a pole 0 of 6 were settled by less than a window, 13 of
    17 by 1 to 1.4 windows and 29 of 31 by 2.8 and more, the first to be in three folds (benchmarks/next_experiment.py,
    seeds 20000 on): what is found on one fold is not confirmed on another that shows something else.
    """
    try:
        (_, few), (_, whole) = (_to_come(record, settings, part) for part in (t[:count], t))
    except UserError:
        return False
    return bool(np.array_equal(few.any(axis=1), whole.any(axis=1)) and (few[0] | few[1]).any())


def _to_come(record: Record, settings: DiagnosisSettings, t: Floats) -> tuple[Windows, Bools]:
    """Windows of a recording to come, and whether each is in fit, choose and confirm: (3, w)."""
    n = len(t)
    trace = Trace("next", t, np.zeros((n, len(record.measured))), np.zeros((n, len(record.inputs))))
    both = Record((trace, *record.traces), record.measured, record.inputs)
    windows, folds, _ = cut_in_folds(both, settings, settings.window_s)
    own = windows.trace == 0
    return windows.pick(own), np.stack([folds.fit, folds.choose, folds.confirm])[:, own]


def halves(count: int) -> Iterator[int]:
    """Numbers of samples of recordings half, a quarter, ... as long."""
    while count > LEAST:
        count = (count - 1) // 2 + 1
        yield count


def shortest(whole: int, counts: Iterator[int], at: Callable[[int], T | None]) -> T | None:
    """Result of `at` for the least number of samples that is enough for it; None if only `whole` is.

    Ever smaller counts are tried while they are enough, then the one between the last that was and the first that was
    not.
    """
    best: T | None = None
    for count in counts:
        found = at(count)
        if found is None:
            return at(round(math.sqrt(count * whole))) or best
        best, whole = found, count
    return best


FACTOR = 1.5
"""Value to which a mass is set, over its declared one. Judgement: far enough to show."""


@dataclass(frozen=True)
class Remedy:
    """Another way out: a sentence on what to do, and how sure one will then be."""

    kind: str
    name: str
    sentence: str
    probability: float


def settable(model: SymbolicModel, sets: Sequence[Sequence[AppliedEffect]]) -> Iterator[tuple[str, float]]:
    """Masses of the plant, which a weight changes, and what to set them to: first those in doubt."""
    doubted = {a.on for effects in sets for a in effects if a.name == "parameter_error"}
    masses = [n for n, p in model.parameters.items() if p.unit == "kg" and "." not in n and p.value != 0.0]
    for name in sorted(masses, key=lambda n: n not in doubted):
        yield name, FACTOR * model.parameters[name].value


def best_remedy(options: Iterable[Remedy], wanted: float) -> Remedy | None:
    """The first option that makes one as sure as wanted, else the best above even odds."""
    best: Remedy | None = None
    for found in options:
        if best is None or found.probability > best.probability:
            best = found
        if found.probability >= wanted:
            break
    return best if best is not None and best.probability > 0.5 else None


WANTED = 1.0 - MATTERS
"""An input that makes one less sure than this is no answer by itself: what else would help is looked for."""
UNREAD = 1e-3
"""A sensor that is not there yet is taken to have this share of the range of its state as noise. Judgement."""


@dataclass(frozen=True, eq=False)
class Question:
    """Explanations that are to be told apart, and the limits of the recording that does it.

    Attributes:
        model: known conditions as inputs; record, settings, noise: of the diagnosis.
        sets: its answer and what it could not tell from it, with their numbers.
        t: (n,) s of the recording to come; start: (nx,); allowed: states; middle, reach: (m,) of the inputs.
        brief: whether a shorter recording may do.
        conditions: rows of known conditions under which there are recordings; one empty row without any.
    """

    model: SymbolicModel
    record: Record
    settings: DiagnosisSettings
    noise: Mapping[str, float]
    sets: tuple[Explained, ...]
    t: Floats
    start: Floats
    allowed: Box
    middle: Floats
    reach: Floats
    conditions: tuple[tuple[float, ...], ...] = ((),)
    brief: bool = True

    def fitted(self) -> KnownRivals:
        """The sets fitted to the recordings."""
        return known_rivals(self.model, self.record, self.settings, self.sets, self.noise)

    def bench(self, known: KnownRivals, held: tuple[float, ...], count: int | None = None) -> Bench:
        """Bench of the next recording under these conditions, with so many samples (all of t if not given)."""
        problem, t = known.problem, self.t[:count]
        windows, tells = windows_to_come(self.record, self.settings, t)
        names, readings = self.record.measured, worth(self.record)
        return Bench(
            problem.model, known.rivals, np.array([self.noise[n] for n in names]), t, windows, tells,
            min(problem.h_max, float(t[1] - t[0])), self.start, self.allowed, self.middle, self.reach, held,
            known.excess, problem.size, readings.steps, readings.shared,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Advice:
    """The best input with its bench, the explanations that it is to tell apart, and what else would help.

    `longest`: the best one of the whole length, where a shorter one is enough.
    """

    known: KnownRivals
    proposal: InputProposal
    remedy: Remedy | None
    longest: InputProposal | None = None


def ask(question: Question, rng: np.random.Generator, tell: Callable[[str], None] = lambda words: None) -> Advice:
    """The next experiment."""
    tell(f"fitting {len(question.sets)} explanation{'s' if len(question.sets) > 1 else ''} to the recordings")
    known = question.fitted()
    several = len(known.rivals) > 1
    hidden = beside(question.model, question.record, question.settings, question.sets[0], known) if several else None
    proposal = propose([question.bench(known, row) for row in question.conditions], rng, tell, beside=hidden)
    longest = None
    if question.brief and hidden is not None and proposal.best is not None and proposal.sure >= CONFIDENCE:
        tell("looking for the shortest recording that is enough")
        less = _shorter(question, known, proposal, hidden, rng, tell)
        if less is not None:
            longest, proposal = proposal, less
    remedy = None
    open_ = proposal.sure < WANTED or proposal.alike()
    if several and proposal.best is not None and open_:
        tell("no input is enough: looking for a weight or a sensor that is")
        asked = {k for pair in proposal.alike() for k in pair} or set(range(len(known.rivals)))
        left = replace(question, t=proposal.bench.t, sets=tuple(s for k, s in enumerate(question.sets) if k in asked))
        remedy = best_remedy(_remedies(left, proposal.best.u, rng), ENOUGH)
    return Advice(known, proposal, remedy, longest)


def _shorter(
    question: Question, known: KnownRivals, whole: InputProposal, hidden: Beside, rng: np.random.Generator,
    tell: Callable[[str], None],
) -> InputProposal | None:  # fmt: skip
    """The shortest recording that is enough; None if only the whole one is."""

    def at(count: int) -> InputProposal | None:
        if not as_usable(question.record, question.settings, question.t, count):
            return None
        benches = [question.bench(known, row, count) for row in question.conditions]
        found = propose(benches, rng, tell, beside=hidden, counted=whole.counted)
        enough = found.best is not None and found.sure >= CONFIDENCE and found.shown >= AS_MUCH * whole.shown
        return found if enough else None

    return shortest(len(question.t), halves(len(question.t)), at)


def _remedies(question: Question, u: Floats, rng: np.random.Generator) -> Iterator[Remedy]:
    """Masses to set, then states to read."""
    for name, value in settable(question.model, question.sets):
        size = f"{number(value)} {pretty_unit(question.model.parameters[name].unit)}".strip()
        words = f"set {name} to a known value, such as {size} (add a weight), and say so under"
        yield Remedy("condition", name, f"{words} measured.conditions", _set(question, name, value, rng))
    for name in question.model.state_names:
        if name not in question.record.measured:
            yield Remedy("sensor", name, f"measure {name} too", _read(question, name, u, rng))


def _set(question: Question, name: str, value: float, rng: np.random.Generator) -> float:
    """How sure one is once a mass is known to have another value: no explanation errs about it then."""
    model = conditioned(question.model, [name])
    declared = question.model.parameters[name].value
    traces = tuple(replace(t, u=np.hstack([t.u, np.full((len(t.u), 1), declared)])) for t in question.record.traces)
    record = replace(question.record, traces=traces, inputs=(*question.record.inputs, name))
    sets = tuple(tuple(a for a in s if a.on != name) for s in question.sets)
    other = replace(question, model=model, record=record, sets=sets)
    bench = other.bench(other.fitted(), (*question.conditions[0], value))
    return propose([bench], rng, few=True).of_all


def _read(question: Question, name: str, u: Floats, rng: np.random.Generator) -> float:
    """How sure one is once a state is read as well, in the range that the best input brings it to."""
    known = question.fitted()
    bench = question.bench(known, question.conditions[0])
    states, _ = bench.moved(known.rivals[0], u)
    span = float(np.ptp(states[:, question.model.state_names.index(name)]))
    here = known.problem.model
    there = cached_supermodel(here.model, (*here.measured, name), library_names(question.sets))
    rivals = [translated(r, s, here, there) for r, s in zip(known.rivals, question.sets, strict=True)]
    seen = replace(
        bench, model=there, rivals=tuple(rivals), sigma=np.append(bench.sigma, UNREAD * max(span, 1e-12)),
        steps=np.append(bench.steps, 0.0), shared=np.append(bench.shared, 0.0),
    )  # fmt: skip
    return propose([seen], rng, few=True).of_all
