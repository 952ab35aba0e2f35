"""The trace stage on both kinds of case, from the command line as well."""

from dataclasses import replace

import pytest

from simgap.cli import main
from simgap.io.rerun.recording import JointScene, PlanarScene, viewed
from simgap.plants.context import Context
from simgap.provenance import READS, sections_digest
from simgap.report.scene import scene
from tests.io.recorded import read_curves
from tests.stages import loop_example as example


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    return folder, example.robot(folder)


def command(folder, case, *more):
    return ["trace", str(case), "--nominal", str(folder / "nominal/controller.npz"), "--gap-aware",
            str(folder / "gap/controller.npz"), "--traces", str(folder / "validation/traces.parquet"),
            "--out", str(folder / "trace.rrd"), *more]  # fmt: skip


def test_robot_by_the_command_line(robot):
    folder, case = robot
    with pytest.raises(SystemExit) as exit_:
        main(command(folder, case, "--log", str(folder / "trace.log")))
    assert exit_.value.code == 0
    assert "recorded 8 runs" in (folder / "trace.log").read_text()
    curves = read_curves(folder / "trace.rrd")
    states = {f"runs/gap-aware/simulator/run-0/state/{n}" for n in ("x", "y", "heading")}
    assert states <= set(curves)


def test_the_scene_follows_from_the_case(robot, tmp_path, root):
    _, case = robot
    planar = scene(Context.load(case))
    assert isinstance(planar, PlanarScene)
    assert planar.axes == (0, 1, 2)
    assert planar.radius == 0.18
    assert [list(b.hi) for b in planar.obstacles] == [[2.0, 2.5]]
    assert list(planar.target.lo) == [3.0, 3.0]
    jointed = scene(Context.load(example.pendulum(root, tmp_path)))
    assert isinstance(jointed, JointScene)
    assert jointed.joints == {"hinge": 0}


def test_the_title_that_the_recording_prints_is_read_by_its_stage(robot):
    _, path = robot
    case = Context.load(path).case
    renamed = case.model_copy(update={"title": "Another title"})
    before, after = (sections_digest(c, READS["trace"], path.parent) for c in (case, renamed))
    assert before != after


def test_missing_traces_are_one_line(robot, capsys, tmp_path):
    folder, case = robot
    wrong = [str(tmp_path / "none.parquet") if a.endswith("traces.parquet") else a for a in command(folder, case)]
    with pytest.raises(SystemExit) as exit_:
        main(wrong)
    assert exit_.value.code == 2
    assert capsys.readouterr().err.count("does not exist") >= 1


def test_a_model_file_that_the_viewer_refuses_leaves_the_scene_out(root, tmp_path):
    """Its reader wants a velocity in every <limit>, which no engine does."""
    told = (root / "configs/models/pendulum.urdf").read_text()
    (bare := tmp_path / "bare.urdf").write_text(told.replace(' velocity="100"', ""))
    whole = JointScene(root / "configs/models/pendulum.urdf", {"hinge": 0})
    assert viewed(whole) is whole
    assert viewed(replace(whole, urdf=bare)) is None
