"""The gates of the Lipschitz estimates: what a grid must resolve before its slopes are believed."""

from __future__ import annotations

GATE = 1.3
"""Largest L(s) / L(2 s) of a grid that resolves the gap. It is 1 for a smooth gap on a fine grid and 2 at a jump; the
value between is judgement. How often it lets an estimate pass that is too small: `benchmarks/lipschitz.py`."""

SPLIT_GATE = 1.5
"""The same over two cells, where a jump on a sample has 2 and a smooth bend over the four cells that it takes 1.4."""

STEEP_SHARE = 0.5
"""Cells are taken out as rough in rounds, each down to this share of the steepest left: fewer rounds, the same gate."""

NOMINAL_TOLERANCE = 1e-9
"""Largest deviation of a nominal step from the symmetry that a case names; well above rounding, below any real one."""

SMALL_INFLUENCE = 0.005
"""Share of the gap's sup below which a rise of the influence of older inputs with their age is no finding: the largest
of some hundreds of differences is only known that well. An engine that lost contacts rose by a fiftieth."""

MOST_BORDER_STATES = 50_000
"""States that are listed on borders and beside surfaces at most; a lattice with more is thinned."""

CHECK_LEVELS = 40
"""Levels along each axis of the random lattice of border states that check a bound: 160 on faces in the plane."""

LEAST_CHECKED_BORDER = 1_000
"""States on borders that check a bound, at most: as many as the grid has, but never fewer than these. With 40 levels on
each of four axes it would be 600,000 states, more than twenty times what the bound itself was made of. Judgement."""

EVERYWHERE = 0.5
"""Share of rough cells above which a gap is said to be followed too coarsely, not to jump; only words depend on it."""

CROWDED = 1.5
"""How many times more of the cells are rough in a layer that is named as the place than in another; words alone."""
