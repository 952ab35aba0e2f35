"""The search from end to end: effects and faults of the recording, whatever each of them changes in the data.

What is found may show that commands from before the record act, that columns are not what the case says, that a
channel was filtered, or that the noise remembers: each changes the problem, and the search is made again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.result import Key, RecordingFault
from simgap.diagnosis.search.columns import better_columns
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.noise_colour import noise_colour
from simgap.diagnosis.search.scoring import list_starts
from simgap.diagnosis.search.selection import best_so_far, carried_over, on_all, preferred, select
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.step_length import settled
from simgap.diagnosis.thresholds import FIT_QUALITY
from simgap.diagnosis.verdict.faults import filtered_channels
from simgap.diagnosis.verdict.judge import chi2_dof

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sought:
    """Where a search stands.

    Attributes:
        parts: the folds as problems, with what was found out about the recording.
        search, base, found: the search on `parts.known`, the model as declared there, what explains it best.
        barred: candidates that were not tried, and why.
        faults: of the recording, found on the way.
    """

    parts: Parts
    search: Search
    base: Fit
    found: Explanation
    barred: Mapping[Key, str]
    faults: tuple[RecordingFault, ...] = ()

    @property
    def reduced(self) -> float:
        """chi^2/dof of what was found."""
        return chi2_dof(self.search.problem, self.found.fit)

    def again(self, parts: Parts, most: int, *faults: RecordingFault) -> Sought:
        """A search from the beginning on other problems."""
        ends = _searched(parts.known, most, self.barred, self.search.watch)
        return Sought(parts, *ends, self.barred, (*self.faults, *faults))


def sought(parts: Parts, most: int, not_tried: Mapping[Key, str], watch: Watch) -> Sought:
    """The best set of at most `most` effects and faults, and the problems on which it stands."""
    columns = better_columns(coarse(parts.known))
    faults: tuple[RecordingFault, ...] = ()
    if columns is not None:
        change, faults = columns.applied, (columns.finding,)
        parts = parts.changed(lambda p: settled(change(p)))
    at = Sought(parts, *_searched(parts.known, most, not_tried, watch), not_tried, faults)
    at = _past_the_unknown(at, most)
    for step in (_unfiltered, _whitened):
        if watch.stopped:
            break
        at = step(at, most)
    return at


def _past_the_unknown(at: Sought, most: int) -> Sought:
    """Commands from before the record are unknown: what they may still act on is masked."""
    known, search, found = at.parts.known, at.search, at.found
    reach = known.reach(found.fit.theta)
    if reach <= known.reach(search.problem.model.null):
        return at
    parts = at.parts.past_the_unknown(reach)
    if search.watch.stopped:
        return Sought(parts, *_fitted_again(parts.known, search, found, at.barred), at.barred, at.faults)
    ends = _searched(parts.known, most, at.barred, search.watch, (found, at.reduced))
    return Sought(parts, *ends, at.barred, at.faults)


def _unfiltered(at: Sought, most: int) -> Sought:
    """Without velocities that were found to be filtered."""
    faults = filtered_channels(at.search, at.found)
    if not faults:
        return at
    left_out = {(f.fault, f.channel): "the channel was left out" for f in faults}
    parts = at.parts.without(np.isin(at.parts.known.model.measured, [f.channel for f in faults]))
    return replace(at, barred={**at.barred, **left_out}).again(parts, most, *faults)


def _whitened(at: Sought, most: int) -> Sought:
    """With the law of the noise, where what was found leaves more than white noise and that is no trace of a force."""
    if at.reduced <= FIT_QUALITY:
        return at
    known, fitted = at.parts.known, at.found.fit
    if at.search.problem is not known:
        fitted = fit(known, fitted.theta, initial_states(known), [], {})
    law = noise_colour(known, fitted.theta, fitted.x0)
    return at if law is None else at.again(at.parts.with_noise(*law), most)


def _fitted_again(
    problem: Problem, search: Search, found: Explanation, not_tried: Collection[Key]
) -> tuple[Search, Fit, Explanation]:
    """What a search found before it was stopped, fitted on another problem; nothing else is tried there."""
    sought = coarse(problem)
    base = fit(sought, sought.model.null, initial_states(sought), [], {})
    again = Search(sought, list_starts(sought, not_tried), watch=search.watch)
    return again, base, on_all(again, search, found, base)


def _searched(
    problem: Problem, most: int, not_tried: Collection[Key], watch: Watch,
    known: tuple[Explanation, float] | None = None,
) -> tuple[Search, Fit, Explanation]:  # fmt: skip
    """A search on the problem, the model as declared, and what explains it best; begun from what is `known`.

    What is known comes with its chi^2/dof where it was found. A search that is stopped ends with its best so far.
    """
    sought = coarse(problem)
    base = fit(sought, sought.model.null, initial_states(sought), [], {})
    search = Search(sought, list_starts(sought, not_tried), watch=watch)
    try:
        found = select(search, base, most) if known is None else carried_over(search, base, *known, most)
        rivals(search, found)  # what could stand in its place is fitted, and may turn out to be simpler
        return search, base, preferred(search, found, most)
    except Stopped:
        pass
    except KeyboardInterrupt:
        watch.interrupted()
    return search, base, best_so_far(search, base, most)
