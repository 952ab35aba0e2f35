"""What may hide beside the answer: effects that the recordings at hand were too small to show, linearised.

The truth need not be among what was left open: it may be the answer and one more effect of the library, as large as
what is at hand leaves it. With own parameters a and one effect e of size v free, another one e' instead misses of it

    D(e, e') = v^T (G_ee - G_eN G_NN^+ G_Ne) v,   N = {a, e'},

G = J^T J of the recordings at hand and of the one to come together, initial states projected out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.search.scoring import column, list_starts, small_amplitude
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.sensitivity import Direction, inverted, linearise, scaled, slot_direction
from simgap.diagnosis.simulation.supermodel import SuperModel
from simgap.distributions import norm
from simgap.extras.experiment.rivals import Bench, Explained, KnownRivals, margin, members, translated
from simgap.model.symbolic import SymbolicModel

_UNSEEN = 1e-10
"""What is at hand cannot see an effect of which it leaves a smaller share."""
_ROUNDS = 3  # what was fitted to every sample is near its end on block means
SIZES = norm.ppf(0.5 + 0.5 * (np.arange(8) + 0.5) / 8)
"""Sizes of a hidden effect, in standard errors of what is at hand: middles of eight equally likely ones."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Everything that could join the answer.

    Attributes:
        model: with every effect of the library; theta: (q,) of the answer.
        directions: of its own parameters, then of each effect; own: how many of the first.
        columns: of each effect among the directions; names: of the effects.
        gram: (p, p) of the recordings at hand; size: numbers in them.
        hidden: of each effect, (columns,) what one standard error is.
    """

    model: SuperModel
    theta: Floats
    directions: tuple[Direction, ...]
    own: int
    columns: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]
    gram: Floats
    size: int
    hidden: tuple[Floats, ...]

    def missed(self, bench: Bench, states: Floats, readings: Floats, u: Floats) -> Floats:
        """(e, e + 1) D of each effect at one standard error, with another one in its place or (last) with none."""
        problem, x0 = replace(bench, model=self.model).recorded(states, readings, u)
        gram = self.gram + linearise(problem, self.theta, x0, self.directions).gram
        count = len(self.columns)
        out = np.full((count, count + 1), np.inf)
        own = list(range(self.own))
        for other in range(count + 1):
            free = [*own, *(self.columns[other] if other < count else ())]
            left = gram - gram[:, free] @ inverted(gram[np.ix_(free, free)]) @ gram[free, :]
            for e, (columns, v) in enumerate(zip(self.columns, self.hidden, strict=True)):
                if e != other:
                    out[e, other] = max(float(v @ left[np.ix_(columns, columns)] @ v), 0.0)
        return out / bench.excess

    def told(self, d: Floats, bench: Bench) -> Floats:
        """(e, e + 1) probability that such an effect is told from the other, over its sizes."""
        counts = np.array([len(c) for c in self.columns], dtype=np.float64)
        more = counts[:, None] - np.append(counts, 0.0)[None, :]
        log = math.log(max(self.size + bench.compared, 2))
        own = ~np.isfinite(d)  # an effect is not its own rival
        each = [np.where(own, 1.0, norm.cdf(margin(np.where(own, 1.0, s**2 * d), more, log))) for s in SIZES]
        return np.asarray(np.mean(each, axis=0))


def beside(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, answer: Explained, known: KnownRivals
) -> Beside:
    """What may hide beside an answer, the first of what is known."""
    noise = dict(zip(record.measured, map(float, known.problem.sigma), strict=True))
    parts, _ = parts_of(model, record, replace(settings, noise=noise))
    problem = coarse(parts.known)
    rival = translated(known.rivals[0], answer, known.problem.model, problem.model)
    steps = dict(zip(rival.slots, rival.steps, strict=True))
    at = fit(problem, rival.theta, initial_states(problem), rival.slots, steps, _ROUNDS)
    own = [slot_direction(problem, at.theta, k, h) for k, h in steps.items()]
    directions, columns, names = list(own), [], []
    inside = {c.key for c in members(problem.model, answer)}
    starts = list_starts(problem, inside)
    for index, (c, start) in enumerate(starts.items):
        if c.key in inside:
            continue
        inside.add(c.key)
        amplitude = small_amplitude(problem, at, c, start, index, starts)
        columns.append(tuple(range(len(directions), len(directions) + start.size)))
        names.append(c.effect.phrase(c.on))
        directions += [column(at.theta, c, start, j, amplitude) for j in range(start.size)]
    linear = linearise(problem, at.theta, at.x0, directions)
    seen = [k for k, c in enumerate(columns) if linear.visible[list(c)].all()]  # of others no size is at hand
    columns, names = [columns[k] for k in seen], [names[k] for k in seen]
    hidden = tuple(_one_error(linear.gram, len(own), c) for c in columns)
    return Beside(
        problem.model, at.theta, tuple(directions), len(own), tuple(columns), tuple(names), linear.gram, problem.size,
        hidden,
    )  # fmt: skip


def _one_error(gram: Floats, own: int, columns: tuple[int, ...]) -> Floats:
    """The direction of an effect's coefficients that is known least, as long as its standard error."""
    c, a = list(columns), list(range(own))
    g, scale = scaled(gram)
    left = g[np.ix_(c, c)] - g[np.ix_(c, a)] @ inverted(g[np.ix_(a, a)]) @ g[np.ix_(a, c)]
    values, vectors = np.linalg.eigh(left)
    return np.asarray(vectors[:, 0] / math.sqrt(max(values[0], _UNSEEN)) / scale[c])
