"""A gear or a shaft that gives way between a motor and its link."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product

from simgap.effects.base import EffectParameter, Values
from simgap.effects.drive_train import DriveTrainEffect, Law
from simgap.effects.start import Scales, Start


class JointElasticity(DriveTrainEffect):
    """Two masses on a spring: the drive moves the motor, and the link feels the spring and its damper."""

    name = "joint_elasticity"
    short = "elasticity of the {on}"
    long = "elasticity of the {on} ({k}) before a motor of {I}"
    formula = "I p'' = u - T, link: T in the place of u, T = k (p - q) + c (p' - v)"
    source = "Spong (1987), Modeling and Control of Elastic Joint Robots, J. Dyn. Syst. Meas. Control 109(4)"
    excitation = "add faster input changes, near the resonance"
    parameters = (
        EffectParameter("I", "{force}*s^2/{position}", "inertia of the motor at the joint", null=0.0, lower=0.0),
        EffectParameter("k", "{force}/{position}", "stiffness of the joint", null=0.0, lower=0.0, shape=True),
        EffectParameter(
            "c", "{force}*s/{position}", "damping of the joint", null=0.0, lower=0.0, shape=True, may_vanish=True
        ),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Shares of the link's inertia, and resonances of the motor against it."""

        def at(share: float, hz: float) -> Start:
            inertia = share * scales.inertia
            stiffness = (2.0 * math.pi * hz) ** 2 * inertia / (1.0 + share)
            damping = 0.1 * math.sqrt(stiffness * inertia)
            return Start(1, lambda c: {"I": c[0] * inertia, "k": c[0] * stiffness, "c": c[0] * damping}, amplitude=1.0)

        return tuple(at(*each) for each in product((0.03, 0.2), (4.0, 8.0, 16.0)))

    def physical(self, values: Mapping[str, float]) -> bool:
        """What swings: at half of the critical damping and above it is friction that holds a motor, or play."""
        return super().physical(values) and values["c"] ** 2 <= values["k"] * values["I"]

    def law(self, values: Values) -> Law:
        """k w + c w'."""
        return Law(values["I"], values["k"], values["c"])
