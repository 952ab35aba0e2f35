"""The interface that an engine implements to be the high-fidelity side."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.plant import AddedEffect, DomainSection
from simgap.config.simulator import EngineSection
from simgap.effects.base import Effect
from simgap.errors import Finding, UserError
from simgap.late import sympy as sp
from simgap.plants.model_file import Link


def domain_of(case: Case) -> DomainSection:
    """Sampling time, X and U of a case.

    Raises:
        UserError: a case without them.
    """
    if case.domain is None:
        raise UserError("the simulator needs a sampling time", key="domain.tau", remedy="Add `domain:`.")
    return case.domain


def added_effects(case: Case) -> tuple[AddedEffect, ...]:
    """Effects that the simulator of a case adds; none without a simulator."""
    return case.simulator.effects if case.simulator is not None else ()


@dataclass(frozen=True)
class FileTraits:
    """Behaviour of an engine that loads a URDF; tests show each trait in the engine itself.

    Attributes:
        stops: whether a joint stops at the ends of its range.
        damps_links: whether it damps the motion of links on its own (`simulator.damping`).
        fastest: the speed at which it cuts every joint, rad/s or m/s; None if it does not.
    """

    stops: bool = True
    damps_links: bool = False
    fastest: float | None = None


class Simulator(ABC):
    """The map `x+ = f_hat(x, u)` over one sampling time (paper, eq. simulator_model).

    An instance owns an engine and must live in a process of its own (`simgap.simulators.process`). It is a context
    manager, which closes the engine at its end.
    """

    nx: int
    nu: int
    engine: str
    remembers: bool = False
    """True if delay or lag of inputs, or noise, give a state more than one successor; `spread` is then its range."""
    draws: int = 0
    """How often `spread` draws the noise, the same noise at every state and input; 0: each its own, once."""

    @cached_property
    def rng(self) -> np.random.Generator:
        """Where a stochastic engine takes all its random numbers from; replaced before every call.

        Raises:
            UserError: asked for in a case that does not say that its simulator is random.
        """
        raise UserError(
            "the engine draws random numbers, and the case does not say so", key="simulator.stochastic",
            remedy="Say `stochastic: true` there.",
        )  # fmt: skip

    @abstractmethod
    def reset(self, x: Floats) -> None:
        """Put the plant at state x (nx,), with nothing left of what ran before."""

    @abstractmethod
    def advance(self, u: Floats) -> Floats:
        """Run one sampling time under input u (nu,): -> the new state (nx,)."""

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx); the same bits in any order."""
        out = np.empty((len(x), self.nx))
        for k in range(len(x)):
            self.reset(x[k])
            out[k] = self.advance(u[k])
        return out

    def spread(self, x: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Least and largest successors over what earlier commands leave behind: (n, nx), (n, nu) -> two (n, nx)."""
        following = self.rollouts(x, u)
        return following, following

    def loaded(self) -> Mapping[str, Link]:
        """Links of the model file as the engine computes with them, by name; empty for an engine without a file."""
        return {}

    def close(self) -> None:  # noqa: B027 - most engines have nothing to release
        """Release the engine."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


class Engine(Simulator):
    """A simulator that a case can name: a plug-in of the group `engines`, one a file.

    Its file is imported to check a case, long before anything runs; what takes time to import belongs into functions.
    """

    Settings: ClassVar[type[EngineSection]]
    """The keys of the case's section `simulator`."""
    distributions: ClassVar[tuple[str, ...]] = ()
    """Installed distributions that results depend on, such as ("mujoco",); their versions enter every hash."""
    stochastic: ClassVar[bool] = False
    """True if it may draw random numbers, all of them from `self.rng`; the case then says `stochastic: true`."""
    of_a_person: ClassVar[bool] = False
    """True if a built-in engine runs code of a person, which is tried as that of a plug-in is (`simulators.probe`)."""
    file_traits: ClassVar[FileTraits | None] = None
    """Behaviour with a URDF that no message tells of; None for an engine that loads none."""

    @classmethod
    @abstractmethod
    def build(cls, case: Case, folder: Path) -> Simulator:
        """The engine for a case whose relative paths start from `folder`.

        Raises:
            UserError: a case that this engine cannot run.
        """

    @classmethod
    def closed_form(cls, case: Case, folder: Path) -> tuple[sp.Expr, ...] | None:
        """The map f_hat over tau, one expression a state over the symbols of states and inputs; None for a black box.

        Where there is one, the gap is bounded by enclosures of it and no Lipschitz constant is estimated.

        Raises:
            UserError: a case that this engine cannot run.
        """
        return None

    @classmethod
    def findings(cls, case: Case, folder: Path) -> list[Finding] | None:
        """Findings about a model file in the engine's own format; None for an engine without one.

        Raises:
            UserError: a case that this engine cannot run.
        """
        return None

    @classmethod
    def switches(cls, case: Case, folder: Path) -> tuple[sp.Expr, ...]:
        """Surfaces, 0 at an expression over states and inputs, on which a file in the engine's own format switches.

        Raises:
            UserError: a case that this engine cannot run.
        """
        return ()

    @classmethod
    def acts_out(cls, effect: Effect) -> bool:
        """True if the engine can apply this effect; a case that declares another one is refused."""
        return False

    @classmethod
    def of_its_own(cls, case: Case) -> bool:
        """True if it computes a model of its own, which may have what the nominal model lacks.

        One that is made of the nominal model lacks the same, so that what is found on hardware is put on both.
        """
        return True


class PathSimulator(Simulator):
    """A planar robot whose state is its pose while the engine remembers more; it records poses between samples."""

    pose: tuple[int, int, int]
    """Which states are x, y and heading."""

    @abstractmethod
    def responses(self, history: Floats, inputs: Floats, heading: float = 0.0) -> Floats:
        """Paths in the body frame of the pose that a history of inputs (k, nu) leads to, from rest.

        -> (M, poses, 3), one for each of the inputs (M, nu).
        """

    @abstractmethod
    def chain(self, start: Floats, inputs: Floats) -> tuple[Floats, Floats]:
        """Run inputs (k, nu) one after the other from rest: -> poses (k + 1, 3), paths (k, poses, 3) in body frames."""
