"""Stand-ins in the equations of an arm whose mass matrix is computed as numbers and not written out.

Writing out the inverse mass matrix of three joints takes a minute of CPU and of six does not end; Newton-Euler on the
numbers takes microseconds (`model.inverse_dynamics`: 17 us a sample with the regressor of six joints). So from three
joints on, W = M^-1 and h (bias and gravity) are undefined functions of what they depend on. Effects act on such
equations as on any: forces, inputs and changed parameters go to their places. Whatever needs the equations themselves
(a bound, a controller) refuses them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from simgap.late import sympy as sp
from simgap.model.symbolic import Parameter, symbol

MOST_DERIVED = 2
"""Largest number of joints whose equations are written out: two take 2 s of CPU, three 60 s."""


def inverse_mass(order: Sequence[str], parameters: Mapping[str, Parameter]) -> sp.Matrix:
    """W, n x n and symmetric, over the positions and the inertial parameters."""
    n = len(order)
    at = [symbol(name) for name in (*order, *_inertial(parameters))]
    return sp.Matrix(n, n, lambda i, k: sp.Function(f"W_{min(i, k) + 1}_{max(i, k) + 1}", real=True)(*at))


def bias(order: Sequence[str], rates: Sequence[str], parameters: Mapping[str, Parameter]) -> sp.Matrix:
    """h, n x 1, over positions, velocities, the inertial parameters and gravity."""
    at = [symbol(name) for name in (*order, *rates, *_inertial(parameters), *_gravity(parameters))]
    return sp.Matrix(len(order), 1, lambda i, _: sp.Function(f"h_{i + 1}", real=True)(*at))


def _inertial(parameters: Mapping[str, Parameter]) -> list[str]:
    """Those that are not 0."""
    other = ("gravity_", ".damping")
    return [n for n, p in parameters.items() if p.value and not n.startswith(other[0]) and not n.endswith(other[1])]


def _gravity(parameters: Mapping[str, Parameter]) -> list[str]:
    return [n for n in parameters if n.startswith("gravity_")]
