"""The closed loop as a Rerun recording: both controllers' traces on one time line, in 3-D and as curves.

Entities, over the timeline `sim_time`:

    /runs/<controller>/<plant>/run-<k>/state/<state>              as in traces.parquet, every kept run
    /runs/<controller>/<plant>/run-<k>/input/<input>
    /runs/<controller>/<plant>/run-<k>/gap/<state>/{actual,lower,upper}
    /shown/<controller>/...       what is derived from the run on display: share of the bound, value function, events
    /scene/...                    the 3-D scene        /phase/...    winning domains with the runs in them
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.geometry import Box, Floats
from simgap.io import figure_style as style
from simgap.io.atomic import atomic
from simgap.io.traces import MODEL, NOMINAL, ROBUST, SIMULATOR, Trace, twin
from simgap.synthesis.controller import Controller

TIMELINE = "sim_time"
COLOURS = {ROBUST: style.BLUE, NOMINAL: style.VERMILLION}
TITLES = {ROBUST: "gap-aware", NOMINAL: "nominal-only"}
SERIES = (style.SKY, style.PURPLE, style.GREEN, style.YELLOW)
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
        arena, target, obstacles: boxes over (x, y); radius: of the footprint, m.
    """

    urdf: Path | None
    axes: tuple[int, int, int]
    arena: Box
    target: Box
    obstacles: tuple[Box, ...]
    radius: float


@dataclass(frozen=True, eq=False)
class Content:
    """What a recording shows."""

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


def write_recording(path: Path, content: Content) -> None:
    """Write the recording with its blueprint, atomically."""
    import rerun as rr

    from simgap.io.recording_blueprint import blueprint
    from simgap.io.recording_phase import log_phase
    from simgap.io.recording_scene import log_scene

    with atomic(path) as temporary:
        recording = rr.RecordingStream("simgap", recording_id=f"simgap-{content.case}")
        recording.save(temporary, default_blueprint=blueprint(content))
        recording.log("about", rr.TextDocument(content.about, media_type="text/markdown"), static=True)
        for trace in content.traces:
            for entity, t, values in curves(trace, content.states, content.inputs):
                _style(recording, entity, trace)
                send(recording, entity, t, values)
        for controller, trace in content.shown.items():
            _log_shown(recording, content, controller, trace)
        _log_limits(recording, content)
        log_phase(recording, content)
        log_scene(recording, content)
        recording.flush()
        recording.disconnect()


def root(trace: Trace) -> str:
    """The entity under which a run is kept."""
    return f"runs/{trace.controller}/{_PLANTS[trace.plant]}/run-{trace.run}"


def curves(trace: Trace, states: Sequence[str], inputs: Sequence[str]) -> Iterator[tuple[str, Floats, Floats]]:
    """Entity, times and values of everything that the table of traces holds of a run; only finite values."""
    for j, name in enumerate(states):
        yield _finite(f"{root(trace)}/state/{name}", trace.t, trace.x[:, j])
    for j, name in enumerate(inputs):
        yield _finite(f"{root(trace)}/input/{name}", trace.t, trace.u[:, j])
    for j, name in enumerate(states):
        for part, values in (("actual", trace.d), ("lower", trace.lo), ("upper", trace.hi)):
            yield _finite(f"{root(trace)}/gap/{name}/{part}", trace.t, values[:, j])


def _finite(entity: str, t: Floats, values: Floats) -> tuple[str, Floats, Floats]:
    good = np.isfinite(values)
    return entity, t[good], values[good]


def share_of_bound(trace: Trace) -> Floats:
    """Where the gap lies between its bounds: -1 at the lower, 1 at the upper one: (n, nx); NaN without a bound."""
    half = 0.5 * (trace.hi - trace.lo)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (trace.d - 0.5 * (trace.hi + trace.lo)) / half
    return np.where(np.isfinite(half) & (half > 0), share, np.nan)


def send(recording: Any, entity: str, t: Floats, values: Floats) -> None:
    """Log scalars over `sim_time`."""
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


def _style(recording: Any, entity: str, trace: Trace) -> None:
    colour = COLOURS[trace.controller] if trace.plant == SIMULATOR else style.GREY
    plant = "simulator" if trace.plant == SIMULATOR else "model"
    last = entity.rsplit("/", 1)[-1]
    if last in ("lower", "upper"):
        line(recording, entity, style.ORANGE, 1.5, f"{TITLES[trace.controller]}, {last} bound")
    else:
        width = 3.5 if last == "actual" else 2.0 if plant == "simulator" else 1.3
        line(recording, entity, colour, width, f"{TITLES[trace.controller]}, {plant}")


def _log_shown(recording: Any, content: Content, controller: str, trace: Trace) -> None:
    """The share of the bound, the value function and what happened, of the run on display."""
    import rerun as rr

    share = share_of_bound(trace)
    for j, name in enumerate(content.states):
        entity, t, values = _finite(f"shown/{controller}/share/{name}", trace.t, share[:, j])
        line(recording, entity, SERIES[j % len(SERIES)], 2.0, name)
        send(recording, entity, t, values)
    policy = content.controllers[controller]
    if policy.solution.value is not None:
        line(recording, f"shown/{controller}/value", COLOURS[controller], 2.0, TITLES[controller])
        send(recording, f"shown/{controller}/value", trace.t, policy.value(trace.x).astype(float))
    for when, text, level in events(content, controller, trace):
        recording.set_time(TIMELINE, duration=when)
        recording.log(f"shown/{controller}/events", rr.TextLog(text, level=level))
    recording.reset_time()


def events(content: Content, controller: str, trace: Trace) -> list[tuple[float, str, str]]:
    """Time, text and level of what a viewer should notice about a run."""
    title = TITLES[controller]
    out = [(0.0, f"{title}: run {trace.run} starts", "INFO")]
    if trace.violates:
        first = int(np.flatnonzero(~trace.safe)[0])
        t, x = float(trace.t[first]), trace.x[first]
        where = ", ".join(f"{n} = {v:.4g}" for n, v in zip(content.states, x, strict=True))
        out.append((t, f"{title}: the simulator is unsafe at {where}", "ERROR"))
    elif content.controllers[controller].in_target(trace.x[-1:])[0]:
        out.append((trace.duration, f"{title}: target reached after {trace.duration:g} s", "INFO"))
    elif content.controllers[controller].solution.target is not None:
        out.append((trace.duration, f"{title}: ends without reaching the target", "WARN"))
    else:
        out.append((trace.duration, f"{title}: safe at all {len(trace.t)} samples", "INFO"))
    model = twin(content.traces, trace)
    if model is not None and not model.violates and model.duration < trace.duration:
        out.append((model.duration, f"{title}, run on the nominal model: ends without an admissible input", "WARN"))
    elif model is not None and model.violates:
        out.append((model.duration, f"{title}, run on the nominal model: unsafe", "WARN"))
    return sorted(out)


def _log_limits(recording: Any, content: Content) -> None:
    """The safe set beside the states, and +-1 beside the share of the bound."""
    ends = np.array([0.0, max(t.duration for t in content.shown.values())])
    for j, name in enumerate(content.states):
        for side, value in (("lowest", content.safe.lo[j]), ("highest", content.safe.hi[j])):
            if np.isfinite(value):
                line(recording, f"safe_set/{name}/{side}", style.GREEN, 1.5, f"safe set, {side}")
                send(recording, f"safe_set/{name}/{side}", ends, np.full(2, value))
    for side, value in (("lower", -1.0), ("upper", 1.0)):
        line(recording, f"bound/{side}", style.ORANGE, 1.5, f"{side} bound")
        send(recording, f"bound/{side}", ends, np.full(2, value))
