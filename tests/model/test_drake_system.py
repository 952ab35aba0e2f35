"""Written equations as a Drake system: its own numbers against the compiled kernels and formulas by hand."""

import numpy as np
import pytest
import sympy as sp

from simgap.errors import UserError
from simgap.model.compile import compile_kernel
from simgap.model.symbolic import Parameter, SymbolicModel, Variable, symbol
from simgap.plants.drake_check import symbolic_plant
from tests.drake_numbers import time_derivatives

x, y, th, v, w, b = (symbol(n) for n in ("x", "y", "theta", "v", "w", "b"))
STATES, INPUTS = tuple(Variable(n, "1") for n in ("x", "y", "theta")), tuple(Variable(n, "1") for n in ("v", "w"))


def unicycle(*xdot, **changes):
    return SymbolicModel(states=STATES, inputs=INPUTS, parameters={}, xdot=xdot, **changes)


def points(n=300, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-4, 4, (n, 3)), rng.uniform(-1, 1, (n, 2))


def test_drake_evaluates_the_unicycle_as_written():
    s, u = points()
    found = time_derivatives(symbolic_plant(unicycle(v * sp.cos(th), v * sp.sin(th), w)), s, u)
    by_hand = np.stack([u[:, 0] * np.cos(s[:, 2]), u[:, 0] * np.sin(s[:, 2]), u[:, 1]], axis=1)
    assert np.abs(found - by_hand).max() <= 1e-12


@pytest.mark.parametrize(
    "rows",
    [
        (v * sp.cos(th), v * sp.sin(th), w),
        (v * sp.exp(-(x**2)) + sp.tanh(y), sp.Abs(x) * sp.sign(w) - sp.sqrt(1 + y**2), sp.sinc(w) + sp.atan2(y, x)),
        (sp.Max(x, y, v), sp.Min(x, 0.5), sp.cosh(w) / (2 + sp.sin(x))),
    ],
)
def test_compiled_dynamics_equal_drakes_evaluation(rows):
    model = unicycle(*rows)
    kernel = compile_kernel(model.numeric(), [[s.symbol for s in STATES], [i.symbol for i in INPUTS]])
    s, u = points(seed=1)
    compiled = np.array([kernel(a, c) for a, c in zip(s, u, strict=True)])
    drake = time_derivatives(symbolic_plant(model), s, u)
    assert np.abs(compiled - drake).max() <= 1e-12 * max(1.0, np.abs(drake).max())


def test_parameters_take_their_numbers_and_outputs_are_readings():
    model = unicycle(-b * x, v, w).with_parameter("b", Parameter(0.25)).with_output("x", x + 1)
    system = symbolic_plant(model)
    s, u = points(5)
    assert np.abs(time_derivatives(system, s, u)[:, 0] + 0.25 * s[:, 0]).max() <= 1e-12
    context = system.CreateDefaultContext()
    context.SetContinuousState(s[0])
    system.get_input_port().FixValue(context, u[0])
    assert system.get_output_port().Eval(context) == pytest.approx([s[0, 0] + 1, s[0, 1], s[0, 2]], abs=1e-12)


def test_what_drake_lacks_is_refused_by_name():
    with pytest.raises(UserError, match="erf"):
        symbolic_plant(unicycle(sp.erf(x), v, w))
    with pytest.raises(UserError, match="delay"):
        symbolic_plant(unicycle(x, v, w).with_delay("v", sp.Float(0.1)))
