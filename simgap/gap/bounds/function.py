"""The gap function: `lo_i(x, u) <= d_i(x, u) <= hi_i(x, u)` with d = simulator - nominal, on all of X x U.

Every kind of bound (linear in a basis, tables of cells) is a `GapFunction` and offers the same: bounds at points and
over boxes, a numba kernel for the abstraction, suprema, and a JSON form that a person can read (`load.from_json` reads
it back). Bounds are rounded outward. Outside the domain there is no bound: (-inf, inf) is returned. All values are
immutable.

A gap that is periodic along an axis is bounded on one period, X. A box that leaves X there is moved back by whole turns
and cut at the seam; a moved part is widened by the rounding of the move. A box a turn wide or more is all of the axis.

A bound rests on statements, its guarantee tiers, printed wherever gamma is:

1. deterministic: holds everywhere, given the Lipschitz constants it was padded with;
2. estimate: which of these constants are estimates, how they were obtained and how far they can be trusted;
3. statistical: fresh random samples that no fit has seen (`fresh_check`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import UserError
from simgap.gap.json_record import JsonRecord
from simgap.geometry import Box, rows
from simgap.late import njit
from simgap.model.compile import cached_kernel


@dataclass(frozen=True)
class Tier(JsonRecord, names={"level": "tier"}):
    """One statement: its level 1, 2 or 3 and its text, a full sentence for the reader of a report."""

    level: int
    text: str


MARGIN = 1e-9  # relative to the width of X: cell borders computed in floating point may stick out of X by this much
PROVEN = Tier(
    1,
    "The bound holds at every state of X and input of U, rounding included: simulator and model are both known as "
    "equations, and slope and value of their difference are enclosed on every cell by interval arithmetic. No "
    "Lipschitz constant is given or estimated.",
)


PARTS = 3
"""Parts of an interval: its own, what lies beyond the upper end of X, what rounding may have moved below the lower."""
_ROUNDING = 2.0**-49


@njit(cache=True, error_model="numpy")
def crosses(xlo, xhi, lo, hi, axes):  # type: ignore[no-untyped-def]
    """True if a proper box leaves X along a periodic axis; one with an end that is no number is left alone."""
    found = False
    for j in axes:
        found = found or (xlo[j] <= xhi[j] and (xlo[j] < lo[j] or xhi[j] > hi[j]))
    return found


@njit(cache=True)
def _set(a, values):  # type: ignore[no-untyped-def]
    for j in range(a.size):  # to set a slice costs two seconds of compilation, for the words of a wrong shape
        a[j] = values[j]


@njit(cache=True, error_model="numpy")
def cut(xlo, xhi, lo, hi, axes, piece, a, b):  # type: ignore[no-untyped-def]
    """Write the `piece`-th of PARTS ** axes parts of a box into a, b; False where there is nothing of it."""
    _set(a, xlo)
    _set(b, xhi)
    for j in axes:
        part = piece % PARTS
        piece //= PARTS
        turn = hi[j] - lo[j]
        if not xhi[j] - xlo[j] < turn:
            a[j], b[j] = lo[j], hi[j]
            if part > 0:
                return False
            continue
        back = np.floor((xlo[j] - lo[j]) / turn) * turn
        slack = _ROUNDING * (abs(xlo[j]) + abs(xhi[j]) + abs(lo[j]) + abs(hi[j]) + abs(back))
        start, end = xlo[j] - back - slack, xhi[j] - back + slack
        if part == 1:
            if end <= hi[j]:
                return False
            start, end = lo[j], end - turn + slack
        elif part == 2:
            if start >= lo[j]:
                return False
            start, end = start + turn - slack, hi[j]
        a[j], b[j] = max(start, lo[j]), min(end, hi[j])
    return True


def periodic_kernel(inner, box: Box, axes: tuple[int, ...]):  # type: ignore[no-untyped-def]
    """The kernel of a gap function (`GapFunction.kernel`) that answers for boxes any number of turns away from X."""
    lo, hi, wraps = box.lo.copy(), box.hi.copy(), np.array(axes, dtype=np.int64)
    count = PARTS ** len(axes)

    @cached_kernel
    def bounds_over_box(xlo, xhi, u, lower, upper):  # type: ignore[no-untyped-def]
        if not crosses(xlo, xhi, lo, hi, wraps):
            inner(xlo, xhi, u, lower, upper)
            return
        n = xlo.size
        work = np.empty((4, n))
        lower[:] = np.inf
        upper[:] = -np.inf
        for piece in range(count):
            if cut(xlo, xhi, lo, hi, wraps, piece, work[0], work[1]):
                inner(work[0], work[1], u, work[2], work[3])
                for i in range(n):
                    lower[i], upper[i] = min(lower[i], work[2, i]), max(upper[i], work[3, i])

    return bounds_over_box


def parts(xlo: Floats, xhi: Floats, box: Box, axes: tuple[int, ...]) -> list[tuple[NDArray[np.intp], Floats, Floats]]:
    """Boxes (n, nx), (n, nx) as boxes inside X along periodic axes: for each kind of part (rows, lower, upper)."""
    wraps = np.array(axes, dtype=np.int64)
    out = []
    for piece in range(PARTS ** len(axes)):
        a, b, there = np.empty(xlo.shape), np.empty(xhi.shape), np.zeros(len(xlo), np.bool_)
        _cut_rows(*(np.ascontiguousarray(v, np.float64) for v in (xlo, xhi)), box.lo, box.hi, wraps, piece, a, b, there)
        rows = np.flatnonzero(there)
        out.append((rows, a[rows], b[rows]))
    return out


@njit(cache=True, error_model="numpy")
def _cut_rows(xlo, xhi, lo, hi, axes, piece, a, b, there):  # type: ignore[no-untyped-def]
    for n in range(len(xlo)):
        if crosses(xlo[n], xhi[n], lo, hi, axes):
            there[n] = cut(xlo[n], xhi[n], lo, hi, axes, piece, a[n], b[n])
        elif piece == 0:
            _set(a[n], xlo[n])
            _set(b[n], xhi[n])
            there[n] = True


Kernel = Callable[[Floats, Floats, Floats, Floats, Floats], None]


@dataclass(frozen=True, eq=False)
class GapDomain:
    """Domain of a gap function: states X and the finite input set U.

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

    @property
    def read(self) -> list[int]:
        """State axes on which the gap may depend."""
        return [j for j in range(len(self.states)) if j not in self.free]

    def limits(self) -> tuple[Floats, Floats]:
        """Lower and upper state limits with the rounding margin; infinite along free axes: (nx,) each."""
        margin = MARGIN * (self.box.hi - self.box.lo)
        lo, hi = self.box.lo - margin, self.box.hi + margin
        lo[list(self.free)], hi[list(self.free)] = -np.inf, np.inf
        return lo, hi

    def outside(self, xlo: Floats, xhi: Floats) -> Bools:
        """Flags of boxes not inside X, repeated along periodic axes: (n, nx), (n, nx) -> (n,)."""
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

    def check(self) -> None:
        """Refuse a saved one that is none.

        Raises:
            UserError: naming the part that is wrong.
        """
        nx, m = len(self.states), len(self.input_set)
        require(nx > 0 and self.box.size == nx, "its X has not one interval for each state")
        require_finite("its X", np.stack([self.box.lo, self.box.hi]), (2, nx))
        require(m > 0, "its U is empty")
        require_finite("its U", self.input_set, (m, len(self.inputs)))

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
    def raised(self, below: Floats, above: Floats) -> Self:
        """The bound moved outward: lo - below, hi + above, each (nx,)."""

    def with_tiers(self, tiers: Sequence[Tier]) -> Self:
        """The same bound with other guarantee tiers."""
        return replace(self, tiers=tuple(tiers))

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
        """Entries that `to_json` adds to domain and tiers; holds `kind`."""

    @classmethod
    @abstractmethod
    def from_content(cls, data: Mapping[str, Any], domain: GapDomain, tiers: tuple[Tier, ...]) -> Self:
        """The inverse of `_content`; KeyError, TypeError or ValueError for anything else."""

    @abstractmethod
    def check(self) -> None:
        """Refuse what is no bound on all of X and U, lower side below upper side.

        Raises:
            UserError: naming the part that is wrong.
        """

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


def sides_by_state(states: Sequence[str], lower: Floats, upper: Floats) -> dict[str, Any]:
    """Tables (..., nx) of both sides as plain data, by the name of the state."""
    sides = {"lower": lower, "upper": upper}
    return {s: {name: side[..., n].tolist() for name, side in sides.items()} for n, s in enumerate(states)}


def sides_from(data: Mapping[str, Any], states: Sequence[str]) -> tuple[Floats, Floats]:
    """The inverse of `sides_by_state`."""
    lower, upper = (np.stack([np.array(data[s][side]) for s in states], axis=-1) for side in ("lower", "upper"))
    return lower, upper


def require(holds: Any, problem: str) -> None:
    """Refuse a saved bound, unless something holds.

    Raises:
        UserError: with the problem.
    """
    if not holds:
        raise UserError(problem)


def require_finite(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Refuse what is no table of finite numbers of this shape."""
    numbers = np.issubdtype(array.dtype, np.number) and array.shape == shape and np.isfinite(array).all()
    require(numbers, f"{name} is not a table of finite numbers of shape {shape}")


def require_sides(lower: Floats, upper: Floats, shape: tuple[int, ...], after: str = "") -> None:
    """Refuse sides that are no finite tables of this shape, or upside down."""
    require_finite(f"its lower side{after}", lower, shape)
    require_finite(f"its upper side{after}", upper, shape)
    require((lower <= upper).all(), "its lower side is above its upper side")


@njit(error_model="numpy", cache=True)
def input_index(inputs, u):  # type: ignore[no-untyped-def]
    """Row of the input set that equals u to 1e-9 of its size; -1 if there is none."""
    for m in range(len(inputs)):
        same = True
        for k in range(inputs.shape[1]):
            same = same and abs(inputs[m, k] - u[k]) <= 1e-9 * (1.0 + abs(u[k]))
        if same:
            return m
    return -1
