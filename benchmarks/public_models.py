"""Public robot files as they are: what `simgap new` and `simgap check` make of each, and whether that is right.

    python benchmarks/public_models.py [--packages FOLDER] [--only NAME | --missing] [--run]

Files are those of installed packages (`pip install --target FOLDER --no-deps gymnasium dm-control example-robot-data`
has those that simgap does not need); none is copied here. What is right was written down by hand from the files: a
case, or a refusal that holds a word. Each is tried in a process of its own with LIMIT seconds of CPU time, SEARCH of
them for numbers; --run takes a case that asks for a controller to its closed loop. Rows are in
benchmarks/results/public_models.json; docs/evidence/public_models.md shows them.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import resource
import site
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
OUT, PAGE = ROOT / "benchmarks/results/public_models.json", ROOT / "docs/evidence/public_models.md"
LIMIT, SEARCH, RUN = 240, 60.0, 1200
APART = 1.5
"""Times by which the CPU time that `simgap check` says may miss what the run takes."""
CASE = "case"
BULLET, DRAKE, GYM, SUITE = (
    "pybullet_data",
    "pydrake/share/drake/examples",
    "gymnasium/envs/mujoco/assets",
    "dm_control",
)
DATA = "cmeel.prefix/share/example-robot-data/robots"
SHIPPED_AS = {"cmeel.prefix": "example-robot-data", "pydrake": "drake"}
LEGS, FREE, WHEELS = "chains of joints begin at its base", "floating base", "it has wheels"
STILL = "has no joint that turns or slides"
FILES: tuple[tuple[str, str, dict[str, Any], str], ...] = (
    # folder of a package, file, options, what is right: a case, or a word of the refusal
    (BULLET, "cartpole.urdf", {}, CASE),
    (BULLET, "pendulum5.urdf", {}, "which joints have a drive"),
    (BULLET, "cube_rotate.urdf", {}, CASE),
    (BULLET, "TwoJointRobot_wo_fixedJoints.urdf", {}, "no body has principal moments"),
    (BULLET, "franka_panda/panda.urdf", {}, "mimics"),
    (BULLET, "franka_panda/panda.urdf", {"joints": ["panda_joint2", "panda_joint4"]}, CASE),
    (BULLET, "franka_panda/panda.urdf", {"joints": ["panda_joint1", "panda_joint4"]}, CASE),
    (BULLET, "kuka_iiwa/model.urdf", {}, CASE),
    (BULLET, "kuka_iiwa/model.urdf", {"joints": ["lbr_iiwa_joint_4"]}, CASE),
    (BULLET, "xarm/xarm6_robot.urdf", {"joints": ["joint3"]}, "no body has principal moments"),
    (BULLET, "xarm/xarm6_robot.urdf", {"joints": ["joint5"]}, CASE),
    (BULLET, "pr2_gripper.urdf", {"joints": ["left_gripper_joint"], "base": "fixed"}, CASE),
    (BULLET, "a1/a1.urdf", {}, LEGS),
    (BULLET, "laikago/laikago_toes.urdf", {}, LEGS),
    (BULLET, "mini_cheetah/mini_cheetah.urdf", {}, LEGS),
    (BULLET, "quadruped/minitaur.urdf", {}, LEGS),
    (BULLET, "humanoid/humanoid.urdf", {}, LEGS),
    (BULLET, "r2d2.urdf", {}, WHEELS),
    (BULLET, "racecar/racecar.urdf", {}, WHEELS),
    (BULLET, "husky/husky.urdf", {}, "run xacro first"),
    (BULLET, "cube.urdf", {}, STILL),
    (BULLET, "biped/biped2d_pybullet.urdf", {}, "-1.57."),
    (DRAKE, "acrobot/Acrobot_no_collision.urdf", {"inputs": ["elbow"], "at": {"shoulder": 3.141592653589793}}, CASE),
    (DRAKE, "acrobot/Acrobot.urdf", {}, 'Add <link name="world"/>'),
    (DRAKE, "pendulum/Pendulum.urdf", {}, CASE),
    (DATA, "ur_description/urdf/ur5_robot.urdf", {"joints": ["elbow_joint"]}, CASE),
    (DATA, "ur_description/urdf/ur5_robot.urdf", {"joints": ["shoulder_pan_joint", "elbow_joint"]}, CASE),
    (DATA, "ur_description/urdf/ur5_robot.urdf", {"joints": ["wrist_1_joint"]}, CASE),
    (DATA, "ur_description/urdf/ur5_robot.urdf", {"joints": ["wrist_3_joint"]}, CASE),
    (DATA, "panda_description/urdf/panda.urdf", {"joints": ["panda_joint4"]}, CASE),
    (DATA, "kinova_description/robots/kinova.urdf", {"joints": ["j2s6s200_joint_2"]}, CASE),
    (DATA, "double_pendulum_description/urdf/double_pendulum.urdf", {}, "no room between its limits"),
    (DATA, "double_pendulum_description/urdf/double_pendulum_continuous.urdf", {}, "which joints have a drive"),
    (DATA, "asr_twodof_description/urdf/TwoDofs.urdf", {}, CASE),
    (DATA, "so_arm_description/urdf/so100.urdf", {"base": "fixed"}, CASE),
    (DATA, "z1_description/urdf/z1.urdf", {"joints": ["joint3"]}, CASE),
    (DATA, "finger_edu_description/robots/finger_edu.urdf", {"base": "fixed"}, CASE),
    (DATA, "g1_description/urdf/g1_29dof_rev_1_0.urdf", {}, LEGS),
    (DATA, "solo_description/robots/solo12.urdf", {}, LEGS),
    (DATA, "tiago_pro_description/robots/tiago_pro.urdf", {}, WHEELS),
    (DATA, "romeo_description/urdf/romeo.urdf", {}, LEGS),
    (DATA, "borinot_description/urdf/borinot_flying_arm_2.urdf", {}, FREE),
    (GYM, "inverted_pendulum.xml", {"mjcf": True, "at": {"hinge": 0.0}}, CASE),
    (GYM, "inverted_double_pendulum.xml", {"mjcf": True}, CASE),
    (GYM, "half_cheetah.xml", {"mjcf": True}, FREE),
    (GYM, "ant.xml", {"mjcf": True}, FREE),
    (GYM, "reacher.xml", {"mjcf": True, "joints": ["joint0", "joint1"], "base": "fixed"}, CASE),
    (GYM, "pusher_v5.xml", {}, "It is MJCF"),
    (SUITE, "suite/pendulum.xml", {"mjcf": True}, CASE),
    (SUITE, "suite/acrobot.xml", {"mjcf": True, "at": {"shoulder": 0.0}}, CASE),
    (SUITE, "suite/cartpole.xml", {"mjcf": True}, CASE),
    (SUITE, "suite/finger.xml", {"mjcf": True, "joints": ["proximal", "distal"]}, CASE),
    (SUITE, "suite/point_mass.xml", {"mjcf": True}, "tendons"),
    (SUITE, "suite/humanoid.xml", {"mjcf": True}, FREE),
    (SUITE, "third_party/kinova/jaco_arm.xml", {"mjcf": True, "joints": ["joint_2"]}, CASE),
)


def tried(path: Path, options: dict[str, Any], run: bool) -> dict[str, Any]:
    """What became of a file: `became` (case, refused, traceback), `why`."""
    from simgap.errors import SimgapError
    from simgap.extras.wizard import new_case as new
    from simgap.stages import check

    given, notes = dict(options), list[str]()
    files = {"urdf": None, "mjcf": path} if given.pop("mjcf", False) else {"urdf": path}
    with tempfile.TemporaryDirectory() as folder:
        try:
            case = new.run("mine", out=Path(folder), note=notes.append, seconds=SEARCH, **files, **given)
            checked = check.run(case)
        except SimgapError as error:
            return {"became": "refused", "why": str(error).replace(f"{folder}/", "").replace(f"{path}: ", "")}
        except Exception:
            return {"became": "traceback", "why": traceback.format_exc().strip().splitlines()[-1]}
        said = [n for n in notes if n.startswith(("Its base", "No controller", "A robot on"))]
        loop: dict[str, Any] = {}
        if run and re.search(r"^synthesis:", case.read_text(), re.MULTILINE):
            told = {"told_s": round(sum(cost.seconds for cost in checked.costs if not cost.at_most), 1)}
            loop = told | closed_loop(case)
        return {**loop, "became": CASE, "joints": case.read_text().count("quantity: position"), "controller": bool(
            re.search(r"^synthesis:", case.read_text(), re.MULTILINE)), "in_order": check.conclusion(checked, case)[:80]
            .replace(f"{folder}/", ""), "why": " ".join(said)}  # fmt: skip


def closed_loop(case: Path) -> dict[str, Any]:
    """What a run of the case ends with: `won`, `violations` of so many `runs`; or why it ended; and its `run_s`."""
    simgap, before = Path(sys.executable).with_name("simgap"), _spent()
    ended = subprocess.run(
        [simgap, "run", case.name, "--cores", "1"], cwd=case.parent, capture_output=True, text=True, timeout=4 * RUN
    )
    took = {"run_s": round(_spent() - before, 1)}
    summary = case.parent / f"results/{case.stem}/summary.json"
    if ended.returncode or not summary.is_file():
        reasons = [line for line in ended.stderr.splitlines() if line.startswith("simgap: ")]
        return took | {"ran": reasons[0][:300] if reasons else f"status {ended.returncode}"}
    found = json.loads(summary.read_text())
    loop = (found.get("closed_loop") or {}).get("gap", {}).get("simulator", {})
    return took | {"won": (found.get("winning_fraction") or {}).get("gap"), "runs": loop.get("runs"),
            "violations": loop.get("runs_that_violated_it")}  # fmt: skip


def _spent() -> float:
    """CPU seconds of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _child(path: Path, options: dict[str, Any], pipe: Any, run: bool) -> None:
    limit = RUN if run else LIMIT
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    pipe.send(tried(path, options, run))


def row(found: Path, package: str, name: str, options: dict[str, Any], right: str, run: bool) -> dict[str, Any]:
    """One file in a process of its own."""
    here, there = multiprocessing.Pipe(duplex=False)
    before, began = _spent(), time.perf_counter()
    process = multiprocessing.get_context("fork").Process(target=_child, args=(found, options, there, run))
    process.start()
    there.close()
    try:
        said = here.recv()
    except EOFError:
        said = {"became": "ended", "why": f"ended by the engine, or after {LIMIT} s of CPU time"}
    process.join()
    good = (
        said["became"] == CASE
        if right == CASE
        else said["became"] == "refused" and right.lower() in said["why"].lower()
    )
    return {"package": package.split("/")[0], "file": name, "options": options, "right": right, **said, "good": good,
            "cpu_s": round(_spent() - before, 1), "minutes": round((time.perf_counter() - began) / 60, 1),
            "load": round(os.getloadavg()[1], 1)}  # fmt: skip


def counts(rows: list[dict[str, Any]]) -> dict[str, int]:
    """How many ended how."""
    return {
        "listed": len(FILES),
        "tried": len(rows),
        "right": sum(r["good"] for r in rows),
        "right cases": sum(r["good"] and r["became"] == CASE for r in rows),
        "right refusals": sum(r["good"] and r["became"] == "refused" for r in rows),
        "tracebacks": sum(r["became"] == "traceback" for r in rows),
        "ended": sum(r["became"] == "ended" for r in rows),
        "false in order": sum(r["became"] == CASE and r["right"] != CASE for r in rows),
        "cases that ask for a controller": sum(bool(r.get("controller")) for r in rows),
        "controllers in closed loop without a violation": sum(
            bool(r.get("runs")) and not r["violations"] for r in rows
        ),
        "runs within 1.5 times of what check said": sum(
            bool(r.get("runs")) and 1 / APART <= r["told_s"] / r["run_s"] <= APART for r in rows
        ),
    }


def _options(given: dict[str, Any]) -> str:
    words = []
    for key, value in given.items():
        if isinstance(value, dict):
            words.append(f"--{key} {','.join(f'{name}={place:.4g}' for name, place in value.items())}")
        else:
            words.append(
                f"--{key}" if value is True else f"--{key} {value if isinstance(value, str) else ','.join(value)}"
            )
    return " ".join(words)


def page(rows: list[dict[str, Any]]) -> str:
    """The table as Markdown."""
    lines = [
        "# Public robot files",
        "",
        "What `simgap new` and `simgap check` make of robot files as packages ship them, none of which was written for "
        "simgap. Right is what was written down by hand from the files: a case, or a refusal for that reason. Made by "
        f"`python benchmarks/public_models.py` with {SEARCH:g} s for the search of numbers; where a run "
        "followed (--run), what the controller wins, how often it failed, the CPU time of the run and what "
        "`simgap check` had said of it.",
        "",
        "CPU seconds say what a file costs. Minutes are of the clock, on one of two cores that are shared with other "
        "work: the load beside them is the mean of five minutes of processes that wait or compute. A row keeps the "
        "numbers of the code that made it.",
        "",
        ". ".join(f"{name}: {n}" for name, n in counts(rows).items()) + ".",
        "",
        "| package | file | options | became | right | minutes, load | CPU s | its run, check said | what was said |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        became = r["became"]
        if became == CASE:
            became = f"case of {r['joints']}{', controller asked for' * r['controller']}"
            if r.get("runs"):
                became = f"case of {r['joints']}, wins {r['won']:.3f}, {r['violations']} of {r['runs']} runs failed"
            elif r.get("ran"):
                first = r["ran"].removeprefix("simgap: mine.yaml: ").split(". ")[0]
                became = f"case of {r['joints']}, no controller: {first}"
        why = re.sub(r"\s+", " ", r["why"]).replace("|", "\\|").replace("<", "&lt;")[:220]
        right = "yes" if r["good"] else "**no**"
        own = [
            SHIPPED_AS.get(r["package"], r["package"]),
            r["file"],
            _options(r["options"]),
            became,
            right,
            f"{r['minutes']}, {r['load']}" if "minutes" in r else "",
            str(r["cpu_s"]),
            f"{r['run_s']:.0f}, {r['told_s']:.0f}" if r.get("runs") else "",
            why,
        ]
        lines.append(f"| {' | '.join(own)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Try the files that are there; rows of the results that are not asked for stay."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--packages", type=Path, action="append", default=[])
    parser.add_argument("--only", default="")
    parser.add_argument("--missing", action="store_true")
    parser.add_argument("--run", action="store_true")
    asked = parser.parse_args()

    rows: list[dict[str, Any]] = json.loads(OUT.read_text())["rows"] if OUT.is_file() else []
    listed = [(package.split("/")[0], name, options) for package, name, options, _ in FILES]
    rows = [r for r in rows if (r["package"], r["file"], r["options"]) in listed]
    for package, name, options, right in sorted(FILES, key=lambda file: file[3] == CASE):  # refusals take no time
        places = [Path(folder) / package / name for folder in (*asked.packages, *site.getsitepackages())]
        found = next((p for p in places if p.is_file()), None)
        there = any((r["package"], r["file"], r["options"]) == (package.split("/")[0], name, options) for r in rows)
        if found is None or asked.only not in name or (asked.missing and there):
            continue
        own = row(found, package, name, options, right, asked.run)
        rows = [r for r in rows if (r["package"], r["file"], r["options"]) != (own["package"], name, options)] + [own]
        print(own["good"], name, own["became"], own["why"][:160], f"{own['minutes']} min", file=sys.stderr, flush=True)
        OUT.write_text(json.dumps({"counts": counts(rows), "rows": rows}, indent=1) + "\n")
        PAGE.write_text(page(rows))


if __name__ == "__main__":
    main()
