"""Motors behind coordinates: where they are at the start of a window follows from the motion and the drive before it.

Where the link is read, the motor is simulated along each trace with it as it was measured (smoothed); what is not known
is where it was at the first sample, taken as where the drive then holds it. Where the motor is read, the torque that it
passes on tells where the link is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.effects.base import Effect, driven_by
from simgap.effects.drive_train import DriveTrainEffect, Law, with_motor
from simgap.late import njit
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

_RIGID = 10.0  # rad between two readings: a spring that is quicker is simulated no more, as each turn costs steps


@dataclass(frozen=True)
class Train:
    """A motor behind a coordinate.

    Attributes:
        on: the coordinate; law: the torque between them, over theta.
        position, velocity: places of the link's states; inputs: columns of what drives the motor.
        slots: places in theta of its numbers; numbers: theta -> those of its law.
    """

    on: str
    law: Law
    position: int
    velocity: int
    inputs: tuple[int, ...]
    slots: tuple[int, ...]
    numbers: Callable[[Floats], Sequence[float]]

    def swings(self, theta: Floats) -> bool:
        """Whether what is not read does not forget how it began: a motor on a spring; a link that nothing reads."""
        return self.numbers(theta)[1] > 0.0 or self.read_at_motor(theta)

    def read_at_motor(self, theta: Floats) -> bool:
        """Whether the joint's sensors read the motor, and the link is what has to be inferred."""
        return self.numbers(theta)[7] > 0.0

    def quick(self, theta: Floats) -> float:
        """How fast the motor swings against a link that stands still, 1/s; 0 where there is no motor."""
        inertia, spring, _, _, stops, *_ = self.numbers(theta)
        stiffness = spring + stops
        return math.sqrt(stiffness / inertia) if inertia > 0.0 and stiffness > 0.0 else 0.0

    def rigid(self, theta: Floats, interval: float) -> bool:
        """Whether the spring is so stiff that readings this far apart (s) tell nothing of it."""
        inertia, spring, *_ = self.numbers(theta)
        return spring * interval**2 > _RIGID**2 * inertia


def trains_of(
    model: SymbolicModel, effects: Sequence[tuple[Effect, str, tuple[int, ...]]], theta: Sequence[sp.Symbol]
) -> tuple[Train, ...]:  # fmt: skip
    """One for each coordinate behind which an effect, on it, with its places in theta, puts a motor."""
    laws: dict[str, Law] = {}
    slots: dict[str, tuple[int, ...]] = {}
    for effect, on, own in effects:
        if isinstance(effect, DriveTrainEffect):
            law = effect.law({p.symbol: theta[k] for p, k in zip(effect.parameters, own, strict=True)})
            laws[on] = laws[on] + law if on in laws else law
            slots[on] = slots.get(on, ()) + own
    found = []
    for on, law in laws.items():
        link, place = model.coordinate(on), model.state_names.index
        inputs = tuple(model.input_names.index(u) for u in driven_by(model, on))
        numbers = sp.lambdify([theta], law.numbers, modules="math")
        found.append(Train(on, law, place(link.position), place(link.velocity), inputs, slots[on], numbers))
    return tuple(found)


def beside_motors(model: SymbolicModel, places: list[tuple[Effect, str]]) -> list[tuple[Effect, str]]:
    """Without what has no place where a motor stands behind its joint: a law of the speed of what an input drives."""
    loose = model
    for on in dict.fromkeys(on for e, on in places if isinstance(e, DriveTrainEffect)):
        loose = with_motor(loose, on, Law(sp.Integer(1)))
    return [(e, on) for e, on in places if isinstance(e, DriveTrainEffect) or on in e.targets(loose)]


def twists_by_torque(t: Floats, v: Floats, u: Floats, law: Floats, firsts: Ints) -> Floats:
    """Twist of a spring and its rate at every stamp, (n, 2), with the motor as measured: from what it passes on.

    That is the drive less what the motor's inertia takes; a place to begin at, from where windows are fitted.

    Args:
        t: (n,) s; v: (n,) the motor's speed, smoothed; u: (n,) the drive, held from each stamp on.
        law: its numbers; firsts: first sample of each trace.
    """
    inertia, k, *_ = law
    out = np.zeros((t.size, 2))
    for a, b in zip(firsts.tolist(), [*firsts[1:].tolist(), t.size], strict=True):
        if b - a > 1 and k > 0.0:
            acting = np.append(u[a], (u[a : b - 1] + u[a + 1 : b]) / 2)
            out[a:b, 0] = (acting - inertia * np.gradient(v[a:b], t[a:b])) / k
            out[a:b, 1] = np.gradient(out[a:b, 0], t[a:b])
    return out


@njit(
    "void(float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], int64[::1], float64[:, ::1])",
    cache=True,
)
def twists(t: Floats, q: Floats, v: Floats, u: Floats, law: Floats, firsts: Ints, out: Floats) -> None:
    """Twist and its rate at every stamp, (n, 2), with the link as measured, (n,): semi-implicit steps between stamps.

    Args:
        t: (n,) s; q, v: (n,) the link; u: (n,) the drive, held from each stamp on; law: (I, k, c, half, h).
        firsts: first sample of each trace.
    """
    inertia, k, c, half, stops, pressed, depth = law
    quick = math.sqrt((k + stops) / inertia)
    trace, p, r = 0, 0.0, 0.0
    for i in range(t.size):
        if trace < firsts.size and i == firsts[trace]:
            trace += 1
            side = 1.0 if u[i] > 0.0 else -1.0
            p, r = q[i] + u[i] / (k + stops) + side * half, v[i]
        else:
            dt = t[i] - t[i - 1]
            count = max(math.ceil(quick * dt / 0.15), 2)
            h = dt / count
            for j in range(count):
                share = (j + 0.5) / count
                w = p - q[i - 1] - share * (q[i] - q[i - 1])
                s = r - v[i - 1] - share * (v[i] - v[i - 1])
                up, down = max(w - half, 0.0), max(-w - half, 0.0)
                held = max(stops * up + pressed * s * min(1.0, up * depth), 0.0)
                back = max(stops * down - pressed * s * min(1.0, down * depth), 0.0)
                r += h * (u[i - 1] - k * w - c * s - held + back) / inertia
                p += h * r
        out[i, 0], out[i, 1] = p - q[i], r - v[i]
