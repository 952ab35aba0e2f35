"""What engines of a planar robot share: chains of inputs, and paths seen from the pose at which an input began."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from simgap.geometry import Floats
from simgap.simulators.base import PathSimulator


class WheeledPaths(PathSimulator):
    """An engine whose `path` (poses, 3) holds the poses of the last step, headings continued."""

    path: Floats

    @abstractmethod
    def reset(self, x: Floats) -> None:
        """Put the robot at rest at a pose."""

    def chain(self, start: Floats, inputs: Floats) -> tuple[Floats, Floats]:
        """Run inputs (k, nu) one after the other from rest: -> poses (k + 1, 3), paths (k, poses, 3) in body frames."""
        self.reset(start)
        poses = np.empty((len(inputs) + 1, 3))
        poses[0] = start
        paths = np.empty((len(inputs), *self.path.shape))
        for n, u in enumerate(inputs):
            poses[n + 1] = self.advance(u)
            paths[n] = self._in_body_frame(poses[n])
        return poses, paths

    def _in_body_frame(self, origin: Floats) -> Floats:
        i, j, k = self.pose
        cos, sin = np.cos(origin[k]), np.sin(origin[k])
        d = self.path - origin
        out = np.empty_like(d)
        out[:, i] = cos * d[:, i] + sin * d[:, j]
        out[:, j] = -sin * d[:, i] + cos * d[:, j]
        out[:, k] = d[:, k]
        return out
