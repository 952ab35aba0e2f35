"""Results as files: JSON documents and tables, which read back exactly and carry a checksum of all their bytes.

Equal content gives equal bytes. Tables carry units and provenance in the metadata of Parquet; its pages leave the
footer open, so that the checksum is of the whole file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.errors import UserError, excerpt, placed
from simgap.io.atomic import SEAL, seal_holds, sealed
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_parquet as pq
from simgap.reading import JSON_HELD, require_room, table_size

CHECKSUM = "checksum"
REMEDY = "Delete it and run again: it is remade."
MOST = reading.MOST // JSON_HELD
"""Bytes of a result: what it takes once it is read is a quarter of the machine's memory."""


def plain(value: Any) -> Any:
    """Content as JSON has it: lists for arrays, null for what is not a number, "inf" for what has no end."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a result atomically, its checksum (key `checksum`, which content cannot have) last."""
    body = plain({key: value for key, value in content.items() if key != CHECKSUM})
    text = json.dumps(body | {CHECKSUM: SEAL}, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    with sealed(path) as temporary:
        temporary.write_bytes(text.encode(errors="backslashreplace"))


def read_json(path: Path) -> dict[str, Any]:
    """Read a result that `write_json` wrote, without its checksum.

    Raises:
        UserError: missing, damaged, edited or foreign file.
    """
    try:
        data = reading.read_bytes(path, MOST)
        content = json.loads(data.decode())
    except FileNotFoundError:
        raise UserError("the file does not exist", file=path, remedy="Run the stage that makes it.") from None
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"damaged: {excerpt(error)}", file=path, remedy=REMEDY) from None
    if not isinstance(content, dict) or CHECKSUM not in content:
        raise UserError("damaged: not a result of simgap, or its checksum is missing", file=path, remedy=REMEDY)
    content.pop(CHECKSUM)
    if not seal_holds(data):
        problem = "damaged: the checksum does not fit the content, which was changed after it was written"
        raise UserError(problem, file=path, remedy=REMEDY)
    return content


def table(
    columns: Mapping[str, Floats], units: Mapping[str, str], constants: Mapping[str, Any], provenance: Mapping[str, Any]
) -> pa.Table:
    """A table of float columns (n,) with units, plus typed columns that hold one value throughout."""
    rows = len(next(iter(columns.values())))
    arrays = [*map(pa.array, columns.values()), *(_constant(value, rows) for value in constants.values())]
    told = [*({"unit": units.get(name, "1")} for name in columns), *(None for _ in constants)]
    each = zip((*columns, *constants), arrays, told, strict=True)
    fields = [pa.field(name, array.type, metadata=own) for name, array, own in each]
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
        with placed(file=path):
            require_room(table_size(source.metadata, len(columns) if columns else source.metadata.num_columns))
        return source.read(list(columns) if columns else None)
    except FileNotFoundError:
        raise UserError("the file does not exist", file=path, remedy="Run the stage that makes it.") from None
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        problem = f"not a whole Parquet file ({excerpt(str(error).splitlines()[0])})"
        raise UserError(problem, file=path, remedy=REMEDY) from None


def columns_of(content: pa.Table) -> dict[str, Any]:
    """All columns as arrays, (rows,) each."""
    return {name: content.column(name).to_numpy() for name in content.column_names}


def stack(content: pa.Table, names: Sequence[str]) -> Floats:
    """Columns side by side: -> (rows, len(names)) float64."""
    return np.stack([content.column(n).to_numpy() for n in names], axis=-1)
