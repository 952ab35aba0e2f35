"""The `simulator` section: the high-fidelity side, every one of its defaults made explicit."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simgap.config.base import Section
from simgap.config.plant import AddedEffect


class Damping(Section):
    """Damping that the engine adds on its own."""

    linear: float = Field(0.04, ge=0, description="Of a link's linear velocity, 1/s; PyBullet's default is 0.04.")
    angular: float = Field(0.04, ge=0, description="Of a link's angular velocity, 1/s; PyBullet's default is 0.04.")
    joint: float = Field(0.0, ge=0, description="Of a joint, N m s/rad; replaces what the URDF says.")


class PyBulletSection(Section):
    """PyBullet over the plant's URDF: joints driven by torques, default motors off."""

    engine: Literal["pybullet"] = Field("pybullet", description="Which engine.")
    urdf: str | None = Field(None, description="Model file if it differs from the plant's, relative to the case file.")
    substeps: int = Field(1, ge=1, description="Engine steps within tau.")
    inertia: Literal["engine", "file"] = Field(
        description="engine: PyBullet's default, which ignores the URDF's inertia; file: the URDF's inertia."
    )
    damping: Damping = Field(Damping(), description="Damping that the engine adds on its own.")
    effects: tuple[AddedEffect, ...] = Field((), description="Effects applied at every engine step.")


class MuJoCoSection(Section):
    """MuJoCo over the plant's URDF (optional extra `simgap[mujoco]`)."""

    engine: Literal["mujoco"] = Field("mujoco", description="Which engine.")
    urdf: str | None = Field(None, description="Model file if it differs from the plant's, relative to the case file.")
    substeps: int = Field(1, ge=1, description="Engine steps within tau.")
    integrator: Literal["euler", "implicit", "rk4"] = Field("euler", description="MuJoCo's integrator.")
    damping: Damping = Field(Damping(linear=0.0, angular=0.0), description="Only `joint` applies to MuJoCo.")
    effects: tuple[AddedEffect, ...] = Field((), description="Effects applied at every engine step.")


JointSimulator = Annotated[PyBulletSection | MuJoCoSection, Field(discriminator="engine")]
