"""Files between the stages from `grid` to `gap`: what one writes and those after it read, of this case alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from simgap.arrays import Floats
from simgap.errors import UserError, excerpt
from simgap.gap.json_record import JsonRecord
from simgap.gap.sampling.points import Columns, Points, state_names, units
from simgap.io.results import columns_of, read_json, read_parquet, record_of, stack, table, write_json, write_parquet
from simgap.late import pyarrow as pa
from simgap.plants.context import Context
from simgap.stages import log

STATES, INPUTS = "states.parquet", "inputs.parquet"


def write_points(
    folder: Path, points: Points, names: tuple[Sequence[str], Sequence[str]], units: Mapping[str, str],
    record: Mapping[str, Any],
) -> None:  # fmt: skip
    """Two files in `folder`: the states (or earlier inputs) of a point, and the inputs; `names` of their columns."""
    for name, values, own in ((STATES, points.states, names[0]), (INPUTS, points.inputs, names[1])):
        columns = {n: values[:, k] for k, n in enumerate(own)}
        write_parquet(folder / name, table(columns, units, {"point": points.name}, record))


def write_rollouts(
    context: Context, out: Path, stage: str, columns: Columns, engine: str, seeds: Mapping[str, int], **about: Any
) -> None:
    """Write roll-outs, with what they are `about` in every row, such as the point of the grid or the seed."""
    constants = {"case": context.case.name, **about, "engine": engine}
    record = context.record(stage, seeds, engine=engine)
    write_parquet(out, table(columns, units(context.case), constants, record))


def points_of_case(context: Context, grid: Path) -> Points:
    """The grid in a folder.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    found: list[Floats] = []
    for name, columns in ((STATES, state_names(context.case)), (INPUTS, context.inputs)):
        content = read_table(context, grid / name, "grid", columns=[*columns, "point"])
        found.append(stack(content, columns))
    return Points(str(content.column("point")[0]), *found)


def read_samples(context: Context, path: Path, *stages: str) -> Columns:
    """Samples that one of these stages made of this case, as arrays by column.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    return columns_of(read_table(context, path, *stages))


def read_result(context: Context, path: Path, stage: str) -> dict[str, Any]:
    """Document that a stage wrote of this case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    content = read_json(path)
    context.own(path, content.get("provenance"), stage)
    return content


def read_table(context: Context, path: Path, *stages: str, columns: Sequence[str] | None = None) -> pa.Table:
    """A table, or some of its columns, that one of these stages made of this case.

    Raises:
        UserError: a missing or damaged file, or one of another case.
    """
    content = read_parquet(path, columns)
    context.own(path, record_of(content.schema), *stages)
    return content


class Rolled(Sequence[Columns]):
    """Roll-outs, shards in order; each is read when it is asked for, so that no two are in memory at once."""

    def __init__(self, context: Context, paths: Sequence[Path]) -> None:
        self._context, self.paths = context, tuple(paths)

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, k: int) -> Columns:  # type: ignore[override]  # nobody asks for several at once
        return read_samples(self._context, self.paths[k], "rollouts")


@contextmanager
def blame_shards(shards: Sequence[Path]) -> Iterator[None]:
    """Name the first shard in mistakes about the roll-outs, which have neither file nor key."""
    try:
        yield
    except UserError as error:
        if error.file is None and error.key is None:
            raise UserError(error.problem, file=shards[0], remedy=error.remedy) from None
        raise


def write_dimensions(
    context: Context, stage: str, grid: Path, shards: Sequence[Path], out: Path,
    find: Callable[[Points, Rolled, int], JsonRecord],
) -> None:  # fmt: skip
    """Write what `find` finds out about each dimension, the i-th, from the roll-outs of a grid.

    Raises:
        UserError: damaged shards, settings that do not fit.
    """
    found = {}
    with blame_shards(shards):
        points = points_of_case(context, grid)
        log.info("%d samples x %d inputs", len(points.states), len(points.inputs))
        for i, state in enumerate(context.states):
            began = time.perf_counter()
            found[state] = {"state": state, **find(points, Rolled(context, shards), i).to_json()}
            log.info("%s in %.2f s, roll-outs read and compared", state, time.perf_counter() - began)
    record = context.record(stage, point=points.name)
    write_json(out, {"states": found, "provenance": record})


def read_dimensions(context: Context, stage: str, point: str, path: Path) -> dict[str, Any]:
    """Results of `write_dimensions` by state, made of this case on this grid.

    A case that says the same under another name will do: points of a sweep share what they have in common.

    Raises:
        UserError: a state without a result, a damaged one, or one that was made of something else.
    """
    content = read_result(context, path, stage)
    other, found = content["provenance"].get("point"), content.get("states", {})
    if other != point:
        raise UserError(f"of the grid {excerpt(other)}, not {point}", file=path, remedy=f"Run `{stage}` again.")
    missing = [name for name in context.states if name not in found]
    if missing:
        raise UserError(f"no result for {', '.join(missing)}", file=path, remedy=f"Run `{stage}` again.")
    return dict(found)
