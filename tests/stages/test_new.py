"""`simgap new`: the case that it writes passes `check` and takes the road to a controller as it stands."""

import os
import re
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from simgap.errors import UserError
from simgap.extras.wizard import new_case as new
from simgap.extras.wizard.driven_arm import Proposal
from simgap.extras.wizard.model_file import centre_of
from simgap.extras.wizard.new_case import axes_of, drives, needed_inputs
from simgap.extras.wizard.proposal import blocks_along
from simgap.extras.wizard.propose import Numbers
from simgap.gap.sampling.points import covering_grid, own_point
from simgap.io.controller_file import load_controller
from simgap.lint.gap import find_stuck_joints
from simgap.plants.context import Context
from simgap.plants.model_file import read_model_file, wheels_of
from simgap.stages import check, fresh, synthesis
from tests.stages import road


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


def rubbing(root, tmp_path, name, friction):
    """A URDF of the project with dry friction in its joints, in their order."""
    text = (root / "configs/models" / f"{name}.urdf").read_text()
    for value in friction:
        text = re.sub(r'friction="0(\.0)?"', f'friction="{value}"', text, count=1)
    path = tmp_path / "rubs.urdf"
    path.write_text(text)
    return path


def test_a_joint_that_rubs_gets_a_bound_that_follows_it(root, tmp_path):
    """On a grid of 2,500 cells and a polynomial the gap of this pendulum is refused as rough."""
    notes = []
    case = new.run("mine", rubbing(root, tmp_path, "pendulum", [0.1]), tmp_path, note=notes.append)
    context = Context.load(case)
    assert context.case.simulator.effects[0].parameters == {"F_c": 0.1}
    assert not context.case.plant.effects
    assert "states dry friction for hinge" in notes[1]
    controller = controlled(case, tmp_path)
    assert controller.solution.winning.mean() > 0.9
    assert not [found for found in check.run(case).findings if "friction" in str(found)]


NUMBERS = Numbers(
    Proposal(
        0.05, {"q1": (-0.25, 0.25), "q2": (-0.2, 0.2), "v1": (-1.0, 1.0), "v2": (-1.5, 1.5)},
        {"u1": (-9.0, 9.0, 4.5), "u2": (-2.0, 2.0, 1.0)}, (12, 12, 14, 14), 0.25, ("q1",), 1.0,
    ),
    {"q2": 0.02, "v1": 0.1, "v2": 0.15}, 2,
)  # fmt: skip


def test_little_that_is_won_is_called_little():
    assert NUMBERS.doubtful == ""
    assert replace(NUMBERS, proposal=replace(NUMBERS.proposal, wins=0.021)).doubtful.startswith(
        "0.021 of X is little: a run may end with an empty winning domain"
    )


@pytest.mark.parametrize(("friction", "told"), [(0.1, False), (700.0, True)])
def test_friction_that_the_input_does_not_overcome_is_told(root, tmp_path, friction, told):
    case = new.run("mine", rubbing(root, tmp_path, "pendulum", [0.1]), tmp_path)
    case.write_text(case.read_text().replace("F_c: 0.1", f"F_c: {friction}"))
    found = list(find_stuck_joints(Context.load(case)))
    assert [finding.key for finding in found] == ["simulator.effects.0"] * told
    assert all("does not move it" in finding.problem for finding in found)


def test_joints_with_dampings_of_their_own_keep_them(root, tmp_path):
    """The engine has one number for all joints; what another has more is an effect, and `check` finds nothing left."""
    text = (root / "configs/models/cart_pole.urdf").read_text()
    first, second = re.subn(r'damping="[0-9.]*"', 'damping="0.3"', text, count=1)[0].split("</joint>", 1)
    (tmp_path / "cart.urdf").write_text(first + "</joint>" + re.sub(r'damping="[0-9.]*"', 'damping="0.02"', second))
    case = new.run("cart", tmp_path / "cart.urdf", tmp_path, inputs=["rail"], seconds=1.0)
    simulator = Context.load(case).case.simulator
    assert simulator.damping.joint == 0.02
    assert [(e.name, e.on, e.parameters) for e in simulator.effects] == [("viscous_friction", "rail", {"b": 0.28})]
    assert not [found for found in check.run(case).findings if "replaces the damping" in found.problem]


def test_an_arm_that_rubs_has_fine_cells_along_its_speeds(root, tmp_path, monkeypatch):
    def numbers(*given):
        own = replace(NUMBERS, half_widths={"q2": 0.02, "v1": 0.1, "v2": 0.0625}, blocks=(1, 10, 10, 24))
        return own if given[-1] == {"elbow": 0.02} else None

    monkeypatch.setattr(new, "numbers", numbers)
    text = (root / "configs/models/two_link.urdf").read_text()
    first, second = text.split('friction="0.0"', 1)
    (tmp_path / "arm.urdf").write_text(first + 'friction="0.0"' + second.replace('friction="0.0"', 'friction="0.02"'))
    case = Context.load(new.run("arm", tmp_path / "arm.urdf", tmp_path)).case
    assert case.gap.basis.blocks == (1, 10, 10, 24)
    assert [effect.on for effect in case.simulator.effects] == ["elbow"]
    assert case.gap.lipschitz.rough_limit == 0.5
    assert blocks_along(["q2", "v1", "v2"], {"v2"}) == {"q2": 10, "v1": 10, "v2": 80}


def test_a_pair_of_joints_without_a_proposal_is_sampled_as_finely_as_one_with(root, tmp_path):
    path = new.run("arm", root / "configs/models/double_pendulum.urdf", tmp_path, ["shoulder"], {"elbow": 0.7})
    context = Context.load(path)
    assert covering_grid(context.case, context.box, own_point(context.case)).cells == (10,) * 4


def test_a_case_of_four_states_has_the_numbers_that_were_found(root, tmp_path, monkeypatch):
    """The search itself is tested in tests/synthesis/test_proposal.py; here is what the case makes of it."""
    asked, notes = [], []

    def numbers(case, folder, at, limits, room, tell, until, rubs):
        asked.append((at, limits, room))
        return NUMBERS

    monkeypatch.setattr(new, "numbers", numbers)
    case = new.run("arm", root / "configs/models/double_pendulum.urdf", tmp_path, at={"elbow": 0.1}, note=notes.append)
    context = Context.load(case)
    assert context.states == ["q1", "q2", "v1", "v2"]
    assert context.domain.tau == 0.05
    assert context.domain.X == NUMBERS.proposal.X
    assert context.input_set.shape == (25, 2)
    assert context.case.synthesis.cells == (12, 12, 14, 14)
    assert context.case.symmetry.along == ("q1",)
    assert context.case.simulator.substeps == 12  # of PyBullet's 240 a second
    assert {cost.stage for cost in check.run(case).costs} >= {"rollouts", "gap", "synthesis", "audit"}
    ((at, limits, room),) = asked
    assert at == {"q1": 0.0, "q2": 0.1}
    assert limits == {"u1": 100.0, "u2": 100.0}
    assert room["q1"] == (-12.6, 12.6)
    assert room["v2"] == (-100.0, 100.0)
    assert "the URDF states an effort for each" in notes[0]
    assert "alone wins 0.25 of X; the case uses 12 x 12 x 14 x 14 cells" in notes[1]


def geared(root, folder, changes=(), transmissions=()):
    """The double pendulum with parts replaced and drives on some joints."""
    text = (root / "configs/models/double_pendulum.urdf").read_text()
    for old, better in changes:
        assert old in text
        text = text.replace(old, better)
    drives = (f'<transmission name="{j}"><joint name="{j}"/><actuator name="m"/></transmission>' for j in transmissions)
    (folder / "m.urdf").write_text(text.replace("</robot>", "".join(drives) + "</robot>"))
    return read_model_file(folder / "m.urdf")


LIMIT = '<limit lower="-12.6" upper="12.6" effort="100" velocity="100"/>'


def test_joints_have_a_drive_where_the_file_says_so(root, tmp_path):
    both = ("shoulder", "elbow")
    assert drives(geared(root, tmp_path, transmissions=["elbow"]), None)[0] == ("elbow",)
    assert drives(geared(root, tmp_path), None)[0] == both
    assert drives(geared(root, tmp_path), ["elbow"])[0] == ("elbow",)
    free = [('name="elbow" type="revolute"', 'name="elbow" type="continuous"')]
    loose = (tmp_path / "m.urdf").read_text()
    head, tail = loose.rsplit(LIMIT, 1)
    (tmp_path / "m.urdf").write_text((head + tail).replace(*free[0]))
    assert drives(read_model_file(tmp_path / "m.urdf"), None)[0] == ("shoulder",)


def test_what_drives_an_underactuated_robot_is_asked_for(root, tmp_path):
    text = (root / "configs/models/double_pendulum.urdf").read_text()
    (tmp_path / "m.urdf").write_text(text.replace("revolute", "continuous").replace(LIMIT, ""))
    with pytest.raises(UserError, match="does not say which joints have a drive") as caught:
        new.run("mine", tmp_path / "m.urdf", tmp_path)
    assert "--inputs shoulder" in caught.value.remedy
    with pytest.raises(UserError, match="there is no moving joint 'wrist'"):
        new.run("mine", tmp_path / "m.urdf", tmp_path, ["wrist"])
    with pytest.raises(UserError, match="there is no moving joint 'wrist'"):
        new.run("mine", tmp_path / "m.urdf", tmp_path, ["elbow"], {"wrist": 1.0})
    assert not (tmp_path / "mine.yaml").exists()


def test_a_posture_that_nothing_holds_is_a_case_without_a_controller_that_says_why(root, tmp_path):
    """The shoulder alone cannot hold the forearm to one side; the case is there for a diagnosis."""
    notes = []
    urdf = root / "configs/models/double_pendulum.urdf"
    case = new.run("mine", urdf, tmp_path, ["shoulder"], {"elbow": 0.7}, note=notes.append)
    assert Context.load(case).case.synthesis is None
    assert list(Context.load(case).case.plant.inputs) == ["u1"]
    assert "no input holds the posture" in notes[1]
    assert "no input holds the posture" in case.read_text()


def test_inputs_can_hold_the_plant_and_stop_it(root, tmp_path):
    """By hand: a rod of 1 kg and 1 m weighs 9.81/2 sin(.25) N m at the end of X, and .5^2/(2 .25) rad/s^2 stop it."""
    case = Context.load(new.run("rod", root / "configs/models/pendulum.urdf", tmp_path)).case
    inertia = 1.0 / 3.0
    weight = 9.81 * 0.5 * 0.2474039592545229
    assert case.domain.U["u"].max > weight + inertia * 0.5**2 / (2 * 0.25)
    assert case.domain.U["u"].max < 2.0 * (weight + inertia)


@pytest.mark.parametrize(("at", "reached"), [(-12.7, False), (12.6001, False), (12.6, True), (-12.6, True)])
def test_a_posture_beyond_a_stop_is_refused_and_not_moved_to_it(root, at, reached):
    urdf = root / "configs/models/pendulum.urdf"
    joints = read_model_file(urdf).joints
    (name,) = joints
    if reached:
        (axis,) = axes_of(joints, {name: at})
        assert axis.centre == at
        return
    with pytest.raises(UserError, match=rf"^--at: {name}={at:g} is beyond a stop: the joint goes from -12.6 to 12.6"):
        axes_of(joints, {name: at})


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


@pytest.mark.parametrize(("ends", "centre"), [((-1.0, 2.5), 0.0), ((0.0, 2.5), 1.25), ((0.4, 1.0), 0.7), (None, 0.0)])
def test_a_joint_that_has_no_room_about_0_is_looked_at_in_its_middle(ends, centre):
    assert centre_of(SimpleNamespace(range=ends)) == pytest.approx(centre)


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
    case = new.run("chain", tmp_path / "chain.urdf", tmp_path, inputs=[f"j{k}" for k in range(6)])
    assert time.process_time() - began < 10.0
    context = Context.load(case)
    assert context.case.domain is None
    assert len(context.states) == 12
    assert check.run(case).costs == []
    text = case.read_text()
    assert "`simgap new --joints` keeps 2 of the joints and locks the others" in text
    head, _, tail = text.partition("# domain:")
    commented, _, _ = tail.partition("# The high-fidelity side")
    limits = yaml.safe_load("domain:" + commented.replace("\n# ", "\n"))["domain"]["U"]
    assert head.rstrip().endswith("What follows is what it would hold.")
    assert all(0.0 < limits[f"u{k}"]["max"] < 100.0 for k in range(1, 7))


@pytest.mark.parametrize("driven", [(0, 1), (0,)])
def test_inputs_of_an_arm_hold_and_stop_its_driven_joints_anywhere(root, driven):
    """By Drake's inverse dynamics, its own recursion: .5^2/(2 .25) rad/s^2 at driven joints, others as they go."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import MultibodyForces

    urdf = root / "configs/models/double_pendulum.urdf"
    axes = [replace(a, driven=k in driven) for k, a in enumerate(axes_of(read_model_file(urdf).joints, {}))]
    most = needed_inputs(urdf, axes, 9.81)
    plant = MultibodyPlant(0.0)
    (model,) = Parser(plant).AddModels(urdf)
    (base,) = [b for b in (plant.get_body(k) for k in plant.GetBodyIndices(model)) if b.name() in ("world", "base")][:1]
    plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    context, rng, seen = plant.CreateDefaultContext(), np.random.default_rng(0), np.zeros(len(driven))
    for _ in range(300):
        plant.SetPositionsAndVelocities(context, rng.uniform([-0.25, -0.25, -0.5, -0.5], [0.25, 0.25, 0.5, 0.5]))
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        asked = rng.choice([-0.5, 0.5], 2)
        if len(driven) == 1:  # the elbow's acceleration is the one without a torque there
            at = [plant.CalcInverseDynamics(context, np.array([asked[0], a]), forces)[1] for a in (0.0, 1.0)]
            asked[1] = -at[0] / (at[1] - at[0])
        seen = np.maximum(seen, np.abs(plant.CalcInverseDynamics(context, asked, forces))[list(driven)])
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
    with pytest.raises(UserError, match="already exists"):
        new.run("mine", None, tmp_path)
    with pytest.raises(UserError, match="is not a valid case name"):
        new.run("Grün", None, tmp_path)
    with pytest.raises(UserError, match=r"no such|does not exist"):
        new.run("other", tmp_path / "none.urdf", tmp_path)
    assert os.listdir(tmp_path) == ["mine.yaml"]
    assert (tmp_path / "mine.yaml").read_text() == "kept"


def test_a_robot_on_two_wheels_becomes_a_case_that_passes_its_check(root, tmp_path):
    """The shipped one, its wheels, their track and torque as its own case has them; a pendulum has none."""
    file, notes = root / "configs/models/pioneer.urdf", []
    shipped = yaml.safe_load((root / "configs/cases/pioneer.yaml").read_text())
    path = new.run("mine", file, tmp_path, note=notes.append)
    made = yaml.safe_load(path.read_text())
    for key in ("left", "right", "wheel_radius", "track"):
        assert made["simulator"][key] == shipped["simulator"][key]
    assert made["simulator"]["torque"] == pytest.approx(shipped["simulator"]["torque"], rel=0.1)
    assert made["plant"]["symbolic"]["wheels"]["track"] == shipped["simulator"]["track"]
    assert "'drive_l' and 'drive_r'" in notes[0]
    found = check.run(path)
    assert {cost.stage for cost in found.costs} >= {"synthesis", "audit"}
    assert wheels_of(root / "configs/models/double_pendulum.urdf") is None
    turned = file.read_text().replace('name="drive_l" type="continuous"', 'name="drive_l" type="revolute"')
    assert turned != file.read_text()
    (tmp_path / "m.urdf").write_text(turned)
    assert wheels_of(tmp_path / "m.urdf") is None
