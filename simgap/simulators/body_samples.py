"""Steps of a planar robot as the robot itself sees them: where it got to, and the box that its path swept."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from simgap.arrays import Floats, Ints

REST = -1
"""In place of the number of a previous input: the robot was at rest."""


@dataclass(frozen=True, eq=False)
class BodySamples:
    """Roll-outs seen from the pose at which their input began.

    Attributes:
        m: (n,) number of the input in U; final: (n, 3) pose after tau; extent: (n, 4) least and largest x, least and
            largest y along the path, the start included.
        previous: (n,) number of the input before, `REST` where there was none.
    """

    m: Ints
    final: Floats
    extent: Floats
    previous: Ints

    @staticmethod
    def of_paths(
        m: Ints, paths: Floats, pose: tuple[int, int, int] = (0, 1, 2), previous: Ints | int = REST
    ) -> BodySamples:
        """From paths (n, poses, 3) that do not hold the start itself; `pose` says which states are x, y, heading."""
        x, y = paths[..., pose[0]], paths[..., pose[1]]
        ends = [np.minimum(x.min(1), 0), np.maximum(x.max(1), 0), np.minimum(y.min(1), 0), np.maximum(y.max(1), 0)]
        before = np.broadcast_to(np.asarray(previous, dtype=np.int64), (len(m),))
        return BodySamples(m, paths[:, -1].copy(), np.stack(ends, axis=1), before)


def joined(parts: list[BodySamples]) -> BodySamples:
    """Samples under each other."""
    return BodySamples(*(np.concatenate([getattr(p, own.name) for p in parts]) for own in fields(BodySamples)))


def to_body(d: Floats, heading: Floats | float, pose: tuple[int, int, int] = (0, 1, 2)) -> Floats:
    """Differences (..., 3) of the world turned into frames of the given headings, of one or (...,): R(-heading) d."""
    i, j, _ = pose
    cos, sin = np.cos(heading), np.sin(heading)
    out = d.copy()
    out[..., i] = cos * d[..., i] + sin * d[..., j]
    out[..., j] = -sin * d[..., i] + cos * d[..., j]
    return out
