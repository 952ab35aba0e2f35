"""Columns of a recording, which of them is which state or input, and what their cells mean."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.errors import UserError, excerpt, placed
from simgap.units import conversion, full_turn

_LARGEST = 1e100
"""In the model's unit; sums of squares of larger numbers overflow."""


@dataclass(frozen=True, eq=False)
class RawTable:
    """The columns of one file that were asked for.

    Attributes:
        file: the name that messages and reports use.
        header: every column of the file, asked for or not.
        time: (n,) stamps as recorded, float64 or int64; int64 keeps nanoseconds since an epoch exact.
        time_unit: unit of the stamps if the file itself says so (a time-stamp type), else None.
        columns: (n,) float64 each, finite or NaN where the cell is empty.
        labels: (n,) text of the trace column, or None where the file has none.
        units: unit stored with a column in the file.
        notes: what a person should know of how it was read, in sentences.
    """

    file: str
    header: tuple[str, ...]
    time: Floats | Ints
    time_unit: str | None
    columns: Mapping[str, Floats]
    labels: NDArray[np.str_] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    sha256: str = ""
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.time.size)


def no_time_column(time: str, header: Sequence[str], file: str) -> UserError:
    """What to say of a file without the column of stamps."""
    return UserError(
        f"no time column '{time}' among {excerpt(_listed(header), 200)}",
        file=file,
        remedy="Name it with measured.time.column in the case.",
    )


@dataclass(frozen=True)
class Channel:
    """A state or an input of the model and the column it comes from.

    The value is `scale * (cell converted to unit) + offset`, in `unit`, the model's own.

    Attributes:
        name: state or input.
        unit: its unit in the model.
        is_input: whether it is an input.
        column: name of the column.
        column_unit: unit of the cells; None: what the file says, else `unit`.
        wrapped: whether the cells jump by full turns; None: found from the data.
        constant: value of an input that was held and not recorded.
        mapped: whether the case maps it, so that a missing column is a mistake.
        section: the keys of the case that map it.
    """

    name: str
    unit: str
    is_input: bool
    column: str
    column_unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    wrapped: bool | None = None
    constant: float | None = None
    mapped: bool = False
    section: str = "columns"

    @property
    def key(self) -> str:
        """The case's key for it."""
        return f"measured.{self.section}.{self.name}"


Turns = Mapping[str, tuple[float, bool | None]]
"""Of channels that may be wrapped: a full turn in the model's unit, and whether they are (None: the data decide)."""


def measured_columns(
    file: str, header: Sequence[str], units: Mapping[str, str], channels: Sequence[Channel]
) -> tuple[str, ...]:
    """The states that a file with this header holds, in the model's order; `units` are those stored with columns.

    Raises:
        UserError: if it holds none, lacks a column that the case names or an input that is not declared constant, or
            stores a unit that is not the channel's. What the case has to say otherwise names its key and no file.
    """
    read = [c for c in channels if c.constant is None]
    for c in read:
        if c.mapped and c.column not in header:
            raise UserError(
                f"'{file}' has no column '{c.column}', it has {_listed(header)}",
                key=f"{c.key}.column", remedy="Name one of its columns.",
            )  # fmt: skip
    found = tuple(c.name for c in channels if not c.is_input and c.column in header)
    if not found:
        states = [c.name for c in channels if not c.is_input]
        raise UserError(
            f"none of its columns {_listed(header)} is a state of the model ({_listed(states)})",
            file=file,
            remedy=f"Rename a column, or map it in the case: `measured: {{columns: {{{states[0]}: COLUMN}}}}`.",
        )
    for c in read:
        if c.is_input and c.column not in header:
            raise UserError(
                f"no column for the input '{c.name}' among {_listed(header)}",
                file=file,
                remedy=f"Map it with {c.key}.column, or give {c.key}.constant if it was held.",
            )
        if c.column in header:
            _affine(c.column_unit or units.get(c.column) or c.unit, c, file)
    return found


def convert(table: RawTable, channels: Sequence[Channel]) -> tuple[Mapping[str, Floats], Turns]:
    """All channels of a file in the model's units, (rows,) each; angles still wrapped, and which may be.

    Raises:
        UserError: for a unit that cannot be converted, or that is no angle where the case says that it wraps; for a
            number that nothing measures.
    """
    values: dict[str, Floats] = {}
    turns: dict[str, tuple[float, bool | None]] = {}
    for c in channels:
        if c.constant is not None:
            values[c.name] = np.full(table.rows, c.constant)
        elif c.column in table.columns:
            unit = c.column_unit or table.units.get(c.column) or c.unit
            factor, shift = _affine(unit, c, table.file)
            with np.errstate(over="ignore"):
                values[c.name] = table.columns[c.column] * (c.scale * factor) + (c.scale * shift + c.offset)
            beyond = np.flatnonzero(np.abs(values[c.name]) > _LARGEST)
            if beyond.size:
                raise UserError(
                    f"row {beyond[0] + 1}, column '{c.column}': {values[c.name][beyond[0]]:.3g} {c.unit} is no reading",
                    file=table.file, remedy=f"Correct the cell, or unit, scale and offset under {c.key}.",
                )  # fmt: skip
            turn = full_turn(unit)
            if c.wrapped and turn is None:
                raise UserError(f"'{unit}' is not an angle, so it cannot be wrapped", file=table.file, key=c.key)
            if turn is not None and c.wrapped is not False and not c.is_input:
                turns[c.name] = (abs(turn * factor * c.scale), c.wrapped)
    return values, turns


def _affine(unit: str, c: Channel, file: str) -> tuple[float, float]:
    with placed(file=file, key=f"{c.key}.unit" if c.column_unit else f"column '{c.column}'"):
        change = conversion(unit, c.unit)
    return change.factor, change.shift


def unwrap(values: Floats, dt: Floats, typical_dt: float, turn: float, wrapped: bool | None) -> tuple[Floats, bool]:
    """Angles without jumps by a full turn: (n,), intervals (n-1,) -> (n,) and whether anything changed.

    With `wrapped` None the data decide: they are wrapped if they stay within one turn and jump by more than half a
    turn between neighbours that are an ordinary interval apart.
    """
    jumps = np.abs(np.diff(values)) > 0.5 * turn
    if wrapped is None:
        within = np.ptp(values) <= turn * (1 + 1e-6)
        wrapped = bool(within and np.any(jumps & (dt <= 3.0 * typical_dt)))
    if not wrapped or not jumps.any():
        return values, False
    return np.unwrap(values, period=turn), True


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"'{n}'" for n in names)


LONGEST = 160
"""Characters of a list of columns; some recordings have hundreds."""


def column_words(tables: Sequence[RawTable], channels: Sequence[Channel], others: Collection[str]) -> tuple[str, ...]:
    """A line for each file, or one for all where they are alike; none where every column has the name of its state.

    Args:
        others: columns that are neither a state nor an input, such as those of time and of traces.
    """
    told = [(table.file, "; ".join(_words(table.header, channels, others))) for table in tables]
    if len({words for _, words in told}) == 1:
        return tuple(f"Columns: {words}." for _, words in told[:1] if words)
    return tuple(f"Columns of {file}: {words}." for file, words in told if words)


def _words(header: Sequence[str], channels: Sequence[Channel], others: Collection[str]) -> Iterator[str]:
    read = [c for c in channels if c.constant is None and c.column in header]
    renamed = [f"{c.name} is read from '{excerpt(c.column, 40)}'" for c in read if c.column != c.name]
    if renamed:
        yield _some(renamed)
    left = [name for name in header if name not in others and name not in {c.column for c in read}]
    lacking = [c.name for c in channels if c.constant is None and c.column not in header]
    if left:
        names = _some([f"'{excerpt(name, 40)}'" for name in left])
        yield f"{names} {'is' if len(left) == 1 else 'are'} not used, as the model has no such state or input"
    if lacking and left:  # else velocities that nobody measured, as in most recordings
        count, it = ("count", "one of them") if len(lacking) > 1 else ("counts", "it")
        yield f"{', '.join(lacking)} {count} as not measured (name a column that is {it} under measured.columns)"


def _some(parts: Sequence[str]) -> str:
    """A list of parts, whole ones as far as there is room, and how many more there are."""
    ends = np.cumsum([len(part) + 2 for part in parts])
    kept = parts[: max(1, int(np.searchsorted(ends, LONGEST, side="right")))]
    return ", ".join(kept) + (f" and {len(parts) - len(kept)} more" if len(kept) < len(parts) else "")
