"""From what a search found to the set that is put to *confirm*."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

from simgap.arrays import Floats
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.selection import by_place, fitted_here, taken_over
from simgap.diagnosis.seek import Hypothesis, looked_again
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.thresholds import FIT_QUALITY
from simgap.diagnosis.verdict.sets import Carried, Trial, density, real, transferable, trials


@dataclass(frozen=True, eq=False)
class Chosen:
    """What fit and choose ended with.

    Attributes:
        search, sparse: the search, on fewer samples where there are many, and the model as declared there.
        found: what it chose there; kept: the same on every sample.
        full, base: a search on every sample, and the model as declared there.
        carried: from the choice off the noise floor.
        held: parts of the data, each with what a set that is judged on it is fitted to.
        horizon_s: how far ahead is predicted, s.
        at_floor: whether the fit reaches the noise; agree: whether halves of the data give the same coefficients.
        barred: candidates that were not tried, and why.
        competing: the same with the set that predicts best, whether the fit reaches the noise or not.
    """

    search: Search
    sparse: Fit
    found: Explanation
    kept: Explanation
    full: Search
    base: Fit
    carried: Carried | None
    held: Callable[[], Sequence[Trial]]
    horizon_s: float
    at_floor: bool
    agree: bool
    barred: Mapping[Key, str]
    competing: Callable[[], Chosen]

    @cached_property
    def predicted(self) -> Floats:
        """Log density (b,) of its errors ahead in each block, fitted to others.

        Of the model as declared where no set carries over.
        """
        if self.carried is not None:
            return self.carried.predicted
        put = self.kept if self.at_floor else self.full.empty(self.base)
        return density(put, self.held(), self.horizon_s, self.full.steps)

    def less(self, kept: Explanation) -> Chosen:
        """The same with a part of what was chosen alone."""
        return replace(self, kept=kept, found=taken_over(self.search, self.sparse, kept))


def chosen(under: Hypothesis, judged: Parts, compete: bool = False) -> Chosen:
    """The set that is put to *confirm*, fitted on every sample of the other folds.

    Off the noise floor sets `compete` by their predictions of the windows of `judged`; at it, if they are made to.
    """
    known, settings = under.parts.known, under.settings
    search, sparse, found = under.search, under.base, under.found
    full = search if search.problem is known else Search(known, search.starts)
    base = sparse if full is search else fit(known, known.model.null, initial_states(known), [], {})
    kept = found if full is search else fitted_here(full, base, found)
    at_floor = chi2_dof(known, kept.fit) <= FIT_QUALITY and not compete
    horizon_s = under.parts.horizon_s
    together = math.ceil((horizon_s + 0.5 * judged.window_s) / judged.window_s)
    held = cache(partial(trials, known, judged.known.windows, together))
    agree, carried = True, None
    if found.members and not at_floor:
        most = min(settings.max_effects, settings.most_off_floor)
        carried = looked_again(
            under.watch,
            lambda: transferable(search, sparse, found, held(), horizon_s, most, settings.max_effects),
        )
        agree = carried is not None and carried.agrees
        if carried is not None:
            search, found = carried.search, carried.chosen
            same = [r.explanation for r in rivals(search, found) if r.exact]
            found = min((found, *same), key=by_place)
            kept = found if full.problem is search.problem else fitted_here(full, base, found)
    kept = real(full, kept, at_floor)
    found = found if found.keys == kept.keys else taken_over(search, sparse, kept)
    competing = partial(chosen, under, judged, True)
    return Chosen(
        search, sparse, found, kept, full, base, carried, held, horizon_s, at_floor, agree, under.not_tried, competing
    )
