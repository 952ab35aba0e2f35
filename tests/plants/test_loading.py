"""Whatever an engine has against a model file is one line with the file, and what in it."""

import ast
import json
from pathlib import Path

import pytest

from simgap.errors import UserError
from simgap.plants import urdf
from simgap.plants.model_file import read_model_file
from simgap.plants.urdf import multibody_plant
from simgap.plants.urdf_checks import check_urdf, loading

PACKAGE = Path(__file__).parents[2] / "simgap"
LOADERS = {"AddModels", "loadURDF", "from_xml_path", "from_xml_string", "from_file"}
WEIGHT = """<inertial><origin xyz="0 0 -0.5"/><mass value="1"/>
  <inertia ixx="0.3" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.01"/></inertial>"""


def link(name, more=""):
    return f'<link name="{name}">{WEIGHT if name != "base" else ""}{more}</link>'


def joint(name, parent, child, more="", kind="continuous"):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 1 0"/>{more}</joint>'


def written(folder, *parts):
    path = folder / "robot.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="r">{"".join(parts)}</robot>')
    return path


HINGED = (link("base"), link("rod"), joint("hinge", "base", "rod"))


@pytest.mark.parametrize("ring", ["b", "bc", "bcd"])
def test_a_ring_beside_a_free_root_is_told_with_its_links(tmp_path, ring):
    """Every link hangs on one joint, and none of the ring on the root."""
    beside = [link(n) for n in ring]
    beside += [joint(f"j{n}", n, ring[(k + 1) % len(ring)]) for k, n in enumerate(ring)]
    path = written(tmp_path, *HINGED, *beside)
    for call in (check_urdf, read_model_file):
        with pytest.raises(UserError, match=r"its chain leads back to it: 'b'.* hang on each other") as told:
            call(path)
        assert told.value.file == path


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ((joint("j", "rod", "tip", '<mimic joint="nowhere"/>'), link("tip")), "'nowhere' which does not exist"),
        ((joint("j", "rod", "tip", '<mimic joint="j"/>'), link("tip")), "cannot mimic themselves"),
        ((joint("j", "rod", "tip", kind="wobbly"), link("tip")), "unrecognized type: 'wobbly'"),
        ((joint("j", "rod", "tip", kind="planar"), link("tip")), "joint 'j' is of type planar"),
        ((joint("j", "rod", "tip", kind="floating"), link("tip")), "is of type quaternion_floating"),
    ],
    ids=["mimics nothing", "mimics itself", "no kind", "planar", "floating"],
)
def test_what_drake_refuses_is_one_line(tmp_path, parts, told):
    path = written(tmp_path, *HINGED, *parts)
    check_urdf(path)
    with pytest.raises(UserError, match=told) as caught:
        multibody_plant(path, (0.0, 0.0, -9.81))
    assert caught.value.file == path


def test_a_loop_that_no_check_saw_is_still_one_line(tmp_path):
    """Drake finds it when all bodies are there, after the file was read."""
    ring = [link(n) for n in "bcd"] + [joint(f"j{a}", a, b) for a, b in ("bc", "cd", "db")]
    path = written(tmp_path, *HINGED, *ring)
    with pytest.raises(UserError, match=r"Drake does not take it: The bodies and joints .* form one or more loops"):
        multibody_plant(path, (0.0, 0.0, -9.81))


def test_pybullet_says_nothing_and_the_missing_mesh_is_told(tmp_path):
    p = pytest.importorskip("pybullet")
    shape = '<collision><geometry><mesh filename="none.stl"/></geometry></collision>'
    path = written(tmp_path, link("base"), link("rod", shape), joint("hinge", "base", "rod"))
    client = p.connect(p.DIRECT)
    try:
        told = r"PyBullet does not take it: Cannot load URDF file; there is no none\.stl"
        with pytest.raises(UserError, match=told), loading("PyBullet", path):
            p.loadURDF(str(path), physicsClientId=client)
    finally:
        p.disconnect(client)


def test_every_load_goes_through_the_one_wrapper():
    found = []
    for source in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(source.read_text())
        inside = [
            node
            for block in ast.walk(tree)
            if isinstance(block, ast.With) and any("loading(" in ast.unparse(i.context_expr) for i in block.items)
            for node in ast.walk(block)
        ]
        for node in ast.walk(tree):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            if node.func.attr in LOADERS or (node.func.attr == "Finalize" and not node.args):
                found.append(node.func.attr)
                assert node in inside, f"{source.name}:{node.lineno}"
    assert len(found) >= 8


def test_drake_reads_a_file_once_and_a_changed_one_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = written(tmp_path, *HINGED)
    first = urdf.mechanism(path)
    assert first["bodies"]["rod"]["m"] == 1.0
    with monkeypatch.context() as only:
        only.setattr(urdf, "multibody_plant", lambda *_: pytest.fail("Drake was asked again"))
        again = urdf.mechanism(path)
        assert json.dumps(again) == json.dumps(first)
    path.write_text(path.read_text().replace('mass value="1"', 'mass value="2"'))
    assert urdf.mechanism(path)["bodies"]["rod"]["m"] == 2.0
