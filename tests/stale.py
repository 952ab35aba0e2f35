"""Which slow tests have to run again: those whose code has changed since they last passed (`pytest -m slow --stale`).

The code of a file of tests is the file, the helpers that it imports, and the import closure in the package of all of
them, as results of stages know it, with every plug-in; a file that imports nothing of the package starts it as a
process, and is of all of it. What is not Python (cases, rules, templates, the lock file) and what pytest reads anyway
count for every file; of the folders of `NAMED`, what a text in the file names.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from simgap import plugins
from simgap.provenance import UNHASHED, closure, digest, file_digest, imported_names, imports, module_digests

SLOW = {
    "checker": ["test_reach"],
    "cli": ["test_notebook", "test_tutorial"],
    "diagnosis": [
        "test_arms", "test_change", "test_encoder", "test_experiment", "test_measured_records", "test_push",
        "test_recording_faults",
    ],
    "gap": ["test_staircase"],
    "installation": ["*"],
    "io": ["test_full_disk", "test_hostile_input"],
    "simulators": ["test_drake_joints", "test_mjcf", "test_mujoco_wheeled"],
    "stages": [
        "test_acted_out", "test_case_studies", "test_certified_tasks", "test_closed_road",
        "test_conditions", "test_diagnosis_records",
        "test_drive", "test_faults_kill", "test_gap_from_case", "test_memory", "test_new", "test_next",
        "test_pages_in_a_browser", "test_robot_from_case", "test_sensing_stage",
        "test_servo_bench", "test_several_records", "test_shield", "test_twin",
    ],
    "synthesis": ["test_proposal"],
    "undeclared": [
        "test_alike", "test_creep", "test_drives", "test_force_curve", "test_many", "test_merge", "test_mujoco",
        "test_outside", "test_robot",
    ],
    "workflow": ["*"],
}  # fmt: skip
"""Files of tests that take more than two thirds of the time of all: whole roads, studies, kills, other installations.
What they protect has a small test elsewhere, or is tried again only when its code changes."""
TESTS = Path(__file__).parent
ROOT = TESTS.parent
PASSED = TESTS / "slow_passed.json"
"""Digests of the code with which each file of slow tests passed; `--record` writes it."""
OTHERS = ("configs/**/*", "rules/*", "reports/**/*", "profiles/**/*", "Snakefile", "uv.lock", "docs/tutorial/*")
OTHERS += ("pyproject.toml", "tests/conftest.py")
NAMED = ("benchmarks", "checker", "docs")


def is_slow(file: Path) -> bool:
    """Whether plain `pytest` leaves a file of tests out, unless it is named."""
    names = SLOW.get(file.parent.name, []) if file.parent.parent == TESTS else []
    return file.stem in names or "*" in names


def stale(files: Iterable[Path]) -> set[Path]:
    """Those of the files of tests that have not passed with the code of today."""
    known = json.loads(PASSED.read_text()) if PASSED.exists() else {}
    return {file for file in files if known.get(_name(file)) != made_of(file)}


def record(passed: Iterable[Path], failed: Iterable[Path]) -> None:
    """Keep the digests of files that passed; forget those that did not, and files that are no more."""
    known = json.loads(PASSED.read_text()) if PASSED.exists() else {}
    known |= {_name(file): made_of(file) for file in passed}
    gone = {_name(file) for file in failed} | {name for name in known if not (ROOT / name).exists()}
    kept = {name: value for name, value in sorted(known.items()) if name not in gone}
    PASSED.write_text(json.dumps(kept, indent=1) + "\n")


def made_of(file: Path) -> str:
    """A hash of the code of a file of tests."""
    own, modules, waiting = {}, set[str](), [file]
    while waiting:
        path = waiting.pop()
        if _name(path) in own:
            continue
        own[_name(path)] = file_digest(path)
        for name in imported_names(path.read_bytes()):
            modules |= closure(name)
            waiting += _helpers(path, name)
        own |= {_name(place): file_digest(place) for place in _named_in(path)}
    found = modules | _plugged() if modules else set(imports())
    return digest([own, module_digests({*found, *UNHASHED}), _others()])


def _helpers(path: Path, name: str) -> list[Path]:
    """The file of a helper that stands beside the tests or is named from the root, if it is one."""
    relative = Path(*name.split(".")).with_suffix(".py")
    return [place for place in (path.parent / relative, ROOT / relative) if place.is_file() and TESTS in place.parents]


def _named_in(path: Path) -> list[Path]:
    """Files of the folders of `NAMED` that a text in it names, or that lie in a folder that it does."""
    texts = {n.value for n in ast.walk(ast.parse(path.read_bytes())) if isinstance(n, ast.Constant)}
    places = [ROOT / text for text in texts if isinstance(text, str) and text.partition("/")[0] in NAMED]
    files = [file for place in places for file in (place, *place.rglob("*")) if "__pycache__" not in file.parts]
    return [file for file in files if file.is_file()]


@cache
def _plugged() -> frozenset[str]:
    """What no import shows, because it is found by name."""
    named = (target.partition(":")[0] for group in plugins.BUILT_IN.values() for target in group.values())
    return frozenset(module for name in named for module in closure(name))


@cache
def _others() -> dict[str, str]:
    found = (path for pattern in OTHERS for path in sorted(ROOT.glob(pattern)) if path.is_file())
    return {_name(path): file_digest(path) for path in found}


def _name(file: Path) -> str:
    return file.resolve().relative_to(ROOT).as_posix()
