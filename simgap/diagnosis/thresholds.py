"""Every threshold that decides an attribution or a verdict, in one place.

chi^2/dof is of windows whose initial states are refitted; RMSE/sigma is of held-out windows, also refitted. BIC is the
Bayesian information criterion, chi^2 + k log N (Schwarz 1978), with k the parameters (discrete choices count) and N the
compared numbers.
"""

from __future__ import annotations

BIC_GAIN = 15.0
"""An effect is added, or kept, only if BIC falls by at least this much."""

NEAR_TIE = 12.0
"""Between models whose BIC differ by less, the one with fewer parameters is preferred."""

AMBIGUOUS = 10.0
"""Sets of effects within this BIC of the chosen one cannot be told from it."""

FIT_QUALITY = 1.15
"""Largest chi^2/dof of a model that reaches the noise floor."""

HELD_OUT_QUALITY = 1.08
"""Largest held-out RMSE/sigma of a model that reaches the noise floor."""

EXCESS_KEPT = 0.5
"""A partial explanation leaves at most this share of the held-out excess error."""

SIMPLER_SHARE = 0.9
"""Above the noise floor, one more parameter must leave at most this share of the held-out excess."""

PLAUSIBLE_RATIO = 5.0
"""Off the noise floor, a gain or property further from its declared value than this factor absorbs, not explains."""

FOLD_AGREEMENT = 0.5
"""Coefficients of two folds agree if they differ by less than this share of their size (or by their intervals)."""

EQUIVALENT_CHI2 = 1.0
"""Two fits whose chi^2 differ by less predict the same: an exact equivalence if their sensitivities span the same."""

COLLINEAR = 0.99
"""Projected sensitivities with a larger correlation are called hard to tell apart on this excitation."""

EXACTLY_COLLINEAR = 1.0 - 1e-6
"""Projected sensitivities with a larger correlation are the same direction."""

SAME_PROMISE = 1e-5
"""Candidates whose promised drops of chi^2 differ by a smaller share are one direction, refitted once."""

FINALISTS = 5
"""How many of the most promising candidates are refitted in full at each round."""

SETTLED_PROMISE = 0.05
"""A fit has settled if the linear problem promises at most this further drop of chi^2 (in units of chi^2/dof where that
is above 1): a step of less than a quarter of a standard error."""

SETTLED_STATES = 1.0
"""... and at most this for the initial state of a window; under dry friction, where a window may stand at a kink, what
fitting it afresh from several starts gains counts instead of the promise."""

LAGS_REMEMBERED = 5.0
"""After this many time constants of a lag (e^-5 is less than a hundredth) what was commanded before has faded."""
