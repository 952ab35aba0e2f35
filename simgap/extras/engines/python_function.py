"""A person's own simulator: a Python function of x, u and tau in a file beside the case."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.named_files import KEY, FunctionFile
from simgap.config.simulator import EngineSection
from simgap.errors import UserError, excerpt
from simgap.plugins import announce
from simgap.simulators.base import Engine, domain_of
from simgap.simulators.supervision import bounded, describe_call

STARTING = 60.0
"""Longest time that the file may take to be imported, s."""


class PythonSettings(EngineSection):
    """A function of one's own as the simulator; it is code and runs with your rights."""

    engine: Literal["python"] = "python"
    """Name of the engine."""
    function: str
    """file.py:name of a function in a file beside the case: name(x, u, tau) with arrays (states,) and (inputs,) in the
    order and units of the case gives the state after tau seconds. With `stochastic: true` it also takes `rng`, a NumPy
    generator from which all its random numbers come."""
    batch: bool = False
    """Whether the function takes many states at once: arrays (n, states) and (n, inputs), result (n, states)."""
    parameters: dict[str, float] = Field(default_factory=dict)
    """Numbers that are passed to the function by name."""
    timeout: float = Field(10.0, gt=0)
    """Longest time of one call, s; a call that takes longer is ended."""

    OPTIONAL: ClassVar[tuple[str, ...]] = EngineSection.NOISE

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
        announce(f"the simulator {found.path}")
        return function


class PythonEngine(Engine):
    """`f_hat` by a function: all its state is x, so a reset leaves nothing behind."""

    Settings = PythonSettings
    engine = "python function"
    of_a_person = True
    stochastic = True

    def __init__(self, file: FunctionFile, case: Case, section: PythonSettings, tau: float) -> None:
        """Import the file in this process, which is the engine's own."""
        self._file, self._names = file, (list(case.plant.states), list(case.plant.inputs))
        self.nx, self.nu = len(self._names[0]), len(self._names[1])
        self._tau, self._substeps, self._parameters = tau, section.substeps, dict(section.parameters)
        self._is_random = section.stochastic
        try:
            self._function = bounded("while the function's file is imported", STARTING, lambda: imported(file))
        except Exception as error:
            raise self._fault(f"cannot be imported: {type(error).__name__}: {excerpt(str(error))}") from None

    @classmethod
    def build(cls, case: Case, folder: Path) -> PythonEngine:
        """The engine for a case.

        Raises:
            UserError: no domain, or a file that cannot be run.
        """
        section = case.simulator
        if not isinstance(section, PythonSettings):
            raise UserError("the simulator is not a Python function", key="simulator.engine")
        kind = _OfMany if section.batch else cls
        return kind(FunctionFile.find(section.function, folder), case, section, domain_of(case).tau / section.substeps)

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,)."""
        self._x = np.array(x, dtype=np.float64)

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau: -> (nx,).

        Raises:
            UserError: a call that fails or gives no state, with its x and u.
        """
        for _ in range(self._substeps):
            self._x = self._called(self._x, np.array(u, dtype=np.float64))
        return self._x.copy()

    def _called(self, x: Floats, u: Floats) -> Floats:
        given: dict[str, Any] = self._parameters | ({"rng": self.rng} if self._is_random else {})
        try:
            result = self._function(x.copy(), u.copy(), self._tau, **given)
        except Exception as error:
            line = _line(error, str(self._file.path))
            raise self._fault(f"fails: {type(error).__name__}: {excerpt(str(error))}{line}", x, u) from None
        try:
            found = np.asarray(result, dtype=np.float64)
        except (TypeError, ValueError):
            raise self._fault(f"gives {excerpt(repr(result), 60)}, which is not an array of numbers", x, u) from None
        if found.shape != x.shape:
            raise self._fault(f"gives an array {found.shape} instead of {x.shape}", x, u)
        return found

    def _fault(self, problem: str, x: Floats | None = None, u: Floats | None = None) -> UserError:
        """Error about what went wrong, with the call, the first of many."""
        first = None if x is None or u is None else (np.atleast_2d(x)[0], np.atleast_2d(u)[0])
        where = f", {describe_call(self._names, *first)}" if first is not None else ""
        return UserError(
            f"the function '{self._file.name}' {problem}{where}", file=self._file.path, key=KEY,
            remedy="Correct it, or exclude what it cannot do from domain.X and domain.U.",
        )  # fmt: skip


class _OfMany(PythonEngine):
    """A function that takes many at once."""

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx)."""
        for _ in range(self._substeps):
            x = self._called(x, u)
        return x

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau: -> (nx,)."""
        self._x = self.rollouts(self._x[None], np.asarray(u, dtype=np.float64).reshape(1, self.nu))[0]
        return self._x.copy()


def _line(error: BaseException, path: str) -> str:
    """The line of the file where it failed."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
    return f" (line {lines[-1]})" if lines else ""


def imported(file: FunctionFile) -> Callable[..., Any]:
    """A person's function, by running its file in this process; raises what that raises."""
    sys.dont_write_bytecode = True  # what runs is what was hashed
    folder = str(file.path.parent)
    sys.path.insert(0, folder)
    spec = importlib.util.spec_from_file_location(f"simgap_function_{file.path.stem}", file.path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file.path.name} cannot be read")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(folder)
        sys.path.append(folder)  # what it imports later is found; nothing that simgap imports later is shadowed
    function = getattr(module, file.name)
    if not callable(function):
        raise TypeError(f"'{file.name}' is not a function")
    found: Callable[..., Any] = function
    return found
