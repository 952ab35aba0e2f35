"""Arms of three joints and more: numeric dynamics against Drake, what is found against what a rig was told."""

from __future__ import annotations

import html
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from simgap.diagnosis.arms.inertia import base_parameters, consistent
from simgap.errors import UserError
from simgap.io.urdf_file import with_inertial
from simgap.model.tree import forces, regressor, symmetric
from simgap.plants.plant_model import load_plant
from simgap.plants.urdf import load_tree, multibody_plant
from simgap.plants.urdf_checks import check_urdf
from simgap.stages import diagnosis as stage
from tests.diagnosis import arm_rig as rig

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "../shared/data/ur10e"
NOISE = 0.02  # N m, of each torque
VISCOUS = np.array([8.0, 6.5, 4.0, 1.2, 0.9, 0.6])
COULOMB = np.array([6.0, 7.0, 3.5, 1.1, 0.8, 0.5])
BIAS = np.array([0.0, 1.5, 0.0, -0.4, 0.0, 0.0])
HEAVIER = 1.3  # kg, in one of the recordings


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Four recordings of a six-joint arm, one with a weight, diagnosed as a person would: (diagnosis, folder)."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "rig.urdf").write_text(rig.urdf())
    (folder / "heavy.urdf").write_text(rig.urdf(extra=HEAVIER))
    rng = np.random.default_rng(5)
    for k, name in enumerate(("light_1", "heavy", "light_2", "light_3")):
        t, q, v, a = rig.motion(6, 16.0, 100.0, seed=k)
        model = folder / ("heavy.urdf" if name == "heavy" else "rig.urdf")
        u = rig.torques(model, q, v, a) + rig.rubbed(v, rig.Friction(VISCOUS, COULOMB, BIAS))
        u += NOISE * rng.normal(size=u.shape)
        rig.write_csv(folder / f"{name}.csv", t, q, v, u)
    measured = (
        "  files: [light_1.csv, heavy.csv, light_2.csv, light_3.csv]\n"
        "  payloads: [{file: heavy.csv, link: link6}]\n  max_effects: 4\n"
    )
    (folder / "case.yaml").write_text(rig.case(6, measured))
    return stage.run(folder / "case.yaml", [], folder / "found"), folder


def test_friction_of_every_joint_is_found(found):
    result, _ = found
    value = {(e["name"], e["on"]): next(iter(e["parameters"].values()))["value"] for e in result["effects"]}
    for k in range(6):
        assert value["viscous_friction", f"joint{k + 1}"] == pytest.approx(VISCOUS[k], rel=0.05)
        assert value["coulomb_friction", f"joint{k + 1}"] == pytest.approx(COULOMB[k], rel=0.05)
    biased = {on: v for (name, on), v in value.items() if name == "input_bias"}
    assert set(biased) >= {"torque2", "torque4"}
    assert biased["torque2"] == pytest.approx(1.5, rel=0.1)
    assert biased["torque4"] == pytest.approx(-0.4, rel=0.1)
    assert not {name for name, _ in value} & {"quadratic_drag", "reflected_inertia", "inertial_parameters"}
    assert result["verdict"] in ("attributed", "partial")
    before, after = (result["error"][w]["fit_rmse"] for w in ("before", "after"))
    assert all(after[u] < 0.1 * before[u] for u in before)


def test_the_weight_is_found_in_the_file_that_has_it(found):
    (payload,) = found[0]["payloads"]
    assert payload["traces"] == ["heavy"]
    assert payload["parameters"]["m"]["value"] == pytest.approx(HEAVIER, rel=0.05)


def test_all_files_are_written_and_the_folds_are_apart(found):
    result, folder = found
    written = {p.name for p in (folder / "found").iterdir()}
    assert written >= {"diagnosis.json", "report.html", "corrected_case.yaml", "error.svg", "torques-1.svg"}
    assert written >= {"residual.rrd", "transitions.parquet"}  # what the workflow waits for
    assert len(load_plant(folder / "found" / "corrected_case.yaml").effects) == len(result["effects"])
    assert json.loads((folder / "found" / "diagnosis.json").read_text())["sentence"] == result["sentence"]
    assert "joint6" in (folder / "found" / "report.html").read_text()
    folds = {name: set(fold["traces"]) for name, fold in result["folds"].items()}
    assert folds["confirm"] == {"light_3"}
    assert not folds["fit"] & folds["choose"]


def test_inverse_dynamics_are_those_of_drake(tmp_path):
    from pydrake.multibody.tree import MultibodyForces

    path = tmp_path / "rig.urdf"
    path.write_text(rig.urdf().replace('name="joint3" type="continuous"', 'name="joint3" type="prismatic"'))
    tree = load_tree(path)
    plant, names = multibody_plant(path, (0.0, 0.0, -9.81))
    assert list(tree.joints) == names
    context = plant.CreateDefaultContext()
    q, v, a = np.random.default_rng(0).normal(size=(3, 10, 6))
    mine = forces(tree, q, v, a)
    for k in range(10):
        plant.SetPositions(context, q[k])
        plant.SetVelocities(context, v[k])
        acting = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, acting)
        assert mine[k] == pytest.approx(plant.CalcInverseDynamics(context, a[k], acting), abs=1e-9)


def test_base_parameters_say_all_that_a_motion_shows(tmp_path):
    (tmp_path / "rig.urdf").write_text(rig.urdf())
    tree = load_tree(tmp_path / "rig.urdf")
    base = base_parameters(tree)
    q, v, a = np.random.default_rng(7).normal(size=(3, 50, 6))
    y = regressor(tree, q, v, a)
    some = np.random.default_rng(8).normal(size=60)  # any inertial parameters, of a body or not
    assert y[:, :, base.kept] @ (base.combine @ some) == pytest.approx(y @ some, abs=1e-8)
    assert np.linalg.matrix_rank(y.reshape(-1, 60)) == len(base.kept)
    assert base.names[0].startswith("link1.Izz + ")


def test_six_joints_load_at_once(found):
    began = time.process_time()
    plant = load_plant(found[1] / "case.yaml")
    assert len(plant.declared.coordinates) == 6
    assert time.process_time() - began < 10.0


def test_a_bound_of_an_arm_is_refused_with_the_remedy(tmp_path):
    (tmp_path / "rig.urdf").write_text(rig.urdf())
    text = rig.case(6, "  files: [a.csv]\n")
    sides = ", ".join(f"{x}{k}: [-1, 1]" for x in "qv" for k in range(1, 7))
    values = ", ".join(f"torque{k}: {{values: [0]}}" for k in range(1, 7))
    (tmp_path / "case.yaml").write_text(f"{text}domain: {{tau: 0.01, X: {{{sides}}}, U: {{{values}}}}}\n")
    with pytest.raises(UserError, match="6 joints") as error:
        _ = load_plant(tmp_path / "case.yaml").sampled
    assert "at most two joints" in str(error.value)


def test_an_undriven_joint_and_an_unknown_link_are_refused(found, tmp_path):
    folder = found[1]
    text = (folder / "case.yaml").read_text()
    for old, new, key in (
        ("    torque6: {unit: N*m, joint: joint6}\n", "", "plant.inputs"),
        ("link: link6", "link: tool", "measured.payloads.0.link"),
    ):
        path = folder / "mistake.yaml"
        path.write_text(text.replace(old, new))
        with pytest.raises(UserError) as error:
            stage.run(path, [], tmp_path / "out")
        assert error.value.key == key
    assert not (tmp_path / "out").exists()


def test_a_closed_chain_is_refused(tmp_path):
    again = '<joint name="back" type="continuous"><parent link="base"/><child link="link4"/></joint></robot>'
    (tmp_path / "rig.urdf").write_text(rig.urdf().replace("</robot>", again))
    with pytest.raises(UserError, match="'joint4' and 'back' both carry it: a closed chain") as error:
        check_urdf(tmp_path / "rig.urdf")
    assert "Open the chain" in str(error.value)


def possible(inertial):
    """Whether a body can have these parameters, (10,): its pseudo-inertia is positive semidefinite, up to rounding."""
    tensor, pseudo = symmetric(inertial[4:]), np.zeros((4, 4))
    pseudo[:3, :3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    pseudo[:3, 3] = pseudo[3, :3] = inertial[1:4]
    pseudo[3, 3] = inertial[0]
    return np.linalg.eigvalsh(pseudo)[0] >= -1e-9 * max(1.0, np.abs(pseudo).max())


def test_inertial_parameters_that_were_found_are_those_of_bodies_and_go_to_a_urdf(tmp_path):
    (tmp_path / "rig.urdf").write_text(rig.urdf())
    (tmp_path / "true.urdf").write_text(rig.urdf().replace('mass value="5.0"', 'mass value="6.5"'))
    tree, true = load_tree(tmp_path / "rig.urdf"), load_tree(tmp_path / "true.urdf")
    base = base_parameters(tree)
    seen = base.combine @ true.inertial.ravel()
    bodies = consistent(tree, base, seen, 1e6 * np.eye(len(seen)))
    assert bodies is not None
    assert bodies.distance < 1.0
    assert all(possible(p) for p in bodies.inertial)
    assert not possible(np.array([1.0, 0.5, 0, 0, 0.1, 0, 0, 0.1, 0, 0.1]))  # m c^2 alone is more than that
    inertial = dict(zip(tree.links, bodies.inertial, strict=True))
    (tmp_path / "found.urdf").write_text(with_inertial(tmp_path / "rig.urdf", tmp_path, inertial))
    again = load_tree(tmp_path / "found.urdf")
    assert again.inertial == pytest.approx(bodies.inertial, rel=1e-6, abs=1e-8)
    assert base.combine @ again.inertial.ravel() == pytest.approx(seen, abs=2e-3)


@pytest.mark.skipif(not RECORDS.is_dir(), reason="the real records are not beside the project")
def test_a_real_six_joint_arm(tmp_path):
    text = (ROOT / "configs" / "cases" / "ur10e.yaml").read_text()
    (tmp_path / "case.yaml").write_text(text.replace("../../../shared", str((ROOT / "../shared").resolve())))
    began = time.process_time()
    result = stage.run(tmp_path / "case.yaml", [], tmp_path / "out")
    assert time.process_time() - began < 60.0
    assert result["verdict"] == "partial"
    found = {(e["name"], e["on"]) for e in result["effects"]}
    for k in range(1, 7):
        assert {("viscous_friction", f"joint{k}"), ("coulomb_friction", f"joint{k}")} <= found
    moving = result["error"]["by_trace"]["free_5harm"]
    assert all(moving["after"][u] < 0.5 * moving["before"][u] for u in moving["before"])
    (payload,) = result["payloads"]
    assert payload["parameters"]["m"]["value"] == pytest.approx(2.805, rel=0.15)  # as its recorders published


def test_gains_of_the_drives_are_found_from_a_known_weight(tmp_path):
    """Recorded torques are the true ones over (true gain / declared gain), which the fit is not told."""
    ratio, b, f = np.array([0.9, 1.12, 0.85]), np.array([3.0, 5.0, 2.0]), np.array([2.0, 4.0, 1.5])
    (tmp_path / "rig.urdf").write_text(rig.urdf(3))
    (tmp_path / "heavy.urdf").write_text(rig.urdf(3, extra=4.0))
    rng = np.random.default_rng(6)
    for k, name in enumerate(("light_1", "heavy", "light_2", "light_3")):
        t, q, v, a = rig.motion(3, 16.0, 100.0, seed=10 + k)
        u = rig.torques(tmp_path / ("heavy.urdf" if name == "heavy" else "rig.urdf"), q, v, a)
        u = (u + rig.rubbed(v, rig.Friction(b, f, np.zeros(3)))) / ratio + NOISE * rng.normal(size=u.shape)
        rig.write_csv(tmp_path / f"{name}.csv", t, q, v, u)
    measured = (
        "  files: [light_1.csv, heavy.csv, light_2.csv, light_3.csv]\n"
        "  payloads: [{file: heavy.csv, link: link3, mass: 4.0}]\n  max_effects: 4\n"
    )
    (tmp_path / "case.yaml").write_text(rig.case(3, measured))
    result = stage.run(tmp_path / "case.yaml", [], tmp_path / "found")
    value = {(e["name"], e["on"]): next(iter(e["parameters"].values()))["value"] for e in result["effects"]}
    for k in range(3):
        assert value["input_gain", f"torque{k + 1}"] == pytest.approx(ratio[k], rel=0.05)
        assert value["viscous_friction", f"joint{k + 1}"] == pytest.approx(b[k], rel=0.05)
        assert value["coulomb_friction", f"joint{k + 1}"] == pytest.approx(f[k], rel=0.05)
    assert result["verdict"] in ("attributed", "partial")
    assert len(load_plant(tmp_path / "found" / "corrected_case.yaml").effects) == len(value) - sum(
        name == "inertial_parameters" for name, _ in value
    )


RUBBED = rig.Friction(np.array([3.0, 5.0, 2.0]), np.array([2.0, 4.0, 1.5]), np.zeros(3))


@pytest.fixture(scope="module")
def plain():
    """Four recordings of a three-joint arm with friction, the second with 4 kg more: name -> (t, q, v, torques)."""
    with tempfile.TemporaryDirectory() as name:
        folder, rng = Path(name), np.random.default_rng(3)
        (folder / "rig.urdf").write_text(rig.urdf(3))
        (folder / "heavy.urdf").write_text(rig.urdf(3, extra=4.0))
        out = {}
        for k, trace in enumerate(("light_1", "heavy", "light_2", "light_3", "light_4")):
            t, q, v, a = rig.motion(3, 16.0, 100.0, seed=10 + k)
            u = rig.torques(folder / ("heavy.urdf" if trace == "heavy" else "rig.urdf"), q, v, a)
            out[trace] = t, q, v, u + rig.rubbed(v, RUBBED) + NOISE * rng.normal(size=u.shape)
    return out


LIGHT = ("light_1", "light_2", "light_3", "light_4")


def diagnosed(folder, plain, order, change=lambda u: u, more=""):
    """What is found in these recordings in that order, their torques changed."""
    (folder / "rig.urdf").write_text(rig.urdf(3))
    for trace in order:
        t, q, v, u = plain[trace]
        rig.write_csv(folder / f"{trace}.csv", t, q, v, change(u))
    files = ", ".join(f"{trace}.csv" for trace in order)
    (folder / "case.yaml").write_text(rig.case(3, f"  files: [{files}]\n  max_effects: 4\n{more}"))
    return stage.run(folder / "case.yaml", [], folder / "found")


CARRIES = "  payloads: [{file: heavy.csv, link: link3}]\n"


@pytest.mark.parametrize(
    "order", [("light_1", "light_2", "light_3", "heavy"), ("light_1", "light_2", "heavy", "light_3")]
)
def test_a_payload_is_found_wherever_its_file_stands(tmp_path, plain, order):
    result = diagnosed(tmp_path, plain, order, more=f"{CARRIES}  budget_s: 100\n")
    assert result["payloads"][0]["parameters"]["m"]["value"] == pytest.approx(4.0, rel=0.01)
    assert "heavy" in result["folds"]["fit"]["traces"]
    assert result["verdict"] == "attributed"


def test_a_budget_too_small_for_an_arm_is_refused(tmp_path, plain):
    with pytest.raises(UserError, match="nothing was judged in that time"):
        diagnosed(tmp_path, plain, LIGHT, more="  budget_s: 0.01\n")


def test_two_payloads_of_one_link_have_a_mass_each(tmp_path, plain):
    two = "  payloads: [{file: heavy.csv, link: link3}, {file: light_2.csv, link: link3}]\n"
    result = diagnosed(tmp_path, plain, ("light_1", "heavy", "light_2", "light_3"), more=two)
    assert [p["parameters"]["m"]["value"] for p in result["payloads"]] == pytest.approx([4.0, 0.0], abs=0.04)


def test_a_payload_that_nothing_fitted_carries_is_refused(tmp_path, plain):
    loads = ", ".join(f"{{file: {x}.csv, link: link3}}" for x in ("light_1", "heavy", "light_2"))
    with pytest.raises(UserError, match="no fitted trace carries the payload of 'link3'") as error:
        diagnosed(tmp_path, plain, ("light_1", "heavy", "light_2"), more=f"  payloads: [{loads}]\n")
    assert error.value.key == "measured.held_out"


def test_a_wrong_mass_alone_goes_to_a_urdf_and_names_no_rotor(tmp_path):
    true = tmp_path / "true.urdf"
    true.write_text(rig.urdf(3).replace('mass value="8.0"', 'mass value="11.0"'))
    rng, records = np.random.default_rng(3), {}
    for k, trace in enumerate(LIGHT):
        t, q, v, a = rig.motion(3, 16.0, 100.0, seed=10 + k)
        u = rig.torques(true, q, v, a)
        records[trace] = t, q, v, u + NOISE * rng.normal(size=u.shape)
    result = diagnosed(tmp_path, records, LIGHT)
    assert {e["name"] for e in result["effects"]} == {"inertial_parameters"}
    assert result["verdict"] in ("attributed", "partial")
    assert " explain " in result["sentence"]
    text = (tmp_path / "found" / "corrected_case.yaml").read_text()
    assert "Nothing was added" not in text
    assert "urdf: corrected.urdf" in text
    corrected = load_tree(tmp_path / "found" / "corrected.urdf")
    base = base_parameters(load_tree(true))
    seen, real = (base.combine @ x.inertial.ravel() for x in (corrected, load_tree(true)))
    assert seen == pytest.approx(real, abs=0.02)


@pytest.mark.parametrize(
    ("change", "fault", "channel", "left"),
    [
        (lambda u: u * [1.0, 1.0, -1.0], "wrong_sign", "torque3", {1, 2}),
        (lambda u: u[:, [0, 2, 1]], "swapped_columns", "torque2, torque3", {1}),
        (lambda u: u * [1.0, 1.0, 0.0], "constant", "torque3", {1, 2}),
    ],
)
def test_a_faulty_torque_column_is_a_finding_and_nothing_is_named_on_its_joint(
    tmp_path, plain, change, fault, channel, left
):
    result = diagnosed(tmp_path, plain, LIGHT, change)
    (found,) = result["recording"]
    assert (found["fault"], found["channel"]) == (fault, channel)
    assert found["remedy"] in result["sentence"]
    assert found["remedy"] in html.unescape((tmp_path / "found" / "report.html").read_text())
    named = {(e["name"], e["on"]) for e in result["effects"]}
    assert named == {(f, f"joint{k}") for k in left for f in ("viscous_friction", "coulomb_friction")}
    assert result["verdict"] == "attributed"  # of the other joints


def test_a_torque_in_another_scale_is_warned_of(tmp_path, plain):
    result = diagnosed(tmp_path, plain, LIGHT, lambda u: u * [1.0, 1.5, 1.0])
    (said,) = [w for w in result["warnings"] if "times what the declared arm needs" in w]
    assert "torque2 is 1.5 times" in said
    assert diagnosed(tmp_path, plain, LIGHT)["warnings"] == []


@pytest.mark.parametrize("joint", [2, 3])
def test_one_drive_with_another_gain_is_named_and_no_bias_in_its_place(tmp_path, plain, joint):
    """The record shows 1.5 times the torque: the drive gives 1/1.5 of what it is declared to."""
    scale = np.where(np.arange(3) == joint - 1, 1.5, 1.0)
    result = diagnosed(tmp_path, plain, LIGHT, lambda u: u * scale)
    value = {(e["name"], e["on"]): next(iter(e["parameters"].values())) for e in result["effects"]}
    assert value["input_gain", f"torque{joint}"]["value"] == pytest.approx(1 / 1.5, rel=0.01)
    friction = {(f, f"joint{k}") for k in (1, 2, 3) for f in ("viscous_friction", "coulomb_friction")}
    assert set(value) == friction | {("input_gain", f"torque{joint}")}
    for k in range(3):
        assert value["viscous_friction", f"joint{k + 1}"]["value"] == pytest.approx(RUBBED.viscous[k], rel=0.02)
        assert value["coulomb_friction", f"joint{k + 1}"]["value"] == pytest.approx(RUBBED.coulomb[k], rel=0.02)
    assert result["verdict"] == "attributed"
    assert any("relative to the declared masses" in w for w in result["warnings"])


def test_an_arm_at_rest_is_refused(tmp_path, plain):
    still = {n: (t, 0 * q + q[0], 0 * v, u) for n, (t, q, v, u) in plain.items()}
    with pytest.raises(UserError, match="no joint moves in any recording"):
        diagnosed(tmp_path, still, LIGHT)
