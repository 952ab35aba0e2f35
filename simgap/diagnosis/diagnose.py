"""Diagnosis: from a declared model and a record to the physical effect that the model lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.change import Answer, sides_apart
from simgap.diagnosis.choosing import Chosen, chosen
from simgap.diagnosis.conclude import conclude
from simgap.diagnosis.record.faults.columns import velocity_lags
from simgap.diagnosis.record.faults.registry import mended
from simgap.diagnosis.record.noise import resolution
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, RecordingFault
from simgap.diagnosis.search.columns import better_columns
from simgap.diagnosis.search.scoring import barred
from simgap.diagnosis.search.selection import best_so_far, leap_from_beginnings
from simgap.diagnosis.search.watch import Watch, answered
from simgap.diagnosis.seek import (
    Hypothesis,
    explained,
    looked_again,
    no_louder_than_misses,
    on_its_step,
    under_its_law,
    under_its_noise,
)
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.parts import Parts, parts_of
from simgap.diagnosis.thresholds import MATTERS
from simgap.diagnosis.tiers import explain_all, motors, screened, second
from simgap.diagnosis.verdict.faults import filtered_channels
from simgap.diagnosis.verdict.score import gained
from simgap.diagnosis.verdict.sets import plausible
from simgap.effects import MemoryInputEffect
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel
from simgap.notation import joined

_UNKNOWN_PAST = (
    "The first {:.3g} s of each trace are not compared: with {}, found on the whole of it, what was commanded before, "
    "which the record does not hold, may still act there. Begin to record as long before the input first changes."
)


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
            judged; under a budget the last that was judged stands.

    Raises:
        UserError: no trace as long as a window, inputs that are not the model's, unknown effects, a budget in which
            nothing is judged.
    """
    return diagnose_mended(model, record, settings, tell)[0]


def diagnose_mended(
    model: SymbolicModel,
    record: Record,
    settings: DiagnosisSettings | None = None,
    tell: Callable[[str], None] = lambda words: None,
) -> tuple[Diagnosis, Record]:
    """The same, and the record as it was diagnosed: without what was seen to be no measurement, in the right units."""
    settings = settings or DiagnosisSettings()
    if record.inputs != model.input_names:
        raise UserError(f"the record has inputs {list(record.inputs)}", remedy=f"Give {list(model.input_names)}.")
    budget_s = settings.budget_s
    return answered(budget_s, lambda told: _diagnosed(model, record, settings, Watch(budget_s, told)), tell)


def _diagnosed(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, watch: Watch
) -> tuple[Diagnosis, Record]:
    own, *others = ready(model, record, settings)
    first = _singles(model, own, settings, watch)
    answer = _part_by(model, settings, watch)
    apart = None if first.explained else _apart(own, first.best, answer)  # it costs less than a search
    if apart is not None:
        return apart, own.record
    sought = _sought(own, first)
    looked_again(watch, partial(watch.save, anyhow=True))
    if (others or sought.others) and not sought.settled:
        watch.over = True  # what was saved stands until a hypothesis is found better
        under = looked_again(watch, lambda: [_sought(o, _singles(model, o, settings, watch)) for o in others]) or []
        every = (*sought.others, *(h for each in under for h in (each, *each.others)))
        best = looked_again(watch, lambda: sought.likeliest(every))
        sought = sought if best is None or watch.stopped else best
    found = _concluded(sought)
    if found.verdict in ("partial", "unexplained") and not sought.coloured:
        again = answer if sought.ready is own else _part_by(model, settings, watch)  # columns may be others
        found = _apart(sought.ready, sought.under, again) or found
    return found, sought.ready.record


def _apart(own: Ready, under: Hypothesis, answer: Answer) -> Diagnosis | None:
    """The answer for one side of a change in mid-record; where it lies is not sought in traces that are held out."""
    plain = own.parts.known if under.settings.held_out_traces else own.parts.every
    apart = looked_again(under.watch, lambda: sides_apart(own.record, plain, under.read_on(plain), answer))
    return None if apart is None else replace(apart, recording=(*own.faults, *apart.recording))


@dataclass(frozen=True, eq=False)
class Ready:
    """A record as it is diagnosed.

    Attributes:
        record: without what is no measurement; parts: its folds; said: what is to be said of it; faults: seen in it.
        factors: (k,) from the readings that were logged to these.
    """

    record: Record
    parts: Parts
    said: tuple[str, ...]
    faults: tuple[RecordingFault, ...]
    factors: Floats


@dataclass(frozen=True, eq=False)
class _Sought:
    """A hypothesis of what a record is, once it was sought under it.

    Attributes:
        ready: the record; under: the folds, as far as commands from the record alone act, and what was found on them.
        filtered: velocities that were left out; coloured: whether the noise has a colour.
        judged: folds on whose windows sets compete, its own if not given.
        others: further hypotheses of the same record: that gross errors are no pushes, that columns are others.
    """

    ready: Ready
    under: Hypothesis
    filtered: tuple[RecordingFault, ...]
    coloured: bool
    judged: Parts | None = None
    others: tuple[_Sought, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether what was found is down to the noise, no matter of belief, and of every channel."""
        return self.under.reached and plausible(self.under.found) and not self.filtered

    @cached_property
    def choice(self) -> Chosen:
        """The set that is put to *confirm*; the search is over."""
        self.under.watch.over = True
        return chosen(self.under, self.judged or self.under.parts)

    @cached_property
    def score(self) -> Floats:
        """Log density (b,) of errors ahead, in each block that they were not fitted to, in the units that were logged.

        Empty where there are no blocks to compare, or a channel was left out.
        """
        held = self.choice.held()
        if not held or np.any(self.under.parts.known.heard == 0.0):
            return np.zeros(0)
        size = np.mean([np.log(judged.sigma / np.abs(self.ready.factors)) for _, judged in held])
        return self.choice.predicted - float(size)

    def likeliest(self, others: Sequence[_Sought]) -> _Sought:
        """This hypothesis, or one that surely predicts better; instead of one beyond belief a plausible one as good,
        instead of one that leaves a channel out one that explains all."""
        best = self
        for other in (replace(each, judged=self.under.parts) for each in others):
            gain = gained(best.score, other.score)
            instead = plausible(other.choice.kept) and not plausible(best.choice.kept)
            explains = best.filtered and other.settled
            if gain.sure or explains or (instead and math.isfinite(gain.half) and gain.nats > -gain.half):
                best = other
        return best


def _concluded(sought: _Sought) -> Diagnosis:
    """The answer from what was found: the set that is judged on *confirm*, and what *confirm* says of it."""
    own, under = sought.ready, sought.under
    if under.watch.stopped:  # what is spent is spent: the answer stands on the samples that it was found on
        under = replace(under, parts=replace(under.parts, known=under.search.problem))
        sought = replace(sought, under=under)
    faults = (*own.faults, *sought.filtered)
    return conclude(own.record, under.settings, under.parts, sought.choice, own.said, faults)


@dataclass(frozen=True, eq=False)
class _Singles:
    """A search as far as single effects.

    Attributes:
        start: the search; under: what it found, where one effect of the second tier reaches the noise.
        wide: the search with the second tier, where that was begun.
        explained: whether one effect, or none, is down to the noise.
    """

    start: Hypothesis
    under: Hypothesis | None
    wide: Hypothesis | None
    explained: bool

    @property
    def best(self) -> Hypothesis:
        """The best single effect."""
        start = self.start
        return replace(start, found=best_so_far(start.search, start.base, 1))


def _singles(model: SymbolicModel, own: Ready, settings: DiagnosisSettings, watch: Watch) -> _Singles:
    """Try single effects of the first tier, and of the second where none of them is down to the noise."""
    start = Hypothesis.of(own.parts, settings, barred(model, own.record, settings.effects, settings.known), watch)
    looked_again(watch, watch.save)
    if not start.reached:
        looked_again(watch, lambda: leap_from_beginnings(start.search, start.base, start.most))
    under, wide = screened(start)
    return _Singles(start, under, wide, under is not None or explained(start))


def _sought(own: Ready, first: _Singles) -> _Sought:
    """Search a record on, tier by tier, and again where what was found changes what is known of it."""
    start, under, wide, settings, watch = first.start, first.under, first.wide, first.start.settings, first.start.watch
    robust = None
    if under is None:
        pushed = None if first.explained else under_its_law(start)
        if pushed is not None and pushed.parts.left_out and not (wide and explain_all(wide, pushed.found)):
            under, wide = pushed, None
        else:  # all data by least squares, from the beginning
            law = pushed is not None and not pushed.parts.left_out and not pushed.acts_later
            robust = pushed if law else None
            under = start.searched(passing=True)
        under = second(under, wide) or under
    under = on_its_step(motors(under) or under)
    if under.acts_later:  # commands outside the record are unknown
        known, found = under.parts.known, under.found
        reach = known.reach(found.fit.theta)
        parts = under.parts.past_the_unknown(reach)
        if parts.known.windows.samples < (1.0 - MATTERS) * known.windows.samples:
            why = joined([c.effect.phrase(c.on) for c in found.members if isinstance(c.effect, MemoryInputEffect)])
            own = replace(own, said=(*own.said, _UNKNOWN_PAST.format(reach, why)))
        late = known.ahead(found.fit.theta)
        under = under.on(parts.changed(lambda p: p.before_the_end(late)))
    filtered = () if watch.stopped else tuple(filtered_channels(under.search, under.found))
    if filtered:
        heard = (~np.isin(own.record.measured, [f.channel for f in filtered])).astype(np.float64)
        barring = {**under.not_tried, **{(f.fault, f.channel): "the channel was left out" for f in filtered}}
        fewer = under.anew(under.parts.changed(lambda p: replace(p, heard=heard)), barring)
        under, robust = fewer.with_what(under.found.leaving(barring), math.inf), None
    under = no_louder_than_misses(under, _least_noise(own.record, settings, under.parts))
    louder = under_its_noise(under)
    sought = _Sought(own, louder or under, filtered, louder is not None)
    return sought if robust is None else replace(sought, others=(replace(sought, under=robust),))


def _least_noise(record: Record, settings: DiagnosisSettings, parts: Parts) -> Floats:
    """Standard deviation of each channel that is known, (k,), or that rounding makes."""
    known = np.array([settings.noise.get(name, 0.0) for name in record.measured])
    return np.maximum(known, resolution(record) / np.sqrt(12.0))


def ready(model: SymbolicModel, record: Record, settings: DiagnosisSettings) -> list[Ready]:
    """The record without what a look at it shows to be no measurement; another one where its columns may be others."""
    record, seen = mended(record, model)
    parts, said = parts_of(model, record, settings)
    own = Ready(record, parts, said, seen, np.ones(len(record.measured)))
    columns = better_columns(coarse(parts.known), tuple(velocity_lags(record, model)), settings.within)
    if columns is None:
        return [own]
    record = columns.of_record(record)
    other = Ready(record, *parts_of(model, record, settings), (*seen, columns.finding), columns.y)
    return [other] if columns.sure else [own, other]


def _part_by(model: SymbolicModel, settings: DiagnosisSettings, watch: Watch) -> Answer:
    """Diagnoses a part of the record, each once; only where it comes down to its noise, and nobody interrupts."""

    def diagnosed(part: Record) -> tuple[Diagnosis, Hypothesis] | None:
        names = {trace.name for trace in part.traces}
        held = tuple(n for n in settings.held_out_traces if n in names)
        own_settings = replace(settings, held_out_traces=held if len(held) < len(names) else ())
        try:
            own, apart = ready(model, part, own_settings)[0], Watch(tell=watch.tell)
        except UserError:  # it is too short for three folds
            return None
        sought = _sought(own, _singles(model, own, own_settings, apart))
        answer = _concluded(sought) if sought.under.reached and not apart.stopped else None
        watch.stopped = apart.stopped
        if apart.stopped or answer is None or answer.verdict not in ("none", "attributed"):
            return None
        named, found = {(e.name, e.on) for e in answer.effects}, sought.choice.found
        lost = {c.key for c in found.members if not c.of_recording} - named
        return answer, replace(sought.under, found=found.leaving(lost))

    known: dict[tuple[tuple[str, float], ...], tuple[Diagnosis, Hypothesis] | None] = {}

    def answer(part: Record) -> tuple[Diagnosis, Hypothesis] | None:
        key = tuple((trace.name, float(t)) for trace in part.traces for t in trace.t[[0, -1]])
        if key not in known:
            known[key] = diagnosed(part)
        return known[key]

    return answer
