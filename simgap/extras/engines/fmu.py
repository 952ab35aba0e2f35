"""A functional mock-up unit (FMI 2 or 3, co-simulation) as the simulator, by FMPy (optional extra `fmu`)."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from simgap import reading
from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.simulator import EngineSection
from simgap.errors import UserError, excerpt, optional
from simgap.plugins import announce
from simgap.simulators.base import Engine, domain_of
from simgap.units import check_unit, require_unit

KEY = "simulator.fmu"
PREFIX = "simgap-fmu-"
REAL = ("Real", "Float64")
DESCRIPTION = "modelDescription.xml"
MOST_PARTS, MOST_UNPACKED = 10_000, 2_000_000_000
"""Most files of an archive, and bytes of them unpacked. Judgement: FMUs of whole vehicles have hundreds of MB."""


def _place() -> tuple[Path, int]:
    """A folder to unpack to, and its lock, which ends with this process; those of processes that were killed go."""
    for left in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # somebody else's, or in use
            lock = _locked(left)
            try:
                shutil.rmtree(left)
            finally:
                os.close(lock)
    made = Path(tempfile.mkdtemp(prefix="simgap-new-"))
    lock = _locked(made)  # before it has the name by which others find it
    return made.rename(made.with_name(PREFIX + made.name)), lock


def _locked(folder: Path) -> int:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _check_archive(path: Path) -> None:
    """Refuse what does not unpack into a folder of moderate size.

    Raises:
        UserError: no archive, one of too many or too large parts, paths that lead out of it, or a description that is
            too large or has a document type.
    """
    try:
        with reading.opened(path) as stream, zipfile.ZipFile(stream) as archive:
            entries = archive.infolist()
            _refuse_archive(path, entries)
            reading.xml_of(archive.read(DESCRIPTION), path)
    except (OSError, zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, KeyError, RuntimeError) as error:
        raise UserError(f"is not an FMU: {_said(error)}", file=path, key=KEY) from None


def _refuse_archive(path: Path, entries: Sequence[zipfile.ZipInfo]) -> None:
    out = [e.filename for e in entries if e.filename[:1] in "/\\" or ".." in re.split(r"[/\\]", e.filename)]
    size = sum(e.file_size for e in entries)
    described = sum(e.file_size for e in entries if e.filename == DESCRIPTION)
    problem = ""
    if out:
        problem = f"'{excerpt(out[0], 60)}' in it leads out of the folder that it is unpacked to"
    elif len(entries) > MOST_PARTS or size > MOST_UNPACKED:
        most = f"the most are {MOST_PARTS} and {MOST_UNPACKED / 1e9:.3g} GB"
        problem = f"holds {len(entries)} parts of {size / 1e9:.3g} GB in all; {most}"
    elif described > reading.MOST_XML:
        problem = f"its {DESCRIPTION} has {described} bytes; the most are {reading.MOST_XML}"
    if problem:
        raise UserError(problem, file=path, key=KEY, remedy="Export it again.")


class Unit:
    """An FMU for co-simulation."""

    def __init__(self, path: Path) -> None:
        """Unpack and instantiate.

        Raises:
            UserError: FMPy is not installed, no such file, or one that is no FMU for co-simulation of this machine.
        """
        with optional("FMPy", "fmu"):
            import fmpy
            from fmpy.fmi2 import FMU2Slave
            from fmpy.fmi3 import FMU3Slave
        if not reading.is_file(path):
            raise UserError("the FMU does not exist", file=path, key=KEY, remedy="Correct its path.")
        _check_archive(path)
        try:
            about = fmpy.read_model_description(str(path))
        except Exception as error:  # FMPy raises what zip, XML and its own checks raise
            raise UserError(f"is not an FMU: {_said(error)}", file=path, key=KEY) from None
        kinds = {"2": FMU2Slave, "3": FMU3Slave}
        self.fmi, self.model, self._path = str(about.fmiVersion), str(about.modelName), path
        if about.coSimulation is None or self.fmi[0] not in kinds:
            problem = f"is FMI {self.fmi} {'without' if about.coSimulation is None else 'with'} co-simulation"
            raise UserError(problem, file=path, key=KEY, remedy="Export it as FMI 2 or 3 for co-simulation.")
        self._variables = {v.name: v for v in about.modelVariables}
        self._folder, self._lock = _place()
        fmpy.extract(str(path), str(self._folder))
        try:
            self._fmu: Any = kinds[self.fmi[0]](
                guid=about.guid, unzipDirectory=str(self._folder), instanceName="simgap",
                modelIdentifier=about.coSimulation.modelIdentifier,
            )  # fmt: skip
            self._fmu.instantiate()
        except Exception as error:
            self._remove()
            raise UserError(f"cannot be loaded on this machine: {_said(error)}", file=path, key=KEY) from None
        self._running = False

    def check(self, name: str, key: str, unit: str | None = None) -> None:
        """Refuse a variable that is not there, is not a real number, or is in another unit.

        Raises:
            UserError: naming the key.
        """
        found = self._variables.get(name)
        if found is None or found.type not in REAL or found.dimensions:
            known = [v.name for v in self._variables.values() if v.type in REAL and not v.dimensions]
            problem = f"the FMU has no real variable '{excerpt(name, 60)}'"
            raise UserError(problem, file=self._path, key=key, remedy=f"It has: {excerpt(', '.join(known), 300)}.")
        stated = found.unit or getattr(found.declaredType, "unit", None)
        if unit is None or not stated:
            return
        own = str(stated).replace(".", "*")
        try:
            check_unit(own, key)
        except UserError:
            return  # units of other tools are texts; what cannot be read is not judged
        require_unit(unit, own, key)

    def begin(self, values: Mapping[str, float]) -> None:
        """Reset, set values while it initialises, and be ready to step.

        Raises:
            UserError: a value that it does not take.
        """
        with self._taken("does not begin"):
            if self._running:
                self._fmu.reset()
            self._running = True
            if self.fmi[0] == "2":
                self._fmu.setupExperiment(startTime=0.0)
            self._fmu.enterInitializationMode()
            self.write(values)
            self._fmu.exitInitializationMode()

    def write(self, values: Mapping[str, float]) -> None:
        """Set variables by name.

        Raises:
            UserError: naming the first that it does not take.
        """
        for name, value in values.items():
            reference = [self._variables[name].valueReference]
            with self._taken(f"does not take {name} = {value:g}"):
                (self._fmu.setReal if self.fmi[0] == "2" else self._fmu.setFloat64)(reference, [value])

    def read(self, names: Sequence[str]) -> Floats:
        """Variables by name: -> (n,).

        Raises:
            UserError: values that are not finite.
        """
        references = [self._variables[name].valueReference for name in names]
        with self._taken(f"does not report {', '.join(names)}"):
            found = self._fmu.getReal(references) if self.fmi[0] == "2" else self._fmu.getFloat64(references)
        values = np.array(found, dtype=np.float64)
        if not np.isfinite(values).all():
            raise UserError(f"gives {dict(zip(names, values.tolist(), strict=True))}", file=self._path, key=KEY)
        return values

    def step(self, time: float, length: float) -> None:
        """Go on by `length` seconds.

        Raises:
            UserError: a step that it refuses.
        """
        with self._taken(f"does not step from {time:g} s by {length:g} s"):
            self._fmu.doStep(currentCommunicationPoint=time, communicationStepSize=length)

    @contextmanager
    def _taken(self, what: str) -> Iterator[None]:
        """A call of FMPy; what it raises is told in one line, which begins with `what`."""
        try:
            yield
        except UserError:
            raise
        except Exception as error:
            remedy = "Try it in FMPy (`fmpy simulate`), and exclude what it cannot do from domain.X and domain.U."
            raise UserError(f"{what}: {_said(error)}", file=self._path, key=KEY, remedy=remedy) from None

    def close(self) -> None:
        """Free the instance, and remove what was unpacked."""
        try:
            if self._running:
                self._fmu.terminate()
            self._fmu.freeInstance()
        finally:
            self._remove()

    def _remove(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        os.close(self._lock)


def _said(error: BaseException) -> str:
    return excerpt(" ".join(str(error).split()) or type(error).__name__, 200)


STARTS = 1e-9
"""Largest relative deviation of a start from the state that was set: rounding; judgement."""


class FmuSettings(EngineSection):
    """An FMU for co-simulation, as Simulink, Modelica tools and many others export it; it is code with your rights."""

    engine: Literal["fmu"] = "fmu"
    """Name of the engine."""
    fmu: str
    """The .fmu file, relative to the case file: FMI 2 or 3 with co-simulation."""
    variables: dict[str, str] = Field(default_factory=dict)
    """For a state or input, its variable in the FMU; a variable of the same name if not given."""
    starts: dict[str, str] = Field(default_factory=dict)
    """For a state, the variable that sets its initial value, such as a parameter q_start; the variable of the state
    itself if not given."""
    parameters: dict[str, float] = Field(default_factory=dict)
    """Values of other variables, by their names."""

    @model_validator(mode="after")
    def _announced(self, info: ValidationInfo) -> FmuSettings:
        """Said where the case is read, and not in the engine's process, whose output goes to a log."""
        folder = (info.context or {}).get("folder")
        if folder is not None:
            announce(f"the simulator {folder / self.fmu}")
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
        names = list(case.plant.states), list(case.plant.inputs)
        for key, known in (("variables", (*names[0], *names[1])), ("starts", names[0])):
            unknown = sorted(set(getattr(section, key)) - set(known))
            if unknown:
                raise UserError(f"{unknown} are not of the plant", key=f"simulator.{key}", remedy=f"It has {[*known]}.")
        engine = cls(Unit(folder / section.fmu), names, section, domain_of(case).tau)
        units = [s.unit for s in case.plant.states.values()], [i.unit for i in case.plant.inputs.values()]
        engine._check(units)
        return engine

    def _check(self, units: tuple[list[str], list[str]]) -> None:
        (states, inputs), (of_states, of_inputs) = self._names, units
        for key, names, variables, own in (
            ("variables", states, self._states, of_states),
            ("variables", inputs, self._inputs, of_inputs),
            ("starts", states, self._starts, of_states),
        ):
            for name, variable, unit in zip(names, variables, own, strict=True):
                self._unit.check(variable, f"simulator.{key}.{name}", unit)
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
            problem = f"set to begin at {self._names[0][k]} = {x[k]:g}, the FMU begins at {found[k]:g}"
            remedy = "Name the variable or parameter that sets its start."
            raise UserError(problem, key=f"simulator.starts.{self._names[0][k]}", remedy=remedy)

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
