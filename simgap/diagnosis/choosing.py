"""From what a search found to the set that is put to *confirm*."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

from simgap.arrays import Floats
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, states_fitted
from simgap.diagnosis.search.selection import by_place, fitted_here, taken_over
from simgap.diagnosis.seek import Hypothesis, looked_again
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.verdict.sets import Carried, Trial, density, real, transferable, trials


@dataclass(frozen=True, eq=False)
class Chosen:
    """What fit and choose ended with.

    Attributes:
        under: the search, on fewer samples where there are many; judged: folds on whose windows sets compete.
        full, base: a search on every sample, and the model as declared there.
        carried: from the choice off the noise floor.
        found: what was chosen on the samples that were searched; kept: the same on every sample.
        at_floor: whether the fit reaches the noise and sets were not made to compete.
        held: parts of the data, each with what a set that is judged on it is fitted to.
    """

    under: Hypothesis
    judged: Parts
    full: Search
    base: Fit
    carried: Carried | None
    found: Explanation
    kept: Explanation
    at_floor: bool
    held: Callable[[], Sequence[Trial]]

    @property
    def search(self) -> Search:
        """What the set was chosen with."""
        return self.under.search if self.carried is None else self.carried.search

    @property
    def agree(self) -> bool:
        """Whether halves of the data give the same coefficients, where sets competed."""
        alone = self.at_floor or not self.under.found.members
        return alone or (self.carried is not None and self.carried.agrees)

    @cached_property
    def predicted(self) -> Floats:
        """Log density (b,) of its errors ahead in each block, fitted to others.

        Of the model as declared where no set carries over.
        """
        if self.carried is not None:
            return self.carried.predicted
        put = self.kept if self.at_floor else self.full.empty(self.base)
        return density(put, self.held(), self.under.parts.horizon_s, self.full.steps)

    def less(self, kept: Explanation) -> Chosen:
        """The same with a part of what was chosen alone."""
        return replace(self, kept=kept, found=taken_over(self.search, self.under.base, kept))

    def competing(self) -> Chosen:
        """The same with the set that predicts best, whether the fit reaches the noise or not."""
        return chosen(self.under, self.judged, compete=True)


def chosen(under: Hypothesis, judged: Parts, compete: bool = False) -> Chosen:
    """The set that is put to *confirm*, fitted on every sample of the other folds.

    Off the noise floor sets `compete` by their predictions of the windows of `judged`; at it, if they are made to.
    """
    known, horizon_s, settings = under.parts.known, under.parts.horizon_s, under.settings
    search, sparse, found = under.search, under.base, under.found
    full = search if search.problem is known else Search(known, search.starts)
    base = sparse if full is search else states_fitted(known, known.model.null)
    kept = found if full is search else fitted_here(full, base, found)
    at_floor = full.reached(kept) and not compete
    together = math.ceil((horizon_s + 0.5 * judged.window_s) / judged.window_s)
    held = cache(partial(trials, known, judged.known.windows, together))
    carried = None
    if found.members and not at_floor:
        most = min(settings.max_effects, settings.most_off_floor)
        carried = looked_again(
            under.watch,
            lambda: transferable(search, sparse, found, held(), horizon_s, most, settings.max_effects),
        )
    if carried is not None:
        search, found = carried.search, carried.chosen
        same = [r.explanation for r in rivals(search, found) if r.exact]
        found = min((found, *same), key=by_place)
        kept = found if full.problem is search.problem else fitted_here(full, base, found)
    kept = real(full, kept, at_floor)
    found = found if found.keys == kept.keys else taken_over(search, sparse, kept)
    return Chosen(under, judged, full, base, carried, found, kept, at_floor, held)
