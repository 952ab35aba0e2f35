"""A joint engine behind its commands: as it is, or a step at a time where an input is delayed or lags."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from simgap.config.case import Case
from simgap.effects import effect
from simgap.effects.commands import InputEffect
from simgap.errors import UserError
from simgap.simulators.base import Simulator
from simgap.simulators.commands import CommandPath, command_paths
from simgap.simulators.joints import JointPlant
from simgap.simulators.memory import RememberingInputs


def behind_commands(case: Case, plant: JointPlant, engine: Callable[[JointPlant, Any], Simulator]) -> Simulator:
    """The engine for the plant of a case, its effects declared in `simulator.effects`.

    Raises:
        UserError: a lagged state of the plant that does not lag in the simulator.
    """
    section: Any = case.simulator
    lags = [plant.input_names.index(s.lag_of) for s in case.plant.states.values() if s.lag_of is not None]
    lagging = {e.on for e in section.effects if effect(e.name).memory_state(e.on) is not None}
    if not {plant.input_names[k] for k in lags} <= lagging:
        slow = sorted({e.name for e in case.plant.effects if effect(e.name).memory_state(e.on) is not None})
        raise UserError(
            "a lagged input is a state of the plant, but does not lag in the simulator", key="simulator.effects",
            remedy=f"Add {slow} there too, or remove the state.",
        )  # fmt: skip
    if not any(effect(e.name).remembers for e in section.effects):
        return engine(plant, section)
    paths = case_command_paths(case)
    others = tuple(e for e in section.effects if not isinstance(effect(e.name), InputEffect))
    a_step = replace(plant, tau=plant.tau / section.substeps)
    bare = engine(a_step, section.model_copy(update={"substeps": 1, "effects": others}))
    return RememberingInputs(bare, paths, lags, plant.tau, section.substeps)


def acts_at_once(case: Case) -> bool:
    """Whether what acts on the plant is constant between samples: no hidden state, nothing that comes late."""
    effects = case.simulator.effects if case.simulator is not None else ()
    return case.hidden_state is None and not any(effect(e.name).remembers for e in effects)


def case_command_paths(case: Case) -> list[CommandPath]:
    """The paths of the commands; the delay that the controller has as its latency is not acted out a second time."""
    if case.domain is None:
        raise UserError("the simulator needs a domain", key="domain", remedy="Add `domain:`.")
    known = case.domain.tau * case.sensing.known_delay if case.sensing else 0.0
    values = {name: case.domain.U[name].list().tolist() for name in case.plant.inputs}
    effects = case.simulator.effects if case.simulator is not None else ()
    return command_paths(effects, values, known)
