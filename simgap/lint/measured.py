"""Checks of the `measured` section before a recording is read: names, units, files and their headers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from simgap import reading
from simgap.config.measured import MeasuredSection, named_recordings
from simgap.diagnosis.record.channels import Channel, measured_columns
from simgap.diagnosis.record.conditions import conditioned, refuse_undefined
from simgap.diagnosis.record.traces import same_file
from simgap.effects import EFFECTS
from simgap.errors import Finding, UserError, nearest, placed
from simgap.io.recordings.measured import channels_of, condition_channels
from simgap.io.recordings.tables import kind_of, read_header, read_recording
from simgap.model.symbolic import SymbolicModel
from simgap.plants.context import Context
from simgap.units import conversion


def check_measured(context: Context) -> None:
    """Refuse what `simgap diagnose` would: it takes the header of each file and no row.

    Raises:
        UserError: naming the case file, the key and the remedy.
    """
    section = context.case.measured
    if section is None:
        return
    with context.blame():
        model = context.plant.corrected if context.plant.declared.derived else context.plant.declared
        channels = channels_of(model, section)
        conditions = condition_channels(model, section)
        if section.time.unit is not None:
            with placed(key="measured.time.unit", remedy="Use s, ms, us or ns."):
                conversion(section.time.unit, "s")
        for k, name in enumerate(section.effects):
            if name not in EFFECTS:
                problem, remedy = f"there is no effect '{name}'", nearest(name, EFFECTS)
                raise UserError(problem, key=f"measured.effects.{k}", remedy=remedy)
        refuse_unknown(section, model)
        _refuse_conditions(section, model)
        refuse_links(context, section)
        if section.files:
            paths = named_recordings(context.path, section.files)
            for path in paths:
                _refuse_columns(context, section, (*channels, *conditions), path)
            _refuse_other_files(section, [reading.relative(path, context.folder) for path in paths])


def as_read(context: Context) -> list[str]:
    """A line on each recording of a case: its rows (not of MCAP, which takes long), its columns with their units.

    Raises:
        UserError: a column of time stamps that a diagnosis would refuse.
    """
    section, model = context.case.measured, context.plant.declared
    if section is None or not section.files:
        return []
    with context.blame():
        paths = named_recordings(context.path, section.files)
        channels = channels_of(model, section)
        return [_as_read(path, reading.relative(path, context.folder), section, channels) for path in paths]


def _as_read(path: Path, name: str, section: MeasuredSection, channels: Sequence[Channel]) -> str:
    (header, units), time, told = read_header(path, name), section.time, f"{name}: "
    if kind_of(path) != "mcap":
        table = read_recording(path, [], time.column, section.trace_column, name)
        told += f"{table.rows:,} rows; {time.column} in {time.unit or table.time_unit or 's'}, "
    held = [(c, c.column_unit or units.get(c.column) or c.unit or "1") for c in channels if c.constant is None]
    return told + ", ".join(
        f"{c.name}{f' from {c.column}' * (c.column != c.name)} in {unit}" for c, unit in held if c.column in header
    )


def find_missing_coordinates(context: Context) -> Iterator[Finding]:
    """Equations of which a diagnosis seeks no force: it would blame what is left on inputs and sensors."""
    model = context.plant.declared
    if context.case.measured is not None and model.wheels is None and not model.coordinates:
        yield Finding(
            "plant.symbolic.coordinates",
            "is not given, so that a diagnosis seeks no friction, spring or other force on the motion",
            "Name the degrees of freedom there if something moves",
        )


def refuse_unknown(section: MeasuredSection, model: SymbolicModel) -> None:
    """Names under `measured.known` that are none of the plant's parameters.

    Raises:
        UserError: naming the key and the remedy.
    """
    for k, name in enumerate(section.known):
        if name not in model.named_parameters:
            listed = ", ".join(model.named_parameters) or "it has none"
            remedy = f"Parameters: {listed}."
            raise UserError(f"the plant has no parameter '{name}'", key=f"measured.known.{k}", remedy=remedy)


def _refuse_conditions(section: MeasuredSection, model: SymbolicModel) -> None:
    if model.derived:
        _ = model.numeric()  # refuses parameters as declared under which a rate is no number
    for k, condition in enumerate(section.conditions):
        try:
            _ = conditioned(model, tuple(condition.values))
            refuse_undefined(model, condition.values)
        except UserError as error:
            raise UserError(error.problem, key=f"measured.conditions.{k}", remedy=error.remedy) from None


def refuse_links(context: Context, section: MeasuredSection) -> None:
    """An arm's payloads hang on links that a joint moves; nothing in its regression differs from file to file.

    Raises:
        UserError: naming the key.
    """
    tree = None if context.plant.declared.derived else context.plant.tree
    for key in ("conditions", "conditions_from") if tree is not None else ():
        if getattr(section, key):
            problem = "a diagnosis of three joints or more knows no such conditions"
            remedy = "Remove them; weights that were mounted can be named under measured.payloads."
            raise UserError(problem, key=f"measured.{key}", remedy=remedy)
    if not section.payloads:
        return
    if tree is None:
        problem = "payloads are found on arms of three joints or more alone"
        remedy = "Remove them; what differs from file to file can be named under measured.conditions."
        raise UserError(problem, key="measured.payloads", remedy=remedy)
    for k, payload in enumerate(section.payloads):
        if payload.link not in tree.links:
            raise UserError(
                f"no joint moves a link '{payload.link}'", key=f"measured.payloads.{k}.link",
                remedy=f"Moving links: {', '.join(tree.links)}.",
            )  # fmt: skip


def _refuse_columns(context: Context, section: MeasuredSection, channels: Sequence[Channel], path: Path) -> None:
    """The header of one file against what the case maps."""
    name = reading.relative(path, context.folder)
    header, units = read_header(path, name)
    if section.time.column not in header and kind_of(path) != "mcap":  # its messages have stamps
        listed = ", ".join(f"'{column}'" for column in header)
        problem = f"'{name}' has no time column '{section.time.column}', it has {listed}"
        remedy = "Name its column of time stamps."
        raise UserError(problem, file=context.path, key="measured.time.column", remedy=remedy)
    measured_columns(name, header, units, channels)


def _refuse_other_files(section: MeasuredSection, files: Sequence[str]) -> None:
    """Refuse what the case says of a file that is none of its recordings: it would be passed over in silence."""
    spoken_of = {f"masks.{k}.file": m.file for k, m in enumerate(section.masks) if m.file is not None}
    spoken_of |= {f"conditions.{k}.file": c.file for k, c in enumerate(section.conditions)}
    spoken_of |= {f"payloads.{k}.file": p.file for k, p in enumerate(section.payloads)}
    spoken_of |= {f"held_out.files.{k}": name for k, name in enumerate(section.held_out.files)}
    for key, name in spoken_of.items():
        if not any(same_file(name, file) for file in files):
            remedy = f"Name one of {', '.join(files)}."
            raise UserError(f"'{name}' is not among the data", key=f"measured.{key}", remedy=remedy)
