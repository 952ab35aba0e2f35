"""Diagnosis: from a declared model and a record to the physical effect that the model lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.change import Answer, sides_apart
from simgap.diagnosis.conclude import Chosen, conclude
from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.push import left_out_by, push_fault, suspected
from simgap.diagnosis.reading.exchanged import put_back
from simgap.diagnosis.reading.hum import without_hum
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.repair import repaired
from simgap.diagnosis.reading.windows import Span
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, Key, RecordingFault
from simgap.diagnosis.search.barred import barred
from simgap.diagnosis.search.columns import better_columns
from simgap.diagnosis.search.equivalence import rivals
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
from simgap.diagnosis.thresholds import FIT_QUALITY, LEAPS_ANYHOW, MOST_COLOURED
from simgap.diagnosis.verdict.faults import filtered_channels
from simgap.diagnosis.verdict.judge import chi2_dof, real
from simgap.diagnosis.verdict.transfer import Trial, transferable
from simgap.diagnosis.widen import clearer, screened, widened
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
    return _answer(model, record, settings, tell, whole=True)


def _answer(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, tell: Callable[[str], None], whole: bool,
    left_out: tuple[Span, ...] | None = None,
) -> Diagnosis:  # fmt: skip
    """The answer for a record; only of a `whole` one it is asked whether the plant changed in the middle.

    `left_out`: times in which nothing is fitted; None: those that stand out, if what is found bears that out.
    """
    given = record
    record, parts, said, faults = mended(model, record, settings)
    not_tried = barred(parts.known.model, record, settings.effects)
    watch = Watch(settings.budget_s, tell)
    begun = _begun(parts.known, not_tried, watch)
    aside = left_out or ()
    if left_out is None and chi2_dof(begun[0].problem, begun[1]) > FIT_QUALITY:
        aside = suspected(parts, *begun, not_tried, settings.max_effects)
    if aside:
        record = replace(record, left_out=aside)
        parts, said = parts_of(model, record, settings)
        begun = _begun(parts.known, not_tried, watch)
    wider = screened(model, record, settings, *begun, not_tried)
    if wider is None:
        search, base, found = _searched(parts.known, settings.max_effects, not_tried, watch, begun=begun)
        wider = widened(model, record, settings, search, found, not_tried)
        wider = wider or clearer(model, record, settings, search, found, not_tried)
    if wider is not None:
        parts, (search, base, found) = wider
    reach, late = parts.known.reach(found.fit.theta), parts.known.ahead(found.fit.theta)
    if late > 0.0 or reach > parts.known.reach(search.problem.model.null):  # commands outside the record are unknown
        parts = parts.past_the_unknown(reach).before_the_end(late)
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
    still = left_out_by(model, record, settings, parts.known, search, found, sought=left_out is None and not aside)
    if still != record.left_out and not watch.stopped:
        return _answer(model, given, replace(settings, budget_s=watch.left), tell, whole, still)
    if still != record.left_out:
        record = replace(record, left_out=still)
        parts, _ = parts_of(model, record, settings, any(c.effect.second for c in parts.known.model.candidates))
        parts = parts.past_the_unknown(reach).before_the_end(late)
        search, base, found = _fitted_again(parts.known, search, found, not_tried)
    pushes = (push_fault(record, parts.known),) if still else ()
    louder = _under_its_noise(parts, search, found, settings.max_effects, not_tried)
    if louder is not None:
        parts, (search, base, found) = louder
    elif whole:
        apart = sides_apart(record, settings, search, found, _part_by(model, watch, tell))
        if apart is not None:
            return replace(apart, recording=(*faults, *apart.recording))
    chosen = _chosen(parts, search, base, found, settings, not_tried)
    return conclude(model, record, settings, parts, chosen, said, (*faults, *pushes, *filtered))


def mended(
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


def _part_by(model: SymbolicModel, watch: Watch, tell: Callable[[str], None]) -> Answer:
    """Diagnoses a part of the record within what is left of the budget."""

    def answer(part: Record, settings: DiagnosisSettings) -> Diagnosis:
        return _answer(model, part, replace(settings, budget_s=watch.left), tell, whole=False)

    return answer


def _under_its_noise(
    parts: Parts, search: Search, found: Explanation, most: int, not_tried: Collection[Key]
) -> tuple[Parts, tuple[Search, Fit, Explanation]] | None:
    """The search again under a noise with a colour, where it then reaches that noise; None where it does not."""
    full = len(found.members) >= min(most, LEAPS_ANYHOW)  # all that it takes anyhow: what is left is no noise
    noise = None if search.watch.stopped or full else _noise(parts.known, search, found)
    if noise is None:
        return None
    louder = parts.with_noise(*noise)
    ends = _searched(louder.known, most, not_tried, search.watch)
    if chi2_dof(ends[0].problem, ends[2].fit) > FIT_QUALITY:  # it was not the noise that was missing
        return None
    return louder, ends


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
        if begun is not None and _acts_later(search, found):  # sought once more without what was commanded before
            return search, base, found
        rivals(search, found)  # what could stand in its place is fitted, and may turn out to be simpler
        return search, base, preferred(search, found, most)
    except Stopped:
        pass
    except KeyboardInterrupt:
        watch.interrupted()
    return search, base, best_so_far(search, base, most)


def _acts_later(search: Search, found: Explanation) -> bool:
    """Whether commands from outside the record act on it under what was found, and not as declared."""
    problem, null = search.problem, search.problem.model.null
    return problem.ahead(found.fit.theta) > 0.0 or problem.reach(found.fit.theta) > problem.reach(null)


def _chosen(
    parts: Parts, search: Search, sparse: Fit, found: Explanation, settings: DiagnosisSettings,
    not_tried: Mapping[Key, str],
) -> Chosen:  # fmt: skip
    """From what the search found to the set that is put to *confirm*, fitted on every sample of the other folds."""
    known = parts.known
    full = search if search.problem is known else Search(known, search.starts)
    base = sparse if full is search else fit(known, known.model.null, initial_states(known), [], {})
    kept = on_all(full, search, found, base)
    at_floor = chi2_dof(known, kept.fit) <= FIT_QUALITY
    agree, carried = True, None
    if found.members and not at_floor:
        together = math.ceil((settings.horizon_s + 0.5 * settings.window_s) / settings.window_s)
        most = min(settings.max_effects, settings.most_off_floor)
        trial = Trial(coarse(parts.fit), coarse(parts.choose, JUDGED_ROWS, together), settings.horizon_s)
        try:
            stopped = bool(search.watch.stopped)
            carried = None if stopped else transferable(search, sparse, found, trial, most)
        except Stopped:
            carried = None
        except KeyboardInterrupt:
            search.watch.interrupted()
        agree = carried is not None and carried.agrees
        if carried is not None:
            search, found = carried.search, carried.chosen
            kept = on_all(full, search, found, base)
    search.watch.over = full.watch.over = True
    return Chosen(search, sparse, found, real(full, kept, at_floor), full, base, carried, at_floor, agree, not_tried)
