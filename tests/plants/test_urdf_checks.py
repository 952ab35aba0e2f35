"""A URDF that engines would read differently, or that no body can be, is refused by file, link and attribute."""

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.plants.urdf import multibody_plant
from simgap.plants.urdf_checks import check_bodies, check_floating_root, check_urdf

CHANGES = {
    "negative moment": ('iyy="0.33333"', 'iyy="-1"', r"link 'rod': <inertia>: no body has principal moments of -1, 0"),
    "not semidefinite": ('ixy="0"', 'ixy="5"', "principal moments of -4.667, 0.001, 5.333 kg m"),
    "more than a body's inertia": ('iyy="0.33333"', 'iyy="9"', "exceeds the sum of the others by 8.7; Drake would"),
    "products too large": ('ixy="0"', 'ixy="0.2"', "of 0.001, 0.1333, 0.5333 kg m"),
    "moment no number": ('iyy="0.33333"', 'iyy="x"', "<inertia> iyy: 'x' is not one number"),
    "mass abc": ('mass value="1.0"', 'mass value="abc"', r"<mass> value: 'abc' is not one number"),
    "mass negative": ('mass value="1.0"', 'mass value="-1"', "<mass> value: '-1' is negative"),
    "mass infinite": ('mass value="1.0"', 'mass value="inf"', "not one number"),
    "mass zero": ('mass value="1.0"', 'mass value="0"', "moving link without mass"),
    "mass in another script": ('mass value="1.0"', 'mass value="١"', "not one number"),
    "mass long": ('mass value="1.0"', f'mass value="{"9" * 20_000}"', "not one number"),
    "xyz one number": ('xyz="0 0 -0.5"', 'xyz="-1"', "<origin> xyz: '-1' is not 3 numbers"),
    "axis nowhere": ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "<axis> xyz: '0 0 0' has no direction"),
    "empty link": ('link name="base"', 'link name=""', "link '': name: is missing or empty"),
    "joint without name": ('joint name="hinge"', "joint", "joint '': name: is missing or empty"),
    "child of nothing": ('child link="rod"', 'child link="none"', "joint 'hinge': <child> link: names no link"),
    "child not named": ('child link="rod"', "child", "names no link"),
    "twice": ('link name="rod"', 'link name="base"', "names no link|appears twice"),
    "no XML": ("</robot>", "", "not well-formed XML"),
    "encoding": ('<?xml version="1.0"?>', '<?xml version="1.0" encoding="nope"?>', "not well-formed XML"),
    "other root": ("robot", "model", "root element is <model>"),
    "MJCF": ("robot", "mujoco", "root element is <mujoco>, not <robot>. It is MJCF: simgap new NAME --mjcf FILE"),
    "xacro argument": ('xyz="0 0 -0.5"', 'xyz="$(arg place)"', r"xacro template.*'\$\(arg place\)'. Run xacro first"),
    "xacro expression": ('mass value="1.0"', 'mass value="${m/2}"', r"xacro template.*'\$\{m/2\}'. Run xacro first"),
    "xacro macro": ('<link name="base"/>', '<xacro:rod/><link name="base"/>', "holds <xacro:rod>. Run xacro first"),
    "limits swapped": ('type="continuous">', 'type="revolute"><limit lower="1" upper="-1"/>', "'1' lies above '-1'"),
    "chain that Drake closes": (
        "</robot>",
        "<drake:ball_constraint/></robot>",
        "<drake:ball_constraint> closes a chain",
    ),
    "world not there": ('parent link="base"', 'parent link="world"', 'Add <link name="world"/>, which only Drake'),
}
GOOD = """<?xml version="1.0"?>
<robot name="pendulum">
  <link name="base"/>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.5" rpy="0 0 0"/>
      <mass value="1.0"/>
      <inertia ixx="0.33333" ixy="0" ixz="0" iyy="0.33333" iyz="0" izz="0.001"/>
    </inertial>
    <visual><geometry><cylinder radius="0.02" length="1"/></geometry></visual>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="base"/><child link="rod"/>
    <axis xyz="0 1 0"/><dynamics damping="0" friction="0"/>
  </joint>
</robot>
"""


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_refused_is_one_short_line(tmp_path, name):
    old, new, match = CHANGES[name]
    assert old in GOOD
    path = tmp_path / "model.urdf"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(UserError, match=match) as caught:
        check_urdf(path)
    told = str(caught.value).replace(str(tmp_path), "")
    assert told.startswith("/model.urdf")
    assert "\n" not in told
    assert len(told) < 300


IRRELEVANT = {
    "axis of a fixed joint": ("</robot>", '<link name="tip"/><joint name="weld" type="fixed"><parent link="rod"/>'
                              '<child link="tip"/><axis xyz="0 0 0"/></joint></robot>'),
    "a box that is drawn": ("</link>\n  <joint", '<visual><geometry><box size="0 0 0"/></geometry></visual></link>'
                            "<joint"),
    "Drake's names, undeclared": ("</link>\n  <joint", '<collision><geometry><box size="1 1 1"/></geometry><drake:'
                                  'proximity_properties drake:x="1"/></collision></link><joint'),
    "tags that nobody knows": ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><safety_controller k="none"/><gazebo/>'),
    "blanks before it": ('<?xml version="1.0"?>', '\n  <?xml version="1.0"?>'),
    "a zero behind it": ("</robot>\n", "</robot>\n\0"),
    "a body that does not move": ('<link name="base"/>', '<link name="base"><inertial><mass value="1"/><inertia '
                                  'ixx="9" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'),
}  # fmt: skip


@pytest.mark.parametrize("name", IRRELEVANT)
def test_what_enters_no_motion_is_no_reason_to_refuse(tmp_path, name):
    old, new = IRRELEVANT[name]
    assert old in GOOD
    path = tmp_path / "model.urdf"
    path.write_text(GOOD.replace(old, new))
    check_urdf(path)
    _, joints = multibody_plant(path, (0.0, 0.0, -9.81))
    assert joints == ["hinge"]


PLATES = ((0.1, 0.7), (1e-7, 3e-7), (0.0, 0.3), (12.3, 45.6))
EXCESS = (0.0, 1e-16, 1e-14, 1e-12, 1e-9, 1e-3)


@pytest.mark.parametrize("least", PLATES)
@pytest.mark.parametrize("share", EXCESS)
def test_an_inertia_is_taken_if_and_only_if_drake_computes_with_it(tmp_path, least, share):
    """On flat plates, at the edge of what a body can be: beyond it Drake takes a sphere's, PyBullet 0."""
    a, b = least
    most = (a + b) * (1 + share)
    path = tmp_path / "model.urdf"
    path.write_text(
        GOOD.replace('ixx="0.33333"', f'ixx="{a!r}"')
        .replace('iyy="0.33333"', f'iyy="{b!r}"')
        .replace("0.001", repr(most))
    )
    plant, _ = multibody_plant(path, (0.0, 0.0, -9.81))
    spatial = plant.GetBodyByName("rod").default_spatial_inertia()
    central = spatial.Shift(spatial.get_com()).CalcRotationalInertia().get_moments()
    if np.allclose(central, (a, b, most), rtol=1e-6, atol=1e-12):
        check_bodies(path)
    else:
        with pytest.raises(UserError, match="no body has principal moments"):
            check_bodies(path)


def test_bullet_computes_an_impossible_inertia_as_none(tmp_path):
    """What the refusal says of it."""
    pybullet = pytest.importorskip("pybullet")
    path = tmp_path / "impossible.urdf"
    path.write_text(GOOD.replace('iyy="0.33333"', 'iyy="9"'))
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(
        str(path), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client
    )
    assert pybullet.getDynamicsInfo(body, 0, physicsClientId=client)[2] == (0.0, 0.0, 0.0)
    pybullet.disconnect(client)


def test_only_bodies_that_move_in_the_case_need_an_inertia(tmp_path):
    path = tmp_path / "model.urdf"
    hand = WEIGHT.format(MASS.format(1) + '<inertia ixx="9" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>')
    path.write_text(
        GOOD.replace(
            "</robot>",
            f'<link name="hand">{hand}</link><joint name="wrist" type="continuous"><parent link="rod"/>'
            '<child link="hand"/><axis xyz="0 1 0"/></joint></robot>',
        )
    )
    for locked in ([], ["hinge"], ["wrist"]):  # locked to a rod that moves, the hand moves
        with pytest.raises(UserError, match="link 'hand': <inertia>"):
            check_bodies(path, locked)
    check_bodies(path, ["hinge", "wrist"])
    with pytest.raises(UserError, match="link 'hand'"):
        check_bodies(path, ["hinge", "wrist"], floating=True)


def test_links_without_mass_are_told_together_in_one_line(tmp_path, capfd):
    path = tmp_path / "model.urdf"
    more = [f'<link name="l{k}"/><joint name="j{k}" type="continuous"><parent link="rod"/><child link="l{k}"/></joint>'
            for k in range(6)]  # fmt: skip
    path.write_text(GOOD.replace("</robot>", "".join(more) + "</robot>"))
    with pytest.raises(UserError, match=r"link 'l0', 'l1', 'l2', 'l3' \.\.\.: moving links without mass and inertia"):
        check_urdf(path)
    path.write_text(path.read_text().replace('type="continuous"><parent link="rod"', 'type="fixed"><parent link="rod"'))
    multibody_plant(path, (0.0, 0.0, -9.81))
    assert capfd.readouterr() == ("", "")


def test_whole_ones_pass(tmp_path, root):
    (tmp_path / "model.urdf").write_text(GOOD)
    for path in (tmp_path / "model.urdf", *sorted((root / "configs/models").glob("*.urdf"))):
        check_urdf(path)
    with pytest.raises(UserError, match="does not exist"):
        check_urdf(tmp_path)


WEIGHT = "<inertial>{}</inertial>"
INERTIA = '<inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"/>'
MASS = '<mass value="{}"/>'


@pytest.mark.parametrize(
    "inside",
    ["", MASS.format(1), INERTIA.format(1), MASS.format(0) + INERTIA.format(1), MASS.format(1) + INERTIA.format(0)],
)
def test_a_root_that_floats_has_mass_and_inertia(tmp_path, inside):
    path = tmp_path / "model.urdf"
    root = f'<link name="base">{WEIGHT.format(inside)}</link>' if inside else '<link name="base"/>'
    path.write_text(GOOD.replace('<link name="base"/>', root))
    check_urdf(path)
    with pytest.raises(UserError, match=r"link 'base': <inertial>: .*Make the chassis the root"):
        check_floating_root(path)
    path.write_text(
        GOOD.replace(
            '<link name="base"/>', f'<link name="base">{WEIGHT.format(MASS.format(1) + INERTIA.format(1))}</link>'
        )
    )
    check_floating_root(path)


MESH = '<visual><geometry><mesh filename="NAME"/></geometry></visual>'


@pytest.mark.parametrize(
    ("name", "allowed"),
    [("rod.stl", True), ("../meshes/rod.stl", True), ("package://robot/meshes/rod.stl", True), ("../../rod.stl", False),
     ("/etc/passwd", False), ("file:///etc/passwd", False), ("package://robot/../../rod.stl", False),
     ("http://example.org/rod.stl", False), ("model://../rod", False)],
)  # fmt: skip
def test_files_that_a_model_names_lie_in_its_folders_unless_the_user_trusts_it(tmp_path, monkeypatch, name, allowed):
    folder = tmp_path / "package/urdf"
    folder.mkdir(parents=True)
    path = folder / "model.urdf"
    path.write_text(GOOD.replace("<inertial>", f"{MESH.replace('NAME', name)}<inertial>"))
    if not allowed:
        with pytest.raises(UserError, match="lies outside the model's folders"):
            check_urdf(path)
        monkeypatch.setenv("SIMGAP_TRUST_MODEL_FILES", "1")
    check_urdf(path)
