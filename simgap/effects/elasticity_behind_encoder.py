"""A gear or a shaft that gives way behind a motor whose own encoder is what is read."""

from __future__ import annotations

from simgap.effects.base import Values
from simgap.effects.drive_train import Law
from simgap.effects.joint_elasticity import JointElasticity
from simgap.model.symbolic import SymbolicModel


class ElasticityBehindEncoder(JointElasticity):
    """Two masses on a spring as `joint_elasticity`; the joint's readings are the motor's, as most servos log them.

    What a case calls the joint's place and speed is the link's still: a controller then knows it through the spring.
    """

    name = "elasticity_behind_encoder"
    short = "elasticity of the {on} behind its encoder"
    long = "elasticity of the {on} ({k}) behind the encoder of a motor of {I}"
    formula = "I p'' = u - T, link: T in the place of u, T = k (p - q) + c (p' - v), read: p in the place of q"

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """Where the settings name it: on which side an encoder sits is known."""
        return ()

    def law(self, values: Values) -> Law:
        """k w + c w', seen from the motor."""
        return super().law(values).at_the_motor()
