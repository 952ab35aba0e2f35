"""Short times that carry most of what a model misses: where somebody may have pushed.

Windows are cut into cells of a tenth of a second; two neighbouring cells are a piece, whose initial state is fitted by
itself. What a model lacks for a moment stands out in the pieces that hold this moment, and in no other; what it lacks
all the time hardly shows in so short a time. A cell is left out if every piece that holds it stands out; of a piece
that stands out without such a cell both are. Trimming what fits worst under the best model so far: Rousseeuw, Van
Driessen (2006), Computing LTS regression for large data sets, Data Mining and Knowledge Discovery 12.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi_squared

from simgap.diagnosis.reading.windows import Span, Windows, joined, left_out
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit_from_all
from simgap.diagnosis.thresholds import CELL_S, LEFT_OUT_MOST, MIN_SAMPLES, MOST_OF_THE_ERROR, PIECE_TELLS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Outlying:
    """Times that stand out.

    Attributes:
        spans: in order; share: of the time of the windows.
        error_share: of what the pieces' chi^2 add up to above what is usual.
    """

    spans: tuple[Span, ...]
    share: float
    error_share: float


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells (c,) as windows, the first cell of each piece (p,), and how many cells each piece has (p,)."""

    windows: Windows
    first: Ints
    count: Ints


def outlying(problem: Problem, theta: Floats) -> Outlying | None:
    """The times that stand out at theta (q,), where they are few and carry most of the excess chi^2; else None.

    A piece stands out if its chi^2/dof is so many times the median piece's as noise never makes it.
    """
    cells = _cells(problem)
    pieces = problem.on(_pieces(cells))
    free = np.maximum(pieces.counts - problem.model.nx, 1.0)
    chi2 = refit_from_all(pieces, theta, initial_states(pieces)).chi2
    usual = max(1.0, float(np.median(chi2 / free)))
    out = chi2 / free > usual * chi_squared.ppf(PIECE_TELLS, free) / free
    if not out.any():
        return None
    bad = np.ones(len(cells.windows), dtype=bool)
    for first, count in zip(cells.first[~out], cells.count[~out], strict=True):
        bad[first : first + count] = False
    for first, count in zip(cells.first[out], cells.count[out], strict=True):
        if not bad[first : first + count].any():  # neither cell alone tells enough: both
            bad[first : first + count] = True
    spans = _spans(problem.t, joined(cells.windows.pick(bad)))
    share = 1.0 - left_out(problem.windows, problem.t, spans).samples / problem.windows.samples
    above = chi2 - usual * free
    carried = float(above[out].sum() / max(above.sum(), above[out].sum()))
    if share > LEFT_OUT_MOST or carried < MOST_OF_THE_ERROR:
        return None
    return Outlying(spans, share, carried)


def _cells(problem: Problem) -> _Cells:
    """Cells of `CELL_S`, each of `MIN_SAMPLES` or more; pieces are pairs of neighbours, or a cell that has none."""
    rows: list[tuple[int, int, int, int]] = []
    first: list[int] = []
    count: list[int] = []
    whole, t = joined(problem.windows), problem.t
    for a, b, f, k in zip(whole.start, whole.stop, whole.first, whole.trace, strict=True):
        lasts = float(t[b - 1] - t[a])
        n = int(max(1, min(round(lasts / CELL_S), (b - a) // MIN_SAMPLES)))
        edges = [a, *(a + np.searchsorted(t[a:b], t[a] + lasts * np.arange(1, n) / n)).tolist(), b]
        kept = [(i, j, f, k) for i, j in itertools.pairwise(edges) if j > i]
        pairs = max(len(kept) - 1, 1)
        first += range(len(rows), len(rows) + pairs)
        count += [min(len(kept), 2)] * pairs
        rows += kept
    table = np.array(rows, dtype=np.int64)
    return _Cells(Windows(*(table[:, j] for j in range(4))), np.array(first), np.array(count))


def _pieces(cells: _Cells) -> Windows:
    w, last = cells.windows, cells.first + cells.count - 1
    return Windows(w.start[cells.first], w.stop[last], w.first[cells.first], w.trace[cells.first])


def _spans(t: Floats, bad: Windows) -> tuple[Span, ...]:
    """Joined cells as times, with half a cell on either side: what lasts into it for a few samples tells too little."""
    pad = 0.5 * CELL_S
    rows = zip(bad.start.tolist(), bad.stop.tolist(), bad.trace.tolist(), strict=True)
    return tuple((trace, float(t[a]) - pad, float(t[b - 1]) + pad) for a, b, trace in rows)
