"""The compiled model against Drake's own numbers, before anything is built on it.

Two comparisons at random states and inputs: the compiled map f against Drake's evaluation of the same expressions, and,
for a model file, dx/dt as declared against the accelerations of Drake's numeric `MultibodyPlant`, which
shares nothing with the symbolic derivation but the file. `symbolic_plant` is the model as a
Drake system.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.plant import PlantSection
from simgap.errors import BrokenPromise, UserError
from simgap.geometry import Box
from simgap.late import sympy as sp
from simgap.model.sampled import NominalModel, RungeKutta
from simgap.model.symbolic import SymbolicModel
from simgap.plants.urdf import multibody_plant


def symbolic_plant(model: SymbolicModel) -> Any:
    """The model as a `pydrake.systems.primitives.SymbolicVectorSystem` in continuous time.

    States and inputs keep their order, parameters take their declared numbers, the output is what the sensors read.

    Raises:
        UserError: a function in the equations that Drake does not have, or an input that acts with a delay.
    """
    from pydrake.symbolic import Expression, Variable
    from pydrake.systems.primitives import SymbolicVectorSystem

    late = [name for name, seconds in model.delays.items() if seconds != 0]
    if late:
        problem = f"the inputs {late} act with a delay, which a SymbolicVectorSystem does not have"
        remedy = "Leave the delay out and wire one before the system, such as Drake's DiscreteTimeDelay."
        raise UserError(problem, remedy=remedy)
    states = [Variable(v.name) for v in model.states]
    inputs = [Variable(v.name) for v in model.inputs]
    symbols = [v.symbol for v in (*model.states, *model.inputs)]
    place: dict[sp.Symbol, Any] = dict(zip(symbols, (Expression(v) for v in (*states, *inputs)), strict=True))
    values = model.values()
    readings = [sp.sympify(model.outputs.get(v.name, v.symbol)).subs(values) for v in model.states]
    return SymbolicVectorSystem(
        state=np.array(states),
        input=np.array(inputs),
        dynamics=np.array([to_drake(e, place) for e in model.numeric()]),
        output=np.array([to_drake(e, place) for e in readings]),
    )


def evaluator(
    exprs: Sequence[sp.Expr], x: Sequence[sp.Symbol], u: Sequence[sp.Symbol]
) -> Callable[[Floats, Floats], Floats]:
    """Drake's own numeric evaluation of expressions: a function (n, nx), (n, nu) -> (n, len(exprs)).

    Raises:
        UserError: a function in the expressions that Drake does not have.
    """
    from pydrake.symbolic import Evaluate, Expression, Variable

    variables = [Variable(s.name) for s in (*x, *u)]
    place: dict[sp.Symbol, Any] = dict(zip((*x, *u), (Expression(v) for v in variables), strict=True))
    rows = np.array([to_drake(e, place) for e in exprs])

    def evaluate(states: Floats, inputs: Floats) -> Floats:
        points = np.concatenate([states, inputs], axis=1)
        return np.array([Evaluate(rows, dict(zip(variables, p, strict=True))).ravel() for p in points])

    return evaluate


def to_drake(e: sp.Expr, place: Mapping[sp.Symbol, Any]) -> Any:
    """A SymPy expression as a Drake one; `place` maps its symbols.

    Raises:
        UserError: a symbol without a place, or a function that Drake does not have.
    """
    from pydrake.symbolic import Expression

    e = sp.sympify(e)
    if e.is_number:
        return Expression(float(e))
    if isinstance(e, sp.Symbol):
        if e not in place:
            raise UserError(f"the symbol {e} has no value")
        return place[e]
    parts = [to_drake(a, place) for a in e.args] if not isinstance(e, sp.Piecewise) else []
    if isinstance(e, sp.Add):
        return reduce(lambda a, b: a + b, parts)
    if isinstance(e, sp.Mul):
        return reduce(lambda a, b: a * b, parts)
    functions = _functions()
    if e.func in functions:
        return functions[e.func](*parts)
    raise UserError(
        f"Drake has no function '{e.func.__name__}'", remedy=f"It has {sorted(f.__name__ for f in functions)}."
    )


def _functions() -> dict[Any, Callable[..., Any]]:
    from pydrake import symbolic as drake

    def sign(a: Any) -> Any:
        return drake.if_then_else(a > 0, 1.0, drake.if_then_else(a < 0, -1.0, 0.0))

    def sinc(a: Any) -> Any:
        return drake.if_then_else(a == 0, 1.0, drake.sin(a) / a)

    functions: dict[Any, Callable[..., Any]] = {
        sp.Pow: drake.pow, sp.sin: drake.sin, sp.cos: drake.cos, sp.tan: drake.tan, sp.asin: drake.asin,
        sp.acos: drake.acos, sp.atan: drake.atan, sp.atan2: drake.atan2, sp.exp: drake.exp, sp.log: drake.log,
        sp.sinh: drake.sinh, sp.cosh: drake.cosh, sp.tanh: drake.tanh, sp.Abs: drake.abs, sp.sign: sign, sp.sinc: sinc,
        sp.Min: lambda *a: reduce(drake.min, a), sp.Max: lambda *a: reduce(drake.max, a),
    }  # fmt: skip
    return functions


POINTS = 32
"""Random pairs of a state and an input; a wrong term shows at almost every one of them."""
ROUNDING = 1e-9
"""Largest difference, as a share of a state's largest value: 1e7 roundings, and far below any gap."""


def check_map(model: NominalModel, box: Box, inputs: Floats) -> None:
    """Compare the compiled map with Drake's evaluation of it.

    Args:
        model: f.
        box: X; inputs: U, (M, nu).

    Raises:
        BrokenPromise: naming the state in which they differ.
    """
    x, u = _points(box, inputs)
    drake = _by_drake(model)(x, u)
    _compare("the compiled map", [s.name for s in model.x], model.step(x, u), drake, x, u)


def _by_drake(model: NominalModel) -> Callable[[Floats, Floats], Floats]:
    """The map by Drake's evaluation of its expressions: (n, nx), (n, nu) -> (n, nx)."""
    rate, h = evaluator(model.rule, model.x, model.u), model.tau
    if not isinstance(model, RungeKutta):
        return rate

    def step(x: Floats, u: Floats) -> Floats:
        k1 = rate(x, u)
        k2 = rate(x + h / 2 * k1, u)
        k3 = rate(x + h / 2 * k2, u)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, u))

    return step


def check_declared(model: SymbolicModel, section: PlantSection, urdf: Path, box: Box, inputs: Floats) -> None:
    """Compare dx/dt of a model file, as declared, with that of Drake's `MultibodyPlant`.

    Args:
        model: as declared.
        section: which joints its states and inputs are.
        urdf: the model file.
        box: X, of which the first states are those of the model; inputs: U, (M, nu).

    Raises:
        BrokenPromise: naming the state in which they differ.
    """
    nx = len(model.states)
    x, u = _points(Box(box.lo[:nx], box.hi[:nx]), inputs)
    symbolic = evaluator(model.numeric(), [v.symbol for v in model.states], [v.symbol for v in model.inputs])(x, u)
    _compare("dx/dt", model.state_names, symbolic, _multibody_rates(section, urdf, x, u), x, u)


def _multibody_rates(section: PlantSection, urdf: Path, x: Floats, u: Floats) -> Floats:
    """Drake's accelerations, and the velocities themselves: (n, nx), (n, nu) -> (n, nx)."""
    plant, joints = multibody_plant(urdf, (0.0, 0.0, -section.gravity))
    names = list(section.states)
    place = {(s.joint, s.quantity): names.index(n) for n, s in section.states.items()}
    q, v = ([place[j, kind] for j in joints] for kind in ("position", "velocity"))
    drives = np.array([[i.joint == j for j in joints] for i in section.inputs.values()], dtype=np.float64)
    forces = u @ drives.reshape(-1, len(joints))
    out = np.empty_like(x)
    out[:, v] = accelerations(plant, list(range(len(joints))), x[:, q], x[:, v], forces)
    out[:, q] = x[:, v]
    return out


def accelerations(plant: Any, order: Sequence[int], q: Floats, v: Floats, force: Floats) -> Floats:
    """Drake's accelerations of joints: positions, velocities and forces (k, n), joint j of them number `order[j]`."""
    context, n = plant.CreateDefaultContext(), plant.num_velocities()
    place, out = np.asarray(order), np.empty_like(q)
    for k in range(len(q)):
        full = np.zeros((3, n))
        full[:, place] = q[k], v[k], force[k]
        plant.SetPositions(context, full[0])
        plant.SetVelocities(context, full[1])
        plant.get_applied_generalized_force_input_port().FixValue(context, full[2])
        out[k] = plant.EvalTimeDerivatives(context).CopyToVector()[n:][place]
    return out


def _points(box: Box, inputs: Floats) -> tuple[Floats, Floats]:
    """Seeded, so that equal cases are checked alike: (n, nx), (n, nu)."""
    rng = np.random.default_rng(0)
    return rng.uniform(box.lo, box.hi, (POINTS, box.size)), inputs[rng.integers(len(inputs), size=POINTS)]


def _compare(what: str, names: Sequence[str], compiled: Floats, drake: Floats, x: Floats, u: Floats) -> None:
    off = np.abs(compiled - drake)
    allowed = ROUNDING * np.maximum(np.abs(drake).max(axis=0), 1e-3)
    wrong = ~(off <= allowed)  # a value that is no number is wrong too
    if wrong.any():
        i = int(np.flatnonzero(wrong.any(axis=0))[0])
        k = int(np.argmax(np.where(np.isfinite(off[:, i]), off[:, i], np.inf)))
        raise BrokenPromise(
            f"{what} differs from Drake's in {names[i]} by {off[k, i]:.3g} at x = {x[k].tolist()}, u = {u[k].tolist()}",
            "The model is not what the case declares: report this with the case.",
        )
