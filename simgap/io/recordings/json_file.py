"""Recordings in JSON as plain columns, as loggers and servo benches write them.

A document is a list of objects, an object of equally long arrays, or an object that holds one list of objects beside
what holds throughout (a mass, a gain), which becomes a column that never changes; lines of JSON are an object each.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any, Never

import numpy as np

from simgap import reading
from simgap.errors import UserError, excerpt, placed
from simgap.io.recordings.csv_file import not_text
from simgap.late import pyarrow as pa
from simgap.reading import JSON_HELD, require_room

_HELD = 32  # bytes of a number while samples are gathered: the number and its place in a list
_ABSENT = object()
_NUMBERS = frozenset({int, float, bool})
_MEND = "Write a number there, or leave the sample out."


def json_cells(path: Path, columns: Iterable[str], file: str) -> tuple[tuple[str, ...], dict[str, list[Any]]]:
    """The names of all columns, and the cells of those that are asked for.

    Raises:
        UserError: a file that is no JSON, is too large or holds no samples.
    """
    samples = read_samples(path, file)
    constants, varying, rows = samples.constants, dict[str, None](), 0
    cells: dict[str, list[Any]] = {name: [] for name in columns}
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
            f"'{excerpt(twice, 40)}' appears in the samples and beside them", file=file, remedy="Rename one of them."
        )
    for name in constants.keys() & cells.keys():
        cells[name] = list(repeat(constants[name], rows))
    return tuple(_text(name) for name in (*varying, *constants)), cells


def json_table(
    cells: Mapping[str, list[Any]], columns: Sequence[str], time: str, labels: str | None, file: str
) -> pa.Table:
    """The columns as Arrow has them: numbers, booleans as 0 and 1; in `labels` the names of traces, as text.

    Raises:
        UserError: a value that is missing or no number (with its row, counted from 1 in the list of samples).
    """
    return pa.table(
        {n: _labels(cells[n], file, n) if n == labels else _numbers(cells[n], file, n, n == time) for n in columns}
    )


def _numbers(cells: Sequence[Any], file: str, name: str, stamps: bool) -> pa.Array:
    """A column of numbers, NaN for null; whole stamps stay exact: nanoseconds since an epoch have too many digits."""
    kinds, taken = set(map(type, cells)), _NUMBERS if stamps else _NUMBERS | {type(None)}
    if kinds <= taken:
        for kind in (np.int64, np.float64) if stamps and kinds == {int} else (np.float64,):
            with suppress(OverflowError):
                return pa.array(np.array(cells, dtype=kind))
    row = next(k for k, cell in enumerate(cells) if type(cell) not in taken or abs(cell or 0) > sys.float_info.max)
    raise _bad(file, name, row, cells[row], "not a finite number")


def _labels(cells: Sequence[Any], file: str, name: str) -> pa.Array:
    for row, cell in enumerate(cells):
        if cell is None or cell is _ABSENT:
            raise _bad(file, name, row, cell, "not the name of a trace")
    return pa.array([_text(str(cell)) for cell in cells], pa.string())


def _bad(file: str, name: str, row: int, cell: Any, what: str) -> UserError:
    problem = f"'{excerpt(cell, 40)}' is {what}"
    if cell is None or cell is _ABSENT:
        problem = "null is not a reading" if cell is None else "the sample has no such key"
    elif isinstance(cell, str):
        problem = f"'{excerpt(cell, 40)}' is a text, not a number"
    return UserError(f"row {row + 1}, key '{excerpt(name, 40)}': {problem}", file=file, remedy=_MEND)


def _text(name: str) -> str:
    """A text that every encoding takes: JSON can write halves of a character."""
    return name.encode("utf-8", "backslashreplace").decode()


_MOST_PARTS = 64
"""Entries of a list within a sample that become columns; longer ones (pictures, scans) are none. Judgement."""
MOST = reading.MOST // JSON_HELD
"""Characters of a line."""
_SHAPE = 'Write a list of objects, one a sample: [{"t": 0.0, "q": 0.1}, ...].'
_WRITTEN = "Correct it there, or export it again."


@dataclass(frozen=True)
class Samples:
    """Samples of a file.

    Attributes:
        constants: name -> a number, a text, a boolean or None that stands beside the samples.
        rows: name -> the same of each sample, in the order of the file; read once.
    """

    constants: Mapping[str, Any]
    rows: Iterator[Mapping[str, Any]]


@dataclass(frozen=True)
class _Twice:
    """Stands for an object that has a key twice, until its place is known."""

    key: str


def read_samples(path: Path, file: str) -> Samples:
    """The samples of a file; lines are read as rows are asked for, a document is held whole.

    Raises:
        UserError: a file that is no JSON, is too large or holds no samples; rows raise for what is wrong with them.
    """
    if _are_lines(path, file):
        return Samples({}, _rows(_line_values(path, file), file, "line"))
    return _samples(_document(path, file), file)


def _are_lines(path: Path, file: str) -> bool:
    """Whether the first line is a value of its own and others follow it; what the file is called does not matter."""
    try:
        written = (line for line in reading.lines(path, file, MOST) if line.strip())
        first, more = next(written, ""), next(written, None) is not None
        return more and json.loads(first) is not None
    except (ValueError, RecursionError):  # no text, or no JSON: the document says where
        return False


def _document(path: Path, file: str) -> Any:
    require_json_room(path.stat().st_size * JSON_HELD, file)
    content = reading.read_bytes(path)
    if not content.strip():
        raise UserError("is empty", file=file, remedy="Check the recording.")
    try:
        return _parsed(content, file, path)
    except json.JSONDecodeError as error:
        raise _malformed(error, file, error.lineno) from None


def _line_values(path: Path, file: str) -> Iterator[tuple[int, Any]]:
    """Number of a line that is not blank, and what it says."""
    try:
        for number, line in enumerate(reading.lines(path, file, MOST), 1):
            if line.strip():
                try:
                    yield number, _parsed(line, file, path)
                except json.JSONDecodeError as error:
                    raise _malformed(error, file, number) from None
    except UnicodeDecodeError:
        raise not_text(path, file) from None


def _parsed(content: bytes | str, file: str, path: Path) -> Any:
    try:
        return json.loads(content, object_pairs_hook=_object)
    except json.JSONDecodeError:
        raise
    except UnicodeDecodeError:
        raise not_text(path, file) from None
    except RecursionError:
        raise UserError("is nested too deeply", file=file, remedy=_SHAPE) from None
    except ValueError:  # of Python itself: it reads integers of 4300 digits at most
        raise UserError("holds an integer of thousands of digits", file=file, remedy=_WRITTEN) from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any] | _Twice:
    content = dict(pairs)
    if len(content) == len(pairs):
        return content
    keys = [key for key, _ in pairs]
    return _Twice(next(key for key in keys if keys.count(key) > 1))


def _malformed(error: json.JSONDecodeError, file: str, line: int) -> UserError:
    if not error.doc[error.pos :].strip():
        return UserError(
            f"ends at line {line} before its JSON does", file=file, remedy="Wait until it is written, or copy it again."
        )
    return UserError(f"line {line}, column {error.colno} is not JSON ({error.msg})", file=file, remedy=_WRITTEN)


def _samples(content: Any, file: str) -> Samples:
    """Samples of a document."""
    if isinstance(content, list):
        return Samples({}, _rows(enumerate(content, 1), file, "row"))
    if not isinstance(content, dict):
        _refuse_kind(content, "the document", file)
    lists: dict[str, list[Any]] = {}
    constants = _flat(content, "beside the samples", file, lists)
    records = [name for name, values in lists.items() if values and isinstance(values[0], dict | _Twice)]
    if len(records) > 1:
        raise UserError(
            f"holds two lists of samples, '{excerpt(records[0], 40)}' and '{excerpt(records[1], 40)}'", file=file,
            remedy="Give each a file of its own.",
        )  # fmt: skip
    if records:
        return Samples(constants, _rows(enumerate(lists[records[0]], 1), file, "row"))
    if not lists:
        raise UserError("holds no list of samples", file=file, remedy=_SHAPE)
    first = next(iter(lists))
    for name, values in lists.items():
        if len(values) != len(lists[first]):
            raise UserError(
                f"'{excerpt(name, 40)}' has {len(values)} values and '{excerpt(first, 40)}' {len(lists[first])}",
                file=file, remedy="Write arrays of one length, or a list of objects, one a sample.",
            )  # fmt: skip
    across = ({name: values[k] for name, values in lists.items()} for k in range(len(lists[first])))
    return Samples(constants, _rows(enumerate(across, 1), file, "row"))


def _rows(samples: Iterable[tuple[int, Any]], file: str, word: str) -> Iterator[Mapping[str, Any]]:
    for number, sample in samples:
        yield _flat(sample, f"{word} {number}", file)


def _flat(value: Any, place: str, file: str, lists: dict[str, list[Any]] | None = None) -> Mapping[str, Any]:
    """The scalars of an object by dotted name. Lists go to `lists`, or become `name.0`, `name.1` ... without it."""
    if not isinstance(value, dict):
        _refuse_kind(value, place, file)
    if not any(isinstance(inner, dict | list | _Twice) for inner in value.values()):
        return value
    found: dict[str, Any] = {}
    open_ones: list[tuple[str, Any]] = [(key, value[key]) for key in reversed(value)]
    while open_ones:
        name, inner = open_ones.pop()
        if isinstance(inner, _Twice):
            _refuse_kind(inner, place, file)
        if isinstance(inner, dict) or (isinstance(inner, list) and lists is None):
            pairs = list(inner.items() if isinstance(inner, dict) else enumerate(inner))
            if isinstance(inner, dict) or len(pairs) <= _MOST_PARTS:
                open_ones += [(f"{name}.{key}", below) for key, below in reversed(pairs)]
        elif name in found or (lists and name in lists):
            raise UserError(
                f"{place}: two values are called '{excerpt(name, 40)}'", file=file, remedy="Rename one of the keys."
            )
        elif isinstance(inner, list) and lists is not None:
            lists[name] = inner
        else:
            found[name] = inner
    return found


def _refuse_kind(value: Any, place: str, file: str) -> Never:
    if isinstance(value, _Twice):
        raise UserError(
            f"{place}: the key '{excerpt(value.key, 40)}' appears twice", file=file, remedy="Remove one of them."
        )
    kinds = {list: "a list", str: "a text", bool: "a boolean", int: "a number", float: "a number"}
    raise UserError(f"{place} is {kinds.get(type(value), 'null')}, not an object", file=file, remedy=_SHAPE)


def require_json_room(size: int, file: str) -> None:
    """Refuse so many bytes if they are too many; the message names the file."""
    with placed(file=file, remedy="Write it as lines of JSON (.jsonl) or as Parquet."):
        require_room(size)
