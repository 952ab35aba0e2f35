"""Play between a motor and its link: neither moves the other while the motor crosses it."""

from __future__ import annotations

from itertools import product

from simgap.effects.base import EffectParameter, Values
from simgap.effects.drive_train import DriveTrainEffect, Law
from simgap.effects.start import Scales, Start

_QUICK = 500.0  # 1/s: how fast a stop answers; of 150, 300 and 500 the widths came nearest to the hidden ones at 500
_DEPTH = 0.05  # of the gap: a stop damps in full from here on, and less before, so that no torque jumps
_REBOUND = 2.5
"""How many times wider than it comes out a gap may be where the motor rebounds. In trials of six records, fits begun
near the truth, stops that give back 0.85, 0.73 and 0.53 of the speed made it 27 to 60, up to 35 and up to 17 % too
narrow, others 12 %; the factor covers the worst of these (2.48), and is judgement beyond them. Fitting the rebound
along, as the damping of the stops, was no remedy: of six such records no fit settled, and the gap came out at 0.57 to
2.3 times the true one, without it at 0.60 to 0.93. Valleys of chi^2 over gap and rebound differ by less than ten."""
_LEAST = 1e-12


class Backlash(DriveTrainEffect):
    """The motor moves alone within the gap, under its drive and its own inertia, and stays at the stop that it meets.

    Stops are springs, damped critically, that never pull: stiff beside what records of a hundred readings a second see.
    A motor that rebounds is in the gap more often: it comes out too narrow, and the interval allows for that.
    """

    name = "backlash"
    short = "backlash of the {on}"
    long = "backlash of {b} at the {on}, crossed by a motor of {I}"
    jerks = True
    formula = "I p'' = u - T, link: T in the place of u, T = 0 while |p - q| < b/2, else what keeps it at the stop"
    source = "Nordin, Gutman (2002), Controlling Mechanical Systems with Backlash, Automatica 38(10), sec. 3"
    excitation = "reverse the input often, in small and large steps"
    parameters = (
        EffectParameter(
            "b", "{position}", "width of the gap at the joint", null=0.0, lower=0.0, shape=True, times=_REBOUND
        ),
        EffectParameter("I", "{force}*s^2/{position}", "inertia of the motor at the joint", null=0.0, lower=0.0),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Shares of the link's inertia, and times in which a third of the largest drive moves the motor across."""

        def at(share: float, crossing: float) -> Start:
            inertia = share * scales.inertia
            gap = scales.command / 3.0 * crossing**2 / (2.0 * inertia)
            return Start(1, lambda c: {"b": c[0] * gap, "I": inertia}, amplitude=1.0)

        return tuple(at(*each) for each in product((0.02, 0.06, 0.18), (0.012, 0.025, 0.05)))

    def law(self, values: Values) -> Law:
        """Nothing within the gap, critically damped stops on both sides."""
        inertia = values["I"]
        stops, pressed = inertia * _QUICK**2, 2 * inertia * _QUICK
        return Law(
            inertia, half=values["b"] / 2, stops=stops, pressed=pressed, depth=1 / (_DEPTH * values["b"] + _LEAST)
        )
