"""`simgap new`: a commented case for a robot that simgap has never seen, with numbers that are chosen to run.

Ranges, inputs and grids are round numbers near the model's equilibrium: a beginning to be edited, not a recommendation.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from simgap.config.load import load_case, parse_case
from simgap.errors import UserError
from simgap.geometry import Floats
from simgap.io.atomic import write_text
from simgap.io.pages import text
from simgap.plants.model_file import FileJoint, read_model_file
from simgap.plants.plant_model import PlantModel

TAU = 0.01
REACH, SPEED = 0.25, 0.5
"""Half-widths of X: rad or m, and the same a second. Judgement: small enough for a first run of a minute."""
AUTHORITY = 2.0
"""Times the acceleration that stops SPEED within REACH, beyond what holds the plant in place. Judgement."""
STATES, CELLS = 2500, 40_000
"""Of the first grid of samples, and cells of the first controller. Judgement: a run of a minute or two."""


@dataclass(frozen=True)
class Axis:
    """A moving joint as the case names it: symbols of position, velocity and input, units, centre of its range."""

    joint: str
    position: str
    velocity: str
    drive: str
    unit: str
    force: str
    centre: float


def run(name: str, urdf: Path | None, out: Path) -> Path:
    """Write `NAME.yaml` to the folder `out`: for a URDF, or equations to be replaced by one's own.

    Raises:
        UserError: a name that is none, a file that is there already, or a model file that simgap cannot take.
    """
    path = out / f"{name}.yaml"
    if path.exists():
        raise UserError("is there already, and stays as it is", file=path, remedy="Give another name, or move it.")
    content = text("new_equations.yaml.j2", name=name) if urdf is None else _of_urdf(name, urdf, out)
    parse_case(yaml.safe_load(content), path)
    write_text(path, content)
    load_case(path)
    return path


def _of_urdf(name: str, urdf: Path, out: Path) -> str:
    file = read_model_file(urdf)
    axes = _axes(urdf, file.joints)
    place = Path(os.path.relpath(urdf.resolve(), out.resolve())).as_posix()
    limits = _inputs(name, place, axes, out)
    nx = 2 * len(axes)
    volume = (2 * REACH * 2 * SPEED) ** len(axes)
    eps = 0.5 * math.sqrt(nx) * (volume / STATES) ** (1.0 / nx)
    values = 11 if len(axes) == 1 else 3
    steps = {n: _round_up(2 * u / (values - 1)) for n, u in limits.items()}  # 0 is among the values
    ranges = {a.joint: (_round(a.centre - REACH), _round(a.centre + REACH)) for a in axes}
    return text(
        "new_urdf.yaml.j2",
        name=name,
        urdf=place,
        axes=axes,
        ranges=ranges,
        speed=SPEED,
        limits={n: round(step * (values - 1) / 2, 12) for n, step in steps.items()},
        steps=steps,
        efforts={a.drive: file.joints[a.joint].effort for a in axes},
        tau=TAU,
        eps=_round(eps),
        cells=[max(2, round(CELLS ** (1.0 / nx)))] * nx,
        single=len(axes) == 1,
    )


def _axes(urdf: Path, joints: Mapping[str, FileJoint]) -> list[Axis]:
    if not joints:
        raise UserError("has no moving joint", file=urdf, remedy="Give the URDF of a robot that moves.")
    axes = []
    for k, (name, joint) in enumerate(joints.items()):
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise UserError(
                f"the joint '{name}' is {joint.kind}", file=urdf,
                remedy="Joints that turn about or slide along one axis can be taken; write equations for the others.",
            )  # fmt: skip
        slides = joint.kind == "prismatic"
        lower, upper = joint.range or (-math.inf, math.inf)
        centre = min(max(0.0, lower + REACH), upper - REACH) if upper - lower > 2 * REACH else (lower + upper) / 2
        end = "" if len(joints) == 1 else str(k + 1)
        axes.append(Axis(name, f"q{end}", f"v{end}", f"u{end}", "m" if slides else "rad",
            "N" if slides else "N*m", centre))  # fmt: skip
    return axes


def _inputs(name: str, urdf: str, axes: list[Axis], folder: Path) -> dict[str, float]:
    """For each input the largest magnitude that the case starts with, by the nominal model."""
    states = {a.position: {"joint": a.joint, "quantity": "position", "unit": a.unit} for a in axes}
    states |= {a.velocity: {"joint": a.joint, "quantity": "velocity", "unit": f"{a.unit}/s"} for a in axes}
    inputs = {a.drive: {"joint": a.joint, "unit": a.force} for a in axes}
    case = parse_case({"name": name, "plant": {"urdf": urdf, "states": states, "inputs": inputs}}, folder / "new.yaml")
    model = PlantModel(case.plant, folder, TAU).sampled
    n = len(axes)
    corners = np.stack(np.meshgrid(*([-1.0, 0.0, 1.0],) * (2 * n), indexing="ij"), axis=-1).reshape(-1, 2 * n)
    x = corners * np.array([REACH] * n + [SPEED] * n) + np.array([a.centre for a in axes] + [0.0] * n)

    def acceleration(u: Floats) -> Floats:
        rows = np.repeat(u[None], len(x), axis=0)
        return np.asarray((model.step(x, rows) - x)[:, n:] / TAU)

    free, found = acceleration(np.zeros(n)), {}
    for k, a in enumerate(axes):
        gain = np.abs(acceleration(np.eye(n)[k]) - free)[:, k].min()
        needed = (np.abs(free[:, k]).max() + AUTHORITY * SPEED**2 / (2 * REACH)) / max(gain, 1e-12)
        found[a.drive] = _round(float(needed))
    return found


def _round_up(value: float) -> float:
    """At least the value, in two digits."""
    rounded = _round(value)
    return rounded if rounded >= value else _round(rounded + 10.0 ** (math.floor(math.log10(value)) - 1))


def _round(value: float) -> float:
    """Two significant digits, as a person would write them."""
    return float(f"{value:.2g}")
