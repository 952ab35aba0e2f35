"""Tables with units and provenance, and a checksum of the whole file: those of pages leave the footer open."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.errors import UserError, excerpt
from simgap.io.atomic import SEAL, seal_holds, sealed
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_parquet as pq
from simgap.reading import require_room, table_size


def table(
    columns: Mapping[str, Floats], units: Mapping[str, str], constants: Mapping[str, Any], provenance: Mapping[str, Any]
) -> pa.Table:
    """A table of float columns (n,) with units, plus typed columns that hold one value throughout."""
    rows = len(next(iter(columns.values())))
    arrays, fields = [], []
    for name, values in columns.items():
        arrays.append(pa.array(values))
        fields.append(pa.field(name, arrays[-1].type, metadata={"unit": units.get(name, "1")}))
    for name, value in constants.items():
        arrays.append(_constant(value, rows))
        fields.append(pa.field(name, arrays[-1].type))
    schema = pa.schema(fields, metadata={"provenance": json.dumps(provenance, sort_keys=True)})
    return pa.Table.from_arrays(arrays, schema=schema)


def record_of(schema: pa.Schema) -> Any:
    """The provenance of a table; None where it is none."""
    try:
        return json.loads((schema.metadata or {}).get(b"provenance", b"null"))
    except ValueError:
        return None


def _constant(value: Any, rows: int) -> pa.Array:
    if isinstance(value, str):  # a dictionary of one word costs nothing
        return pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([value]))
    kind = pa.int64() if value is None or isinstance(value, int) else pa.float64()
    return pa.array(np.full(rows, value), kind) if value is not None else pa.nulls(rows, kind)


def write_parquet(path: Path, content: pa.Table) -> None:
    """Write a table with a checksum over all of its file; a reader never sees half of it."""
    with sealed(path) as temporary, pq.ParquetWriter(temporary, content.schema, compression="zstd") as writer:
        writer.write_table(content)
        writer.add_key_value_metadata({"simgap.checksum": SEAL})


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a table that `write_parquet` wrote.

    Raises:
        UserError: missing, truncated, changed or foreign file.
    """
    try:
        data = reading.read_bytes(path)
        if not seal_holds(data):
            raise pa.ArrowInvalid("its checksum is missing or does not fit its content")
        source = pq.ParquetFile(pa.BufferReader(data))
        require_room(table_size(source.metadata, len(columns) if columns else source.metadata.num_columns))
        return source.read(list(columns) if columns else None)
    except FileNotFoundError:
        raise UserError("the file does not exist", file=path, remedy="Run the stage that makes it.") from None
    except UserError as error:
        raise UserError(error.problem, file=path, remedy=error.remedy) from None
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise UserError(
            f"not a whole Parquet file ({excerpt(str(error).splitlines()[0])})",
            file=path,
            remedy="Delete it and run again: it is remade.",
        ) from None


def columns_of(content: pa.Table) -> dict[str, Any]:
    """All columns as arrays, (rows,) each."""
    return {name: content.column(name).to_numpy() for name in content.column_names}


def stack(content: pa.Table, names: Sequence[str]) -> Floats:
    """Columns side by side: -> (rows, len(names)) float64."""
    return np.stack([content.column(n).to_numpy() for n in names], axis=-1)
