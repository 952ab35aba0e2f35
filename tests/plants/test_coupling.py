"""Coupled coordinates in equations: the mass matrix says how a force on one moves all, and what hides it is refused."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.config.plant import PlantSection
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.effects import EFFECTS
from simgap.errors import UserError
from simgap.model.symbolic import symbol
from simgap.plants.plant_model import declared_model

CART, POLE, LENGTH, GRAVITY = 1.0, 0.3, 0.5, 9.81
DRAG = 0.6  # N s/m, what the declared model lacks
PLANT = {
    "states": {"x": {"unit": "m"}, "q": {"unit": "rad"}, "v": {"unit": "m/s"}, "w": {"unit": "rad/s"}},
    "inputs": {"u": {"unit": "N"}},
    "symbolic": {
        "parameters": {
            "M": {"value": CART, "unit": "kg"}, "m": {"value": POLE, "unit": "kg"},
            "l": {"value": LENGTH, "unit": "m"}, "g": {"value": GRAVITY, "unit": "m/s^2"},
        },
        "dynamics": {
            "x": "v", "q": "w",
            "v": "(u + m*sin(q)*(l*w^2 + g*cos(q)))/(M + m*sin(q)^2)",
            "w": "(-u*cos(q) - m*l*w^2*sin(q)*cos(q) - (M + m)*g*sin(q))/(l*(M + m*sin(q)^2))",
        },
        "mass_matrix": [["M + m", "m*l*cos(q)"], ["m*l*cos(q)", "m*l^2"]],
        "coordinates": {
            "cart": {"position": "x", "velocity": "v", "force_unit": "N"},
            "pole": {"position": "q", "velocity": "w"},
        },
    },
}  # fmt: skip


def model(**changes):
    plant = copy.deepcopy(PLANT)
    plant["symbolic"] |= changes
    return declared_model(PlantSection.model_validate(plant), None)


def gains(cart, pole):
    """The plant without a mass matrix."""
    coordinates = copy.deepcopy(PLANT["symbolic"]["coordinates"])
    coordinates["cart"] |= cart
    coordinates["pole"] |= pole
    return {"mass_matrix": None, "coordinates": coordinates}


def accelerations(at, force):
    """The cart-pole's own equations of motion, M(q) a = forces, solved as numbers: (2,), forces on cart and pole."""
    _, q, _, w = at
    mass = np.array([[CART + POLE, POLE * LENGTH * np.cos(q)], [POLE * LENGTH * np.cos(q), POLE * LENGTH**2]])
    pull = np.array([POLE * LENGTH * w**2 * np.sin(q), -POLE * GRAVITY * LENGTH * np.sin(q)])
    return np.linalg.solve(mass, np.asarray(force) + pull)


def test_a_force_on_the_cart_moves_the_pole():
    plant = model()
    dragged = EFFECTS["viscous_friction"].apply(plant, "cart", {"b": DRAG})
    turned = EFFECTS["spring"].apply(plant, "pole", {"k": 0.4})
    for at in np.random.default_rng(1).uniform(-1.5, 1.5, (10, 5)):
        here = {symbol(n): v for n, v in zip(("x", "q", "v", "w", "u"), at, strict=True)}
        u = at[4]
        found = [[float(e.subs(here)) for e in p.numeric()[2:]] for p in (plant, dragged, turned)]
        forces = [(u, 0.0), (u - DRAG * at[2], 0.0), (u, -0.4 * at[1])]
        assert found == [pytest.approx(accelerations(at[:4], f).tolist(), rel=1e-10) for f in forces]


def record():
    """Two runs of the cart-pole with a cart that rubs, by SciPy's Runge-Kutta from the equations of motion."""
    rng, rate, seconds = np.random.default_rng(4), 100.0, 10.0
    t, traces = np.arange(int(rate * seconds)) / rate, []
    for k in range(2):
        hz, phase = rng.uniform(0.2, 2.0, 5), rng.uniform(0.0, 6.3, 5)
        u = 1.2 * np.sin(2 * np.pi * np.outer(t, hz) + phase).sum(axis=1)
        x = np.empty((t.size, 4))
        x[0] = 0.0, 0.3, 0.0, 0.0
        for i in range(t.size - 1):
            moved = solve_ivp(
                lambda _, s, f: [s[2], s[3], *accelerations(s, (f - DRAG * s[2], 0.0))],
                (0.0, 1.0 / rate), x[i], args=(u[i],), rtol=1e-8, atol=1e-10,
            )  # fmt: skip
            x[i + 1] = moved.y[:, -1]
        y = x[:, :2] + 5e-4 * rng.standard_normal((t.size, 2))
        traces.append(Trace(f"run{k}", t, y, u[:, None]))
    return Record(tuple(traces), ("x", "q"), ("u",))


def test_friction_of_the_cart_is_attributed_to_the_cart():
    chosen = ("viscous_friction", "coulomb_friction", "quadratic_drag", "spring", "input_gain", "input_bias")
    found = diagnose(model(), record(), DiagnosisSettings(effects=chosen))
    assert found.verdict == "attributed"
    (effect,) = found.effects
    assert (effect.name, effect.on) == ("viscous_friction", "cart")
    low, high = effect.parameters["b"].ci95
    assert low <= DRAG <= high
    assert high - low < 0.02 * DRAG


FULL = {"v": "1/(M + m*sin(q)^2)", "w": "-cos(q)/(l*(M + m*sin(q)^2))"}
TURN = {"v": "-cos(q)/(l*(M + m*sin(q)^2))", "w": "(M + m)/(m*l^2*(M + m*sin(q)^2))"}


def test_a_force_map_says_the_same():
    by_matrix, by_map = model(), model(**gains({"force_map": FULL}, {"force_map": TURN}))
    at = {symbol("q"): 0.7} | by_matrix.values()
    for name in ("cart", "pole"):
        columns = [[float(e.subs(at)) for e in p.force_map[name]] for p in (by_matrix, by_map)]
        assert columns[0] == pytest.approx(columns[1], rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (gains({"force_gain": FULL["v"]}, {"force_gain": TURN["w"]}), "coupled"),
        (gains({"force_gain": "1/M"}, {"force_gain": "1/(m*l^2)"}), "coupled"),
        (gains({}, {}), "force_gain or force_map"),
        (gains({"force_map": {"y": "1"}}, {"force_map": TURN}), "not velocities"),
        ({"mass_matrix": [["M", "m*l"]]}, "2 x 2"),
        ({"mass_matrix": [["M", "m*l*cos(q)"], ["m*l*sin(q)", "m*l^2"]]}, "not symmetric"),
        ({"mass_matrix": [["m", "m*l*2"], ["m*l*2", "m*l^2"]]}, "positive definite"),
        ({"mass_matrix": [["M + w^2", "0"], ["0", "m"]]}, "positions and parameters"),
        (gains({"force_gain": "1"}, {}) | {"mass_matrix": PLANT["symbolic"]["mass_matrix"]}, "no force_gain"),
    ],
)
def test_what_hides_the_coupling_is_refused_in_one_line(changes, said):
    with pytest.raises(UserError, match=said) as error:
        model(**changes)
    assert error.value.key.startswith("plant.symbolic")


def test_bodies_joined_by_a_spring_are_not_coupled_by_their_inertia():
    plant = {
        "states": {n: {"unit": u} for n, u in (("a", "m"), ("b", "m"), ("va", "m/s"), ("vb", "m/s"))},
        "inputs": {"u": {"unit": "N"}},
        "symbolic": {
            "dynamics": {"a": "va", "b": "vb", "va": "u + 3*(b - a)", "vb": "3*(a - b)/2 - va*abs(va)"},
            "coordinates": {
                n: {"position": n, "velocity": f"v{n}", "force_gain": g, "force_unit": "N"}
                for n, g in (("a", "1"), ("b", "1/2"))
            },
        },
    }
    assert declared_model(PlantSection.model_validate(plant), None).force_map["a"][3] == 0
