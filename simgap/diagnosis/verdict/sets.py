"""Sets of effects before they are confirmed: whose members are real, whose halves agree, which one carries over.

Real plants keep something that no effect explains. Its residual is large and smooth, so that samples are not
independent and BIC at the noise level would add effects without end. BIC is therefore taken at the size of that
residual and at its number of independent samples, which ranks sets of each size; among the best of these the log
density of causal errors ahead decides, on parts of the data in turn, each predicted from a fit to the others: gain,
inertia and dry friction can stand for each other within one trace, but only the right one carries over to another.
*confirm* is not seen here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.confidence import chi2_dof, independent_share, standard_errors, undetermined, vanishing
from simgap.diagnosis.search.equivalence import Rival
from simgap.diagnosis.search.explanations import Explanation, Search, sound
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.selection import fit_larger
from simgap.diagnosis.simulation.coarse import JUDGED_ROWS, coarse
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import window_chi2
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN, MATTERS, MOST, PLAUSIBLE_RATIO, SURE, WIDTH
from simgap.diagnosis.verdict.held_out import errors_ahead
from simgap.diagnosis.verdict.score import Errors, gained

_PARTS = 10  # the choice is repeated without each of so many parts of the blocks


def real(search: Search, found: Explanation, at_floor: bool) -> Explanation:
    """Without the effects whose interval contains "no effect", or of no practical size, and with what they contain in
    the place of those that refine it by a number the data do not give, where that is as good; one after another, the
    rest fitted again."""
    while found.members:
        gone = vanished(search, found, at_floor) or (negligible(search, found, found.members) if at_floor else [])
        if gone:
            found = search.without(found, gone[0])
            continue
        loose = undetermined(found.members, found.fit, *errors_of(search, found, at_floor))
        plainer = [search.coarser(found, c) for c in loose]
        as_good = [e for e in plainer if e.bic - found.bic < BIC_GAIN]
        if not as_good:
            break
        found = as_good[0]
    return found


def vanished(search: Search, found: Explanation, at_floor: bool) -> list[Candidate]:
    """Its effects whose 95 % interval contains "no effect"."""
    return vanishing(search.problem, found.members, found.fit, *errors_of(search, found, at_floor))


def errors_of(search: Search, found: Explanation, at_floor: bool) -> tuple[Floats, int]:
    """Standard errors (p,) of what was fitted, and the degrees of freedom of its intervals."""
    return standard_errors(search.problem, found.fit, search.steps, at_floor)


def negligible(search: Search, found: Explanation, among: Sequence[Candidate]) -> list[Candidate]:
    """Members, `among` a few, without which, the rest fitted again, predictions miss by next to nothing of the noise
    more.

    Nothing more is fitted where a search was stopped.
    """
    if search.watch.stopped:
        return []
    bar = MATTERS**2 * search.problem.size
    return [c for c in among if search.without(found, c).fit.chi2 - found.fit.chi2 < bar]


def slight(search: Search, found: Explanation, base: Fit) -> frozenset[Key]:
    """Faults of the recording that account for next to nothing of what the declared model misses.

    They stay fitted, as the noise is smaller still.
    """
    least = MATTERS**2 * (base.chi2 - found.fit.chi2)
    faults = [c for c in found.members if c.of_recording]
    return frozenset(c.key for c in faults if search.without(found, c).fit.chi2 - found.fit.chi2 < least)


def as_good(search: Search, chosen: Explanation) -> list[Rival]:
    """Sets of no more parameters that the data do not tell from the chosen one, best first.

    They are within `AS_GOOD` of it, or as near to the noise and, one window aside, not worse by `BIC_GAIN`: a push that
    nobody saw or a gross error makes a set the better one in a single window. What is a part of it is none: a peak of
    friction, or a limit, may act in one window alone. Larger ones fit better off the noise floor, whatever is missing,
    and did not carry over.
    """
    small = [e for e in search.sound() if e.keys != chosen.keys and e.count <= chosen.count]
    at_noise = search.reached(chosen)
    refined = {(c.effect.contains.name, c.on) for c in chosen.members if c.effect.contains is not None}

    def by_window(e: Explanation) -> Floats:
        return window_chi2(search.problem, e.fit.theta, e.fit.x0) / search.scale

    own = by_window(chosen) if at_noise else np.zeros(0)

    def level(e: Explanation) -> bool:
        worse = e.bic - chosen.bic
        if worse <= AS_GOOD or not at_noise or not search.reached(e) or e.keys <= chosen.keys | refined:
            return worse <= AS_GOOD
        return worse - float(np.max(by_window(e) - own)) < BIC_GAIN

    return [Rival(e, False, True) for e in small if level(e)]


def folds_agree(problem: Problem, found: Explanation, steps: dict[int, float], samples: float) -> bool:
    """Whether two halves of the fitted windows give the same coefficients, within their size or two standard errors.

    What a half does not show at all agrees. `samples` is how many samples one independent sample is worth: the standard
    errors grow with its root.
    """
    w = problem.windows
    traces = np.unique(w.trace)
    half = np.isin(w.trace, traces[: len(traces) // 2]) if len(traces) > 1 else np.arange(len(w)) < len(w) // 2
    if half.all() or not half.any():
        return False
    ends = []
    for side in (half, ~half):
        part = problem.on(w.pick(side))
        ends.append((part, fit(part, found.fit.theta, found.fit.x0[side], found.fit.slots, steps)))
    null, slots = problem.model.null, list(found.fit.slots)
    a, b = (e.theta[slots] - np.where(np.isfinite(null[slots]), null[slots], 0.0) for _, e in ends)
    variances = [e.variances * max(chi2_dof(part, e), 1.0) for part, e in ends]
    spread = np.sqrt(sum(variances) * samples)
    size = np.maximum(np.abs(a), np.abs(b))
    for c in found.members:
        if c.effect.one_curve:  # some of its values are near 0 where others are not
            own = np.isin(slots, c.slots)
            size[own] = size[own].max(initial=0.0)
    near = np.abs(a - b) <= np.maximum(MOST * size, SURE * spread)
    return bool(np.all(near))


Trial = tuple[Problem, Problem]
"""What sets are fitted to, and the part of the data on which they are judged then."""


@dataclass(frozen=True, eq=False)
class Carried:
    """An explanation that carries over, fitted to both folds.

    Attributes:
        search, chosen: what it was found with, and it; rivals: others that do as well.
        agrees: whether halves of the data agree on its coefficients.
        declared, predicted: (b,) log density of the errors ahead in each block, of the model as declared and with the
            set that the other blocks choose, neither fitted to it.
    """

    search: Search
    chosen: Explanation
    rivals: tuple[Explanation, ...]
    agrees: bool
    declared: Floats
    predicted: Floats


def rescaled(search: Search, best: Explanation) -> Search:
    """The same search with BIC at the size of the best explanation's residual and its independent samples."""
    scale = max(1.0, chi2_dof(search.problem, best.fit)) * independent_share(search.problem, best.fit)
    wider = replace(search, scale=scale, tried={})
    wider.tried = {k: replace(e, bic=wider.bic(e.fit.chi2, e.count)) for k, e in search.tried.items()}
    return wider


def _takes_most(search: Search, e: Explanation) -> bool:
    """Whether a set leaves less than `MOST` of what the best with one effect fewer does."""
    smaller = search.sound(len(e.members) - 1)[:1]
    return bool(smaller) and e.fit.chi2 < MOST * smaller[0].fit.chi2


def plausible(e: Explanation) -> bool:
    """Whether no ratio of true to declared is beyond belief: off the noise floor such a fit bends the model to a force
    that it lacks, or a column is in another unit."""
    ratios = [r for c in e.members for r in c.effect.ratios(c.values(e.fit.theta.tolist()))]
    return all(1.0 / PLAUSIBLE_RATIO <= abs(r) <= PLAUSIBLE_RATIO for r in ratios)


def trials(known: Problem, windows: Windows, together: int) -> tuple[Trial, ...]:
    """Each trace in turn, or stretches of a single one, of `together` windows at least, as a prediction needs.

    Sets are fitted to the windows of `known` and judged on others of the same record, so that two searches are judged
    on the same ones.
    """
    at = np.unique(windows.trace, return_inverse=True)[1]
    if not at.any():
        at = np.arange(len(windows)) // together
    count = min(WIDTH, int(at[-1]) + 1)
    part = np.minimum(at * count // (int(at[-1]) + 1), count - 1)
    own = part[np.maximum(np.searchsorted(windows.start, known.windows.start, side="right") - 1, 0)]
    rows = JUDGED_ROWS // max(count, 1)
    return tuple(
        (coarse(known.on(known.windows.pick(own != k))), coarse(known.on(windows.pick(part == k)), rows, together))
        for k in range(count if count > 1 else 0)
    )


def transferable(
    search: Search, base: Fit, best: Explanation, parts: Sequence[Trial], h: float, most: int, largest: int
) -> Carried | None:
    """Of the best sets by BIC the smallest of those that no other surely predicts better than; None if all vanish.

    Sets whose coefficients agree between halves of the data come first; one with a ratio beyond belief is taken where
    no other predicts as well.

    Args:
        search, base, best: what was sought, the model as declared, the best set on it.
        parts: from `trials`; h: how far ahead is predicted, s; most: number of effects that are tried anyhow; largest:
            number of them where each one more took most of what was left away.
    """
    wider = replace(rescaled(search, best).near(best), ends=dict(search.ends))  # what is given up here ends here
    wider.joined(wider.empty(base))
    for size in range(1, most + 1):  # a wider look than the greedy path: the right set need not fit best
        for e in wider.sound(size)[:1]:
            wider.refined(e)
            if size < most:  # what acts alike here need not act alike where a fit of it ends
                wider.joined(e)
        if size < most:
            fit_larger(wider, wider.sound(size)[:WIDTH], size + 1)
    for e in sorted(wider.tried.values(), key=lambda e: e.bic)[:WIDTH]:
        for c in () if e.physical else e.members:  # a smaller set may have ended far from where this one leads
            if not sound(c, e.fit):
                wider.without(e, c)
    pool = [
        e for size in range(1, largest + 1) for e in wider.sound(size)[:WIDTH]
        if e.fit.converged and not vanished(search, e, False)
        and (size <= most or _takes_most(wider, e))
    ]  # fmt: skip
    if not pool:
        return None
    sets = [wider.empty(base), *pool]
    rated = [Rated.of(e, density(e, parts, h, wider.steps)) for e in sets]
    worth = independent_share(search.problem, best.fit)
    steady = [k for k, e in enumerate(pool, 1) if folds_agree(search.problem, e, search.steps, worth)]
    among = steady or range(1, len(sets))
    first, *others = preferred_of(rated, among)
    rivals = [sets[k] for k in others if steady and plausible(sets[k]) and not sets[first].keys < sets[k].keys]
    predicted = density_of_choice(rated, among)
    whole = replace(wider, limit=math.inf, ends=search.ends, tried=wider.finished())
    return Carried(whole, sets[first], tuple(rivals), bool(steady), rated[0].density, predicted)


@dataclass(frozen=True, eq=False)
class Rated:
    """What speaks for a set of effects and against it.

    Attributes:
        density: (b,) log density of its errors ahead in each block; count: parameters; bic: of its fit.
        far: whether a ratio is beyond belief; sensors: how many of its members act on a sensor.
    """

    density: Floats
    count: int
    bic: float
    far: bool = False
    sensors: int = 0

    @staticmethod
    def of(e: Explanation, density: Floats) -> Rated:
        """What speaks for a set that was fitted."""
        return Rated(density, e.count, e.bic, not plausible(e), sum(c.effect.kind == "state" for c in e.members))

    @property
    def known(self) -> bool:
        """Whether its predictions are compared: a prediction that is no number is none."""
        return len(self.density) > 1 and bool(np.isfinite(self.density).all())

    @property
    def mean(self) -> float:
        """Mean log density; each parameter has to take a share of the error away that matters."""
        return float(np.mean(self.density)) + self.count * math.log(1.0 - MATTERS) if self.known else 0.0


def density_of_choice(sets: Sequence[Rated], among: Sequence[int]) -> Floats:
    """Log density (b,) in each block of the set that the rest of them prefers: blocks that choose a set flatter it.

    Source: Varma, Simon (2006), BMC Bioinformatics 7, 91 (nested cross-validation).
    """
    among = [k for k in among if np.isfinite(sets[k].density).all()] or among
    out = np.empty(len(sets[0].density))
    for own in np.array_split(np.arange(len(out)), min(_PARTS, len(out))):
        first = preferred_of([replace(s, density=np.delete(s.density, own)) for s in sets], among)[0]
        out[own] = sets[first].density[own]
    return out


def preferred_of(sets: Sequence[Rated], among: Sequence[int]) -> list[int]:
    """Numbers of the sets, `among` which to choose, that cannot be told from the one that predicts best, best first.

    Two are told apart where one surely predicts better by the spread over blocks, or has the lower BIC: few blocks are
    sure of little, and one of nothing. Of the others those beyond belief come last, the smallest ones first; of sets as
    small the one with fewer members on a sensor, as a sensor off its zero imitates what bends little.
    """
    among = [k for k in among if sets[k].known] or among
    top = sets[max(among, key=lambda k: (sets[k].mean, -sets[k].bic))]
    level = [k for k in among if sets[k].bic <= top.bic + BIC_GAIN and not gained(sets[k].density, top.density).sure]
    return sorted(level, key=lambda k: (sets[k].far, sets[k].count, sets[k].sensors, -sets[k].mean))


def density(e: Explanation, parts: Sequence[Trial], h: float, steps: dict[int, float]) -> Floats:
    """Log density (b,) of the errors ahead on each part of a set fitted to the others, block by block."""
    errors = []
    for known, judged in parts:
        at = fit(known, e.fit.theta, e.fit.begin(known), e.fit.slots, steps) if e.members else e.fit
        errors.append(errors_ahead(judged, at.theta, h))
    return Errors.joined(errors).density() if errors else np.zeros(1)
