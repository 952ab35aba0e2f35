"""Content of a recording of the closed loop: the curves of every run, its file, and its 3-D scene.

The scene is the plant's own URDF, moved along the runs on display.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.atomic import write_bytes
from simgap.io.figure_style import COLOURS
from simgap.io.traces import EVERY_TITLE, MODEL, SIMULATOR, TITLES, Trace, twin
from simgap.late import rerun as rr
from simgap.late import rerun_blueprint as rrb
from simgap.plants.model_file import numbers
from simgap.synthesis.controller import Controller

SERIES = (("#56B4E9", "light blue"), ("#CC79A7", "pink"), ("#009E73", "green"), ("#F0E442", "yellow"))
"""Colours of the states in one view, with what a title calls them (Okabe & Ito (2008))."""
_PLANTS = {SIMULATOR: "simulator", MODEL: "nominal_model"}


@dataclass(frozen=True, eq=False)
class JointScene:
    """A URDF whose joints follow states: joint name -> index of the state that is its position."""

    urdf: Path
    joints: Mapping[str, int]

    @cached_property
    def links(self) -> tuple[tuple[Any, int, Floats], ...]:
        """Each joint, the index of its state, and where the far end of its link is: twice the centre of its visual."""
        tree, document = _tree(self.urdf, "links"), reading.read_xml(self.urdf)
        joints = [(tree.get_joint_by_name(name), j) for name, j in self.joints.items()]
        places = [f"./link[@name='{joint.child_link}']/visual/origin" for joint, _ in joints]
        return tuple((*own, 2.0 * numbers(document, place, "xyz")) for own, place in zip(joints, places, strict=True))


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


def laid_out(content: Any, **time: Any) -> Any:
    """A blueprint of these views alone, with its panels shut; `time`: what more the one of time is given."""
    hidden = rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden")
    return rrb.Blueprint(content, rrb.TimePanel(state="collapsed", **time), *hidden, auto_views=False)


WORLD = "tf#/scene"  # the frame of the entity /scene
APART = 0.6  # between copies of a plant that is fixed to the ground, as a share of its reach
_COLOURED = {"cylinder": "Cylinders3D", "box": "Boxes3D", "sphere": "Ellipsoids3D", "capsule": "Capsules3D"}


def viewed(scene: JointScene | PlanarScene | None) -> JointScene | PlanarScene | None:
    """The scene without a model file that the viewer's reader refuses, such as one whose <limit> has no velocity."""
    if scene is None or scene.urdf is None:
        return scene
    try:
        _tree(scene.urdf, "viewed")
    except RuntimeError:
        return replace(scene, urdf=None) if isinstance(scene, PlanarScene) else None
    return scene


def log_scene(recording: Any, content: Content) -> None:
    """Log the scene that the content asks for; nothing if it has none."""
    if content.scene is None:
        return
    recording.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if isinstance(content.scene, JointScene):
        _joints(recording, content, content.scene)
    else:
        _planar(recording, content, content.scene)


def _joints(recording: Any, content: Content, scene: JointScene) -> None:
    """A copy for each controller: the simulator solid, the nominal model as a ghost, limits of the safe set in grey."""
    _, across, reach = stance(scene)
    aside = -0.1 * lean(content, scene) * reach
    for number, (controller, trace) in enumerate(content.shown.items()):
        offset = APART * reach * (number - 0.5) * across
        above = offset + np.array([0.0, 0.0, aside])
        label = rr.Points3D([above], labels=[TITLES[controller]], colors=rgb(COLOURS[controller]), radii=0.012)
        recording.log(f"scene/{controller}/label", label, static=True)
        _jointed(recording, scene, f"body_{controller}_simulator", offset, trace, rgb(COLOURS[controller]))
        model = twin(content.traces, trace)
        if model is not None:
            _jointed(recording, scene, f"body_{controller}_model", offset, model, rgb(style.GREY, 110))
        if len(scene.joints) == 1:
            _limits(recording, content, scene, f"scene/{controller}/safe_set", offset)


def stance(scene: JointScene) -> tuple[Floats, Floats, float]:
    """Unit vectors, (3,) each, along which to look at the plant and side by side, and how far it reaches, m."""
    axis = np.asarray(scene.links[0][0].axis if scene.links else (0.0, 1.0, 0.0), dtype=float)
    along = axis if abs(axis[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    across = np.cross(along, [0.0, 0.0, 1.0])
    reach = sum(float(np.linalg.norm(far)) for *_, far in scene.links)
    return along / np.linalg.norm(along), across / np.linalg.norm(across), max(reach, 0.1)


def lean(content: Content, scene: JointScene) -> float:
    """How far up the plant stands where the runs begin: 1 upright, -1 hanging, for joints about one axis."""
    x = next(iter(content.shown.values())).x[0]
    angle, tip = 0.0, np.zeros(3)
    for joint, j, far in scene.links:
        angle += 0.0 if joint.joint_type == "prismatic" else float(x[j])
        tip += _rotated(np.asarray(joint.axis), angle, far)
    return float(tip[2] / max(np.linalg.norm(tip), 1e-9))


def _limits(recording: Any, content: Content, scene: JointScene, prefix: str, offset: Floats) -> None:
    """For one joint: the ends of the safe set as thin lines from the joint to the end of the link."""
    ((joint, j, reach),) = scene.links
    if joint.joint_type not in ("revolute", "continuous"):
        return
    for side, value in (("lowest", content.safe.lo[j]), ("highest", content.safe.hi[j])):
        if np.isfinite(value):
            tip = _rotated(np.asarray(joint.axis), float(value), reach) + np.asarray(joint.origin_xyz)
            strip = [np.add(joint.origin_xyz, offset), np.add(tip, offset)]
            look = rr.LineStrips3D([strip], colors=rgb(style.GREEN), radii=0.004 * float(np.linalg.norm(reach)))
            recording.log(f"{prefix}/{side}", look, static=True)


def _rotated(axis: Floats, angle: float, v: Floats) -> Floats:
    """Rodrigues' rotation of v about a unit axis."""
    cross, along = np.cross(axis, v), axis * np.dot(axis, v)
    return np.asarray(v * np.cos(angle) + cross * np.sin(angle) + along * (1.0 - np.cos(angle)))


def _tree(urdf: Path, prefix: str) -> Any:
    """The URDF with all its entities under `/prefix`, and its frames apart from those of other copies."""
    return rr.urdf.UrdfTree.from_file_path(
        urdf,
        entity_path_prefix=prefix,
        frame_prefix=f"{prefix}/",
        static_transform_entity_path=f"{prefix}_fixed",  # else all copies share one, and overwrite it
    )


def _place(recording: Any, urdf: Path, prefix: str, colour: list[int]) -> Any:
    """Log a URDF under a prefix, all of it in one colour: -> its tree."""
    tree = _tree(urdf, prefix)
    tree.log_urdf_to_recording(recording=recording)
    links = {link.get("name"): link for link in reading.read_xml(urdf).findall("link")}
    for name, link in links.items():
        paths = tree.get_visual_geometry_paths(tree.get_link_by_name(name))
        for path, visual in zip(paths, link.findall("visual"), strict=False):
            shape = visual.find("geometry/*")
            kind = _COLOURED.get(shape.tag) if shape is not None else None
            if kind is not None:
                recording.log(path, getattr(rr, kind).from_fields(colors=[colour], fill_mode="solid"), static=True)
    return tree


def _jointed(recording: Any, scene: JointScene, prefix: str, offset: Floats, trace: Trace, colour: list[int]) -> None:
    """A URDF fixed to the ground whose joints follow a trace."""
    tree = _place(recording, scene.urdf, prefix, colour)
    base = rr.Transform3D(translation=offset, parent_frame=WORLD, child_frame=f"{prefix}/{tree.root_link().name}")
    recording.log(f"{prefix}/base", base, static=True)
    times = [rr.TimeColumn(TIMELINE, duration=trace.t)]
    for name, j in scene.joints.items():
        joint = tree.get_joint_by_name(name)
        moves = joint.compute_transform_columns(trace.x[:, j].tolist(), clamp=False)
        recording.send_columns(f"{prefix}/joints/{name}", times, moves)


def _planar(recording: Any, content: Content, scene: PlanarScene) -> None:
    """The arena with obstacles and target, and a robot for each controller with the path behind it."""
    _floor(recording, "scene/arena", scene.arena, rgb("#ECEFF2"), 0.01, below=True)
    if scene.target is not None:
        _floor(recording, "scene/target", scene.target, rgb(style.YELLOW), 0.012)
    for k, obstacle in enumerate(scene.obstacles):
        _floor(recording, f"scene/obstacles/{k}", obstacle, rgb("#3A3F47"), 0.35)
    for controller, trace in content.shown.items():
        _driven(recording, scene, f"body_{controller}_simulator", trace, rgb(COLOURS[controller]))
        _path(recording, scene, f"scene/{controller}/path", trace, rgb(COLOURS[controller]))
        model = twin(content.traces, trace)
        if model is not None:
            _path(recording, scene, f"scene/{controller}/{MODEL.replace(' ', '_')}", model, rgb(style.GREY))


def _floor(recording: Any, entity: str, box: Box, colour: list[int], height: float, below: bool = False) -> None:
    middle, half = 0.5 * (box.lo + box.hi), 0.5 * (box.hi - box.lo)
    z = -height if below else height
    shape = rr.Boxes3D(
        centers=[(*middle, 0.5 * z)], half_sizes=[(*half, 0.5 * height)], colors=colour, fill_mode="solid"
    )
    recording.log(entity, shape, static=True)


def _path(recording: Any, scene: PlanarScene, entity: str, trace: Trace, colour: list[int]) -> None:
    points = np.column_stack([trace.x[:, list(scene.axes[:2])], np.full(len(trace.t), 0.02)])
    recording.log(entity, rr.LineStrips3D([points], colors=colour, radii=0.02), static=True)


def _driven(recording: Any, scene: PlanarScene, prefix: str, trace: Trace, colour: list[int]) -> None:
    """The robot at its pose: its URDF, or a disc with a nose."""
    x, y, heading = (trace.x[:, j] for j in scene.axes)
    if scene.urdf is not None:
        child = f"{prefix}/{_place(recording, scene.urdf, prefix, colour).root_link().name}"
    else:
        child = f"{prefix}/body"
        disc = rr.Cylinders3D(lengths=[0.2], radii=[scene.radius], colors=colour, fill_mode="solid")
        recording.log(child, rr.CoordinateFrame(child), disc, static=True)
    zero = np.zeros_like(x)
    poses = rr.Transform3D.columns(
        translation=np.column_stack([x, y, zero]),
        quaternion=np.column_stack([zero, zero, np.sin(0.5 * heading), np.cos(0.5 * heading)]),
        parent_frame=[WORLD] * len(x),
        child_frame=[child] * len(x),
    )
    recording.send_columns(f"{prefix}/pose", [rr.TimeColumn(TIMELINE, duration=trace.t)], poses)
