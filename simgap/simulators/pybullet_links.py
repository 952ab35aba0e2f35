"""Links as PyBullet computes with them, and the frames without mass that it would give 1 kg."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simgap.plants.model_file import Link, read_model_file


def without_mass(p: Any, client: int, body: int, urdf: Path) -> None:
    """Take from links without `<inertial>` the 1 kg and 1, 1, 1 kg m^2 that PyBullet invents for them.

    Frames of sensors and tools on fixed joints are written like that; Drake gives them no mass. The root is left as it
    is: where it is welded to the world its inertia moves nothing, and where it floats one without is refused
    (`check_floating_root`).
    """
    bare = set(read_model_file(urdf).bare)
    for name, j in _numbers(p, client, body).items():
        if name in bare:
            p.changeDynamics(body, j, mass=0.0, localInertiaDiagonal=[0.0, 0.0, 0.0], physicsClientId=client)


def links_of(p: Any, client: int, body: int) -> Mapping[str, Link]:
    """Mass, principal moments and centre of mass of every link but the root, by name."""
    found = {}
    for name, j in _numbers(p, client, body).items():
        info = p.getDynamicsInfo(body, j, physicsClientId=client)
        found[name] = Link(float(info[0]), np.sort(info[2]), np.array(info[3]))
    return found


def _numbers(p: Any, client: int, body: int) -> dict[str, int]:
    """Link names and their numbers; a link has the number of the joint that it hangs on."""
    count = p.getNumJoints(body, physicsClientId=client)
    return {p.getJointInfo(body, j, physicsClientId=client)[12].decode(): j for j in range(count)}
