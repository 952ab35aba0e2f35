"""Files of samples: the grid of a point, roll-outs, and the columns that the steps of a bound work on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from simgap.arrays import Floats
from simgap.gap.sampling.points import Columns, Points
from simgap.io.parquet import read_parquet, record_of, stack, table, write_parquet

Own = Callable[[Path, Any], None]
STATES, INPUTS = "states.parquet", "inputs.parquet"


def write_points(
    folder: Path,
    points: Points,
    names: tuple[Sequence[str], Sequence[str]],
    units: Mapping[str, str],
    record: Mapping[str, Any],
) -> None:
    """Two files in `folder`: the states (or earlier inputs) of a point, and the inputs; `names` of their columns."""
    for name, values, own in ((STATES, points.states, names[0]), (INPUTS, points.inputs, names[1])):
        columns = {n: values[:, k] for k, n in enumerate(own)}
        write_parquet(folder / name, table(columns, units, {"point": points.name}, record))


def read_points(folder: Path, names: tuple[Sequence[str], Sequence[str]], own: Own) -> Points:
    """Points that `write_points` wrote; `own` refuses a record of another case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    found: list[Floats] = []
    for name, columns in zip((STATES, INPUTS), names, strict=True):
        content = read_parquet(folder / name, [*columns, "point"])
        own(folder / name, record_of(content.schema))
        found.append(stack(content, columns))
    return Points(str(content.column("point")[0]), *found)


def read_columns(path: Path, own: Own) -> Columns:
    """A table as arrays by column; `own` refuses a record of another case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    content = read_parquet(path)
    own(path, record_of(content.schema))
    return {name: content.column(name).to_numpy() for name in content.column_names}


def write_columns(
    path: Path,
    columns: Columns,
    units: Mapping[str, str],
    constants: Mapping[str, Any],
    record: Mapping[str, Any],
) -> None:
    """A table from arrays by column, with columns that hold one value throughout."""
    write_parquet(path, table(columns, units, constants, record))
