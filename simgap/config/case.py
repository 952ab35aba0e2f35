"""The case file: everything that a run of simgap needs, in typed sections, and its JSON schema."""

from __future__ import annotations

import ast
import inspect
import json
import os
from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import ModelSchema

from simgap.config.base import Gibibytes, Hours, Section
from simgap.config.controller import AuditSection, SensingSection, SynthesisSection, ValidationSection
from simgap.config.gap import GapSection, GridSection, HiddenStateSection, SymmetrySection
from simgap.config.measured import MeasuredSection
from simgap.config.plant import DomainSection, PlantSection
from simgap.config.plugged import Plugged
from simgap.config.simulator import EngineSection, TwinSection


class BudgetSection(Section):
    """Limits that a case is held against before anything runs."""

    memory: Gibibytes | None = Field(None, gt=0)
    """Memory limit of one stage, in GiB or with a unit; half of the machine's if not given."""
    time: Hours = Field(1.0, gt=0)
    """Time limit of one stage on one core, in hours or with a unit."""

    @property
    def bytes(self) -> float:
        """`memory` in bytes."""
        if self.memory is not None:
            return self.memory * 2.0**30
        return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


SimulatorSection = Annotated[EngineSection, Plugged("engines", "engine")]


class Case(Section):
    """A case; a stage needs only the sections that it reads."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_-]*$", max_length=100)
    """Short name; results go to results/<name>."""
    title: str = ""
    """Title of the report."""
    no_controller: str = ""
    """Reason why the case has no controller; the page of its run prints it."""
    plant: PlantSection
    """The nominal model."""
    domain: DomainSection | None = None
    """Sampling time, states and inputs."""
    simulator: SimulatorSection | None = None
    """The simulator that the model is compared with."""
    grid: GridSection | None = None
    """Samples at which simulator and model are compared."""
    gap: GapSection | None = None
    """How the gap is bounded."""
    symmetry: SymmetrySection | None = None
    """A declared symmetry of the gap, measured before use."""
    hidden_state: HiddenStateSection | None = None
    """How the simulator's memory is covered."""
    sensing: SensingSection | None = None
    """What the controller knows of the state."""
    synthesis: SynthesisSection | None = None
    """Specification, cells and options of the controller."""
    validation: ValidationSection | None = None
    """Simulated runs that test the controllers."""
    audit: AuditSection | None = None
    """The adversary's budget against bound and controller."""
    twin: TwinSection | None = None
    """Another engine that the simulator stands for."""
    budget: BudgetSection = BudgetSection()
    """Cost above which a run is refused."""
    measured: MeasuredSection | None = None
    """Recordings of the real machine."""

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

    @property
    def is_random(self) -> bool:
        """True if the simulator draws random numbers."""
        return self.simulator is not None and self.simulator.is_random

    @model_validator(mode="after")
    def _noise_where_it_is_supported(self) -> Case:
        if self.simulator is None or not self.is_random:
            return self
        unknown = sorted(set(self.simulator.noise) - {*self.plant.states, *self.plant.inputs})
        if unknown:
            raise ValueError(f"simulator.noise has {unknown}, which are neither states nor inputs of the plant")
        for key, there, remedy in (
            ("hidden_state", self.hidden_state, "take it out, or leave the noise out"),
            ("symmetry", self.symmetry, "take it out: the noise may depend on every state"),
            ("twin", self.twin, "take it out: two random simulators differ at every step"),
        ):
            if there:
                raise ValueError(f"{key} is not supported for a simulator with noise (simulator.noise): {remedy}")
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


class _Described(GenerateJsonSchema):
    """Schema of sections whose keys are described by the text below them in their source: nothing else reads it."""

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        """See `GenerateJsonSchema`."""
        found = super().model_schema(schema)
        for kind in schema["cls"].__mro__:
            for key, words in _descriptions(kind) if issubclass(kind, Section) else ():
                if key in found["properties"]:
                    found["properties"][key].setdefault("description", words)
        return found


def _descriptions(section: type[Section]) -> list[tuple[str, str]]:
    """Keys of a section, each with the text below it in its class."""
    (tree,) = ast.parse(inspect.getsource(section)).body
    assert isinstance(tree, ast.ClassDef)
    return [
        (key.target.id, " ".join(below.value.value.split()))
        for key, below in pairwise(tree.body)
        if isinstance(key, ast.AnnAssign) and isinstance(key.target, ast.Name)
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str)
    ]


def schema_text() -> str:
    """The text of configs/schema.json."""
    schema = Case.model_json_schema(schema_generator=_Described) | {
        "$schema": "https://json-schema.org/draft/2020-12/schema"
    }
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "Another case file in this folder. Sections that are not given here are taken from it; null "
        "removes a section.",
    }
    own = [name for name in schema.pop("required") if name != "plant"]
    schema["anyOf"] = [{"required": [*own, "plant"]}, {"required": [*own, "extends"]}]
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
