"""The sections `simulator` and `twin`: the keys of every engine; those of one alone are in its file, as `Settings`."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from simgap.arrays import Floats
from simgap.config.base import NotNegative, Positive, Section
from simgap.config.plant import AddedEffect
from simgap.config.plugged import Plugged
from simgap.errors import UserError


class RandomNumber(Section):
    """A random number around 0, drawn anew in every sampling time, independent of all others."""

    normal: Positive | None = None
    """Normally distributed, with this standard deviation, in the unit of what it is added to."""
    uniform: Positive | None = None
    """Uniformly distributed, from minus this number to this number."""

    @model_validator(mode="after")
    def _one_of_both(self) -> RandomNumber:
        if (self.normal is None) == (self.uniform is None):
            raise ValueError("a random number is either normal or uniform: give one of them")
        return self

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """(count,) independent draws."""
        if self.uniform is not None:
            return rng.uniform(-self.uniform, self.uniform, count)
        return rng.normal(0.0, self.normal or 0.0, count)


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

    stochastic: bool = False
    """The engine itself draws random numbers, such as a Python function that takes `rng`."""
    noise: dict[str, RandomNumber] = Field(default_factory=dict)
    """Noise that simgap adds to any engine: by the name of an input, to the command over tau; by the name of a state,
    to that state after tau."""
    noise_seed: int = Field(0, ge=0)
    """Seed of everything that is random in the simulator."""

    NOISE: ClassVar[tuple[str, ...]] = ("stochastic", "noise", "noise_seed")
    OPTIONAL: ClassVar[tuple[str, ...]] = ("timeout", *NOISE)

    @property
    def is_random(self) -> bool:
        """True if two calls from the same state may differ."""
        return self.stochastic or bool(self.noise)

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
