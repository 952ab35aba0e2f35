"""Engines that are a map and nothing more: their state is x, so that a reset leaves nothing behind."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.simulators.base import Engine


class MapEngine(Engine):
    """An engine that offers `rollouts`; a step is one of them."""

    _x: Floats

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,)."""
        self._x = np.array(x, dtype=np.float64)

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau: -> (nx,)."""
        self._x = self.rollouts(self._x[None], np.asarray(u, dtype=np.float64).reshape(1, self.nu))[0]
        return self._x.copy()
