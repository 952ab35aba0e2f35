"""Sets of effects, fitted: one search over one problem, in which everything that is tried is kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import Key
from simgap.diagnosis.search.confidence import at_noise, misfit
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.scoring import Score, Screen, Starts, best_of_each, score, screen, visited
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import choose_steps, inverted, with_values
from simgap.diagnosis.simulation.step_length import resolved
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import BIC_GAIN, COLLINEAR, NEAR, OUT_OF_SIGHT, WIDTH
from simgap.notation import joined

SAME, SAME_PROMISE = 0.1, 1e-5
"""Fits whose chi^2, or BIC, differ by less are one; candidates whose promised drops differ by a smaller share are one
direction, refitted once."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A set of effects, fitted.

    Attributes:
        members: the effects.
        fit: the fit with their parameters free.
        bic: chi^2 over `scale` plus k log N; numbers that begin a window beyond the plant's cost what each takes away
            of chi^2 by chance.
        physical: whether every coefficient has its sign and none vanished.
    """

    members: tuple[Candidate, ...]
    fit: Fit
    bic: float
    physical: bool

    @property
    def keys(self) -> frozenset[Key]:
        """Names and targets."""
        return frozenset(c.key for c in self.members)

    def leaving(self, keys: Collection[Key]) -> Explanation:
        """The rest of it with the numbers that it has, not fitted again."""
        return replace(self, members=tuple(c for c in self.members if c.key not in keys))

    @property
    def count(self) -> int:
        """Number of parameters, discrete choices included."""
        return sum(len(c.slots) for c in self.members)


@dataclass(eq=False)
class Search:
    """One search over one problem: everything that is tried is fitted once and kept.

    A fit that stays above `limit` by its own linear problems, or `OUT_OF_SIGHT` times the chi^2 of a set that has
    reached the noise, is given up, and no other start of that set is tried. One from another start of a set is given up
    where it promises no lower end.
    """

    problem: Problem
    starts: Starts
    scale: float = 1.0
    steps: dict[int, float] = field(default_factory=dict)
    tried: dict[tuple[frozenset[Key], tuple[float, ...]], Explanation] = field(default_factory=dict)
    screens: dict[tuple[frozenset[Key], float], Screen] = field(default_factory=dict)
    every: dict[frozenset[Key], list[Score]] = field(default_factory=dict)
    ends: dict[tuple[tuple[int, ...], bytes, bytes], tuple[Fit, dict[int, float]]] = field(default_factory=dict)
    watch: Watch = field(default_factory=Watch)
    limit: float = math.inf

    def empty(self, base: Fit) -> Explanation:
        """The model as declared."""
        return Explanation((), base, self.bic(base.chi2, 0), True)

    def bic(self, chi2: float, count: int) -> float:
        """chi^2 / scale + k log N."""
        return chi2 / self.scale + count * math.log(self.problem.size)

    def extend(self, base: Explanation, s: Score) -> Explanation:
        """Fit the base and one more effect, begun where its score says; at each of its starts if it bends much, where
        that comes in sight and leaves more than noise; else from where what it contains ends."""
        members = (*base.members, s.candidate)
        known = self._key(members, with_values(base.fit.theta, s.values)) in self.tried
        found = self.explain(members, with_values(base.fit.theta, s.values), base.fit)
        bends = len(s.candidate.slots) > 2 or s.candidate.effect.several_valleys
        if known or not bends or s.candidate.free != s.candidate.slots:
            return found
        if found.fit.chi2 > self._in_sight():
            found = self._from_contained(base, s) or found
        if found.fit.chi2 <= self._in_sight():
            starts = [other for other in self.every[base.keys] if other.candidate.key == s.candidate.key]
            for other in () if self.reached(found) else starts:
                if other is not s:
                    found = self.explain(members, with_values(base.fit.theta, other.values), base.fit, again=True)
            for start in starts:
                found = self._from_contained(base, start) or found
        return found

    def near(self, known: Explanation) -> Search:
        """The same search for what is to come near a set: no other fit is ended."""
        return replace(self, limit=min(self.limit, NEAR * known.fit.chi2))

    def finished(self) -> dict[tuple[frozenset[Key], tuple[float, ...]], Explanation]:
        """What was tried and not given up."""
        return {k: e for k, e in self.tried.items() if e.fit.converged or e.fit.chi2 <= self.limit}

    def _in_sight(self) -> float:
        """The largest chi^2 that serves."""
        reached = (e.fit.chi2 for e in self.tried.values() if e.physical and self.reached(e))
        return min(self.limit, OUT_OF_SIGHT * min(reached, default=math.inf))

    def _from_contained(self, base: Explanation, s: Score) -> Explanation | None:
        """Fit from where the effect that a candidate contains ends, at a start's other numbers; None without.

        Far from the null no derivative leads.
        """
        c, inner = s.candidate, s.candidate.effect.contains
        first = next((o for o in self.every[base.keys] if inner and o.candidate.key == (inner.name, c.on)), None)
        if first is None:
            return None
        found = self.explain((*base.members, first.candidate), with_values(base.fit.theta, first.values), base.fit).fit
        back = {k: float(self.problem.model.null[k]) for k in first.candidate.slots}
        own = c.values(with_values(found.theta, s.values).tolist())
        point = c.effect.beyond(first.candidate.values(found.theta.tolist()), own)
        theta = with_values(found.theta, back | c.by_slot(point))
        return self.explain((*base.members, c), theta, found, again=True)

    def without(self, base: Explanation, member: Candidate, instead: Sequence[Candidate] = ()) -> Explanation:
        """Fit the base without one effect, or with what that one contains `instead`, begun at its numbers."""
        kept = tuple(k for c in base.members for k in (instead if c.key == member.key else (c,)))
        values = {k: float(self.problem.model.null[k]) for k in member.slots}
        for c in instead:
            values |= c.by_slot(member.values(base.fit.theta.tolist()))
        return self.explain(kept, with_values(base.fit.theta, values), base.fit, again=True)

    def coarser(self, base: Explanation, member: Candidate) -> Explanation:
        """Fit the base with the effect that one of its effects contains in that one's place.

        Without it where it is not among the candidates, or beside it.
        """
        inner = [c for c, _ in self.starts.items if c.key == _contained(member) and c.key not in base.keys]
        return self.without(base, member, inner[:1])

    def refined(self, base: Explanation) -> list[Explanation]:
        """The base with an effect that contains one of its own in that one's place, fitted, physical ones only."""
        found, near = [], self.near(base)
        for member in base.members:
            finer = {c.key for c, _ in self.starts.items if _contained(c) == member.key} - base.keys
            if finer:
                rest = self.without(base, member)
                found += [near.extend(rest, s) for s in self.ranked(rest) if s.candidate.key in finer]
        return [e for e in found if e.physical]

    def _key(self, members: tuple[Candidate, ...], theta: Floats) -> tuple[frozenset[Key], tuple[float, ...]]:
        discrete = tuple(float(theta[k]) for c in members for k in c.slots if k not in c.free)
        return frozenset(c.key for c in members), discrete

    def explain(self, members: tuple[Candidate, ...], theta: Floats, base: Fit, *, again: bool = False) -> Explanation:
        """Fit a set of effects from theta (q,); once, or `again` from another start if that may end lower."""
        key = self._key(members, theta)
        if key not in self.tried or again:
            slots = [k for c in members for k in c.free]
            made = len(self.ends)
            old = self.tried.get(key)
            ends = old.fit.chi2 if old is not None and old.physical else math.inf
            found = self._ended(theta, base.begin(self.problem), slots, ends)
            count = sum(len(c.slots) for c in members)
            physical = all(sound(c, found) for c in members) and resolved(self.problem, found.theta, found.x0)
            bends = any(c.effect.one_curve for c in members)  # to anything: an answer only where nothing is left
            physical = physical and (not bends or self.at_noise(found))
            spent = self.problem.spent(found.theta)
            new = Explanation(members, found, self.bic(found.chi2 + spent, count), physical)
            if old is None or (new.physical, -new.fit.chi2) > (old.physical, SAME - old.fit.chi2):
                self.tried[key] = new
            if len(self.ends) > made:
                self.watch.step(self._best())
        return self.tried[key]

    def sound(self, size: int | None = None) -> list[Explanation]:
        """Physical sets that were fitted, of so many effects or of one at least, lowest BIC first."""
        own = [e for e in self.tried.values() if e.physical and (e.members if size is None else len(e.members) == size)]
        return sorted(own, key=lambda e: e.bic)

    def _best(self) -> str:
        """The best answer so far, in words."""
        sound = [e for e in self.tried.values() if e.physical]
        least = min((e.bic for e in sound), default=0.0)  # the simplest of those near it, as the choice takes it
        best = min((e for e in sound if e.bic - least < BIC_GAIN), key=lambda e: (e.count, e.bic), default=None)
        if best is None or not best.members:
            return "the model as declared"
        named = joined([c.effect.phrase(c.on) for c in best.members])
        return f"{named} (chi²/dof {best.fit.chi2 / self.problem.size:.3g})"

    def _ended(self, theta: Floats, x0: Floats, slots: list[int], known: float) -> Fit:
        """Where a fit ends that begins there; each is made once, as one search comes by the same place often."""
        key = tuple(slots), theta.tobytes(), x0.tobytes()
        if key not in self.ends:
            self.ends[key] = self._fitted(theta, x0, slots, known)
        found, steps = self.ends[key]
        self.steps.update(steps)
        return found

    def _fitted(self, theta: Floats, x0: Floats, slots: list[int], known: float) -> tuple[Fit, dict[int, float]]:
        """Fit, and again if difference steps that suit the start do not suit the end (a peak that began flat)."""
        useless = min(known, self._in_sight())
        steps = choose_steps(self.problem, theta, x0, slots)
        found = fit(self.problem, theta, x0, slots, steps, useless=useless)
        for _ in range(2):
            if found.chi2 > useless:
                break
            again = choose_steps(self.problem, found.theta, found.x0, slots)
            if all(0.1 < again[k] / steps[k] < 10.0 for k in slots):
                break
            steps = again
            found = fit(self.problem, found.theta, found.x0, slots, steps, useless=useless)
        return found, steps

    def screen(self, base: Explanation) -> Screen:
        """The linear problem around an explanation, with everything that could join it."""
        key = base.keys, base.fit.chi2
        if key not in self.screens:
            self.screens[key] = screen(self.problem, base.fit, self.steps, self.starts, base.keys)
        return self.screens[key]

    def reached(self, e: Explanation) -> bool:
        """Whether it is down to the noise."""
        return self.at_noise(e.fit)

    def at_noise(self, at: Fit) -> bool:
        """The same of a fit."""
        return at_noise(*misfit(self.problem, at))

    def surely(self, e: Explanation, member: Candidate) -> bool:
        """Whether an effect of one parameter is worth more than any doubt: its square over its variance (Wald 1943)."""
        if len(member.slots) != 1 or member.slots[0] not in e.fit.slots:
            return False
        k = member.slots[0]
        away = float(e.fit.theta[k] - self.problem.model.null[k])
        variance = float(e.fit.variances[e.fit.slots.index(k)]) * self.scale
        return math.isfinite(away) and variance > 0.0 and away**2 > OUT_OF_SIGHT * BIC_GAIN * variance

    def ranked(self, base: Explanation) -> list[Score]:
        """Scores of everything that could join the base, best first, one start for each candidate."""
        if base.keys not in self.every:
            self.every[base.keys] = score(self.screen(base))
        return best_of_each(self.every[base.keys])

    def joined(self, base: Explanation, exclude: Collection[Key] = (), most: int = WIDTH) -> list[Explanation]:
        """The most promising extensions of the base, fitted, physical ones only.

        An effect that contains another which may be tried is left to `refined`: it costs several fits of more numbers.
        """
        asked = {c.key for c, _ in self.starts.items} - set(exclude)
        worth = [
            s for s in self.ranked(base)
            if s.drop / self.scale > BIC_GAIN and s.candidate.key in asked and _contained(s.candidate) not in asked
        ]  # fmt: skip
        alike = _alike(self.screen(base))
        firsts = _distinct(worth, alike)[:most]
        fitted = [(s, self.extend(base, s)) for s in firsts]
        lost = [s for s, e in fitted if not e.physical]  # what stands for it in the list may be sound
        fitted += [(s, self.extend(base, s)) for s in worth if s not in firsts and any(alike(s, k) for k in lost)]
        sound = [(s, e) for s, e in fitted if e.physical]
        if sound:  # one direction at the null need not be one far from it: the best one's namesakes are fitted too
            best, _ = min(sound, key=lambda pair: pair[1].bic)
            twins = [s for s in worth if s not in firsts and alike(s, best)]
            sound += [(s, e) for s, e in ((s, self.extend(base, s)) for s in twins) if e.physical]
        return [e for _, e in sound]


def _alike(seen: Screen) -> Callable[[Score, Score], bool]:
    """Whether two scores of one number each are of one direction, what the free parameters can do left aside.

    Others are where they promise the same.
    """
    own = slice(0, seen.own)
    rest = seen.gram - seen.gram[:, own] @ inverted(seen.gram[own, own]) @ seen.gram[own]
    size = np.sqrt(np.maximum(np.diag(rest), 1e-300))

    def alike(a: Score, b: Score) -> bool:
        if len(a.columns) != 1 or len(b.columns) != 1:
            return abs(a.drop - b.drop) <= SAME_PROMISE * b.drop
        (i,), (j,) = a.columns, b.columns
        return abs(float(rest[i, j])) > COLLINEAR * float(size[i] * size[j])

    return alike


def _distinct(scores: list[Score], alike: Callable[[Score, Score], bool]) -> list[Score]:
    """Scores without those of the direction of a better one: the same under another name, or nearly so."""
    kept: list[Score] = []
    for s in scores:
        if not any(alike(s, k) for k in kept):
            kept.append(s)
    return kept


def _contained(c: Candidate) -> Key | None:
    """The candidate that this one contains."""
    return None if c.effect.contains is None else (c.effect.contains.name, c.on)


def sound(c: Candidate, found: Fit) -> bool:
    """Whether a fitted effect is physical and not at a limit of what it may be."""
    held = [k for p, k in zip(c.effect.parameters, c.slots, strict=True) if not p.may_vanish]
    return c.effect.physical(c.values(found.theta.tolist())) and not any(k in found.at_limit for k in held)


def doubted(problem: Problem, e: Explanation) -> tuple[str, ...]:
    """What is to be said of effects that may be something else wherever the record was."""
    values = e.fit.theta.tolist()
    doubts = [(c, c.effect.doubt(c.effect.canonical(c.values(values)), visited(problem, c))) for c in e.members]
    return tuple(f"Of {c.effect.phrase(c.on)}: {why}." for c, why in doubts if why)
