"""The linear problem behind an arm's diagnosis: rows of measured torque, columns of what may be missing.

Traces become smooth motion and torques on an even grid first. A zero-phase low pass is applied to everything alike, so
that no side of the equations is late (Gautier (1997), IEEE ICRA, "Dynamic identification of robots with power model":
parallel filtering; Butterworth forwards and backwards).

What a joint may lack is the torque that a measured motion takes beyond the rigid bodies, for a parameter of 1; names
and symbols are those of the library of effects, which has formula, source and limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.arms.inertia import BaseParameters, independent
from simgap.diagnosis.record.folds import SEVERAL_TRACES, Windows, split_folds
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.thresholds import AT_REST, BAND, MATTERS, SELDOM
from simgap.effects import effect
from simgap.errors import UserError
from simgap.model.symbolic import Coordinate
from simgap.model.tree import PARAMETERS, Tree, regressor

_OF_THE_RATE = 0.2  # the cut is at most this share of the sampling rate, so that central differences are derivatives
_STILL = 1e-2  # a trace whose joints never exceed this speed, rad/s or m/s, is at rest: what moves is noise


@dataclass(frozen=True, eq=False)
class Motion:
    """One trace on an even grid.

    Attributes:
        trace: its name.
        t: (N,) s; q, v, torque: (N, n).
    """

    trace: str
    t: Floats
    q: Floats
    v: Floats
    torque: Floats


@dataclass(frozen=True, eq=False)
class Filter:
    """A Butterworth low pass of fourth order, forwards and backwards along axis 0, at `cut` Hz of `rate` Hz."""

    cut: float
    rate: float

    def __call__(self, x: Floats) -> Floats:
        """(N, ...) -> (N, ...)."""
        from scipy.signal import butter, sosfiltfilt

        sections = butter(4, self.cut / (0.5 * self.rate), output="sos")
        reach = min(len(x) - 1, int(3 * self.rate / self.cut))
        return np.ascontiguousarray(sosfiltfilt(sections, x, axis=0, padlen=reach))

    @property
    def used(self) -> slice:
        """Rows away from the ends, where it sees both sides, thinned to what the cut leaves."""
        edge = int(self.rate / self.cut)
        return slice(edge, -edge, max(1, int(self.rate / (2.5 * self.cut))))

    @property
    def noise_gain(self) -> float:
        """Standard deviation of white noise behind it, as a share of that before it."""
        pulse = np.zeros(int(20 * self.rate / self.cut) | 1)
        pulse[len(pulse) // 2] = 1.0
        return float(np.linalg.norm(self(pulse)))


def motions(record: Record, ends: Sequence[Coordinate], torques: Sequence[str]) -> tuple[list[Motion], Filter]:
    """Every trace, and one low pass for all: its cut is `BAND` times the frequency below which the motion lies.

    Args:
        ends: the coordinate of each joint; torques: the input of each.

    Raises:
        UserError: a position that was not measured; nothing moves.
    """
    for c in ends:
        if c.position not in record.measured:
            raise UserError(
                f"the position '{c.position}' is not measured", remedy="An arm's diagnosis needs every position."
            )
    rate = 1.0 / record.interval
    every = [_even(record, trace, ends, torques, rate) for trace in record.traces]
    band = max(_band(m.v, rate) for m in every)
    if not band > 0.0:
        raise UserError(
            f"no joint moves in any recording (faster than {_STILL:g} rad/s or m/s)", key="measured.files",
            remedy="Name recordings in which the arm moves: at rest dry friction balances any force.",
        )  # fmt: skip
    return every, Filter(min(BAND * band, _OF_THE_RATE * rate), rate)


def _even(record: Record, trace: Trace, ends: Sequence[Coordinate], torques: Sequence[str], rate: float) -> Motion:
    """The trace on its grid; a velocity that was not measured is the derivative of the position."""
    t = np.arange(trace.t[0], trace.t[-1], 1.0 / rate)
    columns = zip((*record.measured, *record.inputs), (*trace.y.T, *trace.u.T), strict=True)
    grid = {name: np.interp(t, trace.t, column) for name, column in columns}
    q, u = (np.stack([grid[n] for n in names], axis=1) for names in ([c.position for c in ends], torques))
    slopes = np.gradient(q, 1.0 / rate, axis=0)
    v = np.stack([grid.get(c.velocity, slopes[:, j]) for j, c in enumerate(ends)], axis=1)
    return Motion(trace.name, t, q, v, u)


def _band(v: Floats, rate: float) -> float:
    """Frequency, Hz, below which all but `SELDOM` of the velocities' energy lies."""
    taper = np.hanning(len(v))[:, None]  # the ends of a trace are no jumps
    power = np.square(np.abs(np.fft.rfft(taper * (v - v.mean(axis=0)), axis=0))).sum(axis=1)
    if not power.sum() > 0.0 or np.abs(v).max() < _STILL:  # at rest: what moves is noise
        return 0.0
    share = np.cumsum(power) / power.sum()
    return float(np.fft.rfftfreq(len(v), 1.0 / rate)[np.searchsorted(share, 1.0 - SELDOM)])


TERMS: Mapping[str, Callable[[Floats, Floats, Floats], Floats]] = {
    "viscous_friction": lambda v, way, a: v,
    "coulomb_friction": lambda v, way, a: way,
    "quadratic_drag": lambda v, way, a: v * np.abs(v),
    "reflected_inertia": lambda v, way, a: a,
    "input_bias": lambda v, way, a: -np.ones_like(v),
}
"""Effects with one number that enters linearly: (velocity, direction, acceleration) of joints -> their torque for a
parameter of 1; direction is the sign of the velocity, and between -1 and 1 at rest."""


INERTIAL, PAYLOAD = "inertial_parameters", "payload"


@dataclass(frozen=True)
class Payload:
    """Something more that was mounted on a link while some traces were recorded; its mass in kg where it is known."""

    traces: tuple[str, ...]
    link: str
    mass: float | None = None


@dataclass(frozen=True)
class Key:
    """What a column stands for: the effect, what it is on (a joint, its input, a link), and the parameter.

    `joint`: number of the joint that a term is of; None for what several joints feel.
    """

    effect: str
    on: str
    symbol: str
    joint: int | None = None


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of some traces.

    Attributes:
        x: (R, n, p) torque of each joint for a parameter of 1; y: (R, n) measured torque less the declared model's.
        live: (R, n) 0 where the joint is at rest, so that dry friction may be anything.
        trace: (R,) index of the trace; t: (R,) s; torque: (R, n) as measured.
    """

    x: Floats
    y: Floats
    live: Floats
    trace: Ints
    t: Floats
    torque: Floats

    def of(self, rows: Ints) -> Part:
        """Some of the rows."""
        return Part(*(getattr(self, f.name)[rows] for f in fields(self)))

    def beside(self, *others: Part) -> Part:
        """The rows of all."""
        return Part(*(np.concatenate([getattr(p, f.name) for p in (self, *others)]) for f in fields(self)))

    def grams(self, weights: Floats) -> tuple[Floats, Floats]:
        """(p, p) and (p,): X'WX and X'Wy, joints weighted."""
        w = self.live * weights**2
        wx = self.x * w[:, :, None]
        flat = self.x.reshape(-1, self.x.shape[2])
        return flat.T @ wx.reshape(flat.shape), wx.reshape(flat.shape).T @ self.y.ravel()


def keys_of(tree: Tree, base: BaseParameters, inputs: Sequence[str], payloads: Sequence[Payload]) -> tuple[Key, ...]:
    """What each column is: combinations of inertial parameters, terms of each joint, payloads."""
    found = [Key(INERTIAL, link, name) for link, name in zip(base.links, base.names, strict=True)]
    for j, joint in enumerate(tree.joints):
        for e in map(effect, TERMS):
            found.append(Key(e.name, inputs[j] if e.kind == "input" else joint, e.parameters[0].symbol, j))
    for p in payloads:
        found += [Key(PAYLOAD, p.link, PARAMETERS[k]) for k in payload_columns(tree, p)]
    return tuple(found)


def payload_columns(tree: Tree, payload: Payload) -> Ints:
    """Which inertial parameters of a body on that link a motion shows, its known mass left out."""
    rng = np.random.default_rng(1)
    q, v, a = rng.normal(size=(3, 100, tree.size))
    first = 10 * tree.links.index(payload.link)
    seen = independent(regressor(tree, q, v, a)[:, :, first : first + 10].reshape(-1, 10))
    return seen[seen > 0] if payload.mass is not None else seen


def part_of(
    motions: Sequence[Motion], low_pass: Filter, tree: Tree, base: BaseParameters, payloads: Sequence[Payload],
    known: Mapping[str, Floats],
) -> Part:  # fmt: skip
    """The rows of some traces, everything smooth.

    Args:
        known: terms that the case declares, effect -> (n,) parameters, which are part of the declared model.
    """
    parts, used, speeds = list[Part](), low_pass.used, [low_pass(m.v) for m in motions]
    # so slow is at rest, where dry friction is any force up to its size
    rest = np.maximum(AT_REST * np.max([np.abs(v).max(axis=0) for v in speeds], axis=0), 1e-9)
    for m, v in zip(motions, speeds, strict=True):
        a = np.gradient(v, 1.0 / low_pass.rate, axis=0)
        whole = low_pass(regressor(tree, low_pass(m.q), v, a))[used]
        felt = low_pass(a)  # as in the regressor: an inertia of bodies and of a rotor are compared alike
        way = low_pass(np.clip(v / (MATTERS * rest), -1.0, 1.0))
        terms = np.stack([column(v, way, felt)[used] for column in TERMS.values()], axis=2)
        rows = (terms[:, :, None] * np.eye(tree.size)[:, :, None]).reshape(len(whole), tree.size, -1)
        weight, carried = _payloads(whole, tree, payloads, m.trace)
        torque = low_pass(m.torque)[used] * known.get("input_gain", np.ones(tree.size))
        missing = torque - whole @ tree.inertial.ravel() - v[used] * tree.damping - weight
        for k, name in enumerate(TERMS):
            missing -= terms[:, :, k] * known.get(name, 0.0)
        x, live = np.concatenate([whole[:, :, base.kept], rows, *carried], axis=2), np.abs(v[used]) > rest
        trace = np.full(len(whole), len(parts), dtype=np.int64)
        parts.append(Part(x, missing, live.astype(np.float64), trace, m.t[used], torque))
    return parts[0].beside(*parts[1:])


def _payloads(whole: Floats, tree: Tree, payloads: Sequence[Payload], trace: str) -> tuple[Floats, list[Floats]]:
    """Torque of the known masses on board (R, n), and columns of what is to be found of each payload."""
    weight, columns = np.zeros(whole.shape[:2]), list[Floats]()
    for p in payloads:
        first, seen = 10 * tree.links.index(p.link), payload_columns(tree, p)
        on_board = trace in p.traces
        columns.append(whole[:, :, first + seen] * float(on_board))
        if on_board and p.mass is not None:
            weight += p.mass * whole[:, :, first]
    return weight, columns


@dataclass(frozen=True, eq=False)
class ArmFolds:
    """Parts of each fold, and the traces that each is made of."""

    fit: Part
    choose: Part
    confirm: Part
    traces: dict[str, tuple[str, ...]]


def folds_of(
    part: Part, names: Sequence[str], held: Sequence[str], share: float, payloads: Sequence[Payload]
) -> ArmFolds:
    """Cut rows into fit, choose and confirm, as `split_folds` cuts windows: traces, or eighths of fewer than three.

    Args:
        part: all rows; names: of the traces that `part.trace` counts.
        held: traces that confirm; if empty, the last `share` of them.
        payloads: of each the first trace that is not held out is fitted to, as nothing else says what it is.

    Raises:
        UserError: nothing would be left to fit to, or nothing of a payload.
    """
    needed = {next((n for n in names if n in p.traces and n not in held), None) for p in payloads}
    order = sorted(range(len(names)), key=lambda k: names[k] not in needed)
    pieces = 1 if held or len(names) >= SEVERAL_TRACES else 8
    rows = [block for k in order for block in np.array_split(np.flatnonzero(part.trace == k), pieces)]
    sizes, own = np.array([len(block) for block in rows]), np.repeat(np.arange(len(order)), pieces)
    begins = np.cumsum(sizes) - sizes
    windows = Windows(begins, begins + sizes, own)
    folds = split_folds([names[k] for k in order], windows, held, share)
    if not folds.complete:
        raise UserError(
            "the traces are too few for the three folds fit, choose and confirm", key="measured.held_out",
            remedy="Record more traces, or hold out fewer.",
        )  # fmt: skip
    parts, traces = {}, {}
    for f in fields(folds):
        mask = getattr(folds, f.name)
        parts[f.name] = part.of(np.sort(np.concatenate([rows[i] for i in np.flatnonzero(mask)])))
        traces[f.name] = tuple(n for k, n in enumerate(names) if order.index(k) in own[mask])
    for p in payloads:
        if not set(p.traces) & set(traces["fit"]):
            raise UserError(
                f"no fitted trace carries the payload of '{p.link}'", key="measured.held_out",
                remedy="Record more traces, or hold out other files.",
            )  # fmt: skip
    return ArmFolds(**parts, traces=traces)
