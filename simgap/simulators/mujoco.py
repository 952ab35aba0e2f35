"""MuJoCo: joints of a URDF or of a file of its own format, MJCF (optional extra `mujoco`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import model_validator

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.simulator import Damping, EngineSection
from simgap.errors import Finding
from simgap.late import sympy as sp
from simgap.plants.model_file import Link
from simgap.plants.urdf_checks import check_urdf, loading
from simgap.simulators import mjcf
from simgap.simulators.base import FileTraits, Simulator
from simgap.simulators.findings import mjcf_findings, mjcf_switches
from simgap.simulators.joints import JointEngine, JointPlant
from simgap.simulators.mjcf import MuJoCoModel


class MuJoCoSettings(EngineSection):
    """MuJoCo over the plant's URDF, or over an MJCF file (optional extra `simgap[mujoco]`)."""

    engine: Literal["mujoco"] = "mujoco"
    """Name of the engine."""
    integrator: Literal["euler", "implicit", "rk4"] = "euler"
    """MuJoCo's integrator."""
    damping: Damping = Damping(linear=0.0, angular=0.0)
    """Only `joint` applies to MuJoCo."""
    mjcf: str | None = None
    """An MJCF file in place of the plant's URDF, relative to the case file. All of it is used as it is (damping,
    friction, armature, stops, integrator, gravity), but for the timestep, which is tau/substeps, and its motors, which
    idle: the inputs are forces on joints."""

    OPTIONAL: ClassVar[tuple[str, ...]] = (*EngineSection.OPTIONAL, "mjcf")

    @model_validator(mode="after")
    def _one_file(self) -> MuJoCoSettings:
        given = [key for key in ("urdf", "integrator", "damping") if key in self.model_fields_set]
        if self.mjcf is not None and given and not (given == ["urdf"] and self.urdf is None):
            raise ValueError(f"with mjcf, {' and '.join(given)} would replace what the file says: change it there")
        return self


class MuJoCoJoints(JointEngine):
    """`f_hat` of a fixed-base plant in MuJoCo: a reset clears the solver's warm start with the rest of its data."""

    Settings = MuJoCoSettings
    distributions = ("mujoco",)
    file_traits = FileTraits(stops=True)

    def __init__(self, plant: JointPlant, section: MuJoCoSettings) -> None:
        super().__init__(plant, section)
        model = _of_urdf(plant, section) if section.mjcf is None else mjcf.read_mjcf(plant.file)
        model.opt.timestep = plant.tau / section.substeps
        self._run = MuJoCoModel(model)
        self.engine = self._run.engine
        joints = [model.joint(name) for name in plant.joints]
        self._q = [int(j.qposadr[0]) for j in joints]
        self._v = [int(j.dofadr[0]) for j in joints]

    @classmethod
    def build(cls, case: Case, folder: Path) -> Simulator:
        """See `JointEngine.build`; an MJCF file is checked against the case first."""
        if _mjcf(case):
            mjcf.check_mjcf(case, folder)
        return super().build(case, folder)

    @classmethod
    def of_its_own(cls, case: Case) -> bool:
        """See `JointEngine.of_its_own`."""
        return _mjcf(case) or super().of_its_own(case)

    @classmethod
    def findings(cls, case: Case, folder: Path) -> list[Finding] | None:
        """See `Engine.findings`."""
        return mjcf_findings(case, folder) if _mjcf(case) else None

    @classmethod
    def switches(cls, case: Case, folder: Path) -> tuple[sp.Expr, ...]:
        """See `Engine.switches`."""
        return mjcf_switches(case, folder) if _mjcf(case) else ()

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`."""
        return self._run.links(1)

    def reset(self, x: Floats) -> None:
        """Fresh data, then every joint's position and velocity: x (nx,)."""
        self._run.reset()
        self._run.data.qpos[self._q] = x[list(self._plant.positions)]
        self._run.data.qvel[self._v] = x[list(self._plant.velocities)]

    def advance(self, u: Floats) -> Floats:
        """See `JointEngine.advance`.

        Raises:
            UserError: a motion that diverges, with the joints' positions and velocities and the inputs it began with.
        """
        q, v = self._read()
        x = super().advance(u)
        if self._run.has_diverged:
            names = (*self._plant.joints, *(f"{name}'s velocity" for name in self._plant.joints))
            values = map(float, (*q, *v, *u))
            raise self._run.diverged("mujoco", zip((*names, *self._plant.input_names), values, strict=True))
        return x

    def _read(self) -> tuple[Floats, Floats]:
        return self._run.data.qpos[self._q], self._run.data.qvel[self._v]

    def _step(self, torques: Sequence[float]) -> None:
        self._run.data.qfrc_applied[self._v] = torques
        self._run.step()


def _mjcf(case: Case) -> bool:
    return getattr(case.simulator, "mjcf", None) is not None


def _of_urdf(plant: JointPlant, section: MuJoCoSettings) -> Any:
    """MuJoCo's model of a URDF, with the keys of the case in place of what the file says of damping and friction."""
    mujoco = mjcf.require_mujoco()
    check_urdf(plant.file)
    with loading("MuJoCo", plant.file):
        model = mujoco.MjModel.from_xml_path(str(plant.file))
    model.opt.gravity[:] = (0.0, 0.0, -plant.gravity)
    kinds = {"euler": mujoco.mjtIntegrator.mjINT_EULER, "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT}
    model.opt.integrator = kinds.get(section.integrator, mujoco.mjtIntegrator.mjINT_RK4)
    model.dof_damping[:] = section.damping.joint
    model.dof_frictionloss[:] = 0.0  # the URDF's joint friction; Drake ignores it, effects declare it
    return model
