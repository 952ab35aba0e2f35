"""What the data cannot tell apart: near-ties by BIC, exact equivalences by the rank of the sensitivities."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.measurement import ReadingFault
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import EQUIVALENT_CHI2
from simgap.diagnosis.search.scoring import begun_at
from simgap.diagnosis.simulation.sensitivity import scaled, with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import BIC_GAIN, COLLINEAR, WIDTH
from simgap.effects.base import Start

EXACTLY_COLLINEAR = 1.0 - 1e-6
"""Projected sensitivities with a larger correlation are the same direction, up to rounding."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A set of effects that explains the data as well.

    Attributes:
        exact: whether it predicts the same whatever the motion; level: whether the data do not decide surely.
    """

    explanation: Explanation
    exact: bool
    level: bool = False


def rivals(search: Search, chosen: Explanation) -> list[Rival]:
    """All sets within `BIC_GAIN` of the chosen one, best first, each once.

    Each effect is replaced by others in turn, then whole sets by others whose sensitivities span the same space, and an
    effect by one number that moves the predictions nearly as its own do, begun there; where the search was stopped,
    those that it fitted are listed. A set that only adds effects to another one on the list is left out.
    """
    if not chosen.members:
        return []
    return _listed(search, chosen, set() if search.watch.stopped else _fitted(search, chosen))


def _fitted(search: Search, chosen: Explanation) -> set[Key]:
    """Fit what could stand in the place of the chosen effects, as long as it comes near; the candidates whose
    sensitivities lie in their span."""
    near, reached = search.near(chosen), search.reached(chosen)
    for member in chosen.members:
        base = search.without(chosen, member)
        near.joined(base, chosen.keys)
        for c in _stand_ins(search, member):
            own = {c.slots[0]: float(chosen.fit.theta[member.slots[0]])}
            near.explain((*base.members, c), with_values(base.fit.theta, own), chosen.fit)
    null, span = search.problem.model.null, _Span.around(search, chosen)
    inside = span.inside()
    for members, columns in [*_other_sets(chosen, span, inside), *(_alike(chosen, span, null) if reached else [])]:
        theta = _begun(chosen, null, span, members, columns if reached else [])
        near.explain(members, theta, chosen.fit, again=True)  # an earlier start may have ended elsewhere
    return {c.key for c in inside.values()}


def _stand_ins(search: Search, member: Candidate) -> list[Candidate]:
    """Faults of a reading that look as an effect does, which are tried in its place alone."""
    return [
        c for c in search.problem.model.candidates
        if isinstance(c.effect, ReadingFault) and member.effect.name in c.effect.stands_for
        and (member.effect.kind == "input" or member.on == c.on)
    ]  # fmt: skip


def once(listed: Iterable[Rival]) -> list[Rival]:
    """Each set of effects once: exact, and level, if it is so anywhere on the list."""
    own: dict[frozenset[Key], Rival] = {}
    for r in listed:
        known = own.setdefault(r.explanation.keys, r)
        own[r.explanation.keys] = replace(known, exact=known.exact or r.exact, level=known.level or r.level)
    return list(own.values())


def _listed(search: Search, chosen: Explanation, spanned: set[Key]) -> list[Rival]:
    close = [e for e in search.sound() if e.keys != chosen.keys and e.bic < chosen.bic + BIC_GAIN]
    kept: list[Explanation] = [chosen]
    found = []
    for e in sorted(close, key=lambda e: (e.count, e.bic)):
        if any(other.keys <= e.keys for other in kept):
            continue
        kept.append(e)
        same = e.fit.chi2 - chosen.fit.chi2 < EQUIVALENT_CHI2 * search.scale and e.count == chosen.count
        found.append(Rival(e, same and (e.keys <= spanned | chosen.keys or _spans(search, e, chosen))))
    return sorted(found, key=lambda r: r.explanation.bic)


def _spans(search: Search, other: Explanation, chosen: Explanation) -> bool:
    """Whether the chosen effects lie in the span of another set's: one with a kink has no direction away from its null.

    On a command of one sign a dead zone is a bias."""
    inside = _Span.around(search, other).inside()
    return chosen.keys <= {c.key for c in inside.values()} | other.keys


_Set = tuple[tuple[Candidate, ...], list[int]]
"""Members, and the columns that are theirs."""


@dataclass(frozen=True, eq=False)
class _Span:
    """What the chosen effects and others do to the predictions, around the fit.

    Attributes:
        own: the chosen effects' free slots, one column each; joining: candidates with a start of one column each.
        gram, size: normalised Gram matrix and sizes of the columns, in that order.
    """

    own: int
    joining: tuple[tuple[Candidate, Start], ...]
    gram: Floats
    size: Floats

    @staticmethod
    def around(search: Search, chosen: Explanation) -> _Span:
        seen = search.screen(chosen)
        single = [(c, start, j) for c, start, (j, *more) in seen.asked if not more and start.amplitude is None]
        gram, size = scaled(seen.gram)
        kept = [*range(seen.own), *(j for *_, j in single)]
        return _Span(seen.own, tuple((c, start) for c, start, _ in single), gram[np.ix_(kept, kept)], size[kept])

    def inside(self) -> dict[int, Candidate]:
        """Candidates whose column lies in the span of the chosen effects', by that column."""
        own = range(self.own)
        return {j: c for j, (c, _) in enumerate(self.joining, self.own) if self.holds(own, j)}

    def holds(self, among: Sequence[int], j: int) -> bool:
        """Whether column j lies in the span of others."""
        return self.share(among, [j], np.ones(1)) > EXACTLY_COLLINEAR**2

    def share(self, among: Sequence[int], gone: Sequence[int], away: Floats) -> float:
        """Share of what steps `away` along `gone` do (of its square) that steps along `among` can do."""
        step, back = away * self.size[gone], self.instead(among, gone, away) * self.size[among]
        whole = float(step @ self.gram[np.ix_(gone, gone)] @ step)
        return float(back @ self.gram[np.ix_(among, gone)] @ step) / max(whole, 1e-300)

    def instead(self, among: Sequence[int], gone: Sequence[int], away: Floats) -> Floats:
        """Steps along `among` that do what steps `away` along `gone` do."""
        moved = self.gram[np.ix_(among, gone)] @ (away * self.size[gone])
        return np.asarray(np.linalg.lstsq(self.gram[np.ix_(among, among)], moved, rcond=1e-9)[0] / self.size[among])


def _columns(chosen: Explanation) -> list[list[int]]:
    """The columns of each chosen effect."""
    return [[j for j, k in enumerate(chosen.fit.slots) if k in c.slots] for c in chosen.members]


def _other_sets(chosen: Explanation, span: _Span, inside: Mapping[int, Candidate]) -> list[_Set]:
    """Other sets of the same size that span what the chosen one does; those with two effects replaced or more first,
    since single replacements were fitted already."""
    pool = [*zip(chosen.members, _columns(chosen), strict=True), *((c, [j]) for j, c in inside.items())]
    sets: list[_Set] = []
    for picked in itertools.combinations(pool, len(chosen.members)):
        members = tuple(c for c, _ in picked)
        directions = [j for _, own in picked for j in own]
        others = [j for j in range(span.own) if j not in directions]
        if others and all(span.holds(directions, j) for j in others):
            sets.append((members, directions))
    sets.sort(key=lambda s: len({c.key for c in s[0]} - chosen.keys) == 1)
    return sets[: 2 * WIDTH]


def _alike(chosen: Explanation, span: _Span, null: Floats) -> list[_Set]:
    """Sets with one number in the place of an effect's own, one or several, where it does nearly what these do: begun
    there, a fit does not wander off."""
    sets: list[_Set] = []
    for member, gone in zip(chosen.members, _columns(chosen), strict=True):
        rest = tuple(c for c in chosen.members if c is not member)
        kept = [j for j in range(span.own) if j not in gone]
        away, joining = _away(chosen, gone, null), {j: c for j, (c, _) in enumerate(span.joining, span.own)}
        shares = {j: span.share([*kept, j], gone, away) for j in joining}
        near = sorted((j for j in joining if shares[j] > COLLINEAR**2), key=lambda j: -shares[j])
        sets += [((*rest, joining[j]), [*kept, j]) for j in near[:WIDTH]]
    return sets


def _away(chosen: Explanation, columns: list[int], null: Floats) -> Floats:
    """How far what stands in these columns is from its null; shapes stay, as what they belong to is gone."""
    slots = [chosen.fit.slots[j] for j in columns]
    acting = [k for c in chosen.members for p, k in zip(c.effect.parameters, c.slots, strict=True) if not p.shape]
    return np.where(np.isin(slots, acting), chosen.fit.theta[slots] - null[slots], 0.0)


def _begun(
    chosen: Explanation, null: Floats, span: _Span, members: tuple[Candidate, ...], columns: list[int]
) -> Floats:
    """Start of a set (q,): what is gone at its null, its columns where they predict the same, to first order."""
    slots, theta = chosen.fit.slots, chosen.fit.theta
    gone = [j for j in range(span.own) if j not in columns] if columns else []
    values = {k: float(null[k]) for c in chosen.members if c not in members for k in c.slots}
    for j, step in zip(columns, span.instead(columns, gone, _away(chosen, gone, null)).tolist(), strict=True):
        if j < span.own:
            values[slots[j]] = float(theta[slots[j]]) + step
        else:
            values |= begun_at(*span.joining[j - span.own], np.array([step])) or {}
    return with_values(theta, values)


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
