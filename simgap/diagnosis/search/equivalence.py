"""What the data cannot tell apart: near-ties by BIC, exact equivalences by the rank of the sensitivities."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.measurement import ReadingFault
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import EQUIVALENT_CHI2
from simgap.diagnosis.simulation.sensitivity import scaled, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN, COLLINEAR, MOST, WIDTH

EXACTLY_COLLINEAR = 1.0 - 1e-6
"""Projected sensitivities with a larger correlation are the same direction, up to rounding."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A set of effects that explains the data as well; `exact` if it predicts the same whatever the motion."""

    explanation: Explanation
    exact: bool


def rivals(search: Search, chosen: Explanation) -> list[Rival]:
    """All sets within `BIC_GAIN` of the chosen one, best first, each once.

    Each effect is replaced by others in turn, then whole sets by others whose sensitivities span the same space. A set
    that only adds effects to another one on the list is left out.
    """
    if not chosen.members:
        return []
    for member in chosen.members:
        base = search.without(chosen, member)
        floor = base.fit.chi2 - chosen.fit.chi2
        ranked = [
            s for s in search.ranked(base) if s.candidate.key != member.key and s.candidate.key not in chosen.keys
        ]
        for s in [s for s in ranked if s.drop / search.scale > BIC_GAIN and s.drop > MOST * floor][:WIDTH]:
            search.extend(base, s)
        for c in _stand_ins(search, member):
            own = {c.slots[0]: float(chosen.fit.theta[member.slots[0]])}
            search.explain((*base.members, c), with_values(base.fit.theta, own), chosen.fit)
    spanned, gram = _spanned(search, chosen)
    for members in _other_sets(chosen, spanned, gram):
        theta = _reset(search, chosen, members)
        search.explain(members, theta, chosen.fit, again=True)  # an earlier start may have ended elsewhere
    return _listed(search, chosen, {c.key for c in spanned})


def _stand_ins(search: Search, member: Candidate) -> list[Candidate]:
    """Faults of a reading that look as an effect does, which are tried in its place alone."""
    return [
        c for c in search.problem.model.candidates
        if isinstance(c.effect, ReadingFault) and member.effect.name in c.effect.stands_for
        and (member.effect.kind == "input" or member.on == c.on)
    ]  # fmt: skip


def as_good(search: Search, chosen: Explanation) -> list[Rival]:
    """Sets of no more parameters that were fitted and are within `AS_GOOD` of the chosen one, best first.

    Larger ones fit better off the noise floor, whatever is missing, and did not carry over.
    """
    close = [
        e for e in search.tried.values()
        if e.physical and e.members and e.keys != chosen.keys and e.count <= chosen.count
        and e.bic <= chosen.bic + AS_GOOD
    ]  # fmt: skip
    return [Rival(e, False) for e in sorted(close, key=lambda e: e.bic)]


def once(listed: Iterable[Rival]) -> list[Rival]:
    """The first of each set of effects."""
    return list({r.explanation.keys: r for r in reversed(list(listed))}.values())[::-1]


def _listed(search: Search, chosen: Explanation, spanned: set[Key]) -> list[Rival]:
    close = [
        e for e in search.tried.values()
        if e.physical and e.members and e.keys != chosen.keys and e.bic < chosen.bic + BIC_GAIN
    ]  # fmt: skip
    close.sort(key=lambda e: (e.count, e.bic))
    kept: list[Explanation] = [chosen]
    found = []
    for e in close:
        if any(other.keys <= e.keys for other in kept):
            continue
        kept.append(e)
        same = e.fit.chi2 - chosen.fit.chi2 < EQUIVALENT_CHI2 * search.scale and e.count == chosen.count
        found.append(Rival(e, same and e.keys <= spanned | chosen.keys))
    return sorted(found, key=lambda r: r.explanation.bic)


def _spanned(search: Search, chosen: Explanation) -> tuple[list[Candidate], Floats]:
    """Candidates whose projected sensitivity lies in the span of the chosen effects' at the fitted point.

    With the normalised Gram matrix of the free slots of the chosen effects, then of these candidates.
    """
    seen = search.screen(chosen)
    gram, own = scaled(seen.gram)[0], list(range(seen.own))
    inside = [
        (c, j) for c, start, (j, *more) in seen.asked
        if not more and start.amplitude is None and _in_span(gram, own, j)
    ]  # fmt: skip
    kept = [*own, *(j for _, j in inside)]
    return [c for c, _ in inside], np.asarray(gram[np.ix_(kept, kept)])


def _in_span(gram: Floats, among: list[int], j: int) -> bool:
    """Whether direction j lies in the span of others, by their Gram matrix."""
    weights = np.linalg.lstsq(gram[np.ix_(among, among)], gram[among, j], rcond=1e-9)[0]
    return float(weights @ gram[among, j]) > EXACTLY_COLLINEAR**2


def _other_sets(chosen: Explanation, spanned: list[Candidate], gram: Floats) -> list[tuple[Candidate, ...]]:
    """Other sets of the same size that span what the chosen one does; those with two effects replaced or more first,
    since single replacements were fitted already."""
    free = [[j for j, k in enumerate(chosen.fit.slots) if k in c.slots] for c in chosen.members]
    first = len(chosen.fit.slots)
    pool = [*zip(chosen.members, free, strict=True), *((c, [first + n]) for n, c in enumerate(spanned))]
    sets = []
    for picked in itertools.combinations(pool, len(chosen.members)):
        members = tuple(c for c, _ in picked)
        directions = [j for _, own in picked for j in own]
        others = [j for j in range(first) if j not in directions]
        if others and all(_in_span(gram, directions, j) for j in others):
            sets.append(members)
    sets.sort(key=lambda s: len({c.key for c in s} - chosen.keys) == 1)
    return sets[: 2 * WIDTH]


def _reset(search: Search, chosen: Explanation, members: tuple[Candidate, ...]) -> Floats:
    """Start of a set: shared effects as fitted, everything else at its null."""
    keys = {c.key for c in members}
    gone = [k for c in chosen.members if c.key not in keys for k in c.slots]
    return with_values(chosen.fit.theta, {k: float(search.problem.model.null[k]) for k in gone})


def collinear_pairs(search: Search, base: Explanation) -> list[tuple[Key, Key, float]]:
    """Pairs of candidates whose sensitivities around the declared model correlate above `COLLINEAR`, closest first."""
    seen = search.screen(base)
    first: dict[Key, int] = {}
    for c, _, (j, *more) in seen.asked:
        if not more:
            first.setdefault(c.key, j)
    gram = np.abs(scaled(seen.gram)[0])
    pairs = [
        (a, b, min(float(gram[first[a], first[b]]), 1.0))
        for b, a in itertools.combinations(first, 2) if gram[first[a], first[b]] > COLLINEAR
    ]  # fmt: skip
    return sorted(pairs, key=lambda pair: -pair[2])
