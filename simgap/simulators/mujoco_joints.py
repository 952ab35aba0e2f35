"""MuJoCo over a URDF of joints (optional extra `mujoco`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from simgap.config.simulator import Damping, EngineSection
from simgap.errors import UserError
from simgap.geometry import Floats
from simgap.plants.model_file import Link
from simgap.plants.urdf_checks import check_urdf
from simgap.simulators.joint_engine import JointEngine
from simgap.simulators.traits import FileTraits

if TYPE_CHECKING:
    from simgap.simulators.joints import JointPlant


class MuJoCoSettings(EngineSection):
    """MuJoCo over the plant's URDF (optional extra `simgap[mujoco]`)."""

    engine: Literal["mujoco"] = Field("mujoco", description="Which engine.")
    integrator: Literal["euler", "implicit", "rk4"] = Field("euler", description="MuJoCo's integrator.")
    damping: Damping = Field(Damping(linear=0.0, angular=0.0), description="Only `joint` applies to MuJoCo.")


class MuJoCoJoints(JointEngine):
    """`f_hat` of a fixed-base plant in MuJoCo: a reset clears the solver's warm start with the rest of its data."""

    Settings = MuJoCoSettings
    distributions = ("mujoco",)
    file_traits = FileTraits(stops=True)

    def __init__(self, plant: JointPlant, section: MuJoCoSettings) -> None:
        from simgap.simulators.joints import joint_forces

        try:
            import mujoco
        except ImportError:
            raise UserError(
                "MuJoCo is not installed", key="simulator.engine", remedy="Install the extra: simgap[mujoco]."
            ) from None
        check_urdf(plant.urdf)
        self.nx, self.nu, self.engine = plant.nx, plant.nu, f"mujoco {mujoco.__version__}"
        self._mujoco: Any = mujoco
        self._plant, self._substeps = plant, section.substeps
        self._forces = joint_forces(plant, section.effects)
        model = mujoco.MjModel.from_xml_path(str(plant.urdf))
        model.opt.timestep = plant.tau / section.substeps
        model.opt.gravity[:] = (0.0, 0.0, -plant.gravity)
        kinds = {"euler": mujoco.mjtIntegrator.mjINT_EULER, "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT}
        model.opt.integrator = kinds.get(section.integrator, mujoco.mjtIntegrator.mjINT_RK4)
        model.dof_damping[:] = section.damping.joint
        model.dof_frictionloss[:] = 0.0  # the URDF's joint friction; Drake ignores it, effects declare it
        self._model, self._data = model, mujoco.MjData(model)
        joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in plant.joints]
        if min(joints) < 0:
            raise UserError(f"not all of the joints {list(plant.joints)} are there", file=plant.urdf)
        self._q = [int(model.jnt_qposadr[j]) for j in joints]
        self._v = [int(model.jnt_dofadr[j]) for j in joints]

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`; links on fixed joints are part of what they are fixed to."""
        model = self._model
        names = [model.body(k).name for k in range(1, model.nbody)]
        return {
            name: Link(float(model.body_mass[k]), np.sort(model.body_inertia[k]), np.array(model.body_ipos[k]))
            for k, name in enumerate(names, 1)
        }

    def reset(self, x: Floats) -> None:
        """Fresh data, then every joint's position and velocity: x (nx,)."""
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._q] = x[list(self._plant.positions)]
        self._data.qvel[self._v] = x[list(self._plant.velocities)]

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau, effects evaluated at every engine step: -> (nx,)."""
        data = self._data
        torques: Any = [sum(u[i] for i in drive) for drive in self._plant.inputs]
        for _ in range(self._substeps):
            if self._forces is not None:
                torques = self._forces(*data.qpos[self._q], *data.qvel[self._v], *u)
            data.qfrc_applied[self._v] = torques
            self._mujoco.mj_step(self._model, data)
        x = np.empty(self.nx)
        x[list(self._plant.positions)] = data.qpos[self._q]
        x[list(self._plant.velocities)] = data.qvel[self._v]
        return x
