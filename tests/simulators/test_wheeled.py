"""The wheeled robot: physics a person can work out, independence of order, what sub-steps and histories do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.lint.engine import find_other_wheel_sizes
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.simulators.pybullet import PyBulletWheeled
from simgap.simulators.wheeled import wheeled_plant

CASE = Path(__file__).parents[2] / "configs/cases/turtlebot.yaml"


def make(**changes):
    case = load_case(CASE)
    section = case.simulator.model_copy(update={"substeps": 100, "poses": 20, **changes})
    return PyBulletWheeled(wheeled_plant(case, CASE.parent), section)


def rollouts(x, u, changes):
    robot = make(**changes)
    try:
        return robot.rollouts(x, u)
    finally:
        robot.close()


def histories(history, inputs, heading, before, changes):
    """Responses after unrelated motion, in a fresh engine."""
    robot = make(**changes)
    for u in before:
        robot.chain(np.array([3.0, 1.0, 0.4]), u[None])
    return robot.responses(history, inputs, heading)


def run(task, *jobs):
    return run_in_processes(task, jobs)


def samples(n=12, seed=0):
    rng = np.random.default_rng(seed)
    x = np.stack([rng.uniform(0, 10, n), rng.uniform(0, 10, n), rng.uniform(-np.pi, np.pi, n)], axis=1)
    return x, np.stack([rng.uniform(-0.5, 0.5, n), rng.uniform(-1, 1, n)], axis=1)


def test_rollouts_are_the_same_bits_in_any_order():
    x, u = samples()
    order = np.random.default_rng(1).permutation(len(x))
    straight, shuffled, alone = run(rollouts, (x, u, {}), (x[order], u[order], {}), (x[3:4], u[3:4], {}))
    assert np.array_equal(straight[order], shuffled)
    assert np.array_equal(straight[3], alone[0])


def test_a_history_leaves_the_same_state_whatever_ran_before():
    _, u = samples(8, seed=2)
    nothing = np.zeros((0, 2))
    fresh, used, reversed_ = run(
        histories,
        (u[:3], u[3:], 0.0, nothing, {}),
        (u[:3], u[3:], 0.0, u[:5], {}),
        (u[:3], u[3:][::-1], 0.0, u[:2], {}),
    )
    assert np.array_equal(fresh, used)
    assert np.array_equal(fresh, reversed_[::-1])


def test_a_straight_start_loses_the_distance_that_the_motors_need():
    """From rest the robot covers v tau - v^2 / (2 a) with a = 2 T / (r m), the wheels' inertia in m."""
    speed = 0.4
    mass = 5.9 + 2 * 0.2 + 2 * 0.05 + 2 * 1.5e-4 / 0.038**2
    acceleration = 2 * 0.3 / 0.038 / mass
    ((out,),) = run(rollouts, (np.zeros((1, 3)), np.array([[speed, 0.0]]), {}))
    assert out[0] == pytest.approx(speed - speed**2 / (2 * acceleration), abs=0.004)
    assert np.abs(out[1:]).max() < 1e-3


def test_at_a_held_command_the_robot_follows_the_arc():
    v, w = 0.4, 0.8
    ((paths),) = run(histories, (np.tile([v, w], (3, 1)), np.array([[v, w]]), 0.0, np.zeros((0, 2)), {}))
    assert paths[0, -1] == pytest.approx([v / w * np.sin(w), v / w * (1 - np.cos(w)), w], abs=3e-3)


def test_engine_steps_count_alike_however_they_are_grouped():
    """PyBullet scales a motor's limit with its outer step; the simulator takes that back."""
    x, u = samples(4, seed=3)
    grouped, single = run(rollouts, (x, u, {"poses": 20}), (x, u, {"poses": 100}))
    assert np.abs(grouped - single).max() < 1e-9


def test_the_previous_input_matters():
    u = np.array([[0.3, 0.0]])
    forward, backward = run(
        histories, (np.array([[0.5, 0.0]]), u, 0.0, u[:0], {}), (np.array([[-0.5, 0.0]]), u, 0.0, u[:0], {})
    )
    assert forward[0, -1, 0] - backward[0, -1, 0] > 0.05


TURNS = np.array([[0.5, -0.6], [0.35, 1.0], [0.5, 1.0]])
BRAKING = np.array([[-0.45, 0.3]])
AS_SHIPPED = {"substeps": 50, "poses": 25}


def test_equal_histories_end_alike_at_every_heading_however_hard_the_robot_brakes():
    """A wheel that loses its contact for a step turns the robot by .045 rad at this heading and not beside it.

    A contact solver that stops early makes them differ by some 1e-4, as it works along the axes of the world.
    """
    headings = (0.0, -1.82247, -1.8195, 1.0, np.pi / 2)
    found = run(histories, *((TURNS, BRAKING, t, BRAKING[:0], AS_SHIPPED) for t in headings))
    ends = np.array([paths[0, -1] for paths in found])
    assert np.abs(ends - ends[0]).max(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)


def test_the_mirror_image_of_a_history_ends_in_the_mirror_image():
    """The robot is the same left and right: neither the order of contacts nor that of wheels may show."""
    flipped = np.array([1.0, -1.0])
    job = TURNS, BRAKING, 0.0, BRAKING[:0], AS_SHIPPED
    ((own,), (image,)) = run(histories, job, (TURNS * flipped, BRAKING * flipped, *job[2:]))
    assert np.abs(own - image * [1.0, -1.0, -1.0]).max() < 1e-9


def test_no_input_but_the_previous_one_matters_where_the_motors_settle_within_a_sample():
    rng = np.random.default_rng(8)
    older = rng.uniform([-0.5, -1.0], [0.5, 1.0], (12, 2, 2))
    held = rng.uniform([-0.5, -1.0], [0.5, 1.0], (12, 2, 2))
    jobs = [(h[:1], h[1:], 0.0, BRAKING[:0], AS_SHIPPED) for h in held]
    longer = np.concatenate([older, held[:, :1]], axis=1)
    jobs += [(o, h[1:], 0.0, BRAKING[:0], AS_SHIPPED) for o, h in zip(longer, held, strict=True)]
    found = np.array(run(histories, *jobs))[:, 0, -1]
    assert np.abs(found[:12] - found[12:]).max() < 5e-4


def test_more_load_answers_more_slowly():
    x, u = np.zeros((1, 3)), np.array([[0.5, 0.0]])
    light, heavy = run(rollouts, (x, u, {}), (x, u, {"payload": 5.0}))
    assert heavy[0, 0] < light[0, 0] - 0.01


def test_mistakes_name_what_is_wrong():
    case = load_case(CASE)
    with pytest.raises(UserError, match="divide"):
        make(poses=7)
    for key, name, said in (
        ("left", "wheel_of_fortune", "no joint called 'wheel_of_fortune'"),
        ("right", "rear_caster", "is fixed, not a wheel's"),  # the engine drove it, and the robot ran on one wheel
        ("right", make()._section.left, "is both wheels"),
    ):
        with pytest.raises(UserError, match=said) as caught:
            make(**{key: name})
        assert caught.value.key == f"simulator.{key}"
        assert "turn without end: " in caught.value.remedy
    with pytest.raises(UserError, match="wheels"):
        wheeled_plant(case.model_copy(update={"plant": case.plant.model_copy(update={"symbolic": None})}), CASE.parent)
    assert replace(wheeled_plant(case, CASE.parent), tau=2.0).tau == 2.0


def test_tyres_that_multiply_the_floor_s_friction_are_refused(tmp_path):
    """The room that is left between recorded poses counts on the floor's friction alone."""
    case = load_case(CASE)
    plant = wheeled_plant(case, CASE.parent)
    sticky = tmp_path / "sticky.urdf"
    sticky.write_text(
        plant.urdf.read_text().replace('<lateral_friction value="1.0"/>', '<lateral_friction value="1.5"/>')
    )
    with pytest.raises(UserError, match=r"lateral friction 1\.5"):
        PyBulletWheeled(replace(plant, urdf=sticky), case.simulator)


def turned_axes(urdf, x, u):
    """Poses after one step, for the robot of a model file."""
    case = load_case(CASE)
    plant = replace(wheeled_plant(case, CASE.parent), urdf=urdf)
    robot = PyBulletWheeled(plant, case.simulator.model_copy(update={"substeps": 100, "poses": 20}))
    try:
        return robot.rollouts(x, u)
    finally:
        robot.close()


def test_the_axes_in_which_an_inertia_is_written_turn_no_heading(tmp_path):
    """The body is as heavy about x as about y: written in axes turned about z it is the same body."""
    text = (CASE.parent / "../models/turtlebot.urdf").read_text()
    own = '<origin xyz="-0.02 0 0.08" rpy="0 0 0"/>'
    assert text.count(own) == 1
    plain, turned = tmp_path / "plain.urdf", tmp_path / "turned.urdf"
    plain.write_text(text)
    turned.write_text(text.replace(own, own.replace("0 0 0", "0 0 0.6")))
    x, u = np.array([[1.0, 2.0, 0.3], [0.0, 0.0, -2.0]]), np.array([[0.3, 0.5], [0.2, -0.8]])
    a, b = run(turned_axes, (plain, x, u), (turned, x, u))
    assert np.abs(a - b).max() < 1e-3


def test_sizes_that_are_not_the_files_are_told(vary, root):
    """Commands are turned into wheel speeds by them: ten times the radius is a robot that hardly moves."""
    urdf = {"simulator.urdf": str(root / "configs/models/pioneer.urdf")}
    assert list(find_other_wheel_sizes(Context.load(vary("pioneer", urdf)))) == []
    (worn,) = find_other_wheel_sizes(Context.load(vary("pioneer", {**urdf, "simulator.wheel_radius": 0.092})))
    assert worn.key == "simulator.wheel_radius"
    for key, value, stated in (("wheel_radius", 0.975, "0.0975"), ("track", 0.1, "0.33")):
        with pytest.raises(UserError, match=f"have {stated} m") as caught:
            list(find_other_wheel_sizes(Context.load(vary("pioneer", {**urdf, f"simulator.{key}": value}))))
        assert caught.value.key == f"simulator.{key}"
