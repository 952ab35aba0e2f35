"""The `simulator` section: what every engine's keys have in common; an engine's own are in its file, as `Settings`."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from simgap.config.base import Section
from simgap.config.plant import AddedEffect
from simgap.errors import UserError


class EngineSection(Section):
    """The keys of every engine; the `Settings` of an engine derive from it."""

    engine: str = Field(
        description="Which engine: a built-in one, one that an installed distribution offers, or file.py:Class for a "
        "class in a file beside the case."
    )
    urdf: str | None = Field(None, description="Model file if it differs from the plant's, relative to the case file.")
    substeps: int = Field(1, ge=1, description="Engine steps within tau.")
    effects: tuple[AddedEffect, ...] = Field((), description="Effects applied at every engine step.")
    timeout: float = Field(
        60.0, gt=0, description="Longest time of one call of an engine that is not simgap's own, s; then it is ended."
    )

    OPTIONAL: ClassVar[tuple[str, ...]] = ("timeout",)

    def between_poses(self, tau: float, gravity: float) -> float:
        """How far (m) a robot may stray from the straight line between two poses that the engine records within tau.

        Args:
            tau: sampling time, s.
            gravity: acceleration of the case, m/s^2.

        Raises:
            UserError: an engine that records no poses between samples.
        """
        raise UserError(
            f"the engine '{self.engine}' records no poses between samples",
            key="simulator.engine",
            remedy="A robot with memory needs one that does, such as pybullet_wheeled.",
        )


class Damping(Section):
    """Damping that an engine adds on its own."""

    linear: float = Field(0.04, ge=0, description="Of a link's linear velocity, 1/s; PyBullet's default is 0.04.")
    angular: float = Field(0.04, ge=0, description="Of a link's angular velocity, 1/s; PyBullet's default is 0.04.")
    joint: float = Field(0.0, ge=0, description="Of a joint, N m s/rad; replaces what the URDF says.")
