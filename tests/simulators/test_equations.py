"""Equations as the simulator: against the same steps written by hand, and the shipped twin against PyBullet itself."""

import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import engine_of, make_simulator, roll_out

TAU = 0.005
EQUATIONS = {
    "parameters": {"b": {"value": 0.3}, "w": {"value": 12.0}},
    "dynamics": {"x1": "x2", "x2": "4*u - w*sin(x1) - b*x2*abs(x2)"},
    "coordinates": {"hinge": {"position": "x1", "velocity": "x2", "force_gain": "4"}},
}


def rate(x, u):
    return np.array([x[1], 4.0 * u - 12.0 * np.sin(x[0]) - 0.3 * x[1] * abs(x[1])])


def explicit(x, u, h):
    return x + h * rate(x, u)


def semi_implicit(x, u, h):
    v = x[1] + h * rate(x, u)[1]
    return np.array([x[0] + h * v, v])


def rk4(x, u, h):
    a = rate(x, u)
    b = rate(x + h / 2 * a, u)
    c = rate(x + h / 2 * b, u)
    d = rate(x + h * c, u)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


def equations(vary, **changes):
    section = {"engine": "equations", "integrator": "explicit_euler", "equations": EQUATIONS} | changes
    return vary("pendulum", {"simulator": section})


def samples(n=200, seed=3):
    rng = np.random.default_rng(seed)
    return rng.uniform([-0.2, -0.5], [0.2, 0.5], (n, 2)), rng.uniform(-1.2, 1.2, (n, 1))


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize(
    ("integrator", "step"), [("explicit_euler", explicit), ("semi_implicit_euler", semi_implicit), ("rk4", rk4)]
)
def test_steps_and_closed_form_are_the_steps_by_hand(vary, integrator, step, substeps):
    path = equations(vary, integrator=integrator, substeps=substeps)
    case, (x, u) = load_case(path), samples(20)
    expected = x.copy()
    for k in range(len(x)):
        for _ in range(substeps):
            expected[k] = step(expected[k], u[k, 0], TAU / substeps)
    simulator = make_simulator(case, path.parent)
    np.testing.assert_allclose(simulator.rollouts(x, u), expected, rtol=0, atol=1e-15)
    simulator.reset(x[0])
    np.testing.assert_allclose(simulator.advance(u[0]), expected[0], rtol=0, atol=1e-15)
    if (integrator, substeps) == ("rk4", 3):
        return  # its closed form is refused, see below
    rows = engine_of(case, path.parent).closed_form(case, path.parent)
    names = {s.name: s for row in rows for s in row.free_symbols}
    for k in range(3):
        at = {names["x1"]: x[k, 0], names["x2"]: x[k, 1], names["u"]: u[k, 0]}
        assert [float(row.subs(at)) for row in rows] == pytest.approx(expected[k].tolist(), abs=1e-14)


def test_the_shipped_twin_is_pybullet(root):
    x, u = samples(3000)
    found = []
    for name in ("pendulum_proven", "pendulum"):
        path = root / f"configs/cases/{name}.yaml"
        ((after, _),) = run_in_processes(roll_out, [(load_case(path), path.parent, x, u)])
        found.append(after)
    assert np.abs(found[0] - found[1]).max() < 1e-15


def test_effects_of_the_simulator_are_part_of_its_equations(vary):
    effect = {"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.5}}
    path = equations(vary, effects=[effect])
    (x, u), bare = samples(5), equations(vary)
    with_effect = make_simulator(load_case(path := equations(vary, effects=[effect])), path.parent).rollouts(x, u)
    without = make_simulator(load_case(bare := equations(vary)), bare.parent).rollouts(x, u)
    np.testing.assert_allclose(with_effect[:, 1] - without[:, 1], -TAU * 4.0 * 0.5 * x[:, 1], atol=1e-15)


def test_the_plants_own_equations_are_taken_where_none_are_given(vary):
    path = vary("pendulum", {"simulator": {"engine": "equations", "integrator": "semi_implicit_euler"}})
    (x, u) = samples(10)
    found = make_simulator(load_case(path), path.parent).rollouts(x, u)
    v = x[:, 1] + TAU * 3.0 * (u[:, 0] - 0.5 * 9.81 * np.sin(x[:, 0]))
    np.testing.assert_allclose(found, np.stack([x[:, 0] + TAU * v, v], axis=1), atol=1e-12)


def test_a_delay_spreads_the_successors_over_what_earlier_commands_leave(vary):
    """Half a step of the least or of the largest command, then that of the step: by hand, without gravity."""
    late = {"name": "input_delay", "on": "u", "parameters": {"delay": TAU / 2}}
    path = equations(vary, effects=[late], substeps=2)
    case = load_case(path)
    engine, ends = make_simulator(case, path.parent), case.domain.U["u"].list()
    lo, hi = engine.spread(np.zeros((1, 2)), np.zeros((1, 1)))
    bare = make_simulator(load_case(path := equations(vary, substeps=2)), path.parent)
    pushed = bare.rollouts(np.zeros((2, 2)), np.array([[ends.min()], [ends.max()]])) / 2.0
    np.testing.assert_allclose([lo[0, 1], hi[0, 1]], pushed[:, 1], rtol=1e-2)
    assert engine.remembers


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effects": [{"name": "sensor_offset", "on": "x1", "parameters": {"offset": 0.1}}]}, "cannot simulate"),
        ({"equations": EQUATIONS | {"dynamics": {"x1": "x2"}}}, "dynamics are given for"),
        ({"integrator": "exact_arc"}, "wheeled"),
    ],
)
def test_what_equations_cannot_do_is_one_line(vary, changes, words):
    path = equations(vary, **changes)
    with pytest.raises(UserError, match=words) as caught:
        make_simulator(load_case(path), path.parent)
    assert "\n" not in str(caught.value)


def test_a_map_too_large_to_enclose_is_refused(vary):
    path = equations(vary, integrator="rk4", substeps=3)
    case = load_case(path)
    with pytest.raises(UserError, match="too many operations to enclose"):
        engine_of(case, path.parent).closed_form(case, path.parent)


def test_own_equations_of_a_plant_are_part_of_what_its_roll_outs_read(vary):
    """A black box does not read them, so they are hashed for equations alone."""
    from simgap.provenance import sections_of

    black_box, known = load_case(vary("pendulum", {})), load_case(equations(vary))
    assert "plant.symbolic" not in sections_of("rollouts", black_box)
    assert "plant.symbolic" in sections_of("rollouts", known)
    for stage in ("scp", "lipschitz"):  # they enclose the gap of equations, and take a black box from its roll-outs
        assert "simulator" in sections_of(stage, known)
        assert "simulator" not in sections_of(stage, black_box)
    assert yaml.safe_load(known.model_dump_json())["simulator"]["equations"]["dynamics"] == EQUATIONS["dynamics"]


def test_other_values_of_parameters_are_those_of_equations_that_have_them(vary):
    path = equations(vary, parameters={"w": 9.0})
    (x, u) = samples(5)
    found = make_simulator(load_case(path), path.parent).rollouts(x, u)
    rate_v = 4.0 * u[:, 0] - 9.0 * np.sin(x[:, 0]) - 0.3 * x[:, 1] * abs(x[:, 1])
    np.testing.assert_allclose(found[:, 1], x[:, 1] + TAU * rate_v, atol=1e-15)
    path = equations(vary, parameters={"mass": 9.0})
    with pytest.raises(UserError, match=r"no parameter called mass.*b, w"):
        make_simulator(load_case(path), path.parent)


def test_a_map_too_large_to_enclose_is_sampled_if_the_case_says_so(vary):
    path = equations(vary, integrator="rk4", substeps=3, slopes="sampled")
    case = load_case(path)
    assert engine_of(case, path.parent).closed_form(case, path.parent) is None


def test_keys_that_came_later_change_no_hash_until_they_are_used(vary):
    plain = load_case(equations(vary)).model_dump(mode="json")["simulator"]
    assert not {"parameters", "slopes"} & set(plain)
    used = load_case(equations(vary, parameters={"w": 9.0}, slopes="sampled")).model_dump(mode="json")["simulator"]
    assert used["parameters"] == {"w": 9.0}
    assert used["slopes"] == "sampled"


def test_equations_with_a_pole_at_0_are_never_asked_there(vary):
    """A magnet above a coil: the force falls with the square of the distance, and X does not hold 0."""
    path = vary("pendulum", {
        "plant.urdf": None,
        "plant.symbolic": {"dynamics": {"x1": "x2", "x2": "9.81 - u/x1^2"}},
        "plant.states": {"x1": {"unit": "m"}, "x2": {"unit": "m/s"}},
        "plant.inputs": {"u": {"unit": "m^3/s^2"}},
        "simulator": {"engine": "equations", "integrator": "explicit_euler", "substeps": 1},
    })  # fmt: skip
    x, u = np.array([[0.005, 0.01]]), np.array([[3e-4]])
    simulator = make_simulator(load_case(path), path.parent)
    np.testing.assert_allclose(simulator.rollouts(x, u), [[0.005 + TAU * 0.01, 0.01 + TAU * (9.81 - 3e-4 / 0.005**2)]])
