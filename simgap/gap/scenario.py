"""Scenario program of one side of a gap bound (paper, eq. SOP_for_one_state), solved exactly by constraint generation.

    minimise eta  subject to  q.p(x_r, u_m) <= eta,  target_rm <= q.p(x_r, u_m)   at all N x M samples.

The target is |d_i| for the paper's unsigned bound, d_i or -d_i for one side of a signed one, with the local padding
added where it is part of the constraint. `lexicographic` then minimises the mean of q.p subject to
`q.p <= eta* + slack * max|target|`, because any q with the same largest value is optimal for the first program.

A working set of rows is solved with CVXPY and Clarabel; all rows are scanned for the most violated ones, which join
the working set, until none is violated by more than the tolerance. Any working set gives a lower bound of the optimum,
so optimum <= true optimum <= optimum + worst violation.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.gap.design import Design
from simgap.geometry import Floats

Rows = NDArray[np.int64]
_ADD = 96  # rows that join in a round, from each kind
_ROUNDS = 60
_REPORTED = ("optimum", "mean", "sup", "worst_violation", "rounds", "working_set", "samples", "objective", "status")


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """Solution of one scenario program.

    Attributes:
        coefficients: (z,) q. optimum: eta* of the working set, at most the optimum over all samples.
        mean: mean of q.p over all samples. sup: largest q.p over all samples.
        worst_violation: largest target - q.p over all samples, 0 if none; the bound is raised by it.
        rounds, working_set, samples: of the last objective, with all rows scanned in each round.
        status: a sentence that names the remedy when something is short of exact.
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
    rows: Rows

    def to_json(self) -> dict[str, Any]:
        """Numbers and status for the report."""
        return {name: getattr(self, name) for name in _REPORTED}

    @staticmethod
    def from_json(data: Mapping[str, Any], coefficients: Floats) -> ScenarioResult:
        """The inverse of `to_json` for coefficients (z,); the rows of the working set are not kept."""
        return ScenarioResult(coefficients, **{name: data[name] for name in _REPORTED}, rows=np.empty(0, np.int64))


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The program in whitened coordinates around the least-squares fit, in units of its residual."""

    design: Design
    start: Floats  # least-squares coefficients
    target: Floats  # (N, M)
    unit: float
    reach: float  # no feasible solution lies outside |y| <= reach
    level: float  # largest |target|

    @staticmethod
    def of(design: Design, target: Floats) -> _Scaled:
        start = design.least_squares(target)
        fitted = design.product(start)
        level = float(np.abs(target).max())
        residual = float(np.abs(target - fitted).max())
        unit = max(residual, 1e-7 * level) or 1.0
        reach = 4.0 * (3.0 * level + float(np.abs(fitted).max()) + unit) / unit
        return _Scaled(design, start, target, unit, reach, level)

    @property
    def tolerance(self) -> float:
        """Largest violation that ends the scan."""
        return min(1e-7 * self.level, 1e-3 * self.unit)

    def coefficients(self, y: Floats) -> Floats:
        return self.start + self.unit * (self.design.whitening @ y)


def solve_scenario(
    design: Design, target: Floats, objective: str = "lexicographic", slack: float = 0.01, warm: Rows | None = None
) -> ScenarioResult:
    """Solve the scenario program for target (N, M); `warm` are row indices of a related program's working set.

    Raises:
        UserError: when no combination of the terms covers the samples.
    """
    scaled = _Scaled.of(design, target)
    rows = np.unique(np.concatenate([_first_rows(scaled), warm if warm is not None else np.empty(0, np.int64)]))
    eta, y, rows, rounds, closed = _generate(scaled, rows, None)
    optimum = eta
    if objective == "lexicographic":
        _, y, rows, more, closed_again = _generate(scaled, rows, eta + slack * scaled.level)
        rounds, closed = rounds + more, closed and closed_again
    q = scaled.coefficients(y)
    values = design.product(q)
    violation = max(float((target - values).max()), 0.0)
    if closed:
        status = "solved: no sample is violated by more than the tolerance"
    else:
        status = (
            f"stopped after {_ROUNDS} rounds with a violation of {violation:.3g}; the bound is raised by it and holds, "
            "but is not the tightest: use fewer terms"
        )
    return ScenarioResult(
        q, optimum, float(values.mean()), float(values.max()), violation, rounds, len(rows), design.size, objective,
        status, rows,
    )  # fmt: skip


def _first_rows(scaled: _Scaled) -> Rows:
    """Corners of the samples and, for each input, the row that the least-squares fit misses most."""
    n, m = scaled.design.shape
    x, u = scaled.design.x, scaled.design.u
    states = np.unique([*x.argmin(axis=0), *x.argmax(axis=0), *(x @ _signs(x)).argmax(axis=0), n // 2])
    inputs = np.unique([*u.argmin(axis=0), *u.argmax(axis=0), m // 2])
    corners = (states[:, None] * m + inputs).ravel()
    return np.unique(np.concatenate([corners, _worst(scaled.target - scaled.design.product(scaled.start), -np.inf)]))


def _signs(x: Floats) -> Floats:
    """All 2^nx sign vectors over the width of each axis, (nx, 2^nx)."""
    nx = x.shape[1]
    signs = np.array(np.meshgrid(*([[-1.0, 1.0]] * nx), indexing="ij")).reshape(nx, -1)
    width = np.ptp(x, axis=0)
    return signs / np.where(width > 0.0, width, 1.0)[:, None]


def _worst(violation: Floats, tolerance: float) -> Rows:
    """Most violated rows, at most one for each input and slice of states, so that they are spread out."""
    n, m = violation.shape
    slices = int(min(n, max(1, _ADD // m)))
    found = []
    for part in np.array_split(np.arange(n), slices):
        first, last = int(part[0]), int(part[-1]) + 1
        r = violation[first:last].argmax(axis=0) + first
        found.append(r * m + np.arange(m))
    rows = np.concatenate(found).astype(np.int64)
    size = violation.ravel()[rows]
    order = np.argsort(-size)[:_ADD]
    return rows[order][size[order] > tolerance]


def _generate(scaled: _Scaled, rows: Rows, cap: float | None) -> tuple[float, Floats, Rows, int, bool]:
    """Constraint generation for `min eta` (cap None) or `min mean` under q.p <= cap: eta, y, rows, rounds, closed."""
    y, eta = np.zeros(scaled.design.whitening.shape[1]), 0.0
    for count in range(1, _ROUNDS + 1):
        y, eta = _solve_working_set(scaled, rows, cap)
        values = scaled.design.product(scaled.coefficients(y))
        short, over = scaled.target - values, values - eta
        if max(float(short.max()), float(over.max())) <= scaled.tolerance:
            return eta, y, rows, count, True
        more = np.union1d(_worst(short, scaled.tolerance), _worst(over, scaled.tolerance))
        grown = np.union1d(rows, more)
        if len(grown) == len(rows):  # the solver's own accuracy is the limit
            return eta, y, rows, count, max(float(short.max()), float(over.max())) <= 1e-6 * scaled.level
        rows = grown
    return eta, y, rows, _ROUNDS, False


def _solve_working_set(scaled: _Scaled, rows: Rows, cap: float | None) -> tuple[Floats, float]:
    """One small linear program in y (and eta): -> y, eta (the cap, when that is given)."""
    import cvxpy as cp

    design, unit = scaled.design, scaled.unit
    p = design.rows(rows)
    a, base, target = p @ design.whitening, p @ scaled.start, scaled.target.ravel()[rows]
    y = cp.Variable(a.shape[1])
    cover = a @ y >= (target - base) / unit
    box = cp.norm_inf(y) <= scaled.reach
    origin = float(base.max())  # eta is measured from here, so that the numbers stay of one size
    eta = cp.Variable()
    top = eta if cap is None else (cap - origin) / unit
    capped = a @ y <= (origin - base) / unit + top
    goal = eta if cap is None else (design.mean @ design.whitening) @ y
    problem = cp.Problem(cp.Minimize(goal), [cover, capped, box])
    accuracy = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
    with warnings.catch_warnings():
        # "may be inaccurate" is no news here: every row is scanned afterwards, whatever the solver says of itself
        warnings.simplefilter("ignore", UserWarning)
        problem.solve(solver=cp.CLARABEL, **accuracy)
    if y.value is None:
        raise UserError(
            f"no combination of the terms covers the samples ({problem.status})",
            key="gap.basis",
            remedy="Add the constant 1 to the basis.",
        )
    return np.asarray(y.value), origin + unit * float(eta.value) if cap is None else cap
