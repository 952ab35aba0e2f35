"""A checked case: the place that it came from, names, units, X and U as arrays, its nominal model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeVar

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.load import load_case
from simgap.config.plant import DomainSection
from simgap.errors import UserError, placed
from simgap.geometry import Box
from simgap.plants.plant_model import PlantModel
from simgap.provenance import provenance, require_own

T = TypeVar("T")


@dataclass(frozen=True)
class Context:
    """A case, the place that its relative paths start from, and its nominal model, built once when first needed."""

    case: Case
    path: Path

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read the case file.

        Raises:
            UserError: if it does not check.
        """
        return cls(load_case(path), path)

    @property
    def folder(self) -> Path:
        """The folder of the case file."""
        return self.path.parent

    def need(self, section: T | None, key: str) -> T:
        """A section that this stage cannot do without.

        Raises:
            UserError: if the case does not have it.
        """
        if section is None:
            raise UserError("this stage needs the section", file=self.path, key=key, remedy=f"Add `{key}:`.")
        return section

    @property
    def domain(self) -> DomainSection:
        """Sampling time, X and U."""
        return self.need(self.case.domain, "domain")

    @property
    def periodic(self) -> tuple[int, ...]:
        """Axes of the states that wrap around."""
        return tuple(self.states.index(name) for name in self.domain.periodic)

    @property
    def states(self) -> list[str]:
        """Names of the states, in order."""
        return list(self.case.plant.states)

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs, in order."""
        return list(self.case.plant.inputs)

    @property
    def box(self) -> Box:
        """The state box X."""
        ends = [self.domain.X[name] for name in self.states]
        return Box([lo for lo, _ in ends], [hi for _, hi in ends])

    @property
    def input_set(self) -> Floats:
        """All of U, (M, nu)."""
        return self.domain.inputs(self.inputs)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each state and input."""
        plant = self.case.plant
        return {n: s.unit for n, s in plant.states.items()} | {n: i.unit for n, i in plant.inputs.items()}

    def blame(self) -> AbstractContextManager[None]:
        """Name the case file in mistakes that surface deeper down without a file."""
        return placed(file=self.path)

    @cached_property
    def plant(self) -> PlantModel:
        """The nominal model in all its shapes."""
        return PlantModel.of(self.case, self.folder)

    def record(
        self, stage: str, seeds: Mapping[str, int] | None = None, rests: Sequence[str] = (), **more: Any
    ) -> dict[str, Any]:
        """What a result of a stage says of how it was made of this case: `provenance.provenance`."""
        return provenance(stage, self.case, self.folder, seeds, rests, **more)

    def own(self, path: Path | str, record: Any, *stages: str) -> None:
        """Refuse a result that one of these stages did not make of this case: `provenance.require_own`.

        Raises:
            UserError: with the keys that differ.
        """
        require_own(Path(path), record, stages, self.case, self.folder)


def pose_axes(context: Context) -> tuple[int, int, int]:
    """Axes of x, y and heading."""
    symbolic = context.need(context.case.plant.symbolic, "plant.symbolic")
    wheels = context.need(symbolic.wheels, "plant.symbolic.wheels")
    x, y, heading = (context.states.index(name) for name in (wheels.x, wheels.y, wheels.heading))
    return x, y, heading
