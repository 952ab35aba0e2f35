"""A person's own simulator: a Python function of x, u and tau in a file beside the case."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from simgap.arrays import Floats
from simgap.config.function_file import FunctionFile
from simgap.config.simulator import EngineSection
from simgap.errors import UserError
from simgap.simulators.base import MapEngine
from simgap.simulators.function_process import FunctionProcess
from simgap.simulators.probe import at_call

if TYPE_CHECKING:
    from simgap.config.case import Case

log = logging.getLogger("simgap.code")
_told: set[Path] = set()


class PythonSettings(EngineSection):
    """A function of one's own as the simulator; it is code and runs with your rights."""

    engine: Literal["python"] = Field("python", description="Which engine.")
    function: str = Field(
        description="file.py:name of a function in a file beside the case: name(x, u, tau) with arrays (states,) and "
        "(inputs,) in the order and units of the case gives the state after tau seconds."
    )
    batch: bool = Field(
        False, description="Whether it takes many at once: arrays (n, states) and (n, inputs), and gives (n, states)."
    )
    parameters: dict[str, float] = Field(default_factory=dict, description="Numbers that it is given by name.")
    timeout: float = Field(10.0, gt=0, description="Longest time of one call, s; a call that takes longer is ended.")

    OPTIONAL: ClassVar[tuple[str, ...]] = ()

    @field_validator("function")
    @classmethod
    def _there(cls, function: str, info: ValidationInfo) -> str:
        """The file is there and holds the function; said before anything of it runs."""
        folder = (info.context or {}).get("folder")
        if folder is None:
            return function
        try:
            found = FunctionFile.find(function, folder)
        except UserError as error:
            place = f"{error.file}: " if error.file else ""
            raise ValueError(f"{place}{error.problem}. {error.remedy or ''}".strip()) from None
        if found.path not in _told:
            _told.add(found.path)
            log.warning("the simulator %s is code and runs with your rights", found.path)
        return function


class PythonEngine(MapEngine):
    """`f_hat` by a function: all its state is x, so a reset leaves nothing behind."""

    Settings = PythonSettings
    engine = "python function"
    of_a_person = True

    def __init__(self, process: FunctionProcess, names: tuple[list[str], list[str]], substeps: int) -> None:
        """Calls go to `process`; `names` are those of states and inputs."""
        self.nx, self.nu = len(names[0]), len(names[1])
        self._process, self._names, self._substeps = process, names, substeps

    @classmethod
    def build(cls, case: Case, folder: Path) -> PythonEngine:
        """The engine for a case.

        Raises:
            UserError: no domain, or a file that cannot be run.
        """
        section = case.simulator
        if not isinstance(section, PythonSettings):
            raise UserError("the simulator is no Python function", key="simulator.engine")
        if case.domain is None:
            raise UserError("the simulator needs a sampling time", key="domain.tau", remedy="Add `domain:`.")
        found = FunctionFile.find(section.function, folder)
        tau = case.domain.tau / section.substeps
        process = FunctionProcess(found, tau, dict(section.parameters), section.batch, section.timeout)
        return cls(process, (list(case.plant.states), list(case.plant.inputs)), section.substeps)

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx).

        Raises:
            UserError: a call that fails, ends its process, takes too long or gives no finite state, with its x and u.
        """
        for _ in range(self._substeps):
            x = self._checked(x, u)
        return x

    def _checked(self, x: Floats, u: Floats) -> Floats:
        following = self._process.call(x, u, self._said)
        bad = np.flatnonzero(~np.isfinite(following).all(axis=1))
        if bad.size:
            k = int(bad[0])
            where = [name for name, value in zip(self._names[0], following[k], strict=True) if not np.isfinite(value)]
            values = ", ".join(f"{n} = {following[k][self._names[0].index(n)]:g}" for n in where)
            raise self._process.fault(f"gives {values}", self._said(x[k], u[k]))
        return following

    def _said(self, x: Any, u: Any) -> str:
        """A call in words."""
        return at_call(self._names, x, u)

    def close(self) -> None:
        """End the function's process."""
        self._process.close()
