"""`simgap new`: the case that it writes passes `check` and takes the road to a controller as it stands."""

import os
import re
import time

import numpy as np
import pytest
import road
import yaml

from simgap.errors import UserError
from simgap.io.controller_file import load_controller
from simgap.stages import check, fresh, new, synthesis
from simgap.stages.context import Context


def controlled(case, folder):
    """The gap-aware controller of a case, by the stages as the rules call them."""
    check.run(case)
    shards = road.roll_out(case, folder)
    fresh.run(case, folder / "fresh.parquet")
    road.bound(case, folder, shards, folder / "fresh.parquet", folder / "gap.json")
    synthesis.run(case, folder / "gap.json", folder / "c.npz", folder / "s.json", 1)
    return load_controller(folder / "c.npz")


@pytest.mark.parametrize("urdf", ["pendulum.urdf", None])
def test_it_runs_as_it_stands(root, tmp_path, urdf):
    file = None if urdf is None else root / "configs/models" / urdf
    case = new.run("mine", file, tmp_path)
    controller = controlled(case, tmp_path)
    assert controller.solution.winning.mean() > 0.5
    assert controller.contains([0.0, 0.0]).all()


def test_an_arm_of_two_joints_passes_the_check(root, tmp_path):
    """Its controller is written as a comment, since four states take longer; what is commented out is a case too."""
    case = new.run("arm", root / "configs/models/double_pendulum.urdf", tmp_path)
    context = Context.load(case)
    assert context.states == ["q1", "q2", "v1", "v2"]
    assert context.case.synthesis is None
    found = check.run(case)
    assert {cost.stage for cost in found.costs} >= {"rollouts", "gap"}
    head, _, tail = case.read_text().partition("# synthesis:")
    commented, _, rest = tail.partition("# Your recordings")
    case.write_text(head + "synthesis:" + commented.replace("\n# ", "\n") + "# Your recordings" + rest)
    assert Context.load(case).case.synthesis.cells == (14, 14, 14, 14)
    check.run(case)


def test_inputs_can_hold_the_plant_and_stop_it(root, tmp_path):
    """By hand: a rod of 1 kg and 1 m weighs 9.81/2 sin(.25) N m at the end of X, and .5^2/(2 .25) rad/s^2 stop it."""
    case = Context.load(new.run("rod", root / "configs/models/pendulum.urdf", tmp_path)).case
    inertia = 1.0 / 3.0
    weight = 9.81 * 0.5 * 0.2474039592545229
    assert case.domain.U["u"].max > weight + inertia * 0.5**2 / (2 * 0.25)
    assert case.domain.U["u"].max < 2.0 * (weight + inertia)


@pytest.mark.parametrize("limits", [(-0.1, 0.15), (0.4, 0.43), (-3.0, -0.2), (0.0005, 12.0)])
def test_X_stays_inside_the_range_of_a_joint(root, tmp_path, limits):
    """An engine stops a joint there and the nominal model does not: a new case begins without that finding."""
    text = (root / "configs/models/pendulum.urdf").read_text()
    (tmp_path / "m.urdf").write_text(
        text.replace('lower="-12.6" upper="12.6"', 'lower="{}" upper="{}"'.format(*limits))
    )
    case = new.run("mine", tmp_path / "m.urdf", tmp_path)
    lo, hi = Context.load(case).case.domain.X["q"]
    assert limits[0] < lo < hi < limits[1]
    assert hi - lo > 0.6 * min(limits[1] - limits[0], 0.5)
    assert not [f for f in check.run(case).findings if f.key.startswith("domain.X")]


def test_a_joint_without_room_is_told(root, tmp_path):
    text = (root / "configs/models/pendulum.urdf").read_text()
    (tmp_path / "m.urdf").write_text(text.replace('lower="-12.6" upper="12.6"', 'lower="0" upper="0"'))
    with pytest.raises(UserError, match="no room between its limits"):
        new.run("mine", tmp_path / "m.urdf", tmp_path)


def chain(links):
    """A URDF of so many rods, one hanging from the next."""
    parts = ['<robot name="chain"><link name="base"/>']
    for k in range(links):
        parent, at = ("base", 0) if k == 0 else (f"rod{k - 1}", -0.2)
        parts.append(
            f'<link name="rod{k}"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/><inertia ixx="0.002" ixy="0" '
            f'ixz="0" iyy="0.002" iyz="0" izz="0.0001"/></inertial></link><joint name="j{k}" type="continuous"><parent '
            f'link="{parent}"/><child link="rod{k}"/><origin xyz="0 0 {at}"/><axis xyz="0 1 0"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def test_a_case_of_many_joints_is_written_in_no_time_and_can_be_checked(tmp_path):
    """No equations are derived for it: what a bound needs is a comment, with numbers by Drake's accelerations."""
    (tmp_path / "chain.urdf").write_text(chain(6))
    began = time.process_time()
    case = new.run("chain", tmp_path / "chain.urdf", tmp_path)
    assert time.process_time() - began < 10.0
    context = Context.load(case)
    assert context.case.domain is None
    assert len(context.states) == 12
    assert check.run(case).costs == []
    text = case.read_text()
    assert "make all but 2 joints `fixed`" in text
    head, _, tail = text.partition("# domain:")
    commented, _, _ = tail.partition("# The high-fidelity side")
    limits = yaml.safe_load("domain:" + commented.replace("\n# ", "\n"))["domain"]["U"]
    assert head.rstrip().endswith("What follows is what it would hold.")
    assert all(0.0 < limits[f"u{k}"]["max"] < 100.0 for k in range(1, 7))


def test_inputs_of_an_arm_hold_and_stop_it_anywhere(root, tmp_path):
    """By Drake's inverse dynamics, its own recursion: .5^2/(2 .25) rad/s^2 at every joint, anywhere in X."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import MultibodyForces

    urdf = root / "configs/models/double_pendulum.urdf"
    domain = Context.load(new.run("arm", urdf, tmp_path)).case.domain
    plant = MultibodyPlant(0.0)
    (model,) = Parser(plant).AddModels(urdf)
    (base,) = [b for b in (plant.get_body(k) for k in plant.GetBodyIndices(model)) if b.name() in ("world", "base")][:1]
    plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    context, rng, seen = plant.CreateDefaultContext(), np.random.default_rng(0), np.zeros(2)
    ends = np.array([domain.X[n] for n in ("q1", "q2", "v1", "v2")])
    for _ in range(300):
        plant.SetPositionsAndVelocities(context, rng.uniform(ends[:, 0], ends[:, 1]))
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        seen = np.maximum(seen, np.abs(plant.CalcInverseDynamics(context, rng.choice([-0.5, 0.5], 2), forces)))
    most = np.array([domain.U["u1"].max, domain.U["u2"].max])
    assert (seen < most).all()
    assert (most < 3.0 * seen).all()


@pytest.mark.parametrize("effort", [1.0, 0.37])
def test_inputs_stay_within_the_effort_of_a_joint(root, tmp_path, effort):
    text = (root / "configs/models/pendulum.urdf").read_text()
    (tmp_path / "m.urdf").write_text(re.sub('effort="[^"]*"', f'effort="{effort}"', text))
    case = new.run("weak", tmp_path / "m.urdf", tmp_path)
    inputs = Context.load(case).case.domain.U["u"]
    assert 0.8 * effort < inputs.max <= effort
    assert 0.0 in inputs.list()
    assert f"the URDF allows {effort}; to hold and stop it anywhere in X takes 1.5" in case.read_text()
    assert not [f for f in check.run(case).findings if f.key == "domain.U.u"]


def test_a_name_of_a_joint_is_no_yaml(root, tmp_path):
    text = (root / "configs/models/pendulum.urdf").read_text()
    (tmp_path / "m.urdf").write_text(text.replace('name="hinge"', 'name="a: &quot;b&quot; #"'))
    case = new.run("odd", tmp_path / "m.urdf", tmp_path)
    assert yaml.safe_load(case.read_text())["plant"]["states"]["q"]["joint"] == 'a: "b" #'


def test_what_is_there_stays(tmp_path):
    (tmp_path / "mine.yaml").write_text("kept")
    with pytest.raises(UserError, match="is there already"):
        new.run("mine", None, tmp_path)
    with pytest.raises(UserError, match="is no name of a case"):
        new.run("Grün", None, tmp_path)
    with pytest.raises(UserError, match=r"no such|does not exist"):
        new.run("other", tmp_path / "none.urdf", tmp_path)
    assert os.listdir(tmp_path) == ["mine.yaml"]
    assert (tmp_path / "mine.yaml").read_text() == "kept"
