"""Gap bound of a plant with the symmetry of the plane: one table over the inputs, seen from the robot's own frame.

A plant on flat ground behaves the same at every place and heading (SE(2)). The body-frame gap
`R(-theta) (f_hat(x, u) - f(x, u))` is then a function of the input (and of the hidden state), and one table over U
bounds it on all of X x U. Engines keep the symmetry only nearly: the deviation between headings is measured and added.

A box of the body frame is turned into the world by the range of `R(theta) b` over box and interval of theta. Each
coordinate is linear in b, so its extremes are at corners; for a corner at distance r and bearing phi it is
r cos(theta + phi) or r sin(theta + phi), with extremes at the ends of the interval and where the angle is a multiple of
pi or an odd multiple of pi/2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.gap.bounds.function import (
    GapDomain,
    GapFunction,
    GapSuprema,
    Kernel,
    Tier,
    input_index,
    require,
    require_sides,
    sides_by_state,
    sides_from,
)
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.thresholds import NOMINAL_TOLERANCE
from simgap.late import njit
from simgap.model.compile import cached_kernel
from simgap.simulators.body_samples import to_body

_ROTATION_SLACK = 1e-13  # relative: arctan2, cos and hypot are each off by some 1e-16, angles are below 100 rad


@njit(cache=True, error_model="numpy")
def cosine_range(lo, hi):  # type: ignore[no-untyped-def]
    """Smallest and largest cosine on [lo, hi]; exact up to rounding, which the caller covers."""
    a, b = np.cos(lo), np.cos(hi)
    low, high = min(a, b), max(a, b)
    if np.floor(hi / (2.0 * np.pi) + 1e-12) >= np.ceil(lo / (2.0 * np.pi) - 1e-12):
        high = 1.0
    if np.floor((hi - np.pi) / (2.0 * np.pi) + 1e-12) >= np.ceil((lo - np.pi) / (2.0 * np.pi) - 1e-12):
        low = -1.0
    return low, high


@njit(cache=True, error_model="numpy")
def rotated_box(t0, t1, a0, a1, b0, b1):  # type: ignore[no-untyped-def]
    """Hull of R(theta) [a0, a1] x [b0, b1] over theta in [t0, t1]: -> x0, x1, y0, y1, rounded outward."""
    x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(4):
        a = a1 if corner & 1 else a0
        b = b1 if corner & 2 else b0
        r, phi = np.hypot(a, b), np.arctan2(b, a)
        low, high = cosine_range(t0 + phi, t1 + phi)
        x0, x1 = min(x0, r * low), max(x1, r * high)
        low, high = cosine_range(t0 + phi - 0.5 * np.pi, t1 + phi - 0.5 * np.pi)
        y0, y1 = min(y0, r * low), max(y1, r * high)
    slack = _ROTATION_SLACK * (max(abs(a0), abs(a1)) + max(abs(b0), abs(b1))) * (1.0 + abs(t0) + abs(t1)) + 1e-300
    return x0 - slack, x1 + slack, y0 - slack, y1 + slack


@dataclass(frozen=True, eq=False)
class BodyFrameGap(GapFunction):
    """`lower[m] <= R(-theta) d <= upper[m]` for input m, at every position and heading.

    Attributes:
        class_lower, class_upper: (C, M, 3) body-frame bounds after a previous input of each class, states in order.
        pose: which states are x, y and heading.
        classes: of the previous input; one if none are given.
    """

    class_lower: Floats
    class_upper: Floats
    pose: tuple[int, int, int] = (0, 1, 2)
    classes: PreviousClasses = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.classes is None:
            object.__setattr__(self, "classes", PreviousClasses.single(self.class_lower.shape[1]))

    @cached_property
    def lower(self) -> Floats:
        """(M, 3) after any previous input."""
        return self.class_lower.min(axis=0)

    @cached_property
    def upper(self) -> Floats:
        """(M, 3) after any previous input."""
        return self.class_upper.max(axis=0)

    def after(self, number: int) -> BodyFrameGap:
        """The bound after a previous input of one class."""
        lower, upper = self.class_lower[[number]], self.class_upper[[number]]
        return BodyFrameGap(self.domain, self.tiers, lower, upper, self.pose)

    def bounds_of_inputs(self, m: Ints, before: Ints) -> tuple[Floats, Floats]:
        """Body-frame bounds of steps with input numbers (k,) after others (k,), `REST` among them: two (k, 3)."""
        kind = self.classes.after(before)
        return self.class_lower[kind, m], self.class_upper[kind, m]

    def bounds_after(self, x: Floats, u: Floats, previous: Ints) -> tuple[Floats, Floats]:
        """See `GapFunction.bounds_after`."""
        lo, hi, number = np.empty(x.shape), np.empty(x.shape), self.classes.after(previous)
        for c in np.unique(number).tolist():
            rows = number == c
            lo[rows], hi[rows] = self._each[c].bounds(x[rows], u[rows])
        return lo, hi

    @cached_property
    def _each(self) -> list[BodyFrameGap]:
        """The bound after each class."""
        return [self.after(c) for c in range(self.classes.count)]

    def _box_bounds(self, xlo: Floats, xhi: Floats, u: Floats) -> tuple[Floats, Floats]:
        lo, hi = np.empty(xlo.shape), np.empty(xhi.shape)
        rows = tuple(np.ascontiguousarray(a, dtype=np.float64) for a in (xlo, xhi, u))
        _over_rows(*rows, lo, hi, *self._tables())
        return lo, hi

    def sup(self) -> dict[str, GapSuprema]:
        """Suprema over all headings and inputs: in the plane the farthest corner, and the widest view of the box."""
        i, j, _ = self.pose
        corner = np.maximum(np.abs(self.lower), np.abs(self.upper))
        wide = self.upper - self.lower
        size, width = corner.max(axis=0), wide.max(axis=0)
        size[i] = size[j] = np.hypot(corner[:, i], corner[:, j]).max()
        width[i] = width[j] = np.hypot(wide[:, i], wide[:, j]).max()
        grown = 1.0 + 2.0**-40
        return {
            s: GapSuprema(float(size[n] * grown), float(width[n] * grown)) for n, s in enumerate(self.domain.states)
        }

    def raised(self, below: Floats, above: Floats) -> BodyFrameGap:
        """lower - below, upper + above, in the body frame; both (nx,)."""
        return replace(self, class_lower=self.class_lower - below, class_upper=self.class_upper + above)

    def _kernel(self) -> Kernel:
        """See `GapFunction._kernel`."""
        inputs, limit_lo, limit_hi, lower, upper, i, j, k = self._tables()

        @cached_kernel
        def bounds_over_box(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
            _over_box(xlo, xhi, u, lo, hi, inputs, limit_lo, limit_hi, lower, upper, i, j, k)

        return bounds_over_box

    def _tables(self) -> tuple[Any, ...]:
        return self.domain.input_set, *self.domain.limits(), self.lower, self.upper, *self.pose

    def _content(self) -> dict[str, Any]:
        states = self.domain.states
        found = {
            "kind": "body_frame",
            "meaning": "lower <= simulator - nominal <= upper in the frame of the robot, one row per input",
            "pose": [states[n] for n in self.pose],
            "gap": sides_by_state(states, self.lower, self.upper),
        }
        if self.classes.count > 1:
            sides = {"lower": self.class_lower.tolist(), "upper": self.class_upper.tolist()}
            found["previous_input"] = self.classes.to_json() | sides
        return found

    @classmethod
    def from_content(cls, data: Mapping[str, Any], domain: GapDomain, tiers: tuple[Tier, ...]) -> BodyFrameGap:
        """The inverse of `_content`."""
        x, y, heading = (domain.states.index(s) for s in data["pose"])
        lower, upper = sides_from(data["gap"], domain.states)
        if "previous_input" not in data:
            return cls(domain, tiers, lower[None], upper[None], (x, y, heading))
        own = data["previous_input"]
        sides = np.array(own["lower"], dtype=np.float64), np.array(own["upper"], dtype=np.float64)
        found = cls(domain, tiers, *sides, (x, y, heading), PreviousClasses.from_json(own))
        whole = np.array_equal(found.lower, lower) and np.array_equal(found.upper, upper)
        require(whole, "its bound after any input does not hold those after each class")
        return found

    def check(self) -> None:
        """See `GapFunction.check`."""
        require(sorted(self.pose) == [0, 1, 2] and len(self.domain.states) == 3, "its pose is not x, y and heading")
        m, count = len(self.domain.input_set), len(self.class_lower)
        require_sides(self.class_lower, self.class_upper, (count, m, 3))
        kind = self.classes.kind
        require(kind.shape == (m,) and count > 0, "its classes are not one for each input")
        require(np.isin(np.append(kind, self.classes.rest), np.arange(count)).all(), "its classes are not numbered")


@njit(cache=True, error_model="numpy")
def _over_rows(xlo, xhi, u, lo, hi, inputs, llo, lhi, lower, upper, i, j, k):  # type: ignore[no-untyped-def]
    for n in range(len(xlo)):
        _over_box(xlo[n], xhi[n], u[n], lo[n], hi[n], inputs, llo, lhi, lower, upper, i, j, k)


@njit(cache=True, error_model="numpy")
def _over_box(xlo, xhi, u, lo, hi, inputs, llo, lhi, lower, upper, i, j, k):  # type: ignore[no-untyped-def]
    m = input_index(inputs, u)
    inside = m >= 0
    for n in range(3):
        inside = inside and xlo[n] >= llo[n] and xhi[n] <= lhi[n]
    if not inside:
        for n in range(3):
            lo[n], hi[n] = -np.inf, np.inf
        return
    lo[i], hi[i], lo[j], hi[j] = rotated_box(xlo[k], xhi[k], lower[m, i], upper[m, i], lower[m, j], upper[m, j])
    slack = 2.0**-48 * (abs(lower[m, k]) + abs(upper[m, k])) + 1e-300
    lo[k], hi[k] = lower[m, k] - slack, upper[m, k] + slack


def nominal_motion(
    step: Callable[[Floats, Floats], Floats], centre: Floats, inputs: Floats, pose: tuple[int, int, int],
    rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """The nominal step seen from the robot, (M, 3); refused when it depends on where the robot stands.

    Args:
        step: nominal map x (n, 3), u (n, nu) -> (n, 3).
        centre: any pose in X, about which others are drawn.
        inputs: U, (M, nu).

    Raises:
        UserError: a nominal model without the declared symmetry.
    """
    k = pose[2]
    at_zero = centre.copy()
    at_zero[k] = 0.0
    start = np.tile(at_zero, (len(inputs), 1))
    motion = step(start, inputs) - start
    for _ in range(4):
        other = start + rng.uniform(-1.0, 1.0, (len(inputs), 3)) * [3.0 if n == k else 1.0 for n in range(3)]
        turned = to_body(step(other, inputs) - other, other[:, k], pose)
        off = float(np.abs(turned - motion).max())
        if off > NOMINAL_TOLERANCE:
            raise UserError(
                f"the symmetry is declared but false for the nominal model: its step differs by {off:.3g} between "
                "poses when seen from the robot",
                key="symmetry.group",
                remedy="Remove `symmetry`, or correct plant.symbolic.dynamics",
            )
    return motion
