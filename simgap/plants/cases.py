"""The nominal model of a case."""

from __future__ import annotations

from pathlib import Path

from simgap.config.case import Case
from simgap.errors import UserError
from simgap.model.sampled import NominalModel
from simgap.plants.memory import carried_model


def nominal_model(case: Case, folder: Path) -> NominalModel:
    """The sampled nominal map of a case, effects included; memory that the states do not carry is left to gamma.

    Raises:
        UserError: whatever is wrong with the plant, or no `domain`.
    """
    if case.domain is None:
        raise UserError("the nominal model needs a sampling time", key="domain.tau", remedy="Add `domain:`.")
    return NominalModel.of(carried_model(case.plant, folder), case.domain.tau, case.plant.integrator)
