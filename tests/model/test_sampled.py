"""The compiled dynamics against Drake's own numbers, and bounds against samples."""

from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from simgap.config.plant import Input, PlantSection, State
from simgap.errors import UserError
from simgap.model.compile import compile_interval_kernel, compile_kernel
from simgap.model.symbolic import symbol
from simgap.plants.plant_model import PlantModel
from simgap.plants.urdf import load_urdf

MODELS = Path(__file__).parents[2] / "configs" / "models"
PENDULUM = (
    {
        "x1": State(joint="hinge", quantity="position", unit="rad"),
        "x2": State(joint="hinge", quantity="velocity", unit="rad/s"),
    },
    {"u": Input(joint="hinge", unit="N*m")},
)
DOUBLE = (
    {
        "q1": State(joint="shoulder", quantity="position", unit="rad"),
        "q2": State(joint="elbow", quantity="position", unit="rad"),
        "v1": State(joint="shoulder", quantity="velocity", unit="rad/s"),
        "v2": State(joint="elbow", quantity="velocity", unit="rad/s"),
    },
    {"u1": Input(joint="shoulder", unit="N*m"), "u2": Input(joint="elbow", unit="N*m")},
)


@pytest.fixture(scope="module")
def pendulum():
    return load_urdf(MODELS / "pendulum.urdf", *PENDULUM)


def sampled(tau, integrator):
    """The pendulum's map through the one door, from what a case file says."""
    section = PlantSection.model_validate(
        {
            "urdf": "pendulum.urdf",
            "states": {
                "x1": {"unit": "rad", "joint": "hinge", "quantity": "position"},
                "x2": {"unit": "rad/s", "joint": "hinge", "quantity": "velocity"},
            },
            "inputs": {"u": {"unit": "N*m", "joint": "hinge"}},
            "integrator": integrator,
        }
    )
    return PlantModel(section, MODELS, tau).sampled


@pytest.fixture(scope="module")
def double():
    return load_urdf(MODELS / "double_pendulum.urdf", *DOUBLE)


def drake_xdot(name, q, v, u):
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(MODELS / name))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    plant.get_applied_generalized_force_input_port().FixValue(context, u)
    return np.concatenate([v, plant.EvalTimeDerivatives(context).CopyToVector()[len(q) :]])


@pytest.mark.parametrize("name", ["pendulum.urdf", "double_pendulum.urdf"])
def test_compiled_dynamics_equal_drakes_own(name, pendulum, double):
    model = pendulum if name == "pendulum.urdf" else double
    n = len(model.coordinates)
    kernel = compile_kernel(model.numeric(), ([v.symbol for v in model.states], [v.symbol for v in model.inputs]))
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, u = rng.uniform(-3, 3, 2 * n), rng.uniform(-2, 2, n)
        want = drake_xdot(name, x[:n], x[n:], u)
        assert np.allclose(kernel(x, u), want, rtol=1e-12, atol=1e-12 * np.abs(want).max())


def test_explicit_euler_is_the_papers_map():
    f = sampled(0.005, "explicit_euler")
    rng = np.random.default_rng(1)
    x, u = rng.uniform(-0.5, 0.5, (100, 2)), rng.uniform(-1.2, 1.2, (100, 1))
    want = np.stack(
        [x[:, 0] + 0.005 * x[:, 1], x[:, 1] + 0.005 * (-1.5 * 9.81 * np.sin(x[:, 0]) + 3 * u[:, 0])], axis=1
    )
    assert np.allclose(f.step(x, u), want, rtol=1e-13, atol=1e-15)
    assert f.offset_axes == (frozenset({1}), frozenset({0}))


def test_rk4_converges_to_a_fine_reference():
    from scipy.integrate import solve_ivp

    f = sampled(0.01, "rk4")
    x0, u = np.array([[0.7, -0.4]]), np.array([[0.9]])
    want = solve_ivp(
        lambda t, x: [x[1], -1.5 * 9.81 * np.sin(x[0]) + 3 * 0.9], (0, 0.01), x0[0], rtol=1e-12, atol=1e-14
    )
    assert np.allclose(f.step(x0, u)[0], want.y[:, -1], atol=1e-10)


@pytest.mark.parametrize("integrator", ["explicit_euler", "semi_implicit_euler", "rk4"])
def test_jacobian_and_enclosure_hold_on_samples(integrator):
    f = sampled(0.02, integrator)
    rng = np.random.default_rng(2)
    centre, r = rng.uniform(-2, 2, (200, 2)), rng.uniform(0, 0.3, (200, 2))
    u = rng.uniform(-1, 1, (200, 1))
    entries = sp.lambdify([*f.x, *f.u], f.jacobian_exprs, "numpy")

    def jacobian(x):  # (n, 2) -> (n, 4), row by row
        return np.stack([np.broadcast_to(e, len(x)) for e in entries(*x.T, *u.T)], axis=1)

    ends = np.array([f.jacobian_interval_kernel(a, b, c, c) for a, b, c in zip(centre - r, centre + r, u, strict=True)])
    low, high = f.enclosure(centre - r, centre + r, u)
    for _ in range(20):
        x = centre + r * rng.uniform(-1, 1, r.shape)
        assert np.all((ends[..., 0] <= jacobian(x)) & (jacobian(x) <= ends[..., 1]))
        y = f.step(x, u)
        assert np.all((low <= y) & (y <= high))
    h = 1e-6
    for j in range(2):
        e = h * np.eye(2)[j]
        slope = (f.step(centre + e, u) - f.step(centre - e, u)) / (2 * h)
        assert np.allclose(jacobian(centre).reshape(-1, 2, 2)[:, :, j], slope, atol=1e-8)


def test_interval_primitives_enclose():
    x, y = symbol("x"), symbol("y")
    exprs = [
        sp.sin(x) * y,
        sp.cos(x) ** 2,
        x**3 - y**2,
        sp.exp(x) / (2 + sp.cos(y)),
        sp.tanh(x) + sp.atan(y),
        sp.Abs(x) * sp.sign(y),
        sp.sinc(x),
        sp.Max(x, y) - sp.Min(x, y),
        sp.sqrt(1 + x**2),
        sp.Rational(1, 3) * x,
    ]
    value, enclose = compile_kernel(exprs, ([x, y],)), compile_interval_kernel(exprs, ([x, y],))
    rng = np.random.default_rng(3)
    for _ in range(300):
        lo = rng.uniform(-4, 4, 2)
        hi = lo + rng.uniform(0, 2, 2) * rng.integers(0, 2)
        pairs = enclose(lo, hi)
        for _ in range(10):
            for v, (a, b) in zip(value(rng.uniform(lo, hi)), pairs, strict=True):
                assert a <= v <= b


def test_exact_arc_needs_a_wheeled_robot():
    with pytest.raises(UserError, match="exact_arc"):
        sampled(0.1, "exact_arc")


def test_numbers_beyond_int64_are_compiled_as_floats():
    """What a rotation by 1.57079632679 leaves of a zero is a fraction of integers of 70 digits."""
    x, large = symbol("x"), sp.Integer(16) * 10**72
    found = compile_kernel([large * x / (x + large), sp.Rational(1, 3) * x**2], [[x]])(np.array([2.0]))
    assert found == pytest.approx((2.0, 4.0 / 3.0))


def test_symbols_that_stand_before_an_expression_are_what_they_say():
    x, y, cut, twice = symbol("x"), symbol("y"), sp.Symbol("x0"), sp.Symbol("x1")
    before = [(cut, sp.Max(-1, sp.Min(x, y))), (twice, 2 * cut)]
    kernel = compile_kernel([twice + y, cut, sp.Integer(3)], [[x], [y]], before)
    for a, b in ((3.0, 2.0), (0.5, 2.0), (-4.0, 2.0)):
        found = max(-1.0, min(a, b))
        assert kernel(np.array([a]), np.array([b])) == (2.0 * found + b, found, 3.0)
