"""Curves of a Rerun recording, read by Rerun's own reader."""

import numpy as np

from simgap.io.rerun.recording import TIMELINE

_SCALARS = "Scalars:scalars"


def read_curves(path):
    """All scalar curves of a recording: entity -> (times in seconds, values), in order of time."""
    from rerun.chunk import RrdReader

    parts = {}
    for chunk in RrdReader(path).store().stream().to_chunks():
        batch = chunk.to_record_batch()
        if _SCALARS in batch.schema.names and TIMELINE in batch.schema.names:
            t = batch.column(TIMELINE).cast("int64").to_numpy() * 1e-9
            values = batch.column(_SCALARS).flatten().to_numpy()
            parts.setdefault(str(chunk.entity_path).strip("/"), []).append((t, values))
    return {entity: _joined(pieces) for entity, pieces in parts.items()}


def _joined(pieces):
    t, values = (np.concatenate(part) for part in zip(*pieces, strict=True))
    order = np.argsort(t, kind="stable")
    return t[order], values[order]
