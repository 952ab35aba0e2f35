"""How the viewer opens a recording: the scene and the winning domains on the left, curves on the right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simgap.geometry import Box
from simgap.io.rerun.recording import TIMELINE, Content, JointScene, PlanarScene, root
from simgap.io.rerun.scene import robot_name, stance
from simgap.io.traces import ROBUST, TITLES, twin
from simgap.notation import axis_label


def blueprint(content: Content) -> Any:
    """The blueprint of a case: tabs for the two controllers' gaps, everything else side by side."""
    import rerun.blueprint as rrb

    about = rrb.TextDocumentView(name="What this shows", origin="/about")
    middle: list[Any] = [about]
    if len(content.states) >= 2:
        middle.insert(0, rrb.Spatial2DView(name=_plane(content), origin="/phase", contents="$origin/**"))
    left = [
        *([_scene(content)] if content.scene is not None else []),
        rrb.Horizontal(*middle, column_shares=[3.0, 2.0][: len(middle)]),
        rrb.TextLogView(
            name="Events", origin="/shown", contents=[f"/shown/{c}/events" for c in content.shown], columns=_columns()
        ),
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*left, row_shares=[3.0, 3.0, 1.4][-len(left) :]),
            _curves(content),
            _gaps(content),
            column_shares=[9, 6, 6],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _plane(content: Content) -> str:
    """Name of the view of the domains: its axes, and what it says of the other states."""
    (x, y), others = (axis_label(n, content.units) for n in content.states[:2]), content.states[2:]
    return f"Domains: {x} across, {y} up" + (f", every {' and '.join(others)}" if others else "")


def _columns() -> Any:
    """Time and text, without the entity's path."""
    import rerun.blueprint as rrb
    from rerun.blueprint import encodings

    kinds = encodings.TextLogColumnKind
    shown = [encodings.TextLogColumn(kind, visible=kind != kinds.EntityPath) for kind in (kinds.LogLevel, kinds.Body)]
    return rrb.TextLogColumns(text_log_columns=shown)


def _scene(content: Content) -> Any:
    import rerun.blueprint as rrb

    planar = isinstance(content.scene, PlanarScene)
    name = "Arena, robots and paths" if planar else "The plant under both controllers; grey: the nominal model"
    bodies = [f"/body_{controller}_{plant}" for controller in content.shown for plant in ("simulator", "model")]
    urdf = content.scene.urdf if content.scene is not None else None
    collisions = f"{robot_name(urdf)}/collision_geometries" if urdf is not None else "collision_geometries"
    bodies = [rule for body in bodies for rule in (f"{body}/**", f"- {body}/{collisions}/**")]
    return rrb.Spatial3DView(
        name=name, origin="/scene", contents=["/scene/**", *bodies], eye_controls=_eye(content), line_grid=False
    )


def _eye(content: Content) -> Any:
    import rerun.blueprint as rrb

    if not isinstance(content.scene, JointScene):
        arena = content.scene.arena if content.scene is not None else Box([0.0, 0.0], [1.0, 1.0])
        x, y = 0.5 * (arena.lo + arena.hi)
        high = 0.8 * float(max(arena.hi - arena.lo))
        return rrb.EyeControls3D(position=(x, y - 0.7 * high, high), look_target=(x, y, 0.0), eye_up=(0.0, 0.0, 1.0))
    along, across, reach = stance(content.scene)
    target = np.array([0.0, 0.0, -0.45 * reach])
    eye = target + reach * (-1.35 * along + 0.12 * across) + np.array([0.0, 0.0, 0.12 * reach])
    return rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0))


def first_seconds(content: Content) -> float:
    """How much of the runs the curves show at first: enough to see the shortest run end, s."""
    durations = [t.duration for t in content.shown.values()]
    return max(0.05 * max(durations), min(max(durations), 6.0 * min(durations)))


def _plot(content: Content, name: str, contents: Sequence[str]) -> Any:
    """Curves without a legend, which would lie on them: the text of the recording says what the colours mean."""
    import rerun as rr
    import rerun.blueprint as rrb

    boundary = rrb.TimeRangeBoundary.absolute
    window = rr.TimeRange(boundary(seconds=0.0), boundary(seconds=first_seconds(content)))
    return rrb.TimeSeriesView(
        name=name,
        origin="/",
        contents=list(contents),
        axis_x=rrb.TimeAxis(view_range=window),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _curves(content: Content) -> Any:
    """States against the safe set, inputs, the value function."""
    import rerun.blueprint as rrb

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
    import rerun.blueprint as rrb

    tabs = []
    for controller, trace in content.shown.items():
        views = []
        for name in content.states:
            label = axis_label(name, content.units)
            views.append(_plot(content, f"gap of {label} and its bound", [f"/{root(trace)}/gap/{name}/**"]))
        share = ["/bound/**", f"/shown/{controller}/share/**"]
        views.append(_plot(content, "where each gap lies in its bound, ±1", share))
        tabs.append(rrb.Vertical(*views, name=f"Gap, {TITLES[controller]}"))
    return rrb.Tabs(*tabs, active_tab=list(content.shown).index(ROBUST))
