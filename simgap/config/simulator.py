"""The sections `simulator` and `twin`: the keys of every engine; those of one alone are in its file, as `Settings`."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from simgap.config.base import NotNegative, Section
from simgap.config.plant import AddedEffect
from simgap.config.plugged import Plugged
from simgap.errors import UserError


class EngineSection(Section):
    """The keys of every engine; the `Settings` of an engine derive from it."""

    engine: str
    """Which engine: a built-in one, one that an installed distribution offers, or file.py:Class for a class in a file
    beside the case."""
    urdf: str | None = None
    """Model file if it differs from the plant's, relative to the case file."""
    substeps: int = Field(1, ge=1)
    """Engine steps within tau."""
    effects: tuple[AddedEffect, ...] = ()
    """Effects applied at every engine step."""
    timeout: float = Field(60.0, gt=0)
    """Time limit of one call of an engine that is not part of simgap, s; a longer call is ended."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("timeout",)

    def between_poses(self, tau: float, gravity: float) -> float:
        """Distance, m, by which a robot may stray from the line between two poses that the engine records within tau.

        Args:
            tau: sampling time, s.
            gravity: acceleration of the case, m/s^2.

        Raises:
            UserError: an engine that records no poses between samples.
        """
        problem = f"the engine '{self.engine}' records no poses between samples"
        remedy = "A robot with memory needs one that does, such as pybullet_wheeled."
        raise UserError(problem, key="simulator.engine", remedy=remedy)


class Damping(Section):
    """Damping that an engine adds on its own."""

    linear: float = Field(0.04, ge=0)
    """Damping of a link's linear velocity, 1/s; PyBullet's default is 0.04."""
    angular: float = Field(0.04, ge=0)
    """Damping of a link's angular velocity, 1/s; PyBullet's default is 0.04."""
    joint: float = Field(0.0, ge=0)
    """Damping of a joint, N m s/rad; replaces that of the URDF."""


class TwinSection(Section):
    """Engine for which a simulator in closed form stands: both take every step of the run, differences are printed."""

    of: Annotated[EngineSection, Plugged("engines", "engine")]
    """The engine it stands for, with its keys, as in `simulator`."""
    tolerance: dict[str, NotNegative] = Field(default_factory=dict)
    """For a state, the largest difference after one step that is taken, in its unit; more fails the run. States that
    are not named are measured and not judged."""
