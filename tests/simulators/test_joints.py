"""Engines over the pendulum's URDF: the zero-gap control, the paper's likely set-up, independence of order."""

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.plant import AddedEffect
from simgap.errors import UserError
from simgap.simulators.joints import JointPlant, joint_forces
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import make_simulator, roll_out

TAU, G = 0.005, 9.81
MATCHED = {"linear": 0.0, "angular": 0.0, "joint": 0.0}


def samples(n=400, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(-0.2, 0.2, n), rng.uniform(-0.5, 0.5, n)], axis=1), rng.uniform(-1.2, 1.2, (n, 1))


def semi_implicit(x, u, friction=0.0, steps=1):
    """The rod by hand: m = l = 1, inertia 1/3."""
    q, v, h = x[:, 0].copy(), x[:, 1].copy(), TAU / steps
    for _ in range(steps):
        v = v + h * 3.0 * (-0.5 * G * np.sin(q) + u[:, 0] - friction * np.sign(v))
        q = q + h * v
    return np.stack([q, v], axis=1)


def simulate(path, x, u):
    ((out, engine),) = run_in_processes(roll_out, [(load_case(path), path.parent, x, u)])
    return out, engine


@pytest.mark.parametrize(
    "simulator",
    [
        {"engine": "pybullet", "inertia": "file", "damping": MATCHED},
        {"engine": "mujoco", "damping": MATCHED},
    ],
)
def test_with_matched_settings_the_gap_is_zero(vary, simulator):
    x, u = samples()
    out, engine = simulate(vary("pendulum", {"simulator": simulator}), x, u)
    assert simulator["engine"] in engine
    assert np.abs(out - semi_implicit(x, u)).max() < 1e-8


def test_the_gap_between_two_engines_is_zero_with_matched_settings_and_shows_the_inertia_without(root, vary):
    """The shipped MuJoCo case against PyBullet, undamped: nothing; with PyBullet's default inertia: a quarter."""
    x, u = samples()
    mujoco, engine = simulate(root / "configs/cases/pendulum_mujoco.yaml", x, u)
    assert "mujoco" in engine
    same, _ = simulate(vary("pendulum", {"simulator.inertia": "file", "simulator.damping": MATCHED}), x, u)
    other, _ = simulate(vary("pendulum", {"simulator.damping": MATCHED}), x, u)
    assert np.abs(same - mujoco).max() < 1e-8
    own, theirs = mujoco[:, 1] - x[:, 1], other[:, 1] - x[:, 1]
    assert np.allclose(theirs, own * 4 / 3, rtol=0.01, atol=1e-6)  # the hinge's inertia is 1/4 instead of 1/3


def test_pybullets_default_inertia_makes_the_gap_of_the_paper(vary):
    x, u = samples(2000)
    out, _ = simulate(vary("pendulum", {}), x, u)
    euler = np.stack([x[:, 0] + TAU * x[:, 1], x[:, 1] + TAU * 3 * (u[:, 0] - 0.5 * G * np.sin(x[:, 0]))], axis=1)
    largest = np.abs(out - euler).max(axis=0)
    assert 1.8e-4 < largest[0] < 2.3e-4
    assert 0.9e-2 < largest[1] < 1.15e-2


def test_collision_geometry_changes_pybullets_default_inertia(vary, root, tmp_path):
    urdf = (root / "configs/models/pendulum.urdf").read_text()
    shape = '<origin xyz="0 0 -0.5"/><geometry><box size="0.05 0.05 1"/></geometry>'
    box = f"<collision>{shape}</collision>\n  </link>\n  <joint"
    with_box = tmp_path / "boxed.urdf"
    with_box.write_text(urdf.replace("</link>\n  <joint", box))
    x, u = samples(200)
    bare, _ = simulate(vary("pendulum", {}), x, u)
    boxed, _ = simulate(vary("pendulum", {"plant.urdf": str(with_box)}), x, u)
    want = semi_implicit(x, u)
    assert np.abs(boxed - want)[:, 1].max() < 0.05 * np.abs(bare - want)[:, 1].max()


@pytest.mark.parametrize("effects", [[], [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.1}}]])
def test_rollouts_are_the_same_bits_in_any_order_and_sharding(vary, effects):
    path = vary("pendulum", {"simulator.effects": effects, "simulator.substeps": 3})
    x, u = samples(300)
    whole, _ = simulate(path, x, u)
    order = np.random.default_rng(1).permutation(len(x))
    shuffled, _ = simulate(path, x[order], u[order])
    parts = np.concatenate(
        [simulate(path, a, b)[0] for a, b in zip(np.array_split(x, 3), np.array_split(u, 3), strict=True)]
    )
    assert np.array_equal(whole[order], shuffled)
    assert np.array_equal(whole, parts)


@pytest.mark.parametrize("engine", [{"engine": "pybullet", "inertia": "file"}, {"engine": "mujoco"}])
def test_declared_friction_acts_at_every_substep(vary, engine):
    friction = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.1}}]
    section = engine | {"damping": MATCHED, "substeps": 4, "effects": friction}
    x, u = samples()
    out, _ = simulate(vary("pendulum", {"simulator": section}), x, u)
    assert np.abs(out - semi_implicit(x, u, friction=0.1, steps=4)).max() < 1e-8


def test_static_input_effects_and_refusals(root):
    plant = JointPlant(root / "m.urdf", ("hinge",), (0,), (1,), ((0,),), ("u",), TAU)
    gain = AddedEffect(name="input_gain", on="u", parameters={"ratio": 1.1})
    viscous = AddedEffect(name="viscous_friction", on="hinge", parameters={"b": 0.2})
    forces = joint_forces(plant, [gain, viscous])
    assert forces is not None
    assert np.allclose(forces(0.1, 0.5, 2.0), [1.1 * 2.0 - 0.2 * 0.5])
    with pytest.raises(UserError, match=r"simulator\.effects.*input_delay"):
        joint_forces(plant, [AddedEffect(name="input_delay", on="u", parameters={"delay": 0.01})])


def test_what_a_drive_makes_of_its_command_at_the_joint_s_speed(root):
    """The motor gives what its voltage allows, the gear takes a share of that; the command's gain comes before both."""
    plant = JointPlant(root / "m.urdf", ("a", "b"), (0, 1), (2, 3), ((), (0,)), ("u",), 0.05)
    limit = AddedEffect(name="torque_speed_limit", on="u", parameters={"T_s": 2.0, "k": 0.5})
    gear = AddedEffect(name="load_friction", on="u", parameters={"mu": 0.1})
    gain = AddedEffect(name="input_gain", on="u", parameters={"ratio": 2.0})
    forces = joint_forces(plant, [gain, limit, gear])
    assert forces is not None
    for velocity, command, drive in ((1.0, 0.6, 1.2), (1.0, 3.0, 1.5), (1.0, -3.0, -2.5), (-1.0, 3.0, 2.5)):
        felt = drive - 0.1 * abs(drive) * np.sign(velocity)
        assert forces(0.0, 0.0, 9.0, velocity, command) == pytest.approx([0.0, felt])


def test_chatter_of_the_engine_stays_in_its_log(vary, tmp_path, capfd):
    path, log = vary("pendulum", {}), tmp_path / "engine.log"
    run_in_processes(roll_out, [(load_case(path), path.parent, *samples(3))], log=log)
    assert capfd.readouterr().out == ""
    assert log.read_text()


@pytest.mark.parametrize("substeps", [4, 20])
def test_what_diverges_in_mujoco_is_refused_and_not_begun_anew(vary, tmp_path, monkeypatch, substeps):
    """A spring too stiff for the sub-steps; from where it rests nothing diverges, whatever did before."""
    monkeypatch.chdir(tmp_path)
    spring = {"name": "spring", "on": "hinge", "parameters": {"k": 1e12}}
    path = vary("pendulum", {"simulator": {"engine": "mujoco", "substeps": substeps, "effects": [spring]}})
    with pytest.raises(UserError, match=r"the engine 'mujoco' diverges .* at hinge = 0\.1") as refused:
        simulate(path, np.array([[0.1, 0.2]]), np.array([[0.5]]))
    assert refused.value.key == "simulator.substeps"
    assert not list(tmp_path.glob("MUJOCO_LOG*"))
    engine = make_simulator(load_case(path), path.parent)
    engine.reset(np.array([0.1, 0.2]))
    with pytest.raises(UserError, match="diverges"):
        engine.advance(np.array([0.5]))
    engine.reset(np.zeros(2))
    assert np.array_equal(engine.advance(np.zeros(1)), np.zeros(2))
