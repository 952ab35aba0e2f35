"""Reads recordings from CSV, Parquet, JSON and MCAP files into plain columns; mistakes are named by file and row."""

from __future__ import annotations

import codecs
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.diagnosis.record.channels import RawTable, no_time_column
from simgap.errors import UserError, excerpt, placed
from simgap.io.atomic import seal_holds
from simgap.io.recordings.mcap_file import MAGIC, mcap_header, read_mcap
from simgap.io.recordings.text_file import csv_layout, json_cells, json_table, read_csv_columns
from simgap.io.results import record_of
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_compute as pc
from simgap.late import pyarrow_csv as pcsv
from simgap.late import pyarrow_parquet as pq
from simgap.reading import require_room, table_size

Kind = Literal["mcap", "json", "parquet", "csv"]
_Source = tuple[tuple[str, ...], Callable[[list[str]], Any], str]
_GIVE = "Give the path of a CSV, Parquet, JSON or MCAP file."


def read_recording(path: Path, wanted: Iterable[str], time: str, trace: str, name: str | None = None) -> RawTable:
    """The wanted columns of a CSV, Parquet, JSON or MCAP file; those that the file lacks are left out.

    Args:
        path: the file.
        wanted: names of the columns of states and inputs.
        time: name of the column of time stamps; messages of MCAP files have stamps of their own.
        trace: name of the column that tells traces apart; may be missing.
        name: how messages and reports call the file; its path if not given.

    Raises:
        UserError: for a file that is missing, empty, damaged or has no time column, for a cell that is not finite or
            not a number (with its row, counted from 1 below the header or in the list of samples), for an empty stamp.
    """
    file = name or str(path)
    with placed(file=file):
        _refuse_no_file(path, file)
        kind = kind_of(path)
        if kind not in ("parquet", "mcap"):  # its columns are held: none is hashed that is larger than the memory
            reading.checked(path, 4 * reading.MOST)
        sha256, wanted = reading.sha256(path), list(wanted)
        raw = read_mcap(path, wanted, file) if kind == "mcap" else _read_table(kind, path, wanted, time, trace, file)
        if reading.sha256(path) != sha256:
            raise UserError("was changed while it was read", remedy="Wait until it is written, then run again.")
        return replace(raw, sha256=sha256)


def _read_table(kind: Kind, path: Path, wanted: Sequence[str], time: str, trace: str, file: str) -> RawTable:
    labels = None if trace in (time, *wanted) else trace
    header, read, word = _source(kind, path, time, labels, (time, *wanted, trace))
    if time not in header:
        raise no_time_column(time, header, file)
    chosen = [c for c in dict.fromkeys(wanted) if c in header and c != time]
    labels = labels if labels in header else None
    table = read([time, *chosen, *([labels] if labels is not None else [])])
    if table.num_rows == 0:
        raise UserError("has a header and no rows", remedy="Check the recording.")
    stamps, time_unit = _stamps(table.column(time), f"{word} '{time}'")
    return RawTable(
        file=file,
        header=header,
        time=stamps,
        time_unit=time_unit or _unit(table.schema.field(time)),
        columns={c: _numbers(table.column(c), f"{word} '{c}'") for c in chosen},
        labels=None if labels is None else _labels(table.column(labels), f"{word} '{labels}'"),
        units={c: unit for c in chosen if (unit := _unit(table.schema.field(c))) is not None},
    )


def kind_of(path: Path) -> Kind:
    """Kind of a recording, by its name or by how it begins."""
    try:
        with reading.opened(path) as stream:
            start = stream.read(64)
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror}", file=path) from None
    suffix = path.suffix.lower()
    braced = start.removeprefix(codecs.BOM_UTF8).lstrip()[:1] in (b"{", b"[") and suffix not in (".csv", ".tsv")
    if start.startswith(MAGIC):
        return "mcap"
    if braced or suffix in (".json", ".jsonl", ".ndjson"):
        return "json"
    return "parquet" if suffix in (".parquet", ".pq", ".parq") or start.startswith(b"PAR1") else "csv"


def _source(kind: Kind, path: Path, time: str = "", labels: str | None = None, wanted: Sequence[str] = ()) -> _Source:
    """The names of all columns, what reads the wanted ones as an Arrow table, how messages call a column.

    Args:
        time: the column of stamps; labels: that of text.
    """
    if kind == "json":
        names, cells = json_cells(path, wanted)
        return names, lambda columns: json_table(cells, columns, time, labels), "key"
    if kind == "parquet":
        return parquet_header(path), lambda columns: read_parquet_columns(path, columns), "column"
    layout = csv_layout(path)
    types = {c: pa.string() if c == labels else pa.float64() for c in wanted if c != time}
    return layout.header, lambda columns: read_csv_columns(path, layout, columns, types), "column"


def read_header(path: Path, file: str) -> tuple[tuple[str, ...], dict[str, str]]:
    """The names of all columns, and the units that are stored with some (Parquet); a row is read of JSON alone.

    Args:
        path: the file.
        file: how messages call it.

    Raises:
        UserError: for a file that is missing, empty or damaged.
    """
    with placed(file=file):
        _refuse_no_file(path, file)
        kind = kind_of(path)
        header = tuple(mcap_header(path)) if kind == "mcap" else _source(kind, path)[0]
        schema = parquet_schema(path) if kind == "parquet" else ()
        return header, {field.name: unit for field in schema if (unit := _unit(field)) is not None}


def _refuse_no_file(path: Path, file: str) -> None:
    if path.is_dir():
        bags = any(path.glob("*.mcap"))  # as `ros2 bag record` leaves them
        remedy = f"Give the files in it: {file}/*.mcap." if bags else _GIVE
        raise UserError("is a folder, not a file", remedy=remedy)
    if not reading.is_file(path):
        raise UserError("no such file", remedy=_GIVE)


def _stamps(column: Any, name: str) -> tuple[Any, str | None]:
    """Time stamps and the unit their type carries."""
    timed = pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type)
    if not timed and not pa.types.is_integer(column.type):
        return _numbers(column, name, stamps=True), None
    _no_nulls(column, name)
    return column.cast(pa.int64(), safe=False).to_numpy(), column.type.unit if timed else None


def _numbers(column: Any, name: str, stamps: bool = False) -> Floats:
    """A column as finite float64, NaN where a cell that is no stamp is empty; the first other cell is named."""
    cells = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if pa.types.is_string(cells) or pa.types.is_large_string(cells):
        column = _from_text(column, name)
    if stamps:
        _no_nulls(column, name)
    try:
        values = np.ascontiguousarray(column.cast(pa.float64()), dtype=np.float64)
    except pa.ArrowException:
        raise UserError(f"{name} holds {excerpt(column.type)}, not numbers", remedy="Write plain numbers.") from None
    bad = np.flatnonzero(~np.isfinite(values) if stamps else np.isinf(values))
    if bad.size:
        raise _bad_cell(name, int(bad[0]), str(values[bad[0]]))
    return values


def _from_text(column: Any, name: str) -> Any:
    """Numbers that cells of text hold, null where one is blank or says so; a text that many repeat is kept once."""
    coded = pc.dictionary_encode(column.combine_chunks())
    cells = pc.utf8_trim_whitespace(coded.dictionary)
    nothing = pc.is_in(cells, pa.array(pcsv.ConvertOptions().null_values, cells.type))
    cells = pc.if_else(nothing, None, cells)
    try:
        return pc.take(pc.cast(cells, pa.float64()), coded.indices)
    except pa.ArrowException:
        bad = next(k for k, cell in enumerate(cells.to_pylist()) if cell is not None and not _is_number(cell))
        row = pc.index(coded.indices, pa.scalar(bad, coded.indices.type)).as_py()
        raise _bad_cell(name, row, cells[bad].as_py()) from None


def _is_number(text: str) -> bool:
    """True if Arrow reads a text as a number: Python's digits of other scripts and underscores are none."""
    try:
        pc.cast(pa.scalar(text.strip()), pa.float64())
    except pa.ArrowException:
        return False
    return True


def _no_nulls(column: Any, name: str) -> None:
    if column.null_count:
        row = int(np.flatnonzero(np.asarray(pc.is_null(column)))[0])
        raise _bad_cell(name, row, "")


def _bad_cell(name: str, row: int, cell: str) -> UserError:
    what = f"'{cell[:40]}' is not a finite number" if cell else "the cell is empty"
    return UserError(f"row {row + 1}, {name}: {what}", remedy="Remove the row, or empty the cell if it is no stamp.")


def _labels(column: Any, name: str) -> Any:
    _no_nulls(column, name)
    try:
        return np.asarray(column.cast(pa.string()).to_pylist(), dtype=np.str_)
    except (pa.ArrowException, UnicodeDecodeError):
        remedy = "Write plain text."
        raise UserError(f"{name} holds {excerpt(column.type)}, not names of traces", remedy=remedy) from None


def _unit(field: Any) -> str | None:
    stored = (field.metadata or {}).get(b"unit")
    try:
        return stored.decode() if stored else None
    except UnicodeDecodeError:
        remedy = "Write it as text, such as rad."
        raise UserError(f"the unit of column '{field.name}' is not UTF-8 text", remedy=remedy) from None


def parquet_schema(path: Path) -> Any:
    """Names, types and units of all columns."""
    with reading.opened(path) as stream:
        return pq.read_schema(stream)


def parquet_header(path: Path) -> tuple[str, ...]:
    """The names of all columns.

    Raises:
        UserError: a file that is damaged or was changed, or two columns of one name.
    """
    if seal_holds(reading.read_bytes(path)) is False:  # one that simgap wrote; those of others carry none
        raise UserError("was changed after it was written: its checksum does not fit", remedy="Make it again.")
    try:
        names = tuple(parquet_schema(path).names)
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        raise _damaged() from None
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UserError(f"has two columns named '{excerpt(twice[0], 40)}'", remedy="Rename one of them.")
    return names


def rig_record(path: Path) -> Any:
    """Record of the simulator in a file that `simgap rig` wrote; None of any other, readable or not."""
    try:
        record = record_of(parquet_schema(path)) if kind_of(path) == "parquet" else None
    except (pa.ArrowException, OSError, UserError):
        return None
    return record if isinstance(record, dict) and record.get("stage") == "rig" else None


def read_parquet_columns(path: Path, columns: list[str]) -> Any:
    """The named columns as an Arrow table.

    Raises:
        UserError: a file that is damaged or too large.
    """
    try:
        with reading.opened(path) as stream:
            require_room(table_size(pq.read_metadata(stream), len(columns)))
        kinds = {field.name: field.type for field in parquet_schema(path) if field.name in columns}
        # A text that every row repeats is read once: a small file may say that it is gigabytes.
        words = [name for name, kind in kinds.items() if pa.types.is_string(kind) or pa.types.is_large_string(kind)]
        with reading.opened(path) as stream:
            return pq.read_table(stream, columns=columns, partitioning=None, read_dictionary=words)
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        raise _damaged() from None


def _damaged() -> UserError:
    return UserError(
        "is not a whole Parquet file: it is truncated, damaged or of another format", remedy="Copy it again."
    )
