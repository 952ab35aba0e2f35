"""Columns that are not what the case says: two that were swapped, a wrong sign or unit, one that says nothing.

Which of two columns is the derivative of the other is kinematics, so that no missing effect, however large, hides a
position and a velocity that are swapped. Other columns, signs and units are tried with the model as
declared (`search.columns`), or show as a gain that no motor has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.base import Fault, Mended, SeenFault
from simgap.diagnosis.record.noise import noise_floor
from simgap.diagnosis.record.record import Record, Trace, exchanged
from simgap.diagnosis.result import FoundEffect, RecordingFault
from simgap.diagnosis.thresholds import MATTERS, MOST, WITHIN
from simgap.model.symbolic import SymbolicModel

_REACH_S = 0.1  # by how much a velocity is shifted at most, s


@dataclass(frozen=True)
class VelocityLag:
    """A velocity channel against the derivative of its position.

    Attributes:
        position, velocity: the two states.
        lag_s: by how much the velocity trails (s); negative: it leads.
        scale: velocity channel over derivative of the position; 1 when their units agree.
        mismatch: RMS of what lag and scale leave, over the RMS of the velocity.
    """

    position: str
    velocity: str
    lag_s: float
    scale: float
    mismatch: float

    @property
    def related(self) -> bool:
        """Whether the one is a multiple of the other's derivative."""
        return self.mismatch <= MOST

    @property
    def agrees(self) -> bool:
        """Whether that is in size and sign what the one is of the other."""
        return MOST <= self.scale <= 1.0 / MOST


def velocity_lag(record: Record, position: str, velocity: str) -> VelocityLag | None:
    """Lag and scale between two channels, by least squares over shifts up to `_REACH_S`.

    None where nothing moves, or most of the derivative is noise of the position.

    Both sides are averaged over the same +-m samples, so that noise is tamed and no phase is added: the mean of v over
    [t - m dt, t + m dt] is compared with (q(t + m dt) - q(t - m dt)) / (2 m dt). Source: difference quotient and
    cross-correlation, as in Ljung (1999), System Identification, sec. 6.1; the optimum is refined by a parabola.
    """
    j, k = record.measured.index(position), record.measured.index(velocity)
    dt = record.interval
    m, reach = max(1, round(0.01 / dt)), max(2, round(_REACH_S / dt))
    sums = np.zeros((2 * reach + 1, 3))  # for each shift: v.d, d.d, v.v
    for trace in record.traces:
        sums += _shifted_products(trace, j, k, dt, m, reach)
    cross, power, own = sums.T
    rows = sum(trace.duration / dt - 2 * (m + reach) for trace in record.traces)
    noise = 2.0 * rows * float(noise_floor(record)[j] / (2 * m * dt)) ** 2
    if np.min(power) <= 0.0 or np.min(own) <= 0.0 or noise > MOST * np.min(power):
        return None
    loss = 1.0 - cross**2 / (power * own)
    forward = np.where(cross > 0.0, loss, np.inf)  # half a period late a swing is nearly its own negative
    best = int(np.argmin(forward if np.min(forward) <= MOST**2 else loss))
    if np.sign(cross[reach]) == np.sign(cross[best]) and loss[reach] <= (1.0 + MATTERS) * loss[best]:  # slow motion
        best = reach
    shift = float(best - reach)
    if best != reach and 0 < best < 2 * reach:
        left, mid, right = loss[best - 1 : best + 2]
        bend = left - 2 * mid + right
        shift += 0.5 * float((left - right) / bend) if bend > 0 else 0.0
    scale = float(cross[best] / power[best])
    return VelocityLag(position, velocity, shift * dt, scale, float(np.sqrt(max(loss[best], 0.0))))


def _shifted_products(trace: Trace, j: int, k: int, dt: float, m: int, reach: int) -> Floats:
    """Inner products of the averaged velocity with the derivative of the position at every shift, (2 reach + 1, 3)."""
    even = np.arange(trace.t[0], trace.t[-1], dt)
    if even.size < 4 * (reach + m):
        return np.zeros((2 * reach + 1, 3))
    q, v = (np.interp(even, trace.t, trace.y[:, c]) for c in (j, k))
    slope = (q[2 * m :] - q[: -2 * m]) / (2 * m * dt)
    running = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))])
    mean = (running[2 * m :] - running[: -2 * m]) / (2 * m)
    inner = slope[reach:-reach]
    cross, own = np.correlate(mean, inner), np.correlate(mean**2, np.ones_like(inner))
    return np.stack([cross, np.full_like(cross, inner @ inner), own], axis=1)


class SwappedColumns(SeenFault):
    """Two columns are swapped.

    Detected: a position and its velocity: the one is the derivative of the other, the wrong way round (kinematics
    alone: no missing effect masks it); other columns as `wrong_unit`; exchanged.
    """

    name = "swapped_columns"
    unit = ""

    def mend(self, record: Record, model: SymbolicModel) -> Mended:
        """The record with positions and velocities in their places.

        Columns are exchanged where the one called position is the derivative of the one called velocity, in size and
        with little left, and the other way round is not so.
        """
        faults = []
        for c in model.coordinates:
            if c.position not in record.measured or c.velocity not in record.measured:
                continue
            as_called, other_way = (
                velocity_lag(record, *names) for names in ((c.position, c.velocity), (c.velocity, c.position))
            )
            if _is_derivative(other_way) and not _is_derivative(as_called):
                y, u = range(len(record.measured)), range(len(record.inputs))
                order = exchanged(y, record.measured.index(c.position), record.measured.index(c.velocity))
                record = record.with_columns(order, u, np.ones(len(y)), np.ones(len(u)))
                faults.append(self.of(c.position, c.velocity))
        return record, tuple(faults)

    def of(self, first: str, second: str, sentence: str = "") -> RecordingFault:
        """The finding of two channels."""
        sentence = sentence or f"The columns of {first} and {second} are swapped; they were exchanged."
        remedy = f"Map them with measured.columns.{first}.column and measured.columns.{second}.column."
        return self.told(f"{first}, {second}", None, sentence, remedy)


class WrongSign(Fault):
    """A column has the other sign.

    Detected: as `wrong_unit`; of a velocity and its position also where the one is the negative of the other's
    derivative (kinematics: no missing effect masks it); of an input only where a search with it reversed predicts
    better, else its gain is negative, and stays named: a reversed wire and a reversed column look alike.
    """

    name = "wrong_sign"
    remedy = "Give measured.columns.{}.scale: -1, or swap its wires."

    def of(self, name: str) -> RecordingFault:
        """The finding of a column that was turned."""
        return self.told(name, -1.0, f"The column of {name} has the wrong sign; it was reversed.")

    def in_gain(self, found: FoundEffect) -> Iterator[RecordingFault]:
        """The finding behind an input's gain."""
        if found.parameters["ratio"].ci95[1] < 0.0:
            sentence = f"{found.on} is reversed: its column, its wiring or its motor has the wrong sign."
            scale = "If the column is wrong, give measured.columns.{}.scale: -1"
            yield self.told(found.on, -1.0, sentence, f"{scale}; otherwise swap the wires or change the case.")


class WrongUnit(Fault):
    """A column is in another unit than the case says.

    Detected: the declared model misses by a chi^2/dof of 100 or more: each unit is tried, alone and with friction,
    biases and gains near 1, and taken if the error falls below a hundredth; below a fifth, if a search in it predicts
    better; or an input's gain equals a ratio of units often confused, and stays named.
    """

    name = "wrong_unit"
    ratios: Mapping[str, float] = {
        "logged in units a thousand times too large": 1000.0,
        "logged in thousandths": 1e-3,
        "degrees for radians": math.pi / 180,
        "radians for degrees": 180 / math.pi,
        "turns a minute for radians a second": math.pi / 30,
        "radians a second for turns a minute": 30 / math.pi,
    }
    """True over logged, of units that are often mistaken for each other."""

    def of(self, name: str, words: str, factor: float) -> RecordingFault:
        """The finding of a column that was converted, or of several together."""
        sentence = f"The column of {name} is in {words}; it was converted by {factor:.4g}."
        first = name.split(", ")[0]
        remedy = f"Give the column's unit (or scale: {factor:.6g}) under measured.columns.{first}."
        return self.told(name, factor, sentence, remedy)

    def in_gain(self, found: FoundEffect) -> Iterator[RecordingFault]:
        """The findings behind an input's gain."""
        ratio = found.parameters["ratio"]
        lo, hi = sorted(map(abs, ratio.ci95))
        for words, factor in self.ratios.items():
            if lo <= factor * (1 + WITHIN) and hi >= factor * (1 - WITHIN) and hi < 1.2 * lo:
                sentence = f"{found.on} acts {ratio.value:.4g} times as strongly as its column says: {words}?"
                remedy = "If so, give its column's unit under measured.columns.{}."
                yield self.told(found.on, ratio.value, sentence, remedy)


class ConstantColumn(Fault):
    """The torque of an arm's joint never changes while the arm moves.

    Detected: its spread is nothing beside that of the declared arm's torque; nothing is fitted to it.
    """

    name = "constant"
    unit = ""
    remedy = "Log the torque of {0}, or map its column with measured.columns.{0}.column."


def velocity_lags(record: Record, model: SymbolicModel) -> Iterator[VelocityLag]:
    """Of every coordinate that moves whose velocity is declared to be the rate of its position, both measured."""
    rates = dict(zip(model.state_names, map(str, model.xdot), strict=True))
    for c in model.coordinates:
        if {c.position, c.velocity} <= {*record.measured} and rates[c.position] == c.velocity:
            lag = velocity_lag(record, c.position, c.velocity)
            if lag is not None:
                yield lag


def _is_derivative(lag: VelocityLag | None) -> bool:
    return lag is not None and lag.related and lag.agrees
