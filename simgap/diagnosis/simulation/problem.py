"""The arrays of one fit: what is predicted, what was measured, and the difference in units of the noise."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.faults.measurement import Rows
from simgap.diagnosis.record.folds import Windows, left_out
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.simulation import past
from simgap.diagnosis.simulation.noise_law import Colour, limited, whiten
from simgap.diagnosis.simulation.simulate import simulate
from simgap.diagnosis.simulation.supermodel import SuperModel
from simgap.diagnosis.thresholds import BRIEF_S
from simgap.late import njit

T = TypeVar("T")
Drive = tuple[Floats, Floats, Floats, Floats]
_FADED = 5.0  # time constants of a lag after which what was commanded before has faded (e^-5 < 0.01)
_REMEMBERED = 8
FARTHEST = 1e9
"""A miss in units of the noise is cut to it: the simulation diverged."""
_TURN = 0.6  # of a step, rad, where a motor swings against its link


class Memo:
    """What belongs to the record and a few parameters, and is made once: the last few values of each kind.

    A pass over chunks of windows asks for the same ones again.
    """

    def __init__(self) -> None:
        self._kinds = defaultdict[str, dict[bytes, Any]](dict)

    def kept(self, kind: str, key: bytes, make: Callable[..., T], *of: Any) -> T:
        """The value of a kind and key, made of that where it is not among the last few."""
        values = self._kinds[kind]
        if key not in values:
            values[key] = make(*of)
            if len(values) > _REMEMBERED:
                del values[next(iter(values))]
        return values[key]


@dataclass(frozen=True, eq=False)
class Problem:
    """Windows of a record under a model with candidates.

    Attributes:
        model: the compiled model.
        t: (n,) time stamps; y: (n, k) measured; u: (n, m) recorded inputs, all traces one after another.
        firsts: (traces,) first sample of each trace.
        windows: the windows that are compared.
        sigma: (k,) noise of each channel.
        h_max: longest integration step, s.
        used: (n, k) 1 for readings that are compared, 0 for those that are no measurement.
        heard: (k,) 1 for channels that are fitted, 0 for one that was left out.
        weight: (n, k) what each reading is worth, in (0, 1]; less than 1 where several share one error of rounding.
        colour: law of the noise; None if it is white.
        usual: (k,) size of a miss that is no gross error, in the unit of the channel; None: none is one.
    """

    model: SuperModel
    t: Floats
    y: Floats
    u: Floats
    firsts: Ints
    windows: Windows
    sigma: Floats
    h_max: float
    used: Floats
    heard: Floats
    weight: Floats
    colour: Colour | None = None
    usual: Floats | None = None
    memo: Memo = field(default_factory=Memo)

    def on(self, windows: Windows) -> Problem:
        """The same data and model on other windows."""
        return replace(self, windows=windows)

    def reach(self, theta: Floats) -> float:
        """For how long a command still acts at theta (q,), s: its delay and `_FADED` time constants."""
        _, _, delay, lag = self._drive(theta)
        return float(np.max(delay + _FADED * lag, initial=0.0))

    def ahead(self, theta: Floats) -> float:
        """By how much inputs that were logged late are brought forward at theta (q,), s: so much lacks at the end."""
        delay = np.array(self.model.memory(theta), dtype=np.float64).reshape(2, -1)[0]
        return float(np.max(-delay, initial=0.0))

    def past_the_unknown(self, reach_s: float) -> Problem:
        """The same problem without the samples on which commands from before the record may still act: they are not
        in it."""
        spans = tuple((k, t, t + reach_s * (1 - 1e-9)) for k, t in enumerate(self.t[self.firsts].tolist()))
        return self.on(left_out(self.windows, self.t, spans))

    def before_the_end(self, late_s: float) -> Problem:
        """The same problem without the last `late_s` of each trace, where what acted was logged after its end."""
        if late_s <= 0.0:
            return self
        ends = self.t[self.edges[1:] - 1] - late_s
        spans = tuple((k, end, math.inf) for k, end in enumerate(ends.tolist()))
        return self.on(left_out(self.windows, self.t, spans))

    def pick(self, which: Ints) -> Problem:
        """The same data and model on some of the windows, each once; itself, with what it keeps, if these are all."""
        return self if len(which) == len(self.windows) else self.on(self.windows.pick(which))

    def some(self, count: int = 8) -> tuple[Problem, Ints]:
        """So many windows spread over all, and which they are."""
        few = np.unique(np.linspace(0, len(self.windows) - 1, count).astype(np.int64))
        return self.pick(few), few

    @cached_property
    def edges(self) -> Ints:
        """(traces + 1,) first sample of each trace, and their number."""
        return np.append(self.firsts, len(self.t))

    @property
    def brief(self) -> float:
        """So short a time (s) that it hardly shows what a plant lacks all the time: `BRIEF_S`, or a window."""
        w = self.windows
        return min(BRIEF_S, float(np.max(self.t[w.stop - 1] - self.t[w.start])))

    @property
    def size(self) -> int:
        """Number of compared numbers, as far as they are independent."""
        return int(np.sum(self.counts))

    @cached_property
    def counts(self) -> Floats:
        """(w,) compared numbers of each window, as far as they are independent; at least 1."""
        each = (self._used * self.weight[self.samples]) @ self.heard
        return np.maximum(np.add.reduceat(each, self.rows[:-1]), 1.0)

    @cached_property
    def taken(self) -> float:
        """Degrees of freedom that the initial states take: in a window no more than it has compared numbers."""
        return float(np.sum(np.minimum(self.counts, self.model.begun)))

    def spent(self, theta: Floats) -> float:
        """Degrees of freedom that motors which swing behind their joints take at theta (q,), two in each window."""
        return 2.0 * len(self.windows) * sum(train.swings(theta) for train in self.model.trains)

    @cached_property
    def _factors(self) -> Floats:
        """(rows, k) of the misses: the root of what a reading is worth, 0 for channels that are not fitted."""
        return np.sqrt(self.weight[self.samples]) * self.heard

    @property
    def spacing(self) -> float:
        """Median interval of the stamps, s."""
        return self.memo.kept("spacing", b"", interval, self.t)

    @cached_property
    def rows(self) -> Ints:
        """(w + 1,) first row of each window in flat arrays, and their total."""
        return np.concatenate([[0], np.cumsum(self.windows.stop - self.windows.start)]).astype(np.int64)

    @cached_property
    def samples(self) -> Ints:
        """(rows,) sample behind each flat row."""
        return np.arange(int(self.rows[-1])) + np.repeat(self.windows.start - self.rows[:-1], np.diff(self.rows))

    @cached_property
    def readings(self) -> Floats:
        """(rows, k) measured, window after window."""
        return self.y[self.samples]

    @cached_property
    def _used(self) -> Floats:
        """(rows, k) 1 for readings that are compared, window after window."""
        return self.used[self.samples]

    @property
    def compared(self) -> Floats:
        """(k,) readings that are compared, of each channel; at least 1."""
        return np.maximum(np.sum(self._used, axis=0), 1.0)

    @cached_property
    def shifted(self) -> Problem:
        """The windows once as they are, and once more for each number that begins one."""
        return self.on(self.windows.pick(np.tile(np.arange(len(self.windows)), self.model.begun + 1)))

    def states(self, theta: Floats, x0: Floats) -> Floats:
        """Simulated states of all windows: theta, (w, begun) -> (rows, nx)."""
        return np.ascontiguousarray(self._simulated(theta, x0)[:, : self.model.nx])

    def _simulated(self, theta: Floats, x0: Floats) -> Floats:
        """The same with the states of motors, (rows, begun)."""
        if any(train.rigid(theta, self.spacing) for train in self.model.trains):
            return np.full((int(self.rows[-1]), self.model.begun), np.nan)
        w, begin = self.windows, x0.copy()
        for k, train in enumerate(self.model.trains):
            link, motor = [train.position, train.velocity], self.model.nx + np.array([2 * k, 2 * k + 1])
            away = train.swings(theta) * x0[:, motor] + self._twists(k, theta)[w.start]
            if train.read_at_motor(theta):  # what was fitted is the motor's
                begin[:, motor], begin[:, link] = x0[:, link], x0[:, link] - away
            else:
                begin[:, motor] = x0[:, link] + away
        if self.model.remembered:
            begin = np.hstack([begin, self._memories(theta)[w.start]])
        out, quick = np.empty((int(self.rows[-1]), begin.shape[1])), [train.quick(theta) for train in self.model.trains]
        step = self.h_max / max(1.0, max(quick, default=0.0) * self.spacing / _TURN)
        simulate(
            *self.model.dynamics.addresses, self.t, *self._drive(theta), self.model.dynamics.constants_at(theta), begin,
            self.firsts[w.trace], w.start, w.stop, self.rows[:-1], self.model.dynamics.speed, step, out,
        )  # fmt: skip
        return np.ascontiguousarray(out[:, : self.model.begun])

    def _memories(self, theta: Floats) -> Floats:
        """The effects' own states at every stamp, (n, h); kept for the last few of their numbers."""
        on = [self.model.model.coordinate(c.on) for c in self.model.remembered]
        slots = [k for c in self.model.remembered for k in c.slots]
        read = self.model.measured, self.t, self.y, self.firsts
        speeds = self.memo.kept("speeds", b"", past.measured_speeds, on, *read)
        own = self.model.past, theta, self.t, speeds, self.firsts
        return self.memo.kept("memories", theta[slots].tobytes(), past.memories, *own)

    def _twists(self, k: int, theta: Floats) -> Floats:
        """Twist and its rate of a motor against its link at every stamp, (n, 2); kept for the last few laws."""
        slots = [*self.model.trains[k].slots, *self.model.input_slots]
        return self.memo.kept(f"twists of {k}", theta[slots].tobytes(), self._make_twists, k, theta)

    def _make_twists(self, k: int, theta: Floats) -> Floats:
        train = self.model.trains[k]
        if train.quick(theta) == 0.0:
            return np.zeros((len(self.t), 2))
        on, law = self.model.model.coordinate(train.on), np.array(train.numbers(theta), dtype=np.float64)
        read = self.model.measured, self.t, self.y, self.firsts
        q, v = self.memo.kept(f"link of {k}", b"", past.measured_link, on, *read)
        felt = self._felt(theta, train.inputs)
        if train.read_at_motor(theta):
            return past.twists_by_torque(self.t, v, felt, law, self.edges)
        return np.asarray(past.twists(self.t, q, v, felt, law[:-1], self.edges))

    def _felt(self, theta: Floats, inputs: tuple[int, ...]) -> Floats:
        """The sum of some inputs as the plant feels it at each stamp, (n,)."""
        level, excess, delay, lag = self._drive(theta)
        total = np.zeros(len(self.t))
        for c, (a, b) in itertools.product(inputs, itertools.pairwise(self.edges.tolist())):
            t = self.t[a:b]  # each trace has a clock of its own
            at = np.maximum(np.searchsorted(t, t - delay[c] + 1e-12, "right") - 1, 0)
            total[a:b] += level[a:b, c][at]
            if lag[c] > 0.0:
                total[a:b] += excess[a:b, c][at] * np.exp(-np.maximum(t - delay[c] - t[at], 0.0) / lag[c])
        return total

    def predict(self, theta: Floats, x0: Floats) -> Floats:
        """What the measured channels would read: theta, (w, nx) -> (rows, k)."""
        x = self._simulated(theta, x0)
        out = np.empty((len(x), self.y.shape[1]))
        self.model.read(x, theta, out)
        for fault, column, slot in self.model.reading_faults:
            if theta[slot] != 0.0:
                own, t = np.ascontiguousarray(out[:, column]), self.t[self.samples]
                since = t - np.repeat(self.t[self.firsts[self.windows.trace]], np.diff(self.rows))
                read, noise = self.readings[:, column], float(self.sigma[column])
                fault.distort(own, float(theta[slot]), Rows(t, since, self.rows, read, noise))
                out[:, column] = own
        return out

    def misses(self, theta: Floats, x0: Floats) -> Floats:
        """(measured - predicted) / sigma, (rows, k); a diverging simulation is cut to a large number."""
        with np.errstate(over="ignore", invalid="ignore"):
            missed = (self.readings - self.predict(theta, x0)) / self.sigma
        return self._used * np.fmax(np.fmin(missed, FARTHEST), -FARTHEST)  # what is no number is far

    def residuals(self, theta: Floats, x0: Floats) -> Floats:
        """Misses made white by the law of the noise, (rows, k): of a perfect model they are independent, of size 1."""
        residual = self.misses(theta, x0)
        if self.colour is not None:
            whiten(residual, self.rows, *self.colour.memory)
        residual *= self._factors
        return residual if self.usual is None else limited(residual, self.spread)

    @property
    def spread(self) -> Floats:
        """Size of a usual miss in units of the noise, (k,); at least 1."""
        return np.ones(len(self.sigma)) if self.usual is None else np.maximum(self.usual / self.sigma, 1.0)

    def _drive(self, theta: Floats) -> Drive:
        """Level, excess, delay and lag of the inputs; kept while the parameters of the inputs stay the same."""
        key = theta[list(self.model.input_slots)].tobytes()
        return self.memo.kept("drives", key, self._make_drive, theta)

    def _make_drive(self, theta: Floats) -> Drive:
        level = np.empty_like(self.u)
        self.model.static(self.u, theta, level)
        delay, lag = np.array(self.model.memory(theta), dtype=np.float64).reshape(2, -1)
        for c in np.flatnonzero(delay < 0.0):  # whole samples by which it is brought forward, and a rest above 0
            ahead = int(np.ceil(-delay[c] / self.spacing - 1e-9))
            delay[c] += ahead * self.spacing
            for a, b in itertools.pairwise(self.edges):
                level[a:b, c] = level[np.minimum(np.arange(a, b) + ahead, b - 1), c]
        excess = np.zeros_like(level)
        for c in np.flatnonzero(lag > 0.0):
            excess[:, c] = lagged_excess(self.t, np.ascontiguousarray(level[:, c]), self.edges, float(lag[c]))
        return level, excess, delay, lag


@njit("float64[::1](float64[::1], float64[::1], int64[::1], float64)", cache=True)
def lagged_excess(t: Floats, level: Floats, edges: Ints, lag: float) -> Floats:
    """Lagged input minus its target at each stamp, exactly, for inputs held between stamps: (n,).

    z' = (u - z) / T gives e_k = e_{k-1} exp(-dt/T) + u_{k-1} - u_k: exactly 0 in the end. Each trace
    starts settled.
    """
    excess = np.zeros_like(level)
    for trace in range(edges.size - 1):
        for k in range(edges[trace] + 1, edges[trace + 1]):
            excess[k] = excess[k - 1] * math.exp(-(t[k] - t[k - 1]) / lag) + level[k - 1] - level[k]
    return excess


def interval(t: Floats) -> float:
    """Median interval of stamps that lie trace after trace: (n,) s -> s."""
    steps = np.diff(t)
    return float(np.median(steps[steps > 0]))


def build_problem(
    model: SuperModel, record: Record, windows: Windows, sigma: Floats, weight: Floats | None = None
) -> Problem:
    """Lay the traces one after another; sigma: (k,) noise of each channel, weight: (n, k) of the readings (1)."""
    t, y, u, used = (
        np.ascontiguousarray(np.concatenate([getattr(trace, name) for trace in record.traces]))
        for name in ("t", "y", "u", "compared")
    )
    firsts = np.cumsum([0, *(len(trace.t) for trace in record.traces[:-1])])
    weight = np.ones(y.shape) if weight is None else weight
    return Problem(model, t, y, u, firsts, windows, sigma, interval(t), used, np.ones(len(sigma)), weight)
