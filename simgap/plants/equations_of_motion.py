"""The equations of motion of a rigid-body tree, written out in its joints and inertial parameters.

Inverse dynamics of `model.tree` on symbols in place of numbers. It goes from frame to frame of the bodies, so neither
where the base stands nor how the first joint turns enters M and C v, and expanded a large arm of two joints has some
hundred operations. `drake_check` compares them with Drake's numeric plant.

Simplifying them takes seconds, and every stage of a case builds its model. What comes out is
kept in the cache folder, under a digest of what went in and of SymPy's version; it is written as a tree of names and
numbers, so that nothing of it is ever run. Only what reads back as the same expression is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.cache import recall, remember
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol
from simgap.model.tree import Tree, forces

MOST_SIMPLIFIED = 250
"""Operations of a matrix that is simplified. Set on arms of packages: SymPy took 4 s for 203 of TwoJointRobot, 10 to 20
for 353 to 633 of a double pendulum, an iiwa and a Panda, more than 45 for 405 of another pair of the iiwa; a kernel
lost a third of its operations by it."""
SAME = 1e-10
"""Below it a coordinate is the whole number beside it: files write a right angle as 1.57079632679, 5e-12 off."""


@np.errstate(invalid="ignore")  # NumPy reads flags that arithmetic on expressions leaves
def derive_accelerations(tree: Tree, order: Sequence[str], rates: Sequence[str]) -> tuple[sp.Matrix, sp.Matrix]:
    """M(q)^-1, and the acceleration without forces, M^-1 (weight - C(q, v) v).

    Args:
        tree: its inertial parameters and its gravity as expressions.
        order, rates: names of its positions and velocities.
    """
    q, v = (np.array([[symbol(name) for name in names]]) for names in (order, rates))
    turning = np.vectorize(sp.sin, otypes=[object]), np.vectorize(sp.cos, otypes=[object])
    exact = {name: _exact(getattr(tree, name)) for name in ("turn", "place", "axis", "inertial")}
    arm = replace(tree, **exact)
    weightless, still, n = replace(arm, gravity=0 * arm.gravity), 0 * v, tree.size
    units = np.eye(n, dtype=object)
    squares = {sp.sin(s) ** 2: 1 - sp.cos(s) ** 2 for s in q[0]}

    def written(matrix: Floats) -> sp.Matrix:
        return sp.Matrix(matrix).applyfunc(lambda e: sp.expand(sp.expand(e).xreplace(squares)))

    upper = written(forces(weightless, q.repeat(n, axis=0), still.repeat(n, axis=0), units, turning))
    mass = sp.Matrix(n, n, lambda i, k: upper[min(i, k), max(i, k)])
    bias = written(forces(weightless, q, v, still, turning).T)
    weight = written(-forces(arm, q, still, still, turning).T)
    mass, bias, weight = (simplified(m, _shortest, "urdf 2") for m in (mass, bias, weight))
    inverse = simplified(mass, lambda m: _shortest(m.adjugate() / m.det()), "inverse 2")
    return inverse, simplified(inverse * (weight - bias), _shortest, "urdf 2")


def _exact(values: Any) -> Any:
    """Lengths, direction cosines and their products with symbols, in rationals."""

    def entry(value: Any) -> sp.Expr:
        e = sp.expand(sp.sympify(value))
        return e.xreplace({f: _rational(f) for f in e.atoms(sp.Float)})

    return np.vectorize(entry, otypes=[object])(values)


def _rational(value: sp.Float) -> sp.Rational:
    whole = round(value)
    return sp.Integer(whole) if abs(value - whole) < SAME else sp.nsimplify(round(float(value), 15), rational=True)


def _shortest(matrix: sp.Matrix) -> sp.Matrix:
    few = sum(int(sp.count_ops(e)) for e in matrix) <= MOST_SIMPLIFIED
    return matrix.applyfunc(sp.simplify) if few else matrix


_OPERATIONS = frozenset({"Add", "Mul", "Pow", "sin", "cos", "tan"})
_RULE = "1"  # of how it is written here


class _Other(ValueError):
    """An expression with something in it that is not written here."""


def simplified(matrix: sp.Matrix, how: Callable[[sp.Matrix], sp.Matrix], name: str) -> sp.Matrix:
    """`how(matrix)`, from the cache folder if it was made before.

    Args:
        matrix: in symbols as `model.symbolic.symbol` makes them; how: a function of nothing else.
        name: of the function and its version.
    """
    question = f"{_RULE} {sp.__version__} {name} {sp.srepr(matrix)}"
    with suppress(ValueError, KeyError, TypeError, RecursionError):  # nothing, or nothing that is written here
        known = recall("expressions", question)
        return sp.Matrix(*known["shape"], [_expression(e) for e in known["entries"]])
    made = how(matrix)
    with suppress(_Other, RecursionError):
        entries = [_written(e) for e in made]
        if [_expression(e) for e in entries] == list(made):
            remember("expressions", question, {"shape": made.shape, "entries": entries})
    return made


def _written(e: sp.Expr) -> Any:
    """A symbol as its name, a rational as its two whole numbers, an operation as a list."""
    if e.is_Symbol and e == symbol(e.name):
        return e.name
    if e.is_Rational:
        return {"p": str(e.p), "q": str(e.q)}
    name = type(e).__name__
    if name not in _OPERATIONS or getattr(sp, name) is not type(e):
        raise _Other(name)
    return [name, *(_written(a) for a in e.args)]


def _expression(node: Any) -> sp.Expr:
    if isinstance(node, str):
        return symbol(node)
    if isinstance(node, dict):
        return sp.Rational(int(node["p"]), int(node["q"]))
    if node[0] not in _OPERATIONS:
        raise _Other(node[0])
    return getattr(sp, node[0])(*(_expression(a) for a in node[1:]))
