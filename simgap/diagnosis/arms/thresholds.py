"""Numbers that decide in the diagnosis of an arm."""

ENERGY, BAND = 0.999, 3.0
"""The low pass cuts at three times the frequency below which this share of the velocities' energy lies. Judgement: the
recordings of a six-joint arm give 4 to 6 Hz, where published identifications of such arms filter."""

MOST_OF_THE_RATE = 0.2
"""The cut is at most this share of the sampling rate, so that central differences are derivatives."""

EDGE_PERIODS = 1.0
"""Rows within so many periods of the cut from the end of a trace are not compared: the filter sees one side of them."""

REST_SHARE = 0.02
"""A joint below this share of its largest speed counts as at rest. Judgement."""

SAME_DIRECTION = 1e-3
"""A term of which less than this share (of its norm) is not what others do is not sought beside them."""

INDEPENDENT = 1e-8
"""Columns of the regressor at random motions with a smaller share of their own are combinations of others."""

TERM_GAIN = 2.0
"""A term of a joint is taken in if BIC on *choose* falls by more: positive evidence (Kass, Raftery (1995), J. Am. Stat.
Assoc. 90(430)). Rows count there as what is independent of them, a tenth and less; and the term's interval on fit and
choose must leave out 0 besides, or it goes again."""

TOWARDS_DECLARED = 1e-3
"""Weight, in squared standard errors, with which inertial parameters stay near the declared ones where the motion does
not show them."""
