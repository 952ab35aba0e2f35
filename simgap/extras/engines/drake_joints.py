"""Drake's discrete `MultibodyPlant` over a URDF of joints, with contact between its links."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import metadata
from typing import Any, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Floats
from simgap.config.simulator import EngineSection
from simgap.errors import UserError
from simgap.plants.model_file import Link
from simgap.plants.urdf_checks import check_urdf, loading, root_link
from simgap.simulators.base import FileTraits
from simgap.simulators.joints import JointEngine, JointPlant, joint_forces


class DrakeSettings(EngineSection):
    """Drake's discrete `MultibodyPlant` over the plant's URDF: stops of joints and contact by its convex solver."""

    engine: Literal["drake"] = Field("drake", description="Which engine.")
    contact: bool = Field(
        True, description="Whether links touch each other and what the file fixes to the world; no neighbours do."
    )
    approximation: Literal["sap", "similar", "lagged", "tamsi"] = Field(
        "lagged", description="Drake's approximation of contact (set_discrete_contact_approximation)."
    )


class DrakeJoints(JointEngine):
    """`f_hat` of a fixed-base plant in Drake: its whole state is (q, v), so a reset leaves nothing behind."""

    Settings = DrakeSettings
    distributions = ("drake",)
    file_traits = FileTraits(stops=True)

    def __init__(self, plant: JointPlant, section: DrakeSettings) -> None:

        check_urdf(plant.file)
        self.nx, self.nu = plant.nx, plant.nu
        self.engine = f"drake {metadata.version('drake')}"
        self._plant, self._substeps = plant, section.substeps
        self._forces = joint_forces(plant, section.effects)
        self._diagram, self._bodies = _diagram(plant, section)
        self._context = self._diagram.CreateDefaultContext()
        self._own = self._bodies.GetMyMutableContextFromRoot(self._context)
        joints = []
        for name in plant.joints:
            if not self._bodies.HasJointNamed(name):
                raise UserError(f"no joint called '{name}'", file=plant.file)
            joints.append(self._bodies.GetJointByName(name))
        self._q = [joint.position_start() for joint in joints]
        self._v = [joint.velocity_start() for joint in joints]
        self._push = self._bodies.get_applied_generalized_force_input_port()

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`."""
        return {name: _link(body) for name, body in _moving(self._bodies).items()}

    def reset(self, x: Floats) -> None:
        """Set every joint's position and velocity: x (nx,)."""
        q, v = np.zeros(self._bodies.num_positions()), np.zeros(self._bodies.num_velocities())
        q[self._q], v[self._v] = x[list(self._plant.positions)], x[list(self._plant.velocities)]
        self._context.SetTime(0.0)
        self._bodies.SetPositionsAndVelocities(self._own, np.concatenate([q, v]))

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau, effects evaluated at every engine step: -> (nx,)."""
        torques: Any = [sum(u[i] for i in drive) for drive in self._plant.inputs]
        force = np.zeros(self._bodies.num_velocities())
        for k in range(self._substeps):
            if self._forces is not None or k == 0:
                if self._forces is not None:
                    q, v = self._bodies.GetPositions(self._own), self._bodies.GetVelocities(self._own)
                    torques = self._forces(*q[self._q], *v[self._v], *u)
                force[self._v] = torques
                self._push.FixValue(self._own, force)
            self._context.SetDiscreteState(self._diagram.EvalUniquePeriodicDiscreteUpdate(self._context))
        x = np.empty(self.nx)
        x[list(self._plant.positions)] = self._bodies.GetPositions(self._own)[self._q]
        x[list(self._plant.velocities)] = self._bodies.GetVelocities(self._own)[self._v]
        return x


def _diagram(plant: JointPlant, section: DrakeSettings) -> tuple[Any, Any]:
    """The diagram of plant and geometry, and the plant in it."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
    from pydrake.systems.framework import DiagramBuilder

    builder, step = DiagramBuilder(), plant.tau / section.substeps
    if section.contact:
        bodies, _ = AddMultibodyPlantSceneGraph(builder, step)
    else:
        bodies = builder.AddSystem(MultibodyPlant(step))
    kinds = DiscreteContactApproximation
    approximations = {"sap": kinds.kSap, "similar": kinds.kSimilar, "lagged": kinds.kLagged, "tamsi": kinds.kTamsi}
    bodies.set_discrete_contact_approximation(approximations[section.approximation])
    bodies.SetUseSampledOutputPorts(False)  # its state is then (q, v) alone
    bodies.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -plant.gravity])
    with loading("Drake", plant.file):
        (model,) = Parser(bodies).AddModels(plant.file)
        root = root_link(plant.file)
        if root != "world":
            bodies.WeldFrames(bodies.world_frame(), bodies.GetFrameByName(root, model))
        bodies.Finalize()
        return builder.Build(), bodies


def _moving(bodies: Any) -> dict[str, Any]:
    from pydrake.multibody.tree import BodyIndex

    found = (bodies.get_body(BodyIndex(k)) for k in range(bodies.num_bodies()))
    return {body.name(): body for body in found if not bodies.IsAnchored(body)}


def _link(body: Any) -> Link:
    """Mass, principal moments about the centre of mass, and centre of mass of a body."""
    inertia = body.default_spatial_inertia()
    mass, com = float(inertia.get_mass()), np.array(inertia.get_com())
    if mass == 0.0:
        return Link(0.0, np.zeros(3), com)
    about = inertia.CalcRotationalInertia().CopyToFullMatrix3()
    about = about - mass * (com @ com * np.eye(3) - np.outer(com, com))
    return Link(mass, np.linalg.eigvalsh(about), com)
