"""From what a search found to the set that is put to *confirm*."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce

from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.selection import by_place, fitted_here
from simgap.diagnosis.seek import Searched, looked_again
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.thresholds import FIT_QUALITY
from simgap.diagnosis.verdict.score import gained
from simgap.diagnosis.verdict.sets import Carried, real, transferable, trials


@dataclass(frozen=True, eq=False)
class Chosen:
    """What fit and choose ended with.

    Attributes:
        search, sparse: the search, on fewer samples where there are many, and the model as declared there.
        found: what it chose there; kept: the same on every sample.
        full, base: a search on every sample, and the model as declared there.
        carried: from the choice off the noise floor.
        at_floor: whether the fit reaches the noise; agree: whether halves of the data give the same coefficients.
        barred: candidates that were not tried, and why.
    """

    search: Search
    sparse: Fit
    found: Explanation
    kept: Explanation
    full: Search
    base: Fit
    carried: Carried | None
    at_floor: bool
    agree: bool
    barred: Mapping[Key, str]

    def predicts_better_than(self, other: Chosen) -> bool:
        """Whether its set surely predicts better than another's, or than the model as declared where that has none."""
        if self.carried is None:
            return False
        than = self.carried.declared if other.carried is None else other.carried.predicted
        return gained(than, self.carried.predicted).sure

    def less(self, kept: Explanation) -> Chosen:
        """The same with some effects of what was chosen alone."""
        gone = [c for c in self.found.members if c.key not in kept.keys]
        return replace(self, kept=kept, found=reduce(self.search.without, gone, self.found))


def chosen(
    parts: Parts, ends: Searched, settings: DiagnosisSettings, not_tried: Mapping[Key, str], judged: Windows
) -> Chosen:
    """The set that is put to *confirm*, fitted on every sample of the other folds.

    Off the noise floor sets compete by their predictions of the windows `judged`.
    """
    known, (search, sparse, found) = parts.known, ends
    full = search if search.problem is known else Search(known, search.starts)
    base = sparse if full is search else fit(known, known.model.null, initial_states(known), [], {})
    kept = found if full is search else fitted_here(full, base, found)
    at_floor = chi2_dof(known, kept.fit) <= FIT_QUALITY
    agree, carried = True, None
    if found.members and not at_floor:
        together = math.ceil((settings.horizon_s + 0.5 * parts.window_s) / parts.window_s)
        most = min(settings.max_effects, settings.most_off_floor)
        held = trials(known, judged, together)
        carried = looked_again(
            search.watch, lambda: transferable(*ends, held, settings.horizon_s, most, settings.max_effects)
        )
        agree = carried is not None and carried.agrees
        if carried is not None:
            search, found = carried.search, carried.chosen
            same = [r.explanation for r in rivals(search, found) if r.exact]
            found = min((found, *same), key=by_place)
            kept = found if full.problem is search.problem else fitted_here(full, base, found)
    return Chosen(search, sparse, found, real(full, kept, at_floor), full, base, carried, at_floor, agree, not_tried)
