"""The case file: everything that a run of simgap needs, in typed sections, and its JSON schema."""

from __future__ import annotations

import itertools
import json
import os
from enum import StrEnum
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from simgap.arrays import Floats
from simgap.config.base import Gibibytes, Hours, Seconds, Section
from simgap.config.gap import GapSection, GridSection, HiddenStateSection, SymmetrySection
from simgap.config.measured import MeasuredSection
from simgap.config.plant import PlantSection
from simgap.config.plugged import Plugged
from simgap.config.simulator import EngineSection, TwinSection


class InputSet(Section):
    """The values that one input may take: `values`, or all of min, min + step, ..., max."""

    min: float | None = Field(None, description="Smallest value.")
    max: float | None = Field(None, description="Largest value.")
    step: float | None = Field(None, gt=0, description="Distance between neighbours.")
    values: tuple[float, ...] | None = Field(None, description="The values one by one, instead of a range.")

    @model_validator(mode="after")
    def _not_empty(self) -> InputSet:
        if self.values is not None:
            if not (self.min is None and self.max is None and self.step is None):
                raise ValueError("an input set has either values, or min, max and step")
            if len(self.values) == 0:
                raise ValueError("U is empty: list at least one value")
            return self
        if self.min is None or self.max is None or self.step is None:
            raise ValueError("an input set needs values, or min, max and step")
        if self.max < self.min:
            raise ValueError(f"U is empty: max {self.max} is below min {self.min}")
        return self

    @property
    def count(self) -> int:
        """How many values there are."""
        if self.values is not None:
            return len(self.values)
        low, high, step = (float(v) for v in (self.min, self.max, self.step) if v is not None)
        return int(np.floor((high - low) / step + 1e-9)) + 1

    def list(self) -> Floats:
        """The values in ascending order, (n,); decimal steps give the decimals a person would write."""
        if self.values is not None:
            return np.array(sorted(self.values))
        assert self.min is not None
        assert self.step is not None
        return np.round(self.min + self.step * np.arange(self.count), 12)


class DomainSection(Section):
    """Where the model is compared with the simulator and where the controller works."""

    tau: Seconds = Field(gt=0, description="Sampling time, in seconds or with a unit ('5 ms').")
    X: dict[str, tuple[float, float]] = Field(
        description="For each state its lower and upper end, in its unit; angles in rad, not degrees."
    )
    U: dict[str, InputSet] = Field(description="For each input the values that it may take.")
    periodic: tuple[str, ...] = Field(
        (), description="States that wrap around at the ends of X, such as a heading; X is one turn."
    )

    @model_validator(mode="after")
    def _upright(self) -> DomainSection:
        for name, (lo, hi) in self.X.items():
            if not lo < hi:
                raise ValueError(f"the box is upside down for {name}: {lo} is not below {hi}. Give the lower end first")
        unknown = [name for name in self.periodic if name not in self.X]
        if unknown:
            raise ValueError(f"periodic names {unknown}, which are not states of X")
        return self

    def inputs(self, order: list[str]) -> Floats:
        """All of U as rows (M, nu), the last input running fastest."""
        return np.array(list(itertools.product(*(self.U[name].list() for name in order))), dtype=np.float64)


class SynthesisSection(Section):
    """Cells of the abstraction and the specification."""

    cells: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        min_length=1, max_length=4, description="Cells per state, in order, over the safe set or the arena."
    )
    specification: Annotated[Section, Plugged("specifications", "kind")] = Field(
        description="What the closed loop must do."
    )
    nominal_between_samples: bool = Field(
        False,
        description="Whether the nominal-only controller also checks what its model does between samples; by "
        "default, as in the paper, it looks at the sampling instants only.",
    )
    record: Literal["all", "one"] = Field(
        "all",
        exclude_if=lambda value: value == "all",  # what a case reads that does not ask for it stays what it was
        description="Whether the controller keeps all admissible inputs of a cell, a bit for each input, or the one "
        "that `least_effort` picks, two bytes: for very many cells and inputs, where something is to be reached. What "
        "it applies is the same; the audit, the margins and a certificate are then about that one input.",
    )
    layers: int = Field(
        1, ge=1, le=8,
        exclude_if=lambda value: value == 1,
        description="Sizes of cells by which a set to be held is found, the largest of 2^(layers - 1) cells a side: "
        "large ones are split only where they do not decide. The result is that of one layer, bit for bit; from three "
        "states on 3 is several times faster. For perfect measurements, states that do not wrap, and a gap that "
        "depends on few states.",
    )  # fmt: skip
    rule: Literal["least_effort", "middle"] = Field(
        "least_effort", description="Which of the admissible inputs the controller applies."
    )


class SensingSection(Section):
    """A bounded measurement error and a latency in whole samples."""

    error: dict[str, float] = Field(
        default_factory=dict, description="For a state, the largest |measured - true|, in its unit; 0 if not given."
    )
    latency: int = Field(0, ge=0, le=1, description="Samples between a measurement and the input that uses it.")
    latency_of: Literal["measurement", "input_delay"] = Field(
        "measurement",
        description="measurement: the latency comes on top of the delays that effects declare. input_delay: it is the "
        "first sample of these delays, so that the controller knows which input is pending; a command that would act "
        "earlier is held back until then.",
    )
    first_input: dict[str, float] = Field(
        default_factory=dict,
        description="With a latency, the input that acts in the first sample, before any measurement has arrived: one "
        "of domain.U. If not given, the one of least effort in U, rest where U holds it.",
    )

    @property
    def known_delay(self) -> int:
        """Samples of the inputs' delay that the controller knows of as its latency."""
        return self.latency if self.latency_of == "input_delay" else 0

    @field_validator("error")
    @classmethod
    def _not_negative(cls, value: dict[str, float]) -> dict[str, float]:
        bad = [name for name, e in value.items() if e < 0]
        if bad:
            raise ValueError(f"the error of {bad} is negative")
        return value


class Trials(StrEnum):
    """Numbers of random and adversarial trials: of a plain run, of `snakemake full`, of `snakemake audit_deep`."""

    PLAIN = "plain"
    FULL = "full"
    DEEP = "deep"


BUDGET = {Trials.PLAIN: (200_000, 20_000), Trials.FULL: (1_000_000, 100_000), Trials.DEEP: (10_000_000, 1_000_000)}
"""Evaluations and steps."""
BUDGET_OF_HISTORIES = {Trials.PLAIN: (6_000, 2_000), Trials.FULL: (30_000, 10_000), Trials.DEEP: (300_000, 100_000)}
"""Where the simulator remembers earlier inputs: one of its steps costs some hundred times as much."""


def _unless_given(index: int) -> str:
    """Words about the number that stands in for one that a case does not give."""
    plain, full = ((BUDGET[t][index], BUDGET_OF_HISTORIES[t][index]) for t in (Trials.PLAIN, Trials.FULL))
    return f"if not given {plain[0]:,}, {full[0]:,} in a full run; {plain[1]:,} and {full[1]:,} with a hidden_state."


class AuditSection(Section):
    """How hard the adversary tries."""

    evaluations: int | None = Field(
        None,
        ge=1,
        description=f"Steps of the simulator on which the gap's bound is attacked; {_unless_given(0)}",
    )
    steps: int | None = Field(
        None,
        ge=1,
        description="Closed-loop steps under the worst admissible inputs, in the simulator and as many against "
        f"the worst disturbance; {_unless_given(1)}",
    )
    seed: int = Field(21, ge=0, description="Of everything random in it.")

    def budget(self, histories: bool, trials: Trials = Trials.PLAIN) -> tuple[int, int]:
        """Evaluations and steps, `histories` where the simulator remembers inputs; a deep audit takes no less."""
        evaluations, steps = (BUDGET_OF_HISTORIES if histories else BUDGET)[trials]
        if trials == Trials.DEEP:
            return max(evaluations, self.evaluations or 0), max(steps, self.steps or 0)
        return self.evaluations or evaluations, self.steps or steps


STARTS, FULL_STARTS = 300, 1000
"""Of a plain run and of a full one: if none of them fails, at most 1 % and 0.3 % do, with 95 % confidence."""
BASELINE_STARTS = 200
"""Of each controller that a plain run only compares with; nothing is promised of them."""


class ValidationSection(Section):
    """How many runs, how long, and which of them are kept in full."""

    starts: int | None = Field(
        None,
        ge=1,
        description="Starts, drawn from the winning domain of the gap-aware controller; if not given "
        f"{STARTS:,}, {FULL_STARTS:,} in a full run. In a plain run the controllers to compare with take "
        f"{BASELINE_STARTS:,} of them.",
    )
    first: tuple[dict[str, float], ...] = Field(
        (), description="States to start from before the drawn ones; each must be in both winning domains."
    )
    steps: int = Field(2000, ge=1, description="Samples a run.")
    seed: int = Field(0, ge=0, description="Seed of the starts.")
    kept: int = Field(4, ge=1, description="Runs of each controller whose traces are written.")
    fair_baseline: bool = Field(
        False,
        description="Whether a third controller runs from the same starts: made for the nominal model alone, as the "
        "nominal-only one, but minding what that model does between samples. For specifications of the whole path.",
    )

    def count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts of the gap-aware controller."""
        return self.starts or (STARTS if trials == Trials.PLAIN else FULL_STARTS)

    def baseline_count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts, of these, of each controller that it is compared with."""
        return min(self.count(trials), BASELINE_STARTS) if trials == Trials.PLAIN else self.count(trials)


class BudgetSection(Section):
    """Limits that a case is held against before anything runs."""

    memory: Gibibytes | None = Field(
        None, gt=0, description="Most memory of one stage, in GiB or with a unit; half of the machine's if not given."
    )
    time: Hours = Field(1.0, gt=0, description="Most time of one stage on one core, in hours or with a unit.")

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
    title: str = Field("", description="What the report is headed with.")
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
    budget: BudgetSection = Field(BudgetSection(), description="What a run may cost before it is refused.")
    measured: MeasuredSection | None = Field(None, description="Recordings of the real thing.")

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
        "description": "Another case file of this folder: sections that are not given here are taken from it, null "
        "leaves one out.",
    }
    own = [name for name in schema.pop("required") if name != "plant"]
    schema["anyOf"] = [{"required": [*own, "plant"]}, {"required": [*own, "extends"]}]
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
