"""Recordings under known conditions: parameters of the plant whose values differ from file to file.

To the fit such a parameter is one more input, held at its value throughout a trace: one set of effects is fitted to all
files, and what one condition alone cannot tell is separated by the others. Nothing acts between it and the plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from simgap.config.measured import Condition
from simgap.diagnosis.record.channels import Channel, RawTable, convert
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.record.traces import Reading, by_label, same_file
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel, Variable

_KEY = "measured.conditions"


def conditioned(model: SymbolicModel, names: Sequence[str]) -> SymbolicModel:
    """The model with some parameters as inputs, after its own.

    Raises:
        UserError: a name that is no parameter.
    """
    if not names:
        return model
    for name in names:
        if name not in model.parameters:
            known = [n for n in model.parameters if "." not in n]
            raise UserError(f"'{name}' is not a parameter of the plant", key=_KEY, remedy=f"Known: {', '.join(known)}.")
    more = tuple(Variable(n, model.parameters[n].unit) for n in names)
    left = {n: p for n, p in model.parameters.items() if n not in names}
    return replace(model, inputs=(*model.inputs, *more), parameters=left, conditions=tuple(names))


def refuse_undefined(model: SymbolicModel, values: Mapping[str, float]) -> None:
    """Refuses values of parameters under which a rate of the plant is no number.

    Raises:
        UserError: naming the rate and the values.
    """
    try:
        _ = model.numeric(values)
    except UserError as error:
        raise UserError(error.problem, key=_KEY, remedy="Correct the value, or the equation.") from None


def told_by_columns(table: RawTable, channels: Sequence[Channel]) -> dict[str | None, dict[str, float]]:
    """What columns of a file that never change say: value of the trace column -> parameter -> value, in its unit.

    Args:
        channels: parameters and their columns, which the file has.

    Raises:
        UserError: a column that changes within a file or, where its traces are told apart, within a trace.
    """
    values, found = convert(table, channels)[0], dict[str | None, dict[str, float]]()
    for label, rows in by_label(table):
        for c in channels:
            written = rows[~np.isnan(values[c.name][rows])]  # it never changes: some cells may be empty
            own = values[c.name][written]
            if not own.size:
                raise UserError(
                    f"row {rows[0] + 1}, '{c.column}': the cell is empty, as are all of its trace",
                    file=table.file, key=c.key, remedy="Write the value there, or give it under measured.conditions.",
                )  # fmt: skip
            other = np.flatnonzero(own != own[0])
            if other.size:
                raise UserError(
                    f"row {written[other[0]] + 1}: '{c.column}' gives {own[other[0]]:.6g} {c.unit} where it gave "
                    f"{own[0]:.6g} before", file=table.file, key=c.key,
                    remedy="A condition holds throughout: cut the file there, or separate its parts by a trace column; "
                    "for what is measured with noise state its mean under measured.conditions.",
                )  # fmt: skip
            found.setdefault(label, {})[c.name] = float(own[0])
    return found


def under_conditions(
    reading: Reading, model: SymbolicModel, conditions: Sequence[Condition]
) -> tuple[Record, tuple[str, ...]]:
    """The record with a column for each parameter that differs, and their names; what a file does not say is declared.

    Args:
        reading: as read; its own conditions, from columns, are of other parameters than those that are stated.
        model: with the parameters as declared.

    Raises:
        UserError: a condition of a file that is no recording, or of two, or under which a rate is no number.
    """
    told = (*(c.values for c in conditions), *reading.conditions.values())
    names = tuple(dict.fromkeys(n for values in told for n in values))
    files = {file for file, _ in reading.origins.values()}
    for c in conditions:
        if not any(same_file(c.file, file) for file in files):
            raise UserError(f"there is no recording '{c.file}'", key=_KEY, remedy=f"Files: {', '.join(sorted(files))}.")
    _ = conditioned(model, names)  # refuses unknown names
    traces, record = [], reading.record
    for trace in record.traces:
        own = [c for c in conditions if same_file(c.file, reading.origins[trace.name][0])]
        values = {n: model.parameters[n].value for n in names} | dict(reading.conditions.get(trace.name, {}))
        for c in own:
            twice = [n for n in c.values if any(n in other.values for other in own if other is not c)]
            if twice:
                raise UserError(f"'{twice[0]}' is given twice for '{c.file}'", key=_KEY, remedy="Give it once.")
            values |= c.values
        columns = np.tile(np.array([values[n] for n in names], dtype=np.float64), (len(trace.t), 1))
        traces.append(replace(trace, u=np.hstack([trace.u, columns])))
    for numbers in dict.fromkeys(tuple(trace.u[0, len(record.inputs) :].tolist()) for trace in traces):
        refuse_undefined(model, dict(zip(names, numbers, strict=True)))
    return Record(tuple(traces), record.measured, (*record.inputs, *names)), names
