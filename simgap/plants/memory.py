"""Which memory of past commands (input delay, input lag) the sampled nominal model carries.

A lag is carried where the case lists the actuator's output among its states (`lag_of`): the state is then one larger.
One sample of delay is carried where `sensing.latency_of` is `input_delay`: the controller then knows the pending input.
What is not carried is left out of the nominal map, and gamma has to cover it: the gap is taken over everything that
admissible earlier commands can leave behind (`simulators.memory`).
"""

from __future__ import annotations

from pathlib import Path

from simgap.config.plant import PlantSection
from simgap.effects import AppliedEffect, apply_effects
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel
from simgap.plants.build import bare_model

MEMORY = ("input_delay", "input_lag")


def carried_effects(section: PlantSection) -> list[AppliedEffect]:
    """The plant's effects without the memory that its states do not carry: no delay, a lag only if it is a state."""
    carried = {s.lag_of for s in section.states.values()}
    return [
        AppliedEffect(e.name, e.on, e.parameters)
        for e in section.effects
        if e.name not in MEMORY or (e.name == "input_lag" and e.on in carried)
    ]


def carried_model(section: PlantSection, folder: Path) -> SymbolicModel:
    """The plant as a function of the case's states and the present input.

    Raises:
        UserError: whatever is wrong with the plant; states that are not those of the plant with its lags.
    """
    model = apply_effects(bare_model(section, folder), carried_effects(section))
    if model.state_names != tuple(section.states):
        raise UserError(
            f"the states are {list(section.states)}, the plant with its lagged inputs has {list(model.state_names)}",
            key="plant.states",
            remedy="A state with lag_of is called <input>_lagged, stands last, and its input has the effect input_lag.",
        )
    return model
