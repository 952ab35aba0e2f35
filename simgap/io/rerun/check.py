"""Reads a recording back and holds it against the table of traces that it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.io.rerun.content import curves
from simgap.io.rerun.log import TIMELINE
from simgap.io.traces import Trace

_SCALARS = "Scalars:scalars"


def read_curves(path: Path) -> dict[str, tuple[Floats, Floats]]:
    """All scalar curves of a recording: entity -> (times in seconds, values), in order of time.

    Raises:
        UserError: a file that is missing or not a recording.
    """
    import warnings

    from rerun.chunk import RrdReader

    if not reading.is_file(path):
        raise UserError("the file does not exist", file=path, remedy="Run the trace stage.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # the reader only warns of a file that was cut off
            chunks = RrdReader(path).store().stream().to_chunks()
    except (RuntimeError, ValueError, OSError, Warning) as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"not a whole recording ({reason})", file=path, remedy="Run the trace stage again.") from None
    parts: dict[str, list[tuple[Floats, Floats]]] = {}
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if _SCALARS in batch.schema.names and TIMELINE in batch.schema.names:
            t = batch.column(TIMELINE).cast("int64").to_numpy() * 1e-9
            values = batch.column(_SCALARS).flatten().to_numpy()
            parts.setdefault(str(chunk.entity_path).strip("/"), []).append((t, values))
    return {entity: _joined(pieces) for entity, pieces in parts.items()}


def _joined(pieces: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    t, values = (np.concatenate(part) for part in zip(*pieces, strict=True))
    order = np.argsort(t, kind="stable")
    return t[order], values[order]


def verify(path: Path, traces: Sequence[Trace], states: Sequence[str], inputs: Sequence[str]) -> int:
    """Hold every curve of every run against the table: equal values, bit for bit, times to the nanosecond.

    Returns:
        The number of values that were compared.

    Raises:
        BrokenPromise: a curve that is missing, or differs.
        UserError: see `read_curves`.
    """
    recorded = read_curves(path)
    compared = 0
    for trace in traces:
        for entity, t, values in curves(trace, states, inputs):
            if not len(t):
                continue
            if entity not in recorded:
                raise BrokenPromise(f"{path}: the recording lacks /{entity}", "Run the trace stage again.")
            own_t, own = recorded[entity]
            if len(own) != len(values) or not np.array_equal(own, values) or np.abs(own_t - t).max() > 1e-9:
                raise BrokenPromise(
                    f"{path}: /{entity} is not what the table of traces holds", "Run the trace stage again."
                )
            compared += len(values)
    return compared
