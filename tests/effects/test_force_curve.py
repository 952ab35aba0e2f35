"""The curve of force over place, held against what a natural cubic spline is, without one."""

import numpy as np
import pytest
import sympy as sp

from simgap.effects.forces import ForceCurve

Q, V = sp.Symbol("q", real=True), sp.Symbol("v", real=True)
PLACES = np.linspace(-0.5, 2.0, 11)


def curve(values):
    numbers = {f"F_{k}": sp.Float(v) for k, v in enumerate(values)} | {"low": sp.Float(-0.5), "high": sp.Float(2.0)}
    return sp.lambdify(Q, ForceCurve().force(Q, V, numbers), modules="math")


def test_goes_through_its_values():
    values = np.random.default_rng(0).normal(size=11)
    at = curve(values)
    assert [at(q) for q in PLACES] == pytest.approx(values, abs=1e-10)


def test_a_straight_line_is_one_everywhere():
    at = curve(3.0 - 2.0 * PLACES)
    assert [at(q) for q in (-4.0, -0.3, 0.77, 1.9, 5.0)] == pytest.approx([11.0, 3.6, 1.46, -0.8, -7.0], abs=1e-9)


@pytest.mark.parametrize(("end", "out"), [(-0.5, -1.0), (2.0, 1.0)])
def test_goes_on_straight_beyond_its_ends(end, out):
    at = curve(np.cos(3.0 * PLACES))
    steps = [at(end + out * 0.3 * k) for k in range(4)]
    assert np.diff(steps, 2) == pytest.approx(0.0, abs=1e-9)
    inside, outside = ((at(end + s * 1e-5) - at(end)) / (s * 1e-5) for s in (-out, out))
    assert inside == pytest.approx(outside, abs=1e-3)  # no kink at the end


def test_is_the_energy_least_of_all_curves_through_its_values():
    """Holladay (1957): no twice differentiable curve through the same values bends less."""
    values, q = np.sin(4.0 * PLACES), np.linspace(-0.5, 2.0, 4001)
    at = curve(values)
    own = np.array([at(float(x)) for x in q])
    bump = np.prod([q - p for p in PLACES], axis=0)  # 0 at every place

    def bend(f):
        return float(np.sum(np.diff(f, 2) ** 2))

    assert all(bend(own + size * bump / np.abs(bump).max()) > bend(own) for size in (-0.01, 0.01))
