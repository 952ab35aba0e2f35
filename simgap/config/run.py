"""The files of a workflow run beside its cases: its settings, rigs and sweeps.

The settings say which cases there are and where; those of a plain run are `configs/default.yaml`. A rig is an
experiment on a stand-in for hardware, which leaves recordings and nothing else. A sweep is a case and the values of any
of its keys; each combination is a case of its own, named by its values.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from simgap.config.base import Section
from simgap.config.case import Case
from simgap.config.load import case_content, parse_case, read_yaml, validated
from simgap.errors import UserError


class Excitation(Section):
    """A random-phase multisine on every input."""

    amplitude: float = Field(gt=0)
    """Largest |u|, in the unit of the input."""
    low: float = Field(0.1, gt=0)
    """Lowest frequency, Hz."""
    high: float = Field(8.0, gt=0)
    """Highest frequency, Hz."""


class Rig(Section):
    """Experiment: whose simulator stands in for hardware, how it is moved and what is measured."""

    case: str
    """Case file whose simulator is the rig, relative to this file."""
    substeps: int | None = Field(None, ge=1)
    """Engine steps within tau while recording; those of the case if not given. Hardware does not move in steps of the
    controller: a fine engine step keeps the engine's integration error out of the recordings."""
    traces: int = Field(2, ge=1)
    """Number of recordings, each from rest at the origin."""
    seconds: float = Field(15.0, gt=0)
    """Length of each, s."""
    excitation: Excitation
    """Signals of the inputs."""
    noise: dict[str, float] = Field(min_length=1)
    """For each state that is measured, the standard deviation of its noise."""
    seed: int = Field(0, ge=0)
    """Seed of phases and noise."""


def case_of_rig(path: Path) -> Path:
    """The case file that a rig file names: its simulator is the rig, whatever the rig file itself is called.

    Raises:
        UserError: missing file, unknown, missing or wrong key.
    """
    return path.parent / load_rig(path).case


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        UserError: missing file, unknown, missing or wrong key.
    """
    return validated(Rig, read_yaml(path), path)


MARK = "--"
"""Between the name of a sweep and that of a point."""
NAME = re.compile(r"[a-z][a-z0-9_]*(-[a-z0-9_]+)*")
"""Name of a sweep, as the workflow takes it (rules/sweep.smk): a doubled hyphen stands between sweep and point."""
MOST_POINTS = 1000


class Sweep(Section):
    """A sweep file."""

    case: str
    """Case file, relative to the sweep file."""
    title: str = ""
    """Title of the page."""
    mode: Literal["grid", "zip"] = "grid"
    """grid: every combination. zip: the first values, the second ones, ..."""
    axes: dict[str, tuple[Any, ...]] = Field(min_length=1)
    """Values by dotted key of the case, such as gap.basis or synthesis.cells."""


@dataclass(frozen=True)
class Point:
    """One case of a sweep: its name, what its keys are set to, its content and the checked case."""

    name: str
    values: dict[str, Any]
    content: dict[str, Any]
    case: Case


def load_sweep(path: Path) -> Sweep:
    """Read a sweep file.

    Raises:
        UserError: a file that is missing or no YAML, an unknown or wrong key.
    """
    return validated(Sweep, read_yaml(path), path)


def base_of(path: Path) -> Path:
    """The case file that a sweep file names."""
    return path.parent / load_sweep(path).case


def points_of_sweep(path: Path) -> list[Point]:
    """The points of a sweep file, the last axis running fastest.

    A point is the case with its keys set, without recordings of its own: what it is asked is what the keys change.

    Raises:
        UserError: axes of different lengths where they are zipped, too many points, or a point that is no case.
    """
    if not NAME.fullmatch(path.stem):
        remedy = "Rename it: lower-case letters, digits, and single - or _ between them, such as basis.yaml."
        raise UserError("the file's name is that of the sweep and of a folder", file=path, remedy=remedy)
    sweep = load_sweep(path)
    if sweep.mode == "zip" and len({len(values) for values in sweep.axes.values()}) > 1:
        raise UserError("zipped axes have different lengths", file=path, key="axes", remedy="Give each as many values.")
    values = sweep.axes.values()
    together = itertools.product(*values) if sweep.mode == "grid" else zip(*values, strict=True)
    rows = [dict(zip(sweep.axes, row, strict=True)) for row in itertools.islice(together, MOST_POINTS + 1)]
    if not 0 < len(rows) <= MOST_POINTS:
        problem = "there is no point" if not rows else f"there are more than {MOST_POINTS} points"
        raise UserError(problem, file=path, key="axes", remedy="Give other values.")
    if any(row in rows[:k] for k, row in enumerate(rows)):
        raise UserError("a point appears twice", file=path, key="axes")
    base = path.parent / sweep.case
    content = case_content(base)
    parse_case(copy.deepcopy(content), base)  # a mistake of its own is told with its own file
    content.pop("measured", None)
    return [_point(path, base, content, row) for row in rows]


def _point(path: Path, base: Path, content: dict[str, Any], values: dict[str, Any]) -> Point:
    name = f"{path.stem}{MARK}{hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:8]}"
    changed = copy.deepcopy(content)
    for key, value in values.items():
        _set(changed, key, value, path)
    title = content.get("title") or content["name"]
    changed |= {"name": name, "title": f"{title}: {', '.join(f'{k} = {v}' for k, v in values.items())}"}
    return Point(name, values, changed, parse_case(copy.deepcopy(changed), path, plugins_beside=base))


def _set(content: dict[str, Any], key: str, value: Any, path: Path) -> None:
    place, (*parents, last) = content, key.split(".")
    for part in parents:
        place = place.setdefault(part, {})
        if not isinstance(place, dict):
            raise UserError(f"'{part}' has no keys", file=path, key=f"axes.{key}", remedy="Correct the dotted key.")
    place[last] = value


class EpsSweep(Section):
    """More points of one case."""

    eps: tuple[float, ...] = ()
    """Radii of the balls that cover X, beside the case's own."""


class WorkflowConfig(Section):
    """Settings of a run: where its files are, and its cases."""

    case_folder: str = "configs/cases"
    """Folder of the case files."""
    rig_folder: str = "configs/rigs"
    """Folder of the rigs that stand in for hardware."""
    sweep_folder: str = "configs/sweeps"
    """Folder of sweep files."""
    cases: list[str] = Field(min_length=1)
    """Cases of the run, by the names of their files."""
    sweeps: dict[str, EpsSweep] = Field(default_factory=dict)
    """More points, by case, for the table of eps of a full run."""

    @field_validator("cases", mode="before")
    @classmethod
    def _names(cls, value: object) -> object:
        if isinstance(value, str):
            raise ValueError(f"a list of names is needed, got '{value}'. Write `cases: [{value}]`.")
        return value


def workflow_config(content: Mapping[str, Any]) -> WorkflowConfig:
    """The checked settings of a run.

    Raises:
        UserError: an unknown or wrong key, named.
    """
    return validated(WorkflowConfig, dict(content), "the run's config")
