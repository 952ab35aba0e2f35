"""What a packed file would hold in memory, asked before it is unpacked: a megabyte can say that it is a terabyte."""

from __future__ import annotations

from typing import Any

from simgap.errors import UserError
from simgap.reading import MOST

JSON_HELD = 30  # bytes in memory for one of the text: lists of the shortest objects take 20 to 30


class TooLarge(UserError):
    """A file that does not fit into memory; the name is for those who know a better remedy."""


_CELL = 8  # bytes of a number


def table_size(metadata: Any, columns: int) -> int:
    """Bytes that so many columns of numbers of a Parquet file take as arrays: its pages may repeat one value.

    Rows are counted by groups. What the file says of single columns is not asked for: where that is damaged, pyarrow
    ends the process.
    """
    return sum(metadata.row_group(g).num_rows for g in range(metadata.num_row_groups)) * columns * _CELL


def require_room(size: int) -> None:
    """Refuse what is too large.

    Raises:
        TooLarge: without file.
    """
    if size > MOST:
        raise TooLarge(
            f"holds {size / 1e9:.3g} GB unpacked, more than a quarter of this machine's memory",
            remedy="Take another machine, or less data in a file.",
        )
