"""Gap that dry friction which the nominal model lacks will leave, guessed for the games of a proposal.

A force of constant size against the speed moves the states by a known amount a step, forwards or backwards: a gap that
is shifted and not wide, but where the speed changes its sign within the step. By the linear model around a posture the
speed goes from v to v' = (A x + B u)_j, and the force points against it for (v + v') / (|v| + |v'|) of the step on
balance. A table of blocks bounds that over a block.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.extras.wizard.posture import Posture
from simgap.late import numba, scipy
from simgap.model.symbolic import SymbolicModel
from simgap.synthesis.abstraction.post import Kernel

RUBBING, RESTING = {1: 80, 2: 24}, {2: 25, 3: 10, 4: 8}
"""Cells of the grid, and blocks of the bound, where joints rub: along each speed that friction turns round with, by the
number of such speeds, and along each other axis, by the number of all. On a two-link arm with a tenth of its torques as
dry friction, 10 cells along a speed gave nothing and 24 won .56 of the cells, where the model alone wins .75."""


FINER = 1.6
"""Times as many cells along the speeds at which a dry friction turns round. On a cart with a pole and .07 of its force
as friction, 42 x 32 x 50 x 35 cells won nothing with the gap, 80 along the speed .46, and two thirds more along all
axes .50."""


def blocks_along(kept: Sequence[str], rubbing: Collection[str]) -> dict[str, int]:
    """Cells along each axis on which the gap may depend, where the speeds `rubbing` turn a dry friction round."""
    fine = RUBBING.get(len([n for n in kept if n in rubbing]), 12)
    return {n: fine if n in rubbing else RESTING.get(len(kept), 8) for n in kept}


@dataclass(frozen=True, eq=False)
class Rubbing:
    """Dry friction of k joints over one sampling time, around a posture.

    Attributes:
        names, free: the states, and those on which the motion does not depend.
        speeds: (k,) the state that is the speed of each. pushed: (k, n) what the force adds to the states in a step.
        following: (k, n + m) the speed after a step, by state and input; rest: (k,) its constant.
    """

    names: tuple[str, ...]
    free: tuple[str, ...]
    speeds: tuple[int, ...]
    pushed: Floats
    following: Floats
    rest: Floats

    def finer(self, cells: Sequence[int]) -> tuple[int, ...]:
        """More cells along the speeds."""
        return tuple(math.ceil(FINER * n) if j in self.speeds else n for j, n in enumerate(cells))

    def gap(self, half: Floats, spread: Floats) -> Kernel:
        """The gap as a table of blocks on X of these half-widths would bound it."""
        kept = [n for n in self.names if n not in self.free]
        along = blocks_along(kept, [self.names[j] for j in self.speeds])
        return _kernel(
            np.array(self.speeds), self.pushed, self.following, self.rest,
            np.array([2.0 * half[i] / along[n] if n in along else 0.0 for i, n in enumerate(self.names)]), spread,
        )  # fmt: skip


def rubbing(model: SymbolicModel, posture: Posture, friction: Mapping[str, float] | None, tau: float) -> Rubbing | None:
    """Effect of the dry friction of joints, by name, on the states over tau; None where no joint has any."""
    friction = friction or {}
    rubs = [c for c in model.coordinates if friction.get(c.name, 0.0) > 0.0]
    if not rubs:
        return None
    names = model.state_names
    here = dict(zip([v.symbol for v in model.states], posture.x, strict=True)) | model.values()
    forces = np.array([[float(e.subs(here)) for e in model.force_map[c.name]] for c in rubs]).T
    sizes = np.array([friction[c.name] for c in rubs])
    n, m, k = len(names), posture.b.shape[1], len(rubs)
    whole = np.zeros((n + m + k, n + m + k))
    whole[:n] = np.hstack([posture.a, posture.b, forces * sizes])
    step = scipy.linalg.expm(whole * tau)[:n]
    speeds = tuple(names.index(c.velocity) for c in rubs)
    following = step[list(speeds), : n + m]
    return Rubbing(
        names, posture.free, speeds, step[:, n + m :].T.copy(), following,
        posture.x[list(speeds)] - following @ np.concatenate([posture.x, posture.u]),
    )  # fmt: skip


def _kernel(speeds: Floats, pushed: Floats, following: Floats, rest: Floats, block: Floats, spread: Floats) -> Kernel:
    @numba.njit(error_model="numpy")
    def against(v, then):  # type: ignore[no-untyped-def]
        """Share of a step for which the force points backwards, less that for which it points forwards."""
        both = abs(v) + abs(then)
        return (v + then) / both if both > 0.0 else 0.0

    @numba.njit(error_model="numpy")
    def gap(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        n = len(lo)
        for i in range(n):
            lo[i], hi[i] = -spread[i], spread[i]
        for r in range(len(speeds)):
            j = speeds[r]
            least = most = rest[r]
            for i in range(n):
                a, b = following[r, i] * (xlo[i] - block[i]), following[r, i] * (xhi[i] + block[i])
                least += min(a, b)
                most += max(a, b)
            for i in range(len(u)):
                least += following[r, n + i] * u[i]
                most += following[r, n + i] * u[i]
            fewest = against(xlo[j] - block[j], least)
            largest = against(xhi[j] + block[j], most)
            for i in range(n):
                a, b = -pushed[r, i] * fewest, -pushed[r, i] * largest
                lo[i] += min(a, b)
                hi[i] += max(a, b)

    found: Kernel = gap
    return found
