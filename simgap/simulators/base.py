"""The interface that an engine implements to be the high-fidelity side."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from simgap.geometry import Floats


class Simulator(ABC):
    """The map `x+ = f_hat(x, u)` over one sampling time (paper, eq. simulator_model).

    An instance owns an engine and must live in a process of its own (`simgap.simulators.process`).
    """

    nx: int
    nu: int
    engine: str
    remembers: bool = False
    """Whether delay or lag of the inputs make the successor depend on earlier commands; `spread` is then its range."""

    @abstractmethod
    def reset(self, x: Floats) -> None:
        """Put the plant at state x (nx,), with nothing left of what ran before."""

    @abstractmethod
    def advance(self, u: Floats) -> Floats:
        """Run one sampling time under input u (nu,): -> the new state (nx,)."""

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx); the same bits in any order."""
        out = np.empty((len(x), self.nx))
        for k in range(len(x)):
            self.reset(x[k])
            out[k] = self.advance(u[k])
        return out

    def spread(self, x: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Least and largest successors over what earlier commands leave behind: (n, nx), (n, nu) -> two (n, nx)."""
        following = self.rollouts(x, u)
        return following, following

    def close(self) -> None:  # noqa: B027 - most engines have nothing to release
        """Release the engine."""
