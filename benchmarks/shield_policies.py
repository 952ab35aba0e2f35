"""Policies for `benchmarks/shields.py`: the measured state, in the units of the case, to an input."""

from math import atan2, pi


def largest(x):
    """The pendulum's largest torque."""
    return 1.2


def toward_the_border(x):
    """The pendulum's largest torque to the nearer end of the safe set."""
    return 1.2 if x[0] > 0.1 else -1.2


def at_the_target(x):
    """The TurtleBot at full speed toward the target, whatever stands between."""
    turn = atan2(9.3 - x[1], 9.3 - x[0]) - x[2]
    return [0.5, min(max((turn + pi) % (2 * pi) - pi, -1.0), 1.0)]
