"""A functional mock-up unit (FMI 2 or 3, co-simulation) as the simulator, by FMPy (optional extra `fmu`)."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from simgap import reading
from simgap.arrays import Floats
from simgap.config.simulator import EngineSection
from simgap.errors import UserError
from simgap.simulators.base import Engine
from simgap.simulators.fmu_unit import Unit

if TYPE_CHECKING:
    from simgap.config.case import Case

STARTS = 1e-9
"""Largest relative deviation of a start from the state that was set: rounding; judgement."""
KEY = "simulator.fmu"
log = logging.getLogger("simgap.code")
_told: set[Path] = set()


class FmuSettings(EngineSection):
    """An FMU for co-simulation, as Simulink, Modelica tools and many others export it; it is code with your rights."""

    engine: Literal["fmu"] = Field("fmu", description="Which engine.")
    fmu: str = Field(description="The .fmu file, relative to the case file: FMI 2 or 3 with co-simulation.")
    variables: dict[str, str] = Field(
        default_factory=dict,
        description="For a state or input the variable of the FMU that it is; its own name where none is given.",
    )
    starts: dict[str, str] = Field(
        default_factory=dict,
        description="For a state the variable that sets where it begins, such as a parameter q_start; the state's own "
        "variable where none is given.",
    )
    parameters: dict[str, float] = Field(default_factory=dict, description="Values of other variables, by their names.")

    @model_validator(mode="after")
    def _announced(self, info: ValidationInfo) -> FmuSettings:
        """Said where the case is read, and not in the engine's process, whose output goes to a log."""
        folder = (info.context or {}).get("folder")
        if folder is not None and reading.real(folder / self.fmu) not in _told:
            _told.add(reading.real(folder / self.fmu))
            log.warning("the simulator %s is code and runs with your rights", folder / self.fmu)
        return self


class FmuEngine(Engine):
    """`f_hat` by an FMU: each roll-out begins with a reset."""

    Settings = FmuSettings
    distributions = ("fmpy",)
    of_a_person = True

    def __init__(self, unit: Unit, names: tuple[list[str], list[str]], section: FmuSettings, tau: float) -> None:
        """Roll-outs of `unit`; `names` are those of states and inputs."""
        self.nx, self.nu = len(names[0]), len(names[1])
        self.engine = f"fmu {unit.model} (FMI {unit.fmi})"
        self._unit, self._names, self._step, self._substeps = unit, names, tau / section.substeps, section.substeps
        named = {name: section.variables.get(name, name) for name in (*names[0], *names[1])}
        self._states = [named[name] for name in names[0]]
        self._inputs = [named[name] for name in names[1]]
        self._starts = [section.starts.get(name, named[name]) for name in names[0]]
        self._parameters = section.parameters

    @classmethod
    def build(cls, case: Case, folder: Path) -> FmuEngine:
        """The engine for a case.

        Raises:
            UserError: no domain, a file that is no FMU for co-simulation of this machine, variables that it does not
                have or in other units.
        """
        section: Any = case.simulator
        if case.domain is None:
            raise UserError("the simulator needs a sampling time", key="domain.tau", remedy="Add `domain:`.")
        names = list(case.plant.states), list(case.plant.inputs)
        for key, known in (("variables", (*names[0], *names[1])), ("starts", names[0])):
            unknown = sorted(set(getattr(section, key)) - set(known))
            if unknown:
                raise UserError(f"{unknown} are not of the plant", key=f"simulator.{key}", remedy=f"It has {[*known]}.")
        engine = cls(Unit(folder / section.fmu), names, section, case.domain.tau)
        units = [s.unit for s in case.plant.states.values()], [i.unit for i in case.plant.inputs.values()]
        engine._check(units)
        return engine

    def _check(self, units: tuple[list[str], list[str]]) -> None:
        of_states = zip(self._names[0], self._states, units[0], strict=True)
        of_inputs = zip(self._names[1], self._inputs, units[1], strict=True)
        for name, variable, unit in (*of_states, *of_inputs):
            self._unit.check(variable, f"simulator.variables.{name}", unit)
        for name, variable, unit in zip(self._names[0], self._starts, units[0], strict=True):
            self._unit.check(variable, f"simulator.starts.{name}", unit)
        for name in self._parameters:
            self._unit.check(name, f"simulator.parameters.{name}")

    def reset(self, x: Floats) -> None:
        """Begin again at x (nx,), with nothing left of what ran before.

        Raises:
            UserError: where the FMU begins elsewhere.
        """
        begin = dict(zip(self._starts, map(float, x), strict=True))
        self._unit.begin(begin | self._parameters)
        self._time, found = 0.0, self._unit.read(self._states)
        off = np.abs(found - x) > STARTS * np.maximum(1.0, np.abs(x))
        if off.any():
            k = int(np.argmax(off))
            raise UserError(
                f"told to begin at {self._names[0][k]} = {x[k]:g}, the FMU begins at {found[k]:g}",
                key=f"simulator.starts.{self._names[0][k]}",
                remedy="Name the variable or parameter that sets its start.",
            )

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau: -> (nx,).

        Raises:
            UserError: a step that the FMU refuses.
        """
        self._unit.write(dict(zip(self._inputs, map(float, u), strict=True)))
        for _ in range(self._substeps):
            self._unit.step(self._time, self._step)
            self._time += self._step
        return self._unit.read(self._states)

    def close(self) -> None:
        """Free the FMU and what was unpacked of it."""
        self._unit.close()
