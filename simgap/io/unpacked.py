"""What a packed file would hold in memory, asked before it is unpacked: a megabyte can say that it is a terabyte."""

from __future__ import annotations

import os
from collections.abc import Collection
from typing import Any

from simgap.errors import UserError

MOST = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
"""Most bytes that one file may hold unpacked: a quarter of the machine's memory, for readers hold it up to three times
(measured for controllers: 3.9 times, their own bytes included)."""
_CELL = 8  # bytes of a number


def table_size(metadata: Any, names: Collection[str] | None = None) -> int:
    """Bytes that columns of a Parquet file (all, or those named) take as arrays: its pages may repeat one value."""
    groups = [metadata.row_group(g) for g in range(metadata.num_row_groups)]
    columns = [group.column(c) for group in groups for c in range(metadata.num_columns)]
    chosen = [c for c in columns if names is None or c.path_in_schema.partition(".")[0] in names]
    return sum(max(_CELL * c.num_values, c.total_uncompressed_size) for c in chosen)


def require_room(size: int) -> None:
    """Refuse what is too large.

    Raises:
        UserError: without file.
    """
    if size > MOST:
        raise UserError(
            f"holds {size / 1e9:.3g} GB unpacked, more than a quarter of this machine's memory",
            remedy="Take another machine, or less data in a file.",
        )
