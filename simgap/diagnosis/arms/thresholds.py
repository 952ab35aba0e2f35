"""Numbers that decide in the diagnosis of an arm."""

ENERGY, BAND = 0.999, 5.0
"""The low pass cuts at five times the frequency below which this share of the velocities' energy lies. Judgement."""

MOST_OF_THE_RATE = 0.2
"""The cut is at most this share of the sampling rate, so that central differences are derivatives."""

EDGE_PERIODS = 1.0
"""Rows within so many periods of the cut from the end of a trace are not compared: the filter sees one side of them."""

REST_SHARE = 0.02
"""A joint below this share of its largest speed counts as at rest. Judgement."""

STILL = 1e-2
"""A trace whose joints never exceed this speed, rad/s or m/s, is at rest: what moves is noise. Judgement."""

TURNING_SHARE = 0.1
"""Dry friction turns round within this share of the speed that counts as rest: sharply, but not with the noise of a
joint that stands still. Judgement."""

SAME_DIRECTION = 1e-3
"""A term of which less than this share (of its norm) is not what others do is not sought beside them."""

INDEPENDENT = 1e-8
"""Columns of the regressor at random motions with a smaller share of their own are combinations of others."""

EXPECTED = ("viscous_friction", "coulomb_friction")
TERM_GAIN = 2.0
"""What every drive with a gear has is taken in if BIC on *choose* falls by more than this: positive evidence (Kass,
Raftery (1995), J. Am. Stat. Assoc. 90(430)); other terms if it falls by `BIC_GAIN`. With 2 for all, a quadratic drag of
0.3 N m s^2/rad^2, a gain of 6 to 8, was found at three joints of a rig that had none (tests/diagnosis/test_arms.py).
Rows count there as what is independent of them; and the term's interval on fit and choose must leave out 0 besides."""

TOWARDS_DECLARED = 1e-3
"""Weight, in squared standard errors, with which inertial parameters stay near the declared ones where the motion does
not show them."""

CONSTANT = 1e-6
"""A torque that varies less than this share of the declared model's is no reading. Judgement."""

OWN_SHARE = 0.5
"""A model's torque tells what a column is if it takes away at least this share of the square of what friction and a
bias leave. Judgement."""

OTHER_COLUMN, OTHER_SCALE = 0.1, 3.0
"""A column is another joint's if that joint's torque leaves less than this share of the square that its own leaves, at
a slope between 1/3 and 3; and a multiple of its own if that leaves less than this share of what its own leaves.
Judgement."""

MOST_LONE = 0.5
"""Without a known mass, gains are named on at most this share of the drives: the others' agreement with the declared
bodies is all that ties them. A real arm whose declared bodies are off asks for other gains at many joints.
Judgement."""

EXCESS_KEPT = 0.5
"""A partial explanation leaves at most this share of the held-out excess error."""
