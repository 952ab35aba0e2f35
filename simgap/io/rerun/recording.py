"""Content of a recording of the closed loop: the curves of every run, its file, time line and colours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io.atomic import write_bytes
from simgap.io.traces import EVERY_TITLE, MODEL, SIMULATOR, Trace
from simgap.late import rerun as rr
from simgap.synthesis.controller import Controller

SERIES = (("#56B4E9", "light blue"), ("#CC79A7", "pink"), ("#009E73", "green"), ("#F0E442", "yellow"))
"""Colours of the states in one view, with what a title calls them (Okabe & Ito (2008))."""
_PLANTS = {SIMULATOR: "simulator", MODEL: "nominal_model"}


@dataclass(frozen=True, eq=False)
class JointScene:
    """A URDF whose joints follow states: joint name -> index of the state that is its position."""

    urdf: Path
    joints: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class PlanarScene:
    """A robot that drives on a floor: a URDF placed at (x, y, heading), with boxes around it.

    Attributes:
        urdf: the robot, or None for a disc; axes: indices of the states x, y, heading.
        arena, target, obstacles: boxes over (x, y), no target where there is none; radius: of the footprint, m.
    """

    urdf: Path | None
    axes: tuple[int, int, int]
    arena: Box
    target: Box | None
    obstacles: tuple[Box, ...]
    radius: float


@dataclass(frozen=True, eq=False)
class Content:
    """Content of a recording."""

    case: str
    about: str  # Markdown
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    units: Mapping[str, str]
    safe: Box  # bounds to draw beside each state, infinite where there are none
    traces: Sequence[Trace]
    shown: Mapping[str, Trace]  # by controller
    controllers: Mapping[str, Controller]
    scene: JointScene | PlanarScene | None


def root(trace: Trace) -> str:
    """The entity under which a run is kept."""
    return f"runs/{EVERY_TITLE[trace.controller].replace(' ', '-')}/{_PLANTS[trace.plant]}/run-{trace.run}"


def curves(trace: Trace, states: Sequence[str], inputs: Sequence[str]) -> Iterator[tuple[str, Floats, Floats]]:
    """Entity, times (n,) in s and values (n,) of all that the table of traces holds of a run; only finite values."""
    for j, name in enumerate(states):
        yield finite(f"{root(trace)}/state/{name}", trace.t, trace.x[:, j])
    for j, name in enumerate(inputs):
        yield finite(f"{root(trace)}/input/{name}", trace.t, trace.u[:, j])
    for j, name in enumerate(states):
        for part, values in (("actual", trace.d), ("lower", trace.lo), ("upper", trace.hi)):
            yield finite(f"{root(trace)}/gap/{name}/{part}", trace.t, values[:, j])


def finite(entity: str, t: Floats, values: Floats) -> tuple[str, Floats, Floats]:
    """A curve, (n,) times and values, without its values that are not finite."""
    good = np.isfinite(values)
    return entity, t[good], values[good]


def share_of_bound(trace: Trace) -> Floats:
    """Place of the gap between its bounds: -1 at the lower, 1 at the upper one: (n, nx); NaN without a bound."""
    half = 0.5 * (trace.hi - trace.lo)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (trace.d - 0.5 * (trace.hi + trace.lo)) / half
    return np.where(np.isfinite(half) & (half > 0), share, np.nan)


TIMELINE = "sim_time"


def rgb(colour: str, alpha: int = 255) -> list[int]:
    """'#0072B2' -> [0, 114, 178, alpha]."""
    return [*(int(colour[k : k + 2], 16) for k in (1, 3, 5)), alpha]


def plot(
    recording: Any, entity: str, t: Floats, values: Floats, colour: str, width: float, name: str | None = None
) -> None:
    """A curve over simulated time: t (n,) s, values (n,); called like the end of its entity if it has no other name."""
    look = rr.SeriesLines(colors=rgb(colour), widths=width, names=name or entity.rsplit("/", 1)[-1])
    recording.log(entity, look, static=True)
    if len(t):
        recording.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=t)], rr.Scalars.columns(scalars=values))


@contextmanager
def recording_file(path: Path, application: str, identifier: str, blueprint: Any = None) -> Iterator[Any]:
    """A recording to log to, which is written atomically at `path` when the block ends.

    Rerun writes in a thread of its own, which waits for ever on a disk that is full. So it writes to memory, and what
    the disk refuses is told here.
    """
    recording = rr.RecordingStream(application, recording_id=identifier)
    memory = recording.memory_recording()
    if blueprint is not None:
        recording.send_blueprint(blueprint, make_active=True, make_default=True)
    yield recording
    recording.flush()
    content = memory.drain_as_bytes()
    recording.disconnect()
    write_bytes(path, content)
