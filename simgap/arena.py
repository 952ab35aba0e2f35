"""A round robot among boxes: how near it comes, how a run ends, and headings brought back into X."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simgap.closed_loop import Policy, scalar_lookup
from simgap.geometry import Floats

Ints = NDArray[np.int64]
REACHED, COLLIDED, STUCK, LATE = "reached the target", "collision", "no admissible input", "out of time"


@dataclass(frozen=True, eq=False)
class Arena:
    """Obstacles (b, 4) as x0, x1, y0, y1; walls (4,) the same; radius of the robot's footprint, m."""

    obstacles: Floats
    walls: Floats
    radius: float

    def clearance(self, way: Floats) -> float:
        """Least distance between the footprint and anything along positions (k, 2); negative inside."""
        x, y = way[:, 0], way[:, 1]
        x0, x1, y0, y1 = self.walls
        nearest = min((x - x0).min(), (x1 - x).min(), (y - y0).min(), (y1 - y).min())
        for a0, a1, b0, b1 in self.obstacles:
            dx, dy = np.maximum(a0 - x, x - a1), np.maximum(b0 - y, y - b1)
            outside = np.hypot(np.maximum(dx, 0.0), np.maximum(dy, 0.0))
            nearest = min(nearest, (outside + np.minimum(np.maximum(dx, dy), 0.0)).min())
        return float(nearest) - self.radius


class Robot(Protocol):
    """What `drive` needs of a simulator."""

    path: Floats

    def reset(self, x: Floats) -> None:
        """Put the robot at rest at x."""

    def advance(self, u: Floats) -> Floats:
        """Hold u for one sampling time; `path` (k, 3) then holds the poses on the way."""


@dataclass(frozen=True, eq=False)
class Drive:
    """One run of a robot.

    Attributes:
        x: (k + 1, 3) states, the heading not wrapped; inputs: (k,) numbers of the inputs applied.
        end: one of REACHED, COLLIDED, STUCK, LATE; clearance: least distance to anything on the way, m.
        climbs: steps after which the controller's value had not fallen: the state left its certified box.
    """

    x: Floats
    inputs: Ints
    end: str
    clearance: float
    climbs: int


def drive(
    robot: Robot,
    policy: Policy,
    value: Callable[[Floats], int],
    arena: Arena,
    start: Floats,
    steps: int,
    position: tuple[int, int] = (0, 1),
) -> Drive:
    """Run from `start` until the target (value 0), a collision, a state without input, or `steps` samples.

    Args:
        value: worst-case steps to the target at a state (3,), negative where losing.
    """
    lookup, inputs, columns = scalar_lookup(policy), policy.input_set, list(position)
    robot.reset(start)
    x = np.array(start, dtype=np.float64)
    states, applied, climbs = [x], [], 0
    nearest, end, level = arena.clearance(x[None, columns]), LATE, value(x)
    for _ in range(steps):
        if level == 0:
            end = REACHED
            break
        m = lookup(x, 0)
        if m < 0:
            end = STUCK
            break
        x = robot.advance(inputs[m])
        states.append(x)
        applied.append(m)
        nearest = min(nearest, arena.clearance(robot.path[:, columns]))
        if nearest <= 0.0:
            end = COLLIDED
            break
        following = value(x)
        climbs += not 0 <= following < level
        level = following
    else:
        end = REACHED if level == 0 else LATE
    return Drive(np.array(states), np.array(applied, dtype=np.int64), end, nearest, climbs)


def wrapped(x: Floats, following: Floats, axis: int, lo: float, hi: float) -> tuple[Floats, Floats]:
    """Bring a periodic state of x (n, nx) into [lo, hi) and move the successors by the same whole turns."""
    turns = np.floor((x[:, axis] - lo) / (hi - lo)) * (hi - lo)
    back = np.zeros_like(x)
    back[:, axis] = turns
    return x - back, following - back
