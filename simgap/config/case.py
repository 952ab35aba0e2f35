"""The case file: everything that a run of simgap needs, in typed sections, and its JSON schema."""

from __future__ import annotations

import json
import os
from typing import Annotated

from pydantic import Field, model_validator

from simgap.config.base import Gibibytes, Hours, Section
from simgap.config.controller import AuditSection, SensingSection, SynthesisSection, ValidationSection
from simgap.config.domain import DomainSection
from simgap.config.gap import GapSection, GridSection, HiddenStateSection, SymmetrySection
from simgap.config.measured import MeasuredSection
from simgap.config.plant import PlantSection
from simgap.config.plugged import Plugged
from simgap.config.simulator import EngineSection, TwinSection


class BudgetSection(Section):
    """Limits that a case is held against before anything runs."""

    memory: Gibibytes | None = Field(
        None, gt=0, description="Memory limit of one stage, in GiB or with a unit; half of the machine's if not given."
    )
    time: Hours = Field(1.0, gt=0, description="Time limit of one stage on one core, in hours or with a unit.")

    @property
    def bytes(self) -> float:
        """`memory` in bytes."""
        if self.memory is not None:
            return self.memory * 2.0**30
        return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


SimulatorSection = Annotated[EngineSection, Plugged("engines", "engine")]


class Case(Section):
    """A case; a stage needs only the sections that it reads."""

    name: str = Field(
        pattern=r"^[a-z][a-z0-9_-]*$", max_length=100, description="Short name; results go to results/<name>."
    )
    title: str = Field("", description="Title of the report.")
    no_controller: str = Field("", description="Why the case asks for none, for the page of a run that ends with it.")
    plant: PlantSection = Field(description="The nominal model.")
    domain: DomainSection | None = Field(None, description="Sampling time, states and inputs.")
    simulator: SimulatorSection | None = Field(None, description="The high-fidelity side.")
    grid: GridSection | None = Field(None, description="Where the two are compared.")
    gap: GapSection | None = Field(None, description="How the gap is bounded.")
    symmetry: SymmetrySection | None = Field(None, description="A declared symmetry of the gap, measured before use.")
    hidden_state: HiddenStateSection | None = Field(None, description="How the simulator's memory is covered.")
    sensing: SensingSection | None = Field(None, description="What the controller knows of the state.")
    synthesis: SynthesisSection | None = Field(None, description="Specification, cells and options of the controller.")
    validation: ValidationSection | None = Field(None, description="The closed loop that checks it.")
    audit: AuditSection | None = Field(None, description="The adversary's budget against bound and controller.")
    twin: TwinSection | None = Field(None, description="Another engine that the simulator stands for.")
    budget: BudgetSection = Field(BudgetSection(), description="Cost above which a run is refused.")
    measured: MeasuredSection | None = Field(None, description="Recordings of the real machine.")

    @model_validator(mode="after")
    def _one_set_of_names(self) -> Case:
        if self.domain is not None:
            for key, declared, given in (
                ("domain.X", set(self.plant.states), set(self.domain.X)),
                ("domain.U", set(self.plant.inputs), set(self.domain.U)),
            ):
                if declared != given:
                    raise ValueError(f"{key} has {sorted(given)}, the plant has {sorted(declared)}")
        return self

    @model_validator(mode="after")
    def _translation_of_states(self) -> Case:
        along = self.symmetry.along if self.symmetry is not None else ()
        unknown = [name for name in along if name not in self.plant.states]
        if unknown or len(along) == len(self.plant.states):
            raise ValueError(f"symmetry.along has {unknown or 'every state'}, the plant has {list(self.plant.states)}")
        if along and self.hidden_state is not None:
            raise ValueError("a translation is of a gap over X; with hidden_state the symmetry is planar")
        if self.grid is not None and self.grid.half_widths and self.hidden_state is None:
            needed = {name for name in self.plant.states if name not in along}
            if set(self.grid.half_widths) != needed:
                raise ValueError(f"grid.half_widths has {sorted(self.grid.half_widths)}, it needs {sorted(needed)}")
        return self


def schema_text() -> str:
    """The text of configs/schema.json."""
    schema = Case.model_json_schema() | {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "Another case file in this folder: sections that are not given here are taken from it; null "
        "removes one.",
    }
    own = [name for name in schema.pop("required") if name != "plant"]
    schema["anyOf"] = [{"required": [*own, "plant"]}, {"required": [*own, "extends"]}]
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
