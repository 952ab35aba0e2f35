"""Numbers that decide in the diagnosis of an arm."""

ENERGY, BAND = 0.999, 5.0
"""The low pass cuts at five times the frequency below which this share of the velocities' energy lies. Judgement."""

MOST_OF_THE_RATE = 0.2
"""The cut is at most this share of the sampling rate, so that central differences are derivatives."""

REST_SHARE = 0.02
"""A joint below this share of its largest speed counts as at rest. Judgement."""

STILL = 1e-2
"""A trace whose joints never exceed this speed, rad/s or m/s, is at rest: what moves is noise. Judgement."""

SAME_DIRECTION = 1e-3
"""A term of which less than this share (of its norm) is not what others do is not sought beside them."""

INDEPENDENT = 1e-8
"""Columns of the regressor at random motions with a smaller share of their own are combinations of others."""

EXPECTED = ("viscous_friction", "coulomb_friction")
"""What every drive with a gear has."""

TOWARDS_DECLARED = 1e-3
"""Weight, in squared standard errors, with which inertial parameters stay near the declared ones where the motion does
not show them."""

CONSTANT = 1e-6
"""A torque that varies less than this share of the declared model's is no reading. Judgement."""

OTHER_SCALE = 3.0
"""A column is another joint's if that joint's torque leaves less than a tenth of the square that its own leaves, at a
slope between 1/3 and 3; and a multiple of its own if that leaves less than a tenth of what its own leaves."""
