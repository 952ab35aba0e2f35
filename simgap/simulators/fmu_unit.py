"""One instance of an FMU through FMPy: unpacked, begun at values, read, written, stepped; FMI 2 and 3 alike."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.errors import UserError, excerpt
from simgap.units import check_unit, require_unit

KEY = "simulator.fmu"
PREFIX = "simgap-fmu-"
REAL = ("Real", "Float64")
DESCRIPTION = "modelDescription.xml"
MOST_PARTS, MOST_UNPACKED = 10_000, 2_000_000_000
"""Of an archive: files, and bytes of them unpacked. Judgement: FMUs of whole vehicles have hundreds of MB."""


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
        raise UserError(f"is no FMU: {_said(error)}", file=path, key=KEY) from None


def _refuse_archive(path: Path, entries: Sequence[zipfile.ZipInfo]) -> None:
    out = [e.filename for e in entries if e.filename[:1] in "/\\" or ".." in re.split(r"[/\\]", e.filename)]
    size = sum(e.file_size for e in entries)
    described = sum(e.file_size for e in entries if e.filename == DESCRIPTION)
    problem = (
        f"'{excerpt(out[0], 60)}' in it leads out of the folder that it is unpacked to"
        if out
        else f"holds {len(entries)} parts of {size / 1e9:.3g} GB in all; the most are {MOST_PARTS} and "
        f"{MOST_UNPACKED / 1e9:.3g} GB"
        if len(entries) > MOST_PARTS or size > MOST_UNPACKED
        else f"its {DESCRIPTION} has {described} bytes; the most are {reading.MOST_XML}"
        if described > reading.MOST_XML
        else None
    )
    if problem:
        raise UserError(problem, file=path, key=KEY, remedy="Export it again.")


class Unit:
    """An FMU for co-simulation."""

    def __init__(self, path: Path) -> None:
        """Unpack and instantiate.

        Raises:
            UserError: FMPy is not installed, no such file, or one that is no FMU for co-simulation of this machine.
        """
        try:
            import fmpy
            from fmpy.fmi2 import FMU2Slave
            from fmpy.fmi3 import FMU3Slave
        except ImportError:
            raise UserError(
                "FMPy is not installed", key="simulator.engine", remedy="Install the extra: simgap[fmu]."
            ) from None
        if not reading.is_file(path):
            raise UserError("the FMU does not exist", file=path, key=KEY, remedy="Correct its path.")
        _check_archive(path)
        try:
            about = fmpy.read_model_description(str(path))
        except Exception as error:  # FMPy raises what zip, XML and its own checks raise
            raise UserError(f"is no FMU: {_said(error)}", file=path, key=KEY) from None
        kinds = {"2": FMU2Slave, "3": FMU3Slave}
        self.fmi, self.model, self._path = str(about.fmiVersion), str(about.modelName), path
        if about.coSimulation is None or self.fmi[0] not in kinds:
            raise UserError(
                f"is FMI {self.fmi} {'without' if about.coSimulation is None else 'with'} co-simulation", file=path,
                key=KEY, remedy="Export it as FMI 2 or 3 for co-simulation.",
            )  # fmt: skip
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
        """Refuse a variable that is not there, is no real number, or is in another unit.

        Raises:
            UserError: naming the key.
        """
        found = self._variables.get(name)
        if found is None or found.type not in REAL or found.dimensions:
            known = [v.name for v in self._variables.values() if v.type in REAL and not v.dimensions]
            raise UserError(
                f"the FMU has no real variable '{excerpt(name, 60)}'", file=self._path, key=key,
                remedy=f"It has: {excerpt(', '.join(known), 300)}.",
            )  # fmt: skip
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
        try:
            if self._running:
                self._fmu.reset()
            self._running = True
            if self.fmi[0] == "2":
                self._fmu.setupExperiment(startTime=0.0)
            self._fmu.enterInitializationMode()
            self.write(values)
            self._fmu.exitInitializationMode()
        except UserError:
            raise
        except Exception as error:
            raise self._fault("does not begin", error) from None

    def write(self, values: Mapping[str, float]) -> None:
        """Set variables by name.

        Raises:
            UserError: naming the first that it does not take.
        """
        for name, value in values.items():
            reference = [self._variables[name].valueReference]
            try:
                if self.fmi[0] == "2":
                    self._fmu.setReal(reference, [value])
                else:
                    self._fmu.setFloat64(reference, [value])
            except Exception as error:
                raise self._fault(f"does not take {name} = {value:g}", error) from None

    def read(self, names: Sequence[str]) -> Floats:
        """Variables by name: -> (n,).

        Raises:
            UserError: values that are not finite.
        """
        references = [self._variables[name].valueReference for name in names]
        try:
            found = self._fmu.getReal(references) if self.fmi[0] == "2" else self._fmu.getFloat64(references)
        except Exception as error:
            raise self._fault(f"does not tell {', '.join(names)}", error) from None
        values = np.array(found, dtype=np.float64)
        if not np.isfinite(values).all():
            raise UserError(f"gives {dict(zip(names, values.tolist(), strict=True))}", file=self._path, key=KEY)
        return values

    def step(self, time: float, length: float) -> None:
        """Go on by `length` seconds.

        Raises:
            UserError: a step that it refuses.
        """
        try:
            self._fmu.doStep(currentCommunicationPoint=time, communicationStepSize=length)
        except Exception as error:
            raise self._fault(f"does not step from {time:g} s by {length:g} s", error) from None

    def _fault(self, what: str, error: BaseException) -> UserError:
        return UserError(
            f"{what}: {_said(error)}", file=self._path, key=KEY,
            remedy="Try it in FMPy (`fmpy simulate`), and leave what it cannot do out of domain.X and domain.U.",
        )  # fmt: skip

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
