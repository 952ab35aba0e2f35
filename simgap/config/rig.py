"""A rig file: an experiment on a stand-in for hardware, which leaves recordings and nothing else."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from simgap.config.base import Section
from simgap.config.load import read_yaml, validated


class Excitation(Section):
    """A random-phase multisine on every input."""

    amplitude: float = Field(gt=0, description="Largest |u|, in the unit of the input.")
    low: float = Field(0.1, gt=0, description="Lowest frequency, Hz.")
    high: float = Field(8.0, gt=0, description="Highest frequency, Hz.")


class Rig(Section):
    """Which case's simulator stands in for hardware, how it is moved and what is measured."""

    case: str = Field(description="Case file whose simulator is the rig, relative to this file.")
    substeps: int | None = Field(
        None,
        ge=1,
        description="Engine steps within tau while recording; those of the case if not given. Hardware does not move "
        "in steps of the controller: a fine engine step keeps the engine's integration error out of the recordings.",
    )
    traces: int = Field(2, ge=1, description="Number of recordings, each from rest at the origin.")
    seconds: float = Field(15.0, gt=0, description="Length of each, s.")
    excitation: Excitation = Field(description="Signals of the inputs.")
    noise: dict[str, float] = Field(
        min_length=1, description="For each state that is measured, the standard deviation of its noise."
    )
    seed: int = Field(0, ge=0, description="Seed of phases and noise.")


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
