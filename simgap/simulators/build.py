"""From a case to its simulator: the engine that it names, found among the plug-ins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simgap import plugins
from simgap.config.case import Case
from simgap.effects import EFFECTS, check_listed, effect
from simgap.errors import UserError
from simgap.simulators.base import Engine, Simulator
from simgap.simulators.supervision import Supervised, supervise, try_as_map


def make_simulator(case: Case, folder: Path) -> Simulator:
    """The simulator that a case declares; call it in the process that will run it.

    Raises:
        UserError: no `simulator` section, a plug-in that is no engine, or an effect that the engine cannot act out.
    """
    kind, section = _engine(case, folder), case.simulator
    simulator = kind.build(case, folder)
    if section is None:
        return simulator
    if section.engine in plugins.BUILT_IN["engines"] and not kind.of_a_person:
        return simulator
    names, calls = (list(case.plant.states), list(case.plant.inputs)), section.substeps if kind.of_a_person else 1
    return try_as_map(supervise(simulator, Supervised(section.engine, *names, section.timeout * calls)), case)


def closed_form(case: Case, folder: Path) -> tuple[Any, ...] | None:
    """The map f_hat over tau as expressions (SymPy), one a state, where the engine of the case knows it; else None.

    Raises:
        UserError: as `make_simulator`.
    """
    return _engine(case, folder).closed_form(case, folder)


def findings(case: Case, folder: Path) -> list[Any] | None:
    """Findings about a model file in the engine's own format (`Engine.findings`).

    Raises:
        UserError: as `make_simulator`.
    """
    return _engine(case, folder).findings(case, folder)


def switches(case: Case, folder: Path) -> tuple[Any, ...]:
    """Surfaces on which a model file in the engine's own format switches, as expressions (SymPy); none without one.

    Raises:
        UserError: as `make_simulator`.
    """
    return _engine(case, folder).switches(case, folder) if case.simulator is not None else ()


def _engine(case: Case, folder: Path) -> type[Engine]:
    section = case.simulator
    if section is None:
        raise UserError("this stage needs a simulator", key="simulator", remedy="Add `simulator:`.")
    engine = plugins.find("engines", section.engine, folder)
    if not issubclass(engine, Engine):
        raise UserError(
            f"'{section.engine}' is no engine", key="simulator.engine", remedy="Derive it from simgap's Engine."
        )
    check_listed(section.effects, "simulator.effects")
    for k, added in enumerate(section.effects):
        if not engine.acts_out(effect(added.name)):
            known = ", ".join(name for name, kind in EFFECTS.items() if engine.acts_out(kind)) or "none"
            raise UserError(
                f"the simulator cannot act out '{added.name}'",
                key=f"simulator.effects.{k}.name",
                remedy=f"It takes: {known}. Without it gamma does not cover hardware that has the effect.",
            )
    return engine
