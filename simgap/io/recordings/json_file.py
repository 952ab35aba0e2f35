"""Recordings in JSON as plain columns: what stands beside the samples is a column that never changes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.channels import RawTable, no_time_column
from simgap.errors import UserError, excerpt
from simgap.io.recordings.json_samples import Samples, read_samples, require_json_room

_HELD = 32  # bytes of a number while samples are gathered: the number and its place in a list
_ABSENT = object()
_NUMBERS = frozenset({int, float, bool})
_MEND = "Write a number there, or leave the sample out."


def json_header(path: Path, file: str) -> tuple[str, ...]:
    """The names of all columns; every sample is read, as any may bring one more.

    Raises:
        UserError: as `read_json_table`, but for what samples hold.
    """
    header, _ = _gathered(read_samples(path, file), (), file)
    return header


def read_json_table(path: Path, wanted: Sequence[str], time: str, trace: str, file: str, sha256: str) -> RawTable:
    """The wanted columns; those that the file lacks are left out. Booleans are 0 and 1.

    Args:
        path: the file; file: how messages call it; sha256: of its bytes.
        wanted: names of the columns of states and inputs; time: of the stamps; trace: of what tells traces apart.

    Raises:
        UserError: a file that is no JSON, holds no samples or no time, and a value that is missing, not finite or not
            a number (with its row, counted from 1 in the list of samples).
    """
    samples = read_samples(path, file)
    header, cells = _gathered(samples, (time, *wanted, trace), file)
    if time not in header:
        raise no_time_column(time, header, file)
    chosen = [name for name in dict.fromkeys(wanted) if name in header and name != time]
    labels = _labels(cells[trace], file, trace) if trace in header and trace not in (time, *chosen) else None
    return RawTable(
        file=file, header=header, time=_stamps(cells[time], file, time), time_unit=None,
        columns={name: _numbers(cells[name], file, name) for name in chosen}, labels=labels, sha256=sha256,
    )  # fmt: skip


def _gathered(samples: Samples, asked: Iterable[str], file: str) -> tuple[tuple[str, ...], dict[str, list[Any]]]:
    """The names of all columns, and the cells of those that are asked for."""
    constants, varying, rows = samples.constants, dict[str, None](), 0
    cells: dict[str, list[Any]] = {name: [] for name in asked}
    for rows, row in enumerate(samples.rows, 1):
        if not row.keys() <= varying.keys():
            varying |= dict.fromkeys(row)
        for name, own in cells.items():
            own.append(row.get(name, _ABSENT))
        if rows % 4096 == 0:
            require_json_room(rows * len(cells) * _HELD, file)
    if not rows:
        raise UserError("has no samples", file=file, remedy="Check the recording.")
    twice = next((name for name in constants if name in varying), None)
    if twice is not None:
        raise UserError(
            f"'{excerpt(twice, 40)}' stands in the samples and beside them", file=file, remedy="Rename one of them."
        )
    for name in constants.keys() & cells.keys():
        cells[name] = list(repeat(constants[name], rows))
    return tuple(_text(name) for name in (*varying, *constants)), cells


def _stamps(cells: Sequence[Any], file: str, name: str) -> Floats | Ints:
    """Whole numbers stay exact: nanoseconds since an epoch have more digits than a float."""
    if set(map(type, cells)) == {int}:
        try:
            return np.array(cells, dtype=np.int64)
        except OverflowError:
            pass
    return _numbers(cells, file, name)


def _numbers(cells: Sequence[Any], file: str, name: str) -> Floats:
    """A column as finite float64; the first cell that is not one is named."""
    if _NUMBERS.issuperset(map(type, cells)):
        try:
            values = np.array(cells, dtype=np.float64)
        except OverflowError:
            pass
        else:
            if np.isfinite(values).all():
                return values
    row = next(k for k, cell in enumerate(cells) if not _is_number(cell))
    raise _bad(file, name, row, cells[row], "not a finite number")


def _is_number(cell: Any) -> bool:
    try:
        return type(cell) in _NUMBERS and bool(np.isfinite(float(cell)))
    except OverflowError:
        return False


def _labels(cells: Sequence[Any], file: str, name: str) -> NDArray[np.str_]:
    for row, cell in enumerate(cells):
        if cell is None or cell is _ABSENT:
            raise _bad(file, name, row, cell, "not the name of a trace")
    return np.array([_text(str(cell)) for cell in cells], dtype=np.str_)


def _bad(file: str, name: str, row: int, cell: Any, what: str) -> UserError:
    said = f"'{excerpt(cell, 40)}' is {what}"
    if cell is None or cell is _ABSENT:
        said = "null is no reading" if cell is None else "the sample has no such key"
    elif isinstance(cell, str):
        said = f"'{excerpt(cell, 40)}' is a text, not a number"
    return UserError(f"row {row + 1}, key '{excerpt(name, 40)}': {said}", file=file, remedy=_MEND)


def _text(name: str) -> str:
    """A text that every encoding takes: JSON can write halves of a character."""
    return name.encode("utf-8", "backslashreplace").decode()
