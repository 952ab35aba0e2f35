"""MJCF as the simulator: as the file has it, its differences told, what would mislead refused, edits seen by hashes."""

import copy
import json

import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.model.symbolic import symbol
from simgap.provenance import sections_digest, sections_of
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import check, fresh
from tests.stages import road

pytest.importorskip("mujoco")

from simgap.simulators import mjcf
from simgap.simulators.findings import mjcf_findings, mjcf_switches

TAU, G = 0.005, 9.81
ROD = """<mujoco><compiler angle="radian"/>{head}<option timestep="{step}" {option}/>
<worldbody>{world}<body name="stick"><joint name="hinge" type="{type}" axis="0 1 0" {joint}/>{geom}
<inertial pos="0 0 -0.5" mass="{mass}" diaginertia="0.08333333333333333 0.08333333333333333 1e-6"/></body>{more}
</worldbody>{tail}</mujoco>"""
PLAIN = {"head": "", "step": TAU, "option": "", "world": "", "type": "hinge", "joint": "", "geom": "", "mass": 1,
         "more": "", "tail": ""}  # fmt: skip
ARM = '<body name="arm"><joint name="other"/><geom size="0.1"/></body>'
CART_POLE = """<mujoco><compiler angle="radian" meshdir="m"/><option timestep="0.004" integrator="RK4"/><worldbody>
<body name="trolley"><joint name="rail" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body name="stick"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 1" mass="0.1" diaginertia="0.0005 0.0005 0.0001"/></body></body></worldbody>
<actuator><motor joint="rail"/></actuator></mujoco>"""


@pytest.fixture
def rod(vary, tmp_path):
    """rod({"joint": 'damping="0.1"'}, {"domain.tau": ...}) -> the pendulum's case with such an MJCF file."""

    def make(file=(), case=()):
        (tmp_path / "rod.xml").write_text(ROD.format(**{**PLAIN, **dict(file)}))
        return vary("pendulum", {"simulator": {"engine": "mujoco", "mjcf": "rod.xml"}, **dict(case)})

    return make


def by_hand(x, u, friction=0.0, damping=0.0, steps=1):
    """The rod of 1 kg and 1 m, in semi-implicit steps that take a damping at their end, as MuJoCo's Euler does."""
    q, v, h = x[:, 0].copy(), x[:, 1].copy(), TAU / steps
    for _ in range(steps):
        v = (v + h * 3.0 * (-0.5 * G * np.sin(q) + u[:, 0] - friction * np.sign(v))) / (1.0 + h * 3.0 * damping)
        q = q + h * v
    return np.stack([q, v], axis=1)


def simulate(path, x, u):
    ((out, _),) = run_in_processes(roll_out, [(load_case(path), path.parent, x, u)])
    return out


def samples(n=300):
    rng = np.random.default_rng(0)
    return np.stack([rng.uniform(-0.2, 0.2, n), rng.uniform(-0.5, 0.5, n)], axis=1), rng.uniform(-1.2, 1.2, (n, 1))


def test_the_file_is_what_is_simulated_with_the_effects_of_the_case_on_top(rod):
    x, u = samples()
    assert np.abs(simulate(rod(), x, u) - by_hand(x, u)).max() < 1e-8
    damped = rod({"joint": 'damping="0.3"', "tail": '<actuator><motor name="m" joint="hinge"/></actuator>'})
    assert np.abs(simulate(damped, x, u) - by_hand(x, u, damping=0.3)).max() < 1e-8
    effect = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.1}}]
    rubbing = rod({"joint": 'damping="0.3"'}, {"simulator.effects": effect, "simulator.substeps": 4})
    assert np.abs(simulate(rubbing, x, u) - by_hand(x, u, 0.1, 0.3, steps=4)).max() < 1e-8


def test_commands_that_come_late_are_late_with_an_mjcf_file_too(rod):
    late = [{"name": "input_delay", "on": "u", "parameters": {"delay": TAU}}]  # a whole sample: u has not come yet
    x, u = samples(50)
    fast = simulate(rod({}, {"simulator.effects": late, "simulator.substeps": 5}), x, u)
    assert fast.shape == x.shape
    assert np.abs(fast - by_hand(x, u, steps=5)).max() > 1e-3


def test_a_pendulum_goes_from_its_mjcf_file_to_a_bound(rod, tmp_path):
    grid = {"half_widths": {"x1": 0.04, "x2": 0.1}, "shards": 1}
    inputs = {"u": {"min": -1, "max": 1, "step": 1}}
    changes = {"grid": grid, "domain.U": inputs, "gap.fresh_samples": 200, "gap.basis": ["sin(x1)", "x2", "u", 1]}
    path = rod({"joint": 'damping="0.2"'}, {**changes, "plant.integrator": "semi_implicit_euler"})
    checked = check.run(path)
    assert [f.problem for f in checked.findings] == ["the file damps it by 0.2, the nominal model has 0"]
    assert checked.compared
    shards = road.roll_out(path, tmp_path)
    fresh.run(path, tmp_path / "fresh.parquet")
    road.bound(path, tmp_path, shards, tmp_path / "fresh.parquet", tmp_path / "gap.json")
    found = json.loads((tmp_path / "gap.json").read_text())
    assert found["fresh"]["violations"] == 0
    largest = found["dimensions"][1]["largest_sampled_gap"]
    assert 0.9 < largest / (TAU * 3 * 0.2 * 0.4) < 1.1  # what damping takes where a cell is fastest


def test_a_cart_pole_in_mjcf_is_the_one_of_the_urdf(vary, tmp_path):
    (tmp_path / "cp.xml").write_text(CART_POLE)
    path = vary("cart_pole", {"simulator": {"engine": "mujoco", "mjcf": "cp.xml", "substeps": 25}})
    case = load_case(path)
    found = mjcf_findings(case, tmp_path)
    assert [f.problem for f in found] == ["it integrates by rk4, as its <option> says"]
    rng = np.random.default_rng(1)
    x, u = rng.uniform(-0.2, 0.2, (30, 4)), rng.uniform(-5, 5, (30, 1))
    exact = check.Context.load(vary("cart_pole", {"plant.integrator": "rk4"})).plant.sampled.step(x, u)
    assert np.abs(run_in_processes(roll_out, [(case, tmp_path, x, u)])[0][0] - exact).max() < 1e-4


FOUND = [
    ({"joint": 'damping="0.1"'}, {}, "joint 'hinge'", "the file damps it by 0.1"),
    ({"joint": 'frictionloss="0.05"'}, {}, "joint 'hinge'", "dry friction of 0.05"),
    ({"joint": 'armature="0.02"'}, {}, "joint 'hinge'", "an armature of 0.02"),
    ({"joint": 'stiffness="2"'}, {}, "joint 'hinge'", "a spring of 2"),
    ({"mass": 1.2}, {}, "joint 'hinge'", "it moves 1.2 kg in the file, 1 kg in the plant's URDF"),
    ({"joint": 'ref="0.3"'}, {}, "joint 'hinge'", "gravity pulls it by"),
    ({"joint": 'range="-0.1 1" limited="true"'}, {}, "domain.X.x1", "the engine stops it"),
    ({"step": 0.001}, {}, "simulator.substeps", "the file steps by 0.001 s"),
    ({"option": 'gravity="0 0 -1.62"'}, {}, "simulator.mjcf", "its gravity is (0, 0, -1.62)"),
    ({"option": 'integrator="implicitfast"'}, {}, "simulator.mjcf", "integrates by implicitfast"),
    ({"option": 'density="1.2"', "geom": '<geom size="0.1"/>'}, {}, "simulator.mjcf", "a medium"),
    ({"head": '<option><flag gravity="disable"/></option>'}, {}, "simulator.mjcf", "switches off: gravity"),
    (
        {"world": '<geom name="floor" type="plane" size="1 1 1" pos="0 0 -1"/>',
         "geom": '<geom name="bob" size="0.1" pos="0 0 -1"/>'},
        {}, "simulator.mjcf", "geom 'floor' and geom 'bob' touch at x1 = 0",
    ),
    ({"tail": '<actuator><motor name="m" joint="hinge" gear="5"/></actuator>'}, {}, "actuator 'm'", "5 of a command"),
    (
        {"tail": '<actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator>'},
        {}, "domain.U.u", "is limited to 1,",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("file", "case", "key", "words"), FOUND, ids=[f[3] for f in FOUND])
def test_what_differs_from_the_nominal_model_is_told(rod, tmp_path, file, case, key, words):
    found = mjcf_findings(load_case(rod(file, case)), tmp_path)
    assert any(f.key == key and words in f.problem for f in found), found


def test_effects_of_the_case_make_up_for_what_the_file_has(rod, tmp_path):
    rubbing = {"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.05}}
    path = rod({"joint": 'frictionloss="0.05"'}, {"plant.effects": [rubbing]})
    assert mjcf_findings(load_case(path), tmp_path) == []


REFUSED = [
    ({"type": "ball"}, {}, "more than one degree of freedom"),
    ({"more": '<body><freejoint name="free"/><geom size="1"/></body>'}, {}, "more than one degree of freedom"),
    ({"more": ARM}, {}, "no state of the case is its position"),
    ({"tail": '<actuator><position name="servo" joint="hinge" kp="9"/></actuator>'}, {}, "actuator 'servo': it works"),
    ({"tail": '<actuator><velocity name="servo" joint="hinge" kv="9"/></actuator>'}, {}, "actuator 'servo': it works"),
    (
        {"tail": '<actuator><general joint="hinge" dyntype="filter" dynprm="1"/></actuator>'},
        {}, "has 1 states, as of an actuator's filter",
    ),
    (
        {"tail": '<actuator><motor joint="hinge" ctrlrange="-1 1" armature="0.5"/></actuator>'},
        {}, "compared with nothing",
    ),
    (
        {"tail": '<tendon><fixed limited="true" range="-0.1 0.1"><joint joint="hinge" coef="1"/></fixed></tendon>'},
        {}, "compared with nothing",
    ),
    ({"type": "slide"}, {}, r"plant.states.x1.unit"),
    ({"head": '<asset><mesh name="x" file="no.stl"/></asset>', "geom": '<geom type="mesh" mesh="x"/>'}, {}, "no.stl"),
    ({"head": '<include file="no.xml"/>'}, {}, "no.xml"),
    ({"head": "<nonsense/>"}, {}, "nonsense"),
]  # fmt: skip


@pytest.mark.parametrize(("file", "case", "words"), REFUSED, ids=[f"{k}-{r[2]}" for k, r in enumerate(REFUSED)])
def test_what_would_mislead_is_refused_in_one_line(rod, tmp_path, file, case, words):
    with pytest.raises(UserError) as caught:
        mjcf.check_mjcf(load_case(rod(file, case)), tmp_path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["damping", "integrator", "urdf"])
def test_a_key_that_the_file_decides_is_refused_beside_it(rod, key):
    value = {"damping": {"joint": 0.1}, "integrator": "euler", "urdf": "other.urdf"}[key]
    with pytest.raises(UserError, match=f"with mjcf, {key} would replace"):
        load_case(rod({}, {f"simulator.{key}": value}))


def test_a_urdf_and_a_missing_file_are_told(rod, tmp_path, root):
    path = rod()
    (tmp_path / "rod.xml").write_text((root / "configs/models/pendulum.urdf").read_text())
    with pytest.raises(UserError, match=r"rod\.xml.*<robot>, not <mujoco>.*simulator\.urdf"):
        mjcf.check_mjcf(load_case(path), tmp_path)
    (tmp_path / "rod.xml").unlink()
    with pytest.raises(UserError, match=r"rod\.xml: simulator\.mjcf: the model file does not exist"):
        mjcf.check_mjcf(load_case(path), tmp_path)


def test_a_joint_that_the_file_lacks_lists_those_there_are(rod, tmp_path):
    path = rod()
    (tmp_path / "rod.xml").write_text(ROD.format(**PLAIN).replace('"hinge" type', '"swivel" type'))
    with pytest.raises(UserError, match=r"has no moving joint 'hinge'\. Moving joints: swivel"):
        mjcf.check_mjcf(load_case(path), tmp_path)


def test_edits_of_what_the_file_includes_are_seen(rod, tmp_path):
    case = tmp_path / "c"
    case.mkdir()
    path = rod({"head": '<include file="../parts/option.xml"/>'}).rename(case / "pendulum.yaml")
    (tmp_path / "rod.xml").rename(case / "rod.xml")
    (tmp_path / "parts").mkdir()
    outer, inner = tmp_path / "parts/option.xml", tmp_path / "parts/more.xml"
    outer.write_text('<mujoco><include file="more.xml"/></mujoco>')
    inner.write_text('<mujoco><option integrator="RK4"/></mujoco>')
    loaded = load_case(path)
    model = mjcf.check_mjcf(loaded, case)
    assert model.opt.integrator == 1

    def digests():
        return [
            sections_digest(loaded, sections_of(s, loaded), case) for s in ("rollouts", "scp", "validation", "grid")
        ]

    before = digests()
    inner.write_text('<mujoco><option integrator="Euler"/></mujoco>')
    after = digests()
    assert [a == b for a, b in zip(before, after, strict=True)] == [False, False, False, True]
    (case / "rod.xml").write_text(ROD.format(**{**PLAIN, "head": '<include file="../../parts/option.xml"/>'}))
    (tmp_path.parent / "parts").mkdir(exist_ok=True)
    (tmp_path.parent / "parts/option.xml").write_text("<mujoco/>")
    with pytest.raises(UserError, match="lies outside the model's folders"):
        mjcf.check_mjcf(loaded, case)


def test_cases_without_mjcf_are_hashed_as_before(vary):
    section = load_case(vary("pendulum", {"simulator": {"engine": "mujoco"}})).simulator
    assert "mjcf" not in section.model_dump()
    assert "simulator.mjcf" not in sections_of("scp", load_case(vary("pendulum", {})))


def test_stops_and_dry_friction_of_the_file_are_where_the_gap_is_sampled_on_both_sides(rod, tmp_path):
    path = rod({"joint": 'frictionloss="0.05" range="-0.1 1" limited="true"'})
    found = mjcf_switches(load_case(path), tmp_path)
    assert {str(e) for e in found} == {str(symbol("x2")), str(symbol("x1") + 0.1), str(symbol("x1") - 1.0)}
    from simgap.gap.sampling.borders import switching_surfaces

    assert set(found) <= set(switching_surfaces(check.Context.load(path)))


def test_a_plant_in_equations_takes_its_joints_from_the_file(rod, tmp_path):
    content = yaml.safe_load(rod().read_text())
    plant = copy.deepcopy(content["plant"])
    del plant["urdf"]
    rates = {"x1": "x2", "x2": "3*(u - 4.905*sin(x1))"}
    plant["symbolic"] = {"dynamics": rates}
    path = tmp_path / "pendulum.yaml"
    path.write_text(yaml.safe_dump({**content, "plant": plant}, sort_keys=False))
    x, u = samples(50)
    assert np.abs(simulate(path, x, u) - by_hand(x, u)).max() < 1e-8
    driven = plant["inputs"]["u"].pop("joint")
    path.write_text(yaml.safe_dump({**content, "plant": plant}, sort_keys=False))
    with pytest.raises(UserError, match=r"plant\.inputs\.u: the file does not know it"):  # it would push nothing
        mjcf.check_mjcf(load_case(path), tmp_path)
    plant["inputs"]["u"]["joint"] = driven
    for state in plant["states"].values():
        del state["joint"]
    path.write_text(yaml.safe_dump({**content, "plant": plant}, sort_keys=False))
    with pytest.raises(UserError, match=r"joint 'hinge': it moves, and no state of the case is its position"):
        mjcf.check_mjcf(load_case(path), tmp_path)
