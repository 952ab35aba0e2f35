"""The gap function: `lo_i(x, u) <= d_i(x, u) <= hi_i(x, u)` with d = simulator - nominal, on all of X x U.

Every kind of bound (linear in a basis, tables of cells) is a `GapFunction` and offers the same: bounds at points and
over boxes, a numba kernel for the abstraction, suprema, and a JSON form that a person can read (`load.from_json` reads
it back). Bounds are rounded outward. Outside the domain there is no bound: (-inf, inf) is returned. All values are
immutable.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simgap.arrays import Bools, Floats, Ints
from simgap.gap.bounds.forms import MARGIN
from simgap.gap.bounds.periodic import parts, periodic_kernel
from simgap.gap.bounds.tiers import Tier
from simgap.geometry import Box, rows

Kernel = Callable[[Floats, Floats, Floats, Floats, Floats], None]


@dataclass(frozen=True, eq=False)
class GapDomain:
    """Where a gap function holds: states X and the finite input set U.

    Attributes:
        states, inputs: names; box: X; input_set: (M, nu).
        free: state axes on which the gap does not depend by a declared symmetry; X is unbounded along them.
        periodic: state axes along which plant and gap repeat themselves with the width of X.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    box: Box
    input_set: Floats
    free: tuple[int, ...] = ()
    periodic: tuple[int, ...] = ()

    @property
    def wrapping(self) -> tuple[int, ...]:
        """Periodic axes that matter."""
        return tuple(j for j in self.periodic if j not in self.free)

    def limits(self) -> tuple[Floats, Floats]:
        """Lower and upper state limits with the rounding margin; infinite along free axes: (nx,) each."""
        margin = MARGIN * (self.box.hi - self.box.lo)
        lo, hi = self.box.lo - margin, self.box.hi + margin
        lo[list(self.free)], hi[list(self.free)] = -np.inf, np.inf
        return lo, hi

    def outside(self, xlo: Floats, xhi: Floats) -> Bools:
        """Which boxes are not inside X, repeated along periodic axes: (n, nx), (n, nx) -> (n,)."""
        lo, hi = self.limits()
        lo[list(self.wrapping)], hi[list(self.wrapping)] = -np.inf, np.inf
        return np.any(~((xlo >= lo) & (xhi <= hi)), axis=1)

    def pinned(self, x: Floats) -> Floats:
        """The points with free coordinates moved to the centre of X: (n, nx) -> (n, nx)."""
        if not self.free:
            return x
        x = x.copy()
        axes = list(self.free)
        x[:, axes] = (0.5 * (self.box.lo + self.box.hi))[axes]
        return x

    def to_json(self) -> dict[str, Any]:
        """Names, box and input set."""
        ends = zip(self.states, self.box.lo, self.box.hi, strict=True)
        return {
            "states": {name: [float(lo), float(hi)] for name, lo, hi in ends},
            "inputs": list(self.inputs),
            "input_set": self.input_set.tolist(),
            "free": [self.states[j] for j in self.free],
            "periodic": [self.states[j] for j in self.periodic],
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> GapDomain:
        """The inverse of `to_json`."""
        names = tuple(data["states"])
        lo, hi = zip(*data["states"].values(), strict=True)
        free, periodic = (tuple(names.index(s) for s in data[key]) for key in ("free", "periodic"))
        inputs = np.array(data["input_set"], dtype=float).reshape(-1, len(data["inputs"]))
        return GapDomain(names, tuple(data["inputs"]), Box(lo, hi), inputs, free, periodic)


@dataclass(frozen=True)
class GapSuprema:
    """Suprema over X x U of one dimension: `size` of max(|lo|, |hi|), `width` of hi - lo; both are upper bounds."""

    size: float
    width: float


@dataclass(frozen=True, eq=False)
class GapFunction(ABC):
    """Two-sided bound of the gap on a domain, with the guarantee tiers it rests on."""

    domain: GapDomain
    tiers: tuple[Tier, ...]

    @abstractmethod
    def _box_bounds(self, xlo: Floats, xhi: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Bounds over boxes inside the domain, outward rounded: (n, nx), (n, nx), (n, nu) -> 2 x (n, nx)."""

    @abstractmethod
    def sup(self) -> dict[str, GapSuprema]:
        """Suprema over X x U, by state name."""

    @abstractmethod
    def raised(self, below: Floats, above: Floats) -> GapFunction:
        """The bound moved outward: lo - below, hi + above, each (nx,)."""

    @abstractmethod
    def with_tiers(self, tiers: Sequence[Tier]) -> GapFunction:
        """The same bound with other guarantee tiers."""

    @abstractmethod
    def _kernel(self) -> Kernel:
        """`kernel` for boxes inside X: allocates nothing, writes -inf and inf for a box that is not inside X."""

    def kernel(self) -> Kernel:
        """A numba function (xlo (nx,), xhi (nx,), u (nu,), lo_out (nx,), hi_out (nx,)) -> None.

        Writes the outward rounded infimum of lo and supremum of hi over the box. Along periodic axes a box may lie any
        number of turns away from X or across its seam.
        """
        own, axes = self._kernel(), self.domain.wrapping
        if not axes:
            return own
        wrapped: Kernel = periodic_kernel(own, self.domain.box, axes)
        return wrapped

    @abstractmethod
    def _content(self) -> dict[str, Any]:
        """What `to_json` adds to domain and tiers; holds `kind`."""

    def box_bounds(self, xlo: ArrayLike, xhi: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        """Infimum of lo and supremum of hi over boxes: (n, nx), (n, nx), (n, nu) -> (n, nx), (n, nx).

        (-inf, inf) for a box that is not inside the domain.

        Raises:
            UserError: rows of another size, or not as many of one as of another.
        """
        states, inputs = self.domain.states, self.domain.inputs
        xlo, xhi, u = rows((xlo, states), (xhi, states), (u, inputs))
        lo, hi = np.full(xlo.shape, np.inf), np.full(xhi.shape, -np.inf)
        box = self.domain.box
        for of, a, b in parts(xlo, xhi, box, self.domain.wrapping):
            if len(of) == 0:
                continue
            inner_lo = np.clip(self.domain.pinned(a), box.lo, box.hi)
            inner_hi = np.clip(self.domain.pinned(b), box.lo, box.hi)
            low, high = self._box_bounds(inner_lo, inner_hi, u[of])
            lo[of], hi[of] = np.minimum(lo[of], low), np.maximum(hi[of], high)
        outside = self.domain.outside(xlo, xhi)
        lo[outside], hi[outside] = -np.inf, np.inf
        return lo, hi

    def bounds(self, x: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        """lo and hi at points: (n, nx), (n, nu) -> (n, nx), (n, nx), outward rounded.

        Raises:
            UserError: as `box_bounds`.
        """
        return self.box_bounds(x, x, u)

    def bounds_after(self, x: Floats, u: Floats, previous: Ints) -> tuple[Floats, Floats]:
        """lo and hi at points where the number of the previous input is known, (n,), -1 at rest: (n, nx) twice."""
        return self.bounds(x, u)

    def to_json(self) -> dict[str, Any]:
        """The bound as plain data: what it holds for, the formula, what it rests on."""
        guarantee = [tier.to_json() for tier in self.tiers]
        return {**self._content(), "domain": self.domain.to_json(), "guarantee": guarantee}
