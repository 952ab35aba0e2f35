"""Equations as the simulator: the high-fidelity side in closed form, whose gap is enclosed and not estimated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.plant import AddedEffect, Integrator, SymbolicPlant
from simgap.config.simulator import EngineSection
from simgap.effects import effect
from simgap.effects.base import Effect
from simgap.effects.commands import MemoryInputEffect
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.sampled import MOST_OPERATIONS, NominalModel
from simgap.plants.plant_model import PlantModel
from simgap.simulators.base import Engine, Simulator, domain_of
from simgap.simulators.commands import with_commands


class EquationsSettings(EngineSection):
    """Equations of motion with an integrator of their own: a simulator whose gap is proven, not sampled."""

    engine: Literal["equations"] = "equations"
    """Name of the engine."""
    equations: SymbolicPlant | None = None
    """The dynamics over the plant's states and inputs; the plant's own, as declared, if not given."""
    integrator: Integrator
    """How the equations are discretised: semi_implicit_euler (as PyBullet), explicit_euler, rk4 or exact_arc."""
    parameters: dict[str, float] = Field(default_factory=dict)
    """Values of parameters in the equations that differ from the declared ones."""
    slopes: Literal["enclosed", "sampled"] = "enclosed"
    """enclosed: the gap is bounded from the expressions, and nothing is estimated. sampled: as that of any other
    engine; for many substeps, whose expressions are too large."""

    OPTIONAL: ClassVar[tuple[str, ...]] = (*EngineSection.OPTIONAL, "parameters", "slopes")

    @model_validator(mode="after")
    def _noise_is_sampled(self) -> EquationsSettings:
        if self.is_random and self.slopes == "enclosed":
            raise ValueError(
                "noise is in no expression, so that its bound is not proven: say slopes: sampled beside it"
            )
        return self


class EquationsEngine(Engine):
    """`f_hat` as an expression; a state is all that it has, so a reset leaves nothing behind."""

    Settings = EquationsSettings
    engine = "equations"
    _x: Floats

    def __init__(self, step: NominalModel, substeps: int) -> None:
        """The map over one substep, and how many make a sampling time."""
        self.nx, self.nu = step.nx, step.nu
        self._step, self._substeps = step, substeps
        step.step(np.empty((0, step.nx)), np.empty((0, step.nu)))  # compiled here, at no state: 0 may be a pole

    @classmethod
    def build(cls, case: Case, folder: Path) -> Simulator:
        """The map, or, where earlier commands act on that no state holds, the map a substep at a time behind them.

        Raises:
            UserError: equations that do not fit the plant's states and inputs, an integrator that does not fit them,
                or a lagged state of the plant that does not lag in the simulator.
        """
        if _carried(case):
            return cls(_substep(case, folder), _section(case).substeps)
        own = {n: s for n, s in case.plant.states.items() if s.lag_of is None}
        bare = case.model_copy(update={"plant": case.plant.model_copy(update={"states": own})})
        return with_commands(case, lambda effects: cls(_substep(bare, folder, effects), 1))

    @classmethod
    def acts_out(cls, effect: Effect) -> bool:
        """Every effect on the plant and its commands; none of the readings."""
        return effect.kind != "state"

    @classmethod
    def of_its_own(cls, case: Case) -> bool:
        """Other equations, another file or other numbers than the plant's."""
        section = _section(case)
        return section.equations is not None or section.urdf not in (None, case.plant.urdf) or bool(section.parameters)

    @classmethod
    def closed_form(cls, case: Case, folder: Path) -> tuple[sp.Expr, ...] | None:
        """The map over tau: its substeps put into each other; None where the case asks for samples.

        Raises:
            UserError: as `build`, and a map that is too large to be enclosed.
        """
        if _section(case).slopes == "sampled" or not _carried(case):
            return None
        step = _substep(case, folder)
        if step.too_long_to_write_out:
            raise _too_large("simulator.slopes")
        rows: tuple[sp.Expr, ...] = step.f
        for _ in range(_section(case).substeps - 1):
            at = dict(zip(step.x, rows, strict=True))
            rows = tuple(sp.sympify(row).xreplace(at) for row in step.f)
            if max(int(sp.count_ops(row)) for row in rows) > MOST_OPERATIONS:
                raise _too_large("simulator.substeps")
        return rows

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,)."""
        self._x = np.array(x, dtype=np.float64)

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau: -> (nx,)."""
        self._x = self.rollouts(self._x[None], np.asarray(u, dtype=np.float64).reshape(1, self.nu))[0]
        return self._x.copy()

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx)."""
        for _ in range(self._substeps):
            x = self._step.step(x, u)
        return x


def _too_large(key: str) -> UserError:
    remedy = "Set simulator.slopes: sampled, or use fewer substeps or a simpler integrator."
    return UserError("the map over tau has too many operations to enclose its gap", key=key, remedy=remedy)


def _section(case: Case) -> EquationsSettings:
    section = case.simulator
    if not isinstance(section, EquationsSettings):
        raise UserError("the simulator is not given as equations", key="simulator.engine")
    return section


def _carried(case: Case) -> bool:
    """True if states of the case hold all that the simulator remembers of earlier commands."""
    return all(
        kind.memory_state(e.on) in case.plant.states and kind.seconds(e.parameters)[0] == 0.0
        for e in _section(case).effects
        if isinstance(kind := effect(e.name), MemoryInputEffect)
    )


def _substep(case: Case, folder: Path, effects: Sequence[AddedEffect] | None = None) -> NominalModel:
    """The map over one substep: the plant with the equations, effects and integrator of the simulator.

    Args:
        effects: in place of all those that the simulator acts out.
    """
    section = _section(case)
    added = section.effects if effects is None else tuple(effects)
    changes: dict[str, object] = {"integrator": section.integrator, "effects": added}
    if section.equations is not None:
        own = [n for n, state in case.plant.states.items() if state.lag_of is None]
        if set(section.equations.dynamics) != set(own):
            problem = f"dynamics are given for {sorted(section.equations.dynamics)}, states are {sorted(own)}"
            raise UserError(problem, key="simulator.equations.dynamics")
        changes |= {"urdf": None, "symbolic": section.equations}
    elif section.urdf is not None:
        changes |= {"urdf": section.urdf, "symbolic": None}
    if section.parameters:
        changes["symbolic"] = _other_values(changes.get("symbolic", case.plant.symbolic), section.parameters)
    plant = case.plant.model_copy(update=changes)
    return PlantModel(plant, folder, domain_of(case).tau / section.substeps).sampled


def _other_values(equations: object, values: dict[str, float]) -> SymbolicPlant:
    """The equations with other values of their parameters.

    Raises:
        UserError: parameters that they do not have, or no equations.
    """
    known = getattr(equations, "parameters", {})
    unknown = sorted(set(values) - set(known))
    if unknown or not isinstance(equations, SymbolicPlant):
        problem = f"the equations have no parameter called {', '.join(unknown)}"
        remedy = f"They have {', '.join(known) or 'none; a URDF takes simulator.effects (parameter_error)'}."
        raise UserError(problem, key="simulator.parameters", remedy=remedy)
    changed = {name: known[name].model_copy(update={"value": value}) for name, value in values.items()}
    return equations.model_copy(update={"parameters": {**known, **changed}})
