"""Certificates of reach-while-avoid: a small robot that remembers, an obstacle across the seam, and deceit."""

import itertools
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simgap.extras.certify import Certified, Reached, target_of, write_certificate
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain
from simgap.gap.bounds.previous import PreviousClasses
from simgap.geometry import Box
from simgap.specifications.reaching import ReachAvoid
from simgap.specifications.space import Space
from simgap.specifications.task import Task
from simgap.synthesis.abstraction.intersample import planar_swept_cells
from simgap.synthesis.games.game import PreviousBounds
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.checker.checker_runs import change, run
from tests.synthesis.synthesis_plants import unicycle

STATES, SHAPE = ("x", "y", "t"), (30, 30, 32)
U = np.array([[v, w] for v in (-0.4, 0.0, 0.4) for w in (-0.6, 0.0, 0.6)])
X = Box([0.0, 0.0, -np.pi], [3.0, 3.0, np.pi])
SPACE = Space(STATES, X, (2,), {"x": "m", "y": "m", "t": "rad"}, (0, 1, 2))
ARENA = {
    "obstacles": ({"x": (1.2, 1.4), "y": (0.0, 1.5)},),
    "target": {"x": (2.2, 3.0), "y": (0.2, 1.2)},
    "clearance": {"x": 0.1, "y": 0.1},
}
ROUNDS = {key: ARENA[key] for key in ("obstacles", "clearance")} | {
    "formula": "G F left & G F right",
    "regions": {"left": {"x": (0.2, 1.0), "y": (1.4, 2.8)}, "right": {"x": (1.8, 2.8), "y": (1.4, 2.8)}},
}


def made_of(classes, arena, swept=True, one=False):
    """Controller and certificate of a robot whose gap is wider after some inputs than after others."""
    kind = "task" if "formula" in arena else "reach_avoid"
    model, specification = unicycle(), {"task": Task, "reach_avoid": ReachAvoid}[kind](kind=kind, **arena)
    kind = PreviousClasses.of(U, classes)
    wide = 1.0 + 0.3 * np.arange(kind.count)[:, None, None]
    upper = wide * np.array([0.004, 0.003, 0.01]) * (1.0 + np.abs(U).sum(axis=1))[None, :, None]
    domain = GapDomain(STATES, ("v", "w"), X, U, (0, 1), (2,))
    bound = BodyFrameGap(domain, (), -upper, 1.2 * upper, classes=kind)
    way = np.minimum(0.0, U[:, :1]), np.maximum(0.0, U[:, :1])
    side = 0.02 * wide + np.abs(U[:, 1:] * U[:, :1]) * 0.5
    boxes = (
        np.concatenate([way[0] - 0.03 * wide, -side], axis=2),
        np.concatenate([way[1] + 0.03 * wide, side], axis=2),
    )
    problem = SynthesisProblem(model, specification, SPACE, SHAPE, U, bound.kernel(), [2], one=one)
    stray = None if swept else np.array([[0.05, 0.05, 0.1], [0.02, 0.03, 0.1]])  # from obstacles, and from walls
    if swept:
        every = planar_swept_cells(problem.grid, boxes[0].min(axis=0), boxes[1].max(axis=0))
        problem = replace(problem, swept=every)
        own = [planar_swept_cells(problem.grid, *sides) for sides in zip(*boxes, strict=True)]
        gaps = tuple(bound.after(c).kernel() for c in range(kind.count))
        previous = PreviousBounds(kind.kind, kind.rest, gaps, tuple(own))
        problem = replace(problem, previous=previous if kind.count > 1 else None)
    solution = synthesise(replace(problem, stray=stray))
    task = Reached(
        target_of(specification, SPACE, solution), specification.boxes(SPACE), SPACE.vector(specification.clearance),
        np.zeros(3) if stray is None else stray, (0, 1, 2), boxes if swept else None,
    )  # fmt: skip
    units = {"x": "m", "y": "m", "t": "rad", "v": "m/s", "w": "rad/s"}
    return Certified("small", units, model, bound, None, solution, U, ["v", "w"], task)


@pytest.fixture(scope="module")
def made():
    """Three classes of the previous input."""
    return made_of((3, 1), ARENA)


@pytest.fixture(scope="module")
def original(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    write_certificate(folder, made, {})
    return folder


@pytest.fixture
def certificate(original, tmp_path):
    return Path(shutil.copytree(original, tmp_path / "copy"))


def levels(made):
    return made.solution.value.reshape(-1, 3).copy()


def bits(made):
    return np.unpackbits(made.solution.mask, axis=1, count=len(U), bitorder="little").astype(bool)


def packed(admitted):
    return np.packbits(admitted, axis=1, bitorder="little")


def node_name(node):
    cell, after = divmod(int(node), 3)
    return f"cell {tuple(int(k) for k in np.unravel_index(cell, SHAPE))} after an input of class {after}"


def test_every_pair_of_the_robot_is_verified(certificate, made):
    status, words = run(certificate, "--exact", "40")
    assert (status, "ACCEPTED" in words) == (0, True), words
    assert f"{int(bits(made).sum()):,} pairs of node and input" in words
    assert "40 pairs verified exactly" in words
    assert "not covered: That the path of each step" in words
    value = levels(made)
    assert (value[:, 0] != value[:, 2]).any()  # the memory matters
    assert made.solution.fraction > 0.5
    assert value.max() > 5


def test_a_controller_with_one_input_a_cell_is_verified_by_its_one_input(tmp_path):
    made = made_of((1, 1), ARENA, one=True)
    write_certificate(tmp_path, made, {})
    status, words = run(tmp_path)
    assert (status, "ACCEPTED" in words) == (0, True), words
    pairs = int((made.solution.value > 0).sum())
    assert pairs > 1000
    assert f"{pairs:,} pairs of node and input" in words


def test_a_task_of_a_robot_that_remembers_is_verified_and_a_wider_bound_is_not(tmp_path):
    """Memory is the state of the task and, in it, the class of the previous input."""
    made = made_of((3, 1), ROUNDS)
    write_certificate(tmp_path, made, {})
    status, words = run(tmp_path, "--exact", "40")
    assert (status, "ACCEPTED" in words) == (0, True), words
    assert made.solution.memory == 6
    assert made.solution.fraction > 0.3
    assert f"{int(bits(made).sum()):,} pairs of node and input" in words
    bound = np.load(tmp_path / "bound.npy")
    bound[1, 2, :, 0] += 0.06
    change(tmp_path, bound=bound)
    status, words = run(tmp_path, "--exact", "0")
    assert status == 1
    assert " of the task after an input of class 2 with input" in words


def test_a_sample_is_seeded_and_says_so(certificate):
    said = [run(certificate, "--sample", "50", "--exact", "9", "--seed", seed)[1] for seed in ("3", "3", "4")]
    assert all("all inputs of 50 of " in words and "ACCEPTED" in words for words in said)
    drawn = [words.splitlines()[1] for words in said]
    assert drawn[0] == drawn[1] != drawn[2]
    assert "drawn with seed 3" in drawn[0]


def test_a_level_that_is_lower_than_it_should_be_is_refused(certificate, made):
    value = levels(made)
    node = int(np.argmax(value))
    value.reshape(-1)[node] = 1
    change(certificate, levels=value)
    status, words = run(certificate, "--exact", "0")
    assert status == 1
    assert f"REJECTED: {node_name(node)} with input" in words


def test_an_input_that_does_not_go_down_a_level_is_refused(certificate, made):
    admitted, value = bits(made), made.solution.value
    node = int(np.flatnonzero((value > 0) & ~admitted[:, 0])[11])
    admitted[node, 0] = True
    change(certificate, inputs=packed(admitted))
    status, words = run(certificate, "--exact", "0")
    assert status == 1
    assert f"REJECTED: {node_name(node)} with input 0 (" in words


def test_an_obstacle_where_the_robot_drives_is_refused(certificate, made):
    """In winning cells by the cells, and beside them by the paths alone."""
    change(certificate, lambda head: head["obstacles"].append({"x": [(0.5).hex(), (0.6).hex()]}))
    assert "is too near to an obstacle or a wall" in run(certificate, "--exact", "0")[1]
    head = json.loads((certificate / "certificate.json").read_text())
    head["obstacles"].pop()
    kept = {key: head["clearance"][key] for key in ("x", "y")}

    def thinner(head):
        """Samples may be nearer, and the obstacle reaches up to where they were: cells stay clear, paths do not."""
        head["obstacles"] = [{"x": [(1.1).hex(), (1.5).hex()], "y": [(-0.1).hex(), (1.6).hex()]}]
        head["clearance"] = dict.fromkeys(kept, (0.0).hex()) | {"t": (0.0).hex()}

    change(certificate, thinner)
    assert run(certificate, "--exact", "0")[0] == 0  # the same thing, said in another way
    swept = np.load(certificate / "swept.npy")
    swept[0, :, :, 0] -= 0.1
    change(certificate, swept=swept)
    assert "its path not clear" in run(certificate, "--exact", "0")[1]


def test_another_class_of_an_input_is_refused(certificate, made):
    def swapped(head):
        of_input = head["classes"]["of_input"]
        head["classes"]["of_input"] = [{0: 2, 2: 0}.get(c, c) for c in of_input]

    change(certificate, swapped)
    status, words = run(certificate, "--exact", "0")
    assert (status, "REJECTED: cell (" in words) == (1, True)


def test_a_wider_bound_after_one_class_is_refused_there(certificate):
    bound = np.load(certificate / "bound.npy")
    bound[1, 2, :, 0] += 0.06
    change(certificate, bound=bound)
    status, words = run(certificate, "--exact", "0")
    assert (status, "after an input of class 2 with input" in words) == (1, True)


def test_targets_walls_and_starts_are_held_against_the_header(certificate, made):
    def target(head):
        head["target"]["x"] = [(2.3).hex(), (3.0).hex()]

    change(certificate, target)
    assert "is at level 0 and not in the target" in run(certificate)[1]
    head = {"x": [(2.2).hex(), (3.0).hex()], "y": [(0.2).hex(), (1.2).hex()]}
    change(certificate, lambda h: h.update(target=head))
    change(certificate, lambda h: h["clearance"].update(y=(0.5).hex()))
    assert "is too near to an obstacle or a wall" in run(certificate)[1]
    change(certificate, lambda h: h["clearance"].update(y=(0.1).hex()))
    change(certificate, lambda h: h["classes"].update(at_rest=2))
    assert "is promised without a level at rest, or the reverse" in run(certificate)[1]
    change(certificate, lambda h: h["classes"].update(at_rest=made.solution.first))
    value = levels(made)
    cell = int(np.flatnonzero(value[:, 0] == 0)[0])
    value[cell, 1] = 3
    change(certificate, levels=value)
    assert run(certificate)[0] == 1
    change(certificate, levels=levels(made))
    swept = np.load(certificate / "swept.npy")
    change(certificate, swept=np.maximum(swept, 0.01))
    assert "does not hold where the path begins" in run(certificate)[1]


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda h: h["classes"].update(of_input=[0] * 8), "not numbered"),
        (lambda h: h["classes"].update(of_input=[0, 2] * 4 + [0]), "not numbered"),
        (lambda h: h["classes"].update(at_rest=7), "not numbered"),
        (lambda h: h.update(pose=["x", "y"]), "a pose is the names"),
        (lambda h: h.update(pose=None), "expressions, or a table"),
        (lambda h: h["files"].pop("bound.npy"), "expressions, or a table"),
        (lambda h: h["obstacles"].append({}), "bound some of the states"),
        (lambda h: h["obstacles"].append({"z": ["0x0p+0", "0x1p+0"]}), "bound some of the states"),
        (lambda h: h["obstacles"].append({"x": ["0x1p+0", "0x0p+0"]}), "no interval"),
        (lambda h: h.update(obstacles={}), "no list"),
        (lambda h: h["clearance"].update(x="-0x1p+0"), "not negative"),
        (lambda h: h.pop("between"), "'between'"),
        (lambda h: h.update(simulator=h["nominal"]), "do not go together"),
    ],
)
def test_a_malformed_header_is_one_line_and_unreadable(certificate, edit, words):
    change(certificate, edit)
    status, said = run(certificate)
    assert (status, said.count("\n")) == (2, 1), said
    assert words in said


def test_tables_that_do_not_fit_are_unreadable(certificate, made):
    bound = np.load(certificate / "bound.npy")
    for tables in (
        {"levels": levels(made).astype(np.int64)}, {"levels": levels(made)[:, :2]}, {"bound": bound[:, :, :, :2]},
        {"bound": bound[::-1]}, {"bound": np.where(bound > 0.03, np.nan, bound)}, {"swept": bound[..., :1]},
    ):  # fmt: skip
        shutil.copytree(certificate, certificate / "one")
        change(certificate / "one", **tables)
        assert run(certificate / "one")[0] == 2
        shutil.rmtree(certificate / "one")


@pytest.fixture(scope="module")
def across_the_seam():
    """No classes, no swept boxes, and headings near +-pi that are forbidden in part of the arena."""
    seam = {"x": (0.0, 0.9), "t": (2.9, 3.5)}
    return made_of((1, 1), ARENA | {"obstacles": (*ARENA["obstacles"], seam)}, swept=False)


def test_an_obstacle_across_the_seam_is_seen_on_both_sides(across_the_seam, tmp_path):
    """Cells right above -pi are forbidden by the copy of [2.9, 3.5]; a controller that wins there is refused."""
    write_certificate(tmp_path / "seam", across_the_seam, {})
    status, words = run(tmp_path / "seam", "--exact", "20")
    assert status == 0, words
    assert "not covered: That a path strays from its samples" in words
    value = across_the_seam.solution.value.reshape(SHAPE)
    assert (value[5, 20, 0], value[5, 20, -1]) == (-1, -1)
    assert value[5, 20, 16] > 0
    free = made_of((1, 1), ARENA, swept=False)
    for layer in (0, 31):
        shown = free.solution.value.reshape(SHAPE)
        assert shown[5, 20, layer] > 0
        only = np.where(np.arange(SHAPE[2]) == layer, shown, across_the_seam.solution.value.reshape(SHAPE))
        admitted = np.where((only == shown).reshape(-1)[:, None], free.solution.mask, across_the_seam.solution.mask)
        changed = replace(
            across_the_seam.solution, value=only.reshape(-1), winning=only.reshape(-1) >= 0, mask=admitted
        )
        write_certificate(tmp_path / f"{layer}", replace(across_the_seam, solution=changed), {})
        assert "is too near to an obstacle or a wall" in run(tmp_path / f"{layer}", "--exact", "0")[1]


def test_regions_are_those_of_the_definition(across_the_seam, tmp_path):
    """Cells near obstacles and walls, from points in them and every copy of every obstacle."""
    write_certificate(tmp_path / "seam", across_the_seam, {})
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path\n"
        "import certificate, numpy, regions\n"
        "numpy.save(sys.argv[3], regions.forbidden(certificate.read(Path(sys.argv[2]))))"
    )
    import subprocess

    from tests.checker.checker_runs import CHECKER

    command = [sys.executable, "-c", code, str(CHECKER), str(tmp_path / "seam"), str(tmp_path / "bad.npy")]
    subprocess.run(command, check=True)
    bad, task = np.load(tmp_path / "bad.npy").reshape(SHAPE), across_the_seam.task
    (keep, beyond), width = task.clearance + np.broadcast_to(task.between, (2, 3)), (X.hi - X.lo) / SHAPE
    rng = np.random.default_rng(0)
    for k in rng.integers(0, SHAPE, (400, 3)):
        lo, hi = X.lo + width * k, X.lo + width * (k + 1)
        wall = any(lo[j] < X.lo[j] + beyond[j] - 1e-9 or hi[j] > X.hi[j] - beyond[j] + 1e-9 for j in (0, 1))
        meets = False
        for box, turn in itertools.product(task.obstacles, (-2, -1, 0, 1, 2)):
            shift = np.array([0.0, 0.0, 2 * np.pi * turn])
            meets |= bool(np.all((hi > box.lo + shift - keep + 1e-9) & (lo < box.hi + shift + keep - 1e-9)))
        assert bad[tuple(k)] == (wall or meets)


@pytest.mark.parametrize(
    "ends", [("-0x1.0p+900", "0x1.0p+900"), ("0x1.0p+900", "0x1.0p+901"), ("-0x1.8p+0", "0x1.8p+0")]
)
def test_a_box_of_many_periods_is_all_of_the_axis_and_costs_no_more(across_the_seam, tmp_path, ends):
    """Not a copy for each period: of [-2^900, 2^900] there are more than anybody counts."""
    write_certificate(tmp_path / "wide", across_the_seam, {})
    whole = float.fromhex(ends[1]) - float.fromhex(ends[0]) >= 2 * np.pi
    change(tmp_path / "wide", lambda head: head.update(obstacles=[{"t": list(ends)}], target={"t": list(ends)}))
    status, words = run(tmp_path / "wide", "--exact", "0", "--sample", "1")
    assert (status, whole) == (1, "is too near to an obstacle" in words), words
