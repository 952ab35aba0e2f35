"""What engines over a URDF of joints share: built for the joints of a case, and behind its late commands if need be."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simgap.simulators.base import Engine, Simulator

if TYPE_CHECKING:
    from simgap.config.case import Case
    from simgap.effects.base import Effect
    from simgap.simulators.joints import JointPlant


class JointEngine(Engine):
    """An engine whose whole state is the positions and velocities of its joints."""

    @abstractmethod
    def __init__(self, plant: JointPlant, section: Any) -> None:
        """Load the plant with the settings of the case."""

    @classmethod
    def acts_out(cls, effect: Effect) -> bool:
        """Forces on coordinates, every change of a command, and what a drive makes of it at its speed."""
        from simgap.effects.base import CoordinateEffect
        from simgap.effects.commands import InputEffect
        from simgap.effects.drives import DriveEffect

        return isinstance(effect, CoordinateEffect | InputEffect | DriveEffect)

    @classmethod
    def of_its_own(cls, case: Case) -> bool:
        """Another model file than the plant's may differ in anything."""
        section = case.simulator
        return section is not None and section.urdf is not None and section.urdf != case.plant.urdf

    @classmethod
    def build(cls, case: Case, folder: Path) -> Simulator:
        """The engine itself, or, where an input is delayed or lags, the engine a step at a time behind its commands.

        Raises:
            UserError: no model file, no domain, or a lagged state of the plant that does not lag in the simulator.
        """
        from simgap.effects import effect
        from simgap.simulators.behind_commands import behind_commands, check_lagged
        from simgap.simulators.joints import joint_plant

        plant, section = joint_plant(case, folder), case.simulator
        check_lagged(case)
        if section is None or not any(effect(e.name).remembers for e in section.effects):
            return cls(plant, section)
        a_step = replace(plant, tau=plant.tau / section.substeps)
        return behind_commands(
            case, lambda effects: cls(a_step, section.model_copy(update={"substeps": 1, "effects": effects}))
        )
