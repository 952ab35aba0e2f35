"""Scenario program of one side of a gap bound (paper, eq. SOP_for_one_state), solved exactly by constraint generation.

    minimise eta  subject to  q.p(x_r, u_m) <= eta,  target_rm <= q.p(x_r, u_m)   at all N x M samples.

The target is |d_i| for the paper's unsigned bound, d_i or -d_i for one side of a signed one, with the local padding
added where it is part of the constraint. `lexicographic` then minimises the mean of q.p subject to
`q.p <= eta* + slack * max|target|`, because any q with the same largest value is optimal for the first program.

A working set of rows is solved with Clarabel; all rows are scanned for the most violated ones, which join the working
set, until none is violated by more than the tolerance. Any working set gives a lower bound of the optimum, so
optimum <= true optimum <= optimum + worst violation.

The rows of the program are the basis at every sample, and are never stored as one matrix. A term that depends on the
state alone is evaluated once for each state, one that depends on the input alone once for each input; NumPy's
broadcasting makes the product of them, for some states at a time. So a pass over a million samples costs a few
milliseconds, and a hundred million take no more memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement, pairwise

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.linear import Basis
from simgap.gap.json_record import JsonRecord
from simgap.gap.sampling.values import Rows, Values, combined, of_states, values
from simgap.geometry import mesh
from simgap.late import scipy

_ADD = 96  # rows that join in a round, from each kind
_ROUNDS = 60
Term = Callable[..., Floats | float]


@dataclass(frozen=True, eq=False)
class Design:
    """Rows p(x_r, u_m) of all states (N, nx) times inputs (M, nu); row index r M + m."""

    basis: Basis
    x: Values
    u: Floats

    @staticmethod
    def of(basis: Basis, x: Floats, u: Floats) -> Design:
        """The design of states in memory."""
        return Design(basis, values(x), u)

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return self.x.shape[0], len(self.u)

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.x.shape[0] * len(self.u)

    def rows(self, index: Rows) -> Floats:
        """Rows by index: (k,) -> (k, z)."""
        return self.basis.evaluate(self.x[index // len(self.u)], self.u[index % len(self.u)])

    def _evaluate(self, function: Term, x: Floats) -> Floats:
        """A term at states (n, nx), in the smallest shape that broadcasts to (n, M)."""
        value = np.asarray(function(*x.T[:, :, None], *self.u.T[:, None, :]), dtype=float)
        return value.reshape((1, 1)) if value.ndim == 0 else value

    @cached_property
    def _functions(self) -> list[Term]:
        return [self.basis.compiled(e) for e in self.basis.exprs]

    @cached_property
    def _slope_functions(self) -> list[list[Term | None]]:
        return [[None if e == 0 else self.basis.compiled(e) for e in row] for row in self.basis.gradients]

    def columns(self, x: Floats) -> list[Floats]:
        """Every term at states (n, nx), in shapes that broadcast to (n, M)."""
        return [self._evaluate(function, x) for function in self._functions]

    def product(self, q: Floats) -> Values:
        """q.p at every sample: (z,) -> (N, M)."""
        parts = [(v, f) for v, f in zip(q, self._functions, strict=True) if v != 0.0]
        return self._summed(parts)

    def slope(self, q: Floats, j: int) -> Values:
        """d q.p / d x_j at every sample: (z,) -> (N, M)."""
        parts = [(v, row[j]) for v, row in zip(q, self._slope_functions, strict=True)]
        return self._summed([(v, f) for v, f in parts if v != 0.0 and f is not None])

    def _summed(self, parts: Sequence[tuple[float, Term]]) -> Values:
        """Sum of broadcastable parts; those of one shape are added before they meet the others."""

        def summed(x: Floats) -> Floats:
            by_shape: dict[tuple[int, ...], Floats] = {}
            for v, function in parts:
                part = v * self._evaluate(function, x)
                by_shape[part.shape] = by_shape[part.shape] + part if part.shape in by_shape else part
            total = np.zeros((len(x), len(self.u)))
            for part in by_shape.values():
                total += part
            return total

        return of_states(summed, self.x, len(self.u))

    def _parts(self) -> Iterator[tuple[float, list[Floats]]]:
        """Blocks of states as those of values of this shape: their share of all, and every term there."""
        for block in self._summed(()).blocks():
            x = self.x[block]
            yield len(x) / self.shape[0], self.columns(x)

    @cached_property
    def mean(self) -> Floats:
        """(z,) mean row."""
        total = np.zeros(self.basis.size)
        for share, columns in self._parts():
            total += share * np.array([c.mean() for c in columns])
        return total

    @cached_property
    def _gram(self) -> Floats:
        """(z, z) mean of p p^T."""
        z = self.basis.size
        gram = np.zeros((z, z))
        for share, columns in self._parts():
            for a, b in combinations_with_replacement(range(z), 2):
                gram[a, b] += share * (columns[a] * columns[b]).mean()
        return np.triu(gram) + np.triu(gram, 1).T

    @cached_property
    def whitening(self) -> Floats:
        """(z, k) map from coordinates y to coefficients q = W y in which the mean of (q.p)^2 is |y|^2.

        Directions in which the samples do not tell the terms apart are left out (their coefficient is 0).
        """
        scale = np.sqrt(np.diag(self._gram))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(self._gram / np.outer(scale, scale))
        kept = values > 1e-12 * values.max()
        return (vectors[:, kept] / np.sqrt(values[kept])) / scale[:, None]

    def least_squares(self, target: Values) -> Floats:
        """(z,) coefficients of the least-squares fit of (N, M) values; refined once against rounding."""
        w, q = self.whitening, np.zeros(self.basis.size)
        for _ in range(2):
            product, moment = self.product(q), np.zeros(len(q))
            for block in target.blocks():
                rest, columns = target[block] - product[block], self.columns(self.x[block])
                moment += len(rest) / self.shape[0] * np.array([_moment(column, rest) for column in columns])
            q = q + w @ (w.T @ moment)
        return q


def _moment(column: Floats, rest: Floats) -> float:
    """Mean of column * rest without blowing the column up."""
    small = rest
    for axis in (0, 1):
        if column.shape[axis] == 1:
            small = small.mean(axis=axis, keepdims=True)
    return float((column * small).mean())


@dataclass(frozen=True, eq=False)
class ScenarioResult(JsonRecord):
    """Solution of one scenario program.

    Attributes:
        coefficients: (z,) q. optimum: eta* of the working set, at most the optimum over all samples.
        mean: mean of q.p over all samples. sup: largest q.p over all samples.
        worst_violation: largest target - q.p over all samples, 0 if none; the bound is raised by it.
        rounds, working_set, samples: of the last objective, with all rows scanned in each round.
        status: a sentence that names the remedy when something is short of exact.
        rows: of the working set, for a related program; they are not saved.
    """

    coefficients: Floats
    optimum: float
    mean: float
    sup: float
    worst_violation: float
    rounds: int
    working_set: int
    samples: int
    objective: str
    status: str
    rows: Rows = field(default_factory=lambda: np.empty(0, np.int64), repr=False)


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The program in whitened coordinates around the least-squares fit, in units of its residual."""

    design: Design
    start: Floats  # least-squares coefficients
    target: Values  # (N, M)
    unit: float
    reach: float  # no feasible solution lies outside |y| <= reach
    level: float  # largest |target|

    @staticmethod
    def of(design: Design, target: Values) -> _Scaled:
        start = design.least_squares(target)
        product, level, largest, residual = design.product(start), 0.0, 0.0, 0.0
        for block in target.blocks():
            wanted, fitted = target[block], product[block]
            level, largest = max(level, float(np.abs(wanted).max())), max(largest, float(np.abs(fitted).max()))
            residual = max(residual, float(np.abs(wanted - fitted).max()))
        unit = max(residual, 1e-7 * level) or np.finfo(np.float64).eps  # zeros are fitted to rounding
        reach = 4.0 * (3.0 * level + largest + unit) / unit
        return _Scaled(design, start, target, unit, reach, level)

    @property
    def tolerance(self) -> float:
        """Largest violation that ends the scan."""
        return min(1e-7 * self.level, 1e-3 * self.unit)

    def coefficients(self, y: Floats) -> Floats:
        return self.start + self.unit * (self.design.whitening @ y)


def solve_scenario(
    design: Design,
    given: Values | Floats,
    objective: str = "lexicographic",
    slack: float = 0.01,
    warm: Rows | None = None,
) -> ScenarioResult:
    """Solve the scenario program for given targets (N, M); `warm` are row indices of a related program's working set.

    No matrix of all rows is made and no array of all samples: each scan goes through them block by block.

    Raises:
        UserError: when no combination of the terms covers the samples.
    """
    target = values(given)
    scaled = _Scaled.of(design, target)
    rows = np.unique(np.concatenate([_first_rows(scaled), warm if warm is not None else np.empty(0, np.int64)]))
    eta, y, rows, rounds, closed = _generate(scaled, rows, None)
    optimum = eta
    if objective == "lexicographic":
        _, y, rows, more, closed_again = _generate(scaled, rows, eta + slack * scaled.level)
        rounds, closed = rounds + more, closed and closed_again
    q = scaled.coefficients(y)
    fitted = design.product(q)
    violation = max(combined(np.subtract, target, fitted).ends()[1], 0.0)
    if closed:
        status = "solved: no sample is violated by more than the tolerance"
    else:
        status = (
            f"stopped after {_ROUNDS} rounds with a violation of {violation:.3g}; the bound is raised by it and holds, "
            "but is not the tightest: use fewer terms"
        )
    return ScenarioResult(
        q, optimum, fitted.mean(), fitted.ends()[1], violation, rounds, len(rows), design.size, objective,
        status, rows,
    )  # fmt: skip


def _first_rows(scaled: _Scaled) -> Rows:
    """Corners of the samples and, for each input, the row that the least-squares fit misses most."""
    n, m = scaled.design.shape
    u = scaled.design.u
    states = np.unique([*outermost(scaled.design.x), n // 2])
    inputs = np.unique([*u.argmin(axis=0), *u.argmax(axis=0), m // 2])
    corners = (states[:, None] * m + inputs).ravel()
    missed, _ = scan(scaled.target, scaled.design.product(scaled.start), None)
    return np.unique(np.concatenate([corners, missed.rows(-np.inf)]))


def _generate(scaled: _Scaled, rows: Rows, cap: float | None) -> tuple[float, Floats, Rows, int, bool]:
    """Constraint generation for `min eta` (cap None) or `min mean` under q.p <= cap: eta, y, rows, rounds, closed."""
    y, eta = np.zeros(scaled.design.whitening.shape[1]), 0.0
    for count in range(1, _ROUNDS + 1):
        y, eta = _solve_working_set(scaled, rows, cap)
        found = scan(scaled.target, scaled.design.product(scaled.coefficients(y)), eta)
        largest = max(float(own.top.max()) for own in found)
        if largest <= scaled.tolerance:
            return eta, y, rows, count, True
        grown = np.union1d(rows, np.union1d(*(own.rows(scaled.tolerance) for own in found)))
        if len(grown) == len(rows):  # the solver's own accuracy is the limit
            return eta, y, rows, count, largest <= 1e-6 * scaled.level
        rows = grown
    return eta, y, rows, _ROUNDS, False


def _solve_working_set(scaled: _Scaled, rows: Rows, cap: float | None) -> tuple[Floats, float]:
    """One small linear program in y (and eta): -> y, eta (the cap, when that is given)."""
    design, unit = scaled.design, scaled.unit
    p = design.rows(rows)
    m = design.shape[1]
    a, base, target = (
        p @ design.whitening,
        p @ scaled.start,
        scaled.target[rows // m][np.arange(len(rows)), rows % m],
    )
    origin = float(base.max())  # eta is measured from here, so that the numbers stay of one size
    n, size = a.shape  # of z = (y, w, eta), where w bounds |y|: one large number in the program and not 2 n of them
    y, w, eta = np.eye(size), np.eye(size + 2)[[size]], np.eye(size + 2)[[size + 1]]
    rows_of = [
        (np.hstack([-a, np.zeros((n, 2))]), (base - target) / unit),
        (np.hstack([a, np.zeros((n, 2))]) - eta, (origin - base) / unit),
        *((np.hstack([sign * y, np.zeros((size, 2))]) - w, np.zeros(size)) for sign in (1.0, -1.0)),
        (w, np.array([scaled.reach])),
    ]
    goal = eta[0]
    if cap is not None:
        rows_of.append((eta, np.array([(cap - origin) / unit])))
        goal = np.append(design.mean @ design.whitening, [0.0, 0.0])
    left, right = (np.concatenate(part) for part in zip(*rows_of, strict=True))
    found = _linear_program(goal, left, right)
    return found[:size], origin + unit * float(found[-1]) if cap is None else cap


def _linear_program(goal: Floats, left: Floats, right: Floats) -> Floats:
    """The z (n,) for which goal (n,) . z is least under left (m, n) @ z <= right (m,), by Clarabel's interior points.

    Raises:
        UserError: a program without a solution, or one that the solver gives up.
    """
    import clarabel

    constraints, cones = scipy.sparse.csc_matrix(left), [clarabel.NonnegativeConeT(len(right))]
    quadratic, status = scipy.sparse.csc_matrix((len(goal), len(goal))), clarabel.SolverStatus
    for accuracy in (1e-10, None):  # what fails to that accuracy may not to the solver's own
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        if accuracy is not None:
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = accuracy
        solution = clarabel.DefaultSolver(quadratic, goal, constraints, right, cones, settings).solve()
        # that it may be inaccurate is no news: every row is scanned afterwards, whatever the solver says of itself
        if solution.status in (status.Solved, status.AlmostSolved):
            return np.asarray(solution.x)
        if solution.status in (status.PrimalInfeasible, status.AlmostPrimalInfeasible):
            raise UserError(
                f"no combination of the terms covers the samples ({solution.status})",
                key="gap.basis", remedy="Add the constant 1 to the basis.",
            )  # fmt: skip
    corner = scipy.optimize.linprog(goal, left, right, bounds=(None, None))  # simplex, where interior points give up
    if corner.status == 0:
        return np.asarray(corner.x)
    raise UserError(
        f"a program of {len(goal)} unknowns is too ill-conditioned to be solved",
        key="gap.basis", remedy="Use fewer terms, such as a lower degree.",
    )  # fmt: skip


class Worst:
    """The largest numbers so far, for each slice of states and each input or column, so that they are spread out.

    Attributes:
        top: (slices, columns) the numbers. at: the first row where each stands.
    """

    def __init__(self, slices: int, columns: int) -> None:
        self.top, self.at = np.full((slices, columns), -np.inf), np.zeros((slices, columns), dtype=np.int64)

    def update(self, k: int, some: Floats, first: int) -> None:
        """Look at further rows (n, columns) of slice k, which begin with row `first`."""
        at = some.argmax(axis=0)
        top = some[at, np.arange(len(at))]
        better = top > self.top[k]
        self.top[k, better], self.at[k, better] = top[better], first + at[better]

    def rows(self, tolerance: float) -> Rows:
        """Row numbers of samples of the worst ones that are larger than the tolerance, `_ADD` of them at most."""
        rows, size = (self.at * self.at.shape[1] + np.arange(self.at.shape[1])).ravel(), self.top.ravel()
        order = np.argsort(-size)[:_ADD]
        return rows[order][size[order] > tolerance]


def outermost(x: Values) -> Rows:
    """The first rows that are least and largest along each axis, and largest along each diagonal, of states (N, nx)."""
    lo = np.min([x[block].min(axis=0) for block in x.blocks()], axis=0)
    hi = np.max([x[block].max(axis=0) for block in x.blocks()], axis=0)
    signs = mesh(*[np.array([-1.0, 1.0])] * len(lo)).T / np.where(hi > lo, hi - lo, 1.0)[:, None]
    most = Worst(1, 2 * len(lo) + signs.shape[1])
    for block in x.blocks():
        own = x[block]
        diagonals = np.sum([own[:, [j]] * row for j, row in enumerate(signs)], axis=0)
        most.update(0, np.concatenate([-own, own, diagonals], axis=1), block.start)
    return most.at[0]


def scan(target: Values, product: Values, eta: float | None) -> tuple[Worst, Worst]:
    """Shortfall of rows (N, M) below their targets, and their excess over eta, of which without it there is none."""
    n, m = target.shape
    slices = min(n, max(1, _ADD // m))
    ends = np.cumsum([0, *(n // slices + (k < n % slices) for k in range(slices))])
    short, over = Worst(slices, m), Worst(slices, m)
    for k, (start, stop) in enumerate(pairwise(ends.tolist())):
        for block in product.blocks(start, stop):
            values = product[block]
            short.update(k, target[block] - values, block.start)
            if eta is not None:
                over.update(k, values - eta, block.start)
    return short, over
