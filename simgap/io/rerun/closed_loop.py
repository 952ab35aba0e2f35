"""The closed loop as a Rerun recording: both controllers' traces on one time line, in 3-D and as curves.

Entities, over the timeline `sim_time`:

    /runs/<controller>/<plant>/run-<k>/state/<state>              as in traces.parquet, every kept run
    /runs/<controller>/<plant>/run-<k>/input/<input>
    /runs/<controller>/<plant>/run-<k>/gap/<state>/{actual,lower,upper}
    /shown/<controller>/...       what is derived from the run on display: share of the bound, value function, events
    /scene/...                    the 3-D scene        /phase/...    winning domains with the runs in them
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap import reading
from simgap.arrays import Floats, Ints
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.rerun.recording import (
    SERIES,
    TIMELINE,
    Content,
    JointScene,
    PlanarScene,
    curves,
    finite,
    laid_out,
    lean,
    log_scene,
    plot,
    recording_file,
    rgb,
    root,
    share_of_bound,
    stance,
    viewed,
)
from simgap.io.traces import GAP_AWARE, NOMINAL, SIMULATOR, TITLES, Trace, cut_short, first_seconds, twin
from simgap.late import rerun as rr
from simgap.late import rerun_blueprint as rrb
from simgap.notation import axis_label
from simgap.synthesis.controller import Controller


def write_recording(path: Path, content: Content) -> None:
    """Write the recording with its blueprint, atomically."""
    content = replace(content, scene=viewed(content.scene))
    with recording_file(path, "simgap", f"simgap-{content.case}", blueprint(content)) as recording:
        recording.log("about", rr.TextDocument(content.about, media_type="text/markdown"), static=True)
        for trace in content.traces:
            for entity, t, values in curves(trace, content.states, content.inputs):
                plot(recording, entity, t, values, *_look(entity, trace))
        for controller, trace in content.shown.items():
            _log_shown(recording, content, controller, trace)
        _log_limits(recording, content)
        log_phase(recording, content)
        log_scene(recording, content)


def _look(entity: str, trace: Trace) -> tuple[str, float, str]:
    """Colour, width and name of a curve of a run."""
    colour = COLOURS[trace.controller] if trace.plant == SIMULATOR else style.GREY
    plant = "simulator" if trace.plant == SIMULATOR else "model"
    last = entity.rsplit("/", 1)[-1]
    if last in ("lower", "upper"):
        return style.ORANGE, 1.5, f"{TITLES[trace.controller]}, {last} bound"
    width = 3.5 if last == "actual" else 2.0 if plant == "simulator" else 1.3
    return colour, width, f"{TITLES[trace.controller]}, {plant}"


def _log_shown(recording: Any, content: Content, controller: str, trace: Trace) -> None:
    """The share of the bound, the value function and what happened, of the run on display."""
    share = share_of_bound(trace)
    for j, name in enumerate(content.states):
        curve = finite(f"shown/{controller}/share/{name}", trace.t, share[:, j])
        plot(recording, *curve, SERIES[j % len(SERIES)][0], 2.0)
    policy = content.controllers[controller]
    if policy.solution.value is not None:
        steps = steps_to_target(policy, trace)
        plot(recording, f"shown/{controller}/value", *steps, COLOURS[controller], 2.0, TITLES[controller])
    for when, text, level in events(content, controller, trace):
        recording.set_time(TIMELINE, duration=when)
        recording.log(f"shown/{controller}/events", rr.TextLog(text, level=level))
    recording.reset_time()


def steps_to_target(policy: Controller, trace: Trace) -> tuple[Floats, Floats]:
    """The value function along a run: times and steps, (n,) each, without the last where no pending input is known."""
    memory = memories(policy, trace)
    return trace.t[: len(memory)], policy.value(trace.x[: len(memory)], memory).astype(np.float64)


def memories(policy: Controller, trace: Trace) -> Ints:
    """What the controller remembered at the samples of a run, as far as its inputs say."""
    applied = np.argmin(np.abs(policy.input_set[None] - trace.u[:-1, None]).sum(axis=2), axis=1)
    memory = [policy.first]
    for cell, chosen in zip(policy.cell(trace.x).tolist(), applied[int(policy.late) :].tolist(), strict=False):
        memory.append(int(policy.solution.step(memory[-1], chosen, cell)[1]))
    return np.array(memory)


def events(content: Content, controller: str, trace: Trace) -> list[tuple[float, str, str]]:
    """Time, text and level of what a viewer should notice about a run."""
    title, policy = TITLES[controller], content.controllers[controller]
    out = [(0.0, f"{title}: run {trace.run} starts", "INFO")]
    if trace.violates:
        first = int(np.flatnonzero(~trace.safe)[0])
        t, x = float(trace.t[first]), trace.x[first]
        where = ", ".join(f"{n} = {v:.4g}" for n, v in zip(content.states, x, strict=True))
        out.append((t, f"{title}: the simulator is unsafe at {where}", "ERROR"))
    elif (task := policy.progress) is not None:
        stages = memories(policy, trace) // task.base
        for k in 1 + np.flatnonzero(np.diff(stages)):
            following = task.awaits[stages[k]] if task.awaits else ""
            what = f"next is {following}" if following else f"to stage {stages[k]}"
            out.append((float(trace.t[k]), f"{title}: the task moves on, {what}", "INFO"))
    elif policy.in_target(trace.x[-1:])[0]:
        arrived = float(trace.t[policy.in_target(trace.x)][0])
        out.append((arrived, f"{title}: target reached after {arrived:g} s", "INFO"))
    elif cut_short(content.traces, trace) > 0.0:
        out.append((trace.duration, f"{title}: ends without an admissible input", "WARN"))
    elif policy.solution.target is not None:
        out.append((trace.duration, f"{title}: ends without reaching the target", "WARN"))
    else:
        out.append((trace.duration, f"{title}: safe at all {len(trace.t)} samples", "INFO"))
    model = twin(content.traces, trace)
    if model is not None and (model.violates or model.duration < trace.duration):
        what = "unsafe" if model.violates else "ends without an admissible input"
        out.append((model.duration, f"{title}, run on the nominal model: {what}", "WARN"))
    return sorted(out)


def _log_limits(recording: Any, content: Content) -> None:
    """The safe set beside the states, and +-1 beside the share of the bound."""
    ends = np.array([0.0, max(t.duration for t in content.shown.values())])
    for j, name in enumerate(content.states):
        for side, value in (("lowest", content.safe.lo[j]), ("highest", content.safe.hi[j])):
            if np.isfinite(value):
                limit, named = np.full(2, value), f"safe set, {side}"
                plot(recording, f"safe_set/{name}/{side}", ends, limit, style.GREEN, 1.5, named)
    for side, value in (("lower", -1.0), ("upper", 1.0)):
        plot(recording, f"bound/{side}", ends, np.full(2, value), style.ORANGE, 1.5, f"{side} bound")


PIXELS = 800  # along the longer side, at least
NEITHER, BOTH = "#FFFFFF", "#C9D3DC"


def on_plane(controller: Controller) -> Floats:
    """Share of the cells above each point of the plane of the first two states that win: (c0, c1)."""
    winning = controller.solution.winning.reshape(controller.grid.cells)
    return winning.reshape(*winning.shape[:2], -1).mean(axis=2)


def domains_image(gap_aware: Controller, nominal: Controller) -> NDArray[np.uint8]:
    """Winning domains of the controllers as colours: (c1, c0, 3), second state upward.

    More than two states: where it wins for every value of the others.
    """
    a, b = on_plane(gap_aware) >= 1.0, on_plane(nominal) >= 1.0
    image = np.empty((*a.shape, 3), np.uint8)
    for chosen, colour in ((~a & ~b, NEITHER), (a & b, BOTH), (a & ~b, COLOURS[GAP_AWARE]), (~a & b, COLOURS[NOMINAL])):
        image[chosen] = rgb(colour)[:3]
    return np.ascontiguousarray(image.transpose(1, 0, 2)[::-1])


def to_pixels(x: Floats, box: Box, shape: tuple[int, int]) -> Floats:
    """States (n, >= 2) in the coordinates of an image of (height, width) that shows `box`: (n, 2)."""
    height, width = shape
    scaled = (x[:, :2] - box.lo[:2]) / (box.hi[:2] - box.lo[:2])
    return np.stack([scaled[:, 0] * width, (1.0 - scaled[:, 1]) * height], axis=1)


def log_phase(recording: Any, content: Content) -> None:
    """Log the image and the runs; nothing for plants with one state, or grids that differ."""
    gap_aware, nominal = content.controllers[GAP_AWARE], content.controllers[NOMINAL]
    if len(content.states) < 2 or gap_aware.grid.cells != nominal.grid.cells:
        return
    image = domains_image(gap_aware, nominal)
    repeat = max(1, PIXELS // max(image.shape[:2]))
    image = image.repeat(repeat, axis=0).repeat(repeat, axis=1)
    recording.log("phase/winning_domains", rr.Image(image), static=True)
    size = 0.004 * max(image.shape[:2])
    for controller, trace in content.shown.items():
        points = to_pixels(trace.x, gap_aware.grid.box, image.shape[:2])
        name, colour = f"phase/{controller}", rgb("#00436B" if controller == GAP_AWARE else COLOURS[controller])
        recording.log(f"{name}/path", rr.LineStrips2D([points], colors=colour, radii=0.35 * size), static=True)
        look = rr.Points2D.from_fields(colors=colour, radii=1.6 * size)
        recording.log(f"{name}/state", look, static=True)
        recording.send_columns(
            f"{name}/state", [rr.TimeColumn(TIMELINE, duration=trace.t)], rr.Points2D.columns(positions=points)
        )


_LOOK = {"lower": (style.ORANGE, 1.5), "upper": (style.ORANGE, 1.5), "actual": (style.BLUE, 3.0)}


def write_witness(
    path: Path,
    case: str,
    what: str,
    trace: Trace,
    states: Sequence[str],
    inputs: Sequence[str],
    measured: Floats | None = None,
) -> None:
    """Write the recording atomically; `rerun PATH` opens it. `measured` (n, nx) is what the controller saw."""
    with recording_file(path, "simgap", f"simgap-witness-{case}") as recording:
        recording.log("about", rr.TextDocument(f"# {case}\n\n{what}", media_type="text/markdown"), static=True)
        every = [*curves(trace, states, inputs)]
        if measured is not None:
            every += [finite(f"{root(trace)}/measured/{n}", trace.t, measured[:, j]) for j, n in enumerate(states)]
        for entity, t, values in every:
            plot(recording, entity, t, values, *_LOOK.get(entity.rsplit("/", 1)[-1], (style.BLACK, 2.0)))


def blueprint(content: Content) -> Any:
    """The blueprint of a case: tabs for the two controllers' gaps, everything else side by side."""
    about = rrb.TextDocumentView(name="What this shows", origin="/about")
    middle: list[Any] = [about]
    if len(content.states) >= 2:
        middle.insert(0, rrb.Spatial2DView(name=_plane(content), origin="/phase", contents="$origin/**"))
    left = [
        *([_scene(content, content.scene)] if content.scene is not None else []),
        rrb.Horizontal(*middle, column_shares=[3.0, 2.0][: len(middle)]),
        rrb.TextLogView(
            name="Events", origin="/shown", contents=[f"/shown/{c}/events" for c in content.shown], columns=_columns()
        ),
    ]
    columns = rrb.Vertical(*left, row_shares=[3.0, 3.0, 1.4][-len(left) :]), _curves(content), _gaps(content)
    return laid_out(rrb.Horizontal(*columns, column_shares=[9, 6, 6]), timeline=TIMELINE)


def _plane(content: Content) -> str:
    """Name of the view of the domains: its axes, and what it says of the other states."""
    (x, y), others = (axis_label(n, content.units) for n in content.states[:2]), content.states[2:]
    return f"Domains: {x} across, {y} up" + (f", every {' and '.join(others)}" if others else "")


def _columns() -> Any:
    """Time and text, without the entity's path."""
    from rerun.blueprint import encodings

    kinds = encodings.TextLogColumnKind
    shown = [encodings.TextLogColumn(kind, visible=kind != kinds.EntityPath) for kind in (kinds.LogLevel, kinds.Body)]
    return rrb.TextLogColumns(text_log_columns=shown)


def _scene(content: Content, scene: JointScene | PlanarScene) -> Any:
    planar = isinstance(scene, PlanarScene)
    name = "Arena, robots and paths" if planar else "The plant under both controllers; grey: the nominal model"
    bodies = [f"/body_{controller}_{plant}" for controller in content.shown for plant in ("simulator", "model")]
    robot = "" if scene.urdf is None else f"{reading.read_xml(scene.urdf).get('name', '')}/"
    bodies = [rule for body in bodies for rule in (f"{body}/**", f"- {body}/{robot}collision_geometries/**")]
    return rrb.Spatial3DView(
        name=name, origin="/scene", contents=["/scene/**", *bodies], eye_controls=_eye(content, scene), line_grid=False
    )


def _eye(content: Content, scene: JointScene | PlanarScene) -> Any:
    if isinstance(scene, PlanarScene):
        arena = scene.arena
        x, y = 0.5 * (arena.lo + arena.hi)
        high = 0.8 * float(max(arena.hi - arena.lo))
        return rrb.EyeControls3D(position=(x, y - 0.7 * high, high), look_target=(x, y, 0.0), eye_up=(0.0, 0.0, 1.0))
    along, across, reach = stance(scene)
    target = np.array([0.0, 0.0, 0.45 * lean(content, scene) * reach])
    eye = target + reach * (-1.35 * along + 0.12 * across) + np.array([0.0, 0.0, 0.12 * reach])
    return rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0))


def _plot(content: Content, name: str, contents: Sequence[str]) -> Any:
    """Curves without a legend, which would lie on them: the text of the recording says what the colours mean."""
    boundary = rrb.TimeRangeBoundary.absolute
    window = rr.TimeRange(boundary(seconds=0.0), boundary(seconds=first_seconds(content.shown)))
    return rrb.TimeSeriesView(
        name=name,
        origin="/",
        contents=list(contents),
        axis_x=rrb.TimeAxis(view_range=window),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _curves(content: Content) -> Any:
    """States against the safe set, inputs, the value function."""
    models = [m for t in content.shown.values() if (m := twin(content.traces, t)) is not None]
    views = []
    for name in content.states:
        runs = [f"/{root(t)}/state/{name}" for t in (*content.shown.values(), *models)]
        views.append(_plot(content, axis_label(name, content.units), [f"/safe_set/{name}/**", *runs]))
    for name in content.inputs:
        runs = [f"/{root(t)}/input/{name}" for t in content.shown.values()]
        views.append(_plot(content, f"input {axis_label(name, content.units)}", runs))
    if any(c.solution.value is not None for c in content.controllers.values()):
        values = [f"/shown/{controller}/value" for controller in content.shown]
        views.append(_plot(content, "Value function: steps to the target", values))
    return rrb.Vertical(*views, name="States and inputs")


def _gaps(content: Content) -> Any:
    """Gap against bound for each controller, a tab each, and where in its bound the gap lies."""
    series = ", ".join(f"{name} {SERIES[j % len(SERIES)][1]}" for j, name in enumerate(content.states))
    tabs = []
    for controller, trace in content.shown.items():
        views = []
        for name in content.states:
            label = axis_label(name, content.units)
            views.append(_plot(content, f"gap of {label} and its bound", [f"/{root(trace)}/gap/{name}/**"]))
        share = ["/bound/**", f"/shown/{controller}/share/**"]
        views.append(_plot(content, f"gap within its bound, ±1: {series}", share))
        tabs.append(rrb.Vertical(*views, name=f"Gap, {TITLES[controller]}"))
    return rrb.Tabs(*tabs, active_tab=list(content.shown).index(GAP_AWARE))
