"""The trace stage on both kinds of case, from the command line as well."""

from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from simgap.cli import main
from simgap.io.controller_file import load_controller
from simgap.io.rerun.closed_loop import events
from simgap.io.rerun.recording import JointScene, PlanarScene, viewed
from simgap.io.traces import split
from simgap.plants.context import Context
from simgap.provenance import READS, sections_digest
from simgap.report.scene import recording_content, scene
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
    assert states | {"shown/gap/value", "shown/nominal/value", "shown/gap/share/x"} <= set(curves)


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


def test_what_the_recording_says_happened(robot):
    folder, case = robot
    context = Context.load(case)
    traces = split(pq.read_table(folder / "validation/traces.parquet"), context.states, context.inputs)
    controllers = [load_controller(folder / kind / "controller.npz") for kind in ("nominal", "gap")]
    content = recording_content(context, traces, *controllers)
    told = [text for kind, t in content.shown.items() for _, text, _ in events(content, kind, t)]
    assert any(text.startswith("nominal-only: the simulator is unsafe at x = -0.01") for text in told)
    assert "gap-aware: target reached after 24 s" in told  # 0.9 of the arena at 30 s, 0.75 of it at 23.6 s


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
