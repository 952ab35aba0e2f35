"""Drake's discrete `MultibodyPlant` over a URDF of joints, with contact between its links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Any, Literal

import numpy as np

from simgap.arrays import Floats
from simgap.config.simulator import EngineSection
from simgap.plants.model_file import Link
from simgap.plants.urdf import add_welded, moving_bodies
from simgap.plants.urdf_checks import check_urdf
from simgap.simulators.base import FileTraits
from simgap.simulators.joints import JointEngine, JointPlant


class DrakeSettings(EngineSection):
    """Drake's discrete `MultibodyPlant` over the plant's URDF: stops of joints and contact by its convex solver."""

    engine: Literal["drake"] = "drake"
    """Name of the engine."""
    contact: bool = True
    """Whether links touch each other and what the file fixes to the world. Neighbouring links never touch."""
    approximation: Literal["sap", "similar", "lagged", "tamsi"] = "lagged"
    """Drake's approximation of contact (set_discrete_contact_approximation)."""


class DrakeJoints(JointEngine):
    """`f_hat` of a fixed-base plant in Drake: its whole state is (q, v), so a reset leaves nothing behind."""

    Settings = DrakeSettings
    distributions = ("drake",)
    file_traits = FileTraits(stops=True)

    def __init__(self, plant: JointPlant, section: DrakeSettings) -> None:
        check_urdf(plant.file)
        super().__init__(plant, section)
        self.engine = f"drake {metadata.version('drake')}"
        self._diagram, self._bodies = _diagram(plant, section)
        self._context = self._diagram.CreateDefaultContext()
        self._own = self._bodies.GetMyMutableContextFromRoot(self._context)
        joints = [self._bodies.GetJointByName(name) for name in plant.joints]
        self._q = [joint.position_start() for joint in joints]
        self._v = [joint.velocity_start() for joint in joints]
        self._push = self._bodies.get_applied_generalized_force_input_port()

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`."""
        return {body.name(): _link(body) for body in moving_bodies(self._bodies)}

    def reset(self, x: Floats) -> None:
        """Set every joint's position and velocity: x (nx,)."""
        q, v = np.zeros(self._bodies.num_positions()), np.zeros(self._bodies.num_velocities())
        q[self._q], v[self._v] = x[list(self._plant.positions)], x[list(self._plant.velocities)]
        self._context.SetTime(0.0)
        self._bodies.SetPositionsAndVelocities(self._own, np.concatenate([q, v]))

    def _read(self) -> tuple[Floats, Floats]:
        q, v = self._bodies.GetPositions(self._own), self._bodies.GetVelocities(self._own)
        return q[self._q], v[self._v]

    def _step(self, torques: Sequence[float]) -> None:
        force = np.zeros(self._bodies.num_velocities())
        force[self._v] = torques
        self._push.FixValue(self._own, force)
        self._context.SetDiscreteState(self._diagram.EvalUniquePeriodicDiscreteUpdate(self._context))


def _diagram(plant: JointPlant, section: DrakeSettings) -> tuple[Any, Any]:
    """The diagram of plant and geometry, and the plant in it."""
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
    add_welded(bodies, plant.file)
    return builder.Build(), bodies


def _link(body: Any) -> Link:
    """Mass, principal moments about the centre of mass, and centre of mass of a body."""
    inertia = body.default_spatial_inertia()
    mass, com = float(inertia.get_mass()), np.array(inertia.get_com())
    about = inertia.CalcRotationalInertia().CopyToFullMatrix3() if mass else np.zeros((3, 3))
    return Link(mass, np.linalg.eigvalsh(about - mass * (com @ com * np.eye(3) - np.outer(com, com))), com)
