"""What every recording is made with: its file, the time line, colours, curves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from simgap.arrays import Floats
from simgap.io.atomic import atomic

TIMELINE = "sim_time"


def send(recording: Any, entity: str, t: Floats, values: Floats) -> None:
    """Log scalars (n,) over `sim_time`, (n,) in s."""
    import rerun as rr

    if len(t):
        recording.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=t)], rr.Scalars.columns(scalars=values))


def rgb(colour: str, alpha: int = 255) -> list[int]:
    """'#0072B2' -> [0, 114, 178, alpha]."""
    return [*(int(colour[k : k + 2], 16) for k in (1, 3, 5)), alpha]


def line(recording: Any, entity: str, colour: str, width: float, name: str) -> None:
    """How a curve is drawn."""
    import rerun as rr

    recording.log(entity, rr.SeriesLines(colors=rgb(colour), widths=width, names=name), static=True)


@contextmanager
def recording_file(path: Path, application: str, identifier: str, blueprint: Any = None) -> Iterator[Any]:
    """A recording to log to, which is written atomically at `path` when the block ends.

    Rerun writes in a thread of its own, which waits for ever on a disk that is full. So it writes to memory, and what
    the disk refuses is told here.
    """
    import rerun as rr

    recording = rr.RecordingStream(application, recording_id=identifier)
    memory = recording.memory_recording()
    if blueprint is not None:
        recording.send_blueprint(blueprint, make_active=False, make_default=True)
    yield recording
    recording.flush()
    content = memory.drain_as_bytes()
    recording.disconnect()
    with atomic(path) as temporary:
        temporary.write_bytes(content)
