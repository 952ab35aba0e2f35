"""A command takes no result of another case: each is held against the keys that it rests on, whatever names agree."""

import os

import numpy as np
import pytest
import yaml

import simgap
from simgap.config.load import load_case
from simgap.config.run import load_rig
from simgap.errors import UserError
from simgap.extras import certify
from simgap.io.results import write_parquet
from simgap.plants.context import Context
from simgap.provenance import parts_of, provenance
from simgap.stages import audit, report, synthesis, trace, validation
from simgap.stages.gap_inputs import read_samples
from simgap.stages.rig import recording
from tests.stages import loop_example as example
from tests.stages import road


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    """Folder of results, and their case with another sampling time and another damping of the engine."""
    folder = tmp_path_factory.mktemp("made")
    case = example.pendulum(root, folder)
    content = yaml.safe_load(case.read_text())
    content["domain"]["tau"] = "0.0055 s"
    content["simulator"]["damping"] = {"linear": 0.9, "angular": 0.9}
    (folder / "edited.yaml").write_text(yaml.safe_dump(content))
    return folder, case, folder / "edited.yaml"


def commands(folder, case):
    gap, law, out = folder / "gap.json", folder / "gap/controller.npz", folder / "out"
    given = report.ReportFiles(**example.arguments(folder))
    files = audit.AuditFiles(gap, law, [], folder / "samples.parquet")
    to = audit.AuditOutputs(out / "a.json", out / "m.parquet", out / "w.json")
    nominal, traces = folder / "nominal/controller.npz", folder / "validation/traces.parquet"
    return {
        "certify": lambda: certify.run(case, gap, law, out),
        "synthesis": lambda: synthesis.run(case, gap, out / "c.npz", out / "s.json"),
        "validation": lambda: validation.run(case, nominal, law, gap, out / "v.json", out / "t.parquet"),
        "audit": lambda: audit.run(case, files, to),
        "trace": lambda: trace.run(case, nominal, law, traces, out / "t.rrd"),
        "report": lambda: report.run(case, given, out / "r.html", out / "r.json"),
        "load_gap": lambda: simgap.load_gap(gap, case),
    }


@pytest.mark.parametrize("name", ["certify", "synthesis", "validation", "audit", "trace", "report", "load_gap"])
def test_what_was_made_before_the_case_was_edited_is_refused_with_what_differs(made, name):
    folder, _, edited = made
    with pytest.raises(UserError, match=r"not of this case, which differs in domain\.tau") as told:
        commands(folder, edited)[name]()
    assert told.value.file.is_relative_to(folder)
    assert not (folder / "out").exists()


def test_what_was_made_of_it_is_taken(made):
    folder, case, _ = made
    assert simgap.load_gap(folder / "gap.json", case).domain.states == ("x1", "x2")


def test_a_controller_rests_on_what_its_bound_rests_on(made):
    """Its own stage reads of the simulator no more than its effects."""
    folder, case, _ = made
    content = yaml.safe_load(case.read_text())
    content["simulator"]["substeps"] = 3
    edited = folder / "substeps.yaml"
    edited.write_text(yaml.safe_dump(content))
    before, after = Context.load(case), Context.load(edited)
    gap_aware, nominal = (provenance("synthesis", before.case, folder, rests=rests) for rests in (("gap",), ()))
    after.own(folder / "n.npz", nominal, "synthesis")
    with pytest.raises(UserError, match=r"differs in simulator\.substeps"):
        after.own(folder / "r.npz", gap_aware, "synthesis")


def test_samples_of_another_case_or_stage_are_refused(made):
    folder, case, edited = made
    own, other = Context.load(case), Context.load(edited)
    x, u = np.zeros((3, 2)), own.input_set[:3]
    path = road.made_up(own, folder / "fresh.parquet", x, u, x, stage="fresh")
    assert len(read_samples(own, path, "fresh")["x1"]) == 3
    with pytest.raises(UserError, match=r"differs in domain\.tau, simulator\.damping"):
        read_samples(other, path, "fresh")
    with pytest.raises(UserError, match="not what `rollouts` makes, but `fresh`"):
        read_samples(own, path, "rollouts")
    with pytest.raises(UserError, match="not what `gap` makes"):
        own.own(path, {}, "gap")


def test_a_rig_of_another_simulator_is_not_taken_for_the_own_one(made, tmp_path):
    """What is found in recordings of the case's own simulator goes into the model alone."""
    folder, case, edited = made
    content = yaml.safe_load(edited.read_text()) | {"measured": {"rig": "simulator"}}
    content["domain"]["tau"] = yaml.safe_load(case.read_text())["domain"]["tau"]
    own, rig = folder / "rigged.yaml", folder / "rig.yaml"
    own.write_text(yaml.safe_dump(content))
    rig.write_text("case: case.yaml\ntraces: 1\nseconds: 1\nexcitation: {amplitude: 1.0}\nnoise: {x1: 0.001}\n")
    context, still = Context.load(case), np.zeros((200, 2))
    table = recording(context, load_rig(rig), 0, np.arange(200) * 0.005, still, still[:, :1], np.random.default_rng(0))
    write_parquet(tmp_path / "recordings.parquet", table)
    with pytest.raises(UserError, match=r"recordings\.parquet: not of this case, which differs in simulator\.damping"):
        simgap.diagnose(own, tmp_path / "recordings.parquet", tmp_path / "out")


FUNCTION = "import numpy as np\ndef step(x, u, tau):\n    return x\n"


def test_the_same_case_written_elsewhere_reads_the_same(vary, root, tmp_path):
    """A corrected case stands in another folder and names copies of the plug-ins; its name is another."""
    path = vary("pendulum", {"simulator": {"engine": "python", "function": "mine.py:step"}})
    (path.parent / "mine.py").write_text(FUNCTION)
    other = tmp_path / "below" / "moved.yaml"
    other.parent.mkdir()
    content = yaml.safe_load(path.read_text())
    content["simulator"]["function"] = "mine-0123.py:step"
    content["name"] = "another"
    content["plant"]["urdf"] = os.path.relpath(root / "configs/models/pendulum.urdf", other.parent)
    (other.parent / "mine-0123.py").write_text(FUNCTION)
    other.write_text(yaml.safe_dump(content))
    sections = ("plant", "domain", "simulator", "plant.urdf")
    one, two = (parts_of(load_case(p), sections, p.parent) for p in (path, other))
    assert one == two
    (other.parent / "mine-0123.py").write_text(FUNCTION + "# changed\n")
    assert {k for k, v in parts_of(load_case(other), sections, other.parent).items() if one[k] != v} == {
        "simulator.function"
    }
