"""What `simgap new` takes a model file for: joints locked, MJCF, and the premises that it asks for."""

import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.extras.wizard.mjcf_as_urdf import model_of_mjcf
from simgap.extras.wizard.model_file import Asked, model_of_urdf
from simgap.extras.wizard.new_case import run
from simgap.stages import check

WEIGHT = """<inertial><origin xyz="{at}"/><mass value="{m}"/>
<inertia ixx=".02" ixy="0" ixz="0" iyy=".03" iyz="0" izz=".01"/></inertial>"""


def link(name, m=1.0, at="0 0.02 -0.2", more=""):
    return f'<link name="{name}">{WEIGHT.format(m=m, at=at)}{more}</link>'


def joint(name, parent, child, kind="revolute", axis="0 1 0", place="0 0 -0.4", more=""):
    limit = '<limit lower="-2" upper="2" effort="30" velocity="9"/>' if kind in ("revolute", "prismatic") else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{place}" '
        f'rpy="0.3 0 0.2"/><axis xyz="{axis}"/>{limit}{more}</joint>'
    )


def chain(prefix, count, parent="base"):
    names = [f"{prefix}{k}" for k in range(count)]
    axes = ["0 1 0", "1 0 0", "0 0 1"]
    return "".join(link(n) + joint(f"j{n}", [parent, *names][k], n, axis=axes[k % 3]) for k, n in enumerate(names))


def urdf(folder, *parts, root=None):
    path = folder / "given.urdf"
    path.write_text(f'<robot name="r">{root or link("base")}{"".join(parts)}</robot>')
    return path


def asked(folder, joints=None, at=(), base=None, note=lambda words: None):
    return Asked(joints, dict(at), base, folder / "mine", note=note)


def accelerations(path, names, q, v, held=()):
    """By Drake, of the joints `names` of a file, those of `held` kept where they are by forces."""
    from simgap.plants.urdf import multibody_plant

    plant, order = multibody_plant(path, (0.0, 0.0, -9.81))
    context = plant.CreateDefaultContext()
    values = dict(zip(names, q, strict=True)) | dict(held)
    speeds = dict(zip(names, v, strict=True))
    plant.SetPositions(context, [values[n] for n in order])
    plant.SetVelocities(context, [speeds.get(n, 0.0) for n in order])
    on = [order.index(n) for n in names]
    mass = plant.CalcMassMatrix(context)[np.ix_(on, on)]
    force = (plant.CalcGravityGeneralizedForces(context) - plant.CalcBiasTerm(context))[on]
    return np.linalg.solve(mass, force)


@pytest.mark.parametrize("kept", [["ja1"], ["ja1", "ja2"], ["ja0", "ja3"]])
def test_locked_joints_leave_the_motion_of_the_others_as_it_is(tmp_path, kept):
    """Against the whole arm in Drake, whose other joints are held by forces."""
    path = urdf(tmp_path, chain("a", 4))
    at = {"ja0": 0.4, "ja1": -0.7, "ja2": 1.1, "ja3": 0.2}
    model = model_of_urdf(path, asked(tmp_path, kept, at))
    assert list(model.file.joints) == kept
    rng, held = np.random.default_rng(0), {n: q for n, q in at.items() if n not in kept}
    for _ in range(5):
        q, v = rng.uniform(-1.0, 1.0, (2, len(kept)))
        mine = accelerations(model.file.path, kept, q, v)
        np.testing.assert_allclose(mine, accelerations(path, kept, q, v, held), rtol=1e-8, atol=1e-8)


def test_a_case_of_one_joint_of_an_arm_stands_beside_its_file(tmp_path):
    notes = []
    case = run("mine", urdf(tmp_path, chain("a", 4)), tmp_path, at={"ja0": 0.4}, joints=["ja2"], note=notes.append)
    assert load_case(case).plant.urdf == "mine_model.urdf"
    assert list(load_case(case).plant.inputs) == ["u"]
    assert "mine_model.urdf has the other joints locked: ja0 at 0.4, ja1 at 0, ja3 at 0." in notes
    assert "Its base, link 'base', is assumed to be bolted to the world." in notes
    case.unlink()
    with pytest.raises(UserError, match=r"mine_model\.urdf: already exists"):
        run("mine", urdf(tmp_path, chain("a", 4)), tmp_path, joints=["ja2"])


IMPOSSIBLE = '<inertia ixx=".02" ixy="0" ixz="0" iyy=".06" iyz="0" izz=".01"/>'


def test_an_inertia_that_no_body_has_is_refused_where_its_body_moves(tmp_path):
    """Engines would replace it, each by another one, before joints are locked and bodies composed."""
    whole = WEIGHT.format(at="0 0.02 -0.2", m=1.0)
    weight = whole[: whole.index("<inertia ")] + IMPOSSIBLE + "</inertial>"
    path = urdf(tmp_path, chain("a", 4).replace(whole, weight, 1))  # of a0, which ja0 moves
    for kept in (None, ["ja0"]):
        with pytest.raises(
            UserError, match=r"given\.urdf: link 'a0': <inertia>: no body has .* 0\.01, 0\.02, 0\.06 kg"
        ):
            run("mine", path, tmp_path, joints=kept)
    assert [p.name for p in tmp_path.iterdir()] == ["given.urdf"]
    run("mine", path, tmp_path, joints=["ja2"])


def wheel(name, place):
    shape = '<collision><geometry><cylinder radius="0.1" length="0.05"/></geometry></collision>'
    return link(name, more=shape) + joint(f"j{name}", "base", name, "continuous", place=place)


MIMIC = '<mimic joint="ja0" multiplier="-1"/>'
REFUSED = {
    "legs": ((chain("a", 2), chain("b", 2)), {},
             r"--base: 2 chains of joints begin at its base \('ja0', 'jb0'\), as legs"),
    "car": (tuple(wheel(n, f"{x} {y} 0") for n, x, y in (("a", 1, 1), ("b", 1, -1), ("c", -1, 1), ("d", -1, -1))), {},
            r"--base: it has wheels \('ja', 'jb', 'jc', 'jd'\)"),
    "floating": ((link("a"), joint("ja", "base", "a", "floating")), {}, "'ja' is floating: a floating base"),
    "no wheels": ((chain("a", 2),), {"base": "wheels"}, "--base: no two driven wheels are seen"),
    "mimic": ((chain("a", 1), link("m"), joint("jm", "base", "m", more=MIMIC)), {},
              r"joint 'jm': mimics 'ja0': the two are one coordinate"),
    "mimic of what is kept": ((chain("a", 1), link("m"), joint("jm", "base", "m", more=MIMIC)), {"joints": ["ja0"]},
                              "mimics 'ja0'"),
    "no such joint": ((chain("a", 2),), {"joints": ["elbow"]}, "--joints: there is no moving joint 'elbow'.*ja0, ja1"),
    "beyond a stop": ((chain("a", 3),), {"joints": ["ja0"], "at": {"ja2": 2.1}}, "--at: ja2=2.1 is beyond a stop"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_file_does_not_say_is_asked_for_in_a_line(tmp_path, name):
    parts, given, told = REFUSED[name]
    with pytest.raises(UserError, match=told) as caught:
        run("mine", urdf(tmp_path, *parts), tmp_path, **given)
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["given.urdf"]


def test_what_is_asked_for_decides(tmp_path):
    legs = urdf(tmp_path, chain("a", 2), chain("b", 2))
    assert len(model_of_urdf(legs, asked(tmp_path, base="fixed")).file.joints) == 4
    bolted = urdf(tmp_path, chain("a", 2, "world"), chain("b", 2, "world"), root='<link name="world"/>')
    assert len(model_of_urdf(bolted, asked(tmp_path)).file.joints) == 4
    loose = urdf(tmp_path, link("a"), joint("ja", "base", "a", "floating"), chain("b", 1, "a"))
    assert list(model_of_urdf(loose, asked(tmp_path, base="fixed")).file.joints) == ["jb0"]


def test_check_says_that_legs_are_bolted(tmp_path):
    path = urdf(tmp_path, chain("a", 2), chain("b", 2))
    case = run("mine", path, tmp_path, base="fixed")
    found = check.run(case)
    assert [f.key for f in found.findings] == ["plant.urdf"]
    assert "as legs do, and here its base is bolted to the world" in found.findings[0].problem
    assert check.conclusion(found, case).startswith("The case is in order. simgap")
    arm = run("arm", urdf(tmp_path, chain("a", 3)), tmp_path)
    assert check.conclusion(check.run(arm), arm).startswith("The case is in order. simgap")


def test_check_says_that_a_run_ends_without_a_controller(tmp_path):
    case = run("mine", urdf(tmp_path, chain("a", 2)), tmp_path, seconds=0.0)
    found = check.run(case)
    assert found.findings[-1].problem.startswith("a run ends with the bound: not found in the time")
    assert found.findings[-1].remedy == "Search longer (--seconds)."
    assert "in order. A run takes" in check.conclusion(found, case)


def test_joints_that_mimic_are_locked_with_what_they_mimic(tmp_path):
    fingers = joint("jm", "a1", "m", more=MIMIC.replace("ja0", "jf")), joint("jf", "a1", "f")
    hand = (chain("a", 2), link("m"), link("f"), *fingers)
    model = model_of_urdf(urdf(tmp_path, *hand), asked(tmp_path, ["ja1"], {"jf": 0.5}))
    assert list(model.file.joints) == ["ja1"]
    whole = accelerations(tmp_path / "given.urdf", ["ja1"], [0.3], [0.0], {"ja0": 0.0, "jf": 0.5, "jm": -0.5})
    np.testing.assert_allclose(accelerations(model.file.path, ["ja1"], [0.3], [0.0]), whole, rtol=1e-8)


def test_meshes_that_are_not_there_are_left_out_and_told(tmp_path):
    mesh = '<visual><geometry><mesh filename="package://gone/arm.stl"/></geometry></visual>'
    notes = []
    path = urdf(tmp_path, link("a", more=mesh), joint("ja", "base", "a"))
    model = model_of_urdf(path, asked(tmp_path, note=notes.append))
    assert model.file.meshes == ()
    assert "package://gone/arm.stl is missing" in notes[0]


CART = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>{more}
<body name="cart" pos="0 0 1">
<joint name="rail" type="slide" axis="1 0 0" damping="0.5" range="-2 2" limited="true"/>
<geom type="box" size=".1 .1 .1" mass="2"/>
<body name="pole" quat="0.9 0.1 0.3 0.2">
<joint name="hinge" pos="0 0 .05" ref="{ref}" armature="0.01" frictionloss="0.02"/>
<inertial pos="0.1 0.2 0.5" quat="0.5 0.5 0.1 0.7" mass="0.7" diaginertia="0.02 0.03 0.04"/>
{tip}</body></body></worldbody>
<actuator>{actuator}</actuator>{tail}</mujoco>"""
PLAIN = {"more": "", "ref": 0, "tip": "", "tail": "", "actuator": '<motor joint="rail" gear="10" ctrlrange="-1 1"/>'}
TIP = """<body name="tip" pos="0.1 0 0.6" euler="0.2 0.4 0.1"><joint name="wrist" axis="0 1 0" pos="0 0.1 0"/>
<geom type="capsule" size="0.05 0.2" pos="0 0 0.2"/></body>"""


def mjcf(folder, **given):
    path = folder / "given.xml"
    path.write_text(CART.format(**PLAIN | given))
    return path


def by_mujoco(path, q, v, held=()):
    """Accelerations without armature, friction and damping, joints of `held` kept by forces."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.dof_armature[:] = model.dof_frictionloss[:] = model.dof_damping[:] = 0.0
    data = mujoco.MjData(model)
    for name, value in {**q, **dict(held)}.items():
        data.joint(name).qpos[:] = value
    for name, value in v.items():
        data.joint(name).qvel[:] = value
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    for k in range(model.nv):
        mujoco.mj_mulM(model, data, mass[k], np.eye(model.nv)[k])
    on = [int(model.joint(n).dofadr[0]) for n in q]
    return np.linalg.solve(mass[np.ix_(on, on)], -data.qfrc_bias[on])


@pytest.mark.parametrize(("given", "kept", "at"), [
    ({}, None, {}), ({"ref": 0.6}, None, {}), ({"tip": TIP}, ["rail", "wrist"], {"hinge": 0.8}),
    ({"tip": TIP, "ref": 0.3}, ["hinge"], {"wrist": -0.4}),
])  # fmt: skip
def test_a_file_of_mujoco_becomes_the_same_motion_in_drake(tmp_path, given, kept, at):
    path = mjcf(tmp_path, **given)
    model = model_of_mjcf(path, asked(tmp_path, kept, at))
    names = kept or ["rail", "hinge"]
    assert sorted(model.file.joints) == sorted(names)
    rng, held = np.random.default_rng(1), {n: q for n, q in at.items() if n not in names}
    if "tip" in given and "rail" not in names:
        held["rail"] = 0.0
    for _ in range(5):
        q, v = rng.uniform(-1.0, 1.0, (2, len(names)))
        whole = by_mujoco(path, dict(zip(names, q, strict=True)), dict(zip(names, v, strict=True)), held)
        mine = accelerations(model.file.path, names, q, v)
        np.testing.assert_allclose(mine, whole, rtol=1e-4, atol=1e-4)
        if model.mjcf != path:
            own = by_mujoco(model.mjcf, dict(zip(names, q, strict=True)), dict(zip(names, v, strict=True)))
            np.testing.assert_allclose(own, whole, rtol=1e-4, atol=1e-4)


def test_a_case_of_an_mjcf_file_has_its_numbers(tmp_path):
    pytest.importorskip("mujoco")
    case = run("mine", None, tmp_path, mjcf=mjcf(tmp_path), seconds=1.0)
    written = yaml.safe_load(case.read_text())
    assert written["simulator"]["engine"] == "mujoco"
    assert written["simulator"]["mjcf"] == "given.xml"
    assert [i["joint"] for i in written["plant"]["inputs"].values()] == ["rail"]
    (added,) = load_case(case).plant.effects
    assert (added.name, added.on, added.parameters) == ("reflected_inertia", "hinge", {"I": 0.01})
    assert load_case(case).plant.urdf == "mine_model.urdf"


def test_gravity_that_a_flag_switches_off_pulls_at_nothing(tmp_path):
    pytest.importorskip("mujoco")
    path = mjcf(tmp_path, more='</worldbody><option><flag gravity="disable"/></option><worldbody>')
    case = run("mine", None, tmp_path, mjcf=path, joints=["hinge"])
    assert load_case(case).plant.gravity == 0.0
    found = check.run(case).findings
    assert [f.problem for f in found if "gravity" in f.problem] == ["its <flag> switches off: gravity"]


def test_servos_are_left_out_and_told(tmp_path):
    pytest.importorskip("mujoco")
    notes = []
    path = mjcf(tmp_path, actuator='<position joint="rail" kp="50" forcerange="-7 7"/>')
    model = model_of_mjcf(path, asked(tmp_path, note=notes.append))
    assert model.mjcf == tmp_path / "mine_model.xml"
    assert "servos (rail kp = 50 kv = 0), for the inputs of the case are forces on joints" in notes[0]
    assert model.file.joints["rail"].effort == 7.0
    assert model.file.driven == ("rail",)


MJCF_REFUSED = {
    "free": ({"more": '<body><freejoint/><geom size="1"/></body>'}, {}, "--base: joint '' is free: a base or a body"),
    "planar": ({"more": '<body><joint type="slide" axis="1 0 0" name="x"/><joint type="slide" axis="0 1 0" name="y"/>'
                        '<geom size="1"/></body>'}, {}, "joint 'x' is slide and nothing drives it"),
    "two on a body": ({"tip": '<body name="t"><joint name="a"/><joint name="b" axis="1 0 0"/><geom size=".1"/></body>'},
                      {}, r"body 't': has several joints \(a, b\)"),
    "closed": ({"tail": '<equality><connect body1="pole" anchor="0 0 0"/></equality>'}, {}, "connect closes a chain"),
    "coupled": ({"tail": '<equality><joint joint1="rail" joint2="hinge"/></equality>'}, {}, "couples joints, as mimic"),
    "tendons": ({"tail": '<tendon><fixed><joint joint="rail" coef="1"/></fixed></tendon>'}, {}, "it has tendons"),
    "pulled by tendons": ({
        "more": '<body><joint type="slide" name="x"/><joint type="slide" axis="0 1 0" name="y"/>'
                '<geom size="1"/></body>',
        "tail": '<tendon><fixed><joint joint="x" coef="1"/></fixed><fixed><joint joint="y" coef="1"/></fixed></tendon>',
    }, {}, "it has tendons"),
    "tilted": ({"more": "</worldbody><option gravity='3 0 -9'/><worldbody>"}, {}, "its gravity is not along -z"),
    "no such joint": ({}, {"joints": ["elbow"]}, "--joints: there is no moving joint 'elbow'.*rail, hinge"),
    "beyond a stop": ({}, {"at": {"rail": 3.0}}, "--at: rail=3 is beyond a stop"),
}  # fmt: skip


@pytest.mark.parametrize("name", MJCF_REFUSED)
def test_what_a_nominal_model_lacks_is_refused_by_its_word(tmp_path, name):
    pytest.importorskip("mujoco")
    given, options, told = MJCF_REFUSED[name]
    with pytest.raises(UserError, match=told) as caught:
        run("mine", None, tmp_path, mjcf=mjcf(tmp_path, **given), **options)
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["given.xml"]


def test_a_base_that_outweighs_what_it_carries_is_asked_for(tmp_path):
    heavy = urdf(tmp_path, chain("a", 2), root=link("base", m=3.0))
    with pytest.raises(UserError, match="its base weighs 3 kg and all that it carries 2 kg"):
        model_of_urdf(heavy, asked(tmp_path))
    assert list(model_of_urdf(heavy, asked(tmp_path, base="fixed")).file.joints) == ["ja0", "ja1"]
    light = urdf(tmp_path, chain("a", 2), root=link("base", m=1.9))
    assert model_of_urdf(light, asked(tmp_path)).file.joints
