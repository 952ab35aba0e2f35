"""A small robot case from the case file to the closed loop, in the engine; and what a person gets wrong on the way."""

import re
import shutil

import numpy as np
import pytest

from simgap.cli import main
from simgap.errors import BrokenPromise, UserError
from simgap.extras import shield
from simgap.gap.memory.bound import robot_of
from simgap.io.results import read_json, read_parquet, write_json
from simgap.plants.context import Context
from simgap.stages import fresh, report, synthesis, validation
from tests.stages import road

START = {"x": 0.6, "y": 0.6, "theta": 0.5}
U = {"v": {"min": -0.2, "max": 0.2, "step": 0.1}, "w": {"min": -0.4, "max": 0.4, "step": 0.4}}
ARENA = {
    "kind": "reach_avoid",
    "obstacles": [{"x": [1.6, 1.7], "y": [0.0, 1.6]}],
    "target": {"x": [2.2, 3.0], "y": [0.4, 1.2]},
    "clearance": {"x": 0.18, "y": 0.18},
}


@pytest.fixture
def small(vary, root):
    def make(**more):
        changes = {
            "domain.X": {"x": [0, 3.4], "y": [0, 3], "theta": [-np.pi, np.pi]},
            "domain.U": U,
            "simulator.urdf": str(root / "configs/models/turtlebot.urdf"),
            "hidden_state": {
                "previous": {"v": 3, "w": 2},
                "chains": 20,
                "chain_length": 100,
                "fresh_samples": 300,
                "classes": {"v": 2, "w": 1},
                "search": 150,
            },
            "symmetry.histories": 5,
            "symmetry.headings": 2,
            "synthesis.cells": [68, 60, 32],
            "synthesis.specification": ARENA,
            "validation": {"starts": 4, "steps": 300, "seed": 1, "first": [START], "kept": 2},
        }
        return vary("turtlebot", changes | more)

    return make


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    return tmp_path_factory.mktemp("robot")


@pytest.fixture
def bound(small, shared):
    """Roll-outs after every previous input and the bound, made once: -> (case, folder)."""
    case = small()
    if not (shared / "gap.json").exists():
        shards = road.roll_out(case, shared, "full-table")
        fresh.run(case, shared / "fresh.parquet", workers=1)
        road.bound(case, shared, shards, shared / "fresh.parquet", shared / "gap.json")
    return case, shared


def test_the_full_table_holds_every_pair_of_inputs(bound):
    _, folder = bound
    parts = [p for k in (0, 1) for p in read_parquet(folder / f"shard-{k}.parquet").column("part").to_pylist()]
    assert parts.count("after_previous") == 15 * 15
    assert parts.count("sequence") == 20 * 100
    assert parts.count("history") == 5 * (4 + 2)  # five histories with 1 to 4 earlier inputs, and at two headings
    assert read_json(folder / "gap.json")["budget"]["previous_inputs"] == 15


def test_a_policy_that_drives_at_obstacles_is_led_around_them(bound, tmp_path):
    case, folder = bound
    synthesis.run(case, folder / "gap.json", tmp_path / "gap.npz", tmp_path / "gap_synthesis.json", 1)
    (tmp_path / "own.py").write_text("def straight_on(x):\n    return [0.2, 0.0]\n")
    for policy in ("random", f"{tmp_path}/own.py:straight_on"):
        found = shield.run(case, policy, 4, tmp_path / "gap.npz", folder / "gap.json")
        assert found["alone"]["runs_that_violated_it"] >= 3
        assert found["shielded"]["ends"] == {"reached the target": 4}
        assert 0 < found["acted"] < found["samples"]


def test_from_the_case_to_the_closed_loop(bound, tmp_path):
    case, folder = bound
    for kind, path in (("nominal", None), ("baseline", None), ("gap", folder / "gap.json")):
        synthesis.run(case, path, tmp_path / f"{kind}.npz", tmp_path / f"{kind}.json", 1, kind == "baseline")
        assert read_json(tmp_path / f"{kind}.json")["winning_fraction_after_inflation"] > 0.5
        assert read_json(tmp_path / f"{kind}.json")["looks_between_samples"] == (kind != "nominal")
    files, baseline = (tmp_path / name for name in ("nominal.npz", "gap.npz")), tmp_path / "baseline.npz"
    traces = tmp_path / "traces.parquet"
    validation.run(case, *files, folder / "gap.json", tmp_path / "v.json", traces, 1, baseline=baseline)
    loops = read_json(tmp_path / "v.json")["controllers"]
    assert loops["baseline"]["simulator"]["runs"] == 4
    assert loops["baseline"]["simulator"]["steps_that_left_the_certified_box"] >= 0
    kept = loops["baseline"]["nominal model"]  # the path of its model is what it checks
    assert kept["runs_that_kept_the_specification"] == kept["runs"]
    assert kept["least_clearance"] > 0
    judged = read_json(tmp_path / "v.json")["controllers"]["gap"]["simulator"]
    assert judged["runs_that_kept_the_specification"] == judged["runs"] == 4
    assert judged["steps_outside_gamma"] == 0
    assert judged["least_clearance"] > 0
    rows = read_parquet(tmp_path / "traces.parquet").to_pylist()
    begins = [r for r in rows if r["run"] == 0 and r["step"] == 0]
    assert len(begins) == 4
    assert all({n: r[n] for n in START} == START for r in begins)
    controllers = {kind: tmp_path / f"{kind}.npz" for kind in ("nominal", "gap")}
    given = report.ReportFiles(
        gaps=[folder / "gap.json"],
        samples=folder / "thinned.parquet",
        nominal=controllers["nominal"],
        nominal_summary=controllers["nominal"].with_suffix(".json"),
        gap_aware=controllers["gap"],
        gap_aware_summary=controllers["gap"].with_suffix(".json"),
        validation=tmp_path / "v.json",
        traces=tmp_path / "traces.parquet",
    )
    report.run(case, given, tmp_path / "report.html", tmp_path / "summary.json")  # of what the stages wrote
    assert "4 of 4 runs" in re.sub(r"<[^>]*>", "", (tmp_path / "report.html").read_text())


def test_gravity_of_the_bound_is_that_of_the_case(small):
    found = []
    for gravity in (9.81, 1.62):
        context = Context.load(small(**{"plant.gravity": gravity}))
        motion = np.zeros((len(context.input_set), 3))
        found.append(robot_of(context, context.case.hidden_state, motion).between_poses)
    assert found[1] / found[0] == pytest.approx(1.62 / 9.81, rel=1e-12)


def test_a_robot_is_held_to_the_share_that_its_own_bound_tolerates(small):
    case = Context.load(small(**{"hidden_state.tolerated_probability": 0.02})).case
    kept = {"runs": 4, "runs_that_violated_it": 0, "steps": 100, "steps_outside_gamma": 2}
    validation.keep_promise(kept, validation.tolerated_share(case))
    with pytest.raises(BrokenPromise, match="3 of 100 steps are outside gamma"):
        validation.keep_promise(kept | {"steps_outside_gamma": 3}, validation.tolerated_share(case))
    with pytest.raises(BrokenPromise, match="2 of 100"):
        validation.keep_promise(kept, validation.tolerated_share(Context.load(small()).case))
    with pytest.raises(BrokenPromise, match="1 of 4 runs"):  # a broken run is never tolerated
        validation.keep_promise(kept | {"runs_that_violated_it": 1}, validation.tolerated_share(case))


@pytest.mark.parametrize(
    ("start", "word"),
    [
        ({"x": 3.5, "y": 1.0, "theta": 0.0}, "outside X: x = 3.5 is not in [0, 3.4]"),
        ({"x": 1.65, "y": 0.5, "theta": 0.0}, "not in the winning domain"),
        ({"x": 1.0, "y": 1.0}, "for each of x, y, theta"),
    ],
)
def test_starts_that_cannot_be(small, shared, bound, tmp_path, start, word):
    case = small(validation={"starts": 2, "steps": 10, "first": [START, start]})
    controller = shared / "for-starts.npz"
    if not controller.exists():
        synthesis.run(case, None, controller, tmp_path / "s.json", 1)
    with pytest.raises(UserError) as caught:
        validation.run(case, controller, controller, shared / "gap.json", tmp_path / "v", tmp_path / "t", 1)
    assert word in str(caught.value)
    assert f"{case}: validation.first[1]" in str(caught.value)
    assert not (tmp_path / "v").exists()


def refused(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert caught.value.code == 2
    return line


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"obstacles": [{"x": [4, 5], "y": [0, 1]}]}, ["obstacles[0]", "outside the arena"]),
        ({"obstacles": [{"x": [2.0, 3.2], "y": [0.2, 1.4]}]}, ["target", "inside an obstacle", "Move the target"]),
        ({"target": {"x": [2.21, 2.28], "y": [0.4, 1.2]}}, ["target along x", "Cells of 0.035 or less would do"]),
        ({"target": {"x": [3.0, 3.6], "y": [0.4, 1.2]}}, ["target lies outside the arena", "Move it inside"]),
    ],
)
def test_an_arena_that_cannot_be(small, tmp_path, capsys, changes, words):
    case = small(**{"synthesis.specification": ARENA | changes})
    out = tmp_path / "out"
    arguments = ["synthesis", case, "--out", out / "c.npz", "--summary", out / "s.json", "--log", tmp_path / "log"]
    line = refused(capsys, arguments)
    assert str(case) in line
    assert all(w in line for w in [*words, "synthesis.specification"])
    assert not list(out.glob("*"))


def test_an_empty_domain_names_what_emptied_it(small, bound, tmp_path, capsys):
    _, folder = bound
    case = small()
    gap = read_json(folder / "gap.json")
    for name in {"swept_boxes", "swept_boxes_by_class"} & gap.keys():
        shape = np.shape(gap[name]["lower"])
        gap[name] = {"lower": np.full(shape, -2.0), "upper": np.full(shape, 2.0)}
    write_json(tmp_path / "wide.json", gap)
    common = ["--out", tmp_path / "c.npz", "--summary", tmp_path / "s.json", "--log", tmp_path / "log"]
    line = refused(capsys, ["synthesis", case, "--gap", tmp_path / "wide.json", *common])
    assert "lost to the path between samples" in line
    coarse = small(**{"synthesis.cells": [8, 8, 8]})
    line = refused(capsys, ["synthesis", coarse, *common])
    assert "cells" in line.split("synthesis")[1]
    assert not (tmp_path / "c.npz").exists()


def test_a_symmetry_that_the_model_does_not_have(small, bound, tmp_path, capsys):
    case = small(**{"plant.symbolic.dynamics": {"x": "v*cos(theta) + 0.01*x", "y": "v*sin(theta)", "theta": "w"}})
    folder = tmp_path / "copy"
    shutil.copytree(bound[1], folder)
    shards = [f"--rollouts={folder / f'shard-{k}.parquet'}" for k in (0, 1)]
    out = tmp_path / "new.json"
    given = ["--grid", folder / "grid", *shards, "--out", out, "--log", tmp_path / "log"]
    line = refused(capsys, ["scp", case, *given])
    assert "symmetry.group" in line
    assert "declared but false" in line
    assert not out.exists()


def test_an_obstacle_that_bounds_the_heading_is_kept_clear_of_by_samples(small):
    """A swept box says where a path is and not which way the robot looks on it: it cannot see such an obstacle."""
    obstacle = {"x": [1.0, 1.4], "theta": [0.0, 1.0]}
    arenas = (
        (ARENA, True),
        (ARENA | {"obstacles": [obstacle]}, False),
        (ARENA | {"clearance": ARENA["clearance"] | {"theta": 0.1}}, False),
    )
    for arena, by_boxes in arenas:
        case = small(**{"synthesis.specification": arena, "synthesis.nominal_between_samples": True})
        problem, between = synthesis.pose_problem(Context.load(case), None)
        assert (problem.swept is not None) == by_boxes
        assert (problem.stray is None) == by_boxes
        if not by_boxes:
            assert np.array_equal(problem.stray, between)
            assert between[0][2] >= 0.5 * 0.4  # half a sample of the fastest turn
