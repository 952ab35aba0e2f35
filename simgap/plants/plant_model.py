"""The one door to the nominal model: built once from the `plant` section of a case, asked for in four shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.load import load_case
from simgap.config.plant import PlantSection
from simgap.effects import AppliedEffect, apply_effects, check_listed, delays_and_lags, effect
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.model.drake_system import symbolic_plant
from simgap.model.integrators import sampling_rule
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel
from simgap.model.tree import Tree
from simgap.plants.declared import declared_model
from simgap.plants.drake_check import check_declared, check_map
from simgap.plants.urdf import load_tree
from simgap.units import require_unit


@dataclass(frozen=True, eq=False)
class PlantModel:
    """The nominal plant of a case; each shape is made when first asked for and kept.

    An effect may remember past commands (a delay, a lag). The sampled map is a function of the case's states and the
    present input, so it has such an effect only where the case carries its memory: a lag whose output is among the
    states (`lag_of`). One sample of delay is carried where `sensing.latency_of` is `input_delay`: the controller then
    knows the pending input. What is not carried is left out of the map, and gamma has to cover it: the gap is taken
    over everything that admissible earlier commands can leave behind (`simulators.memory`).

    Attributes:
        section: the plant, with its effects.
        folder: where the section's relative paths start.
        tau: sampling time, s; None for a case without a domain, whose model cannot be sampled.
    """

    section: PlantSection
    folder: Path
    tau: float | None = None

    @staticmethod
    def of(case: Case, folder: Path) -> PlantModel:
        """The plant of a case."""
        return PlantModel(case.plant, folder, case.domain.tau if case.domain is not None else None)

    @cached_property
    def declared(self) -> SymbolicModel:
        """Continuous, as declared, before any effect.

        Raises:
            UserError: whatever is wrong with the model file, the equations or the units.
        """
        return declared_model(self.section, self.folder)

    @cached_property
    def tree(self) -> Tree | None:
        """The model file as numbers, before any effect; None for written equations."""
        if self.section.urdf is None:
            return None
        _ = self.declared  # refuses what is wrong with the file
        return load_tree(self.folder / self.section.urdf, self.section.gravity)

    @cached_property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects that the case adds, in the order in which it lists them.

        Raises:
            UserError: a name that no effect has, or numbers that are not its own.
        """
        check_listed(self.section.effects, "plant.effects")
        return tuple(AppliedEffect(e.name, e.on, e.parameters) for e in self.section.effects)

    def _with(self, effects: Sequence[AppliedEffect]) -> SymbolicModel:
        """The declared plant with these; a mistake is told with the key of the effect."""
        declared = self.declared  # a mistake in the file or the equations is none of an effect
        try:
            return apply_effects(declared, effects)
        except UserError as error:
            wrong = (k for k, e in enumerate(self.effects) if e.on not in effect(e.name).targets(declared))
            k = next(wrong, None)
            key = "plant.effects" if k is None else f"plant.effects.{k}.on"
            raise UserError(error.problem, key=error.key or key, remedy=error.remedy) from None

    @cached_property
    def corrected(self) -> SymbolicModel:
        """Continuous, with all effects and all their memory: further states and delays.

        Raises:
            UserError: an effect that does not fit the plant.
        """
        return self._with(self.effects)

    @cached_property
    def carried(self) -> SymbolicModel:
        """Continuous, over the case's own states: with the effects whose memory these carry.

        Raises:
            UserError: states that are not those of the plant with its lags.
        """
        states = tuple(self.section.states)
        kept = [e for e in self.effects if not effect(e.name).remembers or effect(e.name).memory_state(e.on) in states]
        model = self._with(kept)
        if model.state_names != states:
            raise UserError(
                f"the states are {list(states)}, the plant with its lagged inputs has {list(model.state_names)}",
                key="plant.states",
                remedy="A state with lag_of is called <input>_lagged, comes last, and its input has an effect that "
                "lags, such as input_lag.",
            )
        for name, state in self.section.states.items():
            if state.lag_of is not None:
                require_unit(state.unit, self.section.inputs[state.lag_of].unit, f"plant.states.{name}.unit")
        return model

    @cached_property
    def sampled(self) -> NominalModel:
        """The compiled map f over tau, of `carried`.

        Raises:
            UserError: a case without `domain`, or an integrator that does not fit the plant.
        """
        if self.tau is None:
            raise UserError("the nominal model needs a sampling time", key="domain.tau", remedy="Add `domain:`.")
        if not self.carried.derived:
            raise UserError(
                f"the equations of {len(self.carried.coordinates)} joints are not written out, which a bound or a "
                "controller needs", key="plant.urdf",
                remedy="Take at most two joints, fixing the others; `simgap diagnose` takes them all.",
            )  # fmt: skip
        x, u = (tuple(v.symbol for v in group) for group in (self.carried.states, self.carried.inputs))
        return NominalModel(x, u, sampling_rule(self.carried, self.tau, self.section.integrator), self.tau)

    def drake_system(self) -> Any:
        """`corrected` as a Drake system that can be wired into a diagram, whatever the case declares it by.

        A `SymbolicVectorSystem` in continuous time: its input is the inputs of the case, its state their states (those
        of lags last), its output what the sensors read.

        Raises:
            UserError: a delay, or a function that Drake does not have.
        """
        return symbolic_plant(self.corrected)

    def check_with_drake(self, box: Box, inputs: Floats) -> None:
        """Hold the compiled map, and the model file as declared, against Drake's own numbers on X and U, (M, nu).

        Raises:
            BrokenPromise: naming the state in which they differ beyond rounding.
        """
        check_map(self.sampled, box, inputs)
        if self.section.urdf is not None:
            check_declared(self.declared, self.section, self.folder / self.section.urdf, box, inputs)

    def corrected_by(self, found: Sequence[AppliedEffect]) -> tuple[SymbolicModel, dict[str, float]]:
        """`corrected` with further effects but no further memory: -> model, input -> seconds by which it acts later.

        For slow commands delay and lag are alike.
        """
        late = {on: delay + lag for on, (delay, lag) in delays_and_lags(found).items()}
        return apply_effects(self.corrected, [e for e in found if not effect(e.name).remembers]), late


def load_plant(path: str | Path) -> PlantModel:
    """The nominal model of a case file.

    Raises:
        UserError: a case that does not check.
    """
    return PlantModel.of(load_case(Path(path)), Path(path).parent)
