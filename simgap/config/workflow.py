"""The settings of a run of the workflow: which cases, where they are; `configs/default.yaml` of a plain run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, ValidationError

from simgap.config.base import Section
from simgap.config.load import problem_and_remedy
from simgap.errors import UserError


class EpsSweep(Section):
    """More points of one case."""

    eps: tuple[float, ...] = Field((), description="Radii of the balls that cover X, beside the case's own.")


class WorkflowConfig(Section):
    """What a run is about."""

    case_folder: str = Field("configs/cases", description="Folder of the case files.")
    rig_folder: str = Field("configs/rigs", description="Folder of the rigs that stand in for hardware.")
    sweep_folder: str = Field("configs/sweeps", description="Folder of sweep files.")
    cases: list[str] = Field(min_length=1, description="Cases of the run, by the names of their files.")
    sweeps: dict[str, EpsSweep] = Field(
        default_factory=dict, description="More points, by case, for the table of eps of a full run."
    )


def workflow_config(content: Mapping[str, Any]) -> WorkflowConfig:
    """The checked settings of a run.

    Raises:
        UserError: an unknown or wrong key, named.
    """
    try:
        return WorkflowConfig.model_validate(dict(content))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        if key == "cases" and isinstance(first.get("input"), str):
            name = first["input"]
            problem, remedy = f"a list of names is needed, got '{name}'", f"Write `cases: [{name}]`."
        elif first["type"] == "extra_forbidden":
            problem, remedy = "unknown key", f"Known: {', '.join(WorkflowConfig.model_fields)}."
        elif first["type"] == "missing":
            problem, remedy = "this key is missing", "Add it."
        else:
            problem, said = problem_and_remedy(first)
            remedy = said or "Correct it."
        raise UserError(problem, file="the run's config", key=key, remedy=remedy) from None
