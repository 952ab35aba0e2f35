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

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.record.folds import Span, Windows, joined, left_out
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit_from_all
from simgap.diagnosis.thresholds import A_FEW, BRIEF_S, BY_CHANCE, MIN_SAMPLES, MOST
from simgap.distributions import chi2 as chi_squared


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
class Pieces:
    """Cells (c,) as windows, and pieces (p,) of them, measured at one theta.

    Attributes:
        cells: as windows; t: (n,) s of all samples; windows: those that were cut.
        first, count: (p,) the first cell of each piece, and how many it has.
        chi2: (p,) with an initial state of its own; free: (p,) its degrees of freedom.
    """

    cells: Windows
    t: Floats
    windows: Windows
    first: Ints
    count: Ints
    chi2: Floats
    free: Floats

    def worst(self) -> tuple[Span, ...]:
        """The times that miss most, as many as may be left out."""
        bad = np.zeros(len(self.cells), dtype=bool)
        rows = self.cells.stop - self.cells.start
        for k in np.argsort(-self.chi2 / self.free, kind="stable"):
            more = bad.copy()
            more[self.first[k] : self.first[k] + self.count[k]] = True
            if rows[more].sum() > A_FEW * rows.sum():
                break
            bad = more
        return self._spans(bad)

    def outlying(self) -> Outlying | None:
        """The times that stand out, where they are few and carry most of the excess chi^2; else None.

        A piece stands out if its chi^2/dof is so many times the median piece's as noise never makes it.
        """
        usual = max(1.0, float(np.median(self.chi2 / self.free)))
        out = self.chi2 > usual * chi_squared.ppf(1.0 - BY_CHANCE, self.free)
        if not out.any():
            return None
        bad = np.ones(len(self.cells), dtype=bool)
        for first, count in zip(self.first[~out], self.count[~out], strict=True):
            bad[first : first + count] = False
        for first, count in zip(self.first[out], self.count[out], strict=True):
            if not bad[first : first + count].any():  # neither cell alone tells enough: both
                bad[first : first + count] = True
        spans = self._spans(bad)
        share = 1.0 - left_out(self.windows, self.t, spans).samples / self.windows.samples
        above = self.chi2 - usual * self.free
        carried = float(above[out].sum() / max(above.sum(), above[out].sum()))
        if share > A_FEW or carried < MOST:
            return None
        return Outlying(spans, share, carried)

    def _spans(self, bad: Bools) -> tuple[Span, ...]:
        """Joined cells as times, with half a cell on either side: what lasts into it for a few samples tells little."""
        if not bad.any():  # a short record: a cell is more than may be left out
            return ()
        own, pad = joined(self.cells.pick(bad)), 0.25 * BRIEF_S
        rows = zip(own.start.tolist(), own.stop.tolist(), own.trace.tolist(), strict=True)
        return tuple((trace, float(self.t[a]) - pad, float(self.t[b - 1]) + pad) for a, b, trace in rows)


def pieces(problem: Problem, theta: Floats) -> Pieces:
    """Cells and pieces of a problem's windows, each piece fitted by itself at theta (q,)."""
    cells, first, count = _cells(problem)
    last = first + count - 1
    own = problem.on(Windows(cells.start[first], cells.stop[last], cells.first[first], cells.trace[first]))
    chi2 = refit_from_all(own, theta, initial_states(own)).chi2
    free = np.maximum(own.counts - problem.model.begun, 1.0)
    return Pieces(cells, problem.t, problem.windows, first, count, chi2, free)


def _cells(problem: Problem) -> tuple[Windows, Ints, Ints]:
    """Cells of half of `BRIEF_S`, each of `MIN_SAMPLES` or more; the first cell of each piece (p,), and how many (p,).

    Pieces are pairs of neighbours, or a cell that has none.
    """
    rows: list[tuple[int, int, int, int]] = []
    first: list[int] = []
    count: list[int] = []
    whole, t = joined(problem.windows), problem.t
    for a, b, f, k in zip(whole.start, whole.stop, whole.first, whole.trace, strict=True):
        lasts = float(t[b - 1] - t[a])
        n = int(max(1, min(round(lasts / (0.5 * BRIEF_S)), (b - a) // MIN_SAMPLES)))
        edges = [a, *(a + np.searchsorted(t[a:b], t[a] + lasts * np.arange(1, n) / n)).tolist(), b]
        kept = [(i, j, f, k) for i, j in itertools.pairwise(edges) if j > i]
        pairs = max(len(kept) - 1, 1)
        first += range(len(rows), len(rows) + pairs)
        count += [min(len(kept), 2)] * pairs
        rows += kept
    table = np.array(rows, dtype=np.int64)
    return Windows(*(table[:, j] for j in range(4))), np.array(first), np.array(count)
