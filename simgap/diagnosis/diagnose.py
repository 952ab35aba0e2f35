"""Diagnosis: from a declared model and a record to the physical effect that the model lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from simgap.diagnosis.change import Answer, sides_apart
from simgap.diagnosis.choosing import chosen
from simgap.diagnosis.conclude import conclude
from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.push import left_out_by, one_is_enough, push_fault, suspected
from simgap.diagnosis.record.faults.registry import mended
from simgap.diagnosis.record.folds import Span
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, Key, RecordingFault
from simgap.diagnosis.search.barred import barred
from simgap.diagnosis.search.columns import better_columns
from simgap.diagnosis.search.explanations import Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.seek import Searched, begun, fitted_again, searched, under_its_noise
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.thresholds import FIT_QUALITY
from simgap.diagnosis.tiers import Tiers
from simgap.diagnosis.verdict.answer import filtered_channels
from simgap.diagnosis.verdict.judge import chi2_dof
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel


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
    return _answer(model, record, settings, tell, whole=True)


def _answer(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, tell: Callable[[str], None], whole: bool
) -> Diagnosis:
    """The answer for a record; only of a `whole` one it is asked whether the plant changed in the middle."""
    record, parts, said, faults = ready(model, record, settings)
    watch, not_tried = Watch(settings.budget_s, tell), barred(model, record, settings.effects, settings.known)
    before = begun(parts.known, not_tried, watch)
    aside: tuple[Span, ...] = ()
    if chi2_dof(before[0].problem, before[1]) > FIT_QUALITY and not one_is_enough(*before):
        aside = suspected(parts, *before, not_tried, settings.max_effects)
    sought = not aside  # what stands out under what is found may still be left out, once
    while True:
        if aside != record.left_out:
            record = replace(record, left_out=aside)
            parts, said = parts_of(model, record, settings)
            before = begun(parts.known, not_tried, watch)
        found = _found(model, record, settings, parts, before, not_tried, watch)
        search, _, best = found.ends
        aside = left_out_by(model, record, settings, found.parts.known, search, best, sought=sought)
        if aside == record.left_out or watch.stopped:
            break
        sought = False
    if aside != record.left_out:
        record = replace(record, left_out=aside)
        found = found.left_out(model, record, settings)
    pushes = (push_fault(record, found.parts.known),) if aside else ()
    louder = under_its_noise(found.parts, found.ends, settings.max_effects, found.not_tried)
    if louder is None and whole:
        search, _, best = found.ends
        apart = sides_apart(record, settings, search, best, _part_by(model, watch, tell))
        if apart is not None:
            return replace(apart, recording=(*faults, *apart.recording))
    parts, ends = louder or (found.parts, found.ends)
    if watch.stopped:  # what is spent is spent: the answer stands on the samples that it was found on
        parts = replace(parts, known=ends[0].problem)
    put = chosen(parts, ends, settings, found.not_tried)
    return conclude(model, record, settings, parts, put, said, (*faults, *pushes, *found.filtered))


@dataclass(frozen=True, eq=False)
class _Found:
    """What a search on a record ended with.

    Attributes:
        parts: the folds, as far as commands from the record alone act; ends: the search on them.
        reach, late: how long commands act on, and how late they were logged, s.
        filtered: velocities that were left out; not_tried: candidates that were not, and why.
    """

    parts: Parts
    ends: Searched
    reach: float
    late: float
    filtered: tuple[RecordingFault, ...]
    not_tried: Mapping[Key, str]

    def left_out(self, model: SymbolicModel, record: Record, settings: DiagnosisSettings) -> _Found:
        """The same set, fitted with other times of the record left out."""
        every = self.parts.known.model.candidates
        second, last = any(c.effect.second for c in every), any(c.effect.last for c in every)
        parts, _ = parts_of(model, record, settings, second, last)
        parts = parts.past_the_unknown(self.reach).before_the_end(self.late)
        search, _, found = self.ends
        return replace(self, parts=parts, ends=fitted_again(parts.known, search, found, self.not_tried))


def _found(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, parts: Parts, before: tuple[Search, Fit],
    not_tried: Mapping[Key, str], watch: Watch,
) -> _Found:  # fmt: skip
    """Search a record with what it leaves out as it stands."""
    most = settings.max_effects
    tiers = Tiers(model, record, settings, not_tried)
    wider, wide = tiers.screened(*before)
    if wider is None:
        ends = searched(parts.known, most, not_tried, watch, before=before)
        wider = tiers.second(ends[0], ends[2], wide)
    parts, ends = wider or (parts, ends)
    parts, ends = tiers.motors(ends[0], ends[2]) or (parts, ends)
    search, _, found = ends
    reach, late = parts.known.reach(found.fit.theta), parts.known.ahead(found.fit.theta)
    if late > 0.0 or reach > parts.known.reach(search.problem.model.null):  # commands outside the record are unknown
        parts = parts.past_the_unknown(reach).before_the_end(late)
        if watch.stopped:
            ends = fitted_again(parts.known, search, found, not_tried)
        else:
            ends = searched(parts.known, most, not_tried, watch, (found, chi2_dof(search.problem, found.fit)))
    filtered = () if watch.stopped else tuple(filtered_channels(ends[0], ends[2]))
    if filtered:
        parts = parts.without(np.isin(record.measured, [f.channel for f in filtered]))
        not_tried = {**not_tried, **{(f.fault, f.channel): "the channel was left out" for f in filtered}}
        ends = searched(parts.known, most, not_tried, watch)
    return _Found(parts, ends, reach, late, filtered, not_tried)


def ready(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings
) -> tuple[Record, Parts, tuple[str, ...], tuple[RecordingFault, ...]]:
    """The record without what a look at it shows to be no measurement, its folds, what is to be said, the faults."""
    record, seen = mended(record, model)
    parts, said = parts_of(model, record, settings)
    columns = better_columns(coarse(parts.known))
    if columns is None:
        return record, parts, said, seen
    record = columns.of_record(record)
    return record, *parts_of(model, record, settings), (*seen, columns.finding)


def _part_by(model: SymbolicModel, watch: Watch, tell: Callable[[str], None]) -> Answer:
    """Diagnoses a part of the record within what is left of the budget."""

    def answer(part: Record, settings: DiagnosisSettings) -> Diagnosis:
        return _answer(model, part, replace(settings, budget_s=watch.left), tell, whole=False)

    return answer
