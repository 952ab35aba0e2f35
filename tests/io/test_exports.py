"""Controllers and models as files for others: every cell compared with a compiled header, every number by hand."""

import json
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import simgap
from simgap.cli import main
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.io import controller_file
from simgap.io.controller_file import save_controller
from simgap.specifications.solution import Progress, Solution
from simgap.synthesis.controller import FARTHEST, Controller
from simgap.synthesis.input_sets import packed_width

COMPILER = shutil.which("cc") or shutil.which("gcc")
MAIN = """\
#include <stdio.h>
#include "%(name)s.h"
#ifndef %(big)s_TASK
#define %(name)s_observe(x, memory) memory
#endif
int main(void) {
  double x[%(big)s_STATES], u[1]; long memory; int c;
  while (scanf("%%la %%la %%ld", &x[0], &x[1], &memory) == 3) {
    c = %(name)s_input(x, memory, u);
    printf("%%d %%d %%ld\\n", c, %(name)s_acting(memory, c), %(name)s_next(%(name)s_observe(x, memory), c));
  }
  return 0;
}
"""


def made_up(seed, late=False, kind=None, periodic=(), inputs=((-1.5,), (-0.25,), (0.0,), (0.25,), (1.5,)), task=1):
    """A controller whose admissible inputs are drawn at random, none of them in a third of the cells."""
    rng = np.random.default_rng(seed)
    grid = Grid(Box([-0.7, -1.1], [0.3, 1.3]), [13, 7], periodic)
    inputs = np.array(inputs)
    memory = (len(inputs) if late else 1) * (1 if kind is None else max(kind) + 1)
    bits = rng.random((grid.size * memory, len(inputs))) < 0.4
    bits[np.repeat(rng.random(grid.size) < 0.3, memory)] = False
    mask = np.packbits(bits, axis=1, bitorder="little")
    assert mask.shape[1] == packed_width(len(inputs))
    winning = bits.any(axis=1).reshape(grid.size, memory).all(axis=1)
    solution = Solution(
        grid=grid, winning=winning, mask=mask, free=np.ones(grid.size, bool), value=None, target=None, memory=memory,
        first=0, late=late, kind=None if kind is None else np.array(kind), statistics={},
    )  # fmt: skip
    if task > 1:
        memory *= task
        mask = np.repeat(mask, task, axis=0)
        after = rng.integers(0, task, (grid.size, task)).astype(np.int16)
        solution = replace(solution, mask=mask, memory=memory, progress=Progress(after, memory // task))
    names = ("u", "w")[: inputs.shape[1]]
    return Controller(inputs, ("q", "v"), names, solution, "least_effort", {"case": "made_up"})


KINDS = {
    "plain": {},
    "periodic": {"periodic": (0,)},
    "late": {"late": True},
    "classes": {"kind": [0, 0, 1, 2, 2]},
    "late classes": {"late": True, "kind": [0, 0, 1, 2, 2]},
    "task": {"task": 3},
    "late task": {"late": True, "kind": [0, 0, 1, 2, 2], "task": 2, "periodic": (0,)},
}


def asked(controller):
    """All centres of cells with all memories; faces and corners of the box; points beside and far outside."""
    centres = controller.grid.centres()
    corners = np.array([[a, b] for a in (-0.7, 0.3) for b in (-1.1, 1.3)])
    faces = centres + controller.grid.h
    outside = np.array([[0.3000001, 0.0], [-0.8, 0.0], [0.0, 1.31], [7.0, 0.0], [-1e12, 0.0], [0.0, 1e300]])
    points = np.concatenate([centres, corners, faces, outside])
    memories = np.arange(controller.memory)
    return np.repeat(points, len(memories), axis=0), np.tile(memories, len(points))


@pytest.mark.parametrize("kind", KINDS)
def test_python_and_c_choose_what_the_controller_chooses(tmp_path, kind):
    controller = made_up(len(kind), **KINDS[kind])
    x, memory = asked(controller)
    wanted = controller.lookup(x, memory)
    assert (wanted >= 0).sum() > 50
    simgap.export_controller(controller, tmp_path / "law.py")
    ask = "import json, sys, law; print(json.dumps([[c, *law.after(law.observe(p, m), c)]"
    ask += " for p, m in json.load(sys.stdin) for c in [law.choose(p, m)]]))"
    rows = [[p, m] for p, m in zip(x.tolist(), memory.tolist(), strict=True)]
    done = subprocess.run(
        [sys.executable, "-S", "-c", ask], cwd=tmp_path, input=json.dumps(rows), capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    python = np.array(json.loads(done.stdout))
    assert python[:, 0].tolist() == wanted.tolist()
    base = controller.memory if controller.progress is None else controller.progress.base
    classes = base // (len(controller.input_set) if controller.late else 1)
    followed = []
    for m, c, cell in zip(memory.tolist(), wanted.tolist(), controller.cell(x).tolist(), strict=True):
        if c >= 0:
            followed.append([int(v) for v in controller.solution.step(m, c, cell)])
            continue
        # nothing is chosen: what was chosen before still acts where inputs act late
        seen = m if cell < 0 or base == controller.memory else int(controller.progress(m, cell)) * base + m % base
        followed.append([m % base // classes if controller.late else -1, seen])
    assert python[:, 1:].tolist() == followed

    if COMPILER is None:
        pytest.skip("no C compiler")
    simgap.export_controller(controller, tmp_path / "law.h")
    (tmp_path / "main.c").write_text(MAIN % {"name": "law", "big": "LAW"})
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    subprocess.run([COMPILER, *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    lines = "".join(f"{a.hex()} {b.hex()} {m}\n" for (a, b), m in zip(x.tolist(), memory.tolist(), strict=True))
    told = subprocess.run([tmp_path / "main"], input=lines, capture_output=True, text=True, check=True).stdout
    compiled = np.array([row.split() for row in told.splitlines()], dtype=int)
    assert compiled.tolist() == python.tolist()
    far = np.abs(x).max(axis=1) > 1e9  # no angle that anyone measures, though a periodic axis would wrap it into a cell
    assert (wanted[far] == -1).all()


FILTER = """\
#include <math.h>
#include <stdio.h>
#include "law.h"
#ifndef LAW_TASK
#define law_observe(x, memory) memory
#endif
int main(void) {
  double x[2], u[2] = {0.0, 0.0}; long memory; int c;
  while (scanf("%la %la %ld %la %la", &x[0], &x[1], &memory, &u[0], &u[1]) == 5) {
    c = law_filter(x, memory, u, u);
    printf("%d %a %a %ld %d\\n", c, u[0], u[1], law_next(law_observe(x, memory), c), law_acting(memory, c));
  }
  u[0] = u[1] = NAN;
  x[0] = 0.0; x[1] = 0.1;
  return law_filter(x, 0, u, u) >= 0 || law_input(x, 0, u) < 0 ? 0 : 1;
}
"""
PLANE = [(v, w) for v in (-0.3, 0.0, 0.1, 0.3) for w in (-2.0, 0.5, 1.7)]  # 12: two bytes a set


@pytest.mark.parametrize("kind", [*KINDS, "two inputs", "late two inputs"])
def test_python_and_c_shield_as_simgap_does(tmp_path, kind):
    more = KINDS.get(kind) or {"inputs": PLANE, "late": kind.startswith("late")} if kind != "plain" else {}
    controller = made_up(len(kind), **more)
    shield, rng = simgap.Shield(controller), np.random.default_rng(2)
    x, memory = (rows[:4000] for rows in asked(controller))
    nu = controller.input_set.shape[1]
    at_ties = (controller.input_set[rng.integers(0, len(controller.input_set), (2, len(x)))]).mean(axis=0)
    wanted = np.where(rng.random((len(x), 1)) < 0.3, at_ties, rng.uniform(-2.5, 2.5, (len(x), nu)))
    given = [shield.numbers(*row)[0] for row in zip(x, wanted, memory.tolist(), strict=True)]
    assert len({*given}) == len(controller.input_set) + 1
    simgap.export_controller(controller, tmp_path / "law.py")
    law = runpy.run_path(str(tmp_path / "law.py"))
    rows = zip(x.tolist(), wanted.tolist(), memory.tolist(), strict=True)
    assert [law["filter"](*row) for row in rows] == given
    for wrong in ([0.0] * (nu + 1), [float("nan")] * nu):
        with pytest.raises(ValueError, match="an input is"):
            law["filter"](x[0].tolist(), wrong, 0)

    if COMPILER is None:
        pytest.skip("no C compiler")
    simgap.export_controller(controller, tmp_path / "law.h")
    (tmp_path / "main.c").write_text(FILTER)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    subprocess.run([COMPILER, *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    padded = np.concatenate([wanted, np.zeros((len(x), 2 - nu))], axis=1)
    words = [f"{a.hex()} {b.hex()} {m} {u.hex()} {w.hex()}" for (a, b), m, (u, w) in
             zip(x.tolist(), memory.tolist(), padded.tolist(), strict=True)]  # fmt: skip
    told = subprocess.run(
        [tmp_path / "main"], input="\n".join(words), capture_output=True, text=True, check=True
    ).stdout
    lines = [line.split() for line in told.splitlines()]
    assert [int(line[0]) for line in lines] == given
    values = np.array([[float.fromhex(v) for v in line[1 : 1 + nu]] for line in lines])
    assert np.array_equal(values, np.where(np.array(given)[:, None] >= 0, controller.input_set[given], wanted))
    for line, m, c, cell in zip(lines, memory.tolist(), given, controller.cell(x).tolist(), strict=True):
        if c >= 0:
            acting, after = controller.solution.step(m, c, cell)
            assert (int(line[4]), int(line[3])) == (acting, after)


@pytest.mark.parametrize("ending", [".h", ".py"])
def test_a_law_without_the_sets_has_no_shield_and_chooses_the_same(tmp_path, ending, monkeypatch):
    controller = made_up(1)
    simgap.export_controller(controller, tmp_path / f"whole{ending}")
    monkeypatch.setattr(controller_file, "MOST_SETS", 40)  # numbered piece by piece
    simgap.export_controller(controller, tmp_path / f"pieces{ending}")
    monkeypatch.setattr(controller_file, "MOST_SETS", 5)
    simgap.export_controller(controller, tmp_path / f"law{ending}")
    solution = replace(
        controller.solution, mask=np.empty((len(controller.choice), 0), np.uint8), chosen=controller.choice
    )
    simgap.export_controller(replace(controller, solution=solution), tmp_path / f"one{ending}")
    texts = {name: (tmp_path / f"{name}{ending}").read_text() for name in ("whole", "pieces", "law", "one")}
    assert [("filter(" in text) for text in texts.values()] == [True, True, False, False]
    if ending == ".h":
        assert "too many different sets" in texts["law"]
        assert "records one input a cell" in texts["one"]
    else:
        laws = [runpy.run_path(str(tmp_path / f"{name}{ending}")) for name in texts]
        for x in asked(controller)[0].tolist():
            assert len({law["choose"](x) for law in laws}) == 1
            assert laws[0]["filter"](x, [1.0]) == laws[1]["filter"](x, [1.0])


@pytest.mark.parametrize("count", [5, 7, 11, 100])
def test_an_angle_is_too_far_for_all_alike(tmp_path, count):
    grid = Grid(Box([-np.pi], [np.pi]), [count], (0,))
    every = np.ones(count, bool)
    solution = Solution(grid=grid, winning=every, mask=np.ones((count, 1), np.uint8), free=every)
    controller = Controller(np.zeros((1, 1)), ("q",), ("u",), solution, "least_effort", {})
    simgap.export_controller(controller, tmp_path / "law.py")
    law = runpy.run_path(str(tmp_path / "law.py"))
    ends = np.array([-1.0, 1.0]) * FARTHEST * 2.0 * grid.h - np.pi
    x = np.concatenate([ends + k * np.spacing(ends) for k in range(-9, 10)])
    assert controller.cell(x[:, None]).tolist() == [law["cell"]([value]) for value in x.tolist()]


def test_the_command_says_what_the_law_takes(tmp_path, capsys):
    save_controller(made_up(1), tmp_path / "controller.npz")
    for name, held in (("law.h", "its table takes {:,}, 2 for each"), ("law.py", "")):
        with pytest.raises(SystemExit):
            main(["export", str(tmp_path / "controller.npz"), "--out", str(tmp_path / name)])
        told = capsys.readouterr().out
        assert f"{(tmp_path / name).stat().st_size:,} bytes" in told
        assert held.format(2 * len(made_up(1).choice)) in told


def test_a_name_of_which_nothing_can_be_called(tmp_path):
    for name, words in (("law.txt", "neither a C header nor Python"), ("3.h", "does not begin with a letter")):
        with pytest.raises(UserError, match=words):
            simgap.export_controller(made_up(1), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_comment_is_never_code(tmp_path):
    controller = made_up(1)
    controller.metadata["case"] = '*/ int x; """ import os\n"""'
    simgap.export_controller(controller, tmp_path / "law.py")
    simgap.export_controller(controller, tmp_path / "law.h")
    compile((tmp_path / "law.py").read_text(), "law.py", "exec")
    assert (tmp_path / "law.h").read_text().index("*/") > (tmp_path / "law.h").read_text().index("Needs no library")


def test_one_state_is_asked_about():
    controller = made_up(1)
    for wrong in ([0.1], [0.1, 0.2, 0.3], [[0.1, 0.2]], 0.1, [0.1, float("nan")]):
        with pytest.raises(UserError):
            controller.input(wrong)
        with pytest.raises(UserError):
            controller.inputs(wrong)


def test_found_effects_in_a_urdf(root, tmp_path, vary):
    """Damping and friction add to what the file says; a denser rod has its mass and inertia scaled."""
    effects = [
        {"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.02}},
        {"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.15}},
        {"name": "parameter_error", "on": "rod.mass", "parameters": {"ratio": 1.5}},
    ]
    case = vary("pendulum", {"plant.effects": effects}, remove=("measured",))
    simgap.export_model(case, tmp_path / "made.urdf")
    robot = ElementTree.parse(tmp_path / "made.urdf").getroot()
    assert {k: float(v) for k, v in robot.find("joint/dynamics").attrib.items()} == {"damping": 0.02, "friction": 0.15}
    assert float(robot.find("link[@name='rod']/inertial/mass").get("value")) == 1.5
    assert float(robot.find("link[@name='rod']/inertial/inertia").get("ixx")) == pytest.approx(0.125, rel=1e-15)
    # without the friction, which Drake does not read, file and corrected case are the same model
    plain = vary("pendulum", {"plant.effects": effects[::2]}, remove=("measured",))
    same = simgap.load_plant(plain).sampled
    simgap.export_model(plain, tmp_path / "drake.urdf")
    read = vary("pendulum", {"plant.urdf": str(tmp_path / "drake.urdf")}, remove=("measured",))
    x, u = np.array([[0.1, 0.4], [-0.2, -0.5]]), np.array([[0.3], [-1.0]])
    assert np.allclose(simgap.load_plant(read).sampled.step(x, u), same.step(x, u), rtol=0, atol=1e-15)


MJCF = [
    ("viscous_friction", "hinge", {"b": 0.02}),
    ("quadratic_drag", "hinge", {"c": 0.3}),
    ("reflected_inertia", "hinge", {"I": 0.05}),
    ("spring", "hinge", {"k": 2.0}),
    ("cubic_spring", "hinge", {"k3": -1.5}),
    ("parameter_error", "rod.mass", {"ratio": 1.5}),
    ("input_gain", "u", {"ratio": 0.8}),
]


def test_the_corrected_model_in_mujoco(root, tmp_path, vary):
    """Accelerations of the MJCF against those of the Drake system, at states and torques of all signs."""
    mujoco = pytest.importorskip("mujoco")
    effects = [{"name": name, "on": on, "parameters": numbers} for name, on, numbers in MJCF]
    case = vary("pendulum", {"plant.effects": effects}, remove=("measured",))
    simgap.export_model(case, tmp_path / "made.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "made.xml"))
    assert model.opt.timestep == pytest.approx(0.005)
    data, system = mujoco.MjData(model), simgap.load_plant(case).drake_system()
    context, rng = system.CreateDefaultContext(), np.random.default_rng(3)
    for _ in range(20):
        q, v, u = rng.uniform(-1, 1), rng.uniform(-3, 3), rng.uniform(-2, 2)
        data.qpos[0], data.qvel[0], data.ctrl[0] = q, v, u
        mujoco.mj_forward(model, data)
        context.SetContinuousState([q, v])
        system.get_input_port().FixValue(context, [u])
        rates = system.EvalTimeDerivatives(context).get_vector().CopyToVector()
        assert data.qacc[0] == pytest.approx(rates[1], rel=2e-5, abs=2e-5)  # six digits are written


def test_dry_friction_in_mujoco_is_the_effect_alone(root, tmp_path, vary):
    """A `friction` of the URDF is no part of the nominal model."""
    mujoco = pytest.importorskip("mujoco")
    urdf = (root / "configs/models/pendulum.urdf").read_text()
    (tmp_path / "rough.urdf").write_text(urdf.replace('friction="0"', 'friction="0.7"'))
    effects = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.15}}]
    case = vary(
        "pendulum", {"plant.effects": effects, "plant.urdf": str(tmp_path / "rough.urdf")}, remove=("measured",)
    )
    simgap.export_model(case, tmp_path / "made.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "made.xml")).dof_frictionloss.tolist() == [0.15]


def test_what_mjcf_cannot_say_is_refused(tmp_path, vary):
    pytest.importorskip("mujoco")
    case = vary("pendulum", {"plant.effects": [{"name": "input_delay", "on": "u", "parameters": {"delay": 0.01}}]})
    with pytest.raises(UserError, match=r"plant.effects.0: MJCF cannot hold 'input_delay' on 'u'"):
        simgap.export_model(case, tmp_path / "made.xml")
    assert not (tmp_path / "made.xml").exists()


def test_what_a_urdf_cannot_say_is_refused(tmp_path, vary):
    case = vary("pendulum", {"plant.effects": [{"name": "spring", "on": "hinge", "parameters": {"k": 1.0}}]})
    with pytest.raises(UserError, match=r"plant.effects.0: a URDF cannot hold 'spring' on 'hinge'"):
        simgap.export_model(case, tmp_path / "made.urdf")
    assert not (tmp_path / "made.urdf").exists()


def test_the_public_names_are_there_and_documented(root):
    page = (root / "docs/how-to/python.md").read_text()
    for name in simgap.__all__:
        assert getattr(simgap, name).__doc__
        assert f"`{name}" in page, name
