"""Columns that are not what the case says: a wrong sign or unit, two that were swapped.

Such a fault is discrete and large: no effect leads there step by step, and a search under it leads nowhere. Each
possibility is tried on a few windows with the model as declared, before the search, and one is taken up where it misses
by a small part of what the columns as they are miss. An input's sign is left to its gain, which may be negative.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.exchanged import swap
from simgap.diagnosis.reading.record import Record, Trace
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Memo, Problem
from simgap.diagnosis.simulation.step_length import settled
from simgap.diagnosis.thresholds import COLUMN_TELLS, COLUMNS_IN_DOUBT, INPUT_TELLS
from simgap.units import full_turn

Floats = NDArray[np.float64]
_WINDOWS = 8
_LIKE = 0.7  # a later possibility must miss by less than this share of the best before it
_THOUSANDS = (("a thousandth of the declared unit", 1e-3), ("a thousand times the declared unit", 1e3))


@dataclass(frozen=True, eq=False)
class Columns:
    """What the columns may really be.

    Attributes:
        finding: the fault, if it is one.
        y, u: (k,), (m,) factors from logged to true, after the order below.
        y_order, u_order: which logged column each channel is in.
    """

    finding: RecordingFault
    y: Floats
    u: Floats
    y_order: tuple[int, ...]
    u_order: tuple[int, ...]

    def applied(self, problem: Problem) -> Problem:
        """The problem with the columns as they may really be."""
        order, y_scale = list(self.y_order), self.y
        return replace(
            problem,
            y=np.ascontiguousarray(problem.y[:, order] * y_scale),
            u=np.ascontiguousarray(problem.u[:, list(self.u_order)] * self.u),
            sigma=problem.sigma[order] * np.abs(y_scale),
            used=np.ascontiguousarray(problem.used[:, order]),
            weight=np.ascontiguousarray(problem.weight[:, order]),
            memo=Memo(),
        )

    def of_record(self, record: Record) -> Record:
        """The record with the columns as they really are."""
        return replace(record, traces=tuple(self._of_trace(trace) for trace in record.traces))

    def _of_trace(self, trace: Trace) -> Trace:
        used = None if trace.used is None else trace.used[:, list(self.y_order)]
        y, u = trace.y[:, list(self.y_order)] * self.y, trace.u[:, list(self.u_order)] * self.u
        return replace(trace, y=y, u=u, used=used)


def better_columns(problem: Problem) -> Columns | None:
    """The possibility under which the declared model misses least, if it is better by far than the columns as they are.

    A small factor on an input must also be better by far than no input at all, which it comes near to.
    """
    few = np.unique(np.linspace(0, len(problem.windows) - 1, _WINDOWS).astype(int))
    part = problem.on(problem.windows.pick(few))
    bar, best, least = _missed(part), None, np.inf
    if bar < COLUMNS_IN_DOUBT:
        return None
    for option in _options(problem):
        missed = _missed(option.applied(part))
        if missed < (_LIKE if best is not None else 1.0) * least:  # a linear plant: input or reading, one and the same
            best, least = option, missed
    if best is None or least > COLUMN_TELLS * bar or np.any(best.u < 0.0):
        return None
    off = np.inf
    if np.any(best.u < 1.0):
        off = _missed(replace(part, u=np.zeros_like(part.u), memo=Memo()))
    return best if least < INPUT_TELLS * off else None


def _missed(part: Problem) -> float:
    """chi^2/dof of the declared model, initial states fitted."""
    part = settled(part)
    at = fit(part, part.model.null, initial_states(part), [], {})
    return at.chi2 / max(part.size - part.taken, 1)


def _options(problem: Problem) -> Iterator[Columns]:
    names, inputs = problem.model.measured, problem.model.model.input_names
    units = {v.name: v.unit for v in (*problem.model.model.states, *problem.model.model.inputs)}
    k, m = len(names), len(inputs)
    ones, same = (np.ones(k), np.ones(m)), (tuple(range(k)), tuple(range(m)))

    def scaled(which: list[int], factor: float, of_input: bool, finding: RecordingFault) -> Columns:
        y, u = ones[0].copy(), ones[1].copy()
        (u if of_input else y)[which] = factor
        return Columns(finding, y, u, *same)

    for of_input, channels in ((True, inputs), (False, names)):
        for j, name in enumerate(channels):
            yield scaled([j], -1.0, of_input, _sign(name))
            for words, factor in (*_THOUSANDS, *_angles(units[name])):
                yield scaled([j], factor, of_input, _unit(name, words, factor))
    turning = [j for j, name in enumerate(names) if full_turn(units[name].split("/")[0]) is not None]
    if len(turning) > 1:
        yield scaled(turning, np.pi / 180, False, _unit(", ".join(names[j] for j in turning), "degrees", np.pi / 180))
    for i, j in itertools.combinations(range(k), 2):
        yield Columns(swap(names[i], names[j]), *ones, _exchanged(same[0], i, j), same[1])
    for i, j in itertools.combinations(range(m), 2):
        yield Columns(swap(inputs[i], inputs[j]), *ones, same[0], _exchanged(same[1], i, j))


def _angles(unit: str) -> list[tuple[str, float]]:
    """Units that are mistaken for this one, with the factor to it."""
    return {
        "rad": [("degrees", np.pi / 180), ("turns", 2 * np.pi)],
        "rad/s": [("degrees a second", np.pi / 180), ("turns a minute", np.pi / 30)],
    }.get(unit, [])


def _exchanged(order: tuple[int, ...], i: int, j: int) -> tuple[int, ...]:
    out = list(order)
    out[i], out[j] = out[j], out[i]
    return tuple(out)


def _sign(name: str) -> RecordingFault:
    return RecordingFault(
        "wrong_sign", name, -1.0, "1", f"The column of {name} has the other sign; it was turned.",
        f"Give measured.columns.{name}.scale: -1, or turn its wire.",
    )  # fmt: skip


def _unit(name: str, words: str, factor: float) -> RecordingFault:
    return RecordingFault(
        "wrong_unit", name, factor, "1", f"The column of {name} is in {words}; it was converted by {factor:.4g}.",
        f"Give the column's unit (or scale: {factor:.6g}) under measured.columns.{name.split(', ')[0]}.",
    )  # fmt: skip
