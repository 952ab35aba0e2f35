"""The header of a Parquet file and its columns as an Arrow table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simgap import reading
from simgap.errors import UserError, excerpt, placed
from simgap.io.parquet import checksum_holds, record_of
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_parquet as pq
from simgap.reading import require_room, table_size

_MAGIC = b"PAR1"


def is_parquet(path: Path) -> bool:
    """Whether a file is named or begins as Parquet files do."""
    if path.suffix.lower() in (".parquet", ".pq", ".parq"):
        return True
    try:
        with reading.opened(path) as stream:
            return stream.read(4) == _MAGIC
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror}", file=path) from None


def parquet_schema(path: Path) -> Any:
    """Names, types and units of all columns."""
    with reading.opened(path) as stream:
        return pq.read_schema(stream)


def parquet_header(path: Path, file: str) -> tuple[str, ...]:
    """The names of all columns.

    Raises:
        UserError: a file that is damaged or was changed, or two columns of one name.
    """
    if checksum_holds(reading.read_bytes(path)) is False:  # one that simgap wrote; those of others carry none
        raise UserError(
            "was changed after it was written: its checksum does not fit", file=file, remedy="Make it again."
        )
    try:
        names = tuple(parquet_schema(path).names)
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        raise _damaged(file) from None
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UserError(f"has two columns named '{excerpt(twice[0], 40)}'", file=file, remedy="Rename one of them.")
    return names


def rig_record(path: Path) -> Any:
    """What a file that `simgap rig` wrote says of its simulator; None of any other, readable or not."""
    try:
        record = record_of(parquet_schema(path)) if is_parquet(path) else None
    except (pa.ArrowException, OSError, UserError):
        return None
    return record if isinstance(record, dict) and record.get("stage") == "rig" else None


def read_parquet_columns(path: Path, columns: list[str], file: str) -> Any:
    """The named columns as an Arrow table.

    Raises:
        UserError: a file that is damaged or too large.
    """
    try:
        with placed(file=file):
            with reading.opened(path) as stream:
                require_room(table_size(pq.read_metadata(stream), len(columns)))
            kinds = {field.name: field.type for field in parquet_schema(path) if field.name in columns}
            # A text that every row repeats is read once: a small file may say that it is gigabytes.
            words = [name for name, kind in kinds.items() if pa.types.is_string(kind) or pa.types.is_large_string(kind)]
            with reading.opened(path) as stream:
                return pq.read_table(stream, columns=columns, partitioning=None, read_dictionary=words)
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        raise _damaged(file) from None


def _damaged(file: str) -> UserError:
    return UserError(
        "is not a whole Parquet file: it is truncated, damaged or of another format", file=file, remedy="Copy it again."
    )
