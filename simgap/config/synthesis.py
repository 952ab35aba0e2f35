"""The `synthesis` section: what the controller is asked for, and on which cells."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from simgap.config.base import Section

Interval = tuple[float, float]


def _upright(box: dict[str, Interval], key: str) -> None:
    for name, (lo, hi) in box.items():
        if not lo < hi:
            raise ValueError(f"{key} is upside down for {name}: {lo} is not below {hi}")


class InvarianceSpecification(Section):
    """Stay in a box for ever."""

    kind: Literal["invariance"] = Field(description="Stay in the safe set for ever.")
    safe: dict[str, Interval] = Field(
        min_length=1, description="For each state the interval to stay in; states not named keep all of X."
    )

    @field_validator("safe")
    @classmethod
    def _check(cls, value: dict[str, Interval]) -> dict[str, Interval]:
        _upright(value, "safe")
        return value


class ReachAvoidSpecification(Section):
    """Reach a box without touching others on the way."""

    kind: Literal["reach_avoid"] = Field(description="Reach the target and avoid the obstacles on the way.")
    arena: dict[str, Interval] = Field(
        default_factory=dict, description="For each state the interval never to leave; states not named keep all of X."
    )
    obstacles: tuple[dict[str, Interval], ...] = Field(
        (), description="Boxes to avoid; an obstacle holds for all values of the states it does not name."
    )
    target: dict[str, Interval] = Field(min_length=1, description="The box to reach; states not named are free.")
    clearance: dict[str, float] = Field(
        default_factory=dict,
        description="For a state, how far to keep from walls and obstacles (half the footprint), in its unit.",
    )

    @model_validator(mode="after")
    def _check(self) -> ReachAvoidSpecification:
        _upright(self.arena, "arena")
        _upright(self.target, "target")
        for number, obstacle in enumerate(self.obstacles):
            _upright(obstacle, f"obstacles[{number}]")
        negative = [name for name, value in self.clearance.items() if value < 0]
        if negative:
            raise ValueError(f"the clearance of {negative} is negative")
        return self


Specification = Annotated[InvarianceSpecification | ReachAvoidSpecification, Field(discriminator="kind")]


class SynthesisSection(Section):
    """Cells of the abstraction and the specification."""

    cells: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        min_length=1, max_length=4, description="Cells per state, in order, over the safe set or the arena."
    )
    specification: Specification = Field(description="What the closed loop must do.")
    nominal_between_samples: bool = Field(
        False,
        description="Whether the controller of the nominal model alone also minds what that model does between "
        "samples; as in the paper it looks at the sampling instants only.",
    )
    rule: Literal["least_effort", "middle"] = Field(
        "least_effort", description="Which of the admissible inputs the controller applies."
    )
