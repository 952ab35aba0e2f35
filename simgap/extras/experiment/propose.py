"""The input that parts rivals best: a few dozen tries of every family, then improved from the best ones.

Beside the answer may hide effects that the recordings at hand were too small to show; they are taken linearised. The
truth need not be among what was left open: it may be the answer and one more effect of the library, as large as what is
at hand leaves it. With own parameters a and one effect e of size v free, another one e' instead misses of it

    D(e, e') = v^T (G_ee - G_eN G_NN^+ G_Ne) v,   N = {a, e'},

G = J^T J of the recordings at hand and of the one to come together, initial states projected out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import DiagnosisSettings, Key
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.search.scoring import column, list_starts, small_amplitude
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.sensitivity import Direction, inverted, linearise, scaled, slot_direction
from simgap.diagnosis.simulation.supermodel import SuperModel
from simgap.diagnosis.thresholds import SELDOM
from simgap.extras.experiment.rivals import Bench, Explained, KnownRivals, margin, members, translated
from simgap.model.symbolic import SymbolicModel
from simgap.signals import multisine
from simgap.statistics import norm

_UNSEEN = 1e-10
"""Share that the data at hand leave of an effect, below which they cannot see it."""
_ROUNDS = 3  # what was fitted to every sample is near its end on block means
SIZES = norm.ppf(0.5 + 0.5 * (np.arange(8) + 0.5) / 8)
"""Sizes of a hidden effect, in standard errors of what is at hand: middles of eight equally likely ones."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Everything that could join the answer.

    Attributes:
        model: with every effect of the library; theta: (q,) of the answer.
        directions: of its own parameters, then of each effect; own: how many of the first.
        columns: of each effect, by its name and place, among the directions.
        gram: (p, p) of the recordings at hand; size: numbers in them.
        hidden: of each effect, (columns,) what one standard error is.
    """

    model: SuperModel
    theta: Floats
    directions: tuple[Direction, ...]
    own: int
    columns: Mapping[Key, tuple[int, ...]]
    gram: Floats
    size: int
    hidden: tuple[Floats, ...]

    def missed(self, bench: Bench, states: Floats, readings: Floats, u: Floats) -> Floats:
        """(e, e + 1) D of each effect at one standard error, with another one in its place or (last) with none."""
        problem, x0 = replace(bench, model=self.model).recorded(states, readings, u)
        gram = self.gram + linearise(problem, self.theta, x0, self.directions).gram
        effects = [*self.columns.values()]
        out = np.full((len(effects), len(effects) + 1), np.inf)
        for other, more in enumerate([*effects, ()]):
            free = [*range(self.own), *more]
            left = gram - gram[:, free] @ inverted(gram[np.ix_(free, free)]) @ gram[free, :]
            for e, (columns, v) in enumerate(zip(effects, self.hidden, strict=True)):
                if e != other:
                    out[e, other] = max(float(v @ left[np.ix_(columns, columns)] @ v), 0.0)
        return out / bench.excess

    def told(self, d: Floats, bench: Bench) -> Floats:
        """(e, e + 1) probability that such an effect is told from the other, over its sizes."""
        counts = np.array([len(c) for c in self.columns.values()], dtype=np.float64)
        more, count = counts[:, None] - np.append(counts, 0.0)[None, :], self.size + bench.compared
        own = ~np.isfinite(d)  # an effect is not its own rival
        each = [np.where(own, 1.0, norm.cdf(margin(np.where(own, 1.0, s**2 * d), more, count))) for s in SIZES]
        return np.asarray(np.mean(each, axis=0))


def beside(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, answer: Explained, known: KnownRivals
) -> Beside:
    """Effects that may hide beside an answer, the first of the rivals that are known."""
    noise = dict(zip(record.measured, map(float, known.problem.sigma), strict=True))
    parts, _ = parts_of(model, record, replace(settings, noise=noise))
    problem = coarse(parts.known)
    rival = translated(known.rivals[0], answer, known.problem.model, problem.model)
    at = fit(problem, rival.theta, initial_states(problem), [*rival.steps], rival.steps, _ROUNDS)
    own = [slot_direction(problem, at.theta, k, h) for k, h in rival.steps.items()]
    directions, columns = list(own), dict[Key, tuple[int, ...]]()
    inside = {c.key for c in members(problem.model, answer)}
    starts = list_starts(problem, inside)
    for index, (c, start) in enumerate(starts.items):
        if c.key in columns:
            continue
        amplitude = small_amplitude(problem, at, c, start, index, starts)
        columns[c.key] = tuple(range(len(directions), len(directions) + start.size))
        directions += [column(at.theta, c, start, j, amplitude) for j in range(start.size)]
    linear = linearise(problem, at.theta, at.x0, directions)
    seen = {key: c for key, c in columns.items() if linear.visible[list(c)].all()}  # of others no size is at hand
    hidden = tuple(_one_error(linear.gram, len(own), c) for c in seen.values())
    return Beside(problem.model, at.theta, tuple(directions), len(own), seen, linear.gram, problem.size, hidden)


def _one_error(gram: Floats, own: int, columns: tuple[int, ...]) -> Floats:
    """The direction of an effect's coefficients that is known least, as long as its standard error."""
    c, a = list(columns), list(range(own))
    g, scale = scaled(gram)
    left = g[np.ix_(c, c)] - g[np.ix_(c, a)] @ inverted(g[np.ix_(a, a)]) @ g[np.ix_(a, c)]
    values, vectors = np.linalg.eigh(left)
    return np.asarray(vectors[:, 0] / math.sqrt(max(values[0], _UNSEEN)) / scale[c])


SHARES = (1.0, 0.5, 0.2)
"""Shares of the range in which each family is tried."""
HALVINGS = 3
"""How often a wave that takes the plant out of its range is made smaller."""
BEST, ROUNDS = 4, 40
"""From how many tries the improvement sets out, and how many changes it tries."""
ENOUGH = 1.0 - SELDOM
"""Once the predicted probability of telling the rivals apart is above it, nothing more is improved."""


@dataclass(frozen=True, eq=False)
class Try:
    """One input.

    Attributes:
        bench: on which it was tried; name: of its family; wave: (n, m); u: (n, m + c) as the plant feels it.
        score: what is made large; d: (r, r) of `Bench.parts`, with the answer alone its standard errors (p,).
        states, readings: of each rival, (n, nx) and (n, k).
        hidden: (e, e + 1) of `Beside.told`; None where nothing is sought beside.
    """

    bench: Bench
    name: str
    wave: Floats
    u: Floats
    score: float
    d: Floats
    states: tuple[Floats, ...]
    readings: tuple[Floats, ...]
    hidden: Floats | None = None


@dataclass(frozen=True, eq=False)
class Counted:
    """Pairs that some input tells: of the rivals (r, r), and of what may hide beside the answer (e, e + 1)."""

    rivals: Bools
    hidden: Bools


@dataclass(frozen=True, eq=False)
class InputProposal:
    """The best input.

    Attributes:
        best: the try; bench: its bench, the first of those given where nothing could be tried.
        tried: how many there were; left: how many would have left the range of the plant.
        sure: the least probability, over the pairs that count, that the right one is told from the other.
        shown: the share of what may hide beside the answer that the recording would show and name.
        counted: the pairs that some input tells apart; all rivals, where none does.
    """

    best: Try | None
    bench: Bench
    tried: int
    left: int
    sure: float
    shown: float
    counted: Counted

    @property
    def found(self) -> Try:
        """The best, where an input kept the plant in its range."""
        assert self.best is not None
        return self.best

    @property
    def closest(self) -> tuple[int, int]:
        """The pair that the best input tells least surely: the right one and the other."""
        z = _counting(self.found, self.counted)
        a, b = np.unravel_index(int(np.argmin(z)), z.shape)
        return int(a), int(b)

    @property
    def of_all(self) -> float:
        """`sure` where no pair is alike, else 0."""
        return 0.0 if self.alike() else self.sure

    def alike(self) -> list[tuple[int, int]]:
        """Pairs that no input that was tried tells apart."""
        told = self.counted.rivals
        return [(a, b) for a in range(len(told)) for b in range(a) if not told[a, b]]


def propose(
    benches: Sequence[Bench], rng: np.random.Generator, tell: Callable[[str], None] = lambda words: None,
    few: bool = False, beside: Beside | None = None, counted: Counted | None = None,
) -> InputProposal:  # fmt: skip
    """Try every family on each bench (one for each known condition), and improve the best ones.

    Args:
        benches: with two or more rivals to be told apart, or one whose numbers are to be told better.
        few: one size of each family and no improvement.
        beside: what may hide beside the first of them.
        counted: the pairs that count; those that some input tells apart if not given.
    """
    attempts: list[Try | None] = []
    for bench in benches:
        for wave in waves(bench.t, len(bench.reach), rng):
            for size in SHARES[:1] if few else SHARES:
                attempts.append(_fitting(bench, replace(wave, u=size * wave.u), beside))
        tell(f"{len(attempts)} inputs tried")
    found = [a for a in attempts if a is not None]
    count, left = len(attempts), len(attempts) - len(found)
    counted = counted or _told(found, len(benches[0].rivals))
    if not found:
        return InputProposal(None, benches[0], count, left, 0.0, 0.0, counted)
    best = sorted((replace(a, score=_score(a, counted)) for a in found), key=lambda a: -a.score)[:BEST]
    for k in range(0 if few else ROUNDS):
        if best[0].score >= ENOUGH * (1.0 + (beside is not None)):
            break
        parent = best[k % len(best)]
        attempt = tried(parent.bench, _changed(parent, best[0], rng), beside)
        count += 1
        if attempt is not None and (score := _score(attempt, counted)) > parent.score:
            best[k % len(best)] = replace(attempt, score=score)
            best.sort(key=lambda a: -a.score)
    return InputProposal(best[0], best[0].bench, count, left, sure(best[0], counted), shown(best[0], counted), counted)


def _told(found: Sequence[Try], rivals: int) -> Counted:
    """Pairs that some input tells more likely than not, whichever is right; all rivals, where none is."""
    best = np.full((rivals, rivals), -np.inf)
    for a in found if rivals > 1 else ():
        z = a.bench.margins(a.d)
        best = np.maximum(best, np.minimum(z, z.T))
    told = best > 0.0
    told = told if np.any(told & ~np.eye(rivals, dtype=bool)) else np.ones_like(told)
    hidden = [a.hidden for a in found if a.hidden is not None]
    return Counted(told, np.max(hidden, axis=0) > 0.5 if hidden else np.zeros((0, 1), dtype=bool))


def _score(a: Try, counted: Counted) -> float:
    """Objective of the search: how sure the pairs that count are told apart, and what would show beside the answer."""
    if len(a.bench.rivals) == 1:
        return a.score
    z = float(_counting(a, counted).min())
    return float(norm.cdf(z)) + min(z, 0.0) + shown(a, counted)


def _counting(a: Try, counted: Counted) -> Floats:
    """Margins (r, r) of the pairs that count, infinite of others."""
    return np.where(counted.rivals, a.bench.margins(a.d), np.inf)


def shown(a: Try, counted: Counted) -> float:
    """The share of what may hide beside the answer that would show and be named; 1 where nothing can."""
    if a.hidden is None or not counted.hidden.any():
        return 1.0
    least = np.where(counted.hidden, a.hidden, 1.0).min(axis=1)
    return float(np.mean(least[counted.hidden.any(axis=1)]))


def _fitting(bench: Bench, wave: Wave, beside: Beside | None) -> Try | None:
    """A try, made smaller while a rival leaves its range; None if it does at every size."""
    for k in range(HALVINGS + 1):
        attempt = tried(bench, replace(wave, u=0.5**k * wave.u), beside)
        if attempt is not None:
            return attempt
    return None


def tried(bench: Bench, wave: Wave, beside: Beside | None = None) -> Try | None:
    """Try of an input: how far it parts the rivals; None if one of them leaves the range of the plant."""
    u, rivals = bench.input(wave.u), bench.rivals
    moved: list[tuple[Floats, Floats]] = []
    for r in rivals:
        moved.append(bench.moved(r, u))
        if not bench.stays(moved[-1][0]):
            return None
    states, readings = zip(*moved, strict=True)
    if len(rivals) == 1:
        (only,) = rivals
        errors = bench.errors(states[0], readings[0], u, only)
        score = float(np.min(bench.errors_now(only) / np.maximum(errors, 1e-300)))  # the number that gains least
        return Try(bench, wave.name, wave.u, u, score, errors, states, readings)
    d = np.array(
        [[0.0 if a is b else bench.parts(*at, u, b) for b in rivals] for a, at in zip(rivals, moved, strict=True)]
    )
    hidden = None if beside is None else beside.told(beside.missed(bench, *moved[0], u), bench)
    return Try(bench, wave.name, wave.u, u, float(bench.margins(d).min()), d, states, readings, hidden)


def _changed(parent: Try, other: Try, rng: np.random.Generator) -> Wave:
    """A wave near a good one: a part of another, one more multisine, another size, the halves of two."""
    kind, m, t = rng.integers(4), parent.wave.shape[1], parent.bench.t
    if kind == 0:
        share = rng.uniform(0.2, 0.8)
        return Wave(parent.name, share * parent.wave + (1.0 - share) * other.wave[::-1])
    if kind == 1:
        low = np.exp(rng.uniform(np.log(0.1), np.log(4.0)))
        more = np.stack([multisine(t, rng.uniform(0.1, 0.5), low, 2.0 * low, rng) for _ in range(m)], axis=1)
        return Wave(parent.name, np.clip(parent.wave + more, -1.0, 1.0))
    if kind == 2:
        return Wave(parent.name, np.clip(parent.wave * rng.uniform(0.6, 1.8), -1.0, 1.0))
    half = len(t) // 2
    return Wave(parent.name, np.concatenate([parent.wave[:half], other.wave[half:]]))


def sure(a: Try, counted: Counted) -> float:
    """The least probability, over the pairs that count, that the right one is told from the other; 1 for one alone."""
    return 1.0 if len(a.bench.rivals) == 1 else float(norm.cdf(_counting(a, counted).min()))


@dataclass(frozen=True, eq=False)
class Wave:
    """An input to be tried.

    Attributes:
        name: what people read; u: (n, m) in units of the way from the middle of each input's range to its end.
    """

    name: str
    u: Floats


def waves(t: Floats, inputs: int, rng: np.random.Generator) -> Iterator[Wave]:
    """Every family on each input alone and, where there are several, on all of them together; t: (n,) s."""
    for name, shape in _shapes(t, rng):
        for j in range(inputs):
            yield Wave(name, np.outer(shape, np.arange(inputs) == j))
        if inputs > 1:
            shifts = [np.roll(shape, j * len(t) // inputs) for j in range(inputs)]
            yield Wave(f"{name}, all inputs", np.stack(shifts, axis=1))


def _shapes(t: Floats, rng: np.random.Generator) -> Iterator[tuple[str, Floats]]:
    """Waves (n,) between -1 and 1."""
    span, rate = float(t[-1] - t[0]), 1.0 / float(t[1] - t[0])
    since = t - t[0]
    top = min(0.2 * rate, 8.0)
    for low, high in ((0.1, 0.5), (0.1, 2.0), (0.5, 2.0), (0.5, 5.0), (2.0, 8.0)):
        if low < top:
            for _ in range(2):
                band = (low, min(high, top))
                yield f"multisine of {low:g} to {band[1]:.2g} Hz", multisine(t, 1.0, *band, rng)
    for first, last in ((0.1, 2.0), (0.2, 5.0), (3.0, 0.2)):
        end = min(last, top)
        turns = first * since + 0.5 * (end - first) / span * since**2
        yield f"chirp of {first:g} to {end:.2g} Hz", np.asarray(np.sin(2.0 * np.pi * turns))
    for dwell in (0.15, 0.5, 1.5):
        levels = rng.uniform(-1.0, 1.0, int(span / dwell) + 2)
        yield f"steps of {dwell:g} s", levels[(since / dwell).astype(np.int64)]
        signs = np.sign(levels)
        yield f"reversals of {dwell:g} s", signs[(since / dwell).astype(np.int64)]
    for count in (1, 2, 5):
        phase = (count * since / span + 0.25) % 1.0
        yield f"ramps of {span / count:.3g} s", np.asarray(1.0 - 4.0 * np.abs(phase - 0.5))
    for count in (4, 8):
        held = np.round(3.0 * np.sin(2.0 * np.pi * np.floor(count * since / span) / count)) / 3.0
        yield f"holds of {span / count:.3g} s", 0.8 * held
        yield (
            f"holds of {span / count:.3g} s with a multisine",
            0.6 * held + multisine(t, 0.4, 0.5, min(4.0, max(top, 0.6)), rng),
        )
    decay = np.exp(-3.0 * since / span)
    yield "a multisine that fades", decay * multisine(t, 1.0, 0.2, min(3.0, max(top, 0.3)), rng)
    yield "a multisine that grows", decay[::-1] * multisine(t, 1.0, 0.2, min(3.0, max(top, 0.3)), rng)


def missed(best: Try, right: int, wrong: int) -> Floats:
    """Error that a wrong explanation would leave of a recording, fitted to it in full and not linearised.

    Residuals over the noise, (n, k), of the wrong one on the recording to come alone, if the right one is right.
    """
    problem, x0 = best.bench.recorded(best.states[right], best.readings[right], best.u, whole=True)
    other = best.bench.rivals[wrong]
    ends = fit(problem, other.theta, x0, [*other.steps], other.steps)
    left = np.full_like(best.readings[right], np.nan)
    left[problem.samples] = problem.residuals(ends.theta, ends.x0) / np.sqrt(best.bench.excess)
    return left
