"""A checked case with its nominal model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from simgap.config import context
from simgap.plants.plant_model import PlantModel


@dataclass(frozen=True)
class Context(context.Context):
    """A case with its nominal model, which is built when first asked for, once a stage."""

    @cached_property
    def plant(self) -> PlantModel:
        """The nominal model in all its shapes."""
        return PlantModel.of(self.case, self.folder)
