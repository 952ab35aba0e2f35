"""A motor behind the joint that it drives: the torque between the two sides, and what drives the motor."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

from simgap.effects.base import PLANT, CoordinateTarget, Effect, Values, driven_by
from simgap.effects.reflected_inertia import ReflectedInertia
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, Variable, symbol

RIGID = (
    "reflected_inertia", "parameter_error", "input_gain", "input_curve", "input_lag", "input_delay", "input_dead_zone",
)  # fmt: skip
"""Effects that stand in for a motor behind its joint where it tells little: as if the two were rigid, or late."""
_NOTHING = 1e-24  # beside the square of an inertia


@dataclass(frozen=True)
class Law:
    """The motor's inertia, and the torque on the link over twist w = p - q and its rate.

    A spring and a damper, k w + c w', and stops beyond `half` on either side that push with `stops` times how deep they
    are pressed and damp with `pressed`, in full from 1 / `depth` on, and never pull: the torque does not jump.
    `read`: 1 where the sensors of the joint read the motor, 0 where they read the link.
    """

    inertia: sp.Expr
    stiffness: sp.Expr = 0
    damping: sp.Expr = 0
    half: sp.Expr = 0
    stops: sp.Expr = 0
    pressed: sp.Expr = 0
    depth: sp.Expr = 0
    read: sp.Expr = 0

    def __add__(self, other: Law) -> Law:
        """Of two, of which one at most acts."""
        return Law(*(a + b for a, b in zip(self.numbers, other.numbers, strict=True)))

    def torque(self, twist: sp.Expr, rate: sp.Expr) -> sp.Expr:
        """On the link; the motor feels its opposite."""
        up, down = sp.Max(twist - self.half, 0), sp.Max(-twist - self.half, 0)
        held = sp.Max(0, self.stops * up + self.pressed * rate * sp.Min(1, up * self.depth))
        back = sp.Max(0, self.stops * down - self.pressed * rate * sp.Min(1, down * self.depth))
        return self.stiffness * twist + self.damping * rate + held - back

    @property
    def numbers(self) -> tuple[sp.Expr, ...]:
        """In the order in which they are given."""
        own = self.inertia, self.stiffness, self.damping
        return tuple(map(sp.sympify, (*own, self.half, self.stops, self.pressed, self.depth, self.read)))

    def at_the_motor(self) -> Law:
        """The same torque, read on the motor's side; nothing where there is no motor."""
        return replace(self, read=_there(self.inertia))


class DriveTrainEffect(CoordinateTarget):
    """What lies between a motor and a link: two states more, the motor's place p and speed r, seen at the joint.

    The motor's inertia comes on top of what is declared, which is the link's. Without it nothing changes.
    """

    rank: ClassVar[int] = PLANT + 50
    contains: ClassVar[type[Effect] | None] = ReflectedInertia
    resembles: ClassVar[tuple[str, ...]] = RIGID
    remembers: ClassVar[bool] = True
    last: ClassVar[bool] = True
    passes_a_constant: ClassVar[bool] = False  # a bias acts on the motor, a force on the link
    needs: ClassVar[str] = "a coordinate on which an input is a force"

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Coordinates on which an input is a force, one to one."""
        return tuple(c.name for c in model.coordinates if driven_by(model, c.name))

    @abstractmethod
    def law(self, values: Values) -> Law:
        """The torque between the two sides."""

    @abstractmethod
    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Places to begin at, far from rigid: no derivative leads there."""

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the motor, and give the link what comes through in the place of the drive."""
        return with_motor(model, on, self.law(values))


def motor_states(on: str) -> tuple[str, str]:
    """Names of the motor's place and speed behind a coordinate."""
    return f"{on}_motor", f"{on}_motor_rate"


def with_motor(model: SymbolicModel, on: str, law: Law) -> SymbolicModel:
    """The model with a motor behind the coordinate; rigid, and the motor at rest, where the law's inertia is 0."""
    c = model.coordinate(on)
    motor, rate = motor_states(on)
    p, r = symbol(motor), symbol(rate)
    torque = law.torque(p - symbol(c.position), r - symbol(c.velocity))
    drive = sp.Add(*(symbol(u) for u in driven_by(model, on)))
    ease = law.inertia / (law.inertia**2 + _NOTHING)  # 1 / I, 0 for none
    acts = _there(law.inertia)
    grown = model.with_state(Variable(motor, model.units[c.position]), acts * r)
    grown = grown.with_state(Variable(rate, model.units[c.velocity]), ease * (drive - torque))
    grown = grown.with_force(on, acts * (torque - drive))
    if law.read == 0:
        return grown
    for link, behind in ((c.position, p), (c.velocity, r)):
        grown = grown.with_output(link, symbol(link) + law.read * (behind - symbol(link)))
    return grown


def _there(inertia: sp.Expr) -> sp.Expr:
    """1 where there is a motor, 0 for none."""
    return inertia**2 / (inertia**2 + _NOTHING)
