"""The layout of a CSV file (delimiter, decimal sign, header) and its columns."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from simgap import reading
from simgap.errors import UserError
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_compute as pc
from simgap.late import pyarrow_csv as pcsv

_SHEET = ("is a spreadsheet, not text", "Export the sheet as CSV in UTF-8.")
_OTHERS = {
    b"PK\x03\x04": _SHEET,  # .xlsx, .ods
    b"\xd0\xcf\x11\xe0": _SHEET,  # .xls
    b"\x1f\x8b": ("is compressed (gzip)", "Unpack it (`gunzip`)."),
    b"SQLite format 3": ("is an SQLite database, as older bags of ROS 2 are", "Make MCAP of it (`ros2 bag convert`)."),
    b"#ROSBAG": ("is a bag of ROS 1", "Convert it to ROS 2 messages in MCAP."),
}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class CsvLayout:
    """How a CSV file is written: lines above the first row of data, delimiter, decimal sign, column names."""

    skip: int
    delimiter: str
    decimal: str
    header: tuple[str, ...]


def csv_layout(path: Path, file: str) -> CsvLayout:
    """The layout, from the first lines: comma, semicolon or tab; a header may stand in a '#' line.

    Raises:
        UserError: for an empty file, a file without a header line or one that is not UTF-8 text.
    """
    skip, comment, text, below = _first_lines(path, file)
    delimiter = next((d for d in ";\t" if d in text), ",")  # a comma beside one of these is a decimal sign
    if comment and all(_NUMBER.fullmatch(c.strip()) for c in text.split(delimiter)):
        below, text, skip = [text, *below], comment, skip - 1  # the names stand in the '#' line above the numbers
    names = tuple(cell.strip().strip('"').strip() for cell in text.lstrip("#").split(delimiter))
    if all(_NUMBER.fullmatch(n) for n in names if n):
        raise UserError("has no header line", file=file, remedy="Add a first line with the names of the columns.")
    twice = sorted({n for n in names if n and names.count(n) > 1})
    if twice:
        raise UserError(f"has two columns named '{twice[0]}'", file=file, remedy="Rename one of them.")
    decimal = "," if delimiter != "," and any("," in line for line in below) else "."
    return CsvLayout(skip, delimiter, decimal, names)


def _first_lines(path: Path, file: str) -> tuple[int, str, str, list[str]]:
    """Number of lines up to the first that is neither blank nor '#', the last '#' line, that line, some lines below."""
    comment = ""
    try:
        stream = reading.lines(path, file)
        for k, line in enumerate(stream):
            if line.startswith("#"):
                comment = line.strip()
            elif line.strip():
                return k + 1, comment, line.rstrip("\r\n"), list(islice(stream, 64))
    except UnicodeDecodeError:
        raise not_text(path, file) from None
    raise UserError("is empty", file=file, remedy="Check the recording.")


def not_text(path: Path, file: str) -> UserError:
    """Message for a file that is not UTF-8 text, by how it begins."""
    with reading.opened(path) as stream:
        start = stream.read(16)
    problem, remedy = next(
        (said for magic, said in _OTHERS.items() if start.startswith(magic)),
        ("is not UTF-8 text", "Save it in UTF-8, or as Parquet."),
    )
    return UserError(problem, file=file, remedy=remedy)


def read_csv_columns(path: Path, layout: CsvLayout, columns: list[str], types: Mapping[str, Any], file: str) -> Any:
    """The named columns as an Arrow table; a column with a cell that is not a number comes back as text.

    Raises:
        UserError: for a row with too many or too few cells, or a file that cannot be parsed.
    """
    try:
        return _read(path, layout, columns, dict(types))
    except (pa.ArrowException, OSError) as error:
        if "Expected" in str(error) and "columns" in str(error):
            raise _ragged(path, layout, file) from None
    try:
        return _read(path, layout, columns, {c: pa.string() for c in columns})
    except (pa.ArrowException, OSError) as error:
        raise UserError(f"cannot be read as CSV ({str(error)[:120]})", file=file, remedy="Export it again.") from None


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


def _ragged(path: Path, layout: CsvLayout, file: str) -> UserError:
    """The first row whose number of cells is not that of the header."""
    want, row = len(layout.header), 0
    for k, line in enumerate(reading.lines(path, file, errors="replace")):
        if k < layout.skip or not line.strip():
            continue
        row += 1
        cells = line.rstrip("\r\n").count(layout.delimiter) + 1
        if cells != want:
            commas = layout.delimiter == "," and row == 1
            remedy = "Write decimals with points, or put semicolons between columns." if commas else "Mend the row."
            return UserError(f"row {row} has {cells} cells where the header has {want}", file=file, remedy=remedy)
    return UserError("has rows of different lengths", file=file, remedy="Export it again.")
