"""What the stages from `rollouts` to `gap` read of those before them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import overload

from simgap.errors import UserError
from simgap.gap.points import Columns, Points, state_names
from simgap.io.samples import read_columns, read_points
from simgap.stages.context import Context


def points_of_case(context: Context, grid: Path) -> Points:
    """The grid in a folder.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    return read_points(grid, (state_names(context.case), context.inputs))


class Shards(Sequence[Columns]):
    """Roll-outs, shards in order; each is read when it is asked for, so that no two are in memory at once."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = tuple(paths)

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, k: int) -> Columns: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[Columns]: ...
    def __getitem__(self, k: int | slice) -> Columns | Sequence[Columns]:
        return Shards(self.paths[k]) if isinstance(k, slice) else read_columns(self.paths[k])


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
