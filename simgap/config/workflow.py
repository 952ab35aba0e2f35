"""The settings of a run of the workflow: which cases, where they are; `configs/default.yaml` of a plain run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, field_validator

from simgap.config.base import Section
from simgap.config.load import validated


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
