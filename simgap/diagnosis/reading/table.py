"""Columns of a recording in memory, before they mean anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.errors import UserError, excerpt


@dataclass(frozen=True, eq=False)
class RawTable:
    """The columns of one file that were asked for.

    Attributes:
        file: the name that messages and reports use.
        header: every column of the file, asked for or not.
        time: (n,) stamps as recorded, float64 or int64; int64 keeps nanoseconds since an epoch exact.
        time_unit: unit of the stamps if the file itself says so (a time-stamp type), else None.
        columns: (n,) finite float64 each.
        labels: (n,) text of the trace column, or None where the file has none.
        units: unit stored with a column in the file.
        notes: what a person should know of how it was read, in sentences.
    """

    file: str
    header: tuple[str, ...]
    time: Floats | Ints
    time_unit: str | None
    columns: Mapping[str, Floats]
    labels: NDArray[np.str_] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    sha256: str = ""
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.time.size)


def no_time_column(time: str, header: Sequence[str], file: str) -> UserError:
    """What to say of a file without the column of stamps."""
    listed = excerpt(", ".join(f"'{name}'" for name in header), 200)
    return UserError(
        f"no time column '{time}' among {listed}", file=file, remedy="Name it with measured.time.column in the case."
    )
