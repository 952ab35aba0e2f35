"""What the stages from `rollouts` to `gap` read of those before them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, overload

from simgap.errors import UserError
from simgap.gap.sampling.points import Columns, Points, state_names
from simgap.io.documents import read_json
from simgap.io.parquet import read_parquet, record_of
from simgap.io.samples import read_columns, read_points
from simgap.late import pyarrow as pa
from simgap.plants.context import Context


def points_of_case(context: Context, grid: Path) -> Points:
    """The grid in a folder.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    names = state_names(context.case), context.inputs
    return read_points(grid, names, lambda path, record: context.own(path, record, "grid"))


def samples_of(context: Context, path: Path, *stages: str) -> Columns:
    """Samples that one of these stages made of this case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    return read_columns(path, lambda own, record: context.own(own, record, *stages))


def result_of(context: Context, path: Path, stage: str) -> dict[str, Any]:
    """What a stage found out about this case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    content = read_json(path)
    context.own(path, content.get("provenance"), stage)
    return content


def table_of(context: Context, path: Path, stage: str) -> pa.Table:
    """A table that a stage made of this case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    content = read_parquet(path)
    context.own(path, record_of(content.schema), stage)
    return content


class Shards(Sequence[Columns]):
    """Roll-outs, shards in order; each is read when it is asked for, so that no two are in memory at once."""

    def __init__(self, context: Context, paths: Sequence[Path]) -> None:
        self._context, self.paths = context, tuple(paths)

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, k: int) -> Columns: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[Columns]: ...
    def __getitem__(self, k: int | slice) -> Columns | Sequence[Columns]:
        if isinstance(k, slice):
            return Shards(self._context, self.paths[k])
        return samples_of(self._context, self.paths[k], "rollouts")


def dimension(context: Context, state: str) -> int:
    """Which dimension a state is.

    Raises:
        UserError: for a name that is no state, with those that are.
    """
    if state not in context.states:
        known = ", ".join(context.states)
        raise UserError(f"'{state}' is no state", file=context.path, key="plant.states", remedy=f"States: {known}.")
    return context.states.index(state)


@contextmanager
def blame_shards(shards: Sequence[Path]) -> Iterator[None]:
    """Name the first shard in mistakes about the roll-outs, which have neither file nor key."""
    try:
        yield
    except UserError as error:
        if error.file is None and error.key is None:
            raise UserError(error.problem, file=shards[0], remedy=error.remedy) from None
        raise
