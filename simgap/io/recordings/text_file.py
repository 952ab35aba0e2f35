"""Recordings in text files: the layout of a CSV file (delimiter, decimal sign, header), and columns of JSON.

A JSON document, as loggers and servo benches write it, is a list of objects, an object of equally long arrays, or an
object that holds one list of objects beside what holds throughout (a mass, a gain), which becomes a column that never
changes; lines of JSON are an object each.
"""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, repeat
from pathlib import Path
from typing import Any, Never

import numpy as np

from simgap import reading
from simgap.errors import UserError, excerpt, placed
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_compute as pc
from simgap.late import pyarrow_csv as pcsv
from simgap.reading import JSON_HELD, require_room

_SHEET = ("is a spreadsheet, not text", "Export the sheet as CSV in UTF-8.")
_OTHERS = {
    b"PK\x03\x04": _SHEET,  # .xlsx, .ods
    b"\xd0\xcf\x11\xe0": _SHEET,  # .xls
    b"\x1f\x8b": ("is compressed (gzip)", "Unpack it (`gunzip`)."),
    b"SQLite format 3": ("is an SQLite database, as older bags of ROS 2 are", "Make MCAP of it (`ros2 bag convert`)."),
    b"#ROSBAG": ("is a bag of ROS 1", "Convert it to ROS 2 messages in MCAP."),
}
_QUOTED = re.compile(r'"[^"]*"')
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class CsvLayout:
    """Layout of a CSV file: lines above the first row of data, delimiter, decimal sign, column names."""

    skip: int
    delimiter: str
    decimal: str
    header: tuple[str, ...]


def csv_layout(path: Path) -> CsvLayout:
    """The layout, from the first lines: comma, semicolon or tab; a header may stand in a '#' line.

    Raises:
        UserError: for an empty file, a file without a header line or one that is not UTF-8 text.
    """
    skip, comment, text, below = _first_lines(path)
    bare = _QUOTED.sub("", text)
    delimiter = next((d for d in ";\t" if d in bare), ",")  # a comma beside one of these is a decimal sign
    if comment and all(_NUMBER.fullmatch(c) for c in _cells(text, delimiter)):
        below, text, skip = [text, *below], comment, skip - 1  # the names stand in the '#' line above the numbers
    names = _cells(text.lstrip("#"), delimiter)
    if all(_NUMBER.fullmatch(n) for n in names if n):
        raise UserError("has no header line", remedy="Add a first line with the names of the columns.")
    twice = sorted({n for n in names if n and names.count(n) > 1})
    if twice:
        raise UserError(f"has two columns named '{twice[0]}'", remedy="Rename one of them.")
    decimal = "," if delimiter != "," and any("," in line for line in below) else "."
    return CsvLayout(skip, delimiter, decimal, names)


def _cells(line: str, delimiter: str) -> tuple[str, ...]:
    """The cells of a line; a delimiter within quotes divides none."""
    try:
        return tuple(c.strip() for c in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [""]))
    except csv.Error as error:
        raise UserError(f"has a line that is not CSV ({error})", remedy="Export it again.") from None


def _first_lines(path: Path) -> tuple[int, str, str, list[str]]:
    """Number of lines up to the first that is neither blank nor '#', the last '#' line, that line, some lines below."""
    comment = ""
    try:
        stream = reading.lines(path)
        for k, line in enumerate(stream):
            if line.startswith("#"):
                comment = line.strip()
            elif line.strip():
                return k + 1, comment, line.rstrip("\r\n"), list(islice(stream, 64))
    except UnicodeDecodeError:
        raise not_text(path) from None
    raise UserError("is empty", remedy="Check the recording.")


def not_text(path: Path) -> UserError:
    """Message for a file that is not UTF-8 text, by how it begins."""
    with reading.opened(path) as stream:
        start = stream.read(16)
    problem, remedy = next(
        (said for magic, said in _OTHERS.items() if start.startswith(magic)),
        ("is not UTF-8 text", "Save it in UTF-8, or as Parquet."),
    )
    return UserError(problem, remedy=remedy)


def read_csv_columns(path: Path, layout: CsvLayout, columns: list[str], types: Mapping[str, Any]) -> Any:
    """The named columns as an Arrow table; a column with a cell that is not a number comes back as text.

    Raises:
        UserError: for a row with too many or too few cells, or a file that cannot be parsed.
    """
    try:
        return _read(path, layout, columns, dict(types))
    except (pa.ArrowException, OSError) as error:
        if "Expected" in str(error) and "columns" in str(error):
            raise _ragged(path, layout) from None
    try:
        return _read(path, layout, columns, {c: pa.string() for c in columns})
    except (pa.ArrowException, OSError) as error:
        raise UserError(f"cannot be read as CSV ({str(error)[:120]})", remedy="Export it again.") from None


def _read(path: Path, layout: CsvLayout, columns: list[str], types: dict[str, Any]) -> Any:
    with reading.opened(path) as stream:
        table = pcsv.read_csv(
            stream,
            read_options=pcsv.ReadOptions(skip_rows=layout.skip, column_names=list(layout.header)),
            parse_options=pcsv.ParseOptions(delimiter=layout.delimiter),
            convert_options=pcsv.ConvertOptions(
                include_columns=columns, column_types=types, decimal_point=layout.decimal, strings_can_be_null=False
            ),
        )
    if layout.decimal == ",":  # text that is converted later must use the point
        for k, name in enumerate(table.column_names):
            if pa.types.is_string(table.column(k).type):
                table = table.set_column(k, name, pc.replace_substring(table.column(k), ",", "."))
    return table


def _ragged(path: Path, layout: CsvLayout) -> UserError:
    """The first row whose number of cells is not that of the header."""
    want, row = len(layout.header), 0
    for k, line in enumerate(reading.lines(path, errors="replace")):
        if k < layout.skip or not line.strip():
            continue
        row += 1
        cells = len(_cells(line.rstrip("\r\n"), layout.delimiter))
        if cells != want:
            commas = layout.delimiter == "," and row == 1
            remedy = "Write decimals with points, or put semicolons between columns." if commas else "Mend the row."
            return UserError(f"row {row} has {cells} cells where the header has {want}", remedy=remedy)
    return UserError("has rows of different lengths", remedy="Export it again.")


_HELD = 32  # bytes of a number while samples are gathered: the number and its place in a list
_ABSENT = object()
_NUMBERS = frozenset({int, float, bool})
_MEND = "Write a number there, or leave the sample out."


def json_cells(path: Path, columns: Iterable[str]) -> tuple[tuple[str, ...], dict[str, list[Any]]]:
    """The names of all columns, and the cells of those that are asked for.

    Raises:
        UserError: a file that is no JSON, is too large or holds no samples.
    """
    (constants, samples), varying, rows = read_samples(path), dict[str, None](), 0
    cells: dict[str, list[Any]] = {name: [] for name in columns}
    for rows, row in enumerate(samples, 1):
        if not row.keys() <= varying.keys():
            varying |= dict.fromkeys(row)
        for name, own in cells.items():
            own.append(row.get(name, _ABSENT))
        if rows % 4096 == 0:
            require_json_room(rows * len(cells) * _HELD)
    if not rows:
        raise UserError("has no samples", remedy="Check the recording.")
    twice = next((name for name in constants if name in varying), None)
    if twice is not None:
        raise UserError(f"'{excerpt(twice, 40)}' appears in the samples and beside them", remedy="Rename one of them.")
    for name in constants.keys() & cells.keys():
        cells[name] = list(repeat(constants[name], rows))
    return tuple(_text(name) for name in (*varying, *constants)), cells


def json_table(cells: Mapping[str, list[Any]], columns: Sequence[str], time: str, labels: str | None) -> pa.Table:
    """The columns as Arrow has them: numbers, booleans as 0 and 1; in `labels` the names of traces, as text.

    Raises:
        UserError: a value that is missing or no number (with its row, counted from 1 in the list of samples).
    """
    return pa.table({n: _labels(cells[n], n) if n == labels else _numbers(cells[n], n, n == time) for n in columns})


def _numbers(cells: Sequence[Any], name: str, stamps: bool) -> pa.Array:
    """A column of numbers, NaN for null; whole stamps stay exact: nanoseconds since an epoch have too many digits."""
    kinds, taken = set(map(type, cells)), _NUMBERS if stamps else _NUMBERS | {type(None)}
    if kinds <= taken:
        for kind in (np.int64, np.float64) if stamps and kinds == {int} else (np.float64,):
            with suppress(OverflowError):
                return pa.array(np.array(cells, dtype=kind))
    row = next(k for k, cell in enumerate(cells) if type(cell) not in taken or abs(cell or 0) > sys.float_info.max)
    raise _bad(name, row, cells[row], "not a finite number")


def _labels(cells: Sequence[Any], name: str) -> pa.Array:
    for row, cell in enumerate(cells):
        if cell is None or cell is _ABSENT:
            raise _bad(name, row, cell, "not the name of a trace")
    return pa.array([_text(str(cell)) for cell in cells], pa.string())


def _bad(name: str, row: int, cell: Any, what: str) -> UserError:
    problem = f"'{excerpt(cell, 40)}' is {what}"
    if cell is None or cell is _ABSENT:
        problem = "null is not a reading" if cell is None else "the sample has no such key"
    elif isinstance(cell, str):
        problem = f"'{excerpt(cell, 40)}' is a text, not a number"
    return UserError(f"row {row + 1}, key '{excerpt(name, 40)}': {problem}", remedy=_MEND)


def _text(name: str) -> str:
    """A text that every encoding takes: JSON can write halves of a character."""
    return name.encode("utf-8", "backslashreplace").decode()


_MOST_PARTS = 64
"""Entries of a list within a sample that become columns; longer ones (pictures, scans) are none. Judgement."""
MOST = reading.MOST // JSON_HELD
"""Characters of a line."""
_SHAPE = 'Write a list of objects, one a sample: [{"t": 0.0, "q": 0.1}, ...].'
_WRITTEN = "Correct it there, or export it again."


Samples = tuple[Mapping[str, Any], Iterator[Mapping[str, Any]]]
"""Name -> a number, a text, a boolean or None that stands beside the samples; the same of each sample, in the order of
the file, read once."""


def read_samples(path: Path) -> Samples:
    """The samples of a file; lines are read as rows are asked for, a document is held whole.

    Raises:
        UserError: a file that is no JSON, is too large or holds no samples; rows raise for what is wrong with them.
    """
    if _are_lines(path):
        return {}, _rows(_line_values(path), "line")
    return _samples(_document(path))


def _are_lines(path: Path) -> bool:
    """True if the first line is a value of its own and others follow it; what the file is called does not matter."""
    try:
        written = (line for line in reading.lines(path, MOST) if line.strip())
        first, more = next(written, ""), next(written, None) is not None
        return more and json.loads(first) is not None
    except (ValueError, RecursionError):  # no text, or no JSON: the document says where
        return False


def _document(path: Path) -> Any:
    require_json_room(path.stat().st_size * JSON_HELD)
    content = reading.read_bytes(path)
    if not content.strip():
        raise UserError("is empty", remedy="Check the recording.")
    return _parsed(content, path)


def _line_values(path: Path) -> Iterator[tuple[int, Any]]:
    """Number of a line that is not blank, and what it says."""
    try:
        for number, line in enumerate(reading.lines(path, MOST), 1):
            if line.strip():
                yield number, _parsed(line, path, number)
    except UnicodeDecodeError:
        raise not_text(path) from None


def _parsed(content: bytes | str, path: Path, number: int | None = None) -> Any:
    """The value of a document, or of a line by its number."""
    try:
        return json.loads(content, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        line = number or error.lineno
        if not error.doc[error.pos :].strip():
            remedy = "Wait until it is written, or copy it again."
            raise UserError(f"ends at line {line} before its JSON does", remedy=remedy) from None
        problem = f"line {line}, column {error.colno} is not JSON ({error.msg})"
        raise UserError(problem, remedy=_WRITTEN) from None
    except UnicodeDecodeError:
        raise not_text(path) from None
    except RecursionError:
        raise UserError("is nested too deeply", remedy=_SHAPE) from None
    except ValueError:  # of Python itself: it reads integers of 4300 digits at most
        raise UserError("holds an integer of thousands of digits", remedy=_WRITTEN) from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise UserError(f"the key '{excerpt(twice, 40)}' appears twice in an object", remedy="Remove one of them.")
    return content


def _samples(content: Any) -> Samples:
    """Samples of a document."""
    if isinstance(content, list):
        return {}, _rows(enumerate(content, 1), "row")
    if not isinstance(content, dict):
        _refuse_kind(content, "the document")
    lists: dict[str, list[Any]] = {}
    constants = _flat(content, "beside the samples", lists)
    records = [name for name, values in lists.items() if values and isinstance(values[0], dict)]
    if len(records) > 1:
        problem = f"holds two lists of samples, '{excerpt(records[0], 40)}' and '{excerpt(records[1], 40)}'"
        raise UserError(problem, remedy="Give each a file of its own.")
    if records:
        return constants, _rows(enumerate(lists[records[0]], 1), "row")
    if not lists:
        raise UserError("holds no list of samples", remedy=_SHAPE)
    first = next(iter(lists))
    for name, values in lists.items():
        if len(values) != len(lists[first]):
            raise UserError(
                f"'{excerpt(name, 40)}' has {len(values)} values and '{excerpt(first, 40)}' {len(lists[first])}",
                remedy="Write arrays of one length, or a list of objects, one a sample.",
            )
    across = ({name: values[k] for name, values in lists.items()} for k in range(len(lists[first])))
    return constants, _rows(enumerate(across, 1), "row")


def _rows(samples: Iterable[tuple[int, Any]], word: str) -> Iterator[Mapping[str, Any]]:
    for number, sample in samples:
        yield _flat(sample, f"{word} {number}")


def _flat(value: Any, place: str, lists: dict[str, list[Any]] | None = None) -> Mapping[str, Any]:
    """The scalars of an object by dotted name. Lists go to `lists`, or become `name.0`, `name.1` ... without it."""
    if not isinstance(value, dict):
        _refuse_kind(value, place)
    if not any(isinstance(inner, dict | list) for inner in value.values()):
        return value
    found: dict[str, Any] = {}
    open_ones: list[tuple[str, Any]] = [(key, value[key]) for key in reversed(value)]
    while open_ones:
        name, inner = open_ones.pop()
        if isinstance(inner, dict) or (isinstance(inner, list) and lists is None):
            pairs = list(inner.items() if isinstance(inner, dict) else enumerate(inner))
            if isinstance(inner, dict) or len(pairs) <= _MOST_PARTS:
                open_ones += [(f"{name}.{key}", below) for key, below in reversed(pairs)]
        elif name in found or (lists and name in lists):
            raise UserError(f"{place}: two values are called '{excerpt(name, 40)}'", remedy="Rename one of the keys.")
        elif isinstance(inner, list) and lists is not None:
            lists[name] = inner
        else:
            found[name] = inner
    return found


def _refuse_kind(value: Any, place: str) -> Never:
    kinds = {list: "a list", str: "a text", bool: "a boolean", int: "a number", float: "a number"}
    raise UserError(f"{place} is {kinds.get(type(value), 'null')}, not an object", remedy=_SHAPE)


def require_json_room(size: int) -> None:
    """Refuse so many bytes if they are too many; the message names the file."""
    with placed(remedy="Write it as lines of JSON (.jsonl) or as Parquet."):
        require_room(size)
