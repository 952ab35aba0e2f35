"""What is hashed: sections that a stage reads, code that it reaches, plug-ins of the case, model files as bytes."""

import ast
from pathlib import Path

import pytest
import yaml

from simgap import plugins, provenance
from simgap.config.load import load_case
from simgap.config.named_files import named_by
from simgap.config.run import case_of_rig
from simgap.provenance import READS, closure, code_digest, sections_digest, versions

WHOLE = {"check", "diagnosis"}  # stages that read every key
ENGINE = """
from simgap.simulators.base import Engine
from simgap.config.simulator import EngineSection

class Still(Engine):
    Settings = EngineSection
    distributions = ("pyyaml",)

    @classmethod
    def build(cls, case, folder):
        return cls()

    def reset(self, x):
        self.x = x

    def advance(self, u):
        return self.x
"""


def reached(stage):
    return {"/".join(name.split(".")[-2:]) for name in closure(f"simgap.stages.{stage}")}


def used(case, stage):
    return {f"{group}: {name}" for group, name in provenance.plugins_of(stage, load_case(case))}


def test_code_that_a_stage_reaches():
    assert "games/invariance" in reached("synthesis")
    assert "simulators/supervision" in reached("rollouts")
    elsewhere = ("games/", "abstraction/", "synthesis/", "diagnosis/", "lipschitz/", "fitting/")
    assert not any(name.startswith(elsewhere) for name in reached("rollouts"))
    where_it_is_asked = {
        *("sampling/points", "memory/hidden_state", "memory/histories"),
        *("bounds/previous", "gap/thresholds", "gap/json_record", "gap/noise"),
    }
    of_the_gap = ("gap/", "sampling/", "memory/", "bounds/")
    assert {name for name in reached("rollouts") if name.startswith(of_the_gap)} <= where_it_is_asked
    assert {"fitting/scenario", "fitting/padding"} <= reached("scp")
    assert not {"fitting/scenario", "fitting/padding"} & reached("lipschitz")
    assert "lipschitz/estimates" in reached("lipschitz") - reached("scp") - reached("gap")
    assert not any(name.startswith("games/inv") for name in reached("gap"))


def test_the_closure_is_what_the_sources_say():
    """Against a walk of our own over the syntax trees, from one stage."""

    def place(name):
        base = provenance.PACKAGE.joinpath(*name.split(".")[1:])
        return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")

    def imports(name):
        names = []
        for node in ast.walk(ast.parse(place(name).read_text())):
            if isinstance(node, ast.Import):
                names += [a.name for a in node.names]
            elif isinstance(node, ast.ImportFrom):
                inner = [f"{node.module}.{a.name}" for a in node.names]
                names += [i if place(i).is_file() else node.module for i in inner]
        return [n for n in names if n.startswith("simgap.")]

    seen, todo = set(), ["simgap.stages.rollouts"]
    while todo:
        name = todo.pop()
        if name not in seen and name not in provenance.UNHASHED:
            seen.add(name)
            todo += imports(name)
    assert closure("simgap.stages.rollouts") == seen


def test_sections_are_narrow(vary):
    base = _digests(vary, {})
    # a check looks at the whole case, and the diagnosis copies it into the corrected one
    changed = _digests(vary, {"synthesis.cells": [10, 10]})
    assert {stage for stage in READS if base[stage] != changed[stage]} == {"synthesis", "certify", *WHOLE}
    changed = _digests(vary, {"validation.seed": 9})
    assert {stage for stage in READS if base[stage] != changed[stage]} == {"validation", *WHOLE}
    changed = _digests(vary, {"plant.integrator": "rk4"})
    assert not {"rollouts", "fresh", "rig"} & {stage for stage in READS if base[stage] != changed[stage]}


@pytest.mark.parametrize("place", ["rod", "rod/urdf", "rod/urdf/plain"])
def test_a_mesh_is_found_where_pybullet_looks_for_its_package(tmp_path, place):
    model, mesh = tmp_path / place / "rod.urdf", tmp_path / "rod/meshes/rod.obj"
    for path, content in ((model, '<robot><mesh filename="package://rod/meshes/rod.obj"/></robot>'), (mesh, "v 0 0 0")):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    assert mesh in [Path(found).resolve() for _, found in named_by(model)]


def test_meshes_of_a_model_are_part_of_what_was_made(vary, root, tmp_path):
    shape = '<collision><geometry><mesh filename="{}"/></geometry></collision></link>'
    text = (root / "configs/models/pendulum.urdf").read_text()
    (tmp_path / "package/models").mkdir(parents=True)
    model, mesh = tmp_path / "package/models/own.urdf", tmp_path / "package/rod.obj"
    for name in ("../rod.obj", "package://own/rod.obj"):
        model.write_text(text.replace("</link>", shape.format(name), 1))
        mesh.write_text("v 0 0 0\n")
        before = _digests(vary, {"plant.urdf": str(model)})
        mesh.write_text("v 0 0 1\n")
        after = _digests(vary, {"plant.urdf": str(model)})
        assert {"rollouts", "fresh", "borders"} <= {stage for stage in READS if before[stage] != after[stage]}


FRICTION = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.01}}]


@pytest.mark.parametrize(
    ("changes", "again"),
    [
        ({"gap.basis": ["x1", "u", 1]}, {"scp", "gap"}),
        ({"gap.objective": "eta"}, {"scp", "gap"}),
        ({"gap.padding": "paper"}, {"scp", "gap"}),  # inflate pads inside the program
        ({"gap.lipschitz": {"extreme_value": False}}, {"lipschitz", "gap"}),
        ({"gap.lipschitz": {"rough_limit": 0.2}}, {"gap"}),
        ({"gap.tolerated_probability": 0.01}, {"gap", "validation"}),
        ({"grid.eps": 0.1}, {"report"}),  # another point, whose files have other names
        ({"plant.integrator": "rk4"}, {"borders", "scp", "lipschitz", "gap"}),
        ({"domain.X.x1": [-0.1, 0.2]}, {"grid", "rollouts", "fresh", "borders", "scp", "lipschitz", "gap"}),
        ({"simulator.substeps": 2}, {"rollouts", "fresh", "borders", "gap"}),
        ({"simulator.effects": FRICTION}, {"rollouts", "fresh", "borders", "scp", "gap"}),
    ],
)
def test_each_stage_of_the_bound_reads_its_own_keys(vary, changes, again):
    road = {"grid", "rollouts", "fresh", "borders", "scp", "lipschitz", "gap", "validation", "report"}
    assert {stage for stage in road if _digests(vary, {})[stage] != _digests(vary, changes)[stage]} >= again
    bound = road - {"validation", "report"}
    assert {s for s in bound if _digests(vary, {})[s] != _digests(vary, changes)[s]} == again & bound


def test_which_padding_it_is_matters_to_the_program_where_it_is_inflate(vary):
    per_axis, paper = (_digests(vary, {"gap.padding": name}) for name in ("per_axis", "paper"))
    assert {stage for stage in READS if per_axis[stage] != paper[stage]} == {"gap", *WHOLE}


def _digests(vary, changes):
    path = vary("pendulum", changes)
    return {stage: sections_digest(load_case(path), read, path.parent) for stage, read in READS.items()}


def test_only_the_engine_of_the_case_counts(root):
    cases = root / "configs/cases"
    assert used(cases / "pendulum.yaml", "rollouts") == {"engines: pybullet"}
    assert used(cases / "pendulum_mujoco.yaml", "validation") == {"engines: mujoco", "specifications: invariance"}
    assert used(cases / "pendulum.yaml", "synthesis") == {"specifications: invariance"}
    assert "simgap.simulators.pybullet" not in closure("simgap.stages.rollouts")


def test_the_version_of_the_engine_is_recorded(root):
    cases = root / "configs/cases"
    with_mujoco = versions("rollouts", load_case(cases / "pendulum_mujoco.yaml"), cases)
    assert with_mujoco.keys() - versions("rollouts", load_case(cases / "pendulum.yaml"), cases).keys() == {"mujoco"}
    assert "mujoco" not in versions("synthesis", load_case(cases / "pendulum_mujoco.yaml"), cases)


def test_only_the_effects_of_the_case_count(vary):
    friction = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.1}}]
    assert "effects: coulomb_friction" not in used(vary("pendulum", {}), "rollouts")
    assert "effects: coulomb_friction" in used(vary("pendulum", {"simulator.effects": friction}), "rollouts")
    tried = used(vary("pendulum", {}), "diagnosis")
    assert {f"effects: {name}" for name in plugins.BUILT_IN["effects"]} <= tried


def test_another_engine_in_the_registry_changes_nothing(root, monkeypatch):
    path = root / "configs/cases/pendulum.yaml"
    before = code_digest("rollouts", load_case(path), path.parent)
    more = {"engines": {**plugins.BUILT_IN["engines"], "another": "simgap.simulators.pybullet:PyBulletWheeled"}}
    monkeypatch.setattr(plugins, "BUILT_IN", {**plugins.BUILT_IN, **more})
    assert code_digest("rollouts", load_case(path), path.parent) == before
    path = root / "configs/cases/pendulum_mujoco.yaml"
    assert code_digest("rollouts", load_case(path), path.parent) != before


@pytest.fixture
def own(vary):
    path = vary("pendulum", {})
    (path.parent / "still.py").write_text(ENGINE)
    content = yaml.safe_load(path.read_text())
    content["simulator"] = {"engine": "still.py:Still"}
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_file_beside_the_case_is_code_of_its_stages(own):
    def digests():
        return {s: code_digest(s, load_case(own), own.parent) for s in stages}

    stages = ("rollouts", "validation", "synthesis", "trace", "diagnosis")
    before = digests()
    (own.parent / "still.py").write_text(ENGINE + "# changed\n")
    after = digests()
    changed = {stage for stage in before if before[stage] != after[stage]}
    assert changed == {"rollouts", "validation", "diagnosis"}  # a corrected case takes a copy of the file along
    assert "pyyaml" in versions("rollouts", load_case(own), own.parent)


def test_what_a_file_imports_from_the_package_is_its_code(own):
    (own.parent / "still.py").write_text(ENGINE + "from simgap.simulators import joints\n")
    sources = provenance._sources("engines", "still.py:Still", own.parent)
    assert {"", "simgap.simulators.base", "simgap.simulators.joints"} <= set(sources)
    assert not list(own.parent.rglob("__pycache__"))


def test_over_hidden_states_the_bound_depends_on_its_engine(root):
    """How far a path strays between recorded poses is a method of the engine's settings, which stand in its file."""
    cases = root / "configs" / "cases"
    assert "engines: pybullet_wheeled" in used(cases / "turtlebot.yaml", "gap")
    assert not any(u.startswith("engines") for u in used(cases / "turtlebot.yaml", "synthesis"))


def test_a_rig_is_hashed_by_the_case_that_its_file_names(vary, tmp_path):
    """A rig of another case's simulator depends on that simulator, and not on the case that bears its name."""
    (tmp_path / "other").mkdir()
    moved = vary("pendulum", {"simulator.substeps": 7})
    moved.rename(tmp_path / "other" / "theirs.yaml")
    own = vary("pendulum", {})
    rig = tmp_path / "pendulum.yaml.rig"
    rig.write_text("case: other/theirs.yaml\nexcitation: {amplitude: 1.0}\nnoise: {x1: 0.001}\n")
    named = case_of_rig(rig)
    assert named == tmp_path / "other" / "theirs.yaml"
    digests = [sections_digest(load_case(p), READS["rig"], p.parent) for p in (named, own)]
    assert digests[0] != digests[1]
    rules = (Path(__file__).parents[1] / "rules" / "diagnosis.smk").read_text()
    assert "reads=rig_reads" in rules.partition("rule rig:")[2].partition("shell:")[0]
