"""The nominal way between samples against the arc in closed form and a finely sampled one."""

import numpy as np
import sympy as sp

from simgap.model.integrators import nominal_paths
from simgap.model.symbolic import PlanarWheels, SymbolicModel, Variable, symbol

v, w, th = symbol("v"), symbol("w"), symbol("theta")
ROBOT = SymbolicModel(
    states=tuple(Variable(n, "1") for n in ("x", "y", "theta")),
    inputs=(Variable("v", "m/s"), Variable("w", "rad/s")),
    parameters={},
    xdot=(v * sp.cos(th), v * sp.sin(th), w),
    wheels=PlanarWheels("x", "y", "theta", "v", "w", 0.2),
)
U = np.array([(a, b) for a in (-0.5, 0.0, 0.3) for b in (-1.0, 0.0, 0.7)])


def test_the_arc_and_its_bulge():
    paths, bulge = nominal_paths(ROBOT, "exact_arc", 1.0, np.zeros(3), U, 10)
    fine, _ = nominal_paths(ROBOT, "exact_arc", 1.0, np.zeros(3), U, 200)
    for m, (a, b) in enumerate(U):
        end = [a / b * np.sin(b), a / b * (1 - np.cos(b)), b] if b else [a, 0.0, 0.0]
        assert np.allclose(paths[m, -1], end, atol=1e-12)
    coarse = np.concatenate([np.zeros((len(U), 1, 3)), paths], axis=1)
    line = np.stack([[np.interp(np.linspace(0, 1, 201)[1:], np.linspace(0, 1, 11), coarse[m, :, i]) for i in range(3)]
                     for m in range(len(U))]).transpose(0, 2, 1)  # fmt: skip
    assert np.abs(fine - line).max() <= bulge
    assert bulge < 2e-3


def test_explicit_euler_drives_straight_as_the_paper_writes_it():
    paths, bulge = nominal_paths(ROBOT, "explicit_euler", 1.0, np.zeros(3), U, 4)
    assert np.allclose(paths[:, 1], 0.5 * np.stack([U[:, 0], 0 * U[:, 0], U[:, 1]], axis=1))
    assert bulge < 1e-12
