"""The sections `synthesis`, `sensing`, `validation` and `audit`: the controller, what it measures, how it is tested."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from simgap.config.base import NotNegative, Section
from simgap.config.plugged import Plugged


class SynthesisSection(Section):
    """Cells of the abstraction and the specification."""

    OPTIONAL = ("record",)

    cells: tuple[Annotated[int, Field(ge=1)], ...] = Field(min_length=1, max_length=4)
    """Cells per state, in order, over the safe set or the arena."""
    specification: Annotated[Section, Plugged("specifications", "kind")]
    """What the closed loop must do."""
    nominal_between_samples: bool = False
    """Whether the nominal-only controller also checks what its model does between samples; by default, as in the paper,
    it considers the sampling instants only."""
    record: Literal["all", "one"] = "all"
    """Whether the controller keeps all admissible inputs of a cell, a bit for each input, or the one that
    `least_effort` picks, two bytes: for very many cells and inputs, where something is to be reached. What it applies
    is the same; the audit, the margins and a certificate are then about that one input."""
    rule: Literal["least_effort", "middle"] = "least_effort"
    """Which of the admissible inputs the controller applies."""


class SensingSection(Section):
    """A bounded measurement error and a latency in whole samples."""

    error: dict[str, NotNegative] = Field(default_factory=dict)
    """For a state, the largest |measured - true|, in its unit; 0 if not given."""
    latency: int = Field(0, ge=0, le=1)
    """Samples between a measurement and the input that uses it."""
    latency_of: Literal["measurement", "input_delay"] = "measurement"
    """measurement: the latency comes on top of the delays that effects declare. input_delay: it is the first sample of
    these delays, so that the controller knows which input is pending; a command that would act earlier is held back
    until then."""
    first_input: dict[str, float] = Field(default_factory=dict)
    """With a latency, the input that acts in the first sample, before any measurement has arrived: one of domain.U. If
    not given, the one of least effort in U, rest where U holds it."""

    @property
    def known_delay(self) -> int:
        """Samples of the inputs' delay that the controller knows of as its latency."""
        return self.latency if self.latency_of == "input_delay" else 0


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
    return f"Default: {plain[0]:,} (full run: {full[0]:,}); with a hidden_state {plain[1]:,} ({full[1]:,})."


class AuditSection(Section):
    """Budget of the adversary."""

    evaluations: int | None = Field(
        None, ge=1, description=f"Simulator steps that attack the bound of the gap. {_unless_given(0)}"
    )
    steps: int | None = Field(
        None,
        ge=1,
        description="Closed-loop steps under the worst admissible inputs in the simulator, and as many against "
        f"the worst disturbance. {_unless_given(1)}",
    )
    seed: int = Field(21, ge=0)
    """Seed of everything random in the audit."""

    def budget(self, histories: bool, trials: Trials = Trials.PLAIN) -> tuple[int, int]:
        """Evaluations and steps, `histories` where the simulator remembers inputs; a deep audit takes no less."""
        evaluations, steps = (BUDGET_OF_HISTORIES if histories else BUDGET)[trials]
        if trials == Trials.DEEP:
            return max(evaluations, self.evaluations or 0), max(steps, self.steps or 0)
        return self.evaluations or evaluations, self.steps or steps


STARTS, FULL_STARTS = 300, 1000
"""Starts of a plain run and of a full one: if none fails, at most 1 % and 0.3 % do, with 95 % confidence."""
BASELINE_STARTS = 200
"""Starts of each controller that a plain run only compares with; nothing is promised of them."""


class ValidationSection(Section):
    """Number of runs, their length, and which of them are kept in full."""

    starts: int | None = Field(
        None,
        ge=1,
        description="Number of runs; their initial states are drawn from the winning domain of the gap-aware "
        f"controller. Default: {STARTS:,} (full run: {FULL_STARTS:,}). In a plain run, the other controllers run "
        f"from {BASELINE_STARTS:,} of them.",
    )
    first: tuple[dict[str, float], ...] = ()
    """Initial states of the first runs, before random ones; each must be in both winning domains."""
    steps: int = Field(2000, ge=1)
    """Samples in each run."""
    seed: int = Field(0, ge=0)
    """Seed of the starts."""
    kept: int = Field(4, ge=1)
    """Number of runs of each controller whose traces are kept."""
    fair_baseline: bool = False
    """Whether a third controller runs from the same starts: made for the nominal model alone, like the nominal-only
    one, but checking what that model does between samples. For specifications of the whole path."""

    def count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts of the gap-aware controller."""
        return self.starts or (STARTS if trials == Trials.PLAIN else FULL_STARTS)

    def baseline_count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts, of these, of each controller that it is compared with."""
        return min(self.count(trials), BASELINE_STARTS) if trials == Trials.PLAIN else self.count(trials)
