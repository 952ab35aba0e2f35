"""Split conformal prediction: how far scores of held-out samples reach with a stated coverage.

Of n exchangeable scores the k-th smallest, k = ceil((n + 1) level), is not exceeded by a further one with probability
at least `level`. Sources: Vovk, Gammerman and Shafer (2005), Algorithmic Learning in a Random World; Lei et al. (2018),
Distribution-Free Predictive Inference for Regression.
"""

from __future__ import annotations

import math

import numpy as np

from simgap.geometry import Floats


def reach(scores: Floats, level: float) -> float:
    """The k-th smallest of the scores (n,); infinite if there are too few for this level."""
    rank = _rank(len(scores), level)
    return float(np.partition(scores, rank - 1)[rank - 1]) if rank <= len(scores) else math.inf


def fewest(level: float) -> int:
    """The smallest number of scores whose reach is finite."""
    n = max(1, math.floor(level / (1.0 - level)) - 1)
    while _rank(n, level) > n:
        n += 1
    return n


def _rank(n: int, level: float) -> int:
    return math.ceil((n + 1) * level)
