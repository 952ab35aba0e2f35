"""End stops of the joints of a model file: positions beyond which an engine does not let them go."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from simgap import reading

_STOPPED = ("revolute", "prismatic")


def joint_stops(urdf: Path, joints: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Finite limits of the position of each of these joints, in rad or m; none for a continuous one.

    The file is one that `urdf_checks.check_urdf` has taken.
    """
    found = {}
    for joint in reading.read_xml(urdf).findall("joint"):
        limit = joint.find("limit")
        if joint.get("name") in joints and joint.get("type") in _STOPPED and limit is not None:
            ends = [float(limit.get(end, "0")) for end in ("lower", "upper")]
            found[str(joint.get("name"))] = tuple(sorted({end for end in ends if math.isfinite(end)}))
    return {name: found.get(name, ()) for name in joints}
