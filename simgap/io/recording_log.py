"""What every part of a recording is logged with: the time line, colours, curves."""

from __future__ import annotations

from typing import Any

from simgap.geometry import Floats

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
