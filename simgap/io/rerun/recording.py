"""Rerun recordings: file, time line, colours and curves; that of a diagnosis.

A diagnosis shows measured data, the prediction before and after, residuals and inputs on one time line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.atomic import atomic
from simgap.io.pages import text
from simgap.io.traces import EVERY_TITLE, MODEL, SIMULATOR, Trace
from simgap.notation import axis_label, printable
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
    """Where the gap lies between its bounds: -1 at the lower, 1 at the upper one: (n, nx); NaN without a bound."""
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
    import rerun as rr

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
    import rerun as rr

    recording = rr.RecordingStream(application, recording_id=identifier)
    memory = recording.memory_recording()
    if blueprint is not None:
        recording.send_blueprint(blueprint, make_active=True, make_default=True)
    yield recording
    recording.flush()
    content = memory.drain_as_bytes()
    recording.disconnect()
    with atomic(path) as temporary:
        temporary.write_bytes(content)


_LINES = (("measured", style.MEASURED_IN_A_VIEWER, 1.5), ("before", style.BEFORE, 3.0), ("after", style.AFTER, 3.0))


def write_recording(
    path: Path,
    windows: Sequence[WindowPrediction],
    measured: Sequence[str],
    inputs: Sequence[str],
    units: Mapping[str, str],
    title: str,
    sentence: str = "",
) -> None:
    """Write the recording, atomically; the sentence is the verdict.

    Entities: `/<trace>/<state>/{measured,before,after}`, `/<trace>/residual/<state>/{before,after}` and
    `/<trace>/input/<input>`, each a scalar over `sim_time`; the traces' own stamps are kept. `/<trace>/never_fitted` is
    1 in the windows that were held out for the verdict and 0 elsewhere; `/about` says it all in words.
    """
    import rerun as rr

    traces = list(dict.fromkeys(w.trace for w in windows))
    look = _blueprint(traces, measured, inputs, units)
    with recording_file(path, "simgap_diagnosis", _identifier(title), look) as recording:
        words = printable(text("diagnosis_recording.md.j2", title=title, sentence=sentence))
        about = rr.TextDocument(words, media_type="text/markdown")
        recording.log("about", about, static=True)
        for trace in traces:
            own = sorted((w for w in windows if w.trace == trace), key=lambda w: float(w.t[0]))
            _log_trace(recording, _entity(trace), own, measured, inputs)


def _identifier(title: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in title) or "diagnosis"


def _entity(trace: str) -> str:
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in trace)


def _log_trace(
    recording: Any, root: str, windows: Sequence[WindowPrediction], measured: Sequence[str], inputs: Sequence[str]
) -> None:
    t = np.concatenate([w.t for w in windows])
    columns = {side: np.concatenate([getattr(w, side) for w in windows]) for side in ("measured", "before", "after")}
    u = np.concatenate([w.inputs for w in windows])
    held = np.concatenate([np.full(w.t.size, float(w.held_out)) for w in windows])
    plot(recording, f"{root}/never_fitted", t, held, style.YELLOW, 2.5)
    for k, state in enumerate(measured):
        for side, colour, width in _LINES:
            plot(recording, f"{root}/{state}/{side}", t, columns[side][:, k], colour, width)
        for side, colour, width in _LINES[1:]:
            residual = columns["measured"][:, k] - columns[side][:, k]
            plot(recording, f"{root}/residual/{state}/{side}", t, residual, colour, width)
    for j, name in enumerate(inputs):
        plot(recording, f"{root}/input/{name}", t, u[:, j], style.GREEN, 1.5)


def _blueprint(traces: Sequence[str], measured: Sequence[str], inputs: Sequence[str], units: Mapping[str, str]) -> Any:
    """One tab a trace: every state above its residual, the inputs and the windows that were never fitted below."""
    import rerun.blueprint as rrb

    def view(name: str, origin: str) -> Any:
        return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.PlotLegend(visible=False))

    tabs = []
    for trace in traces:
        root = _entity(trace)
        views = []
        for state in measured:
            label = axis_label(state, units)
            views += [
                view(name=label, origin=f"/{root}/{state}"),
                view(name=f"residual of {label}", origin=f"/{root}/residual/{state}"),
            ]
        if inputs:
            named = axis_label(inputs[0], units) if len(inputs) == 1 else ", ".join(inputs)
            views.append(view(name=f"input {named}", origin=f"/{root}/input"))
        views.append(view(name="1: never fitted, 0: fitted", origin=f"/{root}/never_fitted"))
        tabs.append(rrb.Vertical(*views, row_shares=[*([3.0] * (len(views) - 1)), 1.0], name=printable(trace)))
    curves = rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0]
    about = rrb.TextDocumentView(name="What this shows", origin="/about")
    return rrb.Blueprint(
        rrb.Horizontal(about, curves, column_shares=[1.0, 3.0]),
        rrb.TimePanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )
