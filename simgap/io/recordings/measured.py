"""Recordings named by a case or on the command line become a `Reading`: the one place that maps config to arguments."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from simgap.config.measured import ColumnMap, MeasuredSection
from simgap.diagnosis.record.channels import Channel, column_words, measured_columns
from simgap.diagnosis.record.conditions import told_by_columns
from simgap.diagnosis.record.traces import Reading, read_traces
from simgap.errors import UserError, placed
from simgap.io.recordings.tables import read_recording
from simgap.model.expressions import parse
from simgap.model.symbolic import SymbolicModel
from simgap.reading import relative
from simgap.units import conversion, full_turn


def load_reading(
    model: SymbolicModel,
    section: MeasuredSection,
    paths: Sequence[Path],
    relative_to: Path,
    case: str | None = None,
    strict: bool = True,
) -> Reading:
    """Read recordings of a plant.

    Args:
        model: whose states and inputs are looked for.
        section: mapping, masks, held-out data.
        paths: the files.
        relative_to: directory that file names in results are relative to.
        case: name of the case file, for messages.
        strict: whether held-out data that the case names must be among the files.

    Raises:
        UserError: for anything wrong with the files or the mapping.
    """
    typed = {relative(path, relative_to): str(path) for path in paths}
    try:
        channels, conditions = channels_of(model, section), condition_channels(model, section)
        wanted = [c.column for c in (*channels, *conditions) if c.constant is None]
        tables = [
            read_recording(path, wanted, section.time.column, section.trace_column, relative(path, relative_to))
            for path in paths
        ]
        reading = read_traces(tables, channels, section, strict)
        for t in tables if conditions else ():
            measured_columns(t.file, t.header, t.units, (*channels, *conditions))  # refuses what a file lacks
        conditions_held = {(t.file, label): v for t in tables for label, v in told_by_columns(t, conditions).items()}
        words = column_words(tables, (*channels, *conditions), (section.time.column, section.trace_column))
        held = {name: conditions_held[origin] for name, origin in reading.origins.items() if origin in conditions_held}
        return replace(reading, columns=words, conditions=held)
    except UserError as error:  # results name a file relative to the case, a message as the person typed it
        file = typed.get(str(error.file), error.file if error.file is not None else case)
        raise UserError(error.problem, file=file, key=error.key, remedy=error.remedy) from None


def channels_of(model: SymbolicModel, section: MeasuredSection) -> tuple[Channel, ...]:
    """States, then inputs, with the columns they come from.

    Raises:
        UserError: if the case maps something that is neither a state nor an input, or an offset is not a number.
    """
    known = (*model.state_names, *model.input_names)
    _refuse_unknown(section.columns, known, "columns", "neither a state nor an input")
    _refuse_unknown(section.noise, model.state_names, "noise", "not a state")
    return tuple(
        _channel(v.name, v.unit, is_input, section.columns.get(v.name))
        for variables, is_input in ((model.states, False), (model.inputs, True))
        for v in variables
    )


def condition_channels(model: SymbolicModel, section: MeasuredSection) -> tuple[Channel, ...]:
    """Parameters that columns tell, with these columns.

    Raises:
        UserError: what is not a parameter of the plant, the column of time, or a unit of something else.
    """
    _refuse_unknown(section.conditions_from, tuple(model.parameters), "conditions_from", "not a parameter of the plant")
    found = []
    for name, column in section.conditions_from.items():
        if column.column == section.time.column:
            problem = f"'{column.column}' is the column of time stamps"
            remedy = "Name one that holds the parameter."
            raise UserError(problem, key=f"measured.conditions_from.{name}.column", remedy=remedy)
        unit = model.parameters[name].unit
        _refuse_unit(f"measured.conditions_from.{name}", unit, column.unit)
        found.append(
            Channel(name, unit, True, column.column, column.unit, column.scale, mapped=True, section="conditions_from")
        )
    return tuple(found)


def _refuse_unknown(names: Iterable[str], known: Sequence[str], key: str, what: str) -> None:
    for name in names:
        if name not in known:
            raise UserError(f"'{name}' is {what}", key=f"measured.{key}.{name}", remedy=f"Known: {', '.join(known)}.")


def _channel(name: str, unit: str, is_input: bool, given: ColumnMap | None) -> Channel:
    column, key = given or ColumnMap(), f"measured.columns.{name}"
    if column.constant is not None and not is_input:
        remedy = "Leave out a state that was not measured."
        raise UserError("a state cannot be constant", key=f"{key}.constant", remedy=remedy)
    _refuse_unit(key, unit, column.unit)
    if column.wrapped and full_turn(column.unit or unit) is None:
        problem = f"'{column.unit or unit}' is not an angle, so it cannot be wrapped"
        raise UserError(problem, key=f"{key}.wrapped", remedy="Remove it, or correct the unit.")
    return Channel(
        name,
        unit,
        is_input,
        column=column.column or name,
        column_unit=column.unit,
        scale=column.scale,
        offset=_number(column.offset, f"{key}.offset"),
        wrapped=column.wrapped,
        constant=column.constant,
        mapped=given is not None,
    )


def _refuse_unit(key: str, unit: str, cells: str | None) -> None:
    """A unit of the cells that does not exist or is of something else."""
    with placed(key=f"{key}.unit"):
        conversion(unit if cells is None else cells, unit)


def _number(value: float | str, key: str) -> float:
    if isinstance(value, int | float):
        return float(value)
    with placed(key=key, remedy="Write a number, or one like -pi/2."):
        return float(parse(value, ()))
